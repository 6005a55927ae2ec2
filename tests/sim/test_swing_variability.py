"""Swings of a person differ, and leave the places and times of the footsteps as they are."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import gait
from stridetwin.sim.config import Gait, Level, Route, TwinConfig
from stridetwin.sim.gait.foot_path import STOPPING_S
from stridetwin.sim.gait.footsteps import CLEARANCE_M, Footstep, SwingVariation
from stridetwin.sim.gait.heel_strike import SHOE, draw_shoes
from stridetwin.sim.gait.swing_variability import vary_swings
from stridetwin.sim.twin import Twin

CONFIG = TwinConfig(
    name="swings", route=Route(segments=(Level(length_m=8.0),)), gait=Gait(speed_mps=1.3), sensors=(), ideal=True
)


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin(CONFIG, 5)


def test_heels_land_at_a_persons_speed_and_the_ground_stops_them(twin: Twin) -> None:
    for side, steps in twin.walk.steps.items():
        assert 0.002 < gait.skid(twin, side) < 0.013
        touch = np.array([s.t_touch for s in steps if np.isfinite(s.t_touch)][1:-2])
        for after_s, low, high in ((-0.02, 0.8, 1.5), (0.0, 0.3, 1.0), (STOPPING_S, 0.0, 0.05)):
            t_ns = np.round((touch + after_s) * 1e9).astype(np.int64)
            track = twin.player().motion(t_ns).tracks[f"foot_{side}"]
            speed = np.linalg.norm(track.v_body_in_world[:, :2], axis=1)
            assert (speed > low).all()
            assert (speed < high).all()


def test_no_two_swings_are_alike_and_equal_seeds_give_equal_ones(twin: Twin) -> None:
    steps = twin.walk.steps["l"]
    assert len({s.swing for s in steps}) == len(steps)
    again = Twin(CONFIG, 5).walk.steps["l"]
    assert [s.swing for s in again] == [s.swing for s in steps]
    other = Twin(CONFIG, 6).walk.steps["l"]
    assert other[0].swing != steps[0].swing


def test_places_and_times_stay(twin: Twin) -> None:
    steps: list[Footstep] = [replace(s, swing=SwingVariation(), clearance_m=CLEARANCE_M) for s in twin.walk.steps["r"]]
    varied = vary_swings(steps, CONFIG.gait, np.random.default_rng(0))
    for before, after in zip(steps, varied):
        np.testing.assert_array_equal(after.p_foot_in_world, before.p_foot_in_world)
        assert (after.t_touch, after.t_off) == (before.t_touch, before.t_off)
        assert after.clearance_m > 0.5 * CLEARANCE_M
    # a person whose steps do not vary has the same swing in every stride
    same = vary_swings(steps, replace(CONFIG.gait, step_sd=0.0), np.random.default_rng(0))
    assert len({s.swing for s in same}) == 1


def test_shoes_of_people_differ_about_the_recorded_one() -> None:
    pairs = [draw_shoes(np.random.default_rng(seed)) for seed in range(200)]
    strength = np.array([left.mode_rate[0, 0] / SHOE.mode_rate[0, 0] for left, _ in pairs])
    assert 0.6 < np.median(strength) < 1.1
    assert strength.min() > 0.2
    assert strength.max() <= 1.5
    lean = np.degrees([np.linalg.norm(right.lean_rad) for _, right in pairs])
    assert 0.6 < np.median(lean) < 4.0
    assert lean.max() < 7.7


def test_shoes_roll_in_stance_at_the_rates_of_the_recorded_ones() -> None:
    """Toward the toes 0.02 to 0.2 rad/s in most; the feet of a pair turn inward and lean outward as mirror images."""
    pairs = [draw_shoes(np.random.default_rng(seed)) for seed in range(200)]
    left, right = (np.array([shoe.roll_rad for shoe in shoes]) for shoes in zip(*pairs))
    per_s = 1.875 / 0.65  # rate in the middle of a stance of 0.65 s, of a roll of 1 rad
    forward = per_s * np.concatenate([left, right])[:, 1]
    assert 0.06 < np.median(forward) < 0.10
    assert np.mean((forward > 0.0) & (forward < 0.2)) > 0.9
    np.testing.assert_allclose(left.mean(axis=0), right.mean(axis=0) * [-1.0, 1.0, -1.0], atol=0.004)
    assert left[:, 2].mean() < 0.0 < right[:, 2].mean()
    sinking = [1e3 * per_s * shoe.give_m[2] for shoes in pairs for shoe in shoes]  # mm/s
    assert -12.0 < np.median(sinking) < -4.0
