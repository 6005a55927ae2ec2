"""Plane fits, with covariance, from sums over points."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INSIDE, cached
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent

SUMS = 11
"""n, x, y, z, xx, xy, xz, yy, yz, zz, and the sum of the points' variances (m²)."""
_NEWTON, _EXACT = 40, 1e-9
BORDER_M = 0.25
"""Width of a plane's border, half of which is free space, where its height is not evaluated (`toward`)."""
Plane = tuple[float, float, float, float, float, float, float]


@njit(inline="always")
def add_point(sums: Array, x: float, y: float, z: float, noise: float) -> None:
    """Adds a point to (11,) sums."""
    sums[0] += 1.0
    sums[1] += x
    sums[2] += y
    sums[3] += z
    sums[4] += x * x
    sums[5] += x * y
    sums[6] += x * z
    sums[7] += y * y
    sums[8] += y * z
    sums[9] += z * z
    sums[10] += noise * noise


@njit(error_model="numpy", **INSIDE)
def fit(s: Array) -> Plane:
    """Principal component analysis of points.

    See docs/terrain_map.md (5).

    Args:
        s: (11,) sums over at least three points, see `SUMS`.

    Returns:
        Centre (x, y, z), unit normal (x, y, z; upwards), and the mean squared distance from the plane.
    """
    n = s[0]
    x, y, z = s[1] / n, s[2] / n, s[3] / n
    a, b, d = s[4] / n - x * x, s[7] / n - y * y, s[9] / n - z * z
    e, f, g = s[5] / n - x * y, s[6] / n - x * z, s[8] / n - y * z
    # Smallest eigenvalue of a symmetric matrix, in closed form (Smith 1961).
    q = (a + b + d) / 3.0
    p = math.sqrt(max(((a - q) ** 2 + (b - q) ** 2 + (d - q) ** 2 + 2.0 * (e * e + f * f + g * g)) / 6.0, 1e-30))
    aa, bb, dd, ee, ff, gg = (a - q) / p, (b - q) / p, (d - q) / p, e / p, f / p, g / p
    det = aa * (bb * dd - gg * gg) - ee * (ee * dd - gg * ff) + ff * (ee * gg - bb * ff)
    phi = math.acos(min(1.0, max(-1.0, det / 2.0))) / 3.0
    least = q + 2.0 * p * math.cos(phi + 2.0 * math.pi / 3.0)
    # Its eigenvector is orthogonal to the rows of (matrix - eigenvalue): the longest cross product of two of them.
    a, b, d = a - least, b - least, d - least
    ux, uy, uz = e * g - f * b, f * e - a * g, a * b - e * e
    vx, vy, vz = e * d - f * g, f * f - a * d, a * g - e * f
    wx, wy, wz = b * d - g * g, g * f - e * d, e * g - b * f
    uu, vv, ww = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz
    if vv > uu:
        ux, uy, uz, uu = vx, vy, vz, vv
    if ww > uu:
        ux, uy, uz, uu = wx, wy, wz, ww
    if uu < 1e-40:
        ux, uy, uz, uu = 0.0, 0.0, 1.0, 1.0
    size = math.copysign(math.sqrt(uu), uz)
    return x, y, z, ux / size, uy / size, uz / size, max(least, 0.0)


@njit(error_model="numpy", **INSIDE)
def off_plane(s: Array) -> float:
    """Mean squared distance of points from their best-fit plane, m², as in `fit`, without computing the plane.

    Newton's method finds the smallest root of the characteristic polynomial from 0. It converges from below in a few
    steps, because points on a plane scatter little across it.

    Args:
        s: (11,) sums over at least three points, see `SUMS`.
    """
    n = s[0]
    x, y, z = s[1] / n, s[2] / n, s[3] / n
    a, b, d = s[4] / n - x * x, s[7] / n - y * y, s[9] / n - z * z
    e, f, g = s[5] / n - x * y, s[6] / n - x * z, s[8] / n - y * z
    trace, minors = a + b + d, a * b - e * e + a * d - f * f + b * d - g * g
    det = a * (b * d - g * g) - e * (e * d - g * f) + f * (e * g - b * f)
    root = 0.0
    for _ in range(_NEWTON):
        rise = minors - root * (2.0 * trace - 3.0 * root)
        if rise <= 0.0:
            break
        step = (det - root * (minors - root * (trace - root))) / rise
        root += step
        if step <= _EXACT * root:
            break
    return max(root, 0.0)


@cached(_HERE, error_model="numpy")
def squared_distance(sums: Array) -> float:
    """`off_plane` for uncompiled code."""
    return off_plane(sums)


@njit(**INSIDE)
def spread_of(sums: Array, spread: Array) -> None:
    """(2, 2) m², covariance of points in plan, from their (11,) sums."""
    n, x, y = sums[0], sums[1] / sums[0], sums[2] / sums[0]
    xy = sums[5] / n - x * y
    spread[0, 0] = sums[4] / n - x * x
    spread[0, 1] = xy
    spread[1, 0] = xy
    spread[1, 1] = sums[7] / n - y * y


@njit(error_model="numpy", **INSIDE)
def height_plane(
    sums: Array, common_m: float, common_rad: float, alike: float, slope_sd: float, centre: Array, slopes: Array,
    covariance: Array, spread: Array,
) -> None:  # fmt: skip
    """Maximum-likelihood plane through points as a height function, z = z_c + a (x - x_c) + b (y - y_c).

    See docs/terrain_map.md (7), (8).

    The prior is a level plane, for points that are too few or too nearly collinear to determine the slope.

    Args:
        sums: (11,) sums over its points, see `SUMS`.
        common_m: Standard deviation of the height error common to all points.
        common_rad: The same for the slopes, rad.
        alike: Number of points that share an error.
        slope_sd: Prior standard deviation of the slopes, rad.
        centre: (3,) out.
        slopes: (2,) out: a and b.
        covariance: (3, 3) out: of (z_c, a, b).
        spread: (2, 2) out: `spread_of`.
    """
    n = sums[0]
    for i in range(3):
        centre[i] = sums[1 + i] / n
        covariance[0, i] = 0.0
        covariance[i, 0] = 0.0
    spread_of(sums, spread)
    rise_x, rise_y = sums[6] / n - centre[0] * centre[2], sums[8] / n - centre[1] * centre[2]
    share = max(sums[10] / n * alike / n, 1e-12)
    # The slopes' covariance: inverse of spread / share + 1 / slope_sd^2, two by two.
    xx, yy, xy = (spread[0, 0] / share + slope_sd**-2, spread[1, 1] / share + slope_sd**-2, spread[0, 1] / share)
    det = xx * yy - xy * xy
    covariance[1, 1] = yy / det
    covariance[2, 2] = xx / det
    covariance[1, 2] = -xy / det
    covariance[2, 1] = -xy / det
    slopes[0] = (covariance[1, 1] * rise_x + covariance[1, 2] * rise_y) / share
    slopes[1] = (covariance[1, 2] * rise_x + covariance[2, 2] * rise_y) / share
    covariance[0, 0] = share + common_m**2
    covariance[1, 1] += common_rad**2
    covariance[2, 2] += common_rad**2


@cached(_HERE)
def height_planes(
    sums: Array, common_m: float, common_rad: float, alike: float, slope_sd: float
) -> tuple[Array, Array, Array, Array]:
    """`height_plane` of (N, 11) sums: (N, 3), (N, 2) and (N, 3, 3); and their (N, 2, 2) `spread_of`."""
    n = len(sums)
    centres, slopes, covariances = np.empty((n, 3)), np.empty((n, 2)), np.empty((n, 3, 3))
    spreads = np.empty((n, 2, 2))
    for k in range(n):
        height_plane(sums[k], common_m, common_rad, alike, slope_sd, centres[k], slopes[k], covariances[k], spreads[k])
    return centres, slopes, covariances, spreads


@cached(_HERE, error_model="numpy")
def off_height_plane(
    new: Array, old: Array, common_m: float, common_rad: float, alike: float, slope_sd: float
) -> float:
    """Mean squared height difference, m², of points from the `height_plane` of others; both given as (11,) sums."""
    c, slopes, covariance, spread = np.empty(3), np.empty(2), np.empty((3, 3)), np.empty((2, 2))
    height_plane(old, common_m, common_rad, alike, slope_sd, c, slopes, covariance, spread)
    a, b = -slopes[0], -slopes[1]
    d = -(c[2] + a * c[0] + b * c[1])
    # of a x + b y + z + d
    squares = a * a * new[4] + b * b * new[7] + new[9] + 2.0 * (a * b * new[5] + a * new[6] + b * new[8])
    return (squares + 2.0 * d * (a * new[1] + b * new[2] + new[3])) / new[0] + d * d


@cached(_HERE)
def toward(centre: Array, spread: Array, x: float, y: float, border_m: float) -> tuple[float, float]:
    """The farthest point from a plane's centre toward (x, y) at which the plane is well observed.

    Args:
        centre: (3,) m.
        spread: (2, 2) m², covariance of its points in plan.
        x: m.
        y: m.
        border_m: Width of the border where it is not well observed.
    """
    ox, oy = centre[0], centre[1]
    x, y = x - ox, y - oy
    length = math.hypot(x, y)
    if length == 0.0:
        return ox, oy
    x, y = x / length, y / length
    variance = x * x * spread[0, 0] + 2.0 * x * y * spread[0, 1] + y * y * spread[1, 1]
    half = math.sqrt(3.0 * max(variance, 0.0))  # for uniformly distributed points
    reach = max(0.0, min(length, half) - border_m)
    return ox + reach * x, oy + reach * y


@cached(_HERE)
def seen_height(centre: Array, gradient: Array, spread: Array, x: float, y: float, border_m: float) -> float:
    """Height of a plane, m, where it is well observed toward (x, y); gradient (2,), the rest as in `toward`.

    A narrow plane is known best at its centre: its slope is uncertain, and its boundary is half free space.
    """
    x, y = toward(centre, spread, x, y, border_m)
    return centre[2] + (x - centre[0]) * gradient[0] + (y - centre[1]) * gradient[1]


def rotated(
    centres: Array, slopes: Array, covariances: Array, spreads: Array, R: Array
) -> tuple[Array, Array, Array, Array]:
    """Rotates the result of `height_planes` by a (3, 3) rotation about the vertical."""
    turn = R[:2, :2]
    covariances = covariances.copy()
    covariances[:, 1:, 1:] = turn @ covariances[:, 1:, 1:] @ turn.T
    return centres @ R.T, slopes @ turn.T, covariances, turn @ spreads @ turn.T
