"""The vertical of a world whose z axis may point anywhere, from the surfaces in depth images.

Floors, table tops and ceilings have vertical normals, walls horizontal ones, and a camera is held more or less upright.
So the vertical is the direction near the camera's upward axis along which most normals lie, with those across it.
Planes through level surfaces and walls then give it more exactly, with its uncertainty.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import NamedTuple

import cv2
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
_KNOWN_SHARE, _SPREAD_SHARE = 0.5, 0.05  # of a square's pixels with depth; standard deviation of them over the mean
_CANDIDATES, _ROUNDS = 400, 5  # numbers of normals tried as the vertical, and of means of those near the best one
_SUPPORT_MIN = 0.1  # smallest share of all normals along the vertical


def normals(depth: NDArray[np.float32], intrinsics: Array) -> Array:
    """(N, 3) unit normals towards the camera, in its optical frame, of a coarse grid of an image.

    Args:
        depth: (H, W) m; 0 is invalid.
        intrinsics: (4,) fu, fv, pu, pv.
    """
    step = max(1, max(depth.shape) // _CELLS)  # pixels between the points of the grid
    _, normal, is_surface = _cells(depth, intrinsics, step)
    return np.asarray(normal[is_surface])


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


_FINE_CELLS = 160
"""Cells along the longer side of an image in which surfaces are found."""
_LEVEL_COSINE, _WALL_SINE = np.cos(np.radians(12.0)), np.sin(np.radians(12.0))
"""Normals within 12° of the coarse vertical may be of a level surface, and those within 12° of the horizontal of a
wall."""
_WALL_BINS = 24
"""Directions, in the plane across the vertical, into which the normals of walls are sorted."""
_MIN_SURFACE_CELLS = 60
"""Fewest cells of a surface: a tread seen from 2 m has about 200."""
_ROUGH_M, _ROUGH_PER_M = 0.006, 0.004
"""Largest RMS distance of a surface's points from its plane: a constant, and a part that grows with depth squared."""
_CELLS_PER_ERROR = 16.0
"""Neighbouring cells that share one error of the depth."""
_SURFACE_SD_RAD = np.radians(0.5)
"""Floors, treads and walls are level and upright so exactly."""
_AGREE_RAD, _AGREE_SD = np.radians(1.5), 3.0
"""Surfaces agree on the vertical within this angle and so many standard deviations."""
_APART_M = 0.05
"""Level surfaces whose heights differ by so much are two witnesses: a ramp is one."""
_GIVEN_SHARE, _UPRIGHT = 0.4, np.cos(_AGREE_RAD)
"""Where the z axis has this share of the support of a vertical that is farther than that from it, level ground may as
well agree with the z axis."""
_UPDATES = 8
"""Rounds of choosing the surfaces that agree, from each of them."""


class Surface(NamedTuple):
    """A level surface or a wall in one image.

    Attributes:
        normal: (3,) unit vector, upwards for a level surface.
        sd_rad: Standard deviation of its tilt.
        is_wall: Whether it is a wall.
        centre: (3,) m, world, of its points.
        image: Number of the image that shows it.
    """

    normal: Array
    sd_rad: float
    is_wall: bool
    centre: Array
    image: int


class Vertical(NamedTuple):
    """The vertical of a world with its uncertainty.

    Attributes:
        up: (3,) unit vector.
        sd_rad: Standard deviation of its tilt.
        is_confirmed: Whether surfaces at two heights, or level ones and walls, agree on it: a ramp alone does not. And
            hardly any agree with the z axis instead.
    """

    up: Array
    sd_rad: float
    is_confirmed: bool


def find_surfaces(
    depth: NDArray[np.float32], intrinsics: Array, T_world_camera: Array, up: Array, image: int = 0
) -> list[Surface]:
    """Level surfaces and walls of one image: connected cells with such normals that lie on a plane.

    Args:
        depth: (H, W) m; 0 is invalid.
        intrinsics: (4,) fu, fv, pu, pv.
        T_world_camera: (4, 4) pose of the optical frame, m.
        up: (3,) coarse vertical in the world.
        image: Number of the image.
    """
    step = max(1, max(depth.shape) // _FINE_CELLS)
    points, normal, is_surface = _cells(depth, intrinsics, step)
    points = points @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
    normal = normal @ T_world_camera[:3, :3].T
    along = normal @ up
    across = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    azimuth = np.arctan2(normal @ np.cross(up, across), normal @ across)
    bins = np.floor(azimuth / (2.0 * np.pi) * _WALL_BINS).astype(int) % _WALL_BINS
    masks = [(is_surface & (along > _LEVEL_COSINE), False)]
    upright = is_surface & (np.abs(along) < _WALL_SINE)
    masks += [(upright & (bins == k), True) for k in range(_WALL_BINS)]
    surfaces = []
    for mask, is_wall in masks:
        if np.count_nonzero(mask) < _MIN_SURFACE_CELLS:
            continue
        count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
        for label in range(1, count):
            inside = labels == label
            if np.count_nonzero(inside) >= _MIN_SURFACE_CELLS:
                surface = _fit_surface(points[inside], T_world_camera[:3, 3], up, is_wall, image)
                if surface is not None:
                    surfaces.append(surface)
    return surfaces


def _cells(depth: NDArray[np.float32], intrinsics: Array, step: int) -> tuple[Array, Array, NDArray[np.bool_]]:
    """(n, m, 3) points, m, (n, m, 3) unit normals towards the camera, and (n, m) whether both are known, of an image.

    Args:
        depth: (H, W) m; 0 is invalid.
        intrinsics: (4,) fu, fv, pu, pv.
        step: Pixels between two cells.
    """
    z = _mean_depths(depth, step)
    v, u = np.mgrid[: z.shape[0], : z.shape[1]] * step + 0.5 * (step - 1)
    fu, fv, pu, pv = intrinsics
    points = np.stack([(u - pu) / fu * z, (v - pv) / fv * z, z], axis=-1)
    r = _REACH
    # the three points of each normal; a large difference of their depths means two surfaces
    here, right, below = points[:-r, :-r], points[:-r, r:], points[r:, :-r]
    nearest = np.minimum(np.minimum(here[..., 2], right[..., 2]), below[..., 2])
    farthest = np.maximum(np.maximum(here[..., 2], right[..., 2]), below[..., 2])
    normal = np.cross(below - here, right - here)
    length = np.linalg.norm(normal, axis=-1)
    is_surface = (nearest > 0.0) & (farthest - nearest < _JUMP_SHARE * nearest) & (length > 0.0)
    normal = normal / np.maximum(length, 1e-12)[..., None]
    normal = -np.sign(np.sum(normal * here, axis=-1))[..., None] * normal
    return here, normal, is_surface


def _mean_depths(depth: NDArray[np.float32], step: int) -> Array:
    """(n, m) m, mean depth of each square of `step` by `step` pixels of an image; 0 where few pixels are known.

    The mean of many pixels is less noisy than one. Squares that contain two surfaces are left out.
    """
    rows, columns = depth.shape[0] // step, depth.shape[1] // step
    squares = depth[: rows * step, : columns * step].astype(float).reshape(rows, step, columns, step)
    known = squares > 0.0
    count = known.sum(axis=(1, 3))
    total = np.maximum(count, 1)
    mean = squares.sum(axis=(1, 3)) / total
    variance = np.maximum((squares**2).sum(axis=(1, 3)) / total - mean**2, 0.0)
    is_one_surface = (count >= _KNOWN_SHARE * step**2) & (variance < (_SPREAD_SHARE * mean) ** 2)
    return np.where(is_one_surface, mean, 0.0)


def _fit_surface(points: Array, p_camera: Array, up: Array, is_wall: bool, image: int) -> Surface | None:
    """The plane through the points of a surface; None if they are not on one plane.

    Args:
        points: (N, 3) m, world.
        p_camera: (3,) m, world.
        up: (3,) coarse vertical, to which the normal of a level surface points.
        is_wall: Whether it is a wall.
        image: Number of the image.
    """
    for _ in range(2):  # the second time without the points that lie off the first plane
        centre = points.mean(axis=0)
        _, scale, axes = np.linalg.svd(points - centre, full_matrices=False)
        off = (points - centre) @ axes[2]
        rms = float(np.sqrt(np.mean(off**2)))
        points = points[np.abs(off) <= 2.5 * max(rms, 1e-4)]
        if len(points) < _MIN_SURFACE_CELLS:
            return None
    away = float(np.linalg.norm(centre - p_camera))
    if rms > _ROUGH_M + _ROUGH_PER_M * away**2:
        return None
    normal = axes[2] if is_wall or axes[2] @ up > 0.0 else -axes[2]
    # error of the tilt about the longer side, from the extent along the shorter one
    extent = float(scale[1]) / np.sqrt(len(off))
    sd = rms / np.sqrt(max(len(off) / _CELLS_PER_ERROR, 1.0)) / max(extent, 1e-3)
    return Surface(np.asarray(normal), float(np.hypot(sd, _SURFACE_SD_RAD)), is_wall, centre, image)


def refine_vertical(surfaces: Sequence[Surface], up: Array) -> Vertical | None:
    """The vertical on which most surfaces agree: along the normals of level ones, and across those of walls.

    It minimises Σ |n × up|² / σ² over level surfaces plus Σ (n · up)² / σ² over walls: docs/terrain_map.md (14).
    Ramps and sloping lids, which do not agree with the others, take no part.

    Args:
        surfaces: Surfaces of one image or of several.
        up: (3,) coarse vertical.

    Returns:
        None without a level surface.
    """
    if all(surface.is_wall for surface in surfaces):
        return None
    normals_of = np.array([surface.normal for surface in surfaces])
    sd = np.array([surface.sd_rad for surface in surfaces])
    is_wall = np.array([surface.is_wall for surface in surfaces])
    weight, gate = sd**-2, np.hypot(_AGREE_RAD, _AGREE_SD * sd)
    best, most = None, -1.0
    for start in [up, *normals_of[~is_wall]]:
        candidate, agree = start, np.zeros(len(surfaces), bool)
        for _ in range(_UPDATES):
            along = np.clip(normals_of @ candidate, -1.0, 1.0)
            off = np.where(is_wall, np.abs(np.arcsin(along)), np.arccos(along))
            agree = off < gate
            if not (agree & ~is_wall).any():
                break
            signed = np.where(is_wall, 1.0, -1.0) * weight * agree
            _, axes = np.linalg.eigh((normals_of * signed[:, None]).T @ normals_of)
            candidate = axes[:, 0] if axes[:, 0] @ up > 0.0 else -axes[:, 0]
        support = float(weight[agree].sum())
        if support > most and (agree & ~is_wall).any():
            best, most, agreeing = candidate, support, agree
    if best is None:
        return None
    level = agreeing & ~is_wall
    has_walls = bool((agreeing & is_wall).any())
    # level surfaces that are nearer to the z axis as it is than to the best vertical
    is_nearer_given = ~is_wall & (normals_of[:, 2] > normals_of @ best)
    is_given = float(weight[is_nearer_given].sum()) > _GIVEN_SHARE * float(weight[level].sum()) and best[2] < _UPRIGHT
    agreeing_levels = [surface for surface, agrees in zip(surfaces, level) if agrees]
    is_confirmed = not is_given and (has_walls or _are_at_two_heights(agreeing_levels, best))
    return Vertical(np.asarray(best), float(1.0 / np.sqrt(weight[level].sum())), is_confirmed)


def _are_at_two_heights(levels: Sequence[Surface], up: Array) -> bool:
    """Whether one image shows two level surfaces at different heights along `up`, (3,).

    Those of several images may be one ramp. The tilt of each is uncertain, so far ones must differ by more.
    """
    for one, other in combinations(levels, 2):
        apart = one.centre - other.centre
        tilt_rad = float(np.hypot(one.sd_rad, other.sd_rad))
        if one.image == other.image and abs(apart @ up) > _APART_M + tilt_rad * float(np.linalg.norm(apart)):
            return True
    return False
