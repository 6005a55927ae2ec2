"""Input and output of a peer: an RGB-D folder in the TUM layout, and a text file of camera poses.

Needs only numpy and OpenCV, as it runs in environments without this project.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

PER_METRE = 5000.0


@dataclass(frozen=True)
class Frame:
    """One frame.

    Attributes:
        stamp: s, as written.
        rgb: (H, W, 3) uint8.
        depth: (H, W) float32 m, 0 where invalid.
    """

    stamp: str
    rgb: Any
    depth: Any


def frames(folder: Path) -> Iterator[Frame]:
    """Frames that have a depth image of the same stamp."""
    depths = dict(_rows(folder / "depth.txt"))
    for stamp, name in _rows(folder / "rgb.txt"):
        if stamp in depths:
            rgb = cv2.cvtColor(cv2.imread(str(folder / name)), cv2.COLOR_BGR2RGB)
            depth = cv2.imread(str(folder / depths[stamp]), cv2.IMREAD_UNCHANGED).astype(np.float32)
            yield Frame(stamp, rgb, depth / np.float32(PER_METRE))


def intrinsics(folder: Path) -> Any:
    """(3, 3) camera matrix."""
    fu, fv, pu, pv = (float(word) for word in (folder / "calibration.txt").read_text().split()[:4])
    return np.array([[fu, 0.0, pu], [0.0, fv, pv], [0.0, 0.0, 1.0]])


def imu(folder: Path) -> Any:
    """(N, 7) s, rad/s, m/s²."""
    return np.loadtxt(folder / "imu.txt")


def row(stamp: str, sure: bool, ms: float, T_world_camera: Any) -> str:
    """A line of a peer's output: stamp, whether the pose is valid, ms of work, and 3 × 4 numbers of the pose."""
    pose = " ".join(f"{value:.9g}" for value in np.asarray(T_world_camera)[:3].ravel())
    return f"{stamp} {int(sure)} {ms:.3f} {pose}\n"


def _rows(file: Path) -> list[tuple[str, str]]:
    cells = (line.split() for line in file.read_text().splitlines() if not line.startswith("#"))
    return [(stamp, name) for stamp, name in cells]
