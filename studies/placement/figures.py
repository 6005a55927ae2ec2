"""Figures of a placement: a map over two values, the score over each value, and the front between scores."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from stridetwin.report.svg import Plot, data_range
from stridetwin.streams.samples import Array
from stridetwin.studies.placement.free import Knob
from stridetwin.studies.placement.measure import Measured
from stridetwin.studies.placement.places import format_value
from stridetwin.studies.placement.problem_file import Problem
from stridetwin.studies.placement.significance import front, intervals

_DOT, _BEST, _AS_IT_IS = "#7a8fa8", "#0b6bcb", "#c2410c"
_VIRIDIS = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]])  # van der Walt & Smith
_MOST_DOTS = 2000


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
    for i, place in enumerate(searched.places):
        if place.values and np.isfinite(losses[i]):
            at = int(np.searchsorted(ys, place.values[up.name])), int(np.searchsorted(xs, place.values[across.name]))
            if losses[i] < least[at]:
                least[at], best[at] = losses[i], means[i]
    x_edges, y_edges = _edges(xs), _edges(ys)
    score = problem.scores[k]
    plot = Plot(
        width=640.0, height=440.0, x=(x_edges[0], x_edges[-1]), y=(y_edges[0], y_edges[-1]),
        title=f"{score.name} over {across.name} and {up.name}", x_label=across.name, y_label=up.name,
    )  # fmt: skip
    low, high = float(np.nanmin(best)), float(np.nanmax(best))
    for r, (y0, y1) in enumerate(pairwise(y_edges)):
        for c, (x0, x1) in enumerate(pairwise(x_edges)):
            if np.isfinite(best[r, c]):
                share = (best[r, c] - low) / (high - low) if high > low else 1.0
                share = share if score.higher_is_better else 1.0 - share
                plot.polygon([x0, x1, x1, x0], [y0, y0, y1, y1], _colour(share))
    top = np.unravel_index(np.argmin(least), least.shape)
    plot.dots([xs[top[1]]], [ys[top[0]]], "#ffffff", radius=5)
    plot.dots([xs[top[1]]], [ys[top[0]]], "#0f1c2e", radius=3)
    ends = (high, low) if score.higher_is_better else (low, high)
    plot.legend(f"{score.name} {ends[1]:.4g}", _colour(0.0), "band")
    plot.legend(f"{ends[0]:.4g}", _colour(1.0), "band")
    return plot.svg()


def profiles(problem: Problem, searched: Measured, losses: Array) -> list[str]:
    """The first weighted score over each value: one dot per place; for a choice the best place with its interval."""
    return [_profile(knob, problem, searched, losses) for knob in problem.knobs if _scored(searched, losses)]


def _scored(searched: Measured, losses: Array) -> list[int]:
    """Numbers of the places with a score, without the unchanged one."""
    return [i for i, place in enumerate(searched.places) if place.values and np.isfinite(losses[i])]


def _profile(knob: Knob, problem: Problem, searched: Measured, losses: Array) -> str:
    k = _weighing(problem)
    score = problem.scores[k]
    there = _scored(searched, losses)
    means = searched.values[..., k].mean(axis=1)
    names = [format_value(value) for value in knob.values]
    if names:
        best = [min((i for i in there if searched.places[i].values[knob.name] == value), key=lambda i: losses[i],
                    default=None) for value in knob.values]  # fmt: skip
        found = {c: i for c, i in enumerate(best) if i is not None}
        told_of = dict(zip(found, intervals(np.column_stack([searched.values[i, :, k] for i in found.values()]))))
        ends = [x for t in told_of.values() for x in (t.mean, t.low, t.high) if x is not None]
        plot = Plot(width=420.0, height=220.0, x=(-0.5, len(names) - 0.5), y=data_range(ends), title=knob.name,
                    x_label=knob.name, y_label=score.name, x_names=names)  # fmt: skip
        for c, told_c in told_of.items():
            if told_c.low is not None and told_c.high is not None:
                plot.line([c, c + 1e-6], [told_c.low, told_c.high], _BEST, stroke=3)
            plot.dots([c], [told_c.mean], _BEST, radius=5)
        return plot.svg()
    drawn = sorted(there, key=lambda i: losses[i])[:_MOST_DOTS]
    x = np.array([searched.places[i].values[knob.name] for i in drawn])
    plot = Plot(width=420.0, height=220.0, x=data_range(x), y=data_range(means[drawn]), title=knob.name,
                x_label=knob.name, y_label=score.name)  # fmt: skip
    plot.dots(x[::-1], means[drawn][::-1], _DOT, radius=1.8)
    plot.dots(x[:1], means[drawn][:1], _BEST, radius=4.5, label="best")
    return plot.svg()


def fronts(problem: Problem, searched: Measured, losses: Array) -> list[str]:
    """The first score against each of the others: all places and the Pareto front."""
    means, plots = searched.values.mean(axis=1), []
    for k in range(1, len(problem.scores)):
        pair = [0, k]
        there = np.isfinite(means[:, pair]).all(axis=1)
        if not there.any():
            continue
        sides = np.column_stack([problem.scores[i].losses(means[:, i]) for i in pair])
        ahead = front(np.where(there[:, None], sides, np.inf))
        ahead.sort(key=lambda i: means[i, 0])
        rows = np.flatnonzero(there)
        rows = rows[np.argsort(losses[rows], kind="stable")][:_MOST_DOTS]
        plot = Plot(
            width=520.0, height=320.0, x=data_range(means[there, 0]), y=data_range(means[there, k]),
            title=f"{problem.scores[0].name} and {problem.scores[k].name}", x_label=problem.scores[0].name,
            y_label=problem.scores[k].name,
        )  # fmt: skip
        plot.dots(means[rows, 0], means[rows, k], _DOT, radius=1.8)
        plot.line(means[ahead, 0], means[ahead, k], _BEST, stroke=1.2)
        plot.dots(means[ahead, 0], means[ahead, k], _BEST, radius=4, label="front")
        if there[0]:
            plot.dots(means[:1, 0], means[:1, k], _AS_IT_IS, radius=5, label="as it is")
        plots.append(plot.svg())
    return plots


def _weighing(problem: Problem) -> int:
    return next(i for i, score in enumerate(problem.scores) if score.weight)


def _edges(values: Array) -> Array:
    """(N + 1,) edges half way between (N,) values."""
    if len(values) == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    half = np.diff(values) / 2
    return np.concatenate([[values[0] - half[0]], values[:-1] + half, [values[-1] + half[-1]]])


def _colour(share: float) -> str:
    rgb = [round(float(np.interp(share, np.linspace(0, 1, 5), _VIRIDIS[:, c]))) for c in range(3)]
    return "#{:02x}{:02x}{:02x}".format(*rgb)
