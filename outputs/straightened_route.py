"""The route laid out straight, for figures from above: arc length against distance to the left of it."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from stridetwin.outputs.aligned_walk import AlignedWalk
from stridetwin.outputs.route_figures import GROUND, outline
from stridetwin.pages.plot import MUTED, Plot, Range
from stridetwin.streams.samples import Array

HALF_WIDTH_M = 1.0
"""Half width of a figure from above."""
_ROW_M, _MAX_ROWS = 10.0, 8
_TRUE_STEP = "#46546a"


class StraightenedRoute:
    """The true footprints and the true path of a walk along its route.

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
        """A span of the route cut into rows of equal length that a page shows to scale, m."""
        count = max(1, min(_MAX_ROWS, math.ceil((span[1] - span[0]) / _ROW_M)))
        return list(pairwise(np.linspace(*span, count + 1).tolist()))

    def within(self, span: Range) -> list[int]:
        """Numbers of the footprints whose middle lies within a span."""
        return [i for i, f in enumerate(self.footprints) if span[0] < f[:, 0].mean() < span[1]]

    def plot_row(self, title: str, number: int, rows: list[Range]) -> Plot:
        """An empty plot of one row, to scale."""
        is_last = number == len(rows) - 1
        return Plot(
            title=title if number == 0 else f"{title}, row {number + 1}", x=rows[number],
            y=(-HALF_WIDTH_M, HALF_WIDTH_M), to_scale=True, x_label="along the route, m" if is_last else "",
            y_label="left, m", continued=number > 0,
        )  # fmt: skip

    def draw_footprints(self, plot: Plot, span: Range) -> None:
        """The true footprints within a span."""
        outlines = [self.footprints[i] for i in self.within(span)]
        plot.areas(outlines, "#ffffff", stroke=_TRUE_STEP, label="true footprint")

    def draw_path(self, plot: Plot, span: Range) -> None:
        """The true path of the camera within a span."""
        way, p = self._walk.layout.way, self._walk.p_frame_in_world[::8, :2]
        s = way.project(p)
        heading, off = way.heading(s), p - way.point(s)
        left = off[:, 1] * np.cos(heading) - off[:, 0] * np.sin(heading)
        is_inside = (s > span[0]) & (s < span[1])
        plot.line(s[is_inside], left[is_inside], MUTED, width=1.0, label="true path of the camera")

    def draw_terrain_keys(self, plot: Plot) -> None:
        """The colours of the terrain of the whole route, for the legend of the first row."""
        present = {strip.terrain for strip in self._walk.layout.profile}
        for terrain, color in GROUND.items():
            if terrain in present:
                plot.key(terrain, color)

    def draw_terrain(self, plot: Plot, span: Range) -> None:
        """The true terrain within a span, as bands across the route."""
        for terrain, color in GROUND.items():
            bands = []
            for strip in self._walk.layout.profile:
                s0, s1 = max(strip.s0, span[0]), min(strip.s1, span[1])
                if strip.terrain == terrain and s1 > s0:
                    corners = [(s0, -HALF_WIDTH_M), (s1, -HALF_WIDTH_M), (s1, HALF_WIDTH_M), (s0, HALF_WIDTH_M)]
                    bands.append(np.array(corners))
            plot.areas(bands, color)
