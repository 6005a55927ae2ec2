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
from stridetwin.estimators.terrain_map.order_statistics import mean, median, percentile, sort
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
    n, least, most = len(points), math.inf, -math.inf
    for k in range(n):
        along = points[k, 1] * down[0] - points[k, 0] * down[1]
        least, most = min(least, along), max(most, along)
    return mean(points, 0, n, 0), mean(points, 0, n, 1), most - least


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
    x, y = mean(points, 0, len(points), 0), mean(points, 0, len(points), 1)
    lower = seen_height(low_centre, low_gradient, low_spread, x, y, p.border_m)
    return down, points, seen_height(centre, gradient, spread, x, y, p.border_m) - lower


@njit(**INSIDE)
def _projected(points: Array, u: float, v: float) -> Array:
    """(N,) coordinates of (N, 2) points along (u, v)."""
    s = np.empty(points.shape[0])
    for n in range(points.shape[0]):
        s[n] = points[n, 0] * u + points[n, 1] * v
    return s


@njit(**INSIDE)
def _median(s: Array) -> float:
    ordered = s.copy()
    sort(ordered)
    return median(ordered, ordered.shape[0])


@njit(**INSIDE)
def _kept(points: Array, keep: NDArray[np.bool_], fewest: int) -> Array:
    """The (N, 2) points to keep; none if they are too few."""
    count = 0
    for n in range(points.shape[0]):
        count += keep[n]
    found = np.empty((count if count >= fewest else 0, 2))
    at = 0
    for n in range(points.shape[0] if count >= fewest else 0):
        if keep[n]:
            found[at, 0] = points[n, 0]
            found[at, 1] = points[n, 1]
            at += 1
    return found


@njit(**INSIDE)
def _line(ends: Array, toward: Array, p: EdgeParameters) -> tuple[Array, Array]:
    """(2,) unit vector down across an edge, and its columns (see `_edge`) on the line; none if there is no edge."""
    count, down = ends.shape[0], np.empty(2)
    down[0] = mean(toward, 0, count, 0)
    down[1] = mean(toward, 0, count, 1)
    keep = np.zeros(count, np.bool_)
    if math.hypot(down[0], down[1]) < p.open_side:  # the lower plane surrounds the upper one: no edge to step over
        return down, _kept(ends, keep, 1)
    down = across(ends, down, p.direction_ratio)
    s = _projected(ends, down[0], down[1])
    middle = _median(s)
    for n in range(count):
        keep[n] = abs(s[n] - middle) < p.line_m
    points = _kept(ends, keep, p.points_min)
    return (across(points, down, p.direction_ratio) if len(points) else down), points


@njit(**INSIDE)
def across(points: Array, toward: Array, ratio_min: float) -> Array:
    """(2,) unit vector across the line through (N, 2) points, on the side of `toward` (2,)."""
    count, found = points.shape[0], np.empty(2)
    middle_x, middle_y = mean(points, 0, count, 0), mean(points, 0, count, 1)
    xx, xy, yy = 0.0, 0.0, 0.0
    for n in range(count):
        x, y = points[n, 0] - middle_x, points[n, 1] - middle_y
        xx += x * x
        xy += x * y
        yy += y * y
    turn = 0.5 * math.atan2(2.0 * xy, xx - yy)  # the line's, from its scatter
    ahead = -math.sin(turn) * toward[0] + math.cos(turn) * toward[1]
    along = math.cos(turn) * toward[0] + math.sin(turn) * toward[1]
    if abs(ahead) < abs(along) * ratio_min:  # the edge is too short to have a direction
        size = math.hypot(toward[0], toward[1])
        found[0] = toward[0] / size
        found[1] = toward[1] / size
    else:
        side = math.copysign(1.0, ahead)
        found[0] = side * -math.sin(turn)
        found[1] = side * math.cos(turn)
    return found


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
    direction = np.empty(2)
    for axis in range(2):
        direction[axis] = turn[axis, 0] * down[0] + turn[axis, 1] * down[1]
    length, gap = (p.inside_m + p.beyond_m) / voxel_m, p.gap_m / voxel_m
    found = _ends(starts, solid_reach(blocks, at, direction, slope, length, gap, rays), voxel_m, down, p)
    return (across(found, down, p.direction_ratio) if len(found) else down), found


@njit(**INSIDE)
def _starts(points: Array, down: Array, p: EdgeParameters) -> Array:
    """(N, 2) m, start points, a little before an edge, of the lanes that cross it."""
    aside = _projected(points, -down[1], down[0])
    sort(aside)
    low, high = percentile(aside, p.trim_pct), percentile(aside, 100.0 - p.trim_pct)
    first = _median(_projected(points, down[0], down[1])) - p.inside_m
    starts = np.empty((p.lanes, 2))
    for n in range(p.lanes):
        lane = low + (high - low) * n / (p.lanes - 1)
        starts[n, 0] = first * down[0] - lane * down[1]
        starts[n, 1] = first * down[1] + lane * down[0]
    return starts


@njit(**INSIDE)
def _ends(starts: Array, reach: Array, voxel_m: float, down: Array, p: EdgeParameters) -> Array:
    """(N, 2) m, end points of the lanes without outliers, from their reach, voxels; none if too few remain."""
    points, keep, seen = np.empty(starts.shape), np.zeros(starts.shape[0], np.bool_), 0
    known = np.empty(starts.shape[0])
    for n in range(starts.shape[0]):
        if math.isfinite(reach[n]):
            known[seen] = reach[n] * voxel_m
            seen += 1
    if seen < p.points_min:
        return _kept(points, keep, 1)
    middle = _median(known[:seen])
    for n in range(starts.shape[0]):
        along = reach[n] * voxel_m
        keep[n] = abs(along - middle) < p.outlier_m
        points[n, 0] = starts[n, 0] + along * down[0]
        points[n, 1] = starts[n, 1] + along * down[1]
    return _kept(points, keep, p.points_min)


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
        middles[k, 0] = mean(points, first, first + counts[k], 0)
        middles[k, 1] = mean(points, first, first + counts[k], 1)
        first += counts[k]
        middle += (middles[k, 1] * up[0] - middles[k, 0] * up[1]) / n
    values, covariance = _even(points, counts, sd, up, middle, least)
    heights, height_sd, slopes = np.empty(n + 1), np.empty(n + 1), np.empty(3)
    for k in range(n + 1):  # each plane where it is well observed toward its edge
        edge = middles[max(k - 1, 0)]
        x, y = toward(centres[k], spreads[k], edge[0], edge[1], p.border_m)
        slopes[0] = 1.0
        slopes[1] = x - centres[k, 0]
        slopes[2] = y - centres[k, 1]
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
    full[4, 4] = height_covariance[0, 0]
    full[4, 0] = height_covariance[0, 1]
    full[0, 4] = height_covariance[1, 0]
    full[0, 0] = height_covariance[1, 1]
    heading = math.atan2(up[1], up[0]) + values[2]
    # The line at its middle, along the rotated direction of ascent.
    x, y = values[0] * up[0] - middle * up[1], values[0] * up[1] + middle * up[0]
    start = x * math.cos(heading) + y * math.sin(heading)
    x, y = math.cos(heading), math.sin(heading)
    edges, aside, extent = _projected(middles, x, y), _projected(points, -y, x), np.empty(2)
    sort(aside)
    extent[0] = percentile(aside, p.extent_pct)
    extent[1] = percentile(aside, 100.0 - p.extent_pct)
    return (riser, values[1], math.atan2(y, x), start, base), full, edges, extent


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
    s, aside = _projected(points, up[0], up[1]), _projected(points, -up[1], up[0])
    normal, right = np.zeros((3, 3)), np.zeros(3)
    ones, squares, products = np.empty(3), np.empty((3, 3)), np.empty(3)
    first = 0
    for k in range(len(counts)):
        end, n = first + counts[k], float(counts[k])
        total, sides, side_squares, side_s = 0.0, 0.0, 0.0, 0.0
        for i in range(first, end):
            side = aside[i] - middle
            total += s[i]
            sides += side
            side_squares += side * side
            side_s += side * s[i]
        scatter = 0.0
        for i in range(first, end):
            scatter += (s[i] - total / n) ** 2
        first = end
        own = max(scatter / n, least)
        shared = 1.0 / (own**2 * (n / own + 1.0 / sd[k] ** 2))
        ones[0] = n
        ones[1] = k * n
        ones[2] = -sides
        squares[0, 0] = n
        squares[0, 1] = k * n
        squares[1, 1] = k * k * n
        squares[0, 2] = ones[2]
        squares[1, 2] = k * ones[2]
        squares[2, 2] = side_squares
        products[0] = total
        products[1] = k * total
        products[2] = -side_s
        for i in range(3):
            right[i] += products[i] / own - shared * total * ones[i]
            for j in range(3):
                normal[i, j] += squares[min(i, j), max(i, j)] / own - shared * (ones[i] * ones[j])
    fitted = 3 if len(counts) > 1 else 2  # a single edge does not determine the tread, the second
    at, known = np.empty(fitted, np.int64), np.empty((fitted, fitted))
    for i in range(fitted):
        at[i] = i * 2 // (fitted - 1)
    for i in range(fitted):
        for j in range(fitted):
            known[i, j] = normal[at[i], at[j]] + (1e-9 if i == j else 0.0)
    solved = np.linalg.inv(known)
    values, covariance = np.zeros(3), np.zeros((3, 3))
    values[1] = math.nan
    for i in range(fitted):
        values[at[i]] = 0.0
        for j in range(fitted):
            covariance[at[i], at[j]] = solved[i, j]
            values[at[i]] += solved[i, j] * right[at[j]]
    return values, covariance


@njit(error_model="numpy", **INSIDE)
def _stair_line(heights: Array, sd: Array) -> tuple[float, float, Array]:
    """Fits base and riser of equal steps, with their (2, 2) covariance. See docs/terrain_map.md (10)."""
    n, x, xx, y, xy = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(heights)):
        w = sd[k] ** -2
        n += w
        x += w * k
        xx += w * k * k
        y += w * heights[k]
        xy += w * k * heights[k]
    det, covariance = n * xx - x * x, np.empty((2, 2))
    covariance[0, 0] = xx / det
    covariance[0, 1] = -x / det
    covariance[1, 0] = -x / det
    covariance[1, 1] = n / det
    return (xx * y - x * xy) / det, (n * xy - x * y) / det, covariance
