"""Quaternions (w, x, y, z) for compiled code, as four numbers; vectors and matrices as in `sim.triples`."""

from __future__ import annotations

import math

import numba

from stridetwin.sim.triples import Mat3, Vec3, cross, dot, plus, times
from stridetwin.streams.samples import Array

Quaternion = tuple[float, float, float, float]

_SMALL = 1e-3  # rad: below this, series


@numba.njit(cache=True)
def quaternion(a: Array) -> Quaternion:
    """The entries of a (4,) array."""
    return a[0], a[1], a[2], a[3]


@numba.njit(cache=True)
def store(q: Quaternion, out: Array) -> None:
    """Stores a quaternion in a (4,) array."""
    out[0], out[1], out[2], out[3] = q


@numba.njit(cache=True)
def inverse(q: Quaternion) -> Quaternion:
    """The inverse rotation of a unit quaternion."""
    return q[0], -q[1], -q[2], -q[3]


@numba.njit(cache=True)
def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product a b: first rotation b, then a."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@numba.njit(cache=True)
def matrix(q: Quaternion) -> Mat3:
    """Rotation matrix of a unit quaternion."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


@numba.njit(cache=True)
def of_matrix(R: Mat3) -> Quaternion:
    """Unit quaternion, w >= 0, of a rotation matrix, from its largest entry for a safe division."""
    x, y, z = R[2][1] - R[1][2], R[0][2] - R[2][0], R[1][0] - R[0][1]
    xy, xz, yz = R[0][1] + R[1][0], R[0][2] + R[2][0], R[1][2] + R[2][1]
    trace = R[0][0] + R[1][1] + R[2][2]
    if trace >= max(R[0][0], R[1][1], R[2][2]):
        q = (1.0 + trace, x, y, z)
    elif R[0][0] >= max(R[1][1], R[2][2]):
        q = (x, 1.0 + 2.0 * R[0][0] - trace, xy, xz)
    elif R[1][1] >= R[2][2]:
        q = (y, xy, 1.0 + 2.0 * R[1][1] - trace, yz)
    else:
        q = (z, xz, yz, 1.0 + 2.0 * R[2][2] - trace)
    k = math.copysign(1.0 / math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2), q[0])
    return k * q[0], k * q[1], k * q[2], k * q[3]


@numba.njit(cache=True)
def rotate(q: Quaternion, a: Vec3) -> Vec3:
    """Vector rotated by a unit quaternion."""
    axis = (q[1], q[2], q[3])
    once = cross(axis, a)
    return plus(a, times(2.0, plus(times(q[0], once), cross(axis, once))))


@numba.njit(cache=True)
def exp(phi: Vec3) -> Quaternion:
    """Quaternion of a rotation vector, rad."""
    square = dot(phi, phi)
    half = 0.5 * math.sqrt(square)
    k = 0.5 - square / 48.0 if half < 0.5 * _SMALL else 0.5 * math.sin(half) / half
    return math.cos(half), k * phi[0], k * phi[1], k * phi[2]


@numba.njit(cache=True)
def log(q: Quaternion) -> Vec3:
    """Rotation vector, rad, of at most half a turn, of a unit quaternion."""
    sign = 1.0 if q[0] >= 0.0 else -1.0
    axis = (sign * q[1], sign * q[2], sign * q[3])
    sine = math.sqrt(dot(axis, axis))
    k = 2.0 + sine * sine / 3.0 if sine < 0.5 * _SMALL else 2.0 * math.atan2(sine, sign * q[0]) / sine
    return times(k, axis)
