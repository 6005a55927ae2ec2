"""Planes through points: exact ones come back, and the covariance says how far off noisy ones are."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.estimators.terrain_map import plane_fit
from stridetwin.estimators.terrain_map.plane_fit import SUMS, add_point
from tests.estimators.from_python import from_python

fit = from_python(plane_fit.fit_plane)


def height_plane(sums, *limits):
    """Centre, slopes, covariance, and spread in plan."""
    return tuple(found[0] for found in plane_fit.fit_height_planes(sums[None], *limits))


angles = st.floats(0.0, 1.2)
turns = st.floats(-3.1, 3.1)
places = st.floats(-20.0, 20.0)


def sums(points, noise=0.005):
    s = np.zeros(SUMS)
    for p in points:
        add_point(s, *p, noise)
    return s


def patch(rng, count=60, size=0.3):
    return np.column_stack([rng.uniform(-size, size, (count, 2)), np.zeros(count)])


@settings(deadline=None)  # the first call compiles
@given(angles, turns, places, places)
def test_an_exact_plane_comes_back(tilt, turn, x, y):
    R = Rotation.from_euler("ZY", [turn, tilt])
    points = R.apply(patch(np.random.default_rng(0))) + [x, y, 1.0]
    cx, cy, cz, a, b, c, error = fit(sums(points))
    np.testing.assert_allclose([cx, cy, cz], points.mean(axis=0), atol=1e-9)
    np.testing.assert_allclose([a, b, c], R.apply([0, 0, 1]), atol=1e-5)
    assert 0.0 <= error < 1e-9


@settings(deadline=None)  # the first call compiles
@given(turns, st.floats(0.0, 0.4))
def test_the_normal_turns_with_the_points(turn, tilt):
    rng = np.random.default_rng(1)
    points = Rotation.from_euler("Y", tilt).apply(patch(rng) + rng.normal(0, 0.003, (60, 3)))
    R = Rotation.from_euler("Z", turn)
    one, other = fit(sums(points)), fit(sums(R.apply(points)))
    np.testing.assert_allclose(R.apply(one[3:6]), other[3:6], atol=1e-7)
    assert math.isclose(one[6], other[6], rel_tol=1e-6, abs_tol=1e-12)


@settings(deadline=None)  # the first call compiles
@given(st.integers(3, 8), turns)
def test_points_on_a_line_or_a_spot_give_no_nan(count, turn):
    line = np.outer(np.arange(count) * 0.1, [math.cos(turn), math.sin(turn), 0.0])
    for points in (line, np.zeros((count, 3))):
        assert np.isfinite(fit(sums(points))).all()
        centre, slopes, covariance, _ = height_plane(sums(points), 0.003, 0.004, 1.0, 0.1)
        assert np.isfinite(centre).all()
        np.testing.assert_allclose(slopes, 0.0, atol=1e-9)
        assert (np.linalg.eigvalsh(covariance) > 0).all()
        assert covariance[1, 1] <= 0.1**2 + 0.004**2 + 1e-12


def test_the_covariance_of_a_plane_is_its_error():
    rng = np.random.default_rng(2)
    noise, true = 0.006, np.array([0.7, 0.05, -0.12])
    squares = []
    for _ in range(400):
        points = patch(rng, 80, 0.2)
        points[:, 2] = true[0] + points[:, :2] @ true[1:] + rng.normal(0, noise, 80)
        centre, slopes, covariance, _ = height_plane(sums(points, noise), 1e-6, 1e-6, 1.0, 10.0)
        error = np.array([centre[2] - (true[0] + centre[:2] @ true[1:]), *(slopes - true[1:])])
        squares.append(error @ np.linalg.solve(covariance, error))
    assert 2.7 < np.mean(squares) < 3.3  # three degrees of freedom
    assert 0.92 < np.mean(np.array(squares) < 7.815) < 0.98


def test_points_that_share_an_error_count_less():
    points = sums(patch(np.random.default_rng(3)))
    one, many = (height_plane(points, 1e-6, 1e-6, alike, 1.0)[2] for alike in (1.0, 16.0))
    assert math.isclose(many[0, 0], 16 * one[0, 0], rel_tol=1e-3)
    np.testing.assert_allclose(many[1:, 1:], 16 * one[1:, 1:], rtol=0.05)


def test_the_spread_is_the_covariance_in_plan():
    points = patch(np.random.default_rng(4))
    np.testing.assert_allclose(
        height_plane(sums(points), 1.0, 1.0, 1.0, 1.0)[3], np.cov(points[:, :2].T, bias=True), atol=1e-12
    )
