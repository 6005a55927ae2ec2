"""Depth of a stereo pair by semi-global matching (Hirschmüller 2008), for rigs without a depth camera."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.dvio.tracker import Lens
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import CameraCalibration, Rig
from stridetwin.streams.samples import Depth, Image, Sample

_SHRINK = 2  # matching takes a quarter of the pixels and an eighth of the time
_DISPARITIES, _BLOCK = 48, 5
_FIXED_POINT = 16.0  # OpenCV counts disparities in sixteenths of a pixel
_LEAST_PX = 1.0  # a smaller disparity tells next to nothing


class Stereo:
    """Gives each picture of the left camera its depth.

    Args:
        left: Calibration of the camera that the odometry follows.
        right: Of the other one, on the same body.
        topic: Of the depth.

    Raises:
        ConfigError: The two do not look at the same things side by side, or an unknown model of distortion.
    """

    def __init__(self, left: CameraCalibration, right: CameraCalibration, topic: str) -> None:
        self.topic, self._lens = topic, Lens(left)
        T = np.linalg.inv(right.mount.T_body_sensor) @ left.mount.T_body_sensor
        if T[0, 3] >= 0 or abs(T[0, 3]) < np.abs(T[1:3, 3]).max():
            raise ConfigError(right.topic, "mount", T[:3, 3].tolist(), f"a camera to the right of {left.topic}")
        size = (left.width, left.height)
        small = (left.width // _SHRINK, left.height // _SHRINK)
        fisheye = left.distortion_model == "equidistant"
        D = [np.array(c.distortion, dtype=float) for c in (left, right)]
        # Which way to turn each camera depends on the rotation between them alone.
        none = np.zeros(4)
        R1, R2, P1, P2 = cv2.stereoRectify(left.K, none, right.K, none, size, T[:3, :3], T[:3, 3:], alpha=0)[:4]
        P1, P2 = (np.diag([1 / _SHRINK, 1 / _SHRINK, 1.0]) @ P for P in (P1, P2))
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
            minDisparity=0, numDisparities=_DISPARITIES, blockSize=_BLOCK, P1=8 * _BLOCK**2, P2=32 * _BLOCK**2,
            disp12MaxDiff=1, uniquenessRatio=10, speckleWindowSize=60, speckleRange=2,
        )  # fmt: skip

    def depth(self, left: Image, right: Image) -> Depth:
        """Depth registered to the left picture, of its time; 0 where nothing is matched.

        Args:
            left: Grey or colour.
            right: Of the same time.
        """
        pair = [cv2.remap(_grey(p.pixels), *m, cv2.INTER_LINEAR) for p, m in zip((left, right), self._maps)]
        disparity = self._matcher.compute(*pair).astype(np.float32) / _FIXED_POINT
        seen = cv2.remap(disparity, self._column, self._row, cv2.INTER_NEAREST, borderValue=-1.0)
        with np.errstate(divide="ignore"):
            depth = np.where(seen >= _LEAST_PX, self._times_depth / (seen * self._along), 0.0)
        return Depth(topic=self.topic, t_ns=left.t_ns, depth=depth.astype(np.float32))


def with_stereo(rig: Rig, left: str, depth: str) -> Rig:
    """The rig, whose left camera now has depth.

    Args:
        rig: Of two cameras.
        left: Topic of the one that the odometry follows.
        depth: Topic of its depth to be.
    """
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
