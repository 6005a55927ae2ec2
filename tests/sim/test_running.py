"""Runs: a flight between short stances, at a cadence that does not follow the speed, with the forces of a bounce."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stridetwin.sim.config import Gait, Level, Route, Stairs, Stop, TwinConfig
from stridetwin.sim.gait.footsteps import Footstep
from stridetwin.sim.gait.load import in_flight
from stridetwin.sim.gait.running import bounce, running_steps
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2

LEVEL = TwinConfig(
    name="run", route=Route(segments=(Level(length_m=16.0),)), exo=None, gait=Gait.of_pattern("run"), sensors=()
)
SPEEDS_MPS = (1.5, 2.0)


@pytest.fixture(scope="module")
def twins() -> dict[float, Twin]:
    return {v: Twin(replace(LEVEL, gait=replace(LEVEL.gait, speed_mps=v)), 5) for v in SPEEDS_MPS}


def run_steps(twin: Twin) -> list[Footstep]:
    return sorted((s for side in twin.reference.steps.values() for s in side if s.is_run), key=lambda s: s.t_touch)


@pytest.mark.parametrize("speed", SPEEDS_MPS)
def test_runners_fly_between_short_stances(twins: dict[float, Twin], speed: float) -> None:
    steps = run_steps(twins[speed])
    assert len(steps) > 8
    contact = np.array([s.t_off - s.t_touch for s in steps[:-2]])  # after the last two they walk
    time = np.diff([s.t_touch for s in steps])
    assert np.all((contact > 0.22) & (contact < 0.38))
    assert np.median(contact) < np.median(time)
    assert 2.4 < 1.0 / np.median(time) < 2.9  # Cavagna et al. 1988
    assert np.median(np.diff([s.s for s in steps]) / time) == pytest.approx(speed, rel=0.12)
    grid = np.arange(steps[0].t_touch, steps[-1].t_touch, 0.002)
    assert 0.05 < in_flight(twins[speed].reference.steps, grid).mean() < 0.3


@pytest.mark.parametrize("speed", SPEEDS_MPS)
def test_the_ground_carries_a_runner_by_a_force_of_two_body_weights(twins: dict[float, Twin], speed: float) -> None:
    twin, steps = twins[speed], run_steps(twins[speed])
    t_ns = (np.arange(steps[1].t_touch, steps[-2].t_touch, 0.005) * 1e9).astype(np.int64)
    player = twin.player()
    loads = player.loads(t_ns, player.motion(t_ns))
    weight = twin.config.person.mass_kg * NOMINAL_GRAVITY_MPS2
    feet = [load.force[:, 2] / weight for load in loads.feet.values()]
    share = -float(np.median([float(s.style.double_support) for s in steps]))  # of a step in flight
    assert np.mean(np.sum(feet, axis=0)) == pytest.approx(1.0, abs=0.06)
    assert np.percentile(np.max(feet, axis=0), 95) == pytest.approx(np.pi / 2 / (1 - share), rel=0.15)  # Morin 2005
    flight = in_flight(twin.reference.steps, t_ns * 1e-9)
    assert not any(load.loaded[flight].any() for load in loads.feet.values())
    left = np.linalg.norm(loads.residual_force, axis=1)[flight] / weight
    assert np.sqrt(np.mean(left**2)) < 0.6


@pytest.mark.parametrize("speed", SPEEDS_MPS)
def test_a_runners_shoe_is_nearly_still_for_an_instant_of_most_stances(twins: dict[float, Twin], speed: float) -> None:
    """Stillest 25 ms of stances: recorded runners turn at 0.2 to 0.8 rad/s there (`foot_imu_vicon`, 80 %)."""
    config = replace(twins[speed].config, sensors=("foot_imu",))
    stillest = []
    for seed in (5, 6, 7):
        twin = Twin(config, seed)
        t_ns = np.arange(0, int(twin.duration_s * 1e9), 5_000_000, dtype=np.int64)
        uppers, t = twin.player().motion(t_ns).uppers, t_ns * 1e-9
        for side in ("l", "r"):
            rate2 = (uppers[f"foot_{side}"].w_body ** 2).sum(1)
            means = np.sqrt(np.convolve(rate2, np.ones(5) / 5, "same"))
            stillest += [means[(t > s.t_touch) & (t < s.t_off)].min() for s in twin.reference.steps[side] if s.is_run]
    assert 0.2 < np.median(stillest) < 0.8


@given(st.floats(0.02, 0.35))
def test_a_body_falls_freely_in_the_flight(flight: float) -> None:
    wave = bounce(flight)
    phase = np.linspace(0.0, 1.0, 200, endpoint=False)
    up = np.zeros_like(phase)  # acceleration in units of g
    for k in (1, 2, 3):
        angle = 2 * np.pi * k * phase
        up -= (2 * np.pi * k) ** 2 * (wave[2 * k - 2] * np.cos(angle) + wave[2 * k - 1] * np.sin(angle))
    middle = np.abs(phase - (1.0 - flight / 2)) < flight / 8
    assert np.mean(up[middle]) == pytest.approx(-1.0, abs=0.15)
    assert up.max() == pytest.approx(np.pi / 2 / (1 - flight) - 1.0, rel=0.15)


def test_runners_walk_out_of_a_stand_at_risers_and_at_pauses() -> None:
    rises, pauses = [0.0] * 12, [0.0] * 12
    assert running_steps(rises, pauses) == [False] * 3 + [True] * 6 + [False] * 3
    rises[6] = 0.16
    assert running_steps(rises, pauses)[5:8] == [False] * 3
    rises[6], pauses[6] = 0.0, 2.0
    assert running_steps(rises, pauses)[6:8] == [False] * 2
    route = Route(segments=(Level(length_m=7.0), Stairs(risers=3), Level(length_m=6.0)))
    gait = replace(LEVEL.gait, stops=(Stop(at_m=3.0, for_s=2.0),))
    twin = Twin(replace(LEVEL, route=route, gait=gait), 1)
    steps = [s for side in twin.reference.steps.values() for s in side]
    assert any(s.is_run for s in steps)
    assert not any(s.is_run for s in steps if s.mode == "SA" or s.pause_s > 0.0)


def test_simulated_walkers_do_not_run() -> None:
    with pytest.raises(ConfigError, match="physics"):
        Twin(replace(LEVEL, physics="dynamic"), 1)
