"""Gait phase as an estimator: IMU samples of one foot in, phases out."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from stridetwin.estimators.base import FOOT_NAMES, Declaration, Options, Stream, foot_imu_topic
from stridetwin.estimators.gait_phase.contact import ContactDetector
from stridetwin.estimators.gait_phase.estimate import UNKNOWN_PHASE_SD, PhaseEstimate
from stridetwin.estimators.gait_phase.parameters import GaitPhaseParameters
from stridetwin.estimators.gait_phase.stride import StrideFilter
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Imu

KIND = "gait_phase"
_LARGEST_PHASE = math.nextafter(1.0, 0.0)  # the largest number below 1
_MAX_RATE_RADPS, _MAX_FORCE_MPS2 = 100.0, 5000.0  # no foot moves so; such samples are left out


class GaitPhase:
    """Phase of one leg's gait cycle from its foot IMU: causal, of constant memory, deterministic.

    A sample is left out if it is not finite, physically impossible, or not later than the last used one. Gaps in the
    samples are bridged by the clock; after `max_gap_s` the running stride teaches nothing.

    Args:
        rig: The IMU on the foot, and its mount there.
        options: `foot`.
        parameters: Parameters for any foot and sensor.

    Raises:
        StrideTwinError: The rig has no IMU on that foot.
    """

    declaration: ClassVar[Declaration] = Declaration(
        name="gait_phase",
        kind=KIND,
        per_foot=True,
        budget_s=0.05,
        needs="/foot_l/imu or /foot_r/imu",
        summary="Each leg by itself: phase of the gait cycle from one IMU in the shoe.",
    )

    def __init__(
        self, rig: Rig, *, options: Options | None = None, parameters: GaitPhaseParameters | None = None
    ) -> None:
        """Prepares for the IMU that the rig has on the foot that the options name."""
        Rig.check(rig, "GaitPhase")
        options = options or Options()
        if options.foot not in FOOT_NAMES:
            raise ConfigError("GaitPhase", "foot", options.foot, ", ".join(FOOT_NAMES))
        imu = rig.imu(foot_imu_topic(rig, options.foot))
        # (3,) the foot's y axis, left, in sensor axes
        self._left_in_sensor = tuple(float(v) for v in imu.mount.T_body_sensor[1, :3])
        self._parameters = parameters or GaitPhaseParameters()
        self._contact = ContactDetector(self._parameters, imu.accelerometer_range)
        self._stride = StrideFilter(self._parameters)
        self._t_ns = -1  # time of the last sample that was not left out

    @classmethod
    def streams(cls, rig: Rig, options: Options) -> tuple[Stream, ...]:
        """The IMU on the foot `options.foot` (`l` or `r`)."""
        return (Stream(role="imu", topic=foot_imu_topic(rig, options.foot), kind=Imu),)

    def update(self, sample: Imu) -> PhaseEstimate | None:
        """Takes one sample; returns the new estimate, or None if the sample is left out.

        The pitch rate is the component of the angular rate along the foot's y axis, toes down positive. A touch-down,
        which may lie before the sample, ends a stride and begins the next one.
        """
        # three numbers each, in sensor axes: rad/s and m/s²
        rate, force = np.asarray(sample.angular_rate).tolist(), np.asarray(sample.specific_force).tolist()
        if sample.t_ns <= self._t_ns or not _is_possible(rate, force):
            return None
        interval_s = (sample.t_ns - self._t_ns) * 1e-9 if self._t_ns >= 0 else 0.0
        self._t_ns = sample.t_ns
        pitch_rate = sum(r * axis for r, axis in zip(rate, self._left_in_sensor))
        if interval_s > self._parameters.max_gap_s:
            self._stride.is_regular = False  # a touch-down may be missing
        touch_down_ns = self._contact.update(
            sample.t_ns, interval_s, pitch_rate, (force[0], force[1], force[2]), self._stride
        )
        if touch_down_ns is not None:
            self._stride.begin(touch_down_ns)
        self._stride.update(sample.t_ns, interval_s, pitch_rate)
        stride = self._stride
        return PhaseEstimate(
            t_ns=sample.t_ns,
            phase=min(stride.phase, _LARGEST_PHASE) if stride.is_walking else 0.0,
            phase_sd=min(stride.phase_sd, UNKNOWN_PHASE_SD) if stride.is_walking else UNKNOWN_PHASE_SD,
            rate=stride.rate if stride.is_walking else 0.0,
            walking=stride.is_walking,
            swing=self._contact.is_swing,
            touch_down_ns=stride.begin_ns,
        )


def _is_possible(rate: list[float], force: list[float]) -> bool:
    """Whether a sensor on a foot can have measured this; False for NaN."""
    return all(abs(r) <= _MAX_RATE_RADPS for r in rate) and all(abs(f) <= _MAX_FORCE_MPS2 for f in force)
