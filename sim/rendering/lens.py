"""Lens distortion: the undistorted image to render, and its mapping to the distorted one."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array

_WIDEST = 4.0  # times the image size: a pinhole image cannot contain rays near 90 degrees


class Lens:
    """Lens of a camera with `radtan` (Brown-Conrady) or `equidistant` (Kannala-Brandt) distortion.

    Args:
        calibration: Intrinsics and distortion.

    Attributes:
        straight: Whether there is no distortion.
        width: Width of the pinhole image to render, pixels.
        height: Height of that image, pixels.
        intrinsics: Intrinsics of that image, (fu, fv, pu, pv).

    Raises:
        ConfigError: Coefficients that map the image border outside a pinhole image.
    """

    def __init__(self, calibration: CameraCalibration) -> None:
        self.straight = calibration.distortion_model == "radtan" and not any(calibration.distortion)
        self.width, self.height, self.intrinsics = calibration.width, calibration.height, calibration.intrinsics
        if self.straight:
            return
        fu, fv, pu, pv = calibration.intrinsics
        rays = _rays(calibration)
        u, v = fu * rays[..., 0] + pu, fv * rays[..., 1] + pv
        left, right = math.floor(u.min()) - 1, math.ceil(u.max()) + 1
        top, bottom = math.floor(v.min()) - 1, math.ceil(v.max()) + 1
        self.width, self.height = right - left + 1, bottom - top + 1
        if not self.width * self.height < _WIDEST**2 * calibration.width * calibration.height:
            valid = "coefficients with which every pixel is well below 90 deg off the axis"
            raise ConfigError(calibration.topic, "distortion", list(calibration.distortion), valid)
        self.intrinsics = fu, fv, pu - left, pv - top
        self._maps = (u - left).astype(np.float32), (v - top).astype(np.float32)

    def bent(self, image: NDArray, interpolation: int = cv2.INTER_LINEAR) -> NDArray:
        """The camera's image (H, W, ...) from a pinhole image (height, width, ...)."""
        return image if self.straight else np.asarray(cv2.remap(image, *self._maps, interpolation))


def _rays(calibration: CameraCalibration) -> Array:
    """(H, W, 2) x/z and y/z of the ray of each pixel."""
    v, u = np.mgrid[: calibration.height, : calibration.width].astype(float)
    points, d = np.stack([u, v], axis=-1).reshape(-1, 1, 2), np.array(calibration.distortion)
    undistorted = cv2.undistortPoints if calibration.distortion_model == "radtan" else cv2.fisheye.undistortPoints
    return np.asarray(undistorted(points, calibration.K, d), np.float64).reshape(
        calibration.height, calibration.width, 2
    )
