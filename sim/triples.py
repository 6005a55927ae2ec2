"""Vectors and matrices of compiled code as tuples of numbers: the compiler keeps them in registers.

With arrays of three the same computation takes several times as long, because every result is stored and loaded again.
"""

from __future__ import annotations

import numba

from stridetwin.streams.samples import Array

Vec3 = tuple[float, float, float]
Mat3 = tuple[Vec3, Vec3, Vec3]


@numba.njit(cache=True)
def vec3(a: Array) -> Vec3:
    """Tuple of a (3,) array."""
    return a[0], a[1], a[2]


@numba.njit(cache=True)
def mat3(a: Array) -> Mat3:
    """Tuple of rows of a (3, 3) array."""
    return (a[0, 0], a[0, 1], a[0, 2]), (a[1, 0], a[1, 1], a[1, 2]), (a[2, 0], a[2, 1], a[2, 2])


@numba.njit(cache=True)
def put(a: Vec3, out: Array) -> None:
    """Stores a vector in a (3,) array."""
    out[0], out[1], out[2] = a


@numba.njit(cache=True)
def plus(a: Vec3, b: Vec3) -> Vec3:
    """Sum of two."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@numba.njit(cache=True)
def minus(a: Vec3, b: Vec3) -> Vec3:
    """Difference of two."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@numba.njit(cache=True)
def times(k: float, a: Vec3) -> Vec3:
    """Scaled by k."""
    return k * a[0], k * a[1], k * a[2]


@numba.njit(cache=True)
def dot(a: Vec3, b: Vec3) -> float:
    """Dot product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True)
def cross(a: Vec3, b: Vec3) -> Vec3:
    """Cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True)
def matvec(M: Mat3, a: Vec3) -> Vec3:
    """Matrix times vector."""
    return dot(M[0], a), dot(M[1], a), dot(M[2], a)


@numba.njit(cache=True)
def transposed(M: Mat3) -> Mat3:
    """Transposed matrix."""
    return (M[0][0], M[1][0], M[2][0]), (M[0][1], M[1][1], M[2][1]), (M[0][2], M[1][2], M[2][2])


@numba.njit(cache=True)
def matmul(A: Mat3, B: Mat3) -> Mat3:
    """Product of two matrices."""
    T = transposed(B)
    return matvec(T, A[0]), matvec(T, A[1]), matvec(T, A[2])
