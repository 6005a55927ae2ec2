from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stridetwin.sim.config import Gait, Gaze
from stridetwin.sim.gait.footsteps import check_gait
from stridetwin.sim.gait.posture import GazeMotion, plan_gaze
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.terrain_truth import Strip

LEG_M = 0.93
PROFILE = (
    Strip(s0=-2.0, s1=8.0, z0=0.0, z1=0.0, terrain="level"),
    Strip(s0=8.0, s1=8.3, z0=-0.2, z1=-0.2, terrain="stair"),
    Strip(s0=8.3, s1=20.0, z0=-0.4, z1=-0.4, terrain="level"),
)
T = np.arange(0.0, 16.0, 0.005)
S = 1.2 * T


def looked(gaze: Gaze, seed: int = 0) -> GazeMotion:
    return plan_gaze(gaze, T, S, np.zeros_like(T), PROFILE, LEG_M, np.random.default_rng(seed))


def test_looking_ahead_draws_nothing() -> None:
    rng = np.random.default_rng(5)
    plan_gaze(Gaze(), T, S, np.zeros_like(T), PROFILE, LEG_M, rng)
    assert rng.uniform() == np.random.default_rng(5).uniform()


def test_who_looks_at_the_ground_pitches_the_head_down_and_more_where_it_falls() -> None:
    ahead, terrain = looked(Gaze()), looked(Gaze(kind="terrain"))
    assert np.all(terrain.head_pitch[:2400] > ahead.head_pitch[:2400] + 0.1)
    on_level, before_fall = terrain.head_pitch[np.searchsorted(S, 3.0)], terrain.head_pitch[np.searchsorted(S, 7.0)]
    assert before_fall > on_level + 0.02
    assert np.abs(terrain.head_yaw).max() == 0.0


@given(st.integers(0, 10_000), st.floats(-0.6, 0.8), st.floats(-0.7, 0.7))
def test_a_wandering_gaze_stays_within_what_a_neck_can_do(seed: int, pitch: float, yaw: float) -> None:
    found = looked(Gaze(kind="wandering", pitch_rad=pitch, yaw_rad=yaw), seed)
    assert np.abs(found.head_yaw).max() < 1.0
    assert np.abs(found.head_pitch).max() < 1.0
    assert np.abs(np.gradient(found.head_yaw, T)).max() < 8.0  # people turn their heads at up to some 500 deg/s
    assert np.abs(found.chest_yaw).max() < 0.4 * np.abs(found.head_yaw).max()


def test_a_wandering_gaze_holds_still_between_quick_moves() -> None:
    found = looked(Gaze(kind="wandering"), 4)
    speed = np.hypot(np.gradient(found.head_yaw, T), np.gradient(found.head_pitch, T))
    assert (speed < 1e-3).mean() > 0.5
    assert speed.max() > 0.8
    assert np.degrees(found.head_yaw).std() == pytest.approx(20.0, abs=12.0)
    assert np.array_equal(found.head_yaw, looked(Gaze(kind="wandering"), 4).head_yaw)
    assert not np.array_equal(found.head_yaw, looked(Gaze(kind="wandering"), 5).head_yaw)


def test_what_the_user_adds_turns_the_head_and_a_little_the_chest() -> None:
    plain, rotated = looked(Gaze()), looked(Gaze(pitch_rad=0.3, yaw_rad=-0.4))
    assert np.mean(rotated.head_pitch - plain.head_pitch) == pytest.approx(0.3, abs=0.03)
    assert np.mean(rotated.head_yaw) == pytest.approx(-0.4, abs=0.03)
    assert -0.15 < np.mean(rotated.chest_yaw) < -0.05


def test_a_head_that_sways_starts_still_and_reaches_the_configured_rate() -> None:
    amplitude, hz = np.radians(9.0), 2.0
    found, plain = looked(Gaze(sway_yaw_rad=amplitude, sway_pitch_rad=0.05, sway_hz=hz)), looked(Gaze(yaw_rad=1e-9))
    assert np.abs(found.head_yaw[T < 1.0]).max() < 1e-6
    rate = np.gradient(found.head_yaw, T)[T > 2.0]
    assert np.abs(rate).max() == pytest.approx(2 * np.pi * hz * amplitude, rel=0.03)
    nod = (found.head_pitch - plain.head_pitch)[T > 2.0]
    assert np.ptp(nod) == pytest.approx(2 * 0.05, rel=0.03)
    assert abs(np.corrcoef(nod, found.head_yaw[T > 2.0])[0, 1]) < 0.05  # a quarter of a period apart
    assert np.abs(found.chest_yaw).max() < 0.01  # too quick for the trunk


@pytest.mark.parametrize(
    ("gaze", "field"),
    [
        (Gaze(sway_yaw_rad=0.71), "sway_yaw_rad"),
        (Gaze(sway_pitch_rad=-0.1), "sway_pitch_rad"),
        (Gaze(sway_yaw_rad=0.1, sway_hz=3.5), "sway_hz"),
        (Gaze(sway_yaw_rad=0.7, sway_hz=2.0), "sway_hz"),
    ],
)
def test_a_sway_that_no_neck_can_do_is_refused(gaze: Gaze, field: str) -> None:
    with pytest.raises(ConfigError, match=field):
        check_gait(Gait(gaze=gaze))
