"""Which poses an estimator of the ground takes from a recording: given ones, an odometry's, or the truth on request."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from stridetwin.estimators.base import Options
from stridetwin.estimators.terrain_map.depth_camera import depth_calibration
from stridetwin.outputs.feeding import Found, check_topics, fed, leader, paths
from stridetwin.outputs.path.files import reliable
from stridetwin.outputs.terrain.files import given_poses
from stridetwin.outputs.upright_poses import upright
from stridetwin.streams.errors import RecordingError
from stridetwin.streams.formats.tum import read_tum
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import CameraCalibration, ImuCalibration
from stridetwin.streams.trajectory import Trajectory

TRUTH = "truth"
"""The value of `--poses` that requests the true poses of a recording."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ChosenPoses:
    """Poses for the map.

    Attributes:
        path: The poses.
        frame: Frame that they belong to, such as `head/imu`; "" is the depth camera's optical frame.
        words: What they are, for a message.
        camera: `PathEstimate.camera` of an odometry.
    """

    path: Trajectory
    frame: str
    words: str
    camera: Trajectory | None = None


def chosen_poses(found: Found, recording: Recording, options: Options, request: str | None) -> ChosenPoses:
    """The poses that a request selects for an estimator of kind `map` or `modes`.

    Args:
        found: Its class.
        recording: With depth and its calibration.
        options: See `Options`.
        request: `truth` for the true poses of the recording, or a TUM file with poses of the depth camera's optical
            frame. None selects an odometry that the recording can feed, else recorded poses that are not the truth.

    Raises:
        StrideTwinError: The recording has no such poses; the message names the alternatives.
    """
    if request is not None and request != TRUTH:
        return _upright(recording, read_tum(Path(request)), "", f"poses of {request}")
    camera = depth_calibration(recording.rig)
    check_topics(found, found.streams(recording.rig, options), recording)
    if request == TRUTH:
        topic, frame = given_poses(recording, camera)
        if not topic.startswith("/truth/"):
            raise RecordingError(f"{recording.path}: no true poses: {topic} is an estimate; leave out --poses {TRUTH}")
        return _upright(recording, _path(recording, topic), frame, f"true poses of {topic}")
    first = leader()
    body = camera.mount.body
    for estimate in (e for options in fed(first, recording) for e in paths(first, recording, options)):
        if recording.rig.imu(f"/{estimate.frame}").mount.body == body:
            path, words = estimate.path[reliable(estimate)], f"poses estimated by {estimate.name}"
            return ChosenPoses(path=path, frame=estimate.frame, words=words, camera=estimate.camera)
    if (recorded := _recorded(recording, body)) is not None:
        return recorded
    asks = f"--poses {TRUTH}, or " if any(topic.startswith("/truth/") for topic in recording.topics) else ""
    name = first.declaration.name
    raise RecordingError(f"{recording.path}: no poses: {name} cannot run on this recording; pass {asks}--poses FILE")


def _recorded(recording: Recording, body: str) -> ChosenPoses | None:
    """Poses that a device estimated and recorded, of a camera or an IMU on a body: `/head/color/odometry`."""
    frames: list[CameraCalibration | ImuCalibration] = [*recording.rig.cameras.values(), *recording.rig.imus.values()]
    for frame in (f for f in frames if f.mount.body == body):
        if (topic := f"{frame.topic}/odometry") in recording.topics:
            path = _path(recording, topic)
            return _upright(recording, path, frame.topic.removeprefix("/"), f"recorded poses of {topic}")
    return None


def _path(recording: Recording, topic: str) -> Trajectory:
    block = recording.block(topic)
    p, q = block.columns["p_frame_in_world"], block.columns["q_world_frame"]
    return Trajectory(t_ns=block.t_ns, p_frame_in_world=p, q_world_frame=q)


def _upright(recording: Recording, path: Trajectory, frame: str, words: str) -> ChosenPoses:
    path, angle = upright(recording, path, frame)
    turned = f", rotated by {math.degrees(angle):.0f}° because their z axis is not up" if angle else ""
    return ChosenPoses(path=path, frame=frame, words=words + turned)
