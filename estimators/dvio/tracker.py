"""The front end: points tracked from image to image (Lucas and Kanade 1981), new points, and stereo depth.

Stereo pairs are matched by semi-global matching (Hirschmüller 2008), for rigs without a depth camera.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.dvio import kernel
from stridetwin.estimators.dvio.parameters import DvioParameters
from stridetwin.estimators.dvio.patches import blank_patches
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import CameraCalibration, Rig
from stridetwin.streams.samples import Array, Depth, Image, Sample

_SCALES = 2  # of patches: full and half the resolution
Points = NDArray[np.float32]


class Lens:
    """From pixels to the plane at depth 1 and back.

    Raises:
        ConfigError: An unknown model of distortion.
    """

    def __init__(self, camera: CameraCalibration) -> None:
        if camera.distortion_model not in ("radtan", "equidistant"):
            raise ConfigError(camera.topic, "distortion_model", camera.distortion_model, "radtan or equidistant")
        self.shape = (camera.height, camera.width)
        self._fisheye = camera.distortion_model == "equidistant"
        self._distortion = np.array(camera.distortion, dtype=float)
        self._K, (fu, fv, pu, pv) = camera.K, camera.intrinsics
        self._centre, self._focal = np.array([pu, pv]), np.array([fu, fv])
        self.focal_px = float(np.sqrt(fu * fv))

    def normalised(self, pixels: NDArray[np.floating[Any]]) -> Array:
        """(N, 2) on the plane at depth 1 of (N, 2) pixels."""
        if not self._fisheye and not self._distortion.any():
            return np.asarray((pixels - self._centre) / self._focal)
        if not len(pixels):
            return np.zeros((0, 2))
        undistort = cv2.fisheye.undistortPoints if self._fisheye else cv2.undistortPoints
        return np.asarray(undistort(pixels[:, None].astype(float), self._K, self._distortion)[:, 0], dtype=float)

    def pixels(self, at: Array) -> Points:
        """(N, 2) pixels of (N, 2) on the plane at depth 1."""
        if self._fisheye and len(at):
            return np.asarray(cv2.fisheye.distortPoints(at[:, None], self._K, self._distortion)[:, 0], np.float32)
        x, y = at[:, 0], at[:, 1]
        k1, k2, p1, p2 = self._distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + k2 * r2)
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return (np.stack([xd, yd], axis=1) * self._focal + self._centre).astype(np.float32)


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraFrame:
    """One image of the camera.

    Attributes:
        t_ns: On the camera's clock.
        grey: (H, W).
        depth: (H, W) m, 0 where none; or None.
    """

    t_ns: int
    grey: NDArray[np.uint8]
    depth: NDArray[np.float32] | None


class Tracker:
    """Tracks points; keeps the last image.

    Args:
        shape: (H, W) of the images.
        parameters: Of the odometry; each landmark slot keeps a patch.
    """

    def __init__(self, shape: tuple[int, int], parameters: DvioParameters) -> None:
        self._shape, self._parameters = shape, parameters.tracking
        self._patches = [blank_patches(parameters.landmark_slots) for _ in range(_SCALES)]
        self._grey: NDArray[np.uint8] | None = None
        self._before: NDArray[np.uint8] | None = None
        self._scales: list[NDArray[np.uint8]] = []
        thresholds = (self._parameters.fast_threshold, self._parameters.fast_threshold_low)
        self._detectors = [cv2.FastFeatureDetector.create(t, True) for t in thresholds]

    def reset(self) -> None:
        """Restarts: no point is tracked into the next image."""
        self._grey, self._scales = None, []

    def take(self, grey: NDArray[np.uint8]) -> None:
        """Takes the next image, (H, W)."""
        self._before, self._grey, self._scales = self._grey, grey, []

    def follow(self, points: Points, start: Points) -> tuple[Points, NDArray[np.bool_]]:
        """Tracks points (N, 2) px of the previous image into the last one, from where they are expected there (N, 2).

        Returns their pixels and whether forward and backward tracking succeeded, (N,).
        """
        before, grey = self._before, self._grey
        if before is None or grey is None or not len(points):
            return points.copy(), np.zeros(len(points), bool)
        p, flags = self._parameters, cv2.OPTFLOW_USE_INITIAL_FLOW
        window = (p.window_px, p.window_px)
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, p.iterations, p.flow_settled_px)
        there, found, _ = cv2.calcOpticalFlowPyrLK(
            before, grey, points, start.copy(), winSize=window, maxLevel=p.levels, criteria=criteria, flags=flags
        )
        back, returned, _ = cv2.calcOpticalFlowPyrLK(
            grey, before, there, points.copy(), winSize=window, maxLevel=0, criteria=criteria, flags=flags
        )
        good = (found[:, 0] > 0) & (returned[:, 0] > 0)
        good &= np.abs(back - points).max(axis=1) < p.forward_backward_px
        height, width = self._shape
        good &= (there > 2).all(axis=1) & (there[:, 0] < width - 3) & (there[:, 1] < height - 3)
        return np.asarray(there, np.float32), good

    def anchor(self, slots: NDArray[np.int64], points: Points) -> None:
        """Stores the patches of the last image about (N, 2) px in slots (N,)."""
        for scale, (grey, patches) in enumerate(zip(self._smoothed(), self._patches)):
            kernel.cut(grey, slots, np.ascontiguousarray(points) / np.float32(2**scale), patches)

    def align(self, slots: NDArray[np.int64], points: Points, warps: Array) -> tuple[Points, NDArray[np.bool_]]:
        """Aligns points (N, 2) px with the patches in their slots (N,): at half the resolution, then whole.

        `warps` (N, 2, 2) map a patch's pixels to the image's. Returns pixels, and which were aligned, (N,).
        """
        half, found = points / np.float32(2.0), np.ones(len(points), bool)
        kernel.align(self._smoothed()[1], self._patches[1], slots, warps, self._parameters.coarse, half, found)
        points = np.where(found[:, None], np.float32(2.0) * half, points)
        return self.settle(slots, points, warps, np.ones(len(points), bool))

    def settle(
        self, slots: NDArray[np.int64], points: Points, warps: Array, good: NDArray[np.bool_]
    ) -> tuple[Points, NDArray[np.bool_]]:
        """As `align`, but only at the whole resolution and for points that are `good`, (N,)."""
        points, good = points.copy(), good.copy()
        kernel.align(self._smoothed()[0], self._patches[0], slots, warps, self._parameters.fine, points, good)
        return points, good

    def _smoothed(self) -> list[NDArray[np.uint8]]:
        assert self._grey is not None
        if not self._scales:
            smooth = np.asarray(cv2.GaussianBlur(self._grey, (3, 3), 0.0), np.uint8)
            self._scales = [smooth, np.asarray(cv2.pyrDown(smooth), np.uint8)]
        return self._scales

    def find(self, taken: Points, wanted: int) -> Points:
        """(N, 2) px, new points in the last image, N ≤ wanted, away from existing ones."""
        out = np.zeros((max(wanted, 0), 2), np.float32)
        if wanted <= 0 or self._grey is None:
            return out
        count, p = 0, self._parameters
        for detector in self._detectors:
            corners = detector.detect(self._grey)
            candidates = np.array([c.pt for c in corners], np.float32).reshape(-1, 2)
            count = self._pick(candidates, np.ascontiguousarray(taken), out)
            if count >= p.found_share * wanted:
                break
        return out[:count]

    def _pick(self, candidates: Points, taken: Points, out: Points) -> int:
        """The best candidates (N, 2) px into `out`, see `kernel.pick`; returns their number."""
        assert self._grey is not None
        p, score = self._parameters.corners, np.empty(len(candidates))
        kernel.cornerness(self._grey, candidates, p, score)
        order = np.argsort(-score, kind="stable")
        order = order[: np.count_nonzero(score >= 0.0)]
        return int(kernel.pick(self._shape, candidates, order, taken, p, np.empty((p.rows, p.columns), int), out))


@dataclass(frozen=True, kw_only=True)
class StereoParameters:
    """Semi-global matching of stereo pairs; the penalties are those that OpenCV recommends."""

    shrink: int = 2
    """Matching takes an eighth of the time on a quarter of the pixels."""
    disparities: int = 48
    """Number of disparities searched, pixels; a multiple of 16."""
    block_px: int = 5
    """Edge of the window that is compared."""
    small_step_penalty: int = 8
    """Of a disparity step of one pixel, times the window's area."""
    large_step_penalty: int = 32
    """Of a larger one."""
    left_right_px: int = 1
    """Largest difference of the disparities from left to right and back."""
    uniqueness_percent: int = 10
    """By which the best cost is below the second."""
    speckle_size: int = 60
    """Smaller regions are dropped, pixels."""
    speckle_range: int = 2
    """Largest step of the disparity within a region."""
    disparity_min_px: float = 1.0
    """A smaller one is nearly uninformative."""


_FIXED_POINT = 16.0  # OpenCV's disparities are in sixteenths of a pixel


class Stereo:
    """Depth of each image of the left camera.

    Args:
        left: Calibration of the camera that the odometry follows.
        right: Of the other one, on the same body.
        topic: Of the depth.
        parameters: Of the matching.

    Raises:
        ConfigError: The two do not view the same scene side by side, or an unknown model of distortion.
    """

    def __init__(
        self, left: CameraCalibration, right: CameraCalibration, topic: str, parameters: StereoParameters | None = None
    ) -> None:
        p = self._parameters = parameters or StereoParameters()
        self.topic, self._lens = topic, Lens(left)
        T = np.linalg.inv(right.mount.T_body_sensor) @ left.mount.T_body_sensor
        if T[0, 3] >= 0 or abs(T[0, 3]) < np.abs(T[1:3, 3]).max():
            raise ConfigError(right.topic, "mount", T[:3, 3].tolist(), f"a camera to the right of {left.topic}")
        size = (left.width, left.height)
        small = (left.width // p.shrink, left.height // p.shrink)
        fisheye = left.distortion_model == "equidistant"
        D = [np.array(c.distortion, dtype=float) for c in (left, right)]
        # The rectifying rotation of each camera depends only on the rotation between them.
        none = np.zeros(4)
        R1, R2, P1, P2 = cv2.stereoRectify(left.K, none, right.K, none, size, T[:3, :3], T[:3, 3:], alpha=0)[:4]
        P1, P2 = (np.diag([1 / p.shrink, 1 / p.shrink, 1.0]) @ P for P in (P1, P2))
        maps = cv2.fisheye.initUndistortRectifyMap if fisheye else cv2.initUndistortRectifyMap
        self._maps = [
            maps(c.K, d, R, P[:, :3], small, cv2.CV_16SC2) for c, d, R, P in zip((left, right), D, (R1, R2), (P1, P2))
        ]
        self._times_depth = float(-P2[0, 3])  # disparity, px, of a point at 1 m
        v, u = np.mgrid[: left.height, : left.width]
        pixels = np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float32)
        rays = np.concatenate([self._lens.normalised(pixels), np.ones((len(pixels), 1))], axis=1) @ R1.T
        at = rays[:, :2] / rays[:, 2:] * [P1[0, 0], P1[1, 1]] + [P1[0, 2], P1[1, 2]]
        shape = (left.height, left.width)
        self._column, self._row = (np.ascontiguousarray(a.astype(np.float32).reshape(shape)) for a in at.T)
        self._along = rays[:, 2].astype(np.float32).reshape(shape)
        self._matcher = cv2.StereoSGBM.create(
            minDisparity=0, numDisparities=p.disparities, blockSize=p.block_px, disp12MaxDiff=p.left_right_px,
            P1=p.small_step_penalty * p.block_px**2, P2=p.large_step_penalty * p.block_px**2,
            uniquenessRatio=p.uniqueness_percent, speckleWindowSize=p.speckle_size, speckleRange=p.speckle_range,
        )  # fmt: skip

    def depth(self, left: Image, right: Image) -> Depth:
        """Depth registered to the left of two images of the same time; 0 where there is no match."""
        pair = [cv2.remap(_grey(p.pixels), *m, cv2.INTER_LINEAR) for p, m in zip((left, right), self._maps)]
        disparity = self._matcher.compute(*pair).astype(np.float32) / _FIXED_POINT
        seen = cv2.remap(disparity, self._column, self._row, cv2.INTER_NEAREST, borderValue=-1.0)
        with np.errstate(divide="ignore"):
            depth = np.where(seen >= self._parameters.disparity_min_px, self._times_depth / (seen * self._along), 0.0)
        return Depth(topic=self.topic, t_ns=left.t_ns, depth=depth.astype(np.float32))


def with_stereo(rig: Rig, left: str, depth: str) -> Rig:
    """The rig with a depth stream for its camera `left`."""
    return replace(rig, cameras={**rig.cameras, left: replace(rig.cameras[left], depth_topic=depth)})


def with_depth(samples: Iterable[Sample], stereo: Stereo, right: str) -> Iterator[Sample]:
    """The samples, in which the depth of each stereo pair replaces the images of the topic `right`."""
    pair: dict[bool, Image] = {}
    for sample in samples:
        if isinstance(sample, Image):
            pair[sample.topic == right] = sample
        if not (isinstance(sample, Image) and sample.topic == right):
            yield sample
        if len(pair) == 2 and pair[False].t_ns == pair[True].t_ns:
            yield stereo.depth(pair[False], pair[True])
            pair.clear()


def _grey(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return pixels if pixels.ndim == 2 else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY), np.uint8)
