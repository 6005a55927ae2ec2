"""Borders between planes of different heights, on any side of the upper one."""

import numpy as np
import pytest

from stridetwin.estimators.terrain_map.plane_set import Surface, find_borders

LOW, HIGH = 3, 7
SIDES = {0: (1, 0), 1: (-1, 0), 2: (0, 1), 3: (0, -1)}


@pytest.mark.parametrize("side", SIDES)
def test_a_lower_plane_borders_on_its_side_alone(side):
    surface = Surface.empty()
    surface.label[:], surface.height[:] = HIGH, 0.15
    di, dj = SIDES[side]
    lower = np.arange(surface.label.shape[0]) >= 40 if di + dj > 0 else np.arange(surface.label.shape[0]) <= 40
    rows = (lower, slice(None)) if di else (slice(None), lower)
    surface.label[rows], surface.height[rows] = LOW, 0.0
    found = find_borders(surface, 3, 0.03, 0.30)
    assert set(found[:, 4]) == {side}
    assert {tuple(row) for row in found[:, :2].tolist()} == {(LOW, HIGH)}
    edge = 39 if di + dj > 0 else 41
    assert set(found[:, 2 if di else 3]) == {edge}
    assert len(found) == surface.label.shape[0] - 2
