"""Vectors, 3 × 3 matrices and unit quaternions (Hamilton, w x y z) as tuples of numbers, for compiled code.

The compiler keeps tuples of numbers in registers. With arrays of three the same computation takes several times as
long, because every result is stored and loaded again. Each function is compiled for one type alone, and without NumPy's
functions, which take as long to compile as a page of plain arithmetic.
"""

from __future__ import annotations

import math

from numba import njit

from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

Vec3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Mat3 = tuple[Vec3, Vec3, Vec3]
"""Rows."""

IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)
"""The rotation by 0."""
SMALL_RAD = 1e-3
"""Angle below which series replace quotients whose terms cancel."""


# From and to arrays.


@njit(**INNER_KERNEL)
def vec3(a: Array) -> Vec3:
    """Tuple of a (3,) array."""
    return a[0], a[1], a[2]


@njit(**INNER_KERNEL)
def vec3_at(a: Array, i: int) -> Vec3:
    """Three entries of an array (n,), from `i` on."""
    return a[i], a[i + 1], a[i + 2]


@njit(**INNER_KERNEL)
def store_vec3(v: Vec3, out: Array) -> None:
    """Stores a vector in a (3,) array."""
    out[0], out[1], out[2] = v


@njit(**INNER_KERNEL)
def store_vec3_at(v: Vec3, out: Array, i: int) -> None:
    """Stores a vector in the entries i, i + 1, i + 2 of an array (n,)."""
    out[i], out[i + 1], out[i + 2] = v


@njit(**INNER_KERNEL)
def quaternion(a: Array) -> Quaternion:
    """Quaternion (w, x, y, z) from a (4,) array."""
    return a[0], a[1], a[2], a[3]


@njit(**INNER_KERNEL)
def quaternion_at(a: Array, i: int) -> Quaternion:
    """Quaternion from four entries of an array (n,), from `i` on."""
    return a[i], a[i + 1], a[i + 2], a[i + 3]


@njit(**INNER_KERNEL)
def store_quaternion(q: Quaternion, out: Array) -> None:
    """Stores a quaternion in a (4,) array."""
    out[0], out[1], out[2], out[3] = q


@njit(**INNER_KERNEL)
def store_quaternion_at(q: Quaternion, out: Array, i: int) -> None:
    """Stores a quaternion in four entries of an array (n,), from `i` on."""
    out[i], out[i + 1], out[i + 2], out[i + 3] = q


@njit(**INNER_KERNEL)
def mat3(a: Array) -> Mat3:
    """Tuple of rows of a (3, 3) array."""
    return (a[0, 0], a[0, 1], a[0, 2]), (a[1, 0], a[1, 1], a[1, 2]), (a[2, 0], a[2, 1], a[2, 2])


@njit(**INNER_KERNEL)
def store_mat3(M: Mat3, out: Array) -> None:
    """Stores a matrix in a (3, 3) array."""
    store_vec3(M[0], out[0])
    store_vec3(M[1], out[1])
    store_vec3(M[2], out[2])


@njit(**INNER_KERNEL)
def store_mat3_at(M: Mat3, out: Array, row: int, column: int) -> None:
    """Stores a matrix in the block of an array (n, m) that begins at a row and a column."""
    store_vec3_at(M[0], out[row], column)
    store_vec3_at(M[1], out[row + 1], column)
    store_vec3_at(M[2], out[row + 2], column)


# Vectors.


@njit(**INNER_KERNEL)
def plus(a: Vec3, b: Vec3) -> Vec3:
    """Sum a + b of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@njit(**INNER_KERNEL)
def minus(a: Vec3, b: Vec3) -> Vec3:
    """Difference a - b of two vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(**INNER_KERNEL)
def times(k: float, a: Vec3) -> Vec3:
    """Vector a times the number k."""
    return k * a[0], k * a[1], k * a[2]


@njit(**INNER_KERNEL)
def axpy(a: Vec3, k: float, b: Vec3) -> Vec3:
    """Sum a + k b."""
    return a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]


@njit(**INNER_KERNEL)
def dot(a: Vec3, b: Vec3) -> float:
    """Dot product a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(**INNER_KERNEL)
def cross(a: Vec3, b: Vec3) -> Vec3:
    """Cross product a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


# Matrices, 3 × 3.


@njit(**INNER_KERNEL)
def transposed(M: Mat3) -> Mat3:
    """Transposed matrix Mᵀ; its rows are the columns of M."""
    return (M[0][0], M[1][0], M[2][0]), (M[0][1], M[1][1], M[2][1]), (M[0][2], M[1][2], M[2][2])


@njit(**INNER_KERNEL)
def matvec(M: Mat3, a: Vec3) -> Vec3:
    """Product M a of a matrix, such as a rotation, and a vector."""
    return dot(M[0], a), dot(M[1], a), dot(M[2], a)


@njit(**INNER_KERNEL)
def matmul(A: Mat3, B: Mat3) -> Mat3:
    """Product A B of two matrices: each of its rows is Bᵀ times that row of A."""
    columns = transposed(B)
    return matvec(columns, A[0]), matvec(columns, A[1]), matvec(columns, A[2])


@njit(**INNER_KERNEL)
def scale_matrix(k: float, M: Mat3) -> Mat3:
    """Matrix k M."""
    return times(k, M[0]), times(k, M[1]), times(k, M[2])


@njit(**INNER_KERNEL)
def rows_cross(M: Mat3, v: Vec3) -> Mat3:
    """Product M [v]×: each row of M crossed with v."""
    return cross(M[0], v), cross(M[1], v), cross(M[2], v)


# Rotations: unit quaternions.


@njit(**INNER_KERNEL)
def inverse(q: Quaternion) -> Quaternion:
    """The inverse rotation of a unit quaternion: its conjugate."""
    return q[0], -q[1], -q[2], -q[3]


@njit(**INNER_KERNEL)
def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product a b: first rotation b, then a."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@njit(error_model="numpy", **INNER_KERNEL)
def normalized(q: Quaternion) -> Quaternion:
    """Unit quaternion of the same direction as q."""
    size = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] / size, q[1] / size, q[2] / size, q[3] / size


@njit(**INNER_KERNEL)
def apply(q: Quaternion, a: Vec3) -> Vec3:
    """Vector a rotated by a unit quaternion (w, v): a + 2 (w (v × a) + v × (v × a)), with v its part (x, y, z)."""
    axis = (q[1], q[2], q[3])  # v
    once = cross(axis, a)  # v × a
    return plus(a, times(2.0, plus(times(q[0], once), cross(axis, once))))


@njit(**INNER_KERNEL)
def exp(phi: Vec3, small_rad: float = SMALL_RAD) -> Quaternion:
    """Unit quaternion of a rotation vector, rad: (cos θ/2, φ sin(θ/2) / θ), θ = |φ|.

    Below `small_rad` the quotient is its series 1/2 - θ²/48, which differs from it by rounding alone up to `SMALL_RAD`.
    The estimators of feet switch at another angle than the simulation; each keeps its digits.
    """
    square = dot(phi, phi)
    half = 0.5 * math.sqrt(square)  # θ/2
    k = 0.5 - square / 48.0 if half < 0.5 * small_rad else 0.5 * math.sin(half) / half  # sin(θ/2) / θ
    return math.cos(half), k * phi[0], k * phi[1], k * phi[2]


@njit(**INNER_KERNEL)
def log(q: Quaternion) -> Vec3:
    """Rotation vector of a unit quaternion, rad, of at most half a turn: θ / sin(θ/2) times its part (x, y, z).

    Below `SMALL_RAD` the factor is its series 2 + sin²(θ/2) / 3.
    """
    sign = 1.0 if q[0] >= 0.0 else -1.0  # q and -q are one rotation; the one with w ≥ 0 turns by at most half a turn
    axis = (sign * q[1], sign * q[2], sign * q[3])
    sine = math.sqrt(dot(axis, axis))  # sin(θ/2)
    k = 2.0 + sine * sine / 3.0 if sine < 0.5 * SMALL_RAD else 2.0 * math.atan2(sine, sign * q[0]) / sine
    return times(k, axis)


@njit(**INNER_KERNEL)
def to_matrix(q: Quaternion) -> Mat3:
    """Rotation matrix of a unit quaternion."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


@njit(**INNER_KERNEL)
def rotation_about(axis: Vec3, angle: float) -> Mat3:
    """Rotation matrix about a unit axis by an angle, rad: cos θ 1 + sin θ [a]× + (1 - cos θ) a aᵀ (Rodrigues)."""
    x, y, z = axis
    cos, sin = math.cos(angle), math.sin(angle)
    versine = 1.0 - cos
    return (
        (cos + versine * x * x, versine * x * y - sin * z, versine * x * z + sin * y),
        (versine * x * y + sin * z, cos + versine * y * y, versine * y * z - sin * x),
        (versine * x * z - sin * y, versine * y * z + sin * x, cos + versine * z * z),
    )


@njit(**INNER_KERNEL)
def apply_left_jacobian(phi: Vec3, v: Vec3) -> Vec3:
    """Γ₁(φ) v = v + (1 − cos θ)/θ² φ×v + (θ − sin θ)/θ³ φ×(φ×v) (Barfoot 2017, eq. 7.37).

    Γ₁(φ) = ∫ Exp(s φ) ds over s from 0 to 1 is the left Jacobian of SO(3): Exp(φ + δ) = Exp(Γ₁(φ) δ) Exp(φ) to the
    first order. `phi` is the rotation vector φ in rad, θ = |φ|. Below `SMALL_RAD` both quotients are their series.
    """
    theta = math.sqrt(dot(phi, phi))
    if theta < SMALL_RAD:
        a, b = 0.5 - theta**2 / 24, 1 / 6 - theta**2 / 120
    else:
        a, b = (1 - math.cos(theta)) / theta**2, (theta - math.sin(theta)) / theta**3
    once = cross(phi, v)  # φ×v
    return plus(v, plus(times(a, once), times(b, cross(phi, once))))


@njit(**INNER_KERNEL)
def apply_inverse_left_jacobian(phi: Vec3, v: Vec3) -> Vec3:
    """Γ₁(φ)⁻¹ v = v − φ×v/2 + c φ×(φ×v), c = (1 − (θ/2) cot(θ/2)) / θ² (Barfoot 2017, eq. 7.37).

    Γ₁(φ) is the left Jacobian of SO(3) at the rotation vector φ (`phi`, rad), θ = |φ|. Below `SMALL_RAD`, c is its
    series.
    """
    theta = math.sqrt(dot(phi, phi))
    half = 0.5 * theta
    c = 1 / 12 + theta**2 / 720 if theta < SMALL_RAD else (1 - half / math.tan(half)) / theta**2
    once = cross(phi, v)  # φ×v
    return plus(minus(v, times(0.5, once)), times(c, cross(phi, once)))
