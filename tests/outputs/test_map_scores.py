"""Scores of a terrain map, of a map whose errors are known: the true ground in a rotated and shifted world."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from stridetwin.estimators.terrain_map.estimate import Change, Plane
from stridetwin.estimators.terrain_map.estimate import Level as LevelGround
from stridetwin.estimators.terrain_map.estimate import Stairs as MappedStairs
from stridetwin.outputs.alignment import YawAlignment
from stridetwin.outputs.modes.scores import ModeScores, mode_figures
from stridetwin.outputs.terrain import mapped_route, snapshots
from stridetwin.outputs.terrain.changes import ScoredChange
from stridetwin.outputs.terrain.grid import GROUND_CLASSES
from stridetwin.outputs.terrain.scores import MapScorer, MapScores, cells_ahead, map_figures, points_ahead, true_heights
from stridetwin.sim.config import Level, Ramp, Route, Stairs, Turn
from stridetwin.sim.world.route import lay_out

LAYOUT = lay_out(
    Route(
        segments=(
            Level(length_m=3),
            Stairs(risers=3, riser_m=0.15, tread_m=0.3),
            Level(length_m=3),
            Stairs(risers=3, riser_m=0.15, tread_m=0.3, down=True),
            Level(length_m=2),
            Turn(angle_rad=math.pi / 2, radius_m=1.5),
            Level(length_m=2),
            Ramp(angle_rad=0.2, rise_m=0.4),
            Level(length_m=3),
        )
    )
)
UP, DOWN = 3.0, 3.0 + 2 * 0.3 + 3.0
RAMP = next(p.s0 for p in LAYOUT.profile if p.terrain == "ramp")
ALIGNMENT = YawAlignment(estimated=np.array([1.0, -2.0, 0.5]), true=np.array([0.3, 0.4, 1.7]), yaw=0.7)
DENSE = np.arange(-1.0, LAYOUT.profile[-1].s1 + 1.0, 0.02)


def located(xy):
    """(N,) m along the route and to its left, of (N, 2) points near it in the true world; by search."""
    way, heading = LAYOUT.way.point(DENSE), LAYOUT.way.heading(DENSE)
    k = np.argmin(np.linalg.norm(np.asarray(xy)[:, None] - way, axis=2), axis=1)
    offset = xy - way[k]
    c, s = np.cos(heading[k]), np.sin(heading[k])
    return DENSE[k] + offset[:, 0] * c + offset[:, 1] * s, offset[:, 1] * c - offset[:, 0] * s


def height(s, left=0.0):
    """m, from the strips one by one."""
    strip = next((p for p in LAYOUT.profile if p.s0 <= s < p.s1), LAYOUT.profile[-1])
    return strip.height(s, left)


def in_map(points):
    """Points of the true world in the map's, by the inverse of a rigid transform in homogeneous coordinates."""
    c, s = math.cos(ALIGNMENT.yaw), math.sin(ALIGNMENT.yaw)
    T = np.eye(4)
    T[:3, :3] = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    T[:3, 3] = ALIGNMENT.true - T[:3, :3] @ ALIGNMENT.estimated
    return (np.column_stack([points, np.ones(len(points))]) @ np.linalg.inv(T).T)[:, :3]


def true_points(s, left, above=0.0):
    s, left = np.broadcast_arrays(np.asarray(s, float), left)
    return np.column_stack([LAYOUT.way.point(s, left), [height(a, b) for a, b in zip(s, left)] + np.asarray(above)])


def mapped_flight(s, riser, tread, edges, *, up=True, steps=3):
    """A flight in the map's world that begins at an arc length of the first straight part; `edges` along the walk."""
    heading = -ALIGNMENT.yaw + (0.0 if up else math.pi)
    direction = np.array([math.cos(heading), math.sin(heading)])
    places = in_map(true_points(edges, 0.0))[:, :2]
    at, beside = places @ direction, float(places[0] @ [-direction[1], direction[0]])
    return MappedStairs(
        id=1,
        planes=tuple(range(steps + 1)),
        steps=steps,
        riser=riser,
        tread=tread,
        heading=heading,
        start=float(min(at)),
        base=1.0,
        covariance=np.diag([1.0, 4.0, 9.0, 16.0, 25.0]) * 1e-6,
        edges=np.sort(at),
        risers=np.full(steps, riser),
        across=beside + np.array([-0.6, 0.9]),
    )


class KnownMap:
    """In the place of a map: everything that scores read of one, each with a chosen error."""

    def __init__(self, *, points=None, flights=(), changes=(), here=0.0, slope=None, error=lambda s, left: 0.0):
        self._points, self._changes, self._here, self._slope, self._error = points, changes, here, slope, error
        self.estimate = SimpleNamespace(stairs=flights)

    def surface_points(self):
        points = np.zeros((0, 3)) if self._points is None else self._points
        return in_map(points), np.zeros(len(points), int)

    def heights(self, xy):
        s, left = located(ALIGNMENT.to_true(xy))
        z = true_points(s, left, [self._error(a, b) for a, b in zip(s, left)])
        return in_map(z)[:, 2]

    def profile(self, origin, heading):
        np.testing.assert_allclose(origin, in_map(true_points([self._here], 0.0))[0, :2], atol=1e-9)
        assert heading == pytest.approx(float(LAYOUT.way.heading(self._here)) - ALIGNMENT.yaw)
        return SimpleNamespace(changes=self._changes)

    def ground(self, xy):
        if self._slope is None:
            return None
        s, _ = located(ALIGNMENT.to_true(np.asarray(xy)[None]))
        assert RAMP + 0.3 < s[0] < RAMP + 0.9
        heading = float(LAYOUT.way.heading(RAMP)) - ALIGNMENT.yaw
        gradient = math.tan(self._slope) * np.array([math.cos(heading), math.sin(heading)])
        return SimpleNamespace(slope=abs(self._slope), gradient=gradient, slope_sd=0.004), None


def scored(mapper, here, feet=((10**12, 0.0),)):
    """Scores of one look at a time when no change is scored, or when those are that `feet` give."""
    scorer = MapScorer(LAYOUT, np.array(feet, float))
    assert scorer.sample(10**9, mapper, ALIGNMENT, here)
    return scorer.scores()


def test_heights_of_the_ground_are_those_of_its_strips():
    tilted = [
        SimpleNamespace(s0=0.0, z0=0.3, slope=0.2, cross_slope=-0.1),
        SimpleNamespace(s0=2.0, z0=1.0, slope=-0.3, cross_slope=0.05),
    ]
    s, left = np.array([-0.5, 0.0, 1.5, 2.0, 3.5]), np.array([0.4, -0.2, 0.0, 0.7, -1.0])
    expected = [
        0.3 + math.tan(0.2) * -0.5 - math.tan(0.1) * 0.4,
        0.3 + math.tan(0.1) * 0.2,
        0.3 + math.tan(0.2) * 1.5,
        1.0 + math.tan(0.05) * 0.7,
        1.0 - math.tan(0.3) * 1.5 - math.tan(0.05),
    ]
    np.testing.assert_allclose(true_heights(tilted, s, left), expected, rtol=1e-12)


@pytest.mark.parametrize("here", [0.5, RAMP - 5.0], ids=["straight", "before a turn"])
def test_the_ground_ahead_is_two_metres_long_and_one_wide(here):
    """In a turn along the route, but never farther than 2.5 m away."""
    inside = [(0.52, 0.0), (0.52, 0.45), (1.0, -0.45), (1.513, 0.2), (2.3, -0.3), (2.46, 0.0)]
    outside = [(0.4, 0.0), (-1.0, 0.0), (2.56, 0.0), (2.7, 0.1), (1.0, 0.55), (1.0, -0.55), (1.5, 1.4)]
    points = [true_points([here + s for s, _ in of], [left for _, left in of]) for of in (inside, outside)]
    found = points_ahead(np.vstack(points), here, LAYOUT)
    if here == 0.5:
        np.testing.assert_array_equal(found, points[0])
    else:
        near = np.linalg.norm(points[0][:, :2] - LAYOUT.way.point(here), axis=1) < 2.5
        np.testing.assert_array_equal(found[: near.sum()], points[0][near])
        assert len(found) <= near.sum() + 1  # the curve passes some of the others once more


def test_there_is_no_ground_beyond_the_route_and_none_where_nothing_is_mapped():
    end = LAYOUT.profile[-1].s1
    assert points_ahead(true_points([end + 1.0], 0.0), end, LAYOUT).shape == (0, 3)
    assert points_ahead(true_points([0.0, 9.0], 0.0), 0.5, LAYOUT).shape == (0, 3)
    assert points_ahead(np.zeros((0, 3)), 0.5, LAYOUT).shape == (0, 3)
    assert math.isnan(scored(KnownMap(here=end), end).completeness)


def test_cells_ahead_cover_both_sides_every_five_centimetres():
    s, left = cells_ahead(0.5, LAYOUT)
    assert len(s) == len(left) == 40 * 21
    assert (s.min(), s.max(), left.min(), left.max()) == pytest.approx((1.0, 2.95, -0.5, 0.5))
    short, _ = cells_ahead(LAYOUT.profile[-1].s1 - 1.0, LAYOUT)
    assert short.max() == pytest.approx(LAYOUT.profile[-1].s1 - 0.05)


def test_accuracy_is_the_distance_of_every_fifth_point_from_the_ground():
    s = np.repeat(np.linspace(1.05, 2.4, 50), 5)
    above = np.where(np.arange(250) % 5 == 0, 0.01, 0.2)  # four of five points are not measured
    above[:25] = np.where(np.arange(25) % 5 == 0, -0.03, 0.2)
    scores = scored(KnownMap(here=0.5, points=true_points(s, 0.1, above)), 0.5)
    assert scores.accuracy_m == pytest.approx(math.sqrt((5 * 0.03**2 + 45 * 0.01**2) / 50), rel=1e-9)
    assert scores.accuracy_p95_m == pytest.approx(np.percentile([0.03] * 5 + [0.01] * 45, 95), rel=1e-9)


@pytest.mark.parametrize("here", [0.5, 1.52, RAMP - 1.2])
def test_the_ground_is_complete_where_it_is_known_within_three_centimetres(here):
    def error(s, left):
        return -0.028 if left > 0.025 else 0.032

    assert scored(KnownMap(here=here, error=error), here).completeness == pytest.approx(10 / 21)


def test_edges_are_compared_with_the_nearest_true_one():
    here = 1.0

    def edge(s, sd=0.01, kind="edge"):
        return Change(kind=kind, s=s - here, sd=sd, drop=0.1, bend=0.0)

    changes = (edge(UP + 0.01), edge(UP + 0.28), edge(UP + 1.6), edge(UP, sd=0.03), edge(UP, kind="slope_break"))
    scores = scored(KnownMap(here=here, changes=changes), here)
    np.testing.assert_allclose(scores.edge_errors, [0.01, -0.02, 1.0], atol=1e-9)


def test_an_edge_straight_ahead_of_a_route_that_turns_is_not_scored():
    turn = RAMP - 2.0 - 1.5 * math.pi / 2  # where it begins
    here = turn - 1.0
    changes = tuple(Change(kind="edge", s=s, sd=0.01, drop=0.1, bend=0.0) for s in (0.9, 1.3, 1.5))
    found = scored(KnownMap(here=here, changes=changes), here).edge_errors
    last = DOWN + 0.6
    np.testing.assert_allclose(found, [here + 0.9 - last, here + 1.3 - last], atol=1e-9)


def test_edges_of_a_winding_stair_are_compared_straight_ahead():
    stairs = Stairs(risers=6, tread_m=0.28, turn_rad=math.radians(60.0))
    winding = lay_out(Route(segments=(Level(length_m=3), stairs, Level(length_m=3)), width_m=1.2))
    here, radius, part = 2.8, 5 * 0.28 / math.radians(60.0), math.radians(12.0)
    true = 0.2 + np.array([0.0, radius * math.tan(part)])  # a straight line meets the second edge later than the arc
    changes = tuple(Change(kind="edge", s=float(s), sd=0.01, drop=0.1, bend=0.0) for s in true)
    scorer = MapScorer(winding, np.array([[10**12, 0.0]]))
    scorer.sample(0, KnownMap(here=here, changes=changes), ALIGNMENT, here)
    np.testing.assert_allclose(scorer.scores().edge_errors, 0.0, atol=1e-9)


def test_an_edge_where_the_route_has_none_is_infinitely_wrong():
    level = lay_out(Route(segments=(Level(length_m=6),)))
    scorer = MapScorer(level, np.array([[10**12, 0.0]]))
    mapper = KnownMap(here=1.0, changes=(Change(kind="edge", s=1.0, sd=0.01, drop=0.1, bend=0.0),))
    scorer.sample(0, mapper, ALIGNMENT, 1.0)
    assert scorer.scores().edge_errors.tolist() == [math.inf]


FEET = (
    (0, 0.0),
    (4_000_000_000, UP - 0.1),
    (5_000_000_000, UP + 0.1),
    (6_000_000_000, DOWN + 0.1),
    (9_000_000_000, RAMP + 0.1),
)
SEEN_NS = {"SA": 3_500_000_000, "SD": 4_500_000_000, "RA": 7_500_000_000}
"""1.5 s before the first foot beyond each change."""


def change(mode, mapper, here=0.0, late_ns=0):
    """The score of one change of the route."""
    scorer = MapScorer(LAYOUT, np.array(FEET, float))
    nothing = KnownMap(here=here)
    for other, t_ns in SEEN_NS.items():
        scorer.sample(t_ns + late_ns if other == mode else t_ns, mapper if other == mode else nothing, ALIGNMENT, here)
    found = dict(zip(SEEN_NS, scorer.scores().changes, strict=True))
    assert [c.mode for c in found.values()] == list(SEEN_NS)
    return found[mode]


@pytest.mark.parametrize(("mode", "s"), [("SA", UP), ("SD", DOWN)])
@pytest.mark.parametrize("shift", [0.02, -0.34, 0.34])
def test_a_flight_is_scored_by_its_first_edge_and_its_sizes(mode, s, shift):
    edges = s + shift + np.array([0.0, 0.305, 0.61])
    found = change(mode, KnownMap(flights=(mapped_flight(s, 0.152, 0.305, edges, up=mode == "SA"),)))
    assert found.is_detected
    assert found.distance_m == pytest.approx(shift, abs=1e-9)
    assert (found.riser_m, found.tread_m) == pytest.approx((0.002, 0.005), abs=1e-9)
    assert (found.riser_sd_m, found.tread_sd_m) == pytest.approx((0.001, 0.002))


@pytest.mark.parametrize("mode", ["SA", "SD"])
def test_a_flight_elsewhere_of_the_other_direction_or_of_one_step_is_not_found(mode):
    s, up = (UP, True) if mode == "SA" else (DOWN, False)
    right = mapped_flight(s, 0.15, 0.3, s + np.array([0.0, 0.3, 0.6]), up=up)
    for wrong in (
        mapped_flight(s, 0.15, 0.3, s + 0.36 + np.array([0.0, 0.3, 0.6]), up=up),
        mapped_flight(s, 0.15, 0.3, s - 0.36 + np.array([0.0, 0.3, 0.6]), up=up),
        mapped_flight(s, 0.15, 0.3, s + np.array([0.0, 0.3, 0.6]), up=not up),
        mapped_flight(s, 0.15, 0.3, s + np.array([0.0]), up=up, steps=1),
    ):
        assert (
            change(mode, KnownMap(flights=(wrong,))) == ScoredChange(mode=mode, is_detected=False)
            or not change(mode, KnownMap(flights=(wrong,))).is_detected
        )
        assert change(mode, KnownMap(flights=(wrong, right))).is_detected
    assert change(mode, KnownMap(flights=(right,)), late_ns=190_000_000).is_detected
    assert not change(mode, KnownMap(flights=(right,)), late_ns=200_000_000).is_detected


def test_the_flight_with_the_most_steps_is_the_one_that_counts():
    short = mapped_flight(UP, 0.2, 0.3, UP + np.array([0.0, 0.3]), steps=2)
    whole = mapped_flight(UP, 0.153, 0.3, UP + np.array([0.0, 0.3, 0.6]))
    assert change("SA", KnownMap(flights=(short, whole))).riser_m == pytest.approx(0.003)


def test_a_ramp_is_scored_by_its_slope_and_the_nearest_slope_break():
    here = RAMP - 1.0

    def breaks(*places, kind="slope_break"):
        return tuple(Change(kind=kind, s=s - here, sd=0.01, drop=0.0, bend=0.2) for s in places)

    changes = (*breaks(RAMP - 0.5, RAMP + 0.03, RAMP + 0.4), *breaks(RAMP, kind="edge"))
    found = change("RA", KnownMap(here=here, slope=0.21, changes=changes), here)
    assert found.is_detected
    assert (found.distance_m, found.slope_rad, found.slope_sd_rad) == pytest.approx((0.03, 0.01, 0.004), abs=1e-9)
    gentle = change("RA", KnownMap(here=here, slope=math.radians(4.9), changes=changes), here)
    assert not gentle.is_detected
    assert gentle.distance_m == pytest.approx(0.03)
    assert not change("RA", KnownMap(here=here, changes=changes), here).is_detected
    assert change("RA", KnownMap(here=here, slope=-0.19, changes=changes), here).slope_rad == pytest.approx(-0.39)


def test_a_map_is_sampled_each_half_second():
    scorer = MapScorer(LAYOUT, np.array([[10**12, 0.0]]))
    times = [0, 499_999_999, 500_000_000, 900_000_000, 1_100_000_000, 1_599_999_999, 1_600_000_000]
    assert [scorer.sample(t, KnownMap(here=1.0), ALIGNMENT, 1.0) for t in times] == [1, 0, 1, 0, 1, 0, 1]


def test_figures_of_a_map_have_their_units():
    changes = (
        ScoredChange(mode="SA", is_detected=True, distance_m=0.003, riser_m=-0.002, tread_m=0.006),
        ScoredChange(mode="RA", is_detected=True, distance_m=-0.004, slope_rad=0.02),
        ScoredChange(mode="SD", is_detected=False),
    )
    errors = np.array([0.1, -0.139, 0.141, -0.5, math.inf])
    figures = map_figures(
        MapScores(changes=changes, accuracy_m=0.004, accuracy_p95_m=0.009, completeness=0.9, edge_errors=errors)
    )
    assert figures == pytest.approx(
        {
            "accuracy_rmse_mm": 4.0,
            "accuracy_p95_mm": 9.0,
            "completeness_pct": 90.0,
            "edge_rmse_mm": math.sqrt((100.0**2 + 139.0**2) / 2),
            "edge_mean_mm": -19.5,
            "edge_false_pct": 60.0,
            "found_pct": 200.0 / 3.0,
            "begin_rmse_mm": math.sqrt(12.5),
            "riser_rmse_mm": 2.0,
            "tread_rmse_mm": 6.0,
            "slope_rmse_deg": math.degrees(0.02),
        }
    )


def test_figures_of_predicted_changes_have_their_units():
    """By size and direction; a size with a standard deviation at its bound or above it was not observed."""
    approaches = [
        ScoredChange(
            mode="SA",
            is_detected=True,
            distance_m=-0.03,
            distance_sd_m=0.02,
            riser_m=0.003,
            riser_sd_m=0.019,
            tread_m=-0.004,
            tread_sd_m=0.039,
        ),
        ScoredChange(
            mode="SA",
            is_detected=True,
            distance_m=0.05,
            distance_sd_m=0.02,
            riser_m=0.03,
            riser_sd_m=0.021,
            tread_m=0.2,
            tread_sd_m=0.041,
        ),
        ScoredChange(
            mode="SD", is_detected=True, distance_m=0.01, distance_sd_m=0.02, riser_m=-0.005, riser_sd_m=0.001
        ),
        ScoredChange(mode="LG", is_detected=True, distance_m=-0.07, distance_sd_m=0.01),
        ScoredChange(
            mode="RA", is_detected=True, distance_m=0.06, distance_sd_m=0.1, slope_rad=0.01, slope_sd_rad=0.02
        ),
        ScoredChange(
            mode="RD",
            is_detected=True,
            distance_m=-0.08,
            distance_sd_m=0.1,
            slope_rad=-0.02,
            slope_sd_rad=math.radians(1.6),
        ),
        ScoredChange(mode="RA", is_detected=False),
    ]
    f = mode_figures([ModeScores(steps=[], approaches=approaches)])
    assert f["changes"] == 7
    assert f["changes_found_pct"] == pytest.approx(600 / 7)
    assert f["begins_found_pct"] == pytest.approx(500 / 6)
    assert f["distance_median_mm"] == pytest.approx({"stairs": 30.0, "ramps": 70.0, "ends": 70.0})
    assert f["riser_rmse_mm"] == pytest.approx(math.sqrt((9.0 + 25.0) / 2))
    assert f["tread_rmse_mm"] == pytest.approx(4.0)
    assert f["slope_rmse_deg"] == pytest.approx(math.degrees(0.01))
    riser, tread, slope = (f["sizes"][name] for name in ("riser_mm", "tread_mm", "slope_deg"))
    assert riser["up"] == pytest.approx({"seen_pct": 50.0, "rmse": 3.0, "all_rmse": math.sqrt((9.0 + 900.0) / 2)})
    assert riser["down"] == pytest.approx({"seen_pct": 100.0, "rmse": 5.0, "all_rmse": 5.0})
    assert tread["up"] == pytest.approx({"seen_pct": 50.0, "rmse": 4.0, "all_rmse": math.sqrt((16.0 + 200.0**2) / 2)})
    assert tread["down"] == {"seen_pct": 0.0, "rmse": None, "all_rmse": None}
    assert slope["up"] == pytest.approx({"seen_pct": 50.0, "rmse": math.degrees(0.01), "all_rmse": math.degrees(0.01)})
    assert slope["down"] == {"seen_pct": 0.0, "rmse": None, "all_rmse": pytest.approx(math.degrees(0.02))}
    # riser 0.003, 0.03 and -0.005, tread -0.004 and 0.2, slope 0.01 and -0.02: those of 1.96 standard deviations
    assert f["inside_95_pct"] == pytest.approx(100 * 5 / 7)
    assert f["distance_inside_95_pct"] == pytest.approx(100 * 4 / 6)


def plane(id_, centre, *, gradient=(0.0, 0.0), area=1.0, spread=None):
    normal = np.array([-gradient[0], -gradient[1], 1.0])
    return Plane(
        id=id_,
        centre=np.asarray(centre, float),
        normal=normal / np.linalg.norm(normal),
        area_m2=area,
        spread=np.eye(2) / 12.0 if spread is None else spread,
        votes=9.0,
        covariance=np.zeros((3, 3)),
    )


def test_the_outline_of_a_plane_is_the_rectangle_of_its_points():
    """Corners of a rectangle of 1.2 m by 0.4 m, rotated, on a slope, in order around it."""
    angle, size = 0.5, np.array([1.2, 0.4])
    axes = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    it = plane(0, [1.0, 2.0, 0.5], gradient=(0.1, -0.2), spread=axes @ np.diag(size**2 / 12.0) @ axes.T)
    outline = snapshots._outline(it)
    np.testing.assert_array_equal(outline[0], outline[4])
    sides = np.linalg.norm(np.diff(outline[:, :2], axis=0), axis=1)
    np.testing.assert_allclose(sorted(sides), [0.4, 0.4, 1.2, 1.2])
    np.testing.assert_allclose(outline[:4].mean(axis=0), it.centre, atol=1e-12)
    np.testing.assert_allclose((outline - it.centre) @ it.normal, 0.0, atol=1e-12)
    longest = np.diff(outline[:, :2], axis=0)[sides.argmax()]
    assert abs(longest @ axes[:, 0]) == pytest.approx(1.2)


class KnownGrid:
    """In the place of the ground as a grid: true heights plus 1 cm, known between two arc lengths."""

    def __init__(self, first, last):
        self._first, self._last = first, last

    def at(self, xy):
        s, left = located(ALIGNMENT.to_true(xy.reshape(-1, 2)))
        z = in_map(true_points(s, left, 0.01))[:, 2]
        known = (s > self._first) & (s < self._last)
        shape = xy.shape[:-1]
        return np.where(known, z, np.nan).reshape(shape), np.where(known, 0, -1).reshape(shape)


def level_estimate(flights=()):
    return SimpleNamespace(stairs=flights, terrain_of=lambda k: LevelGround(id=0, plane=0) if k == 0 else None)


def test_the_straightened_ground_is_what_was_last_seen_of_it():
    mapper, here = mapped_route.RouteMapper(LAYOUT, -0.5, 9.0), 1.0
    mapper.add(KnownGrid(-9.0, 2.9), level_estimate(), ALIGNMENT, here)
    seen = mapper.result()
    assert (seen.s[0], seen.left[0], seen.left[-1]) == pytest.approx((-0.48, -0.98, 0.98))
    known = np.isfinite(seen.height)
    expected = (seen.s > here - 0.2) & (seen.s < 2.9)
    assert (known == expected[:, None]).all()
    np.testing.assert_allclose(seen.height[known], 0.01, atol=1e-9)
    assert (seen.classes[known] == GROUND_CLASSES.index("LG")).all()
    assert (seen.classes[~known] == GROUND_CLASSES.index("none")).all()
    mapper.add(KnownGrid(-9.0, 20.0), level_estimate(), ALIGNMENT, 2.0)
    seen = mapper.result()
    known = np.isfinite(seen.height).all(axis=1)
    assert (known == (seen.s > here - 0.2) & (seen.s < 2.0 + 2.5)).all()
    np.testing.assert_allclose(seen.height[known, 0] - [height(s) for s in seen.s[known]], 0.01, atol=1e-9)


def test_edges_ahead_are_stored_with_their_ends_and_replaced_when_seen_again():
    mapper, grid = mapped_route.RouteMapper(LAYOUT, -0.5, 9.0), KnownGrid(0.0, 0.0)

    def sample(edges, here, up=True):
        mapper.add(grid, level_estimate((mapped_flight(0.0, 0.15, 0.3, np.array(edges), up=up),)), ALIGNMENT, here)
        return mapper.result().edges

    first = sample([UP + 0.05, UP + 0.18, UP + 0.9], 2.0)
    np.testing.assert_allclose(first, [[UP + 0.05, -0.6, 0.9], [UP + 0.18, -0.6, 0.9]], atol=1e-9)
    again = sample([UP + 0.01, UP + 0.27, UP + 0.62], 2.5)
    np.testing.assert_allclose(again[:, 0], [UP + 0.01, UP + 0.27, UP + 0.62], atol=1e-9)
    down = mapped_route.RouteMapper(LAYOUT, -0.5, 9.0)
    down.add(
        grid,
        level_estimate((mapped_flight(0.0, 0.15, 0.3, np.array([DOWN]), up=False, steps=1),)),
        ALIGNMENT,
        DOWN - 0.6,
    )
    np.testing.assert_allclose(down.result().edges, [[DOWN, -0.9, 0.6]], atol=1e-9)


@pytest.mark.parametrize(
    ("ends", "kept"),
    [
        (((0.5, -0.4), (0.5, 0.4)), True),
        (((0.5, 0.28), (0.5, 1.0)), True),
        (((0.5, 0.32), (0.5, 1.0)), False),
        (((0.5, -1.0), (0.5, -0.32)), False),
        (((0.1, -0.3), (0.9, 0.3)), False),
        (((0.3, -0.3), (0.7, 0.3)), True),
        (((1.25, -0.4), (1.25, 0.4)), False),
        (((-0.1, -0.4), (-0.1, 0.4)), False),
    ],
)
def test_an_edge_of_the_route_crosses_it(ends, kept):
    """Not those beside it, along it, behind the walker or farther ahead than 1.2 m."""
    mapper = mapped_route.RouteMapper(LAYOUT, -0.5, 9.0)
    a, b = (np.array([1.0 + s, left, 0.15]) for s, left in ends)
    mapper._keep_edge(a, b, 1.0)
    found = mapper.result().edges
    assert len(found) == kept
    if kept:
        middle = next((a[0] + (b[0] - a[0]) * t for t in (-a[1] / (b[1] - a[1]),) if 0 <= t <= 1), a[0])
        assert found[0, 0] == pytest.approx(middle, abs=0.02)
        np.testing.assert_allclose(found[0, 1:], sorted((a[1], b[1])), atol=1e-9)


def test_lines_of_edges_lie_on_the_treads_above_them():
    flight = mapped_flight(UP, 0.15, 0.3, UP + np.array([0.0, 0.3, 0.6]))
    flight.edges[1] = np.nan
    low, high = mapped_route.edge_lines(flight)
    for line, s, z in ((low, UP, 1.15), (high, UP + 0.6, 1.45)):
        true = ALIGNMENT.to_true(line)
        np.testing.assert_allclose(true[:, :2], [[s, -0.6], [s, 0.9]], atol=1e-9)
        np.testing.assert_allclose(line[:, 2], z)


def test_a_snapshot_shows_one_point_per_cell_and_the_planes_nearby():
    eye = in_map(true_points([2.0], 0.0, 1.6))[0]
    rng = np.random.default_rng(0)
    points = np.vstack(
        [
            eye + [0.55, 0.55, 0.0] + rng.uniform(-0.049, 0.049, (40, 3)),
            eye + [[-2.95, 0.05, -1.6]],
            eye + [[0.05, 3.02, -1.6], [1.25, 0.35, -1.6]],
        ]
    )
    planes = {
        0: plane(0, eye + [1.0, 0.0, -1.6]),
        1: plane(1, eye + [1.0, 1.0, -1.6], area=0.049),
        2: plane(2, eye + [0.0, 3.1, -1.6]),
    }
    flight = mapped_flight(UP, 0.15, 0.3, UP + np.array([0.0, 0.3, 0.6]))
    estimate = SimpleNamespace(
        t_ns=7, planes=planes, p_camera_in_world=eye, stairs=(flight,), terrain_of=level_estimate().terrain_of
    )
    grid = SimpleNamespace(points=lambda: (points, np.r_[np.zeros(40, int), -1, 0, 0]))
    shown = snapshots.take_snapshot(grid, estimate, ALIGNMENT, 0.0)
    assert shown.t_ns == 7
    np.testing.assert_allclose(shown.points, ALIGNMENT.to_true(points[[40, 0, 42]]), atol=1e-5)
    assert shown.classes.tolist() == [
        GROUND_CLASSES.index("none"),
        GROUND_CLASSES.index("LG"),
        GROUND_CLASSES.index("LG"),
    ]
    ((outline, kind),) = shown.planes
    assert kind == GROUND_CLASSES.index("LG")
    np.testing.assert_allclose(outline[:4].mean(axis=0), ALIGNMENT.to_true(planes[0].centre), atol=1e-9)
    assert len(shown.edges) == 3
    np.testing.assert_allclose(shown.edges[2][:, :2], [[UP + 0.6, -0.6], [UP + 0.6, 0.9]], atol=1e-9)
