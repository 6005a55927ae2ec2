"""Figures of where the walk went: side view, plan view, error over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stridetwin.scenarios.evaluate import FEET, Result
from stridetwin.scenarios.ground import Strip
from stridetwin.scenarios.scoring import CHI2_3_95
from stridetwin.scenarios.svg import Plot, data_range, wide_and_narrow
from stridetwin.streams.samples import Array, Block, Footprint

INK = "#0f1c2e"
COLORS = {"l": "#0b6bcb", "r": "#d9480f"}
_SHADES = {"l": "#9cc4ee", "r": "#f3b898"}
_GROUND = {"level": "#dde4ec", "stair": "#c7d6e6", "ramp": "#d3e3d2"}
_FOOT_M = 0.26


def foot_of(name: str) -> str:
    """`l` or `r`, from the name of an estimator or a frame of that foot."""
    return name.split("/")[0][-1]


def side_view(profile: Sequence[Strip], results: Sequence[Result]) -> str:
    """Heights along the way: terrain, true and estimated paths of the feet."""
    xs, zs = _coordinates(results, 0), _coordinates(results, 2)
    span_x = (float(xs.min()) - 0.6, float(xs.max()) + 0.6)
    floor = min((min(s.z0, s.z1) for s in profile), default=float(zs.min()))
    span_z = data_range(zs, include=(floor - 0.12,))

    def draw(width: float) -> Plot:
        plot = Plot(width=width, height=300, x=span_x, y=span_z, title="Side view", x_label="x, m", y_label="z, m")
        for strip in profile:
            x = np.clip([strip.x0, strip.x1], *span_x)
            if x[1] > x[0]:
                z = np.interp(x, [strip.x0, strip.x1], [strip.z0, strip.z1])
                corners = np.r_[z, span_z[0], span_z[0]]
                plot.polygon(np.r_[x, x[::-1]], corners, _GROUND[strip.terrain])
        _paths(plot, results, 2)
        return plot

    return wide_and_narrow(draw)


def plan_view(results: Sequence[Result], footprints: Block[Footprint] | None) -> str:
    """The walk from above: footprints, true and estimated paths of the feet."""
    prints = [] if footprints is None else [p.p_foot_in_world for p in footprints]
    ends = [p[0] + _FOOT_M for p in prints]
    span_x = data_range(_coordinates(results, 0), ends, margin=0.02)
    span_y = data_range(_coordinates(results, 1), margin=0.2)

    def draw(width: float) -> Plot:
        plot = Plot(width=width, height=260, x=span_x, y=span_y, title="Plan view", x_label="x, m", y_label="y, m")
        if prints:
            for x, y, _ in prints:
                x_to, half = x + _FOOT_M, 0.045
                plot.polygon([x, x_to, x_to, x], [y - half, y - half, y + half, y + half], "#e8edf3", stroke="#c9d3de")
        _paths(plot, results, 1)
        return plot

    return wide_and_narrow(draw)


def error_over_time(results: Sequence[Result]) -> str:
    """Position error of every estimate, and the 95 % bound that the estimator itself believes in."""
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
            foot, t = foot_of(result.estimate.name), _seconds(result)
            if bound is not None:
                shown = np.where(1000 * bound <= plot.y[1], 1000 * bound, np.nan)
                plot.line(
                    t,
                    shown,
                    _SHADES[foot],
                    dash="4 3",
                    label=f"{FEET[foot]}, own 95 %" if width > 600 else "",
                )
            plot.line(t, 1000 * error, COLORS[foot], label=FEET[foot], stroke=1.8)
        return plot

    return wide_and_narrow(draw)


def _paths(plot: Plot, results: Sequence[Result], axis: int) -> None:
    for i, result in enumerate(results):
        truth = result.comparison.truth.p_frame_in_world
        plot.line(truth[:, 0], truth[:, axis], INK, stroke=1.0, label="truth" if i == 0 else "")
    for result in results:
        foot, estimate = foot_of(result.estimate.name), result.comparison.estimate.p_frame_in_world
        plot.line(estimate[:, 0], estimate[:, axis], COLORS[foot], dash="5 3", label=FEET[foot], stroke=1.6)


def _coordinates(results: Sequence[Result], axis: int) -> Array:
    paths = [p for r in results for p in (r.comparison.truth, r.comparison.estimate)]
    return np.concatenate([p.p_frame_in_world[:, axis] for p in paths])


def _seconds(result: Result) -> Array:
    return np.asarray(result.comparison.truth.t_ns * 1e-9)


def _bound(result: Result) -> Array | None:
    covariance = result.comparison.estimate.covariance
    if covariance is None:
        return None
    return np.asarray(np.sqrt(CHI2_3_95 * np.linalg.eigvalsh(covariance[:, :3, :3])[:, -1]))
