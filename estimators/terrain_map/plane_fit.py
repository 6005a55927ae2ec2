"""Plane fits, with covariance, from sums over points."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numba import njit

from stridetwin.streams.algebra.arrays import matvec
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent

SUMS = 11
"""Number of sums over points: 0 n, 1-3 x, y, z, 4-9 xx, xy, xz, yy, yz, zz, 10 the points' own variances (m²)."""
_NEWTON, _EXACT = 40, 1e-9  # largest number of steps, and relative step that ends the iteration
BORDER_M = 0.25
"""Width of a plane's border, half of which is free space, where its height is not evaluated (`point_toward`)."""
PlaneFit = tuple[float, float, float, float, float, float, float]
"""Centre (x, y, z), unit normal (x, y, z), and mean squared distance of the points, m²."""


@njit(inline="always")
def add_point(sums: Array, x: float, y: float, z: float, noise: float) -> None:
    """Adds a point (x, y, z), m, with standard deviation `noise`, m, to sums (11,), see `SUMS`."""
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


@njit(error_model="numpy", **INNER_KERNEL)
def fit_plane(s: Array) -> PlaneFit:
    """Fits a plane to points by principal component analysis, docs/terrain_map.md (5).

    Args:
        s: (11,) sums over at least three points, see `SUMS`.

    Returns:
        Centre (x, y, z), unit normal (x, y, z; upwards), and the mean squared distance from the plane.
    """
    # covariance of the points [[a, e, f], [e, b, g], [f, g, d]] about their centre (x, y, z)
    n = s[0]
    x, y, z = s[1] / n, s[2] / n, s[3] / n
    a, b, d = s[4] / n - x * x, s[7] / n - y * y, s[9] / n - z * z
    e, f, g = s[5] / n - x * y, s[6] / n - x * z, s[8] / n - y * z
    # Smallest eigenvalue `least` of a symmetric matrix, in closed form (Smith 1961): q is the mean of the eigenvalues,
    # p their scatter, and phi an angle from the determinant of the matrix (covariance - q) / p.
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
    if uu < 1e-40:  # collinear points have no normal
        ux, uy, uz, uu = 0.0, 0.0, 1.0, 1.0
    size = math.copysign(math.sqrt(uu), uz)  # the normal points upwards
    return x, y, z, ux / size, uy / size, uz / size, max(least, 0.0)


@njit(error_model="numpy", **INNER_KERNEL)
def plane_misfit(s: Array) -> float:
    """Mean squared distance of points from their best-fit plane, m², without computing the plane.

    It is the smallest eigenvalue of their covariance. Newton's method finds it, the smallest root of the characteristic
    polynomial, from 0. It converges from below in a few steps, because points on a plane scatter little across it.

    Args:
        s: (11,) sums over at least three points, see `SUMS`.
    """
    # covariance of the points [[a, e, f], [e, b, g], [f, g, d]], and the coefficients of its characteristic polynomial
    n = s[0]
    x, y, z = s[1] / n, s[2] / n, s[3] / n
    a, b, d = s[4] / n - x * x, s[7] / n - y * y, s[9] / n - z * z
    e, f, g = s[5] / n - x * y, s[6] / n - x * z, s[8] / n - y * z
    trace, minors = a + b + d, a * b - e * e + a * d - f * f + b * d - g * g
    det = a * (b * d - g * g) - e * (e * d - g * f) + f * (e * g - b * f)
    root = 0.0
    for _ in range(_NEWTON):
        rise = minors - root * (2.0 * trace - 3.0 * root)  # derivative of the polynomial
        if rise <= 0.0:
            break
        step = (det - root * (minors - root * (trace - root))) / rise
        root += step
        if step <= _EXACT * root:
            break
    return max(root, 0.0)


squared_distance = entry_kernel(_HERE, error_model="numpy")(plane_misfit)
"""`plane_misfit` for uncompiled code."""


def fit_height_planes(
    sums: Array, common_m: float, common_rad: float, alike: float, slope_sd: float
) -> tuple[Array, Array, Array, Array]:
    """Fits planes z = z_c + a (x − x_c) + b (y − y_c) by maximum likelihood, docs/terrain_map.md (7), (8).

    The prior is a level plane, for points that are too few or too nearly collinear to determine the slope.

    Args:
        sums: (N, 11) sums over the points of each, see `SUMS`.
        common_m: Standard deviation of the height error common to all points, m.
        common_rad: Standard deviation of the slope error common to all points, rad.
        alike: Number of points that share an error.
        slope_sd: Prior standard deviation of the slopes, rad.

    Returns:
        (N, 3) centres, m; (N, 2) slopes a and b; (N, 3, 3) covariances of (z_c, a, b); and (N, 2, 2) m², covariances of
        the points in plan.
    """
    n = sums[:, 0]
    centres = sums[:, 1:4] / n[:, None]
    second = (sums[:, [4, 5, 6, 7, 8]] / n[:, None]).T  # (5, N) means of xx, xy, xz, yy, yz
    x, y, z = centres.T
    xx, xy, xz, yy, yz = second - np.array([x * x, x * y, x * z, y * y, y * z])  # (N,) covariances
    spreads = np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2)
    # (N,) variance of the mean height, σ² of docs/terrain_map.md (7): `alike` points count as one
    mean_variance = np.maximum(sums[:, 10] / n * alike / n, 1e-12)
    # (N, 2, 2) covariance of the slopes: inverse of the information of points and prior
    of_slopes = np.asarray(np.linalg.inv(spreads / mean_variance[:, None, None] + slope_sd**-2 * np.eye(2)), float)
    slopes = matvec(of_slopes, np.column_stack([xz, yz])) / mean_variance[:, None]
    covariances = np.zeros((len(sums), 3, 3))
    covariances[:, 0, 0] = mean_variance + common_m**2
    covariances[:, 1:, 1:] = of_slopes + common_rad**2 * np.eye(2)
    return centres, slopes, covariances, spreads


def height_plane_misfit(
    new: Array, old: Array, common_m: float, common_rad: float, alike: float, slope_sd: float
) -> Array:
    """(N,) mean squared height difference, m², of points from planes fitted by `fit_height_planes` to other points.

    Args:
        new: (N, 11) sums of the points.
        old: (N, 11) sums of the points that determine the planes.
        common_m: Standard deviation of the height error common to all points, m.
        common_rad: Standard deviation of the slope error common to all points, rad.
        alike: Number of points that share an error.
        slope_sd: Prior standard deviation of the slopes, rad.
    """
    centres, slopes, _, _ = fit_height_planes(old, common_m, common_rad, alike, slope_sd)
    # the planes are a x + b y + z + d = 0
    a, b = -slopes.T
    d = -(centres[:, 2] + a * centres[:, 0] + b * centres[:, 1])
    n, x, y, z, xx, xy, xz, yy, yz, zz, _ = new.T
    # sum of (a x + b y + z + d)² over the points, from their sums; `squares` is that of (a x + b y + z)²
    squares = a * a * xx + b * b * yy + zz + 2.0 * (a * b * xy + a * xz + b * yz)
    return np.asarray((squares + 2.0 * d * (a * x + b * y + z)) / n + d * d)


@entry_kernel(_HERE)
def point_toward(centre: Array, spread: Array, x: float, y: float, border_m: float) -> tuple[float, float]:
    """The point, in plan, from a plane's centre toward (x, y) that is farthest but still well observed.

    Args:
        centre: (3,) m, centre of the plane's points.
        spread: (2, 2) m², covariance of the plane's points in plan.
        x: Coordinate to point toward, m.
        y: Coordinate to point toward, m.
        border_m: Width of the border where it is not well observed.

    Returns:
        Coordinates x and y of the point, m: (x, y) itself if it is well inside, and the centre of a narrow plane.
    """
    ox, oy = centre[0], centre[1]
    x, y = x - ox, y - oy  # from the centre
    length = math.hypot(x, y)
    if length == 0.0:
        return ox, oy
    x, y = x / length, y / length  # unit vector
    # of the points along the direction (x, y), m²
    variance = x * x * spread[0, 0] + 2.0 * x * y * spread[0, 1] + y * y * spread[1, 1]
    half = math.sqrt(3.0 * max(variance, 0.0))  # from the centre to the boundary, for uniformly distributed points
    reach = max(0.0, min(length, half) - border_m)
    return ox + reach * x, oy + reach * y


@entry_kernel(_HERE)
def height_toward(centre: Array, gradient: Array, spread: Array, x: float, y: float, border_m: float) -> float:
    """Height of a plane, m, at the farthest point toward (x, y) at which it is still well observed.

    That is (x, y) itself if it is well inside. A narrow plane is known best at its centre: its slope is uncertain, and
    its boundary is half free space.

    Args:
        centre: (3,) m, centre of the plane's points.
        gradient: (2,) slopes along x and y.
        spread: (2, 2) m², covariance of the plane's points in plan.
        x: Coordinate to point toward, m.
        y: Coordinate to point toward, m.
        border_m: Width of the border where it is not well observed.
    """
    x, y = point_toward(centre, spread, x, y, border_m)
    return centre[2] + (x - centre[0]) * gradient[0] + (y - centre[1]) * gradient[1]


def rotate_planes(
    centres: Array, slopes: Array, covariances: Array, spreads: Array, R: Array
) -> tuple[Array, Array, Array, Array]:
    """Rotates N planes about the vertical; heights do not change.

    Args:
        centres: (N, 3) m, centres of the planes' points.
        slopes: (N, 2) slopes along x and y.
        covariances: (N, 3, 3) of height at the centre and slopes.
        spreads: (N, 2, 2) m², covariances of the points in plan.
        R: (3, 3) rotation about the vertical.

    Returns:
        The four rotated arrays in the same order.
    """
    rotation = R[:2, :2]  # of the horizontal axes
    covariances = covariances.copy()
    covariances[:, 1:, 1:] = rotation @ covariances[:, 1:, 1:] @ rotation.T
    return centres @ R.T, slopes @ rotation.T, covariances, rotation @ spreads @ rotation.T
