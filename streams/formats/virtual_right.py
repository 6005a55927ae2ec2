"""Virtual view of the right camera of a stereo pair, from the left image and its depth.

Depth-image-based rendering (Fehn, SPIE 5291, 2004): the disparity fu·b/z is warped to the right image, nearest surface
first, and the left image is sampled with it. Areas that only the right camera would see are filled with the adjacent
background.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import CameraCalibration, Mount
from stridetwin.streams.samples import Array

BASELINE_M = (0.001, 1.0)


def right_camera(left: CameraCalibration, baseline_m: float, topic: str) -> CameraCalibration:
    """The calibration of a right camera beside a left one, its axes parallel, +x away.

    Raises:
        ConfigError: An invalid baseline, or a left camera with distortion, so that the rows would not match.
    """
    low, high = BASELINE_M
    if not low <= baseline_m <= high:
        raise ConfigError("export", "--stereo-baseline", baseline_m, f"{low:g} to {high:g} m")
    if any(left.distortion):
        raise ConfigError(
            left.topic, "distortion", list(left.distortion), "a camera without distortion for a right view"
        )
    T_left_right = np.eye(4)
    T_left_right[0, 3] = baseline_m
    mount = Mount(body=left.mount.body, T_body_sensor=left.mount.T_body_sensor @ T_left_right)
    return CameraCalibration(
        topic=topic,
        part=f"virtual, {baseline_m:g} m to the right of {left.topic}",
        rate_hz=left.rate_hz,
        mount=mount,
        width=left.width,
        height=left.height,
        intrinsics=left.intrinsics,
        imu_topic=left.imu_topic,
        timeshift_cam_imu_s=left.timeshift_cam_imu_s,
    )


def right_view(left: Any, depth: NDArray[np.float32], focal_px: float, baseline_m: float) -> Any:
    """The right image.

    Args:
        left: (H, W) or (H, W, 3) uint8.
        depth: (H, W) m, registered to it; 0 = none, filled from the farther neighbour in the row.
        focal_px: fu.
        baseline_m: Distance of the two cameras.

    Returns:
        Image with the shape and type of `left`.
    """
    with np.errstate(divide="ignore"):
        measured = np.where(depth > 0, focal_px * baseline_m / depth, np.nan).astype(np.float64)
    disparity = np.nan_to_num(np.take_along_axis(measured, _background(measured), axis=1))
    width = disparity.shape[1]
    rows: Any
    columns: Any
    rows, columns = np.indices(disparity.shape)
    seen = np.full(disparity.shape, -np.inf)
    for reach in (np.floor, np.ceil):  # both columns next to a warped pixel, so that slopes leave no cracks
        target = reach(columns - disparity).astype(np.int64)
        inside = (target >= 0) & (target < width)
        np.maximum.at(seen, (rows[inside], target[inside]), disparity[inside])
    seen[~np.isfinite(seen)] = np.nan
    from_column = _background(seen)
    x = from_column + np.nan_to_num(np.take_along_axis(seen, from_column, axis=1))
    return cv2.remap(
        left, x.astype(np.float32), rows.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )


def _background(disparity: Array) -> NDArray[np.int64]:
    """(H, W) source column of each pixel: itself, or in a hole (NaN) the farther of the row's two neighbours."""
    known = np.isfinite(disparity)
    at = np.arange(disparity.shape[1])
    before = np.maximum.accumulate(np.where(known, at, -1), axis=1)
    after = np.minimum.accumulate(np.where(known, at, len(at))[:, ::-1], axis=1)[:, ::-1]
    padded = np.pad(np.where(known, disparity, np.inf), ((0, 0), (1, 1)), constant_values=np.inf)
    left, right = (np.take_along_axis(padded, i + 1, axis=1) for i in (before, after))
    nearest = np.where(left <= right, before, after)
    return np.asarray(np.where(np.isfinite(np.minimum(left, right)), nearest, at), np.int64)
