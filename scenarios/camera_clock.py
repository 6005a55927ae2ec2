"""Offset between a camera's clock and its IMU's: the rotation rate seen in the images is aligned with the gyro's.

The rotation between images comes from tracked features: with depth by perspective from n points, without by the
essential matrix (Nistér, PAMI 26(6), 2004). The offset minimises the squared difference between the two rates
(as Kelly and Sukhatme, IJRR 33(2), 2014, align sensors by their rotations alone).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array, Depth, Image

STRETCHES, IMAGES = 4, 45
"""Segments of a recording that are used, and images of each."""
LARGEST_SHIFT_S = 0.15
MOUNT_OFF_DEG = 5.0
_STEP_S = 0.0025  # between the shifts that are compared
_WIDTH = 400  # px of the images that are tracked
_FEATURES, _FEWEST_TRACKS = 150, 20
_STATIONARY_PX, _ROTATION_PX, _INLIER_PX = 0.1, 0.15, 0.7
_FEWEST_PAIRS = 30  # of images with a known rotation
_SURE = 0.7  # correlation from which a result counts
_BETTER = 1.5  # ratio of costs from which another mount counts
_ROUNDS, _PRIOR_SHARE = 3, 0.01  # of the alignment, and weight of the nominal mount in it


@dataclass(frozen=True, kw_only=True)
class _Fit:
    """The shift that best aligns the gyro's rate with the visual one, s, and the correlation of the rates."""

    shift_s: float
    sd_s: float
    cost: float
    correlation: float


def camera_clock(recording: Recording, camera: CameraCalibration) -> dict[str, Any] | None:
    """The time offset of one camera, and the rotation error of its mount relative to its IMU's.

    Returns:
        `shift_s` (t_imu = t_cam + shift), its standard deviation `sd_s`, the calibrated value `calibrated_s`, the
        difference `unexplained_s`, `correlation` of the two rates, `imu`; `mount_off_deg`, the rotation of the mount
        that gives this correlation, 0 for the nominal mount; None where the images do not show the rotation well
        enough (little texture, or a scene that moves along).
    """
    imu = recording.rig.imu(camera.imu_topic)
    gyro = recording.block(camera.imu_topic)
    R_cam_imu = camera.mount.T_body_sensor[:3, :3].T @ imu.mount.T_body_sensor[:3, :3]
    t: Array = np.asarray((gyro.t_ns - gyro.t_ns[0]) * 1e-9, float)
    rate = gyro.columns["angular_rate"] @ R_cam_imu.T
    pairs = [
        pair
        for first in _liveliest(recording.image_times(camera.topic), gyro.t_ns, rate)
        for pair in _rotation_rates(recording, camera, first)
    ]
    if len(pairs) < _FEWEST_PAIRS:
        return None
    spans: Array = (np.array([p[:2] for p in pairs]) - gyro.t_ns[0]) * 1e-9
    seen: Array = np.array([p[2] for p in pairs])
    angle = np.vstack((np.zeros(3), np.cumsum(rate[1:] * np.diff(t)[:, None], axis=0)))
    calibrated = camera.timeshift_cam_imu_s
    shifts: Array = calibrated + np.arange(-LARGEST_SHIFT_S, LARGEST_SHIFT_S + _STEP_S / 2, _STEP_S)

    def gyro_rate_at(shift_s: float) -> Array:
        return _gyro_rate(spans + shift_s, t, angle)

    fit, off_deg = _fit(shifts, gyro_rate_at, seen), 0.0
    # with wrong nominal mounts the two rates may correlate only after a rotation of one of them
    rotation = min((_rotation_between(gyro_rate_at(s), seen) for s in shifts.tolist()), key=lambda found: found[1])[0]
    if (off := math.degrees(rotation.magnitude())) > MOUNT_OFF_DEG:
        rotated = _fit(shifts, lambda s: np.asarray(rotation.apply(gyro_rate_at(s)), float), seen)
        better = rotated is not None and (fit is None or rotated.cost * _BETTER < fit.cost)
        if rotated is not None and better and rotated.correlation >= _SURE:
            fit, off_deg = rotated, off
    if fit is None or fit.correlation < _SURE:
        return None
    return {
        "imu": camera.imu_topic,
        "shift_s": fit.shift_s,
        "calibrated_s": calibrated,
        "unexplained_s": fit.shift_s - calibrated,
        "sd_s": fit.sd_s,
        "correlation": fit.correlation,
        "mount_off_deg": off_deg,
        "pairs": len(pairs),
    }


def _fit(shifts: Array, gyro_rate_at: Callable[[float], Array], seen: Array) -> _Fit | None:
    """The best of the shifts; None if it is the first or the last, or the cost has no minimum."""
    cost = np.array([_cost(gyro_rate_at(float(s)), seen) for s in shifts])
    best = int(np.argmin(cost))
    if best in (0, len(shifts) - 1):
        return None
    before, here, after = cost[best - 1 : best + 2]
    curvature = (before - 2 * here + after) / _STEP_S**2
    if curvature <= 0:
        return None
    shift = float(shifts[best] + 0.5 * _STEP_S * (before - after) / (before - 2 * here + after))
    return _Fit(
        shift_s=shift,
        sd_s=float(np.sqrt(2 * here / curvature / (3 * len(seen)))),
        cost=float(here),
        correlation=_correlation(gyro_rate_at(shift), seen),
    )


def _rotation_between(measured: Array, seen: Array) -> tuple[Rotation, float]:
    """The rotation that best maps gyro rates to visual rates (Kabsch), without the gyro's bias; and its `_cost`.

    A small weight keeps it at the nominal mount about axes that the rates do not observe.
    """
    a, b = measured - np.median(measured, axis=0), seen - np.median(seen, axis=0)
    kept = np.ones(len(a), bool)
    for _ in range(_ROUNDS):
        prior = _PRIOR_SHARE * float(np.sum(np.linalg.norm(a[kept], axis=1) * np.linalg.norm(b[kept], axis=1))) + 1e-12
        axes = np.sqrt(prior) * np.eye(3)
        R = Rotation.align_vectors(np.vstack((b[kept], axes)), np.vstack((a[kept], axes)))[0]
        off = np.sum((R.apply(a) - b) ** 2, axis=1)
        kept = off <= 5 * np.median(off)
    return R, _cost(R.apply(measured), seen)


def _liveliest(images: NDArray[np.int64], t: NDArray[np.int64], rate: Array) -> list[int]:
    """First images of the segments in which the camera's rotation rate varies most."""
    starts = range(0, max(1, len(images) - IMAGES), IMAGES)
    spread: list[float] = []
    for start in starts:
        first, last = images[start], images[min(start + IMAGES, len(images) - 1)]
        here = rate[(t >= first) & (t <= last)]
        spread.append(float(here.std(axis=0).sum()) if len(here) > 1 else 0.0)
    return sorted(starts[int(i)] for i in np.argsort(spread)[::-1][:STRETCHES])


def _rotation_rates(recording: Recording, camera: CameraCalibration, first: int) -> list[tuple[int, int, Array]]:
    """(start and end in ns, mean rate (3,) in the camera's frame) between the images of a segment."""
    times = recording.image_times(camera.topic)[first : first + IMAGES]
    try:
        images = recording.images(camera.topic, range(first, first + len(times)))
        depths = _depths(recording, camera, times)
    except StrideTwinError:
        return []  # a damaged image is reported as a problem of its own
    views = [(p.t_ns, _grey(p)) for p in images if isinstance(p, Image)]
    found = []
    for (t0, a), (t1, b) in pairwise(views):
        rotation = _rotation(a, b, depths.get(t0), camera)
        if rotation is not None:
            found.append((t0, t1, rotation * 1e9 / (t1 - t0)))
    return found


def _depths(recording: Recording, camera: CameraCalibration, t_ns: NDArray[np.int64]) -> dict[int, Any]:
    """Depth images by the stamps of the colour images that they are registered to."""
    if camera.depth_topic not in recording.topics:
        return {}
    times = recording.image_times(camera.depth_topic)
    at = np.flatnonzero(np.isin(times, t_ns)).tolist()
    return {d.t_ns: d.depth for d in recording.images(camera.depth_topic, at) if isinstance(d, Depth)}


def _grey(image: Image) -> Any:
    pixels = image.pixels if image.pixels.ndim == 2 else cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY)
    scale = min(1.0, _WIDTH / pixels.shape[1])
    return cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def _rotation(a: Any, b: Any, depth: Any, camera: CameraCalibration) -> Array | None:
    """Rotation vector (3,) of the camera from image a to image b, in its own frame."""
    corners = cv2.goodFeaturesToTrack(a, _FEATURES, 0.01, 8)
    if corners is None or len(corners) < _FEWEST_TRACKS:
        return None
    moved, found, _ = cv2.calcOpticalFlowPyrLK(a, b, corners, np.zeros_like(corners), winSize=(15, 15), maxLevel=3)
    kept = np.ravel(found) == 1
    if kept.sum() < _FEWEST_TRACKS:
        return None
    scale = a.shape[1] / camera.width
    x, y = (_rays(np.asarray(points)[kept], camera, scale) for points in (corners, moved))
    pixel = 1.0 / (camera.intrinsics[0] * scale)
    if float(np.median(np.linalg.norm(x - y, axis=1))) < _STATIONARY_PX * pixel:
        return np.zeros(3)  # at rest the essential matrix is not defined
    R = _by_depth(x, y, _z_at(depth, corners[kept], scale), pixel) if depth is not None else None
    R = _by_rotation(x, y, pixel) if R is None else R
    R = _by_epipoles(x, y, pixel) if R is None else R
    # R maps points of a into b: the inverse of the camera's own rotation
    return None if R is None else -Rotation.from_matrix(R).as_rotvec()


def _by_rotation(x: Array, y: Array, pixel: float) -> Array | None:
    """The rotation between rays if rotation alone explains them (Kabsch's algorithm): then there are no epipoles."""
    a, b = (np.column_stack((rays, np.ones(len(rays)))) for rays in (x, y))
    a, b = (rays / np.linalg.norm(rays, axis=1, keepdims=True) for rays in (a, b))
    R = Rotation.align_vectors(b, a)[0].as_matrix()
    off = np.linalg.norm(a @ R.T - b, axis=1)
    return np.asarray(R, float) if float(np.median(off)) < _ROTATION_PX * pixel else None


def _by_epipoles(x: Array, y: Array, pixel: float) -> Array | None:
    E, inliers = cv2.findEssentialMat(x, y, np.eye(3), cv2.RANSAC, 0.999, _INLIER_PX * pixel)
    if E is None or E.shape != (3, 3):
        return None
    count, R, _, _ = cv2.recoverPose(E, x, y, np.eye(3), mask=inliers)
    return np.asarray(R, float) if count >= _FEWEST_TRACKS else None


def _by_depth(x: Array, y: Array, z: Array, pixel: float) -> Array | None:
    """The same with depth, which separates rotation from sideways motion far better (perspective from n points)."""
    known = z > 0
    if known.sum() < _FEWEST_TRACKS:
        return None
    points = np.column_stack((x, np.ones(len(x))))[known] * z[known, None]
    done, rotation, _, inliers = cv2.solvePnPRansac(
        points, y[known], np.eye(3), np.zeros(4), reprojectionError=_INLIER_PX * pixel
    )
    return np.asarray(cv2.Rodrigues(rotation)[0], float) if done and len(inliers) >= _FEWEST_TRACKS else None


def _z_at(depth: Any, corners: Any, scale: float) -> Array:
    """(N,) m, depth at the features."""
    at = np.rint((corners.reshape(-1, 2) + 0.5) / scale - 0.5).astype(int)
    height, width = depth.shape
    return np.asarray(depth[at[:, 1].clip(0, height - 1), at[:, 0].clip(0, width - 1)], float)


def _rays(pixels: Any, camera: CameraCalibration, scale: float) -> Array:
    """(N, 2) normalised image coordinates without distortion."""
    points = (pixels.reshape(-1, 1, 2).astype(np.float64) + 0.5) / scale - 0.5
    undistort = cv2.fisheye.undistortPoints if camera.distortion_model == "equidistant" else cv2.undistortPoints
    return np.asarray(undistort(points, camera.K, np.array(camera.distortion)), float).reshape(-1, 2)


def _gyro_rate(spans: Array, t: Array, angle: Array) -> Array:
    """(N, 3) mean rate of the gyro over each (start, end)."""
    ends = np.stack([[np.interp(s, t, angle[:, k]) for k in range(3)] for s in spans.T])  # (2, 3, N)
    return np.asarray(((ends[1] - ends[0]) / (spans[:, 1] - spans[:, 0])).T)


def _cost(measured: Array, seen: Array) -> float:
    """Mean squared difference without the gyro's bias; the cost of a pair is limited to five times the median."""
    off = measured - seen
    squared = np.sum((off - np.median(off, axis=0)) ** 2, axis=1)
    return float(np.mean(np.minimum(squared, 5 * np.median(squared))))


def _correlation(measured: Array, seen: Array) -> float:
    a, b = measured - np.median(measured, axis=0), seen - np.median(seen, axis=0)
    off = np.sum((a - b) ** 2, axis=1)
    kept = off <= 5 * np.median(off)
    return float(np.sum(a[kept] * b[kept]) / np.sqrt(np.sum(a[kept] ** 2) * np.sum(b[kept] ** 2) + 1e-30))
