"""The lean of the map, and the slopes of segments without it."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stridetwin.estimators.locomotion_mode import vertical
from stridetwin.estimators.locomotion_mode.parameters import LocomotionModeParameters
from stridetwin.estimators.locomotion_mode.vertical import remove_lean

LEAN_SD_RAD = LocomotionModeParameters().lean_sd_rad
SD = np.radians(0.4)


def apart(mapped):
    """No slope break between any two segments."""
    return np.zeros(max(len(mapped) - 1, 0), bool)


def slopes_deg(*mapped_deg, breaks=None):
    breaks = apart(mapped_deg) if breaks is None else np.array(breaks)
    slope, sd = remove_lean(np.radians(mapped_deg), np.full(len(mapped_deg), SD), breaks, LEAN_SD_RAD)
    return np.degrees(slope), np.degrees(sd)


@given(st.lists(st.floats(-0.3, 0.3), max_size=6))
def test_a_mirrored_way_has_mirrored_slopes(mapped):
    slope, sd = remove_lean(np.array(mapped), np.full(len(mapped), SD), apart(mapped), LEAN_SD_RAD)
    mirrored, mirrored_sd = remove_lean(-np.array(mapped), np.full(len(mapped), SD), apart(mapped), LEAN_SD_RAD)
    np.testing.assert_allclose(mirrored, -slope, atol=1e-12)
    np.testing.assert_allclose(mirrored_sd, sd, atol=1e-9)


@given(st.lists(st.floats(-0.3, 0.3), min_size=1, max_size=6))
def test_no_slope_is_steeper_than_mapped_by_more_than_the_largest_lean(mapped):
    slope, sd = remove_lean(np.array(mapped), np.full(len(mapped), SD), apart(mapped), LEAN_SD_RAD)
    assert (np.abs(slope - mapped) <= np.maximum(vertical._REACH_SD * LEAN_SD_RAD, np.abs(mapped))).all()
    assert np.isfinite(sd).all()
    assert (sd > 0.0).all()


def test_what_level_segments_have_in_common_is_the_lean():
    (before, ramp, beyond), sd = slopes_deg(0.8, 4.4, 0.9)
    assert max(abs(before), abs(beyond)) < 0.4
    assert ramp == pytest.approx(3.6, abs=0.35)
    assert sd[1] < 0.75


def test_a_single_gentle_slope_is_the_lean_and_a_steep_one_a_ramp():
    assert abs(slopes_deg(0.7)[0][0]) < 0.4
    assert slopes_deg(5.0)[0][0] == pytest.approx(5.0, abs=0.5)


def test_between_level_and_ramp_the_slope_is_uncertain():
    (slope,), (sd,) = slopes_deg(2.6)
    assert 1.0 < slope < 2.6
    assert sd > slopes_deg(5.0)[1][0]


def test_ground_beyond_a_slope_break_is_a_ramp():
    together = slopes_deg(-0.1, 1.6)[0][1]
    (before, beyond), _ = slopes_deg(-0.1, 1.6, breaks=[True])
    assert together < 1.0 < beyond
    assert abs(before) < 0.4


@given(st.lists(st.tuples(st.floats(-0.1, 0.1), st.booleans()), min_size=1, max_size=4))
def test_slopes_are_those_of_all_combinations_of_level_ground_and_ramps(way):
    mapped, breaks = np.array([m for m, _ in way]), np.array([b for _, b in way[1:]], bool)
    lean = np.linspace(-vertical._REACH_SD, vertical._REACH_SD, 81) * LEAN_SD_RAD
    total, mean = 0.0, np.zeros(len(way))
    for kinds in product((0, 1), repeat=len(way)):
        built = np.array([(vertical._FLAT_SD_RAD, vertical._RAMP_SD_RAD)[k] for k in kinds])[:, None] ** 2
        weight = np.exp(-0.5 * (lean / LEAN_SD_RAD) ** 2)
        for (k, other), cut in zip(pairwise(kinds), breaks, strict=True):
            weight = weight * (vertical._FALSE_BREAK if cut and k == other == 0 else 1.0)
        off = mapped[:, None] - lean
        share = np.array([(vertical._LEVEL_SHARE, 1.0 - vertical._LEVEL_SHARE)[k] for k in kinds])
        variance = built + SD**2
        weight = weight * np.prod(share[:, None] * np.exp(-0.5 * off**2 / variance) / np.sqrt(variance), axis=0)
        total += weight.sum()
        mean += (weight * off * built / variance).sum(axis=1)
    slope, _ = remove_lean(mapped, np.full(len(way), SD), breaks, LEAN_SD_RAD)
    np.testing.assert_allclose(slope, mean / total, atol=1e-9)
