"""Bends of one plane along a line: gentle ramps between level ground."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stridetwin.estimators.terrain_map.bends import straight_stretches
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters

MIN_BEND_RAD = TerrainMapParameters().min_slope_break_rad
S = np.arange(0.01, 7.2, 0.02)


def ground(*slopes_deg: float, bends_m: tuple[float, ...] = (2.0, 5.0), noise_m: float = 0.001) -> np.ndarray:
    slope = np.tan(np.radians(slopes_deg))[np.searchsorted(bends_m, S)]
    rough = np.random.default_rng(3).normal(0.0, noise_m, len(S))
    return np.cumsum(slope) * 0.02 + rough


@settings(max_examples=40, deadline=None)
@given(st.floats(2.0, 6.0), st.booleans(), st.floats(-1.0, 1.0), st.floats(1.0, 2.5))
def test_a_gentle_ramp_between_level_pieces_is_found(ramp: float, down: bool, lean: float, begin: float) -> None:
    ramp = -ramp if down else ramp
    height = ground(lean, lean + ramp, lean, bends_m=(begin, begin + 3.0))
    stretches = straight_stretches(S, height, 0, len(S) - 1, MIN_BEND_RAD)
    assert [math.degrees(math.atan(k.slope)) for k in stretches] == pytest.approx([lean, lean + ramp, lean], abs=0.25)
    assert [k.break_s for k in stretches[1:]] == pytest.approx([begin, begin + 3.0], abs=0.1)
    assert stretches[0].first == 0
    assert stretches[-1].last == len(S) - 1
    assert all(a.last + 1 == b.first for a, b in pairwise(stretches))


@settings(max_examples=40, deadline=None)
@given(st.floats(-15.0, 15.0), st.integers(0, 50))
def test_straight_ground_is_not_cut(slope: float, seed: int) -> None:
    rough = np.random.default_rng(seed).normal(0.0, 0.006, len(S))
    assert len(straight_stretches(S, math.tan(math.radians(slope)) * S + rough, 0, len(S) - 1, MIN_BEND_RAD)) < 2


def test_missing_heights_and_short_runs_do_not_bend() -> None:
    height = ground(0.0, 4.0, 0.0)
    height[::3] = np.nan
    assert len(straight_stretches(S, height, 0, len(S) - 1, MIN_BEND_RAD)) == 3
    assert straight_stretches(S, np.full(len(S), np.nan), 0, len(S) - 1, MIN_BEND_RAD) == []
    assert straight_stretches(S, height, 0, 10, MIN_BEND_RAD) == []


def test_a_jump_is_no_bend() -> None:
    """A kerb of 40 mm that the map holds as one plane with the ground around it: nothing slopes."""
    rough = np.random.default_rng(1).normal(0.0, 0.002, len(S))
    assert len(straight_stretches(S, np.where(S > 3.3, -0.04, 0.01) + rough, 0, len(S) - 1, MIN_BEND_RAD)) < 2
