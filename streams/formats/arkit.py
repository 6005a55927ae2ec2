"""Frames and cameras of Apple's ARKit, as the recordings of iPhone scanners have them, in ours.

ARKit's world has y up; ours z. Its camera looks along −z with y up; our optical frame along z with y down. The axes of
the device are x to the right and y to the top of the upright phone, z out of the screen; its accelerometer reports
forces with the opposite sign, in g.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.formats.assumed_calibration import image_size, pinhole
from stridetwin.streams.formats.derived import odometry
from stridetwin.streams.plausible import mean_rate
from stridetwin.streams.recording.imported import ImageStream
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.rig import CameraCalibration, Rig
from stridetwin.streams.samples import Array, Block, Odometry

COLOR, DEPTH, IMU = "/head/color", "/head/depth", "/head/imu"
"""Topics of a scan."""
R_ZUP_YUP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
R_ARKIT_OPTICAL = np.diag([1.0, -1.0, -1.0])
R_DEVICE_OPTICAL = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def path_topic(images: Iterable[str]) -> str:
    """Topic of the path of a scan's cameras, which are in one place: ARKit's estimate, not the truth."""
    return f"{COLOR if COLOR in images else DEPTH}/odometry"


def arkit_path(
    topic: str, t_ns: NDArray[np.int64], p: Array, q: Array, optical: bool, notes: Notes, file: object
) -> Block[Odometry]:
    """Poses of the camera's optical frame in a world with z up.

    Args:
        topic: Topic.
        t_ns: (N,) stamps.
        p: (N, 3) m, camera in ARKit's world.
        q: (N, 4) quaternions (w, x, y, z), camera to ARKit's world.
        optical: Whether the camera's frame is already the optical one.
        notes: Collects problems.
        file: Named by errors.

    Raises:
        ConfigError: A quaternion far from unit norm, unless lenient.
    """
    from scipy.spatial.transform import Rotation  # takes long to import: only where it is needed

    block = odometry(topic, t_ns, p, q, None, notes, file)
    R = Rotation.from_matrix(R_ZUP_YUP) * Rotation.from_quat(block.columns["q_world_frame"], scalar_first=True)
    if not optical:
        R = R * Rotation.from_matrix(R_ARKIT_OPTICAL)
    p = block.columns["p_frame_in_world"] @ R_ZUP_YUP.T
    return odometry(topic, block.t_ns, p, R.as_quat(scalar_first=True), None, notes, file)


def scanner_rig(
    images: dict[str, ImageStream], intrinsics: tuple[float, float, float, float], size: tuple[int, int], imu: bool
) -> Rig:
    """The colour camera, and the depth camera with the same view and its own size of image.

    Args:
        images: Colour and depth, if they are there.
        intrinsics: (fu, fv, pu, pv) in pixels of images of `size`.
        size: (width, height).
        imu: Whether there is an IMU, in the axes of the device, at the camera.
    """
    cameras: dict[str, CameraCalibration] = {}
    for topic, stream in images.items():
        own = image_size(stream) or size
        su, sv = own[0] / size[0], own[1] / size[1]
        fu, fv, pu, pv = intrinsics
        scaled = (su * fu, sv * fv, su * (pu + 0.5) - 0.5, sv * (pv + 0.5) - 0.5)
        camera = pinhole(topic, own, scaled, mean_rate(stream.t_ns), DEPTH if topic == DEPTH else "")
        if imu:
            T = np.eye(4)
            T[:3, :3] = R_DEVICE_OPTICAL
            camera = replace(camera, mount=replace(camera.mount, T_body_sensor=T))
        cameras[topic] = camera
    return Rig(cameras=cameras)
