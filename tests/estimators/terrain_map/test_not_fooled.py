"""Things that are no stairs and no ramps, and ramps that are."""

import math

import numpy as np
import pytest
import scenes

from stridetwin.estimators.terrain_map import Level, Ramp, Stairs, TerrainMap

AHEAD = np.array([0.3, 0.0])


def kind(terrain_map, xy):
    found = terrain_map.ground(np.asarray(xy, float))
    return None if found is None else type(found[1])


def test_a_kerb_of_4_cm_is_level():
    terrain_map, estimate = scenes.approach([scenes.FLOOR, scenes.Box(x=(0, 3), z=(-1, 0.04))], start=2.0, end=0.8)
    assert not estimate.stairs
    assert kind(terrain_map, AHEAD) is Level
    plane, _ = terrain_map.ground(AHEAD)
    assert plane.height(AHEAD) == pytest.approx(0.04, abs=0.006)
    assert len({terrain_map.ground(np.array([x, 0.0]))[0].id for x in (-0.4, 0.4)}) == 2


def test_a_table_is_no_step():
    table = [scenes.Box(x=(0, 0.8), y=(-0.6, 0.6), z=(0.70, 0.74))]
    terrain_map, estimate = scenes.approach([scenes.FLOOR, *table], start=2.2, end=1.0)
    assert not estimate.stairs
    assert not estimate.ramps
    assert all(c.kind != "slope_break" for c in terrain_map.profile(np.array([-1.0, 0.0]), 0.0).changes)


def test_a_wall_is_no_ground():
    terrain_map, estimate = scenes.approach(
        [scenes.FLOOR, scenes.Box(x=(0, 0.2), y=(-3, 3), z=(-1, 2.6))], start=2.0, end=0.9
    )
    assert not estimate.stairs
    assert not estimate.ramps
    assert all(abs(p.centre[2]) < 0.02 for p in estimate.planes.values())
    assert terrain_map.ground(np.array([0.1, 0.0])) is None or kind(terrain_map, [0.1, 0.0]) is Level


def test_a_painted_stripe_or_a_shadow_is_nothing_to_depth():
    """Where the paint is glossy its depth is missing: a hole in the map is none in the ground."""
    terrain_map = TerrainMap(scenes.RIG)
    rng = np.random.default_rng(0)
    for i, x in enumerate(np.linspace(-2.0, -1.0, 10)):
        eye, R = np.array([x, 0.0, scenes.EYE_M]), scenes.attitude(0.0)
        seen = scenes.image([scenes.FLOOR], eye, R, rng)
        rows = np.abs(_ground_x(eye, R, seen) + 0.1) < 0.06
        seen[rows] = 0.0
        terrain_map.update(scenes.pose(i * scenes.PERIOD_NS, eye, R))
        estimate = terrain_map.update(scenes.depth(i * scenes.PERIOD_NS, seen))
    assert not estimate.stairs
    assert not estimate.ramps
    assert all(isinstance(t, Level) for t in estimate.terrains)


def _ground_x(eye, R, seen):
    """(H, W) x of what each pixel sees."""
    from scenes import RAYS

    return (eye[0] + R.apply(RAYS)[:, 0] * seen.ravel()).reshape(seen.shape)


def test_a_mirror_like_floor_with_holes_stays_one_level():
    terrain_map = TerrainMap(scenes.RIG)
    rng = np.random.default_rng(0)
    for i, x in enumerate(np.linspace(-2.0, -1.0, 14)):
        eye, R = np.array([x, 0.0, scenes.EYE_M]), scenes.attitude(0.0)
        seen = scenes.image([scenes.FLOOR], eye, R, rng)
        blotches = rng.random((30, 40)) < 0.35
        seen[np.kron(blotches, np.ones((8, 8))) > 0] = 0.0
        deep = np.kron(rng.random((30, 40)) < 0.03, np.ones((8, 8))) > 0  # a reflection: twice as far
        seen[deep] *= 2.0
        terrain_map.update(scenes.pose(i * scenes.PERIOD_NS, eye, R))
        estimate = terrain_map.update(scenes.depth(i * scenes.PERIOD_NS, seen))
    assert not estimate.stairs
    assert not estimate.ramps
    largest = max(estimate.planes.values(), key=lambda p: p.area_m2)
    assert largest.area_m2 > 1.5
    assert largest.slope < math.radians(0.5)


def test_a_leg_that_went_leaves_no_trace():
    """A bystander's leg stands 0.7 m ahead for a second and then goes."""
    leg = scenes.Box(x=(-0.35, -0.22), y=(-0.06, 0.08), z=(-0.5, 0.85))
    shoe = scenes.Box(x=(-0.48, -0.22), y=(-0.06, 0.06), z=(-0.5, 0.10))
    terrain_map, estimate = scenes.approach([scenes.FLOOR, leg, shoe], start=1.2, end=1.2, frames=10)
    assert not [s for s in estimate.stairs if s.steps > 1]
    terrain_map, estimate = scenes.approach(
        [scenes.FLOOR], start=1.2, end=1.2, frames=15, terrain_map=terrain_map, first_ns=1_500_000_000
    )
    assert not estimate.stairs
    points, _ = terrain_map.surface_points()
    there = np.abs(points[:, :2] - [-0.33, 0.0]).max(axis=1) < 0.2
    assert there.sum() > 100
    assert np.abs(points[there, 2]).max() < 0.03


@pytest.mark.parametrize("angle_deg", [8.0, 11.8, 17.8])
def test_a_ramp_is_a_ramp(angle_deg):
    angle = math.radians(angle_deg)
    terrain_map, estimate = scenes.approach([scenes.FLOOR], start=2.2, end=1.2, more=scenes.slope(angle, 0.0, 0.6))
    plane, terrain = terrain_map.ground(np.array([0.5, 0.0]))
    assert isinstance(terrain, Ramp)
    assert abs(terrain.slope - angle) < math.radians(0.5)
    assert abs(terrain.heading) < math.radians(2.0)
    assert terrain.slope_sd < math.radians(1.0)
    knee = next(c for c in terrain_map.profile(np.array([-1.2, 0.0]), 0.0).changes if c.kind == "slope_break")
    assert abs(knee.s - 1.2) < 0.04
    assert abs(knee.bend - angle) < math.radians(1.0)
    assert kind(terrain_map, [-0.5, 0.0]) is Level
    assert not [t for t in estimate.terrains if isinstance(t, Stairs)]
    assert plane.slope == pytest.approx(terrain.slope)
