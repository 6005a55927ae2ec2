"""Habits on stairs: their probabilities, the chain of footprints of each, and scripted walks."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stridetwin.estimators.locomotion_mode import MODES, LocomotionMode, foothold, habits
from stridetwin.estimators.locomotion_mode.habits import HABITS, Habit, Habits
from stridetwin.estimators.locomotion_mode.parameters import Settings
from stridetwin.estimators.locomotion_mode.rollout import Likelihoods, mix_chains, moments, roll_out
from stridetwin.estimators.locomotion_mode.segments import foothold_heights, surface_along
from stridetwin.estimators.terrain_map import Profile
from tests.estimators.locomotion_mode.test_next_steps import RATIOS, S, foot_at, ground
from tests.estimators.locomotion_mode.walker import footprints, samples
from tests.estimators.terrain_map.scenes import RIG

P = Settings()
LG, SA, SD = (MODES.index(mode) for mode in ("LG", "SA", "SD"))
TREAD_M = 0.30
EDGES = [1.0 + TREAD_M * k for k in range(5)]
shares = st.lists(st.floats(0.0, 1.0), min_size=2 * HABITS, max_size=2 * HABITS).filter(lambda x: sum(x) > 0.1)


def joint_of(values):
    """A joint density with these shares of kind and crossing."""
    made = np.array(values).reshape(HABITS, 2, 1) * foot_at(1.0)
    return made / made.sum()


def normal(off, sd):
    return np.exp(-0.5 * (off / sd) ** 2) / sd


def flight(drop, at, *, crossed, joins, landing=None, steps=4):
    """The steps from a foot within a flight."""
    stance = np.stack([np.zeros(len(S)), foot_at(at)] if crossed else [foot_at(at), np.zeros(len(S))])
    segments = ground(*((edge, drop) for edge in EDGES))
    return roll_out(stance, S, segments, [0.5] * steps, 0.03, RATIOS, P, Habit(joins=(joins, joins)), landing)


@given(shares)
def test_a_change_of_kind_changes_neither_place_nor_crossing(values):
    joint = joint_of(values)
    after = Habits(P).after_habit_change(joint)
    np.testing.assert_allclose(after.sum(axis=0), joint.sum(axis=0), atol=1e-12)


@given(shares, st.integers(1, 80))
def test_level_ground_makes_every_habit_forget_towards_the_shares_of_walkers(values, steps):
    walkers, joint = Habits(P), joint_of(values)
    joint[:, 0] += joint[:, 1]
    joint[:, 1] = 0.0
    off = np.abs(joint.sum(axis=(1, 2)) - walkers.prior)
    for _ in range(steps):
        joint = walkers.after_habit_change(joint)
    left = (1.0 - habits._HABIT_CHANGE) ** steps
    np.testing.assert_allclose(np.abs(joint.sum(axis=(1, 2)) - walkers.prior), left * off, atol=1e-12)


@given(shares)
def test_the_probability_of_joining_lies_between_those_of_the_habits(values):
    for _, habit in Habits(P).group_by_steps(joint_of(values), ground((1.0, 0.17))):
        for chance in habit.joins:
            assert habits._OTHER_JOINS - 1e-12 <= chance <= habits._JOINER_JOINS + 1e-12


@given(shares, st.floats(0.2, 0.7), st.sampled_from([0.17, -0.17]))
def test_groups_of_habits_hold_all_walkers_but_the_improbable(values, tread, drop):
    joint = 0.9 * joint_of(values) + 0.1 * joint_of(np.ones(2 * HABITS))
    segments = ground(*((1.0 + tread * k, drop) for k in range(4)))
    groups = Habits(P).group_by_steps(joint, segments)
    has_either = any(habits._TWO_PACES_M < length <= habits._ONE_PACE_M for length in habits._tread_lengths(segments))
    assert len(groups) <= 1 + has_either + (drop > 0.0)
    assert sum(part.sum() for part, _ in groups) == pytest.approx(1.0, abs=2 * habits._MIN_SHARE)


def test_a_habit_never_becomes_certain():
    walkers = Habits(P)
    for habit in range(HABITS):
        changed = walkers.after_habit_change(joint_of(np.eye(2 * HABITS)[2 * habit + 1]))
        assert changed[habit].sum() == pytest.approx(1.0 - habits._HABIT_CHANGE * (1.0 - walkers.prior[habit]))


@settings(max_examples=20, deadline=None)
@given(st.floats(0.0, 1.0), st.sampled_from([0.17, -0.17]), st.booleans())
def test_densities_sum_to_one_and_only_a_foot_that_crossed_is_joined(joins, drop, crossed):
    predicted = flight(drop, EDGES[0] + 0.05, crossed=crossed, joins=joins)
    for found in (predicted.density, predicted.modes, predicted.on):
        np.testing.assert_allclose(found.sum(axis=1), 1.0)
    assert predicted.last.sum() == pytest.approx(1.0)
    assert ((predicted.joined >= 0.0) & (predicted.joined <= 1.0 + 1e-9)).all()
    assert crossed or predicted.joined[0] == 0.0


@pytest.mark.parametrize(("drop", "mode"), [(0.17, SA), (-0.17, SD)])
def test_who_joins_takes_a_tread_every_other_step(drop, mode):
    predicted = flight(drop, EDGES[0] + 0.05, crossed=True, joins=0.97)
    assert predicted.modes.argmax(axis=1).tolist() == [LG, mode, LG, mode]
    places = [moments(density, S)[0] for density in predicted.density]
    assert places[0] == pytest.approx(EDGES[0] + 0.05, abs=0.05)
    assert places[3] - places[1] == pytest.approx(TREAD_M, abs=0.06)
    assert flight(drop, EDGES[0] + 0.05, crossed=True, joins=0.0).modes.argmax(axis=1).tolist() == [mode] * 4


@pytest.mark.parametrize("tread", [0.26, 0.30, 0.35])
def test_a_single_step_joins_as_often_as_expected_on_any_tread(tread):
    """How rarely an ordinary step finds a foothold does not matter."""
    segments = ground(*((1.0 + tread * k, 0.17) for k in range(5)))
    stance = np.stack([np.zeros(len(S)), foot_at(1.05)])
    for joins in (0.1, 0.5, 0.9):
        predicted = roll_out(stance, S, segments, [0.5], 0.03, RATIOS, P, Habit(joins=(joins, joins)))
        assert predicted.joined[0] == pytest.approx(joins, abs=0.02)


def test_who_takes_two_treads_at_a_time_takes_one_at_the_end_and_on_the_way_down():
    segments = ground(*((edge, 0.17) for edge in EDGES))
    stance = np.stack([foot_at(EDGES[0] - 0.35), np.zeros(len(S))])
    up = roll_out(stance, S, segments, [0.6] * 3, 0.03, RATIOS, P, Habit(treads=2))
    assert up.modes.argmax(axis=1).tolist() == [SA] * 3
    assert up.on.argmax(axis=1).tolist() == [2, 4, 5]
    assert up.on.max(axis=1).min() > 0.8
    down = ground(*((edge, -0.17) for edge in EDGES))
    usual, two = (roll_out(stance, S, down, [0.6] * 3, 0.03, RATIOS, P, Habit(treads=n)) for n in (1, 2))
    np.testing.assert_allclose(two.density, usual.density, atol=1e-12)


def test_one_pace_on_deep_treads_is_a_habit_not_a_matter_of_length():
    segments = ground(*((1.0 + 0.58 * k, 0.12) for k in range(4)))
    stance = np.stack([np.zeros(len(S)), foot_at(1.1)])
    usual, one = (roll_out(stance, S, segments, [0.36], 0.03, RATIOS, P, Habit(one_per_tread=o)) for o in (False, True))
    assert usual.modes[0, LG] > 0.5
    assert one.modes[0, SA] > 0.9


@pytest.mark.parametrize("habit", [Habit(one_per_tread=True), Habit(treads=2)])
def test_a_step_that_all_habits_take_is_no_evidence(habit):
    """On level ground the sum over all chains is the same for every habit."""
    stance = np.stack([foot_at(1.0), np.zeros(len(S))])
    segments = ground((3.2, 0.17), (3.5, 0.17))
    usual, other = (roll_out(stance, S, segments, [0.5], 0.03, RATIOS, P, h) for h in (Habit(), habit))
    assert other.evidence == pytest.approx(usual.evidence)


def test_a_habit_without_any_walker_gives_no_evidence_and_no_prediction():
    segments = ground(*((edge, 0.17) for edge in EDGES))
    nobody, somebody = (
        roll_out(share * np.stack([foot_at(1.1), np.zeros(len(S))]), S, segments, [0.5] * 2, 0.03, RATIOS, P)
        for share in (0.0, 1.0)
    )
    assert nobody.evidence == 0.0
    np.testing.assert_allclose(mix_chains([nobody, somebody], np.array([0.0, 1.0])).density, somebody.density)


@pytest.mark.parametrize(("tread", "favoured"), [(1, Habit()), (2, Habit(treads=2))])
def test_where_a_foot_lands_is_evidence_for_a_habit(tread, favoured):
    segments = ground(*((edge, 0.17) for edge in EDGES))
    stance = np.stack([np.zeros(len(S)), foot_at(EDGES[0] + 0.05)])
    at = normal(S - EDGES[tread] - 0.05, 0.06)
    likelihoods = Likelihoods(even=at, over=at, beside=at)
    found = {
        habit: roll_out(stance, S, segments, [0.5], 0.03, RATIOS, P, habit, likelihoods).evidence
        for habit in (Habit(), Habit(treads=2))
    }
    assert found.pop(favoured) > 8.0 * next(iter(found.values()))


def test_the_body_shows_whether_the_foot_joined():
    """The body is ahead of feet side by side, and behind a foot that crossed an edge.

    With even chances before, the right kind of step becomes more than twice as probable as the other.
    """
    found = {}
    for place in (1.05, 1.35):
        body = 1.05 + foothold._JOINED_AHEAD_M if place < 1.2 else 1.35 - foothold._EDGE_AHEAD_M
        likelihoods = Likelihoods(
            even=np.full(len(S), 1e-9),
            over=normal(S - body - foothold._EDGE_AHEAD_M, foothold._EDGE_AHEAD_SD_M),
            beside=normal(S - body + foothold._JOINED_AHEAD_M, foothold._JOINED_AHEAD_SD_M),
        )
        predicted = flight(0.17, 1.05, crossed=True, joins=0.5, landing=likelihoods, steps=1)
        found[place] = predicted.joined[0], moments(predicted.last.sum(axis=0), S)[0]
    assert found[1.05][0] > 2 / 3
    assert found[1.35][0] < 1 / 3
    assert found[1.05][1] < 1.15 < 1.25 < found[1.35][1]


def test_a_heel_that_overhangs_an_edge_is_as_high_as_its_sole():
    segments = ground((1.0, 0.17), (1.3, 0.17))
    s = np.linspace(0.2, 2.0, 181)
    height, *_ = surface_along(segments, s)
    profile = Profile(s=s, height=height, plane=np.zeros(len(s), np.int64), changes=())
    found = foothold_heights(segments, profile, s, P)
    np.testing.assert_allclose(np.interp([0.85, 0.95, 1.25], s, found), [0.0, 0.17, 0.34], atol=1e-9)
    slope = ground((0.0, 0.0), slopes=[8.0, 8.0])
    height, *_ = surface_along(slope, s)
    np.testing.assert_allclose(foothold_heights(slope, replace(profile, height=height), s, P), height, atol=1e-9)


def habit_evidence(crossed_before, crossed_now, straight):
    """Probabilities of the habits after a step that only someone who joins the feet takes."""
    walker = foothold.FootholdEstimator(P)
    stance = walker._habits.joint(foot_at(1.0), walker._habits.prior)
    stance = np.stack([(1.0 - crossed_before) * stance[:, 0], crossed_before * stance[:, 0]], axis=1)
    part = flight(0.17, 1.05, crossed=True, joins=0.5, steps=1)
    last = np.stack([(1.0 - crossed_now) * foot_at(1.0), crossed_now * foot_at(1.0)])
    chains = [replace(part, last=last, evidence=evidence) for evidence in (1.0, 1e-6, 1e-6, 1e-6)]
    return walker._weigh_habits(stance, chains, straight), walker._habits.prior


@pytest.mark.parametrize(
    ("crossed_before", "crossed_now", "straight"), [(0.0, 0.4, 1.0), (0.5, 0.0, 1.0), (1.0, 1.0, 0.0)]
)
def test_neither_a_turn_nor_a_doubtful_crossing_is_evidence(crossed_before, crossed_now, straight):
    after, before = habit_evidence(crossed_before, crossed_now, straight)
    np.testing.assert_allclose(after, before, atol=1e-12)


@pytest.mark.parametrize(("crossed_before", "crossed_now"), [(1.0, 0.0), (0.0, 1.0), (0.95, 0.95)])
def test_a_sure_crossing_on_a_straight_way_is_full_evidence(crossed_before, crossed_now):
    after, _ = habit_evidence(crossed_before, crossed_now, 1.0)
    assert after[0] > 0.999


@settings(max_examples=30, deadline=None)
@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_less_certain_steps_are_less_evidence(crossed_before, crossed_now, straight):
    after, before = habit_evidence(crossed_before, crossed_now, straight)
    surer, _ = habit_evidence(1.0, crossed_now, straight)
    assert after.sum() == pytest.approx(1.0)
    assert before[0] - 1e-9 <= after[0] <= surer[0] + 1e-9


@pytest.fixture(scope="module")
def stair_walk():
    """True steps and predictions of a scripted walker who puts both feet on each tread."""
    mode = LocomotionMode(RIG)
    return footprints(both=True), [e for e in map(mode.update, samples(both=True)) if e is not None]


def test_from_the_third_tread_on_both_feet_are_expected(stair_walk):
    prints, predicted = stair_walk
    joined = 0
    for (*_, before), (t, _, foot, mode) in pairwise(prints):
        step = next(e for e in reversed(predicted) if e.t_ns < t * 1e9).steps[0]
        assert step.foot == foot
        joined += before == "SA" and mode == "LG"
        if joined > 2 or mode == "SA" or joined == 0:
            assert step.mode == mode, t
            assert step.probabilities[mode] > 0.7
    assert joined == 4
