"""Rises of furniture and planters are no stairs; those that lead on from walked ground are."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scenes import FLOOR, Box, approach, flight

from stridetwin.estimators.terrain_map.estimate import Plane
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.plane_set import PlaneSet
from stridetwin.estimators.terrain_map.risers import Riser
from stridetwin.estimators.terrain_map.walkable import WalkedPlanes, select_walkable

P = TerrainMapParameters()
GROUND, WIDE_M = 0, 1.2


def a_plane(id_, x, z, *, long=0.30, wide=WIDE_M, slope=0.0):
    """A rectangle that begins at x and slopes up along it."""
    gradient = math.tan(slope)
    normal = np.array([-gradient, 0.0, 1.0])
    return Plane(
        id=id_,
        centre=np.array([x + long / 2, 0.0, z + gradient * long / 2]),
        normal=normal / np.linalg.norm(normal),
        area_m2=long * wide,
        spread=np.diag([long**2, wide**2]) / 12.0,
        votes=9.0,
        covariance=np.diag([1e-5, 1e-4, 1e-4]),
    )


def a_riser(lower, upper, *, wide=WIDE_M):
    """The step from one plane up to another, where the upper one begins."""
    x = upper.centre[0] - 0.5 * math.sqrt(12.0 * upper.spread[0, 0])
    points = np.column_stack([np.full(25, x), np.linspace(-wide / 2, wide / 2, 25)])
    height = float(upper.centre[2] - lower.height(np.array([x, 0.0])))
    return Riser(
        lower=lower.id, upper=upper.id, down=np.array([-1.0, 0.0]), points=points, in_voxels=True, height=height
    )


def some_steps(count, riser_m, *, base=0.0, first=1, last_long=1.0, wide=WIDE_M):
    """The planes of the ground and of a flight on it, and the flight's risers."""
    planes = [a_plane(GROUND, -4.0, 0.0, long=4.0, wide=3.0)]
    planes += [
        a_plane(first + k, 0.3 * k, base + riser_m * (k + 1), long=0.3 if k < count - 1 else last_long, wide=wide)
        for k in range(count)
    ]
    row = tuple(a_riser(one, other, wide=wide) for one, other in pairwise(planes))
    return {plane.id: plane for plane in planes}, row


@pytest.mark.parametrize(("count", "last_long"), [(2, 1.0), (3, 0.3), (6, 0.3)])
def test_a_flight_from_walked_ground_is_walkable(count, last_long):
    planes, row = some_steps(count, 0.16, last_long=last_long)
    assert select_walkable([row], planes, {GROUND}, P) == [row]


@pytest.mark.parametrize(("wide", "second_m", "walkable"), [(0.7, 0.24, False), (1.2, 0.36, False), (1.2, 0.24, True)])
def test_two_rises_that_lead_nowhere_are_broad_and_alike(wide, second_m, walkable):
    """The first two treads that come into view, and boxes that touch each other."""
    planes, row = some_steps(2, 0.12, last_long=0.30, wide=wide)
    row = (row[0], replace(row[1], height=second_m - 0.12))
    assert bool(select_walkable([row], planes, {GROUND}, P)) == walkable


def test_a_narrow_part_of_a_tread_belongs_to_its_flight():
    planes, row = some_steps(4, 0.16, last_long=0.3)
    part = replace(row[3], points=row[3].points[:9])
    assert select_walkable([row[:3], (part,)], planes, {GROUND}, P) == [row[:3], (part,)]
    assert select_walkable([(part,)], planes, {GROUND}, P) == []


@pytest.mark.parametrize(
    ("long", "wide", "walkable"),
    [
        (1.0, 1.2, True),  # a kerb
        (0.40, 0.60, False),  # a crate
        (0.40, 1.50, False),  # the hedge of a planter
        (0.05, 1.50, False),  # its rim
        (1.5, 0.40, False),  # from its end
        (0.60, 0.74, False),  # two crates side by side
    ],
)
def test_a_single_rise_leads_to_a_landing(long, wide, walkable):
    planes, row = some_steps(1, 0.2, last_long=long, wide=wide)
    assert bool(select_walkable([row], planes, {GROUND}, P)) == walkable


def test_who_stands_on_a_tread_can_go_down():
    planes, row = some_steps(1, 0.2, last_long=0.3)
    assert select_walkable([row], planes, {row[0].upper}, P) == [row]


def test_a_table_behind_a_chest_is_on_no_way():
    """The rise between the two is that of a step, but that to the chest is too high for one."""
    floor, chest, table = (
        a_plane(0, -4.0, 0.0, long=4.0),
        a_plane(1, 0.0, 0.45, long=0.5),
        a_plane(2, 0.5, 0.72, long=0.9),
    )
    planes = {plane.id: plane for plane in (floor, chest, table)}
    row = (a_riser(chest, table),)
    assert select_walkable([row], planes, {GROUND}, P) == []
    assert select_walkable([row], planes, {chest.id}, P) == [row]


def test_steps_narrower_than_a_person_are_none():
    planes, row = some_steps(3, 0.2, wide=0.45)
    assert select_walkable([row], planes, {GROUND}, P) == []


def test_a_rise_from_a_tread_goes_on():
    """A winding flight whose chain of risers is interrupted: the next riser leads to a tread, not to a landing."""
    planes, row = some_steps(4, 0.16, last_long=0.3)
    assert select_walkable([row[:2], row[2:3], row[3:]], planes, {GROUND}, P) == [row[:2], row[2:3], row[3:]]
    assert select_walkable([row[2:3], row[3:]], planes, {GROUND}, P) == []


def test_like_risers_are_stairs_though_their_foot_is_hidden():
    planes, row = some_steps(5, 0.16, last_long=0.3)
    assert select_walkable([row[2:]], planes, {GROUND}, P) == [row[2:]]
    planes, row = some_steps(5, 0.16, last_long=0.3)
    uneven = (*row[2:4], a_riser(planes[4], a_plane(5, 1.2, 0.64 + 0.26)))
    assert select_walkable([uneven], planes, {GROUND}, P) == []


def test_stairs_behind_a_ramp_can_be_reached():
    slope = math.radians(8.0)
    top = 3.0 * math.tan(slope)
    floor, ramp = a_plane(GROUND, -4.0, 0.0, long=4.0), a_plane(1, 0.0, 0.0, long=3.0, slope=slope)
    level, kerb = a_plane(2, 3.1, top, long=0.8), a_plane(3, 3.9, top + 0.15, long=1.0)
    row = (a_riser(level, kerb),)
    assert select_walkable([row], {p.id: p for p in (floor, ramp, level, kerb)}, {GROUND}, P) == [row]
    assert select_walkable([row], {p.id: p for p in (floor, level, kerb)}, {GROUND}, P) == []


def test_stairs_on_floor_behind_something_that_hides_the_floor_can_be_reached():
    floor, beyond, kerb = a_plane(GROUND, -4.0, 0.0, long=4.0), a_plane(1, 1.0, 0.02), a_plane(2, 1.3, 0.15, long=1.0)
    row = (a_riser(beyond, kerb),)
    assert select_walkable([row], {p.id: p for p in (floor, beyond, kerb)}, {GROUND}, P) == [row]


def test_before_the_walker_moves_the_lowest_plane_nearby_is_the_ground():
    walked = WalkedPlanes(np.eye(3), P)
    floor, table = a_plane(5, 0.8, 0.0, long=4.0, wide=3.0), a_plane(6, 0.4, 0.72, long=0.7)
    far, speck = a_plane(7, 3.0, -1.0, long=2.0), a_plane(8, 0.9, -0.5, long=0.05)
    planes = {plane.id: plane for plane in (floor, table, far, speck)}
    assert walked.update(planes, PlaneSet(P), np.array([0.0, 0.0, 1.65])) == {5}
    assert walked.update({6: table}, PlaneSet(P), np.array([0.0, 0.0, 1.2])) == set()


PLANTER = [Box(x=(-0.6, 0.9), y=(0.75, 1.2), z=(-1, 0.16)), Box(x=(-0.55, 0.85), y=(0.8, 1.15), z=(-1, 0.38))]
CRATE_AND_CHAIR = [Box(x=(0.0, 0.4), y=(-1.1, -0.5), z=(-1, 0.2)), Box(x=(0.4, 0.85), y=(-1.0, -0.55), z=(0.41, 0.45))]
CHEST_AND_TABLE = [Box(x=(0.0, 0.5), y=(-0.3, 0.5), z=(-1, 0.45)), Box(x=(0.5, 1.2), y=(-0.5, 0.7), z=(0.68, 0.72))]
LOW_BENCH = [Box(x=(0.0, 0.35), y=(-0.7, 0.7), z=(0.25, 0.3))]
SHELVES = [Box(x=(0.2 * k, 0.2 * k + 0.2), y=(-0.6, 0.6), z=(-1, 0.9 + 0.25 * k)) for k in range(3)]


@pytest.mark.parametrize("things", [PLANTER, CRATE_AND_CHAIR, CHEST_AND_TABLE, LOW_BENCH, SHELVES])
def test_what_stands_beside_the_way_is_no_flight(things):
    for heading in (0.0, 0.5):
        _, estimate = approach([FLOOR, *things], start=2.4, end=1.1, heading=heading, frames=8)
        assert not estimate.stairs
        assert estimate.rises or things is LOW_BENCH or things is SHELVES, "measured, but no stairs"


def a_furnished_room(seed):
    """Boxes of random sizes, heights and places at least 0.4 m beside the way along x; some touch each other."""
    rng = np.random.default_rng(seed)
    boxes = [FLOOR]
    for side in (-1.0, 1.0):
        x = -1.5
        while x < 2.0:
            long, wide, away = rng.uniform(0.3, 1.3), rng.uniform(0.3, 0.55), rng.uniform(0.4, 0.8)
            top = rng.choice([rng.uniform(0.08, 0.33), rng.uniform(0.35, 0.6), rng.uniform(0.68, 0.76)])
            bottom = top - 0.04 if rng.uniform() < 0.3 else -1.0
            y = (away, away + wide) if side > 0 else (-away - wide, -away)
            boxes.append(Box(x=(x, x + long), y=y, z=(bottom, top)))
            x += long + rng.choice([0.0, rng.uniform(0.0, 0.6)])
    return boxes


@pytest.mark.parametrize("seed", range(8))
def test_furniture_is_no_flight(seed):
    terrain_map, estimate = approach(a_furnished_room(seed), start=2.5, end=1.2, frames=5)
    assert not estimate.stairs
    _, estimate = approach(
        a_furnished_room(seed), start=1.1, end=0.0, frames=5, terrain_map=terrain_map, first_ns=10**9
    )
    assert not estimate.stairs


def test_a_flight_beside_furniture_is_the_only_one():
    steps = dict(riser=0.17, tread=0.29, steps=5, start=0.6)
    beside = [Box(x=(-0.5, 0.3), y=(0.9, 1.4), z=(-1, 0.25)), Box(x=(-0.5, 0.2), y=(-1.4, -0.9), z=(-1, 0.45))]
    _, estimate = approach([*flight(**steps), *beside], start=2.0, end=0.6, frames=8)
    (ours,) = (found for found in estimate.stairs if found.steps > 1)
    assert ours.steps >= 3
    assert ours.riser == pytest.approx(0.17, abs=0.008)


@pytest.mark.parametrize(("climbs", "expected"), [(False, {GROUND}), (True, {GROUND, 1})])
def test_the_camera_rises_with_who_steps_up_and_stays_over_a_box(climbs, expected):
    """A box of 0.2 m is under the camera for a second: of a walker who steps onto it, or held in the hand."""
    planes = {GROUND: a_plane(GROUND, -3.0, 0.0, long=3.0), 1: a_plane(1, 0.0, 0.2, long=0.6)}
    walked = WalkedPlanes(np.eye(3), P)

    class Columns:
        """Slots of the planes by place alone."""

        ids = np.arange(8)

        class surface:  # noqa: N801 - stands for an attribute
            @staticmethod
            def at(columns):
                return (columns[:, 0] >= 0).astype(np.int64), None

    for x in np.linspace(-1.0, 0.5, 31):
        z = 1.4 + (0.2 if climbs and x > 0.0 else 0.0)
        ids = walked.update(planes, Columns(), np.array([x, 0.0, z]))
    assert ids == expected


def test_what_stands_on_a_counter_is_no_third_step():
    """Drawers of 0.28 m, a counter of 0.57 m and a pot of 0.12 m on it: too unlike, and too narrow to stand on."""
    planes = [a_plane(GROUND, -4.0, 0.0, long=4.0, wide=3.0)]
    heights = (0.28, 0.85, 0.97)
    planes += [a_plane(1 + k, 0.3 * k, z, long=0.3) for k, z in enumerate(heights)]
    rows = [(a_riser(one, other),) for one, other in pairwise(planes)]
    assert select_walkable(rows, {plane.id: plane for plane in planes}, {GROUND}, P) == []
