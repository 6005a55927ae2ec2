"""Patterns, speeds and manners of walking: what people do, on the ground, without slip."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks import gait
from stridetwin.sim.config import Gait, Gaze, Level, Ramp, Route, Segment, Stairs, Turn, TwinConfig
from stridetwin.sim.gait.footsteps import CLEARANCE_M, Footstep
from stridetwin.sim.gait.style import style_at
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import ConfigError

LEVEL: tuple[Segment, ...] = (Level(length_m=7.0),)
STAIRS = (Level(length_m=2.5), Stairs(risers=3), Level(length_m=2.0), Stairs(risers=3, down=True), Level(length_m=2.0))
CURVE = (Level(length_m=3.0), Turn(angle_rad=np.radians(-90.0), radius_m=2.0), Level(length_m=2.0))
RAMP = (Level(length_m=3.0), Ramp(angle_rad=np.radians(5.0), rise_m=0.26), Level(length_m=3.0))
WALKS: dict[str, tuple[tuple[Segment, ...], Gait]] = {
    "wander": ((Level(length_m=12.0),), Gait.of_pattern("wander")),
    "jog": (CURVE, Gait.of_pattern("jog")),
    "run": (CURVE, Gait.of_pattern("run")),
    "fast": (LEVEL, Gait(speed_mps=2.1)),
    "slow": ((Level(length_m=2.0),), Gait(speed_mps=0.1)),
    "fast stairs": (STAIRS, Gait(speed_mps=2.1)),
    "slow stairs": (STAIRS, Gait(speed_mps=0.3)),
    "step by step": (STAIRS, Gait(speed_mps=0.7, stairs="step_by_step", leading_foot="l")),
    "two at a time": (
        (Level(length_m=2.5), Stairs(risers=7), Level(length_m=2.0), Stairs(risers=3, down=True), Level(length_m=2.0)),
        Gait(stairs="two_at_a_time"),
    ),
    "limp": (CURVE, Gait(speed_mps=0.8, asymmetry=0.25)),
    "shuffle": (RAMP, Gait(speed_mps=0.4, shuffle=1.0)),
}


def make(segments: tuple[Segment, ...], walk: Gait, seed: int = 3) -> Twin:
    return Twin(TwinConfig(name="t", route=Route(segments=segments), exo=None, gait=walk, sensors=()), seed)


def in_order(twin: Twin) -> list[Footstep]:
    steps = [s for own in twin.reference.steps.values() for s in own if np.isfinite(s.t_touch)]
    return sorted(steps, key=lambda s: s.t_touch)


@pytest.fixture(scope="module")
def twins() -> dict[str, Twin]:
    return {name: make(*walk) for name, walk in WALKS.items()}


@pytest.mark.parametrize("name", list(WALKS))
def test_feet_stay_on_the_ground_and_joints_in_human_ranges(twins: dict[str, Twin], name: str) -> None:
    twin = twins[name]
    assert max(gait.penetration(twin, side) for side in "lr") < 0.005
    assert max(gait.slip(twin, side) for side in "lr") < 0.002
    for joint, (low, high) in gait.HUMAN_DEG.items():
        least, most = gait.joint_range_deg(twin, joint)
        assert low - 4.0 <= least, joint
        # both feet on each tread: the one above bends it in the air; two at a time: the body rises over a bent leg
        assert most <= high + (7.0 if name == "two at a time" else 5.0), joint


@pytest.mark.parametrize(("name", "speed"), [("fast", 2.1), ("slow", 0.1)])
def test_the_walker_goes_as_fast_as_asked(twins: dict[str, Twin], name: str, speed: float) -> None:
    steps = in_order(twins[name])
    speeds = np.diff([s.s for s in steps]) / np.diff([s.t_touch for s in steps])
    assert np.median(speeds[2:-2]) == pytest.approx(speed, rel=0.12)


@given(st.floats(0.01, 0.75), st.floats(0.005, 0.05))
def test_styles_change_smoothly_and_slow_walkers_stay_on_both_feet(pace: float, more: float) -> None:
    slow, fast = style_at(pace), style_at(pace + more)
    assert float(fast.double_support) <= float(slow.double_support) + 0.01
    assert np.abs(fast.to_vector() - slow.to_vector()).max() < 12.0 * more + 0.01
    assert 0.05 < float(fast.double_support) < 0.9


def test_double_support_is_that_of_people() -> None:
    share = [float(style_at(pace).double_support) for pace in (0.03, 0.14, 0.27, 0.42)]
    assert share[0] > 0.6
    assert 0.35 < share[1] < 0.50  # 0.4 m/s
    assert 0.23 < share[2] < 0.33  # 0.8 m/s
    assert 0.15 < share[3] < 0.22


def test_a_wanderer_pauses_with_both_feet_on_the_ground(twins: dict[str, Twin]) -> None:
    steps = in_order(twins["wander"])
    times = np.diff([s.t_touch for s in steps])
    pauses = np.flatnonzero(times > 1.25)
    assert len(pauses) >= 1
    for i in pauses:
        on_both = steps[i + 1].style.double_support * times[i]
        assert on_both > 0.6
    assert np.std(np.delete(times, pauses)) > 0.05


def test_both_feet_come_to_every_tread_and_the_chosen_one_leads(twins: dict[str, Twin]) -> None:
    steps = in_order(twins["step by step"])
    treads = [s for s in steps if s.terrain == "stair"]
    assert len(treads) == 2 * 4
    for lead, joined in zip(treads[::2], treads[1::2]):
        assert (lead.foot, joined.foot) == ("l", "r")
        assert lead.mode in ("SA", "SD")
        assert joined.mode == "LG"
        assert joined.p_foot_in_world[2] == lead.p_foot_in_world[2]
        assert joined.arrival == "flat"
    assert [s.mode for s in steps].count("SA") == [s.mode for s in steps].count("SD") == 3


def test_every_second_tread_is_passed_over_on_the_way_up_alone(twins: dict[str, Twin]) -> None:
    steps = in_order(twins["two at a time"])
    up, down = ([s for s in steps if s.mode == mode] for mode in ("SA", "SD"))
    assert [round(s.rise / 0.165) for s in up] == [2, 2, 2, 1]
    assert [round(s.rise / 0.165) for s in down] == [-1, -1, -1]
    assert {s.arrival for s in up} == {"flat"}


@pytest.mark.parametrize(
    ("stairs", "rises"),
    [
        (Stairs(risers=4, riser_m=(0.15, 0.20, 0.15, 0.15)), [1, 1, 2]),
        (Stairs(risers=4, riser_m=0.21), [1, 1, 1, 1]),
        (Stairs(risers=4, riser_m=0.15, tread_m=0.34), [1, 1, 1, 1]),
        (Stairs(risers=1), [1]),
    ],
)
def test_legs_that_are_too_short_for_two_treads_take_one(stairs: Stairs, rises: list[int]) -> None:
    walk = make((Level(length_m=2.5), stairs, Level(length_m=2.0)), Gait(stairs="two_at_a_time"))
    treads = np.concatenate([[0.0], np.cumsum(stairs.heights_m)])
    at = [int(np.abs(treads - s.p_foot_in_world[2]).argmin()) for s in in_order(walk) if s.mode == "SA"]
    assert np.diff([0, *at]).tolist() == rises


def test_a_tread_deeper_than_a_pace_takes_two() -> None:
    deep = Stairs(risers=3, tread_m=0.6)
    steps = in_order(make((Level(length_m=2.5), deep, Level(length_m=2.0)), Gait(speed_mps=0.5)))
    assert [s.mode for s in steps if s.terrain == "stair"] == ["SA", "LG", "SA", "LG"]


def test_a_limp_has_long_and_short_steps_in_space_and_time() -> None:
    steps = in_order(make((Level(length_m=12.0),), Gait(speed_mps=0.8, asymmetry=0.25, step_sd=0.0)))[3:-4]
    lengths, times = np.diff([s.s for s in steps]), np.diff([s.t_touch for s in steps])
    left = np.array([s.foot == "l" for s in steps[1:]])
    for values in (lengths, times):
        assert np.mean(values[left]) / np.mean(values[~left]) == pytest.approx(1.25 / 0.75, rel=0.06)
    stance = {side: np.mean([s.t_off - s.t_touch for s in steps if s.foot == side]) for side in "lr"}
    assert stance["l"] < 0.9 * stance["r"]


def test_a_shuffler_slides_along_flat_in_short_steps(twins: dict[str, Twin]) -> None:
    shuffling = in_order(twins["shuffle"])
    usual = in_order(make(RAMP, Gait(speed_mps=0.4)))
    assert {s.arrival for s in shuffling} == {"flat"}
    assert max(s.clearance_m for s in shuffling) < 0.4 * CLEARANCE_M
    assert len(shuffling) > 1.5 * len(usual)
    assert np.mean([s.style.double_support for s in shuffling]) > np.mean([s.style.double_support for s in usual]) + 0.1


def test_fast_walkers_slow_down_before_stairs(twins: dict[str, Twin]) -> None:
    steps = in_order(twins["fast stairs"])
    times = np.diff([s.t_touch for s in steps])
    assert times[[s.mode in ("SA", "SD") for s in steps[1:]]].min() > 0.38
    assert steps[0].t_off < np.inf


@pytest.mark.parametrize(
    ("walk", "field", "valid"),
    [
        (Gait(pattern="hop"), "pattern", "wander, walk, jog, run"),
        (Gait.of_pattern("run", shuffle=0.5), "shuffle", "0 in a run"),
        (Gait(speed_mps=5.0), "speed_mps", "0.05-2.1"),
        (Gait(speed_mps=0.01), "speed_mps", "0.05-2.1"),
        (Gait(stairs="hop"), "stairs", "step_by_step"),
        (Gait(leading_foot="left"), "leading_foot", "l, r"),
        (Gait(asymmetry=0.7), "asymmetry", "0.4"),
        (Gait(shuffle=-1.0), "shuffle", "0-1"),
        (Gait(gaze=Gaze(kind="down")), "gaze.kind", "ahead, terrain, wandering"),
        (Gait(gaze=Gaze(yaw_rad=2.0)), "gaze.yaw_rad", "0.7"),
    ],
)
def test_a_gait_that_nobody_walks_is_refused_with_what_is_possible(walk: Gait, field: str, valid: str) -> None:
    with pytest.raises(ConfigError, match=field) as refused:
        make(LEVEL, walk)
    assert valid in str(refused.value)
