"""Rotations of stacked arrays: SciPy's, derivatives by finite differences, and shapes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.streams.algebra import arrays

STEP = 1e-6
part = st.floats(-1.0, 1.0)
vectors = st.lists(st.tuples(part, part, part), min_size=3, max_size=3).map(np.array)
angles = st.tuples(st.floats(-3.0, 3.0), st.floats(-1.5, 1.5), st.floats(-3.0, 3.0)).map(np.array)


@given(vectors)
def test_rotations_are_a_group_that_acts_on_vectors(phi):
    a, b, c = arrays.exp(phi)
    np.testing.assert_allclose((a @ b) @ c, a @ (b @ c), atol=1e-14)
    np.testing.assert_array_equal(arrays.exp(np.zeros(3)), np.eye(3))
    np.testing.assert_allclose(a @ a.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(a.T, arrays.exp(-phi[0]), atol=1e-14)
    assert np.linalg.det(a) == pytest.approx(1.0)
    np.testing.assert_allclose(arrays.matvec(a @ b, phi[2]), arrays.matvec(a, arrays.matvec(b, phi[2])), atol=1e-14)
    np.testing.assert_allclose(arrays.log(arrays.exp(phi)), phi, atol=1e-12)


@settings(deadline=None)
@given(vectors)
def test_they_are_scipys(phi):
    R = arrays.exp(phi)
    np.testing.assert_allclose(R, Rotation.from_rotvec(phi).as_matrix(), atol=1e-14)
    q = arrays.to_quaternion(R)
    np.testing.assert_allclose(q, Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True), atol=1e-14)
    np.testing.assert_allclose(arrays.from_quaternion(q), R, atol=1e-14)
    np.testing.assert_allclose(arrays.apply_quaternion(q, phi[::-1]), arrays.matvec(R, phi[::-1]), atol=1e-14)
    np.testing.assert_array_equal(arrays.cross(phi, phi[::-1]), np.cross(phi, phi[::-1]))
    np.testing.assert_allclose(arrays.matvec(arrays.hat(phi), phi[::-1]), np.cross(phi, phi[::-1]), atol=1e-15)


@given(angles)
def test_euler_angles_are_scipys(ypr):
    R = arrays.from_euler(ypr)
    np.testing.assert_allclose(R, Rotation.from_euler("ZYX", ypr).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(R, arrays.rot_z(ypr[0]) @ arrays.rot_y(ypr[1]) @ arrays.rot_x(ypr[2]), atol=1e-15)


@given(vectors)
def test_the_derivative_of_exp_at_zero_is_hat(phi):
    v = phi[0]
    np.testing.assert_allclose((arrays.exp(STEP * v) - arrays.exp(-STEP * v)) / (2 * STEP), arrays.hat(v), atol=1e-9)


@given(angles, vectors)
def test_rates_and_accelerations_are_derivatives_of_euler_angles(start, motion):
    """Of the angles start + rates t + accelerations t²/2, whose body rate is Rᵀ dR/dt."""
    rates, accelerations = motion[0], motion[1]

    def at(t):
        return start + rates * t + 0.5 * accelerations * t * t

    def body_rate(t):
        return arrays.euler_rates_to_body(at(t), rates + accelerations * t)

    R = [arrays.from_euler(at(t)) for t in (-STEP, 0.0, STEP)]
    np.testing.assert_allclose(R[1].T @ (R[2] - R[0]) / (2 * STEP), arrays.hat(body_rate(0.0)), atol=1e-8)
    change = (body_rate(STEP) - body_rate(-STEP)) / (2 * STEP)
    np.testing.assert_allclose(arrays.euler_accelerations_to_body(start, rates, accelerations), change, atol=1e-8)


@given(vectors, st.floats(0.0, 1.0))
def test_slerp_is_the_path_of_constant_rate(phi, share):
    R_a, R_b = arrays.exp(phi[0]), arrays.exp(phi[1])
    ends = arrays.slerp(R_a, R_b, np.array([0.0, share, 1.0]))
    np.testing.assert_allclose(ends[[0, 2]], [R_a, R_b], atol=1e-12)
    np.testing.assert_allclose(arrays.log(R_a.T @ ends[1]), share * arrays.log(R_a.T @ R_b), atol=1e-12)


@pytest.mark.parametrize("axis", np.vstack([np.eye(3), np.ones((3, 3)) - np.eye(3)]))
def test_half_turns_divide_by_what_is_large(axis):
    R = Rotation.from_rotvec(np.pi * axis / np.linalg.norm(axis)).as_matrix()
    np.testing.assert_allclose(arrays.from_quaternion(arrays.to_quaternion(R)), R, atol=1e-12)


@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
def test_stacks_keep_their_shape(shape):
    q = np.random.default_rng(2).normal(size=(*shape, 4))
    q *= np.sign(q[..., :1]) / np.linalg.norm(q, axis=-1, keepdims=True)
    R = arrays.from_quaternion(q)
    assert R.shape == (*shape, 3, 3)
    np.testing.assert_allclose(arrays.to_quaternion(np.swapaxes(R, -1, -2)), q * [1, -1, -1, -1], atol=1e-12)
    v = q[..., 1:]
    assert arrays.log(arrays.exp(v)).shape == v.shape


def test_a_product_of_many_matrices_and_vectors_is_each_pairs():
    M, v = np.random.default_rng(12).normal(size=(4, 3, 4))[..., :3], np.random.default_rng(13).normal(size=(4, 3))
    np.testing.assert_allclose(arrays.matvec(M, v), [m @ x for m, x in zip(M, v)], rtol=1e-14)
