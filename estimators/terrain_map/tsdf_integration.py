"""Integrates depth images into the voxels: docs/terrain_map.md (1)-(4), after Zhao 2023 (19)-(22)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.terrain_map.voxel_blocks import EDGE, SHAPE, VOXELS, Blocks, add_block, slot_of
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent

_f32 = np.float32
# signed distance of an unobserved voxel, m, and least divisor
_NONE, _LEAST = _f32(1e9), _f32(1e-20)
# Constants with which arithmetic stays in 32 bit. `_ORIGIN` is pixel 0, which also marks voxels out of view, and the
# start of counts.
_ZERO, _ONE, _ORIGIN = _f32(0.0), _f32(1.0), np.int32(0)
_Corner = tuple[np.float32, np.float32, np.float32]
"""A block's first voxel in the camera's axes, m."""
_RADIUS = math.sqrt(3.0) / 2.0 * EDGE  # of a sphere around a block, voxels
_SLAB = EDGE * EDGE
"""Voxels of a block that are skipped together if an image does not observe them."""
_PIXEL_STRIDE = 8
"""Every eighth pixel in both directions allocates blocks: at 4.5 m these are 6 cm apart, a block is 16 cm wide."""
_MIN_DESCENT = _f32(0.3)
"""κ of docs/terrain_map.md (2) is no smaller: height over depth of the shallowest line of sight."""
_NEAR_M = _f32(0.05)
"""Closer voxels are out of view."""
_FREE_LAMBDA = _f32(-0.5)
"""Space with a smaller λ is certainly free."""
_NOISE_GATE_SD = 3.0
"""Standard deviations of the depth by which a surface may be missed straight above a voxel."""


@entry_kernel(_HERE)
def allocate(
    blocks: Blocks,
    depth: NDArray[np.float32],
    intrinsics: Array,
    T_grid_camera: Array,
    voxel_m: float,
    band_m: float,
    top_m: float,
    t_ns: int,
) -> None:
    """Allocates the blocks that contain surfaces of a depth image, and notes when they were last seen.

    Blocks outside the window are left out, as are surfaces above `top_m`, and new ones once the buffer is full.

    Args:
        blocks: Modified in place.
        depth: (H, W) m, 0 = none.
        intrinsics: (4,) fu, fv, pu, pv.
        T_grid_camera: (4, 4) optical frame to grid axes, m.
        voxel_m: Edge of a voxel.
        band_m: Truncation, as a height.
        top_m: Upper limit of the mapped height, grid axes.
        t_ns: Time of the image.
    """
    R, c = T_grid_camera[:3, :3], T_grid_camera[:3, 3]  # c is the camera's position
    per_block = 1.0 / (voxel_m * EDGE)  # blocks per metre
    ray = np.zeros(3)  # of a pixel at a depth of 1 m, grid axes
    last_i, last_j, last_k = 0, 0, blocks.origin[2] - 1  # a block outside the window
    for v in range(_PIXEL_STRIDE // 2, depth.shape[0], _PIXEL_STRIDE):
        for u in range(_PIXEL_STRIDE // 2, depth.shape[1], _PIXEL_STRIDE):
            d = depth[v, u]
            if d == 0.0:
                continue
            x, y = (u - intrinsics[2]) / intrinsics[0], (v - intrinsics[3]) / intrinsics[1]
            for a in range(3):
                ray[a] = R[a, 0] * x + R[a, 1] * y + R[a, 2]
            if c[2] + ray[2] * d > top_m:  # the surface is too high
                continue
            # depth within the band on either side of the surface; five positions in it, half a band apart
            band = band_m / max(abs(ray[2]), float(_MIN_DESCENT))
            for step in range(-2, 3):
                at = d + 0.5 * step * band
                i = math.floor((c[0] + ray[0] * at) * per_block)
                j = math.floor((c[1] + ray[1] * at) * per_block)
                k = math.floor((c[2] + ray[2] * at) * per_block)
                if i == last_i and j == last_j and k == last_k:
                    continue
                last_i, last_j, last_k = i, j, k
                if (
                    i < blocks.origin[0]
                    or i >= blocks.origin[0] + SHAPE[0]
                    or j < blocks.origin[1]
                    or j >= blocks.origin[1] + SHAPE[1]
                    or k < blocks.origin[2]
                    or k >= blocks.origin[2] + SHAPE[2]
                ):
                    continue
                row = slot_of(blocks.slots, blocks.origin, i, j, k)
                if row < 0:
                    row = add_block(blocks, i, j, k)
                if row >= 0:  # else the buffer is full
                    blocks.seen_ns[row] = t_ns


@entry_kernel(_HERE, error_model="numpy", fastmath=True)
def integrate(
    blocks: Blocks,
    depth: NDArray[np.float32],
    intrinsics: Array,
    T_camera_grid: Array,
    voxel_m: float,
    band_m: float,
    max_weight: float,
    noise_per_m: float,
) -> None:
    """Updates every voxel in view by docs/terrain_map.md (1)-(4), after Zhao 2023 (19)-(22).

    The truncation t_δ of a line of sight makes λ a height: it is band_m divided by the line's descent per metre. A
    voxel counts as behind a surface only if the surface extends to straight above it. Otherwise a line of sight just
    over a tread's edge would lengthen the tread.

    Args:
        blocks: Modified in place.
        depth: (H, W) m, 0 = none.
        intrinsics: (4,) fu, fv, pu, pv.
        T_camera_grid: (4, 4) grid axes to optical frame, m.
        voxel_m: Edge of a voxel.
        band_m: Truncation, as a height.
        max_weight: W_max.
        noise_per_m: Standard deviation of the depth divided by its square, 1/m.
    """
    height, width = depth.shape
    fu, fv, pu, pv = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    R, t = T_camera_grid[:3, :3], T_camera_grid[:3, 3]
    # height of the camera in grid axes; half the distance between a block's outermost voxels
    eye_z = -(R[0, 2] * t[0] + R[1, 2] * t[1] + R[2, 2] * t[2])
    radius, half = _RADIUS * voxel_m, 0.5 * (EDGE - 1) * voxel_m
    # 1 / cosine of the image's half angles: by so much a sphere reaches farther across the image's border
    slope_u, slope_v = math.sqrt(1 + (width / 2 / fu) ** 2), math.sqrt(1 + (height / 2 / fv) ** 2)
    camera = _Pinhole(
        _f32(fu),
        _f32(fv),
        _f32(pu + 0.5),
        _f32(pv + 0.5),
        np.int32(width),
        np.int32(height),
        _f32(R[0, 2]),
        _f32(R[1, 2]),
        _f32(R[2, 2]),
        _f32(band_m),
        _f32(1.0 / band_m),
        _f32(max_weight),
        _f32(_NOISE_GATE_SD * noise_per_m),
    )
    lattice, projection = _build_lattice(R * voxel_m, voxel_m), _allocate_projection()
    image = depth.ravel()
    for row in range(len(blocks.used)):
        if not blocks.used[row]:
            continue
        # the block's first voxel in grid axes, then in the camera's, and the block's middle in the camera's
        bx = (blocks.places[row, 0] * EDGE + 0.5) * voxel_m
        by = (blocks.places[row, 1] * EDGE + 0.5) * voxel_m
        bz = (blocks.places[row, 2] * EDGE + 0.5) * voxel_m
        x0 = R[0, 0] * bx + R[0, 1] * by + R[0, 2] * bz + t[0]
        y0 = R[1, 0] * bx + R[1, 1] * by + R[1, 2] * bz + t[1]
        z0 = R[2, 0] * bx + R[2, 1] * by + R[2, 2] * bz + t[2]
        xc = x0 + half * (R[0, 0] + R[0, 1] + R[0, 2])
        yc = y0 + half * (R[1, 0] + R[1, 1] + R[1, 2])
        zc = z0 + half * (R[2, 0] + R[2, 1] + R[2, 2])
        if (  # the sphere around the block is behind the camera or beside the image
            zc < radius
            or abs(fu * xc + (pu - width / 2) * zc) > width / 2 * zc + fu * radius * slope_u
            or abs(fv * yc + (pv - height / 2) * zc) > height / 2 * zc + fv * radius * slope_v
        ):
            continue
        corner = _f32(x0), _f32(y0), _f32(z0)
        if _project(image, camera, lattice, corner, _f32(eye_z - bz), projection):
            _check_above(image, camera, lattice, corner, projection)
            _average(blocks.distance[row], blocks.weight[row], camera, projection)
            blocks.solid[row] = False  # it may no longer be solid


class _Pinhole(NamedTuple):
    """A pinhole camera: pixels, the vertical in its axes, and the weight of its depth; all 32 bit.

    Attributes:
        fu: Focal length along u, px.
        fv: Focal length along v, px.
        pu: Principal point plus 0.5, px: cut to a whole number, a coordinate is then its nearest pixel.
        pv: As `pu`, along v.
        width: Pixels of a row.
        height: Pixels of a column.
        up_x: Component x of the upward unit vector in the camera's axes; `up_y` and `up_z` are the others.
        band: Truncation, as a height, m.
        per_band: 1 / `band`, 1/m.
        max_weight: W_max of docs/terrain_map.md (4).
        noise: Depth by which a surface may be missed, divided by the depth's square, 1/m.
    """

    fu: np.float32
    fv: np.float32
    pu: np.float32
    pv: np.float32
    width: np.int32
    height: np.int32
    up_x: np.float32
    up_y: np.float32
    up_z: np.float32
    band: np.float32
    per_band: np.float32
    max_weight: np.float32
    noise: np.float32


class _Lattice(NamedTuple):
    """Offsets of a block's 512 voxels from its first one.

    Attributes:
        x: (512,) m, along the camera's x axis.
        y: (512,) m, along the camera's y axis.
        z: (512,) m, along the camera's optical axis.
        up: (512,) m, upwards.
    """

    x: NDArray[np.float32]
    y: NDArray[np.float32]
    z: NDArray[np.float32]
    up: NDArray[np.float32]


class _Projection(NamedTuple):
    """A depth image evaluated at the voxels of a block: (512,) per voxel, (8,) per slab.

    Attributes:
        z: m along the optical axis.
        descent: Descent of the line of sight per metre of depth.
        scale: λ per metre of depth.
        pixel: Pixel of the voxel; 0 if it is not in view.
        sdf: Signed distance of docs/terrain_map.md (1), m; `_NONE` where unobserved.
        second: Depth of the image at the second lookup, m.
        observed: Number of observed voxels per slab.
        behind: Number of those behind a surface seen from above.
    """

    z: NDArray[np.float32]
    descent: NDArray[np.float32]
    scale: NDArray[np.float32]
    pixel: NDArray[np.int32]
    sdf: NDArray[np.float32]
    second: NDArray[np.float32]
    observed: NDArray[np.int32]
    behind: NDArray[np.int32]


@njit(**INNER_KERNEL)
def _build_lattice(steps: Array, voxel_m: float) -> _Lattice:
    """Offsets of a block's voxels from its first one.

    Args:
        steps: (3, 3) m, columns: steps to the next voxel along i, j and k, in the camera's axes.
        voxel_m: Edge of a voxel.
    """
    x, y, z = np.empty(VOXELS, np.float32), np.empty(VOXELS, np.float32), np.empty(VOXELS, np.float32)
    up = np.empty(VOXELS, np.float32)
    for at in range(VOXELS):
        i, j, k = at >> 6, (at >> 3) & 7, at & 7  # voxel (i, j, k) is at index 64 i + 8 j + k
        x[at] = i * steps[0, 0] + j * steps[0, 1] + k * steps[0, 2]
        y[at] = i * steps[1, 0] + j * steps[1, 1] + k * steps[1, 2]
        z[at] = i * steps[2, 0] + j * steps[2, 1] + k * steps[2, 2]
        up[at] = k * voxel_m
    return _Lattice(x, y, z, up)


@njit(**INNER_KERNEL)
def _allocate_projection() -> _Projection:
    """A projection with uninitialised arrays, which `_project` overwrites for each block."""
    return _Projection(
        np.empty(VOXELS, np.float32),
        np.empty(VOXELS, np.float32),
        np.empty(VOXELS, np.float32),
        np.empty(VOXELS, np.int32),
        np.empty(VOXELS, np.float32),
        np.empty(VOXELS, np.float32),
        np.empty(EDGE, np.int32),
        np.empty(EDGE, np.int32),
    )


@njit(error_model="numpy", fastmath=True, **INNER_KERNEL)
def _project(
    image: NDArray[np.float32],
    camera: _Pinhole,
    lattice: _Lattice,
    corner: _Corner,
    above: np.float32,
    projection: _Projection,
) -> bool:
    """Evaluates a depth image at each voxel of a block; returns whether any voxel is observed.

    A voxel is observed if it is in view, if the image has a depth at its pixel, and if it is not farther behind that
    surface than the truncation.

    Args:
        image: (H * W) depth, m, 0 = none.
        camera: Pinhole camera.
        lattice: Offsets of the voxels.
        corner: The block's first voxel in the camera's axes, m.
        above: Height of the camera over that voxel, m.
        projection: Overwritten.
    """
    x0, y0, z0 = corner
    # Loops without branches or lookups among the sums are vectorised.
    for at in range(VOXELS):
        z = z0 + lattice.z[at]
        per_z = _ONE / z
        # nearest pixel; z may be 0 or negative, which `inside` excludes
        u = np.int32(camera.fu * (x0 + lattice.x[at]) * per_z + camera.pu)
        v = np.int32(camera.fv * (y0 + lattice.y[at]) * per_z + camera.pv)
        descent = (above - lattice.up[at]) * per_z
        steep = abs(descent)
        inside = (z >= _NEAR_M) & (u >= _ORIGIN) & (u < camera.width) & (v >= _ORIGIN) & (v < camera.height)
        projection.z[at], projection.descent[at] = z, descent
        # κ / t of docs/terrain_map.md (2)
        projection.scale[at] = (steep if steep > _MIN_DESCENT else _MIN_DESCENT) * camera.per_band
        projection.pixel[at] = v * camera.width + u if inside else _ORIGIN
    for at in range(VOXELS):  # `sdf` holds the image's depth at first
        projection.sdf[at] = image[np.uint64(projection.pixel[at])]
    any_observed = False
    for slab in range(EDGE):
        observed_count, behind = _ORIGIN, _ORIGIN
        for at in range(slab * _SLAB, (slab + 1) * _SLAB):
            d = projection.sdf[at]
            sdf = projection.z[at] - d  # Zhao 2023 (19)
            is_observed = (projection.pixel[at] != _ORIGIN) & (d > _ZERO) & (sdf * projection.scale[at] <= _ONE)
            projection.sdf[at] = sdf if is_observed else _NONE
            observed_count += np.int32(1) if is_observed else _ORIGIN
            # behind a surface that is seen from above
            behind += np.int32(1) if is_observed & (sdf > _ZERO) & (projection.descent[at] > _ZERO) else _ORIGIN
        projection.observed[slab], projection.behind[slab] = observed_count, behind
        any_observed = any_observed or bool(observed_count > _ORIGIN)
    return any_observed


@njit(error_model="numpy", fastmath=True, **INNER_KERNEL)
def _check_above(
    image: NDArray[np.float32], camera: _Pinhole, lattice: _Lattice, corner: _Corner, projection: _Projection
) -> None:
    """Keeps voxels behind a surface only if it extends to straight above them, by a second lookup in the image.

    The second lookup is at the point straight above the voxel that is as high as where the line of sight meets the
    surface. The projection's `pixel` becomes that of this lookup, and `descent` the depth of that point. If the image
    has no depth there, the voxel counts as unobserved. If the image is much farther there, the surface ends before it.

    Args:
        image: (H * W) depth, m, 0 = none.
        camera: Pinhole camera.
        lattice: Offsets of the voxels.
        corner: The block's first voxel in the camera's axes, m.
        projection: Changed in place; where the surface ends, the distance becomes that to the second pixel's depth.
    """
    x0, y0 = corner[0], corner[1]
    for slab in range(EDGE):
        if projection.behind[slab] == _ORIGIN:
            continue
        for at in range(slab * _SLAB, (slab + 1) * _SLAB):
            sdf, descent = projection.sdf[at], projection.descent[at]
            behind = (sdf > _ZERO) & (sdf < _NONE) & (descent > _ZERO)
            up = sdf * descent if behind else _ZERO  # to where the line of sight meets the surface
            zf = projection.z[at] + camera.up_z * up  # depth of the point straight above
            per_z = _ONE / zf
            u = np.int32(camera.fu * (x0 + lattice.x[at] + camera.up_x * up) * per_z + camera.pu)
            v = np.int32(camera.fv * (y0 + lattice.y[at] + camera.up_y * up) * per_z + camera.pv)
            inside = behind & (u >= _ORIGIN) & (u < camera.width) & (v >= _ORIGIN) & (v < camera.height)
            projection.descent[at] = zf
            projection.pixel[at] = v * camera.width + u if inside else _ORIGIN
        for at in range(slab * _SLAB, (slab + 1) * _SLAB):
            projection.second[at] = image[np.uint64(projection.pixel[at])]
        for at in range(slab * _SLAB, (slab + 1) * _SLAB):
            d, z, sdf, zf = projection.second[at], projection.z[at], projection.sdf[at], projection.descent[at]
            # whether the image is much farther there than the surface: it has ended before
            ends = (zf - d + camera.noise * z * z) * projection.scale[at] < _FREE_LAMBDA
            # unobserved without a depth; distance to the second pixel's depth where the surface ends; else unchanged
            other = _NONE if d == _ZERO else zf - d if ends else sdf
            projection.sdf[at] = other if projection.pixel[at] != _ORIGIN else sdf


@njit(error_model="numpy", fastmath=True, **INNER_KERNEL)
def _average(
    distance: NDArray[np.float32], weight: NDArray[np.float32], camera: _Pinhole, projection: _Projection
) -> None:
    """Averages λ and weight of a block's voxels: docs/terrain_map.md (2)-(4), after Zhao 2023 (20)-(22).

    Args:
        distance: (512,) λ, changed in place where the voxel is observed.
        weight: (512,) W, changed in place.
        camera: Truncation and W_max.
        projection: Signed distances and scales of the voxels.
    """
    for slab in range(EDGE):
        if projection.observed[slab] == _ORIGIN:
            continue
        for at in range(slab * _SLAB, (slab + 1) * _SLAB):
            sdf, z = projection.sdf[at], projection.z[at]
            value = sdf * projection.scale[at]
            value = value if value > -_ONE else -_ONE  # Zhao 2023 (20)
            # weight of this image, docs/terrain_map.md (3): (κ / z)², with z of at least 1 m; scale * band is κ
            new = projection.scale[at] * camera.band / (z if z > _ONE else _ONE)
            new = new * new if sdf < _NONE else _ZERO
            old = weight[at]
            total = old + new  # weight with this image
            # Zhao 2023 (21)
            mixed = (old * distance[at] + new * value) / (total if total > _LEAST else _LEAST)
            distance[at] = mixed if sdf < _NONE else distance[at]
            weight[at] = total if total < camera.max_weight else camera.max_weight  # Zhao 2023 (22)
