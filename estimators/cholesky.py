"""Systems of linear equations with a symmetric, positive definite matrix, for compiled code."""

from __future__ import annotations

import math

from numba import njit

from stridetwin.estimators.compiled import INNER_KERNEL
from stridetwin.estimators.matrices import REORDERED
from stridetwin.streams.samples import Array


@njit(fastmath=REORDERED, error_model="numpy", **INNER_KERNEL)
def factorise(L: Array, size: int) -> bool:
    """Cholesky factor of the leading `size` rows, in place in the lower triangle; False where there is none.

    Four rows at a time, so that their common factor is read once; faster than LAPACK at this size.
    """
    for j in range(size):
        a = L[j]
        d = a[j]
        for k in range(j):
            d -= a[k] * a[k]
        if not d > 0.0:
            return False
        d = math.sqrt(d)
        a[j] = d
        i = j + 1
        while i + 3 < size:
            w, x, y, z = L[i], L[i + 1], L[i + 2], L[i + 3]
            dw, dx, dy, dz = w[j], x[j], y[j], z[j]
            for k in range(j):
                dw -= w[k] * a[k]
                dx -= x[k] * a[k]
                dy -= y[k] * a[k]
                dz -= z[k] * a[k]
            w[j], x[j], y[j], z[j] = dw / d, dx / d, dy / d, dz / d
            i += 4
        for r in range(i, size):
            w = L[r]
            dw = w[j]
            for k in range(j):
                dw -= w[k] * a[k]
            w[j] = dw / d
    return True


@njit(fastmath=REORDERED, error_model="numpy", **INNER_KERNEL)
def solve(A: Array, b: Array, size: int, damping: float, L: Array, x: Array) -> bool:
    """Solves A x = b for the first `size` unknowns, with a damped diagonal.

    Args:
        A: (N, N) matrix, of which the lower triangle is read.
        b: (N,) right-hand side.
        size: Number of unknowns.
        damping: Share of the diagonal that is added to it.
        L: (N, N) written: Cholesky factor, lower triangle.
        x: (N,) written: the solution.

    Returns:
        False where A is not positive definite.
    """
    for i in range(size):
        for j in range(i):
            L[i, j] = A[i, j]
        L[i, i] = A[i, i] * (1.0 + damping) + 1e-9
    if not factorise(L, size):
        return False
    for i in range(size):
        s = b[i]
        for k in range(i):
            s -= L[i, k] * x[k]
        x[i] = s / L[i, i]
    for i in range(size - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, size):
            s -= L[k, i] * x[k]
        x[i] = s / L[i, i]
    return True
