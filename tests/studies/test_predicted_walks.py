"""Walks with predicted steps: conditions, spreads, tables and page; the map without memory."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.estimators.locomotion_mode import METHODS
from stridetwin.estimators.terrain_map import TerrainMap
from stridetwin.outputs.modes.scores import ModeScores, ScoredMode, mode_figures, reliability
from stridetwin.outputs.terrain.changes import ScoredChange
from stridetwin.pages.plot import library
from stridetwin.reference.norms import read_reference
from stridetwin.sim.config import Turn, TwinConfig
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.people import PEOPLE
from stridetwin.sim.sensors.standard_rig import standard_rig
from stridetwin.sim.world.obstacles import surroundings
from stridetwin.sim.world.route import lay_out
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Depth, Odometry
from stridetwin.studies.experiment import experiment
from stridetwin.studies.zhao2023 import mode_results
from stridetwin.studies.zhao2023.mode_results import GAIT_PATTERNS, PAPER_TERRAINS
from stridetwin.studies.zhao2023.mode_walks import (
    EDGES,
    FORGETFUL,
    HEIGHT_GROUPS,
    MOUNTS,
    ForgetfulMap,
    SharedMap,
    combine_spreads,
    compute_spread,
    pitch_down,
)
from tests.plots import figures
from tests.studies.short_experiment import make_case


def step(mode: str, predicted: str, p: float) -> ScoredMode:
    others = (1.0 - p) / 4
    probabilities = tuple(p if m == predicted else others for m in ("LG", "SA", "SD", "RA", "RD"))
    return ScoredMode(
        t_s=1.0,
        mode=mode,
        before="LG",
        predicted=predicted,
        allowed=(mode,),
        lead_s=1.2 * (mode == predicted),
        probabilities=probabilities,
    )


def row(seed: int, predicted: str = "SA", methods: tuple[str, ...] = ("proposed", "published")) -> dict:
    scores = ModeScores(steps=[step("LG", "LG", 0.99), step("SA", predicted, 0.75)]).rows()
    angles = np.linspace(0.2, 0.6, 50)
    return {
        "seed": seed,
        "physics": "dynamic",
        "fell_at_s": None,
        "mount": "head",
        "spread": {q: compute_spread(angles, EDGES[q]) for q in EDGES},
        "methods": {m: scores | {"time_ms": {"mean": 20.0, "p95": 30.0}} for m in methods},
    }


TRIALS = ("zhao_view", "zhao_directions", "zhao_disturbance")


def labels(name: str, seed: int = 1000) -> dict:
    """Condition of a walk of an experiment."""
    return make_case(experiment(name), Path(), seed).labels


def trial_config(name: str, walk: str) -> TwinConfig:
    """The twin of a subject's first or second walk."""
    cases = [make_case(experiment(name), Path(), seed) for seed in range(1000, 1010)]
    return next(case for case in cases if case.labels["walk"] == walk).walks()[0].config


@pytest.mark.parametrize("name", TRIALS)
def test_each_subject_walks_twice_and_ten_walks_hold_every_group_both_ways(name) -> None:
    turns = [labels(name, seed) for seed in experiment(name).seeds]
    assert len({tuple(turn.values()) for turn in turns}) == len(turns) == 30
    for first in (0, 10, 20):
        some = [(turn["height_group"], turn["walk"]) for turn in turns[first : first + 10]]
        assert Counter(some) == {(group, walk): 1 for group in HEIGHT_GROUPS for walk in ("first", "second")}


def test_every_condition_is_walked_three_times_and_sixty_walks_are_balanced():
    seeds = experiment("zhao_generality").seeds
    rows = [labels("zhao_generality", seed) for seed in seeds]
    assert len({tuple(row.values()) for row in rows}) == len(seeds) == 540
    cell = ("height_group", "pattern", "terrain", "mount")
    assert set(Counter(tuple(row[key] for key in cell) for row in rows).values()) == {3}
    for first in (0, 1, 37, 480):
        some = rows[first : first + 60]
        for key, values in (("terrain", PAPER_TERRAINS), ("mount", MOUNTS), ("height_group", HEIGHT_GROUPS)):
            assert Counter(row[key] for row in some) == {value: 60 // len(values) for value in values}
    for first in range(0, 540, 60):
        assert Counter(row["pattern"] for row in rows[first : first + 60]) == dict.fromkeys(GAIT_PATTERNS, 20)
    assert labels("zhao_generality", 0) in rows
    people = {make_case(experiment("zhao_generality"), Path(), seed).walks()[0].config.person for seed in seeds[::7]}
    assert people == {person for name, person in PEOPLE.items() if name.startswith("zhao_")}


def test_the_second_walk_is_on_the_chest_or_to_the_other_side() -> None:
    for name in ("zhao_directions", "zhao_disturbance"):
        configs = [trial_config(name, walk) for walk in ("first", "second")]
        assert [c.rig_mount for c in configs] == ["head", "chest"]
        assert all(c.gait.gaze.kind == "wandering" for c in configs)
    assert trial_config("zhao_disturbance", "first").route.bystanders == 2
    assert trial_config("zhao_directions", "first").fittings["head_camera"].part is not None
    views = [trial_config("zhao_view", walk) for walk in ("first", "second")]
    turns = [[s.angle_rad for s in c.route.segments if isinstance(s, Turn)] for c in views]
    assert turns == [[pytest.approx(math.pi / 2)], [pytest.approx(-math.pi / 2)]]
    assert all(c.gait.gaze.sway_yaw_rad > 0.6 and c.rig_mount == "head" for c in views)


def test_walls_of_a_corridor_stand_at_its_borders_and_nowhere_on_the_way() -> None:
    config = trial_config("zhao_view", "first")
    layout = lay_out(config.route)
    walls = [mark.box for mark in surroundings("corridor", layout, -1.0)]
    for s in np.arange(0.5, layout.profile[-1].s1 - 1.0, 0.25):
        beside = layout.way.point(s)
        distances = [_distance(wall, beside) for wall in walls]
        assert min(distances) > 0.7
        if all(abs(s - p.s0) > 2.5 and abs(s - p.s1) > 2.5 for p in layout.way.segments if p.curvature):
            left, right = (layout.way.point(s, side * 0.86) for side in (-1.0, 1.0))
            assert all(min(_distance(wall, p) for wall in walls) < 0.01 for p in (left, right))


def _distance(box, p) -> float:
    cos, sin = math.cos(box.yaw), math.sin(box.yaw)
    dx, dy = p[0] - box.x, p[1] - box.y
    along, across = abs(cos * dx + sin * dy) - box.length / 2, abs(cos * dy - sin * dx) - box.width / 2
    return math.hypot(max(along, 0.0), max(across, 0.0))


@pytest.mark.parametrize("mount", ["head", "chest"])
def test_the_camera_looks_as_far_down_as_it_is_fitted(mount) -> None:
    config = replace(trial_config("zhao_view", "first"), rig_mount=mount, sensors=("head_imu", "head_camera"))
    pitch = {}
    for degrees in (None, 8.0):
        asked = None if degrees is None else math.radians(degrees)
        rig = standard_rig(replace(config, fittings={"head_camera": SensorConfig(pitch_down_rad=asked)}))
        (camera,), (imu,) = rig.cameras.values(), rig.imus.values()
        assert np.allclose(camera.mount.T_body_sensor[:3, :3], imu.mount.T_body_sensor[:3, :3])
        axis = camera.mount.T_body_sensor[:3, 2]
        pitch[degrees] = math.degrees(math.asin(-axis[2]))
    protocol = read_reference("zhao2023")["protocol"]["mount_pitch_down_deg"]
    assert pitch == {None: pytest.approx(protocol["nominal"]), 8.0: pytest.approx(protocol["shallow"])}


def test_pitch_is_that_of_the_optical_axis_below_the_horizon() -> None:
    forward = np.column_stack([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    turns = Rotation.from_euler("ZY", [[0.3, 0.4], [-2.0, -0.2]]) * Rotation.from_matrix(forward)
    assert pitch_down(turns.as_quat(scalar_first=True)) == pytest.approx([0.4, -0.2])


def test_spreads_add_up_as_if_all_values_were_one_walks() -> None:
    rng = np.random.default_rng(1)
    parts = [rng.normal(0.3, 0.4, 80), rng.normal(0.6, 0.1, 200)]
    edges = EDGES["camera_pitch_rad"]
    whole, added = (
        compute_spread(np.concatenate(parts), edges),
        combine_spreads([compute_spread(part, edges) for part in parts]),
    )
    assert added.pop("bins") == whole.pop("bins")
    assert added == pytest.approx(whole)
    assert sum(compute_spread(np.array([-9.0, 9.0]), edges)["bins"]) == 2


def test_predicted_probabilities_are_compared_with_the_share_of_correct_predictions() -> None:
    steps = [step("SA", "SA", 0.95), step("SA", "LG", 0.95), step("LG", "LG", 0.55)]
    assert reliability(steps) == [(pytest.approx(0.55), 1.0, 1), (pytest.approx(0.95), 0.5, 2)]
    assert reliability([]) == []


@pytest.mark.parametrize("name", [*TRIALS, "zhao_generality", "zhao_baselines"])
def test_table_and_page_have_the_papers_figures(name) -> None:
    methods = ("proposed", "published", *([FORGETFUL] if name == "zhao_baselines" else []))
    more = labels(name)
    results = [row(1000, methods=methods) | more, row(1001, "LG", methods) | more]
    study = experiment(name)
    result = json.loads(json.dumps(study.result(results)))
    assert result["summary"]["proposed"]["walks_accuracy_pct"]["mean"] == 75.0
    assert result["summary"]["proposed"]["walks_accuracy_pct"]["sd"] == 25.0
    lines = study.table(result)
    accuracy = next(line for line in lines if line.startswith("accuracy %"))
    theirs = result["paper"]["published"]["accuracy_pct"]["mean"]
    assert accuracy.split()[2 : 3 + len(methods)] == [*["75.00"] * len(methods), f"{theirs:.2f}"]
    assert ("Table II" in lines) == (name not in TRIALS)
    assert ("one image" in "\n".join(lines)) == (FORGETFUL in methods)
    assert sum("0.26" in line for line in lines if line.startswith("  paper")) == (name not in TRIALS)
    assert study.report is not None
    html = study.report(result)
    assert all(f"<h2>{title}</h2>" in html for title in ("Accuracy", "Figure 4", "Lead time", "Calibration"))
    assert ("<h2>Table II</h2>" in html) == (name not in TRIALS)
    assert {"Lead time", "Calibration"} <= set(figures(html))
    text = html.replace(library(), "")
    assert not re.search(r'<script [^>]*src|@import|url\(|(src|href)="(?!data:)|https?:', text)
    assert "nan" not in re.sub(r"<script.*?</script>", "", text, flags=re.S).lower().replace("dominant", "")
    assert mode_results.report is study.report


def floor_seen_from(rig: Rig, x: float, t_ns: int) -> tuple[Odometry, Depth]:
    """Pose of a camera 1.5 m above a level floor that looks 45 degrees down along x, and its image."""
    (camera,) = rig.cameras.values()
    fx, fy, cx, cy = camera.intrinsics
    v, u = np.mgrid[: camera.height, : camera.width]
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(u.shape)], -1)
    forward, right = np.array([1.0, 0.0, -1.0]) / math.sqrt(2.0), np.array([0.0, -1.0, 0.0])
    R = np.column_stack([right, np.cross(forward, right), forward])
    down = -(rays @ R.T)[..., 2]
    depth = np.where(down > 0.3, 1.5 / np.maximum(down, 0.3), 0.0).astype(np.float32)
    still = np.zeros(3)
    q = Rotation.from_matrix(R).as_quat(scalar_first=True)
    pose = Odometry(
        topic="/poses",
        t_ns=t_ns,
        p_frame_in_world=np.array([x, 0.0, 1.5]),
        q_world_frame=q,
        v_frame_in_world=still,
        angular_rate=still,
    )
    return pose, Depth(topic=camera.depth_topic, t_ns=t_ns, depth=depth)


def test_who_falls_is_named_and_the_interval_is_that_of_persons() -> None:
    persons = [labels("zhao_generality", seed) for seed in (1000, 1001)]
    results = [row(1000 + i, predicted) | persons[i // 2] for i, predicted in enumerate(["SA", "SA", "LG", "LG"])]
    results[1]["fell_at_s"] = 3.5
    result = experiment("zhao_generality").result(results)
    mean = result["summary"]["proposed"]["walks_accuracy_pct"]
    assert mean["over"] == len({(p["height_group"], p["member"]) for p in persons}) == 2
    assert mean["of"] == "persons"
    assert mean["ci95"] == pytest.approx(12.706 * 25.0 * math.sqrt(2.0) / math.sqrt(2.0), rel=1e-4)
    assert "walks that ended by a fall: 1001" in mode_results.overall_lines(result)


def test_sizes_that_were_not_seen_are_counted() -> None:
    errors_and_sds = [(0.002, 0.005), (0.1, 0.09), (math.nan, math.nan), (-0.002, 0.005)]
    approaches = [ScoredChange(mode="SD", is_detected=True, riser_m=e, riser_sd_m=sd) for e, sd in errors_and_sds]
    down = mode_figures([ModeScores(approaches=approaches)])["sizes"]["riser_mm"]["down"]
    assert down == {
        "seen_pct": 50.0,
        "rmse": pytest.approx(2.0),
        "all_rmse": pytest.approx(math.sqrt((100.0**2 + 8.0) / 3)),
    }


def test_steps_without_a_prediction_count() -> None:
    steps = [step("LG", "LG", 0.9), replace(step("LG", "", 0.9), probabilities=())]
    rows = {"steps": ModeScores(steps=steps).rows()["steps"], "alarms_pct": 0.0}
    study = experiment("mode_not_fooled")
    traps = [walk.labels["trap"] for walk in make_case(study, Path()).walks()]
    case = {"seed": 1000, "fell": [], "traps": {trap: dict.fromkeys(METHODS, rows) for trap in traps}}
    result = study.result([case])
    for of in result["summary"]["proposed"].values():
        assert (of["steps"], of["accuracy_pct"], of["predicted"]["LG"], of["predicted"][""]) == (2, 50.0, 1, 1)
    assert len(study.table(result)) == 3 + len(traps) == 10


def test_a_map_without_memory_knows_only_the_last_image() -> None:
    rig = standard_rig(replace(trial_config("zhao_view", "first"), sensors=("head_imu", "head_camera")))
    places = np.array([[1.5, 0.0], [3.0, 0.0]])
    known = {}
    for kind in (TerrainMap, SharedMap, ForgetfulMap):
        ground = kind(rig)
        for t_ns, x in ((0, 0.0), (1_000_000_000, 1.5)):
            for sample in floor_seen_from(rig, x, t_ns):
                ground.update(sample)
        known[kind] = np.isfinite(ground.heights(places)).tolist()
        assert ground.heights(places)[1] == pytest.approx(0.0, abs=0.01)
    assert known == {TerrainMap: [True, True], SharedMap: [True, True], ForgetfulMap: [False, True]}
