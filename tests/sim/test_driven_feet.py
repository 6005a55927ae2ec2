"""Feet driven by markers: the sensor rides on the pinned foot, and its signals are those of the recorded one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import driven_feet
from benchmarks.real_walks import data_folder, load_markers
from stridetwin.sim.motion.skeleton import Skeleton
from stridetwin.sim.people import Person

FOLDER = data_folder("dual_foot_walk")
pytestmark = pytest.mark.skipif(FOLDER is None, reason="no recordings: STRIDETWIN_DATA")


@pytest.fixture(scope="module")
def foot() -> driven_feet.DrivenFoot:
    assert FOLDER is not None
    return driven_feet.drive(load_markers(FOLDER)[0], Skeleton.of(Person()).size.shoe)


def test_rates_and_velocities_are_the_derivatives_of_the_pose(foot: driven_feet.DrivenFoot) -> None:
    t, h = np.linspace(5.0, 7.0, 50), 1e-4
    before, now, after = (foot.motion(t + k * h) for k in (-1, 0, 1))
    v = (after.p_body_in_world - before.p_body_in_world) / (2 * h)
    np.testing.assert_allclose(now.v_body_in_world, v, atol=1e-3)
    w = (before.rotation.inv() * after.rotation).as_rotvec() / (2 * h)
    np.testing.assert_allclose(now.w_body, w, atol=2e-3)


def test_the_sensor_sits_beside_the_ankle_and_the_foot_rests_on_the_ground(foot: driven_feet.DrivenFoot) -> None:
    forward, outward, up = foot.p_sensor_in_foot
    assert 0.0 < forward < 0.06
    assert 0.02 < outward < 0.08
    assert 0.02 < up < 0.07
    rests = [stance.flat for stance in foot.stances if stance.flat is not None]
    assert len(rests) > 20
    moved = [np.ptp(foot.track.p[slice(*rest)], axis=0).max() for rest in rests]
    assert np.median(moved) < 2e-3


def _lateness_of_forces_s(foot: driven_feet.DrivenFoot, setting: str) -> float:
    """How much later than the rates the forces of the driven sensor seem, s."""
    driven = replace(foot, walk=replace(foot.walk, imu=driven_feet.simulate(foot, setting, 0)))
    return float(np.diff(driven_feet.find_delays(driven))[0])


def test_forces_of_the_real_sensor_are_later_than_its_rates(foot: driven_feet.DrivenFoot) -> None:
    assert abs(_lateness_of_forces_s(foot, "part alone")) < 5e-4
    # rates on a shoe that settles seem late; that is the same with and without a delay of the forces
    usual, late = (_lateness_of_forces_s(foot, setting) for setting in ("part and shoe", "late part and shoe"))
    assert late - usual == pytest.approx(driven_feet._FORCE_LATE_S, abs=3e-4)
    assert np.diff(driven_feet.find_delays(foot))[0] > 3e-3


def test_the_filter_follows_the_driven_foot_and_its_signals_are_like_the_real_ones(
    foot: driven_feet.DrivenFoot,
) -> None:
    real = driven_feet.signal_figures(foot, foot.walk.imu)
    ideal = driven_feet.simulate(foot, "ideal", 0)
    assert driven_feet.path_figures(foot, ideal)[driven_feet.PLANE] < 0.02
    driven = driven_feet.signal_figures(foot, driven_feet.simulate(foot, "part and shoe", 0))
    low, high = driven_feet.GOOD
    for name, value in real.items():
        assert low < driven[name] / value < high, name
