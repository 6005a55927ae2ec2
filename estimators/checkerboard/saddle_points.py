"""Subpixel fit of checkerboard corners, with their covariance."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import erf

from stridetwin.streams.algebra.matrices import clear, clear_block, solve_damped
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Array

X, Y, MEAN, STEP, BLUR_U, BLUR_V, RMS, V_XX, V_XY, V_YY, OK = range(11)
COLUMNS = 11
"""Number of columns of a fit: `X`, `Y`, corner, pixels; `MEAN`, `STEP`, mean brightness, and half the step from dark to
bright squares; `BLUR_U`, `BLUR_V`, blur across both families of edges, squares; `RMS`, residual of the brightness;
`V_XX`, `V_XY`, `V_YY`, covariance of the corner for grey values of variance 1, px²; `OK`, 1 if the fit is valid."""

_UNKNOWNS = 6  # x, y, mean, contrast, blur across u, blur across v


# The fit of one corner to the image; hand-chosen.
_HALF = 0.55  # a corner is fitted to the image within this distance of it along both edges, squares
_MIN_PIXELS = 12  # there
_MIN_BLUR, _MAX_BLUR = 0.02, 0.6  # squares
# Information of the prior on the blur, over the contrast squared: the blur of a corner of few pixels is not observable.
_BLUR_INFORMATION = 0.1
_DAMPING = 1e-3  # of the Gauss-Newton steps, relative
_MAX_STEP = 0.2  # of the corner, squares
_POSITION_ROUNDS = 2  # before the blur is fitted too: far from the corner it would shrink
_ROUNDS = 7  # at most
_SETTLED_PX = 3e-3  # smaller steps end the fit: quadratic convergence, so the next step would be a thousandth of this
_SAMPLE_BLURS = 1.5  # distance between the samples of an average over a motion, as a multiple of the blur
_MAX_SAMPLES = 12
_SPARSE_PX2 = 64.0  # larger squares that are smeared use every other pixel each way

_Z_MAX, _PER_Z = 4.0, 64  # the tables below reach from -4 to 4 standard deviations, with 64 entries in each
_Z = np.linspace(-_Z_MAX, _Z_MAX, int(2 * _Z_MAX * _PER_Z) + 1)
# an edge from -1 to 1 at z = 0, smoothed by a Gaussian of standard deviation 1, and its slope; `_PER_Z` entries a unit
_STEP_TABLE = np.append(erf(_Z / math.sqrt(2.0)), 1.0)  # a table is exact to 3e-5 and ten times faster
_BELL_TABLE = np.append(math.sqrt(2.0 / math.pi) * np.exp(-0.5 * _Z * _Z), 0.0)


@entry_kernel(Path(__file__).parent)
def fit_corners(
    image: NDArray[np.uint8], start: Array, edges: Array, colour: Array, blur: Array, motion: Array, fit_blur: bool
) -> Array:
    """Fits the brightness around every corner; unknown are the corner's position, two brightnesses and the blur.

    Around a corner the image of a checkerboard is a + b s(u) s(v): u and v count squares along the board's axes from
    the corner, and s is a square wave smoothed by the Gaussian of pixel, lens and motion, whose width differs between
    the two families of edges. A motion across both families smears the corner along its own direction, so the product
    is averaged over the motion.

    Args:
        image: (H, W) grey.
        start: (N, 2) predicted corners, pixels.
        edges: (N, 2, 2) one square along u (first row) and along v (second), pixels.
        colour: (N,) +1 where the square at +u, +v of the corner is bright, -1 where it is dark.
        blur: (2,) initial standard deviation of the blur across the edges u = 0 and v = 0, squares.
        motion: (2,) motion of the board during the exposure along u and v, squares, if not part of `blur`.
        fit_blur: Whether the blur of each corner is fitted; otherwise it is fixed.

    Returns:
        (N, COLUMNS) fits; rows that are not OK left the image or fit no corner of the right colours.
    """
    fits = np.zeros((len(start), COLUMNS))
    for n in range(len(start)):
        if math.isfinite(start[n, 0] + start[n, 1]):
            _fit_corner(image, start[n], edges[n], colour[n], blur, motion, fit_blur, fits[n])
    return fits


@njit(error_model="numpy", **INNER_KERNEL)
def _square_wave(u: float, sd: float) -> tuple[float, float, float]:
    """Square wave of period 2 that rises at 0, smoothed by a Gaussian.

    Args:
        u: Place, |u| < 2.
        sd: Standard deviation of the Gaussian.

    Returns:
        Value s(u), slope ds/du, and derivative ds/dsd.
    """
    # Edges are at whole numbers k, and rise at even ones. Only those from first to last are smoothed as far as u; the
    # others, of -2 to 2, count as ±1 in the initial value.
    first = max(math.ceil(u - _Z_MAX * sd), -2)  # the first edge that is smoothed as far as u
    last = min(math.floor(u + _Z_MAX * sd), 2)
    value, slope, by_sd = float((first + 2) % 2 - (2 - last) % 2), 0.0, 0.0
    sign = 1.0 if first % 2 == 0 else -1.0
    for k in range(first, last + 1):
        z = (u - k) / sd  # distance from the edge in standard deviations
        # linear interpolation in the tables of a smoothed edge and of its slope
        at = (min(max(z, -_Z_MAX), _Z_MAX) + _Z_MAX) * _PER_Z
        i = int(at)
        fraction = at - i
        value += sign * (_STEP_TABLE[i] + fraction * (_STEP_TABLE[i + 1] - _STEP_TABLE[i]))
        bell = sign * (_BELL_TABLE[i] + fraction * (_BELL_TABLE[i + 1] - _BELL_TABLE[i])) / sd
        slope += bell
        by_sd -= z * bell
        sign = -sign
    return value, slope, by_sd


@njit(error_model="numpy", **INNER_KERNEL)
def _fit_corner(
    image: NDArray[np.uint8],
    start: Array,
    edges: Array,
    colour: float,
    blur: Array,
    motion: Array,
    fit_blur: bool,
    out: Array,
) -> None:
    """Fits the brightness around one corner by Gauss-Newton: minimises Σ (grey - a - b s(u) s(v))².

    There is no fit if the image does not contain all around the corner, has too few pixels there, shows no corner of
    the right colours, or one far from the prediction.

    Args:
        image: (H, W) grey.
        start: (2,) predicted corner, pixels.
        edges: (2, 2) one square along u (first row) and along v (second), pixels.
        colour: +1 where the square at +u, +v of the corner is bright, -1 where it is dark.
        blur: (2,) initial standard deviation of the blur across the edges u = 0 and v = 0, squares.
        motion: (2,) motion of the board during the exposure along u and v, squares.
        fit_blur: Whether the blur is fitted; otherwise it is fixed.
        out: (COLUMNS,) out: the fit, whose entries are `X` to `OK`; it stays 0 without one.
    """
    height, width = image.shape
    area = edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0]  # of a square, px²
    if abs(area) < 1.0:  # the board is seen edge-on
        return
    ux, uy = edges[1, 1] / area, -edges[1, 0] / area  # gradients of u and v in the image
    vx, vy = -edges[0, 1] / area, edges[0, 0] / area
    # the box of pixels around the area that is fitted
    reach_x = _HALF * (abs(edges[0, 0]) + abs(edges[1, 0]))
    reach_y = _HALF * (abs(edges[0, 1]) + abs(edges[1, 1]))
    left, right = math.floor(start[0] - reach_x), math.ceil(start[0] + reach_x)
    top, bottom = math.floor(start[1] - reach_y), math.ceil(start[1] + reach_y)
    if left < 0 or top < 0 or right >= width or bottom >= height:
        return
    # number of places at which the motion is sampled, and distance of the pixels used
    samples = min(1 + int(max(abs(motion[0]) / blur[0], abs(motion[1]) / blur[1]) / _SAMPLE_BLURS), _MAX_SAMPLES)
    pace = 2 if samples > 1 and abs(area) > _SPARSE_PX2 else 1
    size = (right - left + 1) * (bottom - top + 1)
    # pixels within `_HALF` squares of the prediction: position relative to it, and brightness
    dx, dy, grey = np.empty(size), np.empty(size), np.empty(size)
    count = 0
    mean = 0.0
    for row in range(top, bottom + 1, pace):
        for column in range(left, right + 1, pace):
            px, py = column - start[0], row - start[1]
            if abs(ux * px + uy * py) <= _HALF and abs(vx * px + vy * py) <= _HALF:
                dx[count], dy[count], grey[count] = px, py, image[row, column]
                mean += grey[count]
                count += 1
    if count < _MIN_PIXELS:
        return
    mean /= count
    # Unknowns, in the order of J: 0-1 corner relative to the prediction (x, y), 2 mean, 3 contrast b, 4-5 blurs.
    x, y, contrast, blur_u, blur_v = 0.0, 0.0, 0.0, blur[0], blur[1]
    free = _UNKNOWNS if fit_blur else _UNKNOWNS - 2
    # normal matrix JᵀJ and right side Jᵀr; J of one pixel; Cholesky factor and solution of `solve_damped`
    N, g, J = np.zeros((free, free)), np.zeros(free), np.zeros(_UNKNOWNS)
    L, step = np.zeros((free, free)), np.zeros(free)
    settled = False
    for iteration in range(_ROUNDS + 1):
        clear(g)
        clear_block(N, free)
        squares = 0.0  # sum of the squared residuals
        for i in range(count):  # residual r and derivatives J of a + b s(u) s(v), averaged over the motion
            u = ux * (dx[i] - x) + uy * (dy[i] - y)
            v = vx * (dx[i] - x) + vy * (dy[i] - y)
            by_x, by_y, by_contrast, by_blur_u, by_blur_v = 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(samples):
                share = (k + 0.5) / samples - 0.5  # part of the motion, from -0.5 to 0.5
                wave_u, slope_u, widen_u = _square_wave(u + share * motion[0], blur_u)
                wave_v, slope_v, widen_v = _square_wave(v + share * motion[1], blur_v)
                du, dv = slope_u * wave_v, wave_u * slope_v
                by_x -= du * ux + dv * vx
                by_y -= du * uy + dv * vy
                by_contrast += wave_u * wave_v
                by_blur_u += widen_u * wave_v
                by_blur_v += wave_u * widen_v
            scale = contrast / samples
            J[0], J[1], J[2], J[3] = scale * by_x, scale * by_y, 1.0, by_contrast / samples
            J[4], J[5] = scale * by_blur_u, scale * by_blur_v
            r = grey[i] - mean - contrast * J[3]
            squares += r * r
            for j in range(free):
                g[j] += J[j] * r
                for k in range(j + 1):
                    N[j, k] += J[j] * J[k]
        for j in range(free):
            for k in range(j):
                N[k, j] = N[j, k]
        if iteration == 0:  # brightnesses first, by Cramer's rule, as the rest depends on them
            det = N[2, 2] * N[3, 3] - N[2, 3] ** 2
            if det < 1e-9 * N[2, 2] * N[2, 2]:
                return
            mean += (N[3, 3] * g[2] - N[2, 3] * g[3]) / det
            contrast = (N[2, 2] * g[3] - N[2, 3] * g[2]) / det
            if contrast * colour <= 0.0:
                return
            continue
        if settled or iteration == _ROUNDS:  # N and residuals are now those of the final values
            break
        for j in range(free):
            N[j, j] *= 1.0 + _DAMPING
            N[j, j] += 1e-9
        if fit_blur:  # weak prior: the blur of a corner of few pixels is not observable
            N[4, 4] += _BLUR_INFORMATION * contrast * contrast
            N[5, 5] += _BLUR_INFORMATION * contrast * contrast
        if not solve_damped(N, g, free, 0.0, L, step):
            return
        # squares; the step of the position is shortened to `_MAX_STEP`
        moved = max(abs(ux * step[0] + uy * step[1]), abs(vx * step[0] + vy * step[1]))
        limited = min(1.0, _MAX_STEP / (moved + 1e-12))
        dx_px, dy_px = limited * step[0], limited * step[1]
        x, y, mean, contrast = x + dx_px, y + dy_px, mean + step[2], contrast + step[3]
        settled = abs(dx_px) + abs(dy_px) < _SETTLED_PX and (iteration > _POSITION_ROUNDS or not fit_blur)
        if fit_blur and iteration > _POSITION_ROUNDS:
            blur_u = min(max(blur_u + step[4], 0.5 * blur_u, _MIN_BLUR), 2.0 * blur_u, _MAX_BLUR)
            blur_v = min(max(blur_v + step[5], 0.5 * blur_v, _MIN_BLUR), 2.0 * blur_v, _MAX_BLUR)
        if abs(ux * x + uy * y) > _HALF or abs(vx * x + vy * y) > _HALF or contrast * colour <= 0.0:
            return
    det = N[0, 0] * N[1, 1] - N[0, 1] ** 2  # of the part of the corner's position
    if det <= 0.0 or count <= free:
        return
    out[X], out[Y] = start[0] + x, start[1] + y
    out[MEAN], out[STEP] = mean, contrast * colour
    out[BLUR_U], out[BLUR_V] = blur_u, blur_v
    out[RMS] = math.sqrt(squares / (count - free))
    out[V_XX], out[V_XY], out[V_YY] = N[1, 1] / det, -N[0, 1] / det, N[0, 0] / det
    out[OK] = 1.0
