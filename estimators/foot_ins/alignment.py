"""Initial alignment: the vertical from the first stationary window or, without one, from the mean force."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.stance import across_sole
from stridetwin.estimators.foot_ins.state import (
    ALIGNING,
    ATTITUDE,
    D_ACCEL_BIAS,
    D_ATTITUDE,
    D_CONTACT,
    D_GYRO_BIAS,
    D_POSITION,
    D_VELOCITY,
    FILL,
    HEADED,
    LANDED,
    LEVERED,
    NEVER_LANDED,
    PHASE,
    STATES,
    T_ALIGN,
    T_KNOWN,
    T_LAST,
    T_STATIONARY,
    T_STOOD,
    TRACKING,
    VELOCITY,
    Memory,
)
from stridetwin.estimators.so3 import product, quat_exp, rotation_matrix
from stridetwin.streams.samples import Array


@njit(**INSIDE)
def begin(memory: Memory, t_ns: int) -> None:
    """Starts the search for a stationary window at the sample of time `t_ns`; clears what came before."""
    memory.clock[PHASE] = ALIGNING
    memory.clock[T_ALIGN] = t_ns
    memory.clock[T_STATIONARY] = t_ns
    memory.clock[FILL] = 0
    memory.clock[LANDED] = NEVER_LANDED
    memory.clock[T_STOOD] = t_ns
    memory.force_sum[:] = 0.0
    memory.nominal[VELOCITY : VELOCITY + 3] = 0.0
    memory.tilted[:] = memory.nominal[ATTITUDE : ATTITUDE + 4]


@njit(**INSIDE)
def align(memory: Memory, parameters: KernelParameters, t_ns: int, force: Array, statistic: float) -> None:
    """Takes one sample into the alignment; ends it once the foot was stationary for `align_s`, or late."""
    clock, force_sum = memory.clock, memory.force_sum
    if statistic > parameters.stationary_level:
        clock[T_STATIONARY] = t_ns
        force_sum[0] = 0.0
    for i in range(2):
        force_sum[i, :3] += force
        force_sum[i, 3] += 1.0
    stationary = (t_ns - clock[T_STATIONARY]) * 1e-9 >= parameters.align_s
    late = (t_ns - clock[T_ALIGN]) * 1e-9 >= parameters.align_timeout_s
    level(memory, force_sum[0] if stationary or not late else force_sum[1])
    tilt_sd = parameters.tilt_sd_rad if stationary else parameters.moving_tilt_sd_rad
    speed_sd = parameters.aligned_speed_mps if stationary else parameters.moving_speed_mps
    _set_covariance(memory, parameters, t_ns, tilt_sd, speed_sd)
    if stationary or late:
        clock[PHASE] = TRACKING
        clock[HEADED] = 1
        if clock[LEVERED] == 0:
            clock[LEVERED] = 1
            memory.lever[:] = -parameters.lever_arm_m * rotation_matrix(memory.nominal[ATTITUDE : ATTITUDE + 4])[2]
            o = memory.row + D_CONTACT
            memory.covariance[o : o + 3, o : o + 3] = across_sole(memory, parameters.contact_sd_m**2)


@njit(**INSIDE)
def level(memory: Memory, force_sum: Array) -> None:
    """Rotates the initial attitude the shortest way until the mean force points up; an unknown heading becomes 0.

    Successive shortest rotations, as the mean settles, would rotate the heading.

    The heading is that of the sensor's x axis, or of its z axis if x is within 25° of the vertical.
    """
    q = memory.tilted.copy()
    up = rotation_matrix(q) @ force_sum[:3]
    size = math.sqrt(up[0] ** 2 + up[1] ** 2 + up[2] ** 2)
    if size > 0.0:
        up /= size
        if up[2] > -0.999999:
            q = product(np.array([1.0 + up[2], up[1], -up[0], 0.0]), q)
        else:
            q = product(np.array([0.0, 1.0, 0.0, 0.0]), q)
    if memory.clock[HEADED] == 0:
        R = rotation_matrix(q)
        axis = 0 if abs(R[2, 0]) < 0.9 else 2
        q = product(quat_exp(0.0, 0.0, -math.atan2(R[1, axis], R[0, axis])), q)
    memory.nominal[ATTITUDE : ATTITUDE + 4] = q


@njit(**INSIDE)
def _set_covariance(memory: Memory, parameters: KernelParameters, t_ns: int, tilt_sd: float, speed_sd: float) -> None:
    """Covariance of an alignment: the variances of position, heading and biases are kept."""
    P, clock, o = memory.covariance, memory.clock, memory.row
    variance = np.zeros(STATES)
    if clock[LEVERED] == 0:
        variance[D_POSITION : D_POSITION + 3] = memory.start_sd[0] ** 2
        variance[D_ATTITUDE + 2] = memory.start_sd[1] ** 2
        variance[D_GYRO_BIAS : D_GYRO_BIAS + 3] = parameters.gyro_bias_sd_radps**2
        variance[D_ACCEL_BIAS : D_ACCEL_BIAS + 3] = parameters.accel_bias_sd_mps2**2
    else:
        for i in range(STATES):
            variance[i] = P[o + i, o + i]
        lost, lost_before = (t_ns - clock[T_KNOWN]) * 1e-9, (clock[T_LAST] - clock[T_KNOWN]) * 1e-9
        growth = lost**2 - lost_before**2
        variance[D_POSITION : D_POSITION + 3] += parameters.gap_speed_mps**2 * growth
        variance[D_ATTITUDE + 2] += parameters.gap_turn_rate_radps**2 * growth
    variance[D_VELOCITY : D_VELOCITY + 3] = speed_sd**2
    variance[D_ATTITUDE : D_ATTITUDE + 2] = tilt_sd**2
    P[o : o + STATES] = 0.0
    P[:, o : o + STATES] = 0.0
    for i in range(STATES):
        P[o + i, o + i] = variance[i]
