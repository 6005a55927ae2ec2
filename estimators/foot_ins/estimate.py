"""What the filter of one foot returns, and where it starts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.base import PathEstimate
from stridetwin.estimators.foot_ins import state
from stridetwin.estimators.foot_ins.slope import HEIGHT_SD
from stridetwin.estimators.foot_ins.strapdown import MOST_SWING_S
from stridetwin.streams.errors import ConfigError, RecordingError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Array
from stridetwin.streams.trajectory import Pose, Trajectory

LONGEST_WITHOUT_STANCE_S = 6.0
"""A pose counts up to this long after a stance, s. No walk of `docs/foot_ins.md` moves a foot for longer than 2.2 s (it
crawls); after 6 s a consumer IMU alone is off by metres."""
_RARE_SHARE = 0.05  # of the time: a walk of `docs/foot_ins.md` has less far from a stance
NO_STANCE = "the sensor never rests as a foot does in every stance; is it worn on a foot?"


@dataclass(frozen=True, kw_only=True, eq=False)
class StartPose:
    """Pose of the sensor at its first sample; gravity corrects the tilt of `q_world_imu`.

    Attributes:
        p_imu_in_world: (3,) m, position.
        q_world_imu: (4,) unit quaternion (w, x, y, z), sensor to world; its heading is used unchanged.
        position_sd: Standard deviation of the position, m.
        heading_sd: Standard deviation of the heading, rad.
    """

    p_imu_in_world: Array
    q_world_imu: Array
    position_sd: float = state.START_POSITION_SD
    heading_sd: float = state.START_HEADING_SD

    def __post_init__(self) -> None:
        """Raises ConfigError where a value has another shape, is not finite or is no unit quaternion."""
        for name, size in (("p_imu_in_world", 3), ("q_world_imu", 4)):
            value = np.asarray(getattr(self, name), dtype=float)
            if value.shape != (size,) or not np.all(np.isfinite(value)):
                raise ConfigError("StartPose", name, getattr(self, name), f"{size} finite numbers")
        if abs(np.linalg.norm(self.q_world_imu) - 1.0) > 1e-3:
            raise ConfigError("StartPose", "q_world_imu", self.q_world_imu, "a unit quaternion (w, x, y, z)")
        for name in ("position_sd", "heading_sd"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise ConfigError("StartPose", name, getattr(self, name), "a finite number ≥ 0")

    def apply_to(self, memory: state.FilterState) -> None:
        """Writes this pose, and its standard deviations, into the state of a foot without samples.

        The first alignment then keeps the heading of the pose and corrects only its tilt.
        """
        q = np.asarray(self.q_world_imu, dtype=float)  # a unit quaternion but for rounding
        memory.nominal[state.POSITION : state.POSITION + 3] = self.p_imu_in_world
        memory.nominal[state.ATTITUDE : state.ATTITUDE + 4] = q / np.linalg.norm(q)
        memory.start_sd[:] = self.position_sd, self.heading_sd
        memory.clock[state.HEADING_KNOWN] = 1


@dataclass(frozen=True, kw_only=True, eq=False)
class FootInsEstimate:
    """Estimated state of the foot's sensor after one sample.

    Attributes:
        t_ns: Time of the sample.
        pose: Pose of the sensor, without covariance; valid once the vertical is found.
        v_imu_in_world: (3,) m/s, velocity of the sensor.
        covariance: (15, 15) of the errors of position (m), velocity (m/s), attitude (rad, world axes), gyro bias
            (rad/s) and accelerometer bias (m/s², both sensor axes).
        standing_speed_sd: Standard deviation of the speed of a foot detected as stationary, m/s; inf if it is moving.
        aligned: False until the vertical is found.
    """

    t_ns: int
    pose: Pose
    v_imu_in_world: Array
    covariance: Array
    standing_speed_sd: float
    aligned: bool

    @classmethod
    def of(
        cls,
        memory: state.FilterState,
        phase: int,
        standing_speed_sd: float,
        frame: str = "",
        *,
        nominal: Array | None = None,
        pose_covariance: Array | None = None,
    ) -> FootInsEstimate:
        """The estimate in the memory after a sample, copied.

        Args:
            memory: State of the foot.
            phase: Phase in which the sample was used, `state.ALIGNING` or `state.NAVIGATING`.
            standing_speed_sd: Standard deviation of the speed of a stationary foot, m/s; inf if it is moving.
            frame: Frame of the sensor.
            nominal: (22,) nominal state at the time of the sample; None: that of the memory.
            pose_covariance: (6, 6) reported covariance of position (m) and attitude (rad), world axes; None: that of
                the memory with the errors that are no states.
        """
        # o: first row of this foot in the covariance, which may hold both feet
        x, o, t_ns = (
            (memory.nominal if nominal is None else nominal).copy(),
            memory.row,
            int(memory.clock[state.T_LAST]),
        )
        p, q = x[state.POSITION : state.POSITION + 3], x[state.ATTITUDE : state.ATTITUDE + 4]
        covariance = memory.covariance[o : o + state.REPORTED, o : o + state.REPORTED].copy()
        # the reported one has errors that are no states of the filter
        i = np.r_[state.D_POSITION : state.D_POSITION + 3, state.D_ATTITUDE : state.D_ATTITUDE + 3]
        if pose_covariance is None:
            covariance[np.ix_(i, i)] = _report_covariance(memory, covariance[np.ix_(i, i)])
        else:
            covariance[np.ix_(i, i)] = pose_covariance
        return cls(
            t_ns=t_ns,
            pose=Pose(t_ns=t_ns, p_frame_in_world=p, rotation=q, frame=frame, valid=phase == state.NAVIGATING),
            v_imu_in_world=x[state.VELOCITY : state.VELOCITY + 3],
            covariance=covariance,
            standing_speed_sd=standing_speed_sd,
            aligned=phase == state.NAVIGATING,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class FootInsPath:
    """Estimates after each usable sample of a block.

    Attributes:
        trajectory: Poses of the sensor with covariance, one per usable sample.
        v_imu_in_world: (N, 3) m/s, velocity of the sensor.
        standing_speed_sd: (N,) m/s, standard deviation of a stationary foot's speed; inf where it is not stationary.
        aligned: (N,) bool, whether the vertical is found.
    """

    trajectory: Trajectory
    v_imu_in_world: Array
    standing_speed_sd: Array
    aligned: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        t_ns: NDArray[np.int64],
        phase: NDArray[np.int8],
        standing_speed_sd: Array,
        nominal: Array,
        covariance: Array,
    ) -> FootInsPath:
        """The output of `delay.run` for N samples, without those that it ignored.

        Args:
            t_ns: (N,) times.
            phase: (N,) phase in which each sample was used.
            standing_speed_sd: (N,) m/s, standard deviation of a stationary foot's speed; inf where it is not
                stationary.
            nominal: (N, 22) nominal states.
            covariance: (N, 6, 6) of position (m) and attitude (rad), world axes.
        """
        used = phase != state.IGNORED
        return cls(
            trajectory=Trajectory(
                t_ns=t_ns[used],
                p_frame_in_world=nominal[used, state.POSITION : state.POSITION + 3],
                q_world_frame=nominal[used, state.ATTITUDE : state.ATTITUDE + 4],
                covariance=covariance[used],
            ),
            v_imu_in_world=nominal[used, state.VELOCITY : state.VELOCITY + 3],
            standing_speed_sd=standing_speed_sd[used],
            aligned=phase[used] == state.NAVIGATING,
        )

    @property
    def reliable(self) -> NDArray[np.bool_]:
        """(N,) whether a stance, or the alignment, was at most `LONGEST_WITHOUT_STANCE_S` ago.

        A path without any stance is not reliable at all: the sensor is worn elsewhere than on a foot.
        """
        if not np.isfinite(self.standing_speed_sd).any():
            return np.zeros(len(self.aligned), bool)
        return np.asarray(self.aligned & (self._time_since_stance_s <= LONGEST_WITHOUT_STANCE_S))

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence about stances, if they are so rare that much of the path has none nearby."""
        share = float(np.mean(self._time_since_stance_s[self.aligned] > MOST_SWING_S)) if self.aligned.any() else 0.0
        if share < _RARE_SHARE:
            return ()
        far = f"{100.0 * share:.0f} % of the time"
        return (f"the foot has no stance within {MOST_SWING_S:g} s for {far}: its path is unsure",)

    @property
    def _time_since_stance_s(self) -> Array:
        """(N,) time since the last stance, or since the alignment, s."""
        in_stance = np.isfinite(self.standing_speed_sd)
        in_stance[self.aligned.argmax()] = True  # the alignment ends there
        t_ns = self.trajectory.t_ns
        last = np.maximum.accumulate(np.where(in_stance, t_ns, t_ns[0]))  # time of the last stance so far, ns
        return np.asarray((t_ns - last) * 1e-9)

    def estimate(
        self,
        recording: Recording,
        name: str,
        foot: str,
        label: str,
        nis: Mapping[str, float],
        world: str = "",
        topic: str = "",
    ) -> PathEstimate:
        """The path of the IMU on `foot` as an estimate.

        Args:
            recording: The recording that the samples are from.
            name: Name of the estimator.
            foot: `l` or `r`.
            label: Label of the estimate.
            nis: Mean normalised innovation squared by kind of update.
            world: Frame of the world.
            topic: Topic of the IMU; "" stands for that of a shoe's.

        Raises:
            RecordingError: The vertical was never found.
        """
        frame = topic.removeprefix("/") or f"foot_{foot}/imu"
        if not self.aligned.any():  # no alignment has ended
            raise RecordingError(f"{recording.path}: /{frame}: the foot never stands still")
        reliable = self.reliable
        ready_ns = int(self.trajectory.t_ns[self.aligned.argmax()])  # the first sample with a known vertical
        return PathEstimate(
            name=f"{name}_{foot}",
            frame=frame,
            path=self.trajectory,
            ready_ns=ready_ns,
            # only where a part is not reliable; None stands for all
            healthy=None if reliable[self.aligned].all() else reliable,
            nis=nis,
            world=world,
            label=label,
            notes=self.notes,
        )


def _report_covariance(memory: state.FilterState, covariance: Array) -> Array:
    """(6, 6) of position (m) and attitude (rad) with the errors that are no states, as in `kernel.write_estimate`.

    The order of the sums is that of the kernel, so that both give the same digits.
    """
    unlearnt, way = memory.unlearnt, memory.nominal[state.POSITION : state.POSITION + 3] - memory.path[:3]
    along = np.r_[way, np.zeros(3)]
    bent = np.zeros(6)  # by the bias about the vertical
    bent[:2], bent[5] = unlearnt[state.UNLEARNT_POSITION :][:2], unlearnt[state.UNLEARNT_TURN]
    reported = covariance + memory.path[3] ** 2 * np.outer(along, along)
    reported[2, 2] += unlearnt[state.UNLEARNT_HEIGHT] + memory.levelled[HEIGHT_SD] ** 2
    reported += unlearnt[state.UNLEARNT_VARIANCE] * np.outer(bent, bent)
    o = memory.row
    rows = np.r_[o + state.D_POSITION : o + state.D_POSITION + 3, o + state.D_ATTITUDE : o + state.D_ATTITUDE + 3]
    return with_considered(memory, reported, rows)


def with_considered(memory: state.FilterState, covariance: Array, rows: NDArray[np.int64]) -> Array:
    """(n, n) covariance of n errors of the filter with what the considered errors add to it.

    Args:
        memory: State of a foot.
        covariance: (n, n) of them without the considered errors.
        rows: (n,) their rows in `memory.covariance`.
    """
    reported = covariance.copy()
    if memory.considered >= 0:
        for error, sd in enumerate(memory.considered_sd):
            derivative = memory.covariance[memory.considered + error, rows]
            reported += np.outer(sd**2 * derivative, derivative)
    return reported


def nis_by_kind(memory: state.FilterState) -> dict[str, float]:
    """Mean normalised innovation squared, per degree of freedom, of each kind of update used so far: 1 if consistent.

    The kinds are `standing` (zero velocity), `floor` and `rest` (zero rate); those not used so far are left out.
    """
    # (2,) each: sum of the normalised innovation squared, and number of updates
    sums = {
        "standing": memory.nis[state.BY_VELOCITY],
        "floor": memory.nis[state.BY_FLOOR],
        "rest": memory.nis[state.BY_RATE],
    }
    return {name: float(total / count) for name, (total, count) in sums.items() if count > 0.0}
