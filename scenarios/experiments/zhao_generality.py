"""The generality test of Zhao et al. 2023 (Tables II and III): what the next step is, over 540 walks.

Five groups of height, six terrains, the camera on head or chest, three patterns of walking: 180 conditions, three walks
each, one by each member of the group. Every walk goes level, up, level, down, level; where the paper is silent on the
terrain, `reference/zhao2023.yaml` says what is taken. The gaze wanders. Poses come from the visual-inertial odometry,
or are given: then they are the true ones.

The order of the walks is such that any sixty in a row hold every terrain, mount and group alike, and the first
sixty, the second sixty, ... the patterns too.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from stridetwin.estimators.locomotion_mode import METHODS, MODES, LocomotionMode, ModeEstimate
from stridetwin.estimators.terrain_map import TerrainEstimate, TerrainMap
from stridetwin.scenarios.experiments.case import Case
from stridetwin.scenarios.experiments.odometry_walks import HEALTHY, dvio, recorded
from stridetwin.scenarios.experiments.walks import fell_at_s
from stridetwin.scenarios.ground import from_metadata
from stridetwin.scenarios.mode_files import INSOLES
from stridetwin.scenarios.mode_score import Laid, ModeScores, mode_figures, score_modes
from stridetwin.scenarios.norms import reference, reference_rows
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.scenarios.terrain_files import depth_camera, given_poses, matrix_sample, posed_depth
from stridetwin.scenarios.truth import TruePath
from stridetwin.sim.body import wearer
from stridetwin.sim.config import Gait, Gaze
from stridetwin.sim.people import PEOPLE
from stridetwin.streams.recording import Recording
from stridetwin.streams.samples import Depth, Image, Imu, Insole, Odometry, Sample
from stridetwin.streams.trajectory import Trajectory

TERRAINS = {
    "stair_15cm": "zhao_stair_15cm",
    "stair_20cm": "zhao_stair_20cm",
    "stair_25cm": "zhao_stair_25cm",
    "ramp_11.8deg": "zhao_ramp_11_8",
    "ramp_15.8deg": "zhao_ramp_15_8",
    "ramp_17.8deg": "zhao_ramp_17_8",
}
"""The paper's terrains and the scenarios that have them."""
PATTERNS = ("wander", "walk", "jog")
MOUNTS = ("head", "chest")
GROUPS = ("I", "II", "III", "IV", "V")
POSES = ("dvio", "given")
SEEDS = range(1000, 1000 + 9 * len(TERRAINS) * len(MOUNTS) * len(GROUPS))
SENSORS = ("insole", "head_imu", "head_camera")
_BLOCK = len(TERRAINS) * len(MOUNTS) * len(GROUPS)


@dataclass(frozen=True, kw_only=True)
class Condition:
    """What a walk is: as the columns of Table II name it."""

    height_group: str
    pattern: str
    terrain: str
    mount: str
    member: int


def condition(seed: int) -> Condition:
    """The condition of a seed; those below the first go through them alike."""
    i = (seed - SEEDS[0]) % len(SEEDS)
    turn, place = divmod(i, _BLOCK)
    terrain, mount, group = place % 6, place // 6 % 2, place // 12
    return Condition(
        height_group=GROUPS[group],
        pattern=PATTERNS[(terrain + group + mount + turn) % 3],
        terrain=list(TERRAINS)[terrain],
        mount=MOUNTS[mount],
        member=1 + (turn // 3 + group + terrain) % 3,
    )


def run_case(poses: str, case: Case) -> dict[str, Any]:
    """One walk, by both methods.

    Args:
        poses: Of `POSES`.
        case: Which seed, and how.

    Returns:
        `seed`, `physics`, `fell_at_s`, the condition, and `methods`: method to `steps`, `approaches` and `time_ms`.
    """
    which = condition(case.seed)
    config = load_scenario(TERRAINS[which.terrain]).config
    person = PEOPLE[f"zhao_{which.height_group.lower()}_{which.member}"]
    gait = Gait.of_pattern(which.pattern, gaze=Gaze(kind="wandering"))
    config = replace(
        config, sensors=SENSORS, physics=case.physics, person=person, exo=None, rig_mount=which.mount, gait=gait
    )
    with recorded(config, case, which.mount) as recording:
        return {
            "seed": case.seed,
            "physics": case.physics,
            "fell_at_s": fell_at_s(recording),
            **vars(which),
            "methods": predicted(recording, which.mount, poses, wearer(person, with_exo=False).body.shoe_length_m),
        }


class SharedMap(TerrainMap):
    """A map that several predictors feed with the same samples: it takes each once."""

    _last: Sample | None = None
    _told: TerrainEstimate | None = None

    def update(self, sample: Sample) -> TerrainEstimate | None:
        """As `TerrainMap.update`; the same sample again tells the same."""
        if sample is not self._last:
            self._told, self._last = super().update(sample), sample
        return self._told


def predicted(recording: Recording, mount: str, poses: str, sole_m: float) -> dict[str, dict[str, Any]]:
    """By method: rows of the scored steps and changes, and time a depth picture, ms; ours comes first, with the map.

    Args:
        recording: Of the walk.
        mount: Where the camera sits.
        poses: Of `POSES`.
        sole_m: Length of the walker's soles.
    """
    camera = depth_camera(recording.rig)
    topic, place = given_poses(recording, camera)
    ground = SharedMap(recording.rig, mount=place)
    predictors = {m: LocomotionMode(ground, camera, mount=place, method=m) for m in METHODS}
    estimates: dict[str, list[ModeEstimate]] = {m: [] for m in METHODS}
    frame_ms: dict[str, list[float]] = {m: [] for m in METHODS}
    told: list[Odometry] = []
    for sample in posed(recording, mount, poses):
        if isinstance(sample, Odometry):
            told.append(sample)
        for method, predictor in predictors.items():
            began = time.process_time()
            estimate = predictor.update(sample)
            own = 1e3 * (time.process_time() - began)
            if isinstance(sample, Depth):
                frame_ms[method].append(own)
            if estimate is not None:
                estimates[method].append(estimate)
    truth = TruePath.of(recording.block(topic))
    path = _trajectory([o for o in told if truth.t_ns[0] <= o.t_ns <= truth.t_ns[-1]])
    laid = Laid(path, truth.at(path.t_ns))
    footprints, layout = list(recording.block("/truth/footprints")), from_metadata(recording.metadata)
    rows = {}
    for method in METHODS:
        scores = score_modes(footprints, estimates[method], laid, layout, sole_m)
        rows[method] = {
            **scores.rows(),
            "time_ms": {"mean": float(np.mean(frame_ms[method])), "p95": float(np.percentile(frame_ms[method], 95))},
        }
    return rows


def posed(recording: Recording, mount: str, poses: str) -> Iterator[Sample]:
    """Poses of the camera's IMU, depth and insoles in order of time."""
    camera = depth_camera(recording.rig)
    if poses == "given":
        yield from posed_depth(recording, camera, more=INSOLES)[1]
        return
    odometer = dvio("stridetwin", recording.rig, mount)
    for sample in recording.samples([f"/{mount}/imu", camera.topic, *INSOLES, camera.depth_topic]):
        if isinstance(sample, Imu | Image | Depth):
            estimate = odometer.update(sample)
            if estimate is not None and estimate.health in HEALTHY:
                yield matrix_sample(estimate.t_ns, estimate.T_world_imu)
        if isinstance(sample, Depth | Insole):
            yield sample


def _trajectory(path: list[Odometry]) -> Trajectory:
    return Trajectory(
        t_ns=np.array([o.t_ns for o in path], np.int64),
        p_frame_in_world=np.array([o.p_frame_in_world for o in path]),
        q_world_frame=np.array([o.q_world_frame for o in path]),
    )


def collect(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Figures by method over all walks, by condition and cell; the paper's beside."""
    summary: dict[str, Any] = {}
    for method in METHODS:
        walks = [(r, ModeScores.of(r["methods"][method])) for r in results]
        shares = [_share(w) for _, w in walks]
        accuracy = {"mean": float(np.mean(shares)), "sd": float(np.std(shares)), "ci95": _interval(shares)}
        summary[method] = mode_figures([w for _, w in walks]) | {
            "accuracy_pct": accuracy,
            "accuracy_by_condition_pct": {
                name: found for name in conditions() if (found := _mean(walks, name)) is not None
            },
            "cells_pct": _cells(walks),
        }
    times = [r["methods"]["stridetwin"]["time_ms"] for r in results]
    summary["time_ms"] = {"mean": float(np.mean([t["mean"] for t in times])), "p95": max(t["p95"] for t in times)}
    return {"summary": summary, "paper": paper()}


def conditions() -> dict[str, tuple[str, tuple[str, ...]]]:
    """Rows of Table III: name to the key of a case and its values; the groups besides."""
    stairs, ramps = (tuple(t for t in TERRAINS if t.startswith(kind)) for kind in ("stair", "ramp"))
    return {
        **{t: ("terrain", (t,)) for t in TERRAINS},
        "stairs": ("terrain", stairs),
        "ramps": ("terrain", ramps),
        **{p: ("pattern", (p,)) for p in PATTERNS},
        **{m: ("mount", (m,)) for m in MOUNTS},
        **{f"group_{g}": ("height_group", (g,)) for g in GROUPS},
    }


def _share(walk: ModeScores) -> float:
    return 100.0 * sum(s.right for s in walk.steps) / max(len(walk.steps), 1)


def _interval(shares: list[float]) -> float:
    """Half of the 95 % confidence interval of the mean."""
    return float(1.96 * np.std(shares, ddof=1) / np.sqrt(len(shares))) if len(shares) > 1 else 0.0


def _mean(walks: list[tuple[dict[str, Any], ModeScores]], name: str) -> float | None:
    key, values = conditions()[name]
    shares = [_share(w) for r, w in walks if r[key] in values]
    return float(np.mean(shares)) if shares else None


def _cells(walks: list[tuple[dict[str, Any], ModeScores]]) -> dict[str, float]:
    found: dict[str, list[float]] = {}
    for r, w in walks:
        found.setdefault(_cell_name(r), []).append(_share(w))
    return {name: float(np.mean(shares)) for name, shares in sorted(found.items())}


def _cell_name(row: dict[str, Any]) -> str:
    return " ".join(str(row[k]) for k in ("height_group", "pattern", "terrain", "mount"))


@cache
def table_2() -> dict[str, float]:
    """Table II of the paper by cell, %."""
    return {_cell_name(row): float(row["accuracy_pct"]) for row in reference_rows("zhao2023_table2")}


def paper() -> dict[str, Any]:
    """Accuracy of the paper: all walks, by condition (Table III), by cell (Table II)."""
    told = reference("zhao2023")
    return {
        "published": {
            "accuracy_pct": told["generality"]["accuracy_pct"],
            "accuracy_by_condition_pct": {k: v[0] for k, v in told["accuracy_by_condition_pct"].items()},
            "cells_pct": table_2(),
        },
        "time_ms": told["time_ms"],
    }


def table(result: dict[str, Any]) -> list[str]:
    """Tables III and II beside the paper, and the confusion matrix, as lines of text."""
    summary, theirs = result["summary"], result["paper"]["published"]
    ours, published = summary["stridetwin"], summary["published"]
    time_ms = summary["time_ms"]
    lines = [
        f"{len(result['cases'])} walks, {ours['steps']} steps, {ours['transitions']} of them transitions; "
        f"{time_ms['mean']:.1f} ms a depth picture, 95th percentile {time_ms['p95']:.1f}",
        "",
        f"{'':<26}{'stridetwin':>12}{'published':>12}{'paper':>9}",
        *(
            f"{words:<26}{_cell(ours[key]['mean'] if key == 'accuracy_pct' else ours[key])}"
            f"{_cell(published[key]['mean'] if key == 'accuracy_pct' else published[key])}"
            f"{_cell(theirs['accuracy_pct']['mean'], 9) if key == 'accuracy_pct' else ''}"
            for words, key in (
                ("accuracy %", "accuracy_pct"),
                ("strict %", "strict_accuracy_pct"),
                ("straddling %", "straddling_pct"),
                ("transitions %", "transition_accuracy_pct"),
            )
        ),
        *(
            f"{'lead s, ' + words:<26}{_cell(ours['lead_time_s'][key])}{_cell(published['lead_time_s'][key])}"
            for words, key in (("median", "median"), ("5th percentile", "p5"))
        ),
        f"95 % interval of the mean: ± {ours['accuracy_pct']['ci95']:.2f}",
        "",
        "Table III",
    ]
    for name in conditions():
        if name in ours["accuracy_by_condition_pct"]:
            lines.append(
                f"{name:<26}{_cell(ours['accuracy_by_condition_pct'][name])}"
                f"{_cell(published['accuracy_by_condition_pct'][name])}"
                f"{_cell(theirs['accuracy_by_condition_pct'].get(name), 9)}"
            )
    lines += ["", "Table II"]
    lines += [
        f"{name:<34}{_cell(value, 8)}{_cell(published['cells_pct'][name])}{_cell(theirs['cells_pct'].get(name), 9)}"
        for name, value in ours["cells_pct"].items()
    ]
    lines += ["", f"{'true / told':<12}" + "".join(f"{m:>7}" for m in MODES)]
    lines += [f"{true:<12}" + "".join(f"{row[m]:>7}" for m in MODES) for true, row in ours["confusion"].items()]
    return lines


def _cell(value: float | None, width: int = 12) -> str:
    return f"{'-':>{width}}" if value is None else f"{value:>{width}.2f}"
