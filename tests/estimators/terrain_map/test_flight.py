"""Stairs through edges that are given: the same wherever in the world they lie."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import FLOOR, approach, winders

from stridetwin.estimators.terrain_map.estimate import Plane
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.risers import Riser
from stridetwin.estimators.terrain_map.stairs import find_flights, fit_stairs

RISER, TREAD, STEPS, WIDE_M = 0.16, 0.30, 3, 1.2


def a_flight(place, heading, guess):
    """Stairs whose first edge has its middle at a place, from risers whose direction is guessed wrong by an angle."""
    up, aside = np.array([math.cos(heading), math.sin(heading)]), np.array([-math.sin(heading), math.cos(heading)])
    down = -np.array([math.cos(heading + guess), math.sin(heading + guess)])
    along = np.linspace(-0.5 * WIDE_M, 0.5 * WIDE_M, 25)
    row, planes = [], {}
    for k in range(STEPS + 1):
        centre = np.array([*(place + (k - 0.5) * TREAD * up), k * RISER])
        planes[k] = Plane(
            id=k,
            centre=centre,
            normal=np.array([0.0, 0.0, 1.0]),
            area_m2=0.3,
            spread=np.diag([0.01, 0.1]),
            votes=9.0,
            covariance=np.diag([1e-5, 1e-4, 1e-4]),
        )
        if k < STEPS:
            points = place + k * TREAD * up + along[:, None] * aside
            row.append(Riser(lower=k, upper=k + 1, down=down, points=points, in_voxels=True, height=RISER))
    return fit_stairs(row, planes, 0, TerrainMapParameters()), up, aside


@settings(max_examples=40, deadline=None)
@given(st.floats(-40, 40), st.floats(-40, 40), st.floats(-math.pi, math.pi), st.floats(-0.03, 0.03))
def test_edges_lie_along_the_way_up_that_is_estimated(x, y, heading, guess):
    place = np.array([x, y])
    found, up, aside = a_flight(place, heading, guess)
    assert found.up @ up == pytest.approx(1.0, abs=1e-8)
    at = float(found.up @ place)
    assert found.edges - at == pytest.approx(TREAD * np.arange(STEPS), abs=1e-3)
    assert found.start - at == pytest.approx(0.0, abs=1e-3)
    assert found.across - float(aside @ place) == pytest.approx([-0.5 * WIDE_M, 0.5 * WIDE_M], abs=0.06)
    assert (found.riser, found.tread) == pytest.approx((RISER, TREAD), abs=2e-4)  # cosine of the guess


def a_row(headings):
    """Risers that lead one to the next, a tread apart, with given directions of their own, rad."""
    along, at, row = np.linspace(-0.5 * WIDE_M, 0.5 * WIDE_M, 25), np.zeros(2), []
    for k, heading in enumerate(headings):
        up, aside = np.array([math.cos(heading), math.sin(heading)]), np.array([-math.sin(heading), math.cos(heading)])
        points = at + along[:, None] * aside
        row.append(Riser(lower=k, upper=k + 1, down=-up, points=points, in_voxels=True, height=RISER))
        at = at + TREAD * up
    return row


@given(st.floats(-math.pi, math.pi), st.floats(9.0, 18.0), st.sampled_from([-1, 1]), st.integers(3, 8))
def test_risers_of_a_flight_that_winds_are_rows_of_their_own(heading, turn_deg, side, count):
    row = a_row(heading + side * math.radians(turn_deg) * np.arange(count))
    assert find_flights(row, TerrainMapParameters()) == [[one] for one in row]


@given(st.floats(-math.pi, math.pi), st.lists(st.floats(-3.5, 3.5), min_size=3, max_size=8))
def test_edges_that_are_seen_aslant_by_chance_are_one_flight(heading, errors_deg):
    row = a_row(heading + np.radians(errors_deg))
    assert find_flights(row, TerrainMapParameters()) == [row]


def test_winding_stairs_have_edges_where_they_are():
    riser, part, radius = 0.17, math.radians(15.0), 1.07
    scene = winders(riser, part, 6, radius, 0.6)
    terrain_map, estimate = approach([FLOOR], start=2.4, end=1.0, frames=16, more=scene)
    edges = [c for c in terrain_map.profile(np.array([-1.0, 0.0]), 0.0, 2.5).changes if c.kind == "edge"]
    true = 1.0 + radius * np.tan(part * np.arange(3))  # where a straight line meets radial edges
    np.testing.assert_allclose([c.s for c in edges[:3]], true, atol=0.02)
    np.testing.assert_allclose([c.drop for c in edges[:3]], riser, atol=0.008)
    headings = sorted(f.heading for f in estimate.stairs if f.steps == 1)[:3]
    np.testing.assert_allclose(headings, part * np.arange(3), atol=math.radians(3.0))
