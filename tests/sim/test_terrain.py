import itertools
import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stridetwin.sim.config import Lanes, Level, Ramp, Route, Stairs, Thing
from stridetwin.sim.world.scenery import paint_slabs
from stridetwin.sim.world.solids import Solid, SolidSet
from stridetwin.sim.world.terrain import Terrain
from stridetwin.sim.world.textures import PERIOD_M
from stridetwin.streams.errors import ConfigError

ROUTE = Route(
    segments=(
        Level(length_m=3.0),
        Stairs(risers=4, riser_m=0.17, tread_m=0.28),
        Level(length_m=1.5),
        Ramp(angle_rad=math.radians(10), rise_m=0.3, down=True),
        Level(length_m=1.0),
        Stairs(risers=2, riser_m=0.10, tread_m=0.30, down=True),
        Level(length_m=1.0),
    ),
)
TERRAIN = Terrain.from_route(ROUTE)
RAMP_X = 3.0 + 3 * 0.28 + 1.5

level = st.builds(Level, length_m=st.floats(0.3, 4.0))
ramp = st.builds(Ramp, angle_rad=st.floats(0.03, math.radians(20)), rise_m=st.floats(0.05, 0.8), down=st.booleans())
stairs = st.builds(
    Stairs,
    risers=st.integers(1, 6),
    riser_m=st.floats(0.03, 0.25),
    tread_m=st.floats(0.2, 0.5),
    down=st.booleans(),
    nosing_m=st.sampled_from([0.0, 0.03]),
    open_risers=st.booleans(),
    tread_slope_rad=st.sampled_from([0.0, 0.03]),
)
routes = st.lists(st.tuples(level, st.one_of(ramp, stairs)), min_size=1, max_size=3).map(
    lambda pairs: Route(segments=tuple(s for pair in pairs for s in pair))
)


def test_height_class_and_normal_along_the_way():
    xy = [[-1.9, 0], [2.9, 0.5], [3.1, -1.1], [3.0 + 0.28 * 3 + 0.1, 0], [RAMP_X + 0.1, 0]]
    drop = 0.1 * math.tan(math.radians(10))
    np.testing.assert_allclose(TERRAIN.height(xy), [0, 0, 0.17, 0.68, 0.68 - drop], atol=1e-12)
    assert TERRAIN.terrain_class(xy).tolist() == ["level", "level", "stair", "level", "ramp"]
    expected = [math.sin(math.radians(10)), 0.0, math.cos(math.radians(10))]
    np.testing.assert_allclose(TERRAIN.normal(xy[4]), expected, atol=1e-12)
    np.testing.assert_allclose(TERRAIN.normal(xy[:4]), np.tile([0, 0, 1], (4, 1)))


def test_lead_in_run_out_and_ground():
    assert TERRAIN.profile[0].s0 == -2.0
    end = sum(s.s1 - s.s0 for s in TERRAIN.profile) - 2.0
    assert TERRAIN.profile[-1].s1 == pytest.approx(end)
    lowest = min(s.z0 for s in TERRAIN.profile)
    assert TERRAIN.height([0.0, 5.0]) == TERRAIN.ground_m < lowest
    assert TERRAIN.height([0.0, 1.199]) == 0.0


def test_a_riser_belongs_to_its_upper_side():
    assert TERRAIN.height([3.0, 0.0]) == pytest.approx(0.17)


@settings(max_examples=40, deadline=None)
@given(route=routes, seed=st.integers(0, 2**31))
def test_queries_agree_with_the_profile(route, seed):
    terrain = Terrain.from_route(route)
    rng = np.random.default_rng(seed)
    for a, b in zip(terrain.profile[:-1], terrain.profile[1:]):
        assert a.s1 == pytest.approx(b.s0)
    for strip in terrain.profile:
        x = rng.uniform(strip.s0 + 1e-6, strip.s1 - 1e-6, 4)
        xy = np.column_stack([x, rng.uniform(-1.19, 1.19, 4)])
        np.testing.assert_allclose(
            terrain.height(xy), np.interp(x, [strip.s0, strip.s1], [strip.z0, strip.z1]), atol=1e-9
        )
        assert set(terrain.terrain_class(xy)) == {strip.terrain}


@settings(max_examples=25, deadline=None)
@given(route=routes, seed=st.integers(0, 2**31))
def test_a_ray_straight_down_measures_the_height(route, seed):
    terrain = Terrain.from_route(route)
    rng = np.random.default_rng(seed)
    end = terrain.profile[-1].s1
    xy = np.column_stack([rng.uniform(-2.5, end + 0.5, 50), rng.uniform(-1.4, 1.4, 50)])
    origins = np.column_stack([xy, np.full(50, 9.0)])
    np.testing.assert_allclose(9.0 - terrain.ray_cast(origins, [0.0, 0.0, -1.0]), terrain.height(xy), atol=1e-9)


@pytest.mark.parametrize("down", [False, True])
@pytest.mark.parametrize(("changes", "behind_m"), [({}, 0.0), ({"nosing_m": 0.03}, 0.03), ({"open_risers": True}, 0.6)])
def test_the_riser_under_a_tread_stands_back_or_is_missing(down, changes, behind_m):
    """A level ray 80 mm below the edge of the lowest tread meets its riser, or the level ground above the planks."""
    stairs = Stairs(risers=3, riser_m=0.15, tread_m=0.3, down=down, **changes)
    terrain = Terrain.from_route(Route(segments=(Level(length_m=2.0), stairs, Level(length_m=2.0))))
    edge, below = (2.0 + 0.6, -0.45) if down else (2.0, 0.0)
    way = -1.0 if down else 1.0
    origin = np.array([edge - way * 0.1, 0.0, below + 0.07])
    (distance,) = terrain.ray_cast([origin], [[way, 0.0, 0.0]])
    assert distance == pytest.approx(0.1 + behind_m, abs=1e-9)
    at_plank = origin + [0.0, 0.0, 0.05]
    assert terrain.ray_cast([at_plank], [[way, 0.0, 0.0]])[0] == pytest.approx(0.1, abs=1e-9)


@pytest.mark.parametrize("down", [False, True])
@pytest.mark.parametrize("risers", [1, 3])
def test_edges_are_rounded(down, risers):
    """Every edge is three chords of a circle; the way's profile keeps its edges."""
    radius = 0.03
    stairs = Stairs(risers=risers, riser_m=0.15, tread_m=0.3, down=down, edge_radius_m=radius)
    sharp = replace(stairs, edge_radius_m=0.0)
    rounded, plain = (
        Terrain.from_route(Route(segments=(Level(length_m=2.0), one, Level(length_m=2.0)))) for one in (stairs, sharp)
    )
    assert rounded.profile == plain.profile
    x = np.arange(-1.5, 4.5, 1e-3) + 5e-4
    xy = np.column_stack([x, np.zeros(len(x))])
    below = plain.height(xy) - rounded.height(xy)
    edges = 2.0 + 0.3 * np.arange(risers)
    away = (edges[:, None] - x if down else x - edges[:, None]).T
    away = np.where(away < 0.0, np.inf, away).min(axis=1)
    from_centre = np.hypot(radius - away, radius - below)[away < radius]
    assert radius * math.cos(math.radians(15.0)) - 1e-9 <= from_centre.min()
    assert from_centre.max() <= radius + 1e-9
    assert below[away > radius] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("down", [False, True])
@pytest.mark.parametrize("turn_deg", [-180.0, 90.0])
def test_edges_of_a_winding_stair_are_radial(turn_deg, down):
    turn, risers, width = math.radians(turn_deg), 9, 1.1
    stairs = Stairs(risers=risers, riser_m=0.17, tread_m=0.27, down=down, turn_rad=turn)
    terrain = Terrain.from_route(Route(segments=(Level(length_m=2.0), stairs, Level(length_m=1.0)), width_m=width))
    radius, side = (risers - 1) * 0.27 / abs(turn), math.copysign(1.0, turn)
    angle = (np.arange(400) + 0.5) / 400 * abs(turn)
    for r in (radius - 0.49 * width, radius, radius + 0.49 * width):
        xy = np.column_stack([2.0 + r * np.sin(angle), side * (radius - r * np.cos(angle))])
        tread = np.floor(angle / abs(turn) * (risers - 1)) + 1
        np.testing.assert_allclose(terrain.height(xy), (-1 if down else 1) * 0.17 * tread, atol=1e-9)
        assert set(terrain.terrain_class(xy)) == {"stair"}
    last = terrain.profile[-1]
    assert (last.s0, last.z0) == pytest.approx((2.0 + 8 * 0.27, (-1 if down else 1) * 9 * 0.17))
    assert float(terrain.layout.way.heading(last.s0)) == pytest.approx(turn)


@pytest.mark.parametrize(
    ("changes", "width", "valid"),
    [
        ({"risers": 2}, 1.0, "3 or more risers of a stair that winds"),
        ({"turn_rad": 5.0}, 1.0, "270 deg"),
        ({"turn_rad": 2.4}, 1.0, "30 deg. per tread"),
        ({"open_risers": True}, 1.0, "false on a stair that winds"),
        ({"tread_slope_rad": 0.02}, 1.0, "0 rad on a stair that winds"),
        ({}, 2.4, "up to 1.33 m, so that the treads of its winding stairs do not meet at the pole"),
    ],
)
def test_a_winding_stair_that_cannot_be_built_is_refused(changes, width, valid):
    stairs = Stairs(**{"risers": 5, "tread_m": 0.3, "turn_rad": math.radians(90.0), **changes})
    with pytest.raises(ConfigError, match=valid):
        Terrain.from_route(Route(segments=(Level(length_m=2.0), stairs, Level(length_m=1.0)), width_m=width))


def test_a_spiral_that_leads_over_its_own_start_is_refused():
    stairs = Stairs(risers=11, tread_m=0.26, turn_rad=math.radians(225.0))
    with pytest.raises(ConfigError, match=r"segments\[2\]: invalid .*over the start.* expected no overlap"):
        Terrain.from_route(Route(segments=(Level(length_m=2.5), stairs, Level(length_m=2.5)), width_m=0.9))


@pytest.mark.parametrize("down", [False, True])
def test_a_rounded_edge_is_painted_within_its_solid(down):
    stairs = Stairs(risers=2, riser_m=0.15, tread_m=0.3, edge_radius_m=0.02, down=down)
    terrain = Terrain.from_route(Route(segments=(Level(length_m=2.0), stairs, Level(length_m=2.0))))
    surface = SolidSet(terrain.solids, terrain.ground_m)
    for solid in terrain.solids:
        along = np.concatenate([quad.corners[:, 0] for quad in paint_slabs([solid], surface)]) - solid.x
        assert np.abs(along).max() == pytest.approx(solid.length / 2)


def test_stairs_in_lanes_have_sharp_edges():
    lanes = Lanes(lanes=((Stairs(risers=2, edge_radius_m=0.02),), (Level(length_m=1.0),)), walk=1)
    with pytest.raises(ConfigError, match="0 m"):
        Terrain.from_route(Route(segments=(Level(length_m=1.0), lanes, Level(length_m=1.0)), width_m=1.2))


@pytest.mark.parametrize(
    ("changes", "valid"),
    [
        ({"riser_m": 0.02, "edge_radius_m": 0.03}, "0 m up to the lowest riser"),
        ({"nosing_m": 0.02, "edge_radius_m": 0.02}, "0 m with nosings or open risers"),
    ],
)
def test_edges_that_cannot_be_rounded_are_refused(changes, valid):
    with pytest.raises(ConfigError, match=valid):
        Terrain.from_route(Route(segments=(Stairs(risers=2, **changes), Level(length_m=1.0))))


@pytest.mark.parametrize("down", [False, True])
def test_a_sloping_tread_falls_towards_its_edge(down):
    stairs = Stairs(risers=3, riser_m=0.15, tread_m=0.3, down=down, tread_slope_rad=math.radians(2.0))
    strips = Terrain.from_route(Route(segments=(Level(length_m=2.0), stairs, Level(length_m=2.0)))).profile
    for before, after in itertools.pairwise(strips):
        assert abs(after.z0 - before.z1) == pytest.approx(0.15)
    treads = [s for s in strips if s.terrain == "stair"]
    assert [math.degrees(s.slope) for s in treads] == pytest.approx([-2.0 if down else 2.0] * 2)


def test_rays_hit_risers_ramps_and_nothing():
    distance, normal = TERRAIN.ray_hit(
        [[2.0, 0.0, 0.1], [2.0, 0.0, 0.1], [3.1, 0.0, 0.05]],
        [[2.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
    )
    np.testing.assert_allclose(distance, [1.0, np.inf, 0.0])
    np.testing.assert_allclose(normal[:2], [[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    down = TERRAIN.ray_hit([[RAMP_X + 0.5, 0.0, 3.0]], [[0.0, 0.0, -1.0]])[1]
    np.testing.assert_allclose(down[0], TERRAIN.normal([RAMP_X + 0.5, 0.0]))


@settings(max_examples=25, deadline=None)
@given(yaw=st.floats(-3.1, 3.1), seed=st.integers(0, 2**31))
def test_rotated_solids_give_the_same_answers(yaw, seed):
    rng = np.random.default_rng(seed)
    cos, sin = math.cos(yaw), math.sin(yaw)
    turn = np.array([[cos, -sin], [sin, cos]])
    boxes = [
        {"x": 0.0, "y": 0.0, "length": 2.0, "width": 1.0, "bottom": -1.0, "start": 0.0, "end": 0.0},
        {"x": 1.75, "y": 0.0, "length": 1.5, "width": 1.0, "bottom": -1.0, "start": 0.0, "end": 0.3},
    ]
    straight = SolidSet([Solid(**b) for b in boxes], -0.2)
    centres = [turn @ (b["x"], b["y"]) for b in boxes]
    rotated = SolidSet([Solid(**{**b, "x": c[0], "y": c[1], "yaw": yaw}) for b, c in zip(boxes, centres)], -0.2)
    xy = rng.uniform([-1.5, -0.8], [3.0, 0.8], (60, 2))
    np.testing.assert_allclose(rotated.top_facet(xy @ turn.T)[0], straight.top_facet(xy)[0], atol=1e-9)
    rays = rng.standard_normal((60, 3))
    origins = np.column_stack([xy, np.full(60, 1.0)])
    rotated_rays = np.column_stack([rays[:, :2] @ turn.T, rays[:, 2]])
    rotated_origins = np.column_stack([xy @ turn.T, origins[:, 2]])
    np.testing.assert_allclose(
        rotated.ray_cast(rotated_origins, rotated_rays)[0],
        straight.ray_cast(origins, rays)[0],
        rtol=1e-7,
        atol=1e-7,
    )


def test_the_model_collides_with_the_same_surface():
    spec = mujoco.MjSpec()
    TERRAIN.add_to(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rng = np.random.default_rng(5)
    groups = np.array([1, 0, 0, 1, 0, 0], np.uint8)  # the ground, and the collision shapes
    hit = np.zeros(1, np.int32)
    for x, y in rng.uniform([-1.9, -1.15], [TERRAIN.profile[-1].s1 - 0.1, 1.15], (80, 2)):
        far = mujoco.mj_ray(model, data, [x, y, 5.0], [0.0, 0.0, -1.0], groups, 1, -1, hit)
        if model.geom(hit[0]).name.startswith("terrain_"):
            assert 5.0 - far == pytest.approx(float(TERRAIN.height([x, y])), abs=1e-5)
    colliding = [model.geom(i).name for i in range(model.ngeom) if model.geom_contype[i]]
    assert sorted(colliding) == sorted(["ground", *(f"terrain_{i}" for i in range(len(TERRAIN.profile)))])


def test_landmarks_keep_clear_of_the_way():
    assert len(TERRAIN.landmarks) > 10
    for mark in TERRAIN.landmarks:
        beside = abs(mark.box.y) - mark.box.width / 2 >= ROUTE.width_m / 2 + 0.2
        beyond = mark.box.x - mark.box.length / 2 >= TERRAIN.profile[-1].s1 + 1.0
        assert beside or beyond


def test_textures_are_true_to_scale():
    spec = mujoco.MjSpec()
    TERRAIN.add_to(spec)
    model = spec.compile()
    for name in ("concrete", "wood", "brick", "stone"):
        mesh, material = model.mesh(f"scenery_{name}"), model.material(f"scenery_{name}")
        assert not material.texuniform[0]
        np.testing.assert_array_equal(material.texrepeat, 1.0)
        vertex = model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]].reshape(-1, 4, 3)
        uv = model.mesh_texcoord[mesh.texcoordadr[0] :][: mesh.vertnum[0]].reshape(-1, 4, 2)
        metres = np.linalg.norm(np.roll(vertex, -1, axis=1) - vertex, axis=-1)
        periods = np.linalg.norm(np.roll(uv, -1, axis=1) - uv, axis=-1)
        level = np.isclose(metres[:, 0], metres[:, 2], atol=1e-4)  # not the sides of a ramp
        np.testing.assert_allclose(periods[level] * PERIOD_M, metres[level], atol=1e-4)


def test_the_world_looks_the_same_every_time():
    assert Terrain.from_route(ROUTE).landmarks == TERRAIN.landmarks


@pytest.mark.parametrize(
    ("segments", "field", "valid"),
    [
        ((Level(length_m=0.0),), "segments[0].length_m", "more than 0"),
        ((Level(length_m=1.0), Stairs(risers=3, riser_m=0.26)), "segments[1].riser_m", "0.25"),
        ((Stairs(risers=3, riser_m=0.019),), "segments[0].riser_m", "0.019"),
        ((Stairs(risers=3, tread_m=0.19),), "segments[0].tread_m", "0.2"),
        ((Stairs(risers=0),), "segments[0].risers", "from 1"),
        ((Ramp(angle_rad=math.radians(21), rise_m=0.5),), "segments[0].angle_rad", "20 deg"),
        ((Ramp(angle_rad=0.0, rise_m=0.5),), "segments[0].angle_rad", "above 0"),
        ((Ramp(angle_rad=0.1, rise_m=-0.5),), "segments[0].rise_m", "more than 0"),
        ((Level(length_m=math.nan),), "segments[0].length_m", "more than 0"),
        ((Stairs(risers=3), Stairs(risers=3, down=True)), "segments[1]", "level"),
    ],
)
def test_impossible_requests_name_field_value_and_range(segments, field, valid):
    with pytest.raises(ConfigError) as caught:
        Terrain.from_route(Route(segments=segments))
    assert caught.value.field == field
    assert valid in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_way_too_narrow_is_refused():
    with pytest.raises(ConfigError, match="width_m"):
        Terrain.from_route(Route(segments=(Level(length_m=1.0),), width_m=0.5))


def test_things_lie_flat_or_stand_clear_of_the_walker():
    def thing(kind, at_m, left_m=0.0):
        return Thing(kind=kind, at_m=at_m, left_m=left_m)

    things = (thing("stripe", 1.0), thing("shadow", 2.0), thing("table", 3.45), thing("table", 0.5, 1.2))
    plain, full = (Terrain.from_route(Route(segments=(Level(length_m=3.0),), things=some)) for some in ((), things))
    way = np.column_stack([np.linspace(0.0, 4.9, 50), np.zeros(50)])
    np.testing.assert_array_equal(plain.height(way), full.height(way))  # nothing of it is ground
    boards = [m.box for m in full.landmarks if m.material == "wood" and m.box.bottom > 0.6]
    assert sorted(b.x - b.length / 2 for b in boards) == pytest.approx([0.5, 3.45])
    assert {round(b.start, 3) for b in boards} == {0.72}
    down = full.ray_cast([[3.8, 0.0, 1.5], [1.15, 0.0, 1.5]], [[0.0, 0.0, -1.0]] * 2)
    assert down == pytest.approx([1.5 - 0.72, 1.5])
    spec = mujoco.MjSpec()
    full.add_to(spec)
    model = spec.compile()
    painted = [model.mesh(f"scenery_{m}").id for m in ("white_paint", "black_paint", "shadow")]
    assert all(model.mesh_vertnum[i] == 4 for i in painted)


def test_a_pane_of_glass_reflects_sound_and_is_no_ground():
    full = Terrain.from_route(
        Route(segments=(Level(length_m=3.0),), things=(Thing(kind="glass", at_m=1.0, left_m=2.2),))
    )
    assert full.ray_cast([[0.0, 2.2, 1.0]], [[1.0, 0.0, 0.0]]) == pytest.approx([1.0])
    assert full.height([1.01, 2.2]) == pytest.approx(-0.05)  # the lawn


def test_a_chair_and_a_crate_stand_beside_the_way():
    things = (Thing(kind="chair", at_m=1.0, left_m=1.0), Thing(kind="crate", at_m=2.0, left_m=-1.2))
    full = Terrain.from_route(Route(segments=(Level(length_m=3.0),), things=things))
    above = [[1.1, 1.0, 1.5], [1.44, 1.0, 1.5], [2.2, -1.2, 1.5], [2.2, -1.2 + 0.31, 1.5], [1.1, 1.0, 0.3]]
    down = full.ray_cast(above, [[0.0, 0.0, -1.0]] * 5)
    assert down == pytest.approx([1.5 - 0.45, 1.5 - 0.9, 1.5 - 0.2, 1.5, 0.3])  # there is ground under the seat


@pytest.mark.parametrize(
    ("kind", "at_m", "valid"),
    [
        ("table", 2.0, "0.4 m clear of where the walker goes"),
        ("wall", 4.2, "0.4 m clear"),
        ("stripe", 3.5, "on one level of the way"),
        ("chair", 2.0, "0.4 m clear"),
        ("crate", 2.0, "0.4 m clear"),
        ("puddle", 2.0, "stripe, shadow, mat, table, chair, crate, wall, glass"),
    ],
)
def test_things_that_cannot_be_there_are_refused(kind, at_m, valid):
    segments = (Level(length_m=3.0), Ramp(angle_rad=0.1, rise_m=0.1), Level(length_m=1.0))
    with pytest.raises(ConfigError, match=valid):
        Terrain.from_route(Route(segments=segments, things=(Thing(kind=kind, at_m=at_m),)))


@pytest.mark.parametrize("rounding", [0.0, 1e-16, 3e-10])
def test_ground_that_a_loop_comes_back_to_is_painted_once(rounding):
    """Two coincident pavings flicker, and a renderer with shadows adds their light."""
    slabs = [
        Solid.box(x=x, y=0.0, length=2.0, width=1.0, bottom=-0.1, top=top) for x, top in ((0.0, 0.0), (1.0, rounding))
    ]
    tops = [quad.corners for quad in paint_slabs(slabs, SolidSet(slabs, -0.05)) if np.ptp(quad.corners[:, 2]) < 1e-6]
    area = sum(float(np.prod(np.ptp(top[:, :2], axis=0))) for top in tops)
    assert area == pytest.approx(3.0)
