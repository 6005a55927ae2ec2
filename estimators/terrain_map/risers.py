"""Edges between two flat planes: where the upper one ends, to a centimetre."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.compiled import INSIDE, cached
from stridetwin.estimators.terrain_map.blocks import Blocks
from stridetwin.estimators.terrain_map.estimate import Plane
from stridetwin.estimators.terrain_map.plane_fit import seen_height
from stridetwin.estimators.terrain_map.views import brink
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent

_LANES = 28
_INSIDE_M = 0.06
_BEYOND_M = 0.14
_GAP_M = 0.12
_FEWEST = 6
_OUTLIER_M = 0.02
_ENDS = np.array([3.0, 97.0])
"""Percentiles of its points between which an edge is looked up."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Riser:
    """A step between two planes.

    Attributes:
        lower: Id of the lower plane.
        upper: Id of the upper plane.
        down: (2,) unit vector across the edge, from the upper plane to the lower.
        points: (N, 2) m, world, where the upper plane ends.
        found: Whether `points` were found in the voxels; else they are the plane's last columns.
        height: Of the upper plane over the lower one at the edge, m.
    """

    lower: int
    upper: int
    down: Array
    points: Array
    found: bool
    height: float

    @cached_property
    def middle(self) -> tuple[float, float]:
        """m, world."""
        return self._extent[:2]

    @cached_property
    def length(self) -> float:
        """Of the edge, m."""
        return self._extent[2]

    @cached_property
    def _extent(self) -> tuple[float, float, float]:
        return _extent(self.points, self.down)


@cached(_HERE)
def _extent(points: Array, down: Array) -> tuple[float, float, float]:
    """Middle of (N, 2) points, and how far they reach along an edge across `down`, m."""
    along = points[:, 1] * down[0] - points[:, 0] * down[1]
    return points[:, 0].mean(), points[:, 1].mean(), along.max() - along.min()


def riser(lower: Plane, upper: Plane, columns: NDArray[np.int32], turn: Array, voxel_m: float) -> Riser | None:
    """The step between two planes as their columns show it.

    Args:
        lower: Plane.
        upper: Plane.
        columns: (N, 5) as of `surface.borders`, the upper plane's last columns before the lower one.
        turn: (2, 2) grid to world axes.
        voxel_m: Edge of a column.

    Returns:
        The riser, None where the columns make no edge.
    """
    if len(columns) < _FEWEST:
        return None
    down, points, height = _edge(
        columns, turn, voxel_m, lower.centre, lower.gradient, lower.spread, upper.centre, upper.gradient, upper.spread
    )
    if not len(points):
        return None
    return Riser(lower=lower.id, upper=upper.id, down=down, points=points, found=False, height=height)


@cached(_HERE)
def _edge(
    columns: NDArray[np.int32], turn: Array, voxel_m: float, low_centre: Array, low_gradient: Array, low_spread: Array,
    centre: Array, gradient: Array, spread: Array,
) -> tuple[Array, Array, float]:  # fmt: skip
    """Edge between two planes by `riser`'s columns: (2,) down across it, its (N, 2) points, m, and its height, m."""
    ends, toward = np.empty((len(columns), 2)), np.empty((len(columns), 2))
    for n in range(len(columns)):
        side = columns[n, 4]
        i, j = (side == 0) - (side == 1), (side == 2) - (side == 3)
        x, y = (columns[n, 2] + 0.5 + 0.5 * i) * voxel_m, (columns[n, 3] + 0.5 + 0.5 * j) * voxel_m
        for axis in range(2):
            ends[n, axis] = turn[axis, 0] * x + turn[axis, 1] * y
            toward[n, axis] = turn[axis, 0] * i + turn[axis, 1] * j
    down, points = _line(ends, toward)
    if len(points) == 0:
        return down, points, 0.0
    x, y = points[:, 0].mean(), points[:, 1].mean()
    risen = seen_height(centre, gradient, spread, x, y) - seen_height(low_centre, low_gradient, low_spread, x, y)
    return down, points, risen


@njit(**INSIDE)
def _line(ends: Array, toward: Array) -> tuple[Array, Array]:
    """(2,) unit vector down across an edge, and those of its columns, see `_edge`, on it; none if it is none."""
    down = np.array([toward[:, 0].mean(), toward[:, 1].mean()])
    if math.hypot(down[0], down[1]) < 0.4:  # the lower plane lies all around: no edge to step over
        return down, ends[:0]
    down = across(ends, down)
    s = ends[:, 0] * down[0] + ends[:, 1] * down[1]
    points = ends[np.abs(s - np.median(s)) < 0.06]
    if len(points) < _FEWEST:
        return down, ends[:0]
    return across(points, down), points


@njit(**INSIDE)
def across(points: Array, toward: Array) -> Array:
    """(2,) unit vector across the line through (N, 2) points, on the side of `toward` (2,)."""
    x, y = points[:, 0] - points[:, 0].mean(), points[:, 1] - points[:, 1].mean()
    turn = 0.5 * math.atan2(2.0 * (x * y).sum(), (x * x).sum() - (y * y).sum())  # of the line, by its scatter
    ahead = -math.sin(turn) * toward[0] + math.cos(turn) * toward[1]
    along = math.cos(turn) * toward[0] + math.sin(turn) * toward[1]
    if abs(ahead) < abs(along) * 0.5:  # too short an edge to have a direction
        return toward / math.hypot(toward[0], toward[1])
    return math.copysign(1.0, ahead) * np.array([-math.sin(turn), math.cos(turn)])


def refined(edge: Riser, upper: Plane, down: Array, blocks: Blocks, R_grid_world: Array, voxel_m: float) -> Riser:
    """The same riser with its edge looked up in the voxels just under the upper plane.

    Args:
        edge: As the columns show it.
        upper: Its upper plane.
        down: (2,) unit vector across all edges of the flight.
        blocks: The voxels.
        R_grid_world: (3, 3) world to grid axes.
        voxel_m: Edge of a voxel.

    Returns:
        The riser, unchanged where the voxels show no edge.
    """
    across_edge, points = _looked_up(
        edge.points, down, upper.centre, upper.gradient, blocks, R_grid_world[:2, :2], voxel_m
    )
    if not len(points):
        return edge
    return Riser(lower=edge.lower, upper=edge.upper, down=across_edge, points=points, found=True, height=edge.height)


@cached(_HERE)
def _looked_up(
    points: Array, down: Array, centre: Array, gradient: Array, blocks: Blocks, turn: Array, voxel_m: float
) -> tuple[Array, Array]:
    """(2,) unit vector down across an edge, and (N, 2) points, m, of it in the voxels; none if they show none."""
    starts = _starts(points, down)
    at = np.empty((len(starts), 3))
    for n in range(len(starts)):
        x, y = starts[n, 0], starts[n, 1]
        for axis in range(2):
            at[n, axis] = (turn[axis, 0] * x + turn[axis, 1] * y) / voxel_m
        at[n, 2] = (centre[2] + (x - centre[0]) * gradient[0] + (y - centre[1]) * gradient[1]) / voxel_m - 1.0
    slope = gradient[0] * down[0] + gradient[1] * down[1]
    direction = np.array([turn[0, 0] * down[0] + turn[0, 1] * down[1], turn[1, 0] * down[0] + turn[1, 1] * down[1]])
    reach = brink(blocks, at, direction, slope, (_INSIDE_M + _BEYOND_M) / voxel_m, _GAP_M / voxel_m) * voxel_m
    found = _ends(starts, reach, down)
    return (across(found, down) if len(found) else down), found


@njit(**INSIDE)
def _starts(points: Array, down: Array) -> Array:
    """(N, 2) m, where lanes that cross an edge begin, a little before it."""
    s = points[:, 0] * down[0] + points[:, 1] * down[1]
    low, high = np.percentile(points[:, 1] * down[0] - points[:, 0] * down[1], _ENDS)
    first = np.median(s) - _INSIDE_M
    starts = np.empty((_LANES, 2))
    for n in range(_LANES):
        aside = low + (high - low) * n / (_LANES - 1)
        starts[n, 0] = first * down[0] - aside * down[1]
        starts[n, 1] = first * down[1] + aside * down[0]
    return starts


@njit(**INSIDE)
def _ends(starts: Array, reach: Array, down: Array) -> Array:
    """(N, 2) m, where lanes end, without those that end elsewhere than most; none if they are too few."""
    seen = np.isfinite(reach)
    if seen.sum() < _FEWEST:
        return starts[:0]
    seen &= np.abs(reach - np.median(reach[seen])) < _OUTLIER_M
    if seen.sum() < _FEWEST:
        return starts[:0]
    points = starts[seen]
    points[:, 0] += reach[seen] * down[0]
    points[:, 1] += reach[seen] * down[1]
    return points


def pairs_of(found: NDArray[np.int32], ids: NDArray[np.int64]) -> dict[tuple[int, int], NDArray[np.intp]]:
    """Rows of the borders that `surface.borders` finds, by the ids of lower and upper plane."""
    if not len(found):
        return {}
    key = found[:, 0].astype(np.int64) * len(ids) + found[:, 1]
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    groups = np.split(order, starts[1:])
    return {(int(ids[found[g[0], 0]]), int(ids[found[g[0], 1]])): g for g in groups}


def heading_of(edges: list[Riser]) -> Array:
    """(2,) unit vector down the flight that suits all edges best, the longer the more."""
    x, y = max(edges, key=lambda e: len(e.points)).down.tolist()
    total_x, total_y = 0.0, 0.0
    for edge in edges:
        down_x, down_y = edge.down.tolist()
        share = math.copysign(edge.length**3, down_x * x + down_y * y)
        total_x, total_y = total_x + share * down_x, total_y + share * down_y
    return np.array([total_x, total_y]) / math.hypot(total_x, total_y)


def angle_between(a: Array, b: Array) -> float:
    """Angle between two unit vectors, rad."""
    return math.acos(max(-1.0, min(1.0, float(a @ b))))
