"""The newest valid IMU samples, and the state between images that is propagated with each, with its covariance."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.dvio.parameters import DvioParameters
from stridetwin.estimators.dvio.state import FRAME, Frames, ImuNoise, ImuSamples, Preintegration
from stridetwin.streams.algebra.matrices import copy_matrix, empty_mat3, hat, identity, multiply, transform_covariance
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.rig import ImuCalibration
from stridetwin.streams.samples import Array, Imu

# Hand-chosen on tuning seeds.
STATIONARY_S = 0.25
"""Time without motion after which the sensor is stationary."""
_MIN_COMPLETE_SHARE = 0.7  # of the samples that must be there to detect that
_BUFFER_S = 6.0  # longer than a start in motion, or than a gap in vision followed by a late image
_SATURATED_SHARE = 0.995  # of the range; a larger value is saturated
_MAX_RATE_RADPS, _MAX_FORCE_MPS2 = 100.0, 1000.0  # larger values are ignored: no head moves so
_MAX_PERIODS = 1.7  # of the nominal rate between two samples; after a longer time one is missing
# A person's motion and a consumer IMU have no more; beyond that the odometry has failed.
_MAX_SPEED_MPS, _MAX_GYRO_BIAS_RADPS, _MAX_ACCEL_BIAS_MPS2 = 15.0, 0.5, 3.0


class NavState(NamedTuple):
    """A state and its covariance.

    Attributes:
        t_ns: (1,) time of the state on the IMU's clock.
        R: (3, 3) world <- IMU.
        p: (3,) IMU in the world, m.
        v: (3,) velocity in the world, m/s.
        bias: (6,) of gyroscope (rad/s) and accelerometer (m/s²).
        covariance: (15, 15) of the errors: 0-2 position, 3-5 attitude (on its right), 6-8 velocity, 9-14 biases.
    """

    t_ns: NDArray[np.int64]
    R: Array
    p: Array
    v: Array
    bias: Array
    covariance: Array


def copy_of(nav: NavState) -> NavState:
    """A copy of a state that shares no array with it."""
    return NavState._make(a.copy() for a in nav)


def state_of(frames: Frames, k: int) -> NavState:
    """A copy of the state of the frame in slot k, with zero covariance."""
    return NavState(
        t_ns=frames.t_ns[k : k + 1].copy(),
        R=frames.R[k].copy(),
        p=frames.p[k].copy(),
        v=frames.v[k].copy(),
        bias=frames.bias[k].copy(),
        covariance=np.zeros((FRAME, FRAME)),
    )


def blank_nav_state() -> NavState:
    """State of an IMU at rest at the origin, without biases, with zero covariance."""
    return NavState(
        t_ns=np.zeros(1, np.int64),
        R=np.eye(3),
        p=np.zeros(3),
        v=np.zeros(3),
        bias=np.zeros(6),
        covariance=np.zeros((FRAME, FRAME)),
    )


@njit(error_model="numpy", **INNER_KERNEL)
def add_increment(nav: NavState, z: Preintegration, noise: ImuNoise, gravity: float) -> None:
    """Propagates a state and its covariance by a preintegrated measurement; its time is not changed.

    p += v t + g t²/2 + R Δp, v += g t + R Δv, R <- R ΔR, and P <- F P Fᵀ + G Σ Gᵀ + random walk of the biases. F (15,
    15) is the derivative by the state's errors (position, attitude, velocity, two biases), and G (9, 9) that by the
    errors of the measurement (position, rotation, velocity).

    Args:
        nav: The state, changed in place.
        z: Preintegrated measurement from the state's time on, with its covariance Σ.
        noise: Gives the random walk of the biases.
        gravity: Size of gravity, m/s²; it acts along the world's negative z axis.
    """
    dt, delta_R, delta_p, delta_v, by_bias = z.dt[0], z.delta_R, z.delta_p, z.delta_v, z.by_bias
    R, p, v, covariance = empty_mat3(), nav.p, nav.v, nav.covariance
    copy_matrix(nav.R, R)
    # derivatives of position and velocity by the attitude's error (with the opposite sign), and by the biases
    p_by_turn, v_by_turn = multiply(R, hat(delta_p)), multiply(R, hat(delta_v))
    p_by_bias, v_by_bias = multiply(R, by_bias[0:3]), multiply(R, by_bias[6:9])
    # Rows and columns of F: 0-2 position, 3-5 attitude, 6-8 velocity, 9-11 and 12-14 biases of gyroscope and
    # accelerometer. Rows of `by_bias`: 0-2 position, 3-5 rotation, 6-8 velocity.
    F, G = identity(FRAME), np.zeros((9, 9))
    for i in range(3):
        F[i, 6 + i] = dt
        G[3 + i, 3 + i] = 1.0
        for j in range(3):
            F[i, 3 + j] = -p_by_turn[i, j]
            F[3 + i, 3 + j] = delta_R[j, i]
            F[6 + i, 3 + j] = -v_by_turn[i, j]
            G[i, j] = R[i, j]
            G[6 + i, 6 + j] = R[i, j]
        for j in range(6):
            F[i, 9 + j] = p_by_bias[i, j]
            F[3 + i, 9 + j] = by_bias[3 + i, j]
            F[6 + i, 9 + j] = v_by_bias[i, j]
    P, Q = transform_covariance(F, covariance), transform_covariance(G, z.covariance)
    for i in range(FRAME):  # P <- F P Fᵀ, exactly symmetric
        for j in range(FRAME):
            covariance[i, j] = 0.5 * (P[i, j] + P[j, i])
    for i in range(9):  # + G Σ Gᵀ
        for j in range(9):
            covariance[i, j] += 0.5 * (Q[i, j] + Q[j, i])
    for i in range(3):
        covariance[9 + i, 9 + i] += noise.rate_walk**2 * dt
        covariance[12 + i, 12 + i] += noise.force_walk**2 * dt
    for i in range(3):
        p[i] += v[i] * dt
        for j in range(3):
            p[i] += R[i, j] * delta_p[j]
            v[i] += R[i, j] * delta_v[j]
    p[2] -= 0.5 * gravity * dt * dt  # gravity acts along -z only
    v[2] -= gravity * dt
    copy_matrix(multiply(R, delta_R), nav.R)


@njit(error_model="numpy", **INNER_KERNEL)
def is_plausible(nav: NavState) -> bool:
    """Whether a state is finite, and its speed and biases are possible for a person with a consumer IMU."""
    # The sum of all entries is finite only if each is.
    # squared speed; largest entry of each bias
    total, speed2, gyro_bias, accel_bias = 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        total += nav.p[i] + nav.R[i, 0] + nav.R[i, 1] + nav.R[i, 2]
        speed2 += nav.v[i] ** 2
        gyro_bias, accel_bias = max(gyro_bias, abs(nav.bias[i])), max(accel_bias, abs(nav.bias[3 + i]))
        total += nav.bias[i] + nav.bias[3 + i]
    for i in range(FRAME):
        for j in range(FRAME):
            total += nav.covariance[i, j]
    if not (math.isfinite(total) and speed2 < _MAX_SPEED_MPS**2):
        return False
    return gyro_bias < _MAX_GYRO_BIAS_RADPS and accel_bias < _MAX_ACCEL_BIAS_MPS2


@njit(error_model="numpy", **INNER_KERNEL)
def pose_covariance(nav: NavState) -> Array:
    """(6, 6) covariance of position (m) and rotation (rad), both in world axes.

    The state's own attitude error is about the IMU's axes, so its rows are rotated by R.
    """
    to_world, P = identity(6), np.empty((6, 6))
    for i in range(3):
        for j in range(3):
            to_world[3 + i, 3 + j] = nav.R[i, j]
    for i in range(6):
        for j in range(6):
            P[i, j] = nav.covariance[i, j]
    return transform_covariance(to_world, P)


class ImuBuffer:
    """Buffer of IMU samples in time order.

    A sample that is not finite, out of range or not later than the last one is rejected. A sample is invalid if it is
    saturated, or if it follows missing samples (it then replaces them, as the mean with the previous one). Samples of
    the last 6 s are kept, at the nominal rate.

    Args:
        calibration: Rate and ranges.
        parameters: Limits of a stationary sensor.

    Attributes:
        t_ns: (M,) stamps; in all arrays only the first `count` entries are in use.
        samples: (M, 6) angular rate (rad/s) and specific force (m/s²).
        invalid: (M,) 1 where a sample is invalid.
        count: Number of samples in the buffer.
        period_s: Nominal time between two samples.
        force_scale: Estimated ratio of measured to true force, by which the stored forces are divided already.
    """

    def __init__(self, calibration: ImuCalibration, parameters: DvioParameters) -> None:
        """Begins empty; `calibration` gives rate and ranges, `parameters` the limits of a stationary sensor."""
        self._max_stationary = parameters.stationary_rate_sd_radps, parameters.stationary_force_sd_mps2
        # Samples that are always kept, half of the buffer: when it is full, its newer half moves to the front.
        self._half = math.ceil(_BUFFER_S * calibration.rate_hz) + 1
        self.t_ns = np.zeros(2 * self._half, np.int64)
        self.samples = np.zeros((2 * self._half, 6))
        self.invalid = np.zeros(2 * self._half, np.uint8)
        self.count = 0
        self.period_s = 1.0 / calibration.rate_hz
        self.force_scale = 1.0
        ranges = (calibration.gyroscope_range or np.inf, calibration.accelerometer_range or np.inf)
        # (6,) beyond the first a value counts as saturated, beyond the second the sample is rejected
        self._limit = np.repeat(ranges, 3) * _SATURATED_SHARE
        self._largest = np.repeat([_MAX_RATE_RADPS, _MAX_FORCE_MPS2], 3)

    def add(self, sample: Imu) -> bool:
        """Adds a sample; returns False if the sample is rejected.

        Rejected is one that is not later than the last, not finite, or impossibly large. A sample after missing ones is
        stored as the mean of itself and the previous one, marked invalid; a saturated one is marked invalid, too.
        """
        if self.count and sample.t_ns <= self.t_ns[self.count - 1]:
            return False
        x = np.empty(6)
        x[:3], x[3:] = sample.angular_rate, sample.specific_force
        size = np.abs(x)
        if not (size <= self._largest).all():  # also where a value is NaN
            return False
        x[3:] /= self.force_scale
        half = self._half
        # a full buffer drops its older half: the newer half moves to the front
        if self.count == 2 * half:
            for a in (self.t_ns, self.samples, self.invalid):
                a[:half] = a[half:].copy()
            self.count = half
        i = self.count  # row of this sample
        missing = i > 0 and (sample.t_ns - self.t_ns[i - 1]) * 1e-9 > _MAX_PERIODS * self.period_s
        self.t_ns[i] = sample.t_ns
        self.samples[i] = 0.5 * (x + self.samples[i - 1]) if missing else x
        self.invalid[i] = missing or bool((size >= self._limit).any())
        self.count += 1
        return True

    def rescale_forces(self, factor: float) -> None:
        """Multiplies `force_scale` by a factor, and corrects the forces of the stored samples."""
        self.force_scale *= factor
        self.samples[: self.count, 3:] /= factor

    @property
    def imu_samples(self) -> ImuSamples:
        """The samples as views of the buffer, without a copy."""
        n = self.count
        return ImuSamples(self.t_ns[:n], self.samples[:n], self.invalid[:n])

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest sample."""
        return int(self.t_ns[self.count - 1])

    @property
    def oldest_retained_ns(self) -> int:
        """Stamp of the oldest sample that is still in the buffer after the next one is added."""
        return int(self.t_ns[max(self.count - self._half, 0)])

    def gap_s(self) -> float:
        """Time between the two newest samples, s; 0 while there is at most one."""
        return (self.newest_ns - int(self.t_ns[self.count - 2])) * 1e-9 if self.count > 1 else 0.0

    def rate_at(self, t_ns: int) -> Array:
        """(3,) measured angular rate at a time, rad/s, interpolated between the middles of the samples' intervals."""
        i = int(np.searchsorted(self.t_ns[: self.count], t_ns))
        i = min(max(i, 1), self.count - 1)  # the time lies between samples i - 1 and i
        share = (t_ns - self.t_ns[i - 1]) / (self.t_ns[i] - self.t_ns[i - 1])
        # A sample is the mean over the period that ends with it, so sample i holds at share 0.5; j is the next nearest.
        j = min(i + 1, self.count - 1) if share > 0.5 else max(i - 1, 0)
        weight = abs(share - 0.5)
        return np.asarray((1 - weight) * self.samples[i, :3] + weight * self.samples[j, :3])

    def since(self, t_ns: int, until_ns: int) -> Array:
        """(N, 6) rate (rad/s) and force (m/s²) of the samples within (t_ns, until_ns]."""
        i, j = np.searchsorted(self.t_ns[: self.count], [t_ns, until_ns], side="right")
        return self.samples[i:j]

    def covers(self, t_ns: int) -> bool:
        """Whether the buffer holds all samples from a time on."""
        return self.count > 0 and int(self.t_ns[0]) <= t_ns

    def is_stationary(self, until_ns: int) -> bool:
        """Whether the sensor was stationary in the `STATIONARY_S` before a time.

        It was if the standard deviations of rate and force over that time are below the parameters' limits. False if
        the buffer does not cover that time or samples are missing.
        """
        start = until_ns - round(STATIONARY_S * 1e9)
        if not self.covers(start):
            return False
        x = self.since(start, until_ns)
        # samples are missing if there are too few for this time at the nominal rate
        if len(x) < _MIN_COMPLETE_SHARE * STATIONARY_S / self.period_s:
            return False
        spread, (max_rate, max_force) = x.std(axis=0), self._max_stationary
        return bool(spread[:3].max() < max_rate and spread[3:].max() < max_force)
