"""Compiled looks at pictures: the best corner of each cell, and depth where it can be trusted."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.compiled import INSIDE
from stridetwin.streams.samples import Array

_REACH = 3  # px; half of the window in which a corner is judged
_DEPTH_REACH = 2


@njit(error_model="numpy", **INSIDE)
def cornerness(grey: NDArray[np.uint8], x: int, y: int) -> float:
    """Lesser eigenvalue of the mean gradient tensor about a pixel (Shi and Tomasi 1994), grey levels² a pixel²."""
    a, b, c = 0.0, 0.0, 0.0
    for i in range(y - _REACH, y + _REACH + 1):
        for j in range(x - _REACH, x + _REACH + 1):
            dx = 0.5 * (float(grey[i, j + 1]) - float(grey[i, j - 1]))
            dy = 0.5 * (float(grey[i + 1, j]) - float(grey[i - 1, j]))
            a += dx * dx
            b += dx * dy
            c += dy * dy
    n = (2 * _REACH + 1) ** 2
    return (0.5 * (a + c) - math.sqrt(0.25 * (a - c) ** 2 + b * b)) / n


@njit(error_model="numpy", **INSIDE)
def pick(
    grey: NDArray[np.uint8],
    candidates: NDArray[np.float32],
    taken: NDArray[np.float32],
    columns: int,
    rows: int,
    apart: float,
    margin: int,
    least: float,
    wanted: int,
    out: NDArray[np.float32],
) -> int:
    """The best candidates, spread over the picture: the best of each cell that has none, then the next best.

    Args:
        grey: (H, W).
        candidates: (N, 2) px.
        taken: (M, 2) px, points that there are already.
        columns: Of cells.
        rows: Of cells.
        apart: Least distance between two points, px.
        margin: From the picture's edge, px, ≥ 5.
        least: Cornerness of a point.
        wanted: How many.
        out: (wanted, 2) px.

    Returns:
        How many there are.
    """
    height, width = grey.shape
    n = len(candidates)
    score = np.full(n, -1.0)
    for i in range(n):
        x, y = int(candidates[i, 0]), int(candidates[i, 1])
        if margin <= x < width - margin and margin <= y < height - margin:
            s = cornerness(grey, x, y)
            if s >= least:
                score[i] = s
    order = np.argsort(-score)
    filled = np.zeros((rows, columns), np.int64)
    for i in range(len(taken)):
        c = min(max(int(taken[i, 0] * columns / width), 0), columns - 1)
        r = min(max(int(taken[i, 1] * rows / height), 0), rows - 1)
        filled[r, c] += 1
    count = 0
    for most in range(4):
        for i in order:
            if count == wanted or score[i] < 0.0:
                break
            x, y = candidates[i]
            c, r = int(x * columns / width), int(y * rows / height)
            if filled[r, c] > most:
                continue
            near = False
            for k in range(len(taken)):
                if (taken[k, 0] - x) ** 2 + (taken[k, 1] - y) ** 2 < apart * apart:
                    near = True
                    break
            for k in range(count):
                if (out[k, 0] - x) ** 2 + (out[k, 1] - y) ** 2 < apart * apart:
                    near = True
                    break
            if near:
                continue
            out[count, 0], out[count, 1] = x, y
            filled[r, c] += 1
            count += 1
    return count


@njit(error_model="numpy", **INSIDE)
def read_depth(
    depth: NDArray[np.float32], points: NDArray[np.float32], least: float, most: float, spread: float, told: Array
) -> None:
    """Inverse depth at points, where all about them is one smooth surface.

    Args:
        depth: (H, W) m, 0 or NaN where none.
        points: (N, 2) px.
        least: Nearest depth that counts, m.
        most: Farthest.
        spread: Largest difference of inverse depths about a point, 1/m; beyond it there is an edge.
        told: (N,) out: median of the inverse depths, 1/m; 0 where none.
    """
    height, width = depth.shape
    values = np.empty((2 * _DEPTH_REACH + 1) ** 2)
    for i in range(len(points)):
        told[i] = 0.0
        if not (abs(points[i, 0]) < 1e6 and abs(points[i, 1]) < 1e6):
            continue
        x, y = int(points[i, 0] + 0.5), int(points[i, 1] + 0.5)
        if not (_DEPTH_REACH <= x < width - _DEPTH_REACH and _DEPTH_REACH <= y < height - _DEPTH_REACH):
            continue
        n = 0
        for r in range(y - _DEPTH_REACH, y + _DEPTH_REACH + 1):
            for c in range(x - _DEPTH_REACH, x + _DEPTH_REACH + 1):
                z = float(depth[r, c])
                if least <= z <= most:
                    values[n] = 1.0 / z
                    n += 1
        if n < len(values) - 2:
            continue
        ordered = np.sort(values[:n])
        if ordered[n - 1] - ordered[0] <= spread:
            told[i] = ordered[n // 2]
