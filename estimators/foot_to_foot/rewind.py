"""Where a foot was a moment ago: a camera's or sonar's instant lies between the samples of the IMUs."""

from __future__ import annotations

import numpy as np
from numba import njit

from stridetwin.estimators.foot_ins.algebra import exponential, force_at_middle, product, rotation_matrix
from stridetwin.estimators.foot_ins.memory import (
    ACCEL_BIAS,
    ATTITUDE,
    FILL,
    GYRO_BIAS,
    HEAD,
    PHASE,
    POSITION,
    RING,
    T_LAST,
    TRACKING,
    VELOCITY,
    Memory,
)
from stridetwin.streams.samples import Array


@njit
def rewind(memory: Memory, gravity: float, t_ns: int, max_age_s: float) -> tuple[bool, Array, Array, float, Array]:
    """Pose of the foot's IMU at `t_ns`, from the newest state back through the samples since.

    It undoes `foot_ins.strapdown.predict` sample by sample, and so is exact but for the noise in between.

    Args:
        memory: Left alone.
        gravity: m/s².
        t_ns: Not after the newest sample.
        max_age_s: Farthest way back, s.

    Returns:
        Whether the foot was tracked all the time since; (3,) position in the world, m; (3, 3) rotation, world <-
        IMU; how far back, s; (3,) way that the specific force has led since, world, m.
    """
    clock, x = memory.clock, memory.nominal
    p, v = x[POSITION : POSITION + 3].copy(), x[VELOCITY : VELOCITY + 3].copy()
    q = x[ATTITUDE : ATTITUDE + 4].copy()
    age = (clock[T_LAST] - t_ns) * 1e-9
    known = clock[PHASE] == TRACKING and 0.0 <= age <= max_age_s
    back = 0
    while known and memory.ring_t_ns[(clock[HEAD] - back) % RING] > t_ns:
        if back + 1 >= clock[FILL]:
            known = False
            break
        i, before = (clock[HEAD] - back) % RING, (clock[HEAD] - back - 1) % RING
        dt = (memory.ring_t_ns[i] - max(t_ns, memory.ring_t_ns[before])) * 1e-9
        w = memory.ring[i, :3] - x[GYRO_BIAS : GYRO_BIAS + 3]
        half = exponential(-0.5 * dt * w[0], -0.5 * dt * w[1], -0.5 * dt * w[2])
        middle = product(q, half)
        force = memory.ring[i, 3:] - x[ACCEL_BIAS : ACCEL_BIAS + 3]
        a = rotation_matrix(middle) @ force_at_middle(force, dt * w[0], dt * w[1], dt * w[2])
        a[2] -= gravity
        v -= dt * a
        p -= dt * (v + 0.5 * dt * a)
        q = product(middle, half)
        back += 1
    led = p - x[POSITION : POSITION + 3] + age * x[VELOCITY : VELOCITY + 3]
    led[2] += 0.5 * gravity * age * age
    return known, p, rotation_matrix(q), age, led


@njit
def cross(M: Array, v: Array) -> Array:
    """(m, 3) M [v]x, the rows of M (m, 3) each crossed with v."""
    out = np.empty((len(M), 3))
    for i in range(len(M)):
        out[i, 0] = M[i, 1] * v[2] - M[i, 2] * v[1]
        out[i, 1] = M[i, 2] * v[0] - M[i, 0] * v[2]
        out[i, 2] = M[i, 0] * v[1] - M[i, 1] * v[0]
    return out
