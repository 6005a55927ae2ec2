"""A camera in the hand: in motion from the first image, without depth, with a late camera and forces too large."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks import vio_handheld
from stridetwin.estimators.dvio import Dvio
from stridetwin.estimators.dvio.anchor import Anchor
from stridetwin.estimators.dvio.loss import compute_strayed_variance
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Depth, Imu
from tests.estimators.dvio.test_dvio import errors
from tests.estimators.dvio.wall import Wall, rig, swaying


def in_hand(t):
    """Places and rotation vectors of a camera that is in motion at once, and turns twice as fast as a head."""
    p, turn = swaying(np.asarray(t) + 10.0)
    return p, 1.8 * turn


def without_depth(wall, force=1.0):
    """The samples as a phone gives them: no depth, and forces times a factor."""
    for s in wall.samples():
        if isinstance(s, Imu):
            yield replace(s, specific_force=force * s.specific_force)
        elif not isinstance(s, Depth):
            yield s


def plain_rig():
    """The wall's rig without a depth camera."""
    usual = rig()
    camera = replace(usual.cameras["/head/color"], depth_topic="")
    return replace(usual, cameras={"/head/color": camera})


@pytest.mark.parametrize(("late_s", "force"), [(-0.056, 1.028), (0.056, 0.972)])
def test_a_bad_clock_and_bad_forces_in_motion_from_the_start_lose_no_metre(late_s, force):
    wall = Wall(in_hand, 14.0, seed=4, late_s=late_s)
    odometry = Dvio(plain_rig())
    estimates = [e for s in without_depth(wall, force) if (e := odometry.update(s)) is not None]
    assert odometry.time_offset_s == pytest.approx(late_s, abs=6e-3)
    assert estimates[-1].health == "tracking"
    error, sd = errors(wall, estimates), np.array([np.sqrt(np.trace(e.covariance[:3, :3])) for e in estimates])
    assert error.max() < 1.0
    assert np.mean(error < 2.8 * sd) > 0.88


def test_a_covered_camera_ends_as_lost_where_it_was_seen_last_and_begins_anew():
    wall = Wall(swaying, 40.0, seed=5)
    images = wall.images
    wall.images = lambda t_ns: () if 3.0e9 < t_ns < 37.0e9 else images(t_ns)
    odometry, samples = Dvio(plain_rig()), without_depth(wall)
    estimates = [e for s in samples if (e := odometry.update(s)) is not None]
    healths = [e.health for e in estimates]
    assert "lost" in healths
    first = healths.index("lost")
    assert 6e9 < estimates[first].t_ns < 36e9
    lost = [e for e in estimates if e.health == "lost"]
    variance = np.array([np.trace(e.covariance[:3, :3]) for e in lost])
    assert (np.diff(variance) > 0).all()
    error = errors(wall, estimates)
    assert error[-1] < 3.0 * np.sqrt(np.trace(estimates[-1].covariance[:3, :3]))
    assert all(e.covariance[0, 0] > 0.9 * lost[-1].covariance[0, 0] for e in estimates[first + len(lost) :])


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_an_anchor_is_the_uncertainty_of_its_pose_but_for_the_tilt(seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(6, 6))
    P, p, R = A @ A.T, rng.normal(size=3), Rotation.random(random_state=seed).as_matrix()
    anchor = Anchor.at(p, R, P)
    added = anchor.covariance_at(p, R)
    np.testing.assert_allclose(added[:3, :3], P[:3, :3], atol=1e-9)
    up = R[2]
    assert up @ added[3:, 3:] @ up == pytest.approx(up @ P[3:, 3:] @ up)
    # a heading error turns the way since: its share grows with the square of the way over ground
    only_heading = Anchor(p=p, covariance=np.diag([0.0, 0.0, 0.0, 1e-4]))
    away = only_heading.covariance_at(p + [3.0, 4.0, 7.0], R)[:3, :3]
    assert np.trace(away) == pytest.approx(1e-4 * 25.0)
    assert away[2, 2] == pytest.approx(0.0, abs=1e-15)


@given(st.floats(1e-3, 600.0), st.floats(1e-3, 60.0))
def test_the_longer_a_wearer_is_lost_the_farther_away(lost_s, more_s):
    assert compute_strayed_variance(lost_s + more_s) > compute_strayed_variance(lost_s) + 0.9 * more_s
    assert compute_strayed_variance(0.0) == 0.0


def test_a_hand_in_a_room_of_the_twin_ends_within_a_metre(tmp_path):
    recording = Recording(vio_handheld.record_hand(3, 9.0, tmp_path))
    figures = vio_handheld.follow(recording, vio_handheld.RIGS["late_depth"])
    assert figures["end_error_m"] < 0.5
    assert figures["offset_ms"] == pytest.approx(-56.0, abs=8.0)
    assert figures["nees_position_within_95_pct"] > 60.0
