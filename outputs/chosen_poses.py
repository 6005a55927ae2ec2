"""Which poses an estimator of terrain or modes takes from a recording: given ones, an odometry's, or the truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from stridetwin.estimators.terrain_map.depth_camera import depth_calibration
from stridetwin.outputs.feeding import runnable_instances
from stridetwin.outputs.path.files import reliable
from stridetwin.outputs.path.run import run_paths
from stridetwin.outputs.pose_feed import default_odometry
from stridetwin.outputs.upright_poses import upright
from stridetwin.streams.errors import RecordingError
from stridetwin.streams.formats.tum import read_tum
from stridetwin.streams.pose_restart import restart_poses
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import CameraCalibration, ImuCalibration
from stridetwin.streams.samples import Odometry
from stridetwin.streams.trajectory import Trajectory

TRUTH = "truth"
"""The value of `--poses` that requests the true poses of a recording."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ChosenPoses:
    """Poses for the map.

    Attributes:
        path: The poses.
        frame: Frame that they belong to, such as `head/imu`; "" is the depth camera's optical frame.
        description: What they are, for a message.
        camera: `PathEstimate.camera` of an odometry.
    """

    path: Trajectory
    frame: str
    description: str
    camera: Trajectory | None = None


def choose_poses(recording: Recording, request: str | None) -> ChosenPoses:
    """The poses that a request selects for an estimator of terrain or modes.

    Args:
        recording: With depth and its calibration.
        request: `truth` for the true poses of the recording, or a TUM file with poses of the depth camera's optical
            frame. None selects an odometry that the recording can feed, else recorded poses that are not the truth.

    Raises:
        StrideTwinError: The recording has no such poses; the message names the alternatives.
    """
    if request is not None and request != TRUTH:
        return _upright(recording, read_tum(Path(request)), "", f"poses of {request}")
    camera = depth_calibration(recording.rig)
    if request == TRUTH:
        topic, frame = given_poses(recording, camera)
        if not topic.startswith("/truth/"):
            raise RecordingError(f"{recording.path}: no true poses: {topic} is an estimate; leave out --poses {TRUTH}")
        return _upright(recording, _path(recording, topic), frame, f"true poses of {topic}")
    odometry = default_odometry()
    body = camera.mount.body
    for output in (o for i in runnable_instances(odometry, recording) for o in run_paths(i, recording)):
        estimate = output.estimates
        if recording.rig.imu(f"/{estimate.frame}").mount.body == body:
            path = restart_poses(estimate.path[reliable(estimate)], recording.metadata)
            description = f"poses estimated by {estimate.name}"
            return ChosenPoses(path=path, frame=estimate.frame, description=description, camera=estimate.camera)
    if (recorded := _recorded(recording, body)) is not None:
        return recorded
    advice = f"--poses {TRUTH}, or " if any(topic.startswith("/truth/") for topic in recording.topics) else ""
    name = odometry.declaration.name
    raise RecordingError(f"{recording.path}: no poses: {name} cannot run on this recording; pass {advice}--poses FILE")


def given_poses(recording: Recording, camera: CameraCalibration) -> tuple[str, str]:
    """The poses in a recording, and the frame that they belong to.

    Returns:
        Topic of the camera's own path, or of that of another sensor on its body; and that frame, "" for a folder of
        depth alone.

    Raises:
        RecordingError: There are none.
    """
    rig = recording.rig
    frames: list[CameraCalibration | ImuCalibration] = [camera, *rig.imus.values(), *rig.cameras.values()]
    for frame in frames:
        topic = f"/truth{frame.topic}/odometry"
        if topic in recording.topics and frame.mount.body == camera.mount.body:
            return topic, frame.topic.removeprefix("/")
    paths = [topic for topic, info in recording.topics.items() if info.kind is Odometry]
    if len(paths) == 1 and not recording.is_mcap:  # in a folder of depth alone, the poses are the depth camera's
        return paths[0], ""
    raise RecordingError(
        f"{recording.path}: no poses (/truth{camera.topic}/odometry); expected such poses, or --poses FILE"
    )


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


def _upright(recording: Recording, path: Trajectory, frame: str, description: str) -> ChosenPoses:
    path, angle = upright(recording, path, frame)
    rotation = f", rotated by {math.degrees(angle):.0f}° because their z axis is not up" if angle else ""
    return ChosenPoses(path=path, frame=frame, description=description + rotation)
