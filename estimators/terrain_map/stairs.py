"""Fits flights of stairs with equal risers and treads to rows of planes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from stridetwin.estimators.terrain_map.estimate import Plane, Stairs
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.plane_fit import BORDER_M, point_toward
from stridetwin.estimators.terrain_map.risers import Riser
from stridetwin.streams.samples import Array

_UNKNOWN = math.inf  # variance
_IDENTITY = np.eye(3)
_PARALLEL_RAD = math.radians(20.0)
"""Largest difference in direction between edges of one flight."""
_WINDING_RAD = math.radians(8.0)
"""Mean difference from edge to edge above which a flight winds."""
_EXTENT = (0.02, 0.98)
"""A flight's reported lateral extent: from this to this quantile of its points, from right to left."""
_EVEN, _STEPS = np.ix_((3, 1, 2), (3, 1, 2)), np.ix_((4, 0), (4, 0))
"""Rows and columns of start, tread and rotation, and of base and riser, in the covariance of `Stairs`."""


def heading_of(edges: Sequence[Riser]) -> Array:
    """(2,) unit vector down the flight: the mean of the edges' `down`, weighted by the cube of their length.

    An edge whose `down` is opposite to that of the edge with the most points counts reversed.
    """
    downs = np.array([edge.down for edge in edges])
    most = max(edges, key=lambda e: len(e.points)).down
    total = np.copysign([edge.length**3 for edge in edges], downs @ most) @ downs
    return np.asarray(total / math.hypot(*total.tolist()))


def find_flights(risers: list[Riser], p: TerrainMapParameters) -> list[list[Riser]]:
    """Rows of parallel risers a tread apart, lowest first: the upper plane of one is the lower plane of the next.

    The risers of a flight that winds are rows of their own, each with its own direction.
    """
    # risers by their lower plane; `following` is the next riser up by the `id()` of a riser, `led_to` that of these
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
        rows += [[one] for one in row] if _is_winding(row) else [row]
    return rows


def _is_winding(row: list[Riser]) -> bool:
    """Whether each edge of three or more is turned against the one before, all to one side."""
    if len(row) < 3:
        return False
    down = np.array([complex(*r.down) for r in row])
    turns = np.angle(down[1:] / down[:-1])  # rad, from each edge to the next, anticlockwise positive
    return bool(abs(turns.mean()) > _WINDING_RAD and (turns * turns.mean() > 0.0).all())


def _continues(one: Riser, other: Riser, p: TerrainMapParameters) -> bool:
    """Whether one riser continues in another: parallel, and a tread farther up."""
    tread = float(np.subtract(one.middle, other.middle) @ one.down)  # positive: the other one is farther up
    are_parallel = float(one.down @ other.down) > math.cos(_PARALLEL_RAD)
    return are_parallel and p.min_tread_m <= tread <= p.max_tread_m


def fit_stairs(row: list[Riser], planes: dict[int, Plane], id_: int, p: TerrainMapParameters) -> Stairs:
    """Fits a flight with equal risers and treads, and its covariance, to a row of risers: docs/terrain_map.md (10).

    Args:
        row: Risers from the lowest, see `find_flights`.
        planes: Planes by id.
        id_: Id of the flight.
        p: Standard deviations.
    """
    up = -heading_of(row)
    left = to_left(up)
    middles = np.array([r.middle for r in row])
    middle = float((middles @ left).mean())
    # edges from the voxels are more accurate than those from the columns
    sd = [p.edge_sd_m if r.in_voxels else 2.0 * p.voxel_size_m for r in row]
    # even: start, tread and rotation of the edges, of_even: their covariance; steps: base and riser, likewise
    even, of_even = fit_even_edges([r.points for r in row], sd, up, middle, (0.25 * p.voxel_size_m) ** 2)
    ids = (row[0].lower, *(r.upper for r in row))
    ground = [_height_and_sd(planes[k], middles[max(n - 1, 0)]) for n, k in enumerate(ids)]
    steps, of_steps = fit_stair_line(*np.array(ground).T)
    covariance = np.zeros((5, 5))  # of riser, tread, heading, start and base
    covariance[_EVEN], covariance[_STEPS] = of_even, of_steps
    if len(row) == 1:
        covariance[1, 1] = _UNKNOWN
    heading = math.atan2(up[1], up[0]) + float(even[2])
    up_flight = np.array([math.cos(heading), math.sin(heading)])
    aside = np.sort(np.concatenate([r.points for r in row]) @ to_left(up_flight))
    return Stairs(
        id=id_,
        planes=ids,
        steps=len(row),
        riser=float(steps[1]),
        tread=float(even[1]),
        heading=math.atan2(up_flight[1], up_flight[0]),
        base=float(steps[0]),
        covariance=covariance,
        start=float((even[0] * up + middle * left) @ up_flight),  # the line at its middle
        edges=middles @ up_flight,
        risers=np.array([r.height for r in row]),
        # percentiles, by linear interpolation; `numpy.percentile` takes ten times as long for as few points
        across=np.interp(_EXTENT, np.linspace(0.0, 1.0, len(aside)), aside),
    )


def to_left(forward: Array) -> Array:
    """(2,) unit vector to the left of a (2,) direction."""
    return np.array([-forward[1], forward[0]])


def _height_and_sd(plane: Plane, place: Array) -> tuple[float, float]:
    """Height of a plane, m, where it is well observed toward a place (2,), and its standard deviation, m."""
    x, y = point_toward(plane.centre, plane.spread, place[0], place[1], BORDER_M)
    J = np.array([1.0, x - plane.centre[0], y - plane.centre[1]])
    return float(plane.centre[2] + J[1:] @ plane.gradient), math.sqrt(J @ plane.covariance @ J)


def fit_even_edges(
    edges: Sequence[Array], sd: Sequence[float], up: Array, middle: float, least: float
) -> tuple[Array, Array]:
    """Fits evenly spaced edges s = start + k tread − turn (l − middle) by least squares: docs/terrain_map.md (10).

    One row per edge point. An edge's points share an error; Woodbury's formula includes it in the weights.

    Args:
        edges: (N, 2) m, points of each edge.
        sd: Standard deviation of the error common to an edge's points, m.
        up: (2,) unit vector along which s is measured; l to its left.
        middle: Middle of l, m.
        least: Smallest variance of a point, m².

    Returns:
        (3,) start, tread and turn, NaN for the tread of a single edge; their (3, 3) covariance.
    """
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for k, points in enumerate(edges):
        s, l, n = points @ up, points @ to_left(up), len(points)
        variance = max(float(s.var()), least)
        # inverse of variance I + sd² 1 1ᵀ: I / variance - shared 1 1ᵀ
        shared = 1.0 / (variance**2 * (n / variance + 1.0 / sd[k] ** 2))
        A = np.column_stack([np.ones(n), np.full(n, float(k)), middle - l])
        total = A.sum(axis=0)
        normal += A.T @ A / variance - shared * total[:, None] * total
        right += A.T @ s / variance - shared * s.sum() * total
    normal += 1e-9 * _IDENTITY
    if len(edges) > 1:
        covariance = np.linalg.inv(normal)
        return covariance @ right, covariance
    # a single edge does not determine the tread: start and turn alone
    values, covariance = np.full(3, math.nan), np.zeros((3, 3))
    covariance[::2, ::2] = np.linalg.inv(normal[::2, ::2])
    values[::2] = covariance[::2, ::2] @ right[::2]
    return values, covariance


def fit_stair_line(heights: Array, sd: Array) -> tuple[Array, Array]:
    """Fits base and riser h_k = h_0 + k r to heights (N,), m, by weighted least squares: docs/terrain_map.md (10).

    Args:
        heights: (N,) m, from the lowest.
        sd: (N,) standard deviations, m.

    Returns:
        (2,) base and riser, m; their (2, 2) covariance.
    """
    A = np.column_stack([np.ones(len(sd)), np.arange(len(sd))]) / sd[:, None]
    covariance = np.asarray(np.linalg.inv(A.T @ A), float)
    return np.asarray(covariance @ (A.T @ (heights / sd)), float), covariance
