"""Level-floor constraint: a foothold at an apparently unchanged height is at the height of the last one."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.foot_ins.algebra import rotation_matrix
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.state import (
    ATTITUDE,
    D_ATTITUDE,
    D_FLOOR,
    D_POSITION,
    FLOOR,
    LANDED,
    NEVER_LANDED,
    POSITION,
    STANDING,
    STATES,
    SWINGING,
    T_STOOD,
    Memory,
)
from stridetwin.estimators.foot_ins.strapdown import correct
from stridetwin.estimators.foot_ins.zero_velocity import inject


@njit(**INSIDE)
def level_floor_update(memory: Memory, parameters: KernelParameters, t_ns: int, stationary_speed_sd: float) -> None:
    """Compares the height of a foot that has just become stationary with that of its last floor.

    See docs/foot_ins.md (14).

    Zero-velocity updates do not observe height, so its error grows with every stride, mostly with one sign. Built
    ground is level or clearly not. If the foot is stationary and flat, and its height has changed by less than
    `level_step` and by no more than the filter's uncertainty, the floor is taken to be the same, up to `floor_sd`
    (after Abdulrahim, Hide, Moore, Hill 2012). Elsewhere, on a stair or ramp, the floor is at the foot's height and as
    uncertain as the foot.

    Args:
        memory: Changed in place.
        parameters: Of the filter.
        t_ns: Time of the sample.
        stationary_speed_sd: Standard deviation of the stationary foot's speed, m/s, inf if it is moving.
    """
    clock = memory.clock
    if stationary_speed_sd > parameters.stand_speed_mps:
        clock[T_STOOD] = t_ns
        if stationary_speed_sd == math.inf and clock[LANDED] == STANDING:
            clock[LANDED] = SWINGING
        return
    if clock[LANDED] == STANDING or (t_ns - clock[T_STOOD]) * 1e-9 < parameters.stand_s:
        return
    x, P, o = memory.nominal, memory.covariance, memory.row
    r = rotation_matrix(x[ATTITUDE : ATTITUDE + 4]) @ memory.lever
    h = np.zeros(STATES)  # of the sole's height above the floor
    h[D_POSITION + 2], h[D_ATTITUDE], h[D_ATTITUDE + 1], h[D_FLOOR] = 1.0, r[1], -r[0], -1.0
    height = x[POSITION + 2] + r[2]
    known, clock[LANDED] = clock[LANDED] != NEVER_LANDED, STANDING
    step = height - x[FLOOR]
    flat = math.hypot(r[0], r[1]) <= parameters.level_tilt_rad * parameters.lever_arm_m
    own = np.ascontiguousarray(P[o : o + STATES, o : o + STATES])
    variance = h @ own @ h + parameters.floor_sd_m**2
    possible = abs(step) < min(parameters.level_step_m, parameters.innovation_gate * math.sqrt(variance))
    if known and flat and possible:
        correct(P, memory.error, o, h, -step, parameters.floor_sd_m**2)
        inject(memory)
        return
    x[FLOOR] = height
    h[D_FLOOR] = 0.0
    row = h @ np.ascontiguousarray(P[o : o + STATES])
    P[o + D_FLOOR] = row
    P[:, o + D_FLOOR] = row
    P[o + D_FLOOR, o + D_FLOOR] = h @ own @ h
