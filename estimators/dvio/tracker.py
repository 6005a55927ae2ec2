"""The front end: points tracked from image to image (Lucas and Kanade 1981), new points, and stereo depth.

Stereo pairs are matched by semi-global matching (Hirschmüller 2008), for rigs without a depth camera.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.dvio import kernel
from stridetwin.estimators.dvio.patches import AlignmentLimits, blank_patches
from stridetwin.estimators.dvio.projection import directions
from stridetwin.estimators.dvio.state import LANDMARK_SLOTS, Calibration
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import CameraCalibration, Rig
from stridetwin.streams.samples import Array, Depth, Image, Sample

_SCALES = 2  # of patches: full and half the resolution
# Hand-chosen on tuning seeds: optical flow, alignment at the whole resolution and at half of it, and new corners.
_FLOW_WINDOW_PX, _FLOW_LEVELS, _FLOW_STEPS = 15, 2, 12  # levels above the whole resolution, and steps per level
_FLOW_SETTLED_PX = 0.02  # smaller steps end the iteration
_MAX_FORWARD_BACKWARD_PX = 0.7
FINE = AlignmentLimits(max_move_px=2.0, min_correlation=0.8, settled_px=0.01)
_COARSE = AlignmentLimits(max_move_px=4.0, min_correlation=0.6, settled_px=0.1)
_GRID = (8, 10)  # rows and columns of cells over which new points are spread
_MIN_DISTANCE_PX = 16.0  # of a new point from others
_MIN_CORNERNESS, _MIN_ROUNDNESS = 6.0, 0.2  # grey levels² a pixel²; lesser over greater eigenvalue
_FAST_THRESHOLDS = (14, 5)  # grey levels; the second one if the first one finds too few corners
_ENOUGH_SHARE = 0.7  # the search stops at this share of the corners wanted
Points = NDArray[np.float32]


class Lens:
    """Maps pixels to the plane at depth 1 and back, and corrects the rolling shutter: docs/dvio.md (14).

    Each row is exposed a little later than the one above; the middle one at the image's time. While the camera moves, a
    point is therefore seen where it was or will be.

    Args:
        camera: Intrinsics, distortion and readout time.

    Attributes:
        shape: (H, W) of an image.
        focal_px: Mean focal length, px.

    Raises:
        ConfigError: An unknown model of distortion.
    """

    def __init__(self, camera: CameraCalibration) -> None:
        """Raises ConfigError where the model of distortion is unknown."""
        if camera.distortion_model not in ("radtan", "equidistant"):
            raise ConfigError(camera.topic, "distortion_model", camera.distortion_model, "radtan or equidistant")
        self.shape = (camera.height, camera.width)
        self._fisheye = camera.distortion_model == "equidistant"
        self._distortion = np.array(camera.distortion, dtype=float)
        self._K, (fu, fv, pu, pv) = camera.K, camera.intrinsics  # focal lengths and principal point, px
        self._centre, self._focal = np.array([pu, pv]), np.array([fu, fv])
        self.focal_px = float(np.sqrt(fu * fv))
        # time from the exposure of the first row to that of the last (0: global shutter), and the last row's index
        self._readout_s, self._last_row = camera.readout_s, max(camera.height - 1, 1)

    def to_normalized(self, pixels: NDArray[np.floating]) -> Array:
        """(N, 2) points on the plane at depth 1 of (N, 2) pixels, without distortion."""
        if not self._fisheye and not self._distortion.any():  # no distortion: a plain pinhole
            return np.asarray((pixels - self._centre) / self._focal)
        if not len(pixels):  # OpenCV refuses empty arrays
            return np.zeros((0, 2))
        undistort = cv2.fisheye.undistortPoints if self._fisheye else cv2.undistortPoints
        return np.asarray(undistort(pixels[:, None].astype(float), self._K, self._distortion)[:, 0], dtype=float)

    def pixels(self, at: Array) -> Points:
        """(N, 2) pixels of (N, 2) points on the plane at depth 1, with distortion."""
        if not len(at):  # OpenCV refuses empty arrays
            return np.zeros((0, 2), np.float32)
        if self._fisheye:
            return np.asarray(cv2.fisheye.distortPoints(at[:, None], self._K, self._distortion)[:, 0], np.float32)
        # the rays are points in the camera's own axes: rotation and translation are 0
        projected = cv2.projectPoints(directions(at), np.zeros(3), np.zeros(3), self._K, self._distortion)[0]
        return np.asarray(projected[:, 0], np.float32)

    def at_image_time(
        self, points: Points, inverse_depth: Array, calibration: Calibration, R: Array, v: Array, rate: Array
    ) -> Points:
        """Pixels at which resting points would be if all rows were exposed at the time of the image.

        Args:
            points: (N, 2) px, as seen.
            inverse_depth: (N,) 1/m.
            calibration: Mount of the camera on the IMU.
            R: (3, 3) world <- IMU.
            v: (3,) velocity of the IMU in the world, m/s.
            rate: (3,) angular rate of the IMU, rad/s.

        Returns:
            (N, 2) px; `points` itself for a global shutter.
        """
        if not self._readout_s or not len(points):
            return points
        # (N,) s, time from the image's stamp to the exposure of each point's row
        late_s = (points[:, 1] / self._last_row - 0.5) * self._readout_s
        at, c = self.to_normalized(points), calibration
        # of the camera in its own axes; `c.R` is IMU <- camera, `c.p` the camera in the IMU's frame
        camera_velocity, camera_rate = c.R.T @ (R.T @ v + np.cross(rate, c.p)), c.R.T @ rate
        flow = image_velocity(at, inverse_depth, camera_velocity, camera_rate)
        return self.pixels(at - late_s[:, None] * flow)


def image_velocity(at: Array, inverse_depth: Array, velocity: Array, rate: Array) -> Array:
    """(N, 2) 1/s, motion on the plane at depth 1 of resting points, as the camera moves: docs/dvio.md (14).

    After Longuet-Higgins & Prazdny 1980.

    Args:
        at: (N, 2) points on the plane at depth 1.
        inverse_depth: (N,) 1/m.
        velocity: (3,) velocity of the camera in its own axes, m/s.
        rate: (3,) angular rate of the camera in its own axes, rad/s.
    """
    x, y = at.T
    (vx, vy, vz), (wx, wy, wz) = velocity, rate
    return np.column_stack(
        [
            inverse_depth * (x * vz - vx) + wx * x * y - wy * (1.0 + x * x) + wz * y,
            inverse_depth * (y * vz - vy) + wx * (1.0 + y * y) - wy * x * y - wz * x,
        ]
    )


def flow_matrix(at: Array, inverse_depth: Array) -> Array:
    """(N, 2, 6) derivative of `image_velocity` by the velocity and the rate of the camera, in which it is linear.

    Args:
        at: (N, 2) points on the plane at depth 1.
        inverse_depth: (N,) 1/m.
    """
    unit = np.eye(3)
    by_velocity = [image_velocity(at, inverse_depth, axis, np.zeros(3)) for axis in unit]
    by_rate = [image_velocity(at, inverse_depth, np.zeros(3), axis) for axis in unit]
    return np.stack([*by_velocity, *by_rate], axis=-1)


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraFrame:
    """An image of the camera with the depth image of the same instant, as the tracker takes them.

    Attributes:
        t_ns: Time on the camera's clock.
        grey: (H, W) grey image.
        depth: (H, W) depth image, m, 0 where none; or None.
    """

    t_ns: int
    grey: NDArray[np.uint8]
    depth: NDArray[np.float32] | None


class Tracker:
    """Tracks points; keeps the last image and one patch per landmark slot.

    Args:
        shape: (H, W) of the images.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        """Begins without an image; `shape` is (H, W) of the images."""
        self._shape = shape
        # Per scale: the patches of all landmark slots. `_grey` is the last image, `_before` the one before; `_scales`
        # is the last one's pyramid, empty until it is needed.
        self._patches = [blank_patches(LANDMARK_SLOTS) for _ in range(_SCALES)]
        self._grey: NDArray[np.uint8] | None = None
        self._before: NDArray[np.uint8] | None = None
        self._scales: list[NDArray[np.uint8]] = []
        self._detectors = [cv2.FastFeatureDetector.create(t, True) for t in _FAST_THRESHOLDS]

    def reset(self) -> None:
        """Restarts: no point is tracked into the next image."""
        self._grey, self._scales = None, []

    def set_image(self, grey: NDArray[np.uint8]) -> None:
        """Makes `grey` (H, W) the last image, and the one that was so far the previous image."""
        self._before = self._grey
        self._grey = grey
        self._scales = []  # the pyramid of the new image is computed when it is needed

    def track(self, points: Points, start: Points) -> tuple[Points, NDArray[np.bool_]]:
        """Tracks points of the previous image into the last one (Lucas and Kanade 1981, pyramid).

        Args:
            points: (N, 2) px in the previous image.
            start: (N, 2) px, where they are expected in the last one.

        Returns:
            (N, 2) px, and (N,) whether forward and backward tracking succeeded and agree.
        """
        before, grey = self._before, self._grey
        if before is None or grey is None or not len(points):  # nothing to track, as after `reset`
            return points.copy(), np.zeros(len(points), bool)
        flags, window = cv2.OPTFLOW_USE_INITIAL_FLOW, (_FLOW_WINDOW_PX, _FLOW_WINDOW_PX)
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _FLOW_STEPS, _FLOW_SETTLED_PX)
        tracked, status, _ = cv2.calcOpticalFlowPyrLK(
            before, grey, points, start.copy(), winSize=window, maxLevel=_FLOW_LEVELS, criteria=criteria, flags=flags
        )
        # back again from the result, at the whole resolution only
        back, back_status, _ = cv2.calcOpticalFlowPyrLK(
            grey, before, tracked, points.copy(), winSize=window, maxLevel=0, criteria=criteria, flags=flags
        )
        good = (status[:, 0] > 0) & (back_status[:, 0] > 0)
        good &= np.abs(back - points).max(axis=1) < _MAX_FORWARD_BACKWARD_PX
        height, width = self._shape
        # not at the border, where the image's neighbours are missing
        good &= (tracked > 2).all(axis=1) & (tracked[:, 0] < width - 3) & (tracked[:, 1] < height - 3)
        return np.asarray(tracked, np.float32), good

    def store_patches(self, slots: NDArray[np.int64], points: Points) -> None:
        """Stores the patches of the last image about (N, 2) px in slots (N,)."""
        # scale 0 is the full resolution, scale 1 half of it
        for scale, (grey, patches) in enumerate(zip(self._image_pyramid(), self._patches)):
            scaled_points = np.ascontiguousarray(points) / np.float32(2**scale)
            kernel.cut_patches(grey, slots, scaled_points, patches)

    def align(self, slots: NDArray[np.int64], points: Points, warps: Array) -> tuple[Points, NDArray[np.bool_]]:
        """Aligns points (N, 2) px with the patches in their slots (N,): at half the resolution, then whole.

        `warps` (N, 2, 2) map a patch's pixels to the image's. Returns (N, 2) px, and (N,) which were aligned. A point
        that cannot be aligned at half the resolution is still tried at the whole one, from its first guess.
        """
        half_points, is_aligned = points / np.float32(2.0), np.ones(len(points), bool)  # changed by `kernel.align`
        kernel.align(self._image_pyramid()[1], self._patches[1], slots, warps, _COARSE, half_points, is_aligned)
        points = np.where(is_aligned[:, None], np.float32(2.0) * half_points, points)
        return self.align_fine(slots, points, warps, np.ones(len(points), bool))

    def align_fine(
        self, slots: NDArray[np.int64], points: Points, warps: Array, good: NDArray[np.bool_]
    ) -> tuple[Points, NDArray[np.bool_]]:
        """Aligns points with the patches in their slots at the whole resolution, from a good guess.

        Args:
            slots: (N,) landmark slots.
            points: (N, 2) px, guess.
            warps: (N, 2, 2) maps from a patch's pixels to the image's.
            good: (N,) points that are False are skipped.

        Returns:
            (N, 2) px, and (N,) which points were aligned.
        """
        points, good = points.copy(), good.copy()  # `kernel.align` changes both
        kernel.align(self._image_pyramid()[0], self._patches[0], slots, warps, FINE, points, good)
        return points, good

    def _image_pyramid(self) -> list[NDArray[np.uint8]]:
        """The last image, smoothed, at full and at half resolution; computed once per image."""
        assert self._grey is not None  # `set_image` was called
        if not self._scales:
            smooth = np.asarray(cv2.GaussianBlur(self._grey, (3, 3), 0.0), np.uint8)
            self._scales = [smooth, np.asarray(cv2.pyrDown(smooth), np.uint8)]
        return self._scales

    def find(self, taken: Points, wanted: int) -> Points:
        """(N, 2) px, new points in the last image, spread over it and away from existing ones.

        Args:
            taken: (M, 2) px, existing points.
            wanted: Largest number of new points; N may be smaller.
        """
        out = np.zeros((max(wanted, 0), 2), np.float32)
        if wanted <= 0 or self._grey is None:
            return out
        count = 0
        # A detector with a lower threshold follows only if the one before gives too few points.
        for detector in self._detectors:
            candidates = np.array([c.pt for c in detector.detect(self._grey)], np.float32).reshape(-1, 2)
            score = np.empty(len(candidates))  # -1 for a candidate that is no corner
            kernel.cornerness(self._grey, candidates, _MIN_CORNERNESS, _MIN_ROUNDNESS, score)
            corner_count = np.count_nonzero(score >= 0.0)
            order = np.argsort(-score, kind="stable")[:corner_count]  # the corners, from the best
            cells = np.empty(_GRID, int)  # buffer of `kernel.pick`
            count = kernel.pick(
                self._shape, candidates, order, np.ascontiguousarray(taken), _MIN_DISTANCE_PX, cells, out
            )
            if count >= _ENOUGH_SHARE * wanted:
                break
        return out[:count]


# Semi-global matching of stereo pairs; the penalties are those that OpenCV recommends.
_SHRINK = 2  # matching takes an eighth of the time on a quarter of the pixels
_DISPARITIES = 48  # number searched, pixels; a multiple of 16
_BLOCK_PX = 5  # edge of the window that is compared
_SMALL_STEP_PENALTY, _LARGE_STEP_PENALTY = 8, 32  # disparity steps of one pixel, and of more, times the window's area
_MAX_LEFT_RIGHT_PX = 1  # difference of the disparities from left to right and back
_UNIQUENESS_PERCENT = 10  # by which the best cost is below the second
_MIN_REGION_PX, _MAX_REGION_STEP = 60, 2  # smaller regions are dropped; step of the disparity within one
_MIN_DISPARITY_PX = 1.0  # a smaller one is nearly uninformative
_FIXED_POINT = 16.0  # OpenCV's disparities are in sixteenths of a pixel


class Stereo:
    """Depth images for the left camera of a stereo pair by semi-global matching.

    Args:
        left: Calibration of the camera that the odometry follows.
        right: Calibration of the other camera, on the same body.
        topic: Topic of the depth images.

    Raises:
        ConfigError: The two do not view the same scene side by side, or an unknown model of distortion.
    """

    def __init__(self, left: CameraCalibration, right: CameraCalibration, topic: str) -> None:
        """Prepares rectification and matching; `topic` is that of the depth images.

        Raises ConfigError where the right camera is not beside the left one, or the model of distortion is unknown.
        """
        self.topic, self._lens = topic, Lens(left)
        # (4, 4) right camera <- left camera; the left one must lie to the left, more than above or before
        T = np.linalg.inv(right.mount.T_body_sensor) @ left.mount.T_body_sensor
        if T[0, 3] >= 0 or abs(T[0, 3]) < np.abs(T[1:3, 3]).max():
            raise ConfigError(right.topic, "mount", T[:3, 3].tolist(), f"a camera to the right of {left.topic}")
        size = (left.width, left.height)
        small = (left.width // _SHRINK, left.height // _SHRINK)
        fisheye = left.distortion_model == "equidistant"
        D = [np.array(c.distortion, dtype=float) for c in (left, right)]
        # The rectifying rotation of each camera depends only on the pose between them, so it is computed without
        # distortion. R1, R2 (3, 3): rectified camera <- camera; P1, P2 (3, 4): projections of the rectified cameras.
        none = np.zeros(4)
        R1, R2, P1, P2 = cv2.stereoRectify(left.K, none, right.K, none, size, T[:3, :3], T[:3, 3:], alpha=0)[:4]
        P1, P2 = (np.diag([1 / _SHRINK, 1 / _SHRINK, 1.0]) @ P for P in (P1, P2))
        compute_map = cv2.fisheye.initUndistortRectifyMap if fisheye else cv2.initUndistortRectifyMap
        # maps of both cameras to their rectified images, at 1 / `_SHRINK` of the resolution
        self._maps = [
            compute_map(c.K, d, R, P[:, :3], small, cv2.CV_16SC2)
            for c, d, R, P in zip((left, right), D, (R1, R2), (P1, P2))
        ]
        self._times_depth = float(-P2[0, 3])  # disparity, px, of a point at 1 m
        v, u = np.mgrid[: left.height, : left.width]
        pixels = np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float32)
        # Per pixel of the left image: where it is in the rectified one (`_column`, `_row`), and its depth there over
        # its depth here (`_along`), which is the third entry of its ray (x, y, 1) in the rectified axes.
        rays = np.concatenate([self._lens.to_normalized(pixels), np.ones((len(pixels), 1))], axis=1) @ R1.T
        # (H W, 2) px in the rectified image
        at = rays[:, :2] / rays[:, 2:] * [P1[0, 0], P1[1, 1]] + [P1[0, 2], P1[1, 2]]
        shape = (left.height, left.width)
        self._column, self._row = (np.ascontiguousarray(a.astype(np.float32).reshape(shape)) for a in at.T)
        self._along = rays[:, 2].astype(np.float32).reshape(shape)
        # semi-global matching of the rectified images
        self._matcher = cv2.StereoSGBM.create(
            minDisparity=0,
            numDisparities=_DISPARITIES,
            blockSize=_BLOCK_PX,
            disp12MaxDiff=_MAX_LEFT_RIGHT_PX,
            P1=_SMALL_STEP_PENALTY * _BLOCK_PX**2,
            P2=_LARGE_STEP_PENALTY * _BLOCK_PX**2,
            uniquenessRatio=_UNIQUENESS_PERCENT,
            speckleWindowSize=_MIN_REGION_PX,
            speckleRange=_MAX_REGION_STEP,
        )

    def depth(self, left: Image, right: Image) -> Depth:
        """Depth image, m, registered to the left image of a pair of the same time; 0 where there is no match."""
        rectified_pair = [
            cv2.remap(_to_grey(image.pixels), *maps, cv2.INTER_LINEAR) for image, maps in zip((left, right), self._maps)
        ]
        rectified_disparity = self._matcher.compute(*rectified_pair).astype(np.float32) / _FIXED_POINT
        # from the rectified image back to the left one: at each pixel, px; -1 outside
        disparity = cv2.remap(rectified_disparity, self._column, self._row, cv2.INTER_NEAREST, borderValue=-1.0)
        with np.errstate(divide="ignore"):
            # depth in the rectified camera is `_times_depth` / disparity; `_along` converts it to the left camera's
            depth = np.where(disparity >= _MIN_DISPARITY_PX, self._times_depth / (disparity * self._along), 0.0)
        return Depth(topic=self.topic, t_ns=left.t_ns, depth=depth.astype(np.float32))


def with_stereo(rig: Rig, left: str, depth: str) -> Rig:
    """A copy of the rig whose camera of the topic `left` has the depth stream of the topic `depth`."""
    return replace(rig, cameras={**rig.cameras, left: replace(rig.cameras[left], depth_topic=depth)})


def with_depth(samples: Iterable[Sample], stereo: Stereo, right: str) -> Iterator[Sample]:
    """The samples, in which the depth of each stereo pair replaces the images of the topic `right`.

    A pair has equal stamps; its depth comes right after the later of the two images. Images of the right camera are not
    passed on.
    """
    pair: dict[bool, Image] = {}  # the newest image of each camera; True is the right one
    for sample in samples:
        if isinstance(sample, Image):
            pair[sample.topic == right] = sample
        if not (isinstance(sample, Image) and sample.topic == right):
            yield sample
        if len(pair) == 2 and pair[False].t_ns == pair[True].t_ns:
            yield stereo.depth(pair[False], pair[True])
            pair.clear()


def _to_grey(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(H, W) grey values of a grey or RGB image."""
    return pixels if pixels.ndim == 2 else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY), np.uint8)
