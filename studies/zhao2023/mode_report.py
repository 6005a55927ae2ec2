"""The figures and tables of Zhao et al. 2023 on walks with predicted steps, as an HTML page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike

from stridetwin.estimators.locomotion_mode import MODES
from stridetwin.evaluation.mode_scores import ModeScores, ScoredMode, reliability
from stridetwin.report.html import boxes, page, section, table
from stridetwin.report.svg import Plot, wide_and_narrow
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

_COLORS = ("#0a7d7d", "#a3327a", "#d9480f")
_INK, _BAR, _LINE = "#0f1c2e", "#7fb8b8", "#b8c3d0"
_LEAD_EDGES = np.linspace(0.0, 5.0, 21)
_MOUNT_NOTE = (
    "From the truth, between the first step and the last; pitch down is positive. The paper does not tell how its "
    "camera is mounted: ours looks 25° (0.44 rad) down where head or chest are upright, or 8° (0.14 rad) in the "
    "shallow walks, so that means differ by the mount and spreads can be compared."
)


def report(result: dict[str, Any]) -> str:
    """The experiment as HTML text."""
    cases, ours = result["cases"], methods(result)[0]
    steps = {m: [s for c in cases for s in ModeScores.of(c["methods"][m]).steps] for m in methods(result)}
    lead_lead = "How long before touch-down the told mode had become right for good; 0 where it was wrong."
    lead_calibration = (
        "Probability of the told mode against the share of steps that were right, by tenths; amounts of steps."
    )
    lead_confusion = "Steps by true mode and told mode, as last told before touch-down."
    sections = [
        section("Accuracy", "Ours, the published method, and the paper.", _lines(overall(result))),
        _conditions(result),
        _cells(result),
        section("Confusion matrix", lead_confusion, _confusion(result["summary"][ours]["confusion"])),
        section("Figure 4", _MOUNT_NOTE, boxes([_lines(spreads(result)), *_spread_figures(result)]), "stack"),
        section("Lead", lead_lead, _lead(steps)),
        section("Calibration", lead_calibration, _calibration(steps[ours])),
    ]
    name = result["experiment"]
    return page(
        name.replace("_", " ").capitalize(),
        STUDIES[name].description if name in STUDIES else "",
        [f"{len(cases)} walks", f"{len(steps[ours])} steps", f"{cases[0]['physics']} physics"],
        sections,
        "Every walk lies beside this page as JSON.",
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
            told = ["" if pair is None else _two(f"{pair[0]:.2f}", f"{pair[1]:.2f}") for pair in pairs]
            rows.append([f"{group} {pattern}", *told])
    head = ["", *(f"{terrain} {mount}" for terrain, mount in columns)]
    return section("Table II", "Accuracy by cell, %: ours, and the paper's below it.", _table(head, rows))


def _confusion(counts: dict[str, dict[str, int]]) -> str:
    def cell(row: dict[str, int], told: str) -> str:
        share = 100.0 * row[told] / max(sum(row.values()), 1)
        return _two(str(row[told]), f"{share:.1f} %") if row[told] else ""

    rows = [[true, *(cell(row, told) for told in (*MODES, ""))] for true, row in counts.items()]
    return _table(["true / told", *MODES, "nothing"], rows)


def _bars(plot: Plot, edges: ArrayLike, shares: ArrayLike, color: str) -> None:
    edges, shares = np.asarray(edges, float), np.asarray(shares, float)
    for left, right, share in zip(edges[:-1], edges[1:], shares):
        if share > 0:
            plot.polygon([left, left, right, right], [0.0, share, share, 0.0], color, stroke="#fff")


def _spread_figures(result: dict[str, Any]) -> list[str]:
    """Histograms of pitch and speed, with the paper's mean and standard deviation."""
    return [_spread(quantity, result) for quantity in EDGES]


def _spread(quantity: str, result: dict[str, Any]) -> str:
    ours, edges = result["summary"]["spread"][quantity], EDGES[quantity]
    theirs = result["paper"].get("spread", {}).get(quantity)
    shares = 100.0 * np.array(ours["bins"]) / ours["count"]
    top = 1.25 * float(shares.max())

    def draw(width: float) -> Plot:
        plot = Plot(
            width=width, height=240, x=(float(edges[0]), float(edges[-1])), y=(0.0, top), title=QUANTITIES[quantity],
            x_label=QUANTITIES[quantity], y_label="% of the time",
        )  # fmt: skip
        _bars(plot, edges, shares, _BAR)
        for told, at, color, label in ((ours, 0.90, _INK, "ours"), (theirs, 0.96, _COLORS[2], "paper")):
            if told is not None:
                mean, sd = told["mean"], told["sd"]
                plot.line([mean - sd, mean + sd], [at * top] * 2, color, stroke=2.0, label=f"{label}: mean ± SD")
                plot.dots([mean], [at * top], color, radius=4.0)
        return plot

    return wide_and_narrow(draw)


def _lead(steps: dict[str, list[ScoredMode]]) -> str:
    shares = {
        m: 100.0 * np.histogram(np.clip([s.lead_s for s in own], 0.0, 4.999), _LEAD_EDGES)[0] / max(len(own), 1)
        for m, own in steps.items()
    }
    top = 1.15 * max(float(share.max()) for share in shares.values())

    def draw(width: float) -> Plot:
        plot = Plot(
            width=width, height=260, x=(0.0, 5.0), y=(0.0, top), title="Lead", x_label="s before touch-down",
            y_label="% of the steps",
        )  # fmt: skip
        for (method, share), color in zip(shares.items(), _COLORS):
            stairs = np.repeat(_LEAD_EDGES, 2)[1:-1]
            plot.line(stairs, np.repeat(share, 2), color, stroke=2.0, label=WORDS[method])
        return plot

    return wide_and_narrow(draw)


def _calibration(steps: Sequence[ScoredMode]) -> str:
    told = reliability(steps)

    def draw(width: float) -> Plot:
        plot = Plot(
            width=width, height=300, x=(0.0, 1.05), y=(0.0, 1.12), title="Calibration", x_label="told probability",
            y_label="share right",
        )  # fmt: skip
        plot.line([0.0, 1.0], [0.0, 1.0], _LINE, dash="4 4")
        plot.dots([p for p, _, _ in told], [right for _, right, _ in told], _COLORS[0], radius=4.0)
        for p, right, count in told:
            plot.note(p, right + 0.05, str(count))
        return plot

    return wide_and_narrow(draw)
