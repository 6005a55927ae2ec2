"""What makes a ramp of a plane."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stridetwin.estimators.terrain_map.estimate import Plane
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.terrains import is_flat, is_level

P = TerrainMapParameters()


def rectangle(degrees, along_m, across_m=2.0, turn=0.0):
    """A plane that slopes along its first edge, which points `turn` rad from x."""
    slope = math.radians(degrees)
    c, s = math.cos(turn), math.sin(turn)
    turned = np.array([[c, -s], [s, c]])
    gradient = math.tan(slope) * turned[:, 0]
    normal = np.array([*-gradient, 1.0])
    return Plane(
        id=0,
        centre=np.zeros(3),
        normal=normal / np.linalg.norm(normal),
        area_m2=along_m * across_m,
        votes=30.0,
        spread=turned @ np.diag([along_m**2, across_m**2]) @ turned.T / 12.0,
        covariance=np.diag([9e-6, 2e-5, 2e-5]),
    )


@given(st.floats(0.0, 25.0), st.floats(0.05, 3.0), st.floats(0.05, 3.0), st.floats(-math.pi, math.pi))
def test_a_plane_rises_by_its_slope_over_its_length(degrees, along, across, turn):
    rise = rectangle(degrees, along, across, turn).rise
    assert rise == pytest.approx(along * math.tan(math.radians(degrees)), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("degrees", "along_m", "flat"),
    [
        (3.0, 5.0, True),
        (6.5, 0.29, True),  # a tread whose far side was seen before the poses were corrected by 3 cm
        (6.5, 1.0, False),
        (11.8, 0.15, False),  # a strip of a ramp
    ],
)
def test_a_tread_may_lean(degrees, along_m, flat):
    assert is_flat(rectangle(degrees, along_m, turn=0.7), P) == flat


@pytest.mark.parametrize(
    ("degrees", "along_m", "level"),
    [
        (2.0, 5.0, True),
        (3.5, 5.0, False),  # the gentlest ramps of building codes have 2.9°, 1:20
        (3.5, 0.5, True),  # rises by less than a kerb
    ],
)
def test_a_gentle_ramp_is_not_level(degrees, along_m, level):
    assert is_level(rectangle(degrees, along_m), P) == level
