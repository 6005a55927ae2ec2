"""Compiled image kernels: corner selection, patch alignment, and depth and its slope at points.

Points tracked from image to image drift, because the errors of the steps add up. Alignment with the patch of the first
frame (inverse compositional, Baker & Matthews 2004), warped by motion and depth (as Forster et al. 2014), removes the
drift.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.streams.algebra.matrices import clear, clear_block, copy_matrix, inverse
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

# Hand-chosen on tuning seeds.
BORDER_PX = 10
"""No new point lies closer to the image's border; at least 5."""
CORNER_REACH_PX = 3
"""Half of the window for cornerness."""
_MAX_STEPS = 8  # of an alignment
_MIN_GAIN = 0.2  # contrast, as a share of the patch's
_MAX_STRETCH = 10.0  # a patch whose area changes by more than this factor is not aligned
_MAX_EDGE_PER_M = 0.04  # difference of inverse depths about a point; a larger one is an edge
_DEPTH_REACH_PX = 2  # half of the window of a depth
_SLOPE_REACH_PX, _SLOPE_STEP_PX = 8, 2  # half of the window of a slope, and between its samples


class AlignmentLimits(NamedTuple):
    """Limits of a patch alignment, in pixels of the resolution at which it takes place.

    Attributes:
        max_move_px: Largest distance of the result from the first guess.
        min_correlation: Smallest normalised correlation with the patch.
        settled_px: Smaller steps end the iteration.
    """

    max_move_px: float
    min_correlation: float
    settled_px: float


@njit(error_model="numpy", **INNER_KERNEL)
def cornerness(grey: NDArray[np.uint8], x: int, y: int, reach: int) -> tuple[float, float]:
    """Lesser and greater eigenvalue of the mean gradient tensor about a pixel (Shi and Tomasi 1994), (levels/px)².

    The mean is over the square of pixels up to `reach` away from (x, y), whose neighbours must be inside the image.
    """
    a, b, c = 0.0, 0.0, 0.0  # sums of the tensor [[a, b], [b, c]]
    for i in range(y - reach, y + reach + 1):
        for j in range(x - reach, x + reach + 1):
            dx = 0.5 * (float(grey[i, j + 1]) - float(grey[i, j - 1]))
            dy = 0.5 * (float(grey[i + 1, j]) - float(grey[i - 1, j]))
            a += dx * dx
            b += dx * dy
            c += dy * dy
    n = (2 * reach + 1) ** 2  # pixels
    # the eigenvalues of a symmetric (2, 2) matrix are the mean of its diagonal, plus and minus the second number
    mean, half = 0.5 * (a + c) / n, math.sqrt(0.25 * (a - c) ** 2 + b * b) / n
    return mean - half, mean + half


@njit(error_model="numpy", **INNER_KERNEL)
def cornerness_at(
    grey: NDArray[np.uint8], candidates: NDArray[np.float32], min_cornerness: float, min_roundness: float, score: Array
) -> None:
    """Scores candidates (N, 2) px by the lesser eigenvalue of `cornerness`, (levels/px)², into `score` (N,).

    The score is -1 where that eigenvalue is less than `min_cornerness`, or than the share `min_roundness` of the
    greater eigenvalue (along a straight edge a point can slide, or sticks to the jaggies of the image), or where the
    border is too close.
    """
    height, width = grey.shape
    for i in range(candidates.shape[0]):
        score[i] = -1.0
        x, y = int(candidates[i, 0]), int(candidates[i, 1])
        if BORDER_PX <= x < width - BORDER_PX and BORDER_PX <= y < height - BORDER_PX:
            least, most = cornerness(grey, x, y, CORNER_REACH_PX)
            if least >= min_cornerness and least >= min_roundness * most:
                score[i] = least


@njit(error_model="numpy", **INNER_KERNEL)
def _is_near(points: NDArray[np.float32], count: int, x: float, y: float, apart_px: float) -> bool:
    """Whether one of the first `count` points (N, 2) px is closer than `apart_px` to the pixel (x, y)."""
    k = 0
    while k < count and not (points[k, 0] - x) ** 2 + (points[k, 1] - y) ** 2 < apart_px * apart_px:
        k += 1
    return k < count


@njit(error_model="numpy", **INNER_KERNEL)
def pick(
    shape: tuple[int, int],
    candidates: NDArray[np.float32],
    order: NDArray[np.int64],
    taken: NDArray[np.float32],
    min_distance_px: float,
    filled: NDArray[np.int64],
    out: NDArray[np.float32],
) -> int:
    """Picks the best candidates, spread over the image: the best of each cell without a point, then the next best.

    A picked point is at least `min_distance_px` away from all others. A cell gets no further point once it has four,
    existing ones included.

    Args:
        shape: (H, W) of the image.
        candidates: (N, 2) px, points to pick from.
        order: (N,) indices of the candidates from the best.
        taken: (M, 2) px, existing points.
        min_distance_px: Smallest distance between two points.
        filled: (rows, columns) buffer, overwritten: number of points in each cell of the image.
        out: (wanted, 2) px, out: the picked points come first.

    Returns:
        Number of picked points.
    """
    height, width = shape
    rows, columns = filled.shape
    for r in range(rows):
        for c in range(columns):
            filled[r, c] = 0
    for i in range(taken.shape[0]):  # counts the existing points in their cells
        c = min(max(int(taken[i, 0] * columns / width), 0), columns - 1)
        r = min(max(int(taken[i, 1] * rows / height), 0), rows - 1)
        filled[r, c] += 1
    count = 0
    # Four rounds: in each, only cells with at most `most` points (0, then 1, 2, 3) may get another one.
    for most in range(4):
        for n in range(order.shape[0]):
            if count == out.shape[0]:
                break
            i = order[n]
            x, y = candidates[i, 0], candidates[i, 1]
            c, r = int(x * columns / width), int(y * rows / height)
            if filled[r, c] > most:
                continue
            if _is_near(taken, taken.shape[0], x, y, min_distance_px) or _is_near(out, count, x, y, min_distance_px):
                continue
            out[count, 0], out[count, 1] = x, y
            filled[r, c] += 1
            count += 1
    return count


@njit(error_model="numpy", **INNER_KERNEL)
def _sort(values: Array, n: int) -> None:
    """Sorts the first n values in place by insertion; n is small."""
    for i in range(1, n):
        value, at = values[i], i
        while at > 0 and values[at - 1] > value:
            values[at] = values[at - 1]
            at -= 1
        values[at] = value


@njit(error_model="numpy", **INNER_KERNEL)
def read_depth(
    depth: NDArray[np.float32], points: NDArray[np.float32], min_depth_m: float, max_depth_m: float, rho: Array
) -> None:
    """Median inverse depths about points (N, 2) px of a depth image (H, W) m, into `rho` (N,) 1/m.

    The result is 0 at depth edges, near the image's border, and where more than two of the depths about a point do not
    lie between `min_depth_m` and `max_depth_m`.
    """
    height, width = depth.shape
    reach = _DEPTH_REACH_PX
    values = np.empty((2 * reach + 1) ** 2)
    for i in range(len(points)):
        rho[i] = 0.0
        if not (abs(points[i, 0]) < 1e6 and abs(points[i, 1]) < 1e6):  # NaN, or too large for an integer
            continue
        x, y = int(points[i, 0] + 0.5), int(points[i, 1] + 0.5)
        if not (reach <= x < width - reach and reach <= y < height - reach):
            continue
        n = 0
        for r in range(y - reach, y + reach + 1):
            for c in range(x - reach, x + reach + 1):
                z = float(depth[r, c])
                if min_depth_m <= z <= max_depth_m:
                    values[n] = 1.0 / z
                    n += 1
        if n < len(values) - 2:
            continue
        _sort(values, n)
        if values[n - 1] - values[0] <= _MAX_EDGE_PER_M:
            rho[i] = values[n // 2]


REACH = 6  # px; half of a patch, a constant because the compiler unrolls its sums
PIXELS = (2 * REACH + 1) ** 2


@njit(error_model="numpy", **INNER_KERNEL)
def _interpolate(grey: NDArray[np.uint8], x: float, y: float) -> float:
    """Grey value at (x, y) px, bilinear; the four pixels around lie inside the image."""
    j, i = int(x), int(y)
    a, b = x - j, y - i
    top = (1.0 - a) * grey[i, j] + a * grey[i, j + 1]
    return (1.0 - b) * top + b * ((1.0 - a) * grey[i + 1, j] + a * grey[i + 1, j + 1])


class Patches(NamedTuple):
    """Appearance of points in the frame that first observed them.

    Attributes:
        basis: (L, PIXELS, 3) per pixel: gradient along x and y, and grey value, each minus its mean over the patch.
        inverse: (L, 3, 3) inverse of basisᵀ basis; 0 for patches without enough texture.
        power: (L,) sum of the squares of the grey values, minus their mean.
    """

    basis: NDArray[np.float32]
    inverse: Array
    power: Array


def blank_patches(slots: int) -> Patches:
    """Patches for so many landmark slots, without texture."""
    return Patches(np.zeros((slots, PIXELS, 3), np.float32), np.zeros((slots, 3, 3)), np.zeros(slots))


@njit(error_model="numpy", **INNER_KERNEL)
def _determinant(M: Array) -> float:
    """Determinant of a (3, 3) matrix."""
    a = M[1, 1] * M[2, 2] - M[1, 2] * M[2, 1]
    b = M[1, 0] * M[2, 2] - M[1, 2] * M[2, 0]
    c = M[1, 0] * M[2, 1] - M[1, 1] * M[2, 0]
    return M[0, 0] * a - M[0, 1] * b + M[0, 2] * c


@njit(error_model="numpy", **INNER_KERNEL)
def cut_patches(grey: NDArray[np.uint8], ids: NDArray[np.int64], points: NDArray[np.float32], patches: Patches) -> None:
    """Stores the patches about points (N, 2) px in slots `ids` (N,); outside the image, its border is replicated.

    Writes `basis`, `inverse` and `power` of `patches` for these slots. `inverse` is 0, and `align` fails, for a patch
    without enough texture.
    """
    height, width = grey.shape
    # T is the patch with one more pixel on each side for the gradients, of `side` pixels; H is basisᵀ basis. The limit
    # 1.001 px from the border keeps the next pixel, with which `_interpolate` averages, inside the image.
    side = 2 * REACH + 3
    T, mean, H = np.empty((side, side)), np.empty(3), np.empty((3, 3))
    for n in range(len(ids)):
        for i in range(side):
            for j in range(side):
                x = min(max(points[n, 0] + j - REACH - 1, 0.0), width - 1.001)
                y = min(max(points[n, 1] + i - REACH - 1, 0.0), height - 1.001)
                T[i, j] = _interpolate(grey, x, y)
        B = patches.basis[ids[n]]
        clear(mean)  # of each of the three columns of B over the patch
        k = 0  # pixel of the patch, row by row
        for i in range(1, side - 1):
            for j in range(1, side - 1):
                B[k, 0] = 0.5 * (T[i, j + 1] - T[i, j - 1])
                B[k, 1] = 0.5 * (T[i + 1, j] - T[i - 1, j])
                B[k, 2] = T[i, j]
                for c in range(3):
                    mean[c] += B[k, c] / PIXELS
                k += 1
        clear_block(H, 3)
        for k in range(PIXELS):
            for c in range(3):
                B[k, c] -= mean[c]
            for c in range(3):
                for d in range(3):
                    H[c, d] += B[k, c] * B[k, d]
        # a variance of more than one grey level², and gradients that determine a motion
        textured = H[2, 2] > PIXELS and _determinant(H) > 1e-6 * H[0, 0] * H[1, 1] * H[2, 2]
        if textured:
            copy_matrix(inverse(H), patches.inverse[ids[n]])
        else:
            clear_block(patches.inverse[ids[n]], 3)
        patches.power[ids[n]] = H[2, 2]


@njit(error_model="numpy", fastmath=True, **INNER_KERNEL)
def _correlate(
    grey: NDArray[np.uint8], x: float, y: float, M: Array, basis: NDArray[np.float32]
) -> tuple[float, float, float, float]:
    """Correlates the image about (x, y) px, warped by M (2, 2), with a patch's basis (PIXELS, 3).

    The basis has, per pixel of the patch, its gradient along x and y and its grey value, each minus its mean. M maps a
    pixel of the patch, relative to its middle, to one of the image, relative to (x, y).

    Returns:
        basisᵀ s (three numbers) for the warped grey values s, and Σ (s − mean)².
    """
    # (u, v) is where the first pixel of row i of the patch is in the image, (a, b) where pixel j is: bilinear between
    # the four pixels around. 128 is subtracted from the grey values so that 32 bit suffice.
    g0, g1, g2 = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    total, square = np.float32(0.0), np.float32(0.0)
    k = 0
    for i in range(-REACH, REACH + 1):
        u, v = x + M[0, 1] * i - M[0, 0] * REACH, y + M[1, 1] * i - M[1, 0] * REACH
        for j in range(2 * REACH + 1):
            a, b = np.float32(u + M[0, 0] * j), np.float32(v + M[1, 0] * j)
            c, r = int(a), int(b)
            a, b = a - np.float32(c), b - np.float32(r)
            p, q = np.float32(grey[r, c]), np.float32(grey[r + 1, c])
            top = p + a * (np.float32(grey[r, c + 1]) - p)
            low = q + a * (np.float32(grey[r + 1, c + 1]) - q)
            s = top + b * (low - top) - np.float32(128.0)
            total += s
            square += s * s
            g0 += basis[k, 0] * s
            g1 += basis[k, 1] * s
            g2 += basis[k, 2] * s
            k += 1
    # the basis has zero mean, so the image's mean need not be removed before
    return float(g0), float(g1), float(g2), float(square - total * total / PIXELS)


@njit(error_model="numpy", **INNER_KERNEL)
def align(
    grey: NDArray[np.uint8],
    patches: Patches,
    ids: NDArray[np.int64],
    warps: Array,
    limits: AlignmentLimits,
    points: NDArray[np.float32],
    good: NDArray[np.bool_],
) -> None:
    """Aligns points with their patches by inverse compositional Gauss-Newton.

    The warped image about a point is modelled as gain (T + dᵀ∇T) with the patch T. Least squares over the patch's basis
    give (gain d, gain) = (BᵀB)⁻¹ Bᵀ s, and the point moves by −M d until the steps are small. A point fails if it
    leaves the image or moves too far, or if gain, texture or correlation are too small.

    Args:
        grey: (H, W) image.
        patches: Stored by `cut_patches`.
        ids: (N,) slot of each point.
        warps: (N, 2, 2) M, from the patch's pixels to the image's.
        limits: Limits of the alignment.
        points: (N, 2) px, first guess in, result out.
        good: (N,) in and out: points that are False on entry are skipped, and False where the alignment fails.
    """
    height, width = grey.shape
    for l in range(len(ids)):
        if not good[l]:
            continue
        good[l] = False
        M, inverse, power = warps[l], patches.inverse[ids[l]], patches.power[ids[l]]
        stretch = M[0, 0] * M[1, 1] - M[0, 1] * M[1, 0]
        if not 1.0 / _MAX_STRETCH < stretch < _MAX_STRETCH or inverse[2, 2] == 0.0:
            continue
        # half of the warped patch's extent and 2 px of margin, within which the whole patch is inside the image
        reach_x = REACH * (abs(M[0, 0]) + abs(M[0, 1])) + 2
        reach_y = REACH * (abs(M[1, 0]) + abs(M[1, 1])) + 2
        x, y = float(points[l, 0]), float(points[l, 1])
        x0, y0 = x, y  # the first guess
        correlation = 0.0  # 0 means failure
        for _ in range(_MAX_STEPS):
            if not (reach_x < x < width - reach_x and reach_y < y < height - reach_y):
                correlation = 0.0
                break
            g0, g1, g2, power_image = _correlate(grey, x, y, M, patches.basis[ids[l]])
            correlation = g2 / math.sqrt(power_image * power + 1e-9)  # Σ T s / √(Σ T² Σ s²)
            # (gain d, gain) = (BᵀB)⁻¹ Bᵀ s: the patch, moved by d and scaled by a gain
            d0 = inverse[0, 0] * g0 + inverse[0, 1] * g1 + inverse[0, 2] * g2
            d1 = inverse[1, 0] * g0 + inverse[1, 1] * g1 + inverse[1, 2] * g2
            gain = inverse[2, 0] * g0 + inverse[2, 1] * g1 + inverse[2, 2] * g2
            if gain < _MIN_GAIN:
                correlation = 0.0
                break
            d0, d1 = d0 / gain, d1 / gain
            # the patch's coordinates move by d, so the point moves by -M d
            mx, my = M[0, 0] * d0 + M[0, 1] * d1, M[1, 0] * d0 + M[1, 1] * d1
            x, y = x - mx, y - my
            if math.hypot(x - x0, y - y0) > limits.max_move_px:
                correlation = 0.0
                break
            if math.hypot(mx, my) < limits.settled_px:
                break
        if correlation >= limits.min_correlation:
            points[l, 0], points[l, 1] = x, y
            good[l] = True


def read_slope(
    depth: NDArray[np.float32], points: NDArray[np.float32], min_depth_m: float, max_depth_m: float, roughness: float
) -> Array:
    """(N, 2) gradients of the inverse depth about points (N, 2) px along x and y, 1/m per pixel, by least squares.

    Inverse depth is linear in the image of a plane. The gradient is 0 where the scatter about a plane exceeds
    `roughness`, 1/m. It is also 0 near the image's border, and where one of the depths sampled about the point does not
    lie between `min_depth_m` and `max_depth_m`. `depth` is (H, W), m.
    """
    reach, (height, width) = _SLOPE_REACH_PX, depth.shape
    at = np.floor(points.astype(float) + 0.5).astype(int)  # (N, 2) nearest pixels
    is_inside = ((at >= reach) & (at < (width - reach, height - reach))).all(axis=1)
    inside = np.flatnonzero(is_inside)  # indices of the points far enough from the border
    steps = np.arange(-reach, reach + 1, _SLOPE_STEP_PX)
    columns, rows = (a.ravel() for a in np.meshgrid(steps, steps))  # (S,) offsets of the samples about a point, px
    # (M, S) m, depths of the samples about each point that is inside
    z = depth[at[inside, 1, None] + rows, at[inside, 0, None] + columns].astype(float)
    is_complete = ((z >= min_depth_m) & (z <= max_depth_m)).all(axis=1)
    inverse_depth, inside = 1.0 / z[is_complete], inside[is_complete]
    # The samples are symmetric about the point: both gradients are independent, and `columns` and `rows` alike.
    gradient = inverse_depth @ np.column_stack([columns, rows]) / (columns @ columns)
    # variance of the samples about the plane: their variance less that by the gradient
    scatter = inverse_depth.var(axis=1) - (gradient**2).sum(axis=1) * (columns @ columns) / len(columns)
    slope = np.zeros((len(points), 2))
    slope[inside] = np.where(scatter[:, None] < roughness**2, gradient, 0.0)
    return slope
