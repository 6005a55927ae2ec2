"""The ground of a terrain map as a grid of heights and classes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.locomotion_mode import MODES, UNKNOWN
from stridetwin.estimators.terrain_map import Ramp, Stairs, TerrainEstimate, TerrainMap
from stridetwin.estimators.terrain_map.filter import GRID_ROTATION_RAD
from stridetwin.streams.samples import Array

GROUND_CLASSES = (*MODES, "none")
"""Class of the ground for a walker in a given direction: the mode of steps on it; `none` without a class."""
CLASS_COLORS = ((70, 170, 90), (50, 110, 220), (130, 80, 205), (230, 140, 30), (185, 70, 45), (150, 150, 150))
"""RGB of each of `GROUND_CLASSES`."""
CLASS_NAMES = {
    "LG": "level",
    "SA": "stairs up",
    "SD": "stairs down",
    "RA": "ramp up",
    "RD": "ramp down",
    UNKNOWN: "unknown",
}
"""Names of the classes, which are also those of the modes of steps on them, and of an unknown mode."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GroundGrid:
    """Heights and planes of the columns of the map, in the map's own grid, which is rotated against its world.

    Attributes:
        first: (2,) int64, numbers of the grid's column that cell (0, 0) of the arrays holds.
        height: (I, J) m, NaN where unknown.
        plane: (I, J) int64, id of the plane, -1 without a plane.
        rotation: (2, 2), grid to world.
        cell_m: Edge of a column.
    """

    first: NDArray[np.int64]
    height: Array
    plane: NDArray[np.int64]
    rotation: Array
    cell_m: float

    @classmethod
    def of(cls, terrain_map: TerrainMap) -> GroundGrid:
        """The current ground of a map: in each column the height and the plane of its surface point."""
        cell_m = terrain_map.parameters.voxel_size_m
        c, s = math.cos(GRID_ROTATION_RAD), math.sin(GRID_ROTATION_RAD)
        rotation = np.array([[c, -s], [s, c]])
        points, plane = terrain_map.surface_points()
        # (N, 2) numbers of the columns; `points @ rotation` are the coordinates in the rotated grid
        columns = np.floor(points[:, :2] @ rotation / cell_m).astype(np.int64)
        first = columns.min(axis=0) if len(columns) else np.zeros(2, np.int64)
        shape = columns.max(axis=0) - first + 1 if len(columns) else np.zeros(2, np.int64)
        height, ids = np.full(shape, np.nan), np.full(shape, -1, np.int64)
        i, j = (columns - first).T
        height[i, j], ids[i, j] = points[:, 2], plane
        return cls(first=first, height=height, plane=ids, rotation=rotation, cell_m=cell_m)

    def at(self, xy: Array) -> tuple[Array, NDArray[np.int64]]:
        """Heights (...) m and plane ids (...) at places (..., 2) in the map's world; NaN and -1 where unknown."""
        cell = np.floor(xy @ self.rotation / self.cell_m).astype(np.int64) - self.first
        inside = np.asarray(((cell >= 0) & (cell < self.height.shape)).all(axis=-1), bool)
        if not self.height.size:
            return np.full(inside.shape, np.nan), np.full(inside.shape, -1, np.int64)
        # places outside read the first cell, and are replaced below
        i, j = np.moveaxis(np.where(inside[..., None], cell, 0), -1, 0)
        return np.where(inside, self.height[i, j], np.nan), np.where(inside, self.plane[i, j], -1)

    def points(self) -> tuple[Array, NDArray[np.int64]]:
        """The centres of all cells of known height.

        Returns:
            (N, 3) m in the map's world, and (N,) id of the plane of each, -1 without a plane.
        """
        i, j = np.nonzero(np.isfinite(self.height))
        # 0.5 leads from the corner of a cell to its middle
        xy = (np.column_stack([i, j]) + self.first + 0.5) * self.cell_m @ self.rotation.T
        return np.column_stack([xy, self.height[i, j]]), self.plane[i, j]


def ground_class_of(estimate: TerrainEstimate, plane: int, heading: float) -> str:
    """The class of a plane for a walker, one of `GROUND_CLASSES`.

    Args:
        estimate: Planes and terrains of the map.
        plane: Id of the plane.
        heading: Direction of the walker, rad from x in the map's world; it decides between up and down.
    """
    terrain = estimate.terrain_of(plane)
    if terrain is None:
        return "none"
    if not isinstance(terrain, Ramp | Stairs):
        return "LG"
    # `terrain.heading` is the direction in which it rises
    up = math.cos(terrain.heading - heading) >= 0.0
    if isinstance(terrain, Stairs):
        return "SA" if up else "SD"
    return "RA" if up else "RD"


def ground_classes_at(estimate: TerrainEstimate, plane: NDArray[np.int64], heading: float) -> NDArray[np.uint8]:
    """The class of the ground of many planes, for a walker in a given direction.

    Args:
        estimate: Planes and terrains of the map.
        plane: (...) ids of planes; -1 is no plane.
        heading: Direction of the walker, rad from x in the map's world.

    Returns:
        (...) indices in `GROUND_CLASSES`.
    """
    ids, id_index = np.unique(plane, return_inverse=True)  # each plane is classified once
    names = [ground_class_of(estimate, int(i), heading) if i >= 0 else "none" for i in ids]
    classes = np.array([GROUND_CLASSES.index(name) for name in names], np.uint8)
    return classes[id_index].reshape(np.shape(plane))
