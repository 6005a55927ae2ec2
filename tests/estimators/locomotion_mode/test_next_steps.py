"""The parts of the prediction, each by itself."""

import math
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stridetwin.estimators.locomotion_mode import MODES, LocomotionMode
from stridetwin.estimators.locomotion_mode.foothold import GRID_M, FootholdEstimator, PathAhead, position
from stridetwin.estimators.locomotion_mode.parameters import Settings
from stridetwin.estimators.locomotion_mode.published import Division, WalkingInformation
from stridetwin.estimators.locomotion_mode.rhythm import SIDE, StepFilter, StepLanding, StepRhythm, TouchDowns
from stridetwin.estimators.locomotion_mode.rollout import _even_steps, moments, roll_out
from stridetwin.estimators.locomotion_mode.segments import (
    BEHIND_M,
    CLEARANCE_SD_M,
    Segment,
    foothold_weights,
    mix_unseen,
    mode_table,
    segments_along,
    unseen_probability,
)
from stridetwin.estimators.terrain_map import (
    Change,
    Plane,
    Profile,
    Ramp,
    TerrainEstimate,
    TerrainMap,
    TerrainMapParameters,
)
from stridetwin.streams.samples import Insole
from tests.estimators.terrain_map.scenes import RIG

P = Settings()
S = GRID_M * (np.arange(160) + 0.5)
RATIOS = {"RA": (0.8, 0.1), "RD": (0.8, 0.1)}


def ground(*bounds, slopes=None):
    """Pieces between (place, drop); slopes of each in degrees."""
    places = [(-math.inf, 0.0), *bounds, (math.inf, 0.0)]
    slopes = slopes or [0.0] * (len(bounds) + 1)
    return [
        Segment(
            start=a[0],
            start_sd=0.005,
            end=b[0],
            end_sd=0.005,
            drop=a[1],
            drop_sd=0.0,
            slope=math.radians(slope),
            slope_sd=0.01,
            mapped_slope=math.radians(slope),
            mode="LG" if abs(slope) < 2.5 else "RA" if slope > 0 else "RD",
        )
        for a, b, slope in zip(places[:-1], places[1:], slopes)
    ]


def foot_at(s):
    density = np.exp(-0.5 * ((S - s) / 0.03) ** 2)
    return density / density.sum()


def chain(segments, at, steps=4, length=0.6):
    return roll_out(np.stack([foot_at(at), np.zeros(len(S))]), S, segments, [length] * steps, 0.03, RATIOS, P)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.3, 0.9), st.floats(-0.1, 0.1), st.integers(0, 2**31))
def test_the_filter_finds_steady_steps_of_both_feet(mean, share, seed):
    rng = np.random.default_rng(seed)
    steps = StepFilter(0.6, 0.15, 0.1, 0.01, 0.02)
    difference = share * mean
    for k in range(60):
        side = SIDE["lr"[k % 2]]
        steps.update(side, mean + difference * side + rng.normal(0.0, 0.02))
    assert abs(steps.mean() - mean) < 0.05
    assert abs(steps.mean(SIDE["l"]) - steps.mean(SIDE["r"]) - 2 * difference) < 0.08
    assert 0.0 < steps.sd() < 0.15


def test_landings_are_counted_from_the_last_one():
    rhythm = StepRhythm(P)
    for k, foot in enumerate("lrlrlr"):
        rhythm.land(foot, k * 600_000_000, True)
    last_ns = 5 * 600_000_000
    for since_ns in (0, 200_000_000, 400_000_000):  # the prediction does not move while the foot swings
        (first, _), (second, _) = rhythm.times(("l", "r"), last_ns + since_ns)
        assert first == pytest.approx(last_ns + 6e8, abs=3e7)
        assert second == pytest.approx(last_ns + 12e8, abs=6e7)


def test_even_steps_are_longer_by_their_shift():
    level = 0.02 * np.arange(80)
    found = _even_steps(level, np.full(80, 0.05), 0.6, np.array([-0.1, 0.0, 0.1]), 60)
    np.testing.assert_allclose([level[int(found[h, 0].argmax())] for h in range(3)], [0.5, 0.6, 0.7], atol=0.011)


def test_a_step_into_a_pause_says_little():
    steady = StepFilter(0.6, 0.09, 0.02, 0.02, 0.03)
    for _ in range(10):
        steady.update(SIDE["l"], 0.6)
    steady.update(SIDE["r"], 0.2)
    assert steady.mean() > 0.5


@settings(max_examples=30, deadline=None)
@given(st.floats(1.0, 2.0), st.floats(0.1, 0.9), st.sampled_from([0.15, -0.15]))
def test_densities_and_probabilities_sum_to_one(edge, at, drop):
    predicted = chain(ground((edge, drop), (edge + 0.3, drop)), at)
    assert np.allclose(predicted.density.sum(axis=1), 1.0)
    assert np.allclose(predicted.modes.sum(axis=1), 1.0)
    assert np.allclose(predicted.on.sum(axis=1), 1.0)
    assert (predicted.density >= 0).all()
    means = [moments(d, S)[0] for d in predicted.density]
    assert all(a < b for a, b in pairwise(means))


def test_on_even_ground_steps_are_as_long_as_they_were():
    predicted = chain(ground(), 0.5)
    for k, density in enumerate(predicted.density, 1):
        assert abs(moments(density, S)[0] - 0.5 - 0.6 * k) < 0.02
        assert predicted.modes[k - 1][MODES.index("LG")] > 0.999


def test_stairs_take_a_foot_a_tread_and_no_toe_is_in_a_riser():
    edges = [1.0 + 0.3 * k for k in range(4)]
    predicted = chain(ground(*((e, 0.15) for e in edges)), 0.72)
    for k, edge in enumerate(edges[:3]):
        s, sd = moments(predicted.density[k], S)
        assert edge < s + 0.5 * (P.mode.toe_m - P.mode.heel_m) < edge + 0.3
        assert s + P.mode.toe_m < edge + 0.3 + 2 * CLEARANCE_SD_M
        assert sd < 0.09
        assert predicted.modes[k][MODES.index("SA")] > 0.95


@pytest.mark.parametrize(("slope", "mode"), [(12.0, "RA"), (-12.0, "RD")])
def test_a_ramp_counts_from_the_first_foot_on_it_and_ends_with_the_first_beyond(slope, mode):
    predicted = chain(ground((0.9, 0.0), (1.8, 0.0), slopes=[0.0, slope, 0.0]), 0.3)
    most = [MODES[int(m.argmax())] for m in predicted.modes]
    assert mode in most
    assert most[-1] == "LG"
    table = mode_table(ground((0.9, 0.0), (1.8, 0.0), slopes=[0.0, slope, 0.0]), P)
    assert MODES[int(table[0, 1].argmax())] == mode
    assert MODES[int(table[1, 2].argmax())] == "LG"


def test_a_kerb_is_level_and_a_low_stair_is_none():
    for drop, mode in ((0.04, "LG"), (-0.04, "LG"), (0.07, "SA"), (-0.07, "SD")):
        assert MODES[int(mode_table(ground((1.0, drop)), P)[0, 1].argmax())] == mode


def test_the_lowest_riser_of_stairs_is_that_of_the_map():
    terrain_map = TerrainMap(RIG, parameters=TerrainMapParameters(min_riser_m=0.12))
    high_stairs = LocomotionMode(RIG, ground=terrain_map)._settings
    for p, mode in ((P, "SA"), (high_stairs, "LG")):
        assert MODES[int(mode_table(ground((1.0, 0.10)), p)[0, 1].argmax())] == mode


def way(*edges, seen=lambda s: s == s):
    """Edges of a way, (place, drop, deviation), and where it was seen."""
    s = 0.02 * np.arange(240)
    changes = tuple(Change(kind="edge", s=at, sd=sd, drop=drop, bend=0.0) for at, drop, sd in edges)
    return Profile(s=s, height=np.zeros(len(s)), plane=np.where(seen(s), 0, -1), changes=changes)


@pytest.mark.parametrize(
    ("edges", "left"),
    [
        ([(1.5, 0.16, 0.01), (1.8, 0.16, 0.01)], [1.5, 1.8]),
        ([(1.5, -0.16, 0.01), (1.8, -0.16, 0.01)], [1.5, 1.8]),
        ([(2.0, -2.4, 0.02), (2.3, 2.4, 0.02)], []),  # the mirror of a ceiling
        ([(1.5, 0.10, 0.01), (1.6, -0.10, 0.01), (2.5, 0.16, 0.01)], [2.5]),  # a shoe on the way to stairs
        ([(1.5, 0.15, 0.01), (2.2, -0.15, 0.01)], [1.5, 2.2]),  # a platform is walked over
        ([(2.0, 0.72, 0.30), (2.7, -0.72, 0.02)], []),  # a table
        ([(1.5, 0.16, 0.01), (2.5, 2.0, 0.10)], [1.5]),  # a wall on a landing
        ([(0.9, 2.4, 0.02), (1.6, 0.16, 0.01)], [1.6]),  # what lies behind the walker
        ([(2.9, -2.4, 0.02)], []),  # a drop-off without room for treads
    ],
)
def test_what_one_steps_over_and_what_nobody_climbs_is_no_edge(edges, left):
    made = segments_along(way(*edges), None, np.array([1.0, 0.0]), P)
    assert [m.start for m in made[1:]] == pytest.approx(left, abs=0.005)


def sloping(degrees, *, end):
    """Ground that the map takes for a ramp, from 1.5 m along the way on, between edges, with a knee at 1.6 m."""
    slope, far = math.radians(degrees), way((1.5, 0.16, 0.01), (end, 0.16, 0.01))
    knee = Change(kind="knee", s=1.6, sd=0.02, drop=0.0, bend=slope)
    inside = (far.s > 1.5) & (far.s < end)
    profile = Profile(s=far.s, height=far.height, plane=np.where(inside, 7, -1), changes=(*far.changes, knee))
    plane = Plane(
        id=7,
        centre=np.zeros(3),
        normal=np.array([-math.sin(slope), 0.0, math.cos(slope)]),
        area_m2=0.5,
        spread=0.01 * np.eye(2),
        votes=30.0,
        covariance=1e-6 * np.eye(3),
    )
    ramp = Ramp(id=7, plane=7, slope=abs(slope), slope_sd=0.001, heading=0.0)
    estimate = TerrainEstimate(t_ns=0, planes={7: plane}, terrains=(ramp,), p_camera_in_world=np.zeros(3))
    return segments_along(profile, estimate, np.array([1.0, 0.0]), P)


@pytest.mark.parametrize("degrees", [-16.0, -6.5, 6.5])
def test_a_tread_is_level_however_the_poses_have_bent_it(degrees):
    made = sloping(degrees, end=1.8)
    assert [m.start for m in made[1:]] == pytest.approx([1.5, 1.8])
    assert (made[1].slope, made[1].mode) == (0.0, "LG")
    assert MODES[int(mode_table(made, P)[0, 1].argmax())] == "SA"


def test_a_ramp_between_two_edges_is_none_the_less_a_ramp():
    made = sloping(6.5, end=3.5)
    assert [m.start for m in made[1:]] == pytest.approx([1.5, 1.6, 3.5])
    assert made[2].mode == "RA"
    # Nothing long and level pins the lean of the map here, which takes its share of the slope.
    assert math.degrees(made[2].slope) == pytest.approx(6.5, abs=0.2)


def continued(degrees, *, drop=-0.16, end=2.6):
    """The segments of a way with two edges 0.3 m apart, and a slope from the second one to a knee."""
    slope, far = math.radians(degrees), way((1.5, drop, 0.01), (1.8, drop, 0.01))
    knee = Change(kind="knee", s=end, sd=0.02, drop=0.0, bend=-slope)
    inside = (far.s > 1.8) & (far.s < end)
    profile = Profile(s=far.s, height=far.height, plane=np.where(inside, 7, 0), changes=(*far.changes, knee))
    planes = {
        id_: Plane(
            id=id_,
            centre=np.zeros(3),
            normal=np.array([-math.sin(angle), 0.0, math.cos(angle)]),
            area_m2=0.5,
            spread=0.01 * np.eye(2),
            votes=30.0,
            covariance=1e-6 * np.eye(3),
        )
        for id_, angle in ((0, 0.0), (7, slope))
    }
    estimate = TerrainEstimate(t_ns=0, planes=planes, terrains=(), p_camera_in_world=np.zeros(3))
    return segments_along(profile, estimate, np.array([1.0, 0.0]), P)


@pytest.mark.parametrize(("degrees", "drop"), [(-20.0, -0.16), (-28.0, -0.16), (20.0, 0.16)])
def test_a_slope_of_the_pitch_of_the_flight_before_it_is_more_of_that_flight(degrees, drop):
    made = continued(degrees, drop=drop)
    fall = math.tan(math.radians(degrees)) * 0.8
    assert [m.mode for m in made] == ["LG"] * len(made)
    assert [m.drop for m in made[3:]] == pytest.approx([fall / 3] * 3, abs=1e-3)
    assert made[-1].start == pytest.approx(2.6, abs=0.02)
    table = mode_table(made, P)
    assert MODES[int(table[3, 4].argmax())] == ("SD" if drop < 0 else "SA")


@pytest.mark.parametrize(("degrees", "drop"), [(-6.0, -0.16), (-10.0, -0.16), (20.0, -0.16), (-17.8, -0.04)])
def test_gentler_slopes_and_those_the_other_way_are_ramps(degrees, drop):
    made = continued(degrees, drop=drop)
    assert "RD" in [m.mode for m in made] or "RA" in [m.mode for m in made]


def test_hidden_stairs_down_are_no_brink():
    """Four risers down, the treads hidden on 0.9 m: usual treads fill the gap."""
    made = segments_along(way((2.0, -0.72, 0.9 / 4)), None, np.array([1.0, 0.0]), P)
    assert len(made) == 5
    assert all(m.drop == pytest.approx(-0.18) for m in made[1:])


def test_what_is_seen_afar_says_nothing_of_the_ground_under_the_feet():
    here = BEHIND_M
    assert len(segments_along(way(seen=lambda s: s > here + 0.3), None, np.array([1.0, 0.0]), P)) == 1
    feet, afar = segments_along(way(seen=lambda s: s > here + 0.8), None, np.array([1.0, 0.0]), P)
    assert feet.end == afar.start == pytest.approx(here + 0.8, abs=0.03)
    assert (feet.slope, feet.mode, afar.drop) == (0.0, "LG", 0.0)


def test_hidden_stairs_are_like_those_seen_last():
    usual = SimpleNamespace(riser=0.15, tread=0.28)
    made = segments_along(way((2.0, -0.75, 1.4 / 4)), None, np.array([1.0, 0.0]), P, usual)
    assert [m.drop for m in made[1:]] == pytest.approx([-0.15] * 5)
    assert np.diff([m.start for m in made[1:]]) == pytest.approx(0.28)
    assert made[1].drop_sd < 0.01


def test_hidden_stairs_that_cannot_be_like_those_are_as_anywhere():
    usual = SimpleNamespace(riser=0.25, tread=0.28)
    made = segments_along(way((2.0, -0.72, 0.9 / 4)), None, np.array([1.0, 0.0]), P, usual)
    assert [m.drop for m in made[1:]] == pytest.approx([-0.18] * 4)
    assert made[1].drop_sd > 0.05


def test_the_drop_off_behind_a_walker_still_gives_the_place_of_the_hidden_treads():
    usual = SimpleNamespace(riser=0.15, tread=0.28)
    made = segments_along(way((-1.0, -0.75, 1.4 / 4)), None, np.array([1.0, 0.0]), P, usual)
    assert [m.start for m in made] == pytest.approx([-1.0 + 0.28 * k for k in (3, 4)], abs=0.05)
    assert made[1].drop == pytest.approx(-0.15)


def test_the_top_of_the_body_identifies_the_tread_under_the_foot():
    """Treads of 0.28 m and 0.15 m down; a body that rises 1.5 m over feet on the level."""
    foothold, line = FootholdEstimator(P), PathAhead(np.zeros(2), np.array([1.0, 0.0]))
    height = -0.15 * np.clip(np.ceil((foothold.s - 2.0) / 0.28), 0.0, 4.0)
    wide = np.exp(-0.5 * ((foothold.s - 2.3) / 0.2) ** 2)
    wide /= wide.sum()
    assert foothold.after_passing(wide, height, 1.5) is wide  # the height of the walker is not known yet
    level = np.zeros(len(foothold.s))
    for k in range(8):
        landing = StepLanding(feet=("lr"[k % 2],), measurable=True)
        foothold.land(landing, PathAhead(np.array([0.6 * k, 0.0]), line.forward), ground(), level, 1.45, 1.5, 0.0, 0.6)
    for tread in (1, 2, 3):
        density = foothold.after_passing(wide, height, 1.52 - 0.15 * tread)
        assert density[np.isclose(height, -0.15 * tread)].sum() > 0.9
    assert foothold.after_passing(wide, None, 1.5) is wide


@pytest.mark.parametrize("degrees", [5.0, 15.0, 60.0, 90.0, 150.0])
def test_a_foot_stays_where_it_is_when_the_walker_turns(degrees):
    foothold, east = FootholdEstimator(P), np.array([1.0, 0.0])
    for k in range(4):
        landing = StepLanding(feet=("lr"[k % 2],), measurable=True)
        line = PathAhead(np.array([0.6 * k - BEHIND_M, 0.0]), east)
        foothold.land(landing, line, ground(), None, 1.3, 1.5, math.nan, 0.6)
    ahead, _ = moments(position(foothold.stance_density(line)), foothold.s)
    foot = line.origin + ahead * east
    body, turned = line.origin + BEHIND_M * east, math.radians(degrees)
    to = np.array([math.cos(turned), math.sin(turned)])
    s, sd = moments(position(foothold.stance_density(PathAhead(body - BEHIND_M * to, to))), foothold.s)
    assert s - BEHIND_M == pytest.approx((foot - body) @ to, abs=0.03)
    assert sd < 0.15


def test_ground_that_was_not_seen_may_be_any():
    profile = way(seen=lambda s: ((s > 1.0) & (s < 2.0)) | (s > 2.6))
    chance = unseen_probability(profile, np.array([1.5, 2.3, 2.3, 4.0, 5.8]), 0.8, P)
    assert chance[0] < 1e-3
    assert chance[1] == pytest.approx((1.0 - math.exp(-0.3 / P.mode.change_m)) ** 2, rel=0.15)
    assert chance[3] < 1e-3 < chance[4] == pytest.approx(1.0 - math.exp(-1.02 / P.mode.change_m), rel=0.05)
    blind = unseen_probability(way(seen=lambda s: s < 0.0), np.array([1.2, 1.8, 2.4]), 1.2, P)
    assert blind == pytest.approx([0.0, 1.0 - math.exp(-0.6 / P.mode.change_m), 1.0 - math.exp(-1.2 / P.mode.change_m)])
    predicted = mix_unseen(np.array([[1.0, 0.0, 0.0, 0.0, 0.0]] * 3), blind)
    assert predicted.sum(axis=1) == pytest.approx(1.0)
    assert predicted[1, 0] < 0.85


def test_soles_reach_over_free_edges_and_not_into_risers():
    up, down = foothold_weights(ground((1.0, 0.2)), S, P)[0], foothold_weights(ground((1.0, -0.2)), S, P)[0]
    toes = S + P.mode.toe_m
    assert up[toes > 1.06].max() < 0.05
    assert down[(toes > 1.0) & (toes < 1.03)].min() > 0.8
    assert down[toes > 1.13].max() < 0.05


def test_equations_16_to_18():
    walking = WalkingInformation(P)
    for k, (x, foot) in enumerate([(0.0, "l"), (0.5, "r"), (1.1, "l")]):
        walking.add(Division(foot=foot, t_ns=k * 600_000_000, p=np.array([x, 0.0, 1.7]), v=np.array([2.0, 0.0, 0.3])))
    assert walking.sizes() == pytest.approx([0.5, 0.6])
    assert walking.next_size() == pytest.approx(2 * 0.6 - 0.5)
    place, forward = walking.footprint()
    assert forward == pytest.approx([1.0, 0.0])
    assert place == pytest.approx([1.1 + 0.7 + 0.35, -P.mode.width_m / 2])
    assert walking.step_time() == pytest.approx(0.6)


def test_touch_downs_of_drifting_and_dead_insoles():
    touch, predicted = TouchDowns(P), []
    for i in range(1000):
        t = 0.01 * i
        swing = (t % 1.2) < 0.4
        load = (6.0 + 0.5 * t) + (0.0 if swing else 400.0)
        foot = touch.update(Insole(topic="/foot_l/insole", t_ns=round(t * 1e9), force=np.full(4, load / 4)))
        assert touch.update(Insole(topic="/foot_r/insole", t_ns=round(t * 1e9), force=np.zeros(4))) is None
        if foot:
            predicted.append((foot, round(t, 2)))
    assert [f for f, _ in predicted] == ["l"] * len(predicted)
    assert [t for _, t in predicted[1:]] == pytest.approx([0.4 + 1.2 * k for k in range(1, len(predicted))], abs=0.02)


def test_the_first_step_is_detected_although_the_reading_of_the_unloaded_insole_is_unknown():
    touch, predicted = TouchDowns(P), []
    for i in range(300):
        t = 0.01 * i
        load = 38.0 + (0.0 if 1.0 < t < 1.5 else 350.0 + 60.0 * math.sin(9.0 * t))
        if touch.update(Insole(topic="/foot_l/insole", t_ns=round(t * 1e9), force=np.full(4, load / 4))):
            predicted.append(t)
    assert predicted == [pytest.approx(1.5, abs=0.02)]
