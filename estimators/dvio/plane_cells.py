"""Planes in a depth image: inverse depth is linear on each, so cells with the same slope are merged."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.streams.algebra.matrices import copy, copy_matrix
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

# Hand-chosen on twin walks of tuning seeds.
_MAX_DEPTH_M = 5.0  # below the sensor's range, near whose end measured depths are too small
_STEP_PX = 4  # between samples: a stereo camera's noise is correlated within its matching window
SIDE = 10
"""Edge of a usual cell, samples."""
_MIN_MEASURED_SHARE = 0.9  # of a cell's samples
_MAX_ROUGHNESS_SD = 1.6  # scatter of a cell's samples about its plane, standard deviations
_CELL_GATE = 14.0  # squared Mahalanobis distance of a cell from its plane: 0.3 % of its own cells exceed it
_MIN_CELLS = 8  # of a plane
PLANE_ERROR = 3e-3
"""Error of a plane in one image beyond its depth noise: of its direction, rad, and of its distance, relative."""
# Sums per cell, over samples of inverse depth ξ at (x, y) on the plane at depth 1:
# 0-5 x², xy, x, y², y, 1 (upper triangle of the normal equations); 6-8 ξx, ξy, ξ (their right-hand side); 9 ξ²;
# 10 squared residuals of ξ from the cell's own plane.
_SUMS = 11


def sample_pixels(shape: tuple[int, int]) -> NDArray[np.float32]:
    """(R, C, 2) px of the depth samples of an image (H, W); R and C are whole numbers of cells."""
    height, width = shape
    cell_px = _STEP_PX * SIDE
    rows, columns = height // cell_px * SIDE, width // cell_px * SIDE  # samples of the cells that fit
    v, u = np.mgrid[:rows, :columns] * _STEP_PX + _STEP_PX // 2  # each in the middle of its step
    return np.stack([u, v], axis=-1).astype(np.float32)


@njit(error_model="numpy", **INNER_KERNEL)
def invert_symmetric(s: Array, out: Array) -> bool:
    """Writes the inverse of a symmetric 3 x 3 matrix into `out` (3, 3); returns False where it is singular.

    The matrix is [[s0, s1, s2], [s1, s3, s4], [s2, s4, s5]], of the first six entries of `s`. The inverse is in closed
    form by cofactors: the sums of a cell are six numbers, not a matrix that `matrices.factorise` would take. If the
    matrix is singular, nothing is written.
    """
    a, b, c, d, e, f = s[0], s[1], s[2], s[3], s[4], s[5]
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d  # cofactors of the first row
    det = a * A + b * B + c * C
    if not det > 1e-12 * a * d * f:
        return False
    out[0, 0], out[0, 1], out[0, 2] = A / det, B / det, C / det
    out[1, 1], out[1, 2], out[2, 2] = (a * f - c * c) / det, (b * c - a * e) / det, (a * d - b * b) / det
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    return True


@njit(error_model="numpy", **INNER_KERNEL)
def _fit_plane(s: Array, inverse: Array, plane: Array) -> bool:
    """Fits a plane to samples of inverse depth by least squares; returns False if they do not determine a plane.

    The model is ξ = plane · (x, y, 1) for the inverse depth ξ, 1/m, at (x, y) on the plane at depth 1.

    Args:
        s: (11,) sums over the samples, see `_SUMS`: 0-5 x², xy, x, y², y, 1 (the normal equations' matrix), and 6-8
            ξx, ξy, ξ (their right-hand side). The others are not used.
        inverse: (3, 3) out: inverse of the normal equations' matrix. Times the variance of a sample's inverse depth it
            is the covariance of the plane.
        plane: (3,) out: the plane, 1/m. If False is returned, neither is written.
    """
    if not invert_symmetric(s, inverse):
        return False
    for i in range(3):
        plane[i] = inverse[i, 0] * s[6] + inverse[i, 1] * s[7] + inverse[i, 2] * s[8]
    return True


@njit(error_model="numpy", **INNER_KERNEL)
def _sum_cells(depth: NDArray[np.float32], rays: Array, side: int, min_depth_m: float, sd: float, cells: Array) -> None:
    """Writes the sums of each cell, as `_SUMS` lists them, into `cells`.

    Entry 5 is the number of samples. It becomes 0, and the cell is not used, if too few samples have a depth, or if
    they scatter more about the cell's own plane than `sd` explains.

    Args:
        depth: (H, W) m, 0 or NaN where none.
        rays: (R * side, C * side, 2) of the samples on the plane at depth 1.
        side: Edge of a cell, samples.
        min_depth_m: Nearest depth that counts.
        sd: Standard deviation of an inverse depth, 1/m.
        cells: (R, C, 11) out.
    """
    # middle: offset of a sample's pixel within its step, as in `sample_pixels`
    inverse, plane, middle = np.empty((3, 3)), np.empty(3), _STEP_PX // 2
    for r in range(cells.shape[0]):
        for c in range(cells.shape[1]):
            s = cells[r, c]
            s[:] = 0.0
            for i in range(r * side, (r + 1) * side):
                for j in range(c * side, (c + 1) * side):
                    z = float(depth[_STEP_PX * i + middle, _STEP_PX * j + middle])
                    if not min_depth_m <= z <= _MAX_DEPTH_M:
                        continue
                    x, y, xi = rays[i, j, 0], rays[i, j, 1], 1.0 / z
                    s[0] += x * x
                    s[1] += x * y
                    s[2] += x
                    s[3] += y * y
                    s[4] += y
                    s[5] += 1.0
                    s[6] += x * xi
                    s[7] += y * xi
                    s[8] += xi
                    s[9] += xi * xi
            if s[5] < _MIN_MEASURED_SHARE * side * side or not _fit_plane(s, inverse, plane):
                s[5] = 0.0
                continue
            # sum of the squared residuals from the cell's own plane
            s[10] = max(s[9] - plane[0] * s[6] - plane[1] * s[7] - plane[2] * s[8], 0.0)
            if s[10] > (_MAX_ROUGHNESS_SD * sd) ** 2 * s[5]:
                s[5] = 0.0


@njit(error_model="numpy", **INNER_KERNEL)
def _plane_distance(s: Array, region: Array, variance: float, plane: Array, buffers: Array) -> float:
    """Squared Mahalanobis distance between the plane of a cell and that of a region; inf if one is undetermined.

    Args:
        s: (11,) sums of the cell, see `_SUMS`.
        region: (3, 3) inverse of the matrix of the region's normal equations; zeros take the region's plane as exact.
        variance: Variance of a sample's inverse depth, 1/m².
        plane: (3,) plane of the region.
        buffers: (2, 3, 3) overwritten.
    """
    inverse, inverse_sum = buffers[0], buffers[1]
    e = np.empty(3)  # plane of the cell, then its difference from the region's
    if not _fit_plane(s, inverse, e):
        return math.inf
    # Covariance of the difference, over the variance of a sample: sum of the two inverses, kept in `inverse`.
    for i in range(3):
        e[i] -= plane[i]
        for j in range(3):
            inverse[i, j] += region[i, j]
    # its upper triangle, as `invert_symmetric` takes it
    t = np.array([inverse[0, 0], inverse[0, 1], inverse[0, 2], inverse[1, 1], inverse[1, 2], inverse[2, 2]])
    if not invert_symmetric(t, inverse_sum):
        return math.inf
    chi = 0.0
    for i in range(3):
        for j in range(3):
            chi += e[i] * inverse_sum[i, j] * e[j]
    return chi / variance


@njit(error_model="numpy", **INNER_KERNEL)
def _grow_region(cells: Array, group: NDArray[np.int64], name: int, variance: float, total: Array, plane: Array) -> int:
    """Grows a region by neighbouring cells on its plane, then by all other cells on it; returns its number of cells.

    Cells that do not lie on the final plane are removed at the end.

    Args:
        cells: (R, C, 11) sums, see `_SUMS`; a cell of which entry 5 is 0 is not used.
        group: (R, C) number of each cell's region, changed in place: 0 where the cell is free, `name` where it belongs
            to this region, -1 where it was removed from one.
        name: Number of the region, of which one cell is marked already.
        variance: Variance of a sample's inverse depth, 1/m².
        total: (11,) sums of the region, at first those of its one cell; changed in place.
        plane: (3,) out: plane of the region.
    """
    rows, columns = group.shape
    inverse, buffers, count = np.zeros((3, 3)), np.empty((2, 3, 3)), 1
    _fit_plane(total, inverse, plane)
    # Passes over the image: first only neighbours join, until a pass adds none; then cells anywhere join as well.
    anywhere, grown = False, True
    while grown or not anywhere:
        anywhere = not grown
        grown = False
        for r in range(rows):
            for c in range(columns):
                if group[r, c] or cells[r, c, 5] == 0.0:
                    continue
                may_join = (
                    anywhere
                    or (r > 0 and group[r - 1, c] == name)
                    or (r + 1 < rows and group[r + 1, c] == name)
                    or (c > 0 and group[r, c - 1] == name)
                    or (c + 1 < columns and group[r, c + 1] == name)
                )
                if may_join and _plane_distance(cells[r, c], inverse, variance, plane, buffers) < _CELL_GATE:
                    group[r, c] = name
                    total += cells[r, c]
                    _fit_plane(total, inverse, plane)
                    count += 1
                    grown = True
    # Cells added early may not lie on the final plane, which counts as exact here.
    inverse[:] = 0.0
    for r in range(rows):
        for c in range(columns):
            if group[r, c] == name and _plane_distance(cells[r, c], inverse, variance, plane, buffers) > _CELL_GATE:
                group[r, c] = -1
                total -= cells[r, c]
                count -= 1
    return count


@njit(error_model="numpy", **INNER_KERNEL)
def read_planes(
    depth: NDArray[np.float32], rays: Array, side: int, min_depth_m: float, sd: float, planes: Array, weights: Array
) -> int:
    """Reads the largest planes of a depth image, which takes 0.4 ms.

    The image is divided into square cells, each with its own plane; regions of cells on a common plane are its planes.

    Args:
        depth: (H, W) m, 0 or NaN where none.
        rays: (R, C, 2) of `sample_pixels` on the plane at depth 1.
        side: Edge of a cell, samples: `SIDE`, or a divisor of it.
        min_depth_m: Nearest depth that counts.
        sd: Standard deviation of an inverse depth, 1/m.
        planes: (P, 3) out: inverse depth at (x, y) is its product with (x, y, 1); 1/m, largest first.
        weights: (P, 3, 3) out: inverse of the planes' covariances.

    Returns:
        Number of planes.
    """
    rows, columns = rays.shape[0] // side, rays.shape[1] // side
    # sums of each cell; number of its region, 0 while it has none, -1 where it was removed from one
    cells, group = np.empty((rows, columns, _SUMS)), np.zeros((rows, columns), np.int64)
    _sum_cells(depth, rays, side, min_depth_m, sd, cells)
    # Regions grow from the smoothest cells first: by the mean squared residual about the cell's own plane.
    score = np.empty(rows * columns)
    for i in range(len(score)):
        s = cells[i // columns, i % columns]
        score[i] = s[10] / s[5] if s[5] > 0.0 else math.inf
    count, name = 0, 0  # planes in the list so far; number of the newest region
    # number of cells of each plane in the list; sums, plane and inverse of the region that grows
    size, total, plane, inverse = np.zeros(len(planes)), np.empty(_SUMS), np.empty(3), np.empty((3, 3))
    for i in np.argsort(score):
        r, c = i // columns, i % columns
        if score[i] == math.inf:  # only unusable cells are left
            break
        if group[r, c]:  # part of a region, or removed from one
            continue
        name += 1
        group[r, c] = name
        copy(cells[r, c], total)
        n = _grow_region(cells, group, name, sd * sd, total, plane)
        if n < _MIN_CELLS or not _fit_plane(total, inverse, plane):
            continue
        # insertion by size; a plane smaller than all of a full list is left out
        at = min(count, len(planes))
        while at > 0 and size[at - 1] < n:
            at -= 1
        if at == len(planes):
            continue
        count = min(count + 1, len(planes))
        for k in range(count - 1, at, -1):
            size[k] = size[k - 1]
            copy(planes[k - 1], planes[k])
            copy_matrix(weights[k - 1], weights[k])
        # variance by the error of `PLANE_ERROR` of direction and distance, in each component
        error_variance = (PLANE_ERROR * PLANE_ERROR) * (plane[0] ** 2 + plane[1] ** 2 + plane[2] ** 2)
        size[at] = n
        copy(plane, planes[at])
        covariance = sd * sd * inverse
        for k in range(3):
            covariance[k, k] += error_variance
        copy_matrix(np.linalg.inv(covariance), weights[at])  # type: ignore[arg-type]
    return count
