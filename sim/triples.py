"""Vectors and matrices of compiled code as tuples of numbers: the compiler keeps them in registers.

With arrays of three the same computation takes several times as long, because every result is stored and loaded again.
"""

from __future__ import annotations

import numba

from stridetwin.streams.samples import Array

Triple = tuple[float, float, float]
Rows = tuple[Triple, Triple, Triple]


@numba.njit(cache=True)
def triple(a: Array) -> Triple:
    """Tuple of a (3,) array."""
    return a[0], a[1], a[2]


@numba.njit(cache=True)
def rows(a: Array) -> Rows:
    """Tuple of rows of a (3, 3) array."""
    return (a[0, 0], a[0, 1], a[0, 2]), (a[1, 0], a[1, 1], a[1, 2]), (a[2, 0], a[2, 1], a[2, 2])


@numba.njit(cache=True)
def put(a: Triple, out: Array) -> None:
    """Stores a vector in a (3,) array."""
    out[0], out[1], out[2] = a


@numba.njit(cache=True)
def plus(a: Triple, b: Triple) -> Triple:
    """Sum of two."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@numba.njit(cache=True)
def minus(a: Triple, b: Triple) -> Triple:
    """Difference of two."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@numba.njit(cache=True)
def times(k: float, a: Triple) -> Triple:
    """Scaled by k."""
    return k * a[0], k * a[1], k * a[2]


@numba.njit(cache=True)
def dot(a: Triple, b: Triple) -> float:
    """Dot product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True)
def cross(a: Triple, b: Triple) -> Triple:
    """Cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True)
def turned(M: Rows, a: Triple) -> Triple:
    """Matrix times vector."""
    return dot(M[0], a), dot(M[1], a), dot(M[2], a)


@numba.njit(cache=True)
def transposed(M: Rows) -> Rows:
    """Transposed matrix."""
    return (M[0][0], M[1][0], M[2][0]), (M[0][1], M[1][1], M[2][1]), (M[0][2], M[1][2], M[2][2])


@numba.njit(cache=True)
def product(A: Rows, B: Rows) -> Rows:
    """Product of two matrices."""
    T = transposed(B)
    return turned(T, A[0]), turned(T, A[1]), turned(T, A[2])
