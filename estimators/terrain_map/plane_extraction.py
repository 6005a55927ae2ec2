"""Planes of an organised grid of points by agglomerative hierarchical clustering of cells (Feng et al., ICRA 2014).

The grid is divided into cells. A cell without a height step, whose points fit a plane, is a node. Neighbouring nodes
whose planes agree are merged, best pair first, as long as their common plane fits. Pairs that are mutually best are
merged in one round, which costs one pass over the edges. In a height image, large planes are extracted first, then
the strips between them.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.plane_fit import SUMS, add_point, fit_plane, plane_misfit
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent


Labels = NDArray[np.int32]
"""(n, m) number of the plane of each point of a grid, -1 = none."""
Points = NDArray[np.float32]
"""(n, m, 3) m, points of a grid, NaN = no point; or (n, m) m, heights or noise of the points."""
CELL = 4
"""Points along the edge of a cell; from above 8 cm, a third of the shortest tread."""
_VALID_SHARE = 0.7
"""Smallest share of valid points in a cell, and of full cells in a large plane."""
_CELL_ANGLE_RAD = math.radians(7.0)
"""θ of docs/terrain_map.md (6): largest angle between two merged planes, beyond what their noise explains."""
_TILT_GATE_SD = 2.0
"""What noise explains in docs/terrain_map.md (6): standard deviations of the difference of two tilts."""
_DISTANCE_GATE_SD = 3.0
"""Largest distance of a column from its plane, or from its neighbour in a strip, in standard deviations."""
_MIN_CELLS = 4
"""Smallest number of cells of a large plane."""
_STRIP_VARIANCE = 4.0
"""Largest mean squared distance of a strip's columns from their plane, divided by their variance."""
_MIN_AREA_M2 = 0.012
"""Smallest area of a plane: a strip of a tread, seen past the edge of the tread above."""


def min_columns(voxel_size_m: float) -> int:
    """Smallest number of columns of a plane, for columns of `voxel_size_m`."""
    return round(_MIN_AREA_M2 / voxel_size_m**2)


@entry_kernel(_HERE, error_model="numpy")
def cell_sums(points: Points, noise: Points) -> Array:
    """Sums over the points of each cell that fits a plane.

    A cell is a node if enough of its points are valid, none lies off the plane by more than `_DISTANCE_GATE_SD`
    standard deviations, and its mean squared distance from the plane is no greater than the variance of its noise.

    Args:
        points: (n, m, 3) m, NaN = no point.
        noise: (n, m) m, standard deviation of a point.

    Returns:
        (n // CELL, m // CELL, 11) sums, see `plane_fit.SUMS`; 0 where the cell is not a node.
    """
    rows, columns = noise.shape[0] // CELL, noise.shape[1] // CELL
    cells = np.zeros((rows, columns, SUMS))
    for r in range(rows):
        for c in range(columns):
            sums = cells[r, c]
            for i in range(r * CELL, (r + 1) * CELL):
                for j in range(c * CELL, (c + 1) * CELL):
                    if not math.isnan(points[i, j, 2]):
                        add_point(sums, points[i, j, 0], points[i, j, 1], points[i, j, 2], noise[i, j])
            if sums[0] < _VALID_SHARE * CELL * CELL:  # entry 0 is the number of points
                sums[:] = 0.0
                continue
            # centre (x, y, z) and normal (a, b, d); mean squared distance from the plane, and what noise explains of it
            x, y, z, a, b, d, error = fit_plane(sums)
            variance = sums[10] / sums[0]  # mean of the points' own variances, m²
            fits, limit = error <= variance, _DISTANCE_GATE_SD * math.sqrt(variance)
            for i in range(r * CELL, (r + 1) * CELL):
                for j in range(c * CELL, (c + 1) * CELL):
                    off = a * (points[i, j, 0] - x) + b * (points[i, j, 1] - y) + d * (points[i, j, 2] - z)
                    fits = fits and not abs(off) > limit  # a missing point, NaN, fits
            if not fits:
                sums[:] = 0.0
    return cells


@njit(error_model="numpy", **INNER_KERNEL)
def _tilt_variance(s: Array) -> float:
    """Variance of a plane's tilt, rad², in the direction in which its points extend least.

    It is the variance of the mean of n points over their variance along that direction in the plane.

    Args:
        s: (11,) sums over the points, see `plane_fit.SUMS`: 0 n; 1-3 x, y, z; 4-9 xx, xy, xz, yy, yz, zz; 10 the sum of
            the points' own variances, m².
    """
    n = s[0]
    # covariance of the points [[a, e, f], [e, b, g], [f, g, d]]
    a, b, d = s[4] / n - (s[1] / n) ** 2, s[7] / n - (s[2] / n) ** 2, s[9] / n - (s[3] / n) ** 2
    e, f, g = s[5] / n - s[1] * s[2] / n**2, s[6] / n - s[1] * s[3] / n**2, s[8] / n - s[2] * s[3] / n**2
    # The smallest of three eigenvalues is near 0: the middle one follows from their sum and the sum of their products.
    total, products = a + b + d, a * b + a * d + b * d - e * e - f * f - g * g
    middle = 0.5 * (total - math.sqrt(max(total * total - 4.0 * products, 0.0)))
    return s[10] / n / n / max(middle, 1e-9)


@entry_kernel(_HERE, error_model="numpy")
def cluster(cells: Array) -> NDArray[np.int32]:
    """Merges neighbouring cells into planes by agglomerative clustering, docs/terrain_map.md (6).

    Args:
        cells: (R, C, 11) sums of the cells, see `plane_fit.SUMS`; modified: the root cell holds the plane's sums.

    Returns:
        (R, C) root cell of each cell's plane, as index r * C + c; -1 = none.
    """
    rows, columns = cells.shape[:2]
    sums = cells.reshape(rows * columns, SUMS)
    root = np.full(rows * columns, -1, np.int32)
    normals, tilt_variance = np.zeros((rows * columns, 3)), np.zeros(rows * columns)
    for n in range(len(root)):
        if sums[n, 0] > 0:
            root[n] = n
            _, _, _, normals[n, 0], normals[n, 1], normals[n, 2], _ = fit_plane(sums[n])
            tilt_variance[n] = _tilt_variance(sums[n])
    # pairs of neighbouring planes, as their root cells
    edges = np.empty((2 * len(root), 2), np.int32)
    count = 0
    for r in range(rows):
        for c in range(columns):
            n = r * columns + c
            if root[n] < 0:
                continue
            if c + 1 < columns and root[n + 1] >= 0:
                edges[count, 0], edges[count, 1] = n, n + 1
                count += 1
            if r + 1 < rows and root[n + columns] >= 0:
                edges[count, 0], edges[count, 1] = n, n + columns
                count += 1
    costs = np.full(count, -1.0)  # cost of merging an edge's planes; -1 unknown, inf not allowed
    # per plane: its best edge, or -2 - a after it was merged into plane a; `met` is the last neighbour seen
    best, met = np.empty(len(root), np.int64), np.empty(len(root), np.int64)
    common = np.empty(SUMS)
    while True:
        # the cheapest edge of each plane
        best[:] = -1
        for e in range(count):
            a, b = edges[e]
            if costs[e] < 0.0:  # unknown: infinite, unless the normals agree and the common plane fits
                costs[e] = np.inf
                dot = normals[a, 0] * normals[b, 0] + normals[a, 1] * normals[b, 1] + normals[a, 2] * normals[b, 2]
                if 1.0 - dot * dot <= _CELL_ANGLE_RAD**2 + _TILT_GATE_SD**2 * (tilt_variance[a] + tilt_variance[b]):
                    for s in range(SUMS):
                        common[s] = sums[a, s] + sums[b, s]
                    error = plane_misfit(common)
                    if error <= common[10] / common[0]:  # mean of the points' own variances, m²
                        costs[e] = error
            if costs[e] < np.inf:
                if best[a] < 0 or costs[e] < costs[best[a]]:
                    best[a] = e
                if best[b] < 0 or costs[e] < costs[best[b]]:
                    best[b] = e
        merged = False
        for e in range(count):
            a, b = edges[e]
            if best[a] == e and best[b] == e:  # the cheapest edge of both its planes: b is merged into a
                for s in range(SUMS):
                    sums[a, s] += sums[b, s]
                    sums[b, s] = 0.0
                root[b] = a
                _, _, _, normals[a, 0], normals[a, 1], normals[a, 2], _ = fit_plane(sums[a])
                tilt_variance[a] = _tilt_variance(sums[a])
                best[a] = best[b] = -2 - a  # both are the new plane a
                merged = True
        if not merged:
            break
        # Edges of merged planes now belong to the new plane, and their costs are unknown. An edge to the neighbour seen
        # last is a double and removed; doubles with others between them stay, which costs only time.
        kept = 0
        met[:] = -1
        for e in range(count):
            a, b = edges[e]
            new = best[a] < -1 or best[b] < -1
            a = -2 - best[a] if best[a] < -1 else a
            b = -2 - best[b] if best[b] < -1 else b
            low, high = min(a, b), max(a, b)
            if a != b and met[low] != high:  # a long border has many edges
                met[low] = high
                edges[kept, 0], edges[kept, 1] = a, b
                costs[kept] = -1.0 if new else costs[e]
                kept += 1
        count = kept
    # Each merged cell points to the plane it was merged into: follow these links to the end.
    for n in range(len(root)):
        if root[n] >= 0:
            while root[n] != root[root[n]]:
                root[n] = root[root[n]]
    return root.reshape(rows, columns)


def extract_large_planes(points: Points, noise: Points, p: TerrainMapParameters) -> tuple[Labels, Array]:
    """Extracts walkable planes of several cells from an organised grid of points.

    Args:
        points: (n, m, 3) m, grid axes, NaN = no point; n and m are multiples of `CELL`.
        noise: (n, m) m, standard deviation of a point.
        p: Largest slope.

    Returns:
        (n, m) number of each point's plane, -1 = none; and (P, 4) planes a x + b y + c z = d.
    """
    cells = cell_sums(points, noise)
    roots = cluster(cells)  # `cells` now holds the sums of each plane at its root cell
    return _label_points(points, noise, roots, cells.reshape(-1, SUMS), math.cos(p.max_ramp_slope_rad))


def extract_planes(points: Points, noise: Points, p: TerrainMapParameters) -> tuple[Labels, Array]:
    """Extracts the planes of the ground from a top view: large planes, then strips between them.

    Args:
        points: (n, m, 3) m, grid axes, NaN = no point; n and m are multiples of `CELL`.
        noise: (n, m) m, standard deviation of a point.
        p: Largest slope, and size of a column.

    Returns:
        (n, m) number of each column's plane, -1 = none; and (P, 11) sums over each plane's columns.
    """
    labels, planes = extract_large_planes(points, noise, p)
    fewest = min_columns(p.voxel_size_m)
    # changes `labels`, too; the number of planes afterwards
    count = _label_strips(points, noise, labels, planes, math.cos(p.max_ramp_slope_rad), fewest)
    return labels, plane_sums(points, noise, labels, count)


def column_points(height: Points, first: NDArray[np.int64], voxel_m: float) -> Points:
    """(n, n, 3) m, middles of the columns of a height image.

    Args:
        height: (n, n) m, NaN where unobserved; the z of the points.
        first: (2,) column of the image's corner; column (i, j) begins at (i, j) `voxel_m`.
        voxel_m: Edge of a column.
    """
    from_corner = (np.arange(len(height), dtype=np.float32) + np.float32(0.5)) * np.float32(voxel_m)
    places = (from_corner[:, None] + first.astype(float) * voxel_m).astype(np.float32)  # (n, 2) m
    points = np.empty((*height.shape, 3), np.float32)
    points[..., 0], points[..., 1], points[..., 2] = places[:, :1], places[:, 1], height
    return points


@entry_kernel(_HERE)
def plane_sums(points: Points, noise: Points, labels: Labels, count: int) -> Array:
    """(count, 11) sums over the points of each plane, see `plane_fit.SUMS`; points with label -1 belong to none."""
    sums = np.zeros((count, SUMS))
    for i in range(labels.shape[0]):
        for j in range(labels.shape[1]):
            if labels[i, j] >= 0:
                add_point(sums[labels[i, j]], points[i, j, 0], points[i, j, 1], points[i, j, 2], noise[i, j])
    return sums


@entry_kernel(_HERE)
def _label_points(points: Points, noise: Points, roots: Labels, sums: Array, least_up: float) -> tuple[Labels, Array]:
    """Assigns each point to the nearest walkable plane of the cells around it.

    Args:
        points: (n, m, 3) m, grid axes, NaN = no point.
        noise: (n, m) m, standard deviation of each point.
        roots: (R, C) root cell of each cell's plane, from `cluster`.
        sums: (R C, 11) sums of the planes at their root cells.
        least_up: Smallest z of a walkable plane's normal.

    Returns:
        (n, m) number of each point's plane, -1 = none; (P, 4) planes a x + b y + c z = d.
    """
    rows, columns = roots.shape
    number = np.full(rows * columns, -1, np.int32)  # of the walkable plane at each root cell
    planes = np.empty((rows * columns, 4))
    count = 0
    for n in range(rows * columns):
        if sums[n, 0] >= _VALID_SHARE * _MIN_CELLS * CELL * CELL:  # the least number of points of a large plane
            x, y, z, a, b, d, _ = fit_plane(sums[n])
            if d >= least_up:
                number[n] = count
                planes[count, 0], planes[count, 1], planes[count, 2] = a, b, d
                planes[count, 3] = a * x + b * y + d * z
                count += 1
    cells = np.full((rows, columns), -1, np.int32)  # number of each cell's walkable plane
    for r in range(rows):
        for c in range(columns):
            if roots[r, c] >= 0:
                cells[r, c] = number[roots[r, c]]
    labels = np.full(noise.shape, -1, np.int32)
    near_planes = np.empty(9, np.int32)
    for r in range(rows):
        for c in range(columns):
            # planes of the cell and of its eight neighbours; one may be listed twice, which does no harm
            near_count, last = 0, -1
            for p in range(max(r - 1, 0), min(r + 2, rows)):
                for q in range(max(c - 1, 0), min(c + 2, columns)):
                    if cells[p, q] >= 0 and cells[p, q] != last:
                        last = cells[p, q]
                        near_planes[near_count] = last
                        near_count += 1
            if near_count == 0:
                continue
            for i in range(r * CELL, (r + 1) * CELL):
                for j in range(c * CELL, (c + 1) * CELL):
                    x, y, z = points[i, j, 0], points[i, j, 1], points[i, j, 2]
                    if math.isnan(z):
                        continue
                    nearest = _DISTANCE_GATE_SD * noise[i, j]  # a plane farther away is not the point's
                    for k in near_planes[:near_count]:
                        off = abs(planes[k, 0] * x + planes[k, 1] * y + planes[k, 2] * z - planes[k, 3])
                        if off < nearest:
                            nearest = off
                            labels[i, j] = k
    return labels, planes[:count]


@entry_kernel(_HERE)
def _label_strips(points: Points, noise: Points, labels: Labels, planes: Array, least_up: float, fewest: int) -> int:
    """Labels connected columns of one height outside the large planes, or adds them to an adjacent large plane.

    Columns are connected if they are at most two apart and of the same height within their noise. They join the large
    plane beside them if they lie on it. Otherwise they become a plane of their own if they are many enough, and level
    or walkable.

    Args:
        points: (n, m, 3) m, grid axes, NaN = no point.
        noise: (n, m) m, standard deviation of each point.
        labels: (n, m) number of each point's plane, -1 = none; changed in place.
        planes: (P, 4) large planes a x + b y + c z = d.
        least_up: Smallest z of a walkable plane's normal.
        fewest: Smallest number of columns of a strip.

    Returns:
        The new number of planes.
    """
    count = len(planes)
    n, m = labels.shape
    visited, long = labels >= 0, count  # `long` is the number of large planes
    stack = np.empty((n * m, 2), np.int32)
    sums = np.empty(SUMS)
    for i in range(n):
        for j in range(m):
            if visited[i, j] or math.isnan(points[i, j, 2]):
                continue
            # breadth-first search: `size` columns found, `head` of them expanded; `beside` is a plane next to them
            size, head, beside = 1, 0, -1
            stack[0, 0], stack[0, 1] = i, j
            visited[i, j] = True
            while head < size:
                a, b = stack[head]
                head += 1
                for p in range(max(a - 2, 0), min(a + 3, n)):
                    for q in range(max(b - 2, 0), min(b + 3, m)):
                        if labels[p, q] >= 0:
                            beside = labels[p, q]
                        elif (
                            not visited[p, q]
                            and abs(points[p, q, 2] - points[a, b, 2]) < _DISTANCE_GATE_SD * noise[p, q]
                        ):
                            visited[p, q] = True
                            stack[size, 0], stack[size, 1] = p, q
                            size += 1
            if size < fewest and not 0 <= beside < long:  # too few for a plane, and no large plane beside them
                continue
            sums[:] = 0.0
            for s in range(size):
                p, q = stack[s]
                add_point(sums, points[p, q, 0], points[p, q, 1], points[p, q, 2], noise[p, q])
            plane = fit_plane(sums)
            limit = _STRIP_VARIANCE * sums[10] / size  # largest mean squared distance from a plane, m²
            if 0 <= beside < long:
                q = planes[beside]  # (4,) a, b, c, d
                off = 0.0  # sum of the squared distances from the plane beside, m²
                for s in range(size):
                    a, b = stack[s]
                    off += (q[0] * points[a, b, 0] + q[1] * points[a, b, 1] + q[2] * points[a, b, 2] - q[3]) ** 2
                if off / size < limit:
                    for s in range(size):
                        labels[stack[s, 0], stack[s, 1]] = beside
                    continue
            if size < fewest:
                continue
            # of one height within noise: too narrow to have a slope
            level = sums[9] / size - (sums[3] / size) ** 2 < limit
            # 5 is the normal's z, 6 the mean squared distance
            if level or (plane[5] >= least_up and plane[6] < limit):
                for s in range(size):
                    labels[stack[s, 0], stack[s, 1]] = count
                count += 1
    return count
