"""Visual-inertial odometry under injected faults, on the closed loop `zhao_loop`: one recording per seed.

A fault is tolerated (`borne`) if the drift is at most three times that without fault, or if the odometry reports that
it is lost and is healthy again at the end.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.studies.case import Case
from stridetwin.studies.fault_injection import by_fault, fault_table, read_cases
from stridetwin.studies.walks import recorded
from stridetwin.studies.zhao2023.odometry_walks import (
    FIGURES,
    SENSORS,
    Maker,
    figures,
    follow,
    mean,
    odometer,
    odometry_samples,
    true_path,
    worst_time,
)

SCENARIO, MOUNT = "zhao_loop", "head"
SEEDS = range(1000, 1003)
DRIFT_RATIO = 3.0
FAULTS = read_cases(__file__)
_COLUMNS = (
    ("loop drift m", 14, "{loop_drift_m:.3f}"),
    ("APE m", 9, "{ape_rmse_m:.3f}"),
    ("over 5 m %", 12, "{rpe_5m_pct:.2f}"),
    ("NEES in 95 %", 14, "{nees_within_95_pct:.0f}"),
    ("unhealthy s", 13, "{unhealthy_s:.1f}"),
    ("failed", 8, "{failures}"),
    ("tolerated", 11, "{borne}"),
    ("ms p99", 8, "{time_ms[p99]:.1f}"),
)


def run_case(case: Case, make: Maker = odometer) -> dict[str, Any]:
    """One walk, with each fault.

    Returns:
        `seed`, `physics`, and `faults`: name to `odometry_walks.figures`.
    """
    config = replace(load_scenario(SCENARIO).config, sensors=SENSORS, physics=case.physics, rig_mount=MOUNT)
    with recorded(config, case, MOUNT) as recording:
        truth, found = true_path(recording, MOUNT), {}
        for name, fault in FAULTS.items():
            plan = fault.plan(recording.rig, case.seed, recording.duration)
            samples = plan.samples(odometry_samples(recording, MOUNT))
            found[name] = figures(follow(make("proposed", plan.rig, MOUNT), samples), truth)
    return case.row(faults=found)


def collect(results: list[dict[str, Any]]) -> dict[str, Any]:
    """By fault, means over the walks; `borne` counts the walks that tolerate it."""
    nominal = [r["faults"]["none"] for r in results]

    def fault_figures(walks: list[dict[str, Any]]) -> dict[str, Any]:
        return {
            **{figure: mean(walks, figure) for figure in (*FIGURES, "unhealthy_s", "nees_within_95_pct")},
            "failures": sum(bool(w["failure"]) for w in walks),
            "borne": sum(map(_tolerated, walks, nominal)),
            "time_ms": worst_time(walks),
        }

    return by_fault(FAULTS, results, fault_figures)


def _tolerated(walk: dict[str, Any], nominal: dict[str, Any]) -> bool:
    if walk["failure"] == "lost":
        return bool(walk["recovered"])
    if walk["failure"] or "loop_drift_m" not in nominal:
        return False
    return bool(walk["loop_drift_m"] <= DRIFT_RATIO * nominal["loop_drift_m"])


def table(result: dict[str, Any]) -> list[str]:
    """As lines of text; means over the walks."""
    head = f"{len(result['cases'])} walks of {SCENARIO}; tolerated: at most {DRIFT_RATIO:g} times the drift without "
    return [head + "the fault, or a loss reported and recovered", *fault_table(FAULTS, result["summary"], _COLUMNS, 42)]
