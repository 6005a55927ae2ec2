"""Kinds of walks, their sets, the odometry's figures, and the tables."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.estimators.locomotion_mode import METHODS
from stridetwin.outputs.modes.scores import ModeScores, ScoredMode
from stridetwin.sim.world.terrain import Terrain
from stridetwin.studies.experiment import experiment
from stridetwin.studies.terrain_zoo import zoo_walk
from stridetwin.studies.terrain_zoo.kinds import WALK_KINDS, draw_walk
from stridetwin.studies.terrain_zoo.zoo_results import report, table
from stridetwin.studies.terrain_zoo.zoo_walk import kinds_of


@pytest.mark.parametrize("name", WALK_KINDS)
def test_walks_of_a_kind_can_be_laid_out_and_differ(name: str) -> None:
    walks = [draw_walk(name, seed) for seed in range(12)]
    assert len({walk.person.height_m for walk in walks}) == len(walks)
    assert {walk.rig_mount for walk in walks} == {"head", "chest"}
    for walk in walks:
        assert 5.0 < Terrain.from_route(walk.route).profile[-1].s1 < 25.0
    assert draw_walk(name, 3) == walks[3]


def test_a_quarter_of_the_kinds_is_kept_from_tuning_and_the_sets_share_no_seed() -> None:
    reporting, tuning = (experiment(name).seeds for name in ("terrain_zoo", "terrain_zoo_tuning"))
    assert len(reporting) >= 200
    assert tuning[-1] < 1000 <= reporting[0]
    kept = [name for name, entry in WALK_KINDS.items() if not entry.tuned]
    assert len(kept) >= len(WALK_KINDS) / 4
    assert not set(kinds_of("tuned")) & set(kept)
    assert [len(seeds) % len(kinds_of(kinds)) for seeds, kinds in ((reporting, "all"), (tuning, "tuned"))] == [0, 0]
    assert kinds_of("level") == ["level"]


def test_tilt_is_the_angle_between_the_verticals_whatever_the_heading() -> None:
    rng = np.random.default_rng(4)
    true = Rotation.random(20, rng)
    axis = rng.standard_normal((20, 2))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    tilted = Rotation.from_rotvec(np.column_stack([0.02 * axis, np.zeros(20)])) * true
    turned = Rotation.from_euler("z", 0.7) * tilted
    found = zoo_walk._tilt_rad(turned.as_quat(scalar_first=True), true.as_quat(scalar_first=True))
    assert found == pytest.approx(np.full(20, 0.02), abs=1e-9)


def step(mode: str, predicted: str, p: float) -> ScoredMode:
    rest = (1.0 - p) / 4
    probabilities = tuple(p if m == predicted else rest for m in ("LG", "SA", "SD", "RA", "RD"))
    return ScoredMode(
        t_s=1.0,
        mode=mode,
        before="LG",
        predicted=predicted,
        allowed=(mode,),
        lead_s=2.0 * (mode == predicted),
        probabilities=probabilities,
    )


def row(kind: str, seed: int, predicted: str, slope_rad: float) -> dict:
    steps = [step("LG", "LG", 0.99), step("LG", predicted, 0.95), step("RA", "RA", 0.99), step("RA", "RA", 0.99)]
    steps[2:] = [replace(s, slope_rad=slope_rad, slope_sd_rad=math.radians(0.5)) for s in steps[2:]]
    scores = ModeScores(steps=steps).rows() | {"time_ms": 9.0}
    odometry = {"distance_m": 10.0, "end_height_m": -0.05, "tilt_rad": math.radians(0.4), "inside_pct": 90.0}
    return {
        "seed": seed,
        "physics": "kinematic",
        "kind": kind,
        "mount": "head",
        "fell_at_s": None,
        "odometry": odometry,
        "methods": dict.fromkeys(METHODS, scores),
    }


def test_figures_by_kind_and_of_the_kinds_kept_from_tuning() -> None:
    rows = [row("level", 1, "LG", 0.0), row("crest", 2, "RA", math.radians(2.0))]
    result = experiment("terrain_zoo").result(rows)
    groups = result["summary"]["groups"]
    assert groups["all"]["right_pct"] == 87.5
    assert groups["level"]["sure_and_wrong_pct"] == 0.0
    assert groups["crest"]["sure_and_wrong_pct"] == 25.0
    assert groups["crest"]["slope_inside_pct"] == 0.0
    assert groups["crest"]["slope_rms_deg"] == pytest.approx(2.0)
    assert groups["level"]["slope_inside_pct"] == 100.0
    kept = next(name for name in groups if name not in WALK_KINDS and name != "all")
    assert groups[kept] == groups["crest"]
    odometry = result["summary"]["odometry"]["level"]
    assert odometry["height_median_pct"] == pytest.approx(0.5)
    assert odometry["tilt_worst_deg"] == pytest.approx(0.4)
    lines = "\n".join(table(result))
    assert WALK_KINDS["crest"].description + " *" in lines
    assert "<h1" in report(result) or "<title" in report(result)
