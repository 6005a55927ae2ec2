"""Rotations of stacked arrays: elementary matrices, Euler angles (yaw, pitch, roll) and quaternions (w, x, y, z)."""

from __future__ import annotations

import numba
import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.sim.kinematics.quaternions import mat3, matrix, of_matrix, put, quaternion, store
from stridetwin.streams.samples import Array


def rot_x(angle: Array) -> Array:
    """(..., 3, 3) rotation about x by (...) rad."""
    c, s, o, i = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return _rows((i, o, o), (o, c, -s), (o, s, c))


def rot_y(angle: Array) -> Array:
    """(..., 3, 3) rotation about y by (...) rad."""
    c, s, o, i = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return _rows((c, o, s), (o, i, o), (-s, o, c))


def rot_z(angle: Array) -> Array:
    """(..., 3, 3) rotation about z by (...) rad."""
    c, s, o, i = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return _rows((c, -s, o), (s, c, o), (o, o, i))


def from_euler(yaw_pitch_roll: Array) -> Array:
    """(..., 3, 3) matrix Rz(yaw) Ry(pitch) Rx(roll) of (..., 3) angles; pitch positive nose down."""
    y, p, r = (yaw_pitch_roll[..., i] for i in range(3))
    return rot_z(y) @ rot_y(p) @ rot_x(r)


def between(R_a: Array, R_b: Array, share: Array) -> Array:
    """(N, 3, 3) rotations on the shortest path from one (3, 3) matrix to another, at (N,) shares of it."""
    turn = Rotation.from_matrix(R_a.T @ R_b).as_rotvec()
    return R_a @ Rotation.from_rotvec(share[:, None] * turn).as_matrix()


def euler_rates_to_body(yaw_pitch_roll: Array, rates: Array) -> Array:
    """(..., 3) angular rate in body axes of a frame whose yaw, pitch, roll have the (..., 3) `rates`."""
    _, p, r = (yaw_pitch_roll[..., i] for i in range(3))
    dy, dp, dr = (rates[..., i] for i in range(3))
    sp, cp, sr, cr = np.sin(p), np.cos(p), np.sin(r), np.cos(r)
    return np.stack([dr - sp * dy, cr * dp + cp * sr * dy, -sr * dp + cp * cr * dy], -1)


def euler_accelerations_to_body(yaw_pitch_roll: Array, rates: Array, accelerations: Array) -> Array:
    """(..., 3) time derivative of `euler_rates_to_body`."""
    _, p, r = (yaw_pitch_roll[..., i] for i in range(3))
    dy, dp, dr = (rates[..., i] for i in range(3))
    sp, cp, sr, cr = np.sin(p), np.cos(p), np.sin(r), np.cos(r)
    of_rates = np.stack(
        [
            -cp * dp * dy,
            -sr * dr * dp + (-sp * dp * sr + cp * cr * dr) * dy,
            -cr * dr * dp + (-sp * dp * cr - cp * sr * dr) * dy,
        ],
        -1,
    )
    return euler_rates_to_body(yaw_pitch_roll, accelerations) + of_rates


def cross(a: Array, b: Array) -> Array:
    """(..., 3) cross product of (..., 3) and (..., 3) vectors; several times faster than NumPy's on short stacks."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out


def quat_from_matrix(R: Array) -> Array:
    """(..., 4) unit quaternions (w, x, y, z), w >= 0, of (..., 3, 3) matrices."""
    return _quaternions(np.ascontiguousarray(R, dtype=float).reshape(-1, 3, 3)).reshape(*R.shape[:-2], 4)


@numba.njit(cache=True)
def _quaternions(R: Array) -> Array:
    q = np.empty((len(R), 4))
    for i in range(len(R)):
        store(of_matrix(mat3(R[i])), q[i])
    return q


def matrix_from_quat(q: Array) -> Array:
    """(..., 3, 3) matrices of (..., 4) unit quaternions (w, x, y, z)."""
    return _matrices(np.ascontiguousarray(q, dtype=float).reshape(-1, 4)).reshape(*q.shape[:-1], 3, 3)


@numba.njit(cache=True)
def _matrices(q: Array) -> Array:
    R = np.empty((len(q), 3, 3))
    for i in range(len(q)):
        M = matrix(quaternion(q[i]))
        for k in range(3):
            put(M[k], R[i, k])
    return R


def _rows(*rows: tuple[Array, Array, Array]) -> Array:
    out = np.empty((*np.shape(rows[0][0]), 3, 3))
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            out[..., i, j] = entry
    return out
