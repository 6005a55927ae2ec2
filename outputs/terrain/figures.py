"""Figures of the terrain ahead: the ground along the route from above and from the side, coming steps, modes."""

from __future__ import annotations

import math
from itertools import groupby, pairwise

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from stridetwin.estimators.locomotion_mode import MODES
from stridetwin.outputs.modes.scores import first_steps, predictions_by_step
from stridetwin.outputs.path.figures import draw_profile, outline
from stridetwin.outputs.terrain.files import KIND_COLORS, KINDS
from stridetwin.outputs.terrain.scores import true_heights
from stridetwin.outputs.terrain_ahead import CELL_M, HALF_WIDTH_M, Ahead
from stridetwin.outputs.truth import along_way, edges
from stridetwin.pages.plot import ERROR, INK, MUTED, PALETTE, Plot, Range, data_range, faint
from stridetwin.report.images import data_uri
from stridetwin.streams.samples import Array

WORDS = {"LG": "level", "SA": "stairs up", "SD": "stairs down", "RA": "ramp up", "RD": "ramp down"}
_PALE = (255 - 0.45 * (255 - np.array(KIND_COLORS, float))).astype(np.uint8)  # of the mapped ground
_HEX, _PALE_HEX = (
    {kind: "#" + bytes(rgb).hex() for kind, rgb in zip(KINDS, colors)} for colors in (KIND_COLORS, _PALE)
)
_TRUE_STEP = "#46546a"
_ROW_M, _MOST_ROWS = 10.0, 8
_WITHIN_95 = 2.448  # standard deviations that contain 95 % of a normal density in the plane
_ROUND = np.linspace(0.0, 2.0 * math.pi, 25)
_LINE_M = 0.2
_CLEAR_M = 0.06
_LEAST_CLEAR = 0.3  # of the cells across the route
_EDGE_MM = 140.0  # an estimated edge farther than this from every true one matches none


def ellipse(middle: Array, covariance: Array) -> Array:
    """(25, 2) the ellipse that contains 95 % of a normal density in the plane."""
    variances, axes = np.linalg.eigh(covariance)
    half = _WITHIN_95 * np.sqrt(np.maximum(variances, 0.0))
    return np.asarray(middle[:2] + (np.column_stack([np.cos(_ROUND), np.sin(_ROUND)]) * half) @ axes.T)


def ground_from_above(ahead: Ahead) -> Markup:
    """The ground along the route by class, with edges, the true path, true and predicted footprints (one step ahead).

    The route is unrolled and cut into rows, true to scale.
    """
    prints = _Prints(ahead)
    span = (max(float(ahead.seen.s[0]), prints.first - 0.6), min(float(ahead.seen.s[-1]), prints.last + 0.8))
    count = max(1, min(_MOST_ROWS, math.ceil((span[1] - span[0]) / _ROW_M)))
    rows = pairwise(np.linspace(*span, count + 1).tolist())
    return Markup("").join(_row(ahead, prints, row, k, last=k == count - 1) for k, row in enumerate(rows))


class _Prints:
    """Footprints along the unrolled route."""

    def __init__(self, ahead: Ahead) -> None:
        way = ahead.layout.way
        self.s = along_way([f.p_foot_in_world for f in ahead.footprints], ahead.layout)
        self.first, self.last = float(self.s.min()), float(self.s.max())
        self.heading = way.heading(self.s)
        self._origin = way.point(self.s)
        self.true = [self.unrolled(i, outline(f)) for i, f in enumerate(ahead.footprints)]
        self.predicted: list[tuple[Array, Array, str] | None] = [None] * len(self.true)
        for i, first in enumerate(first_steps(ahead.footprints, ahead.estimates), 2):
            if first is None:
                continue
            estimate, step = first
            alignment = ahead.alignment.at(estimate.t_ns)
            shift = alignment.to_true(step.p_foot_in_world[:2]) - ahead.footprints[i].p_foot_in_world[:2]
            rotation = self._rotation(i) @ alignment.rotation
            place = self.unrolled(i, outline(ahead.footprints[i]) + shift)
            self.predicted[i] = place, rotation @ step.covariance @ rotation.T, step.mode

    def unrolled(self, i: int, xy: Array) -> Array:
        """(N, 2) m along the route and to the left of it, for points near the i-th footprint."""
        return np.asarray((xy - self._origin[i]) @ self._rotation(i).T + [self.s[i], 0.0])

    def _rotation(self, i: int) -> Array:
        c, s = math.cos(self.heading[i]), math.sin(self.heading[i])
        return np.array([[c, s], [-s, c]])


def _row(ahead: Ahead, prints: _Prints, span: Range, number: int, *, last: bool) -> Markup:
    plot = Plot(
        title="The ground from above" if number == 0 else f"The ground from above, row {number + 1}", x=span,
        y=(-HALF_WIDTH_M, HALF_WIDTH_M), to_scale=True,
        x_label="along the route, m" if last else "", y_label="left, m",
        continued=number > 0,
    )  # fmt: skip
    seen = ahead.seen
    for kind in np.unique(seen.kind[np.isfinite(seen.height)]).tolist() if number == 0 else ():
        name = KINDS[kind]
        plot.key(f"mapped: {WORDS.get(name, 'unknown class')}", _PALE_HEX[name])
    inside = (seen.s > span[0]) & (seen.s < span[1])
    if inside.any():
        a, b = float(seen.s[inside][0]) - CELL_M / 2, float(seen.s[inside][-1]) + CELL_M / 2
        uri = _class_image(seen.kind[inside], np.isfinite(seen.height[inside]))
        plot.image((a, b), (-HALF_WIDTH_M, HALF_WIDTH_M), uri)
    s, left = _path(ahead)
    there = (s > span[0]) & (s < span[1])
    plot.line(s[there], left[there], MUTED, width=1.0, label="true path of the camera")
    edges_here = [([at, low], [at, high]) for at, low, high in seen.edges if span[0] < at < span[1]]
    plot.curves(edges_here, INK, width=1.6, label="mapped edge")
    shown = [i for i, true in enumerate(prints.true) if span[0] < true[:, 0].mean() < span[1]]
    plot.areas([prints.true[i] for i in shown], "#ffffff", stroke=_TRUE_STEP, label="true footprint")
    predicted = [found for i in shown if (found := prints.predicted[i]) is not None]
    ellipses = [ellipse(p.mean(axis=0), covariance) for p, covariance, _ in predicted if np.isfinite(covariance).all()]
    plot.areas(ellipses, faint(MUTED, 0.2), label="95 % ellipse")
    for mode in dict.fromkeys(mode for _, _, mode in predicted):
        own = [np.vstack([place, place[:1]]) for place, _, m in predicted if m == mode]
        plot.curves(own, _HEX[mode], width=2.0, label="predicted footprint, in its mode's colour")
    steps = ahead.modes.steps if ahead.modes else []
    wrong = [prints.true[i].mean(axis=0) for i in shown if 2 <= i < len(steps) + 2 and not steps[i - 2].right]
    _draw_crosses(plot, np.reshape(wrong, (-1, 2)))
    return plot.html()


def _class_image(kind: NDArray[np.uint8], known: NDArray[np.bool_]) -> str:
    """A PNG of (S, L) kinds, the left of the route on top, as a data URI."""
    bgra = np.zeros((*kind.shape, 4), np.uint8)
    bgra[..., :3] = _PALE[kind][..., ::-1]
    bgra[..., 3] = 255
    bgra[~known] = 0
    png = cv2.imencode(".png", np.ascontiguousarray(bgra[:, ::-1].transpose(1, 0, 2)))[1]
    return data_uri(png.tobytes(), "image/png")


def _path(ahead: Ahead) -> tuple[Array, Array]:
    """The walker's true path, m along the route and to the left of it."""
    way, p = ahead.layout.way, ahead.path[::8, :2]
    s = way.project(p)
    heading, off = way.heading(s), p - way.point(s)
    return s, np.asarray(off[:, 1] * np.cos(heading) - off[:, 0] * np.sin(heading))


def _draw_crosses(plot: Plot, at: Array) -> None:
    """(N, 2) marks for errors."""
    if len(at):
        plot.dots(at[:, 0], at[:, 1], ERROR, size=10, symbol="x", label="wrong")


def ground_from_aside(ahead: Ahead) -> Markup:
    """Heights along the route: true ground, mapped ground by class, estimated edges."""
    s, height, kind = _middle(ahead)
    profile, prints = ahead.layout.profile, _Prints(ahead)
    span = (prints.first - 0.6, prints.last + 0.8)
    shown = (s > span[0]) & (s < span[1])
    true = true_heights(profile, s)
    span_z = data_range(true[shown], height[shown], include=(float(true[shown].min()) - 0.12,))
    plot = Plot(
        title="The ground from the side", x=span, y=span_z, x_label="along the route, m", y_label="height, m",
        height=280,
    )  # fmt: skip
    draw_profile(plot, profile, span, span_z[0])
    edges_here = []
    for at in ahead.seen.edges[:, 0]:
        ends = true_heights(profile, np.array([at - 0.1, at + 0.1]))
        edges_here.append([(at, ends.min() - 0.05), (at, ends.max() + 0.05)])
    plot.curves(edges_here, INK, width=1.2, label="mapped edge")
    for number, name in enumerate(KINDS):
        own = np.where((kind == number) & shown, height, np.nan)
        if np.isfinite(own).any():
            plot.line(s, own, _HEX[name], width=2.4, label=f"mapped: {WORDS.get(name, 'unknown class')}")
    return plot.html()


def ground_errors(ahead: Ahead) -> Markup:
    """Errors of the mapped heights, and of the edges' positions, along the route."""
    s, height, _ = _middle(ahead)
    prints = _Prints(ahead)
    span = (prints.first - 0.6, prints.last + 0.8)
    jumps = np.array([at for at, _, _ in edges(ahead.layout.profile)])
    away = np.abs(s[:, None] - jumps).min(axis=1) if len(jumps) else np.full(len(s), math.inf)
    off = np.where((away > _CLEAR_M) & (s > span[0]) & (s < span[1]),
                   1e3 * (height - true_heights(ahead.layout.profile, s)), np.nan)  # fmt: skip
    mapped = ahead.seen.edges[:, 0]
    mapped = mapped[(mapped > span[0]) & (mapped < span[1])]
    nearest = np.abs(mapped[:, None] - jumps).argmin(axis=1) if len(jumps) else np.zeros(0, int)
    place = 1e3 * (mapped - jumps[nearest]) if len(jumps) else np.zeros(0)
    known = np.abs(place) < _EDGE_MM
    top = max(10.0, float(np.nanmax(np.abs(np.r_[off, place[known]]), initial=0.0))) * 1.1
    plot = Plot(
        title="Errors of the mapped ground", x=span, y=(-top, top), x_label="along the route, m",
        y_label="estimated minus true, mm", height=240,
    )  # fmt: skip
    plot.line(s, off, PALETTE[0], width=1.4, label="height")
    if known.any():
        plot.dots(mapped[known], place[known], INK, label="position of an edge along the route")
    return plot.html()


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
    estimates = [e for e in ahead.estimates if e.steps]
    if not steps or not estimates:
        return ""
    runs = prediction_runs(ahead)
    begin, end = min(runs[0][0], steps[0].t_s), steps[-1].t_s + 0.3
    t = np.array([e.t_ns * 1e-9 for e in estimates])
    p = np.array([e.steps[0].probabilities[e.steps[0].mode] for e in estimates])
    plot = Plot(
        title="Modes over time", x=(begin, end), y=(-0.08, 3.9), x_label="time, s", y_label="mode, probability",
        height=270,
        y_names={3.4: "true", 2.4: "predicted", 1.6: "p = 1", 0.8: "p = 0.5", 0.0: "p = 0"},
    )  # fmt: skip
    touched = np.array([begin, *(step.t_s for step in steps)])
    for mode in MODES:
        true = np.array([step.mode == mode for step in steps])
        plot.bars(touched[:-1][true], touched[1:][true], 3.0, 3.8, _HEX[mode], label=WORDS[mode])
        own = np.array([(a, min(b, end)) for a, b, m, _ in runs if m == mode]).reshape(-1, 2)
        plot.bars(own[:, 0], own[:, 1], 2.0, 2.8, _HEX[mode], label=WORDS[mode])
    wrong = np.array([(a, min(b, end)) for a, b, _, right in runs if not right]).reshape(-1, 2)
    plot.bars(wrong[:, 0], wrong[:, 1], 1.86, 1.98, ERROR, label="wrong")
    _draw_crosses(plot, np.array([(step.t_s, 2.4) for step in steps if not step.right]).reshape(-1, 2))
    plot.line(t[t < end], 1.6 * p[t < end], INK, width=1.0, label="probability")
    return plot.html()


def prediction_runs(ahead: Ahead) -> list[tuple[float, float, str, bool]]:
    """Time spans with one predicted mode of the coming step: from, to (s), the mode, whether it is right.

    A span ends with the next estimate, at the latest at touch-down; the one that ends at touch-down is scored.
    """
    steps = ahead.modes.steps if ahead.modes else []
    by_step = predictions_by_step(ahead.footprints[2:], ahead.estimates)
    found = []
    before = -math.inf
    for step, own in zip(steps, by_step):
        next_ = [(e.t_ns * 1e-9, e.steps[k].mode) for e, k in own if e.t_ns * 1e-9 > before]
        ends = [*(t for t, _ in next_[1:]), step.t_s]
        for mode, run in groupby(zip(next_, ends), key=lambda row: row[0][1]):
            spans = list(run)
            found.append((spans[0][0][0], spans[-1][1], mode, mode in step.allowed))
        before = step.t_s
    return found


def lead_times(ahead: Ahead) -> str:
    """How long before each touch-down its mode was finally predicted right."""
    steps = ahead.modes.steps if ahead.modes else []
    if not steps:
        return ""
    t, lead = np.array([s.t_s for s in steps]), np.array([s.lead_s for s in steps])
    half = 0.3 * float(np.median(np.diff(t))) if len(steps) > 1 else 0.2
    top = 1.1 * max(1.0, float(lead.max()))
    plot = Plot(
        title="Lead time", x=(t[0] - 0.6, t[-1] + 0.6), y=(0.0, top), height=250,
        x_label="touch-down, s", y_label="lead time, s",
    )  # fmt: skip
    for mode in MODES:
        own = np.array([s.mode == mode and s.lead_s > 0 for s in steps])
        plot.bars(t[own] - half, t[own] + half, 0.0, lead[own], _HEX[mode], label=WORDS[mode])
    changes = np.array([s.transition for s in steps])
    if changes.any():
        plot.dots(t[changes], lead[changes], INK, label="changes the mode")
    _draw_crosses(plot, np.array([(s.t_s, 0.06 * top) for s in steps if not s.right]).reshape(-1, 2))
    return plot.html()
