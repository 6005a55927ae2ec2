"""Quaternions and 3-vectors for the compiled kernel (Hamilton, scalar first)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.streams.samples import Array


@njit(**INSIDE)
def rotation_matrix(q: Array) -> Array:
    """(3, 3) matrix of the unit quaternion (4,)."""
    w, x, y, z = q
    R = np.empty((3, 3))
    R[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    R[0, 1] = 2.0 * (x * y - w * z)
    R[0, 2] = 2.0 * (x * z + w * y)
    R[1, 0] = 2.0 * (x * y + w * z)
    R[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    R[1, 2] = 2.0 * (y * z - w * x)
    R[2, 0] = 2.0 * (x * z - w * y)
    R[2, 1] = 2.0 * (y * z + w * x)
    R[2, 2] = 1.0 - 2.0 * (x * x + y * y)
    return R


@njit(**INSIDE)
def product(a: Array, b: Array) -> Array:
    """Unit quaternion (4,) of a ⊗ b, normalised."""
    c = np.empty(4)
    c[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    c[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    c[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    c[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    return c / math.sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2] + c[3] * c[3])


@njit(**INSIDE)
def exponential(x: float, y: float, z: float) -> Array:
    """Unit quaternion (4,) of the rotation vector (x, y, z), rad."""
    angle = math.sqrt(x * x + y * y + z * z)
    q = np.empty(4)
    q[0] = math.cos(0.5 * angle)
    s = 0.5 - angle * angle / 48.0 if angle < 1e-4 else math.sin(0.5 * angle) / angle
    q[1], q[2], q[3] = s * x, s * y, s * z
    return q


@njit(**INSIDE)
def force_at_middle(f: Array, x: float, y: float, z: float) -> Array:
    """(3,) force at the middle of a rotation by (x, y, z) rad with the velocity change of the constant `f` over it.

    The velocity changes by Γ₁(φ) f dt, Γ₁ the left Jacobian of SO(3), which is Exp(φ/2) (1 + [φ]x²/24) to the second
    order (Barfoot 2017, ch. 7).
    """
    along = (x * f[0] + y * f[1] + z * f[2]) / 24.0
    less = 1.0 - (x * x + y * y + z * z) / 24.0
    return np.array([less * f[0] + along * x, less * f[1] + along * y, less * f[2] + along * z])


@njit(**INSIDE)
def skew(v: Array) -> Array:
    """(3, 3) matrix whose product with a vector is v × that vector."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
