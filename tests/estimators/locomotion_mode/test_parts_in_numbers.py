"""Segments, rhythm and the published prediction, each part against plain arithmetic."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from stridetwin.estimators.locomotion_mode import changes, segments
from stridetwin.estimators.locomotion_mode.foothold import PathAhead
from stridetwin.estimators.locomotion_mode.parameters import Settings
from stridetwin.estimators.locomotion_mode.published import (
    Division,
    WalkingInformation,
    mode_between,
    predict_published_steps,
)
from stridetwin.estimators.locomotion_mode.rhythm import StepFilter, StepRhythm
from stridetwin.estimators.locomotion_mode.segments import Segment
from stridetwin.estimators.terrain_map import Change, Plane, Profile, Ramp
from stridetwin.estimators.terrain_map.estimate import Level, Stairs, TerrainEstimate

P = Settings()


def edge(s, drop, sd=0.01):
    return Change(kind="edge", s=s, sd=sd, drop=drop, bend=0.0)


def bounds(change, usual=None):
    return np.array([tuple(b)[:4] for b in segments._to_bounds(change, usual, P)])


def test_a_step_up_or_a_low_step_down_is_one_edge():
    np.testing.assert_allclose(bounds(edge(1.0, 0.17, sd=0.02)), [[1.0, 0.02, 0.17, 0.0]])
    # of a step down the upper ground appears to end too early, by its standard deviation beyond the smallest
    np.testing.assert_allclose(bounds(edge(1.0, -0.17, sd=0.02)), [[1.0 + 0.02 - 0.008, 0.02, -0.17, 0.0]])
    np.testing.assert_allclose(bounds(edge(1.0, -0.17, sd=0.005)), [[1.0, 0.005, -0.17, 0.0]])
    np.testing.assert_allclose(bounds(edge(1.0, -0.17, sd=0.2)), [[1.0 + 0.04 - 0.008, 0.04, -0.17, 0.0]])


def test_a_high_drop_hides_steps_of_the_usual_size():
    """0.54 m are three risers of 0.18 m; two treads of 0.3 m fit into the 0.8 m that an edge of 0.2 m occludes."""
    k = np.arange(3)
    first = 1.0 + 0.04 - 0.008
    expected = np.column_stack([first + 0.3 * k, 0.04 + 0.15 * 0.3 * k, np.full(3, -0.18), np.full(3, 0.4 * 0.18)])
    np.testing.assert_allclose(bounds(edge(1.0, -0.54, sd=0.2)), expected)
    # 0.5 m occluded: two treads of 0.25 m
    expected[:, 0], expected[:, 1] = first + 0.25 * k, 0.04 + 0.15 * 0.25 * k
    np.testing.assert_allclose(bounds(edge(1.0, -0.54, sd=0.125)), expected)
    # 0.4 m: only one tread of at least 0.22 m, so two risers
    k = np.arange(2)
    expected = np.column_stack([first + 0.3 * k, 0.04 + 0.15 * 0.3 * k, np.full(2, -0.27), np.full(2, 0.4 * 0.27)])
    np.testing.assert_allclose(bounds(edge(1.0, -0.54, sd=0.1)), expected)
    # two risers of the usual size, and the tread between them
    expected[:, 2:] = -0.18, 0.4 * 0.18
    np.testing.assert_allclose(bounds(edge(1.0, -0.36, sd=0.2)), expected)
    # no tread at all is occluded
    np.testing.assert_allclose(bounds(edge(1.0, -0.54, sd=0.05)), [[first, 0.04, -0.54, 0.0]])


def test_hidden_steps_are_like_those_observed_where_their_number_is_whole():
    usual = SimpleNamespace(riser=0.15, tread=0.28)
    assert segments._assume_steps(0.45 + 0.029, usual, P) == (0.15, 0.28, 0.05, 0.05)
    assert segments._assume_steps(0.45 - 0.029, usual, P) == (0.15, 0.28, 0.05, 0.05)
    assert segments._assume_steps(0.45 + 0.031, usual, P) == (0.18, 0.30, 0.40, 0.15)
    assert segments._assume_steps(0.45, None, P) == (0.18, 0.30, 0.40, 0.15)
    found = bounds(edge(1.0, -0.45, sd=0.2), usual)
    np.testing.assert_allclose(found[:, 0] - found[0, 0], [0.0, 0.28, 0.56])
    np.testing.assert_allclose(found[:, 1:], [[0.04 + 0.05 * 0.28 * k, -0.15, 0.05 * 0.15] for k in range(3)])


def segment(start, end, *, drop=0.0, slope=0.0, mapped=None, sd=0.01, edge_sd=0.02, mode="LG"):
    return Segment(
        start=start,
        start_sd=edge_sd,
        end=end,
        end_sd=edge_sd,
        drop=drop,
        drop_sd=0.0,
        slope=slope,
        slope_sd=sd,
        mapped_slope=slope if mapped is None else mapped,
        mode=mode,
    )


GROUND = [
    segment(-math.inf, 1.0, slope=0.02, mapped=0.05),
    segment(1.0, 1.3, drop=0.15, sd=0.02),
    segment(1.3, 2.0, drop=-0.1, slope=0.2, mode="RA"),
    segment(2.0, math.inf, slope=-0.1, sd=0.03, mode="RD"),
]


def height(s):
    """m, over the ground at 0, segment by segment."""
    if s < 1.0:
        return math.tan(0.05) * s
    before = math.tan(0.05) + 0.15
    if s < 1.3:
        return before
    if s < 2.0:
        return before - 0.1 + math.tan(0.2) * (s - 1.3)
    return before - 0.1 + math.tan(0.2) * 0.7 - math.tan(0.1) * (s - 2.0)


def test_the_surface_follows_edges_and_mapped_slopes():
    s = np.array([-0.5, 0.0, 0.99, 1.0, 1.29, 1.3, 1.99, 2.0, 3.0])
    z, slope, sd = segments.surface_along(GROUND, s)
    np.testing.assert_allclose(z, [height(x) for x in s], atol=1e-12)
    np.testing.assert_allclose(slope, [0.02] * 3 + [0.0] * 2 + [0.2] * 2 + [-0.1] * 2)
    np.testing.assert_allclose(sd, [0.01] * 3 + [0.02] * 2 + [0.01] * 2 + [0.03] * 2)
    assert segments.edges_before(GROUND) == [0, 1, 2, 2]


def test_heels_lie_on_the_ground_under_the_middle_of_their_sole():
    half = 0.5 * (0.21 - 0.045)
    assert segments.half_sole(P) == pytest.approx(half)
    known = np.array([0.3, 0.5, 1.1, 1.5])
    profile = Profile(
        s=known, height=np.array([height(s) + 0.7 for s in known[:-1]] + [math.nan]), plane=np.zeros(4, int), changes=()
    )
    s = np.array([0.1, 0.95, 1.25, 1.6, 1.95, 2.5])
    slope = [0.05, 0.0, 0.2, 0.2, -0.1, -0.1]
    expected = [height(x + half) - half * math.tan(a) + 0.7 for x, a in zip(s, slope)]
    np.testing.assert_allclose(segments.foothold_heights(GROUND, profile, s, P), expected, atol=1e-12)
    assert (
        segments.foothold_heights(GROUND, Profile(s=known, height=np.full(4, math.nan), plane=known, changes=()), s, P)
        is None
    )
    assert [segments.segment_under(GROUND, x, P) for x in (0.9, 0.92, 1.21, 1.22, 1.91, 1.92)] == [0, 1, 1, 2, 2, 3]


def test_slopes_under_footprints_are_moments_of_a_mixture():
    on = np.array([[0.0, 0.0, 1.0, 0.0], [0.1, 0.2, 0.4, 0.3]])
    (one, one_sd), (mixed, mixed_sd) = segments.slopes_under(GROUND, on)
    assert (one, one_sd) == pytest.approx((0.2, 0.01))
    rng = np.random.default_rng(0)
    which = rng.choice(4, 400_000, p=on[1])
    drawn = rng.normal(np.array([0.02, 0.0, 0.2, -0.1])[which], np.array([0.01, 0.02, 0.01, 0.03])[which])
    assert (mixed, mixed_sd) == pytest.approx((drawn.mean(), drawn.std()), rel=0.01)


@pytest.mark.parametrize(
    ("change", "blocks"),
    [
        (edge(1.0, 0.33), False),
        (edge(1.0, 0.34), True),
        (edge(1.0, -0.33, sd=0.0), False),
        (edge(1.0, -0.34, sd=0.0), True),
        (edge(1.0, -0.33 * 1.9, sd=0.05), False),
        (edge(1.0, -0.33 * 1.92, sd=0.05), True),
        (edge(1.0, 0.0), False),
    ],
)
def test_what_is_too_high_to_step_over_blocks_the_way(change, blocks):
    """A drop may hide one more riser per tread that is occluded behind its edge: 1 + 4 · 0.05 / 0.22."""
    nothing = Profile(s=np.array([0.9, 1.1]), height=np.zeros(2), plane=np.array([0, 1]), changes=())
    assert segments._is_impassable(change, nothing, None, P) == blocks


@pytest.mark.parametrize(("planes", "blocks"), [((0, 1), False), ((0, 2), True)])
def test_a_high_riser_of_a_flight_does_not_block(planes, blocks):
    profile = Profile(s=np.array([0.9, 1.0, 1.1, 1.2]), height=np.zeros(4), plane=np.array([0, 0, -1, 1]), changes=())
    flight = SimpleNamespace(planes=planes)
    assert segments._is_impassable(edge(1.0, 0.5), profile, SimpleNamespace(stairs=(flight,)), P) == blocks


def plane(gradient, sd=0.004, id_=1):
    normal = np.array([-gradient[0], -gradient[1], 1.0])
    return Plane(
        id=id_,
        centre=np.zeros(3),
        normal=normal / np.linalg.norm(normal),
        area_m2=1.0,
        spread=np.eye(2),
        votes=9.0,
        covariance=np.diag([0.0, sd**2, sd**2]),
    )


def test_the_slope_of_a_segment_is_that_of_the_plane_most_seen_on_it():
    s = np.arange(0.0, 2.0, 0.1)
    ids = np.where(s < 0.55, 2, 1)
    ids[3] = -1
    planes = {1: plane((0.1, 0.2)), 2: plane((0.0, 0.0), id_=2)}
    estimate = TerrainEstimate(t_ns=0, planes=planes, terrains=(), p_camera_in_world=np.zeros(3))
    profile = Profile(s=s, height=np.zeros(20), plane=ids, changes=())
    forward = np.array([0.6, 0.8])
    slope, sd = segments._read_slope(profile, estimate, forward, 0.05, 1.65, P)
    assert slope == pytest.approx(math.atan(0.06 + 0.16))
    assert sd == pytest.approx(math.sqrt(0.0055**2 + planes[1].slope_sd ** 2 + (0.015 / 1.0) ** 2))  # 0.6 to 1.6 m
    slope, sd = segments._read_slope(profile, estimate, forward, 0.05, 0.55, P)
    assert (slope, sd) == pytest.approx((0.0, math.sqrt(0.0055**2 + planes[2].slope_sd ** 2 + (0.015 / 0.4) ** 2)))
    bent = Profile(s=s, height=np.zeros(20), plane=ids, changes=(), slope=0.1 * s, slope_sd=0.01 * s)
    slope, sd = segments._read_slope(bent, estimate, forward, 0.05, 1.65, P)
    assert slope == pytest.approx(0.1 * np.median(s[(s > 0.55) & (s < 1.65)]))
    assert sd == pytest.approx(math.sqrt(0.0055**2 + 0.011**2 + 0.015**2))
    assert segments._read_slope(profile, None, forward, 0.0, 2.0, P) is None
    assert segments._read_slope(profile, estimate, forward, 5.0, 6.0, P) is None


def test_a_sole_may_overhang_a_free_edge_and_not_stand_in_a_riser():
    """Exact weights of soles at the edges of a riser up at 1.0 m, on both sides."""
    up = [segment(-math.inf, 1.0), segment(1.0, math.inf, drop=0.17)]
    s = np.array([0.5, 0.84, 1.05, 1.0, 1.2])

    def beyond(inside):
        return 0.5 * (1.0 + np.tanh(inside / (1.2 * 0.02)))

    half = 0.5 * (0.21 - 0.045)
    toes_in_riser, heel_off = np.maximum(0.0, s + 0.21 - 1.0), np.maximum(0.0, 1.0 - (s - 0.045) - 0.03)
    below = np.exp(-0.5 * (toes_in_riser / math.hypot(0.02, 0.02)) ** 2) * beyond(1.0 - s - half)
    above = np.exp(-0.5 * (heel_off / math.hypot(0.03, 0.02)) ** 2) * beyond(s + half - 1.0)
    np.testing.assert_allclose(segments.foothold_weights(up, s, P), [below, above], rtol=1e-9, atol=1e-12)
    down = [segment(-math.inf, 1.0), segment(1.0, math.inf, drop=-0.17)]
    toes_off, heel_in = np.maximum(0.0, s + 0.21 - 1.0 - 0.03), np.maximum(0.0, 1.0 - (s - 0.045))
    above = np.exp(-0.5 * (toes_off / math.hypot(0.03, 0.02)) ** 2) * beyond(1.0 - s - half)
    below = np.exp(-0.5 * (heel_in / math.hypot(0.02, 0.02)) ** 2) * beyond(s + half - 1.0)
    np.testing.assert_allclose(segments.foothold_weights(down, s, P), [above, below], rtol=1e-9, atol=1e-12)
    ramp = [segment(-math.inf, 1.0), segment(1.0, math.inf, slope=0.2)]
    over = np.maximum(0.0, s + 0.21 - 1.0)
    flat = np.exp(-0.5 * (over / math.hypot(0.05, 0.02)) ** 2) * beyond(1.0 - s - half)
    np.testing.assert_allclose(segments.foothold_weights(ramp, s, P)[0], flat, rtol=1e-9, atol=1e-12)


def test_two_changes_are_needed_between_observed_places_and_one_from_the_foot():
    profile = Profile(s=np.array([0.5, 1.0, 3.0]), height=np.zeros(3), plane=np.array([0, 1, 2]), changes=())
    s = np.array([0.5, 0.75, 2.0, 4.0, 0.0])

    def changed(distance):
        return 1.0 - np.exp(-distance / 2.0)

    expected = [
        0.0,
        changed(0.25) ** 2,
        changed(1.0) ** 2,
        min(changed(1.0), changed(3.6)),
        min(changed(0.5), changed(0.4)),
    ]
    np.testing.assert_allclose(segments.unseen_probability(profile, s, 0.4, P), expected, atol=1e-12)


def test_a_path_is_longer_where_steps_are_shorter():
    s = np.arange(0.05, 2.5, 0.1)
    along, sd = segments.path_scale(GROUND, s, {"RA": (0.8, 0.1), "RD": (1.25, 0.2)})
    ratio = np.where((s > 1.3) & (s < 2.0), 0.8, np.where(s > 2.0, 1.25, 1.0))
    np.testing.assert_allclose(along, np.cumsum(0.1 / ratio))
    np.testing.assert_allclose(sd, np.where(ratio == 1.0, 0.0, np.where(ratio < 1.0, 0.1, 0.2)) / ratio)


def test_the_last_flight_is_the_longest_that_is_well_known():
    def stairs(steps, riser_sd=0.001, tread_sd=0.001):
        return Stairs(
            id=1,
            planes=(),
            steps=steps,
            riser=0.1 + 0.01 * steps,
            tread=0.3,
            heading=0.0,
            start=0.0,
            base=0.0,
            covariance=np.diag([riser_sd**2, tread_sd**2, 0, 0, 0]),
            edges=np.zeros(steps),
            risers=np.zeros(steps),
            across=np.zeros(2),
        )

    def last(*flights):
        estimate = TerrainEstimate(t_ns=0, planes={}, terrains=flights, p_camera_in_world=np.zeros(3))
        return segments.last_flight(estimate, SimpleNamespace(riser=9.0)).riser

    assert last(stairs(2), stairs(5), stairs(3)) == pytest.approx(0.15)
    assert last(stairs(2), stairs(5, riser_sd=1.01 * segments._KNOWN_RISER_SD_M)) == pytest.approx(0.12)
    assert last(stairs(2), stairs(5, tread_sd=1.01 * segments._KNOWN_TREAD_SD_M)) == pytest.approx(0.12)
    assert last(stairs(1)) == 9.0


def test_the_sizes_of_stairs_are_those_of_the_flight_with_an_edge_there():
    segment = Segment(
        start=1.0,
        start_sd=0.01,
        end=2.0,
        end_sd=0.01,
        drop=-0.17,
        drop_sd=0.02,
        slope=0.1,
        slope_sd=0.01,
        mapped_slope=0.1,
        mode="LG",
    )

    def stairs(steps, *, up=1.0, off=0.0):
        return Stairs(
            id=1,
            planes=(),
            steps=steps,
            riser=0.1 + 0.02 * steps,
            tread=0.3,
            heading=0.0 if up > 0 else math.pi,
            start=0.0,
            base=0.0,
            covariance=np.diag([0.002**2, 0.004**2, 0, 0, 0]),
            edges=up * 1.0 + off + 0.3 * np.arange(steps),
            risers=np.zeros(steps),
            across=np.zeros(2),
        )

    def sizes(mode, *flights):
        estimate = TerrainEstimate(t_ns=0, planes={}, terrains=flights, p_camera_in_world=np.zeros(3))
        line = PathAhead(origin=np.zeros(2), forward=np.array([1.0, 0.0]))
        return changes._read_sizes(mode, segment, estimate, np.array([1.0, 0.2]), line, P)

    riser_sd, tread_sd = math.hypot(0.002, changes._FLIGHT_RISER_SD_M), changes._TREAD_SD_SHARE * 0.004
    known = {"riser": 0.16, "riser_sd": riser_sd, "tread": 0.3, "tread_sd": tread_sd}
    assert sizes("SA", stairs(2), stairs(3), stairs(5, up=-1.0)) == pytest.approx(known)
    assert sizes("SA", stairs(1)) == pytest.approx({"riser": 0.12, "riser_sd": riser_sd})
    down = known | {"riser": -0.16, "tread_sd": changes._TREAD_DOWN_FACTOR * tread_sd}
    assert sizes("SD", stairs(3, up=-1.0), stairs(5)) == pytest.approx(down)
    unknown = {"riser": -0.17, "riser_sd": math.hypot(P.mode.riser_sd_m, 0.02)}
    assert sizes("SD", stairs(1, up=-1.0, off=1.01 * changes._FLIGHT_MATCH_M)) == pytest.approx(unknown)
    assert sizes("RD") == {"slope": 0.1, "slope_sd": 0.01}
    assert sizes("LG", stairs(3)) == {}


def test_the_step_filter_is_a_kalman_filter_that_distrusts_outliers():
    steps = StepFilter(0.6, 0.15, 0.1, 0.01, 0.02)
    x, P_ = np.array([0.6, 0.0]), np.diag([0.15**2, 0.1**2])
    for kind, value, sd, sure in (
        (1, 0.7, 0.0, 1.0),
        (-1, 0.65, 0.03, 0.5),
        (1, 0.7, 0.0, 1.0),
        (-1, 2.0, 0.0, 1.0),
        (0, 0.1, 0.0, 1.0),
        (1, 5.0, 0.0, 0.0),
    ):
        steps.update(kind, value, sd, sure)
        P_ = P_ + np.diag([0.01**2, 0.0])
        if sure:
            J = np.array([1.0, kind])
            off, spread = value - J @ x, J @ P_ @ J + (0.02**2 + sd**2) / sure
            spread *= max(1.0, off**2 / (4.0 * spread))
            gain = P_ @ J / spread
            x, P_ = x + gain * off, P_ - np.outer(gain, J @ P_)
        found = steps.mean(1), steps.mean(-1), steps.mean()
        assert found == pytest.approx((x[0] + x[1], x[0] - x[1], x[0]), rel=1e-9)
        for k in (-1.0, 0.0, 1.0):
            J = np.array([1.0, k])
            assert steps.sd(k) == pytest.approx(math.sqrt(J @ P_ @ J), rel=1e-9)
        assert steps.sd() == steps.sd(0.0)


def test_landings_in_order_and_their_uncertainty_grows_with_each_step():
    rhythm, ns = StepRhythm(P), 600_000_000
    for k, foot in enumerate("lrlr"):
        rhythm.land(foot, k * ns, True)
    assert rhythm.next_feet() == ("l", "r", "l", "r")
    assert (rhythm.foot, rhythm.step, rhythm.down_ns) == ("r", 4, 3 * ns)
    times = rhythm.times(rhythm.next_feet(), 3 * ns + 1)
    at = 3 * ns
    for k, ((t_ns, sd), foot) in enumerate(zip(times, "lrlr")):
        at += 1e9 * rhythm._time.mean(1.0 if foot == "l" else -1.0)
        assert t_ns == pytest.approx(at, abs=5)
        assert sd == pytest.approx(math.sqrt((k + 1) * (0.05 * rhythm.step_s) ** 2 + rhythm._time.sd() ** 2))
    late = 3 * ns + 2_000_000_000  # no landing is expected in the past, nor sooner than 50 ms
    assert rhythm.times(("l",), late)[0][0] == pytest.approx(late + 50_000_000, abs=5)
    share = 0.6 * rhythm.step_s * 1e9
    assert [rhythm.is_over_foot(3 * ns + int(share) + d) for d in (-1000, 1000)] == [False, True]
    assert not StepRhythm(P).is_over_foot(10**12)


def test_a_missed_step_counts_and_a_bounce_does_not():
    rhythm, ns = StepRhythm(P), 600_000_000
    for k, foot in enumerate("lrlr"):
        assert rhythm.land(foot, k * ns, True).feet == (foot,)
    mean = rhythm.step_s * 1e9
    assert rhythm.land("r", 3 * ns + int(0.59 * mean), True) is None
    landing = rhythm.land("r", 5 * ns, True)  # the left foot's landing was missed
    assert (landing.feet, landing.measurable, rhythm.step) == (("l", "r"), False, 6)
    assert rhythm.step_s == pytest.approx(0.6, abs=0.003)  # two steps in that time
    assert rhythm.overdue_foot(5 * ns + int(1.01 * rhythm.step_s * 1e9)) == "l"
    assert rhythm.overdue_foot(5 * ns + int(0.99 * rhythm.step_s * 1e9)) is None
    landing = rhythm.land("l", 6 * ns, False)
    assert (landing.feet, landing.measurable, rhythm.step) == (("l",), False, 7)
    landing = rhythm.land("r", 7 * ns, True)
    assert (landing.feet, landing.measurable) == (("r",), False)
    assert rhythm.step_s == pytest.approx(0.6, abs=0.003)


def walking(*divisions):
    known = WalkingInformation(P)
    for k, (foot, p, v) in enumerate(divisions):
        known.add(Division(foot=foot, t_ns=k * 500_000_000, p=np.array([*p, 1.6]), v=np.array([*v, 0.3])))
    return known


def test_the_published_footprint_is_half_a_size_ahead_and_half_a_width_aside():
    known = walking(
        ("l", (9.0, 9.0), (1, 0)), ("r", (0.0, 0.0), (0, 1)), ("l", (0.0, 0.5), (0, 1)), ("r", (0.0, 1.1), (0, 2.0))
    )
    assert known.sizes() == pytest.approx([0.5, 0.6])
    assert (known.last_size(), known.next_size(), known.step_time()) == pytest.approx((0.6, 0.7, 0.5))
    for ahead, left in ((1, 1.0), (2, -1.0), (3, 1.0)):  # the right foot is down: the left one is next
        place, forward = known.footprint(ahead)
        np.testing.assert_allclose(forward, [0.0, 1.0])
        np.testing.assert_allclose(place, [-0.06 * left, 1.1 + 0.7 * ahead + 0.35])
    np.testing.assert_allclose(known.stance(), [0.06, 1.1 + 0.3])
    short = walking(("l", (0.0, 0.0), (1, 0)), ("r", (0.9, 0.0), (1, 0)), ("l", (1.1, 0.0), (1, 0)))
    assert short.next_size() == 0.0
    two = walking(("l", (0.0, 0.0), (1, 0)), ("r", (0.5, 0.0), (1, 0)))
    assert two.next_size() == pytest.approx(0.5)
    assert two.footprint() is not None
    one = walking(("l", (0.0, 0.0), (1, 0)))
    assert math.isnan(one.next_size())
    assert math.isnan(one.step_time())
    assert one.footprint() is one.stance() is one.last_size() is None
    still = walking(("l", (0.0, 0.0), (1, 0)), ("r", (0.5, 0.0), (0, 0)))
    assert still.footprint() is still.stance() is None
    known.clear()
    assert known.last is None


class Ground:
    """In the place of a map: planes by the place along x."""

    def __init__(self, *parts):
        self._parts = parts

    def ground(self, xy):
        return next(((plane, terrain) for end, plane, terrain in self._parts if xy[0] < end), None)


def level(z):
    it = plane((0.0, 0.0))
    it.centre[2] = z
    return it


STAIRS = Stairs(
    id=1,
    planes=(),
    steps=3,
    riser=0.15,
    tread=0.3,
    heading=0.0,
    start=0.0,
    base=0.0,
    covariance=np.zeros((5, 5)),
    edges=np.zeros(3),
    risers=np.zeros(3),
    across=np.zeros(2),
)
FLAT = Level(id=0, plane=0)
RAMP = Ramp(id=1, plane=1, slope=0.2, slope_sd=0.01, heading=0.0)


@pytest.mark.parametrize(
    ("before", "after", "forward", "expected"),
    [
        ((level(0.0), FLAT), (level(0.0), FLAT), 1, ("LG", 0.0)),
        ((level(0.0), FLAT), (level(0.06), FLAT), 1, ("SA", 0.06)),
        ((level(0.0), FLAT), (level(-0.06), FLAT), 1, ("SD", -0.06)),
        ((level(0.0), FLAT), (level(0.05), FLAT), 1, ("LG", 0.05)),
        ((level(0.0), FLAT), (level(0.15), STAIRS), 1, ("SA", 0.15)),
        ((level(0.3), FLAT), (level(0.15), STAIRS), -1, ("SD", 0.15)),
        ((level(0.0), FLAT), (plane((0.2, 0.0)), RAMP), 1, ("RA", 0.4)),
        ((level(0.0), FLAT), (plane((0.2, 0.0)), RAMP), -1, ("RD", 0.4)),
        ((level(0.0), RAMP), (level(0.3), FLAT), 1, ("LG", 0.3)),
        ((level(0.0), FLAT), (plane((0.04, 0.0)), RAMP), 1, ("SA", 0.08)),
        (None, (level(0.3), FLAT), 1, ("LG", 0.3)),
        ((level(0.0), FLAT), None, 1, ("LG", math.nan)),
    ],
)
def test_the_published_mode_is_that_of_the_ground_under_the_footprint(before, after, forward, expected):
    parts = [(end, *part) for end, part in ((1.0, before), (9.0, after)) if part is not None]
    here, there = np.array([0.5, 0.0]), np.array([2.0, 0.0])
    if before is None:
        here = np.array([99.0, 0.0])
    if after is None:
        there = np.array([99.0, 0.0])
    mode, z = mode_between(Ground(*parts), here, there, forward * np.array([1.0, 0.0]), P)
    assert (mode, z) == (expected[0], pytest.approx(expected[1], abs=1e-9, nan_ok=True))


def test_the_published_steps_follow_each_other():
    rhythm = StepRhythm(P)
    for k, foot in enumerate("lrl"):
        rhythm.land(foot, k * 500_000_000, True)
    known = walking(("l", (-1.0, 0.0), (1, 0)), ("r", (-0.5, 0.0), (1, 0)), ("l", (0.0, 0.0), (1, 0)))
    ground = Ground((0.9, level(0.0), FLAT), (1.5, level(0.15), FLAT), (9.0, level(0.15), FLAT))
    steps = predict_published_steps(known, rhythm, ground, np.array([0.0, 0.0]), 0.5, 1_100_000_000, P)
    assert [s.step for s in steps] == [4, 5, 6, 7]
    assert [s.foot for s in steps] == ["r", "l", "r", "l"]
    assert [s.t_ns for s in steps] == [1_500_000_000 + 500_000_000 * k for k in range(4)]
    assert [s.mode for s in steps] == ["LG", "SA", "LG", "LG"]
    np.testing.assert_allclose(
        [s.p_foot_in_world for s in steps],
        [[0.75 + 0.5 * k, -0.06 if k % 2 == 0 else 0.06, 0.15 * (k > 0)] for k in range(4)],
    )
    assert steps[1].probabilities == {"LG": 0.0, "SA": 1.0, "SD": 0.0, "RA": 0.0, "RD": 0.0}
    late = predict_published_steps(known, rhythm, ground, np.array([0.0, 0.0]), 0.5, 9_000_000_000, P)
    assert [s.t_ns for s in late] == [9_000_000_000 + 50_000_000 * (k + 1) for k in range(4)]
    unknown = predict_published_steps(WalkingInformation(P), rhythm, ground, np.array([0.3, 0.4]), 0.5, 0, P)
    assert {s.mode for s in unknown} == {"LG"}
    np.testing.assert_allclose(unknown[0].p_foot_in_world, [0.3, 0.4, math.nan])
