"""Rotations, matrices and equations of compiled arrays agree with SciPy and NumPy, also next to their limits."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from stridetwin.streams.algebra import matrices
from tests.estimators.from_python import from_python

AXES = [v / np.linalg.norm(v) for v in ([1.0, -2.0, 3.0], [-0.3, 0.2, 0.1], [0.0, 0.0, 1.0])]
ANGLES = [0.0, 1e-9, 0.9e-5, 1.1e-5, 0.9e-4, 1.1e-4, 0.01, 0.7, 2.0, 3.1]
exp, log, hat = from_python(matrices.exp), from_python(matrices.log), from_python(matrices.hat)
right_jacobian, right_jacobian_inverse = (
    from_python(matrices.right_jacobian),
    from_python(matrices.right_jacobian_inverse),
)


def cross_matrix(v):
    """[v]x, a column per unit vector."""
    return np.cross(v, np.eye(3)).T


def test_hat_is_the_cross_product():
    rng = np.random.default_rng(11)
    a, b = rng.normal(size=(2, 3))
    np.testing.assert_allclose(hat(a) @ b, np.cross(a, b), rtol=1e-14)


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_and_log_are_scipys(angle):
    for axis in AXES:
        v = angle * axis
        expected = Rotation.from_rotvec(v).as_matrix()
        np.testing.assert_allclose(exp(v), expected, rtol=0, atol=1e-15)
        np.testing.assert_allclose(log(expected), v, rtol=0, atol=1e-12)


@pytest.mark.parametrize("below", [0.0, 1e-9, 1e-6])
def test_log_of_half_a_rotation(below):
    """Next to π the antisymmetric part vanishes; the largest diagonal element chooses the axis' column."""
    for axis in [*np.eye(3), *AXES, *(np.roll(AXES[1], k) for k in (1, 2)), np.array([0.6, -0.8, 0.0])]:
        R = Rotation.from_rotvec((np.pi - below) * axis).as_matrix()
        v = log(R)
        assert np.linalg.norm(v) == pytest.approx(np.pi - below, abs=2e-9)
        np.testing.assert_allclose(Rotation.from_rotvec(v).as_matrix(), R, atol=1e-7)


@pytest.mark.parametrize("angle", ANGLES)
def test_the_right_jacobian_is_the_integral_of_rotations(angle):
    """Jr = ∫ Exp(-s v) ds over s from 0 to 1: the upper right block of a matrix exponential."""
    for axis in AXES:
        v = angle * axis
        block = np.zeros((6, 6))
        block[:3, :3], block[:3, 3:] = -cross_matrix(v), np.eye(3)
        expected = expm(block)[:3, 3:]
        np.testing.assert_allclose(right_jacobian(v), expected, atol=1e-9)
        np.testing.assert_allclose(right_jacobian_inverse(v), np.linalg.inv(expected), atol=1e-8)


@pytest.mark.parametrize("size", range(1, 12))
def test_solve_is_numpys_and_reads_the_lower_triangle_alone(size):
    """All remainders of the rows that are taken four at a time, in a larger workspace whose rest stays as it is."""
    rng = np.random.default_rng(11)
    solve, rows = from_python(matrices.solve_damped), size + 2
    B = rng.normal(size=(rows, rows + 3))
    A = B @ B.T
    b, L, x = rng.normal(size=rows), np.full((rows, rows), 7.0), np.full(rows, 7.0)
    assert solve(np.tril(A) + np.triu(np.full((rows, rows), np.nan), 1), b, size, 0.25, L, x)
    damped = A[:size, :size] + np.diag(0.25 * np.diag(A)[:size] + 1e-9)
    np.testing.assert_allclose(x[:size], np.linalg.solve(damped, b[:size]), rtol=1e-9)
    np.testing.assert_allclose(np.tril(L[:size, :size]), np.linalg.cholesky(damped), rtol=1e-9)
    assert (x[size:] == 7.0).all()
    assert (L[size:] == 7.0).all()


@pytest.mark.parametrize("bad", [0, 3, 6])
def test_an_indefinite_matrix_has_no_factor(bad):
    A = np.diag(np.where(np.arange(7) == bad, -1.0, 1.0))
    assert not from_python(matrices.solve_damped)(A, np.ones(7), 7, 0.0, np.zeros((7, 7)), np.zeros(7))


def test_small_matrices_are_numpys():
    rng = np.random.default_rng(11)
    A, B, F = rng.normal(size=(4, 3)), rng.normal(size=(3, 5)), rng.normal(size=(5, 4))
    F[1, 2] = F[3, 1] = 0.0
    P = F[:4] @ F[:4].T
    v, w, R = *rng.normal(size=(2, 3)), Rotation.from_rotvec([0.3, -0.4, 0.5]).as_matrix()
    for name, arguments, expected in [
        ("multiply", (A, B), A @ B),
        ("multiply_sparse", (F, A), F @ A),
        ("transform_covariance", (F, P), F @ P @ F.T),
        ("transposed", (A,), A.T),
        ("identity", (3,), np.eye(3)),
        ("dot", (v, w), v @ w),
        ("apply", (R, v), R @ v),
        ("apply_inverse", (R, v), R.T @ v),
    ]:
        got = from_python(getattr(matrices, name))(*(np.ascontiguousarray(a) if np.ndim(a) else a for a in arguments))
        np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-13, err_msg=name)
    out, flat = np.zeros((4, 3)), np.zeros(3)
    from_python(matrices.copy_matrix)(A, out)
    from_python(matrices.copy)(v, flat)
    np.testing.assert_array_equal(out, A)
    np.testing.assert_array_equal(flat, v)
    from_python(matrices.clear)(flat)
    assert not flat.any()
    from_python(matrices.clear_block)(P, 3)
    assert not P[:3, :3].any()
    assert P[3].all()
    assert P[:, 3].all()


@pytest.mark.parametrize("angle", [1e-6, 0.9e-4, 1.1e-4, 0.7, 3.0])
def test_the_right_jacobian_is_the_derivative_of_exp(angle):
    """Log(Exp(v)ᵀ Exp(v + d)) = Jr d, by central differences."""
    step = 1e-6
    for axis in AXES:
        v = angle * axis
        columns = [(log(exp(v).T @ exp(v + d)) - log(exp(v).T @ exp(v - d))) / (2 * step) for d in step * np.eye(3)]
        np.testing.assert_allclose(right_jacobian(v), np.transpose(columns), atol=1e-8)


def test_products_into_an_array_are_numpys():
    rng = np.random.default_rng(3)
    A, B, C, b = rng.normal(size=(4, 3)), rng.normal(size=(3, 5)), rng.normal(size=(4, 5)), rng.normal(size=4)
    out = np.full((4, 5), 7.0)
    from_python(matrices.multiply_into)(A, B, out)
    np.testing.assert_allclose(out, A @ B, rtol=1e-12)
    sums, total = np.ones((3, 5)), np.ones(3)
    from_python(matrices.add_transposed_product)(A, C, sums)
    np.testing.assert_allclose(sums, 1.0 + A.T @ C, rtol=1e-12)
    from_python(matrices.add_transposed_matvec)(A, b, total)
    np.testing.assert_allclose(total, 1.0 + A.T @ b, rtol=1e-12)


@pytest.mark.parametrize("size", [1, 2, 6])
def test_the_plain_factor_is_numpys_and_solves(size):
    rng = np.random.default_rng(7)
    B = rng.normal(size=(size, size + 3))
    A, X, x = B @ B.T, rng.normal(size=(size, 4)), rng.normal(size=size + 1)
    L = np.zeros((size + 1, size + 1))
    from_python(matrices.factorise)(A, 0.5, L, size)
    np.testing.assert_allclose(L[:size, :size], np.linalg.cholesky(A + 0.5 * np.eye(size)), rtol=1e-12, atol=1e-15)
    expected, solved, vector = np.linalg.solve(A, X), X.copy(), x.copy()
    from_python(matrices.solve_positive)(A.copy(), solved)
    np.testing.assert_allclose(solved, expected, rtol=1e-9)
    from_python(matrices.substitute_forward_in_vector)(L, vector, size)
    np.testing.assert_allclose(vector[:size], np.linalg.solve(L[:size, :size], x[:size]), rtol=1e-10)
    from_python(matrices.substitute_backward_in_vector)(L, vector, size)
    np.testing.assert_allclose(
        vector[:size], np.linalg.solve(A + 0.5 * np.eye(size), x[:size]), rtol=1e-9, err_msg="(L Lᵀ)⁻¹ x"
    )
    assert vector[size] == x[size]
