"""Matrices as arrays, for compiled code: rotations (3, 3), products of any size, and linear equations.

All arrays are C-contiguous: each function is then compiled once. A slice assignment, an array expression or a function
of `np.linalg` takes 50 ms to two seconds to compile, a loop 10 ms. `hat`, `exp`, `log` and the Jacobians are as in
Solà, Deray and Atchuthan 2018 (A micro Lie theory).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

REORDERED = {"reassoc", "contract", "nsz"}
"""Sums may be taken in any order, so that they run on vector units; NaN and infinity keep their meaning."""
_SMALL = 1e-5  # rad; smaller angles use series


@njit(error_model="numpy", **INNER_KERNEL)
def empty_vec3() -> Array:
    """(3,) array whose entries are not set."""
    return np.empty(3)


@njit(error_model="numpy", **INNER_KERNEL)
def empty_mat3() -> Array:
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
def clear_matrix(M: Array) -> None:
    """Sets a matrix (n, m) to 0."""
    for i in range(M.shape[0]):
        for j in range(M.shape[1]):
            M[i, j] = 0.0


@njit(error_model="numpy", **INNER_KERNEL)
def clear_block(M: Array, n: int) -> None:
    """Sets the (n, n) block at the upper left of a matrix to 0; the other entries stay."""
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
    """Copies a matrix (n, m) into `out`."""
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
def multiply(A: Array, B: Array) -> Array:
    """(n, m) product of (n, k) and (k, m); faster than BLAS for small matrices."""
    C = np.zeros((A.shape[0], B.shape[1]))
    add_product(A, B, C)
    return C


@njit(error_model="numpy", **INNER_KERNEL)
def multiply_into(A: Array, B: Array, out: Array) -> None:
    """Writes the product of (n, k) and (k, m) into `out` (n, m), which is neither of them."""
    clear_matrix(out)
    add_product(A, B, out)


@njit(error_model="numpy", **INNER_KERNEL)
def add_product(A: Array, B: Array, out: Array) -> None:
    """Adds the product of (n, k) and (k, m) to `out` (n, m)."""
    n, k, m = A.shape[0], A.shape[1], B.shape[1]
    for i in range(n):
        for j in range(k):
            a = A[i, j]
            for l in range(m):
                out[i, l] += a * B[j, l]


@njit(error_model="numpy", **INNER_KERNEL)
def add_transposed_product(A: Array, B: Array, out: Array) -> None:
    """Adds Aᵀ B to `out` (n, m), for A (k, n) and B (k, m)."""
    for k in range(A.shape[0]):
        for i in range(A.shape[1]):
            a = A[k, i]
            for j in range(B.shape[1]):
                out[i, j] += a * B[k, j]


@njit(error_model="numpy", **INNER_KERNEL)
def add_transposed_matvec(A: Array, b: Array, out: Array) -> None:
    """Adds Aᵀ b to `out` (n,), for A (k, n) and b (k,)."""
    for k in range(A.shape[0]):
        for i in range(A.shape[1]):
            out[i] += A[k, i] * b[k]


@njit(error_model="numpy", **INNER_KERNEL)
def multiply_sparse(F: Array, P: Array) -> Array:
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
    return multiply_sparse(F, transposed(multiply_sparse(F, P)))


@njit(error_model="numpy", **INNER_KERNEL)
def inverse(M: Array) -> Array:
    """(n, n) inverse of M."""
    return np.linalg.inv(M)  # type: ignore[return-value]


# Vectors and rotations, (3, 3).


@njit(error_model="numpy", **INNER_KERNEL)
def dot(a: Array, b: Array) -> float:
    """Product of two vectors (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(error_model="numpy", **INNER_KERNEL)
def apply(R: Array, v: Array) -> Array:
    """(3,) product R v."""
    w = empty_vec3()
    for i in range(3):
        w[i] = R[i, 0] * v[0] + R[i, 1] * v[1] + R[i, 2] * v[2]
    return w


@njit(error_model="numpy", **INNER_KERNEL)
def apply_inverse(R: Array, v: Array) -> Array:
    """(3,) product Rᵀ v."""
    w = empty_vec3()
    for i in range(3):
        w[i] = R[0, i] * v[0] + R[1, i] * v[1] + R[2, i] * v[2]
    return w


@njit(error_model="numpy", **INNER_KERNEL)
def hat(v: Array) -> Array:
    """(3, 3) skew-symmetric matrix [v]×: its product with a vector w is v × w."""
    M = np.zeros((3, 3))
    M[0, 1], M[0, 2], M[1, 2] = -v[2], v[1], -v[0]
    M[1, 0], M[2, 0], M[2, 1] = v[2], -v[1], v[0]
    return M


@njit(error_model="numpy", **INNER_KERNEL)
def exp(v: Array) -> Array:
    """(3, 3) rotation by the vector v, rad: 1 + sin θ / θ [v]× + (1 - cos θ) / θ² [v]×², θ = |v| (Rodrigues).

    For small angles both quotients are their series.
    """
    t2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    t = math.sqrt(t2)  # θ
    if t < _SMALL:
        return _sum_powers_of_hat(v, 1.0, 1.0 - t2 / 6.0, 0.5 - t2 / 24.0)
    return _sum_powers_of_hat(v, 1.0, math.sin(t) / t, (1.0 - math.cos(t)) / t2)


@njit(error_model="numpy", **INNER_KERNEL)
def log(R: Array) -> Array:
    """(3,) rotation vector θ a of a rotation matrix, rad: a is the unit axis, and the angle θ is 0 to π.

    The skew-symmetric part of R gives a sin θ, its trace cos θ.
    """
    v = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])  # a sin θ
    s = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])  # sin θ
    c = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)  # cos θ
    t = math.atan2(s, c)
    if s > 1e-7:
        return v * (t / s)
    if c > 0.0:  # a small angle: θ = sin θ
        return v
    # rotation by π: R = 2 a aᵀ − 1, so the longest column of R + 1 has the direction of a
    k = 0
    for i in range(1, 3):
        if R[i, i] > R[k, k]:
            k = i
    a = R[:, k].copy()
    a[k] += 1.0
    return a * (math.pi / math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]))


@njit(error_model="numpy", **INNER_KERNEL)
def right_jacobian(v: Array) -> Array:
    """(3, 3) Jr with Exp(v + d) = Exp(v) Exp(Jr d) to the first order, v and d in rad.

    Jr = 1 - (1 - cos θ) / θ² [v]× + (θ - sin θ) / θ³ [v]×², θ = |v|. For small angles both quotients are their series.
    """
    t2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    t = math.sqrt(t2)  # θ
    if t < 1e-4:  # the quotients lose digits, as their terms cancel
        return _sum_powers_of_hat(v, 1.0, -0.5 + t2 / 24.0, 1.0 / 6.0 - t2 / 120.0)
    return _sum_powers_of_hat(v, 1.0, -(1.0 - math.cos(t)) / t2, (t - math.sin(t)) / (t2 * t))


@njit(error_model="numpy", **INNER_KERNEL)
def right_jacobian_inverse(v: Array) -> Array:
    """(3, 3) inverse of the right Jacobian of SO(3) at the rotation vector v, |v| < 2π.

    It is 1 + [v]×/2 + (1/θ² - (1 + cos θ) / (2 θ sin θ)) [v]×², θ = |v|; small angles use the series of the factor.
    """
    t2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    t = math.sqrt(t2)  # θ
    if t < 1e-4:  # the factor loses digits, as its terms cancel
        return _sum_powers_of_hat(v, 1.0, 0.5, 1.0 / 12.0 + t2 / 720.0)
    return _sum_powers_of_hat(v, 1.0, 0.5, 1.0 / t2 - (1.0 + math.cos(t)) / (2.0 * t * math.sin(t)))


@njit(error_model="numpy", **INNER_KERNEL)
def _sum_powers_of_hat(v: Array, a: float, b: float, c: float) -> Array:
    """(3, 3) a 1 + b [v]× + c [v]×², where [v]× is the matrix that `hat` returns."""
    x, y, z = v
    M = np.empty((3, 3))
    xx, yy, zz = x * x, y * y, z * z  # of [v]×² = v vᵀ - |v|² 1
    M[0, 0], M[1, 1], M[2, 2] = a - c * (yy + zz), a - c * (xx + zz), a - c * (xx + yy)
    M[0, 1], M[1, 0] = c * x * y - b * z, c * x * y + b * z
    M[0, 2], M[2, 0] = c * x * z + b * y, c * x * z - b * y
    M[1, 2], M[2, 1] = c * y * z - b * x, c * y * z + b * x
    return M


# Linear equations with a symmetric, positive definite matrix.


@njit(**INNER_KERNEL)
def factorise(A: Array, variance: float, L: Array, size: int) -> None:
    """Writes the lower triangle L with L Lᵀ = A + variance · I, of the (size, size) block at the upper left (Cholesky).

    Args:
        A: (n, n) symmetric, of which the lower triangle is read; A + variance · I is positive definite.
        variance: Added to the diagonal.
        L: (n, n) output, of which the lower triangle is written; may be A itself.
        size: Number of leading rows and columns that are used.
    """
    for i in range(size):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            L[i, j] = math.sqrt(s + variance) if i == j else s / L[j, j]


@njit(**INNER_KERNEL)
def factorise_in_place(H: Array) -> None:
    """Overwrites the lower triangle of H (n, n), symmetric and positive definite, by L with L Lᵀ = H (Cholesky)."""
    factorise(H, 0.0, H, len(H))


@njit(**INNER_KERNEL)
def substitute_forward(L: Array, X: Array) -> None:
    """Overwrites X (n, m) by L⁻¹ X, L (n, n) lower triangular; for few unknowns faster than a LAPACK call.

    Row i of L Y = X gives row i of Y from the rows above it.
    """
    for i in range(len(L)):
        for j in range(i):
            for c in range(X.shape[1]):
                X[i, c] -= L[i, j] * X[j, c]
        for c in range(X.shape[1]):
            X[i, c] /= L[i, i]


@njit(**INNER_KERNEL)
def substitute_backward(L: Array, X: Array) -> None:
    """Overwrites X (n, m) by L⁻ᵀ X, L (n, n) lower triangular.

    Row i of Lᵀ Y = X gives row i of Y from the rows below it.
    """
    for i in range(len(L) - 1, -1, -1):
        for j in range(i + 1, len(L)):
            for c in range(X.shape[1]):
                X[i, c] -= L[j, i] * X[j, c]
        for c in range(X.shape[1]):
            X[i, c] /= L[i, i]


@njit(**INNER_KERNEL)
def solve_positive(H: Array, X: Array) -> None:
    """Overwrites X (n, m) by H⁻¹ X, H (n, n) symmetric and positive definite, and H by its Cholesky factor."""
    factorise_in_place(H)
    substitute_forward(H, X)
    substitute_backward(H, X)


@njit(**INNER_KERNEL)
def substitute_forward_in_vector(L: Array, x: Array, size: int) -> None:
    """Overwrites the leading `size` entries of x by L⁻¹ x, L lower triangular."""
    for i in range(size):
        for j in range(i):
            x[i] -= L[i, j] * x[j]
        x[i] /= L[i, i]


@njit(**INNER_KERNEL)
def substitute_backward_in_vector(L: Array, x: Array, size: int) -> None:
    """Overwrites the leading `size` entries of x by L⁻ᵀ x, L lower triangular."""
    for i in range(size - 1, -1, -1):
        for j in range(i + 1, size):
            x[i] -= L[j, i] * x[j]
        x[i] /= L[i, i]


@njit(fastmath=REORDERED, error_model="numpy", **INNER_KERNEL)
def factorise_vectorised(L: Array, size: int) -> bool:
    """Overwrites the lower triangle of a symmetric matrix by its Cholesky factor L, with L Lᵀ equal to the matrix.

    Column by column: below the diagonal, four rows are computed at a time, so that row j, which all of them need, is
    read once; this is faster than LAPACK at such sizes. The sums run in another order than those of `factorise`, so the
    last digits differ.

    Args:
        L: (n, n), of which the lower triangle is read and overwritten.
        size: Number of leading rows and columns that are used.

    Returns:
        Whether there is a factor: false for a matrix that is not positive definite, which is then partly overwritten.
    """
    for j in range(size):
        a = L[j]
        d = a[j]  # becomes L[j, j]
        for k in range(j):
            d -= a[k] * a[k]
        if not d > 0.0:  # negative or 0, and NaN as well
            return False
        d = math.sqrt(d)
        a[j] = d
        # the entries of column j below the diagonal: rows i to i + 3, and then the rest
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
def solve_damped(A: Array, b: Array, size: int, damping: float, L: Array, x: Array) -> bool:
    """Solves (A + damping diag(A)) x = b for the first `size` unknowns, by a Cholesky factorisation.

    Args:
        A: (N, N) symmetric, of which the lower triangle is read.
        b: (N,) right-hand side.
        size: Number of unknowns.
        damping: Factor on the diagonal of A, which is added to A.
        L: (N, N) written: Cholesky factor, lower triangle.
        x: (N,) written: the solution.

    Returns:
        Whether the damped matrix is positive definite; if not, `x` is not written.
    """
    for i in range(size):
        for j in range(i):
            L[i, j] = A[i, j]
        L[i, i] = A[i, i] * (1.0 + damping) + 1e-9  # above 0 also for an unknown that no equation determines
    if not factorise_vectorised(L, size):
        return False
    for i in range(size):  # forward: L y = b, with y in `x`
        s = b[i]
        for k in range(i):
            s -= L[i, k] * x[k]
        x[i] = s / L[i, i]
    for i in range(size - 1, -1, -1):  # backward: Lᵀ x = y
        s = x[i]
        for k in range(i + 1, size):
            s -= L[k, i] * x[k]
        x[i] = s / L[i, i]
    return True
