"""Planes in depth images: how high a camera is above the floor, and whether floor and walls are perpendicular.

On a plane n · X = d the inverse depth is linear in the normalised image coordinates: 1 / Z = θ · (x, y, 1) with
θ = n / d. Disparity cameras measure it with equal noise everywhere, so that θ comes from linear least squares. Depth of
another unit scales θ as a whole; a focal length k times the true one scales its first two components by k. The angles
between floor and walls therefore show the focal length, and no unit of depth.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.streams.plausible import Implausible, advise_depth_unit, find_implausible_depth
from stridetwin.streams.rays import find_rays
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array, Mask

FOCAL_FIELD = "intrinsics"
"""Field of what is implausible in a focal length."""
HEIGHT_M = (0.4, 2.3)
"""Least and largest plausible height of a camera on head or chest, or in a hand, above the floor or a table."""
_USUAL_HEIGHT_M = 1.4
"""Height between those of chest and head."""
_BODIES = ("head", "torso")
"""Bodies on which a camera has such a height."""
_FOCAL_MARGIN_LOG = math.log(1.1)
"""Logarithm of the factor by which a focal length may be off."""
_GRID = 64
"""Points across the longer side of an image."""
_WINDOW, _WINDOW_STEP = 9, 4
"""Points across a window whose plane is a candidate, and from one window to the next."""
_FEWEST_IN_WINDOW = 60
"""Points with a depth that a window needs, of 81."""
_SHARE_OFF = 0.025
"""A point belongs to a plane if its inverse depth differs by less than this share: stereo noise at 3 m."""
_MOST_PLANES, _LEAST_SHARE = 4, 0.08
"""Most planes of an image, and the least share of its points that a plane has."""
_ROUNDS = 4
"""Rounds of choosing the points of a plane and fitting it to them."""
_FLOOR_COSINE = 0.45
"""Least cosine of a floor's normal with the camera's upper side: a camera that looks down by up to 63°."""
_MOST_VIEWS = 12
"""Most depth images of a stream that are looked at."""
_FEWEST_VIEWS = 3
"""Images with a floor from which a height counts."""
_SENSITIVITY = 0.12
"""Least product of the normals' components along the optical axis at which the focal length shows in their angle."""
_FOCAL_RANGE = (0.55, 1.8)
"""Ratios to the true focal length that are looked for; two planes that need another one are no floor and wall."""
_FEWEST_ANGLES = 6
"""Pairs of planes from which a focal length counts."""
_NORMAL_975 = 1.959964
"""Quantile of the standard normal distribution."""
_MEDIAN_ERROR = 1.2533
"""Standard error of a median over that of a mean, of normal variables."""
_SCALED_MAD = 1.4826
"""Standard deviation over the median absolute deviation, of normal variables."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Planes:
    """P planes in an image.

    Attributes:
        theta: (P, 3) normal away from the camera over its distance, 1/m, in the camera's optical frame.
        share: (P,) of the image's points.
    """

    theta: Array
    share: Array


@dataclass(frozen=True, kw_only=True)
class FocalRatio:
    """Calibrated focal length over the one with which planes are perpendicular.

    Attributes:
        ratio: The ratio.
        half_log: Half width of the 95 % interval of its logarithm.
        angle_deg: Typical angle of the pairs of planes with the calibrated focal length.
        pairs: Number of pairs.
    """

    ratio: float
    half_log: float
    angle_deg: float
    pairs: int


def choose_views(count: int) -> list[int]:
    """Numbers of up to `_MOST_VIEWS` of the `count` depth images of a stream, spread over it from end to end."""
    return np.unique(np.linspace(0, count - 1, _MOST_VIEWS).round().astype(int)).tolist()


def find_implausible_views(
    depths: Sequence[Array], camera: CameraCalibration, per_metre: float | None = None
) -> list[Implausible]:
    """What distances in some depth images show of a wrong unit, or else planes of that and of a wrong focal length.

    Args:
        depths: (H, W) m, each; those of another size than the calibrated one show distances, but no planes.
        camera: Calibration of the camera that the depth is registered to.
        per_metre: Units per metre with which the depth was read; None if no option gives them.
    """
    implausible = list(find_implausible_depth(depths, per_metre))
    if implausible:
        return implausible
    views = [find_planes(depth, camera) for depth in depths if depth.shape == (camera.height, camera.width)]
    return list(find_implausible_planes(views, camera, per_metre))


def find_planes(depth: Array, camera: CameraCalibration) -> Planes:
    """The largest planes of a depth image.

    Windows of the image give candidates; the one that most points agree with is fitted to them, and the others are
    looked for in the remaining points.

    Args:
        depth: (H, W) m; 0 where there is none.
        camera: Calibration of the camera that the depth is registered to.

    Returns:
        Up to four planes, the largest first; none in an image that is smaller than a window.
    """
    if min(depth.shape) < _WINDOW:
        return Planes(theta=np.zeros((0, 3)), share=np.zeros(0))
    step = max(1, max(depth.shape) // _GRID)
    z = np.asarray(depth[step // 2 :: step, step // 2 :: step], float)
    v, u = np.mgrid[: z.shape[0], : z.shape[1]] * step + step // 2
    rays = _to_rays(np.column_stack((u.ravel(), v.ravel())), camera).reshape(*z.shape, 3)
    is_valid = np.isfinite(z) & (z > 0.0)
    inverse = np.where(is_valid, 1.0 / np.where(is_valid, z, 1.0), 0.0)
    candidates = _fit_windows(rays, inverse, is_valid)
    points, values = rays[is_valid], inverse[is_valid]  # (N, 3), (N,)
    fits = _lie_on(candidates, points, values)  # (C, N)
    is_left = np.ones(len(values), bool)
    thetas, shares = list[Array](), list[float]()
    while len(thetas) < _MOST_PLANES and len(candidates):
        best = int(np.argmax((fits & is_left).sum(axis=1)))
        theta, chosen = candidates[best], fits[best] & is_left
        for _ in range(_ROUNDS):
            if chosen.sum() < max(3, _LEAST_SHARE * len(values)):
                break
            theta = np.linalg.lstsq(points[chosen], values[chosen], rcond=None)[0]
            chosen = _lie_on(theta[None], points, values)[0] & is_left
        if chosen.sum() < max(3, _LEAST_SHARE * len(values)):
            break
        thetas.append(theta)
        shares.append(float(chosen.mean()))
        is_left = is_left & ~chosen
    return Planes(theta=np.array(thetas).reshape(-1, 3), share=np.array(shares))


def measure_camera_height(views: Sequence[Planes]) -> float | None:
    """Median height, m, of a camera above the largest plane below it.

    Args:
        views: Planes of several images.

    Returns:
        None if fewer than three images show such a plane.
    """
    heights: list[float] = []
    for planes in views:
        length = np.linalg.norm(planes.theta, axis=1)
        is_floor = planes.theta[:, 1] > _FLOOR_COSINE * length
        if is_floor.any():
            heights.append(1.0 / float(length[np.argmax(np.where(is_floor, planes.share, 0.0))]))
    return float(np.median(heights)) if len(heights) >= _FEWEST_VIEWS else None


def measure_focal_ratio(views: Sequence[Planes]) -> FocalRatio | None:
    """The calibrated focal length over the one with which floors and walls are perpendicular.

    With k times the true focal length, perpendicular planes have θ₁ₓ θ₂ₓ + θ₁ᵧ θ₂ᵧ + k² θ₁ᵤ θ₂ᵤ = 0, which gives k for
    each pair that both look towards the camera.

    Args:
        views: Planes of several images.

    Returns:
        None with too few pairs.
    """
    ratios: list[float] = []
    angles: list[float] = []
    for planes in views:
        normal = planes.theta / np.linalg.norm(planes.theta, axis=1, keepdims=True)
        first, second = np.triu_indices(len(normal), 1)
        across = np.sum(normal[first, :2] * normal[second, :2], axis=1)
        along = normal[first, 2] * normal[second, 2]
        squared = -across / np.where(along == 0.0, 1.0, along)
        is_pair = (np.abs(along) > _SENSITIVITY) & (squared > _FOCAL_RANGE[0] ** 2) & (squared < _FOCAL_RANGE[1] ** 2)
        ratios += np.sqrt(squared[is_pair]).tolist()
        angles += np.degrees(np.arccos(np.clip(across + along, -1.0, 1.0)))[is_pair].tolist()
    if len(ratios) < _FEWEST_ANGLES:
        return None
    logs = np.log(ratios)
    median = float(np.median(logs))
    sd = _SCALED_MAD * float(np.median(np.abs(logs - median)))
    return FocalRatio(
        ratio=math.exp(median),
        half_log=_NORMAL_975 * _MEDIAN_ERROR * sd / math.sqrt(len(logs)),
        angle_deg=float(np.median(angles)),
        pairs=len(logs),
    )


def find_implausible_planes(
    views: Sequence[Planes], camera: CameraCalibration, per_metre: float | None = None
) -> Iterator[Implausible]:
    """Yields an `Implausible` if planes show a wrong focal length or unit of depth.

    Floor and walls are perpendicular, and a person carries a camera 0.4 to 2.3 m above the ground, on head or chest or
    in a hand.

    Args:
        views: Planes of several images.
        camera: Calibration of the camera with which they were fitted.
        per_metre: Units per metre with which the depth was read; None if no option gives them.
    """
    focal = measure_focal_ratio(views)
    if focal is not None and abs(math.log(focal.ratio)) - focal.half_log > _FOCAL_MARGIN_LOG:
        f = camera.intrinsics[0]
        yield Implausible(
            FOCAL_FIELD,
            f"focal length {f:.4g} px, with which floor and walls are at {focal.angle_deg:.0f}°",
            f"90°, as with {f / focal.ratio:.3g} ± {f / focal.ratio * focal.half_log:.2g} px; --rig gives the "
            f"calibration for images of {camera.width} x {camera.height}",
        )
    height_m = measure_camera_height(views) if camera.mount.body in _BODIES else None
    if height_m is not None and not HEIGHT_M[0] <= height_m <= HEIGHT_M[1]:
        advice = advise_depth_unit(height_m, HEIGHT_M, _USUAL_HEIGHT_M, per_metre)
        valid = f"{HEIGHT_M[0]:g} to {HEIGHT_M[1]:g} m, as a person carries it{advice}"
        yield Implausible("depth", f"height of the camera of {height_m:.2g} m above the floor", valid)


def _to_rays(pixels: Array, camera: CameraCalibration) -> Array:
    """(N, 3) normalised image coordinates without distortion, and 1, of N pixels (N, 2)."""
    return np.column_stack((find_rays(pixels, camera), np.ones(len(pixels))))


def _lie_on(theta: Array, rays: Array, inverse: Array) -> Mask:
    """(C, N) whether each of N points lies on each of C planes.

    Args:
        theta: (C, 3) planes, 1/m.
        rays: (N, 3) normalised image coordinates and 1.
        inverse: (N,) inverse depths, 1/m.
    """
    return np.asarray(np.abs(theta @ rays.T - inverse) < _SHARE_OFF * inverse)


def _fit_windows(rays: Array, inverse: Array, is_valid: Mask) -> Array:
    """(C, 3) planes fitted to the windows of a grid of points that have enough of them, 1/m.

    Args:
        rays: (h, w, 3) normalised image coordinates and 1.
        inverse: (h, w) inverse depths, 1/m.
        is_valid: (h, w) whether a point has a depth.
    """
    weighted = rays * is_valid[..., None]
    # sums over windows of the products that the normal equations consist of: 9 of rays, 3 with the inverse depth, count
    products = np.concatenate(
        (
            (weighted[..., :, None] * rays[..., None, :]).reshape(*is_valid.shape, 9),
            weighted * inverse[..., None],
            is_valid[..., None],
        ),
        axis=-1,
    )
    total = np.zeros((is_valid.shape[0] + 1, is_valid.shape[1] + 1, products.shape[-1]))
    total[1:, 1:] = products.cumsum(axis=0).cumsum(axis=1)
    rows = np.arange(0, is_valid.shape[0] - _WINDOW + 1, _WINDOW_STEP)[:, None]
    columns = np.arange(0, is_valid.shape[1] - _WINDOW + 1, _WINDOW_STEP)
    below, right = rows + _WINDOW, columns + _WINDOW
    sums = total[below, right] - total[rows, right] - total[below, columns] + total[rows, columns]
    sums = sums.reshape(-1, products.shape[-1])
    sums = sums[sums[:, -1] >= _FEWEST_IN_WINDOW]
    normal_matrix = sums[:, :9].reshape(-1, 3, 3) + 1e-9 * np.eye(3)
    return np.asarray(np.linalg.solve(normal_matrix, sums[:, 9:12, None])[..., 0])
