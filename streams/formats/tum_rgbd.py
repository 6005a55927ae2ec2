"""RGB-D folders in the TUM layout: `rgb.txt`, `depth.txt`, `groundtruth.txt`, `accelerometer.txt` and the images.

Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012. Depth PNGs have 5000 units per metre. The
poses are those of the colour camera's optical frame. `calibration.txt` (fx fy cx cy) is that of the ETH3D datasets. The
layout has only the accelerometer of the IMU: rates are read from an additional `gyroscope.txt`, or rates and forces
from one `imu.txt`, whose header names its columns (wx wy wz ax ay az, in this order without a header).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.formats.assumed_calibration import make_pinhole, read_first_image_size
from stridetwin.streams.formats.derived import check_overlap, join_at_gyro_stamps, to_odometry
from stridetwin.streams.formats.frame_intrinsics import choose_frame
from stridetwin.streams.formats.image_files import choose_camera, read_image_list, write_depth, write_image
from stridetwin.streams.formats.text_rows import read_numbers, read_text_rows, write_text_rows
from stridetwin.streams.formats.trajectory_columns import find_pose_places
from stridetwin.streams.formats.tum import format_seconds, parse_seconds, write_tum
from stridetwin.streams.kalibr import write_rig
from stridetwin.streams.plausible import mean_rate
from stridetwin.streams.recording.imported import ImageStream, Source
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.recording.recording_schema import RIG_NAME
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Rig
from stridetwin.streams.samples import Accelerometer, Array, Block, Depth, Image, Imu, Sample, Stamps
from stridetwin.streams.trajectory import Trajectory

PER_METRE = 5000.0
"""Units of the layout's depth images per metre."""
COLOR, DEPTH, ACCELEROMETER, IMU = "/head/color", "/head/depth", "/head/accelerometer", "/head/imu"
TRUTH_TOPIC = "/truth/head/color/odometry"
# names of the columns after the stamp: angular rate in rad/s, specific force in m/s², position in m and quaternion
_RATE, _FORCE = ("wx", "wy", "wz"), ("ax", "ay", "az")
_PAIRS = ("associations.txt", "association.txt", "associated.txt", "associate.txt", "assoc.txt")
"""Names of a list of pairs, as `associate.py` of the benchmark writes it."""
_OTHER_CALIBRATIONS = (
    "calib.txt",
    "camera.txt",
    "intrinsics.txt",
    "camera_intrinsics.txt",
    "camera.yaml",
    "calib.yaml",
)
"""Files of other names and forms that users have beside the images."""
_INTRINSICS = ("fx", "fy", "cx", "cy")
"""What `calibration.txt` has, once or for each image."""


def is_tum_rgbd(path: Path) -> bool:
    """Whether a folder has the TUM RGB-D layout: `rgb.txt` or `depth.txt`, or both in a list of pairs."""
    return any((path / name).is_file() for name in ("rgb.txt", "depth.txt")) or _find_pairs(path) is not None


def _find_pairs(path: Path) -> Path | None:
    """The list of pairs of a colour and a depth image, beside their folders; None without one."""
    if not any((path / name).is_dir() for name in ("rgb", "depth", "color")):
        return None
    return next((file for name in _PAIRS if (file := path / name).is_file()), None)


def _read_pairs(file: Path, path: Path, notes: Notes, per_metre: float) -> dict[str, ImageStream]:
    """Colour and depth of a list of pairs, `stamp file stamp file`, in either order.

    Raises:
        StrideTwinError: The list cannot be read, or a row is invalid, unless lenient.
    """
    _, rows = read_text_rows(file, None)
    if not rows or len(rows[0].cells) != 4:
        text = rows[0].text[:80] if rows else ""
        raise ConfigError(file, "line 1", text, "a stamp and a file of colour, and a stamp and a file of depth")
    places = {DEPTH: 0, COLOR: 2} if "depth" in rows[0].cells[1].lower() else {COLOR: 0, DEPTH: 2}
    notes.warn(f"{file.name}: the images are those of its pairs")
    return {
        topic: read_image_list(
            file, path, None, parse_seconds, notes, per_metre if topic == DEPTH else None, first=place
        )
        for topic, place in places.items()
    }


def read_tum_rgbd(path: Path, notes: Notes, per_metre: float = PER_METRE) -> Source:
    """Reads a folder in the TUM layout.

    Args:
        path: The folder.
        notes: Collects problems.
        per_metre: Units of the depth images per metre.

    Returns:
        Images, inertial streams and true poses of the colour camera, as far as their files exist, and its calibration.

    Raises:
        StrideTwinError: A file cannot be read or a value in it is invalid, unless lenient.
    """
    images: dict[str, ImageStream] = {}
    blocks: dict[str, Block[Sample]] = {}
    if (path / "rgb.txt").is_file():
        images[COLOR] = read_image_list(path / "rgb.txt", path, None, parse_seconds, notes)
    if (path / "depth.txt").is_file():
        images[DEPTH] = read_image_list(path / "depth.txt", path, None, parse_seconds, notes, per_metre)
    if not images and (pairs := _find_pairs(path)) is not None:
        images = _read_pairs(pairs, path, notes, per_metre)
    images = {topic: stream for topic, stream in images.items() if len(stream.t_ns)}
    blocks |= _read_inertial(path, notes)
    file = path / "groundtruth.txt"
    if file.is_file():
        header, rows = read_text_rows(file, None)
        t_ns, table = read_numbers(file, rows, find_pose_places(header), parse_seconds, notes)
        p, q = table[:, :3], table[:, [6, 3, 4, 5]]  # the quaternion as w, x, y, z
        blocks[TRUTH_TOPIC] = to_odometry(TRUTH_TOPIC, t_ns, p, q, None, notes, file)
    return Source(kind="tum", blocks=blocks, images=images, rig=_read_rig(path, images, notes), unread={})


def _read_inertial(path: Path, notes: Notes) -> dict[str, Block[Sample]]:
    """Reads the accelerometer, and an IMU from `imu.txt` or from `gyroscope.txt` with the accelerometer's forces."""
    blocks: dict[str, Block[Sample]] = {}
    force_file, rate_file, imu_file = (path / f"{name}.txt" for name in ("accelerometer", "gyroscope", "imu"))
    if force_file.is_file():
        t_ns, table = _read_columns(force_file, _FORCE, notes)
        columns = {"specific_force": table}
        blocks[ACCELEROMETER] = Block(topic=ACCELEROMETER, kind=Accelerometer, t_ns=t_ns, columns=columns)
    if imu_file.is_file():
        t_ns, table = _read_columns(imu_file, (*_RATE, *_FORCE), notes)
        columns = {"angular_rate": table[:, :3], "specific_force": table[:, 3:]}
        blocks[IMU] = Block(topic=IMU, kind=Imu, t_ns=t_ns, columns=columns)
    elif rate_file.is_file() and len(blocks.get(ACCELEROMETER, ())) > 1:  # two forces, to interpolate between
        t_ns, table = _read_columns(rate_file, _RATE, notes)
        forces = blocks[ACCELEROMETER]
        if not check_overlap(rate_file.name, t_ns, force_file.name, forces.t_ns, notes):
            return blocks
        gyro = Block(topic=IMU, kind=Imu, t_ns=t_ns, columns={"angular_rate": table})
        blocks[IMU] = join_at_gyro_stamps(IMU, gyro, forces)
        notes.warn("gyroscope.txt and accelerometer.txt are joined, the force interpolated to the stamps of the rate")
    return blocks


def _read_columns(file: Path, names: tuple[str, ...], notes: Notes) -> tuple[Stamps, Array]:
    """Stamps (N,) ns and (N, K) columns of a file, by the names in its header, or in this order after the stamp."""
    header, rows = read_text_rows(file, None)
    has_names = all(name in header for name in names)
    places = [(name, header.index(name) if has_names else i) for i, name in enumerate(names, 1)]
    return read_numbers(file, rows, places, parse_seconds, notes)


def _read_rig(path: Path, images: dict[str, ImageStream], notes: Notes) -> Rig:
    """A rig of the camera in `calibration.txt`; without sensors if there is no such file, or no image that is readable.

    Args:
        path: The folder.
        images: Colour and depth, as far as they exist; the camera is that of colour, or else that of depth.
        notes: Collects how much the intrinsics change, in a file with a row for each image.

    Raises:
        ConfigError: The file has other contents than fx fy cx cy, or a row of these for each image.
    """
    file = path / "calibration.txt"
    other_file = next((name for name in _OTHER_CALIBRATIONS if (path / name).is_file()), None)
    if not file.is_file() and other_file is not None and not (path / RIG_NAME).is_file():
        notes.warn(
            f"{other_file} is not read: calibration.txt with fx fy cx cy in pixels, or a file for --rig, gives the "
            "camera"
        )
    topic = COLOR if COLOR in images else DEPTH
    if not file.is_file() or topic not in images or (size := read_first_image_size(images[topic])) is None:
        return Rig()
    _, rows = read_text_rows(file, None)
    cells = [w for row in rows for w in row.cells]
    per_image = len(rows) > 1 and all(len(row.cells) >= len(_INTRINSICS) for row in rows)
    # of rows of five numbers, the first is a stamp
    start = 1 if per_image and all(len(row.cells) == 1 + len(_INTRINSICS) for row in rows) else 0
    chosen = [row.cells[start : start + len(_INTRINSICS)] for row in rows] if per_image else [cells[:4]]
    try:
        table = np.array([[float(word) for word in row] for row in chosen]).reshape(-1, len(_INTRINSICS))
        sound = bool(np.isfinite(table).all() and len(table) and (table[:, :2] > 0).all())
    except ValueError:
        sound = False
    if not sound:
        raise ConfigError(file, "calibration", " ".join(cells[:8]), "fx fy cx cy, focal lengths above 0")
    fu, fv, pu, pv = table[choose_frame(file.name, table, notes)].tolist()
    rate, depth = mean_rate(images[topic].t_ns), DEPTH if DEPTH in images else ""
    return Rig(cameras={topic: make_pinhole(topic, size, (fu, fv, pu, pv), rate, depth)})


def write_tum_rgbd(recording: Recording, folder: Path, camera_topic: str | None = None) -> dict[str, int]:
    """Writes `rgb/`, `depth/` (5000 units per metre, up to 13.1 m) and the lists, ground truth and calibration.

    The layout has no gyroscope: rates and forces are written together to an additional `imu.txt`. By default the camera
    is the first one with depth.

    Returns:
        Rows written, by file.

    Raises:
        StrideTwinError: The recording lacks the camera or its depth.
    """
    camera = choose_camera(recording, camera_topic)
    if camera.depth_topic not in recording.topics:
        raise ConfigError(
            recording.path,
            f"depth of {camera.topic}",
            camera.depth_topic or None,
            "a camera with depth, or --frame FRAME for the trajectory of a frame",
        )
    counts = {}
    for name, topic in (("rgb", camera.topic), ("depth", camera.depth_topic)):
        counts[f"{name}.txt"] = _write_images(recording, topic, folder, name)
    imu = camera.imu_topic
    if imu in recording.topics:
        block = recording.block(imu)
        stamps = [format_seconds(t) for t in block.t_ns.tolist()]
        force, rate = block.columns["specific_force"], block.columns["angular_rate"]
        write_text_rows(folder / "accelerometer.txt", "# timestamp ax ay az", " ", stamps, force)
        both = np.column_stack((rate, force))
        write_text_rows(folder / "imu.txt", "# timestamp wx wy wz ax ay az", " ", stamps, both)
        counts |= {"accelerometer.txt": len(block), "imu.txt": len(block)}
    path = find_camera_path(recording, camera)
    if path is not None:
        write_tum(path, folder / "groundtruth.txt")
        counts["groundtruth.txt"] = len(path)
    (folder / "calibration.txt").write_text(" ".join(repr(float(v)) for v in camera.intrinsics) + "\n", "ascii")
    write_rig(_with_both_names(camera, recording.rig.imus.get(imu)), folder / RIG_NAME)
    return counts


def find_camera_path(recording: Recording, camera: CameraCalibration) -> Trajectory | None:
    """The true path of a camera's optical frame: recorded, or computed from that of its IMU and both mounts.

    Returns:
        Poses of the optical frame in the world; None if neither is recorded.
    """
    truth_topic = f"/truth{camera.topic}/odometry"
    T_frame_cam: Array = np.eye(4)  # pose of the optical frame in the frame whose path is recorded
    if truth_topic not in recording.topics:
        if camera.imu_topic not in recording.rig.imus:
            return None
        truth_topic = f"/truth{camera.imu_topic}/odometry"
        T_body_imu = recording.rig.imu(camera.imu_topic).mount.T_body_sensor
        T_frame_cam = np.linalg.inv(T_body_imu) @ camera.mount.T_body_sensor
    if truth_topic not in recording.topics:
        return None
    block = recording.block(truth_topic)
    from scipy.spatial.transform import Rotation

    R = Rotation.from_quat(block.columns["q_world_frame"], scalar_first=True)
    return Trajectory(  # T_world_cam = T_world_frame T_frame_cam
        t_ns=block.t_ns,
        p_frame_in_world=block.columns["p_frame_in_world"] + R.apply(T_frame_cam[:3, 3]),
        q_world_frame=(R * Rotation.from_matrix(T_frame_cam[:3, :3])).as_quat(scalar_first=True),
    )


def _with_both_names(camera: CameraCalibration, imu: ImuCalibration | None) -> Rig:
    """A rig with the camera and its IMU twice: under their own topics, and under those of an import of this layout.

    Args:
        camera: Camera that is written.
        imu: Its IMU; None without one.
    """
    as_imported = replace(camera, topic=COLOR, depth_topic=DEPTH, imu_topic=IMU if imu else "")
    imus = {i.topic: i for i in (imu, replace(imu, topic=IMU))} if imu else {}
    return Rig(cameras={c.topic: c for c in (camera, as_imported)}, imus=imus)


def _write_images(recording: Recording, topic: str, folder: Path, name: str) -> int:
    """Writes the images of a topic into `folder/name` and their list beside it; returns their number."""
    (folder / name).mkdir()
    rows = ["# timestamp filename"]
    for sample in recording.samples([topic]):
        file = f"{name}/{format_seconds(sample.t_ns)}.png"
        if isinstance(sample, Depth):
            write_depth(folder / file, sample, PER_METRE)
        elif isinstance(sample, Image):
            write_image(folder / file, sample)
        rows.append(f"{format_seconds(sample.t_ns)} {file}")
    (folder / f"{name}.txt").write_text("\n".join(rows) + "\n", encoding="ascii")
    return len(rows) - 1
