"""Footprints along the way: long steps, both feet, a turn; and when a change ahead of them is asked for."""

from __future__ import annotations

import math

import numpy as np
import pytest

from stridetwin.outputs.truth import SCORED_AHEAD_S, project_on_way, scoring_time_ns
from stridetwin.sim.config import Level, Route, Turn
from stridetwin.sim.world.route import lay_out

CORNER = lay_out(Route(segments=(Level(length_m=6), Turn(angle_rad=math.pi / 2, radius_m=1.5), Level(length_m=6))))


@pytest.mark.parametrize("step_m", [0.3, 0.7, 1.4])
def test_footprints_lie_where_they_were_set_however_long_the_steps(step_m):
    s = np.r_[0.0, 0.0, np.arange(step_m, 13.0, step_m)]
    left = 0.1 - 0.2 * (np.arange(len(s)) % 2)
    places = project_on_way(np.column_stack([CORNER.way.point(s, left), np.zeros(len(s))]), CORNER)
    np.testing.assert_allclose(places, s, atol=0.01)


def test_a_walk_without_footprints_has_no_places():
    assert project_on_way([], CORNER).shape == (0,)


def test_a_change_is_asked_for_before_the_first_foot_beyond_it():
    t_ns, places = np.array([0, 0, 2, 3, 4]) * 10**9, np.array([0.0, 0.0, 0.6, 1.2, 1.8])
    assert scoring_time_ns(1.0, t_ns, places) == 3e9 - SCORED_AHEAD_S * 1e9
    assert scoring_time_ns(1.8, t_ns, places) == math.inf
