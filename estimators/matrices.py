"""Small matrices, for arrays of many and for the compiled kernels; rotations are in `estimators/so3.py`.

All arrays of the kernels are C-contiguous: each function below is then compiled once. A slice assignment, an array
expression or a function of `np.linalg` takes 50 ms to two seconds to compile, a loop 10 ms.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array


def matvec(M: Array, v: Array) -> Array:
    """(..., 3) products of matrices (..., 3, 3) and vectors (..., 3)."""
    return np.asarray((M @ v[..., None])[..., 0])


# Sums may be taken in any order, so that they run on vector units; NaN and infinity keep their meaning.
REORDERED = {"reassoc", "contract", "nsz"}


@njit(error_model="numpy", **INNER_KERNEL)
def vec3() -> Array:
    """(3,) array whose entries are not set."""
    return np.empty(3)


@njit(error_model="numpy", **INNER_KERNEL)
def mat3() -> Array:
    """(3, 3) array whose entries are not set."""
    return np.empty((3, 3))


@njit(error_model="numpy", **INNER_KERNEL)
def identity(n: int) -> Array:
    """(n, n) identity matrix."""
    M = np.zeros((n, n))
    for i in range(n):
        M[i, i] = 1.0
    return M


@njit(error_model="numpy", **INNER_KERNEL)
def clear(v: Array) -> None:
    """Sets a vector (N,) to 0."""
    for i in range(v.shape[0]):
        v[i] = 0.0


@njit(error_model="numpy", **INNER_KERNEL)
def clear_block(M: Array, n: int) -> None:
    """Sets the first n rows and columns of a matrix to 0."""
    for i in range(n):
        for j in range(n):
            M[i, j] = 0.0


@njit(error_model="numpy", **INNER_KERNEL)
def copy(v: Array, out: Array) -> None:
    """Copies a vector (N,) into `out`."""
    for i in range(v.shape[0]):
        out[i] = v[i]


@njit(error_model="numpy", **INNER_KERNEL)
def copy_matrix(M: Array, out: Array) -> None:
    """Copies a matrix (N, M) into `out`."""
    for i in range(M.shape[0]):
        for j in range(M.shape[1]):
            out[i, j] = M[i, j]


@njit(error_model="numpy", **INNER_KERNEL)
def transposed(M: Array) -> Array:
    """(m, n) transpose of (n, m)."""
    T = np.empty((M.shape[1], M.shape[0]))
    for i in range(M.shape[0]):
        for j in range(M.shape[1]):
            T[j, i] = M[i, j]
    return T


@njit(error_model="numpy", **INNER_KERNEL)
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


@njit(error_model="numpy", **INNER_KERNEL)
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


@njit(error_model="numpy", **INNER_KERNEL)
def transform_covariance(F: Array, P: Array) -> Array:
    """(n, n) product F P Fᵀ with a symmetric P."""
    return sparse_mul(F, transposed(sparse_mul(F, P)))


@njit(error_model="numpy", **INNER_KERNEL)
def dot(a: Array, b: Array) -> float:
    """Product of two vectors (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(error_model="numpy", **INNER_KERNEL)
def rotate(R: Array, v: Array) -> Array:
    """(3,) product R v."""
    w = vec3()
    for i in range(3):
        w[i] = R[i, 0] * v[0] + R[i, 1] * v[1] + R[i, 2] * v[2]
    return w


@njit(error_model="numpy", **INNER_KERNEL)
def rotate_back(R: Array, v: Array) -> Array:
    """(3,) product Rᵀ v."""
    w = vec3()
    for i in range(3):
        w[i] = R[0, i] * v[0] + R[1, i] * v[1] + R[2, i] * v[2]
    return w


@njit(error_model="numpy", **INNER_KERNEL)
def inverse(M: Array) -> Array:
    """(n, n) inverse of M."""
    return np.linalg.inv(M)  # type: ignore[return-value]
