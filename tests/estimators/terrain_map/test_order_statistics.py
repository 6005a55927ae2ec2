"""Order statistics, planes and lines through points of the terrain map agree with NumPy's."""

import math

import numpy as np
import pytest

from stridetwin.estimators.terrain_map import order_statistics, plane_fit, ray_casting, risers
from stridetwin.estimators.terrain_map.plane_fit import SUMS, add_point
from tests.estimators.from_python import from_python


def sums(points, noise=0.005):
    s = np.zeros(SUMS)
    for p in points:
        add_point(s, *p, noise)
    return s


@pytest.mark.parametrize("n", [1, 2, 3, 4, 7, 30])
def test_median_percentiles_and_mean_are_numpys(n):
    """Percentiles by Hazen's neighbour to neighbour interpolation, as in NumPy's default."""
    values = np.random.default_rng(n).normal(size=n)
    ordered = values.copy()
    from_python(order_statistics.sort)(ordered)
    np.testing.assert_array_equal(ordered, np.sort(values))
    assert from_python(order_statistics.median)(ordered, n) == pytest.approx(np.median(values), rel=1e-12)
    for percent in (0.0, 2.0, 37.0, 98.0, 100.0):
        found = from_python(order_statistics.percentile)(ordered, percent)
        assert found == pytest.approx(np.percentile(values, percent), rel=1e-12)
    points = np.column_stack([values, -values])
    for first in range(n):
        assert from_python(order_statistics.mean)(points, first, n, 1) == pytest.approx(-values[first:].mean())


def tilted(seed=0, count=50):
    """(count, 3) points about a slope, away from the origin, with scatter in all directions."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-0.4, 0.7, (count, 2)) * [1.0, 0.5]
    return np.column_stack([xy, 0.3 * xy[:, 0] - 0.2 * xy[:, 1] + rng.normal(0, 0.02, count)]) + [2.0, -1.0, 0.7]


@pytest.mark.parametrize("seed", range(3))
def test_the_distance_from_the_best_plane_is_the_least_eigenvalue(seed):
    points = tilted(seed)
    values, vectors = np.linalg.eigh(np.cov(points.T, bias=True))
    assert from_python(plane_fit.plane_misfit)(sums(points)) == pytest.approx(values[0], rel=1e-8)
    found = from_python(plane_fit.fit_plane)(sums(points))
    assert found[6] == pytest.approx(values[0], rel=1e-6)
    np.testing.assert_allclose(found[3:6], vectors[:, 0] * np.sign(vectors[2, 0]), atol=1e-6)


def test_points_on_a_line_or_in_one_place_lie_on_a_plane():
    line = np.outer(np.linspace(0, 1, 9), [1.0, 0.5, 0.2])
    for points in (line, np.tile([1.0, 2.0, 3.0], (5, 1))):
        assert from_python(plane_fit.plane_misfit)(sums(points)) == pytest.approx(0.0, abs=1e-12)
        assert from_python(plane_fit.fit_plane)(sums(points))[6] == pytest.approx(0.0, abs=1e-9)
    assert from_python(plane_fit.fit_plane)(sums(np.tile([1.0, 2.0, 3.0], (5, 1))))[3:6] == (0.0, 0.0, 1.0)


def test_the_height_plane_is_bayesian_least_squares():
    """With the prior slopes as further rows of the system; the covariance from its inverse."""
    points, noise, alike, slope_sd = tilted(), 0.005, 4.0, 0.5
    centres, slopes, covariances, spreads = plane_fit.fit_height_planes(
        sums(points)[None], 0.002, 0.01, alike, slope_sd
    )
    middle = points.mean(axis=0)
    offset = points - middle
    sd = noise * math.sqrt(alike)  # of a point, if so many share an error
    A = np.vstack([np.column_stack([np.ones(len(points)), offset[:, :2]]) / sd, np.eye(3)[1:] / slope_sd])
    expected = np.linalg.lstsq(A, np.r_[offset[:, 2] / sd, 0.0, 0.0], rcond=None)[0]
    np.testing.assert_allclose(centres[0], middle, rtol=1e-12)
    np.testing.assert_allclose(slopes[0], expected[1:], rtol=1e-6)
    covariance = np.linalg.inv(A.T @ A) + np.diag([0.002**2, 0.01**2, 0.01**2])
    np.testing.assert_allclose(covariances[0], covariance, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(spreads[0], np.cov(points[:, :2].T, bias=True), rtol=1e-9)
    others = tilted(5) + [0.1, 0.2, 0.05]
    off = others[:, 2] - middle[2] - (others[:, :2] - middle[:2]) @ slopes[0]
    found = plane_fit.height_plane_misfit(sums(others)[None], sums(points)[None], 0.002, 0.01, alike, slope_sd)
    assert found == pytest.approx([np.mean(off**2)], rel=1e-9)


def test_planes_turn_about_the_vertical():
    centres, slopes, covariances, spreads = plane_fit.fit_height_planes(sums(tilted())[None], 0.0, 0.0, 1.0, 1e3)
    c, s = math.cos(0.6), math.sin(0.6)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    expected = plane_fit.fit_height_planes(sums(tilted() @ R.T)[None], 0.0, 0.0, 1.0, 1e3)
    for a, b in zip(plane_fit.rotate_planes(centres, slopes, covariances, spreads, R), expected):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("toward", [(3.0, 0.0), (0.0, -3.0), (-2.0, 2.0), (0.05, 0.02), (0.0, 0.0)])
def test_the_height_of_a_plane_is_read_where_it_is_well_observed(toward):
    """Of a plane of 1.2 m by 0.6 m: no farther toward a place than its own border, minus 5 cm."""
    centre, gradient = np.array([2.0, -1.0, 0.7]), np.array([0.3, -0.2])
    spread = np.diag(np.array([1.2, 0.6]) ** 2 / 12.0)
    away = math.hypot(*toward)
    unit = np.array(toward) / max(away, 1e-9)
    half = math.sqrt(3.0 * unit @ spread @ unit)
    place = centre[:2] + max(0.0, min(away, half) - 0.05) * unit
    x, y = centre[:2] + toward
    np.testing.assert_allclose(plane_fit.point_toward(centre, spread, x, y, 0.05), place, atol=1e-12)
    height = plane_fit.height_toward(centre, gradient, spread, x, y, 0.05)
    assert height == pytest.approx(centre[2] + (place - centre[:2]) @ gradient)


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.5707, 2.5, -2.0, 3.1])
def test_across_a_line_is_its_normal_on_the_side_asked_for(angle):
    rng = np.random.default_rng(1)
    along, normal = np.array([-math.sin(angle), math.cos(angle)]), np.array([math.cos(angle), math.sin(angle)])
    points = np.outer(rng.uniform(-0.5, 0.5, 40), along) + np.outer(rng.normal(0, 0.004, 40), normal) + [3.0, -2.0]
    _, vectors = np.linalg.eigh(np.cov(points.T))
    for side in (1.0, -1.0):
        toward = side * normal + 0.3 * along
        found = from_python(risers.normal_across)(points, toward, risers._DIRECTION_RATIO)
        expected = vectors[:, 0] * np.sign(vectors[:, 0] @ toward)
        np.testing.assert_allclose(found, expected, atol=1e-9)
    toward = 0.02 * normal + along  # the points do not lie across it
    found = from_python(risers.normal_across)(points, toward, 1.0)
    np.testing.assert_allclose(found, toward / np.linalg.norm(toward), atol=1e-12)


def test_projections_and_kept_points():
    points = np.random.default_rng(0).normal(size=(9, 2))
    np.testing.assert_allclose(from_python(risers.project)(points, 0.6, -0.8), points @ [0.6, -0.8])
    keep = np.arange(9) % 2 == 0
    np.testing.assert_array_equal(from_python(risers._select_points)(points, keep, 5), points[keep])
    assert from_python(risers._select_points)(points, keep, 6).shape == (0, 2)


def test_a_column_is_as_uncertain_as_its_distance_and_weight_say():
    """One seen far less than a neighbour is a flying pixel."""
    height = np.array([[0.2, 0.2, 0.2], [0.2, np.nan, -0.4], [0.2, 0.2, 0.2]], np.float32)
    weight = np.array([[40, 40, 40], [40, 40, 40], [40, 40, 40]], np.float32)
    expected_height = height.copy()
    sd = ray_casting.column_noise(height, weight, 1.6, 0.003, 0.02, 0.01)
    np.testing.assert_array_equal(height, expected_height)
    own = max(40.0, ray_casting._WEIGHT_FLOOR)
    off = 0.01 * np.where(np.isnan(height), 0.0, 1.6 - np.nan_to_num(height))
    np.testing.assert_allclose(sd, np.minimum(np.sqrt(0.003**2 + off**2 / own), 0.02), rtol=1e-5)
    weight[0, 0] = 40 * ray_casting._NEIGHBOUR_SHARE * 0.99
    ray_casting.column_noise(height, weight, 1.6, 0.003, 0.02, 0.01)
    assert np.isnan(height[0, 0])
    assert np.isnan(height).sum() == 2
    few = np.full((3, 3), 1e-3, np.float32)
    sd = ray_casting.column_noise(np.zeros((3, 3), np.float32), few, 1.6, 0.003, 9.0, 0.01)
    np.testing.assert_allclose(sd, np.sqrt(0.003**2 + (0.016) ** 2 / ray_casting._WEIGHT_FLOOR), rtol=1e-5)
