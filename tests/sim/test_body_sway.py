"""Pelvis, chest and head sway with the stride: smoothly, not at rest, and as recorded people's do."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import people_body
from stridetwin.sim.config import SIDES, Level, Ramp, Route, Segment, Stairs, TwinConfig
from stridetwin.sim.gait.body_sway import ANGLES, Sway, SwayParameters, plan_sway
from stridetwin.sim.gait.footsteps import SETTLE_S, WEIGHT_SHIFT_S, Rhythm
from stridetwin.sim.gait.style import leg_length
from stridetwin.sim.twin import Twin

ALIKE = SwayParameters(person_log_sd=0.0, rise_log_sd=0.0, person_phase_deg=0.0, unevenness=0.0, step_sd=0.0)
UP_AND_DOWN: tuple[Segment, ...] = (
    Level(length_m=3.0),
    Stairs(risers=5),
    Level(length_m=2.5),
    Ramp(angle_rad=0.12, rise_m=0.3, down=True),
    Level(length_m=3.0),
)
DT = 0.005


@cache
def walk(seed: int = 3) -> Twin:
    return Twin(TwinConfig(name="sway", route=Route(segments=UP_AND_DOWN), sensors=()), seed)


def sway_of(twin: Twin, seed: int, parameters: SwayParameters | None = None) -> tuple[Sway, Rhythm]:
    rhythm = Rhythm.of(twin.reference.steps)
    return plan_sway(rhythm, leg_length(twin.size), np.random.default_rng(seed), parameters), rhythm


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 10_000))
def test_angles_are_continuous_to_the_second_derivative_across_level_stair_and_ramp(seed: int) -> None:
    """On a finer grid, a second derivative that is continuous changes less from row to row; a jump stays."""
    sway, rhythm = sway_of(walk(), seed)
    largest = []
    for dt in (DT, DT / 2):
        angles = sway.angles(rhythm, np.arange(-0.5, walk().duration_s + 0.5, dt))
        largest.append(np.array([np.abs(np.diff(angles[name], n=3)).max() / dt**2 for name in ANGLES]))
    assert np.all(largest[1] < 0.65 * largest[0])


def test_nothing_sways_while_the_walker_stands() -> None:
    sway, rhythm = sway_of(walk(), 1)
    t = np.arange(-0.5, walk().duration_s + 0.5, DT)
    standing = (t < rhythm.begin[0] - WEIGHT_SHIFT_S / 2) | (t > rhythm.end[-1] + SETTLE_S / 2)
    assert standing.sum() > 50
    for name, angle in sway.angles(rhythm, t).items():
        assert np.abs(angle[standing]).max() == 0.0, name
        assert np.abs(angle[~standing]).max() > np.radians(0.5), name


def test_a_walker_without_differences_repeats_every_stride_with_left_and_right_mirrored() -> None:
    route = Route(segments=(Level(length_m=12.0),))
    twin = Twin(TwinConfig(name="even", route=route, sensors=()), 3)
    sway, _ = sway_of(twin, 0, ALIKE)
    middle = sway.harmonics[4:-4]
    assert np.all(sway.rise == 1.0)
    # steps differ by their speeds alone
    assert np.abs(middle - middle.mean(0)).max() < np.radians(0.5)
    for i, name in enumerate(ANGLES):  # yaw and roll change sides from step to step: odd harmonics; pitch does not
        missing = (0, 2) if name.endswith("pitch") else (1,)
        assert np.abs(middle[:, i][:, missing]).max() == 0.0, name


def test_people_and_steps_differ_by_their_own_stream_alone() -> None:
    first, rhythm = sway_of(walk(), 1)
    again, _ = sway_of(walk(), 1)
    other, _ = sway_of(walk(), 2)
    np.testing.assert_array_equal(first.harmonics, again.harmonics)
    assert np.abs(first.harmonics - other.harmonics).max() > np.radians(0.3)
    assert np.ptp(first.rise) > 0.0
    # the mean of many walkers is the mean walker
    many = np.mean([sway_of(walk(), seed)[0].harmonics for seed in range(300)], axis=0)
    mean = sway_of(walk(), 0, ALIKE)[0].harmonics
    assert np.abs(many - mean).max() < np.radians(0.6)
    assert len(first.rise) == len(rhythm.steps)


def test_a_walk_keeps_its_footsteps_whatever_the_body_does(monkeypatch: pytest.MonkeyPatch) -> None:
    before = walk().reference.steps
    config = TwinConfig(name="sway", route=Route(segments=UP_AND_DOWN), sensors=())

    def still(*args: object) -> Sway:
        sway = plan_sway(*args)  # type: ignore[arg-type]
        return replace(sway, harmonics=0.0 * sway.harmonics)

    monkeypatch.setattr("stridetwin.sim.gait.reference.plan_sway", still)
    after = Twin(config, 3).reference.steps
    for side in SIDES:
        for a, b in zip(before[side], after[side]):
            np.testing.assert_array_equal(a.p_foot_in_world, b.p_foot_in_world)
            assert (a.t_touch, a.t_off, a.swing) == (b.t_touch, b.t_off, b.swing)


@pytest.mark.parametrize("case", list(people_body.ASKED))
def test_ten_people_move_within_the_ranges_of_people(case: str) -> None:
    ground, speed = case.split()
    rows = [
        people_body.figures(people_body.walk(ground, float(speed), person, 1000 + i), ground)
        for i, person in enumerate(people_body.PEOPLE)
    ]
    for key, (low, high) in people_body.ASKED[case].items():
        assert low <= np.median([row[key] for row in rows]) <= high, key
