"""Figures of a walk's path: side view, plan view, error over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stridetwin.estimators.base import FEET
from stridetwin.evaluation.evaluate import Estimate, Result
from stridetwin.evaluation.path_scores import CHI2_3_95
from stridetwin.report.svg import Plot, Range, data_range, wide_and_narrow
from stridetwin.sim.world.route import Layout
from stridetwin.streams.samples import Array, Block, Footprint

INK = "#0f1c2e"
COLORS = {"l": "#0b6bcb", "r": "#d9480f", "camera": "#5f3dc4"}
_SECOND = {"l": "#0a7d7d", "r": "#a3327a"}
_SHADES = {"l": "#9cc4ee", "r": "#f3b898", "camera": "#c5b6f0"}
GROUND = {"level": "#dde4ec", "stair": "#c7d6e6", "ramp": "#d3e3d2"}
_FOOT_M, _HALF_FOOT_M = 0.26, 0.045

_Lines = tuple[tuple[Array, Array], tuple[Array, Array]]  # (horizontal, vertical) of the truth, of the estimate


def part_of(estimate: Estimate) -> str:
    """The body of a path: the foot `l` or `r`, or the `camera`."""
    return next((foot for foot in FEET if estimate.frame.startswith(f"foot_{foot}/")), "camera")


def label_of(estimate: Estimate) -> str:
    """The label of an estimate in a figure: `left`, `left, feet together`, or `camera`."""
    words = FEET.get(part_of(estimate), "camera")
    label = estimate.name if estimate.label is None else estimate.label
    return f"{words}, {label}" if label else words


def _colour(estimate: Estimate) -> str:
    return _SECOND.get(part_of(estimate), COLORS["camera"]) if estimate.label != "" else COLORS[part_of(estimate)]


def side_view(layout: Layout | None, results: Sequence[Result]) -> str:
    """Heights along the route: terrain, true and estimated paths."""
    lines = [_along(layout, result) for result in results]
    every_s = np.concatenate([s for line in lines for s, _ in line])
    every_z = np.concatenate([z for line in lines for _, z in line])
    profile = layout.profile if layout else ()
    span_s = (float(every_s.min()) - 0.6, float(every_s.max()) + 0.6)
    floor = min((min(s.z0, s.z1) for s in profile), default=float(every_z.min()))
    span_z = data_range(every_z, include=(floor - 0.12,))

    def draw(width: float) -> Plot:
        plot = Plot(
            width=width, height=300, x=span_s, y=span_z, title="Side view", x_label="along the way, m", y_label="z, m"
        )
        for strip in profile:
            s = np.clip([strip.s0, strip.s1], *span_s)
            if s[1] > s[0]:
                z = np.interp(s, [strip.s0, strip.s1], [strip.z0, strip.z1])
                corners = np.r_[z, span_z[0], span_z[0]]
                plot.polygon(np.r_[s, s[::-1]], corners, GROUND[strip.terrain])
        _paths(plot, results, lines)
        return plot

    return wide_and_narrow(draw)


def plan_view(layout: Layout | None, results: Sequence[Result], footprints: Block[Footprint] | None) -> str:
    """The walk from above: ground, footprints, true and estimated paths; true to scale if it turns."""
    prints = [] if footprints is None else [outline(p) for p in footprints]
    lines = [_from_above(result) for result in results]
    every_x = [x for line in lines for x, _ in line] + [p[:, 0] for p in prints]
    every_y = [y for line in lines for _, y in line] + [p[:, 1] for p in prints]
    turns = layout is not None and any(piece.curvature for piece in layout.way.pieces)
    span_x, span_y = data_range(*every_x, margin=0.02), data_range(*every_y, margin=0.05 if turns else 0.2)

    def draw(width: float) -> Plot:
        height, x, y = to_scale(width, span_x, span_y) if turns else (260.0, span_x, span_y)
        plot = Plot(width=width, height=height, x=x, y=y, title="Plan view", x_label="x, m", y_label="y, m")
        for slab in layout.slabs if layout and turns else ():
            corners = slab.point([0, slab.length, slab.length, 0], [-slab.right, -slab.right, slab.left, slab.left])
            plot.polygon(np.clip(corners[:, 0], *x), np.clip(corners[:, 1], *y), GROUND[slab.terrain])
        for outline in prints:
            plot.polygon(outline[:, 0], outline[:, 1], "#f6f8fa", stroke="#a9b8c8")
        _paths(plot, results, lines)
        return plot

    return wide_and_narrow(draw)


def error_over_time(results: Sequence[Result]) -> str:
    """Position error of every estimate, and the 95 % bound that the estimator reports."""
    errors = [np.linalg.norm(r.comparison.error_m, axis=1) for r in results]
    bounds = [_bound(r) for r in results]
    span_t = data_range(*(_seconds(r) for r in results), margin=0.0)
    top = max(float(e.max()) for e in errors)
    believed = max((float(b[-1]) for b in bounds if b is not None), default=0.0)

    def draw(width: float) -> Plot:
        plot = Plot(
            width=width,
            height=260,
            x=span_t,
            y=(0.0, 1.1 * 1000 * max(top, min(believed, 3 * top), 1e-3)),
            title="Position error over time",
            x_label="time, s",
            y_label="error, mm",
        )
        for result, error, bound in zip(results, errors, bounds):
            part, t = part_of(result.estimate), _seconds(result)
            first = result.estimate.label == ""
            if bound is not None:
                shown = np.where(1000 * bound <= plot.y[1], 1000 * bound, np.nan)
                plot.line(
                    t,
                    shown,
                    _SHADES[part],
                    dash="4 3",
                    label=f"{label_of(result.estimate)}, own 95 %" if width > 600 and first else "",
                )
            plot.line(t, 1000 * error, _colour(result.estimate), label=label_of(result.estimate), stroke=1.8)
        return plot

    return wide_and_narrow(draw)


def _paths(plot: Plot, results: Sequence[Result], lines: Sequence[_Lines]) -> None:
    for i, (truth, _) in enumerate(lines):
        plot.line(*truth, INK, stroke=1.0, label="truth" if i == 0 else "")
    for result, (_, estimate) in zip(results, lines):
        made = result.estimate
        plot.line(*estimate, _colour(made), dash="5 3", label=label_of(made), stroke=1.6)


def _from_above(result: Result) -> _Lines:
    """X and y of the true and of the estimated path."""
    truth, estimate = (p.p_frame_in_world for p in (result.comparison.truth, result.comparison.estimate))
    return (truth[:, 0], truth[:, 1]), (estimate[:, 0], estimate[:, 1])


def _along(layout: Layout | None, result: Result) -> _Lines:
    """Arc length along the route and height, of the true and of the estimated path.

    The estimate is offset from the truth by the component of its error along the route.
    """
    truth, estimate = (p.p_frame_in_world for p in (result.comparison.truth, result.comparison.estimate))
    s, heading = truth[:, 0], np.zeros(len(truth))
    if layout is not None:
        s = layout.way.project(truth[:, :2])
        heading = layout.way.heading(s)
    error = estimate - truth
    ahead = error[:, 0] * np.cos(heading) + error[:, 1] * np.sin(heading)
    return (s, truth[:, 2]), (s + ahead, estimate[:, 2])


def outline(footprint: Footprint) -> Array:
    """(4, 2) corners of a print in the world."""
    w, x, y, z = footprint.q_world_foot
    toes = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z)])
    aside = np.array([-toes[1], toes[0]])
    local = [(0.0, -_HALF_FOOT_M), (_FOOT_M, -_HALF_FOOT_M), (_FOOT_M, _HALF_FOOT_M), (0.0, _HALF_FOOT_M)]
    return np.array([footprint.p_foot_in_world[:2] + u * toes + v * aside for u, v in local])


def to_scale(width: float, x: Range, y: Range, least: float = 200.0) -> tuple[float, Range, Range]:
    """Height of a plot, and ranges at least as wide as requested, so that both axes have the same scale."""
    inner = width - 60.0
    height = float(np.clip(inner * (y[1] - y[0]) / (x[1] - x[0]), least, 640.0))
    metre = min(inner / (x[1] - x[0]), height / (y[1] - y[0]))
    wide, tall = inner / metre, height / metre
    middle_x, middle_y = (x[0] + x[1]) / 2, (y[0] + y[1]) / 2
    return height + 68.0, (middle_x - wide / 2, middle_x + wide / 2), (middle_y - tall / 2, middle_y + tall / 2)


def _seconds(result: Result) -> Array:
    return np.asarray(result.comparison.truth.t_ns * 1e-9)


def _bound(result: Result) -> Array | None:
    covariance = result.comparison.estimate.covariance
    if covariance is None:
        return None
    return np.asarray(np.sqrt(CHI2_3_95 * np.linalg.eigvalsh(covariance[:, :3, :3])[:, -1]))
