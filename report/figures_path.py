"""Figures of a walk's path: side view, plan view, error over time; and of steps estimated from the legs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import cycle

import numpy as np
from markupsafe import Markup

from stridetwin.estimators.base import FEET
from stridetwin.evaluation.evaluate import Estimate, Result
from stridetwin.evaluation.path_scores import CHI2_3_95
from stridetwin.evaluation.step_scores import ScoredStep
from stridetwin.evaluation.truth import along_way
from stridetwin.report.plot import INK, PALETTE, Plot, Range, data_range, faint
from stridetwin.streams.samples import Array, Block, Footprint
from stridetwin.streams.terrain_truth import Layout, Strip

COLORS = {"l": PALETTE[0], "r": PALETTE[1], "camera": PALETTE[3]}
_OTHERS = {"l": PALETTE[2::3], "r": PALETTE[5::-1], "camera": PALETTE[4:]}  # of further estimators
GROUND = {"level": "#dde4ec", "stair": "#c7d6e6", "ramp": "#d3e3d2"}
_FOOT_M, _HALF_FOOT_M, _NORMAL_M = 0.26, 0.045, 0.16
_PLANE, _NORMAL = PALETTE[2], PALETTE[1]


def part_of(estimate: Estimate) -> str:
    """The body of a path: the foot `l` or `r`, or the `camera`."""
    return next((foot for foot in FEET if estimate.frame.startswith(f"foot_{foot}/")), "camera")


def label_of(estimate: Estimate) -> str:
    """The label of an estimate in a figure: `left`, `left, feet together`, or `camera`."""
    words = FEET.get(part_of(estimate), "camera")
    label = estimate.name if estimate.label is None else estimate.label
    return f"{words}, {label}" if label else words


def by_part(results: Sequence[Result]) -> dict[str, list[Result]]:
    """The results of each foot and of the camera, in this order."""
    parts = {part: [r for r in results if part_of(r.estimate) == part] for part in COLORS}
    return {part: own for part, own in parts.items() if own}


def side_view(layout: Layout | None, results: Sequence[Result]) -> Markup:
    """Heights along the route: terrain, and the true and estimated paths of one foot or of the camera."""
    paths = [_along(layout, result) for result in results]
    span_s = data_range(*(s for s, _ in paths), margin=0.01)
    profile = layout.profile if layout else ()
    lowest = [min(strip.z0, strip.z1) - 0.12 for strip in profile]
    span_z = data_range(*(z for _, z in paths), include=lowest)
    title = f"Side view, {_part_name(results)}"
    plot = Plot(title=title, x=span_s, y=span_z, x_label="along the route, m", y_label="height, m", height=260)
    draw_profile(plot, profile, span_s, span_z[0])
    _draw_paths(plot, results, paths)
    return plot.html()


def plan_view(layout: Layout | None, results: Sequence[Result], footprints: Block[Footprint] | None) -> Markup:
    """The walk from above: ground, footprints, true and estimated paths; to scale unless it is nearly a line."""
    prints = [] if footprints is None else [outline(p) for p in footprints]
    paths = [_positions(result)[:, :, :2].transpose(2, 0, 1) for result in results]
    span_x = data_range(*(x for x, _ in paths), *(p[:, 0] for p in prints), margin=0.02)
    span_y = data_range(*(y for _, y in paths), *(p[:, 1] for p in prints), margin=0.05)
    plot = Plot(title="Plan view", x=span_x, y=span_y, x_label="x, m", y_label="y, m", height=320, to_scale=True)
    draw_slabs(plot, layout, span_x, span_y)
    if plot.is_stretched:  # outlines would be distorted
        middles = np.array([p.mean(axis=0) for p in prints]).reshape(-1, 2)
        plot.dots(middles[:, 0], middles[:, 1], "#8fa3b8", symbol="square-open", label="true footprints")
    else:
        plot.areas(prints, "#f6f8fa", stroke="#a9b8c8", label="true footprints")
    _draw_paths(plot, results, paths)
    return plot.html()


def error_over_time(results: Sequence[Result]) -> Markup:
    """Position errors of the estimates of one part, and the 95 % bound that each estimator reports."""
    errors = [1e3 * np.linalg.norm(r.comparison.error_m, axis=1) for r in results]
    bounds = [_bound_mm(r) for r in results]
    most = max(float(e.max()) for e in errors)
    reported = max((float(b[-1]) for b in bounds if b is not None), default=0.0)
    plot = Plot(
        title=f"Position error over time, {_part_name(results)}", x_label="time, s", y_label="position error, mm",
        y=(0.0, 1.1 * max(most, min(reported, 3 * most), 1.0)), height=260, hover="x",
    )  # fmt: skip
    colors = _colors(results)
    for result, error, bound in zip(results, errors, bounds):
        color = colors[result.estimate.name]
        t, label = result.comparison.truth.t_ns * 1e-9, label_of(result.estimate)
        if bound is not None:
            low, high, own = np.zeros_like(t[::10]), bound[::10], f"{label}: own 95 % bound"
            plot.band(t[::10], low, high, faint(color, 0.08), stroke=faint(color, 0.6), label=own)
        plot.line(t, error, color, label=f"{label}: error")
    return plot.html()


def _part_name(results: Sequence[Result]) -> str:
    part = part_of(results[0].estimate)
    return f"{FEET[part]} foot" if part in FEET else "camera"


def draw_profile(plot: Plot, profile: Iterable[Strip], span: Range, floor: float) -> None:
    """The true ground along the route, down to a height, by terrain."""
    for terrain, color in GROUND.items():
        outlines = []
        for strip in profile:
            s0, s1 = np.clip([strip.s0, strip.s1], *span)
            if strip.terrain == terrain and s1 > s0:
                z0, z1 = np.interp([s0, s1], [strip.s0, strip.s1], [strip.z0, strip.z1])
                outlines.append([(s0, z0), (s1, z1), (s1, floor), (s0, floor)])
        plot.areas(outlines, color, label=terrain)


def draw_slabs(plot: Plot, layout: Layout | None, x: Range, y: Range) -> None:
    """The true ground from above, by terrain."""
    for terrain, color in GROUND.items():
        slabs = [slab for slab in (layout.slabs if layout else ()) if slab.terrain == terrain]
        corners = [
            slab.point([0, slab.length, slab.length, 0], [-slab.right, -slab.right, slab.left, slab.left])
            for slab in slabs
        ]
        plot.areas([np.clip(c[:, :2], [x[0], y[0]], [x[1], y[1]]) for c in corners], color, label=terrain)


def _draw_paths(plot: Plot, results: Sequence[Result], paths: Sequence[Array]) -> None:
    """Paths (2, 2, N): the true one, once for each part, and the estimate; horizontal and vertical coordinate."""
    colors = _colors(results)
    for own in by_part(results).values():
        truth = paths[results.index(own[0])][:, 0]
        plot.line(truth[0], truth[1], INK, width=3.0, label="truth")
    for result, path in zip(results, paths):
        plot.line(path[0, 1], path[1, 1], colors[result.estimate.name], label=label_of(result.estimate))


def _colors(results: Sequence[Result]) -> dict[str, str]:
    """The colour of each estimate, the same in every figure."""
    return {
        result.estimate.name: color
        for part, own in by_part(results).items()
        for result, color in zip(own, cycle((COLORS[part], *_OTHERS[part])))
    }


def _positions(result: Result) -> Array:
    """(2, N, 3) true and estimated positions."""
    return np.stack([result.comparison.truth.p_frame_in_world, result.comparison.estimate.p_frame_in_world])


def _along(layout: Layout | None, result: Result) -> Array:
    """(2, 2, N) arc length along the route and height, of the true and of the estimated path.

    The estimate is offset from the truth by the component of its error along the route.
    """
    truth, estimate = _positions(result)
    s, heading = truth[:, 0], np.zeros(len(truth))
    if layout is not None:
        s = layout.way.project(truth[:, :2])
        heading = layout.way.heading(s)
    error = estimate - truth
    ahead = error[:, 0] * np.cos(heading) + error[:, 1] * np.sin(heading)
    return np.array([[s, s + ahead], [truth[:, 2], estimate[:, 2]]])


def outline(footprint: Footprint) -> Array:
    """(4, 2) corners of a print in the world."""
    w, x, y, z = footprint.q_world_foot
    toes = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z)])
    aside = np.array([-toes[1], toes[0]])
    local = [(0.0, -_HALF_FOOT_M), (_FOOT_M, -_HALF_FOOT_M), (_FOOT_M, _HALF_FOOT_M), (0.0, _HALF_FOOT_M)]
    return np.array([footprint.p_foot_in_world[:2] + u * toes + v * aside for u, v in local])


def _bound_mm(result: Result) -> Array | None:
    covariance = result.comparison.estimate.covariance
    if covariance is None:
        return None
    return np.asarray(1e3 * np.sqrt(CHI2_3_95 * np.linalg.eigvalsh(covariance[:, :3, :3])[:, -1]))


def steps_from_aside(
    layout: Layout | None, steps: Sequence[ScoredStep], title: str = "Planes under the feet"
) -> Markup:
    """Side view: the true ground along the route, and the estimated plane and normal of each footprint of one walk."""
    true, estimated, slopes = _step_positions(steps)
    s = true[:, 0] if layout is None else along_way(true, layout)
    heading = np.zeros(len(s)) if layout is None else layout.way.heading(s)
    error = estimated - true
    at = np.column_stack([s + error[:, 0] * np.cos(heading) + error[:, 1] * np.sin(heading), estimated[:, 2]])
    profile = layout.profile if layout else ()
    span_s = data_range(s, at[:, 0], include=(float(s[0]) - 0.8, float(s[-1]) + 0.8), margin=0.0)
    floor = min((strip.z0 for strip in profile), default=float(true[:, 2].min())) - 0.1
    span_z = data_range(true[:, 2], at[:, 1], include=(floor, float(at[:, 1].max()) + 0.3), margin=0.0)
    plot = Plot(title=title, x=span_s, y=span_z, x_label="along the route, m", y_label="height, m", to_scale=True)
    draw_profile(plot, profile, span_s, span_z[0])
    along = np.column_stack([np.cos(slopes), np.sin(slopes)])
    up = along[:, ::-1] * [-1.0, 1.0]
    foot = at + 0.4 * _FOOT_M * along
    heel, toe = at - 0.1 * _FOOT_M * along, at + 0.9 * _FOOT_M * along
    plot.curves(np.stack([heel, toe], axis=1), _PLANE, width=2.4, label="estimated plane")
    plot.curves(np.stack([foot, foot + _NORMAL_M * up], axis=1), _NORMAL, width=1.4, label="its normal")
    return plot.html()


def steps_from_above(layout: Layout | None, steps: Sequence[ScoredStep], title: str = "The path from above") -> Markup:
    """Plan view: the ground, the true footprints, and the path through the estimated ones."""
    true, estimated, _ = _step_positions(steps)
    x = data_range(true[:, 0], estimated[:, 0])
    y = data_range(true[:, 1], estimated[:, 1], margin=0.1)
    plot = Plot(title=title, x=x, y=y, x_label="x, m", y_label="y, m", to_scale=True)
    draw_slabs(plot, layout, x, y)
    plot.dots(true[:, 0], true[:, 1], INK, size=5, label="true footprints")
    plot.line(estimated[:, 0], estimated[:, 1], _PLANE, label="estimated from the legs")
    return plot.html()


def _step_positions(steps: Sequence[ScoredStep]) -> tuple[Array, Array, Array]:
    """(N, 3) true and estimated positions of the estimated steps, both in the true world, and (N,) estimated slopes.

    The first estimated position is aligned with the true one; headings are those of the AHRS.
    """
    seen = [s for s in steps if s.seen]
    true, estimated = np.array([s.place for s in seen]), np.array([s.estimated_place for s in seen])
    return true, estimated - estimated[0] + true[0], np.array([s.estimated_slope for s in seen])
