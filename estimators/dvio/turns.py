"""Rotations of many at once, as arrays; `algebra` has those for the compiled kernels."""

from __future__ import annotations

import numpy as np

from stridetwin.streams.samples import Array


def skews(v: Array) -> Array:
    """(..., 3, 3) matrices whose product with a vector is v × that vector, of (..., 3)."""
    M = np.zeros((*v.shape, 3))
    M[..., 2, 1], M[..., 0, 2], M[..., 1, 0] = v[..., 0], v[..., 1], v[..., 2]
    return np.asarray(M - np.swapaxes(M, -1, -2))


def exponentials(v: Array) -> Array:
    """(..., 3, 3) rotations by vectors (..., 3), rad."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    X = skews(v)
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * X + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (X @ X))


def turned(M: Array, v: Array) -> Array:
    """(..., 3) products of matrices (..., 3, 3) and vectors (..., 3)."""
    return np.asarray((M @ v[..., None])[..., 0])
