"""The vertical of a world whose z axis may point anywhere, from the surfaces in depth images.

Floors, table tops and ceilings have vertical normals, walls horizontal ones, and a camera is held more or less upright.
So the vertical is the direction near the camera's upward axis along which most normals lie, with those across it.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.samples import Array

_CELLS = 80
"""Normals along the longer side of an image."""
_REACH = 3
"""Cells between the points of a normal: neighbours are too close for the noise of depth."""
_NEAR = np.cos(np.radians(5.0))
"""Normals within 5° are of one surface; walls within 5° of the horizontal."""
_MIN_UP_COSINE = np.cos(np.radians(80.0))
"""A camera that looks down or up keeps its upper side above the horizon; a wall in front of it lies beyond."""
_WALL_WEIGHT = 0.5  # of a normal across a candidate for the vertical, over that of one along it
_JUMP_SHARE = 0.1  # neighbouring depths that differ by more are of different surfaces
_CANDIDATES, _ROUNDS = 400, 5  # numbers of normals tried as the vertical, and of means of those near the best one
_SUPPORT_MIN = 0.1  # smallest share of all normals along the vertical


def normals(depth: NDArray[np.float32], intrinsics: Array) -> Array:
    """(N, 3) unit normals towards the camera, in its optical frame, of a coarse grid of an image.

    Args:
        depth: (H, W) m; 0 is invalid.
        intrinsics: (4,) fu, fv, pu, pv.
    """
    step = max(1, max(depth.shape) // _CELLS)  # pixels between the points of the grid
    z = depth[::step, ::step].astype(float)
    v, u = np.mgrid[: z.shape[0], : z.shape[1]] * step
    fu, fv, pu, pv = intrinsics
    points = np.stack([(u - pu) / fu * z, (v - pv) / fv * z, z], axis=-1)
    r = _REACH
    # the three points of each normal; a large difference of their depths means two surfaces
    here, right, below = points[:-r, :-r], points[:-r, r:], points[r:, :-r]
    nearest = np.minimum(np.minimum(here[..., 2], right[..., 2]), below[..., 2])
    farthest = np.maximum(np.maximum(here[..., 2], right[..., 2]), below[..., 2])
    is_surface = (nearest > 0.0) & (farthest - nearest < _JUMP_SHARE * nearest)
    normal = np.cross((below - here)[is_surface], (right - here)[is_surface])
    length = np.linalg.norm(normal, axis=1)
    valid = length > 0.0
    normal, surface_points = normal[valid] / length[valid, None], here[is_surface][valid]
    away = np.sign(np.sum(normal * surface_points, axis=1))  # 1 where a normal points away from the camera, else -1
    return np.asarray(normal * -away[:, None])


def upward(views: Iterable[tuple[Array, Array]]) -> Array | None:
    """(3,) unit vector upwards in the world, estimated from surface normals of several images.

    None if too few normals are along any direction near the camera's upper side.

    Args:
        views: Per image, (N, 3) normals in the camera's optical frame, and (3, 3) rotation of that frame to the world.
    """
    # per image: normals in the world, and the camera's upper side (y points down in the optical frame)
    parts = [(camera_normals @ R.T, -R[:, 1]) for camera_normals, R in views]
    if not parts:
        return None
    all_normals = np.concatenate([world_normals for world_normals, _ in parts])
    camera_up = np.mean([up_axis for _, up_axis in parts], axis=0)
    camera_up /= np.linalg.norm(camera_up)
    near = all_normals[all_normals @ camera_up > _MIN_UP_COSINE]
    if not len(near):
        return None
    candidates = near[np.linspace(0, len(near) - 1, min(_CANDIDATES, len(near))).astype(int)]
    # per candidate: share of the normals along it, and of those across it
    along = candidates @ all_normals.T  # cosines, candidates by normals
    support = (along > _NEAR).mean(axis=1)
    walls = (np.abs(along) < np.sqrt(1.0 - _NEAR**2)).mean(axis=1)
    up = candidates[np.argmax(support + _WALL_WEIGHT * walls)]
    for _ in range(_ROUNDS):  # refined: mean of the normals near it
        up = all_normals[all_normals @ up > _NEAR].mean(axis=0)
        up /= np.linalg.norm(up)
    return up if float((all_normals @ up > _NEAR).mean()) > _SUPPORT_MIN else None
