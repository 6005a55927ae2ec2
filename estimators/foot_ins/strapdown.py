"""Inertial navigation over one sample, and how its uncertainty grows."""

from __future__ import annotations

from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.foot_ins.algebra import exponential, force_at_middle, product, rotation_matrix
from stridetwin.estimators.foot_ins.covariance import propagate
from stridetwin.estimators.foot_ins.memory import (
    ACCEL_BIAS,
    ATTITUDE,
    D_ACCEL_BIAS,
    D_ATTITUDE,
    D_GYRO_BIAS,
    D_VELOCITY,
    FILL,
    GYRO_BIAS,
    HEAD,
    POSITION,
    RING,
    VELOCITY,
    Memory,
)
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.streams.samples import Array


@njit(**INSIDE)
def carry(x: Array, rate: Array, force: Array, dt: float, gravity: float) -> tuple[Array, Array]:
    """Moves a nominal state over one interval, in place; with a negative `dt` exactly back.

    See docs/foot_ins.md (2), (3).

    Args:
        x: (20,) see `memory`.
        rate: (3,) rad/s, sensor frame.
        force: (3,) m/s², sensor frame.
        dt: s.
        gravity: m/s².

    Returns:
        (3, 3) attitude at the interval's middle, world <- sensor, and (3,) specific force in the world, m/s².
    """
    wx, wy, wz = rate[0] - x[GYRO_BIAS], rate[1] - x[GYRO_BIAS + 1], rate[2] - x[GYRO_BIAS + 2]
    half = exponential(0.5 * dt * wx, 0.5 * dt * wy, 0.5 * dt * wz)
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
    """Moves state and covariance over the interval of length `dt` (s) that the sample is the mean of.

    See docs/foot_ins.md (5).

    The force acts at the attitude of the interval's middle (Titterton & Weston 2004, ch. 11). What scale,
    alignment and sampling errors do is white noise that grows with the motion; an axis at its limit hides an
    unknown excess.

    Args:
        memory: Changed in place.
        parameters: Noise.
        rate: (3,) rad/s, sensor frame.
        force: (3,) m/s², sensor frame.
        dt: s; longer than `max_step_s` means that samples are missing.
    """
    x, P = memory.nominal, memory.covariance
    R, force_in_world = carry(x, rate, force, dt, parameters.gravity_mps2)
    acceleration2 = force_in_world[0] ** 2 + force_in_world[1] ** 2 + (force_in_world[2] - parameters.gravity_mps2) ** 2
    o = memory.row
    propagate(P, o, R, force_in_world, dt)
    attitude_noise = parameters.gyro_noise_radps_rthz**2
    velocity_noise = parameters.accel_noise_mps2_rthz**2 + parameters.accel_motion_noise_per_rthz**2 * acceleration2
    if memory.clock[FILL] > 1:
        before = memory.ring[(memory.clock[HEAD] - 1) % RING]
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

    A limited channel comes back to the same extreme stride after stride; one that is not reaches its largest
    value seldom, so that little is lost by mistrusting it there.
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
