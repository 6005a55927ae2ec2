"""Compiled quaternions against SciPy's rotations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.sim.kinematics import quaternions
from stridetwin.sim.kinematics.quaternions import matrix_from_quat, quat_from_matrix
from tests.estimators.from_python import from_python

exp, inverse, log = (from_python(f) for f in (quaternions.exp, quaternions.inverse, quaternions.log))
multiply, rotate = from_python(quaternions.multiply), from_python(quaternions.rotate)
matrix, of_matrix = from_python(quaternions.matrix), from_python(quaternions.from_matrix)

part = st.floats(-1.0, 1.0)
vector = st.tuples(part, part, part)
angle = st.one_of(st.floats(0.0, math.pi - 1e-6), st.floats(0.0, 2e-3))


def turn(axis: tuple[float, float, float], angle: float) -> tuple[float, float, float]:
    size = math.sqrt(sum(x * x for x in axis))
    x, y, z = (angle * a / size for a in axis) if size > 1e-3 else (angle, 0.0, 0.0)
    return x, y, z


@settings(deadline=None)
@given(vector, angle, vector, angle, vector)
def test_what_they_do_is_what_rotations_do(axis, phi, other, psi, v) -> None:  # type: ignore[no-untyped-def]
    a, b = turn(axis, phi), turn(other, psi)
    A, B = Rotation.from_rotvec(a), Rotation.from_rotvec(b)
    p, q = exp(a), exp(b)
    np.testing.assert_allclose(matrix(p), A.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(matrix(multiply(p, q)), (A * B).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(rotate(p, v), A.apply(v), atol=1e-12)
    np.testing.assert_allclose(rotate(inverse(p), v), A.inv().apply(v), atol=1e-12)
    np.testing.assert_allclose(log(p), a, atol=1e-9)
    np.testing.assert_allclose(log((-p[0], -p[1], -p[2], -p[3])), a, atol=1e-9)  # the same attitude
    np.testing.assert_allclose(of_matrix(matrix(p)), A.as_quat(canonical=True, scalar_first=True), atol=1e-12)


@pytest.mark.parametrize("axis", np.vstack([np.eye(3), np.ones((3, 3)) - np.eye(3)]))
def test_half_turns_divide_by_what_is_large(axis: np.ndarray) -> None:
    R = Rotation.from_rotvec(np.pi * axis / np.linalg.norm(axis)).as_matrix()
    np.testing.assert_allclose(matrix(of_matrix(tuple(map(tuple, R)))), R, atol=1e-12)


@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
def test_stacks_keep_their_shape(shape: tuple[int, ...]) -> None:
    q = np.random.default_rng(2).normal(size=(*shape, 4))
    q *= np.sign(q[..., :1]) / np.linalg.norm(q, axis=-1, keepdims=True)
    R = matrix_from_quat(q)
    assert R.shape == (*shape, 3, 3)
    np.testing.assert_allclose(quat_from_matrix(np.swapaxes(R, -1, -2)), q * [1, -1, -1, -1], atol=1e-12)
