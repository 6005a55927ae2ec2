"""A depth picture goes into the voxels: eqs. (19)-(22) of Zhao et al. 2023."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.terrain_map.blocks import EDGE, SHAPE, Blocks, add_block, slot_of
from stridetwin.streams.samples import Array

_STRIDE = 8
_STEEPEST = 0.3
"""Height over depth along the shallowest line of sight whose distances still count as heights."""
_RADIUS = math.sqrt(3.0) / 2.0 * EDGE


def without_outlines(depth: NDArray[np.float32], share: float, reach: int) -> NDArray[np.float32]:
    """The depth without the pixels beside an outline, which lie on one of two surfaces or between them.

    Taking as much away on either side leaves the middle of the gap where the outline is.

    Args:
        depth: (H, W) m, 0 = none.
        share: Difference of the depths, over the larger one, that makes an outline.
        reach: Pixels.
    """
    window = np.ones((2 * reach + 1,) * 2, np.uint8)
    far = cv2.dilate(depth, window)
    filled = depth.copy()
    filled[depth == 0] = np.inf
    near = cv2.erode(filled, window)
    return np.asarray(depth * (near >= np.float32(1.0 - share) * far), np.float32)


@njit(cache=True)
def touch(
    blocks: Blocks, depth: NDArray[np.float32], intrinsics: Array, T_grid_camera: Array, voxel_m: float, band_m: float,
    top_m: float, t_ns: int,
) -> None:  # fmt: skip
    """Makes the blocks that a picture's surfaces run through.

    Args:
        blocks: Changed in place.
        depth: (H, W) m, 0 = none.
        intrinsics: (4,) fu, fv, pu, pv.
        T_grid_camera: (4, 4) optical frame to grid axes, m.
        voxel_m: Edge of a voxel.
        band_m: Truncation, as a height.
        top_m: Nothing above this height is mapped, grid axes.
        t_ns: Time of the picture.
    """
    R, c = T_grid_camera[:3, :3], T_grid_camera[:3, 3]
    per_block = 1.0 / (voxel_m * EDGE)
    ray = np.zeros(3)
    for v in range(_STRIDE // 2, depth.shape[0], _STRIDE):
        for u in range(_STRIDE // 2, depth.shape[1], _STRIDE):
            d = depth[v, u]
            if d == 0.0:
                continue
            x, y = (u - intrinsics[2]) / intrinsics[0], (v - intrinsics[3]) / intrinsics[1]
            for a in range(3):
                ray[a] = R[a, 0] * x + R[a, 1] * y + R[a, 2]
            if c[2] + ray[2] * d > top_m:
                continue
            band = band_m / max(abs(ray[2]), _STEEPEST)
            for step in range(-2, 3):
                at = d + 0.5 * step * band
                i = math.floor((c[0] + ray[0] * at) * per_block)
                j = math.floor((c[1] + ray[1] * at) * per_block)
                k = math.floor((c[2] + ray[2] * at) * per_block)
                if (
                    i < blocks.origin[0] or i >= blocks.origin[0] + SHAPE[0] or j < blocks.origin[1]
                    or j >= blocks.origin[1] + SHAPE[1] or k < blocks.origin[2] or k >= blocks.origin[2] + SHAPE[2]
                ):  # fmt: skip
                    continue
                row = slot_of(blocks.slots, blocks.origin, i, j, k)
                if row < 0:
                    row = add_block(blocks, i, j, k)
                if row >= 0:
                    blocks.seen_ns[row] = t_ns


@njit(cache=True, error_model="numpy", fastmath=True)
def integrate(
    blocks: Blocks, depth: NDArray[np.float32], intrinsics: Array, T_camera_grid: Array, voxel_m: float, band_m: float,
    weight_max: float, noise_per_m: float,
) -> None:  # fmt: skip
    """Updates every voxel in view by eqs. (19)-(22).

    The truncation t_δ of a line of sight is such that λ is a height: band_m over how steeply the line falls. A voxel
    behind a surface is only counted so where that surface reaches to straight above it; else a line of sight that
    passes just over a tread's edge would lengthen the tread by as much as it runs on below it.

    Args:
        blocks: Changed in place.
        depth: (H, W) m, 0 = none.
        intrinsics: (4,) fu, fv, pu, pv.
        T_camera_grid: (4, 4) grid axes to optical frame, m.
        voxel_m: Edge of a voxel.
        band_m: Truncation, as a height.
        weight_max: W_max.
        noise_per_m: Standard deviation of the depth over its square, 1/m.
    """
    height, width = depth.shape
    fu, fv, pu, pv = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    R, t = T_camera_grid[:3, :3], T_camera_grid[:3, 3]
    eye_z = -(R[0, 2] * t[0] + R[1, 2] * t[1] + R[2, 2] * t[2])
    radius = _RADIUS * voxel_m
    slope_u, slope_v = math.sqrt(1 + (width / 2 / fu) ** 2), math.sqrt(1 + (height / 2 / fv) ** 2)
    steps, per_band = R * voxel_m, 1.0 / band_m
    for row in range(len(blocks.used)):
        if not blocks.used[row]:
            continue
        bx = (blocks.places[row, 0] * EDGE + 0.5) * voxel_m
        by = (blocks.places[row, 1] * EDGE + 0.5) * voxel_m
        bz = (blocks.places[row, 2] * EDGE + 0.5) * voxel_m
        x0 = R[0, 0] * bx + R[0, 1] * by + R[0, 2] * bz + t[0]
        y0 = R[1, 0] * bx + R[1, 1] * by + R[1, 2] * bz + t[1]
        z0 = R[2, 0] * bx + R[2, 1] * by + R[2, 2] * bz + t[2]
        half = 0.5 * (EDGE - 1)
        xc = x0 + half * (steps[0, 0] + steps[0, 1] + steps[0, 2])
        yc = y0 + half * (steps[1, 0] + steps[1, 1] + steps[1, 2])
        zc = z0 + half * (steps[2, 0] + steps[2, 1] + steps[2, 2])
        if (
            zc < radius
            or abs(fu * xc + (pu - width / 2) * zc) > width / 2 * zc + fu * radius * slope_u
            or abs(fv * yc + (pv - height / 2) * zc) > height / 2 * zc + fv * radius * slope_v
        ):
            continue
        at = -1
        for i in range(EDGE):
            for j in range(EDGE):
                for k in range(EDGE):
                    at += 1
                    z = z0 + i * steps[2, 0] + j * steps[2, 1] + k * steps[2, 2]
                    if z < 0.05:
                        continue
                    x = x0 + i * steps[0, 0] + j * steps[0, 1] + k * steps[0, 2]
                    y = y0 + i * steps[1, 0] + j * steps[1, 1] + k * steps[1, 2]
                    per_z = 1.0 / z
                    u, v = int(fu * x * per_z + pu + 0.5), int(fv * y * per_z + pv + 0.5)
                    if u < 0 or u >= width or v < 0 or v >= height:
                        continue
                    d = depth[v, u]
                    if d == 0.0:
                        continue
                    voxel_z = bz + k * voxel_m
                    falls = (eye_z - voxel_z) * per_z
                    scale = max(abs(falls), _STEEPEST) * per_band
                    sdf = z - d  # (19)
                    if sdf * scale > 1.0:
                        continue
                    if sdf > 0.0 and falls > 0.0:
                        up = sdf * falls  # to where the line of sight met the surface
                        zf = z + R[2, 2] * up
                        uf = int(fu * (x + R[0, 2] * up) / zf + pu + 0.5)
                        vf = int(fv * (y + R[1, 2] * up) / zf + pv + 0.5)
                        if uf >= 0 and uf < width and vf >= 0 and vf < height:
                            df = depth[vf, uf]
                            if df == 0.0:
                                continue
                            if zf - df < -0.5 / scale - 3.0 * noise_per_m * z * z:
                                sdf = zf - df
                    value = max(-1.0, sdf * scale)  # (20)
                    new = (scale * band_m * min(per_z, 1.0)) ** 2
                    old = blocks.weight[row, at]
                    blocks.distance[row, at] = (old * blocks.distance[row, at] + new * value) / (old + new)  # (21)
                    blocks.weight[row, at] = min(old + new, weight_max)  # (22)
