"""Edges between two flat planes: where the upper one ends, to a centimetre."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.terrain_map.blocks import Blocks
from stridetwin.estimators.terrain_map.estimate import Plane
from stridetwin.estimators.terrain_map.views import brink
from stridetwin.streams.samples import Array

_LANES = 28
_INSIDE_M = 0.06
_BEYOND_M = 0.14
_GAP_M = 0.12
_FEWEST = 6
_OUTLIER_M = 0.02


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

    @property
    def middle(self) -> Array:
        """(2,) m."""
        return np.asarray(self.points.mean(axis=0))

    @property
    def length(self) -> float:
        """Of the edge, m."""
        return float(np.ptp(self.points @ np.array([-self.down[1], self.down[0]])))


def riser(lower: Plane, upper: Plane, ends: Array, toward: Array) -> Riser | None:
    """The step between two planes as their columns show it.

    Args:
        lower: Plane.
        upper: Plane.
        ends: (N, 2) m, world, the upper plane's last columns before the lower one.
        toward: (N, 2) unit vectors in which the lower one was met.

    Returns:
        The riser, None where the columns make no edge.
    """
    if len(ends) < _FEWEST:
        return None
    down = toward.mean(axis=0)
    if np.linalg.norm(down) < 0.4:  # the lower plane lies all around: no edge to step over
        return None
    down = _across(ends, down)
    s = ends @ down
    near = np.abs(s - np.median(s)) < 0.06
    if near.sum() < _FEWEST:
        return None
    down = _across(ends[near], down)
    points = ends[near]
    middle = points.mean(axis=0)
    return Riser(
        lower=lower.id, upper=upper.id, down=down, points=points, found=False,
        height=float(upper.height(upper.toward(middle)) - lower.height(lower.toward(middle))),
    )  # fmt: skip


def _across(points: Array, toward: Array) -> Array:
    """(2,) unit vector across the line through points, on the side of `toward`."""
    offset = points - points.mean(axis=0)
    _, vectors = np.linalg.eigh(offset.T @ offset)
    across = vectors[:, 0]
    along = vectors[:, 1]
    if abs(across @ toward) < abs(along @ toward) * 0.5:  # too short an edge to have a direction
        across = toward / np.linalg.norm(toward)
    return np.asarray(across if across @ toward > 0 else -across)


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
    left = np.array([-down[1], down[0]])
    s0, across = float(np.median(edge.points @ down)), edge.points @ left
    low, high = np.percentile(across, [3, 97])
    lanes = np.linspace(low, high, _LANES)
    starts = (s0 - _INSIDE_M) * down + lanes[:, None] * left
    slope = float(upper.gradient @ down)
    z = upper.height(starts) - voxel_m
    at = np.column_stack([starts, z]) @ R_grid_world.T / voxel_m
    direction = R_grid_world[:2, :2] @ down
    reach = brink(blocks, at, direction, slope, (_INSIDE_M + _BEYOND_M) / voxel_m, _GAP_M / voxel_m) * voxel_m
    seen = np.isfinite(reach)
    if seen.sum() < _FEWEST:
        return edge
    seen &= np.abs(reach - np.median(reach[seen])) < _OUTLIER_M
    if seen.sum() < _FEWEST:
        return edge
    points = starts[seen] + reach[seen, None] * down
    return Riser(lower=edge.lower, upper=edge.upper, down=_across(points, down), points=points, found=True,
                 height=edge.height)  # fmt: skip


def pairs_of(found: NDArray[np.int32], ids: NDArray[np.int64]) -> dict[tuple[int, int], NDArray[np.int32]]:
    """Columns (N, 2) of the borders by the ids of lower and upper plane, from what `surface.borders` finds."""
    if not len(found):
        return {}
    key = found[:, 0].astype(np.int64) * len(ids) + found[:, 1]
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    groups = np.split(found[order], starts[1:])
    return {(int(ids[g[0, 0]]), int(ids[g[0, 1]])): g for g in groups}


def heading_of(edges: list[Riser]) -> Array:
    """(2,) unit vector down the flight that suits all edges best, the longer the more."""
    total = np.zeros(2)
    reference = max(edges, key=lambda e: len(e.points)).down
    for edge in edges:
        total += edge.length**3 * (edge.down if edge.down @ reference > 0 else -edge.down)
    return np.asarray(total / np.linalg.norm(total))


def angle_between(a: Array, b: Array) -> float:
    """Angle between two unit vectors, rad."""
    return math.acos(max(-1.0, min(1.0, float(a @ b))))
