"""The lean of the map, and the slopes of segments without it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stridetwin.estimators.locomotion_mode.parameters import LocomotionModeParameters
from stridetwin.estimators.locomotion_mode.vertical import without_lean

P = LocomotionModeParameters()
SD = np.radians(0.4)


def slopes_deg(*mapped_deg):
    slope, sd = without_lean(np.radians(mapped_deg), np.full(len(mapped_deg), SD), P)
    return np.degrees(slope), np.degrees(sd)


@given(st.lists(st.floats(-0.3, 0.3), max_size=6))
def test_a_mirrored_way_has_mirrored_slopes(mapped):
    slope, sd = without_lean(np.array(mapped), np.full(len(mapped), SD), P)
    mirrored, mirrored_sd = without_lean(-np.array(mapped), np.full(len(mapped), SD), P)
    np.testing.assert_allclose(mirrored, -slope, atol=1e-12)
    np.testing.assert_allclose(mirrored_sd, sd, atol=1e-9)


@given(st.lists(st.floats(-0.3, 0.3), min_size=1, max_size=6))
def test_no_slope_is_steeper_than_mapped_by_more_than_the_largest_lean(mapped):
    slope, sd = without_lean(np.array(mapped), np.full(len(mapped), SD), P)
    assert (np.abs(slope - mapped) <= np.maximum(P.lean_reach_sd * P.lean_sd_rad, np.abs(mapped))).all()
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
