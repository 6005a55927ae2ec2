"""What a standing foot tells: a point below the sensor has no velocity; at rest, the gyro shows its bias."""

from __future__ import annotations

import numpy as np
from numba import njit

from stridetwin.estimators.foot_ins.algebra import exponential, product, rotation_matrix
from stridetwin.estimators.foot_ins.covariance import correct
from stridetwin.estimators.foot_ins.memory import (
    ACCEL_BIAS,
    ATTITUDE,
    D_ACCEL_BIAS,
    D_ATTITUDE,
    D_GYRO_BIAS,
    D_POSITION,
    D_VELOCITY,
    GYRO_BIAS,
    POSITION,
    STATES,
    VELOCITY,
    Memory,
)
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.streams.samples import Array


@njit(cache=True)
def zero_velocity(
    memory: Memory, parameters: KernelParameters, rate: Array, dt: float, standing_speed: float
) -> None:
    """Update with v + R ((ω - b_g) × r) = 0, r the lever arm (Foxlin 2005, moved to the sole).

    The foot's true speed in stance is no white noise: within `still_correlation_s` all updates share one
    error, so each sample brings dt / still_correlation_s of an update, whatever the rate of the samples.
    """
    x, r = memory.nominal, memory.lever
    R = rotation_matrix(x[ATTITUDE : ATTITUDE + 4])
    wx, wy, wz = rate[0] - x[GYRO_BIAS], rate[1] - x[GYRO_BIAS + 1], rate[2] - x[GYRO_BIAS + 2]
    u = R @ np.array([wy * r[2] - wz * r[1], wz * r[0] - wx * r[2], wx * r[1] - wy * r[0]])
    on_attitude = np.array([[0.0, u[2], -u[1]], [-u[2], 0.0, u[0]], [u[1], -u[0], 0.0]])
    on_bias = R @ np.array([[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]])
    variance = standing_speed**2 * max(1.0, parameters.still_correlation_s / dt)
    error, h = np.zeros(STATES), np.zeros(STATES)
    for i in range(3):
        h[D_VELOCITY : D_VELOCITY + 3] = 0.0
        h[D_VELOCITY + i] = 1.0
        h[D_ATTITUDE : D_ATTITUDE + 3] = on_attitude[i]
        h[D_GYRO_BIAS : D_GYRO_BIAS + 3] = on_bias[i]
        correct(memory.covariance, error, h, -x[VELOCITY + i] - u[i], variance)
    inject(memory, error)


@njit(cache=True)
def zero_rate(memory: Memory, parameters: KernelParameters, rate: Array, dt: float) -> None:
    """Update with ω = b_g: a foot that has long been quiet does not turn."""
    error, h = np.zeros(STATES), np.zeros(STATES)
    for i in range(3):
        h[:] = 0.0
        h[D_GYRO_BIAS + i] = 1.0
        innovation = rate[i] - memory.nominal[GYRO_BIAS + i]
        correct(memory.covariance, error, h, innovation, parameters.rest_rate_noise**2 / dt)
    inject(memory, error)


@njit(cache=True)
def inject(memory: Memory, error: Array) -> None:
    """Moves the error (15,) into the nominal state, in place."""
    x = memory.nominal
    for i in range(3):
        x[POSITION + i] += error[D_POSITION + i]
        x[VELOCITY + i] += error[D_VELOCITY + i]
        x[GYRO_BIAS + i] += error[D_GYRO_BIAS + i]
        x[ACCEL_BIAS + i] += error[D_ACCEL_BIAS + i]
    turn = exponential(error[D_ATTITUDE], error[D_ATTITUDE + 1], error[D_ATTITUDE + 2])
    x[ATTITUDE : ATTITUDE + 4] = product(turn, x[ATTITUDE : ATTITUDE + 4])
