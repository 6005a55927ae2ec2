"""Projection of points into a camera's image, with its distortion model."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array

NEAR_M = 0.03


def project(camera: CameraCalibration, points: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Image coordinates of points (Brown 1966 and Conrady 1919; Kannala & Brandt 2006, as OpenCV has them).

    Args:
        camera: Intrinsics and distortion.
        points: (..., 3) m, optical frame.

    Returns:
        (..., 2) pixels, the middle of the upper left one is (0, 0); and (...) whether the point is before the camera
        and inside the image, within the valid range of the distortion model.
    """
    z = np.where(points[..., 2] > NEAR_M, points[..., 2], np.inf)
    x, y = points[..., 0] / z, points[..., 1] / z
    bent, fair = _radtan if camera.distortion_model == "radtan" else _equidistant, np.isfinite(z)
    x, y, straight = bent(x, y, *camera.distortion)
    fu, fv, pu, pv = camera.intrinsics
    u, v = fu * x + pu, fv * y + pv
    inside = fair & straight & (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1)
    return np.stack([u, v], axis=-1), inside


def _radtan(x: Array, y: Array, k1: float, k2: float, p1: float, p2: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    r2 = x**2 + y**2
    radial = 1.0 + r2 * (k1 + r2 * k2)
    out = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return *out, 1.0 + r2 * (3 * k1 + 5 * k2 * r2) > 0.0


def _equidistant(
    x: Array, y: Array, k1: float, k2: float, k3: float, k4: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    r = np.hypot(x, y)
    angle = np.arctan(r)
    a2 = angle**2
    bent = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
    scale = np.where(r > 1e-9, bent / np.maximum(r, 1e-9), 1.0)
    grows = 1.0 + a2 * (3 * k1 + a2 * (5 * k2 + a2 * (7 * k3 + a2 * 9 * k4))) > 0.0
    return x * scale, y * scale, grows
