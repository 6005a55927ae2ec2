"""Folders of OpenLORIS-Scene: colour and depth of a RealSense D435i, its IMU in two files, and the robot's true path.

Shi et al., Are we ready for service robots? The OpenLORIS-Scene datasets for lifelong SLAM, ICRA 2020. `color.txt` and
`aligned_depth.txt` list the images (depth in mm, registered to colour), `d400_accelerometer.txt` and
`d400_gyroscope.txt` have `t x y z` in m/s² and rad/s, and `groundtruth.txt` has poses of the robot's `base_link`.
`sensors.yaml` has the intrinsics as fx cx fy cy, and `trans_matrix.yaml` the poses of the frames in their parents; both
are OpenCV's YAML. The T265's files and the robot's odometry are not read.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, BeforeValidator

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.fields import Count, NotNegative, Number, OneOf, Positive
from stridetwin.streams.formats.assumed_calibration import BODY
from stridetwin.streams.formats.derived import check_overlap, join_at_gyro_stamps, to_odometry
from stridetwin.streams.formats.image_files import read_image_list
from stridetwin.streams.formats.opencv_yaml import read_opencv_yaml
from stridetwin.streams.formats.text_rows import read_numbers, read_text_rows
from stridetwin.streams.formats.trajectory_columns import find_pose_places
from stridetwin.streams.formats.transform_tree import TransformTree
from stridetwin.streams.formats.tum import parse_seconds
from stridetwin.streams.matrix_fields import RigidTransform
from stridetwin.streams.plausible import mean_rate
from stridetwin.streams.recording.imported import ImageStream, Source
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.rig import CameraCalibration, Mount, Rig
from stridetwin.streams.samples import Accelerometer, Array, Block, Imu, Sample, Stamps
from stridetwin.streams.validation import validate

PER_METRE = 1000.0
"""Units of the layout's depth images per metre."""
COLOR, DEPTH, ALIGNED, TRUTH = "color", "depth", "aligned_depth", "groundtruth"
"""Names of the tables but those of the IMU; the first three are also the names of their folders and streams."""
IMU, ACCELEROMETER = "imu", "accelerometer"
"""Names of the inertial streams."""
_DEVICES = ("d400", "t265")
"""The devices whose IMU is read, the preferred one first."""
_TOPICS = {
    COLOR: "/head/color",
    DEPTH: "/head/depth",
    ALIGNED: "/head/depth",
    IMU: "/head/imu",
    ACCELEROMETER: "/head/accelerometer",
    TRUTH: "/truth/head/imu/odometry",
}
"""Our topic of each stream."""
_FRAMES = {COLOR: "d400_color_optical_frame", DEPTH: "d400_depth_optical_frame"}
"""The calibration files' name of each camera's frame."""
_BASE = "base_link"
_AXES = ("x", "y", "z")
_SENSORS, _TRANSFORMS = "sensors.yaml", "trans_matrix.yaml"
_DISTORTIONS = {"radial-tangential": "radtan", "radtan": "radtan", "equidistant": "equidistant", "none": "radtan"}
"""Our name of a distortion model, by that in `sensors.yaml`."""


def is_openloris(path: Path) -> bool:
    """Whether a folder has the layout: depth that is aligned to colour, or a table of one of the devices' IMUs."""
    names = [ALIGNED, *(f"{device}_{kind}" for device in _DEVICES for kind in ("accelerometer", "gyroscope"))]
    return any((path / f"{name}.txt").is_file() for name in names)


def read_openloris(path: Path, notes: Notes, per_metre: float = PER_METRE) -> Source:
    """Reads a folder of OpenLORIS-Scene.

    Args:
        path: The folder.
        notes: Collects problems.
        per_metre: Units of the depth images per metre.

    Returns:
        Images, the IMU and its true path as far as their files exist, and the camera's calibration.

    Raises:
        StrideTwinError: A file cannot be read or a value in it is invalid, unless lenient.
    """
    if not is_openloris(path):
        valid = "a folder of OpenLORIS-Scene"
        raise ConfigError(path, "", f"no {ALIGNED}.txt and no IMU of {' or '.join(_DEVICES)}", valid)
    depth = ALIGNED if (path / f"{ALIGNED}.txt").is_file() else DEPTH
    images: dict[str, ImageStream] = {}
    for name, scale in ((COLOR, None), (depth, per_metre)):
        file = path / f"{name}.txt"
        if file.is_file():
            images[name] = read_image_list(file, path, None, parse_seconds, notes, scale)
    images = {name: stream for name, stream in images.items() if len(stream.t_ns)}
    device = next((d for d in _DEVICES if (path / f"{d}_gyroscope.txt").is_file()), _DEVICES[0])
    frames = _read_frames(path / _TRANSFORMS)
    imu_frame = _find_imu_frame(frames, device)
    blocks = _read_inertial(path, device, notes) | _read_truth(path, frames, imu_frame, notes)
    rig = _read_rig(path / _SENSORS, images, frames, imu_frame, notes)
    tables = {f"{device}_accelerometer", f"{device}_gyroscope"}
    lists = {file.stem for file in path.glob("*.txt")} - tables - {COLOR, depth, TRUTH}
    unread = {f"/{name}": "OpenLORIS-Scene" for name in sorted(lists)}
    return Source(kind="openloris", blocks=blocks, images=images, rig=rig, unread=unread, names=_TOPICS)


def _find_imu_frame(frames: TransformTree, device: str) -> str:
    """The frame of a device's IMU that is connected to the robot's base, that of the gyroscope if none is."""
    names = [f"{device}_{kind}" for kind in ("gyroscope", "accelerometer")]
    return next((name for name in names if frames.find_transform(name, _BASE) is not None), names[0])


def _read_inertial(path: Path, device: str, notes: Notes) -> dict[str, Block[Sample]]:
    """Reads the IMU of a device from its two tables, by the name of the stream; the forces alone without rates."""
    names = f"{device}_gyroscope.txt", f"{device}_accelerometer.txt"
    rates, forces = (_read_vectors(path / name, notes) for name in names)
    if forces is None or not len(forces[0]):
        if rates is not None:
            notes.warn(f"{names[0]} is not read: there are no forces in {names[1]}")
        return {}
    columns = {"specific_force": forces[1]}
    accel: Block[Sample] = Block(topic=ACCELEROMETER, kind=Accelerometer, t_ns=forces[0], columns=columns)
    if rates is None or not check_overlap(names[0], rates[0], names[1], forces[0], notes):
        return {ACCELEROMETER: accel}
    gyro: Block[Imu] = Block(topic=IMU, kind=Imu, t_ns=rates[0], columns={"angular_rate": rates[1]})
    notes.warn(f"{names[0]} and {names[1]} are joined, the force interpolated to the stamps of the rate")
    return {IMU: join_at_gyro_stamps(IMU, gyro, accel)}


def _read_vectors(file: Path, notes: Notes) -> tuple[Stamps, Array] | None:
    """Stamps (N,) ns and vectors (N, 3) of a table `t x y z`; None without the file."""
    if not file.is_file():
        return None
    _, rows = read_text_rows(file, None)
    return read_numbers(file, rows, [(name, i) for i, name in enumerate(_AXES, 1)], parse_seconds, notes)


def _read_truth(path: Path, frames: TransformTree, imu_frame: str, notes: Notes) -> dict[str, Block[Sample]]:
    """Reads the true path of the IMU, from that of the robot's base; none without the IMU's place on the robot."""
    file = path / f"{TRUTH}.txt"
    if not file.is_file():
        return {}
    T_imu_base = frames.find_transform(imu_frame, _BASE)
    if T_imu_base is None:
        notes.warn(f"{file.name} is not read: its poses are those of {_BASE}, whose place is not in {_TRANSFORMS}")
        return {}
    header, rows = read_text_rows(file, None)
    t_ns, table = read_numbers(file, rows, find_pose_places(header), parse_seconds, notes)
    p, q = table[:, :3], table[:, [6, 3, 4, 5]]  # the quaternion as w, x, y, z
    return {TRUTH: to_odometry(TRUTH, t_ns, p, q, None, notes, file, T_imu_base)}


def _to_matrix_rows(node: object) -> object:
    """The rows of a matrix, which OpenCV writes as a mapping with `data` and `cols`; anything else as it is."""
    if not isinstance(node, dict) or not isinstance(node.get("data"), list):
        return node
    data, columns = node["data"], node.get("cols")
    if not isinstance(columns, int) or columns < 1:
        return data
    return [data[i : i + columns] for i in range(0, len(data), columns)]


def _to_numbers(node: object) -> object:
    """The numbers of a matrix of OpenCV's, row by row; anything else as it is."""
    return node.get("data", node) if isinstance(node, dict) else node


class _Transform(BaseModel):
    """An entry of `trans_matrix.yaml`: the pose of a frame in its parent."""

    parent_frame: str
    child_frame: str
    matrix: Annotated[RigidTransform, BeforeValidator(_to_matrix_rows)]


class _Transforms(BaseModel):
    """`trans_matrix.yaml`."""

    trans_matrix: list[_Transform]


class _Camera(BaseModel):
    """The section of a camera in `sensors.yaml`; intrinsics are fx, cx, fy, cy, in rewritten files fx, fy, cx, cy."""

    width: Count
    height: Count
    fps: NotNegative = 0.0
    intrinsics: Annotated[tuple[Positive, Positive, Positive, Positive], BeforeValidator(_to_numbers)]
    distortion_model: Annotated[str, OneOf(_DISTORTIONS)] = "radtan"
    distortion_coefficients: Annotated[list[Number], BeforeValidator(_to_numbers)] = []


def _order_intrinsics(camera: _Camera) -> tuple[float, float, float, float]:
    """The intrinsics as fu, fv, pu, pv in pixels: of both orders, the one with its centre nearer to the image's."""
    a, b, c, d = camera.intrinsics
    middle = np.array([camera.width, camera.height]) / 2
    orders = ((a, c, b, d), (a, b, c, d))
    return min(orders, key=lambda order: float(np.linalg.norm(order[2:] - middle)))


def _read_frames(file: Path) -> TransformTree:
    """The frames of `trans_matrix.yaml`; none without the file.

    Raises:
        StrideTwinError: The file is no YAML, or a value in it is invalid.
    """
    frames = TransformTree()
    if file.is_file():
        for transform in validate(_Transforms, read_opencv_yaml(file), file).trans_matrix:
            frames.add(transform.parent_frame, transform.child_frame, transform.matrix)
    return frames


def _read_rig(file: Path, images: dict[str, ImageStream], frames: TransformTree, imu_frame: str, notes: Notes) -> Rig:
    """The calibrations of the colour camera, and of a depth camera of its own view, in the frame of the IMU.

    Args:
        file: `sensors.yaml`.
        images: Colour and depth by name, as far as they exist.
        frames: Frames of the cameras and the IMU.
        imu_frame: The frame of the IMU.
        notes: Collects what is assumed, and what is not used.

    Raises:
        StrideTwinError: The file is no YAML, or a value in it is invalid.
    """
    if not file.is_file():
        return Rig()
    sections: Any = read_opencv_yaml(file)
    if not isinstance(sections, dict):
        raise ConfigError(file, "", sections, f"sections {', '.join(_FRAMES.values())}")
    for name, section in sections.items():
        if isinstance(section, dict) and "imu_intrinsic" in section:
            notes.warn(f"{file.name}: {name}: imu_intrinsic, the scale and bias of the sensor, is not used")
    cameras: dict[str, CameraCalibration] = {}
    for name, stream in images.items():
        if name == ALIGNED:  # it has the view of the colour camera
            continue
        frame = _FRAMES[name]
        if frame not in sections:
            notes.warn(f"{file.name}: no section {frame}; the camera's calibration is assumed")
            continue
        camera = validate(_Camera, sections[frame], f"{file}: {frame}")
        T_imu_camera = frames.find_transform(imu_frame, frame)
        if T_imu_camera is None:
            notes.warn(f"{frame}: no place in {_TRANSFORMS}; assumed at the IMU with the same orientation")
        intrinsics = _order_intrinsics(camera)
        k1, k2, p1, p2 = [*camera.distortion_coefficients, 0.0, 0.0, 0.0, 0.0][:4]
        if any(camera.distortion_coefficients[4:]):
            notes.warn(f"{file.name}: {frame}: only the first four distortion_coefficients are used")
        cameras[name] = CameraCalibration(
            topic=name,
            part="",
            rate_hz=mean_rate(stream.t_ns),
            mount=Mount(body=BODY, T_body_sensor=np.eye(4) if T_imu_camera is None else T_imu_camera),
            width=camera.width,
            height=camera.height,
            intrinsics=intrinsics,
            distortion_model=camera.distortion_model,
            distortion=(k1, k2, p1, p2),
            imu_topic=IMU,
        )
    return Rig(cameras=cameras)
