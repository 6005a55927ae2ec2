"""The front end: points followed from picture to picture (Lucas and Kanade 1981), and new ones where there are few."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.dvio import kernel
from stridetwin.estimators.dvio.parameters import DvioParameters
from stridetwin.estimators.dvio.patches import blank_patches
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array

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


class Tracker:
    """Follows points; keeps the last picture.

    Args:
        shape: (H, W) of the pictures.
        parameters: Of the odometry; each landmark slot keeps a patch.
    """

    def __init__(self, shape: tuple[int, int], parameters: DvioParameters) -> None:
        self._shape, self._parameters = shape, parameters.tracking
        self._patches = [blank_patches(parameters.landmark_slots) for _ in range(_SCALES)]
        self._most_px, self._least = parameters.forward_backward_px, parameters.corner_least
        self._grey: NDArray[np.uint8] | None = None
        self._before: NDArray[np.uint8] | None = None
        self._scales: list[NDArray[np.uint8]] = []
        thresholds = (self._parameters.fast_threshold, self._parameters.fast_threshold_low)
        self._detectors = [cv2.FastFeatureDetector.create(t, True) for t in thresholds]

    def forget(self) -> None:
        """Follows nothing into the next picture."""
        self._grey, self._scales = None, []

    def take(self, grey: NDArray[np.uint8]) -> None:
        """Takes the next picture, (H, W)."""
        self._before, self._grey, self._scales = self._grey, grey, []

    def follow(self, points: Points, start: Points) -> tuple[Points, NDArray[np.bool_]]:
        """Points of the picture before the last one, by how they looked there.

        Args:
            points: (N, 2) px there.
            start: (N, 2) px where they are expected in the last one.

        Returns:
            (N, 2) px where they are, and (N,) whether they could be followed there and back.
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
        good &= np.abs(back - points).max(axis=1) < self._most_px
        height, width = self._shape
        good &= (there > 2).all(axis=1) & (there[:, 0] < width - 3) & (there[:, 1] < height - 3)
        return np.asarray(there, np.float32), good

    def anchor(self, slots: NDArray[np.int64], points: Points) -> None:
        """Keeps the patches of the last picture about (N, 2) px in slots (N,)."""
        for scale, (grey, patches) in enumerate(zip(self._smoothed(), self._patches)):
            kernel.cut(grey, slots, np.ascontiguousarray(points) / np.float32(2**scale), patches)

    def align(
        self, slots: NDArray[np.int64], points: Points, warps: Array, far: float, alike: float
    ) -> tuple[Points, NDArray[np.bool_]]:
        """Points of the last picture, each moved to where its slot's patch lies: at half the resolution, then whole.

        Args:
            slots: (N,) of their patches.
            points: (N, 2) px.
            warps: (N, 2, 2) from the patch's pixels to the picture's.
            far: Largest move at the whole resolution, px.
            alike: Least correlation with the patch.

        Returns:
            (N, 2) px, and (N,) which of them are there.
        """
        half, found = points / np.float32(2.0), np.ones(len(points), bool)
        p = self._parameters
        kernel.align(
            self._smoothed()[1], self._patches[1], slots, warps, p.coarse_reach_px / 2.0, p.coarse_likeness,
            p.coarse_settled_px, half, found,
        )  # fmt: skip
        points = np.where(found[:, None], np.float32(2.0) * half, points)
        return self.settle(slots, points, warps, np.ones(len(points), bool), far, alike)

    def settle(
        self, slots: NDArray[np.int64], points: Points, warps: Array, good: NDArray[np.bool_], far: float, alike: float
    ) -> tuple[Points, NDArray[np.bool_]]:
        """As `align`, but only at the whole resolution, of those points that are `good`, (N,)."""
        points, good = points.copy(), good.copy()
        kernel.align(
            self._smoothed()[0], self._patches[0], slots, warps, far, alike, self._parameters.settled_px, points, good
        )
        return points, good

    def _smoothed(self) -> list[NDArray[np.uint8]]:
        assert self._grey is not None
        if not self._scales:
            smooth = np.asarray(cv2.GaussianBlur(self._grey, (3, 3), 0.0), np.uint8)
            self._scales = [smooth, np.asarray(cv2.pyrDown(smooth), np.uint8)]
        return self._scales

    def find(self, taken: Points, wanted: int) -> Points:
        """(N, 2) px, new points in the last picture, N ≤ wanted, away from those that there are."""
        out = np.zeros((max(wanted, 0), 2), np.float32)
        if wanted <= 0 or self._grey is None:
            return out
        count, p = 0, self._parameters
        for detector in self._detectors:
            corners = detector.detect(self._grey)
            candidates = np.array([c.pt for c in corners], np.float32).reshape(-1, 2)
            count = kernel.pick(
                self._grey,
                candidates,
                np.ascontiguousarray(taken),
                p.cells_x,
                p.cells_y,
                p.apart_px,
                p.margin_px,
                self._least,
                wanted,
                out,
            )
            if count >= p.found_share * wanted:
                break
        return out[:count]
