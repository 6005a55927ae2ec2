"""Stairs as one object: planes in a row, each a step above the one before, with equal risers and treads."""

from __future__ import annotations

import math

import numpy as np

from stridetwin.estimators.terrain_map.estimate import Plane, Stairs
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.risers import Riser, angle_between, heading_of
from stridetwin.streams.samples import Array

_PARALLEL = math.radians(20.0)
_UNKNOWN = math.inf


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
    tread = -float((other.middle - one.middle) @ one.down)
    return angle_between(one.down, other.down) < _PARALLEL and p.tread_min_m <= tread <= p.tread_max_m


def stairs(row: list[Riser], planes: dict[int, Plane], id_: int, p: TerrainMapParameters) -> Stairs:
    """The flight that suits a row of risers best, with covariance.

    Args:
        row: Risers from the lowest, see `flights`.
        planes: By id.
        id_: Of the stairs.
        p: Uncertainties that all of an edge or a plane shares.
    """
    up = -heading_of(row)
    left = np.array([-up[1], up[0]])
    n = len(row)
    middle = np.mean([r.middle @ left for r in row])
    # s = start + k tread - turn (l - middle), one row an edge point: least squares, an edge's points share an error.
    normal, right = np.zeros((3, 3)), np.zeros(3)
    edges = np.full(n, np.nan)
    sd = np.zeros(n)
    for k, r in enumerate(row):
        s, side = r.points @ up, r.points @ left - middle
        sd[k] = p.edge_sd_m if r.found else 2.0 * p.voxel_m
        edges[k] = s.mean()
        J = np.column_stack([np.ones(len(s)), np.full(len(s), float(k)), -side])
        # Own scatter of the points, and what all of them share, out of the weights by Woodbury's formula.
        own = max(float((s - s.mean()).var()), (0.25 * p.voxel_m) ** 2)
        shared = 1.0 / (own**2 * (len(s) / own + 1.0 / sd[k] ** 2))
        ones = J.sum(axis=0)
        normal += J.T @ J / own - shared * np.outer(ones, ones)
        right += J.T @ s / own - shared * ones * s.sum()
    known = 3 if n > 1 else 2
    at = np.array([0, 1, 2] if n > 1 else [0, 2])
    covariance = np.full((3, 3), 0.0)
    values = np.array([0.0, math.nan, 0.0])
    solved = np.linalg.inv(normal[np.ix_(at, at)] + 1e-9 * np.eye(known))
    values[at] = solved @ right[at]
    covariance[np.ix_(at, at)] = solved
    turn = float(values[2])
    ground = [(planes[row[0].lower], row[0].middle), *((planes[r.upper], r.middle) for r in row)]
    heights = np.array([float(plane.height(plane.toward(edge))) for plane, edge in ground])
    height_sd = np.array([plane.height_sd(plane.toward(edge)) for plane, edge in ground])
    base, riser, height_covariance = _line(heights, height_sd)
    full = np.zeros((5, 5))
    place = {0: 3, 1: 1, 2: 2}
    for i in range(3):
        for j in range(3):
            full[place[i], place[j]] = covariance[i, j]
    if n == 1:
        full[1, 1] = _UNKNOWN
    full[np.ix_([4, 0], [4, 0])] = height_covariance
    heading = math.atan2(up[1], up[0]) + turn
    across = np.concatenate([r.points @ left for r in row])
    # The line at its middle, told along the turned way up.
    foot = (values[0] * up + middle * left) @ np.array([math.cos(heading), math.sin(heading)])
    return Stairs(
        id=id_, planes=(row[0].lower, *(r.upper for r in row)), steps=n, riser=riser, tread=float(values[1]),
        heading=math.atan2(math.sin(heading), math.cos(heading)), start=float(foot), base=base, covariance=full,
        edges=edges, risers=np.array([r.height for r in row]),
        across=np.array([np.percentile(across, 2), np.percentile(across, 98)]),
    )  # fmt: skip


def _line(heights: Array, sd: Array) -> tuple[float, float, Array]:
    """Base and riser of equal steps, and their (2, 2) covariance."""
    J = np.column_stack([np.ones(len(heights)), np.arange(len(heights))])
    covariance = np.asarray(np.linalg.inv(J.T @ (J / sd[:, None] ** 2)), float)
    base, riser = covariance @ (J.T @ (heights / sd**2))
    return float(base), float(riser), covariance
