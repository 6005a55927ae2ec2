"""Quaternions (w, x, y, z) for compiled code, as four numbers; vectors and matrices as tuples.

The compiler keeps tuples of numbers in registers. With arrays of three the same computation takes several times as
long, because every result is stored and loaded again.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Array

_entry_kernel = entry_kernel(__file__)

Vec3 = tuple[float, float, float]
Mat3 = tuple[Vec3, Vec3, Vec3]


@numba.njit(**INNER_KERNEL)
def vec3(a: Array) -> Vec3:
    """Tuple of a (3,) array."""
    return a[0], a[1], a[2]


@numba.njit(**INNER_KERNEL)
def vec3_at(a: Array, i: int) -> Vec3:
    """Three entries of an array, from `i` on."""
    return a[i], a[i + 1], a[i + 2]


@numba.njit(**INNER_KERNEL)
def store_vec3_at(v: Vec3, out: Array, i: int) -> None:
    """Stores a vector in the entries i, i + 1, i + 2 of an array."""
    out[i], out[i + 1], out[i + 2] = v


@numba.njit(**INNER_KERNEL)
def mat3(a: Array) -> Mat3:
    """Tuple of rows of a (3, 3) array."""
    return (a[0, 0], a[0, 1], a[0, 2]), (a[1, 0], a[1, 1], a[1, 2]), (a[2, 0], a[2, 1], a[2, 2])


@numba.njit(**INNER_KERNEL)
def store_vec3(a: Vec3, out: Array) -> None:
    """Stores a vector in a (3,) array."""
    out[0], out[1], out[2] = a


@numba.njit(**INNER_KERNEL)
def plus(a: Vec3, b: Vec3) -> Vec3:
    """Sum a + b of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@numba.njit(**INNER_KERNEL)
def minus(a: Vec3, b: Vec3) -> Vec3:
    """Difference a - b of two vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@numba.njit(**INNER_KERNEL)
def times(k: float, a: Vec3) -> Vec3:
    """Vector a times the number k."""
    return k * a[0], k * a[1], k * a[2]


@numba.njit(**INNER_KERNEL)
def dot(a: Vec3, b: Vec3) -> float:
    """Dot product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(**INNER_KERNEL)
def cross(a: Vec3, b: Vec3) -> Vec3:
    """Cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@numba.njit(**INNER_KERNEL)
def matvec(M: Mat3, a: Vec3) -> Vec3:
    """Matrix times vector."""
    return dot(M[0], a), dot(M[1], a), dot(M[2], a)


@numba.njit(**INNER_KERNEL)
def transposed(M: Mat3) -> Mat3:
    """Transposed matrix."""
    return (M[0][0], M[1][0], M[2][0]), (M[0][1], M[1][1], M[2][1]), (M[0][2], M[1][2], M[2][2])


@numba.njit(**INNER_KERNEL)
def matmul(A: Mat3, B: Mat3) -> Mat3:
    """Product of two matrices."""
    T = transposed(B)
    return matvec(T, A[0]), matvec(T, A[1]), matvec(T, A[2])


Quaternion = tuple[float, float, float, float]

_SMALL = 1e-3  # rad: below this, series


@numba.njit(**INNER_KERNEL)
def quaternion(a: Array) -> Quaternion:
    """Quaternion (w, x, y, z) from a (4,) array."""
    return a[0], a[1], a[2], a[3]


@numba.njit(**INNER_KERNEL)
def store_quaternion(q: Quaternion, out: Array) -> None:
    """Stores a quaternion in a (4,) array."""
    out[0], out[1], out[2], out[3] = q


@numba.njit(**INNER_KERNEL)
def inverse(q: Quaternion) -> Quaternion:
    """The inverse rotation of a unit quaternion."""
    return q[0], -q[1], -q[2], -q[3]


@numba.njit(**INNER_KERNEL)
def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product a b: first rotation b, then a."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@numba.njit(**INNER_KERNEL)
def matrix(q: Quaternion) -> Mat3:
    """Rotation matrix of a unit quaternion."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


@numba.njit(**INNER_KERNEL)
def from_matrix(R: Mat3) -> Quaternion:
    """Unit quaternion, w >= 0, of a rotation matrix (Shepperd 1978: it divides by the largest of the four entries)."""
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


@numba.njit(**INNER_KERNEL)
def rotate(q: Quaternion, a: Vec3) -> Vec3:
    """Vector a rotated by a unit quaternion: a + 2 w (v × a) + 2 v × (v × a), v the vector part."""
    axis = (q[1], q[2], q[3])
    once = cross(axis, a)
    return plus(a, times(2.0, plus(times(q[0], once), cross(axis, once))))


@numba.njit(**INNER_KERNEL)
def exp(phi: Vec3) -> Quaternion:
    """Quaternion of a rotation vector, rad."""
    square = dot(phi, phi)
    half = 0.5 * math.sqrt(square)
    k = 0.5 - square / 48.0 if half < 0.5 * _SMALL else 0.5 * math.sin(half) / half
    return math.cos(half), k * phi[0], k * phi[1], k * phi[2]


@numba.njit(**INNER_KERNEL)
def log(q: Quaternion) -> Vec3:
    """Rotation vector of a unit quaternion, rad, of at most half a turn."""
    sign = 1.0 if q[0] >= 0.0 else -1.0
    axis = (sign * q[1], sign * q[2], sign * q[3])
    sine = math.sqrt(dot(axis, axis))
    k = 2.0 + sine * sine / 3.0 if sine < 0.5 * _SMALL else 2.0 * math.atan2(sine, sign * q[0]) / sine
    return times(k, axis)


def quat_from_matrix(R: Array) -> Array:
    """(..., 4) unit quaternions (w, x, y, z), w >= 0, of (..., 3, 3) matrices."""
    return _quaternions(np.ascontiguousarray(R, dtype=float).reshape(-1, 3, 3)).reshape(*R.shape[:-2], 4)


@_entry_kernel
def _quaternions(R: Array) -> Array:
    """(N, 4) unit quaternions of (N, 3, 3) rotation matrices."""
    q = np.empty((len(R), 4))
    for i in range(len(R)):
        store_quaternion(from_matrix(mat3(R[i])), q[i])
    return q


def matrix_from_quat(q: Array) -> Array:
    """(..., 3, 3) matrices of (..., 4) unit quaternions (w, x, y, z)."""
    return _matrices(np.ascontiguousarray(q, dtype=float).reshape(-1, 4)).reshape(*q.shape[:-1], 3, 3)


@_entry_kernel
def _matrices(q: Array) -> Array:
    """(N, 3, 3) rotation matrices of (N, 4) unit quaternions."""
    R = np.empty((len(q), 3, 3))
    for i in range(len(q)):
        M = matrix(quaternion(q[i]))
        for k in range(3):
            store_vec3(M[k], R[i, k])
    return R
