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
    reference = max(edges, key=lambda edge: len(edge.points)).down  # of the edge with the most points
    weights = np.copysign([edge.length**3 for edge in edges], downs @ reference)
    total = weights @ downs
    return np.asarray(total / math.hypot(*total.tolist()))


def find_flights(risers: list[Riser], p: TerrainMapParameters) -> list[list[Riser]]:
    """Rows of parallel risers a tread apart, lowest first: the upper plane of one is the lower plane of the next.

    The risers of a flight that winds are rows of their own, each with its own direction.
    """
    above: dict[int, list[Riser]] = {}  # by id of a plane: the risers that lead up from it
    for riser in risers:
        above.setdefault(riser.lower, []).append(riser)
    following: dict[int, Riser] = {}  # by `id()` of a riser: the next one up
    led_to: set[int] = set()  # `id()` of the risers that are the next one of another
    for riser in sorted(risers, key=lambda riser: -len(riser.points)):  # risers with many points choose first
        candidates = [
            upper for upper in above.get(riser.upper, []) if _continues(riser, upper, p) and id(upper) not in led_to
        ]
        if candidates:
            next_riser = max(candidates, key=lambda upper: len(upper.points))
            following[id(riser)] = next_riser
            led_to.add(id(next_riser))
    rows = []
    for riser in risers:
        if id(riser) in led_to:  # not the lowest of its row
            continue
        row = [riser]
        while id(row[-1]) in following:
            row.append(following[id(row[-1])])
        rows += [[one] for one in row] if _is_winding(row) else [row]  # each riser of a winding row by itself
    return rows


def _is_winding(row: list[Riser]) -> bool:
    """Whether each edge of three or more is turned against the one before, all to one side."""
    if len(row) < 3:
        return False
    down = np.array([complex(*riser.down) for riser in row])  # directions as complex numbers x + i y
    turns = np.angle(down[1:] / down[:-1])  # rad, from each edge to the next, anticlockwise positive
    return bool(abs(turns.mean()) > _WINDING_RAD and (turns * turns.mean() > 0.0).all())


def _continues(one: Riser, other: Riser, p: TerrainMapParameters) -> bool:
    """Whether the riser `other` may be the next one up after `one` in a flight: parallel, and a tread farther up."""
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
    up = -heading_of(row)  # (2,) first estimate of the direction of ascent, which the fit corrects by a small turn
    left = to_left(up)
    middles = np.array([riser.middle for riser in row])  # (R, 2) m, world
    middle = float((middles @ left).mean())  # of the flight's width, m to the left
    # edges from the voxels are more accurate than those from the columns
    sd = [p.edge_sd_m if riser.in_voxels else 2.0 * p.voxel_size_m for riser in row]
    edge_points = [riser.points for riser in row]
    min_variance = (0.25 * p.voxel_size_m) ** 2  # of a point, m²: no point is better than a quarter of a voxel
    (start, tread, turn), even_covariance = fit_even_edges(edge_points, sd, up, middle, min_variance)
    ids = (row[0].lower, *(riser.upper for riser in row))  # of the planes, from the lowest
    # height of each plane and its standard deviation, m, toward the edge below it; of the lowest, toward the first edge
    ground = [_height_and_sd(planes[id_plane], middles[max(n - 1, 0)]) for n, id_plane in enumerate(ids)]
    (base, riser_m), steps_covariance = fit_stair_line(*np.array(ground).T)
    covariance = np.zeros((5, 5))  # of riser, tread, heading, start and base
    covariance[_EVEN], covariance[_STEPS] = even_covariance, steps_covariance
    if len(row) == 1:
        covariance[1, 1] = _UNKNOWN
    heading = math.atan2(up[1], up[0]) + float(turn)
    up_flight = np.array([math.cos(heading), math.sin(heading)])
    aside = np.sort(np.concatenate(edge_points) @ to_left(up_flight))  # lateral positions of all points, m
    return Stairs(
        id=id_,
        planes=ids,
        steps=len(row),
        riser=float(riser_m),
        tread=float(tread),
        heading=math.atan2(up_flight[1], up_flight[0]),  # `heading` within -π to π
        base=float(base),
        covariance=covariance,
        start=float((start * up + middle * left) @ up_flight),  # the middle of the first edge, along the new direction
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
    # derivative of the height there by height at the centre and both slopes
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
    normal, right = np.zeros((3, 3)), np.zeros(3)  # matrix and right side of the normal equations
    for k, points in enumerate(edges):
        s, l, n = points @ up, points @ to_left(up), len(points)  # m along the ascent, m to the left, number
        variance = max(float(s.var()), least)
        # inverse of variance I + sd² 1 1ᵀ: I / variance - shared 1 1ᵀ
        shared = 1.0 / (variance**2 * (n / variance + 1.0 / sd[k] ** 2))
        A = np.column_stack([np.ones(n), np.full(n, float(k)), middle - l])  # derivatives by start, tread and turn
        total = A.sum(axis=0)
        normal += A.T @ A / variance - shared * total[:, None] * total
        right += A.T @ s / variance - shared * s.sum() * total
    normal += 1e-9 * _IDENTITY  # so that it has an inverse whatever the points are
    if len(edges) > 1:
        covariance: Array = np.asarray(np.linalg.inv(normal), float)
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
