"""Upright solids with a flat or a sloping top, and exact geometric queries for many of them at once.

Terrain consists of these: boxes for level segments, treads and landings, wedges for ramps. A `SolidSet` answers queries
for N points or rays and all solids at once. The loops are compiled.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.samples import Array

_entry_kernel = entry_kernel(__file__)


@_entry_kernel
def cast_rays(origins: Array, directions: Array, normals: Array, offsets: Array, ground: float) -> tuple[Array, Array]:
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
        best = np.inf  # distance of the nearest face so far, which is face `side` of `solid`
        solid, side = -1, -1
        for s in range(len(offsets)):
            # entry is the last crossing into a half-space, at `face`; leave is the first one out of a half-space
            entry, leave, face = -np.inf, np.inf, 0
            for f in range(offsets.shape[1]):
                nx, ny, nz = normals[s, f, 0], normals[s, f, 1], normals[s, f, 2]
                # outward part of the direction, and distance of the origin inside the face's plane
                speed = nx * dx + ny * dy + nz * dz
                gap = offsets[s, f] - (nx * ox + ny * oy + nz * oz)
                if speed < 0.0:  # the ray enters this half-space
                    if gap / speed > entry:
                        entry, face = gap / speed, f
                elif speed > 0.0:  # the ray leaves it
                    leave = min(leave, gap / speed)
                elif gap < 0.0:  # parallel to the face and outside
                    leave = -np.inf
                if leave < 0.0 or entry > leave or entry >= best:
                    break  # behind the origin, missed, or farther than another solid
            else:  # no face ruled the solid out
                if max(entry, 0.0) < best:
                    best, solid, side = max(entry, 0.0), s, face
        # the ground plane, for a ray that goes down
        if dz < 0.0 and max((ground - oz) / dz, 0.0) < best:
            best = max((ground - oz) / dz, 0.0)
            normal[i, 2] = 1.0
        elif solid >= 0:
            for k in range(3):
                normal[i, k] = normals[solid, side, k]
        distance[i] = best
    return distance, normal


@_entry_kernel
def find_tops(
    points: Array, centre: Array, axes: Array, half: Array, mid: Array, slope: Array, touch: float
) -> tuple[Array, NDArray[np.intp]]:
    """Highest top over each point: (N,) m, -inf for none, and (N,) index of its solid, -1 for none.

    Args:
        points: (N, 2) m.
        centre: (S, 2) m, centres of the footprints.
        axes: (S, 2, 2) unit vectors along length and width, as rows.
        half: (S, 2) m, half length and half width.
        mid: (S,) m, height of the top at the centre.
        slope: (S, 2) rise of the top along both axes.
        touch: Distance from a border within which a point still counts, m.
    """
    n = len(points)
    height, index = np.empty(n), np.empty(n, np.int64)
    for i in range(n):
        height[i], index[i] = -np.inf, -1
        for s in range(len(mid)):
            x, y = points[i, 0] - centre[s, 0], points[i, 1] - centre[s, 1]
            along = axes[s, 0, 0] * x + axes[s, 0, 1] * y
            across = axes[s, 1, 0] * x + axes[s, 1, 1] * y
            if abs(along) <= half[s, 0] + touch and abs(across) <= half[s, 1] + touch:
                # points just outside have the height of the border
                z = (
                    mid[s]
                    + slope[s, 0] * min(max(along, -half[s, 0]), half[s, 0])
                    + slope[s, 1] * min(max(across, -half[s, 1]), half[s, 1])
                )
                if z > height[i]:
                    height[i], index[i] = z, s
    return height, index


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
        """A box with a level top.

        Args:
            x: Centre in the world, m.
            y: Centre in the world, m.
            length: Along its own x axis, m.
            width: Along its own y axis, m.
            bottom: Height of its underside, m.
            top: Height of its top, m.
            yaw: Rotation about the vertical, rad.
        """
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
    """Solids compiled to arrays, above a ground plane.

    Args:
        solids: The S solids.
        ground: Height of the plane, m.
    """

    def __init__(self, solids: Sequence[Solid], ground: float) -> None:
        """Collects the fields of the solids as arrays; `ground` is the height of the plane, m."""
        # (S,) values of each field, by its name
        column = {
            name: np.array([getattr(s, name) for s in solids])
            for name in ("x", "y", "yaw", "length", "width", "bottom", "start", "end", "cross")
        }
        # (S, 2) m, middle and half extent of the footprints; (S,) m, height of the top in the middle: `_mid`
        self._centre = np.stack([column["x"], column["y"]], axis=-1)
        self._half = np.stack([column["length"], column["width"]], axis=-1) / 2
        cos, sin = np.cos(column["yaw"]), np.sin(column["yaw"])
        self._axes = np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], axis=-2)  # rows: own x, y
        self._bottom = column["bottom"]
        self._mid = (column["start"] + column["end"]) / 2
        along = (column["end"] - column["start"]) / column["length"]
        self._slope = np.stack([along, column["cross"]], axis=-1)  # along its own x and y axes
        self._ground = ground

    def top_facet(self, xy: ArrayLike) -> tuple[Array, NDArray[np.intp]]:
        """(...) height of the surface at (..., 2) points, m, and (...) index of its solid, -1 for the ground plane.

        A point on a border belongs to the higher side.
        """
        points = np.asarray(xy, dtype=float)
        height, index = find_tops(
            np.ascontiguousarray(points.reshape(-1, 2)),
            self._centre,
            self._axes,
            self._half,
            self._mid,
            self._slope,
            _TOUCH,
        )
        index[height < self._ground] = -1  # no solid, or one below the ground plane
        height = np.maximum(height, self._ground)
        return height.reshape(points.shape[:-1]), index.reshape(points.shape[:-1])

    def top_normal(self, index: NDArray[np.intp]) -> Array:
        """(..., 3) unit normals in the world of the tops of solids (...); -1 is the ground plane."""
        gradient = np.einsum("sa,sai->si", self._slope, self._axes)  # (S, 2) m/m along the world's x and y
        normal = np.concatenate([-gradient, np.ones((len(gradient), 1))], axis=-1)
        normal = np.concatenate([normal, [[0.0, 0.0, 1.0]]])  # index -1
        return normal[index] / np.linalg.norm(normal[index], axis=-1, keepdims=True)

    def ray_cast(self, origins: ArrayLike, directions: ArrayLike) -> tuple[Array, Array]:
        """Nearest intersections of rays with the surface, from (N, 3) origins along (N, 3) directions of any length.

        Returns:
            (N,) distance, m: inf for a miss, 0 for an origin inside a solid; and (N, 3) outward normal of the face
            that is hit, zero for a miss.
        """
        o, d = np.broadcast_arrays(np.asarray(origins, dtype=float), np.asarray(directions, dtype=float))
        d = d / np.linalg.norm(d, axis=-1, keepdims=True)
        return cast_rays(np.ascontiguousarray(o), d, *self._half_spaces, self._ground)

    @cached_property
    def _half_spaces(self) -> tuple[Array, Array]:
        """Outward normals n (S, 6, 3) and offsets c (S, 6), m, of the half-spaces n·p <= c that make up each solid.

        The six faces are front (+x), left (+y), back (−x), right (−y), bottom and top.
        """
        n = len(self._mid)
        flat = np.concatenate([self._axes, -self._axes], axis=1)  # (S, 4, 2) horizontal normals of the sides
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
