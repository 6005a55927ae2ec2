"""Rotations, matrices and equations of the compiled kernels agree with SciPy and NumPy, also next to their limits."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from stridetwin.estimators import cholesky, matrices, so3
from stridetwin.estimators.foot_ins import kalman, quaternions
from tests.estimators.from_python import from_python

AXES = [v / np.linalg.norm(v) for v in ([1.0, -2.0, 3.0], [-0.3, 0.2, 0.1], [0.0, 0.0, 1.0])]
ANGLES = [0.0, 1e-9, 0.9e-5, 1.1e-5, 0.9e-4, 1.1e-4, 0.01, 0.7, 2.0, 3.1]
exp, log, hat = from_python(so3.exp), from_python(so3.log), from_python(so3.hat)


def cross_matrix(v):
    """[v]x, a column per unit vector."""
    return np.cross(v, np.eye(3)).T


def test_hat_is_the_cross_product():
    rng = np.random.default_rng(11)
    a, b = rng.normal(size=(2, 3))
    np.testing.assert_allclose(hat(a) @ b, np.cross(a, b), rtol=1e-14)


def test_a_product_of_many_matrices_and_vectors_is_each_pairs():
    M, v = np.random.default_rng(12).normal(size=(4, 3, 4))[..., :3], np.random.default_rng(13).normal(size=(4, 3))
    np.testing.assert_allclose(matrices.matvec(M, v), [m @ x for m, x in zip(M, v)], rtol=1e-14)


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
    right, inverse = from_python(so3.right_jacobian), from_python(so3.right_jacobian_inverse)
    for axis in AXES:
        v = angle * axis
        block = np.zeros((6, 6))
        block[:3, :3], block[:3, 3:] = -cross_matrix(v), np.eye(3)
        expected = expm(block)[:3, 3:]
        np.testing.assert_allclose(right(v), expected, atol=1e-9)
        np.testing.assert_allclose(inverse(v), np.linalg.inv(expected), atol=1e-8)


@pytest.mark.parametrize("size", range(1, 12))
def test_solve_is_numpys_and_reads_the_lower_triangle_alone(size):
    """All remainders of the rows that are taken four at a time, in a larger workspace whose rest stays as it is."""
    rng = np.random.default_rng(11)
    solve, rows = from_python(cholesky.solve), size + 2
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
    assert not from_python(cholesky.solve)(A, np.ones(7), 7, 0.0, np.zeros((7, 7)), np.zeros(7))


def test_small_matrices_are_numpys():
    rng = np.random.default_rng(11)
    A, B, F = rng.normal(size=(4, 3)), rng.normal(size=(3, 5)), rng.normal(size=(5, 4))
    F[1, 2] = F[3, 1] = 0.0
    P = F[:4] @ F[:4].T
    v, w, R = *rng.normal(size=(2, 3)), Rotation.from_rotvec([0.3, -0.4, 0.5]).as_matrix()
    for name, arguments, expected in [
        ("mul", (A, B), A @ B),
        ("sparse_mul", (F, A), F @ A),
        ("transform_covariance", (F, P), F @ P @ F.T),
        ("transposed", (A,), A.T),
        ("identity", (3,), np.eye(3)),
        ("dot", (v, w), v @ w),
        ("rotate", (R, v), R @ v),
        ("rotate_back", (R, v), R.T @ v),
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


def test_vectors_and_matrices_of_tuples_are_numpys():
    rng = np.random.default_rng(11)
    a, b, A, B = *rng.normal(size=(2, 3)), *rng.normal(size=(2, 3, 3))
    s, t, M, N = tuple(a), tuple(b), tuple(map(tuple, A)), tuple(map(tuple, B))
    for name, arguments, expected in [
        ("dot", (s, t), a @ b),
        ("cross", (s, t), np.cross(a, b)),
        ("axpy", (s, -1.7, t), a - 1.7 * b),
        ("rotate", (M, t), A @ b),
        ("scale_matrix", (-1.7, M), -1.7 * A),
        ("matrix_product", (M, N), A @ B),
        ("rows_cross", (M, t), A @ cross_matrix(b)),
        ("transposed", (M,), A.T),
    ]:
        np.testing.assert_allclose(
            from_python(getattr(quaternions, name))(*arguments), expected, rtol=1e-12, err_msg=name
        )


def test_what_is_stored_in_an_array_is_read_again_and_nothing_else_changes():
    rng = np.random.default_rng(11)
    row, block = np.arange(9.0), np.zeros((5, 6))
    assert from_python(quaternions.vec3)(row, 2) == (2.0, 3.0, 4.0)
    assert from_python(quaternions.quaternion)(row, 3) == (3.0, 4.0, 5.0, 6.0)
    from_python(quaternions.put_vec3)((-1.0, -2.0, -3.0), row, 1)
    from_python(quaternions.put_quaternion)((-4.0, -5.0, -6.0, -7.0), row, 4)
    np.testing.assert_array_equal(row, [0, -1, -2, -3, -4, -5, -6, -7, 8])
    A = rng.normal(size=(3, 3))
    from_python(quaternions.put_matrix)(tuple(map(tuple, A)), block, 1, 2)
    np.testing.assert_array_equal(block[1:4, 2:5], A)
    assert np.count_nonzero(block) == 9


@pytest.mark.parametrize("angle", ANGLES)
def test_quaternions_are_scipys(angle):
    v, other = angle * AXES[0], Rotation.from_rotvec([0.4, -1.1, 0.8])
    q = from_python(quaternions.quat_exp)(*v)
    first = Rotation.from_rotvec(v)
    np.testing.assert_allclose(q, first.as_quat(scalar_first=True), atol=1e-15)
    np.testing.assert_allclose(from_python(quaternions.rotation_matrix)(q), first.as_matrix(), atol=1e-15)
    both = from_python(quaternions.product)(q, tuple(2.0 * other.as_quat(scalar_first=True)))
    np.testing.assert_allclose(both, (first * other).as_quat(scalar_first=True), atol=1e-14)
    back = from_python(quaternions.conjugate)(q)
    np.testing.assert_allclose(back, first.inv().as_quat(scalar_first=True), atol=1e-15)


STATES, FIRST, MEASURED = 9, 2, 5
"""Of a filter, the first of the states that are measured, and the columns of the Jacobian."""


@pytest.fixture
def filtered():
    """Covariance, error so far, Jacobian (3, 9), innovation, and the workspace with the last two."""
    rng = np.random.default_rng(5)
    B = rng.normal(size=(STATES, STATES))
    P, dx, H, z = (
        B @ B.T + np.eye(STATES),
        0.1 * rng.normal(size=STATES),
        rng.normal(size=(3, MEASURED)),
        rng.normal(size=3),
    )
    H[1, 2] = 0.0
    work = kalman.workspace(STATES, MEASURED)
    work.jacobian[:], work.innovation[:] = 9.0, 9.0
    work.jacobian[:3], work.innovation[:3] = H, z
    whole = np.zeros((3, STATES))
    whole[:, FIRST : FIRST + MEASURED] = H
    return P, dx, whole, z, work


def batch_update(P, dx, H, z, noise):
    """Mean and covariance after a measurement of all rows at once."""
    S = H @ P @ H.T + noise * np.eye(len(H))
    K = P @ H.T @ np.linalg.inv(S)
    return dx + K @ (z - H @ dx), P - K @ S @ K.T


@pytest.mark.parametrize("gate", [1e-3, 1e3])
def test_a_gated_update_is_one_of_all_rows_at_once(filtered, gate):
    P, dx, H, z, work = filtered
    S = H @ P @ H.T + np.eye(3)
    length = np.sqrt(z @ np.linalg.solve(S, z))
    mean, covariance = batch_update(P, dx, H, z, max(1.0, length / gate) ** 2)
    assert from_python(kalman.apply_gated_update)(P, dx, work, FIRST, 3, gate) == pytest.approx(length, rel=1e-12)
    np.testing.assert_allclose(dx, mean, rtol=1e-9)
    np.testing.assert_allclose(P, covariance, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(P, P.T)


def test_the_solution_of_the_innovation_is_numpys(filtered):
    P, _, H, z, work = filtered
    from_python(kalman.spread_measurements)(P, work, FIRST, 3)
    np.testing.assert_allclose(np.tril(work.spread[:3, :3]), np.tril(H @ P @ H.T), rtol=1e-12)
    from_python(kalman.innovation_norm)(work, 3, 0.3)
    from_python(kalman.back_substitute)(work, 3)
    np.testing.assert_allclose(work.solved[:3], np.linalg.solve(H @ P @ H.T + 0.3 * np.eye(3), z), rtol=1e-10)
    from_python(kalman.clear)(work, 2)
    assert not work.jacobian[:2].any()
    np.testing.assert_array_equal(work.jacobian[2], H[2, FIRST : FIRST + MEASURED])


@pytest.mark.parametrize("probability", [0.0, 0.3, 1.0])
def test_an_update_that_applies_probably_has_the_moments_of_the_mixture(filtered, probability):
    P, dx, H, z, work = filtered
    H, z = H[:1], z[:1]
    mean, covariance = batch_update(P, dx, H, z, 0.5)
    average = dx + probability * (mean - dx)
    apart = (mean - dx)[:, None] * (mean - dx)
    mixed = P + probability * (covariance - P) + probability * (1.0 - probability) * apart
    row = H[0, FIRST : FIRST + MEASURED].copy()
    from_python(kalman.correct_probably)(P, dx, work.gain, FIRST, row, z[0], 0.5, probability)
    np.testing.assert_allclose(dx, average, rtol=1e-10)
    np.testing.assert_allclose(P, mixed, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(P, P.T)
