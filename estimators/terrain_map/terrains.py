"""Terrains from planes: ramps and levels by slope and area, stairs from planes a step apart."""

from __future__ import annotations

import math

import numpy as np

from stridetwin.estimators.terrain_map.blocks import Blocks
from stridetwin.estimators.terrain_map.estimate import Level, Plane, Ramp, Terrain
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.plane_set import SLOTS, PlaneSet
from stridetwin.estimators.terrain_map.risers import Riser, heading_of, pairs_of, refined, riser
from stridetwin.estimators.terrain_map.stairs import flights, stairs
from stridetwin.estimators.terrain_map.surface import borders
from stridetwin.streams.samples import Array

_SIDES = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
_HIDDEN_M = 0.30
"""Ground that a riser may hide from the camera."""
_SIGNIFICANT = 2.0


def is_flat(plane: Plane, p: TerrainMapParameters) -> bool:
    """Whether a plane is flat, or may well be."""
    return plane.slope < p.flat_rad + min(_SIGNIFICANT * plane.slope_sd, 2.0 * p.flat_rad)


def find_risers(
    planes: dict[int, Plane], plane_set: PlaneSet, R_world_grid: Array, p: TerrainMapParameters
) -> list[Riser]:
    """Steps between flat planes as their columns show them."""
    surface = plane_set.surface
    found = borders(
        surface.label, surface.height, surface.origin, SLOTS, round(_HIDDEN_M / p.voxel_m), p.riser_min_m,
        p.riser_max_m,
    )  # fmt: skip
    turn = R_world_grid[:2, :2]
    risers = []
    for (low, high), columns in pairs_of(found, plane_set.ids).items():
        lower, upper = planes[low], planes[high]
        if not (is_flat(lower, p) and is_flat(upper, p)):
            continue
        sides = _SIDES[columns[:, 4]]
        ends = (columns[:, 2:4] + 0.5 + 0.5 * sides) * p.voxel_m @ turn.T
        edge = riser(lower, upper, ends, sides @ turn.T)
        if edge is not None and p.riser_min_m <= edge.height <= p.riser_max_m and edge.length >= p.edge_min_m:
            risers.append(edge)
    return risers


def terrains(
    planes: dict[int, Plane], plane_set: PlaneSet, blocks: Blocks, R_world_grid: Array, p: TerrainMapParameters
) -> tuple[Terrain, ...]:
    """Levels, ramps and stairs.

    Args:
        planes: By id, world axes.
        plane_set: Their columns.
        blocks: The voxels.
        R_world_grid: (3, 3) grid to world axes.
        p: Thresholds.
    """
    found: list[Terrain] = []
    treads: set[int] = set()
    for row in flights(find_risers(planes, plane_set, R_world_grid, p), p):
        down = heading_of(row)
        row = [refined(r, planes[r.upper], down, blocks, R_world_grid.T, p.voxel_m) for r in row]
        flight = stairs(row, planes, min(r.upper for r in row), p)
        found.append(flight)
        treads.update(flight.planes[1:-1])
    for plane in planes.values():
        if plane.id in treads:
            continue
        if is_flat(plane, p):
            found.append(Level(id=plane.id, plane=plane.id))
        elif plane.slope <= p.ramp_rad and plane.area_m2 >= p.ramp_area_m2:
            heading = math.atan2(*plane.gradient[::-1])
            found.append(Ramp(id=plane.id, plane=plane.id, slope=plane.slope, slope_sd=plane.slope_sd, heading=heading))
    return tuple(found)
