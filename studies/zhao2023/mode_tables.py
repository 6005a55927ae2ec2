"""Summary of walks with predicted steps, and the figures of Zhao et al. 2023."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from scipy.stats import t as student_t

from stridetwin.estimators.locomotion_mode import MODES
from stridetwin.evaluation.mode_scores import ModeScores, mode_figures
from stridetwin.evaluation.norms import reference, reference_rows
from stridetwin.studies.zhao2023.mode_walks import EDGES, FORGETFUL, GROUPS, MOUNTS, together
from stridetwin.studies.zhao2023.zhao_generality import PATTERNS, TERRAINS
from stridetwin.studies.zhao2023.zhao_trials import TRIALS

Walk = tuple[dict[str, Any], ModeScores]
WORDS = {"proposed": "proposed", "published": "published", FORGETFUL: "one picture"}
"""Column headers of the methods."""
QUANTITIES = {"camera_pitch_rad": "camera pitch rad", "speed_mps": "speed m/s"}
_ACCURACIES = (
    ("accuracy %", ("walks_accuracy_pct", "mean")),
    ("strict %", ("walks_strict_accuracy_pct", "mean")),
    ("steps right %", ("accuracy_pct",)),
    ("strictly %", ("strict_accuracy_pct",)),
    ("straddling %", ("straddling_pct",)),
    ("transitions %", ("transition_accuracy_pct",)),
)
"""The first two are means over walks, as in the paper; the others are shares of all steps."""
_AHEAD = (
    ("changes found %", ("changes_found_pct",), 1.0),
    ("stairs, ramps found %", ("begins_found_pct",), 1.0),
    ("distance to stairs mm, median", ("distance_median_mm", "stairs"), 1.0),
    ("distance to ramps mm, median", ("distance_median_mm", "ramps"), 1.0),
    ("sizes inside 95 %", ("inside_95_pct",), 1.0),
    ("distances inside 95 %", ("distance_inside_95_pct",), 1.0),
    ("next footprint mm, steady", ("footprint_steady_rmse_m", "forward"), 1e3),
    ("calibration error, points of %", ("calibration_error",), 100.0),
)
_NAME = 34
_CELL = ("height_group", "pattern", "terrain", "mount")
_WHO = ("height_group", "member", "subject")
"""Keys of a row that identify the walker."""


def collect(name: str, results: list[dict[str, Any]]) -> dict[str, Any]:
    """Figures by method over all walks, by condition and cell; with the paper's.

    Args:
        name: Of the experiment.
        results: One per walk.
    """
    summary: dict[str, Any] = {}
    for method in results[0]["methods"]:
        walks = [(r, ModeScores.of(r["methods"][method])) for r in results]
        cells = _cells(walks)
        summary[method] = mode_figures([w for _, w in walks]) | {
            "walks_accuracy_pct": _mean(results, [_share(w) for _, w in walks])
            | ({"sd_of_cells": float(np.std(list(cells.values())))} if len(cells) > 1 else {}),
            "walks_strict_accuracy_pct": _mean(results, [_share(w, strict=True) for _, w in walks]),
            "accuracy_by_condition_pct": _by_condition(walks),
            "cells_pct": cells,
        }
    times = [next(iter(r["methods"].values()))["time_ms"] for r in results]
    summary["time_ms"] = {"mean": float(np.mean([t["mean"] for t in times])), "p95": max(t["p95"] for t in times)}
    summary["spread"] = {q: together([r["spread"][q] for r in results]) for q in EDGES}
    return {"summary": summary, "paper": paper(name)}


def conditions() -> dict[str, tuple[str, tuple[str, ...]]]:
    """Rows of Table III: name to the key of a case and its values; also the groups."""
    stairs, ramps = (tuple(t for t in TERRAINS if t.startswith(kind)) for kind in ("stair", "ramp"))
    return {
        **{t: ("terrain", (t,)) for t in TERRAINS},
        "stairs": ("terrain", stairs),
        "ramps": ("terrain", ramps),
        **{p: ("pattern", (p,)) for p in PATTERNS},
        **{m: ("mount", (m,)) for m in MOUNTS},
        **{f"group_{g}": ("height_group", (g,)) for g in GROUPS},
    }


def _share(walk: ModeScores, *, strict: bool = False) -> float:
    """Share of its steps that are right, %."""
    return 100.0 * sum(s.strictly_right if strict else s.right for s in walk.steps) / max(len(walk.steps), 1)


def _mean(rows: Sequence[dict[str, Any]], shares: Sequence[float]) -> dict[str, Any]:
    """Mean and standard deviation over walks, and half of the mean's 95 % interval.

    Walks of one person are not independent: the interval is Student's over the persons' means, or over walks if the
    walker is unknown.
    """
    of: dict[Any, list[float]] = {}
    is_told = any(k in rows[0] for k in _WHO)
    for row, share in zip(rows, shares):
        of.setdefault(tuple(row[k] for k in _WHO if k in row) if is_told else row["seed"], []).append(share)
    means = [float(np.mean(own)) for own in of.values()]
    n = len(means)
    half = float(student_t.ppf(0.975, n - 1) * np.std(means, ddof=1) / math.sqrt(n)) if n > 1 else None
    return {
        "mean": float(np.mean(shares)),
        "sd": float(np.std(shares)),
        "ci95": half,
        "over": n,
        "of": "persons" if is_told else "walks",
    }


def _by_condition(walks: Sequence[Walk]) -> dict[str, float]:
    """Accuracy by row of `conditions`, if any walk has it."""
    shares = {name: [_share(w) for r, w in walks if r.get(k) in values] for name, (k, values) in conditions().items()}
    return {name: float(np.mean(found)) for name, found in shares.items() if found}


def _cells(walks: Sequence[Walk]) -> dict[str, float]:
    """Accuracy by cell of Table II, over walks that belong to one."""
    found: dict[str, list[float]] = {}
    for r, w in walks:
        if all(k in r for k in _CELL):
            found.setdefault(_cell_name(r), []).append(_share(w))
    return {name: float(np.mean(shares)) for name, shares in sorted(found.items())}


def _cell_name(row: dict[str, Any]) -> str:
    return " ".join(str(row[k]) for k in _CELL)


@cache
def table_2() -> dict[str, float]:
    """Table II of the paper by cell, %."""
    return {_cell_name(row): float(row["accuracy_pct"]) for row in reference_rows("zhao2023_table2")}


def paper(name: str) -> dict[str, Any]:
    """Accuracy of the paper: all walks, by condition (Table III), by cell (Table II); its Figure 4; its time.

    Args:
        name: Of the experiment.
    """
    told = reference("zhao2023")
    if name in TRIALS:
        published = {"accuracy_pct": told[TRIALS[name].paper], "accuracy_by_condition_pct": {}, "cells_pct": {}}
        return {"published": published, "time_ms": told["time_ms"]}
    generality = told["generality"]
    published = {
        "accuracy_pct": generality["accuracy_pct"],
        "accuracy_by_condition_pct": {k: v[0] for k, v in told["accuracy_by_condition_pct"].items()},
        "cells_pct": table_2(),
    }
    return {"published": published, "time_ms": told["time_ms"], "spread": {q: generality[q] for q in EDGES}}


def table(result: dict[str, Any]) -> list[str]:
    """Tables III and II with the paper's, Figure 4, and the confusion matrix, as lines of text."""
    blocks = [overall(result), [*ahead(result), "", *spreads(result)], confusion(result)]
    if len(by_condition(result)) > 1:
        blocks[1:1] = [[conditions_title(result), *by_condition(result)]]
    if by_cell(result):
        blocks[-2:-2] = [["Table II", *by_cell(result)]]
    return "\n\n".join("\n".join(block) for block in blocks).split("\n")


def overall(result: dict[str, Any]) -> list[str]:
    """Number of walks and steps, accuracy and lead time."""
    summary, theirs = result["summary"], result["paper"]["published"]["accuracy_pct"]
    columns, time_ms = methods(result), summary["time_ms"]
    ours, mean = summary[columns[0]], summary[columns[0]]["walks_accuracy_pct"]
    fell = [str(case["seed"]) for case in result["cases"] if case["fell_at_s"] is not None]
    cells = f"± {mean['sd_of_cells']:.2f} from cell to cell (as the paper's ±), " if "sd_of_cells" in mean else ""
    half = "" if mean["ci95"] is None else f"; 95 % interval of the mean ± {mean['ci95']:.2f}"
    return [
        f"{len(result['cases'])} walks, {ours['steps']} steps, {ours['transitions']} of them transitions",
        f"walks that ended by a fall: {', '.join(fell) or 'none'}",
        f"map and prediction without odometry: {time_ms['mean']:.1f} ms of processor a depth picture in the mean of "
        f"the walks, 95th percentile {time_ms['p95']:.1f} on the slowest walk",
        "",
        _head(result),
        *(
            f"{words:<{_NAME}}"
            + "".join(_cell(_at(summary[m], keys)) for m in columns)
            + (f"{_cell(theirs['mean'], 9)} ± {theirs['sd']:.2f}" if keys == _ACCURACIES[0][1] else "")
            for words, keys in _ACCURACIES
        ),
        *(
            f"{words + {'median': ', median', 'p5': ', 5th percentile'}[key]:<{_NAME}}"
            + "".join(_cell(summary[m][lead][key]) for m in columns)
            for words, lead in (("lead s", "lead_time_s"), ("of transitions s", "transition_lead_time_s"))
            for key in ("median", "p5")
        ),
        "accuracy and strict are means of the walks, the others shares of all steps",
        f"{columns[0]}: {cells}± {mean['sd']:.2f} from walk to walk{half}, over {mean['over']} {mean['of']}",
    ]


def ahead(result: dict[str, Any]) -> list[str]:
    """Our estimates of terrain changes 1.5 s before a foot landed beyond them, and of the next footprint."""
    ours = result["summary"][methods(result)[0]]
    return [
        f"1.5 s before: {ours['changes']} changes",
        *(f"{words:<{_NAME}}{_cell(_at(ours, keys, factor))}" for words, keys, factor in _AHEAD),
        "",
        f"{'':<{_NAME}}{'seen %':>12}{'RMS of those':>16}{'RMS of all told':>18}",
        *(
            f"{size.replace('_', ' ') + ', ' + way:<{_NAME}}{_cell(own['seen_pct'])}{_cell(own['rmse'], 16)}"
            f"{_cell(own['all_rmse'], 18)}"
            for size, ways in ours["sizes"].items()
            for way, own in ways.items()
        ),
    ]


def _at(figures: Any, keys: tuple[str, ...], factor: float = 1.0) -> float | None:
    for key in keys:
        figures = figures[key]
    return None if figures is None else factor * float(figures)


def conditions_title(result: dict[str, Any]) -> str:
    """Title of the accuracy by condition."""
    return "Table III" if result["paper"]["published"]["accuracy_by_condition_pct"] else "By mount and group"


def by_condition(result: dict[str, Any]) -> list[str]:
    """Accuracy by condition, %."""
    summary, theirs = result["summary"], result["paper"]["published"]["accuracy_by_condition_pct"]
    names = [name for name in conditions() if name in summary[methods(result)[0]]["accuracy_by_condition_pct"]]
    return _rows(result, "accuracy_by_condition_pct", names, theirs)


def by_cell(result: dict[str, Any]) -> list[str]:
    """Accuracy by cell, %."""
    cells = result["summary"][methods(result)[0]]["cells_pct"]
    return _rows(result, "cells_pct", list(cells), result["paper"]["published"]["cells_pct"])


def spreads(result: dict[str, Any]) -> list[str]:
    """Figure 4: camera pitch (down positive) and speed of the walks."""
    ours, theirs = result["summary"]["spread"], result["paper"].get("spread", {})
    return [
        f"{'Figure 4, of the truth':<{_NAME}}{'mean':>8}{'sd':>8}{'min':>8}{'max':>8}",
        *(
            f"{words if who == 'ours' else '  paper':<{_NAME}}"
            + "".join(f"{spread[k]:>8.2f}" for k in ("mean", "sd", "min", "max"))
            for quantity, words in QUANTITIES.items()
            for who, spread in (("ours", ours[quantity]), ("paper", theirs.get(quantity)))
            if spread is not None
        ),
    ]


def confusion(result: dict[str, Any]) -> list[str]:
    """Steps of our method by true and predicted mode."""
    counts = result["summary"][methods(result)[0]]["confusion"]
    lines = [f"{'true / told':<12}" + "".join(f"{m:>7}" for m in MODES) + f"{'nothing':>9}"]
    return lines + [
        f"{true:<12}" + "".join(f"{row[m]:>7}" for m in MODES) + f"{row['']:>9}" for true, row in counts.items()
    ]


def methods(result: dict[str, Any]) -> list[str]:
    """Methods of a result; ours first."""
    return [m for m in WORDS if m in result["summary"]]


def _head(result: dict[str, Any]) -> str:
    return " " * _NAME + "".join(f"{WORDS[m]:>12}" for m in methods(result)) + f"{'paper':>9}"


def _rows(result: dict[str, Any], key: str, names: Sequence[str], theirs: dict[str, float]) -> list[str]:
    columns = [result["summary"][m][key] for m in methods(result)]
    return [
        f"{name:<{_NAME}}" + "".join(_cell(column[name], 12) for column in columns) + _cell(theirs.get(name), 9)
        for name in names
    ]


def _cell(value: float | None, width: int = 12) -> str:
    return f"{'-':>{width}}" if value is None else f"{value:>{width}.2f}"
