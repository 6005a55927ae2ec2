"""EuRoC MAV folders (ASL layout): `mav0/imu0/data.csv`, `mav0/cam0/data/*.png`, `sensor.yaml` beside each.

Burri et al., The EuRoC micro aerial vehicle datasets, IJRR 2016; TUM-VI uses the same layout. The body frame is the
IMU's; the ground truth of another frame, such as the marker of `vicon0`, is converted with its `T_BS`. Columns are
found by the names in the header, or in the published order without a header.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stridetwin.streams.bounded import LARGEST_SETTING, read_text
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.formats.assumed_calibration import BODY
from stridetwin.streams.formats.image_files import read_image_list
from stridetwin.streams.formats.poses import odometry
from stridetwin.streams.formats.text_rows import Row, integer_nanoseconds, numbers, read_text_rows
from stridetwin.streams.recording.imported import ImageStream, Notes, Source, unreadable
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Array, Block, Imu, Odometry
from stridetwin.streams.yaml_node import Node, parse_node

IMU_COLUMNS = ("w_RS_S_x", "w_RS_S_y", "w_RS_S_z", "a_RS_S_x", "a_RS_S_y", "a_RS_S_z")
IMU_UNITS = ("rad s^-1",) * 3 + ("m s^-2",) * 3
POSE_COLUMNS = ("p_RS_R_x", "p_RS_R_y", "p_RS_R_z", "q_RS_w", "q_RS_x", "q_RS_y", "q_RS_z")
POSE_UNITS = ("m",) * 3 + ("",) * 4 + ("m s^-1",) * 3
VELOCITY_COLUMNS = ("v_RS_R_x", "v_RS_R_y", "v_RS_R_z")
GROUND_TRUTHS = ("state_groundtruth_estimate0", "mocap0", "vicon0")
TRUTH = "/truth/head/imu/odometry"
NOISE = (
    "gyroscope_noise_density",
    "gyroscope_random_walk",
    "accelerometer_noise_density",
    "accelerometer_random_walk",
)
NAMES = {"imu0": "/head/imu", "cam0": "/head/color", "cam1": "/head/color_right"}
_DISTORTIONS = {"radial-tangential": "radtan", "radtan": "radtan", "equidistant": "equidistant"}


def euroc_root(path: Path) -> Path | None:
    """The folder with `imu0` or `cam0`: `path` itself or its subfolder `mav0`."""
    for root in (path / "mav0", path):
        if any((root / name).is_dir() for name in ("imu0", "cam0")):
            return root
    return None


def read_euroc(path: Path, notes: Notes) -> Source:
    """Reads a folder in the ASL layout.

    Args:
        path: The folder, or the parent of `mav0`.
        notes: Collects problems.

    Returns:
        Its IMUs, cameras and the first ground truth of `GROUND_TRUTHS`, under our topics (further sensors
        under their folder's name).

    Raises:
        StrideTwinError: A file cannot be read or a value in it is invalid, unless lenient.
    """
    root = euroc_root(path)
    if root is None:
        raise ConfigError(path, "", "no imu0 and no cam0", "a folder in the ASL layout")
    blocks: dict[str, Block[Any]] = {}
    images: dict[str, ImageStream] = {}
    imus: dict[str, ImuCalibration] = {}
    cameras: dict[str, CameraCalibration] = {}
    folders = sorted(p for p in root.iterdir() if p.is_dir())
    for folder in folders:
        topic = NAMES.get(folder.name, f"/{folder.name}")
        if re.fullmatch(r"imu\d+", folder.name):
            blocks[topic] = _read_imu(folder, topic, notes)
            if (imu := _imu_calibration(folder, topic)) is not None:
                imus[topic] = imu
        elif re.fullmatch(r"cam\d+", folder.name):
            images[topic] = read_image_list(folder / "data.csv", folder / "data", ",", integer_nanoseconds, notes)
            if (camera := _camera_calibration(folder, topic)) is not None:
                cameras[topic] = camera
    truth = next((n for n in GROUND_TRUTHS if (root / n / "data.csv").exists()), None)
    if truth is not None:
        blocks[TRUTH] = _read_truth(root / truth / "data.csv", notes)
    first = next(iter(imus), "")
    rig = Rig(imus=imus, cameras={t: replace(c, imu_topic=first) for t, c in cameras.items()})
    known = {"imu0", "cam0", truth} | {f.name for f in folders if re.fullmatch(r"(imu|cam)\d+", f.name)}
    unread = {f"/{f.name}": "folder" for f in folders if f.name not in known}
    return Source(kind="euroc", blocks=blocks, images=images, rig=rig, unread=unread)


def _read_imu(folder: Path, topic: str, notes: Notes) -> Block[Imu]:
    file = folder / "data.csv"
    header, rows = read_text_rows(file, ",")
    columns = _columns(file, header, IMU_COLUMNS, IMU_UNITS, notes)
    t_ns, table = numbers(file, rows, columns, integer_nanoseconds, notes)
    return Block(
        topic=topic, kind=Imu, t_ns=t_ns, columns={"angular_rate": table[:, :3], "specific_force": table[:, 3:]}
    )


def _read_truth(file: Path, notes: Notes) -> Block[Odometry]:
    header, rows = read_text_rows(file, ",")
    names = [_name_and_unit(word)[0] for word in header]
    has_velocity = VELOCITY_COLUMNS[0] in names or (not names and _width(rows) > len(POSE_COLUMNS) + 3)
    wanted = (*POSE_COLUMNS, *VELOCITY_COLUMNS) if has_velocity else POSE_COLUMNS
    columns = _columns(file, header, wanted, POSE_UNITS, notes)
    t_ns, table = numbers(file, rows, columns, integer_nanoseconds, notes)
    velocity = table[:, 7:10] if has_velocity else None
    return odometry(TRUTH, t_ns, table[:, :3], table[:, 3:7], velocity, notes, file, _marker(file.parent))


def _marker(folder: Path) -> Array | None:
    """T_BS of the sensor of a ground truth, such as Vicon's marker; None if its poses are the body's own."""
    node = _sensor(folder)
    if node is None or "T_BS" not in node:
        return None
    T = _mount(node).T_body_sensor
    return None if np.array_equal(T, np.eye(4)) else T


def _columns(
    file: Path, header: list[str], wanted: Sequence[str], units: Sequence[str], notes: Notes
) -> list[tuple[str, int]]:
    """Indices of the given columns, by the header's names, or in the published order without a header."""
    where = f"{file.parent.name}/{file.name}"
    names, own_units = zip(*(_name_and_unit(word) for word in header)) if header else ((), ())
    if not header:
        notes.warn(f"{where}: no header; columns assumed in the published order")
    elif not any(name in names for name in wanted):
        raise ConfigError(file, "header", ",".join(header), f"the columns timestamp, {', '.join(wanted)}")
    else:
        for name, valid in zip(wanted, units):
            if names.count(name) != 1:
                raise ConfigError(file, "header", ",".join(header), f"one column {name}")
            unit = own_units[names.index(name)]
            if unit and unit.replace("/s", " s^-1") != valid:
                raise ConfigError(file, f"header, unit of {name}", unit, valid)
        return [(name, names.index(name)) for name in wanted]
    return [(name, 1 + i) for i, name in enumerate(wanted)]


def _name_and_unit(word: str) -> tuple[str, str]:
    found = re.fullmatch(r"(\w+)\s*(?:\[(.*)\])?", word)
    return (found[1], (found[2] or "").strip()) if found else (word, "")


def _width(rows: list[Row]) -> int:
    return len(rows[0].words) if rows else 0


def _sensor(folder: Path) -> Node | None:
    file = folder / "sensor.yaml"
    if not file.exists():
        return None
    try:
        text = read_text(file, LARGEST_SETTING)
    except (OSError, UnicodeDecodeError) as error:
        raise unreadable(file, error) from error
    # OpenCV's own YAML extensions: a directive and a tag that other parsers do not know
    return parse_node(re.sub(r"!!opencv-matrix|^%.*$", "", text, flags=re.MULTILINE), str(file))


def _imu_calibration(folder: Path, topic: str) -> ImuCalibration | None:
    if (node := _sensor(folder)) is None:
        return None
    return ImuCalibration(
        topic=topic,
        part=_text(node, "comment"),
        rate_hz=node.at("rate_hz").number(0, above=True),
        mount=_mount(node),
        **{name: node.at(name).number(0) for name in NOISE},
    )


def _camera_calibration(folder: Path, topic: str) -> CameraCalibration | None:
    if (node := _sensor(folder)) is None:
        return None
    node.at("camera_model", "pinhole").choice(("pinhole",))
    fu, fv, pu, pv = node.at("intrinsics").numbers(4)
    if fu <= 0 or fv <= 0:
        raise node.at("intrinsics").error("fu, fv, cu, cv with focal lengths above 0")
    resolution = node.at("resolution").items()
    if len(resolution) != 2:
        raise node.at("resolution").error("a list of 2 integers")
    k1, k2, k3, k4 = node.at("distortion_coefficients", [0, 0, 0, 0]).numbers(4)
    return CameraCalibration(
        topic=topic,
        part=_text(node, "comment"),
        rate_hz=node.at("rate_hz", 0).number(0),
        mount=_mount(node),
        width=resolution[0].integer(1),
        height=resolution[1].integer(1),
        intrinsics=(fu, fv, pu, pv),
        distortion_model=_DISTORTIONS[node.at("distortion_model", "radial-tangential").choice(tuple(_DISTORTIONS))],
        distortion=(k1, k2, k3, k4),
    )


def _mount(node: Node) -> Mount:
    T = node.at("T_BS")
    if "data" in T:
        flat = T.at("data").numbers(16)
        rows = np.array(flat).reshape(4, 4).tolist()
        return Mount(body=BODY, T_body_sensor=Node(T.source, T.path, rows).transform())
    return Mount(body=BODY, T_body_sensor=T.transform())


def _text(node: Node, key: str) -> str:
    value = node.at(key, "").value
    return value if isinstance(value, str) else ""
