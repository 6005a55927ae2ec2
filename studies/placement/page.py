"""The report of a placement: one self-contained HTML file with tables, the body map and figures over the values."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from markupsafe import Markup

from stridetwin.pages.html import data_uri, multiples, page, render_template, section, table
from stridetwin.pages.plot import ERROR, PALETTE, Plot
from stridetwin.studies.placement.body_map import BodyImage
from stridetwin.studies.placement.free import Knob, to_number
from stridetwin.studies.placement.measure import MeasuredPlaces
from stridetwin.studies.placement.problem_file import AS_IT_IS, PlacementProblem, format_value
from stridetwin.studies.placement.result import PlacementResult
from stridetwin.studies.significance import interval_text, intervals, pareto_front

_DOT, _BEST, _AS_IT_IS = "#7a8fa8", PALETTE[0], PALETTE[1]
# dots of a figure: most that are drawn, up to how many are drawn larger, and diameter of one among many, pixels
_MOST_DOTS, _FEW_DOTS, _DOT_PX = 2000, 50, 4


def placement_page(
    problem: PlacementProblem, searched: MeasuredPlaces, result: PlacementResult, image: BodyImage | None
) -> str:
    """The page of a placement.

    Args:
        problem: The placement.
        searched: All measured places, for the figures.
        result: Result of `run_placement`, for table and sentences.
        image: The body map; None without one.
    """
    # short facts below the title, among them the first sentence of the comparison
    chips = [f"{result['tried']} places and as it is", f"{len(result['walks'])} walks each", *result["words"][:1]]
    lead = "Means over the same walks at every place, with 95 % intervals; the best first."
    if len(result["table"]) <= result["tried"]:  # fewer than all places and the unchanged one
        lead += f" These are {len(result['table'])} of them; places.csv has all."
    if result["walks_of_table"] != result["walks"]:
        lead += f" The table is from {len(result['walks_of_table'])} walks that the search has not seen."
    sections = [
        section("Places", lead, _table(problem, result)),
        section(
            "Significance",
            "Pairs of places, compared walk by walk, corrected for their number (Holm).",
            render_template("list", words=result["words"]),
        ),
    ]
    if image is not None:
        tag = Markup('<div style="overflow-x:auto"><img src="{}" alt="{}" style="width:100%;min-width:640px"></div>')
        sections.append(
            section("On the body", image.description, tag.format(data_uri(image.png, "image/png"), image.description))
        )
    if drawn := _value_map(problem, searched):
        sections.append(section("Score over two values", "The other values are the best ones.", drawn))
    if profiles := _score_over_each_value(problem, searched):
        sections.append(section("Score over each value", "One dot per place.", multiples(profiles)))
    if fronts := _draw_fronts(searched):
        lead = "No place on the Pareto front can be improved in one score without a loss in the other."
        sections.append(section("Trade-offs between scores", lead, multiples(fronts)))
    return page("Placement", problem.description, chips, sections, "Drawn by stridetwin place.")


def _table(problem: PlacementProblem, result: PlacementResult) -> str:
    """The table of places with their values and scores."""
    knobs = [knob.name for knob in problem.knobs]
    head = ("place", *knobs, *(s.name for s in problem.scores))
    rows = [
        (
            # the rank, and below it the reason for a missing score
            Markup("<br>").join([str(row["rank"]), *([row["failed"]] if "failed" in row else [])]),
            *(value_text(row["values"], name) for name in knobs),
            *(interval_text(row["scores"].get(s.name)) for s in problem.scores),
        )
        for row in result["table"]
    ]
    return table(head, rows, range(1, len(head)))


def value_text(values: Mapping[str, object], name: str) -> str:
    """The value of a knob as text; `as it is` for the unchanged scenario."""
    return format_value(values[name]) if values else AS_IT_IS


def _find_scored(searched: MeasuredPlaces) -> list[int]:
    """Numbers of the changed places with a finite loss, best first."""
    return [i for i in searched.best_first if searched.places[i].values and np.isfinite(searched.losses[i])]


def _first_weighted(problem: PlacementProblem) -> int:
    """Number of the first score that has a weight."""
    return next(i for i, score in enumerate(problem.scores) if score.weight)


def _value_map(problem: PlacementProblem, searched: MeasuredPlaces) -> str:
    """The first weighted score over the first two numbers of a sweep, at the best other values.

    "" for a search, which has no grid of values, for a placement with fewer than two numbers, and without a scored
    place.
    """
    numbers = [knob for knob in problem.knobs if not knob.values]  # knobs that are numbers
    places = _find_scored(searched)
    if problem.search is not None or len(numbers) < 2 or not places:
        return ""
    across, up = numbers[:2]  # the knobs along x and y
    k = _first_weighted(problem)
    xs, ys = across.numbers, up.numbers
    # score of the best place with each pair of values; NaN where no place has a score
    best = np.full((len(ys), len(xs)), np.nan)
    for i in reversed(places):  # best last, so that it stays where places share both values
        values = searched.places[i].values
        best[ys.index(to_number(values[up.name])), xs.index(to_number(values[across.name]))] = searched.means[i, k]
    score, top = problem.scores[k], searched.places[places[0]].values
    plot = Plot(
        title=f"{score.name} over {across.name} and {up.name}", x_label=across.name, y_label=up.name, height=440
    )
    plot.heatmap(xs, ys, best, label=score.name, reverse=not score.higher_is_better)
    best_x, best_y = to_number(top[across.name]), to_number(top[up.name])
    plot.dots([best_x], [best_y], ERROR, size=12, symbol="x", label=_best_label(searched))
    return plot.html()


def _score_over_each_value(problem: PlacementProblem, searched: MeasuredPlaces) -> list[str]:
    """Figures of the first weighted score, one over each knob; none without a scored place.

    Over a number there is one dot per place, over a choice the best place with each value and its interval.
    """
    scored, k = _find_scored(searched), _first_weighted(problem)
    if not scored:
        return []
    return [
        _draw_over_choices(knob, searched, scored, k) if knob.values else _draw_over_numbers(knob, searched, scored, k)
        for knob in problem.knobs
    ]


def _draw_over_choices(knob: Knob, searched: MeasuredPlaces, numbers: list[int], k: int) -> str:
    """The k-th score of the best place with each value of a choice, with intervals.

    Args:
        knob: The choice.
        searched: All measured places.
        numbers: Numbers of the places with a loss, best first.
        k: Number of the score.
    """
    best: dict[int, int] = {}  # by number of the value: number of the best place with it
    for i in numbers:  # best first, so the first place with a value is the best one with it
        best.setdefault(knob.values.index(searched.places[i].values[knob.name]), i)
    column_intervals = intervals(searched.values[list(best.values()), :, k].T)
    plot = Plot(
        title=knob.name,
        x=(-0.5, len(knob.values) - 0.5),
        x_label=knob.name,
        y_label=searched.scores[k].name,
        x_names=[format_value(value) for value in knob.values],
    )
    # without an interval both ends are the mean
    ends = [
        (
            interval.mean if interval.low is None else interval.low,
            interval.mean if interval.high is None else interval.high,
        )
        for interval in column_intervals
    ]
    plot.curves([[(x, low), (x, high)] for x, (low, high) in zip(best, ends)], _BEST, width=3, label="95 % interval")
    plot.dots(list(best), [interval.mean for interval in column_intervals], _BEST, size=10, label="best place")
    return plot.html()


def _draw_over_numbers(knob: Knob, searched: MeasuredPlaces, numbers: list[int], k: int) -> str:
    """The k-th score over a number: one dot per place, and the score of the unchanged scenario as a line.

    Args:
        knob: The number.
        searched: All measured places; the first one is the unchanged scenario.
        numbers: Numbers of the places with a loss, best first.
        k: Number of the score.
    """
    shown = numbers[:_MOST_DOTS]
    x = [to_number(searched.places[i].values[knob.name]) for i in shown]
    means = searched.means[shown, k]
    plot = Plot(title=knob.name, x_label=knob.name, y_label=searched.scores[k].name)
    plot.dots(x, means, _DOT, size=_dot_px(len(x)), label="place")
    # the first of them is the best place
    plot.dots(x[:1], means[:1], _BEST, size=9, label=_best_label(searched))
    if np.isfinite(searched.losses[0]):  # of the unchanged scenario
        plot.line([min(x), max(x)], 2 * [searched.means[0, k]], _AS_IT_IS, width=1.2, label="unchanged")
    return plot.html()


def _best_label(searched: MeasuredPlaces) -> str:
    """Name of the best place of a figure without the unchanged one, which may be better."""
    return "best but for the unchanged" if searched.best_first[0] == 0 else "best"


def _dot_px(count: int) -> int:
    """Diameter of the dots of a figure, pixels: few are larger than many."""
    return _DOT_PX if count > _FEW_DOTS else 2 * _DOT_PX


def _draw_fronts(searched: MeasuredPlaces) -> list[Markup]:
    """Figures of the first score against each of the others: all places and the Pareto front.

    A pair of scores has no figure if no place has both, or if one of them is equal at all places.
    """
    plots = []
    for k in range(1, len(searched.scores)):
        scores = [searched.scores[i] for i in (0, k)]
        x, y = searched.means[:, [0, k]].T  # (P,) means of the first and of the k-th score, NaN where one is missing
        has_both = np.isfinite(x) & np.isfinite(y)
        if not has_both.any() or not (np.ptp(x[has_both]) and np.ptp(y[has_both])):  # `ptp`: largest minus smallest
            continue
        # (P, 2) losses, and the numbers of the places on the front in the order of the first score
        losses = np.column_stack([score.losses(side) for score, side in zip(scores, (x, y))])
        best = sorted(pareto_front(np.where(has_both[:, None], losses, np.inf)), key=lambda i: x[i])
        # numbers of the places that are drawn
        rows = [i for i in searched.best_first if has_both[i]][:_MOST_DOTS]
        names = [score.name for score in scores]
        plot = Plot(title=" and ".join(names), x_label=names[0], y_label=names[1], height=320)
        plot.dots(x[rows], y[rows], _DOT, size=_dot_px(len(rows)), label="place")
        plot.line(x[best], y[best], _BEST, width=1.2, label="Pareto front")
        plot.dots(x[best], y[best], _BEST, size=8, label="Pareto front")
        if has_both[0]:
            plot.dots(x[:1], y[:1], _AS_IT_IS, size=10, symbol="diamond", label="unchanged")
        plots.append(plot.html())
    return plots
