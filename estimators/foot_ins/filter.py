"""The one-foot inertial navigation as an estimator: samples in, poses out."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.base import (
    PATH,
    PROPOSED,
    Declaration,
    Options,
    PathEstimate,
    Progress,
    Stream,
    foot_imu_topic,
)
from stridetwin.estimators.foot_ins import delay, published
from stridetwin.estimators.foot_ins.estimate import NO_STANCE, FootInsEstimate, FootInsPath, StartPose, nis_by_kind
from stridetwin.estimators.foot_ins.learnt import LearntCalibration, read_learnt, write_learnt
from stridetwin.estimators.foot_ins.parameters import FootInsParameters, for_sensor
from stridetwin.estimators.foot_ins.published import THRESHOLDS, ZeroVelocityDetector
from stridetwin.estimators.foot_ins.smoother import FootInsSmoother
from stridetwin.estimators.foot_ins.state import IGNORED, initial_state
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import ImuCalibration, Rig
from stridetwin.streams.samples import Array, Block, Imu

METHODS = (PROPOSED, *THRESHOLDS)
"""The filter described here, and the published ones (module `published`)."""


class FootIns:
    """Zero-velocity-aided inertial navigation of one foot: causal, of constant memory, deterministic.

    The world's z axis is up. Without a start pose, its origin is where the sensor was first stationary, and its x axis
    is the sensor's x axis then (its z axis, if x is within about 25° of the vertical). A sample is ignored if it is not
    finite, physically impossible, or not later than the last used one. A gap is bridged up to 0.3 s; after a
    longer one the filter keeps its position, with a large covariance, and aligns again.

    Args:
        rig: Noise and turn-on biases of the IMU on the foot; None: any consumer sensor.
        parameters: Parameters for any foot and sensor.
        start: Pose of the sensor at the first sample.
        options: `foot`, and `method`, one of `METHODS`.
        detector: Settings of a published method, in place of those that the options' `method` has.

    Raises:
        ConfigError: The method is unknown, or the options have a lag, which `batch` takes.
        StrideTwinError: The rig has no IMU on that foot.
    """

    declaration: ClassVar[Declaration] = Declaration(
        name="foot_ins",
        kind=PATH,
        order=1,
        methods=METHODS,
        per_foot=True,
        smooths=True,
        recalls=True,
        label="",
        budget_s=0.05,
        needs="/foot_l/imu or /foot_r/imu",
        summary="Each foot by itself: one IMU in the shoe, zero-velocity updates, nothing else.",
    )

    def __init__(
        self,
        rig: Rig | None = None,
        parameters: FootInsParameters | None = None,
        start: StartPose | None = None,
        *,
        options: Options | None = None,
        detector: ZeroVelocityDetector | None = None,
    ) -> None:
        """Prepares a foot without samples, with the noise of the rig's IMU on the foot that the options name."""
        if rig is not None:
            Rig.check(rig, "FootIns")  # raises if `rig` is no `Rig`
        options = options or Options()
        if options.lag_s is not None:
            raise ConfigError("FootIns", "lag_s", options.lag_s, "None; FootIns.batch and FootInsSmoother take a lag")
        if options.method not in METHODS:
            raise ConfigError("FootIns", "method", options.method, ", ".join(METHODS))
        if detector is None and options.method != PROPOSED:
            detector = ZeroVelocityDetector(method=options.method)
        calibration = None if rig is None else rig.imu(foot_imu_topic(rig, options.foot))
        self._frame = "" if calibration is None else calibration.topic.removeprefix("/")
        self._parameters = for_sensor(parameters or FootInsParameters(), calibration)
        # of a published method; None for the filter described here
        gravity_mps2 = float(self._parameters.gravity_mps2)
        self._detector = None if detector is None else published.for_kernel(detector, gravity_mps2)
        self._memory = initial_state()  # of the filter
        self._part = "" if calibration is None else calibration.part
        self._rate_hz = 0.0 if calibration is None else calibration.rate_hz
        learnt = None if detector is not None else _recall(options, calibration)  # published methods learn nothing
        self._bank = delay.initial_bank(None if learnt is None else learnt.force_later_s)
        if learnt is not None:
            learnt.apply_to(self._memory)
        # time, rate and force of one sample: `update` uses these buffers and allocates none
        self._sample = np.empty(1, np.int64), np.empty((1, 3)), np.empty((1, 3))
        # phase, standard deviation of the speed, state and covariance after that sample
        self._results = self._allocate_results(1)
        if start is not None:
            start.apply_to(self._memory)

    @classmethod
    def streams(cls, rig: Rig, options: Options) -> tuple[Stream, ...]:
        """The IMU on the foot `options.foot` (`l` or `r`)."""
        return (Stream(role="imu", topic=foot_imu_topic(rig, options.foot), kind=Imu),)

    @classmethod
    def follow(
        cls,
        recording: Recording,
        options: Options,
        progress: Progress | None = None,
        parameters: FootInsParameters | None = None,
    ) -> list[PathEstimate]:
        """The path of one foot over a whole recording, smoothed where the options have a lag.

        It takes seconds, so `progress` is not used. The list has one path.

        Raises:
            StrideTwinError: The topic or the calibration is missing, or the foot is never stationary.
        """
        topic = foot_imu_topic(recording.rig if recording.has_rig else None, options.foot)
        block = recording.block(topic).as_kind(Imu)
        estimator = cls.batch(recording.rig, options, parameters)
        path = estimator.run(block)
        label = ""  # figures call the path "left" or "right" alone
        estimate = path.estimate(recording, cls.declaration.name, options.foot, label, estimator.nis, topic=topic)
        return [replace(estimate, write_calibration=partial(write_learnt, estimator.learnt))]

    @classmethod
    def estimate_block(
        cls, block: Block[Imu], options: Options, rig: Rig | None = None, parameters: FootInsParameters | None = None
    ) -> PathEstimate:
        """The path of a single IMU, with what was learnt of it; without a rig, it is assumed to be a consumer sensor.

        Poses long after a stance (`LONGEST_WITHOUT_STANCE_S`) are left out.

        Raises:
            StrideTwinError: There is no stance after the alignment.
        """
        estimator = cls.batch(rig, options, parameters)
        path = estimator.run(block)
        reliable = path.reliable
        if path.aligned.any() and not reliable.any():
            raise StrideTwinError(f"{block.topic}: {NO_STANCE}")
        # poses before the vertical is known stay, as in a path without a gap
        return PathEstimate(
            name=cls.declaration.name,
            frame="",
            path=path.trajectory[reliable | ~path.aligned],
            notes=path.notes,
            write_calibration=partial(write_learnt, estimator.learnt),
        )

    @classmethod
    def batch(
        cls, rig: Rig | None, options: Options, parameters: FootInsParameters | None = None
    ) -> FootIns | FootInsSmoother:
        """The filter for whole blocks, or its smoother if the options have a lag."""
        if options.lag_s is None:
            return cls(rig, parameters, options=options)
        if options.method != PROPOSED:
            raise ConfigError("FootIns", "method", options.method, f"{PROPOSED}, for a path that is smoothed")
        calibration = None if rig is None else rig.imu(foot_imu_topic(rig, options.foot))
        return FootInsSmoother(options.lag_s, calibration, parameters, learnt=_recall(options, calibration))

    def update(self, sample: Imu) -> FootInsEstimate | None:
        """Takes one sample; returns the new estimate, or None if the sample is ignored."""
        t_ns, rate, force = self._sample
        t_ns[0], rate[0], force[0] = sample.t_ns, sample.angular_rate, sample.specific_force
        phase, speed_sd, nominal, covariance = self._results
        self._take(t_ns, rate, force, self._results)
        if phase[0] == IGNORED:
            return None
        return FootInsEstimate.of(
            self._memory,
            int(phase[0]),
            float(speed_sd[0]),
            self._frame,
            nominal=nominal[0],
            pose_covariance=covariance[0],
        )

    @property
    def nis(self) -> dict[str, float]:
        """Mean normalised innovation squared, per degree of freedom, by kind of update: 1 if consistent.

        The kinds are `standing` (zero velocity), `floor` and `rest` (zero rate); those not used so far are left out.
        """
        return nis_by_kind(self._memory)

    @property
    def learnt(self) -> LearntCalibration:
        """What the samples so far have taught about the sensor."""
        rate_hz = self._rate_hz or delay.sample_rate_hz(self._memory)
        return LearntCalibration.of(self._memory, self._part, rate_hz, delay.force_later_s(self._memory, self._bank))

    def run(self, block: Block[Imu]) -> FootInsPath:
        """Takes a block's samples as `update` would one by one; returns the path over the usable ones."""
        rate, force = block.columns["angular_rate"], block.columns["specific_force"]
        results = self._allocate_results(len(block))
        self._take(
            np.ascontiguousarray(block.t_ns, dtype=np.int64),
            np.ascontiguousarray(rate, dtype=np.float64),
            np.ascontiguousarray(force, dtype=np.float64),
            results,
        )
        return FootInsPath.of(block.t_ns, *results)

    def _take(
        self,
        t_ns: NDArray[np.int64],
        rate: Array,
        force: Array,
        results: tuple[NDArray[np.int8], Array, Array, Array],
    ) -> None:
        """Takes N samples: (N,) times, (N, 3) rad/s and (N, 3) m/s²; fills buffers of `_allocate_results`."""
        if self._detector is None:
            delay.run(self._memory, self._bank, self._parameters, t_ns, rate, force, *results)
        else:
            published.run(self._memory, self._detector, t_ns, rate, force, *results)

    def _allocate_results(self, n: int) -> tuple[NDArray[np.int8], Array, Array, Array]:
        """Empty buffers that `delay.run` fills for n samples.

        Returns:
            Phase (n,); standard deviation of a stationary foot's speed (n,); nominal states (n, 22); covariance of
            position and attitude (n, 6, 6).
        """
        return np.empty(n, np.int8), np.empty(n), np.empty((n, len(self._memory.nominal))), np.empty((n, 6, 6))


def _recall(options: Options, calibration: ImuCalibration | None) -> LearntCalibration | None:
    """What an earlier estimate learnt of the sensor; None without a file.

    Raises:
        ConfigError: The file is of another sensor, or is none.
    """
    if options.calibration_from is None:
        return None
    learnt = read_learnt(options.calibration_from)
    if calibration is not None:
        learnt.check_sensor(str(options.calibration_from), calibration.part, calibration.rate_hz)
    return learnt
