"""Gait phase by time alone.

The share of the last stride's duration that has passed since the last touch-down of one foot.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from stridetwin.estimators.base import Declaration, Options, Stream
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Imu

TOE_OFF_RADPS, REST_RADPS, SHORTEST_SWING_S, LONGEST_STRIDE_S = 5.0, 1.0, 0.35, 2.5


@dataclass(frozen=True, kw_only=True)
class Phase:
    """The phase, 0-1, at a time."""

    t_ns: int
    phase: float


class PhaseByTime:
    """A touch-down is where the foot's rotation first ends, long enough after the fast rotation of toe-off."""

    declaration: ClassVar[Declaration] = Declaration(
        name="phase_by_time", kind="simple_phase", per_foot=True, needs="/foot_l/imu or /foot_r/imu"
    )

    def __init__(self, rig: Rig, *, options: Options | None = None, parameters: Any = None) -> None:
        rig.imu(_topic(options or Options()))
        self._toe_off_ns: int | None = None
        self._touch_down_ns: int | None = None
        self._stride_ns = 0

    @classmethod
    def streams(cls, rig: Rig, options: Options) -> tuple[Stream, ...]:
        """The IMU of the foot."""
        return (Stream(role="imu", topic=_topic(options), kind=Imu),)

    def update(self, sample: Imu) -> Phase | None:
        """The phase after one sample; None before the second touch-down."""
        rate = float(np.linalg.norm(sample.angular_rate))
        if self._toe_off_ns is None and rate > TOE_OFF_RADPS:
            self._toe_off_ns = sample.t_ns
        swings = self._toe_off_ns is not None and sample.t_ns - self._toe_off_ns > SHORTEST_SWING_S * 1e9
        if swings and rate < REST_RADPS:
            since_ns = sample.t_ns - (self._touch_down_ns or 0)
            self._stride_ns = since_ns if self._touch_down_ns and since_ns < LONGEST_STRIDE_S * 1e9 else 0
            self._touch_down_ns, self._toe_off_ns = sample.t_ns, None
        if self._touch_down_ns is None or not self._stride_ns:
            return None
        phase = min(1.0, (sample.t_ns - self._touch_down_ns) / self._stride_ns)
        return Phase(t_ns=sample.t_ns, phase=phase)


def _topic(options: Options) -> str:
    return f"/foot_{options.foot}/imu"
