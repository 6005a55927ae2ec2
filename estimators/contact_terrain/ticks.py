"""Joins nine streams into one row per instant, and fuses the attitudes of the exoskeleton's frames.

A tick is complete when every stream has delivered its sample; the first sample of a later instant closes an incomplete
one. A late stream is extrapolated for up to `_HOLD_S`: an attitude by its last angular rate, an angle and
forces as constants. A sample counts as lost if it is not finite, out of the sensor's range, or not later than the
stream's last one. A negative force, of a cell whose zero is low, counts as none.

The tilt error of an AHRS is correlated and grows with motion; its integrated gyro has hardly any error within a step.
`Attitudes` therefore propagates each attitude by the rates, and the AHRS corrects it slowly: a Kalman filter with one
variance per frame, in which an AHRS sample has a white error of the same power (2 τ σ² / dt).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit

from stridetwin.estimators.contact_terrain.geometry import SIDES, Exoskeleton
from stridetwin.estimators.contact_terrain.parameters import DEFAULTS, ContactTerrainParameters
from stridetwin.streams.algebra import matrices
from stridetwin.streams.algebra.arrays import exp
from stridetwin.streams.algebra.matrices import copy_matrix, dot, multiply, transposed
from stridetwin.streams.algebra.tuples import normalized, quaternion, store_mat3, to_matrix
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Ahrs, Array, Encoder, Insole, Sample

_HERE = Path(__file__).parent
_HOLD_S = 0.06  # a late stream is extrapolated for this long: six samples at 100 Hz
_TOGETHER_S = 0.003  # largest difference of the time stamps of one instant: a third of the period at 100 Hz
# Samples beyond these count as lost: no gyro on a limb has such a range; 32-bit rounding of a quaternion's squared norm
# is far below; several times a running person's weight on one cell.
_MAX_RATE_RADPS, _MAX_NORM_ERROR, _MAX_FORCE_N = 50.0, 0.02, 5000.0
# Hand-chosen on simulated walks of S1-S3, seeds 0-16.
_FULL_MOTION_RADPS = 2.0  # angular rate from which on an AHRS has its error of full motion
_LOST_SD_RAD = math.radians(0.15)  # motion of a limb that one lost sample hides


@dataclass(frozen=True, kw_only=True, eq=False)
class Tick:
    """Samples of all streams at one instant; feet in the order of `SIDES`.

    Attributes:
        t_ns: Time of the instant.
        dt: Time since the last tick, s; 0 for the first one and after a gap that was not bridged.
        R: (5, 3, 3) frame to world, of the back panel (frame 0), the frames on both thighs, and the last frames.
        rate: (5, 3) rad/s of back, thighs and feet in the axes of their frames.
        knee: (2,) rad, angles of the joints that turn the knees' frames.
        force: (2, 4) N on heel, lateral ball, medial ball and toe.
        fresh: (5,) bool, whether the attitude was measured rather than extrapolated.
    """

    t_ns: int
    dt: float
    R: Array
    rate: Array
    knee: Array
    force: Array
    fresh: Array


class TickBuilder:
    """Collects samples of an exoskeleton into ticks.

    Args:
        exo: The exoskeleton, with its streams and sensor mounts.
    """

    def __init__(self, exo: Exoskeleton) -> None:
        """Prepares for the streams that the exoskeleton's geometry names; no sample is known yet."""
        legs = [exo.legs[side] for side in SIDES]
        attitudes = [exo.back, *(leg.thigh for leg in legs), *(leg.foot for leg in legs)]
        # by topic of an AHRS: index of its attitude in `Tick.R`, and (3, 3) rotation from its frame to the sensor
        self._attitude = {a.topic: (i, a.R_frame_sensor.T) for i, a in enumerate(attitudes)}
        # by topic of an encoder: index of the leg, and sign of the knee's angle
        self._encoder = {leg.knee.topic: (i, leg.knee.sign) for i, leg in enumerate(legs)}
        self._insole = {leg.sole.topic: i for i, leg in enumerate(legs)}  # by topic of an insole: index of the foot
        self._last = dict.fromkeys(exo.topics, -1)  # time of each stream's newest sample, ns
        # newest values of all streams, with the layout of `Tick`: attitudes, frame to world, and rates of back, thighs
        # and feet, rad/s; angles of the knees, rad; forces on the cells of both insoles, N
        self._R, self._rate = np.tile(np.eye(3), (5, 1, 1)), np.zeros((5, 3))
        self._knee, self._force = np.zeros(2), np.zeros((2, 4))
        self._open: set[str] = set()  # streams that have delivered their sample of the open tick
        self._now = self._tick_ns = -1  # time of the open tick, and of the last one returned, ns

    def add(self, sample: Sample) -> list[Tick]:
        """Takes one sample; returns the ticks that it completes or closes, at most two.

        A sample of a later instant closes the open tick, although streams are missing, and opens another one. A sample
        of an unknown stream, one that is out of order and an invalid one are ignored.
        """
        if sample.topic not in self._last or sample.t_ns <= self._last[sample.topic] or not _is_valid(sample):
            return []
        ticks: list[Tick] = []
        if self._open and sample.t_ns > self._now + _TOGETHER_S * 1e9:
            ticks += self._complete_tick()
        if not self._open:
            self._now = sample.t_ns
        self._store(sample)
        if len(self._open) == len(self._last):  # every stream has delivered
            ticks += self._complete_tick()
        return ticks

    def _store(self, sample: Sample) -> None:
        """Writes a sample into the newest values, and marks its stream as delivered for the open tick.

        Attitude and rate of an AHRS are converted from the sensor to the frame that carries it, the angle of an encoder
        to that of the joint; a negative force counts as none.
        """
        match sample:
            case Ahrs():
                i, R_sensor_frame = self._attitude[sample.topic]
                self._R[i] = rotation_matrix(sample.q_world_sensor) @ R_sensor_frame
                self._rate[i] = R_sensor_frame.T @ sample.angular_rate
            case Encoder():
                i, sign = self._encoder[sample.topic]
                self._knee[i] = sign * sample.angle
            case Insole():
                self._force[self._insole[sample.topic]] = np.maximum(sample.force, 0.0)
        self._last[sample.topic] = sample.t_ns
        self._open.add(sample.topic)

    def _complete_tick(self) -> list[Tick]:
        """Closes the open tick.

        An attitude whose sample is missing at this instant is extrapolated by its last angular rate.

        Returns:
            The tick in a list; an empty list if a stream is too late, or has not delivered any sample yet.
        """
        self._open, fresh = set(), np.ones(5, dtype=bool)
        oldest = min(self._last.values())  # time of the stream that is latest, ns; -1 if one has delivered nothing
        if oldest < 0 or (self._now - oldest) * 1e-9 > _HOLD_S:
            return []
        R = self._R.copy()
        for topic, (i, _) in self._attitude.items():
            late_s = (self._now - self._last[topic]) * 1e-9
            if late_s > _TOGETHER_S:
                R[i], fresh[i] = R[i] @ exp(late_s * self._rate[i]), False
        dt = (self._now - self._tick_ns) * 1e-9
        if self._tick_ns < 0 or dt > _HOLD_S:  # the first tick, or one after a gap
            dt = 0.0
        self._tick_ns = self._now
        return [
            Tick(
                t_ns=self._now,
                dt=dt,
                R=R,
                rate=self._rate.copy(),
                knee=self._knee.copy(),
                force=self._force.copy(),
                fresh=fresh,
            )
        ]


def _is_valid(sample: Sample) -> bool:
    """Whether a sample is finite, within its sensor's range and of a kind that a tick holds."""
    match sample:
        case Ahrs():
            q, rate = sample.q_world_sensor, sample.angular_rate
            # squared norms, of which comparisons are False for NaN
            return bool(abs(q @ q - 1.0) < _MAX_NORM_ERROR and rate @ rate < _MAX_RATE_RADPS**2)
        case Encoder():
            return abs(sample.angle) < 2 * math.pi
        case Insole():
            return bool(np.abs(sample.force).max() < _MAX_FORCE_N)
    return False


@entry_kernel(_HERE)
def rotation_matrix(q: Array) -> Array:
    """(3, 3) rotation of a quaternion (w, x, y, z) of any length but 0."""
    R = np.empty((3, 3))
    store_mat3(to_matrix(normalized(quaternion(q))), R)
    return R


class _State(NamedTuple):
    """State that compiled code modifies in place.

    Attributes:
        R: (5, 3, 3) attitudes, frame to world.
        last: (5, 3, 3) attitudes at the last fresh sample of each.
        variance: (5,) rad² of these; negative before the first sample.
        rate: (5, 3) rad/s at the last fresh sample of each.
        since: (5,) s since then.
    """

    R: Array
    last: Array
    variance: Array
    rate: Array
    since: Array


class _Noise(NamedTuple):
    """Noise model of the five attitudes: values of `ContactTerrainParameters`, in the form for compiled code.

    Attributes:
        stationary_sd_rad: Standard deviation of an AHRS's tilt at rest, rad.
        moving_sd_rad: Standard deviation of it in full motion, rad.
        correlation_s: Correlation time of the tilt error, s.
        drift_rad_per_sqrt_s: Random walk of an integrated rate, rad/√s.
    """

    stationary_sd_rad: float
    moving_sd_rad: float
    correlation_s: float
    drift_rad_per_sqrt_s: float


class Attitudes:
    """Attitudes of back, thighs and feet.

    Args:
        parameters: Noise of AHRS and gyros.

    Attributes:
        R: (5, 3, 3) frame to world.
    """

    def __init__(self, parameters: ContactTerrainParameters = DEFAULTS) -> None:
        """Begins with unknown attitudes, with the parameters' noise of AHRS and gyros."""
        self._noise = _Noise(
            stationary_sd_rad=parameters.ahrs_stationary_sd_rad,
            moving_sd_rad=parameters.ahrs_moving_sd_rad,
            correlation_s=parameters.ahrs_correlation_s,
            drift_rad_per_sqrt_s=parameters.gyro_drift_rad_per_sqrt_s,
        )
        self.R = np.tile(np.eye(3), (5, 1, 1))
        self._state = _State(
            R=self.R, last=self.R.copy(), variance=np.full(5, -1.0), rate=np.zeros((5, 3)), since=np.zeros(5)
        )

    def update(self, tick: Tick) -> None:
        """Propagates all attitudes to a tick by their rates, and corrects them by the AHRS.

        See docs/contact_terrain.md (6).
        At the start and after a gap, the attitudes are those of the AHRS.
        """
        _fuse(self._state, self._noise, tick.R, tick.rate, tick.fresh, tick.dt)


@entry_kernel(_HERE)
def _fuse(state: _State, noise: _Noise, measured: Array, rate: Array, fresh: Array, dt: float) -> None:
    """Propagates the attitudes by their rates, and corrects them by the AHRS, in place: docs/contact_terrain.md (6).

    Args:
        state: The state, modified in place.
        noise: The noise model.
        measured: (5, 3, 3) attitudes of the AHRS, frame to world.
        rate: (5, 3) rad/s in frame axes.
        fresh: (5,) bool, whether each attitude was measured rather than extrapolated.
        dt: Time since the last tick, s; 0 after a gap: the attitudes are then those of the AHRS.
    """
    R, last, variance, last_rate, since = state
    for i in range(len(R)):
        since[i] += dt
        # a lost sample: the attitude is extrapolated by the last measured rate
        if not fresh[i] and variance[i] >= 0.0 and dt > 0.0:
            copy_matrix(multiply(last[i], matrices.exp(_scale(since[i], last_rate[i]))), R[i])
            variance[i] += _LOST_SD_RAD**2
            continue
        if variance[i] < 0.0 or dt <= 0.0:
            copy_matrix(measured[i], R[i])
            # the first sample is of a wearer at rest, that after a gap of one who may be moving
            variance[i] = noise.stationary_sd_rad**2 if variance[i] < 0.0 else noise.moving_sd_rad**2
        else:
            turn = np.empty(3)  # by the mean of the rates before and after, rad
            for j in range(3):
                turn[j] = 0.5 * since[i] * (last_rate[i, j] + rate[i, j])
            moved = multiply(last[i], matrices.exp(turn))
            variance[i] += noise.drift_rad_per_sqrt_s**2 * since[i]
            # share of full motion, for the standard deviation between rest and full motion
            share = min(math.sqrt(dot(rate[i], rate[i])) / _FULL_MOTION_RADPS, 1.0)
            sd = noise.stationary_sd_rad + (noise.moving_sd_rad - noise.stationary_sd_rad) * share
            # the correlated error of an AHRS counts as a white one of the same power, 2 τ σ² / dt
            gain = variance[i] / (variance[i] + 2.0 * noise.correlation_s / since[i] * sd * sd)
            variance[i] *= 1.0 - gain
            off = matrices.log(multiply(measured[i], transposed(moved)))  # from predicted to measured, rad, world axes
            copy_matrix(multiply(matrices.exp(_scale(gain, off)), moved), R[i])
        copy_matrix(R[i], last[i])  # this fresh sample is the last one from now on
        for j in range(3):
            last_rate[i, j] = rate[i, j]
        since[i] = 0.0


@njit(**INNER_KERNEL)
def _scale(share: float, v: Array) -> Array:
    """(3,) product of a number and a vector."""
    product = np.empty(3)
    for i in range(3):
        product[i] = share * v[i]
    return product
