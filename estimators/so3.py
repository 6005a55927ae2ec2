"""Rotations, SO(3), for compiled code: a rotation is a (3, 3) matrix.

`hat`, `exp`, `log` and the Jacobians as in Solà, Deray and Atchuthan 2018 (A micro Lie theory).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

_SMALL = 1e-5  # rad; smaller angles use series


@njit(error_model="numpy", **INNER_KERNEL)
def hat(v: Array) -> Array:
    """(3, 3) matrix whose product with a vector is v × that vector."""
    M = np.zeros((3, 3))
    M[0, 1], M[0, 2], M[1, 2] = -v[2], v[1], -v[0]
    M[1, 0], M[2, 0], M[2, 1] = v[2], -v[1], v[0]
    return M


@njit(error_model="numpy", **INNER_KERNEL)
def exp(v: Array) -> Array:
    """(3, 3) rotation by the vector v, rad."""
    t2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    t = math.sqrt(t2)
    if t < _SMALL:
        return _series(v, 1.0, 1.0 - t2 / 6.0, 0.5 - t2 / 24.0)
    return _series(v, 1.0, math.sin(t) / t, (1.0 - math.cos(t)) / t2)


@njit(error_model="numpy", **INNER_KERNEL)
def log(R: Array) -> Array:
    """(3,) rotation vector of a rotation matrix, rad, of length ≤ π."""
    v = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    s = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    c = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    t = math.atan2(s, c)
    if s > 1e-7:
        return v * (t / s)
    if c > 0.0:
        return v
    # rotation by π: R = 2 a aᵀ − 1
    k = 0
    for i in range(1, 3):
        if R[i, i] > R[k, k]:
            k = i
    a = R[:, k].copy()
    a[k] += 1.0
    return a * (math.pi / math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]))


@njit(error_model="numpy", **INNER_KERNEL)
def right_jacobian(v: Array) -> Array:
    """(3, 3) Jr with Exp(v + d) = Exp(v) Exp(Jr d) to the first order."""
    t2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    t = math.sqrt(t2)
    if t < 1e-4:
        return _series(v, 1.0, -0.5 + t2 / 24.0, 1.0 / 6.0 - t2 / 120.0)
    return _series(v, 1.0, -(1.0 - math.cos(t)) / t2, (t - math.sin(t)) / (t2 * t))


@njit(error_model="numpy", **INNER_KERNEL)
def right_jacobian_inverse(v: Array) -> Array:
    """(3, 3) inverse of `right_jacobian`, for |v| < 2π."""
    t2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    t = math.sqrt(t2)
    if t < 1e-4:
        return _series(v, 1.0, 0.5, 1.0 / 12.0 + t2 / 720.0)
    return _series(v, 1.0, 0.5, 1.0 / t2 - (1.0 + math.cos(t)) / (2.0 * t * math.sin(t)))


@njit(error_model="numpy", **INNER_KERNEL)
def _series(v: Array, a: float, b: float, c: float) -> Array:
    """(3, 3) a 1 + b [v]x + c [v]x²."""
    x, y, z = v
    M = np.empty((3, 3))
    xx, yy, zz = x * x, y * y, z * z
    M[0, 0], M[1, 1], M[2, 2] = a - c * (yy + zz), a - c * (xx + zz), a - c * (xx + yy)
    M[0, 1], M[1, 0] = c * x * y - b * z, c * x * y + b * z
    M[0, 2], M[2, 0] = c * x * z + b * y, c * x * z - b * y
    M[1, 2], M[2, 1] = c * y * z - b * x, c * y * z + b * x
    return M
