"""Steps between two planes: where the upper one ends, from its last columns and then, to 1 cm, from the voxels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.terrain_map.estimate import Plane
from stridetwin.estimators.terrain_map.order_statistics import mean, median, percentile, sort
from stridetwin.estimators.terrain_map.plane_fit import BORDER_M, height_toward
from stridetwin.estimators.terrain_map.ray_casting import solid_reach
from stridetwin.estimators.terrain_map.voxel_blocks import Blocks
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent

_LANES = 28
"""Lines across an edge along which it is measured in the voxels."""
_INSIDE_M, _BEYOND_M = 0.06, 0.14
"""Start of these lines on the upper plane, before its last column, and their end beyond it."""
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
        in_voxels: Whether `points` come from the voxels; otherwise they are the plane's last columns.
        height: Height of the upper plane over the lower one at the edge, m.
    """

    lower: int
    upper: int
    down: Array
    points: Array
    in_voxels: bool
    height: float

    @cached_property
    def middle(self) -> tuple[float, float]:
        """Middle of the edge, m, world."""
        return self._extent[:2]

    @cached_property
    def length(self) -> float:
        """Length of the edge, m."""
        return self._extent[2]

    @cached_property
    def _extent(self) -> tuple[float, float, float]:
        """Middle (x, y) of the edge and its length, m."""
        return _extent(self.points, self.down)


@entry_kernel(_HERE)
def _extent(points: Array, down: Array) -> tuple[float, float, float]:
    """Middle x and y of an edge's points, and the edge's length, m.

    `points` are (N, 2) m, `down` (2,) is the unit vector across the edge; the length is the extent at right angles to
    it.
    """
    n, least, most = len(points), math.inf, -math.inf
    for k in range(n):
        # along the edge, m
        along = points[k, 1] * down[0] - points[k, 0] * down[1]
        least, most = min(least, along), max(most, along)
    return mean(points, 0, n, 0), mean(points, 0, n, 1), most - least


def fit_riser(lower: Plane, upper: Plane, columns: NDArray[np.int32], turn: Array, voxel_m: float) -> Riser | None:
    """Fits the step between two planes to the columns where they border on each other.

    Args:
        lower: Lower plane.
        upper: Upper plane.
        columns: (N, 5) from `plane_set.find_borders`, the upper plane's last columns before the lower one: slots of the
            lower and the upper plane, column (i, j), and side of the lower plane, 0..3 for +i, -i, +j, -j.
        turn: (2, 2) grid to world axes.
        voxel_m: Edge of a column.

    Returns:
        The riser; None if the columns form no edge.
    """
    if len(columns) < _MIN_POINTS:
        return None
    down, points, height = _fit_edge(
        columns, turn, voxel_m, lower.centre, lower.gradient, lower.spread, upper.centre, upper.gradient, upper.spread
    )
    if not len(points):
        return None
    return Riser(lower=lower.id, upper=upper.id, down=down, points=points, in_voxels=False, height=height)


@entry_kernel(_HERE)
def _fit_edge(
    columns: NDArray[np.int32],
    turn: Array,
    voxel_m: float,
    low_centre: Array,
    low_gradient: Array,
    low_spread: Array,
    centre: Array,
    gradient: Array,
    spread: Array,
) -> tuple[Array, Array, float]:
    """Fits the edge between two planes to the upper one's last columns, and takes their height difference there.

    Args:
        columns: (N, 5) of which are used: 2, 3 the upper plane's column (i, j), and 4 the side of the lower plane, 0..3
            for +i, -i, +j, -j.
        turn: (2, 2) grid to world axes.
        voxel_m: Edge of a column.
        low_centre: (3,) m, centre of the lower plane's points.
        low_gradient: (2,) slopes of the lower plane along x and y.
        low_spread: (2, 2) m², covariance of the lower plane's points in plan.
        centre: (3,) m, centre of the upper plane's points.
        gradient: (2,) slopes of the upper plane along x and y.
        spread: (2, 2) m², covariance of the upper plane's points in plan.

    Returns:
        (2,) unit vector down across the edge; (N, 2) points, m, none if there is no edge; height, m.
    """
    # (N, 2) of each column, in world axes: its end, m, and the unit vector toward the lower plane
    ends, toward = np.empty((len(columns), 2)), np.empty((len(columns), 2))
    for n in range(len(columns)):
        # The end of a column is the middle of its side toward the lower plane; (i, j) points to that side.
        side = columns[n, 4]
        i, j = (side == 0) - (side == 1), (side == 2) - (side == 3)
        x, y = (columns[n, 2] + 0.5 + 0.5 * i) * voxel_m, (columns[n, 3] + 0.5 + 0.5 * j) * voxel_m
        for axis in range(2):
            ends[n, axis] = turn[axis, 0] * x + turn[axis, 1] * y
            toward[n, axis] = turn[axis, 0] * i + turn[axis, 1] * j
    down, points = _fit_edge_line(ends, toward)
    if len(points) == 0:  # no edge
        return down, points, 0.0
    x, y = mean(points, 0, len(points), 0), mean(points, 0, len(points), 1)
    lower = height_toward(low_centre, low_gradient, low_spread, x, y, BORDER_M)
    return down, points, height_toward(centre, gradient, spread, x, y, BORDER_M) - lower


@njit(**INNER_KERNEL)
def project(points: Array, u: float, v: float) -> Array:
    """(N,) coordinates of points (N, 2) along the direction (u, v): x u + y v."""
    s = np.empty(points.shape[0])
    for n in range(points.shape[0]):
        s[n] = points[n, 0] * u + points[n, 1] * v
    return s


@njit(**INNER_KERNEL)
def _median(s: Array) -> float:
    """Median of s (N,), which stays unsorted."""
    ordered = s.copy()
    sort(ordered)
    return median(ordered, ordered.shape[0])


@njit(**INNER_KERNEL)
def _select_points(points: Array, keep: NDArray[np.bool_], fewest: int) -> Array:
    """The points (N, 2) where `keep` (N,) is True; none if they are fewer than `fewest`."""
    count = 0
    for n in range(points.shape[0]):
        count += keep[n]
    selected = np.empty((count if count >= fewest else 0, 2))
    row = 0
    for n in range(points.shape[0] if count >= fewest else 0):
        if keep[n]:
            selected[row, 0] = points[n, 0]
            selected[row, 1] = points[n, 1]
            row += 1
    return selected


@njit(**INNER_KERNEL)
def _fit_edge_line(ends: Array, toward: Array) -> tuple[Array, Array]:
    """Fits the edge's line to the ends of the upper plane's columns.

    Args:
        ends: (N, 2) m, ends of the columns.
        toward: (N, 2) unit vectors from each column toward the lower plane.

    Returns:
        (2,) unit vector down across the edge; (K, 2) m, the ends near the line. There are none if fewer than
        `_MIN_POINTS` lie near it, or if the lower plane surrounds the upper one.
    """
    count, down = ends.shape[0], np.empty(2)
    # first guess of the direction: the mean, which is short where the upper plane has the lower one on all sides
    down[0] = mean(toward, 0, count, 0)
    down[1] = mean(toward, 0, count, 1)
    keep = np.zeros(count, np.bool_)
    if math.hypot(down[0], down[1]) < _OPEN_SIDE:  # the lower plane surrounds the upper one: no edge to step over
        return down, _select_points(ends, keep, 1)
    down = normal_across(ends, down, _DIRECTION_RATIO)
    s = project(ends, down[0], down[1])  # across the edge, m
    middle = _median(s)
    for n in range(count):
        keep[n] = abs(s[n] - middle) < _LINE_M
    points = _select_points(ends, keep, _MIN_POINTS)
    return (normal_across(points, down, _DIRECTION_RATIO) if len(points) else down), points


@njit(**INNER_KERNEL)
def normal_across(points: Array, toward: Array, ratio_min: float) -> Array:
    """(2,) unit vector across the line through points (N, 2), on the side of `toward` (2,).

    The line has the direction of the largest scatter, ½ atan2(2 s_xy, s_xx − s_yy). If `toward` is nearly along it, the
    edge is too short to have a direction, and the result is `toward` itself, normalised.

    Args:
        points: (N, 2) m.
        toward: (2,) direction of any length.
        ratio_min: Smallest ratio of the components of `toward` across and along the line.
    """
    count, normal = points.shape[0], np.empty(2)
    middle_x, middle_y = mean(points, 0, count, 0), mean(points, 0, count, 1)
    xx, xy, yy = 0.0, 0.0, 0.0
    for n in range(count):
        x, y = points[n, 0] - middle_x, points[n, 1] - middle_y
        xx += x * x
        xy += x * y
        yy += y * y
    turn = 0.5 * math.atan2(2.0 * xy, xx - yy)  # direction of the largest scatter
    # components of `toward` across the line and along it
    ahead = -math.sin(turn) * toward[0] + math.cos(turn) * toward[1]
    along = math.cos(turn) * toward[0] + math.sin(turn) * toward[1]
    if abs(ahead) < abs(along) * ratio_min:  # the edge is too short to have a direction
        size = math.hypot(toward[0], toward[1])
        normal[0] = toward[0] / size
        normal[1] = toward[1] / size
    else:
        side = math.copysign(1.0, ahead)  # of the two normals the one on the side of `toward`
        normal[0] = side * -math.sin(turn)
        normal[1] = side * math.cos(turn)
    return normal


def refine_riser(edge: Riser, upper: Plane, down: Array, blocks: Blocks, R_grid_world: Array, voxel_m: float) -> Riser:
    """Measures a riser's edge anew in the voxels just under the upper plane.

    Args:
        edge: Riser from the columns.
        upper: Upper plane of the step.
        down: (2,) unit vector across all edges of the flight.
        blocks: The voxels.
        R_grid_world: (3, 3) world to grid axes.
        voxel_m: Edge of a voxel.

    Returns:
        The riser, unchanged if the voxels show no edge.
    """
    across_edge, points = _edge_in_voxels(
        edge.points, down, upper.centre, upper.gradient, blocks, R_grid_world[:2, :2], voxel_m
    )
    if not len(points):
        return edge
    return replace(edge, down=across_edge, points=points, in_voxels=True)


@entry_kernel(_HERE)
def _edge_in_voxels(
    points: Array, down: Array, centre: Array, gradient: Array, blocks: Blocks, turn: Array, voxel_m: float
) -> tuple[Array, Array]:
    """The end of solid ground along `_LANES` lines that cross an edge one voxel under the upper plane.

    Args:
        points: (N, 2) m, the edge from the columns.
        down: (2,) unit vector across it.
        centre: (3,) of the upper plane, m.
        gradient: (2,) of the upper plane.
        blocks: The voxels.
        turn: (2, 2) world to grid axes.
        voxel_m: Edge of a voxel.

    Returns:
        (2,) unit vector down across the edge; (K, 2) its points, m, none if the voxels show no edge.
    """
    starts = _lane_starts(points, down)
    at = np.empty((len(starts), 3))  # the starts in grid axes, voxels, one voxel under the upper plane
    for n in range(len(starts)):
        x, y = starts[n, 0], starts[n, 1]
        for axis in range(2):
            at[n, axis] = (turn[axis, 0] * x + turn[axis, 1] * y) / voxel_m
        # z = z_c + g · (x - x_c), less one voxel
        at[n, 2] = (centre[2] + (x - centre[0]) * gradient[0] + (y - centre[1]) * gradient[1]) / voxel_m - 1.0
    slope = gradient[0] * down[0] + gradient[1] * down[1]  # of the upper plane along the lanes
    direction = np.empty(2)  # of the lanes, in grid axes
    for axis in range(2):
        direction[axis] = turn[axis, 0] * down[0] + turn[axis, 1] * down[1]
    length, gap = (_INSIDE_M + _BEYOND_M) / voxel_m, _GAP_M / voxel_m
    reach = solid_reach(blocks, at, direction, slope, length, gap)  # voxels, NaN where unobserved
    edge_points = _lane_ends(starts, reach, voxel_m, down)
    return (normal_across(edge_points, down, _DIRECTION_RATIO) if len(edge_points) else down), edge_points


@njit(**INNER_KERNEL)
def _lane_starts(points: Array, down: Array) -> Array:
    """(`_LANES`, 2) m, starts of the lanes across an edge, evenly spaced along it, `_INSIDE_M` before it.

    Args:
        points: (N, 2) m, the edge from the columns.
        down: (2,) unit vector across it, from the upper plane to the lower one.
    """
    aside = project(points, -down[1], down[0])  # along the edge, m
    sort(aside)
    low, high = percentile(aside, _TRIM_PCT), percentile(aside, 100.0 - _TRIM_PCT)
    first = _median(project(points, down[0], down[1])) - _INSIDE_M
    starts = np.empty((_LANES, 2))
    for n in range(_LANES):
        lane = low + (high - low) * n / (_LANES - 1)
        starts[n, 0] = first * down[0] - lane * down[1]
        starts[n, 1] = first * down[1] + lane * down[0]
    return starts


@njit(**INNER_KERNEL)
def _lane_ends(starts: Array, reach: Array, voxel_m: float, down: Array) -> Array:
    """(N, 2) m, ends of the lanes without outliers, none if too few remain.

    Args:
        starts: (N, 2) m, world, starts of the lanes.
        reach: (N,) length of solid ground from each start, voxels; NaN where unobserved.
        voxel_m: Edge of a voxel.
        down: (2,) direction of the lanes.
    """
    points, keep, seen = np.empty(starts.shape), np.zeros(starts.shape[0], np.bool_), 0
    known = np.empty(starts.shape[0])  # m, the first `seen` entries: lengths of the observed lanes
    for n in range(starts.shape[0]):
        if math.isfinite(reach[n]):
            known[seen] = reach[n] * voxel_m
            seen += 1
    if seen < _MIN_POINTS:
        return _select_points(points, keep, 1)
    middle = _median(known[:seen])
    for n in range(starts.shape[0]):
        along = reach[n] * voxel_m
        keep[n] = abs(along - middle) < _OUTLIER_M
        points[n, 0] = starts[n, 0] + along * down[0]
        points[n, 1] = starts[n, 1] + along * down[1]
    return _select_points(points, keep, _MIN_POINTS)


def group_by_planes(borders: NDArray[np.int32], ids: NDArray[np.int64]) -> dict[tuple[int, int], NDArray[np.intp]]:
    """Groups the rows of `borders` by the pair of planes that border on each other.

    Args:
        borders: (N, 5) result of `plane_set.find_borders`.
        ids: (SLOTS,) id of the plane in each slot.

    Returns:
        By the ids of the lower and the upper plane: indices of the rows, in ascending order.
    """
    if not len(borders):
        return {}
    key = borders[:, 0].astype(np.int64) * len(ids) + borders[:, 1]  # one number for each pair of slots
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))  # where another pair begins in that order
    groups = {}
    for rows in np.split(order, starts[1:]):
        lower_slot, upper_slot = borders[rows[0], :2]
        groups[int(ids[lower_slot]), int(ids[upper_slot])] = rows
    return groups
