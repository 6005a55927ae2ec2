"""Strapdown navigation over one sample, and its error-state covariance, a block inside a matrix of any size."""

from __future__ import annotations

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.state import (
    ACCEL_BIAS,
    ATTITUDE,
    D_ACCEL_BIAS,
    D_ATTITUDE,
    D_GYRO_BIAS,
    D_POSITION,
    D_VELOCITY,
    FILL,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    Memory,
    ring_row,
)
from stridetwin.estimators.so3 import product, quat_exp, rotation_matrix
from stridetwin.streams.samples import Array


@njit(**INSIDE)
def propagate_covariance(P: Array, o: int, R: Array, f_world: Array, dt: float) -> None:
    """P <- F P Fᵀ in place, for the foot whose 15 error states begin at row `o`.

    See docs/foot_ins.md (4). F is the strapdown error model of Titterton & Weston 2004, ch. 12, over `dt` (s), without
    Earth rotation, at an attitude R (world <- sensor) and a specific force in the world, m/s².
    """
    _transition(P, o, R, f_world, dt)
    _transition(P.T, o, R, f_world, dt)


@njit(**INSIDE)
def _transition(M: Array, o: int, R: Array, f_world: Array, dt: float) -> None:
    """M <- F M in place; only the foot's own rows change."""
    p, v, a = o + D_POSITION, o + D_VELOCITY, o + D_ATTITUDE
    g, b = o + D_GYRO_BIAS, o + D_ACCEL_BIAS
    fx, fy, fz = f_world[0] * dt, f_world[1] * dt, f_world[2] * dt
    D = R * dt
    for j in range(M.shape[1]):
        a0, a1, a2 = M[a, j], M[a + 1, j], M[a + 2, j]
        g0, g1, g2 = M[g, j], M[g + 1, j], M[g + 2, j]
        b0, b1, b2 = M[b, j], M[b + 1, j], M[b + 2, j]
        for i in range(3):
            M[p + i, j] += 0.5 * dt * M[v + i, j]
            M[a + i, j] -= D[i, 0] * g0 + D[i, 1] * g1 + D[i, 2] * g2
        M[v, j] += fz * a1 - fy * a2 - D[0, 0] * b0 - D[0, 1] * b1 - D[0, 2] * b2
        M[v + 1, j] += fx * a2 - fz * a0 - D[1, 0] * b0 - D[1, 1] * b1 - D[1, 2] * b2
        M[v + 2, j] += fy * a0 - fx * a1 - D[2, 0] * b0 - D[2, 1] * b1 - D[2, 2] * b2
        for i in range(3):
            M[p + i, j] += 0.5 * dt * M[v + i, j]


@njit(**INSIDE)
def shift(P: Array, o: int, dp: Array, dv: Array) -> None:
    """Covariance of the error seen from a state corrected by `dp` (m) and `dv` (m/s), in place.

    See docs/foot_ins.md (12).

    A rotation of the whole world about the vertical z is unobservable; in the error it is (z × p, z × v, z) at
    position, velocity and attitude. Where a correction moves p and v, this direction must move along; otherwise the
    filter takes the difference for a heading measurement, which adds up to false certainty. This is the invariant
    filter of Barrau & Bonnabel 2017 (IEEE TAC 62:1797) in the coordinates of the plain one.
    """
    shift_rows(P, o, dp, dv)
    shift_rows(P.T, o, dp, dv)


@njit(**INSIDE)
def shift_rows(M: Array, o: int, dp: Array, dv: Array) -> None:
    """M <- T M in place, δp + δθ × dp and δv + δθ × dv; see `shift`."""
    p, v, a = o + D_POSITION, o + D_VELOCITY, o + D_ATTITUDE
    for j in range(M.shape[1]):
        x, y, z = M[a, j], M[a + 1, j], M[a + 2, j]
        M[p, j] += y * dp[2] - z * dp[1]
        M[p + 1, j] += z * dp[0] - x * dp[2]
        M[p + 2, j] += x * dp[1] - y * dp[0]
        M[v, j] += y * dv[2] - z * dv[1]
        M[v + 1, j] += z * dv[0] - x * dv[2]
        M[v + 2, j] += x * dv[1] - y * dv[0]


@njit(**INSIDE)
def correct(P: Array, dx: Array, o: int, h: Array, z: float, r: float) -> None:
    """Scalar Kalman update of `P` (n, n) and of the accumulated error `dx` (n,), in place.

    `h` (m,) is the measurement's Jacobian by the m states from row `o` on, `z` the measurement minus its prediction
    from the nominal state, and `r` its variance.
    """
    n = P.shape[0]
    Ph = np.zeros(n)
    for j in range(len(h)):
        if h[j] != 0.0:
            z -= h[j] * dx[o + j]
            for i in range(n):
                Ph[i] += P[o + j, i] * h[j]
    s = r
    for j in range(len(h)):
        s += h[j] * Ph[o + j]
    for i in range(n):
        k = Ph[i] / s
        dx[i] += k * z
        for j in range(i, n):
            P[i, j] -= k * Ph[j]
            P[j, i] = P[i, j]


@njit(**INSIDE)
def force_at_middle(f: Array, x: float, y: float, z: float) -> Array:
    """(3,) force at the middle of a rotation by (x, y, z) rad with the velocity change of the constant `f` over it.

    The velocity changes by Γ₁(φ) f dt, Γ₁ the left Jacobian of SO(3), which is Exp(φ/2) (1 + [φ]x²/24) to the second
    order (Barfoot 2017, ch. 7).
    """
    along = (x * f[0] + y * f[1] + z * f[2]) / 24.0
    less = 1.0 - (x * x + y * y + z * z) / 24.0
    return np.array([less * f[0] + along * x, less * f[1] + along * y, less * f[2] + along * z])


@njit(**INSIDE)
def propagate_state(x: Array, rate: Array, force: Array, dt: float, gravity: float) -> tuple[Array, Array]:
    """Propagates a nominal state (20,) over one interval, in place; a negative `dt` exactly reverses it.

    See docs/foot_ins.md (2), (3).

    Returns:
        (3, 3) attitude at the interval's middle, world <- sensor, and (3,) specific force in the world, m/s².
    """
    wx, wy, wz = rate[0] - x[GYRO_BIAS], rate[1] - x[GYRO_BIAS + 1], rate[2] - x[GYRO_BIAS + 2]
    half = quat_exp(0.5 * dt * wx, 0.5 * dt * wy, 0.5 * dt * wz)
    q_middle = product(x[ATTITUDE : ATTITUDE + 4], half)
    R = rotation_matrix(q_middle)
    force_in_world = R @ force_at_middle(force - x[ACCEL_BIAS : ACCEL_BIAS + 3], dt * wx, dt * wy, dt * wz)
    for i in range(3):
        a = force_in_world[i] - (gravity if i == 2 else 0.0)
        x[POSITION + i] += dt * (x[VELOCITY + i] + 0.5 * dt * a)
        x[VELOCITY + i] += dt * a
    x[ATTITUDE : ATTITUDE + 4] = product(q_middle, half)
    return R, force_in_world


@njit(**INSIDE)
def predict(memory: Memory, parameters: KernelParameters, rate: Array, force: Array, dt: float) -> None:
    """Propagates state and covariance over the interval of length `dt` (s) that the sample is the mean of.

    See docs/foot_ins.md (5).

    The force acts at the attitude of the interval's middle (Titterton & Weston 2004, ch. 11). Scale, alignment and
    sampling errors are white noise that grows with the motion; an axis at its limit has an unknown excess. In an
    interval longer than `max_step_s` samples are missing.
    """
    x, P = memory.nominal, memory.covariance
    R, force_in_world = propagate_state(x, rate, force, dt, parameters.gravity_mps2)
    acceleration2 = force_in_world[0] ** 2 + force_in_world[1] ** 2 + (force_in_world[2] - parameters.gravity_mps2) ** 2
    o = memory.row
    propagate_covariance(P, o, R, force_in_world, dt)
    attitude_noise = parameters.gyro_noise_radps_rthz**2
    velocity_noise = parameters.accel_noise_mps2_rthz**2 + parameters.accel_motion_noise_per_rthz**2 * acceleration2
    if memory.clock[FILL] > 1:
        before = memory.ring[ring_row(memory, 1)]
        jerk2 = 0.0
        for i in range(3):
            jerk2 += ((force[i] - before[3 + i]) / dt) ** 2
        velocity_noise += parameters.accel_jerk_noise_s_rthz**2 * jerk2
    if dt > parameters.max_step_s:
        attitude_noise += parameters.gap_gyro_noise_radps_rthz**2
        velocity_noise += parameters.gap_accel_noise_mps2_rthz**2
    for i in range(3):
        P[o + D_ATTITUDE + i, o + D_ATTITUDE + i] += attitude_noise * dt
        P[o + D_VELOCITY + i, o + D_VELOCITY + i] += velocity_noise * dt
        P[o + D_GYRO_BIAS + i, o + D_GYRO_BIAS + i] += parameters.gyro_bias_walk_radps2_rthz**2 * dt
        P[o + D_ACCEL_BIAS + i, o + D_ACCEL_BIAS + i] += parameters.accel_bias_walk_mps3_rthz**2 * dt
    for i in range(3):
        if _at_limit(
            memory.extreme, i, rate[i], parameters.gyro_range_radps, parameters.gyro_range_min_radps, parameters
        ):
            _add_along(P, o + D_ATTITUDE, R, i, parameters.gyro_limit_noise_radps_rthz**2 * dt)
        if _at_limit(
            memory.extreme, 3 + i, force[i], parameters.accel_range_mps2, parameters.accel_range_min_mps2, parameters
        ):
            _add_along(P, o + D_VELOCITY, R, i, parameters.accel_limit_noise_mps2_rthz**2 * dt)


@njit(**INSIDE)
def _at_limit(
    extreme: Array, channel: int, value: float, known: float, least: float, parameters: KernelParameters
) -> bool:
    """Whether a channel may be limited: near its range or, where unknown, near the largest value so far.

    A limited channel returns to the same extreme in every stride. An unlimited one rarely reaches its largest value, so
    little is lost by down-weighting it there.
    """
    size = abs(value)
    if known > 0.0:
        return size >= parameters.limit_share * known
    extreme[channel] = max(extreme[channel], least, size)
    return size >= parameters.limit_share * extreme[channel]


@njit(**INSIDE)
def _add_along(P: Array, row: int, R: Array, axis: int, variance: float) -> None:
    """Adds variance along one axis of the sensor to the 3×3 block of `P` at `row`, in place."""
    for i in range(3):
        for j in range(3):
            P[row + i, row + j] += variance * R[i, axis] * R[j, axis]
