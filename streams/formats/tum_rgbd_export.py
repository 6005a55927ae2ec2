"""Recordings as RGB-D folders in the TUM layout."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.formats.image_files import chosen_camera, write_depth, write_image
from stridetwin.streams.formats.tum import seconds, write_tum
from stridetwin.streams.formats.tum_rgbd import COLOR, DEPTH, IMU, PER_METRE
from stridetwin.streams.kalibr import write_rig
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.recording.writer import RIG_NAME
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Rig
from stridetwin.streams.samples import Array, Depth, Image
from stridetwin.streams.trajectory import Trajectory


def write_tum_rgbd(recording: Recording, folder: Path, camera_topic: str | None = None) -> dict[str, int]:
    """Writes `rgb/`, `depth/` (5000 units per metre, up to 13.1 m) and the lists, ground truth and calibration.

    The layout has no gyroscope: rates and forces are written together to an additional `imu.txt`.

    Args:
        recording: Needs a colour camera with a registered depth stream.
        folder: An empty folder.
        camera_topic: Topic of the camera; by default the first one with depth.

    Returns:
        Rows written, by file.

    Raises:
        StrideTwinError: The recording lacks the camera or its depth.
    """
    camera = chosen_camera(recording, camera_topic)
    if camera.depth_topic not in recording.topics:
        raise ConfigError(
            recording.path, f"depth of {camera.topic}", camera.depth_topic or None,
            "a camera with depth, or --frame FRAME for the trajectory of a frame",
        )  # fmt: skip
    counts = {}
    for name, topic in (("rgb", camera.topic), ("depth", camera.depth_topic)):
        counts[f"{name}.txt"] = _write_images(recording, topic, folder, name)
    imu = camera.imu_topic
    if imu in recording.topics:
        block = recording.block(imu)
        rows = [
            f"{seconds(t)} {' '.join(map(repr, a))}"
            for t, a in zip(block.t_ns.tolist(), block.columns["specific_force"].tolist())
        ]
        (folder / "accelerometer.txt").write_text("\n".join(["# timestamp ax ay az", *rows]) + "\n", encoding="ascii")
        rates = block.columns["angular_rate"].tolist()
        rows = [f"{t} {' '.join(map(repr, w))} {a}" for (t, a), w in zip((r.split(" ", 1) for r in rows), rates)]
        header = "# timestamp wx wy wz ax ay az"
        (folder / "imu.txt").write_text("\n".join([header, *rows]) + "\n", encoding="ascii")
        counts |= {"accelerometer.txt": len(rows), "imu.txt": len(rows)}
    path = camera_path(recording, camera)
    if path is not None:
        write_tum(path, folder / "groundtruth.txt")
        counts["groundtruth.txt"] = len(path)
    (folder / "calibration.txt").write_text(" ".join(repr(float(v)) for v in camera.intrinsics) + "\n", "ascii")
    write_rig(_both_names(camera, recording.rig.imus.get(imu)), folder / RIG_NAME)
    return counts


def camera_path(recording: Recording, camera: CameraCalibration) -> Trajectory | None:
    """Ground truth of a camera's optical frame: recorded, or from that of its IMU and their mounts."""
    truth_topic = f"/truth{camera.topic}/odometry"
    T_frame_cam: Array = np.eye(4)
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
    return Trajectory(
        t_ns=block.t_ns,
        p_frame_in_world=block.columns["p_frame_in_world"] + R.apply(T_frame_cam[:3, 3]),
        q_world_frame=(R * Rotation.from_matrix(T_frame_cam[:3, :3])).as_quat(scalar_first=True),
    )


def _both_names(camera: CameraCalibration, imu: ImuCalibration | None) -> Rig:
    """Camera and IMU under their own topics, and under the topics that an import of this layout uses."""
    read_as = replace(camera, topic=COLOR, depth_topic=DEPTH, imu_topic=IMU if imu else "")
    cameras = {c.topic: c for c in (camera, read_as)}
    imus = {i.topic: i for i in (imu, replace(imu, topic=IMU))} if imu else {}
    return Rig(cameras=cameras, imus=imus)


def _write_images(recording: Recording, topic: str, folder: Path, name: str) -> int:
    (folder / name).mkdir()
    rows = ["# timestamp filename"]
    for sample in recording.samples([topic]):
        file = f"{name}/{seconds(sample.t_ns)}.png"
        if isinstance(sample, Depth):
            write_depth(folder / file, sample, PER_METRE)
        elif isinstance(sample, Image):
            write_image(folder / file, sample)
        rows.append(f"{seconds(sample.t_ns)} {file}")
    (folder / f"{name}.txt").write_text("\n".join(rows) + "\n", encoding="ascii")
    return len(rows) - 1
