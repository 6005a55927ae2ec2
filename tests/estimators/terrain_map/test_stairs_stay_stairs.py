"""Stairs stay stairs: each tread is its own plane, whatever the riser, the steps, and where one comes from."""

import math
from functools import cache

import numpy as np
import open3d
import pytest
from scenes import EYE_M, FLOOR, RAYS, approach, attitude, flight, image

CASES = {
    "low": dict(riser=0.10, tread=0.32, steps=5),
    "usual": dict(riser=0.17, tread=0.29, steps=8),
    "steep": dict(riser=0.25, tread=0.26, steps=4),
    "two": dict(riser=0.15, tread=0.30, steps=2),
    "long": dict(riser=0.16, tread=0.30, steps=15),
    "open": dict(riser=0.18, tread=0.28, steps=6, open_risers=True),
    "aslant": dict(riser=0.15, tread=0.30, steps=5),
    "open_aslant": dict(riser=0.20, tread=0.28, steps=5, open_risers=True),
}
HEADINGS = {"usual": 15.0, "steep": 30.0, "aslant": 45.0, "open_aslant": 45.0}
"""From where one comes, degrees off the way up; 0 else."""
SEEN_M = 1.1
"""How far beyond the first edge treads are asked for, and how far under the eye."""


def heading(name):
    return math.radians(HEADINGS.get(name, 0.0))


@cache
def climbed(name):
    """The map before a flight, and the treads that it should know."""
    steps = CASES[name]
    terrain_map, estimate = approach(flight(**steps), start=2.6, end=1.1, heading=heading(name))
    known = [
        k
        for k in range(steps["steps"] - 1)
        if (k + 1) * steps["tread"] < SEEN_M and (k + 1) * steps["riser"] < EYE_M - 0.6
    ]
    return steps, terrain_map, estimate, known


@pytest.mark.parametrize("name", CASES)
def test_each_tread_is_its_own_plane(name):
    steps, terrain_map, _, known = climbed(name)
    assert known
    ids = []
    for k in known:
        found = terrain_map.ground(np.array([(k + 0.5) * steps["tread"], 0.0]))
        assert found is not None, f"tread {k + 1} is not known"
        plane, _ = found
        assert abs(plane.height(plane.centre[:2]) - (k + 1) * steps["riser"]) < 0.01
        assert plane.slope < math.radians(5.0)
        ids.append(plane.id)
    assert len(set(ids)) == len(ids)


@pytest.mark.parametrize("name", CASES)
def test_the_flight_has_its_measures(name):
    steps, _, estimate, known = climbed(name)
    ours = max((s for s in estimate.stairs if _turned(s) < math.radians(8)), key=lambda s: s.steps)
    assert ours.steps >= len(known)
    assert abs(ours.riser - steps["riser"]) < 0.008
    assert abs(ours.tread - steps["tread"]) < 0.015
    assert _turned(ours) < math.radians(2.0)
    assert np.isfinite(ours.covariance).all()
    assert np.linalg.eigvalsh(ours.covariance).min() > 0
    true = np.arange(ours.steps) * steps["tread"]
    np.testing.assert_allclose(ours.edges, true, atol=0.018)  # a pixel of this small image, 2 m away


def _turned(stairs):
    """Off the true way up, rad."""
    return abs(math.remainder(stairs.heading, 2 * math.pi))


def test_down_the_same():
    """From the top of five risers down, 1.2 m before the first edge."""
    steps = dict(riser=0.16, tread=0.30, steps=5)
    top = steps["riser"] * steps["steps"]
    first = (steps["steps"] - 1) * steps["tread"]
    terrain_map, estimate = approach(
        flight(**steps, landing=6.0), start=2.4, end=1.2, heading=math.pi, to=(first, 0.0), ground=top
    )
    ours = max(estimate.stairs, key=lambda s: s.steps)
    assert ours.steps >= 2
    assert abs(math.remainder(ours.heading, 2 * math.pi)) < math.radians(2)
    assert abs(ours.riser - steps["riser"]) < 0.008
    assert abs(ours.tread - steps["tread"]) < 0.02
    assert abs(ours.edges[-1] - first) < 0.01
    profile = terrain_map.profile(np.array([first + 1.2, 0.0]), math.pi)
    edge = next(c for c in profile.changes if c.kind == "edge")
    assert abs(edge.s - 1.2) < 0.01
    assert abs(edge.drop + steps["riser"]) < 0.03


def ransac(points, tolerance=0.06):
    """The plane with the most points within a tolerance, by Open3D: (3,) normal, and which points."""
    open3d.utility.random.seed(0)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    plane, inside = cloud.segment_plane(distance_threshold=tolerance, ransac_n=3, num_iterations=200)
    return plane[:3] * np.sign(plane[2]), inside


@pytest.mark.parametrize("name", [name for name, steps in CASES.items() if steps["steps"] > 2])
def test_a_naive_ransac_lays_a_slanted_plane_across_them(name):
    """What goes wrong where points alone vote: the failure that the map avoids (above, with the same last image)."""
    steps = CASES[name]
    eye, R = (
        np.array([*(-1.1 * np.array([math.cos(heading(name)), math.sin(heading(name))])), EYE_M]),
        attitude(heading(name)),
    )
    rng = np.random.default_rng(0)
    depth = image(flight(**steps), eye, R, rng).ravel()
    points = (eye + R.apply(RAYS) * depth[:, None])[depth > 0]
    end = min(2.0, (steps["steps"] - 1) * steps["tread"])
    on_stairs = points[(points[:, 0] > 0) & (points[:, 0] < end) & (np.abs(points[:, 1]) < 0.7) & (points[:, 2] > 0.05)]
    normal, inside = ransac(on_stairs[::8])
    treads = np.unique(np.round(on_stairs[::8][inside][:, 0] // steps["tread"]))
    assert math.acos(normal[2]) > math.radians(10), "one slanted plane"
    assert len(treads) >= 3, "across several treads"
    _, terrain_map, _, known = climbed(name)
    planes = {terrain_map.ground(np.array([(k + 0.5) * steps["tread"], 0.0]))[0].id for k in known}
    assert len(planes) == len(known) >= 3


def test_a_floor_alone_has_no_stairs():
    _, estimate = approach([FLOOR], start=2.0, end=0.5)
    assert not estimate.stairs
    assert not estimate.ramps
    assert max(p.area_m2 for p in estimate.planes.values()) > 0.98 * sum(p.area_m2 for p in estimate.planes.values())
    assert max(estimate.planes.values(), key=lambda p: p.area_m2).slope < math.radians(0.3)
