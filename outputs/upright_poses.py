"""Poses whose z axis is not up, such as those of 7-Scenes in the frame of the first image, set upright for the map."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.terrain_map.depth_camera import DepthCamera, camera_in_frame, depth_calibration
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.upright import normals, upward
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Array, Depth
from stridetwin.streams.trajectory import Trajectory

_IMAGES = 20
_TILT_RAD = math.radians(30.0)
"""A smaller angle may be that of a ramp; the frame of a first image is off by a right angle or so."""


def upright(recording: Recording, path: Trajectory, frame: str) -> tuple[Trajectory, float]:
    """Poses in a world whose z axis is up, and the angle by which they were rotated, rad; 0: they were upright.

    Args:
        recording: With the depth images.
        path: Poses of `frame`.
        frame: Frame of the poses; "" is the depth camera's optical frame.
    """
    calibration = depth_calibration(recording.rig)
    camera, R_frame_camera = DepthCamera(calibration), camera_in_frame(recording.rig, calibration, frame)[:3, :3]
    stamps = recording.image_times(calibration.depth_topic)
    known = np.flatnonzero((stamps >= path.t_ns[0]) & (stamps <= path.t_ns[-1]))
    chosen = known[np.linspace(0, len(known) - 1, min(_IMAGES, len(known))).astype(int)].tolist()
    views: list[tuple[Array, Array]] = []
    for image in recording.images(calibration.depth_topic, chosen):
        if isinstance(image, Depth):
            depth, _ = camera.rectified(image.depth, TerrainMapParameters())
            at = int(np.searchsorted(path.t_ns, image.t_ns, side="right")) - 1
            R = Rotation.from_quat(path.q_world_frame[at], scalar_first=True).as_matrix() @ R_frame_camera
            views.append((normals(depth, camera.intrinsics), R))
    up = upward(views)
    if up is None or (angle := math.acos(min(1.0, max(-1.0, float(up[2]))))) < _TILT_RAD:
        return path, 0.0
    rotation = _onto_z(up)
    turned = Trajectory(
        t_ns=path.t_ns, p_frame_in_world=rotation.apply(path.p_frame_in_world),
        q_world_frame=(rotation * Rotation.from_quat(path.q_world_frame, scalar_first=True)).as_quat(scalar_first=True),
    )  # fmt: skip
    return turned, angle


def _onto_z(up: Array) -> Rotation:
    """The shortest rotation of a unit vector onto the z axis."""
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:
        return Rotation.identity() if up[2] > 0.0 else Rotation.from_rotvec([math.pi, 0.0, 0.0])
    return Rotation.from_rotvec(axis / sine * math.atan2(sine, float(up[2])))
