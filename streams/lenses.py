"""Lenses of other tools as the models of a rig: `radtan` and `equidistant`, each with four coefficients.

Models that are one of these are taken over; others are fitted to one of them within the image, and the largest error
in pixels is returned. Sources: OpenCV's documentation (rational model, fisheye), Geyer and Daniilidis 2000 (omni),
Khomutenko et al. 2016 (eucm), Usenko et al. 2018 (ds), Devernay and Faugeras 2001 (fov).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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


def bin_and_crop(
    intrinsics: Intrinsics,
    size: tuple[int, int],
    offset: tuple[int, int],
    part: tuple[int, int],
    binning: Sequence[int],
) -> tuple[Intrinsics, tuple[int, int]]:
    """Intrinsics and size of the images that a camera gives of a part of its sensor, with pixels joined.

    ROS's CameraInfo has the intrinsics of the whole sensor beside the part and the binning (REP 104).

    Args:
        intrinsics: (fu, fv, pu, pv) of the whole sensor, px.
        size: (width, height) of the whole sensor, px.
        offset: First column and row of the part.
        part: (width, height) of the part; 0 is all.
        binning: Columns and rows that become one; 0 is 1.

    Returns:
        (fu, fv, pu, pv) and (width, height) of the images, px.
    """
    fu, fv, pu, pv = intrinsics
    bu, bv = (max(1, count) for count in binning)
    width, height = ((part[k] or size[k]) // b for k, b in enumerate((bu, bv)))
    return (fu / bu, fv / bv, (pu - offset[0]) / bu, (pv - offset[1]) / bv), (width, height)


DISTORTIONS: Mapping[str, str] = MappingProxyType(
    {
        **dict.fromkeys(("radtan", "plumb_bob", "radial-tangential", "radtan8", "rational_polynomial"), "radtan"),
        **dict.fromkeys(("brown conrady", "modified brown conrady", "inverse brown conrady"), "radtan"),
        **dict.fromkeys(("equidistant", "equi", "fisheye", "kb4", "kannala_brandt", "kannala brandt4"), "equidistant"),
        "fov": "fov",
        **dict.fromkeys(("none", ""), "none"),
    }
)
"""Kalibr's name of a distortion model, by the names of other tools in lower case."""
EXTRA_TERMS: Mapping[str, int] = MappingProxyType({"pinhole": 0, "omni": 1, "eucm": 2, "ds": 2})
"""How many parameters of a projection are before fu, fv, pu, pv in Kalibr's intrinsics, by its name."""
COEFFICIENTS: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {"radtan": (4, 5, 8, 12, 14), "equidistant": (4,), "fov": (1,), "none": (0, 1, 4, 5, 8)}
)
"""How many coefficients a distortion model may have; those of radtan after the fourth are those of OpenCV."""
_CLOSE_FIT_PX = 0.05
"""A fit that leaves focal lengths and centre as they are is taken if its error is below this."""
_WIDEST = 1.5
"""Largest angle in rad between the optical axis and a ray at which lenses are compared."""
_ANGLES, _AROUND = 91, 96
"""Rays of the comparison: angles from the axis, and directions around it."""
WORST_FIT_PX = 3.0
"""Largest error of a lens that is approximated, px."""
VALID_LENS = f"a lens that radtan or equidistant with four coefficients represents up to {WORST_FIT_PX:g} px"
"""What an error expects of a lens beyond it."""
EXACT_FIT_PX = 0.01
"""An error up to this is not worth a warning."""
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
        The lens: as it is if the rig has the model, else the better fit of the two, whose focal lengths and centre may
        differ. The error is infinite if it cannot be fitted.
    """
    fu, fv, pu, pv = intrinsics[-4:]
    pinhole = (fu, fv, pu, pv)
    d = _pad(coefficients)
    has_beyond = bool(np.any(np.abs(np.array(coefficients[MOST_TERMS:])) > _NEGLIGIBLE))  # OpenCV's thin prism and tilt
    if has_beyond or (camera_model != "pinhole" and distortion_model == "equidistant"):
        return Lens(pinhole, "radtan", (0.0, 0.0, 0.0, 0.0), float("inf"))
    has_more_terms = distortion_model == "radtan" and bool(np.any(np.abs(d[4:]) > _NEGLIGIBLE))
    if distortion_model == "none" or (distortion_model == "fov" and coefficients[0] < _NEGLIGIBLE):
        d, distortion_model = np.zeros(MOST_TERMS), "radtan"
    if camera_model == "pinhole" and distortion_model != "fov" and not has_more_terms:
        k1, k2, k3, k4 = (float(value) for value in d[:4])
        return Lens(pinhole, distortion_model, (k1, k2, k3, k4))
    candidates: list[Lens] = []
    if camera_model == "pinhole" and has_more_terms:
        fitted, error = fit_radtan(pinhole, d, size)
        k1, k2, p1, p2 = (float(value) for value in fitted)
        candidates.append(Lens(pinhole, "radtan", (k1, k2, p1, p2), error))
        if error < _CLOSE_FIT_PX:  # the intrinsics stay as they are
            return candidates[0]
    rays = _spread_rays()
    with np.errstate(all="ignore"):  # rays that the model does not see
        plane = _project(camera_model, intrinsics[:-4], rays, coefficients[0] if distortion_model == "fov" else None)
        if distortion_model == "radtan":
            radial, tangential = _rational_distortion(plane, d)
            plane = plane * radial + tangential
        pixels = plane * (fu, fv) + (pu, pv)
        is_seen = _is_before_fold(plane)
    inside = is_seen & np.all((pixels >= 0) & (pixels <= np.array(size) - 1), axis=1)
    if inside.sum() < 2 * _AROUND:
        return Lens(pinhole, "radtan", (0.0, 0.0, 0.0, 0.0), float("inf"))
    candidates += [_fit_model(model, rays[inside], pixels[inside], fv / fu) for model in ("radtan", "equidistant")]
    return min(candidates, key=lambda lens: lens.error_px)


def _pad(coefficients: tuple[float, ...]) -> Array:
    """(8,) the coefficients of the rational model; those that are not given are 0."""
    d = np.zeros(MOST_TERMS)
    d[: min(len(coefficients), MOST_TERMS)] = coefficients[:MOST_TERMS]
    return d


def _spread_rays() -> Array:
    """(N, 3) unit vectors around the optical axis z, up to `_WIDEST` from it."""
    angles, directions = np.meshgrid(
        np.linspace(0.0, _WIDEST, _ANGLES)[1:], np.linspace(0.0, 2 * np.pi, _AROUND, endpoint=False)
    )
    angle, around = angles.ravel(), directions.ravel()
    return np.column_stack((np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)))


def _project(model: str, terms: tuple[float, ...], rays: Array, fov: float | None) -> Array:
    """Projects unit rays (N, 3) to the plane of a lens's focal lengths, (N, 2), before `radtan` distorts them.

    Args:
        model: A key of `EXTRA_TERMS`.
        terms: Its parameters.
        rays: (N, 3).
        fov: The angle of a pinhole with the distortion `fov`; None for other distortions.
    """
    x_y, z = rays[:, :2], rays[:, 2:]
    if model == "omni":
        (xi,) = terms
        return x_y / (z + xi)
    if model == "eucm":
        alpha, beta = terms
        d = np.sqrt(beta * np.sum(x_y**2, axis=1, keepdims=True) + z**2)
        return x_y / (alpha * d + (1 - alpha) * z)
    if model == "ds":
        xi, alpha = terms
        shifted = xi + z  # rays have unit length
        d = np.sqrt(np.sum(x_y**2, axis=1, keepdims=True) + shifted**2)
        return x_y / (alpha * d + (1 - alpha) * shifted)
    if fov is None:
        return x_y / z
    r = np.linalg.norm(x_y, axis=1, keepdims=True) / z
    return x_y / z * np.arctan(2 * r * np.tan(fov / 2)) / (fov * r)


def _is_before_fold(plane: Array) -> Array:
    """(N,) whether the points (N, 2) of `_spread_rays` are farther out than all rays that are nearer to the axis.

    Beyond, a polynomial turns back and would show a ray where another one already is.
    """
    r = np.linalg.norm(plane, axis=1).reshape(_AROUND, -1)  # a row for each direction, from the axis outwards
    steps = np.diff(r, axis=1, prepend=0.0)
    return np.asarray(np.logical_and.accumulate(np.isfinite(r) & (steps > 0), axis=1).ravel())


def _fit_model(model: str, rays: Array, pixels: Array, aspect: float) -> Lens:
    """Fits focal length, centre and coefficients of a rig's model to the pixels of rays, by linear least squares.

    Args:
        model: `radtan` or `equidistant`.
        rays: (N, 3) unit vectors.
        pixels: (N, 2).
        aspect: fv / fu, which is kept.
    """
    if model == "radtan":
        x, y = (rays[:, :2] / rays[:, 2:]).T
        r2 = x * x + y * y
        u = np.column_stack((x, x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x))
        v = np.column_stack((y, y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y))
    else:
        angle = np.arccos(np.clip(rays[:, 2], -1, 1))[:, None]
        direction = rays[:, :2] / np.linalg.norm(rays[:, :2], axis=1, keepdims=True)
        powers = angle ** np.array([1, 3, 5, 7, 9])
        u, v = direction[:, :1] * powers, direction[:, 1:] * powers
    ones, zeros = np.ones((len(rays), 1)), np.zeros((len(rays), 1))
    # rows for u, then for v; unknown are fu, its products with the coefficients, and the centre
    terms = np.concatenate((np.hstack((u, ones, zeros)), np.hstack((aspect * v, zeros, ones))))
    target = pixels.T.ravel()
    scale = np.abs(terms).max(axis=0)  # powers of large numbers would hide the others
    solution = np.linalg.lstsq(terms / scale, target, rcond=None)[0] / scale
    residual = (terms @ solution - target).reshape(2, -1)
    fu, *products, pu, pv = (float(value) for value in solution)
    if not fu > 0:
        return Lens((1.0, 1.0, 0.0, 0.0), model, (0.0, 0.0, 0.0, 0.0), float("inf"))
    k1, k2, k3, k4 = (product / fu for product in products)
    error = float(np.linalg.norm(residual, axis=0).max())
    return Lens((fu, fu * aspect, pu, pv), model, (k1, k2, k3, k4), error)
