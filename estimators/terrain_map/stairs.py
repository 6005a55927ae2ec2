"""Fits flights of stairs with equal risers and treads to rows of planes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.compiled import INSIDE, cached
from stridetwin.estimators.terrain_map.estimate import Plane, Stairs
from stridetwin.estimators.terrain_map.order_statistics import mean, percentile, sort
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.plane_fit import BORDER_M, toward
from stridetwin.estimators.terrain_map.risers import Riser, projected
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent
_UNKNOWN = math.inf
_PARALLEL_RAD = math.radians(20.0)
"""Largest difference in direction between edges of one flight."""
_WINDING_RAD = math.radians(8.0)
"""Mean difference from edge to edge above which a flight winds."""
_EXTENT_PCT = 2.0
"""Share of a flight's points, at either side, beyond its reported lateral extent, %."""
_PLACES = (3, 1, 2)
"""Indices of start, tread and rotation in the covariance of `Stairs`."""


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


def flights(risers: list[Riser], p: TerrainMapParameters) -> list[list[Riser]]:
    """Rows of parallel risers a tread apart, lowest first: the upper plane of one is the lower plane of the next.

    The risers of a flight that winds are rows of their own, each with its own direction.
    """
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
        rows += [[one] for one in row] if _winds(row) else [row]
    return rows


def _winds(row: list[Riser]) -> bool:
    """Whether each edge of three or more is turned against the one before, all to one side."""
    if len(row) < 3:
        return False
    down = np.array([complex(*r.down) for r in row])
    turns = np.angle(down[1:] / down[:-1])
    return bool(abs(turns.mean()) > _WINDING_RAD and (turns * turns.mean() > 0.0).all())


def _continues(one: Riser, other: Riser, p: TerrainMapParameters) -> bool:
    (x, y), (to_x, to_y), (down_x, down_y) = one.middle, other.middle, one.down.tolist()
    tread = (x - to_x) * down_x + (y - to_y) * down_y
    return angle_between(one.down, other.down) < _PARALLEL_RAD and p.min_tread_m <= tread <= p.max_tread_m


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
        np.array([q.covariance for q in ground]),
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
    spreads: Array, covariances: Array,
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
        x, y = toward(centres[k], spreads[k], edge[0], edge[1], BORDER_M)
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
    edges, aside, extent = projected(middles, x, y), projected(points, -y, x), np.empty(2)
    sort(aside)
    extent[0] = percentile(aside, _EXTENT_PCT)
    extent[1] = percentile(aside, 100.0 - _EXTENT_PCT)
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
    s, aside = projected(points, up[0], up[1]), projected(points, -up[1], up[0])
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
