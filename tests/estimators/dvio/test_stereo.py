"""Depth of a stereo pair before a painted, slanting wall."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.estimators.dvio.tracker import Stereo, with_stereo
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import CameraCalibration, Mount, Rig
from stridetwin.streams.samples import Image

SIZE, FOCAL, BASE = (752, 480), 458.0, 0.11
PLANE_N, PLANE_D = np.array([0.15, -0.1, 1.0]) / np.linalg.norm([0.15, -0.1, 1.0]), 2.5


def camera(topic: str, T: np.ndarray, distortion=(-0.28, 0.07, 2e-4, 2e-5)) -> CameraCalibration:
    return CameraCalibration(
        topic=topic,
        part="test",
        rate_hz=20,
        mount=Mount(body="head", T_body_sensor=T),
        width=SIZE[0],
        height=SIZE[1],
        intrinsics=(FOCAL, FOCAL, 370.0, 245.0),
        distortion=distortion,
    )


def pair():
    left, right = np.eye(4), np.eye(4)
    right[:3, :3] = Rotation.from_rotvec([0.01, -0.012, 0.006]).as_matrix()
    right[:3, 3] = [BASE, 0.001, -0.002]
    return camera("/head/color", left), camera("/head/color_right", right)


def depths(c: CameraCalibration) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) true depth of the wall, and (H, W, 3) its points in the body's frame."""
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    pixels = np.stack([u.ravel(), v.ravel()], axis=1).astype(float)
    at = cv2.undistortPoints(pixels[:, None], c.K, np.array(c.distortion))[:, 0]
    rays = np.concatenate([at, np.ones((len(at), 1))], axis=1)
    T = c.mount.T_body_sensor
    z = (PLANE_D - PLANE_N @ T[:3, 3]) / (rays @ T[:3, :3].T @ PLANE_N)
    return z.reshape(SIZE[::-1]), ((rays * z[:, None]) @ T[:3, :3].T + T[:3, 3]).reshape(*SIZE[::-1], 3)


def painted(c: CameraCalibration) -> Image:
    _, points = depths(c)
    paint = cv2.resize(np.random.default_rng(1).uniform(0, 255, (300, 300)).astype(np.float32), (1500, 1500))
    at = ((points[..., :2] + 4.0) * 1500 / 8).astype(np.float32)
    grey = cv2.remap(paint, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return Image(topic=c.topic, t_ns=7, pixels=np.clip(grey, 0, 255).astype(np.uint8))


def test_measures_the_depth_of_a_wall():
    left, right = pair()
    measured = Stereo(left, right, "/head/depth").depth(painted(left), painted(right))
    true, _ = depths(left)
    there = measured.depth > 0
    assert measured.t_ns == 7
    assert measured.depth.shape == true.shape
    assert there.mean() > 0.6
    off = np.abs(1 / measured.depth[there] - 1 / true[there])
    assert np.median(off) < 0.01


def test_refuses_cameras_that_are_not_side_by_side():
    left, right = pair()
    with pytest.raises(ConfigError, match="to the right of"):
        Stereo(right, left, "/head/depth")


def test_the_rig_then_has_depth():
    left, right = pair()
    rig = with_stereo(Rig(cameras={c.topic: c for c in (left, right)}), left.topic, "/head/depth")
    assert rig.cameras[left.topic].depth_topic == "/head/depth"
    assert replace(rig.cameras[left.topic], depth_topic="").depth_topic == left.depth_topic
