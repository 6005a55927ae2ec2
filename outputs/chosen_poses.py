"""Which poses an estimator of terrain or modes takes from a recording: given ones, an odometry's, or the truth.

Poses whose z axis is not up, such as those of 7-Scenes in the frame of the first image, are set upright for the map.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stridetwin.estimators.terrain_map.depth_camera import DepthCamera, camera_in_frame, depth_calibration
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.upright import Vertical, find_surfaces, normals, refine_vertical, upward
from stridetwin.outputs.coverage import ENOUGH_PCT, compute_covered_share
from stridetwin.outputs.feeding import runnable_instances
from stridetwin.outputs.parameters import ParameterValues, with_parameters
from stridetwin.outputs.path.estimate_file import ASSUMED_W_FIRST, settle_order, span_of
from stridetwin.outputs.path.files import is_reliable
from stridetwin.outputs.path.run import run_paths
from stridetwin.outputs.pose_feed import default_odometry
from stridetwin.streams.errors import RecordingError
from stridetwin.streams.formats.opening import print_warnings
from stridetwin.streams.formats.trajectory_columns import W_FIRST
from stridetwin.streams.formats.trajectory_file import TrajectoryFile, read_trajectory
from stridetwin.streams.formats.trajectory_options import NO_OPTIONS, TrajectoryOptions
from stridetwin.streams.pose_restart import restart_poses
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import CameraCalibration, ImuCalibration
from stridetwin.streams.samples import Array, Depth, Odometry
from stridetwin.streams.trajectory import Trajectory

TRUE_POSES = "truth"
"""The value of `--poses` that requests the true poses of a recording."""
_IMAGES = (20, 60, 180)
"""Depth images, spread over the recording, from which the vertical is found: more of them until it is sure."""
_ENOUGH_SD_RAD = math.radians(0.3)
"""A confirmed vertical with a smaller standard deviation needs no more images."""
_TILT_RAD = math.radians(30.0)
"""A smaller angle may be that of a ramp; the frame of a first image is off by a right angle or so."""
_SMALL_TILT_RAD, _SURE_SD = math.radians(1.5), 4.0
"""A smaller tilt of given poses is corrected from this angle, and from so many standard deviations on, if walls or
surfaces at two heights confirm it."""

_LEVEL_RAD = math.radians(5.0)
"""A surface within this angle of the horizontal is level."""
_LEVELLER, _TILTED, _UPRIGHT = 1.5, 0.6, math.cos(math.radians(10.0))
"""How much more of the surfaces must be level for another order of the quaternions; what they count where the z axis is
not up, and the least z component of the vertical where it is."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ChosenPoses:
    """Poses that an estimator of terrain or modes takes, upright, with the frame that they belong to.

    Attributes:
        path: The poses.
        frame: Frame that they belong to, such as `head/imu`; "" is the depth camera's optical frame.
        description: What they are, for a message.
        camera: `PathEstimate.camera` of an odometry.
        statuses: (N,) what holds each of the poses; None if unknown.
    """

    path: Trajectory
    frame: str
    description: str
    camera: Trajectory | None = None
    statuses: NDArray[np.str_] | None = None


def choose_poses(
    recording: Recording,
    request: str | None,
    parameters: ParameterValues = MappingProxyType({}),
    options: TrajectoryOptions = NO_OPTIONS,
) -> ChosenPoses:
    """The poses that a request selects for an estimator of terrain or modes.

    Args:
        recording: With depth and its calibration.
        request: `truth` for the true poses of the recording, or a trajectory of the depth camera's optical frame.
            None selects an odometry that the recording can feed, else recorded poses that are not the truth.
        parameters: Values in place of the odometry's own, see `outputs.parameters`.
        options: How the trajectory is read.

    Raises:
        StrideTwinError: The recording has no such poses; the message names the alternatives.
    """
    if request is not None and request != TRUE_POSES:
        return _choose_upright(recording, _read_given(recording, Path(request), options), "", f"poses of {request}")
    camera = depth_calibration(recording.rig)
    if request == TRUE_POSES:
        topic, frame = find_pose_topic(recording, camera)
        if not topic.startswith("/truth/"):
            raise RecordingError(
                f"{recording.path}: no true poses: {topic} is an estimate; leave out --poses {TRUE_POSES}"
            )
        path = _read_path(recording, topic)
        return _choose_upright(recording, path, frame, f"true poses of {topic}", is_truth=recording.is_mcap)
    odometry = default_odometry()
    body = camera.mount.body
    instances = [with_parameters(instance, parameters) for instance in runnable_instances(odometry, recording)]
    # generated one by one: no further odometry runs after the first whose IMU is on the depth camera's body
    estimates = (output.estimates for instance in instances for output in run_paths(instance, recording))
    for estimate in estimates:
        if recording.rig.imu(f"/{estimate.frame}").mount.body == body:
            # without untrusted poses and long dead reckoning, and restarted where the metadata asks for it
            is_kept = is_reliable(estimate)
            return ChosenPoses(
                path=restart_poses(estimate.path[is_kept], recording.metadata),
                frame=estimate.frame,
                description=f"poses estimated by {estimate.name}",
                camera=estimate.camera,
                statuses=None if estimate.status is None else estimate.status[is_kept],
            )
    if (recorded_poses := _find_recorded_poses(recording, body)) is not None:
        return recorded_poses
    advice = f"--poses {TRUE_POSES}, or " if any(topic.startswith("/truth/") for topic in recording.topics) else ""
    name = odometry.declaration.name
    raise RecordingError(f"{recording.path}: no poses: {name} cannot run on this recording; pass {advice}--poses FILE")


def _read_given(recording: Recording, file: Path, options: TrajectoryOptions) -> Trajectory:
    """Reads a trajectory of the depth camera, and prints warnings on stderr.

    An unknown order of the quaternions is settled by the true poses, or else by the ground in some depth images.

    Raises:
        StrideTwinError: The file is invalid, or not of this recording.
    """
    notes = Notes(file, lenient=False)
    read = read_trajectory(file, options, span_ns=span_of(recording), notes=notes)
    if not read.is_order_known:
        frame = depth_calibration(recording.rig).topic.removeprefix("/")
        try:
            read = settle_order(read, recording, frame, notes, may_tilt=True)
        except RecordingError:  # no truth
            read = _settle_by_ground(recording, read, notes)
    stamps = recording.image_times(depth_calibration(recording.rig).depth_topic)
    covered_pct = (
        100.0 * compute_covered_share(read.path.t_ns, int(stamps[0]), int(stamps[-1])) if len(stamps) else 100.0
    )
    if covered_pct < ENOUGH_PCT:
        notes.warn(f"its poses cover {covered_pct:.1f} % of the time of the depth images: the others are left out")
    print_warnings(file, notes.warnings)
    return read.path


def _settle_by_ground(recording: Recording, read: TrajectoryFile, notes: Notes) -> TrajectoryFile:
    """The trajectory with the order of the quaternion with which the ground is level in most depth images.

    Args:
        recording: With the depth images.
        read: As it was read; its order is kept unless the ground is much less level with it.
        notes: Collects the order if it was changed, or if w was assumed to be first.
    """
    other = read.with_other_order()
    if _level_share(recording, other.path) > _LEVELLER * _level_share(recording, read.path):
        notes.warn(
            f"the ground is level only with quaternions as {other.order}: read so; --quaternion {read.order} keeps the "
            "other order"
        )
        return other
    if read.order == W_FIRST:
        notes.warn(ASSUMED_W_FIRST)
    return read


def _level_share(recording: Recording, path: Trajectory) -> float:
    """Share of the surfaces in some depth images along the vertical of poses of the camera, 0-1.

    It counts less if that vertical is not the z axis, which it is in most worlds.
    """
    views = _views(recording, path, "")
    up = upward(views)
    if up is None:
        return 0.0
    along = np.concatenate([of_image @ R.T for of_image, R in views]) @ up
    return float(np.mean(along > math.cos(_LEVEL_RAD))) * (1.0 if up[2] > _UPRIGHT else _TILTED)


def find_pose_topic(recording: Recording, camera: CameraCalibration) -> tuple[str, str]:
    """Finds the true path of the depth camera, or of a sensor on its body, in a recording.

    Args:
        recording: The recording.
        camera: The depth camera.

    Returns:
        Topic of the path and its frame. The only path of a folder of images is taken without being the truth, with the
        frame "", because such poses are the depth camera's.

    Raises:
        RecordingError: There are no such poses.
    """
    rig = recording.rig
    sensors: list[CameraCalibration | ImuCalibration] = [camera, *rig.imus.values(), *rig.cameras.values()]
    for sensor in sensors:
        topic = f"/truth{sensor.topic}/odometry"
        if topic in recording.topics and sensor.mount.body == camera.mount.body:
            return topic, sensor.topic.removeprefix("/")
    paths = [topic for topic, info in recording.topics.items() if info.kind is Odometry]
    if len(paths) == 1 and not recording.is_mcap:  # in a folder of depth alone, the poses are the depth camera's
        return paths[0], ""
    raise RecordingError(
        f"{recording.path}: no poses (/truth{camera.topic}/odometry); expected such poses, or --poses FILE"
    )


def _find_recorded_poses(recording: Recording, body: str) -> ChosenPoses | None:
    """Poses that a device estimated and recorded with its data, such as `/head/color/odometry`.

    Args:
        recording: With the depth images, which show whether the poses are upright.
        body: Body that carries the camera or IMU of the poses.

    Returns:
        The poses of the first camera, else of the first IMU, of the body that has any; None without any.
    """
    frames: list[CameraCalibration | ImuCalibration] = [*recording.rig.cameras.values(), *recording.rig.imus.values()]
    for frame in frames:
        topic = f"{frame.topic}/odometry"
        if frame.mount.body == body and topic in recording.topics:
            path = _read_path(recording, topic)
            return _choose_upright(recording, path, frame.topic.removeprefix("/"), f"recorded poses of {topic}")
    return None


def _read_path(recording: Recording, topic: str) -> Trajectory:
    """The poses of an odometry topic."""
    block = recording.block(topic)
    p, q = block.columns["p_frame_in_world"], block.columns["q_world_frame"]
    return Trajectory(t_ns=block.t_ns, p_frame_in_world=p, q_world_frame=q)


def _choose_upright(
    recording: Recording, path: Trajectory, frame: str, description: str, *, is_truth: bool = False
) -> ChosenPoses:
    """The poses in a world whose z axis is up, with a description that names the rotation if one was needed.

    Args:
        recording: With the depth images, which show where the ground is.
        path: Poses of `frame`.
        frame: Frame of the poses; "" is the depth camera's optical frame.
        description: What the poses are, for a message.
        is_truth: Whether they are true poses of a recording, whose vertical is that of the world.
    """
    path, remark = _set_upright(recording, path, frame, is_truth=is_truth)
    return ChosenPoses(path=path, frame=frame, description=description + remark)


def _set_upright(recording: Recording, path: Trajectory, frame: str, *, is_truth: bool) -> tuple[Trajectory, str]:
    """Rotates poses so that their world's z axis is up, as surfaces in depth images show it.

    Where few images show no level ground, or too little of it, more are taken. True poses of a recording are upright by
    definition. Others that seem tilted by a small angle stay as they are unless surfaces at two heights, or walls,
    agree: it may be a ramp. Nor is such a tilt corrected where many level surfaces agree with the z axis as it is.

    Args:
        recording: With the depth images.
        path: Poses of `frame`.
        frame: Frame of the poses; "" is the depth camera's optical frame.
        is_truth: Whether they are true poses of a recording.

    Returns:
        The poses, and a remark on what was found, which begins with ", " or is empty.
    """
    vertical = None
    for count in _IMAGES[:1] if is_truth else _IMAGES:
        images = _list_posed_images(recording, path, frame, count)
        coarse = upward(_views_of(images))  # in the world of the given poses; None without any ground
        vertical = None if coarse is None else _find_vertical(images, coarse)
        is_sure = vertical is not None and vertical.is_confirmed and vertical.sd_rad < _ENOUGH_SD_RAD
        if is_sure or len(images) < count:  # there are no more images
            break
    if vertical is None:
        return path, ", no level ground in their depth images shows whether their z axis is up"
    angle = math.acos(min(1.0, max(-1.0, float(vertical.up[2]))))
    if angle < _TILT_RAD:
        sure_rad = max(_SMALL_TILT_RAD, _SURE_SD * vertical.sd_rad)
        if is_truth or not vertical.is_confirmed or angle < sure_rad:
            return path, ""
    tilted = "their z axis is not up" if angle >= _TILT_RAD else "level ground and walls are tilted"
    digits = 0 if angle >= _TILT_RAD else 1
    sd = f" ± {math.degrees(vertical.sd_rad):.1f}°" if math.isfinite(vertical.sd_rad) else ""
    remark = f", rotated by {math.degrees(angle):.{digits}f}°{sd} because {tilted}"
    rotation = _rotation_onto_z(vertical.up)
    upright_path = Trajectory(
        t_ns=path.t_ns,
        p_frame_in_world=rotation.apply(path.p_frame_in_world),
        q_world_frame=(rotation * Rotation.from_quat(path.q_world_frame, scalar_first=True)).as_quat(scalar_first=True),
    )
    return upright_path, remark


def _find_vertical(images: Sequence[_PosedImage], coarse: Array) -> Vertical:
    """The vertical from planes through the surfaces of some images; `coarse` (3,) if no surface is level enough."""
    surfaces = [
        surface
        for number, image in enumerate(images)
        for surface in find_surfaces(image.depth, image.intrinsics, image.T_world_camera, coarse, number)
    ]
    return refine_vertical(surfaces, coarse) or Vertical(coarse, math.inf, is_confirmed=False)


class _PosedImage(NamedTuple):
    """A depth image with its pose.

    Attributes:
        depth: (H, W) m, rectified; 0 is invalid.
        intrinsics: (4,) fu, fv, pu, pv.
        T_world_camera: (4, 4) pose of the optical frame, m.
    """

    depth: NDArray[np.float32]
    intrinsics: Array
    T_world_camera: Array


def _views_of(images: Sequence[_PosedImage]) -> list[tuple[Array, Array]]:
    """Surface normals of images, in the camera's frame, and the camera's rotation to the world of the poses."""
    return [(normals(image.depth, image.intrinsics), image.T_world_camera[:3, :3]) for image in images]


def _views(recording: Recording, path: Trajectory, frame: str) -> list[tuple[Array, Array]]:
    """Surface normals of some depth images, in the camera's frame, and the camera's rotation to the world of the poses.

    Args:
        recording: With the depth images.
        path: Poses of `frame`.
        frame: Frame of the poses; "" is the depth camera's optical frame.
    """
    return _views_of(_list_posed_images(recording, path, frame, _IMAGES[0]))


def _list_posed_images(recording: Recording, path: Trajectory, frame: str, count: int) -> list[_PosedImage]:
    """Some depth images, spread over the recording, with the camera's pose in the world of the poses.

    Args:
        recording: With the depth images.
        path: Poses of `frame`.
        frame: Frame of the poses; "" is the depth camera's optical frame.
        count: Most images.
    """
    calibration = depth_calibration(recording.rig)
    camera, T_frame_camera = DepthCamera(calibration), camera_in_frame(recording.rig, calibration, frame)
    stamps = recording.image_times(calibration.depth_topic)
    in_path = np.flatnonzero((stamps >= path.t_ns[0]) & (stamps <= path.t_ns[-1]))
    chosen = in_path[np.linspace(0, len(in_path) - 1, min(count, len(in_path))).astype(int)].tolist()
    images: list[_PosedImage] = []
    for image in recording.images(calibration.depth_topic, chosen):
        if isinstance(image, Depth):
            depth, _ = camera.rectify(image.depth, TerrainMapParameters())
            # the last pose up to the image
            at = int(np.searchsorted(path.t_ns, image.t_ns, side="right")) - 1
            T = np.eye(4)
            T[:3, :3] = Rotation.from_quat(path.q_world_frame[at], scalar_first=True).as_matrix()
            T[:3, 3] = path.p_frame_in_world[at]
            images.append(_PosedImage(depth, camera.intrinsics, T @ T_frame_camera))
    return images


def _rotation_onto_z(up: Array) -> Rotation:
    """The shortest rotation of a unit vector onto the z axis."""
    axis = np.cross(up, [0.0, 0.0, 1.0])  # its length is the sine of the angle
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:  # parallel or opposite to z: the axis is undefined
        return Rotation.identity() if up[2] > 0.0 else Rotation.from_rotvec([math.pi, 0.0, 0.0])
    return Rotation.from_rotvec(axis / sine * math.atan2(sine, float(up[2])))
