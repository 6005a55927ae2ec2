"""Figures of the terrain ahead: the ground along the route from above and from the side, coming steps, modes."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from itertools import groupby

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.locomotion_mode import MODES
from stridetwin.evaluation.map_scores import true_heights
from stridetwin.evaluation.mode_scores import ScoredMode, first_steps, predictions_by_step
from stridetwin.evaluation.terrain_ahead import CELL_M, HALF_WIDTH_M, Ahead
from stridetwin.evaluation.truth import along_way, edges
from stridetwin.pipeline.terrain_files import KIND_COLORS, KINDS
from stridetwin.report.figures_path import GROUND, INK, outline
from stridetwin.report.svg import Plot, data_range, wide_and_narrow
from stridetwin.streams.samples import Array

WORDS = {"LG": "level", "SA": "stairs up", "SD": "stairs down", "RA": "ramp up", "RD": "ramp down"}
WRONG = "#e03131"
_HEX = {kind: "#" + "".join(f"{c:02x}" for c in rgb) for kind, rgb in zip(KINDS, KIND_COLORS)}
_PALE = 0.45
_TRUE_STEP, _PATH = "#ffffff", "#5b6b7f"
_ROW_M, _NARROW_ROW_M, _MOST_ROWS = 12.0, 5.0, 8
WITHIN_95 = 2.448
"""Standard deviations that contain 95 % of a normal density in the plane."""
_LINE_M = 0.2
_CLEAR_M = 0.06
_LEAST_CLEAR = 0.3  # of the cells across the route


def ground_from_above(ahead: Ahead) -> str:
    """The ground along the route by class, with edges, the true path, true and predicted footprints (one step ahead).

    The route is unrolled and cut into rows, true to scale.
    """
    prints = _Prints(ahead)
    span = (max(float(ahead.seen.s[0]), prints.first - 0.6), min(float(ahead.seen.s[-1]), prints.last + 0.8))
    found = []
    for width, name, most in ((1120.0, "wide", _ROW_M), (420.0, "narrow", _NARROW_ROW_M)):
        rows = max(1, min(_MOST_ROWS if name == "wide" else 2 * _MOST_ROWS, math.ceil((span[1] - span[0]) / most)))
        bounds = np.linspace(*span, rows + 1)
        found += [
            _row(ahead, prints, width, (a, b), first=k == 0, last=k == rows - 1).svg(name)
            for k, (a, b) in enumerate(zip(bounds[:-1].tolist(), bounds[1:].tolist()))
        ]
    return "".join(found)


class _Prints:
    """Footprints along the unrolled route."""

    def __init__(self, ahead: Ahead) -> None:
        way = ahead.layout.way
        self.s = along_way([f.p_foot_in_world for f in ahead.footprints], ahead.layout)
        self.first, self.last = float(self.s.min()), float(self.s.max())
        self.heading = way.heading(self.s)
        self._origin = way.point(self.s)
        self.true = [self.unrolled(i, outline(f)) for i, f in enumerate(ahead.footprints)]
        self.told: list[tuple[Array, Array, Array, str] | None] = [None] * len(self.true)
        for i, first in enumerate(first_steps(ahead.footprints, ahead.estimates), 2):
            if first is None:
                continue
            estimate, step = first
            alignment = ahead.alignment.at(estimate.t_ns)
            shift = alignment.to_true(step.p_foot_in_world[:2]) - ahead.footprints[i].p_foot_in_world[:2]
            turn = self._turn(i) @ alignment.rotation
            place = self.unrolled(i, outline(ahead.footprints[i]) + shift)
            self.told[i] = place, place[:4].mean(axis=0), turn @ step.covariance @ turn.T, step.mode

    def unrolled(self, i: int, xy: Array) -> Array:
        """(N, 2) m along the route and to the left of it, for points near the i-th footprint."""
        return np.asarray((xy - self._origin[i]) @ self._turn(i).T + [self.s[i], 0.0])

    def _turn(self, i: int) -> Array:
        c, s = math.cos(self.heading[i]), math.sin(self.heading[i])
        return np.array([[c, s], [-s, c]])


def _row(ahead: Ahead, prints: _Prints, width: float, span: tuple[float, float], *, first: bool, last: bool) -> Plot:
    wide = width > 600
    metre = (width - 58.0) / (span[1] - span[0])
    height = 2 * HALF_WIDTH_M * metre + 28.0 + (40.0 if last else 24.0)
    plot = Plot(
        width=width, height=height, x=span, y=(-HALF_WIDTH_M, HALF_WIDTH_M), title="The ground from above",
        x_label="along the way, m" if last else "",
        y_label=("left of the way, m" if wide else "left, m") if first else "",
    )  # fmt: skip
    seen = ahead.seen
    some = (seen.s > span[0]) & (seen.s < span[1])
    if some.any():
        a, b = float(seen.s[some][0]) - CELL_M / 2, float(seen.s[some][-1]) + CELL_M / 2
        plot.image((a, b), plot.y, _picture(seen.kind[some], np.isfinite(seen.height[some])))
    s, left = _path(ahead)
    there = (s > span[0]) & (s < span[1])
    plot.line(s[there], left[there], _PATH, stroke=1.0)
    for at, low, high in seen.edges:
        if span[0] < at < span[1]:
            plot.line([at, at], np.clip([low, high], *plot.y), INK, stroke=1.4)
    steps = ahead.modes.steps if ahead.modes else []
    for i, true in enumerate(prints.true):
        if not span[0] < true[:, 0].mean() < span[1]:
            continue
        told = prints.told[i]
        if told is not None and np.isfinite(told[2]).all():
            plot.ellipse(told[1], told[2], WITHIN_95, "#ffffff66")
        plot.polygon(true[:, 0], true[:, 1], _TRUE_STEP, stroke="#46546a")
        if told is not None:
            ends = np.vstack([told[0], told[0][:1]])
            plot.line(ends[:, 0], ends[:, 1], _HEX[told[3]], stroke=1.8, dash="3 2")
        if i >= 2 and i - 2 < len(steps) and not steps[i - 2].right:
            x, y = true.mean(axis=0).tolist()
            _cross(plot, x, y, 0.08, 0.08)
    if first:
        for kind in _there(ahead):
            plot.legend(WORDS[kind] if wide else kind, _HEX[kind], "band")
        if wide:
            plot.legend("edge", INK)
            plot.legend("footprint", "#46546a")
            plot.legend("told a step before", _HEX["LG"], "3 2")
    return plot


def _picture(kind: NDArray[np.uint8], known: NDArray[np.bool_]) -> str:
    """A PNG of (S, L) kinds, the left of the route on top, as a data URI."""
    pale = 255 - _PALE * (255 - np.array(KIND_COLORS, float))
    bgra = np.zeros((*kind.shape, 4), np.uint8)
    bgra[..., :3] = pale[kind][..., ::-1]
    bgra[..., 3] = np.where(known, 255, 0)
    bgra[~known] = 0
    png = cv2.imencode(".png", np.ascontiguousarray(bgra[:, ::-1].transpose(1, 0, 2)))[1]
    return "data:image/png;base64," + base64.b64encode(png.tobytes()).decode("ascii")


def _path(ahead: Ahead) -> tuple[Array, Array]:
    """The walker's true path, m along the route and to the left of it."""
    way, p = ahead.layout.way, ahead.path[::8, :2]
    s = way.project(p)
    heading, off = way.heading(s), p - way.point(s)
    return s, np.asarray(off[:, 1] * np.cos(heading) - off[:, 0] * np.sin(heading))


def _there(ahead: Ahead) -> list[str]:
    """The modes that occur in ground or steps."""
    known = set(np.unique(ahead.seen.kind[np.isfinite(ahead.seen.height)]).tolist())
    steps = {m for s in (ahead.modes.steps if ahead.modes else []) for m in (s.mode, s.predicted)}
    return [mode for i, mode in enumerate(MODES) if i in known or mode in steps]


def _cross(plot: Plot, x: float, y: float, half_x: float, half_y: float) -> None:
    """A mark for an error."""
    for up in (1, -1):
        plot.line([x - half_x, x + half_x], [y - up * half_y, y + up * half_y], WRONG, stroke=2.4)


def ground_from_aside(ahead: Ahead) -> str:
    """Heights along the route: true ground, mapped ground by class, estimated edges."""
    s, height, kind = _middle(ahead)
    strips = ahead.layout.profile
    prints = _Prints(ahead)
    span = (prints.first - 0.6, prints.last + 0.8)
    shown = (s > span[0]) & (s < span[1])
    true = true_heights(strips, s)
    span_z = data_range(true[shown], height[shown], include=(float(true[shown].min()) - 0.12,))

    def draw(width: float) -> Plot:
        plot = Plot(
            width=width, height=280, x=span, y=span_z, title="The ground from aside", x_label="along the way, m",
            y_label="z, m",
        )  # fmt: skip
        for strip in strips:
            ends = np.clip([strip.s0, strip.s1], *span)
            if ends[1] > ends[0]:
                z = np.interp(ends, [strip.s0, strip.s1], [strip.z0, strip.z1])
                plot.polygon(np.r_[ends, ends[::-1]], np.r_[z, span_z[0], span_z[0]], GROUND[strip.terrain])
        for at in ahead.seen.edges[:, 0]:
            if span[0] < at < span[1]:
                ends = true_heights(strips, np.array([at - 0.1, at + 0.1]))
                plot.line([at, at], [ends.min() - 0.05, ends.max() + 0.05], INK, stroke=1.2)
        for number, name in enumerate(KINDS):
            own = np.where((kind == number) & shown, height, np.nan)
            if np.isfinite(own).any():
                plot.line(s, own, _HEX[name], stroke=2.4, label=_label(name, width))
        if width > 600:
            plot.legend("edge", INK)
            plot.legend("true ground", GROUND["stair"], "band")
        return plot

    return wide_and_narrow(draw)


def _label(kind: str, width: float) -> str:
    return (WORDS.get(kind, "not known") if width > 600 else kind).strip()


def ground_errors(ahead: Ahead) -> str:
    """Errors of the mapped heights, and of the edges' positions, along the route."""
    s, height, _ = _middle(ahead)
    prints = _Prints(ahead)
    span = (prints.first - 0.6, prints.last + 0.8)
    jumps = np.array([at for at, _, _ in edges(ahead.layout.profile)])
    away = np.abs(s[:, None] - jumps).min(axis=1) if len(jumps) else np.full(len(s), math.inf)
    off = np.where((away > _CLEAR_M) & (s > span[0]) & (s < span[1]),
                   1e3 * (height - true_heights(ahead.layout.profile, s)), np.nan)  # fmt: skip
    told = ahead.seen.edges[:, 0]
    told = told[(told > span[0]) & (told < span[1])]
    nearest = np.abs(told[:, None] - jumps).argmin(axis=1) if len(jumps) else np.zeros(0, int)
    place = 1e3 * (told - jumps[nearest]) if len(jumps) else np.zeros(0)
    known = np.abs(place) < 140.0
    top = max(10.0, float(np.nanmax(np.abs(np.r_[off, place[known]]), initial=0.0))) * 1.1

    def draw(width: float) -> Plot:
        plot = Plot(
            width=width, height=200, x=span, y=(-top, top), title="Errors of the mapped ground",
            x_label="along the way, m", y_label="told less true, mm",
        )  # fmt: skip
        plot.line(span, (0.0, 0.0), "#b8c3d0", stroke=1.0)
        plot.line(s, off, "#0b6bcb", stroke=1.4, label="height")
        plot.dots(told[known], place[known], INK, radius=3.0, label="edge along the way")
        return plot

    return wide_and_narrow(draw)


def _middle(ahead: Ahead) -> tuple[Array, Array, NDArray[np.uint8]]:
    """Position along the route, m; mapped height of its middle, m; and the most frequent kind there."""
    seen = ahead.seen
    across = np.abs(seen.left) < _LINE_M
    height, kind = seen.height[:, across], seen.kind[:, across]
    known = np.isfinite(height)
    enough = known.mean(axis=1) > _LEAST_CLEAR
    middle = np.full(len(seen.s), np.nan)
    middle[enough] = [np.median(row[there]) for row, there in zip(height[enough], known[enough])]
    counts = np.stack([((kind == k) & known).sum(axis=1) for k in range(len(KINDS))], axis=1)
    return seen.s, middle, counts.argmax(axis=1).astype(np.uint8)


def mode_ribbon(ahead: Ahead) -> str:
    """Over time: the true mode of each step, the prediction of the next one with its probability, and the errors."""
    steps = ahead.modes.steps if ahead.modes else []
    told = [e for e in ahead.estimates if e.steps]
    if not steps or not told:
        return ""
    runs = told_runs(ahead)
    begin, end = min(runs[0][0], steps[0].t_s), steps[-1].t_s + 0.3
    t = np.array([e.t_ns * 1e-9 for e in told])
    p = np.array([e.steps[0].probabilities[e.steps[0].mode] for e in told])
    shown = t < end

    def draw(width: float) -> Plot:
        plot = Plot(
            width=width, height=210, x=(begin, end), y=(-0.08, 3.9), title="Modes over time", x_label="time, s",
            y_names={3.4: "true", 2.4: "told", 1.6: "1", 0.8: "p", 0.0: "0"},
        )  # fmt: skip
        for low in (0.0, 1.6):
            plot.line((begin, end), (low, low), "#e6ebf1", stroke=1.0)
        before = begin
        for step in steps:
            _bar(plot, before, step.t_s, 3.0, 3.8, _HEX[step.mode])
            before = step.t_s
        for a, b, mode, right in runs:
            _bar(plot, a, min(b, end), 2.0, 2.8, _HEX[mode])
            if not right:
                _bar(plot, a, min(b, end), 1.86, 1.98, WRONG)
        for step in wrong_steps(steps):
            _cross(plot, step.t_s, 2.4, 0.006 * (end - begin), 0.3)
        plot.line(t[shown], 1.6 * p[shown], INK, stroke=1.0)
        for kind in _there(ahead):
            plot.legend(WORDS[kind] if width > 600 else kind, _HEX[kind], "band")
        plot.legend("wrong", WRONG)
        return plot

    return wide_and_narrow(draw)


def told_runs(ahead: Ahead) -> list[tuple[float, float, str, bool]]:
    """Time spans with one predicted mode of the coming step: from, to (s), the mode, whether it is right.

    A span ends with the next estimate, at the latest at touch-down; the one that ends at touch-down is scored.
    """
    steps = ahead.modes.steps if ahead.modes else []
    told = predictions_by_step(ahead.footprints[2:], ahead.estimates)
    found = []
    before = -math.inf
    for step, own in zip(steps, told):
        next_ = [(e.t_ns * 1e-9, e.steps[k].mode) for e, k in own if e.t_ns * 1e-9 > before]
        ends = [*(t for t, _ in next_[1:]), step.t_s]
        for mode, run in groupby(zip(next_, ends), key=lambda row: row[0][1]):
            spans = list(run)
            found.append((spans[0][0][0], spans[-1][1], mode, mode in step.allowed))
        before = step.t_s
    return found


def wrong_steps(steps: Sequence[ScoredMode]) -> list[ScoredMode]:
    """The steps that are marked."""
    return [step for step in steps if not step.right]


def lead_times(ahead: Ahead) -> str:
    """How long before each touch-down its mode was finally predicted right."""
    steps = ahead.modes.steps if ahead.modes else []
    if not steps:
        return ""
    span = (steps[0].t_s - 0.6, steps[-1].t_s + 0.6)
    half = 0.3 * float(np.median(np.diff([s.t_s for s in steps]))) if len(steps) > 1 else 0.2
    top = 1.1 * max(1.0, *(s.lead_s for s in steps))

    def draw(width: float) -> Plot:
        plot = Plot(
            width=width, height=180, x=span, y=(0.0, top), title="Lead", x_label="touch-down, s",
            y_label="known for good before touch-down, s" if width > 600 else "lead, s",
        )  # fmt: skip
        for step in steps:
            _bar(plot, step.t_s - half, step.t_s + half, 0.0, step.lead_s, _HEX[step.mode])
            if step.transition:
                plot.dots([step.t_s], [step.lead_s], INK, radius=2.6)
        for step in wrong_steps(steps):
            _cross(plot, step.t_s, 0.06 * top, 0.006 * (span[1] - span[0]), 0.05 * top)
        plot.legend("changes the mode", INK, "dot")
        plot.legend("wrong", WRONG)
        return plot

    return wide_and_narrow(draw)


def _bar(plot: Plot, x0: float, x1: float, y0: float, y1: float, color: str) -> None:
    if x1 > x0 and y1 > y0:
        plot.polygon([x0, x1, x1, x0], [y0, y0, y1, y1], color)
