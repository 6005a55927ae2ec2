"""A sensor that is not on a foot has no path; where stances stop, the path does, too."""

import numpy as np
import pytest

from benchmarks.real_walks import imu_block
from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import FootIns
from stridetwin.estimators.foot_ins.estimate import LONGEST_WITHOUT_STANCE_S
from stridetwin.streams.errors import StrideTwinError
from tests.streams.foot_imu import simulate_foot


def carry_in_hand(rest_s: float, carried_s: float):
    """Samples of a phone that rests, is carried at 1.8 steps per second, and rests again."""
    t = np.arange(0.0, 2 * rest_s + carried_s, 0.01)
    carried = ((t >= rest_s) & (t < rest_s + carried_s))[:, None]
    w = 2 * np.pi * 1.8
    force = np.column_stack([0.8 * np.sin(w * t / 2), 1.5 * np.sin(w * t), 2.5 * np.cos(w * t)]) * carried
    rate = np.column_stack([0.3 * np.cos(w * t / 2), 0.2 * np.sin(w * t), 0.15 + 0.3 * np.sin(w * t / 2)]) * carried
    noise = np.random.default_rng(0).normal
    force = force + [0.0, 0.0, 9.81] + noise(0.0, 0.02, force.shape)
    return imu_block(t, rate + noise(0.0, 0.002, rate.shape), force)


def test_a_sensor_that_never_rests_has_no_path():
    with pytest.raises(StrideTwinError, match="is it worn on a foot"):
        FootIns.estimate_block(carry_in_hand(0.0, 40.0), Options())


def test_the_path_stops_where_stances_do_and_goes_on_at_the_next_one():
    block = carry_in_hand(5.0, 30.0)
    path = FootIns.estimate_block(block, Options()).path
    seconds = path.t_ns * 1e-9
    assert not np.any((seconds > 5.1 + LONGEST_WITHOUT_STANCE_S) & (seconds < 34.9))
    assert np.any(seconds > 39.0)


def test_a_walk_keeps_every_pose():
    t, force, rate = simulate_foot()
    path = FootIns.estimate_block(imu_block(t, rate, force), Options()).path
    assert len(path) == len(t)
    assert abs(path.p_frame_in_world[-1, 2]) < 0.1


def test_rare_stances_are_said_and_widen_the_covariance():
    block = carry_in_hand(5.0, 30.0)
    estimate = FootIns.estimate_block(block, Options())
    (note,) = estimate.notes
    assert "no stance within 2.5 s for" in note
    t, force, rate = simulate_foot()
    assert FootIns.estimate_block(imu_block(t, rate, force), Options()).notes == ()
    path = FootIns().run(block).trajectory
    seconds = path.t_ns * 1e-9
    before, after = np.searchsorted(seconds, [7.4, 11.0])  # up to 2.5 s after the last rest, and after 6 s
    sd = np.sqrt(path.covariance[:, 0, 0])
    assert sd[after] > 1.0 > sd[before]
