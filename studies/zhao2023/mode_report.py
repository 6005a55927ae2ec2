"""The figures and tables of Zhao et al. 2023 on walks with predicted steps, as an HTML page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from stridetwin.estimators.locomotion_mode import MODES
from stridetwin.evaluation.mode_scores import ModeScores, ScoredMode, told_and_right
from stridetwin.report.html import boxes, page, section, table
from stridetwin.report.plot import INK, MUTED, PALETTE, Plot
from stridetwin.studies.catalogue import STUDIES
from stridetwin.studies.zhao2023.mode_tables import (
    QUANTITIES,
    WORDS,
    conditions,
    conditions_title,
    methods,
    overall,
    spreads,
)
from stridetwin.studies.zhao2023.mode_walks import EDGES, GROUPS, MOUNTS
from stridetwin.studies.zhao2023.zhao_generality import PATTERNS, TERRAINS

_LEAD_EDGES = np.linspace(0.0, 5.0, 21)
_MOUNT_NOTE = (
    "From the truth, between the first step and the last; pitch down is positive. The paper does not report how its "
    "camera is mounted. Ours looks 25° (0.44 rad) down where head or chest are upright, or 8° (0.14 rad) in the "
    "shallow walks. Means therefore differ by the mount; spreads can be compared."
)


def report(result: dict[str, Any]) -> str:
    """The experiment as HTML text."""
    cases, ours = result["cases"], methods(result)[0]
    steps = {m: [s for c in cases for s in ModeScores.of(c["methods"][m]).steps] for m in methods(result)}
    lead_lead = "Time from the final correct prediction to touch-down; 0 where the prediction was wrong."
    lead_calibration = "Predicted probability and share of correct predictions, by tenths, with the number of steps."
    lead_confusion = "Steps by true mode and by the last mode predicted before touch-down."
    sections = [
        section("Accuracy", "Ours, the published method, and the paper.", _lines(overall(result))),
        _conditions(result),
        _cells(result),
        section("Confusion matrix", lead_confusion, _confusion(result["summary"][ours]["confusion"])),
        section(
            "Figure 4",
            _MOUNT_NOTE,
            boxes([_lines(spreads(result)), *(_spread(quantity, result) for quantity in EDGES)]),
            "stack",
        ),
        section("Lead time", lead_lead, _lead(steps)),
        section("Calibration", lead_calibration, _calibration(steps[ours])),
    ]
    name = result["experiment"]
    return page(
        name.replace("_", " ").capitalize(),
        STUDIES[name].description if name in STUDIES else "",
        [f"{len(cases)} walks", f"{len(steps[ours])} steps", f"{cases[0]['physics']} physics"],
        sections,
        "The results of every walk are in JSON files beside this page.",
    )


def _lines(lines: Sequence[str]) -> Markup:
    return Markup("<pre>{}</pre>").format("\n".join(lines))


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Markup:
    return table(head, rows, range(1, len(head)))


def _two(value: str, below: str) -> Markup:
    """A cell with a second value in small print below."""
    return Markup("{}<br><small>{}</small>").format(value, below)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _conditions(result: dict[str, Any]) -> str:
    """Table III."""
    key, columns = "accuracy_by_condition_pct", methods(result)
    theirs = result["paper"]["published"][key]
    ours = result["summary"][columns[0]][key]
    rows = [
        [name, *(_number(result["summary"][m][key].get(name)) for m in columns), _number(theirs.get(name))]
        for name in conditions()
        if name in ours
    ]
    lead = "Accuracy by condition, %: mean over its walks."
    return (
        section(conditions_title(result), lead, _table(["", *(WORDS[m] for m in columns), "paper"], rows))
        if rows
        else ""
    )


def _cells(result: dict[str, Any]) -> str:
    """Table II, in the paper's layout."""
    ours, theirs = result["summary"][methods(result)[0]]["cells_pct"], result["paper"]["published"]["cells_pct"]
    if not ours:
        return ""
    columns = [(terrain, mount) for terrain in TERRAINS for mount in MOUNTS]
    rows = []
    for group in GROUPS:
        for pattern in PATTERNS:
            cells = [f"{group} {pattern} {terrain} {mount}" for terrain, mount in columns]
            pairs = [(ours[c], theirs[c]) if c in ours else None for c in cells]
            shown = ["" if pair is None else _two(f"{pair[0]:.2f}", f"{pair[1]:.2f}") for pair in pairs]
            rows.append([f"{group} {pattern}", *shown])
    head = ["", *(f"{terrain} {mount}" for terrain, mount in columns)]
    return section("Table II", "Accuracy by cell, %: ours, and the paper's below it.", _table(head, rows))


def _confusion(counts: dict[str, dict[str, int]]) -> str:
    def cell(row: dict[str, int], mode: str) -> str:
        share = 100.0 * row[mode] / max(sum(row.values()), 1)
        return _two(str(row[mode]), f"{share:.1f} %") if row[mode] else ""

    rows = [[true, *(cell(row, mode) for mode in (*MODES, ""))] for true, row in counts.items()]
    return _table(["true / predicted", *MODES, "none"], rows)


def _spread(quantity: str, result: dict[str, Any]) -> str:
    """Histogram of pitch or speed, with mean and standard deviation, ours and the paper's."""
    ours, edges = result["summary"]["spread"][quantity], EDGES[quantity]
    theirs = result["paper"].get("spread", {}).get(quantity)
    shares = 100.0 * np.array(ours["bins"]) / ours["count"]
    top = 1.25 * float(shares.max())
    plot = Plot(
        title=QUANTITIES[quantity], x=(float(edges[0]), float(edges[-1])), y=(0.0, top), x_label=QUANTITIES[quantity],
        y_label="share of the time, %", height=260,
    )  # fmt: skip
    plot.bars(edges[:-1], edges[1:], 0.0, shares, PALETTE[4], label="ours")
    for found, at, color, label in ((ours, 0.90, INK, "ours"), (theirs, 0.96, PALETTE[1], "paper")):
        if found is not None:
            mean, sd = found["mean"], found["sd"]
            plot.line([mean - sd, mean, mean + sd], [at * top] * 3, color, width=2.0, label=f"{label}: mean ± SD")
            plot.dots([mean], [at * top], color, size=8, label=f"{label}: mean ± SD")
    return plot.html()


def _lead(steps: dict[str, list[ScoredMode]]) -> str:
    plot = Plot(
        title="Lead time", x=(0.0, 5.0), x_label="time before touch-down, s", y_label="share of the steps, %",
        height=280,
    )  # fmt: skip
    for (method, own), color in zip(steps.items(), PALETTE):
        counts = np.histogram(np.clip([s.lead_s for s in own], 0.0, 4.999), _LEAD_EDGES)[0]
        shares = np.repeat(100.0 * counts / max(len(own), 1), 2)
        plot.line(np.repeat(_LEAD_EDGES, 2)[1:-1], shares, color, width=2.0, label=WORDS[method])
    return plot.html()


def _calibration(steps: Sequence[ScoredMode]) -> str:
    bins = told_and_right(steps)
    plot = Plot(
        title="Calibration", x=(0.0, 1.05), y=(0.0, 1.12), x_label="predicted probability",
        y_label="share of correct predictions", height=320,
    )  # fmt: skip
    plot.line([0.0, 1.0], [0.0, 1.0], MUTED, dash="dash", label="calibrated")
    x, y, counts = zip(*bins) if bins else ((), (), ())
    plot.dots(x, y, PALETTE[0], size=8, label="steps (number)", words=[str(count) for count in counts])
    return plot.html()
