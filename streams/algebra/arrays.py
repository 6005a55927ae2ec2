"""Rotations of stacked NumPy arrays: matrices, rotation vectors, Euler angles (yaw, pitch, roll), quaternions (wxyz).

A rotation is a matrix (..., 3, 3): its inverse is the transpose, the product of two is `@`. A pure stack operation
costs some 10 µs of NumPy; compiled code uses `tuples` and `matrices`, one rotation at a time.
"""

from __future__ import annotations

import numpy as np

from stridetwin.streams.samples import Array


def hat(v: Array) -> Array:
    """(..., 3, 3) skew-symmetric matrices [v]× of vectors v (..., 3): [v]× w = v × w."""
    M = np.zeros((*v.shape, 3))
    M[..., 2, 1], M[..., 0, 2], M[..., 1, 0] = v[..., 0], v[..., 1], v[..., 2]
    # the other three entries are the negative transpose of these
    return np.asarray(M - np.swapaxes(M, -1, -2))


def exp(v: Array) -> Array:
    """(..., 3, 3) rotation matrices of rotation vectors v (..., 3), rad.

    Rodrigues' formula with θ = |v|: R = I + sin θ / θ [v]× + (1 - cos θ) / θ² [v]×², where
    (1 - cos θ) / θ² = 1/2 sinc²(θ / 2) has no division by 0.
    """
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    X = hat(v)
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * X + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (X @ X))


def log(R: Array) -> Array:
    """(..., 3) rotation vectors, rad, of length ≤ π, of (..., 3, 3) rotation matrices."""
    from scipy.spatial.transform import Rotation  # takes long to import, and few callers need it

    rotation_vectors = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec()  # SciPy takes a stack of one axis alone
    return np.asarray(rotation_vectors).reshape(R.shape[:-1])


def rot_x(angle: Array) -> Array:
    """(..., 3, 3) rotation about x by (...) rad."""
    # cosine, sine, and arrays of zeros and ones of the same shape
    c, s, o, i = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return _stack_rows((i, o, o), (o, c, -s), (o, s, c))


def rot_y(angle: Array) -> Array:
    """(..., 3, 3) rotation about y by (...) rad."""
    # cosine, sine, and arrays of zeros and ones of the same shape
    c, s, o, i = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return _stack_rows((c, o, s), (o, i, o), (-s, o, c))


def rot_z(angle: Array) -> Array:
    """(..., 3, 3) rotation about z by (...) rad."""
    # cosine, sine, and arrays of zeros and ones of the same shape
    c, s, o, i = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return _stack_rows((c, -s, o), (s, c, o), (o, o, i))


def from_euler(yaw_pitch_roll: Array) -> Array:
    """(..., 3, 3) matrix Rz(yaw) Ry(pitch) Rx(roll) of (..., 3) angles in rad; pitch positive nose down."""
    yaw, pitch, roll = (yaw_pitch_roll[..., i] for i in range(3))
    return rot_z(yaw) @ rot_y(pitch) @ rot_x(roll)


def slerp(R_a: Array, R_b: Array, share: Array) -> Array:
    """(N, 3, 3) rotations R_a exp(share · log(R_aᵀ R_b)): from R_a (share 0) to R_b (share 1) on the shortest path.

    Args:
        R_a: (3, 3) rotation.
        R_b: (3, 3) rotation.
        share: (N,) parts of the rotation from R_a to R_b.
    """
    from scipy.spatial.transform import Rotation  # takes long to import, and few callers need it

    rotation = log(R_a.T @ R_b)  # (3,) rad, rotation vector from R_a to R_b in the axes of R_a
    return R_a @ Rotation.from_rotvec(share[:, None] * rotation).as_matrix()


def euler_rates_to_body(yaw_pitch_roll: Array, rates: Array) -> Array:
    """(..., 3) angular rate in body axes, rad/s, of the frame Rz(yaw) Ry(pitch) Rx(roll) while its angles change.

    Args:
        yaw_pitch_roll: (..., 3) rad.
        rates: (..., 3) their derivatives, rad/s.
    """
    _, p, r = (yaw_pitch_roll[..., i] for i in range(3))  # pitch and roll; the rate in body axes is free of the yaw
    dy, dp, dr = (rates[..., i] for i in range(3))  # derivatives of yaw, pitch, roll
    sp, cp, sr, cr = np.sin(p), np.cos(p), np.sin(r), np.cos(r)
    return np.stack([dr - sp * dy, cr * dp + cp * sr * dy, -sr * dp + cp * cr * dy], -1)


def euler_accelerations_to_body(yaw_pitch_roll: Array, rates: Array, accelerations: Array) -> Array:
    """(..., 3) angular acceleration in body axes, rad/s², of a frame with given yaw, pitch, roll (..., 3).

    It is the derivative of the angular rate of `euler_rates_to_body`, which is linear in the rates: the same function
    of the second derivatives, plus the terms in which its coefficients change.

    Args:
        yaw_pitch_roll: (..., 3) rad.
        rates: (..., 3) their first derivatives, rad/s.
        accelerations: (..., 3) their second derivatives, rad/s².
    """
    _, p, r = (yaw_pitch_roll[..., i] for i in range(3))  # pitch and roll
    dy, dp, dr = (rates[..., i] for i in range(3))  # derivatives of yaw, pitch, roll
    sp, cp, sr, cr = np.sin(p), np.cos(p), np.sin(r), np.cos(r)
    from_coefficients = np.stack(
        [
            -cp * dp * dy,
            -sr * dr * dp + (-sp * dp * sr + cp * cr * dr) * dy,
            -cr * dr * dp + (-sp * dp * cr - cp * sr * dr) * dy,
        ],
        -1,
    )
    return euler_rates_to_body(yaw_pitch_roll, accelerations) + from_coefficients


def cross(a: Array, b: Array) -> Array:
    """(..., 3) cross product of (..., 3) and (..., 3) vectors; several times faster than NumPy's on short stacks."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # each component, and the two after it in cyclic order
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out


def matvec(M: Array, v: Array) -> Array:
    """(..., n) products of matrices (..., n, m), such as rotations, and vectors (..., m)."""
    return np.asarray((M @ v[..., None])[..., 0])


def to_quaternion(R: Array) -> Array:
    """(..., 4) unit quaternions (w, x, y, z), w >= 0, of (..., 3, 3) rotation matrices.

    Of the four multiples of the quaternion that are linear in R, the longest is made unit (Shepperd 1978).
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(np.asarray(R, dtype=float), (-2, -1), (0, 1))
    trace = xx + yy + zz
    rows = np.empty((*np.shape(xx), 4, 4))  # row i is the quaternion times 4 |q_i|
    rows[..., 0, 0], rows[..., 1, 1] = 1.0 + trace, 1.0 + 2.0 * xx - trace
    rows[..., 2, 2], rows[..., 3, 3] = 1.0 + 2.0 * yy - trace, 1.0 + 2.0 * zz - trace
    rows[..., 0, 1] = rows[..., 1, 0] = zy - yz
    rows[..., 0, 2] = rows[..., 2, 0] = xz - zx
    rows[..., 0, 3] = rows[..., 3, 0] = yx - xy
    rows[..., 1, 2] = rows[..., 2, 1] = xy + yx
    rows[..., 1, 3] = rows[..., 3, 1] = xz + zx
    rows[..., 2, 3] = rows[..., 3, 2] = yz + zy
    # (...) number of the longest row, that of the largest |q_i|: for example, 4 w² = 1 + trace is more than
    # 4 x² = 1 + 2 xx - trace where trace > xx
    largest = np.argmax(np.stack([trace, xx, yy, zz], axis=-1), axis=-1)
    q = np.take_along_axis(rows, largest[..., None, None], axis=-2)[..., 0, :]  # (..., 4) that row
    square = q * q
    size = np.sqrt(square[..., 0] + square[..., 1] + square[..., 2] + square[..., 3])
    return np.asarray(np.copysign(1.0 / size, q[..., 0])[..., None] * q)  # unit length, with the sign that makes w ≥ 0


def from_quaternion(q: Array) -> Array:
    """(..., 3, 3) rotation matrices of (..., 4) unit quaternions (w, x, y, z)."""
    w, x, y, z = np.moveaxis(np.asarray(q, dtype=float), -1, 0)
    return _stack_rows(
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def apply_quaternion(q: Array, v: Array) -> Array:
    """(N, 3) vectors (N, 3) rotated by unit quaternions (N, 4) w, x, y, z: v + 2 w (u × v) + 2 u × (u × v), u = xyz."""
    w, u = q[:, :1], q[:, 1:]
    twice = 2.0 * np.cross(u, v)
    return v + w * twice + np.cross(u, twice)


def _stack_rows(*rows: tuple[Array, Array, Array]) -> Array:
    """(..., 3, 3) matrices from three rows of three entries, each an array (...)."""
    out = np.empty((*np.shape(rows[0][0]), 3, 3))
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            out[..., i, j] = entry
    return out
