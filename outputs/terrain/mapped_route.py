"""The ground along the straightened route, as it was last mapped before the walker stood on it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.terrain_map import Stairs, TerrainEstimate
from stridetwin.outputs.alignment import YawAlignment
from stridetwin.outputs.terrain.grid import GROUND_CLASSES, GroundGrid, ground_classes_at
from stridetwin.streams.samples import Array
from stridetwin.streams.terrain_truth import Layout

HALF_WIDTH_M, CELL_M = 1.0, 0.04
"""Half width of the stored ground along the route, and its cell size."""
_BEHIND_M, _AHEAD_M = 0.2, 2.5  # the part of the route around the walker that is stored again at each update
_MAX_EDGE_AHEAD_M = 1.2
"""An edge is stored when it is at most this far ahead."""
_SAME_EDGE_M = 0.1  # nearer edges along the route are one
_BESIDE_M, _ACROSS = 0.3, 0.7
"""An edge that begins farther beside the route, or lies more along than across it, does not belong to the route."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MappedRoute:
    """The ground along the straightened route, as it was last mapped before the walker stood on it.

    Attributes:
        s: (S,) m along the route, centres of the cells.
        left: (L,) m to the left of it.
        height: (S, L) m in the true world, NaN where nothing was seen.
        classes: (S, L) numbers of `GROUND_CLASSES`.
        edges: (E, 3) m: position along the route, and both ends to the left, of each edge.
    """

    s: Array
    left: Array
    height: Array
    classes: NDArray[np.uint8]
    edges: Array


class RouteMapper:
    """Fills a `MappedRoute` during the walk.

    Args:
        layout: The true terrain.
        s0: Begin of the stored ground along the route, m.
        s1: End of the stored ground, m.
    """

    def __init__(self, layout: Layout, s0: float, s1: float) -> None:
        self._way, self._profile = layout.way, layout.profile
        # centres of the cells; the arrays are those of `MappedRoute`
        self._s = np.arange(s0, s1, CELL_M) + CELL_M / 2
        self._left = np.arange(-HALF_WIDTH_M, HALF_WIDTH_M - 1e-9, CELL_M) + CELL_M / 2
        self._height = np.full((len(self._s), len(self._left)), np.nan)
        self._classes = np.full(self._height.shape, GROUND_CLASSES.index("none"), np.uint8)
        self._edges: list[tuple[float, float, float]] = []  # rows of `MappedRoute.edges`

    def add(self, grid: GroundGrid, estimate: TerrainEstimate, alignment: YawAlignment, place_m: float) -> None:
        """Replaces the stored ground and edges near the walker by the current estimate.

        Args:
            grid: Ground of the map.
            estimate: Planes and terrains of the map.
            alignment: From the map's world to the true one, now.
            place_m: Place of the walker along the route, m.
        """
        nearby = np.flatnonzero((self._s > place_m - _BEHIND_M) & (self._s < place_m + _AHEAD_M))
        # the cells (S', L) of this part, and the map's height there; a cell that the map does not know keeps its value
        s, left = np.meshgrid(self._s[nearby], self._left, indexing="ij")
        height, plane = grid.at(alignment.to_estimated(self._way.point(s, left)))
        # one direction for the whole part, that of the route in its middle, in the map's world
        heading = float(self._way.heading(place_m + 0.5 * _AHEAD_M)) - alignment.yaw
        classes = ground_classes_at(estimate, plane, heading)
        is_known = np.isfinite(height)
        rows, columns = np.nonzero(is_known)
        # from the map's world to the true one: without the drift in height
        self._height[nearby[rows], columns] = height[is_known] - alignment.estimated[2] + alignment.true[2]
        self._classes[nearby[rows], columns] = classes[is_known]
        for flight in estimate.stairs:
            for a, b in edge_lines(flight):
                self._keep_edge(alignment.to_true(a), alignment.to_true(b), place_m)

    def _keep_edge(self, a: Array, b: Array, place_m: float) -> None:
        """Stores an edge ahead of the walker; it replaces earlier ones within `_SAME_EDGE_M`.

        Other edges are dropped: an edge counts if its line crosses the route at most `_MAX_EDGE_AHEAD_M` ahead, if it
        lies across the route rather than along it, and if it is not wholly beside the route.

        Args:
            a: (3,) m, one end in the true world.
            b: (3,) m, the other end.
            place_m: Place of the walker along the route, m.
        """
        # samples of the route ahead: m along it; (S, 2) m, points; and (S, 2), unit vectors to its left
        places = np.arange(place_m, place_m + _MAX_EDGE_AHEAD_M, 0.02)
        way, heading = self._way.point(places), self._way.heading(places)
        left = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        distance = np.abs(_distance_from_line(way, a, b))
        k = int(distance.argmin())  # the sample of the route nearest to the edge's line
        if distance[k] > 0.02:  # the line crosses the route nowhere near
            return
        # left coordinates of both ends, and cosine of the angle between edge and the direction across the route
        along_edge = (b - a)[:2]
        low, high = sorted(float((end[:2] - way[k]) @ left[k]) for end in (a, b))
        across = float(abs(along_edge @ left[k])) / max(float(np.linalg.norm(along_edge)), 1e-9)
        if across < _ACROSS or low > _BESIDE_M or high < -_BESIDE_M:
            return
        forward = np.array([math.cos(heading[k]), math.sin(heading[k])])
        # the edge's point nearest to that sample gives the place between two samples
        share = float(np.clip((way[k] - a[:2]) @ along_edge / (along_edge @ along_edge), 0, 1))  # from a (0) to b (1)
        nearest = a[:2] + along_edge * share
        s = float(places[k]) + float((nearest - way[k]) @ forward)
        self._edges = [e for e in self._edges if abs(e[0] - s) > _SAME_EDGE_M]
        self._edges.append((s, low, high))

    def result(self) -> MappedRoute:
        """The stored ground and edges of the whole walk."""
        edges = np.array(sorted(self._edges), float).reshape(-1, 3)
        return MappedRoute(s=self._s, left=self._left, height=self._height, classes=self._classes, edges=edges)


def _distance_from_line(points: Array, a: Array, b: Array) -> Array:
    """(N,) signed distances of points from the line through a and b in the horizontal plane, m; positive to its right.

    Args:
        points: (N, 2) m.
        a: (2,) or (3,) m, a point of the line.
        b: Another point of it.
    """
    along = (b - a)[:2] / np.linalg.norm((b - a)[:2])
    offset = points - a[:2]
    return np.asarray(offset[:, 0] * along[1] - offset[:, 1] * along[0])


def edge_lines(flight: Stairs) -> list[Array]:
    """Ends of each detected edge, (2, 3) m in the map's world, at the height of the tread above it."""
    # the horizontal direction of ascent, and that to its left; an edge k lies at `s` along the first, and its ends at
    # `flight.across` along the second, both from the world's origin
    up = flight.up
    aside = np.array([-up[1], up[0]])
    lines = []
    for k, s in enumerate(flight.edges):
        if math.isfinite(s):
            z = flight.base + (k + 1) * flight.riser
            lines.append(np.array([[*(s * up + reach * aside), z] for reach in flight.across]))
    return lines
