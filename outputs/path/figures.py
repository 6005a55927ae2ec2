"""Figures of estimated paths: side view, plan view, error over time."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle

import numpy as np
from markupsafe import Markup

from stridetwin.estimators.base import FOOT_NAMES, PathEstimate
from stridetwin.outputs.path.evaluate import Result
from stridetwin.outputs.path.scores import CHI2_3_95, nees_position
from stridetwin.outputs.route_figures import draw_profile, draw_slabs, outline
from stridetwin.pages.plot import INK, PALETTE, Plot, data_range, faint
from stridetwin.streams.samples import Array, Block, Footprint
from stridetwin.streams.terrain_truth import Layout

COLORS = {"l": PALETTE[0], "r": PALETTE[1], "camera": PALETTE[3]}
_OTHERS = {"l": PALETTE[2::3], "r": PALETTE[5::-1], "camera": PALETTE[4:]}  # of further estimators


def part_of(estimate: PathEstimate) -> str:
    """What a path is of: the side `l` or `r`, as in the frames `foot_l/imu` or `body/heel_l/imu`; else the `camera`."""
    names = estimate.frame.split("/")
    return next((foot for foot in FOOT_NAMES if any(name.endswith(f"_{foot}") for name in names)), "camera")


def label_of(estimate: PathEstimate) -> str:
    """The label of an estimate in a figure: `left`, `left, feet together`, or `camera`."""
    part_name = FOOT_NAMES.get(part_of(estimate), "camera")
    label = estimate.name if estimate.label is None else estimate.label
    return f"{part_name}, {label}" if label else part_name


def by_part(results: Sequence[Result]) -> dict[str, list[Result]]:
    """The results of each foot and of the camera, in this order."""
    parts = {part: [r for r in results if part_of(r.estimate) == part] for part in COLORS}
    return {part: part_results for part, part_results in parts.items() if part_results}


def side_view(layout: Layout | None, results: Sequence[Result]) -> Markup:
    """Heights along the route: terrain, and the true and estimated paths of one foot or of the camera."""
    paths = [_along_route(layout, result) for result in results]  # (2, 2, N): truth and estimate, place and height
    span_s = data_range(*(s for s, _ in paths), margin=0.01)
    profile = layout.profile if layout else ()
    # the ground is filled down to 12 cm below its lowest point
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
    # (2, 2, N) m: x and y, each of truth and estimate
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
    """Figure of the position errors of one foot or of the camera, and of the 95 % bound that each estimator reports.

    An estimate without a covariance has no bound.
    """
    errors = [1e3 * np.linalg.norm(r.comparison.error_m, axis=1) for r in results]
    bounds = [_bound_mm(r) for r in results]
    max_error = max(float(e.max()) for e in errors)
    # largest bound at the end; the axis shows it up to three times the largest error
    reported = max((float(b[-1]) for b in bounds if b is not None), default=0.0)
    plot = Plot(
        title=f"Position error over time, {_part_name(results)}",
        x_label="time, s",
        y_label="position error, mm",
        y=(0.0, 1.1 * max(max_error, min(reported, 3 * max_error), 1.0)),
        height=260,
        hover="x",
    )
    colors = estimate_colors(results)
    for result, error, bound in zip(results, errors, bounds):
        color = colors[result.estimate.name]
        t, label = result.comparison.truth.t_ns * 1e-9, label_of(result.estimate)
        if bound is not None:  # every tenth sample is enough for the band
            low, high, bound_label = np.zeros_like(t[::10]), bound[::10], f"{label}: own 95 % bound"
            plot.band(t[::10], low, high, faint(color, 0.08), stroke=faint(color, 0.6), label=bound_label)
        plot.line(t, error, color, label=f"{label}: error")
    return plot.html()


def nees_over_time(results: Sequence[Result]) -> Markup:
    """NEES eᵀ P⁻¹ e of the position, and the value that a consistent estimator stays below for 95 % of the time.

    It is "" if no estimate has a covariance. Values beyond ten times the bound are cut off, so that it remains visible.
    """
    # those with a covariance
    consistent = [result for result in results if result.comparison.estimate.covariance is not None]
    if not consistent:
        return Markup("")
    values = [nees_position(result.comparison) for result in consistent]
    most = max(float(nees.max()) for nees in values)
    plot = Plot(
        title=f"NEES of the position over time, {_part_name(results)}",
        x_label="time, s",
        y_label="NEES",
        y=(0.0, min(10.0 * CHI2_3_95, max(1.5 * CHI2_3_95, 1.1 * most))),
        height=260,
        hover="x",
    )
    colors = estimate_colors(results)
    for result, nees in zip(consistent, values):
        t = result.comparison.truth.t_ns * 1e-9
        plot.line(t, nees, colors[result.estimate.name], label=label_of(result.estimate))
    ends = np.array([result.comparison.truth.t_ns[[0, -1]] * 1e-9 for result in consistent])
    span = [ends.min(), ends.max()]
    plot.line(span, [CHI2_3_95, CHI2_3_95], INK, dash="dash", label=f"95 % of a consistent estimator: {CHI2_3_95:.2f}")
    return plot.html()


def _part_name(results: Sequence[Result]) -> str:
    """Name of the part of the body that paths are of, such as `left foot`, for titles."""
    part = part_of(results[0].estimate)
    return f"{FOOT_NAMES[part]} foot" if part in FOOT_NAMES else "camera"


def _draw_paths(plot: Plot, results: Sequence[Result], paths: Sequence[Array]) -> None:
    """Draws the true path of each part once, and every estimate.

    Args:
        plot: The figure.
        results: The estimates.
        paths: For each, horizontal and vertical coordinate of truth and estimate, (2, 2, N) m.
    """
    colors = estimate_colors(results)
    for part_results in by_part(results).values():
        # the estimates of one part share their truth
        truth = paths[results.index(part_results[0])][:, 0]
        plot.line(truth[0], truth[1], INK, width=3.0, label="truth")
    for result, path in zip(results, paths):
        plot.line(path[0, 1], path[1, 1], colors[result.estimate.name], label=label_of(result.estimate))


def estimate_colors(results: Sequence[Result]) -> dict[str, str]:
    """The colour of each estimate by name: that of its part, and further colours for further estimators."""
    return {
        result.estimate.name: color
        for part, part_results in by_part(results).items()
        for result, color in zip(part_results, cycle((COLORS[part], *_OTHERS[part])))
    }


def _positions(result: Result) -> Array:
    """(2, N, 3) m: the true positions, then the estimated ones, both in the true world."""
    return np.stack([result.comparison.truth.p_frame_in_world, result.comparison.estimate.p_frame_in_world])


def _along_route(layout: Layout | None, result: Result) -> Array:
    """A path from the side: place along the route, and height.

    The estimate is offset from the truth by the component of its error along the route.

    Args:
        layout: The true terrain; None takes the world's x axis for the route.
        result: The path beside the truth.

    Returns:
        (2, 2, N) m: first the places, then the heights; each of the truth, then of the estimate.
    """
    truth, estimate = _positions(result)
    s, heading = truth[:, 0], np.zeros(len(truth))
    if layout is not None:
        s = layout.way.project(truth[:, :2])
        heading = layout.way.heading(s)
    error = estimate - truth
    error_along = error[:, 0] * np.cos(heading) + error[:, 1] * np.sin(heading)
    return np.array([[s, s + error_along], [truth[:, 2], estimate[:, 2]]])


def _bound_mm(result: Result) -> Array | None:
    """Radius of a sphere around each estimated position that contains the whole 95 % ellipsoid, mm.

    It is √(χ² λ): χ² is the 95 % quantile with 3 degrees of freedom, λ the largest eigenvalue of the position's
    covariance.

    Returns:
        (N,) mm; None if the estimate has no covariance.
    """
    covariance = result.comparison.estimate.covariance
    if covariance is None:
        return None
    largest_variance = np.linalg.eigvalsh(covariance[:, :3, :3])[:, -1]  # eigenvalues ascend
    return np.asarray(1e3 * np.sqrt(CHI2_3_95 * largest_variance))
