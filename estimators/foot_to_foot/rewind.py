"""Past state of a foot: a camera's or sonar's time is between the IMU samples."""

from __future__ import annotations

from typing import NamedTuple

from numba import njit

from stridetwin.estimators.foot_ins import state
from stridetwin.estimators.foot_ins.strapdown import force_at_middle
from stridetwin.streams.algebra.tuples import (
    Mat3,
    Vec3,
    axpy,
    exp,
    matvec,
    multiply,
    normalized,
    quaternion_at,
    times,
    to_matrix,
    vec3_at,
)
from stridetwin.streams.compiled import INNER_KERNEL

_MAX_LEAD_S = 0.05  # longest extrapolation of the newest IMU sample, for a camera whose clock is late


class PastState(NamedTuple):
    """State of a foot's IMU at a past time.

    Attributes:
        known: Whether the foot was tracked continuously from then to its newest sample.
        p: Position in the world, m.
        R: Rotation, world <- IMU.
        v: Velocity in the world, m/s.
        rate: Angular rate, world axes, rad/s.
        age: Time before the newest sample, s; negative after it.
        displacement: Displacement by the specific force since then, world, m.
    """

    known: bool
    p: Vec3
    R: Mat3
    v: Vec3
    rate: Vec3
    age: float
    displacement: Vec3


@njit(**INNER_KERNEL)
def rewind(memory: state.FilterState, gravity: float, t_ns: int, max_age_s: float) -> PastState:
    """State of the foot's IMU at a past time, from the newest state back through the samples since.

    It reverses `foot_ins.strapdown.predict` sample by sample, and so is exact except for the noise in between. A time a
    little after the newest sample is possible, too, as a camera's clock may be late: that sample is extrapolated by up
    to `_MAX_LEAD_S`. If the state is not known, `known` is false, and the other values must not be used.

    Args:
        memory: State of the foot.
        gravity: m/s².
        t_ns: The past time.
        max_age_s: Largest time before the newest sample, s; an older state is not known.
    """
    clock, x = memory.clock, memory.nominal
    p, v, q = vec3_at(x, state.POSITION), vec3_at(x, state.VELOCITY), quaternion_at(x, state.ATTITUDE)
    gyro_bias, accel_bias = vec3_at(x, state.GYRO_BIAS), vec3_at(x, state.ACCEL_BIAS)
    age = (clock[state.T_LAST] - t_ns) * 1e-9  # s before the newest sample; negative after it
    known = clock[state.PHASE] == state.NAVIGATING and -_MAX_LEAD_S <= age <= max_age_s
    w = axpy(state.rate_of(memory, state.ring_row(memory, 0)), -1.0, gyro_bias)
    back, not_reached = 0, known  # samples gone back so far; whether the past time is not reached yet
    while not_reached:
        # rows of the ring: the sample whose interval is undone, and the one before it
        i, before = state.ring_row(memory, back), state.ring_row(memory, back + 1)
        if age > 0.0 and back + 1 >= clock[state.FILL]:  # the ring does not reach back so far
            known = False
            break
        if age > 0.0:
            not_reached = memory.ring_t_ns[before] > t_ns
            dt = (memory.ring_t_ns[i] - max(t_ns, memory.ring_t_ns[before])) * 1e-9
        else:  # one step forward: the negative dt extrapolates the newest sample
            not_reached, dt = False, age
        w = axpy(state.rate_of(memory, i), -1.0, gyro_bias)
        half = exp(times(-0.5 * dt, w), state.SERIES_RAD)  # half of the rotation, backward
        middle = normalized(multiply(q, half))
        force = axpy(state.force_of(memory, i), -1.0, accel_bias)
        a = matvec(to_matrix(middle), force_at_middle(force, dt * w[0], dt * w[1], dt * w[2]))
        a = a[0], a[1], a[2] - gravity  # acceleration in the world
        v = axpy(v, -dt, a)
        p = axpy(p, -dt, axpy(v, 0.5 * dt, a))
        q = normalized(multiply(middle, half))
        back += 1
    # displacement from the newest state, without that by its velocity and by gravity
    moved = axpy(axpy(p, -1.0, vec3_at(x, state.POSITION)), age, vec3_at(x, state.VELOCITY))
    displacement = moved[0], moved[1], moved[2] + 0.5 * gravity * age * age
    R = to_matrix(q)
    return PastState(known, p, R, v, matvec(R, w), age, displacement)
