"""From a height image to pieces of ground: long planes first, then the strips that are left between them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.compiled import INSIDE, cached
from stridetwin.estimators.terrain_map.cells import cell_sums, cluster
from stridetwin.estimators.terrain_map.plane_fit import SUMS, add_point, fit
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent

CELL = 4
"""Columns along the edge of a cell: 8 cm, a third of the shortest tread."""
_CELLS = 4
"""Fewest cells of a long plane."""
_SIGMAS = 3.0
"""How far a column may lie off its plane, or off its neighbour in a strip."""

Labels = NDArray[np.int32]
Heights = NDArray[np.float32]


def patches(
    height: Heights, noise: Heights, corner: Array, voxel_m: float, steepest: float, fewest: int, angle: float
) -> tuple[Labels, Array]:
    """Planes of the ground seen from above.

    Args:
        height: (n, n) m, NaN where nothing is seen; n a multiple of `CELL`.
        noise: (n, n) m, standard deviation of the heights.
        corner: (2,) m, grid axes, where column (0, 0) begins.
        voxel_m: Edge of a column.
        steepest: Steeper planes are no ground, rad.
        fewest: Columns of the smallest strip.
        angle: Neighbouring cells of one plane differ by less in direction, rad.

    Returns:
        (n, n) number of each column's plane, -1 where there is none; and (P, 11) sums over each plane's columns.
    """
    along = (np.arange(len(height), dtype=np.float32) + np.float32(0.5)) * np.float32(voxel_m)
    places = (along[:, None] + corner).astype(np.float32)
    found = cell_sums(places, height, noise, CELL)
    roots = cluster(found, angle)
    return _label(places, height, noise, roots, found.reshape(-1, SUMS), math.cos(steepest), fewest)


@cached(_HERE)
def _label(
    places: Heights, height: Heights, noise: Heights, roots: Labels, found: Array, least_up: float, fewest: int
) -> tuple[Labels, Array]:
    """Gives each column to the nearest of the planes around it, and what is left to strips."""
    rows, columns = roots.shape
    number = np.full(rows * columns, -1, np.int32)
    planes = np.empty((rows * columns, 4))
    count = 0
    for n in range(rows * columns):
        if found[n, 0] >= 0.7 * _CELLS * CELL * CELL:
            x, y, z, a, b, d, _ = fit(found[n])
            if d >= least_up:
                number[n] = count
                planes[count, 0], planes[count, 1], planes[count, 2] = a, b, d
                planes[count, 3] = a * x + b * y + d * z
                count += 1
    cells = np.full((rows, columns), -1, np.int32)
    for r in range(rows):
        for c in range(columns):
            if roots[r, c] >= 0:
                cells[r, c] = number[roots[r, c]]
    labels = np.full(height.shape, -1, np.int32)
    around = np.empty(9, np.int32)
    for r in range(rows):
        for c in range(columns):
            there, last = 0, -1
            for p in range(max(r - 1, 0), min(r + 2, rows)):
                for q in range(max(c - 1, 0), min(c + 2, columns)):
                    if cells[p, q] >= 0 and cells[p, q] != last:
                        last = cells[p, q]
                        around[there] = last
                        there += 1
            if there == 0:
                continue
            for i in range(r * CELL, (r + 1) * CELL):
                for j in range(c * CELL, (c + 1) * CELL):
                    x, y, z = places[i, 0], places[j, 1], height[i, j]
                    if math.isnan(z):
                        continue
                    nearest = _SIGMAS * noise[i, j]
                    for k in around[:there]:
                        off = abs(planes[k, 0] * x + planes[k, 1] * y + planes[k, 2] * z - planes[k, 3])
                        if off < nearest:
                            nearest = off
                            labels[i, j] = k
    sums = np.zeros((_strips(places, height, noise, labels, planes, count, least_up, fewest), SUMS))
    for i in range(height.shape[0]):
        for j in range(height.shape[1]):
            if labels[i, j] >= 0:
                add_point(sums[labels[i, j]], places[i, 0], places[j, 1], height[i, j], noise[i, j])
    return labels, sums


@njit(**INSIDE)
def _strips(
    places: Heights, height: Heights, noise: Heights, labels: Labels, planes: Array, count: int, least_up: float,
    fewest: int,
) -> int:  # fmt: skip
    """Labels connected columns of one height that belong to no long plane, or go on one that they touch.

    Returns:
        How many planes there are now.
    """
    n, m = labels.shape
    visited, long = labels >= 0, count
    stack = np.empty((n * m, 2), np.int32)
    sums = np.empty(SUMS)
    for i in range(n):
        for j in range(m):
            if visited[i, j] or math.isnan(height[i, j]):
                continue
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
                        elif not visited[p, q] and abs(height[p, q] - height[a, b]) < _SIGMAS * noise[p, q]:
                            visited[p, q] = True
                            stack[size, 0], stack[size, 1] = p, q
                            size += 1
            if size < fewest and not 0 <= beside < long:
                continue
            sums[:] = 0.0
            for s in range(size):
                p, q = stack[s]
                add_point(sums, places[p, 0], places[q, 1], height[p, q], noise[p, q])
            plane = fit(sums)
            limit = 4.0 * sums[10] / size
            if 0 <= beside < long:
                q = planes[beside]
                off = 0.0
                for s in range(size):
                    a, b = stack[s]
                    off += (q[0] * places[a, 0] + q[1] * places[b, 1] + q[2] * height[a, b] - q[3]) ** 2
                if off / size < limit:
                    for s in range(size):
                        labels[stack[s, 0], stack[s, 1]] = beside
                    continue
            if size < fewest:
                continue
            level = sums[9] / size - (sums[3] / size) ** 2 < limit  # too narrow to have a slope
            if level or (plane[5] >= least_up and plane[6] < limit):
                for s in range(size):
                    labels[stack[s, 0], stack[s, 1]] = count
                count += 1
    return count
