"""Upright solids with a flat or a sloping top, and exact geometric queries for many of them at once.

Terrain consists of these: boxes for level segments, treads and landings, wedges for ramps. A `SolidSet` answers queries
for N points or rays and all solids at once. The loops are compiled.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stridetwin.streams.compiled import cached
from stridetwin.streams.samples import Array

_called = cached(__file__)


@_called
def cast(origins: Array, directions: Array, normals: Array, offsets: Array, ground: float) -> tuple[Array, Array]:
    """Nearest intersections of rays with solids or the ground plane.

    A convex solid is the intersection of half-spaces n.p <= c: a ray is inside from its last entry to its first exit.

    Args:
        origins: (N, 3) m.
        directions: (N, 3) unit.
        normals: (S, F, 3) outward, of each solid's faces.
        offsets: (S, F) m.
        ground: Height of the plane, m.

    Returns:
        (N,) distance, inf for none, 0 from inside; (N, 3) outward normal of the face, zero for none.
    """
    n = len(origins)
    distance, normal = np.empty(n), np.zeros((n, 3))
    for i in range(n):
        ox, oy, oz = origins[i, 0], origins[i, 1], origins[i, 2]
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        best = np.inf
        solid, side = -1, -1
        for s in range(len(offsets)):
            entry, leave, face = -np.inf, np.inf, 0
            for f in range(offsets.shape[1]):
                nx, ny, nz = normals[s, f, 0], normals[s, f, 1], normals[s, f, 2]
                speed = nx * dx + ny * dy + nz * dz
                gap = offsets[s, f] - (nx * ox + ny * oy + nz * oz)
                if speed < 0.0:
                    if gap / speed > entry:
                        entry, face = gap / speed, f
                elif speed > 0.0:
                    leave = min(leave, gap / speed)
                elif gap < 0.0:
                    leave = -np.inf
                if leave < 0.0 or entry > leave or entry >= best:
                    break
            else:
                if max(entry, 0.0) < best:
                    best, solid, side = max(entry, 0.0), s, face
        if dz < 0.0 and max((ground - oz) / dz, 0.0) < best:
            best = max((ground - oz) / dz, 0.0)
            normal[i, 2] = 1.0
        elif solid >= 0:
            for k in range(3):
                normal[i, k] = normals[solid, side, k]
        distance[i] = best
    return distance, normal


@_called
def top(
    points: Array, centre: Array, axes: Array, half: Array, mid: Array, slope: Array, touch: float
) -> tuple[Array, NDArray[np.intp]]:
    """Highest top over (N, 2) points: (N,) height, -inf for none, and (N,) index of the solid."""
    n = len(points)
    height, which = np.empty(n), np.empty(n, np.int64)
    for i in range(n):
        height[i], which[i] = -np.inf, -1
        for s in range(len(mid)):
            x, y = points[i, 0] - centre[s, 0], points[i, 1] - centre[s, 1]
            along = axes[s, 0, 0] * x + axes[s, 0, 1] * y
            across = axes[s, 1, 0] * x + axes[s, 1, 1] * y
            if abs(along) <= half[s, 0] + touch and abs(across) <= half[s, 1] + touch:
                z = (
                    mid[s]
                    + slope[s, 0] * min(max(along, -half[s, 0]), half[s, 0])
                    + slope[s, 1] * min(max(across, -half[s, 1]), half[s, 1])
                )
                if z > height[i]:
                    height[i], which[i] = z, s
    return height, which


_TOUCH = 1e-9  # m; points this close to a footprint's border belong to it


@dataclass(frozen=True, kw_only=True)
class Solid:
    """Upright prism on a rectangular footprint, with a flat top.

    Attributes:
        x, y: Centre of the footprint in the world, m.
        length, width: Extent along its own x and y axes, m.
        bottom: Height of the underside, m.
        start, end: Height of the top in the middle of its low-x and its high-x end, m.
        yaw: Rotation about the vertical, rad.
        cross: Rise of the top along its own y axis, m/m.
        terrain: Class of its top: level, stair or ramp.
    """

    x: float
    y: float
    length: float
    width: float
    bottom: float
    start: float
    end: float
    yaw: float = 0.0
    cross: float = 0.0
    terrain: str = "level"

    @property
    def is_box(self) -> bool:
        """Whether its top is level."""
        return self.start == self.end and self.cross == 0.0

    @classmethod
    def box(
        cls, *, x: float, y: float, length: float, width: float, bottom: float, top: float, yaw: float = 0.0
    ) -> Self:
        """A solid with a level top at height `top`."""
        return cls(x=x, y=y, length=length, width=width, bottom=bottom, start=top, end=top, yaw=yaw)


def corners(solid: Solid) -> Array:
    """(8, 3) corners in the world: the underside, then the top, each from low x, low y anticlockwise."""
    x, y = np.array([-1, 1, 1, -1]) * solid.length / 2, np.array([-1, -1, 1, 1]) * solid.width / 2
    cos, sin = np.cos(solid.yaw), np.sin(solid.yaw)
    plan = np.stack([solid.x + cos * x - sin * y, solid.y + sin * x + cos * y], axis=-1)
    under = np.column_stack([plan, np.full(4, solid.bottom)])
    top = np.column_stack([plan, np.array([solid.start, solid.end, solid.end, solid.start]) + solid.cross * y])
    return np.concatenate([under, top])


class SolidSet:
    """Solids compiled to arrays, above a ground plane."""

    def __init__(self, solids: Sequence[Solid], ground: float) -> None:
        column = {
            name: np.array([getattr(s, name) for s in solids])
            for name in ("x", "y", "yaw", "length", "width", "bottom", "start", "end", "cross")
        }
        self._centre = np.stack([column["x"], column["y"]], axis=-1)
        self._half = np.stack([column["length"], column["width"]], axis=-1) / 2
        cos, sin = np.cos(column["yaw"]), np.sin(column["yaw"])
        self._axes = np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], axis=-2)  # rows: own x, y
        self._plan = np.array([corners(s)[:4, :2] for s in solids])
        self._bottom = column["bottom"]
        self._mid = (column["start"] + column["end"]) / 2
        along = (column["end"] - column["start"]) / column["length"]
        self._slope = np.stack([along, column["cross"]], axis=-1)  # along its own x and y axes
        self._ground = ground
        self.edges = self._find_edges()

    def top_facet(self, xy: ArrayLike) -> tuple[Array, NDArray[np.intp]]:
        """(...) height of the surface at (..., 2) points, m, and (...) index of its solid, -1 for the ground plane.

        A point on a border belongs to the higher side.
        """
        points = np.asarray(xy, dtype=float)
        height, which = top(
            np.ascontiguousarray(points.reshape(-1, 2)), self._centre, self._axes, self._half, self._mid, self._slope,
            _TOUCH,
        )  # fmt: skip
        which[height < self._ground] = -1
        height = np.maximum(height, self._ground)
        return height.reshape(points.shape[:-1]), which.reshape(points.shape[:-1])

    def top_normal(self, which: NDArray[np.intp]) -> Array:
        """(..., 3) unit normals in the world of the tops of solids (...); -1 is the ground plane."""
        gradient = np.einsum("sa,sai->si", self._slope, self._axes)
        normal = np.concatenate([-gradient, np.ones((len(gradient), 1))], axis=-1)
        normal = np.concatenate([normal, [[0.0, 0.0, 1.0]]])  # index -1
        return normal[which] / np.linalg.norm(normal[which], axis=-1, keepdims=True)

    def edge_distance(self, xy: ArrayLike) -> Array:
        """Horizontal distance from (..., 2) points to the nearest edge of the surface, m, (...)."""
        points = np.asarray(xy, dtype=float)[..., None, :]
        start, run = self.edges[:, 0], self.edges[:, 1] - self.edges[:, 0]
        share = np.sum((points - start) * run, axis=-1) / np.sum(run * run, axis=-1)
        nearest = start + np.clip(share, 0.0, 1.0)[..., None] * run
        return np.min(np.linalg.norm(points - nearest, axis=-1), axis=-1)

    def ray_cast(self, origins: ArrayLike, directions: ArrayLike) -> tuple[Array, Array]:
        """Nearest intersections of rays with the surface, from (N, 3) origins along (N, 3) directions of any length.

        Returns:
            (N,) distance, m: inf for a miss, 0 for an origin inside a solid; and (N, 3) outward normal of the face
            that is hit, zero for a miss.
        """
        o, d = np.broadcast_arrays(np.asarray(origins, dtype=float), np.asarray(directions, dtype=float))
        d = d / np.linalg.norm(d, axis=-1, keepdims=True)
        return cast(np.ascontiguousarray(o), d, *self._half_spaces, self._ground)

    @cached_property
    def _half_spaces(self) -> tuple[Array, Array]:
        """Outward normals (S, 6, 3) and offsets (S, 6) of front, back, left, right, bottom and top."""
        n = len(self._mid)
        flat = np.concatenate([self._axes, -self._axes], axis=1)
        sides = np.concatenate([flat, np.zeros((n, 4, 1))], axis=-1)
        side_offsets = np.einsum("spi,si->sp", flat, self._centre) + np.tile(self._half, 2)
        down = np.tile([0.0, 0.0, -1.0], (n, 1, 1))
        up = self.top_normal(np.arange(n))[:, None]
        centre = np.concatenate([self._centre, self._mid[:, None]], axis=-1)
        up_offset = np.einsum("spi,si->sp", up, centre)
        return (
            np.concatenate([sides, down, up], axis=1),
            np.concatenate([side_offsets, -self._bottom[:, None], up_offset], axis=1),
        )

    def _find_edges(self) -> Array:
        """Segments (E, 2, 2) where the surface jumps or bends.

        Every border of a footprint is cut at its intersections with other borders; a part is an edge if the planes on
        its two sides differ. Tops that intersect each other inside both footprints do not occur in terrain.
        """
        a = self._plan.reshape(-1, 2)
        b = np.roll(self._plan, -1, axis=1).reshape(-1, 2)
        cut = []
        for p, q in zip(a, b):
            cuts = np.unique(np.round([0.0, *_crossings(p, q, a, b), 1.0], 9))
            cut += [(p + s * (q - p), p + t * (q - p)) for s, t in pairwise(cuts)]
        segments = np.array(cut)
        run = segments[:, 1] - segments[:, 0]
        across = np.stack([-run[:, 1], run[:, 0]], -1) / np.linalg.norm(run, axis=-1, keepdims=True)
        middle = segments.mean(axis=1)
        left, right = self._plane_at(middle, 1e-6 * across), self._plane_at(middle, -1e-6 * across)
        return segments[np.any(np.abs(left - right) > 1e-9, axis=-1)]

    def _plane_at(self, xy: Array, beside: Array) -> Array:
        """Height at `xy` and gradient (N, 3) of the topmost plane at `xy + beside`."""
        _, which = self.top_facet(xy + beside)
        gradient = np.einsum("na,nai->ni", self._slope[which], self._axes[which])
        gradient = np.where(which[:, None] >= 0, gradient, 0.0)
        z = self._mid[which] + np.sum(gradient * (xy - self._centre[which]), axis=-1)
        return np.concatenate([np.where(which >= 0, z, self._ground)[:, None], gradient], axis=-1)


def _crossings(p: Array, q: Array, a: Array, b: Array) -> Array:
    """Positions from p to q, as shares in (0, 1), where the segments (a, b) or their ends meet the line."""
    run, other = q - p, b - a
    cross = run[0] * other[:, 1] - run[1] * other[:, 0]
    to = a - p
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (to[:, 0] * other[:, 1] - to[:, 1] * other[:, 0]) / cross
        t = (to[:, 0] * run[1] - to[:, 1] * run[0]) / cross
    meets = (np.abs(cross) > 1e-12) & (t > -1e-9) & (t < 1 + 1e-9) & (s > 0) & (s < 1)
    return s[meets]
