"""The closed-loop test of Zhao et al. 2023 (Table V): odometry drift when the walker returns to the start."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from stridetwin.estimators.dvio import MOUNTS
from stridetwin.reference.norms import read_reference
from stridetwin.studies.tables import table_lines
from stridetwin.studies.zhao2023.odometry_walks import FIGURES, mean, summarize_time


def collect(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Means by method over all walks and by mount, and the number of failures, beside the paper's figures."""
    summary: dict[str, Any] = {}
    for method in results[0]["methods"]:
        by_mount = {mount: [r["methods"][method] for r in results if r["mount"] == mount] for mount in MOUNTS}
        summary[method] = _summary([r["methods"][method] for r in results])
        summary[method]["by_mount"] = {mount: _summary(walks) for mount, walks in by_mount.items() if walks}
    summary["time_ms"] = summarize_time(r["methods"]["proposed"] for r in results)
    summary["walks_that_fell"] = sum(r["fell_at_s"] is not None for r in results)
    return {"summary": summary, "paper": read_paper_figures()}


def _summary(walks: list[dict[str, Any]]) -> dict[str, Any]:
    """Means of the figures over walks, largest drift and climb error, and the number of failures."""
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


def read_paper_figures() -> dict[str, Any]:
    """Table V of the paper by method: drift along x, y and z, and its norm where all three are reported."""
    drift_of_method: dict[str, Any] = {}
    for method, xyz in read_reference("zhao2023")["zhao_closed_loop_drift_m"].items():
        numbers = all(isinstance(value, int | float) for value in xyz)
        drift_of_method[method] = {"loop_drift_m": math.hypot(*xyz) if numbers else xyz[0], "loop_drift_xyz_m": xyz}
    return drift_of_method


_COLUMNS = (
    ("loop drift m", 14, "{loop_drift_m:.3f}"),
    ("largest m", 11, "{loop_drift_max_m:.3f}"),
    ("paper m", 9, "{paper:.2f}"),
    ("APE m", 8, "{ape_rmse_m:.3f}"),
    ("over 5 m %", 12, "{rpe_5m_pct:.2f}"),
    ("climb, largest mm", 19, "{climb_error_max_m!m:.0f}"),
    ("NEES in 95 %", 14, "{nees_within_95_pct:.0f}"),
    ("failed", 8, "{failures}"),
)


def table(result: dict[str, Any]) -> list[str]:
    """Each method's drift over all walks and by mount beside the paper's, as lines of text."""
    summary, paper_figures = result["summary"], result["paper"]
    time_ms = summary["time_ms"]
    rows = []
    for method in result["cases"][0]["methods"]:
        method_figures = summary[method]
        rows.append((method, {**method_figures, "paper": paper_figures.get(method, {}).get("loop_drift_m", "")}))
        rows += [
            (f"{'':<12}{mount}", {**figures, "paper": ""}) for mount, figures in method_figures["by_mount"].items()
        ]
    return [
        f"{len(result['cases'])} walks, {summary['walks_that_fell']} of them ended by a fall",
        f"proposed: {time_ms['mean']:.1f} ms per frame, 99th percentile {time_ms['p99']:.1f}",
        "",
        *table_lines(_COLUMNS, rows, 20),
    ]
