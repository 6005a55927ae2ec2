"""Ray casting: the map seen from straight above, and how far the ground extends under an edge.

λ is the `distance` of a voxel in `Blocks`: -1 to 1, negative in free space and positive behind a surface.
"""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.terrain_map.voxel_blocks import EDGE, SHAPE, Blocks, slot_of
from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent

_BESIDE = np.ones((5, 5), np.uint8)
"""The columns around one, for `column_noise`."""
_MAX_MIN_WEIGHT = 0.1
"""Weight from which on any voxel is observed, in images taken from 1 m."""
_MIN_WEIGHT = 0.01
"""Smallest weight of an observed voxel."""
_OBSERVED_SD_M = 0.026
"""Largest standard deviation of an observed voxel's height, m: docs/terrain_map.md (13). Tuned on single images of
stairs from in front. With 0.021 fewer treads at grazing angles are mapped from one image; with 0.032 the far border of
level ground frays."""
_MAX_LAMBDA = 0.5
"""Beyond this |λ| the distance is unknown: the surface between two such voxels is taken in the middle."""
_NEIGHBOUR_SHARE = np.float32(0.5)
"""Smallest weight of a column, as a share of its neighbours' weight: flying pixels have less."""
_WEIGHT_FLOOR = np.float32(0.01)
"""Lower limit of the weight in a column's standard deviation."""


@entry_kernel(_HERE)
def cast_down(
    blocks: Blocks,
    first_i: int,
    first_j: int,
    size: int,
    top_k: int,
    voxel_m: float,
    eye_z: float,
    noise_per_m: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Casts one ray straight down per column of voxels, to the highest surface.

    A surface lies where λ changes from negative (free) to positive between two observed voxels; linear interpolation
    gives its height.

    Args:
        blocks: Voxels of the map.
        first_i: Column of the corner along i; a multiple of 8.
        first_j: Column of the corner along j; a multiple of 8.
        size: Columns along one edge of the view; a multiple of 8.
        top_k: Rays start at this layer.
        voxel_m: Edge of a voxel.
        eye_z: Height of the camera, m.
        noise_per_m: Standard deviation of the depth divided by its square, 1/m.

    Returns:
        (size, size) height of the surface, m, NaN where unobserved, and the smaller weight of the two voxels.
    """
    height = np.full((size, size), np.nan, np.float32)
    trust = np.zeros((size, size), np.float32)
    # A block has 64 columns of 8 voxels; voxel k of a column is at index 8 column + k, which is (column << 3) | k.
    # Per column of a block: λ and weight (0 = unobserved) of the voxel above, and which columns are done.
    above, known = np.zeros(EDGE * EDGE, np.float32), np.zeros(EDGE * EDGE, np.float32)
    met = np.zeros(EDGE * EDGE, np.bool_)
    slots, origin = blocks.slots, blocks.origin
    start = min(top_k, (origin[2] + SHAPE[2]) * EDGE - 1)  # highest layer, within the window
    nothing = np.float32(0.0)  # in 32 bit
    # smallest weight of an observed voxel, by its layer in the block
    enough = np.empty(EDGE, np.float32)
    for bi in range(size // EDGE):
        for bj in range(size // EDGE):
            known[:], met[:] = nothing, False
            open_columns = EDGE * EDGE  # number of columns of this block that have not met a surface
            for bk in range(start >> 3, origin[2] - 1, -1):
                row = slot_of(slots, origin, (first_i >> 3) + bi, (first_j >> 3) + bj, bk)
                if row < 0:  # a block that is not allocated is unobserved
                    known[:] = nothing
                    continue
                distance, weight = blocks.distance[row], blocks.weight[row]
                top = min(EDGE - 1, start - bk * EDGE)  # highest layer in this block
                for k in range(EDGE):
                    off = noise_per_m * (eye_z - (bk * EDGE + k + 0.5) * voxel_m) / _OBSERVED_SD_M
                    enough[k] = min(max(off * off, _MIN_WEIGHT), _MAX_MIN_WEIGHT)
                for column in range(EDGE * EDGE):
                    if met[column]:
                        continue
                    # Columns that only pass through free or unobserved voxels are skipped, but for the lowest voxel.
                    first, solid = column << 3, False  # solid: a voxel of the column is behind a surface
                    for k in range(EDGE):
                        solid |= (weight[first | k] >= enough[k]) & (distance[first | k] >= nothing)
                    if not solid:
                        above[column] = distance[first]
                        known[column] = weight[first] if weight[first] >= enough[0] else nothing
                        continue
                    before, trusted = above[column], known[column]  # λ and weight of the voxel above
                    for k in range(top, -1, -1):
                        at = first | k
                        voxel_weight, value = weight[at], distance[at]
                        if voxel_weight < enough[k]:
                            trusted = nothing
                            continue
                        if value >= nothing and trusted > nothing and before < nothing:
                            # the surface lies `value / (value - before)` voxels above the middle of this one
                            i, j = bi * EDGE + (column >> 3), bj * EDGE + (column & 7)
                            height[i, j] = (bk * EDGE + k + 0.5 + value / (value - before)) * voxel_m
                            trust[i, j] = min(voxel_weight, trusted)
                            met[column] = True
                            open_columns -= 1
                            break
                        trusted, before = voxel_weight, value
                    above[column], known[column] = before, trusted
                if open_columns == 0:
                    break
    return height, trust


@entry_kernel(_HERE, error_model="numpy")
def solid_reach(blocks: Blocks, starts: Array, direction: Array, slope: float, reach: float, gap: float) -> Array:
    """How far solid ground extends along lines just under a surface.

    λ is read at steps of one voxel along each line; it is positive in solid ground and negative in free space.

    Args:
        blocks: Voxels of the map.
        starts: (N, 3) voxels, grid axes, just under the surface.
        direction: (2,) horizontal unit vector toward the surface's end.
        slope: Slope of the surface along it.
        reach: Length of the search, voxels.
        gap: Longest unobserved stretch between the last solid and the first free position, voxels.

    Returns:
        (N,) voxels from each start to where λ becomes negative first; NaN if it does not within `reach`, or if no solid
        position is known at most `gap` before.
    """
    extents = np.full(len(starts), np.nan)
    step = 1.0  # voxels
    slots, origin, distance, weight = blocks.slots, blocks.origin, blocks.distance, blocks.weight
    for n in range(len(starts)):
        at, last_at, last = 0.0, -1.0, 0.0  # distance from the start; the last solid position (-1: none), and λ there
        while at < reach:
            # trilinear interpolation of λ between voxel centres, where all eight were observed
            x, y = starts[n, 0] + direction[0] * at - 0.5, starts[n, 1] + direction[1] * at - 0.5
            z = starts[n, 2] + slope * at - 0.5
            i, j, k = math.floor(x), math.floor(y), math.floor(z)
            a, b, c = x - i, y - j, z - k
            value = 0.0
            for corner in range(8):
                di, dj, dk = corner >> 2, (corner >> 1) & 1, corner & 1
                share = (a if di else 1 - a) * (b if dj else 1 - b) * (c if dk else 1 - c)
                if share < 1e-6:
                    continue
                p, q, r = i + di, j + dj, k + dk
                # row of the voxel's block, and index 64 i + 8 j + k of the voxel in it
                row = slot_of(slots, origin, p >> 3, q >> 3, r >> 3)
                here = ((p & 7) << 6) | ((q & 7) << 3) | (r & 7)
                if row < 0 or weight[row, here] < _MIN_WEIGHT:
                    value = math.nan
                    break
                value += share * distance[row, here]
            if not math.isnan(value):
                if value < 0.0:  # free: the ground ends between the last solid position and this one
                    if last_at >= 0.0 and at - last_at <= gap:
                        inside, outside = min(last, _MAX_LAMBDA), max(value, -_MAX_LAMBDA)
                        extents[n] = last_at + (at - last_at) * inside / (inside - outside)
                    break
                last_at, last = at, value
            at += step
    return extents


def column_noise(
    height: NDArray[np.float32],
    weight: NDArray[np.float32],
    eye_z: float,
    least_m: float,
    most_m: float,
    noise_per_m: float,
) -> NDArray[np.float32]:
    """Standard deviation of the columns' heights.

    Columns observed far less than their neighbours are removed: they are flying pixels at a depth discontinuity. The
    variance of the others is that of the depth noise at the camera's height over the column, divided by the weight,
    plus the square of the lower limit.

    Args:
        height: (n, n) m, NaN where unobserved; modified: removed columns become NaN, too.
        weight: (n, n) weight of each column.
        eye_z: Height of the camera, m.
        least_m: Lower limit of the standard deviation.
        most_m: Upper limit.
        noise_per_m: Standard deviation of the depth divided by its square, 1/m.

    Returns:
        (n, n) m, standard deviation of the heights.
    """
    beside = np.asarray(cv2.dilate(weight, _BESIDE), np.float32)
    return _column_noise(height, weight, beside, eye_z, least_m, most_m, noise_per_m)


@entry_kernel(_HERE, error_model="numpy")
def _column_noise(
    height: NDArray[np.float32],
    weight: NDArray[np.float32],
    beside: NDArray[np.float32],
    eye_z: float,
    least_m: float,
    most_m: float,
    noise_per_m: float,
) -> NDArray[np.float32]:
    """(n, n) standard deviation of the columns' heights, m; flying pixels are removed from `height`.

    This is the compiled part of `column_noise`.

    Args:
        height: (n, n) m; modified: NaN where the column has far less weight than one around it.
        weight: (n, n) weight of each column.
        beside: (n, n) largest weight among the columns around each one, itself included.
        eye_z: Height of the camera, m.
        least_m: Lower limit of the standard deviation.
        most_m: Upper limit.
        noise_per_m: Standard deviation of the depth divided by its square, 1/m.
    """
    noise = np.empty(height.shape, np.float32)
    unseen = np.float32(math.nan)
    for i in range(height.shape[0]):
        for j in range(height.shape[1]):
            column_weight = weight[i, j]
            z = unseen if column_weight < _NEIGHBOUR_SHARE * beside[i, j] else height[i, j]
            # An image from h above the column has the noise noise_per_m h² and, straight above it, the weight 1 / h²:
            # the noise is off / √weight with off = noise_per_m h.
            off = noise_per_m * (0.0 if math.isnan(z) else eye_z - z)
            sd = math.sqrt(
                least_m * least_m + off * off / (column_weight if column_weight > _WEIGHT_FLOOR else _WEIGHT_FLOOR)
            )
            height[i, j], noise[i, j] = z, min(sd, most_m)
    return noise
