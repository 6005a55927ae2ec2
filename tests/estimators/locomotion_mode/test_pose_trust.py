"""How far poses can be trusted: growth of their covariance, and a status of dead reckoning."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stridetwin.estimators.base import DEPTH_ONLY, IMU_ONLY, POSES, TRACKING
from stridetwin.estimators.locomotion_mode import UNKNOWN, LocomotionMode
from stridetwin.estimators.locomotion_mode.parameters import Settings
from stridetwin.estimators.locomotion_mode.pose_trust import PoseTrust
from stridetwin.estimators.locomotion_mode.segments import unseen_probability
from stridetwin.estimators.terrain_map import Profile
from stridetwin.outputs.pose_feed import pose_sample
from stridetwin.streams.samples import Depth, Odometry
from tests.estimators.locomotion_mode.walker import samples
from tests.estimators.terrain_map.scenes import RIG

PERIOD_NS = 50_000_000
SPEED_MPS = 1.0


def pose_of(t_ns, *, status="", vertical_sd=None, place_sd=0.0):
    """A pose with a standard deviation of its height and of its place, m."""
    covariance = None if vertical_sd is None else np.diag([place_sd**2, 0.0, vertical_sd**2, 0.0, 0.0, 0.0])
    return pose_sample(t_ns, np.zeros(3), np.array([1.0, 0, 0, 0]), POSES, status=status, covariance=covariance)


def trust_after(seconds, rate_mps, status, *, place_rate_mps=0.0):
    """The trust after some time in which standard deviations grow at a rate."""
    trust = PoseTrust(Settings())
    trust.add(pose_of(0, status=TRACKING, vertical_sd=0.0))
    for t_ns in range(0, round(seconds * 1e9), PERIOD_NS):
        t = t_ns * 1e-9
        trust.add(pose_of(t_ns, status=status, vertical_sd=rate_mps * t, place_sd=place_rate_mps * t))
    return trust


@pytest.mark.parametrize("status", [TRACKING, DEPTH_ONLY])
def test_poses_that_the_surroundings_hold_are_trusted(status):
    trust = trust_after(5.0, 0.1, status, place_rate_mps=0.3)
    assert trust.unsure(SPEED_MPS) == trust.slope_sd_rad(SPEED_MPS) == 0.0


def test_poses_of_which_nothing_is_known_are_trusted():
    trust = PoseTrust(Settings())
    for t_ns in range(0, 5 * 10**9, PERIOD_NS):
        trust.add(pose_of(t_ns))
    assert trust.unsure(SPEED_MPS) == 0.0


def test_dead_reckoning_is_trusted_less_after_a_second():
    short, longer = (trust_after(seconds, 0.02, IMU_ONLY) for seconds in (0.9, 3.0))
    assert short.unsure(SPEED_MPS) < 0.05
    assert longer.unsure(SPEED_MPS) > 0.3


@settings(max_examples=50, deadline=None)
@given(st.floats(0.0, 0.2), st.floats(0.0, 0.2), st.sampled_from(["", IMU_ONLY]), st.floats(0.0, 2.0))
def test_more_drift_and_slower_walks_are_less_sure(rate, more, status, speed):
    less, greater = trust_after(3.0, rate, status), trust_after(3.0, rate + more, status)
    assert 0.0 <= less.unsure(speed) <= greater.unsure(speed) + 1e-9 <= 1.0 + 1e-9
    assert less.unsure(speed + 0.5) <= less.unsure(speed) + 1e-9


def test_trust_returns_when_the_ground_of_the_bad_stretch_is_behind():
    trust = trust_after(3.0, 0.1, IMU_ONLY)
    assert trust.unsure(SPEED_MPS) > 0.5
    for t_ns in range(3 * 10**9, 5 * 10**9, PERIOD_NS):
        trust.add(pose_of(t_ns, status=TRACKING, vertical_sd=0.01))
    assert trust.unsure(SPEED_MPS) == 0.0


def test_a_covariance_that_is_not_finite_is_ignored():
    trust = PoseTrust(Settings())
    for t_ns in range(0, 2 * 10**9, PERIOD_NS):
        trust.add(pose_of(t_ns, status=IMU_ONLY, vertical_sd=math.nan))
    assert trust.unsure(SPEED_MPS) == 0.0


def drifting(walk, *, without_depth):
    """The samples of a scripted walk whose poses nothing but the IMU holds from 2 s on."""
    for sample in walk:
        if isinstance(sample, Depth) and without_depth and sample.t_ns > 2e9:
            yield replace(sample, depth=np.zeros_like(sample.depth))
        elif isinstance(sample, Odometry):
            since_s = max(0.0, sample.t_ns * 1e-9 - 2.0)
            covariance = np.diag([0.05**2, 0.0, 0.03**2, 0.0, 0.0, 0.0]) * since_s**2
            yield pose_sample(
                sample.t_ns,
                sample.p_frame_in_world,
                sample.q_world_frame,
                status=IMU_ONLY if since_s > 0.0 else TRACKING,
                covariance=covariance,
            )
        else:
            yield sample


def test_without_light_and_depth_the_mode_is_unknown_and_with_depth_it_is_still_known():
    for without_depth in (True, False):
        predictor = LocomotionMode(RIG)
        made = [e for e in map(predictor.update, drifting(samples(), without_depth=without_depth)) if e is not None]
        late = [e.steps[0] for e in made if e.t_ns > 4.5e9]
        assert late
        unknown = [step.mode == UNKNOWN for step in late]
        assert all(unknown) if without_depth else not any(unknown)
        for step in late:
            assert sum(step.probabilities.values()) == pytest.approx(1.0)
            assert step.probability == max(step.probabilities.values())
            assert step.probability < 0.7 or not without_depth


def test_after_a_new_start_of_the_map_the_unseen_ground_under_the_foot_may_be_a_stair():
    s = np.linspace(0.0, 3.0, 101)
    profile = Profile(s=s, height=np.where(s > 1.5, 0.0, np.nan), plane=np.where(s > 1.5, 0, -1), changes=())
    usual, lost = (unseen_probability(profile, s, 0.9, Settings(), is_lost=is_lost) for is_lost in (False, True))
    assert usual[30] < 0.01 < 0.5 < lost[30]
    np.testing.assert_allclose(lost[s > 1.6], 0.0, atol=1e-12)
