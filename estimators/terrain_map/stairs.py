"""Stairs as one object: planes in a row, each a step above the one before, with equal risers and treads."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.compiled import INSIDE, cached
from stridetwin.estimators.terrain_map.estimate import Plane, Stairs
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.plane_fit import toward
from stridetwin.estimators.terrain_map.risers import Riser, angle_between, heading_of
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent

_UNKNOWN = math.inf
_PLACES = (3, 1, 2)
"""Of start, tread and turn in the covariance of `Stairs`."""
_ENDS = np.array([2.0, 98.0])
"""Percentiles of its points between which a flight's edges reach."""


def flights(risers: list[Riser], p: TerrainMapParameters) -> list[list[Riser]]:
    """Risers in a row, from the lowest: the upper plane of one is the lower plane of the next, parallel, a tread on.

    Args:
        risers: Steps between two planes each.
        p: Limits of treads.
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
        rows.append(row)
    return rows


def _continues(one: Riser, other: Riser, p: TerrainMapParameters) -> bool:
    (x, y), (to_x, to_y), (down_x, down_y) = one.middle, other.middle, one.down.tolist()
    tread = (x - to_x) * down_x + (y - to_y) * down_y
    return angle_between(one.down, other.down) < p.parallel_rad and p.tread_min_m <= tread <= p.tread_max_m


def stairs(row: list[Riser], planes: dict[int, Plane], id_: int, p: TerrainMapParameters) -> Stairs:
    """The flight that suits a row of risers best, with covariance.

    Args:
        row: Risers from the lowest, see `flights`.
        planes: By id.
        id_: Of the stairs.
        p: Uncertainties that all of an edge or a plane shares.
    """
    up = -heading_of(row)
    points = np.concatenate([r.points for r in row])
    counts = np.array([len(r.points) for r in row])
    sd = np.array([p.edge_sd_m if r.found else 2.0 * p.voxel_size_m for r in row])
    ground = [planes[row[0].lower], *(planes[r.upper] for r in row)]
    told, covariance, edges, across = _flight(
        points, counts, sd, up, (0.25 * p.voxel_size_m) ** 2, np.array([q.centre for q in ground]),
        np.array([q.gradient for q in ground]), np.array([q.spread for q in ground]),
        np.array([q.covariance for q in ground]),
    )  # fmt: skip
    riser, tread, heading, start, base = told
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
    """Equal steps through the edges and planes of a row.

    Args:
        points: As of `_even`, likewise the next three.
        counts: How many each edge has.
        sd: m.
        up: (2,) unit vector of the way up.
        least: Smallest variance of a point, m².
        centres: (n + 1, 3), of the planes from the lowest, as of `Plane`, likewise the next three.
        gradients: (n + 1, 2).
        spreads: (n + 1, 2, 2).
        covariances: (n + 1, 3, 3).

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
    for k in range(n + 1):  # each plane where it is well seen toward its edge
        edge = middles[max(k - 1, 0)]
        x, y = toward(centres[k], spreads[k], edge[0], edge[1])
        slopes = np.array([1.0, x - centres[k, 0], y - centres[k, 1]])
        heights[k] = centres[k, 2] + slopes[1] * gradients[k, 0] + slopes[2] * gradients[k, 1]
        variance = 0.0
        for i in range(3):
            for j in range(3):
                variance += slopes[i] * covariances[k, i, j] * slopes[j]
        height_sd[k] = math.sqrt(variance)
    base, riser, height_covariance = _line(heights, height_sd)
    full = np.zeros((5, 5))
    for i in range(3):
        for j in range(3):
            full[_PLACES[i], _PLACES[j]] = covariance[i, j]
    if n == 1:
        full[1, 1] = _UNKNOWN
    full[4, 4], full[4, 0] = height_covariance[0, 0], height_covariance[0, 1]
    full[0, 4], full[0, 0] = height_covariance[1, 0], height_covariance[1, 1]
    heading = math.atan2(up[1], up[0]) + values[2]
    # The line at its middle, told along the turned way up.
    x, y = values[0] * up[0] - middle * up[1], values[0] * up[1] + middle * up[0]
    start = x * math.cos(heading) + y * math.sin(heading)
    x, y = math.cos(heading), math.sin(heading)
    edges = middles[:, 0] * x + middles[:, 1] * y
    across = np.percentile(points[:, 1] * x - points[:, 0] * y, _ENDS)
    return (riser, values[1], math.atan2(y, x), start, base), full, edges, across


@njit(error_model="numpy", **INSIDE)
def _even(
    points: Array, counts: NDArray[np.int64], sd: Array, up: Array, middle: float, least: float
) -> tuple[Array, Array]:
    """Even edges: s = start + k tread - turn (l - middle), one row an edge point, by least squares.

    See docs/terrain_map.md (10).

    An edge's points share an error: what all of them share comes out of the weights by Woodbury's formula.

    Args:
        points: (N, 2) m, those of each edge in turn.
        counts: How many each has.
        sd: m, what the points of each share.
        up: (2,) unit vector along which s is measured; l to its left.
        middle: m.
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
    at = np.array([0, 1, 2]) if len(counts) > 1 else np.array([0, 2])  # one edge alone tells no tread
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
def _line(heights: Array, sd: Array) -> tuple[float, float, Array]:
    """Base and riser of equal steps, and their (2, 2) covariance. See docs/terrain_map.md (10)."""
    w, k = sd**-2, np.arange(len(heights))
    n, x, xx = w.sum(), (w * k).sum(), (w * k * k).sum()
    det = n * xx - x * x
    covariance = np.array([[xx / det, -x / det], [-x / det, n / det]])
    y, xy = (w * heights).sum(), (w * k * heights).sum()
    return (xx * y - x * xy) / det, (n * xy - x * y) / det, covariance
