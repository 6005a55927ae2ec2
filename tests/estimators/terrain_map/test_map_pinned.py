"""Pinned numbers of the terrain map: see `tests.pinned`."""

import math
from typing import Any

import numpy as np
import pytest
from scenes import Box, approach, flight, slope

from tests.pinned import SAME_POINTS, assert_pinned, columns

DOWN = [*flight(-0.15, 0.28, 4, landing=3.0)[1:], Box(x=(-9, 0), z=(-2, 0))]
FLOOR = flight(0.16, 0.30, 1, start=20.0)
GROUNDS: dict[str, dict[str, Any]] = {
    "stairs_up": {"boxes": flight(0.16, 0.30, 5), "start": 2.2, "end": 1.2},
    "stairs_aslant": {"boxes": flight(0.12, 0.34, 4), "start": 2.2, "end": 1.0, "heading": 0.4},
    "stairs_down": {"boxes": DOWN, "start": 1.6, "end": 0.4},
    "ramp": {"boxes": FLOOR, "start": 2.0, "end": 1.0, "more": slope(math.radians(9.0), 0.0, 0.4)},
    "kerb": {"boxes": flight(0.10, 0.30, 1, landing=4.0), "start": 2.0, "end": 0.8},
}


@pytest.mark.parametrize("name", GROUNDS)
def test_the_map_and_the_ground_ahead(name: str, num_regression: Any) -> None:
    terrain_map, estimate = approach(**GROUNDS[name], frames=6)
    heading = GROUNDS[name].get("heading", 0.0)
    forward = np.array([math.cos(heading), math.sin(heading)])
    profile = terrain_map.profile(-GROUNDS[name]["end"] * forward, heading)
    parts = {
        "plane": estimate.planes.values(),
        "stairs": estimate.stairs,
        "ramp": estimate.ramps,
        "change": profile.changes,
    }
    found = columns([{kind: part} for kind, those in parts.items() for part in those])
    found |= {"s": profile.s[::10], "height": profile.height[::10]}
    assert_pinned(num_regression, found, SAME_POINTS)
