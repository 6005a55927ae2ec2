"""The mapped ground around the walker at one instant, for viewers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.terrain_map import Plane, TerrainEstimate
from stridetwin.outputs.alignment import YawAlignment
from stridetwin.outputs.terrain.grid import GroundGrid, ground_classes_at
from stridetwin.outputs.terrain.mapped_route import edge_lines
from stridetwin.streams.samples import Array

_MAX_DISTANCE_M, _SHOWN_M = 3.0, 0.1  # range of the ground that is kept, and the side of a cell with one point
_MIN_PLANE_M2 = 0.05  # smaller planes are left out


@dataclass(frozen=True, kw_only=True, eq=False)
class Snapshot:
    """The ground around the walker at one instant, in the true world.

    Attributes:
        t_ns: Its time.
        points: (N, 3) m.
        classes: (N,) numbers of `GROUND_CLASSES`.
        planes: Outline of each plane, (5, 3) m, and its number of `GROUND_CLASSES`.
        edges: Ends of each edge of a flight, (2, 3) m.
    """

    t_ns: int
    points: NDArray[np.float32]
    classes: NDArray[np.uint8]
    planes: list[tuple[Array, int]]
    edges: list[Array]


def take_snapshot(grid: GroundGrid, estimate: TerrainEstimate, alignment: YawAlignment, heading: float) -> Snapshot:
    """The ground of a map within 3 m of the camera, in the true world.

    Args:
        grid: Ground of the map.
        estimate: Planes and terrains of the map.
        alignment: From the map's world to the true one, now.
        heading: Direction of the walker, rad from x in the map's world, for the classes.
    """
    points, plane = grid.points()
    eye = estimate.p_camera_in_world
    # numbers of the points near the camera, and the cell of `_SHOWN_M` in which each lies
    nearby = np.flatnonzero(np.linalg.norm(points[:, :2] - eye[:2], axis=1) < _MAX_DISTANCE_M)
    i, j = np.floor((points[nearby, :2] - eye[:2]) / _SHOWN_M).astype(np.int64).T
    # one point per cell; i and j are far smaller than 4096, so that each pair has a number of its own
    nearby = nearby[np.unique(i * 4096 + j, return_index=True)[1]]
    near = [  # large enough planes near the camera
        p
        for p in estimate.planes.values()
        if p.area_m2 > _MIN_PLANE_M2 and np.linalg.norm(p.centre[:2] - eye[:2]) < _MAX_DISTANCE_M
    ]
    plane_classes = ground_classes_at(estimate, np.array([p.id for p in near], np.int64), heading)
    return Snapshot(
        t_ns=estimate.t_ns,
        points=alignment.to_true(points[nearby]).astype(np.float32),
        classes=ground_classes_at(estimate, plane[nearby], heading),
        planes=[(alignment.to_true(_outline(p)), int(c)) for p, c in zip(near, plane_classes)],
        edges=[alignment.to_true(line) for flight in estimate.stairs for line in edge_lines(flight)],
    )


def _outline(plane: Plane) -> Array:
    """The rectangle in a plane that the plane's points would fill if they were evenly distributed.

    Returns:
        (5, 3) m, its corners in the map's world, the first one again at the end.
    """
    variances, axes = np.linalg.eigh(plane.spread)
    # half sides: a uniform density of half width h has the variance h² / 3
    half = np.sqrt(3.0 * np.maximum(variances, 0.0))
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * half
    xy = plane.centre[:2] + corners @ axes.T
    return np.column_stack([xy, plane.height(xy)])
