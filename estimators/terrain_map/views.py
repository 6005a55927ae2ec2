"""Ray casting: the map as the camera would see it, and as seen from straight above."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.terrain_map.blocks import EDGE, SHAPE, Blocks, slot_of, voxel
from stridetwin.streams.samples import Array

_SEEN = 0.1
"""Weight from which on a voxel counts."""
_NEAR = 0.5
"""Beyond this λ does not say how far the surface is: between two such places it lies in the middle."""
_SHARE = 0.5
"""Of the weight beside it that a column needs."""


@njit(cache=True)
def from_above(
    blocks: Blocks, first_i: int, first_j: int, size: int, top_k: int, voxel_m: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What a camera over the ground sees that looks straight down, a ray to each column of voxels.

    Args:
        blocks: The map.
        first_i: Column of the corner; a multiple of 8.
        first_j: As `first_i`.
        size: Columns along an edge of the view; a multiple of 8.
        top_k: Rays start at this layer.
        voxel_m: Edge of a voxel.

    Returns:
        (size, size) height of the surface, m, NaN where none is seen, and the weight of the voxel above it.
    """
    height = np.full((size, size), np.nan, np.float32)
    trust = np.zeros((size, size), np.float32)
    above = np.zeros((EDGE, EDGE), np.float32)
    known = np.zeros((EDGE, EDGE), np.float32)
    low = blocks.origin[2] * EDGE
    start = min(top_k, low + SHAPE[2] * EDGE - 1)
    for bi in range(size // EDGE):
        for bj in range(size // EDGE):
            known[:] = 0.0
            left = EDGE * EDGE
            for bk in range(start >> 3, blocks.origin[2] - 1, -1):
                row = slot_of(blocks.slots, blocks.origin, (first_i >> 3) + bi, (first_j >> 3) + bj, bk)
                if row < 0:
                    known[:] = 0.0
                    continue
                for i in range(EDGE):
                    for j in range(EDGE):
                        if not math.isnan(height[bi * EDGE + i, bj * EDGE + j]):
                            continue
                        for k in range(min(EDGE - 1, start - bk * EDGE), -1, -1):
                            at = (i << 6) | (j << 3) | k
                            weight, value = blocks.weight[row, at], blocks.distance[row, at]
                            if weight < _SEEN:
                                known[i, j] = 0.0
                                continue
                            if value >= 0.0 and known[i, j] > 0.0 and above[i, j] < 0.0:
                                share = value / (value - above[i, j])
                                height[bi * EDGE + i, bj * EDGE + j] = (bk * EDGE + k + 0.5 + share) * voxel_m
                                trust[bi * EDGE + i, bj * EDGE + j] = min(weight, known[i, j])
                                left -= 1
                                break
                            known[i, j], above[i, j] = weight, value
                if left == 0:
                    break
    return height, trust


@njit(cache=True, error_model="numpy")
def from_camera(
    blocks: Blocks, intrinsics: Array, shape: tuple[int, int], T_grid_camera: Array, voxel_m: float, range_m: float
) -> NDArray[np.float32]:
    """The smoothed depth image I_D^s: the depth at which each pixel's ray meets the surface.

    Args:
        blocks: The map.
        intrinsics: (4,) fu, fv, pu, pv of the picture to make.
        shape: (H, W).
        T_grid_camera: (4, 4) optical frame to grid axes, m.
        voxel_m: Edge of a voxel.
        range_m: Rays end at this depth.

    Returns:
        (H, W) m, 0 = none.
    """
    picture = np.zeros(shape, np.float32)
    R, c = T_grid_camera[:3, :3], T_grid_camera[:3, 3] / voxel_m
    for v in range(shape[0]):
        for u in range(shape[1]):
            x, y = (u - intrinsics[2]) / intrinsics[0], (v - intrinsics[3]) / intrinsics[1]
            length = math.sqrt(x * x + y * y + 1.0)
            dx = (R[0, 0] * x + R[0, 1] * y + R[0, 2]) / length
            dy = (R[1, 0] * x + R[1, 1] * y + R[1, 2]) / length
            dz = (R[2, 0] * x + R[2, 1] * y + R[2, 2]) / length
            at, end = 4.0, range_m / voxel_m * length
            before, before_at, free = 0.0, 0.0, False
            while at < end:
                i, j, k = math.floor(c[0] + dx * at), math.floor(c[1] + dy * at), math.floor(c[2] + dz * at)
                row = slot_of(blocks.slots, blocks.origin, i >> 3, j >> 3, k >> 3)
                if row < 0:
                    free = False
                    at += 0.5 * EDGE
                    continue
                here = ((i & 7) << 6) | ((j & 7) << 3) | (k & 7)
                value = blocks.distance[row, here]
                if blocks.weight[row, here] < _SEEN:
                    free = False
                elif value < 0.0:
                    before, before_at, free = value, at, True
                elif free:
                    met = before_at + (at - before_at) * before / (before - value)
                    picture[v, u] = met * voxel_m / length
                    break
                at += 0.7
    return picture


@njit(cache=True, error_model="numpy")
def distance_at(blocks: Blocks, x: float, y: float, z: float) -> float:
    """Distance λ between voxel centres (trilinear), at a place in voxels, grid axes; NaN where a voxel was not seen."""
    x, y, z = x - 0.5, y - 0.5, z - 0.5
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    a, b, c = x - i, y - j, z - k
    total = 0.0
    for p in range(2):
        for q in range(2):
            for r in range(2):
                share = (a if p else 1 - a) * (b if q else 1 - b) * (c if r else 1 - c)
                if share < 1e-6:
                    continue
                value, weight = voxel(blocks, i + p, j + q, k + r)
                if weight < _SEEN:
                    return math.nan
                total += share * value
    return total


@njit(cache=True)
def brink(blocks: Blocks, starts: Array, direction: Array, slope: float, reach: float, gap: float) -> Array:
    """How far solid ground reaches along lines just under a surface.

    Args:
        blocks: The map.
        starts: (N, 3) in voxels, grid axes, just under the surface.
        direction: (2,) horizontal unit vector along which it ends.
        slope: Rise of the surface along it.
        reach: How far to look, voxels.
        gap: Longest stretch not seen between the last solid place and the first free one, voxels.

    Returns:
        (N,) voxels from each start to where λ changes its sign for the first time; NaN where that is not seen.
    """
    found = np.full(len(starts), np.nan)
    step = 1.0
    for n in range(len(starts)):
        x, y, z = starts[n]
        at, last_at, last = 0.0, -1.0, 0.0
        while at < reach:
            value = distance_at(blocks, x + direction[0] * at, y + direction[1] * at, z + slope * at)
            if not math.isnan(value):
                if value < 0.0:
                    if last_at >= 0.0 and at - last_at <= gap:
                        inside, outside = min(last, _NEAR), max(value, -_NEAR)
                        found[n] = last_at + (at - last_at) * inside / (inside - outside)
                    break
                last_at, last = at, value
            at += step
    return found


def well_seen(height: NDArray[np.float32], weight: NDArray[np.float32]) -> None:
    """Takes away the columns that are seen far less than those beside them: they lie at an outline, half in the air.

    Args:
        height: (n, n) m; changed, NaN where nothing is seen.
        weight: (n, n) of the columns.
    """
    most = cv2.dilate(weight, np.ones((5, 5), np.uint8))
    height[weight < _SHARE * most] = np.nan
