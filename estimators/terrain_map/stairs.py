"""Fits flights of stairs with equal risers and treads to rows of planes.

An edge between two flat planes is where the upper one ends; the voxels give it to a centimetre.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.compiled import INSIDE, cached
from stridetwin.estimators.terrain_map.estimate import Plane, Stairs
from stridetwin.estimators.terrain_map.parameters import EdgeParameters, RayParameters, TerrainMapParameters
from stridetwin.estimators.terrain_map.plane_fit import seen_height, toward
from stridetwin.estimators.terrain_map.ray_casting import solid_reach
from stridetwin.estimators.terrain_map.voxel_blocks import Blocks
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent


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
    def middle(self) -> tuple[float, float]:
        """Middle of the edge, m, world."""
        return self._extent[:2]

    @cached_property
    def length(self) -> float:
        """Length of the edge, m."""
        return self._extent[2]

    @cached_property
    def _extent(self) -> tuple[float, float, float]:
        return _extent(self.points, self.down)


@cached(_HERE)
def _extent(points: Array, down: Array) -> tuple[float, float, float]:
    """Middle of (N, 2) points, and their extent along an edge across `down`, m."""
    along = points[:, 1] * down[0] - points[:, 0] * down[1]
    return points[:, 0].mean(), points[:, 1].mean(), along.max() - along.min()


def riser(
    lower: Plane, upper: Plane, columns: NDArray[np.int32], turn: Array, voxel_m: float, p: EdgeParameters
) -> Riser | None:
    """The step between two planes, from their columns.

    Args:
        lower: Lower plane.
        upper: Upper plane.
        columns: (N, 5) from `surface.borders`, the upper plane's last columns before the lower one.
        turn: (2, 2) grid to world axes.
        voxel_m: Edge of a column.
        p: Limits of an edge.

    Returns:
        The riser; None if the columns form no edge.
    """
    if len(columns) < p.points_min:
        return None
    down, points, height = _edge(
        columns, turn, voxel_m, lower.centre, lower.gradient, lower.spread, upper.centre, upper.gradient, upper.spread,
        p,
    )  # fmt: skip
    if not len(points):
        return None
    return Riser(lower=lower.id, upper=upper.id, down=down, points=points, found=False, height=height)


@cached(_HERE)
def _edge(
    columns: NDArray[np.int32], turn: Array, voxel_m: float, low_centre: Array, low_gradient: Array, low_spread: Array,
    centre: Array, gradient: Array, spread: Array, p: EdgeParameters,
) -> tuple[Array, Array, float]:  # fmt: skip
    """Edge between two planes from `riser`'s columns: (2,) down across it, its (N, 2) points, m, and its height, m."""
    ends, toward = np.empty((len(columns), 2)), np.empty((len(columns), 2))
    for n in range(len(columns)):
        side = columns[n, 4]
        i, j = (side == 0) - (side == 1), (side == 2) - (side == 3)
        x, y = (columns[n, 2] + 0.5 + 0.5 * i) * voxel_m, (columns[n, 3] + 0.5 + 0.5 * j) * voxel_m
        for axis in range(2):
            ends[n, axis] = turn[axis, 0] * x + turn[axis, 1] * y
            toward[n, axis] = turn[axis, 0] * i + turn[axis, 1] * j
    down, points = _line(ends, toward, p)
    if len(points) == 0:
        return down, points, 0.0
    x, y = points[:, 0].mean(), points[:, 1].mean()
    lower = seen_height(low_centre, low_gradient, low_spread, x, y, p.border_m)
    return down, points, seen_height(centre, gradient, spread, x, y, p.border_m) - lower


@njit(**INSIDE)
def _line(ends: Array, toward: Array, p: EdgeParameters) -> tuple[Array, Array]:
    """(2,) unit vector down across an edge, and its columns (see `_edge`) on the line; none if there is no edge."""
    down = np.array([toward[:, 0].mean(), toward[:, 1].mean()])
    if math.hypot(down[0], down[1]) < p.open_side:  # the lower plane surrounds the upper one: no edge to step over
        return down, ends[:0]
    down = across(ends, down, p.direction_ratio)
    s = ends[:, 0] * down[0] + ends[:, 1] * down[1]
    points = ends[np.abs(s - np.median(s)) < p.line_m]
    if len(points) < p.points_min:
        return down, ends[:0]
    return across(points, down, p.direction_ratio), points


@njit(**INSIDE)
def across(points: Array, toward: Array, ratio_min: float) -> Array:
    """(2,) unit vector across the line through (N, 2) points, on the side of `toward` (2,)."""
    x, y = points[:, 0] - points[:, 0].mean(), points[:, 1] - points[:, 1].mean()
    turn = 0.5 * math.atan2(2.0 * (x * y).sum(), (x * x).sum() - (y * y).sum())  # the line's, from its scatter
    ahead = -math.sin(turn) * toward[0] + math.cos(turn) * toward[1]
    along = math.cos(turn) * toward[0] + math.sin(turn) * toward[1]
    if abs(ahead) < abs(along) * ratio_min:  # the edge is too short to have a direction
        return toward / math.hypot(toward[0], toward[1])
    return math.copysign(1.0, ahead) * np.array([-math.sin(turn), math.cos(turn)])


def refined(
    edge: Riser, upper: Plane, down: Array, blocks: Blocks, R_grid_world: Array, p: TerrainMapParameters
) -> Riser:
    """Refines a riser's edge in the voxels just under the upper plane.

    Args:
        edge: Riser from the columns.
        upper: Its upper plane.
        down: (2,) unit vector across all edges of the flight.
        blocks: The voxels.
        R_grid_world: (3, 3) world to grid axes.
        p: Size of a voxel, and limits of an edge.

    Returns:
        The riser, unchanged if the voxels show no edge.
    """
    across_edge, points = _edge_in_voxels(
        edge.points, down, upper.centre, upper.gradient, blocks, R_grid_world[:2, :2], p.voxel_size_m, p.edges, p.rays
    )
    if not len(points):
        return edge
    return Riser(lower=edge.lower, upper=edge.upper, down=across_edge, points=points, found=True, height=edge.height)


@cached(_HERE)
def _edge_in_voxels(
    points: Array, down: Array, centre: Array, gradient: Array, blocks: Blocks, turn: Array, voxel_m: float,
    p: EdgeParameters, rays: RayParameters,
) -> tuple[Array, Array]:  # fmt: skip
    """(2,) unit vector down across an edge, and its (N, 2) points, m, in the voxels; none if they show no edge."""
    starts = _starts(points, down, p)
    at = np.empty((len(starts), 3))
    for n in range(len(starts)):
        x, y = starts[n, 0], starts[n, 1]
        for axis in range(2):
            at[n, axis] = (turn[axis, 0] * x + turn[axis, 1] * y) / voxel_m
        at[n, 2] = (centre[2] + (x - centre[0]) * gradient[0] + (y - centre[1]) * gradient[1]) / voxel_m - 1.0
    slope = gradient[0] * down[0] + gradient[1] * down[1]
    direction = np.array([turn[0, 0] * down[0] + turn[0, 1] * down[1], turn[1, 0] * down[0] + turn[1, 1] * down[1]])
    length, gap = (p.inside_m + p.beyond_m) / voxel_m, p.gap_m / voxel_m
    found = _ends(starts, solid_reach(blocks, at, direction, slope, length, gap, rays) * voxel_m, down, p)
    return (across(found, down, p.direction_ratio) if len(found) else down), found


@njit(**INSIDE)
def _starts(points: Array, down: Array, p: EdgeParameters) -> Array:
    """(N, 2) m, start points, a little before an edge, of the lanes that cross it."""
    s = points[:, 0] * down[0] + points[:, 1] * down[1]
    low, high = np.percentile(
        points[:, 1] * down[0] - points[:, 0] * down[1], np.array([p.trim_pct, 100.0 - p.trim_pct])
    )
    first = np.median(s) - p.inside_m
    starts = np.empty((p.lanes, 2))
    for n in range(p.lanes):
        aside = low + (high - low) * n / (p.lanes - 1)
        starts[n, 0] = first * down[0] - aside * down[1]
        starts[n, 1] = first * down[1] + aside * down[0]
    return starts


@njit(**INSIDE)
def _ends(starts: Array, reach: Array, down: Array, p: EdgeParameters) -> Array:
    """(N, 2) m, end points of the lanes without outliers; none if too few remain."""
    seen = np.isfinite(reach)
    if seen.sum() < p.points_min:
        return starts[:0]
    seen &= np.abs(reach - np.median(reach[seen])) < p.outlier_m
    if seen.sum() < p.points_min:
        return starts[:0]
    points = starts[seen]
    points[:, 0] += reach[seen] * down[0]
    points[:, 1] += reach[seen] * down[1]
    return points


def pairs_of(found: NDArray[np.int32], ids: NDArray[np.int64]) -> dict[tuple[int, int], NDArray[np.intp]]:
    """Rows of the result of `surface.borders`, by the ids of lower and upper plane."""
    if not len(found):
        return {}
    key = found[:, 0].astype(np.int64) * len(ids) + found[:, 1]
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    groups = np.split(order, starts[1:])
    return {(int(ids[found[g[0], 0]]), int(ids[found[g[0], 1]])): g for g in groups}


def heading_of(edges: list[Riser]) -> Array:
    """(2,) unit vector down the flight, fitted to all edges weighted by length."""
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


_UNKNOWN = math.inf
_PLACES = (3, 1, 2)
"""Indices of start, tread and rotation in the covariance of `Stairs`."""


def flights(risers: list[Riser], p: TerrainMapParameters) -> list[list[Riser]]:
    """Rows of parallel risers a tread apart, lowest first: the upper plane of one is the lower plane of the next."""
    above: dict[int, list[Riser]] = {}
    for r in risers:
        above.setdefault(r.lower, []).append(r)
    following: dict[int, Riser] = {}
    led_to: set[int] = set()
    for r in sorted(risers, key=lambda r: -len(r.points)):
        best = [n for n in above.get(r.upper, []) if _continues(r, n, p) and id(n) not in led_to]
        if best:
            nxt = max(best, key=lambda n: len(n.points))
            following[id(r)] = nxt
            led_to.add(id(nxt))
    rows = []
    for r in risers:
        if id(r) in led_to:
            continue
        row = [r]
        while id(row[-1]) in following:
            row.append(following[id(row[-1])])
        rows.append(row)
    return rows


def _continues(one: Riser, other: Riser, p: TerrainMapParameters) -> bool:
    (x, y), (to_x, to_y), (down_x, down_y) = one.middle, other.middle, one.down.tolist()
    tread = (x - to_x) * down_x + (y - to_y) * down_y
    return angle_between(one.down, other.down) < p.parallel_rad and p.tread_min_m <= tread <= p.tread_max_m


def stairs(row: list[Riser], planes: dict[int, Plane], id_: int, p: TerrainMapParameters) -> Stairs:
    """Fits a flight to a row of risers from the lowest, see `flights`, with covariance."""
    up = -heading_of(row)
    points = np.concatenate([r.points for r in row])
    counts = np.array([len(r.points) for r in row])
    sd = np.array([p.edge_sd_m if r.found else 2.0 * p.voxel_size_m for r in row])
    ground = [planes[row[0].lower], *(planes[r.upper] for r in row)]
    values, covariance, edges, across = _flight(
        points, counts, sd, up, (0.25 * p.voxel_size_m) ** 2, np.array([q.centre for q in ground]),
        np.array([q.gradient for q in ground]), np.array([q.spread for q in ground]),
        np.array([q.covariance for q in ground]), p.edges,
    )  # fmt: skip
    riser, tread, heading, start, base = values
    return Stairs(
        id=id_, planes=(row[0].lower, *(r.upper for r in row)), steps=len(row), riser=riser, tread=tread,
        heading=heading, start=start, base=base, covariance=covariance, edges=edges,
        risers=np.array([r.height for r in row]), across=across,
    )  # fmt: skip


@cached(_HERE, error_model="numpy")
def _flight(
    points: Array, counts: NDArray[np.int64], sd: Array, up: Array, least: float, centres: Array, gradients: Array,
    spreads: Array, covariances: Array, p: EdgeParameters,
) -> tuple[tuple[float, float, float, float, float], Array, Array, Array]:  # fmt: skip
    """Fits equal steps to the edges and planes of a row.

    Args:
        points: As in `_even`, like the next three.
        counts: Number of points of each edge.
        sd: m.
        up: (2,) unit vector of the direction of ascent.
        least: Smallest variance of a point, m².
        centres: (n + 1, 3), of the planes from the lowest, as in `Plane`, like the next three.
        gradients: (n + 1, 2).
        spreads: (n + 1, 2, 2).
        covariances: (n + 1, 3, 3).
        p: Border of a plane, and trimmed ends.

    Returns:
        Riser, tread, heading, start and base; their (5, 5) covariance; edges and across, see `Stairs`.
    """
    n, first, middle = len(counts), 0, 0.0
    middles = np.empty((n, 2))
    for k in range(n):
        own = points[first : first + counts[k]]
        first += counts[k]
        middles[k, 0], middles[k, 1] = own[:, 0].mean(), own[:, 1].mean()
        middle += (middles[k, 1] * up[0] - middles[k, 0] * up[1]) / n
    values, covariance = _even(points, counts, sd, up, middle, least)
    heights, height_sd = np.empty(n + 1), np.empty(n + 1)
    for k in range(n + 1):  # each plane where it is well observed toward its edge
        edge = middles[max(k - 1, 0)]
        x, y = toward(centres[k], spreads[k], edge[0], edge[1], p.border_m)
        slopes = np.array([1.0, x - centres[k, 0], y - centres[k, 1]])
        heights[k] = centres[k, 2] + slopes[1] * gradients[k, 0] + slopes[2] * gradients[k, 1]
        variance = 0.0
        for i in range(3):
            for j in range(3):
                variance += slopes[i] * covariances[k, i, j] * slopes[j]
        height_sd[k] = math.sqrt(variance)
    base, riser, height_covariance = _stair_line(heights, height_sd)
    full = np.zeros((5, 5))
    for i in range(3):
        for j in range(3):
            full[_PLACES[i], _PLACES[j]] = covariance[i, j]
    if n == 1:
        full[1, 1] = _UNKNOWN
    full[4, 4], full[4, 0] = height_covariance[0, 0], height_covariance[0, 1]
    full[0, 4], full[0, 0] = height_covariance[1, 0], height_covariance[1, 1]
    heading = math.atan2(up[1], up[0]) + values[2]
    # The line at its middle, along the rotated direction of ascent.
    x, y = values[0] * up[0] - middle * up[1], values[0] * up[1] + middle * up[0]
    start = x * math.cos(heading) + y * math.sin(heading)
    x, y = math.cos(heading), math.sin(heading)
    edges = middles[:, 0] * x + middles[:, 1] * y
    across = np.percentile(points[:, 1] * x - points[:, 0] * y, np.array([p.extent_pct, 100.0 - p.extent_pct]))
    return (riser, values[1], math.atan2(y, x), start, base), full, edges, across


@njit(error_model="numpy", **INSIDE)
def _even(
    points: Array, counts: NDArray[np.int64], sd: Array, up: Array, middle: float, least: float
) -> tuple[Array, Array]:
    """Fits evenly spaced edges, s = start + k tread - turn (l - middle), by least squares; one row per edge point.

    See docs/terrain_map.md (10).

    An edge's points share an error; Woodbury's formula includes it in the weights.

    Args:
        points: (N, 2) m, edge after edge.
        counts: Number of points of each edge.
        sd: Standard deviation of the error common to an edge's points, m.
        up: (2,) unit vector along which s is measured; l to its left.
        middle: Middle of l, m.
        least: Smallest variance of a point, m².

    Returns:
        (3,) start, tread and turn; their (3, 3) covariance.
    """
    s, aside = points[:, 0] * up[0] + points[:, 1] * up[1], points[:, 1] * up[0] - points[:, 0] * up[1]
    normal, right = np.zeros((3, 3)), np.zeros(3)
    first = 0
    for k in range(len(counts)):
        own_s, side = s[first : first + counts[k]], aside[first : first + counts[k]] - middle
        first += counts[k]
        n = float(counts[k])
        own = max(own_s.var(), least)
        shared = 1.0 / (own**2 * (n / own + 1.0 / sd[k] ** 2))
        ones = np.array([n, k * n, -side.sum()])
        squares = np.empty((3, 3))
        squares[0, 0], squares[0, 1], squares[1, 1] = n, k * n, k * k * n
        squares[0, 2], squares[1, 2], squares[2, 2] = ones[2], k * ones[2], (side * side).sum()
        squares[1, 0], squares[2, 0], squares[2, 1] = squares[0, 1], squares[0, 2], squares[1, 2]
        normal += squares / own - shared * np.outer(ones, ones)
        total = own_s.sum()
        right += np.array([total, k * total, -(side * own_s).sum()]) / own - shared * total * ones
    at = np.array([0, 1, 2]) if len(counts) > 1 else np.array([0, 2])  # a single edge does not determine the tread
    known = np.empty((len(at), len(at)))
    for i in range(len(at)):
        for j in range(len(at)):
            known[i, j] = normal[at[i], at[j]] + (1e-9 if i == j else 0.0)
    solved = np.linalg.inv(known)
    values, covariance = np.array([0.0, math.nan, 0.0]), np.zeros((3, 3))
    for i in range(len(at)):
        values[at[i]] = 0.0
        for j in range(len(at)):
            covariance[at[i], at[j]] = solved[i, j]
            values[at[i]] += solved[i, j] * right[at[j]]
    return values, covariance


@njit(error_model="numpy", **INSIDE)
def _stair_line(heights: Array, sd: Array) -> tuple[float, float, Array]:
    """Fits base and riser of equal steps, with their (2, 2) covariance. See docs/terrain_map.md (10)."""
    w, k = sd**-2, np.arange(len(heights))
    n, x, xx = w.sum(), (w * k).sum(), (w * k * k).sum()
    det = n * xx - x * x
    covariance = np.array([[xx / det, -x / det], [-x / det, n / det]])
    y, xy = (w * heights).sum(), (w * k * heights).sum()
    return (xx * y - x * xy) / det, (n * xy - x * y) / det, covariance
