"""Fits of flights and bends agree with generalised least squares in NumPy."""

import math
from dataclasses import replace

import numpy as np
import pytest

from stridetwin.estimators.terrain_map import bends, stairs
from stridetwin.estimators.terrain_map.estimate import Plane
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.risers import Riser

P = TerrainMapParameters()
HEADING, TURN, START, TREAD = 0.8, 0.03, 2.4, 0.29
LEAST, SD = 1e-5, np.array([0.01, 0.03, 0.01])


def along(angle):
    return np.array([math.cos(angle), math.sin(angle)])


UP, LEFT = along(HEADING), along(HEADING + math.pi / 2)


def edge_points(steps=3, scatter=0.006, seed=0):
    """Points of parallel edges that lie rotated by TURN from the nominal direction of ascent, and their number."""
    rng = np.random.default_rng(seed)
    up, left = along(HEADING + TURN), along(HEADING + TURN + math.pi / 2)
    found, counts = [], np.array([25, 18, 30])[:steps]
    for k, n in enumerate(counts):
        s, aside = START + k * TREAD + rng.normal(0, scatter, n), rng.uniform(-0.5, 0.8, n)
        found.append(np.outer(s, up) + np.outer(aside, left))
    return np.vstack(found), counts


def by_edge(points, counts):
    return np.split(points, np.cumsum(counts)[:-1])


def least_squares(points, counts, middle, sd):
    """Start, tread and turn by generalised least squares: each edge's points scatter and share one error."""
    s, aside = points @ UP, points @ LEFT - middle
    k = np.repeat(np.arange(len(counts)), counts)
    A = np.column_stack([np.ones(len(s)), k, -aside])
    W = np.zeros((len(s), len(s)))
    for n in range(len(counts)):
        own = max(np.var(s[k == n]), LEAST)
        W[np.ix_(k == n, k == n)] = np.linalg.inv(own * np.eye(counts[n]) + sd[n] ** 2)
    if len(counts) == 1:
        A = A[:, [0, 2]]
    covariance = np.linalg.inv(A.T @ W @ A)
    return covariance @ A.T @ W @ s, covariance


def test_even_edges_are_fitted_by_generalised_least_squares():
    points, counts = edge_points()
    middle = 0.2
    values, covariance = stairs.fit_even_edges(by_edge(points, counts), SD, UP, middle, LEAST)
    expected, expected_covariance = least_squares(points, counts, middle, SD)
    np.testing.assert_allclose(values, expected, rtol=1e-6)
    np.testing.assert_allclose(covariance, expected_covariance, rtol=1e-5, atol=1e-12)
    assert values[1] == pytest.approx(TREAD, abs=0.02)
    assert values[2] == pytest.approx(TURN, abs=0.01)


def test_a_single_edge_has_a_place_and_a_direction_and_no_tread():
    points, counts = edge_points(1)
    values, covariance = stairs.fit_even_edges([points], SD[:1], UP, 0.2, LEAST)
    expected, expected_covariance = least_squares(points, counts, 0.2, SD[:1])
    np.testing.assert_allclose(values[[0, 2]], expected, rtol=1e-6)
    np.testing.assert_allclose(covariance[np.ix_([0, 2], [0, 2])], expected_covariance, rtol=1e-5, atol=1e-12)
    assert math.isnan(values[1])


def test_base_and_riser_are_a_weighted_line_through_the_heights():
    heights, sd = np.array([0.11, 0.27, 0.40, 0.58]), np.array([0.004, 0.01, 0.003, 0.02])
    A = np.column_stack([np.ones(4), np.arange(4)]) / sd[:, None]
    steps, covariance = stairs.fit_stair_line(heights, sd)
    np.testing.assert_allclose(steps, np.linalg.lstsq(A, heights / sd, rcond=None)[0], rtol=1e-9)
    np.testing.assert_allclose(covariance, np.linalg.inv(A.T @ A), rtol=1e-9)


def plane(id_, s, z):
    """A level tread of 0.8 m by 0.8 m about a place along the flight; known to 4 mm."""
    centre = np.array([*(s * along(HEADING + TURN) + 0.1 * LEFT), z])
    return Plane(
        id=id_,
        centre=centre,
        normal=np.array([0.0, 0.0, 1.0]),
        area_m2=0.6,
        spread=np.eye(2) * 0.8**2 / 12.0,
        votes=9.0,
        covariance=np.diag([0.004**2, 1e-6, 1e-6]),
    )


def riser(points, k, in_voxels=True):
    return Riser(lower=k, upper=k + 1, down=-UP, points=points, in_voxels=in_voxels, height=0.15)


def flight(steps=3):
    points, counts = edge_points(steps, scatter=0.002)
    row = [riser(part, k) for k, part in enumerate(by_edge(points, counts))]
    planes = {k: plane(k, START + (k - 0.5) * TREAD, 0.3 + 0.15 * k) for k in range(steps + 1)}
    return row, planes, points


def test_a_flight_has_the_sizes_of_its_edges_and_planes():
    row, planes, points = flight()
    it = stairs.fit_stairs(row, planes, 7, P)
    assert (it.id, it.planes, it.steps) == (7, (0, 1, 2, 3), 3)
    assert (it.riser, it.base) == pytest.approx((0.15, 0.3), abs=1e-9)
    assert it.tread == pytest.approx(TREAD, abs=0.001)
    assert it.heading == pytest.approx(HEADING + TURN, abs=0.003)
    assert it.start == pytest.approx(START, abs=0.003)
    np.testing.assert_allclose(it.edges, START + TREAD * np.arange(3), atol=0.003)
    aside = points @ along(it.heading + math.pi / 2)
    np.testing.assert_allclose(it.across, np.percentile(aside, [2.0, 98.0]), atol=1e-9)
    sd = np.sqrt(np.diag(it.covariance))
    assert sd[0] == pytest.approx(0.004 / math.sqrt(5.0), rel=0.05)  # of a slope over 0, 1, 2, 3
    assert sd[4] == pytest.approx(0.004 * math.sqrt(0.7), rel=0.05)
    assert it.covariance[0, 4] == pytest.approx(-0.3 * 0.004**2, rel=0.1)
    np.testing.assert_allclose(it.covariance, it.covariance.T, rtol=1e-9, atol=1e-18)
    expected = least_squares(
        points, [25, 18, 30], float(np.mean([(r.points @ LEFT).mean() for r in row])), np.full(3, P.edge_sd_m)
    )[1]
    assert sd[1] == pytest.approx(math.sqrt(expected[1, 1]), rel=0.3)
    unsure = stairs.fit_stairs([replace(r, in_voxels=False) for r in row], planes, 7, P)
    assert np.sqrt(unsure.covariance[1, 1]) > 1.5 * sd[1] or P.edge_sd_m > 1.5 * P.voxel_size_m


def test_a_flight_of_one_riser_has_an_unknown_tread():
    row, planes, _ = flight(1)
    it = stairs.fit_stairs(row, planes, 1, P)
    assert math.isnan(it.tread)
    assert it.covariance[1, 1] == math.inf
    assert it.riser == pytest.approx(0.15)


def test_the_direction_of_a_flight_counts_edges_by_the_cube_of_their_length():
    def straight(angle, length, n):
        return Riser(
            lower=0,
            upper=1,
            down=along(angle),
            in_voxels=True,
            height=0.1,
            points=np.outer(np.linspace(-0.5, 0.5, n) * length, along(angle + math.pi / 2)),
        )

    edges = [straight(0.1, 1.0, 30), straight(0.2, 0.5, 9), straight(math.pi + 0.05, 0.8, 9)]
    total = 1.0 * along(0.1) + 0.5**3 * along(0.2) + 0.8**3 * along(0.05)
    np.testing.assert_allclose(stairs.heading_of(edges), total / np.linalg.norm(total), atol=1e-9)


def test_risers_a_tread_apart_are_one_flight():
    row, _, _ = flight()
    far = replace(row[2], lower=3, upper=4, points=row[2].points + 2.0 * along(HEADING + TURN))
    turned = replace(row[0], lower=9, upper=10, down=along(HEADING + math.pi / 2))
    rows = stairs.find_flights([row[2], far, row[0], turned, row[1]], P)
    assert sorted(sorted(r.lower for r in each) for each in rows) == [[0, 1, 2], [3], [9]]
    assert next(each for each in rows if len(each) == 3) == row
    for tread, joined in (
        (0.99 * P.min_tread_m, False),
        (1.01 * P.min_tread_m, True),
        (0.99 * P.max_tread_m, True),
        (1.01 * P.max_tread_m, False),
    ):
        other = replace(row[0], lower=1, upper=2, points=row[0].points + tread * UP)
        assert (len(stairs.find_flights([row[0], other], P)) == 1) == joined
    for angle, joined in ((0.98 * stairs._PARALLEL_RAD, True), (1.02 * stairs._PARALLEL_RAD, False)):
        other = replace(row[0], lower=1, upper=2, points=row[0].points + 0.3 * UP, down=-along(HEADING + angle))
        assert (len(stairs.find_flights([row[0], other], P)) == 1) == joined


def hinge_gain(x, z, k):
    """Reduction of the squared residuals by a hinge at the k-th place beyond a line's, and its change of slope."""
    line = np.column_stack([np.ones(len(x)), x])
    bent = np.column_stack([line, np.maximum(0.0, x - x[k])])
    rest = z - line @ np.linalg.lstsq(line, z, rcond=None)[0]
    solution = np.linalg.lstsq(bent, z, rcond=None)[0]
    return rest @ rest - ((z - bent @ solution) ** 2).sum(), solution[2], rest @ rest


@pytest.mark.parametrize("seed", range(4))
def test_the_best_bend_is_the_hinge_that_explains_most(seed):
    rng = np.random.default_rng(seed)
    n, at = 40, 15 + 3 * seed
    x = np.sort(np.arange(n) * bends._BIN_M + rng.uniform(0, 0.3, n) * bends._BIN_M)
    z = 0.02 * x + 0.08 * np.maximum(0.0, x - x[at]) + rng.normal(0, 0.3 * bends._NOISE_M, n)
    ks = range(bends._MIN_BINS, n - bends._MIN_BINS + 1)
    gains = {k: hinge_gain(x, z, k) for k in ks if k < n}
    best = max(gains, key=lambda k: gains[k][0])
    found = bends._find_best_bend(x, z, P.min_slope_break_rad)
    gain, bend, rest = gains[best]
    left = max((rest - gain) / n, bends._NOISE_M**2)
    is_one = abs(bend) >= math.tan(P.min_slope_break_rad) and gain >= bends._MIN_BEND_SD**2 * left
    assert found == (best if is_one else None)
    assert bends._find_best_bend(x, z) == (best if gain >= bends._MIN_BEND_SD**2 * bends._NOISE_M**2 else None)
    assert is_one


def test_few_bins_have_no_bend_and_neither_has_a_line():
    x = np.arange(30) * bends._BIN_M
    assert bends._find_best_bend(x[: 2 * bends._MIN_BINS - 1], x[: 2 * bends._MIN_BINS - 1] ** 2) is None
    assert bends._find_best_bend(x, 0.3 * x + 1.0) is None


def test_a_line_through_bins_is_numpys():
    rng = np.random.default_rng(0)
    s = np.arange(0.5, 2.5, 0.019)
    height = 0.3 * s + rng.normal(0, 0.01, len(s))
    height[10:30] = np.nan
    x, z = bends._bin_heights(s, height)
    bins = np.floor((s - s[0]) / 0.1)
    known = np.isfinite(height)
    there = np.unique(bins[known])
    np.testing.assert_allclose(x, [s[known & (bins == b)].mean() for b in there], rtol=1e-12)
    np.testing.assert_allclose(z, [height[known & (bins == b)].mean() for b in there], rtol=1e-12)
    middle, level, slope, sd = bends._fit_line(x, z)
    (expected, _), covariance = np.polyfit(x, z, 1, cov="unscaled")
    assert (middle, level, slope) == pytest.approx((x.mean(), z.mean(), expected))
    assert sd == pytest.approx(bends._NOISE_M * math.sqrt(covariance[0, 0]))
    assert [len(a) for a in bends._bin_heights(s, np.full(len(s), np.nan))] == [0, 0]
