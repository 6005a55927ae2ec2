"""What was seen ahead, beside the truth: laid worlds, figures, the Rerun stream, scores as lines; on steps made up."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from stridetwin.cli.console import plain_text
from stridetwin.cli.score import score_tables
from stridetwin.estimators.locomotion_mode import MODES, ModeEstimate, NextChange, StepPrediction
from stridetwin.gate.compare import Rules, compare_scores
from stridetwin.gate.score_table import table_of
from stridetwin.outputs.aligned_walk import AlignedWalk
from stridetwin.outputs.alignment import MovingAlignment, YawAlignment
from stridetwin.outputs.modes.figures import lead_times, mode_ribbon, prediction_runs, steps_from_above
from stridetwin.outputs.modes.kind import EvaluatedModes, Modes
from stridetwin.outputs.modes.rerun import prediction_text
from stridetwin.outputs.modes.scores import mode_figures, score_modes, scores_of_walk
from stridetwin.outputs.pose_feed import merge_poses
from stridetwin.outputs.route_figures import HALF_WIDTH_M
from stridetwin.outputs.terrain.changes import ScoredChange
from stridetwin.outputs.terrain.figures import ground_errors, ground_from_above, ground_from_aside
from stridetwin.outputs.terrain.grid import GROUND_CLASSES
from stridetwin.outputs.terrain.mapped_route import CELL_M, MappedRoute
from stridetwin.outputs.terrain.rerun import log_ground
from stridetwin.outputs.terrain.scores import MapScores, map_figures, true_heights
from stridetwin.outputs.terrain.snapshots import Snapshot
from stridetwin.sim.config import Level, Route, Stairs
from stridetwin.sim.world.route import lay_out
from stridetwin.streams.samples import Depth, Footprint, Odometry
from stridetwin.streams.trajectory import Trajectory
from tests.pinned import SAME_POINTS, assert_pinned, columns
from tests.plots import figure

LAYOUT = lay_out(Route(segments=(Level(length_m=3), Stairs(risers=3, riser_m=0.15, tread_m=0.3), Level(length_m=3))))
EDGES = (3.0, 3.3, 3.6)
TURN, SHIFT = 0.4, np.array([5.0, -2.0, 0.3])
STEP_S, FIRST_S = 0.6, 2.0
WRONG_STEPS = (2, 6)
"""Steps of which another mode is predicted at the last, and of the first of them at the first alone."""


def placed(s: float, left: float) -> np.ndarray:
    return np.array([*LAYOUT.way.point(s, left), true_heights(LAYOUT.profile, np.array([s]))[0]])


def walked() -> list[Footprint]:
    """Two feet that stand, and eleven steps: three of them up."""
    s = [0.0, 0.0, 0.5, 1.0, 1.6, 2.2, 2.7, 3.05, 3.35, 3.7, 4.2, 4.8, 5.4]
    modes = ["LG"] * 7 + ["SA"] * 3 + ["LG"] * 3
    return [
        Footprint(
            topic="/truth/footprints",
            t_ns=round(1e9 * (FIRST_S + STEP_S * max(0, i - 2))),
            foot="lr"[i % 2],
            p_foot_in_world=placed(at, 0.1 - 0.2 * (i % 2)),
            q_world_foot=np.array([1.0, 0, 0, 0]),
            terrain="level",
            mode=mode,
        )
        for i, (at, mode) in enumerate(zip(s, modes))
    ]


def turned(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def predictions(footprints: list[Footprint]) -> list[ModeEstimate]:
    """Ten estimates a second, each of four steps that land 2 cm too far, in a world that is turned and shifted."""
    landed = footprints[2:]
    found = []
    for t_ns in range(10**9, landed[-1].t_ns, 10**8):
        next_ = next(i for i, f in enumerate(landed) if f.t_ns >= t_ns)
        steps = []
        for k in range(next_, min(next_ + 4, len(landed))):
            late = landed[k].t_ns - t_ns < 250_000_000
            mode = landed[k].mode
            if (k == WRONG_STEPS[0] and late) or k == WRONG_STEPS[1]:
                mode = "RD"
            there = turned(-TURN) @ (landed[k].p_foot_in_world + [0.02, 0.0, 0.0] - SHIFT)
            covariance = (turned(-TURN) @ np.diag([0.03**2, 0.02**2, 1.0]) @ turned(TURN))[:2, :2]
            steps.append(
                StepPrediction(
                    step=k + 1,
                    foot=landed[k].foot,
                    mode=mode,
                    t_ns=landed[k].t_ns,
                    t_sd_s=0.03,
                    probabilities={m: 0.96 if m == mode else 0.01 for m in MODES},
                    p_foot_in_world=there,
                    covariance=covariance,
                )
            )
        change = NextChange(
            mode="SA",
            p_in_world=(turned(-TURN) @ (placed(3.0, 0.0) - SHIFT))[:2],
            distance=3.0,
            distance_sd=0.01,
            time_s=1.0,
            time_sd_s=0.1,
            riser=0.151,
            riser_sd=0.002,
            tread=0.302,
            tread_sd=0.003,
            slope=math.nan,
            slope_sd=math.nan,
        )
        found.append(
            ModeEstimate(
                t_ns=t_ns,
                step=next_,
                steps=tuple(steps),
                change=change,
                heading=-TURN,
                p_body_in_world=np.zeros(3),
                step_length=0.5,
                step_length_sd=0.02,
                step_time=STEP_S,
            )
        )
    return found


@pytest.fixture(scope="module")
def walk() -> AlignedWalk:
    footprints = walked()
    t_ns = np.array([0, 10**10])
    poses = Trajectory(t_ns=t_ns, p_frame_in_world=np.zeros((2, 3)), q_world_frame=np.tile([1.0, 0, 0, 0], (2, 1)))
    q_true = np.tile([math.cos(TURN / 2), 0, 0, math.sin(TURN / 2)], (2, 1))
    truth = Trajectory(t_ns=t_ns, p_frame_in_world=np.tile(SHIFT, (2, 1)), q_world_frame=q_true)
    places = np.array([f.p_foot_in_world for f in footprints])
    return AlignedWalk(
        frame="head/imu",
        poses=poses,
        camera=None,
        statuses=None,
        alignment=MovingAlignment(poses, truth),
        p_frame_in_world=places,
        place_m=places[:, 0],
        layout=LAYOUT,
        footprints=footprints,
        foot_places_m=LAYOUT.way.project(places[:, :2]),
    )


@pytest.fixture(scope="module")
def evaluated(walk) -> EvaluatedModes:
    estimates = predictions(walk.footprints)
    modes = score_modes(walk.footprints, estimates, walk.alignment, LAYOUT, walk.sole_m)
    return EvaluatedModes(
        name="locomotion_mode", estimates=estimates, modes=modes, walk=walk, scores=scores_of_walk(modes)
    )


@pytest.fixture(scope="module")
def route() -> MappedRoute:
    s = np.arange(-0.5, 6.5, CELL_M) + CELL_M / 2
    left = np.arange(-HALF_WIDTH_M, HALF_WIDTH_M - 1e-9, CELL_M) + CELL_M / 2
    classes = np.where((s > EDGES[0]) & (s < EDGES[-1]), GROUND_CLASSES.index("SA"), 0).astype(np.uint8)
    return MappedRoute(
        s=s,
        left=left,
        height=np.tile(true_heights(LAYOUT.profile, s)[:, None] + 0.004, len(left)),
        classes=np.tile(classes[:, None], len(left)),
        edges=np.array([[at + 0.006, -0.8, 0.8] for at in EDGES]),
    )


@pytest.fixture(scope="module")
def snapshots() -> list[Snapshot]:
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0.0]])
    return [
        Snapshot(
            t_ns=round(1e9 * t),
            points=np.zeros((5, 3), np.float32),
            classes=np.zeros(5, np.uint8),
            planes=[(square, 0)],
            edges=[square[:2]],
        )
        for t in np.arange(1.0, 8.0, 0.5)
    ]


def test_an_alignment_is_inverted_exactly():
    laid = YawAlignment(estimated=np.array([1.0, 2.0, 3.0]), true=np.array([-1.0, 0.5, 3.2]), yaw=math.pi / 2)
    points = np.array([[[1.0, 2.0, 3.0], [2.0, 2.0, 3.5]]])
    np.testing.assert_allclose(laid.to_true(points)[0], [[-1.0, 0.5, 3.2], [-1.0, 1.5, 3.7]], atol=1e-12)
    np.testing.assert_allclose(laid.to_estimated(laid.to_true(points)), points, atol=1e-12)
    np.testing.assert_allclose(laid.to_true(points[..., :2]), laid.to_true(points)[..., :2], atol=1e-12)


class DepthImages:
    """In the place of a recording with 30 depth images per second."""

    def samples(self, topics):
        assert topics == ["/head/depth"]
        return (Depth(topic="/head/depth", t_ns=k * 10**9 // 30, depth=np.zeros((2, 2), np.float32)) for k in range(30))


def test_map_and_prediction_get_every_image_after_the_pose_of_its_instant():
    t_ns = np.arange(30) * 10**9 // 30
    path = Trajectory(t_ns=t_ns, p_frame_in_world=np.zeros((30, 3)), q_world_frame=np.tile([1.0, 0, 0, 0], (30, 1)))
    given = list(merge_poses(path, DepthImages(), ["/head/depth"]))
    assert [s.t_ns for s in given if isinstance(s, Depth)] == t_ns.tolist()
    assert [type(s) for s in given] == [Odometry, Depth] * 30


def test_errors_of_steps_do_not_depend_on_the_estimators_world(evaluated):
    steps = evaluated.modes.steps
    assert [i for i, s in enumerate(steps) if not s.is_correct] == list(WRONG_STEPS)
    np.testing.assert_allclose([s.forward_m for s in steps[1:]], 0.02, atol=1e-9)
    np.testing.assert_allclose([s.left_m for s in steps[1:]], 0.0, atol=1e-9)
    (up,) = (a for a in evaluated.modes.approaches if a.mode == "SA")
    assert (up.distance_m, up.riser_m, up.tread_m) == pytest.approx((0.0, 0.001, 0.002), abs=1e-9)


PREDICTED = "predicted footprint, in its mode's colour"


def test_the_plan_of_the_steps_has_every_footprint_those_predicted_and_the_wrong_ones(evaluated):
    plan = figure(steps_from_above(evaluated.estimates, evaluated.modes, evaluated.walk))
    footprints = evaluated.walk.footprints
    assert len(plan.shapes("true footprint")) == len(footprints)
    known = len(footprints) - 3  # nothing is predicted of the first step between two landings
    assert len(plan.shapes(PREDICTED)) == len(plan.shapes("95 % ellipse")) == known
    assert len(plan.points("wrong")) == len(WRONG_STEPS)
    assert {"level", "stair", PREDICTED} <= set(plan.labels)


def test_the_plan_of_the_ground_has_the_map_and_the_footprints(route, walk):
    plan = figure(ground_from_above(route, walk))
    assert len(plan.shapes("true footprint")) == len(walk.footprints)
    assert len(plan.layout["images"]) == 1
    assert {"mapped: level", "mapped: stairs up", "mapped edge", "true path of the camera"} <= set(plan.labels)


def test_predicted_footprints_lie_where_they_were_predicted(evaluated):
    plan = figure(steps_from_above(evaluated.estimates, evaluated.modes, evaluated.walk))
    predicted = np.array(sorted(np.mean([s[:4] for s in plan.shapes(PREDICTED)], axis=1).tolist()))
    true = np.array(sorted(np.mean([s[:4] for s in plan.shapes("true footprint")][3:], axis=1).tolist()))
    np.testing.assert_allclose(predicted - true, np.tile([0.02, 0.0], (len(true), 1)), atol=1e-5)


def test_the_ribbon_marks_what_the_score_calls_wrong(evaluated):
    ribbon = figure(mode_ribbon(evaluated.estimates, evaluated.modes, evaluated.walk))
    crosses = [t for t in ribbon.traces if t.get("marker", {}).get("symbol") == "x"]
    assert [len(t["x"]) for t in crosses] == [len(WRONG_STEPS)]
    runs = prediction_runs(evaluated.estimates, evaluated.modes, evaluated.walk)
    assert all(b > a for a, b, _, _ in runs)
    last = {round(b, 6): right for _, b, _, right in runs}  # what is predicted at touch-down is what counts
    assert {s.t_s: last[round(s.t_s, 6)] for s in evaluated.modes.steps} == {
        s.t_s: s.is_correct for s in evaluated.modes.steps
    }
    wrong_runs = [s for s in ribbon.shapes("wrong") if len(s) == 5]
    assert len(wrong_runs) == sum(not right for *_, right in runs) == 2
    early = [(a, b) for a, b, mode, _ in runs if mode == "LG" and b < evaluated.modes.steps[2].t_s]
    assert early[-1][1] == pytest.approx(evaluated.modes.steps[2].t_s - 0.2, abs=0.051)  # right until just before


def test_leads_are_bars_as_long_as_they_are(evaluated):
    lead = figure(lead_times(evaluated.modes))
    bars = [s for label in ("level", "stairs up", "stairs down") if label in lead.labels for s in lead.shapes(label)]
    known = [s.lead_s for s in evaluated.modes.steps if s.lead_s > 0]
    np.testing.assert_allclose(sorted(np.ptp(b[:, 1]) for b in bars), sorted(known), atol=1e-5)
    assert len(lead.points("changes the mode")) == sum(s.is_transition for s in evaluated.modes.steps) == 2
    assert len(lead.points("wrong")) == len(WRONG_STEPS)


def test_the_side_view_and_its_errors_are_in_millimetres(route, walk):
    aside, errors = figure(ground_from_aside(route, walk)), figure(ground_errors(route, walk))
    assert {"stair", "mapped edge"} <= set(aside.labels)
    found = errors.points("position of an edge along the route")
    assert len(found) == len(EDGES)
    np.testing.assert_allclose(found[:, 1], 6.0, atol=1e-3)
    assert errors.layout["yaxis"]["title"]["text"] == "estimated minus true, mm"


class Listening:
    """In the place of a Rerun stream: keeps what is logged, by entity."""

    def __init__(self) -> None:
        self.logged, self.now = {}, None

    def set_time(self, name, *, duration):
        self.now = duration

    def log(self, entity, archetype, static=False):
        self.logged.setdefault(entity, []).append((None if static else self.now, archetype))

    def send_columns(self, entity, indexes, columns):
        self.logged.setdefault(entity, []).append((None, columns))


def test_rerun_gets_ground_steps_and_modes_over_time(evaluated, snapshots):
    rr = pytest.importorskip("rerun")
    stream = Listening()
    log_ground(rr, stream, snapshots)
    Modes().log_rerun(rr, stream, [evaluated], recording=None)
    entities = {
        "world/ahead/ground",
        "world/ahead/planes",
        "world/ahead/edges",
        "world/steps/true",
        "world/steps/predicted",
    }
    entities |= {"world/steps/ellipses", "modes/predicted", *(f"modes/probability/{m}" for m in MODES)}
    assert entities <= set(stream.logged)
    assert [t for t, _ in stream.logged["world/ahead/ground"]] == [s.t_ns * 1e-9 for s in snapshots]
    assert len(stream.logged["world/steps/true"]) == len(evaluated.walk.footprints)
    assert len(stream.logged["world/steps/true"][-1][1].strips.as_arrow_array()) == len(evaluated.walk.footprints)
    landed = [f.t_ns * 1e-9 for f in evaluated.walk.footprints[3:]]
    times = np.array([t for t, _ in stream.logged["world/steps/predicted"]])
    assert all(0.0 < times[times > t].min() - t < 0.11 for t in landed[:-1])  # at once after each landing
    first = np.array(stream.logged["world/steps/predicted"][0][1].strips.as_arrow_array().to_pylist()[0])
    np.testing.assert_allclose(first[0, 0] - evaluated.walk.footprints[2].p_foot_in_world[0], 0.02, atol=1e-5)
    assert prediction_text(evaluated.estimates[0]) == (
        "next step (left): level, 96 %\nthen stairs up in 3.0 m, riser 151 mm, tread 302 mm"
    )


def test_scores_are_listed_by_kind_and_compared_in_the_right_direction(evaluated):
    found = ScoredChange(mode="RA", is_detected=True, distance_m=0.003, slope_rad=0.01)
    missed = ScoredChange(mode="SA", is_detected=False)
    ground = map_figures(
        MapScores(
            changes=(found, missed),
            accuracy_m=0.004,
            accuracy_p95_m=0.009,
            completeness=0.9,
            edge_errors=np.array([0.003, -0.001, 0.3, math.inf]),
        )
    )
    assert ground["found_pct"] == 50.0
    assert ground["begin_rmse_mm"] == pytest.approx(3.0)
    assert ground["slope_rmse_deg"] == pytest.approx(math.degrees(0.01))
    assert (ground["edge_rmse_mm"], ground["edge_mean_mm"]) == pytest.approx((math.sqrt(5.0), 1.0))
    assert ground["edge_false_pct"] == 50.0
    assert "riser_rmse_mm" not in ground
    scores = {"locomotion_mode": evaluated.scores, "terrain_map": ground}
    lines = plain_text(score_tables(scores))
    for words in ("transitions %", "lead s", "accuracy mm", "complete %", "edges mm"):
        assert words in lines
    better = {"locomotion_mode": scores["locomotion_mode"] | {"accuracy_pct": 100.0, "lead_median_s": 9.0}}
    whole, good, own = (
        table_of({"estimators": side}, "") for side in (scores, better, {"locomotion_mode": scores["locomotion_mode"]})
    )
    rules = Rules(tolerance=0.05)
    assert {r.metric for r in compare_scores(whole, good, rules).regressions} == {"accuracy_pct", "lead_median_s"}
    assert compare_scores(good, own, rules).regressions == []


def test_pinned_numbers(evaluated, num_regression):
    """Every score of the steps, and of steps predicted with other probabilities and places."""
    rng = np.random.default_rng(5)
    footprints, estimates = walked(), []
    for estimate in predictions(footprints):
        steps = []
        for step in estimate.steps:
            p = rng.dirichlet([6.0 if m == step.mode else 0.7 for m in MODES])
            place = step.p_foot_in_world + rng.normal(0.0, 0.04, 3)
            mode = MODES[int(p.argmax())]
            steps.append(replace(step, mode=mode, probabilities=dict(zip(MODES, p)), p_foot_in_world=place))
        estimates.append(replace(estimate, steps=tuple(steps)))
    modes = score_modes(footprints, estimates, evaluated.walk.alignment, LAYOUT, 0.27)
    rows = [*modes.steps, *modes.approaches, mode_figures([modes, evaluated.modes]), scores_of_walk(modes)]
    assert_pinned(num_regression, columns(rows), SAME_POINTS)
