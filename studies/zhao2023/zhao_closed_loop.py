"""The closed-loop test of Zhao et al. 2023 (Table V): odometry drift when the walker returns to the start."""

from __future__ import annotations

import math
from typing import TypedDict

import numpy as np

from stridetwin.estimators.dvio import MOUNTS
from stridetwin.reference.norms import read_reference
from stridetwin.studies.result import Collected, Figures, LabelledFigures, Result, Summary, get_figures
from stridetwin.studies.tables import table_lines
from stridetwin.studies.zhao2023.odometry_walks import FIGURES, OdometryFigures, OdometryRow, mean, summarize_time


class PaperDrift(TypedDict):
    """A method's drift in the paper; texts, such as `>10`, where no number is reported.

    Attributes:
        loop_drift_m: Norm of the three, or the first of them if they are texts.
        loop_drift_xyz_m: Along x, y and z.
    """

    loop_drift_m: float | str
    loop_drift_xyz_m: list[float] | list[str]


def collect(results: list[OdometryRow]) -> Collected[Summary, dict[str, PaperDrift]]:
    """Means by method over all walks and by mount, and the number of failures, beside the paper's figures."""
    summary: Summary = {}
    for method in results[0]["methods"]:
        by_mount = {mount: [r["methods"][method] for r in results if r["mount"] == mount] for mount in MOUNTS}
        summary[method] = {
            **_drift_over_walks([r["methods"][method] for r in results]),
            "by_mount": {mount: _drift_over_walks(walks) for mount, walks in by_mount.items() if walks},
        }
    summary["time_ms"] = summarize_time(r["methods"]["proposed"] for r in results)
    summary["walks_that_fell"] = sum(r["fell_at_s"] is not None for r in results)
    return {"summary": summary, "paper": read_paper_figures()}


def _drift_over_walks(walks: list[OdometryFigures]) -> Figures:
    """Means of the figures over walks, largest drift and climb error, and the number of walks that failed.

    A walk counts only for the figures that it has; a figure that none has is None.
    """
    # (3,) absolute drift along x, y, z of each walk with one, m
    ends = [np.abs(w["loop_drift_xyz_m"]) for w in walks if "loop_drift_xyz_m" in w]
    climbs = [climb for w in walks if (climb := w.get("climb_error_m")) is not None]
    return {
        **{name: mean(walks, name) for name in FIGURES},
        "loop_drift_max_m": max((w["loop_drift_m"] for w in walks if "loop_drift_m" in w), default=None),
        "loop_drift_xyz_m": np.mean(ends, axis=0).tolist() if ends else None,
        "climb_error_max_m": max(climbs, default=None),
        "nees_within_95_pct": mean(walks, "nees_within_95_pct"),
        "failures": sum(bool(w["failure"]) for w in walks),
    }


def read_paper_figures() -> dict[str, PaperDrift]:
    """Table V of the paper by method: drift along x, y and z, and its norm, or a text such as `>10` in its place."""
    drift_of_method: dict[str, PaperDrift] = {}
    for method, xyz in read_reference("zhao2023")["zhao_closed_loop_drift_m"].items():
        numbers = [value for value in xyz if isinstance(value, int | float)]
        # where a value is a text, such as `>10`, the first one stands for the norm
        norm_m = math.hypot(*numbers) if len(numbers) == len(xyz) else xyz[0]
        drift_of_method[method] = {"loop_drift_m": norm_m, "loop_drift_xyz_m": xyz}
    return drift_of_method


# header, width, and format of a method's figures
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


def table(result: Result[Summary, dict[str, PaperDrift], OdometryRow]) -> list[str]:
    """Each method's drift over all walks and by mount beside the paper's, as lines of text."""
    summary, paper_figures = result["summary"], result["paper"]
    time_ms = get_figures(summary, "time_ms")
    rows: list[LabelledFigures] = []
    for method in result["cases"][0]["methods"]:
        method_figures = get_figures(summary, method)
        paper_drift = paper_figures[method]["loop_drift_m"] if method in paper_figures else ""
        rows.append((method, {**method_figures, "paper": paper_drift}))
        by_mount = get_figures(method_figures, "by_mount")
        rows += [(f"{'':<12}{mount}", {**get_figures(by_mount, mount), "paper": ""}) for mount in by_mount]
    return [
        f"{len(result['cases'])} walks, {summary['walks_that_fell']} of them ended by a fall",
        f"proposed: {time_ms['mean']:.1f} ms per frame, 99th percentile {time_ms['p99']:.1f}",
        "",
        *table_lines(_COLUMNS, rows, 20),
    ]
