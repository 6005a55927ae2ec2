"""A camera's lens: pixels to rays and back, for both distortion models of a calibration."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array

MODELS = ("radtan", "equidistant")
_FOLD_STEPS = 200  # how finely a distortion is searched for the angle where it folds back
_TAN_MAX = 4.0  # no shoe camera sees farther off its axis than 76 degrees


class Lens:
    """Projects rays (x / z, y / z in the optical frame) to pixels and back.

    Args:
        camera: Intrinsics and distortion.

    Attributes:
        size: (width, height) in pixels.
        focal_px: Mean focal length.
        reach: Largest length of a ray that the distortion maps one to one.

    Raises:
        ConfigError: A distortion model that is not known.
    """

    def __init__(self, camera: CameraCalibration) -> None:
        if camera.distortion_model not in MODELS:
            raise ConfigError(camera.topic, "distortion_model", camera.distortion_model, ", ".join(MODELS))
        self._fisheye = camera.distortion_model == "equidistant"
        self._K, self._D = camera.K, np.asarray(camera.distortion, dtype=float)
        self.size = (camera.width, camera.height)
        self.focal_px = (camera.intrinsics[0] + camera.intrinsics[1]) / 2
        r = np.linspace(0.0, _TAN_MAX, _FOLD_STEPS)
        falls = np.diff(self._distort(np.column_stack([r, np.zeros_like(r)]))[:, 0]) <= 0
        self.reach = float(r[falls.argmax()]) if falls.any() else _TAN_MAX

    def pixels(self, rays: ArrayLike) -> Array:
        """(N, 2) pixels of (N, 2) rays; NaN beyond `reach`, where the polynomial folds the world back."""
        rays = np.asarray(rays, dtype=float)
        fu, fv, pu, pv = self._K[0, 0], self._K[1, 1], self._K[0, 2], self._K[1, 2]
        pixels = self._distort(rays) * (fu, fv) + (pu, pv)
        pixels[~(np.einsum("ij,ij->i", rays, rays) <= self.reach**2)] = np.nan
        return pixels

    def rays(self, pixels: ArrayLike) -> Array:
        """(N, 2) rays of (N, 2) pixels."""
        pixels = np.ascontiguousarray(pixels, dtype=float).reshape(-1, 1, 2)
        undistort = cv2.fisheye.undistortPoints if self._fisheye else cv2.undistortPoints
        return np.asarray(undistort(pixels, self._K, self._D), dtype=float).reshape(-1, 2)

    def _distort(self, rays: Array) -> Array:
        """(N, 2) distorted rays (Kannala & Brandt 2006 for `equidistant`, Brown 1966 for `radtan`)."""
        x, y = rays[:, 0], rays[:, 1]
        r2 = x * x + y * y
        if self._fisheye:
            r = np.sqrt(r2)
            angle = np.arctan(r)
            a2 = angle * angle
            k1, k2, k3, k4 = self._D
            bent = angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
            return rays * np.divide(bent, r, out=np.ones_like(r), where=r > 1e-9)[:, None]
        k1, k2, p1, p2 = self._D
        radial = 1 + r2 * (k1 + r2 * k2)
        return np.column_stack(
            [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y]
        )
