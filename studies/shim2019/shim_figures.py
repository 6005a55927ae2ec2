"""Figures 22 to 24 of Shim et al. 2019 on the simulated walkers, as an HTML page with the table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from stridetwin.estimators.contact_terrain import METHODS, MODES
from stridetwin.evaluation.step_scores import ScoredStep
from stridetwin.report.figures_steps import steps_from_aside
from stridetwin.report.html import boxes, page, section
from stridetwin.report.svg import Plot, data_range, wide_and_narrow
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.world.route import lay_out
from stridetwin.studies.shim2019.shim_table5 import CASES, table

SHOWN = {"shim_level": "Level walk", "shim_stairs": "Stair", "shim_ramp_14": "Ramp of 14°"}
DOTS = 150
"""Number of dots per mode in Figure 24, evenly chosen from all steps to limit the page's size."""
_COLORS = {"LG": "#5b6b7f", "SA": "#d9480f", "SD": "#f0a030", "RA": "#0b6bcb", "RD": "#7a9fd0"}
_METHOD_COLORS = {"proposed": "#0a7d7d", "published": "#a3327a"}
_INK = "#0f1c2e"


def report(result: dict[str, Any]) -> str:
    """The experiment as HTML text: Figures 22-24, then the tables."""
    cases = result["cases"]
    lead_22 = f"Planes and their normals, subject S{cases[0]['subject']}, seed {cases[0]['seed']}."
    lead_23 = "What is told of each terrain, mean and standard deviation over all steps; black is true. Amounts."
    lead_24 = f"Slope and elevation of steps over the largest of each; up to {DOTS} steps of a mode."
    lead_tables = "Ours and the published method beside the paper."
    averages = [_figure_23(cases, what) for what in ("slope", "elevation")]
    sections = [
        *(section(f"Figure 22, {m}", lead_22, boxes(_figure_22(cases[0], m)), "stack") for m in METHODS),
        section("Figure 23", lead_23, boxes(averages), "stack"),
        section("Figure 24", lead_24, boxes([_figure_24(cases, m) for m in METHODS]), "plots"),
        section("Tables 5 to 7", lead_tables, Markup("<pre>{}</pre>").format("\n".join(table(result))), ""),
    ]
    return page(
        "Slope and step height from the legs",
        "Shim et al. 2019 on the simulated walkers: seven subjects on level ground, a stair and three ramps.",
        [f"{len(cases)} trials", f"{cases[0]['physics']} physics"],
        sections,
        "Every trial lies beside this page as JSON.",
    )


def _figure_22(case: dict[str, Any], method: str) -> list[str]:
    """Side views of one trial."""
    figures = []
    for walk, title in SHOWN.items():
        steps = [ScoredStep(**row) for row in case["walks"][walk][method]]
        if any(s.seen for s in steps):
            figures.append(steps_from_aside(lay_out(load_scenario(walk).config.route), steps, title))
    return figures


def _figure_23(cases: Sequence[dict[str, Any]], what: str) -> str:
    """Averages by terrain."""
    scale, unit = (np.degrees(1.0), "°") if what == "slope" else (1e3, "mm")
    true = [[abs(getattr(s, what)) * scale for s in _of_case(cases, METHODS[0], name)] for name in CASES]
    told = {
        method: [[abs(getattr(s, f"told_{what}")) * scale for s in _of_case(cases, method, name)] for name in CASES]
        for method in METHODS
    }
    span = data_range(*(np.array(v) for rows in (true, *told.values()) for v in rows), include=(0.0,))

    def draw(width: float) -> Plot:
        plot = Plot(
            width=width, height=260, x=(-0.6, len(CASES) - 0.4), y=span, title=f"Figure 23, {what}",
            y_label=f"{what}, {unit}", x_names=tuple(CASES),
        )  # fmt: skip
        for i, values in enumerate(true):
            if values:
                plot.line([i - 0.35, i + 0.35], [np.mean(values)] * 2, _INK, stroke=1.4, label="true" if i == 0 else "")
        for k, (method, rows) in enumerate(told.items()):
            for i, values in enumerate(rows):
                if values:
                    at, mean, sd = i + 0.24 * k - 0.12, float(np.mean(values)), float(np.std(values))
                    plot.line([at, at], [mean - sd, mean + sd], _METHOD_COLORS[method], stroke=1.4)
                    plot.dots([at], [mean], _METHOD_COLORS[method], radius=3.2, label=method if i == 0 else "")
        return plot

    return wide_and_narrow(draw)


def _figure_24(cases: Sequence[dict[str, Any]], method: str) -> str:
    """Steps in the plane of normalised slope and elevation."""
    steps = [s for case in cases for walk in case["walks"].values() for s in _seen(walk[method])]
    slopes = np.array([s.estimated_slope for s in steps])
    heights = np.array([s.estimated_elevation for s in steps])
    slopes, heights = (v / max(float(np.abs(v).max(initial=0.0)), 1e-9) for v in (slopes, heights))
    modes = np.array([s.mode for s in steps])

    def draw(width: float) -> Plot:
        plot = Plot(
            width=width, height=380, x=(-1.05, 1.05), y=(-1.05, 1.05), title=f"Figure 24, {method}",
            x_label="slope over the largest", y_label=f"{method}: elevation over the largest",
        )  # fmt: skip
        for mode in MODES:
            own = np.flatnonzero(modes == mode)
            own = own[np.unique(np.linspace(0, len(own) - 1, min(len(own), DOTS)).astype(int))] if len(own) else own
            plot.dots(slopes[own], heights[own], _COLORS[mode], radius=2.0, label=mode)
        return plot

    return wide_and_narrow(draw)


def _of_case(cases: Sequence[dict[str, Any]], method: str, name: str) -> list[ScoredStep]:
    walk, mode = CASES[name]
    return [s for case in cases for s in _seen(case["walks"][walk][method]) if not mode or s.mode == mode]


def _seen(rows: Sequence[dict[str, Any]]) -> Iterator[ScoredStep]:
    return (s for s in (ScoredStep(**row) for row in rows) if s.seen)
