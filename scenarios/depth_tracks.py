"""Motion of a depth camera over short runs of images, from features whose depth the first image of a run gives.

The features of a run's first image are tracked from image to image. Each later image gets its pose by perspective from
n points, all relative to the first image, so that errors do not add up along the run.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

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
from stridetwin.streams.samples import Array, Mask, Stamps

_FEATURES, _FEWEST_FEATURES = 200, 15
"""Most features of a run, and the number below which it ends."""
_SURFACE_PX = 2
"""Pixels around a feature that have to be on one surface."""
_BEND_SHARE, _SLANT_SHARE = 0.1, 0.3
"""They are if inverse depths on opposite sides differ from that in the middle by less than this share in sum, and from
one another by less than this: twice the noise of stereo depth at 5 m, and a floor at 5 m."""
_INLIER_PX = 2.5
"""Largest residual of an inlier, px of the tracked image: 2 % of noise in depth after a way of half the depth."""
_RANSAC_ROUNDS = 60
"""Samples of features from which RANSAC tries a pose."""
_MOST_POSES = 20
"""Most images of a run whose pose is computed, spread over it: 16 Hz for steps at 2 Hz."""
_MOST_APART_S = 0.02
"""Most time between an image and the depth image that is taken for it, which is half a period of 25 Hz."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RunTracks:
    """N features of a run of K images, all of which the run's first image has; the calibration of the lens is in them.

    Attributes:
        t_ns: (K,) stamps of the images.
        depth: (N,) depths in the first image, m by the recorded unit.
        rays: (K, N, 2) normalised image coordinates x / z and y / z by the calibration.
        is_tracked: (K, N) whether a feature has been followed up to an image.
        pixel: Size of a pixel of the tracked images in normalised coordinates.
    """

    t_ns: Stamps
    depth: Array
    rays: Array
    is_tracked: Mask
    pixel: float


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraPath:
    """Poses of a camera in the frame of the first image of a run.

    Attributes:
        t_ns: (K,) stamps of the images, the first one's pose is the identity.
        R_first_camera: (K, 3, 3) rotations of the camera's axes at an image into those at the first one.
        p_camera_in_first: (K, 3) positions in the first image's axes, m by the recorded unit of depth: wrong by the
            factor by which the depths are.
    """

    t_ns: Stamps
    R_first_camera: Array
    p_camera_in_first: Array


def track_features(
    recording: Recording, camera: CameraCalibration, first: int, count: int, longest_s: float
) -> list[RunTracks]:
    """Tracks features through some images of a depth camera, in one or several runs.

    A run ends after `longest_s`, or when too few features are left; the next one begins with its last image.

    Args:
        recording: Recording with the images.
        camera: Calibration of the camera, which has a depth stream.
        first: Number of the first image.
        count: Number of images.
        longest_s: Longest run, s.

    Returns:
        The runs; none from a damaged image on, which is a problem of its own.
    """
    times = recording.image_times(camera.topic)[first : first + count]
    runs: list[RunTracks] = []
    try:
        run: _Run | None = None
        for number, t_ns in enumerate(times.tolist(), first):
            grey = read_small_grey(recording, camera, number)
            if run is not None and run.follow(grey, t_ns) and t_ns - run.t_ns[0] < longest_s * 1e9:
                continue
            if run is not None and len(run.t_ns) > 1:
                runs.append(run.to_tracks())
            depth = _read_nearest_depth(recording, camera, t_ns)
            run = None if depth is None else _begin_run(camera, grey, depth, t_ns)
        if run is not None and len(run.t_ns) > 1:
            runs.append(run.to_tracks())
    except StrideTwinError:  # a damaged image
        pass
    return runs


def solve_path(tracks: RunTracks, focal_factor: float = 1.0) -> CameraPath | None:
    """Poses of the camera along a run by perspective from n points (RANSAC, then least squares over the inliers).

    Args:
        tracks: The features.
        focal_factor: By which the calibrated focal lengths are multiplied.

    Returns:
        Poses of the first image and of up to `_MOST_POSES` others in which enough features fit; None if these are fewer
        than two.
    """
    rays = tracks.rays / focal_factor
    points = np.column_stack((rays[0], np.ones(len(tracks.depth)))) * tracks.depth[:, None]  # (N, 3) m
    stamps, rotations, positions = [tracks.t_ns[0]], [np.eye(3)], [np.zeros(3)]
    guess = np.zeros((3, 1)), np.zeros((3, 1))
    last = len(tracks.t_ns) - 1
    for i in np.unique(np.linspace(1, last, min(last, _MOST_POSES)).round().astype(int)).tolist():
        t_ns, image_rays, is_tracked = tracks.t_ns[i], rays[i], tracks.is_tracked[i]
        pose = _solve_pose(points[is_tracked], image_rays[is_tracked], tracks.pixel / focal_factor, guess)
        if pose is None:
            continue
        guess = pose
        R = np.asarray(cv2.Rodrigues(pose[0])[0], float)  # of the first image's axes into this image's
        stamps.append(t_ns)
        rotations.append(R.T)
        positions.append(-R.T @ pose[1].ravel())
    if len(stamps) < 3:
        return None
    return CameraPath(
        t_ns=np.array(stamps, np.int64), R_first_camera=np.array(rotations), p_camera_in_first=np.array(positions)
    )


def _solve_pose(points: Array, rays: Array, pixel: float, guess: tuple[Array, Array]) -> tuple[Array, Array] | None:
    """Rotation vector and translation (3, 1) that take points into the camera's axes; None with too few inliers.

    Args:
        points: (P, 3) m, in the axes of the run's first image.
        rays: (P, 2) normalised image coordinates in this image.
        pixel: Size of a pixel in them.
        guess: Rotation vector and translation of the image before.
    """
    if len(points) < _FEWEST_FEATURES:
        return None
    K, none = np.eye(3), np.zeros(4)
    if not np.isfinite(rays).all():
        return None
    is_solved, rotation, translation, inliers = cv2.solvePnPRansac(
        points,
        rays,
        K,
        none,
        rvec=guess[0].copy(),
        tvec=guess[1].copy(),
        useExtrinsicGuess=True,
        iterationsCount=_RANSAC_ROUNDS,
        reprojectionError=_INLIER_PX * pixel,
    )
    if not is_solved or inliers is None or len(inliers) < _FEWEST_FEATURES:
        return None
    at = inliers.ravel()
    rotation, translation = cv2.solvePnPRefineLM(points[at], rays[at], K, none, rotation, translation)
    return np.asarray(rotation, float), np.asarray(translation, float)


class _Run:
    """Features that are followed through a run of images.

    Args:
        camera: Calibration of the camera.
        grey: First image of the run, reduced.
        corners: (N, 2) px, the features in it.
        depth: (N,) their depths, m.
        t_ns: Stamp of the image.

    Attributes:
        t_ns: Stamps of the images so far.
    """

    def __init__(self, camera: CameraCalibration, grey: Grey, corners: Corners, depth: Array, t_ns: int) -> None:
        self._camera, self._grey, self._depth = camera, grey, depth
        self._corners, self._is_tracked = corners, np.ones(len(corners), bool)  # (N, 2) px in the last image
        self._pixels, self._masks = [corners], [self._is_tracked]
        self.t_ns = [t_ns]

    def follow(self, grey: Grey, t_ns: int) -> bool:
        """Adds the next image; False, and nothing is added, if too few features are left in it."""
        corners, is_followed = follow_corners(self._grey, grey, self._corners)
        height, width = grey.shape
        is_inside = np.all((corners >= 0) & (corners <= (width - 1, height - 1)), axis=1)
        is_tracked = self._is_tracked & is_followed & is_inside
        if np.count_nonzero(is_tracked) < _FEWEST_FEATURES:
            return False
        self._grey, self._corners, self._is_tracked = grey, corners, is_tracked
        self._pixels.append(corners)
        self._masks.append(is_tracked)
        self.t_ns.append(t_ns)
        return True

    def to_tracks(self) -> RunTracks:
        """The run's features as normalised image coordinates."""
        scale = self._grey.shape[1] / self._camera.width
        rays = find_rays(to_full_size(np.concatenate(self._pixels), scale), self._camera)
        return RunTracks(
            t_ns=np.array(self.t_ns, np.int64),
            depth=self._depth,
            rays=rays.reshape(len(self._pixels), -1, 2),
            is_tracked=np.array(self._masks),
            pixel=1.0 / (self._camera.intrinsics[0] * scale),
        )


def _begin_run(camera: CameraCalibration, grey: Grey, depth: DepthImage, t_ns: int) -> _Run | None:
    """A run that begins with an image and its depth; None if too few corners lie on a surface of known depth."""
    scale = grey.shape[1] / camera.width
    corners = find_corners(grey, _FEATURES)
    depths = _depths_of_surfaces(depth, corners, scale)
    has_depth = depths > 0.0
    if np.count_nonzero(has_depth) < _FEWEST_FEATURES:
        return None
    return _Run(camera, grey, corners[has_depth], depths[has_depth], t_ns)


def _read_nearest_depth(recording: Recording, camera: CameraCalibration, t_ns: int) -> DepthImage | None:
    """(H, W) depth image nearest to a time, m; None if none is near."""
    times = recording.image_times(camera.depth_topic)
    at = int(np.argmin(np.abs(times - t_ns)))
    if abs(int(times[at]) - t_ns) > _MOST_APART_S * 1e9:
        return None
    return read_depth(recording, camera, at)


def _depths_of_surfaces(depth: DepthImage, corners: Corners, scale: float) -> Array:
    """(N,) depths at N corners, m; 0 for those without depth or beside a discontinuity.

    Args:
        depth: (H, W) m.
        corners: (N, 2) pixels in the tracked, smaller image.
        scale: Width of that image relative to the depth image.
    """
    r = _SURFACE_PX
    height, width = depth.shape
    at = find_depth_pixels(corners, scale)
    is_inside = np.all((at >= r) & (at < (width - r, height - r)), axis=1)
    columns, rows = at[:, 0].clip(r, width - r - 1), at[:, 1].clip(r, height - r - 1)
    around = np.stack([depth[rows + i, columns + j] for i in range(-r, r + 1) for j in range(-r, r + 1)], axis=-1)
    has_depth = is_inside & (around.min(axis=1) > 0.0)
    inverse = 1.0 / np.where(has_depth[:, None], around, 1.0)  # (N, P), linear on a plane
    bend = np.abs(inverse + inverse[:, ::-1] - 2.0 * inverse[:, around.shape[1] // 2, None]).max(axis=1)
    mean = inverse.mean(axis=1)
    is_surface = has_depth & (bend < _BEND_SHARE * mean) & (np.ptp(inverse, axis=1) < _SLANT_SHARE * mean)
    return np.where(is_surface, 1.0 / mean, 0.0).astype(float)
