"""Results of walks with predicted steps: summary, text tables and HTML page, with those of Zhao et al. 2023."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Literal, NotRequired, TypedDict, TypeGuard

import numpy as np
from markupsafe import Markup
from scipy.stats import t as student_t

from stridetwin.estimators.locomotion_mode import MODES
from stridetwin.outputs.modes.scores import ModeFigures, ModeScores, ScoredMode, mode_figures, reliability
from stridetwin.pages.html import boxes, page, section, text_block
from stridetwin.pages.html import table as html_table
from stridetwin.pages.plot import INK, MUTED, PALETTE, Plot
from stridetwin.reference.norms import MeanAndSd, Moments, read_reference, read_reference_rows
from stridetwin.studies.result import CaseRow, Collected, Figures, Result, Summary, get_figures
from stridetwin.studies.zhao2023.mode_walks import (
    EDGES,
    FORGETFUL,
    HEIGHT_GROUPS,
    MOUNTS,
    Spread,
    TimedModeRows,
    combine_spreads,
)

PAPER_TERRAINS = ("stair_15cm", "stair_20cm", "stair_25cm", "ramp_11.8deg", "ramp_15.8deg", "ramp_17.8deg")
"""Terrains of Table III, as the rows of walks name them."""
GAIT_PATTERNS = ("wander", "walk", "jog")
"""Patterns of walking of Table III."""
ScoredWalk = tuple[Figures, ModeScores]
"""The row of a walk, and a method's scores on it."""
Trial = Literal["", "external_disturbance_pct", "unconventional_camera_view_pct", "multi_direction_outdoor_pct"]
"""Key in `reference/zhao2023.yaml` of one of the three trials; "" for the test of generality."""
WORDS = {"proposed": "proposed", "published": "published", FORGETFUL: "one image"}
"""Column headers of the methods."""
QUANTITIES = {"camera_pitch_rad": "camera pitch rad", "speed_mps": "speed m/s"}
"""Quantities of Figure 4 with their titles."""
# rows of the table of accuracies: title, and keys of the figure in a `MethodSummary`
_ACCURACIES = (
    ("accuracy %", ("walks_accuracy_pct", "mean")),
    ("strict %", ("walks_strict_accuracy_pct", "mean")),
    ("steps correct %", ("accuracy_pct",)),
    ("strictly correct %", ("strict_accuracy_pct",)),
    ("straddling %", ("straddling_pct",)),
    ("transitions %", ("transition_accuracy_pct",)),
)
"""The first two are means over walks, as in the paper; the others are shares of all steps."""
# rows of the table of estimates ahead: title, keys of the figure in a `MethodSummary`, and factor to the row's unit
_AHEAD = (
    ("changes detected %", ("changes_found_pct",), 1.0),
    ("stairs, ramps detected %", ("begins_found_pct",), 1.0),
    ("distance to stairs mm, median", ("distance_median_mm", "stairs"), 1.0),
    ("distance to ramps mm, median", ("distance_median_mm", "ramps"), 1.0),
    ("sizes inside 95 %", ("inside_95_pct",), 1.0),
    ("distances inside 95 %", ("distance_inside_95_pct",), 1.0),
    ("next footprint mm, steady", ("footprint_steady_rmse_m", "forward"), 1e3),
    ("calibration error, points of %", ("calibration_error",), 100.0),
)
_TITLE_WIDTH = 34  # of the first column of a text table, characters
_CELL_KEYS = ("height_group", "pattern", "terrain", "mount")
"""Keys of a row whose values identify a cell of Table II."""
_WALKER_KEYS = ("height_group", "member")
"""Keys of a row that identify the walker."""


_LEAD_EDGES = np.linspace(0.0, 5.0, 21)  # of the histogram's bins of lead times, s
_MOUNT_NOTE = (
    "From the truth, between the first step and the last; pitch down is positive. The paper does not report how its "
    "camera is mounted. Ours looks 25° (0.44 rad) down where head or chest are upright, or 8° (0.14 rad) in the "
    "shallow walks. Means therefore differ by the mount; spreads can be compared."
)


class ModeRow(CaseRow):
    """The row of a walk, see `mode_walks.run_case`; it also has the levels of the walk's conditions.

    Attributes:
        mount: Body of the camera: head or chest.
        fell_at_s: When the walker fell; None without a fall.
        spread: Spread of camera pitch and speed, by quantity (keys of `EDGES`).
        methods: Scores of the predicted modes, by method.
    """

    mount: str
    fell_at_s: float | None
    spread: dict[str, Spread]
    methods: dict[str, TimedModeRows]


class WalksAccuracy(TypedDict):
    """Accuracy over walks, %.

    Attributes:
        mean: Mean over the walks.
        sd: Standard deviation over the walks.
        ci95: Half of the mean's 95 % interval; None with one person or walk.
        over: Number of persons or walks that the interval is over.
        of: What they are: `persons` or `walks`.
        sd_of_cells: Standard deviation of the accuracies of the cells; only with several cells.
    """

    mean: float
    sd: float
    ci95: float | None
    over: int
    of: str
    sd_of_cells: NotRequired[float]


class MethodSummary(ModeFigures):
    """Figures of one method over all walks.

    Attributes:
        walks_accuracy_pct: Share of right steps of a walk, over the walks.
        walks_strict_accuracy_pct: The share in which only the true mode is right, over the walks.
        accuracy_by_condition_pct: By row of `conditions`, mean of its walks' shares.
        cells_pct: By cell of Table II (`_cell_name`), mean of its walks' shares.
    """

    walks_accuracy_pct: WalksAccuracy
    walks_strict_accuracy_pct: WalksAccuracy
    accuracy_by_condition_pct: dict[str, float]
    cells_pct: dict[str, float]


class PublishedAccuracy(TypedDict):
    """The paper's accuracy, %.

    Attributes:
        accuracy_pct: Over all walks.
        accuracy_by_condition_pct: By row of `conditions`.
        cells_pct: By cell of Table II.
    """

    accuracy_pct: MeanAndSd
    accuracy_by_condition_pct: dict[str, float]
    cells_pct: dict[str, float]


class PaperFigures(TypedDict):
    """The paper's figures.

    Attributes:
        published: Its accuracy.
        time_ms: Times by what was timed.
        spread: Moments by quantity, those of its Figure 4; only of the test of generality.
    """

    published: PublishedAccuracy
    time_ms: dict[str, float]
    spread: NotRequired[dict[str, Moments]]


ModeResult = Result[Summary, PaperFigures, ModeRow]
"""The summary has a `MethodSummary` by method, `time_ms`, and `spread` by quantity."""


def collect(results: list[ModeRow], trial: Trial = "") -> Collected[Summary, PaperFigures]:
    """Figures by method over all walks, by condition and by cell, beside the paper's.

    Args:
        results: Rows of all walks.
        trial: One of the paper's trials; "" for the test of generality.
    """
    summary: Summary = {}
    for method in results[0]["methods"]:
        # row of each walk, and the method's scores on it
        walks: list[ScoredWalk] = [(r, ModeScores.of(r["methods"][method])) for r in results]
        cells = _accuracy_by_cell(walks)
        accuracy = _accuracy_over_walks(results, [_share_right_pct(w) for _, w in walks])
        if len(cells) > 1:
            accuracy["sd_of_cells"] = float(np.std(list(cells.values())))
        strict_shares = [_share_right_pct(w, strict=True) for _, w in walks]
        summary[method] = {
            **mode_figures([w for _, w in walks]),
            "walks_accuracy_pct": accuracy,
            "walks_strict_accuracy_pct": _accuracy_over_walks(results, strict_shares),
            "accuracy_by_condition_pct": _accuracy_by_condition(walks),
            "cells_pct": cells,
        }
    # the time of the first method, which includes that of the map that the methods share
    times = [next(iter(r["methods"].values()))["time_ms"] for r in results]
    summary["time_ms"] = {"mean": float(np.mean([t["mean"] for t in times])), "p95": max(t["p95"] for t in times)}
    summary["spread"] = {q: combine_spreads([r["spread"][q] for r in results]) for q in EDGES}
    return {"summary": summary, "paper": read_paper_figures(trial)}


def conditions() -> dict[str, tuple[str, tuple[str, ...]]]:
    """Rows of Table III, and the height groups: name to the key of a walk's row and the values that belong to it.

    The value of `stairs`, for example, is the key `terrain` and the names of the three stairs.
    """
    stairs, ramps = (tuple(t for t in PAPER_TERRAINS if t.startswith(kind)) for kind in ("stair", "ramp"))
    return {
        **{t: ("terrain", (t,)) for t in PAPER_TERRAINS},
        "stairs": ("terrain", stairs),
        "ramps": ("terrain", ramps),
        **{p: ("pattern", (p,)) for p in GAIT_PATTERNS},
        **{m: ("mount", (m,)) for m in MOUNTS},
        **{f"group_{g}": ("height_group", (g,)) for g in HEIGHT_GROUPS},
    }


def _share_right_pct(walk: ModeScores, *, strict: bool = False) -> float:
    """Share of the steps of a walk that are right, %; 0 without steps.

    Args:
        walk: Scores of the walk.
        strict: Counts only the true mode as right, also where either of two modes would do.
    """
    return 100.0 * sum(s.is_strictly_correct if strict else s.is_correct for s in walk.steps) / max(len(walk.steps), 1)


def _accuracy_over_walks(rows: Sequence[Figures], shares: Sequence[float]) -> WalksAccuracy:
    """Mean and standard deviation over walks, and half of the mean's 95 % interval.

    Walks of one person are not independent: the interval is Student's over the persons' means, or over walks if the
    walker is unknown.

    Args:
        rows: Rows of the walks.
        shares: Share of right steps of each walk, %.
    """
    by_group: dict[object, list[float]] = {}  # shares by person, or by walk if the walker is unknown
    is_known = any(k in rows[0] for k in _WALKER_KEYS)
    for row, share in zip(rows, shares):
        group = tuple(row[k] for k in _WALKER_KEYS if k in row) if is_known else row["seed"]
        by_group.setdefault(group, []).append(share)
    means = [float(np.mean(shares_of_group)) for shares_of_group in by_group.values()]
    n = len(means)
    half = float(student_t.ppf(0.975, n - 1) * np.std(means, ddof=1) / math.sqrt(n)) if n > 1 else None
    return {
        "mean": float(np.mean(shares)),
        "sd": float(np.std(shares)),
        "ci95": half,
        "over": n,
        "of": "persons" if is_known else "walks",
    }


def _accuracy_by_condition(walks: Sequence[ScoredWalk]) -> dict[str, float]:
    """Accuracy for each row of `conditions`, mean over its walks, %; rows without walks are left out."""
    shares = {
        name: [_share_right_pct(scores) for row, scores in walks if row.get(key) in values]
        for name, (key, values) in conditions().items()
    }
    return {name: float(np.mean(shares_of_row)) for name, shares_of_row in shares.items() if shares_of_row}


def _accuracy_by_cell(walks: Sequence[ScoredWalk]) -> dict[str, float]:
    """Accuracy by cell of Table II, mean over its walks, %; walks without all of `_CELL_KEYS` belong to none."""
    shares_of_cell: dict[str, list[float]] = {}
    for row, scores in walks:
        if all(key in row for key in _CELL_KEYS):
            shares_of_cell.setdefault(_cell_name(row), []).append(_share_right_pct(scores))
    return {name: float(np.mean(shares)) for name, shares in sorted(shares_of_cell.items())}


def _cell_name(row: Figures) -> str:
    """Name of the cell of Table II of a row: the values of `_CELL_KEYS`, such as `I walk stair_15cm head`."""
    return " ".join(str(row[key]) for key in _CELL_KEYS)


@cache
def table_2() -> dict[str, float]:
    """Table II of the paper: accuracy by cell, %."""
    return {_cell_name(row): float(row["accuracy_pct"]) for row in read_reference_rows("zhao2023_table2")}


def read_paper_figures(trial: Trial = "") -> PaperFigures:
    """The paper's accuracy: over all walks, by condition and by cell; its Figure 4 and its time.

    Args:
        trial: One of the trials, of which the paper gives only the accuracy over all walks; "" for the test of
            generality.
    """
    figures = read_reference("zhao2023")
    if trial:
        return {
            "published": {"accuracy_pct": figures[trial], "accuracy_by_condition_pct": {}, "cells_pct": {}},
            "time_ms": figures["time_ms"],
        }
    generality = figures["generality"]
    published: PublishedAccuracy = {
        "accuracy_pct": generality["accuracy_pct"],
        # the file has mean and standard deviation of each condition
        "accuracy_by_condition_pct": {k: v[0] for k, v in figures["accuracy_by_condition_pct"].items()},
        "cells_pct": table_2(),
    }
    spread = {"camera_pitch_rad": generality["camera_pitch_rad"], "speed_mps": generality["speed_mps"]}
    return {"published": published, "time_ms": figures["time_ms"], "spread": spread}


def method_summary(result: ModeResult, method: str) -> MethodSummary:
    """The figures of one method in the summary of a result."""
    figures = result["summary"][method]
    assert _is_method_summary(figures)
    return figures


def _is_method_summary(figures: object) -> TypeGuard[MethodSummary]:
    """Whether an entry of a summary is that of a method, which has accuracies over walks."""
    return isinstance(figures, dict) and "walks_accuracy_pct" in figures


def _walk_spreads(result: ModeResult) -> dict[str, Spread]:
    """The spread of pitch and speed over all walks, by quantity."""
    spreads = result["summary"]["spread"]
    assert _are_spreads(spreads)
    return spreads


def _are_spreads(spreads: object) -> TypeGuard[dict[str, Spread]]:
    """Whether an entry of a summary is that of the spreads, each of which has the counts of a histogram."""
    return isinstance(spreads, dict) and all("bins" in spread for spread in spreads.values())


def table(result: ModeResult) -> list[str]:
    """Tables III and II with the paper's, Figure 4, and the confusion matrix, as lines of text."""
    counts = method_summary(result, methods(result)[0])["confusion"]
    blocks = [overall_lines(result)]
    if len(condition_lines(result)) > 1:
        blocks.append([conditions_title(result), *condition_lines(result)])
    if cell_lines(result):
        blocks.append(["Table II", *cell_lines(result)])
    blocks += [[*ahead_lines(result), "", *spread_lines(result)], confusion_lines(counts)]
    # an empty line between the blocks
    return "\n\n".join("\n".join(block) for block in blocks).split("\n")


def overall_lines(result: ModeResult) -> list[str]:
    """Number of walks and steps, accuracy and lead times by method, as lines of text."""
    paper_accuracy = result["paper"]["published"]["accuracy_pct"]
    time_ms = get_figures(result["summary"], "time_ms")
    columns = methods(result)  # ours first
    summary = {m: method_summary(result, m) for m in columns}
    ours, accuracy = summary[columns[0]], summary[columns[0]]["walks_accuracy_pct"]
    fell = [str(case["seed"]) for case in result["cases"] if case["fell_at_s"] is not None]
    # spread of our accuracy from cell to cell, and interval of its mean, where they are defined
    cells = ""
    if "sd_of_cells" in accuracy:
        cells = f"± {accuracy['sd_of_cells']:.2f} from cell to cell (as the paper's ±), "
    paper_text = f"{_figure_text(paper_accuracy['mean'], 9)} ± {paper_accuracy['sd']:.2f}"
    interval = "" if accuracy["ci95"] is None else f"; 95 % interval of the mean ± {accuracy['ci95']:.2f}"
    # one line per accuracy, with the paper's beside the first one, the only one that it has
    accuracy_lines = [
        f"{title:<{_TITLE_WIDTH}}"
        + "".join(_figure_text(_figure_at(summary[m], keys)) for m in columns)
        + (paper_text if keys == _ACCURACIES[0][1] else "")
        for title, keys in _ACCURACIES
    ]
    # one line per lead time and statistic
    statistics = {"median": ", median", "p5": ", 5th percentile"}  # key in the summary, and end of the line's title
    lead_lines = [
        f"{title + ending:<{_TITLE_WIDTH}}"
        + "".join(_figure_text(_figure_at(summary[m], (lead, key))) for m in columns)
        for title, lead in (("lead s", "lead_time_s"), ("of transitions s", "transition_lead_time_s"))
        for key, ending in statistics.items()
    ]
    return [
        f"{len(result['cases'])} walks, {ours['steps']} steps, {ours['transitions']} of them transitions",
        f"walks that ended by a fall: {', '.join(fell) or 'none'}",
        f"map and prediction without odometry: {time_ms['mean']:.1f} ms of CPU time per depth image, "
        f"mean over the walks; 95th percentile {time_ms['p95']:.1f} on the slowest walk",
        "",
        _head_line(result),
        *accuracy_lines,
        *lead_lines,
        "accuracy and strict: means over the walks; others: shares of all steps",
        f"{columns[0]}: {cells}± {accuracy['sd']:.2f} from walk to walk{interval}, "
        f"over {accuracy['over']} {accuracy['of']}",
    ]


def ahead_lines(result: ModeResult) -> list[str]:
    """Estimates of terrain changes 1.5 s before a foot lands beyond them, and of the next footprint, as text.

    They are of our method alone: a line for each figure of `_AHEAD`, then one for each size of stairs and ramps (riser,
    tread, slope), up and down.
    """
    ours = method_summary(result, methods(result)[0])
    lines = [
        f"1.5 s before: {ours['changes']} changes",
        *(f"{title:<{_TITLE_WIDTH}}{_figure_text(_figure_at(ours, keys, factor))}" for title, keys, factor in _AHEAD),
        "",
        f"{'':<{_TITLE_WIDTH}}{'seen %':>12}{'RMS of those':>16}{'RMS of all estimated':>23}",
    ]
    for size, by_direction in ours["sizes"].items():  # such as `riser_mm`, up and down
        for direction, size_figures in by_direction.items():
            title = f"{size.replace('_', ' ')}, {direction}"
            seen, rmse = _figure_text(size_figures["seen_pct"]), _figure_text(size_figures["rmse"], 16)
            lines.append(f"{title:<{_TITLE_WIDTH}}{seen}{rmse}{_figure_text(size_figures['all_rmse'], 23)}")
    return lines


def _figure_at(figures: Figures, keys: tuple[str, ...], factor: float = 1.0) -> float | None:
    """The figure at nested keys times a factor; None if it is undefined.

    Args:
        figures: Figures, some of which are mappings themselves.
        keys: Keys of the figure, from the outermost mapping to the innermost.
        factor: From the figure's unit to that of the table.
    """
    *outer_keys, last_key = keys
    for key in outer_keys:
        figures = get_figures(figures, key)
    value = figures[last_key]
    assert value is None or isinstance(value, (int, float))
    return None if value is None else factor * float(value)


def conditions_title(result: ModeResult) -> str:
    """Title of the accuracy by condition: that of the paper's table, which has only the test of generality."""
    return "Table III" if result["paper"]["published"]["accuracy_by_condition_pct"] else "By mount and group"


def condition_lines(result: ModeResult) -> list[str]:
    """Accuracy by condition and method beside the paper's, %, as lines of text."""
    columns = [method_summary(result, m)["accuracy_by_condition_pct"] for m in methods(result)]
    names = [name for name in conditions() if name in columns[0]]
    return _figure_lines(columns, names, result["paper"]["published"]["accuracy_by_condition_pct"])


def cell_lines(result: ModeResult) -> list[str]:
    """Accuracy by cell and method beside the paper's, %, as lines of text."""
    columns = [method_summary(result, m)["cells_pct"] for m in methods(result)]
    return _figure_lines(columns, list(columns[0]), result["paper"]["published"]["cells_pct"])


def spread_lines(result: ModeResult) -> list[str]:
    """Figure 4 as lines of text: camera pitch (down positive) and speed of the walks beside the paper's."""
    walk_spread, paper_spread = _walk_spreads(result), result["paper"].get("spread", {})
    # title of a line, and its spread: ours, then the paper's where it has one
    spreads = [
        (title if source == "ours" else "  paper", spread)
        for quantity, title in QUANTITIES.items()
        for source, spread in (("ours", walk_spread[quantity]), ("paper", paper_spread.get(quantity)))
        if spread is not None
    ]
    return [
        f"{'Figure 4, of the truth':<{_TITLE_WIDTH}}{'mean':>8}{'sd':>8}{'min':>8}{'max':>8}",
        *(
            f"{title:<{_TITLE_WIDTH}}"
            + "".join(f"{value:>8.2f}" for value in (spread["mean"], spread["sd"], spread["min"], spread["max"]))
            for title, spread in spreads
        ),
    ]


def confusion_lines(counts: dict[str, dict[str, int]]) -> list[str]:
    """The confusion matrix as lines of text: one per true mode, and a column per predicted mode.

    Args:
        counts: True mode to predicted mode to number of steps; the predicted mode "" is that of steps without any.
    """
    lines = [f"{'true / predicted':<17}" + "".join(f"{m:>7}" for m in MODES) + f"{'none':>7}"]
    return lines + [
        f"{true:<17}" + "".join(f"{row[m]:>7}" for m in MODES) + f"{row['']:>7}" for true, row in counts.items()
    ]


def methods(result: ModeResult) -> list[str]:
    """Names of the methods of a result; the proposed one first."""
    return list(result["cases"][0]["methods"])


def _head_line(result: ModeResult) -> str:
    """Head of a table of text: a column per method, and the paper's."""
    return " " * _TITLE_WIDTH + "".join(f"{WORDS.get(m, m):>12}" for m in methods(result)) + f"{'paper':>9}"


def _figure_lines(
    columns: Sequence[dict[str, float]], names: Sequence[str], paper_figures: dict[str, float]
) -> list[str]:
    """Lines of a table of text, one per figure: its name, its value for each method, and the paper's value.

    Args:
        columns: For each method, its figures by name.
        names: Names of the figures, one per line.
        paper_figures: The paper's figures by name.
    """
    return [
        f"{name:<{_TITLE_WIDTH}}"
        + "".join(_figure_text(column[name], 12) for column in columns)
        + _figure_text(paper_figures.get(name), 9)
        for name in names
    ]


def _figure_text(value: float | None, width: int = 12) -> str:
    """A figure as text of a given width; - if it is missing."""
    return f"{'-':>{width}}" if value is None else f"{value:>{width}.2f}"


def report(result: ModeResult) -> str:
    """The experiment as an HTML page."""
    cases, ours = result["cases"], methods(result)[0]
    # of each method, the steps of all walks
    steps = {m: [s for c in cases for s in ModeScores.of(c["methods"][m]).steps] for m in methods(result)}
    # sentences above the figures
    lead_lead = "Time from the final correct prediction to touch-down; 0 where the prediction was wrong."
    lead_calibration = "Predicted probability and share of correct predictions, by tenths, with the number of steps."
    lead_confusion = "Steps by true mode and by the last mode predicted before touch-down."
    sections = [
        section("Accuracy", "Ours, the published method, and the paper.", text_block(overall_lines(result))),
        _condition_section(result),
        _table_2_section(result),
        section("Confusion matrix", lead_confusion, confusion_table(method_summary(result, ours)["confusion"])),
        section(
            "Figure 4",
            _MOUNT_NOTE,
            boxes([text_block(spread_lines(result)), *(_spread_figure(quantity, result) for quantity in EDGES)]),
            "stack",
        ),
        section("Lead time", lead_lead, lead_plot(steps)),
        section("Calibration", lead_calibration, calibration_plot(steps[ours])),
    ]
    name = result["experiment"]
    return page(
        name.replace("_", " ").capitalize(),
        result["description"],
        [f"{len(cases)} walks", f"{len(steps[ours])} steps", f"{cases[0]['physics']} physics"],
        sections,
        "The results of every walk are in JSON files beside this page.",
    )


def _table_of_numbers(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Markup:
    """A table of HTML with names in the first column and numbers in the others."""
    return html_table(head, rows, range(1, len(head)))


def _two_lines(value: str, below: str) -> Markup:
    """A cell with a second value in small print below."""
    return Markup("{}<br><small>{}</small>").format(value, below)


def _number_text(value: float | None) -> str:
    """A figure as text; "" if it is missing."""
    return "" if value is None else f"{value:.2f}"


def _condition_section(result: ModeResult) -> str:
    """Section with Table III: accuracy by condition; "" without any."""
    names = methods(result)
    paper_figures = result["paper"]["published"]["accuracy_by_condition_pct"]
    columns = [method_summary(result, m)["accuracy_by_condition_pct"] for m in names]
    rows = [
        [name, *(_number_text(column.get(name)) for column in columns), _number_text(paper_figures.get(name))]
        for name in conditions()
        if name in columns[0]
    ]
    lead = "Accuracy by condition, %: mean over its walks."
    head = ["", *(WORDS.get(m, m) for m in names), "paper"]
    return section(conditions_title(result), lead, _table_of_numbers(head, rows)) if rows else ""


def _table_2_section(result: ModeResult) -> str:
    """Section with Table II in the paper's layout: accuracy by cell; "" without any."""
    ours = method_summary(result, methods(result)[0])["cells_pct"]
    paper_cells = result["paper"]["published"]["cells_pct"]
    if not ours:
        return ""
    columns = [(terrain, mount) for terrain in PAPER_TERRAINS for mount in MOUNTS]
    rows = []
    for group in HEIGHT_GROUPS:
        for pattern in GAIT_PATTERNS:
            cells = [f"{group} {pattern} {terrain} {mount}" for terrain, mount in columns]
            # our accuracy and the paper's; empty for cells that were not walked
            shown = [_two_lines(f"{ours[c]:.2f}", f"{paper_cells[c]:.2f}") if c in ours else "" for c in cells]
            rows.append([f"{group} {pattern}", *shown])
    head = ["", *(f"{terrain} {mount}" for terrain, mount in columns)]
    return section("Table II", "Accuracy by cell, %: ours, and the paper's below it.", _table_of_numbers(head, rows))


def confusion_table(counts: dict[str, dict[str, int]]) -> str:
    """The confusion matrix as HTML: a row per true mode, and a column per predicted mode.

    Args:
        counts: True mode to predicted mode to number of steps; the predicted mode "" is that of steps without any.
    """

    def cell(row: dict[str, int], mode: str) -> str:
        """Number of steps with a predicted mode, and its share of the steps with the true mode; "" for none."""
        share = 100.0 * row[mode] / max(sum(row.values()), 1)
        return _two_lines(str(row[mode]), f"{share:.1f} %") if row[mode] else ""

    rows = [[true, *(cell(row, mode) for mode in (*MODES, ""))] for true, row in counts.items()]
    return _table_of_numbers(["true / predicted", *MODES, "none"], rows)


def _spread_figure(quantity: str, result: ModeResult) -> str:
    """Histogram of pitch or speed, with mean and standard deviation, ours and the paper's."""
    walk_spread, edges = _walk_spreads(result)[quantity], EDGES[quantity]
    paper_spread = result["paper"].get("spread", {}).get(quantity)
    shares = 100.0 * np.array(walk_spread["bins"]) / walk_spread["count"]  # of each bin, %
    top = 1.25 * float(shares.max())
    plot = Plot(
        title=QUANTITIES[quantity],
        x=(float(edges[0]), float(edges[-1])),
        y=(0.0, top),
        x_label=QUANTITIES[quantity],
        y_label="share of the time, %",
        height=260,
    )
    plot.bars(edges[:-1], edges[1:], 0.0, shares, PALETTE[4], label="ours")
    # above the bars, mean and SD of both: spread, height as a share of the plot's, colour, label
    marks: tuple[tuple[Moments | None, float, str, str], ...] = (
        (walk_spread, 0.90, INK, "ours"),
        (paper_spread, 0.96, PALETTE[1], "paper"),
    )
    for spread, at, color, label in marks:
        if spread is not None:
            mean, sd = spread["mean"], spread["sd"]
            plot.line([mean - sd, mean, mean + sd], [at * top] * 3, color, width=2.0, label=f"{label}: mean ± SD")
            plot.dots([mean], [at * top], color, size=8, label=f"{label}: mean ± SD")
    return plot.html()


def lead_plot(steps: dict[str, list[ScoredMode]]) -> str:
    """Histogram of the lead times by method, as HTML."""
    plot = Plot(
        title="Lead time",
        x=(0.0, 5.0),
        x_label="time before touch-down, s",
        y_label="share of the steps, %",
        height=280,
    )
    for (method, method_steps), color in zip(steps.items(), PALETTE):
        # longer lead times count in the last bin; each share is drawn as a step from edge to edge
        counts = np.histogram(np.clip([s.lead_s for s in method_steps], 0.0, 4.999), _LEAD_EDGES)[0]
        shares = np.repeat(100.0 * counts / max(len(method_steps), 1), 2)
        plot.line(np.repeat(_LEAD_EDGES, 2)[1:-1], shares, color, width=2.0, label=WORDS.get(method, method))
    return plot.html()


def calibration_plot(steps: Sequence[ScoredMode]) -> str:
    """Share of correct predictions by predicted probability, as HTML."""
    bins = reliability(steps)  # mean probability, share of right steps, and number of steps, for each tenth with steps
    plot = Plot(
        title="Calibration",
        x=(0.0, 1.05),
        y=(0.0, 1.12),
        x_label="predicted probability",
        y_label="share of correct predictions",
        height=320,
    )
    plot.line([0.0, 1.0], [0.0, 1.0], MUTED, dash="dash", label="calibrated")
    x, y, counts = zip(*bins) if bins else ((), (), ())
    plot.dots(x, y, PALETTE[0], size=8, label="steps (number)", labels=[str(count) for count in counts])
    return plot.html()
