"""The rig in a scene: a site per sensor and board, a MuJoCo camera per camera, MuJoCo's own sensors where it has them.

Names are topics with underscores: `/foot_l/imu` is `foot_l_imu`. A camera of MuJoCo has neither distortion nor noise.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

import mujoco
import numpy as np

from stridetwin.sim.exo_description import hinge_of
from stridetwin.sim.kinematics.quaternions import quat_from_matrix
from stridetwin.sim.rendering.renderer import swap_camera_convention
from stridetwin.sim.wearer.sensor_bodies import UPPERS
from stridetwin.streams.rig import CameraCalibration, Mount, Rig

_SENSOR, _SITE, _JOINT = mujoco.mjtSensor, mujoco.mjtObj.mjOBJ_SITE, mujoco.mjtObj.mjOBJ_JOINT
_SITE_M = 0.004


def add_sensor_sites(spec: mujoco.MjSpec, rig: Rig) -> None:
    """Adds sites, cameras and sensors of a rig to a model that has the wearer's and the sensors' bodies."""
    for name, mount in _places(rig):
        T = mount.T_body_sensor
        _body(spec, mount).add_site(
            name=name, pos=T[:3, 3], quat=quat_from_matrix(T[:3, :3]), size=np.full(3, _SITE_M)
        )  # fmt: skip
    for camera in rig.cameras.values():
        _add_camera(spec, camera)
    for topic in rig.imus:
        _sense(spec, f"{scene_name(topic)}_gyro", _SENSOR.mjSENS_GYRO, _SITE, scene_name(topic))
        _sense(spec, f"{scene_name(topic)}_accelerometer", _SENSOR.mjSENS_ACCELEROMETER, _SITE, scene_name(topic))
    for topic, sensor in rig.others.items():
        name = scene_name(topic)
        if sensor.kind == "ahrs":
            _sense(spec, name, _SENSOR.mjSENS_FRAMEQUAT, _SITE, name)
        elif sensor.kind == "encoder":
            _sense(spec, name, _SENSOR.mjSENS_JOINTPOS, _JOINT, hinge_of(topic.split("/")[2]))


def scene_name(topic: str) -> str:
    """Name of a topic's site, camera or sensor in a scene."""
    return re.sub(r"\W", "_", topic.strip("/"))


def _places(rig: Rig) -> Iterator[tuple[str, Mount]]:
    """Sites and their mounts."""
    for sensors in (rig.imus, rig.cameras, rig.others):
        yield from ((scene_name(topic), sensor.mount) for topic, sensor in sensors.items())
    for name, board in rig.boards.items():
        yield f"{name}_board", board.mount


def _body(spec: mujoco.MjSpec, mount: Mount) -> mujoco.MjsBody:
    return spec.body(UPPERS.get(mount.body, mount.body))


def _add_camera(spec: mujoco.MjSpec, camera: CameraCalibration) -> None:
    T = swap_camera_convention(camera.mount.T_body_sensor)
    _body(spec, camera.mount).add_camera(
        name=scene_name(camera.topic), pos=T[:3, 3], quat=quat_from_matrix(T[:3, :3]),
        fovy=math.degrees(2 * math.atan2(camera.height / 2, camera.intrinsics[1])),
        resolution=[camera.width, camera.height],
    )  # fmt: skip


def _sense(spec: mujoco.MjSpec, name: str, kind: mujoco.mjtSensor, of: mujoco.mjtObj, target: str) -> None:
    spec.add_sensor(name=name, type=kind, objtype=of, objname=target)
