"""Rotation rate of a camera from the images of a short segment, by features that are tracked from image to image.

With depth the rotation comes from perspective from n points, without it from the essential matrix (Nistér, PAMI 26(6),
2004).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.scenarios.image_features import (
    Corners,
    DepthImage,
    Grey,
    find_corners,
    find_depth_pixels,
    follow_corners,
    read_depth,
    read_small_grey,
    to_full_size,
)
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rays import find_rays
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array

_FEATURES, _REPLACED_BELOW, _MIN_TRACKS = 150, 100, 20
"""Most features that are looked for, the number below which new ones replace them, and the number below which no
rotation is estimated."""
_STATIONARY_PX, _ROTATION_PX, _INLIER_PX = 0.1, 0.15, 0.7
"""Median motion of the features below which the camera is at rest; median residual below which a rotation alone
explains them; and largest residual of an inlier; all in pixels of the tracked images."""
_FARTHEST = 1e4
"""Distance of a feature, in multiples of the motion between two images, up to which it tells front from back."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PairTracks:
    """Features that were tracked from one image to the next, which hold for any calibration of the camera.

    Attributes:
        t_ns: Stamps of both images.
        before: (N, 2) pixels of the features in the first image, at the camera's own resolution.
        after: (N, 2) likewise, in the next image.
        depth: (N,) depths in the first image, m; 0 where unknown. None without a depth image.
        tracked_px: Size of a pixel of the tracked images, which may be smaller, in pixels of the camera.
    """

    t_ns: tuple[int, int]
    before: Array
    after: Array
    depth: Array | None
    tracked_px: float

    @property
    def median_depth(self) -> float:
        """Median of the known depths, m; NaN without any."""
        if self.depth is None or not (self.depth > 0).any():
            return math.nan
        return float(np.median(self.depth[self.depth > 0]))


@dataclass(frozen=True, kw_only=True, eq=False)
class Rates:
    """Mean rotation rates of a camera between the images of N pairs.

    Attributes:
        t_ns: (N, 2) stamps of both images.
        rate: (N, 3) rad/s, in the camera's optical axes.
        shift: (N, 3) m, where the camera is at the second image, in its axes at the first; NaN without depth.
        depth: (N,) m, median depth of the features; NaN without depth.
    """

    t_ns: NDArray[np.int64]
    rate: Array
    shift: Array
    depth: Array


def track_segment(recording: Recording, camera: CameraCalibration, first: int, count: int) -> list[PairTracks]:
    """Tracks features through one segment of a camera's images.

    Args:
        recording: Recording with the images.
        camera: Calibration of the camera, of which only the topics count.
        first: Number of the first image.
        count: Number of images.

    Returns:
        The tracks of each pair of images; a pair with too few features has none, and a segment with a damaged image,
        which is a problem of its own, no pairs.
    """
    times = recording.image_times(camera.topic)[first : first + count].tolist()
    depth_at = _depth_numbers(recording, camera)
    features = _Features(camera.width)
    pairs = list[PairTracks]()
    before = None  # stamp, grey image and depth image of the image before
    try:
        for number, t_ns in enumerate(times, first):
            grey = read_small_grey(recording, camera, number)
            if before is not None:
                tracks = features.track(before[1], grey, before[2], (before[0], t_ns))
                pairs += [] if tracks is None else [tracks]
            depth_number = depth_at.get(t_ns)
            before = t_ns, grey, None if depth_number is None else read_depth(recording, camera, depth_number)
    except StrideTwinError:  # a damaged image
        return []
    return pairs


def list_rates(camera: CameraCalibration, segments: Iterable[Sequence[PairTracks]]) -> list[Rates]:
    """Rates of segments of images with a given calibration (`estimate_rates`); without those that have none."""
    return [rates for rates in (estimate_rates(camera, pairs) for pairs in segments) if rates is not None]


def estimate_rates(camera: CameraCalibration, pairs: Sequence[PairTracks]) -> Rates | None:
    """The rates of a camera with a given calibration from the tracks of pairs of images.

    Args:
        camera: Its calibration, of which the lens counts.
        pairs: Tracks of each pair.

    Returns:
        Those of the pairs whose rotation could be estimated; None without any.
    """
    motions = [_estimate_motion(camera, tracks, np.zeros((2, 3))) for tracks in pairs]
    if camera.readout_s:
        # once more, now that it is known how fast the camera turns while the rows of an image are read
        rates = _find_rates_at_images(pairs, motions)
        motions = [_estimate_motion(camera, tracks, of_pair) for tracks, of_pair in zip(pairs, rates)]
    known = [(tracks, motion) for tracks, motion in zip(pairs, motions) if motion is not None]
    if not known:
        return None
    spans = np.array([tracks.t_ns for tracks, _ in known], np.int64)
    duration_s = (spans[:, 1] - spans[:, 0]) * 1e-9
    return Rates(
        t_ns=spans,
        rate=np.array([rotation for _, (rotation, _) in known]) / duration_s[:, None],
        shift=np.array([shift for _, (_, shift) in known]),
        depth=np.array([tracks.median_depth for tracks, _ in known]),
    )


def _find_rates_at_images(pairs: Sequence[PairTracks], motions: Sequence[tuple[Array, Array] | None]) -> list[Array]:
    """(2, 3) rotation rates at both images of each pair, rad/s: means of the pairs before and after each image.

    A pair without a known motion, or with one that none is beside, counts as the one at hand, or as at rest.
    """
    at_image = dict[int, list[Array]]()
    for tracks, motion in zip(pairs, motions):
        if motion is not None:
            rate = motion[0] * 1e9 / (tracks.t_ns[1] - tracks.t_ns[0])
            for t_ns in tracks.t_ns:
                at_image.setdefault(t_ns, []).append(rate)
    means = {t_ns: np.mean(rates, axis=0) for t_ns, rates in at_image.items()}
    return [np.array([means.get(t_ns, np.zeros(3)) for t_ns in tracks.t_ns]) for tracks in pairs]


def _turn_to_stamp(camera: CameraCalibration, pixels: Array, rays: Array, rate: Array) -> Array:
    """(N, 2) normalised coordinates of features as if all rows had been read at the stamp of the image.

    Args:
        camera: Calibration with the readout of its rolling shutter; the middle row has the stamp.
        pixels: (N, 2) pixels of the features.
        rays: (N, 2) their normalised coordinates.
        rate: (3,) rotation rate of the camera, rad/s.
    """
    late_s = camera.readout_s * ((pixels[:, 1] + 0.5) / camera.height - 0.5)
    points = np.column_stack((rays, np.ones(len(rays))))
    points = points + np.cross(late_s[:, None] * rate, points)
    return np.asarray(points[:, :2] / points[:, 2:])


def _depth_numbers(recording: Recording, camera: CameraCalibration) -> dict[int, int]:
    """Numbers of the depth images by their stamps, ns, which are those of the colour images that they belong to."""
    if camera.depth_topic not in recording.topics:
        return {}
    return {t: i for i, t in enumerate(recording.image_times(camera.depth_topic).tolist())}


class _Features:
    """Features that are tracked through a segment; they are replaced when too few are left.

    Args:
        width: Of the camera's images, px.
    """

    def __init__(self, width: int) -> None:
        """Starts without features, for images `width` pixels across before they are reduced."""
        self._width = width
        self._tracked: Corners = np.zeros((0, 2), np.float32)  # pixels in the last image

    def track(self, a: Grey, b: Grey, depth: DepthImage | None, t_ns: tuple[int, int]) -> PairTracks | None:
        """Tracks the features from one image to the next.

        Args:
            a: First image, grey.
            b: Next image.
            depth: (H, W) depth of the first image, m, or None.
            t_ns: Stamps of both images.

        Returns:
            None if too few features could be tracked.
        """
        if len(self._tracked) < _REPLACED_BELOW:
            self._tracked = find_corners(a, _FEATURES)
        if len(self._tracked) < _MIN_TRACKS:
            return None
        tracked, is_tracked = follow_corners(a, b, self._tracked)
        before, self._tracked = self._tracked[is_tracked], tracked[is_tracked]
        if len(before) < _MIN_TRACKS:
            return None
        scale = a.shape[1] / self._width  # the tracked images are smaller than the camera's
        return PairTracks(
            t_ns=t_ns,
            before=to_full_size(before, scale),
            after=to_full_size(self._tracked, scale),
            depth=None if depth is None else _depth_at(depth, before, scale),
            tracked_px=1.0 / scale,
        )


def _estimate_motion(camera: CameraCalibration, tracks: PairTracks, rates: Array) -> tuple[Array, Array] | None:
    """Motion of a camera from one image to the next.

    Without motion in the image it is 0. Otherwise the rotation comes from the first of these that succeeds: with depth,
    perspective from n points; a rotation alone, if that explains the features; the essential matrix.

    Args:
        camera: Its calibration, of which the lens counts.
        tracks: Features in both images.
        rates: (2, 3) rotation rates at both images, rad/s, with which a rolling shutter is corrected.

    Returns:
        Rotation vector (3,), rad, and position of the camera at the second image (3,), m, in its axes at the first; NaN
        unless points with depth give it. None if no method finds a rotation.
    """
    # x and y are (N, 2) normalised coordinates of the features in both images, and a tracked pixel has this size there
    x, y = (find_rays(points, camera) for points in (tracks.before, tracks.after))
    if camera.readout_s:
        x = _turn_to_stamp(camera, tracks.before, x, rates[0])
        y = _turn_to_stamp(camera, tracks.after, y, rates[1])
    pixel = tracks.tracked_px / camera.intrinsics[0]
    if float(np.median(np.linalg.norm(x - y, axis=1))) < _STATIONARY_PX * pixel:
        return np.zeros(3), np.zeros(3)  # at rest the essential matrix is not defined
    motion = _motion_from_pnp(x, y, tracks.depth, pixel) if tracks.depth is not None else None
    if motion is not None:
        R, t = motion
        return _invert_rotation(R), -R.T @ t
    R_alone = _fit_rotation(x, y, pixel)
    R_alone = _rotation_from_essential(x, y, pixel) if R_alone is None else R_alone
    return None if R_alone is None else (_invert_rotation(R_alone), np.full(3, np.nan))


def _invert_rotation(R: Array) -> Array:
    """(3,) rotation vector of the camera, if R (3, 3) maps points of its axes before into those afterwards."""
    return -np.asarray(cv2.Rodrigues(R)[0], float).ravel()


def _fit_rotation(x: Array, y: Array, pixel: float) -> Array | None:
    """(3, 3) rotation between rays by Kabsch's algorithm; None unless rotation alone explains them.

    Args:
        x: (N, 2) normalised coordinates in the first image.
        y: (N, 2) in the second image.
        pixel: Size of a pixel in normalised coordinates.
    """
    # (N, 3) unit vectors along the rays of both images
    a, b = (np.column_stack((rays, np.ones(len(rays)))) for rays in (x, y))
    a, b = (rays / np.linalg.norm(rays, axis=1, keepdims=True) for rays in (a, b))
    U, _, Vt = np.linalg.svd(b.T @ a)
    U[:, 2] *= np.linalg.det(U @ Vt)  # a rotation, not a reflection
    R = U @ Vt
    residual = np.linalg.norm(a @ R.T - b, axis=1)  # of unit rays: about an angle, rad
    return np.asarray(R, float) if float(np.median(residual)) < _ROTATION_PX * pixel else None


def _rotation_from_essential(x: Array, y: Array, pixel: float) -> Array | None:
    """(3, 3) rotation from the essential matrix (Nistér 2004) with RANSAC; None if it fails.

    Args:
        x: (N, 2) normalised coordinates in the first image.
        y: (N, 2) in the second image.
        pixel: Size of a pixel in normalised coordinates.
    """
    # 0.999 is the probability with which the right matrix shall be found; this variant refines it with all inliers, and
    # its rotations are six times more accurate than those of plain RANSAC
    E, inliers = cv2.findEssentialMat(x, y, np.eye(3), cv2.USAC_ACCURATE, 0.999, _INLIER_PX * pixel)
    if E is None or E.shape != (3, 3):  # OpenCV stacks several solutions
        return None
    count, R, *_ = cv2.recoverPose(E, x, y, np.eye(3), distanceThresh=_FARTHEST, mask=inliers)
    return np.asarray(R, float) if count >= _MIN_TRACKS else None


def _motion_from_pnp(x: Array, y: Array, z: Array, pixel: float) -> tuple[Array, Array] | None:
    """Rotation (3, 3) and translation (3,), m, by perspective from n points with RANSAC; None with too few inliers.

    Depth separates rotation from sideways motion far better than rays alone.

    Args:
        x: (N, 2) normalised coordinates in the first image.
        y: (N, 2) in the second image.
        z: (N,) depths in the first image, m; 0 where unknown.
        pixel: Size of a pixel in normalised coordinates.
    """
    has_depth = z > 0
    if has_depth.sum() < _MIN_TRACKS:
        return None
    # (P, 3) m, the features in space, in the axes of the first image
    points = np.column_stack((x, np.ones(len(x))))[has_depth] * z[has_depth, None]
    is_solved, rotation, translation, inliers = cv2.solvePnPRansac(
        points, y[has_depth], np.eye(3), np.zeros(4), reprojectionError=_INLIER_PX * pixel
    )
    if not is_solved or len(inliers) < _MIN_TRACKS:
        return None
    return np.asarray(cv2.Rodrigues(rotation)[0], float), np.asarray(translation, float).ravel()


def _depth_at(depth: DepthImage, corners: Corners, scale: float) -> Array:
    """(N,) depths at N features, m; 0 where the camera measured none.

    Args:
        depth: (H, W) depths, m.
        corners: (N, 2) pixels of the features in the tracked, smaller image.
        scale: Width of that image relative to the depth image.
    """
    at = find_depth_pixels(corners, scale)
    height, width = depth.shape
    return np.asarray(depth[at[:, 1].clip(0, height - 1), at[:, 0].clip(0, width - 1)], float)
