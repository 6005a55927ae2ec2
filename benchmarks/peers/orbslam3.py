"""ORB-SLAM3 on RGB-D, with or without IMU: `orbslam3.py FOLDER OUT VOCABULARY SETTINGS rgbd|inertial`.

Poses are those estimated when the frame arrives; later corrections of its map do not count.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import cv2
import numpy as np
from folder import frames, imu, row
from pyorbslam3 import Sensor, Slam


def main(folder: Path, out: Path, vocabulary: str, settings: str, mode: str) -> None:
    """Writes one row per frame; invalid while it is not tracking or the IMU is not initialised."""
    inertial = mode == "inertial"
    slam = Slam(vocabulary, settings, Sensor.IMU_RGBD if inertial else Sensor.RGBD, use_viewer=False)
    samples, after = imu(folder) if inertial else None, 0.0
    last = np.eye(4)
    with out.open("w") as file:
        for frame in frames(folder):
            t, extra = float(frame.stamp), {}
            if inertial:
                rows = samples[(samples[:, 0] > after) & (samples[:, 0] <= t)]
                if not len(rows):
                    continue
                extra, after = {"imu": rows}, t
            began = time.perf_counter()
            tracked = slam.track_rgbd(cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY), frame.depth, t, **extra)
            ms = 1e3 * (time.perf_counter() - began)
            sure = bool(tracked.ok) and (not inertial or slam.imu_initialized())
            last = tracked.pose_wc if tracked.ok else last
            file.write(row(frame.stamp, sure, ms, last))
    slam.shutdown()


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:6])
