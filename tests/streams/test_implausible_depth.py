"""Depth of another unit is noticed by the distances that a person sees."""

import numpy as np
import pytest

from stridetwin.streams.plausible import find_implausible_depth


def look_at_floor(pitch_deg: float, height_m: float = 1.6) -> np.ndarray:
    """Depth (60, 80) m of a camera above level ground that looks down by an angle; 0 above the horizon."""
    pitch = np.radians(pitch_deg)
    rows = (np.arange(60)[:, None] - 29.5) / 50.0 + np.zeros((1, 80))
    down = np.cos(pitch) * rows + np.sin(pitch)
    return np.where(down > 0.1, height_m / np.maximum(down, 0.1), 0.0)


@pytest.mark.parametrize("pitch_deg", [0.0, 30.0, 60.0, 90.0])
@pytest.mark.parametrize("height_m", [0.8, 1.6, 1.9])
def test_a_persons_view_is_plausible(pitch_deg, height_m):
    assert not list(find_implausible_depth([look_at_floor(pitch_deg, height_m)]))


@pytest.mark.parametrize(("factor", "advice"), [(0.2, "with 5 times"), (1000.0, "with 0.001 times")])
def test_another_unit_is_named(factor, advice):
    (fault,) = find_implausible_depth([factor * look_at_floor(60.0)])
    assert fault.field == "depth"
    assert advice in str(fault)


def test_images_without_depth_are_not_judged():
    assert not list(find_implausible_depth([np.zeros((4, 4)), np.zeros((0, 0))]))
    assert not list(find_implausible_depth([]))
