"""Where ground that the map holds as one plane bends along a line, from the heights of its columns.

Planes are found by their normals, and gentle ramps have nearly that of level ground. The columns' heights are precise
to millimetres, so that a bend of two degrees shows within half a metre. See docs/terrain_map.md (12).
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from stridetwin.streams.samples import Array

_BIN_M = 0.1
"""Heights are averaged over this length."""
_MIN_BINS = 5
"""A straight stretch is no shorter."""
_NOISE_M = 0.004
"""Standard deviation of a bin's height over a straight line."""
_MIN_BEND_SD = 5.0
"""Smallest bend, in standard deviations."""
_MAX_MISFIT_SD = 2.0
"""Where heights scatter more about a stretch, the ground jumps or bulges there, and nothing is cut."""
_PASSES = 4
"""How often each bend is placed again between its neighbours."""


class Stretch(NamedTuple):
    """A straight stretch of the ground along a line.

    Attributes:
        first, last: First and last sample of the stretch.
        s: Middle of the stretch, m along the line.
        height: Height at the middle, m.
        slope: Rise over run.
        slope_sd: Standard deviation of the slope.
        break_s: Where it begins with a bend, m; NaN for the first stretch.
        break_sd: Standard deviation of `break_s`, m; NaN for the first stretch.
    """

    first: int
    last: int
    s: float
    height: float
    slope: float
    slope_sd: float
    break_s: float = math.nan
    break_sd: float = math.nan


def straight_stretches(s: Array, height: Array, first: int, last: int, min_bend_rad: float) -> list[Stretch]:
    """Cuts samples of one plane into straight stretches at its bends, docs/terrain_map.md (12).

    A single stretch is returned if nothing bends, and none if the ground jumps or bulges, or if too few heights are
    known.

    Args:
        s: (N,) m along the line.
        height: (N,) m, NaN where unknown.
        first: First sample of the plane.
        last: Last sample of the plane.
        min_bend_rad: Smallest bend, rad.
    """
    here = slice(first, last + 1)
    x, z = _bin_heights(s[here], height[here])  # (M,) place along the line and height of each bin, m
    cuts: list[int] = []  # first bin after each bend
    _find_bends(x, z, 0, len(x), cuts)
    bounds = _settle_bounds(x, z, [0, *sorted(cuts), len(x)], min_bend_rad)
    stretches: list[Stretch] = []
    for k, (a, b) in enumerate(pairwise(bounds)):  # stretch k has the bins a to b - 1
        if b - a < _MIN_BINS:  # too few known heights
            return []
        middle, level, slope, slope_sd = _fit_line(x[a:b], z[a:b])
        off = z[a:b] - level - slope * (x[a:b] - middle)  # of each bin from the line, m
        if off @ off > (b - a) * (_MAX_MISFIT_SD * _NOISE_M) ** 2:
            return []  # a jump or a bulge
        begin, break_s, break_sd = first, math.nan, math.nan  # the first stretch begins with no bend
        if k:
            # The bend is where both lines meet, but no farther from bin a than half the length of both.
            before = stretches[-1]
            bend = slope - before.slope
            reach = (b - bounds[k - 1]) * _BIN_M / 2  # m
            # how much higher the line before is at bin a than this one, m
            gap = (before.height + before.slope * (x[a] - before.s)) - (level + slope * (x[a] - middle))
            break_s = float(x[a]) + min(max(gap / bend, -reach), reach) if bend else float(x[a])
            break_sd = _NOISE_M / max(abs(bend), 1e-6)
            begin = int(np.searchsorted(s, break_s))  # first sample beyond the bend
            begin = min(max(begin, before.first + 1), last)
            stretches[-1] = before._replace(last=begin - 1)
        stretches.append(Stretch(begin, last, middle, level, slope, slope_sd, break_s, break_sd))
    return stretches


def _bin_heights(s: Array, height: Array) -> tuple[Array, Array]:
    """Means of places along the line and of heights, each (M,) m, in bins of `_BIN_M`; empty bins are left out.

    `s` (N,) and `height` (N,) are those of the samples, m; samples of unknown height, NaN, do not count.
    """
    known = np.isfinite(height)
    if not known.any():
        return np.empty(0), np.empty(0)
    x, z = s[known], height[known]
    bins = ((x - x[0]) / _BIN_M).astype(int)  # number of the bin of each sample
    count = np.bincount(bins)
    occupied = count > 0
    mean_x = np.bincount(bins, x)[occupied] / count[occupied]
    mean_z = np.bincount(bins, z)[occupied] / count[occupied]
    return mean_x, mean_z


def _fit_line(x: Array, z: Array) -> tuple[float, float, float, float]:
    """Fits a line to heights z (M,), m, at x (M,), m, by least squares.

    Returns:
        Middle x, m; height there, m; slope; and standard deviation of the slope.
    """
    middle, level = float(x.mean()), float(z.mean())
    off = x - middle
    spread = float(off @ off)
    slope = float(off @ (z - level)) / spread
    return middle, level, slope, _NOISE_M / math.sqrt(spread)


def _find_bends(x: Array, z: Array, a: int, b: int, cuts: list[int]) -> None:
    """Appends the bends among the bins a to b - 1 to `cuts`: the best one, then those on both sides of it.

    Any significant bend counts here, however small its angle; `_settle_bounds` removes those that are none. `x` and `z`
    (M,) are places along the line and heights, m; `cuts` are bins.
    """
    best = _find_best_bend(x[a:b], z[a:b])  # counted from bin a
    if best is not None:
        cuts.append(a + best)
        _find_bends(x, z, a, a + best, cuts)
        _find_bends(x, z, a + best, b, cuts)


def _settle_bounds(x: Array, z: Array, bounds: list[int], min_bend_rad: float) -> list[int]:
    """Bounds in which each bend is the best one between its neighbours; bends that are too small are removed.

    Args:
        x: (M,) m along the line.
        z: (M,) m, heights.
        bounds: First bin of each stretch, and the number of bins at the end.
        min_bend_rad: Smallest bend, rad.
    """
    for _ in range(_PASSES):
        kept = bounds[:1]  # the new bounds
        for k in range(1, len(bounds) - 1):  # between the new bound before it and the old one after it
            around = slice(kept[-1], bounds[k + 1])
            best = _find_best_bend(x[around], z[around], min_bend_rad)
            if best is not None:
                kept.append(kept[-1] + best)
        kept.append(bounds[-1])
        if kept == bounds:
            break
        bounds = kept
    return bounds


def _find_best_bend(x: Array, z: Array, min_bend_rad: float | None = None) -> int | None:
    """The bin with the most significant bend, by least squares with a hinge; None where the line is straight.

    For each bin b, β max(0, x − b) is fitted to what a line leaves of the heights; the best bin explains most.

    Args:
        x: (M,) m along the line.
        z: (M,) m, heights.
        min_bend_rad: Smallest bend, rad. None: any bend counts, however small its angle and whatever other bends leave:
            up and down again is a small bend, too.
    """
    n = len(x)
    if n < 2 * _MIN_BINS:
        return None
    ks = np.arange(_MIN_BINS, n - _MIN_BINS + 1)  # (K,) bins that leave a stretch on either side
    x, z = x - x.mean(), z - z.mean()
    line_slope = (x @ z) / (x @ x)
    residual = z - line_slope * x
    hinge = np.maximum(0.0, x[None, :] - x[ks, None])  # (K, n) one row for each bin with a bend
    hinge = hinge - hinge.mean(axis=1, keepdims=True)
    hinge -= ((hinge @ x) / (x @ x))[:, None] * x  # what a line cannot explain
    power = np.einsum("kn,kn->k", hinge, hinge)  # (K,) squared length of each hinge
    along = hinge @ residual
    gain = along**2 / np.maximum(power, 1e-12)  # decrease of the squared residuals by β = along / power
    best = int(gain.argmax())
    # β, the change of slope, and what scatter is left: no less than noise
    bend = along[best] / max(float(power[best]), 1e-12)
    residual_variance = max(float(residual @ residual - gain[best]) / n, _NOISE_M**2)
    if min_bend_rad is None:  # bends that this one leaves are no scatter, so noise alone counts
        residual_variance, min_bend_rad = _NOISE_M**2, 0.0
    if abs(bend) < math.tan(min_bend_rad) or gain[best] < _MIN_BEND_SD**2 * residual_variance:
        return None
    return int(ks[best])
