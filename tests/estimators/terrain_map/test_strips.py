"""Strips of treads, of which a narrow camera maps a few centimetres: they are level, and no slope of theirs goes on."""

import math

import numpy as np
import pytest

from stridetwin.estimators.terrain_map.estimate import Plane
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.profile import _flatten_strip
from stridetwin.estimators.terrain_map.terrains import is_flat

P = TerrainMapParameters()


def plane(long_m, slope_deg, along=(1.0, 0.0)):
    """A plane 1 m wide that is `long_m` long and slopes up in a direction."""
    gradient = math.tan(math.radians(slope_deg)) * np.array(along)
    across = np.array([-along[1], along[0]])
    normal = np.array([-gradient[0], -gradient[1], 1.0])
    return Plane(
        id=1,
        centre=np.array([2.0, 0.0, -0.18]),
        normal=normal / np.linalg.norm(normal),
        area_m2=long_m,
        spread=(long_m**2 * np.outer(along, along) + np.outer(across, across)) / 12.0,
        votes=9.0,
        covariance=np.diag([1e-5, 0.004**2, 0.004**2]),
    )


@pytest.mark.parametrize(
    ("long_m", "slope_deg", "expected"), [(0.08, -13.0, True), (0.5, -13.0, False), (0.08, 30.0, False)]
)
def test_the_rounded_edge_of_a_tread_is_flat_and_a_ramp_is_not(long_m, slope_deg, expected):
    assert is_flat(plane(long_m, slope_deg), P) is expected


def test_a_strip_has_its_own_height_beyond_it_and_a_ramp_goes_on():
    """Half a metre beyond a strip that slopes by 13 degrees, its height would be off by most of a riser."""
    forward, beyond = np.array([0.8, 0.6]), np.array([2.0, 0.0]) + 0.5 * np.array([0.8, 0.6])
    strip, ramp = plane(0.08, -13.0, (0.8, 0.6)), plane(0.5, -13.0, (0.8, 0.6))
    assert float(_flatten_strip(strip, forward).height(beyond)) == pytest.approx(-0.18, abs=1e-9)
    assert _flatten_strip(ramp, forward) is ramp
    assert float(ramp.height(beyond)) == pytest.approx(-0.18 - 0.5 * math.tan(math.radians(13.0)), abs=1e-9)
    # the slope across the line stays
    tilted = plane(0.08, 4.0, (0.0, 1.0))
    assert _flatten_strip(tilted, np.array([1.0, 0.0])).gradient[1] == pytest.approx(math.tan(math.radians(4.0)))
