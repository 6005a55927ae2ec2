"""Classifies planes into terrains: ramps and level ground by slope and area, stairs by steps between planes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.terrain_map.estimate import Level, Plane, Ramp, Stairs, Terrain
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.plane_set import PlaneSet, find_borders
from stridetwin.estimators.terrain_map.risers import Riser, fit_riser, group_by_planes
from stridetwin.estimators.terrain_map.stairs import find_flights, fit_stairs, heading_of
from stridetwin.estimators.terrain_map.walkable import WalkedPlanes, select_walkable
from stridetwin.streams.samples import Array

KERB_M = 0.04
"""Height of a kerb: a plane with less rise from side to side is not a ramp, and a lower step is not an edge."""
_BENT_RAD = math.radians(10.0)
"""Largest apparent slope of a flat plane that pose errors have bent."""
STRIP_M, _STRIP_RAD = 0.15, math.radians(20.0)
"""A plane that is shorter in the direction of its slope is less than a tread, and may be level up to this slope."""
_SIGNIFICANT_SD = 2.0
"""A slope within this many standard deviations of flat may be flat."""
_MIN_RAMP_AREA_M2 = 0.15
"""Smallest area of a ramp; tuned. Doubled: a ramp of 9° is recognised 0.1 m later."""
_HIDDEN_M = 0.30
"""Length of ground that a riser may occlude: the longest shadow of a riser of 0.2 m."""
_MIN_EDGE_M = 0.3
"""Shortest edge of stairs."""


RefineRiser = Callable[[Riser, Plane, Array], Riser]
"""A riser with its edge measured: from the riser, its upper plane, and (2,) down across all edges of its flight."""


class _CachedRiser(NamedTuple):
    """A riser between two planes with what it was computed from.

    Attributes:
        lower: Lower plane.
        upper: Upper plane.
        columns: (N, 5) border columns of the two, from `plane_set.find_borders`.
        riser: The riser; None where there is no edge of stairs.
    """

    lower: Plane
    upper: Plane
    columns: NDArray[np.int32]
    riser: Riser | None


def is_flat(plane: Plane, p: TerrainMapParameters) -> bool:
    """Whether a plane may be a tread: flat within its uncertainty."""
    return _may_slope_less(plane, p.max_tread_slope_rad)


def is_level(plane: Plane, p: TerrainMapParameters) -> bool:
    """Whether a plane is level within its uncertainty."""
    return _may_slope_less(plane, p.max_level_slope_rad)


def _may_slope_less(plane: Plane, slope_rad: float) -> bool:
    """Whether a plane may slope by less than `slope_rad`, within its uncertainty or as a flat one bent by pose errors.

    A tread's two sides are observed at different times. A pose correction in between gives it an apparent slope, which
    does not make it a ramp. Nor does the slope of a strip that is shorter than any tread: of treads seen along the
    slope of a flight, only the outer ends are mapped, and the rounding of the edge by the voxels is most of them.
    """
    if plane.slope < slope_rad + min(_SIGNIFICANT_SD * plane.slope_sd, _BENT_RAD):
        return True
    if plane.rise >= KERB_M:
        return False
    is_strip = plane.rise < STRIP_M * math.tan(plane.slope)
    return plane.slope < (_STRIP_RAD if is_strip else _BENT_RAD)


class Terrains:
    """Finds terrains, and caches those whose planes and edges have not changed since the last image.

    Ground behind the walker is therefore not processed again, however long the walk is.

    Args:
        R_world_grid: (3, 3) grid to world axes.
        parameters: Thresholds.
    """

    def __init__(self, R_world_grid: Array, parameters: TerrainMapParameters) -> None:
        """Begins without terrains; `R_world_grid` (3, 3) rotates grid to world axes."""
        self._R_world_grid, self._p = R_world_grid, parameters
        self._walked = WalkedPlanes(R_world_grid, parameters)
        # what the last call found: risers by the ids of lower and upper plane, flights by their risers
        self._risers: dict[tuple[int, int], _CachedRiser] = {}
        self._stairs: dict[tuple[Riser, ...], Stairs] = {}

    def find(
        self, planes: dict[int, Plane], plane_set: PlaneSet, refine: RefineRiser, p_camera_in_world: Array
    ) -> tuple[tuple[Terrain, ...], tuple[Stairs, ...]]:
        """Finds levels, ramps and stairs among the planes.

        Args:
            planes: Planes by id, world axes; unchanged planes are the same objects as in the last call.
            plane_set: Columns of the planes.
            refine: Measures the edge of a riser.
            p_camera_in_world: (3,) m, under which the walker is.

        Returns:
            The flights, then levels and ramps; and rises that nobody can walk, such as those of furniture. A tread
            within a flight is no level, and a plane that is too steep or too small for a ramp is nothing.
        """
        p = self._p
        walked = self._walked.update(planes, plane_set, p_camera_in_world)
        # rows of risers, one per flight; a row of unchanged risers keeps its flight
        rows = [tuple(row) for row in find_flights(self._find_risers(planes, plane_set), p)]
        self._stairs = {row: self._stairs.get(row) or self._fit_flight(row, planes, refine) for row in rows}
        walkable = select_walkable(rows, planes, walked, p)
        if not self._walked.has_moved:
            # a leg or the border of the image may hide much of the first flight that is seen
            walkable = [row for row in rows if len(row) > 1 or row in walkable]
        terrains: list[Terrain] = [self._stairs[row] for row in walkable]
        treads = {riser.upper for row in walkable for riser in row[:-1]}  # without the landing
        for plane in planes.values():
            if plane.id in treads:
                continue
            if is_level(plane, p):
                terrains.append(Level(id=plane.id, plane=plane.id))
            elif plane.slope <= p.max_ramp_slope_rad and plane.area_m2 >= _MIN_RAMP_AREA_M2:
                gradient_x, gradient_y = plane.gradient
                heading = math.atan2(gradient_y, gradient_x)
                ramp = Ramp(id=plane.id, plane=plane.id, slope=plane.slope, slope_sd=plane.slope_sd, heading=heading)
                terrains.append(ramp)
        selected = {id(row) for row in walkable}
        return tuple(terrains), tuple(self._stairs[row] for row in rows if id(row) not in selected)

    def _fit_flight(self, row: Sequence[Riser], planes: dict[int, Plane], refine: RefineRiser) -> Stairs:
        """The flight of a row of risers, after their edges are measured in the volume by `refine`.

        Its id is the least id of an upper plane in the row.
        """
        down = heading_of(row)
        risers = [refine(r, planes[r.upper], down) for r in row]
        return fit_stairs(risers, planes, min(r.upper for r in row), self._p)

    def _find_risers(self, planes: dict[int, Plane], plane_set: PlaneSet) -> list[Riser]:
        """Risers between flat planes; those whose planes and columns have not changed come from the cache."""
        p = self._p
        border_columns = find_borders(
            plane_set.surface, round(_HIDDEN_M / p.voxel_size_m), p.min_riser_m, p.max_riser_m
        )
        known: dict[tuple[int, int], _CachedRiser] = {}
        # by ids of the lower and the upper plane: the rows of their border columns
        for pair, rows in group_by_planes(border_columns, plane_set.ids).items():
            lower, upper = planes[pair[0]], planes[pair[1]]
            if not (is_flat(lower, p) and is_flat(upper, p)):
                continue
            columns, cached = border_columns[rows], self._risers.get(pair)
            if (  # an unchanged plane is the same object as in the last call
                cached is not None
                and cached.lower is lower
                and cached.upper is upper
                and np.array_equal(cached.columns, columns)
            ):
                known[pair] = cached
            else:
                known[pair] = _CachedRiser(lower, upper, columns, self._fit_riser(lower, upper, columns))
        self._risers = known
        return [cached.riser for cached in known.values() if cached.riser is not None]

    def _fit_riser(self, lower: Plane, upper: Plane, columns: NDArray[np.int32]) -> Riser | None:
        """The riser between two planes; None if it is not as high and long as one of stairs.

        `columns` (N, 5) are the two planes' border columns from `find_borders`.
        """
        p = self._p
        edge = fit_riser(lower, upper, columns, self._R_world_grid[:2, :2], p.voxel_size_m)
        if edge is not None and p.min_riser_m <= edge.height <= p.max_riser_m and edge.length >= _MIN_EDGE_M:
            return edge
        return None
