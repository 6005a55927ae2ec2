"""Compiled vectors, matrices and quaternions of tuples: they form a group and agree with SciPy, NumPy and `arrays`."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.streams.algebra import arrays, matrices, tuples
from tests.estimators.from_python import from_python

exp, inverse, log = (from_python(f) for f in (tuples.exp, tuples.inverse, tuples.log))
multiply, apply, to_matrix = (from_python(f) for f in (tuples.multiply, tuples.apply, tuples.to_matrix))
left_jacobian = from_python(tuples.apply_left_jacobian)
inverse_left_jacobian = from_python(tuples.apply_inverse_left_jacobian)
exp_of_matrix = from_python(matrices.exp)

part = st.floats(-1.0, 1.0)
vector = st.tuples(part, part, part)
angle = st.one_of(st.floats(0.0, math.pi - 1e-6), st.floats(0.0, 2e-3))


@st.composite
def rotation_vectors(draw):
    axis, size = draw(vector), draw(angle)
    length = math.sqrt(sum(x * x for x in axis))
    x, y, z = (size * a / length for a in axis) if length > 1e-3 else (size, 0.0, 0.0)
    return x, y, z


@settings(deadline=None)
@given(rotation_vectors(), rotation_vectors(), rotation_vectors(), vector)
def test_rotations_are_a_group_that_acts_on_vectors(a, b, c, v):
    p, q, r = exp(a), exp(b), exp(c)
    np.testing.assert_allclose(multiply(multiply(p, q), r), multiply(p, multiply(q, r)), atol=1e-14)
    np.testing.assert_allclose(multiply(p, tuples.IDENTITY), p, atol=0.0)
    np.testing.assert_allclose(multiply(tuples.IDENTITY, p), p, atol=0.0)
    np.testing.assert_allclose(multiply(p, inverse(p)), tuples.IDENTITY, atol=1e-15)
    np.testing.assert_allclose(apply(multiply(p, q), v), apply(p, apply(q, v)), atol=1e-14)
    np.testing.assert_allclose(apply(tuples.IDENTITY, v), v, atol=0.0)
    np.testing.assert_allclose(np.linalg.norm(apply(p, v)), np.linalg.norm(v), atol=1e-14)


@settings(deadline=None)
@given(rotation_vectors(), rotation_vectors(), vector)
def test_they_are_scipys(a, b, v):
    A, B = Rotation.from_rotvec(a), Rotation.from_rotvec(b)
    p, q = exp(a), exp(b)
    np.testing.assert_allclose(p, A.as_quat(scalar_first=True), atol=1e-15)
    np.testing.assert_allclose(to_matrix(p), A.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(to_matrix(multiply(p, q)), (A * B).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(apply(p, v), A.apply(v), atol=1e-12)
    np.testing.assert_allclose(apply(inverse(p), v), A.inv().apply(v), atol=1e-12)
    np.testing.assert_allclose(log(p), a, atol=1e-9)
    np.testing.assert_allclose(log((-p[0], -p[1], -p[2], -p[3])), a, atol=1e-9)  # the same attitude


@settings(deadline=None)
@given(rotation_vectors(), vector)
def test_arrays_matrices_and_tuples_agree(a, v):
    q, phi = exp(a), np.array(a)
    R = np.array(to_matrix(q))
    np.testing.assert_allclose(arrays.exp(phi), R, atol=1e-14)
    np.testing.assert_allclose(exp_of_matrix(phi), R, atol=1e-14)
    np.testing.assert_array_equal(arrays.from_quaternion(np.array(q)), R)
    np.testing.assert_allclose(arrays.to_quaternion(R), np.copysign(1.0, q[0]) * np.array(q), atol=1e-14)
    np.testing.assert_allclose(arrays.log(R), log(q), atol=1e-9)
    rotated = arrays.apply_quaternion(np.array([q]), np.array([v]))[0]
    np.testing.assert_allclose(rotated, apply(q, v), atol=1e-14)
    np.testing.assert_allclose(arrays.matvec(R, np.array(v)), apply(q, v), atol=1e-14)
    if np.linalg.norm(a) > 0.0:
        axis = phi / np.linalg.norm(phi)
        about = from_python(tuples.rotation_about)(tuple(axis.tolist()), float(np.linalg.norm(phi)))
        np.testing.assert_allclose(about, R, atol=1e-14)


@pytest.mark.parametrize("size", [0.0, 1e-7, 0.9e-3, 1.1e-3, 0.5, 2.0, 3.0])
def test_the_left_jacobian_is_the_derivative_of_exp(size):
    """Log(Exp(φ + d) Exp(φ)⁻¹) = Γ₁ d, by central differences."""
    step, phi = 1e-6, size * np.array([0.6, -0.48, 0.64])
    back = inverse(exp(tuple(phi)))
    for d in step * np.eye(3):
        ends = [np.array(log(multiply(exp(tuple(phi + sign * d)), back))) for sign in (1.0, -1.0)]
        np.testing.assert_allclose(
            left_jacobian(tuple(phi), tuple(d / step)), (ends[0] - ends[1]) / (2 * step), atol=1e-8
        )
        there = left_jacobian(tuple(phi), tuple(d))
        np.testing.assert_allclose(inverse_left_jacobian(tuple(phi), there), d, atol=1e-15)


@pytest.mark.parametrize("small_rad", [1e-4, 1e-3])
def test_series_and_quotient_of_exp_meet(small_rad):
    for size in (0.99 * small_rad, 1.01 * small_rad):
        phi = (0.6 * size, 0.0, -0.8 * size)
        np.testing.assert_allclose(
            exp(phi, small_rad), Rotation.from_rotvec(phi).as_quat(scalar_first=True), rtol=1e-15
        )


def test_a_normalized_quaternion_has_length_one():
    q = from_python(tuples.normalized)((2.0, -1.0, 4.0, -2.0))
    np.testing.assert_allclose(q, np.array([2.0, -1.0, 4.0, -2.0]) / 5.0, rtol=1e-15)


def test_vectors_and_matrices_of_tuples_are_numpys():
    rng = np.random.default_rng(11)
    a, b, A, B = *rng.normal(size=(2, 3)), *rng.normal(size=(2, 3, 3))
    s, t, M, N = tuple(a), tuple(b), tuple(map(tuple, A)), tuple(map(tuple, B))
    for name, arguments, expected in [
        ("dot", (s, t), a @ b),
        ("cross", (s, t), np.cross(a, b)),
        ("axpy", (s, -1.7, t), a - 1.7 * b),
        ("plus", (s, t), a + b),
        ("minus", (s, t), a - b),
        ("times", (-1.7, t), -1.7 * b),
        ("matvec", (M, t), A @ b),
        ("scale_matrix", (-1.7, M), -1.7 * A),
        ("matmul", (M, N), A @ B),
        ("rows_cross", (M, t), A @ arrays.hat(b)),
        ("transposed", (M,), A.T),
    ]:
        np.testing.assert_allclose(from_python(getattr(tuples, name))(*arguments), expected, rtol=1e-12, err_msg=name)


def test_what_is_stored_in_an_array_is_read_again_and_nothing_else_changes():
    rng = np.random.default_rng(11)
    row, block = np.arange(9.0), np.zeros((5, 6))
    assert from_python(tuples.vec3_at)(row, 2) == (2.0, 3.0, 4.0)
    assert from_python(tuples.quaternion_at)(row, 3) == (3.0, 4.0, 5.0, 6.0)
    from_python(tuples.store_vec3_at)((-1.0, -2.0, -3.0), row, 1)
    from_python(tuples.store_quaternion_at)((-4.0, -5.0, -6.0, -7.0), row, 4)
    np.testing.assert_array_equal(row, [0, -1, -2, -3, -4, -5, -6, -7, 8])
    A = rng.normal(size=(3, 3))
    from_python(tuples.store_mat3_at)(tuple(map(tuple, A)), block, 1, 2)
    np.testing.assert_array_equal(block[1:4, 2:5], A)
    assert np.count_nonzero(block) == 9
    from_python(tuples.store_mat3)(tuple(map(tuple, A)), square := np.zeros((3, 3)))
    np.testing.assert_array_equal(square, A)
    np.testing.assert_array_equal(from_python(tuples.mat3)(A), A)
