"""The way as a curve: continuous, true to its arc length, and found again from points beside it."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stridetwin.sim.config import Lanes, Level, Ramp, Route, Stairs, Turn
from stridetwin.sim.world import scenery
from stridetwin.sim.world.route import SPOT_RADIUS_M, lay_out
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.errors import ConfigError

STAIR, RAMP = Stairs(risers=4, riser_m=0.15, tread_m=0.3), Ramp(angle_rad=0.2, rise_m=0.6)
LANES = ((Level(length_m=1.0),), (STAIR,), (RAMP,))

turn = st.builds(
    Turn,
    angle_rad=st.floats(0.3, 1.6) | st.floats(-1.6, -0.3),
    radius_m=st.just(0.0) | st.floats(1.0, 5.0),
)
level = st.builds(Level, length_m=st.floats(0.5, 4.0))
ways = st.lists(st.tuples(level, turn), min_size=1, max_size=3).map(
    lambda pairs: lay_out(Route(segments=(*(s for pair in pairs for s in pair), Level(length_m=1.0)))).way
)


@settings(max_examples=40, deadline=None)
@given(way=ways)
def test_arc_length_is_that_of_the_curve_and_its_tangent_is_the_heading(way):
    s = np.linspace(way.segments[0].s0, way.segments[-1].s1, 4001)
    step = np.diff(way.point(s), axis=0)
    np.testing.assert_allclose(np.linalg.norm(step, axis=1), np.diff(s), rtol=1e-3)
    middle = way.heading((s[1:] + s[:-1]) / 2)
    np.testing.assert_allclose(np.cos(np.arctan2(step[:, 1], step[:, 0]) - middle), 1.0, atol=1e-3)
    np.testing.assert_allclose(np.diff(way.heading(s)), way.curvature((s[1:] + s[:-1]) / 2) * np.diff(s), atol=0.05)


@settings(max_examples=25, deadline=None)
@given(way=ways, left=st.floats(-0.15, 0.15))
def test_a_path_beside_the_way_is_projected_onto_it(way, left):
    s = np.arange(0.0, way.segments[-1].s1, 0.05)
    np.testing.assert_allclose(way.project(way.point(s, left)), s, atol=0.03)


@settings(max_examples=25, deadline=None)
@given(way=ways, share=st.floats(0.0, 1.0), left=st.floats(-0.15, 0.15))
def test_a_single_point_is_projected_where_it_is_said_to_lie(way, share, left):
    s = share * way.segments[-1].s1
    np.testing.assert_allclose(way.project(way.point([s], left), begin=s + 0.1), [s], atol=0.03)


def test_beyond_its_ends_the_way_goes_straight_on():
    way = lay_out(Route(segments=(Level(length_m=1.0), Turn(angle_rad=math.pi / 2, radius_m=2.0)))).way
    end = way.segments[-1].s1
    np.testing.assert_allclose(way.point(-5.0), [-5.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(way.point(end + 1.0, 0.5), way.point(end) + [-0.5, 1.0], atol=1e-9)


def test_headings_do_not_wrap():
    segments = tuple(s for _ in range(4) for s in (Level(length_m=6.0), Turn(angle_rad=-math.pi / 2, radius_m=3.0)))
    layout = lay_out(Route(segments=(*segments, Level(length_m=1.0))))
    assert layout.way.heading(layout.way.segments[-1].s1) == pytest.approx(-2 * math.pi)
    np.testing.assert_allclose(layout.way.point(layout.way.segments[-1].s1 - 3.0), [0.0, 0.0], atol=1e-9)


@settings(max_examples=15, deadline=None)
@given(
    angle=st.floats(-3.1, -0.3) | st.floats(0.3, 3.1),
    radius=st.just(0.0) | st.floats(1.0, 4.0),
    left=st.floats(-0.9, 0.9),
)
def test_the_ground_of_a_turn_has_no_gap(angle, radius, left):
    route = Route(
        segments=(Level(length_m=3.0), Turn(angle_rad=angle, radius_m=radius), Level(length_m=3.0)), width_m=2.0
    )
    terrain = Terrain.from_route(route)
    end = 6.0 + abs(angle) * (radius or SPOT_RADIUS_M)
    points = terrain.layout.way.point(np.linspace(0.0, end, 200), left)
    np.testing.assert_allclose(terrain.height(points), 0.0, atol=1e-12)
    assert set(terrain.terrain_class(points)) == {"level"}


def test_terrain_follows_the_way_after_a_turn():
    curved = Route(
        segments=(Level(length_m=2.0), Turn(angle_rad=math.pi / 2, radius_m=2.0), Level(length_m=1.0), STAIR)
    )
    terrain = Terrain.from_route(curved)
    straight = Terrain.from_route(Route(segments=(Level(length_m=3.0 + math.pi), STAIR)))
    s = np.linspace(0.0, 8.0, 300)
    way = terrain.layout.way
    np.testing.assert_allclose(terrain.height(way.point(s)), straight.height(np.stack([s, 0 * s], -1)), atol=1e-9)
    ramp = Terrain.from_route(Route(segments=(*curved.segments[:3], RAMP, Level(length_m=1.0))))
    slope = ramp.normal(ramp.layout.way.point(2.0 + math.pi + 1.0 + 1.0))
    np.testing.assert_allclose(slope, [0.0, -math.sin(0.2), math.cos(0.2)], atol=1e-9)  # it now rises along +y


def test_cross_slope_tilts_the_ground_with_the_left_side_up():
    terrain = Terrain.from_route(Route(segments=(Level(length_m=1.0), Level(length_m=3.0, cross_slope_rad=0.08))))
    tan = math.tan(0.08)
    np.testing.assert_allclose(
        terrain.height([[2.0, 0.5], [2.0, -0.5], [0.5, 0.5]]), [0.5 * tan, -0.5 * tan, 0.0], atol=1e-12
    )
    np.testing.assert_allclose(terrain.normal([2.0, 0.0]), [0.0, -math.sin(0.08), math.cos(0.08)], atol=1e-12)
    down = terrain.ray_cast([[2.0, 0.7, 3.0]], [[0.0, 0.0, -1.0]])
    assert down[0] == pytest.approx(3.0 - 0.7 * tan)


def test_uneven_risers_are_as_high_as_asked():
    heights = (0.15, 0.18, 0.12)
    profile = lay_out(Route(segments=(Level(length_m=1.0), Stairs(risers=3, riser_m=heights, down=True)))).profile
    rises = [b.z0 - a.z1 for a, b in pairwise(profile)]
    np.testing.assert_allclose(rises, [-h for h in heights])


def test_lanes_lie_side_by_side_and_the_way_crosses_over_on_the_landing():
    route = Route(
        segments=(
            Level(length_m=2.0),
            Lanes(lanes=LANES, walk=1),
            Level(length_m=3.4),
            Lanes(lanes=LANES, walk=2),
            Level(length_m=2.0),
        ),
        width_m=1.6,
    )
    terrain = Terrain.from_route(route)
    plan_length = 0.6 / math.tan(0.2)
    x = 2.0 + plan_length / 2  # the stair is over and padded, the ramp is half way up
    np.testing.assert_allclose(terrain.height([[x, 1.6], [x, 0.0], [x, -1.6]]), [0.0, 0.6, 0.3], atol=1e-9)
    assert terrain.terrain_class([x, -1.6]) == "ramp"
    landing = 2.0 + plan_length + 1.7
    np.testing.assert_allclose(terrain.height([[landing, y] for y in (2.3, 0.0, -2.3)]), 0.6, atol=1e-9)
    end = terrain.layout.way.point(terrain.profile[-1].s1)
    assert end[1] == pytest.approx(-1.6)
    assert terrain.profile[-1].z1 == pytest.approx(1.2)
    s = np.linspace(0.0, terrain.profile[-1].s1 - 2.0, 400)
    points = terrain.layout.way.point(s)
    on_strip = [
        any(p.s0 <= v <= p.s1 and abs(p.height(v, 0.0) - z) < 1e-6 for p in terrain.profile)
        for v, z in zip(s, terrain.height(points))
    ]
    assert all(on_strip)


@pytest.mark.parametrize(
    ("segments", "field", "words"),
    [
        ((Level(length_m=3), Turn(angle_rad=1, radius_m=0.5), Level(length_m=2)), "segments[1].radius_m", "at least"),
        ((Level(length_m=3), Turn(angle_rad=0.0), Level(length_m=2)), "segments[1].angle_rad", "not 0"),
        ((Level(length_m=3), Turn(angle_rad=1.0), STAIR), "segments[2]", "a level of at least 0.5 m"),
        ((Level(length_m=0.4), Turn(angle_rad=1.0), Level(length_m=2)), "segments[0]", "at least 0.5 m"),
        ((Level(length_m=3, cross_slope_rad=0.2),), "segments[0].cross_slope_rad", "5 deg"),
        ((Level(length_m=3), Stairs(risers=3, riser_m=(0.1, 0.1))), "segments[1].riser_m", "3 risers"),
        ((Level(length_m=3), Stairs(risers=2, riser_m=(0.1, 0.5))), "segments[1].riser_m", "0.25"),
        ((Level(length_m=3), Lanes(lanes=LANES, walk=3)), "segments[1].walk", "0-2"),
        ((Level(length_m=3), Lanes(lanes=LANES, walk=0), STAIR), "segments[2]", "a level"),
        (
            (Level(length_m=3), Lanes(lanes=LANES, walk=0), Level(length_m=2), Lanes(lanes=LANES, walk=2)),
            "segments[2].length_m",
            "to cross over",
        ),
        (
            (Level(length_m=8), STAIR, Level(length_m=3), Turn(angle_rad=math.pi, radius_m=0), Level(length_m=8)),
            "segments[4]",
            "at another height",
        ),
        (
            (
                Level(length_m=4),
                Turn(angle_rad=math.pi / 2),
                Level(length_m=2),
                Turn(angle_rad=math.pi / 2),
                Level(length_m=1),
                RAMP,
                Level(length_m=1),
                Turn(angle_rad=math.pi / 2, radius_m=1.0),
                Level(length_m=9),
            ),
            "segments[8]",
            "at another height",
        ),
    ],
)
def test_routes_that_cannot_be_are_refused_with_what_can(segments, field, words):
    with pytest.raises(ConfigError) as caught:
        lay_out(Route(segments=segments))
    assert caught.value.field == field
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_route_may_meet_itself_at_one_height():
    square = tuple(s for _ in range(4) for s in (Level(length_m=6.0), Turn(angle_rad=-math.pi / 2, radius_m=1.5)))
    back = (Level(length_m=4.0), STAIR, Level(length_m=3.0))
    assert lay_out(Route(segments=(*square, Level(length_m=1.0))))
    assert lay_out(Route(segments=back))


def test_a_room_has_walls_and_furniture_beside_the_way():
    route = Route(
        segments=(Level(length_m=4.0), Turn(angle_rad=-math.pi / 2, radius_m=0.0), Level(length_m=3.0)),
        width_m=1.2,
        scenery="room",
    )
    terrain = Terrain.from_route(route)
    walls = [m for m in terrain.landmarks if m.material == "plaster"]
    assert len(walls) == 4
    assert len(terrain.landmarks) > 12
    s = np.arange(0.0, terrain.profile[-1].s1 - 2.0, 0.1)
    origins = np.column_stack([terrain.layout.way.point(s), np.full(len(s), 0.9)])
    heading = terrain.layout.way.heading(s)
    for angle in np.linspace(0.0, 2 * np.pi, 16, endpoint=False):
        rays = np.column_stack([np.cos(heading + angle), np.sin(heading + angle), 0 * s])
        distance = terrain.ray_cast(origins, rays)
        assert np.isfinite(distance).all()  # every ray ends at a wall
        assert distance.min() > 0.6  # and nothing stands in the way
    np.testing.assert_allclose(terrain.height(terrain.layout.way.point(s, 2.5)), 0.0)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31), count=st.integers(1, 6))
def test_what_is_left_of_a_polygon_and_its_holes_cover_it_once(seed, count):
    rng = np.random.default_rng(seed)

    def rectangle(yaw, centre):
        c, s = math.cos(yaw), math.sin(yaw)
        return np.array([[-2, -1], [2, -1], [2, 1], [-2, 1]]) @ np.array([[c, s], [-s, c]]) + centre

    def inside(polygon, points):
        run = np.roll(polygon, -1, axis=0) - polygon
        to = points[:, None] - polygon
        return np.all(run[:, 0] * to[..., 1] - run[:, 1] * to[..., 0] > 0.0, axis=1)

    polygon = rectangle(0.0, np.zeros(2))
    fan = [rectangle(0.17 * k, rng.uniform(-0.3, 0.3, 2) * (seed % 2)) for k in range(1, count + 1)]
    quads = [q for p in scenery.subtract_holes(polygon, fan) for q in scenery.split_into_quads(p)]
    points = rng.uniform([-2, -1], [2, 1], (400, 2))
    expected = ~np.any([inside(hole, points) for hole in fan], axis=0)
    found = np.sum([inside(p, points) for p in quads], axis=0) if quads else np.zeros(len(points))
    assert np.mean(found != expected) < 0.01  # but for points on a cut
