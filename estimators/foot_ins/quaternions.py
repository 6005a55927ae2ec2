"""Vectors, rotations and unit quaternions (Hamilton, w x y z) as tuples of numbers, for compiled code.

The compiler keeps them in registers: nothing is allocated. Each function is compiled for one type alone, and without
NumPy's functions, which take as long to compile as a page of plain arithmetic.
"""

from __future__ import annotations

import math

from numba import njit

from stridetwin.estimators.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

Vec3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Mat3 = tuple[Vec3, Vec3, Vec3]
"""Rows."""


@njit(**INNER_KERNEL)
def vec3(a: Array, i: int) -> Vec3:
    """Three entries of an array (n,), from `i` on."""
    return a[i], a[i + 1], a[i + 2]


@njit(**INNER_KERNEL)
def put_vec3(v: Vec3, a: Array, i: int) -> None:
    """Stores a vector in an array (n,), from `i` on."""
    a[i], a[i + 1], a[i + 2] = v


@njit(**INNER_KERNEL)
def quaternion(a: Array, i: int) -> Quaternion:
    """Four entries of an array (n,), from `i` on."""
    return a[i], a[i + 1], a[i + 2], a[i + 3]


@njit(**INNER_KERNEL)
def put_quaternion(q: Quaternion, a: Array, i: int) -> None:
    """Stores a quaternion in an array (n,), from `i` on."""
    a[i], a[i + 1], a[i + 2], a[i + 3] = q


@njit(**INNER_KERNEL)
def dot(a: Vec3, b: Vec3) -> float:
    """Product a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(**INNER_KERNEL)
def cross(a: Vec3, b: Vec3) -> Vec3:
    """Product a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(**INNER_KERNEL)
def axpy(a: Vec3, k: float, b: Vec3) -> Vec3:
    """Sum a + k b."""
    return a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]


@njit(**INNER_KERNEL)
def rotate(R: Mat3, v: Vec3) -> Vec3:
    """Product R v."""
    return dot(R[0], v), dot(R[1], v), dot(R[2], v)


@njit(**INNER_KERNEL)
def scale_matrix(k: float, R: Mat3) -> Mat3:
    """Matrix k R."""
    return (
        (k * R[0][0], k * R[0][1], k * R[0][2]),
        (k * R[1][0], k * R[1][1], k * R[1][2]),
        (k * R[2][0], k * R[2][1], k * R[2][2]),
    )


@njit(**INNER_KERNEL)
def matrix_product(A: Mat3, B: Mat3) -> Mat3:
    """Product A B."""
    columns = transposed(B)
    return rotate(columns, A[0]), rotate(columns, A[1]), rotate(columns, A[2])


@njit(**INNER_KERNEL)
def rows_cross(M: Mat3, v: Vec3) -> Mat3:
    """Product M [v]x: each row of M crossed with v."""
    return cross(M[0], v), cross(M[1], v), cross(M[2], v)


@njit(**INNER_KERNEL)
def put_matrix(M: Mat3, a: Array, row: int, column: int) -> None:
    """Stores a matrix in a block of an array (n, m)."""
    put_vec3(M[0], a[row], column)
    put_vec3(M[1], a[row + 1], column)
    put_vec3(M[2], a[row + 2], column)


@njit(**INNER_KERNEL)
def transposed(R: Mat3) -> Mat3:
    """Rᵀ; its rows are the columns of R."""
    return (R[0][0], R[1][0], R[2][0]), (R[0][1], R[1][1], R[2][1]), (R[0][2], R[1][2], R[2][2])


@njit(**INNER_KERNEL)
def quat_exp(x: float, y: float, z: float) -> Quaternion:
    """Unit quaternion of the rotation vector (x, y, z), rad."""
    angle = math.sqrt(x * x + y * y + z * z)
    s = 0.5 - angle * angle / 48.0 if angle < 1e-4 else math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), s * x, s * y, s * z


@njit(error_model="numpy", **INNER_KERNEL)
def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Unit quaternion a ⊗ b, normalised."""
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    size = math.sqrt(w * w + x * x + y * y + z * z)
    return w / size, x / size, y / size, z / size


@njit(**INNER_KERNEL)
def conjugate(q: Quaternion) -> Quaternion:
    """The reverse rotation of a unit quaternion."""
    return q[0], -q[1], -q[2], -q[3]


@njit(**INNER_KERNEL)
def rotation_matrix(q: Quaternion) -> Mat3:
    """Rotation matrix of a unit quaternion."""
    w, x, y, z = q
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
