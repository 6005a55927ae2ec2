"""Floors that are not exactly level: their heights, the slabs that follow them, and feet that rest on them."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stridetwin.scenarios.scenario_file import load_scenario, scenario_of
from stridetwin.sim.config import Exo, Level, Ramp, Route, Stairs, TwinConfig
from stridetwin.sim.twin import Twin
from stridetwin.sim.world.route import lay_out
from stridetwin.sim.world.scenery import paint_slabs
from stridetwin.sim.world.solids import SolidSet
from stridetwin.sim.world.terrain import Terrain
from stridetwin.sim.world.uneven_floor import APART_M, UnevenFloor
from stridetwin.streams.errors import ConfigError

ROUTE = Route(
    segments=(
        Level(length_m=2.0),
        Stairs(risers=2, riser_m=0.15, tread_m=0.3, nosing_m=0.02),
        Level(length_m=1.0),
        Ramp(angle_rad=math.radians(6), rise_m=0.2, down=True),
        Level(length_m=1.5),
    ),
    unevenness_m=0.010,
)
EXACT = Terrain.from_route(replace(ROUTE, unevenness_m=0.0))


def _walk_on(route: Route, physics: str = "kinematic", exo: Exo | None = None) -> Twin:
    usual = load_scenario("level_20m").config
    config = replace(usual, name="uneven", route=route, sensors=("foot_imu",), physics=physics, exo=exo)
    return Twin(config, 4)


@pytest.fixture(scope="module")
def walk() -> Twin:
    return _walk_on(ROUTE)


@pytest.mark.parametrize(("apart_m", "expected"), [(APART_M, 1.0), (1.0, 3**-0.65), (9.0, 3**0.65)])
def test_differences_of_height_grow_with_the_distance_as_on_built_floors(apart_m: float, expected: float) -> None:
    xy = np.array([[0.3, -0.2], [0.3 + apart_m * 0.6, -0.2 + apart_m * 0.8]])
    rises = [float(np.diff(UnevenFloor.draw(0.007, seed).height(xy))[0]) for seed in range(600)]
    assert np.std(rises) == pytest.approx(0.007 * expected, rel=0.15)
    assert abs(np.mean(rises)) < 0.15 * np.std(rises)


def test_curvature_is_that_of_a_conventional_slab() -> None:
    line = np.column_stack([np.arange(0.0, 12.0, 0.3), np.zeros(40)])
    bends = np.concatenate([np.diff(UnevenFloor.draw(0.007, seed).height(line), 2) for seed in range(100)])
    flatness = 116.0 / (3e3 * bends.std())  # F_F of ASTM E1155
    assert 20.0 < flatness < 32.0


def test_floor_belongs_to_the_seed_and_begins_at_the_origin() -> None:
    xy = np.random.default_rng(0).uniform(-5.0, 5.0, (20, 2))
    first, same, other = (UnevenFloor.draw(0.01, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.height(xy), same.height(xy))
    assert abs(first.height(xy) - other.height(xy)).max() > 1e-3
    assert first.height([0.0, 0.0]) == 0.0


def test_slabs_follow_the_floor_and_keep_risers_classes_and_edges() -> None:
    seed = 5
    terrain, floor = Terrain.from_route(ROUTE, seed), UnevenFloor.draw(0.010, seed)
    assert terrain.profile == EXACT.profile
    s = np.arange(-1.9013, terrain.profile[-1].s1 - 0.1, 0.01)  # on no border
    for left in (0.0, 0.15, -0.15):
        xy = terrain.layout.way.point(s, np.full(len(s), left))
        np.testing.assert_allclose(terrain.height(xy), EXACT.height(xy) + floor.height(xy), atol=1.5e-3)
        np.testing.assert_array_equal(terrain.terrain_class(xy), EXACT.terrain_class(xy))
    assert sum(slab.recess != 0.0 for slab in terrain.layout.slabs) == 1


def test_rays_meet_the_ground_that_has_this_height() -> None:
    terrain = Terrain.from_route(ROUTE, 5)
    xy = np.random.default_rng(1).uniform([-1.5, -0.8], [6.0, 0.8], (200, 2))
    down = terrain.ray_cast(np.column_stack([xy, np.full(200, 2.0)]), np.tile([0.0, 0.0, -1.0], (200, 1)))
    np.testing.assert_allclose(2.0 - down, terrain.height(xy), atol=1e-9)


def test_a_tilted_tread_with_a_nosing_is_painted_once() -> None:
    """Its plank and the body under it have one top, although their ends differ in height."""
    terrain = Terrain.from_route(ROUTE, 5)
    quads = paint_slabs(terrain.solids, SolidSet(terrain.solids, terrain.ground_m))
    tops = [q.corners for q in quads if np.ptp(q.corners[:, 2]) < 0.02 and 0.12 < q.corners[:, 2].mean() < 0.18]
    middle = [top for top in tops if 2.0 < top[:, 0].mean() < 2.3]
    area = sum(float(np.prod(np.ptp(top[:, :2], axis=0))) for top in middle)
    tread = next(slab for slab in terrain.layout.slabs if slab.recess)
    assert area == pytest.approx(tread.length * (tread.left + tread.right), rel=1e-3)


def test_an_exact_floor_is_what_it_was() -> None:
    assert Terrain.from_route(replace(ROUTE, unevenness_m=0.0), 5).layout == lay_out(replace(ROUTE, unevenness_m=0.0))


def test_soles_rest_on_the_ground_under_them(walk: Twin) -> None:
    shoe = walk.size.shoe
    corners = np.array([[x, y, 0.0] for x in (0.0, shoe.toe_hinge_x) for y in (-shoe.half_width, shoe.half_width)])
    heights = []
    for stance in walk.walk.stances():
        points = stance.p_foot_in_world + corners @ stance.R_world_sole.T
        above = points[:, 2] - walk.terrain.height(points[:, :2])
        on_ground = abs(above) < 0.02  # others are beyond an edge
        assert on_ground.sum() >= 2
        assert abs(above[on_ground]).max() < 2e-3
        heights.append(float(walk.terrain.height(stance.p_foot_in_world[:2])))
    exact = [float(EXACT.height(stance.p_foot_in_world[:2])) for stance in walk.walk.stances()]
    assert np.std(np.subtract(heights, exact)) > 1e-3


def test_truth_of_a_resting_foot_is_on_the_floor(walk: Twin) -> None:
    stance = next(s for s in walk.walk.steps["l"] if math.isfinite(s.t_touch) and math.isfinite(s.t_off))
    middle = np.array([round(1e9 * (0.6 * stance.t_touch + 0.4 * stance.t_off))], dtype=np.int64)
    foot = walk.player().motion(middle).tracks["foot_l"]
    np.testing.assert_allclose(foot.p_body_in_world[0], stance.p_foot_in_world, atol=1e-3)
    np.testing.assert_allclose(foot.rotation.as_matrix()[0], stance.R_world_sole, atol=0.02)


def test_simulated_walker_stands_on_an_uneven_floor() -> None:
    twin = _walk_on(Route(segments=(Level(length_m=4.0),), unevenness_m=0.012), "dynamic", None)
    assert twin.fell_at is None
    assert twin.duration_s > 4.0


def test_file_gives_millimetres_up_to_20(tmp_path: Path) -> None:
    node = {"description": "uneven", "terrain": [{"level": {"length_m": 5}}], "unevenness_mm": 8}
    config: TwinConfig = scenario_of(node, tmp_path / "uneven.yaml").config
    assert config.route.unevenness_m == pytest.approx(0.008)
    with pytest.raises(ConfigError, match="unevenness_mm"):
        scenario_of(node | {"unevenness_mm": 50}, tmp_path / "uneven.yaml")
