"""Figures of a terrain map along the route: from above, from the side, its errors; and the section of a report."""

from __future__ import annotations

import math

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from stridetwin.outputs.aligned_walk import AlignedWalk
from stridetwin.outputs.base import Scores
from stridetwin.outputs.route_figures import HALF_WIDTH_M, StraightenedRoute, draw_profile
from stridetwin.outputs.score_rows import score_table
from stridetwin.outputs.terrain.grid import CLASS_COLORS, CLASS_NAMES, GROUND_CLASSES
from stridetwin.outputs.terrain.mapped_route import CELL_M, MappedRoute
from stridetwin.outputs.terrain.run import SampledMap
from stridetwin.outputs.terrain.scores import SCORES, true_heights
from stridetwin.outputs.truth import edges
from stridetwin.pages.html import boxes, data_uri, section
from stridetwin.pages.plot import INK, PALETTE, Plot, data_range
from stridetwin.streams.samples import Array

_PALE = (255 - 0.45 * (255 - np.array(CLASS_COLORS, float))).astype(np.uint8)  # of the mapped ground
_HEX, _PALE_HEX = (
    {name: "#" + bytes(rgb).hex() for name, rgb in zip(GROUND_CLASSES, colors)} for colors in (CLASS_COLORS, _PALE)
)
_LINE_M = 0.2  # half width of the strip whose median height is shown
_CLEAR_M = 0.06  # nearer to a true edge no error of the height is shown
_LEAST_CLEAR = 0.3  # of the cells across the route
_MAX_EDGE_ERROR_MM = 140.0  # an estimated edge farther than this from every true one matches none
_LEAD = (
    "From depth camera and visual-inertial odometry: the ground, mapped before the walker reached it. Drift of the "
    "odometry counts as an error of its path only."
)


def ground_from_above(route: MappedRoute, walk: AlignedWalk) -> Markup:
    """The mapped ground along the straightened route by class, with mapped edges, true footprints and the true path.

    The route is cut into rows, true to scale.
    """
    straight = StraightenedRoute(walk)
    span = (max(float(route.s[0]), straight.span_m[0]), min(float(route.s[-1]), straight.span_m[1]))
    rows = straight.rows(span)
    return Markup("").join(_draw_row(route, straight, rows, number) for number in range(len(rows)))


def _draw_row(route: MappedRoute, straight: StraightenedRoute, rows: list[tuple[float, float]], number: int) -> Markup:
    """One row of the figure: mapped ground by class, mapped edges, the true path and footprints.

    Args:
        route: The mapped ground.
        straight: The straightened route.
        rows: Begin and end of each row along the route, m.
        number: Number of this row; the first one has the keys of the classes.
    """
    span = rows[number]
    plot = straight.plot_row("The ground from above", number, rows)
    if number == 0:  # the first row has the legend, with every class that is mapped somewhere
        for ground_class in np.unique(route.classes[np.isfinite(route.height)]).tolist():
            name = GROUND_CLASSES[ground_class]
            plot.key(f"mapped: {CLASS_NAMES.get(name, 'unknown class')}", _PALE_HEX[name])
    is_inside = (route.s > span[0]) & (route.s < span[1])
    if is_inside.any():  # the image reaches half a cell beyond the centres of its outermost cells
        begin, end = float(route.s[is_inside][0]) - CELL_M / 2, float(route.s[is_inside][-1]) + CELL_M / 2
        uri = _encode_class_image(route.classes[is_inside], np.isfinite(route.height[is_inside]))
        plot.image((begin, end), (-HALF_WIDTH_M, HALF_WIDTH_M), uri)
    straight.draw_path(plot, span)
    # lines across the route at `at`, from `low` to `high` to the left of it, m
    edges_here = [([at, low], [at, high]) for at, low, high in route.edges if span[0] < at < span[1]]
    plot.curves(edges_here, INK, width=1.6, label="mapped edge")
    straight.draw_footprints(plot, span)
    return plot.html()


def _encode_class_image(classes: NDArray[np.uint8], known: NDArray[np.bool_]) -> str:
    """A PNG of the ground's classes in pale colours, as a data URI.

    The image shows the route from left to right, with what lies to the left of the route on top.

    Args:
        classes: (S, L) numbers of `GROUND_CLASSES`, along the route and from right to left of it.
        known: (S, L) whether each cell is mapped; others are transparent.
    """
    # blue, green and red as OpenCV orders them, and the opacity
    bgra = np.zeros((*classes.shape, 4), np.uint8)
    bgra[..., :3] = _PALE[classes][..., ::-1]
    bgra[..., 3] = 255
    bgra[~known] = 0
    image = np.ascontiguousarray(bgra[:, ::-1].transpose(1, 0, 2))  # rows from the left of the route to the right
    _, png = cv2.imencode(".png", image)
    return data_uri(png.tobytes(), "image/png")


def ground_from_aside(route: MappedRoute, walk: AlignedWalk) -> Markup:
    """Heights along the route: true ground, mapped ground by class, estimated edges."""
    s, height, classes = _ground_along_middle(route)
    profile, span = walk.layout.profile, StraightenedRoute(walk).span_m
    shown = (s > span[0]) & (s < span[1])
    true = true_heights(profile, s)
    span_z = data_range(true[shown], height[shown], include=(float(true[shown].min()) - 0.12,))
    plot = Plot(
        title="The ground from the side",
        x=span,
        y=span_z,
        x_label="along the route, m",
        y_label="height, m",
        height=280,
    )
    draw_profile(plot, profile, span, span_z[0])
    edges_here = []  # a vertical line per mapped edge
    for at in route.edges[:, 0]:  # m along the route
        # from just below the lower to just above the upper true ground beside the edge
        ends = true_heights(profile, np.array([at - 0.1, at + 0.1]))
        edges_here.append([(at, ends.min() - 0.05), (at, ends.max() + 0.05)])
    plot.curves(edges_here, INK, width=1.2, label="mapped edge")
    for number, name in enumerate(GROUND_CLASSES):
        heights = np.where((classes == number) & shown, height, np.nan)
        if np.isfinite(heights).any():
            plot.line(s, heights, _HEX[name], width=2.4, label=f"mapped: {CLASS_NAMES.get(name, 'unknown class')}")
    return plot.html()


def ground_errors(route: MappedRoute, walk: AlignedWalk) -> Markup:
    """Figure of the errors along the route: of the mapped heights, mm, and of the positions of mapped edges, mm."""
    s, height, _ = _ground_along_middle(route)
    span = StraightenedRoute(walk).span_m
    true_edges = np.array([at for at, _, _ in edges(walk.layout.profile)])  # m along the route
    # distance of each place from the nearest true edge
    away = np.abs(s[:, None] - true_edges).min(axis=1) if len(true_edges) else np.full(len(s), math.inf)
    # errors of the heights, mm; NaN near an edge, where a small error of place would look like one of height
    is_shown = (away > _CLEAR_M) & (s > span[0]) & (s < span[1])
    height_errors = np.where(is_shown, 1e3 * (height - true_heights(walk.layout.profile, s)), np.nan)
    mapped = route.edges[:, 0]  # mapped edges, m along the route
    mapped = mapped[(mapped > span[0]) & (mapped < span[1])]
    nearest = np.abs(mapped[:, None] - true_edges).argmin(axis=1) if len(true_edges) else np.zeros(0, int)
    # errors of the mapped edges' places, mm, from the nearest true one; only those that match it are shown
    edge_errors = 1e3 * (mapped - true_edges[nearest]) if len(true_edges) else np.zeros(0)
    matches = np.abs(edge_errors) < _MAX_EDGE_ERROR_MM
    largest = float(np.nanmax(np.abs(np.r_[height_errors, edge_errors[matches]]), initial=0.0))
    top = max(10.0, largest) * 1.1  # of the figure, mm
    plot = Plot(
        title="Errors of the mapped ground",
        x=span,
        y=(-top, top),
        x_label="along the route, m",
        y_label="estimated minus true, mm",
        height=240,
    )
    plot.line(s, height_errors, PALETTE[0], width=1.4, label="height")
    if matches.any():
        plot.dots(mapped[matches], edge_errors[matches], INK, label="position of an edge along the route")
    return plot.html()


def _ground_along_middle(route: MappedRoute) -> tuple[Array, Array, NDArray[np.uint8]]:
    """The mapped ground along the middle of the route.

    Returns:
        (S,) places along the route, m; (S,) median height near the middle, m, NaN where too little is mapped; and (S,)
        number of the most frequent class.
    """
    across = np.abs(route.left) < _LINE_M
    height, classes = route.height[:, across], route.classes[:, across]
    is_known = np.isfinite(height)
    enough = is_known.mean(axis=1) > _LEAST_CLEAR  # (S,) whether enough cells across the route are mapped
    middle = np.full(len(route.s), np.nan)
    middle[enough] = [np.median(row[is_finite]) for row, is_finite in zip(height[enough], is_known[enough])]
    counts = np.stack([((classes == k) & is_known).sum(axis=1) for k in range(len(GROUND_CLASSES))], axis=1)
    return route.s, middle, counts.argmax(axis=1).astype(np.uint8)


def terrain_section(sampled: SampledMap, scores: Scores) -> str:
    """The ground from above and from the side, errors of heights and edges, and the scores of one map."""
    route, walk = sampled.route, sampled.walk
    figures = [ground_from_above(route, walk), ground_from_aside(route, walk), ground_errors(route, walk)]
    return section("Terrain ahead", _LEAD, boxes([*figures, score_table(SCORES, {"this walk": scores})]), "stack")
