"""The closed-loop test of Zhao et al. 2023 (Table V): odometry drift when the walker returns to the start.

The paper reports neither the length of its loop nor its calibration errors. Ours is 60 m with a stair up and down
(`zhao_loop`), walked once by each of the paper's fifteen subjects with the camera on the head and once on the chest;
the nominal calibration of camera and IMU has errors on every walk. `zhao_loop_stress` is the same loop with all
difficulties for an odometry at once. A closed loop hides wrong scale and extrinsics, so the error over 5 m is printed
as well.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from stridetwin.estimators.dvio import MOUNTS
from stridetwin.evaluation.norms import reference
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.wearer.anthropometry import PEOPLE
from stridetwin.studies.case import Case
from stridetwin.studies.walks import fell_at_s
from stridetwin.studies.zhao2023.odometry_walks import (
    FIGURES,
    METHODS,
    SENSORS,
    Maker,
    dvio,
    every_method,
    mean,
    recorded,
    worst_time,
)

SUBJECTS = tuple(name for name in PEOPLE if name.startswith("zhao_"))
SEEDS = range(1000, 1000 + len(SUBJECTS) * len(MOUNTS))
VARIANTS = {"zhao_closed_loop": (SEEDS, "zhao_loop"), "zhao_closed_loop_stress": (SEEDS, "zhao_loop_stress")}
"""By experiment: its seeds, and the first argument of `run_case`."""


def who_and_where(seed: int) -> tuple[str, str]:
    """Subject and camera mount: each subject with one mount, then each with the other."""
    turn, subject = divmod(seed - SEEDS[0], len(SUBJECTS))
    return SUBJECTS[subject], MOUNTS[turn % len(MOUNTS)]


def run_case(scenario: str, case: Case, make: Maker = dvio) -> dict[str, Any]:
    """One walk, by every method.

    Args:
        scenario: Name in the catalogue.
        case: Seed and options.
        make: Makes the odometries.

    Returns:
        `seed`, `physics`, `subject`, `mount`, `fell_at_s`, and `methods`: method to `odometry_walks.figures`.
    """
    subject, mount = who_and_where(case.seed)
    config = replace(
        load_scenario(scenario).config, sensors=SENSORS, physics=case.physics, person=PEOPLE[subject], rig_mount=mount
    )
    with recorded(config, case, mount) as recording:
        return {
            "seed": case.seed,
            "physics": case.physics,
            "subject": subject,
            "mount": mount,
            "fell_at_s": fell_at_s(recording),
            "methods": every_method(recording, mount, make),
        }


def collect(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Means by method over all walks and over those of each mount, and the number of failures; with the paper's."""
    summary: dict[str, Any] = {m: _summary([r["methods"][m] for r in results]) for m in METHODS}
    for method in METHODS:
        by_mount = {mount: [r["methods"][method] for r in results if r["mount"] == mount] for mount in MOUNTS}
        summary[method]["by_mount"] = {mount: _summary(walks) for mount, walks in by_mount.items() if walks}
    summary["time_ms"] = worst_time(r["methods"]["proposed"] for r in results)
    summary["walks_that_fell"] = sum(r["fell_at_s"] is not None for r in results)
    return {"summary": summary, "paper": paper()}


def _summary(walks: list[dict[str, Any]]) -> dict[str, Any]:
    ends = [np.abs(w["loop_drift_xyz_m"]) for w in walks if "loop_drift_xyz_m" in w]
    climbs = [w["climb_error_m"] for w in walks if w.get("climb_error_m") is not None]
    return {
        **{name: mean(walks, name) for name in FIGURES},
        "loop_drift_max_m": max((w["loop_drift_m"] for w in walks if "loop_drift_m" in w), default=None),
        "loop_drift_xyz_m": np.mean(ends, axis=0).tolist() if ends else None,
        "climb_error_max_m": max(climbs, default=None),
        "nees_within_95_pct": mean(walks, "nees_within_95_pct"),
        "failures": sum(bool(w["failure"]) for w in walks),
    }


def paper() -> dict[str, Any]:
    """Table V: drift along x, y and z, and its norm if reported."""
    drifts = reference("zhao2023")["zhao_closed_loop_drift_m"]
    told: dict[str, Any] = {}
    for method, xyz in drifts.items():
        numbers = all(isinstance(value, int | float) for value in xyz)
        told[method] = {"loop_drift_m": math.hypot(*xyz) if numbers else xyz[0], "loop_drift_xyz_m": xyz}
    return told


def table(result: dict[str, Any]) -> list[str]:
    """Each method and the paper, as lines of text; means over the walks."""
    summary, theirs = result["summary"], result["paper"]
    time_ms = summary["time_ms"]
    lines = [
        f"{len(result['cases'])} walks, {summary['walks_that_fell']} of them ended by a fall",
        f"proposed: {time_ms['mean']:.1f} ms a frame, 99th percentile {time_ms['p99']:.1f}",
        "",
        f"{'':<12}{'':<8}{'loop drift m':>14}{'largest m':>11}{'paper m':>9}{'APE m':>8}{'over 5 m %':>12}"
        f"{'climb, largest mm':>19}{'NEES in 95 %':>14}{'failed':>8}",
    ]
    for method in METHODS:
        for mount, own in {"": summary[method], **summary[method]["by_mount"]}.items():
            paper = theirs.get(method, {}).get("loop_drift_m", "") if not mount else ""
            climb = own["climb_error_max_m"]
            lines.append(
                f"{method if not mount else '':<12}{mount:<8}{_cell(own['loop_drift_m'], 14, 3)}"
                f"{_cell(own['loop_drift_max_m'], 11, 3)}{_cell(paper, 9, 2)}{_cell(own['ape_rmse_m'], 8, 3)}"
                f"{_cell(own['rpe_5m_pct'], 12, 2)}{_cell(None if climb is None else 1e3 * climb, 19, 0)}"
                f"{_cell(own['nees_within_95_pct'], 14, 0)}{own['failures']:>8}"
            )
    return lines


def _cell(value: float | str | None, width: int, digits: int) -> str:
    if value is None:
        return f"{'-':>{width}}"
    return f"{value:>{width}}" if isinstance(value, str) else f"{value:>{width}.{digits}f}"
