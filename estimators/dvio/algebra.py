"""Products of small matrices, for arrays of many and for the compiled kernels; rotations are in `estimators/so3.py`."""

from __future__ import annotations

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.streams.samples import Array


def matvec(M: Array, v: Array) -> Array:
    """(..., 3) products of matrices (..., 3, 3) and vectors (..., 3)."""
    return np.asarray((M @ v[..., None])[..., 0])


# Sums may be taken in any order, so that they run on vector units; NaN and infinity keep their meaning.
REORDERED = {"reassoc", "contract", "nsz"}


@njit(error_model="numpy", **INSIDE)
def mul(A: Array, B: Array) -> Array:
    """(n, m) product of (n, k) and (k, m); faster than BLAS for small matrices."""
    n, k, m = A.shape[0], A.shape[1], B.shape[1]
    C = np.zeros((n, m))
    for i in range(n):
        for j in range(k):
            a = A[i, j]
            for l in range(m):
                C[i, l] += a * B[j, l]
    return C


@njit(error_model="numpy", **INSIDE)
def put(M: Array, row: int, column: int, block: Array, times: float) -> None:
    """Writes a block, multiplied by a number, into a matrix; faster than a slice."""
    for i in range(block.shape[0]):
        for j in range(block.shape[1]):
            M[row + i, column + j] = times * block[i, j]


@njit(error_model="numpy", **INSIDE)
def sparse_mul(F: Array, P: Array) -> Array:
    """(n, m) product of (n, k) and (k, m) that skips the zeros of F."""
    n, k, m = F.shape[0], F.shape[1], P.shape[1]
    C = np.zeros((n, m))
    for i in range(n):
        for j in range(k):
            f = F[i, j]
            if f != 0.0:
                for l in range(m):
                    C[i, l] += f * P[j, l]
    return C


@njit(error_model="numpy", **INSIDE)
def propagated(F: Array, P: Array) -> Array:
    """(n, n) F P Fᵀ of a symmetric P."""
    return sparse_mul(F, np.ascontiguousarray(sparse_mul(F, P).T))


@njit(error_model="numpy", **INSIDE)
def rotate(R: Array, v: Array) -> Array:
    """(3,) R v."""
    w = np.empty(3)
    for i in range(3):
        w[i] = R[i, 0] * v[0] + R[i, 1] * v[1] + R[i, 2] * v[2]
    return w


@njit(error_model="numpy", **INSIDE)
def rotate_back(R: Array, v: Array) -> Array:
    """(3,) Rᵀ v."""
    w = np.empty(3)
    for i in range(3):
        w[i] = R[0, i] * v[0] + R[1, i] * v[1] + R[2, i] * v[2]
    return w
