"""Lenses of other tools as the models of a rig: `radtan` and `equidistant`, each with four coefficients.

Models that are one of these are taken over; others are fitted to one of them within the image, and the largest error
in pixels is returned. Sources: OpenCV's documentation (rational model, fisheye), Geyer and Daniilidis 2000 (omni),
Khomutenko et al. 2016 (eucm), Usenko et al. 2018 (ds), Devernay and Faugeras 2001 (fov).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from stridetwin.streams.samples import Array

Intrinsics = tuple[float, float, float, float]
"""fu, fv, pu, pv in pixels."""
MOST_TERMS = 8
"""Most coefficients of ROS's rational model."""
_ACROSS = 41  # points along each side of the image
_STEPS = 300
"""Steps of the fixed-point iteration that undistorts the points."""
_ENOUGH = 0.8  # of the image must correspond to rays
_CLOSE = 0.01  # px, largest error of a ray's pixel


def fit_radtan(intrinsics: Intrinsics, distortion: Array, size: tuple[int, int]) -> tuple[Array, float]:
    """Fits the four coefficients of `radtan` to a lens of ROS's rational model, by least squares over the image.

    A grid of pixels is undistorted by fixed-point iteration with the rational model; the coefficients are the linear
    least-squares solution for the offset in pixels between each pixel and its ray.

    Args:
        intrinsics: (fu, fv, pu, pv) in pixels.
        distortion: k1, k2, p1, p2 and up to k3, k4, k5, k6, as CameraInfo orders them.
        size: (width, height) in pixels.

    Returns:
        k1, k2, p1, p2, and the largest error of a point of the image in pixels. Points without a ray, which higher
        terms cause in corners, do not count; if they are more than 20 % of the image, the error is infinite and the
        coefficients are the given ones.
    """
    fu, fv, pu, pv = intrinsics
    focal = np.array([fu, fv])
    d = np.zeros(MOST_TERMS)
    d[: len(distortion)] = distortion
    # (N, 2) x and y at z = 1 of a grid of pixels: `distorted`, as the pixels show them, and `rays`, undistorted
    u, v = np.meshgrid(np.linspace(0, size[0] - 1, _ACROSS), np.linspace(0, size[1] - 1, _ACROSS))
    distorted: Array = (np.column_stack((u.ravel(), v.ravel())) - (pu, pv)) / focal
    rays = distorted
    with np.errstate(all="ignore"):  # divergence is detected below
        for _ in range(_STEPS):  # fixed-point iteration: ray = (distorted - tangential(ray)) / radial(ray)
            radial, tangential = _rational_distortion(rays, d)
            rays = (distorted - tangential) / radial
        radial, tangential = _rational_distortion(rays, d)
        # (N,) whether the ray of a pixel has been found: the model takes it back to the pixel
        has_ray = np.linalg.norm((rays * radial + tangential - distorted) * focal, axis=1) < _CLOSE
    if has_ray.mean() < _ENOUGH:
        return d[:4], float("inf")
    rays, distorted = rays[has_ray], distorted[has_ray]
    x, y = rays.T
    r2 = x * x + y * y
    # radtan's change of a ray is linear in k1, k2, p1, p2: rows for u, then for v, and a column for each of the four;
    # in pixels, so that all points have equal weight
    terms = np.concatenate(
        (
            fu * np.column_stack((x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x)),
            fv * np.column_stack((y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y)),
        )
    )
    offset = ((distorted - rays) * focal).T.ravel()  # the change that the rational model makes, px
    coefficients: Array = np.linalg.lstsq(terms, offset, rcond=None)[0]
    residual = (terms @ coefficients - offset).reshape(2, -1)  # u and v of each point
    return coefficients, float(np.linalg.norm(residual, axis=0).max())


def _rational_distortion(rays: Array, d: Array) -> tuple[Array, Array]:
    """Distortion by ROS's rational model of rays (N, 2), x and y at z = 1: distorted = ray · radial + tangential.

    With r² = x² + y²:
    radial = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶),
    tangential = (2 p1 x y + p2 (r² + 2 x²), p1 (r² + 2 y²) + 2 p2 x y).

    Args:
        rays: (N, 2).
        d: k1, k2, p1, p2, k3, k4, k5, k6.

    Returns:
        Radial factor (N, 1) and tangential offset (N, 2).
    """
    x, y = rays.T
    r2 = x * x + y * y
    k1, k2, p1, p2, k3, k4, k5, k6 = d
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    tangential = np.column_stack((2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y))
    return radial[:, None], tangential


DISTORTIONS: Mapping[str, str] = MappingProxyType(
    {
        **dict.fromkeys(("radtan", "plumb_bob", "radial-tangential", "radtan8", "rational_polynomial"), "radtan"),
        **dict.fromkeys(("brown conrady", "modified brown conrady", "inverse brown conrady"), "radtan"),
        **dict.fromkeys(("equidistant", "equi", "fisheye", "kb4", "kannala_brandt", "kannala brandt4"), "equidistant"),
        "fov": "fov",
        "none": "none",
    }
)
"""Kalibr's name of a distortion model, by the names of other tools in lower case."""
EXTRA_TERMS: Mapping[str, int] = MappingProxyType({"pinhole": 0, "omni": 1, "eucm": 2, "ds": 2})
"""How many parameters of a projection are before fu, fv, pu, pv in Kalibr's intrinsics, by its name."""
COEFFICIENTS: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {"radtan": (4, 5, 8, 12, 14), "equidistant": (4,), "fov": (1,), "none": (0, 1, 4, 5, 8)}
)
"""How many coefficients a distortion model may have; those of radtan after the fourth are those of OpenCV."""
_WIDEST = 1.5
"""Largest angle in rad between the optical axis and a ray at which lenses are compared."""
_ANGLES, _AROUND = 61, 24
"""Rays of the comparison: angles from the axis, and directions around it."""
_NEGLIGIBLE = 1e-9
"""Coefficients and parameters below this count as 0."""


@dataclass(frozen=True)
class Lens:
    """A lens in a model of the rig.

    Attributes:
        intrinsics: (fu, fv, pu, pv) in pixels.
        model: `radtan` or `equidistant`.
        distortion: Its four coefficients.
        error_px: Largest difference from the given lens within the image, px; 0 if it is the same model.
    """

    intrinsics: Intrinsics
    model: str
    distortion: tuple[float, float, float, float]
    error_px: float = 0.0


def to_rig_lens(
    camera_model: str,
    intrinsics: tuple[float, ...],
    distortion_model: str,
    coefficients: tuple[float, ...],
    size: tuple[int, int],
) -> Lens:
    """The lens of Kalibr's models in a model of the rig.

    Args:
        camera_model: A key of `EXTRA_TERMS`.
        intrinsics: Its parameters, then fu, fv, pu, pv in pixels. omni: xi; eucm: alpha, beta; ds: xi, alpha.
        distortion_model: A value of `DISTORTIONS`.
        coefficients: As many as `COEFFICIENTS` allows.
        size: (width, height) in pixels.

    Returns:
        The lens. Its error is infinite if neither model comes near, as with rays beyond the field of a pinhole.
    """
    terms = intrinsics[:-4]
    fu, fv, pu, pv = intrinsics[-4:]
    pinhole = (fu, fv, pu, pv)
    if camera_model == "pinhole" and distortion_model != "fov":
        return _keep_pinhole(pinhole, distortion_model, coefficients, size)
    if camera_model == "pinhole" and coefficients[0] < _NEGLIGIBLE:
        return Lens(pinhole, "radtan", (0.0, 0.0, 0.0, 0.0))
    rays = _spread_rays()
    plane, magnification = _project(camera_model, terms, rays, coefficients)
    if distortion_model == "radtan":
        radial, tangential = _rational_distortion(plane, _pad(coefficients))
        plane = plane * radial + tangential
    elif distortion_model == "equidistant":
        return Lens(pinhole, "radtan", (0.0, 0.0, 0.0, 0.0), float("inf"))
    return _fit_equidistant((fu * magnification, fv * magnification, pu, pv), rays, plane * (fu, fv) + (pu, pv), size)


def _keep_pinhole(intrinsics: Intrinsics, model: str, coefficients: tuple[float, ...], size: tuple[int, int]) -> Lens:
    """A pinhole with `radtan`, `equidistant` or no distortion; `fit_radtan` replaces more than four terms."""
    d = _pad(coefficients)
    k1, k2, k3, k4 = (float(value) for value in d[:4])
    if model == "none":
        return Lens(intrinsics, "radtan", (0.0, 0.0, 0.0, 0.0))
    if not np.any(np.abs(d[4:]) > _NEGLIGIBLE):
        return Lens(intrinsics, model, (k1, k2, k3, k4))
    if np.any(np.abs(coefficients[MOST_TERMS:]) > _NEGLIGIBLE):  # OpenCV's thin prism and tilted sensor
        return Lens(intrinsics, model, (k1, k2, k3, k4), float("inf"))
    fitted, error = fit_radtan(intrinsics, d, size)
    k1, k2, p1, p2 = (float(value) for value in fitted)
    return Lens(intrinsics, model, (k1, k2, p1, p2), error)


def _pad(coefficients: tuple[float, ...]) -> Array:
    """(8,) the coefficients of the rational model; those that are not given are 0."""
    d = np.zeros(MOST_TERMS)
    d[: min(len(coefficients), MOST_TERMS)] = coefficients[:MOST_TERMS]
    return d


def _spread_rays() -> Array:
    """(N, 3) unit vectors around the optical axis z, up to `_WIDEST` from it."""
    angle, around = np.meshgrid(
        np.linspace(0.0, _WIDEST, _ANGLES)[1:], np.linspace(0.0, 2 * np.pi, _AROUND, endpoint=False)
    )
    angle, around = angle.ravel(), around.ravel()
    return np.column_stack((np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)))


def _project(model: str, terms: tuple[float, ...], rays: Array, coefficients: tuple[float, ...]) -> tuple[Array, float]:
    """Projects unit rays (N, 3) to the plane of a lens's focal lengths, before another distortion than `fov`.

    Returns:
        (N, 2) x and y, and the magnification at the centre, by which the focal lengths are multiplied.
    """
    x_y, z = rays[:, :2], rays[:, 2:]
    if model == "omni":
        (xi,) = terms
        return x_y / (z + xi), 1 / (1 + xi)
    if model == "eucm":
        alpha, beta = terms
        d = np.sqrt(beta * np.sum(x_y**2, axis=1, keepdims=True) + z**2)
        return x_y / (alpha * d + (1 - alpha) * z), 1.0
    if model == "ds":
        xi, alpha = terms
        shifted = xi + z  # rays have unit length
        d = np.sqrt(np.sum(x_y**2, axis=1, keepdims=True) + shifted**2)
        return x_y / (alpha * d + (1 - alpha) * shifted), 1 / (1 + xi)
    (w,) = coefficients
    width = 2 * np.tan(w / 2)
    r = np.linalg.norm(x_y, axis=1, keepdims=True) / z
    return x_y / z * np.arctan(r * width) / (w * r), width / w


def _fit_equidistant(intrinsics: Intrinsics, rays: Array, pixels: Array, size: tuple[int, int]) -> Lens:
    """Fits the coefficients of `equidistant` to the pixels (N, 2) of unit rays (N, 3), by least squares.

    Pixels outside of the image do not count; without enough others the error is infinite.
    """
    fu, fv, pu, pv = intrinsics
    inside = np.all((pixels >= 0) & (pixels <= np.array(size) - 1), axis=1) & np.isfinite(pixels).all(axis=1)
    if inside.sum() < 2 * _AROUND:
        return Lens(intrinsics, "equidistant", (0.0, 0.0, 0.0, 0.0), float("inf"))
    rays, pixels = rays[inside], pixels[inside]
    angle = np.arccos(np.clip(rays[:, 2], -1, 1))
    direction = rays[:, :2] / np.linalg.norm(rays[:, :2], axis=1, keepdims=True) * (fu, fv)  # px per rad
    powers = angle[:, None] ** np.array([3, 5, 7, 9])
    # rows for u, then for v, and a column for each of the coefficients, in pixels
    terms = np.concatenate([direction[:, [axis]] * powers for axis in (0, 1)])
    offset = (pixels - (pu, pv) - direction * angle[:, None]).T.ravel()
    fitted = np.linalg.lstsq(terms, offset, rcond=None)[0]
    residual = (terms @ fitted - offset).reshape(2, -1)
    k1, k2, k3, k4 = (float(value) for value in fitted)
    return Lens(intrinsics, "equidistant", (k1, k2, k3, k4), float(np.linalg.norm(residual, axis=0).max()))
