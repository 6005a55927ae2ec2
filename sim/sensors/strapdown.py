"""Interval means of rate and specific force from which strapdown integration recovers the motion."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stridetwin.sim.quaternions import exp, inverse, log, multiply, quaternion, rotate
from stridetwin.sim.track import Track
from stridetwin.sim.triples import Vec3, cross, dot, minus, plus, put, times, vec3
from stridetwin.streams.samples import Array

_SMALL = 1e-3  # rad: below this, series


def increments(before: Track, sensor: Track, gravity: Array) -> tuple[Array, Array, Array]:
    """Constant rate and specific force over each interval.

    The rate is the constant one that rotates the attitude at an interval's start to that at its end. The specific force
    is the constant one, in the rotating sensor frame, that gives the true change of velocity: with φ = Log(R₀ᵀR₁) the
    velocity changes by R₀ Γ₁(φ) f Δt + g Δt, where Γ₁ is the left Jacobian of SO(3).

    Args:
        before: One instant, the start of the first interval.
        sensor: N ends of intervals.
        gravity: (3,) in the world, m/s².

    Returns:
        (N,) s, (N, 3) rad/s and (N, 3) m/s², in the sensor frame.
    """
    return _increments(*_columns(before), *_columns(sensor), gravity)


def _columns(track: Track) -> tuple[NDArray[np.int64], Array, Array]:
    return track.t_ns, track.q_world_body, track.v_body_in_world


@numba.njit(cache=True)
def _increments(
    t0: NDArray[np.int64], q0: Array, v0: Array, t: NDArray[np.int64], q: Array, v: Array, gravity: Array
) -> tuple[Array, Array, Array]:
    n = len(t)
    dts, rates, forces = np.empty(n), np.empty((n, 3)), np.empty((n, 3))
    t_last, back, v_last, g = t0[0], inverse(quaternion(q0[0])), vec3(v0[0]), vec3(gravity)
    for i in range(n):
        dt, attitude, velocity = (t[i] - t_last) * 1e-9, quaternion(q[i]), vec3(v[i])
        phi = log(multiply(back, attitude))
        push = rotate(back, minus(times(1 / dt, minus(velocity, v_last)), g))
        dts[i] = dt
        put(times(1 / dt, phi), rates[i])
        put(_left_jacobian_inverse_times(phi, push), forces[i])
        t_last, back, v_last = t[i], inverse(attitude), velocity
    return dts, rates, forces


@numba.njit(cache=True)
def joined(dt: Array, rate: Array, force: Array, steps: int) -> tuple[Array, Array]:
    """One rate and force for every `steps` intervals with the same rotation and velocity change: no coning or sculling.

    Args:
        dt: (N,) s.
        rate: (N, 3) rad/s.
        force: (N, 3) m/s².
        steps: Divides N.

    Returns:
        (N / steps, 3) rad/s and (N / steps, 3) m/s².
    """
    n = len(dt) // steps
    rates, forces = np.empty((n, 3)), np.empty((n, 3))
    for i in range(n):
        rotation, change, whole = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0
        for k in range(i * steps, (i + 1) * steps):
            phi = times(dt[k], vec3(rate[k]))
            push = _left_jacobian_times(phi, times(dt[k], vec3(force[k])))
            change = plus(change, rotate(rotation, push))
            rotation = multiply(rotation, exp(phi))
            whole += dt[k]
        total = log(rotation)
        put(times(1 / whole, total), rates[i])
        put(_left_jacobian_inverse_times(total, times(1 / whole, change)), forces[i])
    return rates, forces


def steadily_before(sensor: Track, steps: int, dt: float) -> Track:
    """`steps` instants before the track's first, `dt` apart, for constant rate and velocity until then."""
    first = sensor[:1]
    ago = dt * np.arange(steps, 0, -1)[:, None]
    return Track(
        t_ns=first.t_ns - np.round(ago[:, 0] * 1e9).astype(np.int64),
        p_body_in_world=first.p_body_in_world - ago * first.v_body_in_world,
        q_world_body=(first.rotation * Rotation.from_rotvec(-ago * first.w_body)).as_quat(scalar_first=True),
        v_body_in_world=np.repeat(first.v_body_in_world, steps, axis=0),
        w_body=np.repeat(first.w_body, steps, axis=0),
    )


@numba.njit(cache=True)
def _left_jacobian_times(phi: Vec3, v: Vec3) -> Vec3:
    """Γ₁(φ) v = v + (1 − cos θ)/θ² φ×v + (θ − sin θ)/θ³ φ×(φ×v) (Barfoot 2017, eq. 7.37)."""
    theta = math.sqrt(dot(phi, phi))
    if theta < _SMALL:
        a, b = 0.5 - theta**2 / 24, 1 / 6 - theta**2 / 120
    else:
        a, b = (1 - math.cos(theta)) / theta**2, (theta - math.sin(theta)) / theta**3
    once = cross(phi, v)
    return plus(v, plus(times(a, once), times(b, cross(phi, once))))


@numba.njit(cache=True)
def _left_jacobian_inverse_times(phi: Vec3, v: Vec3) -> Vec3:
    """Γ₁(φ)⁻¹ v = v − φ×v/2 + c φ×(φ×v), c = (1 − (θ/2) cot(θ/2)) / θ² (Barfoot 2017, eq. 7.37)."""
    theta = math.sqrt(dot(phi, phi))
    half = 0.5 * theta
    c = 1 / 12 + theta**2 / 720 if theta < _SMALL else (1 - half / math.tan(half)) / theta**2
    once = cross(phi, v)
    return plus(minus(v, times(0.5, once)), times(c, cross(phi, once)))
