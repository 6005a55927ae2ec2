"""Past state of a foot: a camera's or sonar's time is between the IMU samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.foot_ins.state import (
    ACCEL_BIAS,
    ATTITUDE,
    FILL,
    GYRO_BIAS,
    PHASE,
    POSITION,
    T_LAST,
    TRACKING,
    VELOCITY,
    Memory,
    ring_row,
)
from stridetwin.estimators.foot_ins.strapdown import force_at_middle
from stridetwin.estimators.so3 import product, quat_exp, rotation_matrix
from stridetwin.streams.samples import Array


class PastState(NamedTuple):
    """State of a foot's IMU at a past time.

    Attributes:
        known: Whether the foot was tracked continuously from then to its newest sample.
        p: (3,) position in the world, m.
        R: (3, 3) rotation, world <- IMU.
        v: (3,) velocity in the world, m/s.
        rate: (3,) angular rate, world axes, rad/s.
        age: Time before the newest sample, s; negative after it.
        displacement: (3,) displacement by the specific force since then, world, m.
    """

    known: bool
    p: Array
    R: Array
    v: Array
    rate: Array
    age: float
    displacement: Array


@njit(**INSIDE)
def rewind(memory: Memory, gravity: float, t_ns: int, max_age_s: float, max_lead_s: float) -> PastState:
    """State of the foot's IMU at `t_ns`, from the newest state back through the samples since.

    It reverses `foot_ins.strapdown.predict` sample by sample, and so is exact except for the noise in between. A little
    after the newest sample (a camera's clock may be late) that sample is extrapolated.
    """
    clock, x = memory.clock, memory.nominal
    p, v = x[POSITION : POSITION + 3].copy(), x[VELOCITY : VELOCITY + 3].copy()
    q = x[ATTITUDE : ATTITUDE + 4].copy()
    age = (clock[T_LAST] - t_ns) * 1e-9
    known = clock[PHASE] == TRACKING and -max_lead_s <= age <= max_age_s
    w = memory.ring[ring_row(memory, 0), :3] - x[GYRO_BIAS : GYRO_BIAS + 3]
    back, left = 0, known
    while left:
        i, before = ring_row(memory, back), ring_row(memory, back + 1)
        if age > 0.0 and back + 1 >= clock[FILL]:
            known = False
            break
        if age > 0.0:
            left = memory.ring_t_ns[before] > t_ns
            dt = (memory.ring_t_ns[i] - max(t_ns, memory.ring_t_ns[before])) * 1e-9
        else:
            left, dt = False, age
        w = memory.ring[i, :3] - x[GYRO_BIAS : GYRO_BIAS + 3]
        half = quat_exp(-0.5 * dt * w[0], -0.5 * dt * w[1], -0.5 * dt * w[2])
        middle = product(q, half)
        force = memory.ring[i, 3:] - x[ACCEL_BIAS : ACCEL_BIAS + 3]
        a = rotation_matrix(middle) @ force_at_middle(force, dt * w[0], dt * w[1], dt * w[2])
        a[2] -= gravity
        v -= dt * a
        p -= dt * (v + 0.5 * dt * a)
        q = product(middle, half)
        back += 1
    displacement = p - x[POSITION : POSITION + 3] + age * x[VELOCITY : VELOCITY + 3]
    displacement[2] += 0.5 * gravity * age * age
    R = rotation_matrix(q)
    return PastState(known, p, R, v, R @ w, age, displacement)


@njit(**INSIDE)
def cross(M: Array, v: Array) -> Array:
    """(m, 3) M [v]x, the rows of M (m, 3) each crossed with v."""
    out = np.empty((len(M), 3))
    for i in range(len(M)):
        out[i, 0] = M[i, 1] * v[2] - M[i, 2] * v[1]
        out[i, 1] = M[i, 2] * v[0] - M[i, 0] * v[2]
        out[i, 2] = M[i, 0] * v[1] - M[i, 1] * v[0]
    return out
