"""Kalman updates of the compiled kernels agree with batch updates in NumPy."""

import numpy as np
import pytest

from stridetwin.estimators.foot_ins import kalman
from tests.estimators.from_python import from_python

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
