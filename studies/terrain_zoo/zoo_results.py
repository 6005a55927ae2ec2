"""Results of the zoo: by kind and over all, beside the published method; odometry on level walks; HTML page."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TypedDict

import numpy as np
from scipy.stats import binomtest

from stridetwin.estimators.locomotion_mode import METHODS
from stridetwin.outputs.modes.scores import ModeScores, ScoredMode, inside_pct, mode_figures, rms
from stridetwin.pages.html import page, section, text_block
from stridetwin.studies.result import CaseRow, Collected, Figures, NoPaper, Result
from stridetwin.studies.tables import table_lines
from stridetwin.studies.terrain_zoo.kinds import WALK_KINDS
from stridetwin.studies.zhao2023.mode_results import calibration_plot, confusion_lines, confusion_table, lead_plot
from stridetwin.studies.zhao2023.mode_walks import TimedModeRows

_SURE = 0.9  # a wrong prediction with a higher probability is sure and wrong
_OURS, _PUBLISHED = METHODS  # names of the predictor's two methods
_UNTUNED = "kinds that are not in the tuning set"  # label of the walks of these kinds
_ALL = "all"  # label of all walks


class ZooRow(CaseRow):
    """The row of a walk.

    Attributes:
        kind: Name of the kind of walk.
        mount: Body of the camera: head or chest.
        fell_at_s: When the walker fell; None without a fall.
        odometry: Figures of the odometry by name (`zoo_walk.odometry_figures`), and `mount_rad`.
        methods: Scores of the predicted modes, by method.
    """

    kind: str
    mount: str
    fell_at_s: float | None
    odometry: dict[str, float]
    methods: dict[str, TimedModeRows]


class ZooSummary(TypedDict):
    """Figures over walks.

    Attributes:
        groups: Figures of the modes (`_group_figures`), by kind of walk, and for `_ALL` and `_UNTUNED`.
        odometry: Figures of the odometry (`_odometry_figures`), by the same names.
        confusion: True mode to predicted mode to number of steps, of our method.
    """

    groups: dict[str, Figures]
    odometry: dict[str, Figures]
    confusion: dict[str, dict[str, int]]


ZooResult = Result[ZooSummary, NoPaper, ZooRow]


def collect(results: list[ZooRow]) -> Collected[ZooSummary, NoPaper]:
    """Figures of modes and odometry: over all walks, over the kinds outside the tuning set, and by kind."""
    # rows of each line of the table, by its label
    rows_of_line = {
        _ALL: list(results),
        _UNTUNED: [row for row in results if not WALK_KINDS[row["kind"]].tuned],
    }
    rows_of_line |= {name: [row for row in results if row["kind"] == name] for name in WALK_KINDS}
    return {
        "summary": {
            "groups": {name: _group_figures(rows) for name, rows in rows_of_line.items() if rows},
            "odometry": {name: _odometry_figures(rows) for name, rows in rows_of_line.items() if rows},
            "confusion": mode_figures(_scores_of_method(results, _OURS))["confusion"],
        },
        "paper": {},
    }


def _scores_of_method(rows: Iterable[ZooRow], method: str) -> list[ModeScores]:
    """The scores of a method on each walk, from the walks' rows."""
    return [ModeScores.of(row["methods"][method]) for row in rows]


def _group_figures(rows: list[ZooRow]) -> Figures:
    """Figures of our method over walks, and the published method's share of right steps."""
    walks = _scores_of_method(rows, _OURS)
    steps = [step for walk in walks for step in walk.steps]
    proposed, published = mode_figures(walks), mode_figures(_scores_of_method(rows, _PUBLISHED))
    right = sum(step.is_correct for step in steps)
    # 95 % interval of the share of right steps
    interval = binomtest(right, len(steps)).proportion_ci(0.95, method="wilson") if steps else None
    # error of the slope and its reported standard deviation, of the steps up (RA) and down (RD) a ramp
    slopes = [(s.slope_rad, s.slope_sd_rad) for s in steps if s.mode in ("RA", "RD")]
    slope_rms = rms([error for error, _ in slopes])
    return {
        "walks": len(rows),
        "steps": len(steps),
        "right_pct": proposed["accuracy_pct"],
        "strict_pct": proposed["strict_accuracy_pct"],
        "low_pct": None if interval is None else 100.0 * interval.low,
        "high_pct": None if interval is None else 100.0 * interval.high,
        "worst_pct": min(100.0 * sum(s.is_correct for s in w.steps) / max(len(w.steps), 1) for w in walks),
        "transitions": proposed["transitions"],
        "transitions_pct": proposed["transition_accuracy_pct"],
        "lead_median_s": proposed["lead_time_s"]["median"],
        "lead_p5_s": proposed["lead_time_s"]["p5"],
        "sure_and_wrong_pct": _sure_and_wrong_pct(steps),
        "calibration_error": proposed["calibration_error"],
        "slope_rms_deg": None if slope_rms is None else math.degrees(slope_rms),
        "slope_inside_pct": inside_pct(slopes),
        "riser_rms_mm": proposed["riser_rmse_mm"],
        "published_pct": published["accuracy_pct"],
    }


def _sure_and_wrong_pct(steps: Sequence[ScoredMode]) -> float | None:
    """Share of the steps whose predicted mode was wrong and had a probability above `_SURE`, %; None without steps."""
    wrong = [not s.is_correct and bool(s.probabilities) and max(s.probabilities) > _SURE for s in steps]
    return 100.0 * sum(wrong) / len(wrong) if wrong else None


def _odometry_figures(rows: list[ZooRow]) -> Figures:
    """Figures of the odometry over walks.

    Returns:
        Median and worst absolute error of the height at the end relative to the distance, %, of the tilt after 5 m,
        deg, and of the camera's mount on its IMU, deg; the mean share of time inside the reported 95 % bound, %.
    """
    rows_of_odometry = [row["odometry"] for row in rows]
    # one value per walk; a walk of less than 5 m has no tilt
    height = [100.0 * abs(o["end_height_m"]) / o["distance_m"] for o in rows_of_odometry]
    tilt = [math.degrees(o["tilt_rad"]) for o in rows_of_odometry if math.isfinite(o["tilt_rad"])]
    mount = [math.degrees(o["mount_rad"]) for o in rows_of_odometry if "mount_rad" in o]
    return {
        "height_median_pct": float(np.median(height)),
        "height_worst_pct": max(height),
        "tilt_median_deg": float(np.median(tilt)) if tilt else None,
        "tilt_worst_deg": max(tilt, default=None),
        "inside_pct": float(np.mean([o["inside_pct"] for o in rows_of_odometry])),
        "mount_median_deg": float(np.median(mount)) if mount else None,
        "mount_worst_deg": max(mount, default=None),
    }


# header, width, and format of a line's figures, of modes and of the odometry
_COLUMNS = (
    ("walks", 6, "{walks}"),
    ("steps", 7, "{steps}"),
    ("right %", 9, "{right_pct:.1f}"),
    ("95 %", 13, "{low_pct:.1f}-{high_pct:.1f}"),
    ("worst", 7, "{worst_pct:.0f}"),
    ("strict %", 10, "{strict_pct:.1f}"),
    ("transitions %", 15, "{transitions_pct:.1f}"),
    ("lead s, p5", 13, "{lead_median_s:.2f} {lead_p5_s:.2f}"),
    ("sure, wrong %", 15, "{sure_and_wrong_pct:.1f}"),
    ("calibration", 13, "{calibration_error:.3f}"),
    ("slope deg, in %", 17, "{slope_rms_deg:.2f} {slope_inside_pct:.0f}"),
    ("riser mm", 10, "{riser_rms_mm:.1f}"),
    ("published %", 13, "{published_pct:.1f}"),
)
_ODOMETRY = (
    ("height, median %", 18, "{height_median_pct:.2f}"),
    ("worst %", 9, "{height_worst_pct:.2f}"),
    ("tilt, median deg", 18, "{tilt_median_deg:.2f}"),
    ("worst deg", 11, "{tilt_worst_deg:.2f}"),
    ("inside 95 %", 13, "{inside_pct:.0f}"),
    ("mount, median deg", 19, "{mount_median_deg:.2f}"),
    ("worst deg", 11, "{mount_worst_deg:.2f}"),
)
_WIDTH = 46  # of the labels, characters


def table(result: ZooResult) -> list[str]:
    """Figures by kind, of the odometry, and the confusion matrix, as lines of text."""
    return [*overall_lines(result), "", *odometry_lines(result), "", *confusion_lines(result["summary"]["confusion"])]


def overall_lines(result: ZooResult) -> list[str]:
    """Figures of the modes by kind, as lines of text; `*` marks kinds outside the tuning set."""
    fell = [str(row["seed"]) for row in result["cases"] if row["fell_at_s"] is not None]
    rows = [(_label(name), figures) for name, figures in result["summary"]["groups"].items()]
    return [
        f"{len(result['cases'])} walks; walks that ended by a fall: {', '.join(fell) or 'none'}",
        "95 %: interval of the share, by Wilson, as if steps were independent; sure, wrong: p > 0.9 for a wrong mode",
        "strict: where either of two modes counts as right, only the true one",
        f"* {_UNTUNED}",
        *table_lines(_COLUMNS, rows, _WIDTH),
    ]


def odometry_lines(result: ZooResult) -> list[str]:
    """Figures of the odometry by kind, as lines of text."""
    rows = [(_label(name), figures) for name, figures in result["summary"]["odometry"].items()]
    return [
        "Odometry: height at the end relative to the distance; RMS tilt after 5 m; time inside the own 95 % bound;",
        "rotation of the camera's mount at the end, estimated and true",
        *table_lines(_ODOMETRY, rows, _WIDTH),
    ]


def _label(name: str) -> str:
    """Description of a kind of walk for a table, with * for kinds outside the tuning set."""
    if name not in WALK_KINDS:
        return name
    return WALK_KINDS[name].description + ("" if WALK_KINDS[name].tuned else " *")


def report(result: ZooResult) -> str:
    """The experiment as an HTML page."""
    cases, name = result["cases"], result["experiment"]
    steps = {m: [s for walk in _scores_of_method(cases, m) for s in walk.steps] for m in METHODS}
    sections = [
        section("By kind", "Steps predicted right, ours and the published method.", text_block(overall_lines(result))),
        section("Odometry", "Height and tilt of the camera's path.", text_block(odometry_lines(result))),
        section(
            "Confusion matrix",
            "Steps by true mode and by the last mode predicted before touch-down.",
            confusion_table(result["summary"]["confusion"]),
        ),
        section(
            "Lead time", "Time from the final correct prediction to touch-down; 0 where it was wrong.", lead_plot(steps)
        ),
        section(
            "Calibration",
            "Predicted probability and share of correct predictions, with the number of steps.",
            calibration_plot(steps[_OURS]),
        ),
    ]
    chips = [f"{len(cases)} walks", f"{len(steps[_OURS])} steps", f"{cases[0]['physics']} physics"]
    closing = "The results of every walk are in JSON files beside this page."
    return page(name.replace("_", " ").capitalize(), result["description"], chips, sections, closing)
