"""A head-worn depth camera for scenes of boxes, which are seen by exact ray casting."""

from __future__ import annotations

import numpy as np

from stridetwin.streams.rig import CameraCalibration, Mount, Rig
from stridetwin.streams.samples import Array


def make_depth_rig(width: int, height: int, focal_px: float, rate_hz: float) -> Rig:
    """A rig with one colour camera and its depth images, both in the same frame."""
    camera = CameraCalibration(
        topic="/head/color",
        part="",
        rate_hz=rate_hz,
        mount=Mount(body="head"),
        width=width,
        height=height,
        intrinsics=(focal_px, focal_px, (width - 1) / 2, (height - 1) / 2),
        depth_topic="/head/depth",
    )
    return Rig(cameras={camera.topic: camera})


def make_rays(width: int, height: int, focal_px: float) -> Array:
    """(height × width, 3) rays of the pixels, row by row, optical axes: a step of 1 along one is 1 m of depth."""
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([(u - (width - 1) / 2) / focal_px, (v - (height - 1) / 2) / focal_px, np.ones_like(u)], -1)
    return rays.reshape(-1, 3)
