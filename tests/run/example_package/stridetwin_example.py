"""Attitude of one foot from gravity alone.

An estimator of another package; the foot's place stays the origin.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import PATH, Declaration, Options, Stream
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Imu
from stridetwin.streams.trajectory import Pose

SMOOTHING = 0.02


class GravityFoot:
    """Low-pass of the specific force of one foot; causal, of constant memory."""

    declaration: ClassVar[Declaration] = Declaration(
        name="gravity_foot",
        kind=PATH,
        per_foot=True,
        methods=("low_pass",),
        needs="/foot_l/imu or /foot_r/imu",
        summary="Gravity: the attitude of a foot that stands.",
    )

    def __init__(self, rig: Rig, *, options: Options | None = None, parameters: float | None = None) -> None:
        self._imu = rig.imu(_topic(options or Options()))
        self._smoothing = SMOOTHING if parameters is None else parameters
        self._up: np.ndarray | None = None
        self._last_ns = -1

    @classmethod
    def streams(cls, rig: Rig, options: Options) -> tuple[Stream, ...]:
        """The IMU of the foot."""
        return (Stream(role="imu", topic=_topic(options), kind=Imu),)

    def update(self, sample: Imu) -> Pose | None:
        """The pose after one sample; None for a sample that is not finite, or not later than the last one."""
        if sample.t_ns <= self._last_ns or not np.isfinite(sample.specific_force).all():
            return None
        self._last_ns = sample.t_ns
        up = sample.specific_force if self._up is None else self._up
        self._up = up = up + self._smoothing * (sample.specific_force - up)
        x = np.cross([0.0, 1.0, 0.0], up)
        rows = np.array([x, np.cross(up, x), up])
        R_world_imu = rows / np.linalg.norm(rows, axis=1, keepdims=True)
        q = Rotation.from_matrix(R_world_imu).as_quat(scalar_first=True)
        frame = self._imu.topic.removeprefix("/")
        return Pose(t_ns=sample.t_ns, frame=frame, p_frame_in_world=np.zeros(3), rotation=q)


def _topic(options: Options) -> str:
    return f"/foot_{options.foot}/imu"
