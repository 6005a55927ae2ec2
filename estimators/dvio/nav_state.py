"""The newest state between images: propagated with each IMU sample, with its covariance."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.dvio.algebra import carried, mul, put, skew
from stridetwin.estimators.dvio.imu_factors import integrate
from stridetwin.estimators.dvio.state import FRAME, ImuNoise, Preintegration
from stridetwin.streams.samples import Array

_FASTEST, _MOST_GYRO_BIAS, _MOST_ACCEL_BIAS = 15.0, 0.5, 3.0  # m/s, rad/s, m/s²


class NavState(NamedTuple):
    """A state and its covariance.

    Attributes:
        t_ns: (1,) on the IMU's clock.
        R: (3, 3) world <- IMU.
        p: (3,) m.
        v: (3,) m/s.
        bias: (6,) rad/s, m/s².
        covariance: (15, 15) in the order of a frame's errors.
    """

    t_ns: NDArray[np.int64]
    R: Array
    p: Array
    v: Array
    bias: Array
    covariance: Array


def blank_nav_state() -> NavState:
    """Stationary at the origin, with zero covariance."""
    return NavState(
        t_ns=np.zeros(1, np.int64), R=np.eye(3), p=np.zeros(3), v=np.zeros(3), bias=np.zeros(6),
        covariance=np.zeros((FRAME, FRAME)),
    )  # fmt: skip


@njit(error_model="numpy", **INSIDE)
def propagate(
    nav: NavState,
    z: Preintegration,
    t_ns: NDArray[np.int64],
    samples: Array,
    invalid: NDArray[np.uint8],
    count: int,
    end_ns: int,
    noise: ImuNoise,
    gravity: float,
) -> None:
    """Propagates a state to `end_ns`.

    Args:
        nav: Changed in place.
        z: Buffer for the increment.
        t_ns: See `integrate`.
        samples: See `integrate`.
        invalid: See `integrate`.
        count: See `integrate`.
        end_ns: Not later than the last sample.
        noise: Of the sensor.
        gravity: m/s².
    """
    integrate(z, t_ns, samples, invalid, count, nav.t_ns[0], end_ns, nav.bias, noise)
    dt = z.dt[0]
    R = nav.R.copy()
    F, G = np.eye(FRAME), np.zeros((9, 9))
    for i in range(3):
        F[i, 6 + i] = dt
        G[3 + i, 3 + i] = 1.0
    put(F, 0, 3, mul(R, skew(z.delta_p)), -1.0)
    put(F, 3, 3, z.delta_R.T, 1.0)
    put(F, 6, 3, mul(R, skew(z.delta_v)), -1.0)
    put(F, 0, 9, mul(R, z.by_bias[0:3]), 1.0)
    put(F, 3, 9, z.by_bias[3:6], 1.0)
    put(F, 6, 9, mul(R, z.by_bias[6:9]), 1.0)
    put(G, 0, 0, R, 1.0)
    put(G, 6, 6, R, 1.0)
    P, Q = carried(F, nav.covariance), carried(G, z.covariance)
    for i in range(FRAME):
        for j in range(FRAME):
            nav.covariance[i, j] = 0.5 * (P[i, j] + P[j, i])
    for i in range(9):
        for j in range(9):
            nav.covariance[i, j] += 0.5 * (Q[i, j] + Q[j, i])
    for i in range(3):
        nav.covariance[9 + i, 9 + i] += noise.rate_walk**2 * dt
        nav.covariance[12 + i, 12 + i] += noise.force_walk**2 * dt
    for i in range(3):
        nav.p[i] += nav.v[i] * dt
        for j in range(3):
            nav.p[i] += R[i, j] * z.delta_p[j]
            nav.v[i] += R[i, j] * z.delta_v[j]
    nav.p[2] -= 0.5 * gravity * dt * dt
    nav.v[2] -= gravity * dt
    put(nav.R, 0, 0, mul(R, z.delta_R), 1.0)
    nav.t_ns[0] = end_ns


@njit(error_model="numpy", **INSIDE)
def plausible(nav: NavState) -> bool:
    """Whether a state is physically possible for a person."""
    total = nav.p.sum() + nav.bias.sum() + nav.R.sum() + nav.covariance.sum()
    fast = nav.v[0] ** 2 + nav.v[1] ** 2 + nav.v[2] ** 2
    if not (math.isfinite(total) and fast < _FASTEST**2):
        return False
    return bool(np.abs(nav.bias[:3]).max() < _MOST_GYRO_BIAS and np.abs(nav.bias[3:]).max() < _MOST_ACCEL_BIAS)


@njit(error_model="numpy", **INSIDE)
def pose_and_covariance(nav: NavState) -> tuple[Array, Array]:
    """(4, 4) world <- IMU, and (6, 6) covariance of its position (m) and rotation (rad), both in world axes."""
    T, to_world = np.zeros((4, 4)), np.zeros((6, 6))
    put(T, 0, 0, nav.R, 1.0)
    put(to_world, 3, 3, nav.R, 1.0)
    T[3, 3] = 1.0
    for i in range(3):
        T[i, 3] = nav.p[i]
        to_world[i, i] = 1.0
    return T, carried(to_world, nav.covariance[:6, :6])
