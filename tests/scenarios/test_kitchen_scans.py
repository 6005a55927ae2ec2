"""A kitchen that is scanned by hand has no stairs."""

from __future__ import annotations

from itertools import islice

import numpy as np

from benchmarks import furniture, kitchen


def test_a_kitchen_with_open_drawers_has_no_flight():
    """Seed 0 had twelve: over the door of a dishwasher to drawers, a counter and what stands on it."""
    figures = furniture.map_kitchen(0)
    assert figures["maps"] > 100
    assert figures["last"] == 0
    assert figures["share"] < 0.05


def test_scans_are_drawn_from_their_seed_and_show_floor_and_furniture():
    for seed in range(2):
        pose, image = islice(kitchen.scan_kitchen(seed), 2)
        _, same = islice(kitchen.scan_kitchen(seed), 2)
        np.testing.assert_array_equal(image.depth, same.depth)
        assert 0.9 < pose.p_frame_in_world[2] < 1.9
        assert (image.depth > 0.0).mean() > 0.3
        assert image.depth.max() < 4.5
