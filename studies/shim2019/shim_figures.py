"""Figures 22 to 24 of Shim et al. 2019 on the simulated walkers, as an HTML page with the table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from markupsafe import Markup

from stridetwin.estimators.contact_terrain import METHODS, MODES
from stridetwin.outputs.steps.figures import steps_from_aside
from stridetwin.outputs.steps.scores import ScoredStep, StepRow
from stridetwin.pages.html import boxes, page, section, text_block
from stridetwin.pages.plot import INK, PALETTE, Plot
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.world.route import lay_out
from stridetwin.studies.shim2019.shim_table5 import CASES, ShimResult, TrialRow, table

SHOWN = {"shim_level": "Level walk", "shim_stairs": "Stair", "shim_ramp_14": "Ramp of 14°"}
"""Walks of Figure 22 by the name of the scenario, with their titles."""
DOTS = 150
"""Number of dots per mode in Figure 24, evenly chosen from all steps to limit the page's size."""
# colours of the modes and of the methods
_COLORS = dict(zip(MODES, ("#5b6b7f", PALETTE[1], PALETTE[5], PALETTE[0], PALETTE[4])))
_METHOD_COLORS = dict(zip(METHODS, PALETTE[2:]))


def report(result: ShimResult) -> str:
    """The experiment as an HTML page: Figures 22 to 24 of Shim et al. 2019, then the tables."""
    cases = result["cases"]
    lead_22 = f"Planes and their normals, subject S{cases[0]['subject']}, seed {cases[0]['seed']}."
    lead_23 = "Absolute slope and elevation by terrain: mean and standard deviation over all steps."
    lead_24 = f"Slope and elevation of steps, relative to the largest; up to {DOTS} steps per mode."
    lead_tables = "The proposed and the published method, and the paper's results."
    averages = [_figure_23(cases, quantity) for quantity in ("slope", "elevation")]
    sections = [
        *(section(f"Figure 22, {m}", lead_22, boxes(_figure_22(cases[0], m)), "stack") for m in METHODS),
        section("Figure 23", lead_23, boxes(averages), "stack"),
        section("Figure 24", lead_24, boxes([_figure_24(cases, m) for m in METHODS]), "plots"),
        section("Tables 5 to 7", lead_tables, text_block(table(result)), ""),
    ]
    return page(
        "Slope and step height from the legs",
        "Shim et al. 2019 on the simulated walkers: seven subjects on level ground, a stair and three ramps.",
        [f"{len(cases)} trials", f"{cases[0]['physics']} physics"],
        sections,
        "The results of every trial are in JSON files beside this page.",
    )


def _figure_22(case: TrialRow, method: str) -> list[Markup]:
    """Figure 22: side views of the walks of one trial with the planes and normals that a method estimates."""
    figures = []
    for walk, title in SHOWN.items():  # scenario, and title of its figure
        steps = [ScoredStep(**row) for row in case["walks"][walk][method]]
        if any(s.is_matched for s in steps):
            figures.append(steps_from_aside(lay_out(load_scenario(walk).config.route), steps, title))
    return figures


def _figure_23(cases: Sequence[TrialRow], quantity: str) -> str:
    """Figure 23: means and standard deviations of absolute slope or elevation, by terrain and method.

    Args:
        cases: Rows of the trials.
        quantity: `slope` or `elevation`.
    """
    factor, unit = (np.degrees(1.0), "°") if quantity == "slope" else (1e3, "mm")  # from rad or m to the plot's unit
    plot = Plot(
        title=f"Figure 23, {quantity}",
        x=(-0.6, len(CASES) - 0.4),
        y_label=f"{quantity}, {unit}",
        x_label="terrain",
        x_names=tuple(CASES),
    )
    for k, method in enumerate((METHODS[0], *METHODS)):  # k = 0: the true values, which are the same for any method
        name = f"estimated_{quantity}" if k else quantity
        # for each case of the table, the absolute values of its steps in the plot's unit; a case may have no steps
        values = [[abs(getattr(s, name)) * factor for s in _steps_of_case(cases, method, case)] for case in CASES]
        # numbers of the table's cases with steps, which are their places on the x axis, and the means there
        places = np.array([i for i, case_values in enumerate(values) if case_values])
        means = np.array([np.mean(case_values) for case_values in values if case_values])
        if k:
            sd = [np.std(case_values) for case_values in values if case_values]
            # the two methods side by side: 0.12 to the left (k = 1) and to the right (k = 2) of the case's place
            x = places + 0.24 * k - 0.36
            plot.dots(x, means, _METHOD_COLORS[method], sd=sd, size=7, label=f"{method}, mean ± SD")
        else:
            plot.curves([[(i - 0.35, m), (i + 0.35, m)] for i, m in zip(places, means)], INK, label="true")
    return plot.html()


def _figure_24(cases: Sequence[TrialRow], method: str) -> str:
    """Figure 24: the steps of a method in the plane of normalised slope and elevation."""
    steps = [s for case in cases for walk in case["walks"].values() for s in _select_matched(walk[method])]
    # (N, 2) slope and elevation, then both relative to their largest value; 1e-9 where all are 0
    points = np.array([(s.estimated_slope, s.estimated_elevation) for s in steps]).reshape(-1, 2)
    points /= np.maximum(np.abs(points).max(axis=0, initial=0.0), 1e-9)
    modes = np.array([s.mode for s in steps])
    plot = Plot(
        title=f"Figure 24, {method}",
        x=(-1.05, 1.05),
        y=(-1.05, 1.05),
        x_label="slope / largest slope",
        y_label=f"{method}: elevation / largest elevation",
        height=380,
    )
    for mode, color in _COLORS.items():
        step_numbers = np.flatnonzero(modes == mode)
        if len(step_numbers):
            # at most `DOTS` of the mode's steps, evenly
            places = np.linspace(0, len(step_numbers) - 1, min(len(step_numbers), DOTS)).astype(int)
            shown = step_numbers[np.unique(places)]
            plot.dots(points[shown, 0], points[shown, 1], color, size=4, label=mode)
    return plot.html()


def _steps_of_case(cases: Sequence[TrialRow], method: str, name: str) -> list[ScoredStep]:
    """The estimated steps of all trials that belong to one case of the table.

    Args:
        cases: Rows of the trials.
        method: Method that has estimated the steps.
        name: Case of the table, such as `SA`.
    """
    walk, mode = CASES[name]
    return [s for case in cases for s in _select_matched(case["walks"][walk][method]) if not mode or s.mode == mode]


def _select_matched(rows: Sequence[StepRow]) -> Iterator[ScoredStep]:
    """The steps with an estimate, from their rows."""
    return (s for s in (ScoredStep(**row) for row in rows) if s.is_matched)
