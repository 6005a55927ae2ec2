"""True changes of mode along a way, what counts as right, rows for JSON, and the conditions of the generality test."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from stridetwin.estimators.locomotion_mode import MODES
from stridetwin.outputs.alignment import MovingAlignment
from stridetwin.outputs.modes.approaches import mode_changes
from stridetwin.outputs.modes.scores import ModeScores, ScoredMode, mode_figures, reliability, score_modes
from stridetwin.outputs.modes.true_steps import predictions_by_step
from stridetwin.outputs.terrain.changes import ScoredChange
from stridetwin.outputs.truth import flights
from stridetwin.sim.config import Level, Ramp, Route, Segment, Stairs, Turn
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.samples import Footprint
from stridetwin.streams.trajectory import Trajectory


def layout(*segments: Segment):
    return Terrain.from_route(Route(segments=segments)).layout


WAY = layout(
    Level(length_m=3),
    Stairs(risers=4, riser_m=0.15, tread_m=0.28),
    Level(length_m=2),
    Stairs(risers=1, riser_m=0.15, tread_m=0.28, down=True),
    Level(length_m=2),
    Ramp(angle_rad=0.2, rise_m=0.5),
    Level(length_m=3),
)


def test_modes_change_at_first_and_last_edges_and_at_both_ends_of_a_ramp():
    changes = mode_changes(WAY)
    assert [c.mode for c in changes] == ["SA", "LG", "SD", "LG", "RA", "LG"]
    up, top, down, below, ramp, end = changes
    assert (up.s, up.riser, up.tread, top.s) == pytest.approx((3.0, 0.15, 0.28, 3.0 + 3 * 0.28))
    assert (down.s, below.s, down.riser, down.tread) == pytest.approx((top.s + 2.0, top.s + 2.0, -0.15, 0.0))
    assert (ramp.s, ramp.slope, end.s - ramp.s) == pytest.approx((below.s + 2.0, 0.2, 0.5 / math.tan(0.2)))


def test_low_risers_are_a_flight_but_change_no_mode():
    way = layout(Level(length_m=2), Stairs(risers=3, riser_m=0.05, tread_m=0.3), Level(length_m=2))
    assert [f.risers for f in flights(way.profile)] == [3]
    assert mode_changes(way) == []


def test_flights_with_a_short_landing_between_them_are_two():
    stairs = Stairs(risers=3, riser_m=0.15, tread_m=0.3)
    way = layout(Level(length_m=2), stairs, Level(length_m=0.6), stairs, Level(length_m=2))
    first, second = flights(way.profile)
    assert (first.end, second.s) == pytest.approx((2.6, 3.2))


def test_scores_survive_json():
    scores = ModeScores(
        steps=[
            ScoredMode(
                t_s=1.0,
                mode="LG",
                before="LG",
                predicted="RA",
                allowed=("LG", "RA"),
                lead_s=0.5,
                probabilities=(0.4, 0.0, 0.0, 0.6, 0.0),
                forward_m=0.02,
            )
        ],
        approaches=[ScoredChange(mode="SA", is_detected=True, distance_m=0.01)],
    )
    rows = json.loads(json.dumps(scores.rows(), allow_nan=False))
    again = ModeScores.of(rows)
    assert again.rows() == scores.rows()
    assert again.steps[0].is_correct
    assert math.isnan(again.steps[0].left_m)
    assert mode_figures([again]) == mode_figures([scores])


@pytest.mark.parametrize(
    ("riser_m", "mode", "others"),
    [(0.064, "LG", ()), (0.066, "LG", ("SA",)), (0.074, "SA", ("LG",)), (0.076, "SA", ())],
)
def test_a_riser_of_about_the_least_height_may_count_as_level_or_stair(riser_m, mode, others):
    way = layout(Level(length_m=2), Stairs(risers=1, riser_m=riser_m, tread_m=0.3), Level(length_m=2))
    pose = {"p_frame_in_world": np.zeros((1, 3)), "q_world_frame": np.array([[1.0, 0.0, 0.0, 0.0]])}
    still = Trajectory(t_ns=np.zeros(1, np.int64), **pose)
    prints = [
        Footprint(
            topic="/truth/footprints",
            t_ns=k,
            foot="lr"[k % 2],
            terrain="level",
            mode="LG" if k == 4 else mode,
            p_foot_in_world=np.array([s, 0.0, 0.0]),
            q_world_foot=np.array([1.0, 0.0, 0.0, 0.0]),
        )
        for k, s in enumerate((0.6, 1.0, 1.5, 2.2, 2.8))
    ]
    prints[2] = replace(prints[2], mode="LG")
    before, over, after = score_modes(prints, [], MovingAlignment(still, still), way, 0.27).steps
    assert (before.allowed, over.allowed, after.allowed) == (("LG",), (mode, *others), ("LG",))


def test_a_step_that_may_count_as_either_mode_has_no_calibration():
    clear = ScoredMode(
        t_s=1.0,
        mode="LG",
        before="LG",
        predicted="LG",
        allowed=("LG",),
        lead_s=0.5,
        probabilities=(0.9, 0.1, 0.0, 0.0, 0.0),
    )
    either = replace(clear, allowed=("LG", "RA"), probabilities=(0.5, 0.0, 0.0, 0.5, 0.0))
    assert reliability([clear, either]) == [(0.9, 1.0, 1)]


def test_a_sole_across_a_ramps_edge_may_count_as_either_mode():
    edge = next(c.s for c in mode_changes(WAY) if c.mode == "RA")
    pose = {"p_frame_in_world": np.zeros((1, 3)), "q_world_frame": np.array([[1.0, 0.0, 0.0, 0.0]])}
    still = Trajectory(t_ns=np.zeros(1, np.int64), **pose)

    def allowed(s: float) -> tuple[str, ...]:
        place = np.array([*WAY.way.point(s), 0.0])
        prints = [
            Footprint(
                topic="/truth/footprints",
                t_ns=k,
                foot="lr"[k % 2],
                terrain="level",
                mode="LG",
                p_foot_in_world=place,
                q_world_foot=np.array([1.0, 0.0, 0.0, 0.0]),
            )
            for k in range(3)
        ]
        (step,) = score_modes(prints, [], MovingAlignment(still, still), WAY, 0.27).steps
        return step.allowed

    assert allowed(edge - 0.10) == ("LG", "RA")
    assert allowed(edge + 0.04) == ("LG", "RA")
    assert allowed(edge - 0.23) == ("LG",)
    assert allowed(edge + 0.05) == ("LG",)


@pytest.mark.parametrize(
    ("modes", "lead_s"),
    [
        (("SA", "SA", "SA", "SA"), 0.8),
        (("LG", "SA", "SA", "SA"), 0.6),
        (("SA", "SA", "LG", "SA"), 0.2),
        (("LG", "SA", "LG", "SA"), 0.2),
        (("SA", "SA", "SA", "LG"), 0.0),
    ],
)
def test_the_lead_counts_from_when_a_prediction_stays_right(modes: tuple[str, ...], lead_s: float) -> None:
    def at(t_ns: int, mode: str) -> SimpleNamespace:
        shares = {m: float(m == mode) for m in MODES}
        step = SimpleNamespace(
            foot="l", mode=mode, probabilities=shares, slope=math.nan, slope_sd=math.nan, p_foot_in_world=np.zeros(3)
        )
        return SimpleNamespace(t_ns=t_ns, steps=(step,), change=None)

    prints = [
        Footprint(
            topic="/truth/footprints",
            t_ns=t_ns,
            foot=foot,
            terrain="stair",
            mode="SA",
            p_foot_in_world=np.zeros(3),
            q_world_foot=np.array([1.0, 0.0, 0.0, 0.0]),
        )
        for t_ns, foot in ((0, "l"), (1, "r"), (2_000_000_000, "l"))
    ]
    estimates = [at(1_200_000_000 + 200_000_000 * k, mode) for k, mode in enumerate(modes)]
    pose = {"p_frame_in_world": np.zeros((1, 3)), "q_world_frame": np.array([[1.0, 0.0, 0.0, 0.0]])}
    still = Trajectory(t_ns=np.zeros(1, np.int64), **pose)
    (step,) = score_modes(prints, estimates, MovingAlignment(still, still), None, 0.27).steps
    assert step.lead_s == pytest.approx(lead_s)


@pytest.mark.parametrize(("off_m", "is_detected"), [(-0.03, True), (0.39, True), (0.41, False), (-0.41, False)])
def test_beyond_a_turn_places_count_along_the_way(off_m: float, is_detected: bool) -> None:
    turned = layout(
        Level(length_m=3),
        Turn(angle_rad=math.pi / 2, radius_m=1.5),
        Level(length_m=2),
        Ramp(angle_rad=0.2, rise_m=0.5),
        Level(length_m=3),
    )
    change = next(c for c in mode_changes(turned) if c.mode == "RA")
    prints = [
        Footprint(
            topic="/truth/footprints",
            t_ns=k * 500_000_000,
            foot="lr"[k % 2],
            terrain="level",
            mode="LG" if s < change.s else "RA",
            p_foot_in_world=np.array([*turned.way.point(s), 0.0]),
            q_world_foot=np.array([1.0, 0.0, 0.0, 0.0]),
        )
        for k, s in enumerate([0.0, 0.0, *np.arange(0.5, change.s - 0.3, 0.7), change.s - 0.1, change.s + 0.6])
    ]
    estimate = SimpleNamespace(
        t_ns=prints[-1].t_ns - 1_600_000_000,
        steps=(),
        change=SimpleNamespace(
            mode="RA",
            p_in_world=turned.way.point(change.s + off_m),
            distance_sd=0.01,
            riser=math.nan,
            riser_sd=math.nan,
            tread=math.nan,
            tread_sd=math.nan,
            slope=0.2,
            slope_sd=0.01,
        ),
    )
    pose = {"p_frame_in_world": np.zeros((1, 3)), "q_world_frame": np.array([[1.0, 0.0, 0.0, 0.0]])}
    still = Trajectory(t_ns=np.zeros(1, np.int64), **pose)
    scores = score_modes(prints, [estimate], MovingAlignment(still, still), turned, 0.27)
    approach = next(a for a in scores.approaches if a.mode == "RA")
    assert approach.is_detected == is_detected
    assert approach.distance_m == pytest.approx(off_m if is_detected else math.nan, nan_ok=True)
    assert [s.is_straddling for s in scores.steps] == [False] * (len(scores.steps) - 2) + [True, False]


def test_who_pauses_does_not_walk_steadily():
    lengths = [0.6] * 5 + [0.3] + [0.6] * 6
    steps = [
        ScoredMode(
            t_s=k, mode="LG", before="LG", predicted="LG", allowed=("LG",), lead_s=1.0, forward_m=error, length_m=m
        )
        for k, (m, error) in enumerate(zip(lengths, [0.3] * 3 + [0.01] + [0.3] * 3 + [0.01, 0.01, 0.05] + [0.3] * 2))
    ]
    figures = mode_figures([ModeScores(steps=steps)])
    assert figures["footprint_steady_rmse_m"]["forward"] == pytest.approx(np.sqrt((3 * 0.01**2 + 0.05**2) / 4))
    assert figures["footprint_rmse_m"]["forward"] > 0.1


def test_estimates_about_a_touch_down_predict_the_feet_that_they_wait_for() -> None:
    """Feet land at 1, 2, 3 s; one lands heard late, one was guessed early."""
    landed = [SimpleNamespace(t_ns=t * 10**9, foot=foot) for t, foot in ((1, "l"), (2, "r"), (3, "l"))]

    def estimate_at(t_s: float, feet: str) -> SimpleNamespace:
        return SimpleNamespace(t_ns=int(t_s * 1e9), steps=[SimpleNamespace(foot=foot) for foot in feet])

    cases = {
        (0.5, "lr"): [0, 1],
        (1.04, "lrl"): [None, 1, 2],  # the left foot is down, the insole has not reported it yet
        (1.96, "lr"): [2, None],  # the right foot counts as down already
        (1.6, "lr"): [1, 2],  # who waits for the wrong foot for long is not helped
        (2.5, ""): [],
    }
    for (t_s, feet), steps in cases.items():
        found = predictions_by_step(landed, [estimate_at(t_s, feet)])
        numbers = {k: i for i, of in enumerate(found) for _, k in of}
        assert [numbers.get(k) for k in range(len(feet))] == steps
