"""Approximation of lenses with more than four terms by `radtan` lenses, within the image."""

from __future__ import annotations

import numpy as np

from stridetwin.streams.samples import Array

MOST_TERMS = 8
_ACROSS = 41  # points along each side of the image
_STEPS = 300
_ENOUGH = 0.8  # of the image must correspond to rays
_CLOSE = 0.01  # px, largest error of a ray's pixel


def fitted_radtan(
    intrinsics: tuple[float, float, float, float], distortion: Array, size: tuple[int, int]
) -> tuple[Array, float]:
    """The radtan coefficients closest to a lens of ROS's rational model, over the whole image.

    Args:
        intrinsics: (fu, fv, pu, pv) in pixels.
        distortion: k1, k2, p1, p2 and up to k3, k4, k5, k6, as CameraInfo orders them.
        size: (width, height) in pixels.

    Returns:
        k1, k2, p1, p2, and the largest error of a point of the image, px. Corners without a ray, as higher terms cause,
        do not count; infinite if they are a large part of the image.
    """
    fu, fv, pu, pv = intrinsics
    focal = np.array([fu, fv])
    d = np.zeros(MOST_TERMS)
    d[: len(distortion)] = distortion
    u, v = np.meshgrid(np.linspace(0, size[0] - 1, _ACROSS), np.linspace(0, size[1] - 1, _ACROSS))
    seen: Array = (np.column_stack((u.ravel(), v.ravel())) - (pu, pv)) / focal
    rays = seen
    with np.errstate(all="ignore"):  # divergence is detected below
        for _ in range(_STEPS):
            radial, aside = _lens(rays, d)
            rays = (seen - aside) / radial
        radial, aside = _lens(rays, d)
        there = np.linalg.norm((rays * radial + aside - seen) * focal, axis=1) < _CLOSE
    if there.mean() < _ENOUGH:
        return d[:4], float("inf")
    rays, seen = rays[there], seen[there]
    x, y = rays.T
    r2 = x * x + y * y
    # radtan's change of a ray is linear in its coefficients; in pixels, so that all points have equal weight
    terms = np.concatenate(
        (
            fu * np.column_stack((x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x)),
            fv * np.column_stack((y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y)),
        )
    )
    wanted = ((seen - rays) * focal).T.ravel()
    four: Array = np.linalg.lstsq(terms, wanted, rcond=None)[0]
    return four, float(np.linalg.norm((terms @ four - wanted).reshape(2, -1), axis=0).max())


def _lens(rays: Array, d: Array) -> tuple[Array, Array]:
    """(N, 1) factor and (N, 2) offset that a lens of the rational model applies to rays x, y at z = 1."""
    x, y = rays.T
    r2 = x * x + y * y
    k1, k2, p1, p2, k3, k4, k5, k6 = d
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    aside = np.column_stack((2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y))
    return radial[:, None], aside
