"""The report of a placement: one self-contained HTML file with tables, the body map and figures over the values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from markupsafe import Markup

from stridetwin.pages.html import data_uri, multiples, page, rendered, section, table
from stridetwin.pages.plot import ERROR, PALETTE, Plot
from stridetwin.streams.samples import Array
from stridetwin.studies.placement.body_map import BodyImage
from stridetwin.studies.placement.free import Knob
from stridetwin.studies.placement.measure import Measured
from stridetwin.studies.placement.problem_file import AS_IT_IS, Problem, format_value
from stridetwin.studies.significance import front, interval_text, intervals

_DOT, _BEST, _AS_IT_IS = "#7a8fa8", PALETTE[0], PALETTE[1]
_MOST_DOTS, _FEW_DOTS, _DOT_PX = 2000, 50, 4


def placement_page(
    problem: Problem, searched: Measured, losses: Array, result: Mapping[str, Any], image: BodyImage | None
) -> str:
    """The page of a placement: the losses (P,) of all places, the result of `run_placement`, and the body map."""
    chips = [f"{result['tried']} places and as it is", f"{len(result['walks'])} walks each", *result["words"][:1]]
    lead = "Means over the same walks at every place, with 95 % intervals; the best first."
    if len(result["table"]) <= result["tried"]:
        lead += f" These are {len(result['table'])} of them; places.csv has all."
    if result["walks_of_table"] != result["walks"]:
        lead += f" The table is from {len(result['walks_of_table'])} walks that the search has not seen."
    sections = [
        section("Places", lead, _table(problem, result)),
        section("Significance", "Pairs of places, compared walk by walk, corrected for their number (Holm).",
                rendered("list", words=result["words"])),
    ]  # fmt: skip
    if image is not None:
        tag = Markup('<div style="overflow-x:auto"><img src="{}" alt="{}" style="width:100%;min-width:640px"></div>')
        sections.append(section("On the body", image.words, tag.format(data_uri(image.png, "image/png"), image.words)))
    if drawn := value_map(problem, searched, losses):
        sections.append(section("Score over two values", "The other values are the best ones.", drawn))
    if drawn_over := profiles(problem, searched, losses):
        sections.append(section("Score over each value", "One dot per place.", multiples(drawn_over)))
    if pairs := fronts(problem, searched, losses):
        lead = "No place on the Pareto front can be improved in one score without a loss in the other."
        sections.append(section("Trade-offs between scores", lead, multiples(pairs)))
    return page("Placement", problem.description, chips, sections, "Drawn by stridetwin place.")


def _table(problem: Problem, result: Mapping[str, Any]) -> str:
    knobs = [knob.name for knob in problem.knobs]
    head = ("place", *knobs, *(s.name for s in problem.scores))
    rows = [
        (
            Markup("<br>").join([str(row["rank"]), *([row["failed"]] if "failed" in row else [])]),
            *(said_value(row["values"], name) for name in knobs),
            *(interval_text(row["scores"].get(s.name)) for s in problem.scores),
        )
        for row in result["table"]
    ]
    return table(head, rows, range(1, len(head)))


def said_value(values: Mapping[str, Any], name: str) -> str:
    """The value of a knob in a table."""
    return format_value(values[name]) if values else AS_IT_IS


def value_map(problem: Problem, searched: Measured, losses: Array) -> str:
    """The first weighted score over the first two numbers of a sweep, at the best other values."""
    numbers = [knob for knob in problem.knobs if not knob.values]
    if problem.search is not None or len(numbers) < 2 or not _scored(searched, losses):
        return ""
    (across, up), k = numbers[:2], _weighing(problem)
    xs, ys = np.array(across.grid), np.array(up.grid)
    best = np.full((len(ys), len(xs)), np.nan)
    least = np.full(best.shape, np.inf)
    means = searched.values[..., k].mean(axis=1)
    for i in _scored(searched, losses):
        values = searched.places[i].values
        at = int(np.searchsorted(ys, values[up.name])), int(np.searchsorted(xs, values[across.name]))
        if losses[i] < least[at]:
            least[at], best[at] = losses[i], means[i]
    score = problem.scores[k]
    plot = Plot(
        title=f"{score.name} over {across.name} and {up.name}", x_label=across.name, y_label=up.name, height=440
    )  # fmt: skip
    plot.heatmap(xs, ys, best, label=score.name, reverse=not score.higher_is_better)
    top = np.unravel_index(np.argmin(least), least.shape)
    plot.dots([xs[top[1]]], [ys[top[0]]], ERROR, size=12, symbol="x", label=_best_label(losses))
    return plot.html()


def profiles(problem: Problem, searched: Measured, losses: Array) -> list[str]:
    """The first weighted score over each value: one dot per place; for a choice the best place with its interval."""
    there = _scored(searched, losses)
    return [(_over_choices if knob.values else _over_numbers)(knob, problem, searched, losses, there)
            for knob in problem.knobs if there]  # fmt: skip


def _scored(searched: Measured, losses: Array) -> list[int]:
    """Numbers of the places with a score, without the unchanged one."""
    return [i for i, place in enumerate(searched.places) if place.values and np.isfinite(losses[i])]


def _over_choices(knob: Knob, problem: Problem, searched: Measured, losses: Array, there: list[int]) -> str:
    k = _weighing(problem)
    best: dict[int, int] = {}
    for i in sorted(there, key=lambda i: losses[i]):
        best.setdefault(knob.values.index(searched.places[i].values[knob.name]), i)
    found = intervals(np.column_stack([searched.values[i, :, k] for i in best.values()]))
    plot = Plot(
        title=knob.name, x=(-0.5, len(knob.values) - 0.5), x_label=knob.name, y_label=problem.scores[k].name,
        x_names=[format_value(value) for value in knob.values],
    )  # fmt: skip
    at, means = list(best), [interval.mean for interval in found]
    ends = [(i.mean if i.low is None else i.low, i.mean if i.high is None else i.high) for i in found]
    plot.curves([[(x, low), (x, high)] for x, (low, high) in zip(at, ends)], _BEST, width=3, label="95 % interval")
    plot.dots(at, means, _BEST, size=10, label="best place")
    return plot.html()


def _over_numbers(knob: Knob, problem: Problem, searched: Measured, losses: Array, there: list[int]) -> str:
    k = _weighing(problem)
    shown = sorted(there, key=lambda i: losses[i])[:_MOST_DOTS]
    x = [searched.places[i].values[knob.name] for i in shown]
    means = searched.values[shown, :, k].mean(axis=1)
    plot = Plot(title=knob.name, x_label=knob.name, y_label=problem.scores[k].name)
    plot.dots(x, means, _DOT, size=_dot_px(len(x)), label="place")
    plot.dots(x[:1], means[:1], _BEST, size=9, label=_best_label(losses))
    if np.isfinite(losses[0]):
        unchanged = float(searched.values[0, :, k].mean())
        plot.line([min(x), max(x)], [unchanged, unchanged], _AS_IT_IS, width=1.2, label="unchanged")
    return plot.html()


def _best_label(losses: Array) -> str:
    """Name of the best place of a figure without the unchanged one, which may be better."""
    return "best but for the unchanged" if np.argmin(losses) == 0 else "best"


def _dot_px(count: int) -> int:
    return _DOT_PX if count > _FEW_DOTS else 2 * _DOT_PX


def fronts(problem: Problem, searched: Measured, losses: Array) -> list[Markup]:
    """The first score against each of the others: all places and the Pareto front."""
    means, plots = searched.values.mean(axis=1), []
    for k in range(1, len(problem.scores)):
        pair = [0, k]
        there = np.isfinite(means[:, pair]).all(axis=1)
        if not there.any() or not np.ptp(means[there][:, pair], axis=0).all():  # without a choice between the two
            continue
        sides = np.column_stack([problem.scores[i].losses(means[:, i]) for i in pair])
        best = sorted(front(np.where(there[:, None], sides, np.inf)), key=lambda i: means[i, 0])
        rows = np.flatnonzero(there)
        rows = rows[np.argsort(losses[rows], kind="stable")][:_MOST_DOTS]
        names = problem.scores[0].name, problem.scores[k].name
        plot = Plot(title=" and ".join(names), x_label=names[0], y_label=names[1], height=320)
        plot.dots(means[rows, 0], means[rows, k], _DOT, size=_dot_px(len(rows)), label="place")
        plot.line(means[best, 0], means[best, k], _BEST, width=1.2, label="Pareto front")
        plot.dots(means[best, 0], means[best, k], _BEST, size=8, label="Pareto front")
        if there[0]:
            plot.dots(means[:1, 0], means[:1, k], _AS_IT_IS, size=10, symbol="diamond", label="unchanged")
        plots.append(plot.html())
    return plots


def _weighing(problem: Problem) -> int:
    return next(i for i, score in enumerate(problem.scores) if score.weight)
