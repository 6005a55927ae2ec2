"""Steps between two planes: where the upper one ends, from its last columns and then, to a centimetre, the voxels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.terrain_map.estimate import Plane
from stridetwin.estimators.terrain_map.plane_fit import BORDER_M, seen_height
from stridetwin.estimators.terrain_map.ray_casting import solid_reach
from stridetwin.estimators.terrain_map.voxel_blocks import Blocks
from stridetwin.streams.samples import Array

_LANES = 28
"""Lines across an edge along which it is measured in the voxels."""
_INSIDE_M, _BEYOND_M = 0.06, 0.14
"""Their start on the upper plane, before its last column, and their end beyond it."""
_GAP_M = 0.12
"""Longest unobserved stretch between the last solid and the first free position."""
_MIN_POINTS = 6
"""Smallest number of points of an edge."""
_OUTLIER_M = 0.02
"""Largest distance of a lane's end from the median."""
_LINE_M = 0.06
"""Largest distance of a column from the edge's median line."""
_OPEN_SIDE = 0.4
"""Smallest mean of the unit vectors toward the lower plane: less where that plane surrounds the upper one."""
_DIRECTION_RATIO = 0.5
"""Smallest ratio, across to along, at which an edge is long enough to have a direction."""
_SIDES = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
"""Directions of the sides of `plane_set.borders`."""
_TRIM_PCT = 3.0
"""Share of an edge's points, at either end, outside which it is not measured in the voxels, %."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Riser:
    """A step between two planes.

    Attributes:
        lower: Id of the lower plane.
        upper: Id of the upper plane.
        down: (2,) unit vector across the edge, from the upper plane to the lower.
        points: (N, 2) m, world, the end of the upper plane.
        found: Whether `points` come from the voxels; otherwise they are the plane's last columns.
        height: Height of the upper plane over the lower one at the edge, m.
    """

    lower: int
    upper: int
    down: Array
    points: Array
    found: bool
    height: float

    @cached_property
    def middle(self) -> Array:
        """(2,) middle of the edge, m, world."""
        return self.points.mean(axis=0)

    @cached_property
    def length(self) -> float:
        """Length of the edge, m."""
        return float(np.ptp(self.points @ left_of(self.down)))


def left_of(forward: Array) -> Array:
    """(2,) unit vector to the left of a (2,) direction."""
    return np.array([-forward[1], forward[0]])


def percentiles(values: Array, percents: Sequence[float]) -> Array:
    """Those of (N,) values, as by `np.percentile`, in a fifth of the time if they are few."""
    return np.interp(np.array(percents) / 100.0 * (len(values) - 1), np.arange(len(values)), np.sort(values))


def riser(lower: Plane, upper: Plane, columns: NDArray[np.int32], turn: Array, voxel_m: float) -> Riser | None:
    """The step between two planes, from their columns.

    Args:
        lower: Lower plane.
        upper: Upper plane.
        columns: (N, 5) from `plane_set.borders`, the upper plane's last columns before the lower one.
        turn: (2, 2) grid to world axes.
        voxel_m: Edge of a column.

    Returns:
        The riser; None if the columns form no edge.
    """
    side = _SIDES[columns[:, 4]]
    toward = turn @ side.mean(axis=0) if len(columns) >= _MIN_POINTS else np.zeros(2)
    if math.hypot(*toward.tolist()) < _OPEN_SIDE:  # the lower plane surrounds the upper one: no edge to step over
        return None
    ends = (columns[:, 2:4] + 0.5 + 0.5 * side) @ turn.T * voxel_m
    down = across(ends, toward)
    s = ends @ down
    points = ends[np.abs(s - np.median(s)) < _LINE_M]
    if len(points) < _MIN_POINTS:
        return None
    x, y = points.mean(axis=0).tolist()
    height, below = (seen_height(q.centre, q.gradient, q.spread, x, y, BORDER_M) for q in (upper, lower))
    return Riser(
        lower=lower.id, upper=upper.id, down=across(points, down), points=points, found=False, height=height - below
    )  # fmt: skip


def across(points: Array, toward: Array) -> Array:
    """(2,) unit vector across the line through (N, 2) points, on the side of `toward` (2,)."""
    off = points - points.mean(axis=0)
    (xx, xy), (_, yy) = (off.T @ off).tolist()
    turn = 0.5 * math.atan2(2.0 * xy, xx - yy)  # the line's, from its scatter
    along = np.array([math.cos(turn), math.sin(turn)])
    ahead = float(left_of(along) @ toward)
    if abs(ahead) < abs(float(along @ toward)) * _DIRECTION_RATIO:  # the edge is too short to have a direction
        return toward / math.hypot(*toward.tolist())
    return math.copysign(1.0, ahead) * left_of(along)


def refined(edge: Riser, upper: Plane, down: Array, blocks: Blocks, R_grid_world: Array, voxel_m: float) -> Riser:
    """Refines a riser's edge in the voxels just under the upper plane.

    Args:
        edge: Riser from the columns.
        upper: Its upper plane.
        down: (2,) unit vector across all edges of the flight.
        blocks: The voxels.
        R_grid_world: (3, 3) world to grid axes.
        voxel_m: Edge of a voxel.

    Returns:
        The riser, unchanged if the voxels show no edge.
    """
    left, turn = left_of(down), R_grid_world[:2, :2]
    low, high = percentiles(edge.points @ left, (_TRIM_PCT, 100.0 - _TRIM_PCT))
    lanes = low + (high - low) * np.arange(_LANES) / (_LANES - 1)
    starts = (np.median(edge.points @ down) - _INSIDE_M) * down + lanes[:, None] * left
    at = np.column_stack([starts @ turn.T, upper.height(starts)]) / voxel_m - (0.0, 0.0, 1.0)
    length, gap = (_INSIDE_M + _BEYOND_M) / voxel_m, _GAP_M / voxel_m
    reach = voxel_m * solid_reach(blocks, at, turn @ down, float(upper.gradient @ down), length, gap)
    seen = reach[np.isfinite(reach)]
    if len(seen) < _MIN_POINTS:
        return edge
    kept = np.abs(reach - np.median(seen)) < _OUTLIER_M
    points = starts[kept] + reach[kept, None] * down
    return replace(edge, down=across(points, down), points=points, found=True) if len(points) >= _MIN_POINTS else edge


def pairs_of(found: NDArray[np.int32], ids: NDArray[np.int64]) -> dict[tuple[int, int], NDArray[np.intp]]:
    """Rows of the result of `plane_set.borders`, by the ids of lower and upper plane."""
    if not len(found):
        return {}
    key = found[:, 0].astype(np.int64) * len(ids) + found[:, 1]
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    groups = np.split(order, starts[1:])
    return {(int(ids[found[g[0], 0]]), int(ids[found[g[0], 1]])): g for g in groups}
