"""OpenCV's RGB-D odometry (`cv2.rgbd.RgbdICPOdometry`), frame against frame: `opencv_rgbd.py FOLDER OUT`."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import cv2
import numpy as np
from folder import frames, intrinsics, row

DEPTH_M = (0.3, 6.0)


def main(folder: Path, out: Path) -> None:
    """Writes one row per frame; a frame that cannot be aligned with the previous one keeps its pose."""
    cv2.setNumThreads(2)
    odometry = cv2.rgbd.RgbdICPOdometry_create(intrinsics(folder), *DEPTH_M)
    T_world_camera, before = np.eye(4), None
    with out.open("w") as file:
        for frame in frames(folder):
            began, sure = time.perf_counter(), True
            grey = cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY)
            depth = np.where(frame.depth > 0, frame.depth, np.float32(np.nan))
            now = cv2.rgbd.OdometryFrame_create(grey, depth)
            if before is not None:
                sure, T_now_before = odometry.compute2(before, now)
                if sure:
                    T_world_camera = T_world_camera @ np.linalg.inv(T_now_before)
            before = now
            file.write(row(frame.stamp, sure, 1e3 * (time.perf_counter() - began), T_world_camera))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
