"""Directions in which the pixels of a camera look."""

from __future__ import annotations

import cv2
import numpy as np

from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array


def find_rays(pixels: Array, camera: CameraCalibration) -> Array:
    """(N, 2) normalised image coordinates (x / z, y / z in the camera's optical frame), without distortion.

    Args:
        pixels: (N, 2) column and row in the camera's own images; the centre of the first pixel is at (0, 0).
        camera: Calibration of the lens.
    """
    undistort = cv2.fisheye.undistortPoints if camera.distortion_model == "equidistant" else cv2.undistortPoints
    points = np.asarray(pixels, float).reshape(-1, 1, 2)
    return np.asarray(undistort(points, camera.K, np.array(camera.distortion)), float).reshape(-1, 2)
