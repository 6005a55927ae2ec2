"""Drawing of the true terrain and footprints, which the figures of several kinds of output share.

Figures from above may show the route laid out straight: arc length against distance to the left of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise

import numpy as np

from stridetwin.outputs.aligned_walk import AlignedWalk
from stridetwin.pages.plot import MUTED, Plot, Range
from stridetwin.streams.samples import Array, Footprint
from stridetwin.streams.terrain_truth import Layout, Strip

GROUND = {"level": "#dde4ec", "stair": "#c7d6e6", "ramp": "#d3e3d2"}
"""Colour of the ground by terrain."""
FOOT_M, _HALF_FOOT_M = 0.26, 0.045
"""Length and half width of a drawn footprint."""
HALF_WIDTH_M = 1.0
"""Half width of a figure of the straightened route."""
_ROW_M, _MAX_ROWS = 10.0, 8  # length of a row of a long route, and most rows
_TRUE_STEP = "#46546a"


def draw_profile(plot: Plot, profile: Iterable[Strip], span: Range, floor: float) -> None:
    """Draws the true ground along the route from the side, by terrain.

    Args:
        plot: The figure.
        profile: Strips of the route.
        span: Begin and end of the figure along the route, m; strips are cut there.
        floor: Height down to which the ground is filled, m.
    """
    for terrain, color in GROUND.items():
        outlines = []
        for strip in profile:
            # begin and end of the visible part along the route, and the heights there, m
            s0, s1 = np.clip([strip.s0, strip.s1], *span)
            if strip.terrain == terrain and s1 > s0:
                z0, z1 = np.interp([s0, s1], [strip.s0, strip.s1], [strip.z0, strip.z1])
                outlines.append([(s0, z0), (s1, z1), (s1, floor), (s0, floor)])
        plot.areas(outlines, color, label=terrain)


def draw_slabs(plot: Plot, layout: Layout | None, x: Range, y: Range) -> None:
    """Draws the true ground from above, by terrain; without a layout it draws nothing.

    Args:
        plot: The figure.
        layout: The true terrain, or None.
        x: Lowest and highest x of the figure, m; slabs are cut there.
        y: Lowest and highest y, m.
    """
    for terrain, color in GROUND.items():
        slabs = [slab for slab in (layout.slabs if layout else ()) if slab.terrain == terrain]
        # (4, 3) m, the corners of each slab in the world: distances along its axis, and to the left of it
        corners = [
            slab.point([0, slab.length, slab.length, 0], [-slab.right, -slab.right, slab.left, slab.left])
            for slab in slabs
        ]
        low, high = [x[0], y[0]], [x[1], y[1]]  # corners of the figure
        plot.areas([np.clip(slab_corners[:, :2], low, high) for slab_corners in corners], color, label=terrain)


def outline(footprint: Footprint) -> Array:
    """(4, 2) m, corners of a footprint in the true world, from above."""
    w, x, y, z = footprint.q_world_foot
    # horizontal unit vectors: from heel to toes (the foot's x axis, which is shorter on a slope), and to the left
    toes = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z)])
    aside = np.array([-toes[1], toes[0]])
    # m from the footprint's position to each corner, forward and to the left
    local = [(0.0, -_HALF_FOOT_M), (FOOT_M, -_HALF_FOOT_M), (FOOT_M, _HALF_FOOT_M), (0.0, _HALF_FOOT_M)]
    return np.array([footprint.p_foot_in_world[:2] + forward * toes + left * aside for forward, left in local])


class StraightenedRoute:
    """A walk's true footprints and path, laid out along the straightened route for figures from above.

    Args:
        walk: The walk.

    Attributes:
        place_m: (F,) m along the route, of each footprint.
        footprints: (4, 2) m, corners of each true footprint: along the route and to the left of it.
        span_m: From shortly before the first footprint to shortly after the last one, m.
    """

    def __init__(self, walk: AlignedWalk) -> None:
        self._walk, way = walk, walk.layout.way
        self.place_m = walk.foot_places_m
        # (F,) rad and (F, 2) m: direction and point of the route at each footprint
        self._heading, self._origin = way.heading(self.place_m), way.point(self.place_m)
        self.footprints = [self.straighten(i, outline(f)) for i, f in enumerate(walk.footprints)]
        self.span_m: Range = (float(self.place_m.min()) - 0.6, float(self.place_m.max()) + 0.8)

    def straighten(self, i: int, xy: Array) -> Array:
        """(N, 2) m along the route and to the left of it, of (N, 2) points of the world near the i-th footprint."""
        return np.asarray((xy - self._origin[i]) @ self.rotation(i).T + [self.place_m[i], 0.0])

    def rotation(self, i: int) -> Array:
        """(2, 2) from the true world to the route's direction at the i-th footprint."""
        c, s = math.cos(self._heading[i]), math.sin(self._heading[i])
        return np.array([[c, s], [-s, c]])

    def rows(self, span: Range) -> list[Range]:
        """Cuts a span of the route into rows of equal length, of about `_ROW_M`, that a page shows to scale.

        Args:
            span: Begin and end along the route, m.

        Returns:
            Begin and end of each row, m; at most `_MAX_ROWS` rows.
        """
        count = max(1, min(_MAX_ROWS, math.ceil((span[1] - span[0]) / _ROW_M)))
        return list(pairwise(np.linspace(*span, count + 1).tolist()))

    def footprints_within(self, span: Range) -> list[int]:
        """Numbers of the footprints whose middle lies within a span of the route, m."""
        middles_m = [corners[:, 0].mean() for corners in self.footprints]  # along the route
        return [i for i, middle_m in enumerate(middles_m) if span[0] < middle_m < span[1]]

    def plot_row(self, title: str, number: int, rows: list[Range]) -> Plot:
        """An empty plot of one row, to scale.

        Args:
            title: Of the whole figure; later rows add their number.
            number: Number of the row.
            rows: Begin and end of each row along the route, m.
        """
        is_last = number == len(rows) - 1
        return Plot(
            title=title if number == 0 else f"{title}, row {number + 1}",
            x=rows[number],
            y=(-HALF_WIDTH_M, HALF_WIDTH_M),
            to_scale=True,
            x_label="along the route, m" if is_last else "",
            y_label="left, m",
            continued=number > 0,
        )

    def draw_footprints(self, plot: Plot, span: Range) -> None:
        """Draws the true footprints within a span of the route."""
        outlines = [self.footprints[i] for i in self.footprints_within(span)]
        plot.areas(outlines, "#ffffff", stroke=_TRUE_STEP, label="true footprint")

    def draw_path(self, plot: Plot, span: Range) -> None:
        """Draws the true path of the camera within a span of the route."""
        # every eighth position is enough for a figure
        way, p = self._walk.layout.way, self._walk.p_frame_in_world[::8, :2]
        s = way.project(p)
        heading, offset = way.heading(s), p - way.point(s)
        # distance to the left of the route
        left = offset[:, 1] * np.cos(heading) - offset[:, 0] * np.sin(heading)
        is_inside = (s > span[0]) & (s < span[1])
        plot.line(s[is_inside], left[is_inside], MUTED, width=1.0, label="true path of the camera")

    def draw_terrain_keys(self, plot: Plot) -> None:
        """Adds the colours of the terrain of the whole route to the legend; for the first row."""
        present = {strip.terrain for strip in self._walk.layout.profile}
        for terrain, color in GROUND.items():
            if terrain in present:
                plot.key(terrain, color)

    def draw_terrain(self, plot: Plot, span: Range) -> None:
        """Draws the true terrain within a span of the route, as bands across it."""
        for terrain, color in GROUND.items():
            bands = []
            for strip in self._walk.layout.profile:
                s0, s1 = max(strip.s0, span[0]), min(strip.s1, span[1])
                if strip.terrain == terrain and s1 > s0:
                    corners = [(s0, -HALF_WIDTH_M), (s1, -HALF_WIDTH_M), (s1, HALF_WIDTH_M), (s0, HALF_WIDTH_M)]
                    bands.append(np.array(corners))
            plot.areas(bands, color)
