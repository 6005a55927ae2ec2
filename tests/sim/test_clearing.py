"""The smoothest rise or fall over what stands in the way."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stridetwin.sim.gait.foot_path import min_jerk_height
from stridetwin.sim.kinematics.smooth import ease

FREE = np.full(61, -np.inf)
AT = np.linspace(0.0, 1.0, 61)


@pytest.mark.parametrize("rise", [-0.33, 0.33])
def test_a_free_way_is_the_minimum_jerk_step(rise: float) -> None:
    height, jerk = min_jerk_height(rise, FREE)
    assert np.abs(height(AT) - rise * ease(AT)).max() < 0.004
    assert jerk == pytest.approx(720.0 * rise**2, rel=0.25)


@settings(max_examples=25, deadline=None)
@given(st.floats(-0.5, 0.5), st.integers(12, 40), st.integers(1, 10), st.floats(-0.2, 0.3))
def test_it_rests_at_both_ends_and_stays_above_with_bounded_acceleration(
    rise: float, first: int, length: int, edge: float
) -> None:
    least = FREE.copy()
    least[first : first + length] = edge
    height, jerk = min_jerk_height(rise, least)
    assert height(0.0) == pytest.approx(0.0, abs=1e-9)
    assert height(1.0) == pytest.approx(rise, abs=1e-9)
    for order in (1, 2):
        assert np.abs(height([0.0, 1.0], order)).max() < 1e-6
    assert (height(AT) >= least - 1e-6).all()
    assert jerk >= 0.99 * min_jerk_height(rise, FREE)[1]
    assert np.abs(height(np.linspace(0, 1, 500), 2)).max() < 60.0 * (abs(rise) + abs(edge) + 0.01) / 0.2**2 / 6.0
