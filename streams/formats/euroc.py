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
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, BeforeValidator

from stridetwin.streams.bounded import LARGEST_SETTING, read_text
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.fields import Count, NotNegative, Number, Positive, RigidTransform, words
from stridetwin.streams.formats.assumed_calibration import BODY
from stridetwin.streams.formats.derived import odometry
from stridetwin.streams.formats.image_files import read_image_list
from stridetwin.streams.formats.text_rows import Row, integer_nanoseconds, numbers, read_text_rows
from stridetwin.streams.kalibr import ImuNoise
from stridetwin.streams.recording.imported import ImageStream, Source
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Array, Block, Imu, Odometry
from stridetwin.streams.validation import validated
from stridetwin.streams.yaml_file import parse_yaml

IMU_COLUMNS = ("w_RS_S_x", "w_RS_S_y", "w_RS_S_z", "a_RS_S_x", "a_RS_S_y", "a_RS_S_z")
IMU_UNITS = ("rad s^-1",) * 3 + ("m s^-2",) * 3
POSE_COLUMNS = ("p_RS_R_x", "p_RS_R_y", "p_RS_R_z", "q_RS_w", "q_RS_x", "q_RS_y", "q_RS_z")
POSE_UNITS = ("m",) * 3 + ("",) * 4 + ("m s^-1",) * 3
VELOCITY_COLUMNS = ("v_RS_R_x", "v_RS_R_y", "v_RS_R_z")
GROUND_TRUTHS = ("state_groundtruth_estimate0", "mocap0", "vicon0")
TRUTH = "/truth/head/imu/odometry"
NAMES = {"imu0": "/head/imu", "cam0": "/head/color", "cam1": "/head/color_right"}
S = TypeVar("S", bound=BaseModel)
_DISTORTIONS = {"radial-tangential": "radtan", "radtan": "radtan", "equidistant": "equidistant"}


def euroc_root(path: Path) -> Path | None:
    """The folder with `imu0` or `cam0`: `path` itself or its subfolder `mav0`."""
    for root in (path / "mav0", path):
        if any((root / name).is_dir() for name in ("imu0", "cam0")):
            return root
    return None


def read_euroc(path: Path, notes: Notes) -> Source:
    """Reads a folder in the ASL layout.

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
            stream = read_image_list(folder / "data.csv", folder / "data", ",", integer_nanoseconds, notes)
            if not len(stream.t_ns):
                continue
            images[topic] = stream
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
    found = _sensor(folder, _Marker)
    return None if found is None or found.T_BS is None or np.array_equal(found.T_BS, np.eye(4)) else found.T_BS


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


def _rows_of(node: Any) -> Any:
    """Rows of a matrix; OpenCV lists its 16 numbers under `data`."""
    data = node.get("data") if isinstance(node, dict) else None
    return [data[i : i + 4] for i in range(0, 16, 4)] if isinstance(data, list) and len(data) == 16 else node


class _Marker(BaseModel):
    """A `sensor.yaml` of a ground truth."""

    T_BS: Annotated[RigidTransform | None, BeforeValidator(_rows_of)] = None


class _Sensor(BaseModel):
    """A `sensor.yaml`; keys that are not read are left alone."""

    T_BS: Annotated[RigidTransform, BeforeValidator(_rows_of)]
    comment: Annotated[str, BeforeValidator(lambda node: node if isinstance(node, str) else "")] = ""

    @property
    def mount(self) -> Mount:
        """Pose in the body."""
        return Mount(body=BODY, T_body_sensor=self.T_BS)


class _ImuSensor(_Sensor, ImuNoise):
    rate_hz: Positive


class _CameraSensor(_Sensor):
    camera_model: Literal["pinhole"] = "pinhole"
    intrinsics: tuple[Positive, Positive, Number, Number]
    resolution: tuple[Count, Count]
    distortion_coefficients: tuple[Number, Number, Number, Number] = (0.0, 0.0, 0.0, 0.0)
    distortion_model: Annotated[str, words(_DISTORTIONS)] = "radtan"
    rate_hz: NotNegative = 0.0


def _sensor(folder: Path, kind: type[S]) -> S | None:
    """The calibration of a sensor; None without its file."""
    file = folder / "sensor.yaml"
    if not file.exists():
        return None
    # OpenCV's own YAML extensions: a directive and a tag that other parsers do not know
    text = re.sub(r"!!opencv-matrix|^%.*$", "", read_text(file, LARGEST_SETTING), flags=re.MULTILINE)
    return validated(kind, parse_yaml(text, str(file)), file)


def _imu_calibration(folder: Path, topic: str) -> ImuCalibration | None:
    if (found := _sensor(folder, _ImuSensor)) is None:
        return None
    noise = {name: getattr(found, name) for name in ImuNoise.model_fields}
    return ImuCalibration(topic=topic, part=found.comment, rate_hz=found.rate_hz, mount=found.mount, **noise)


def _camera_calibration(folder: Path, topic: str) -> CameraCalibration | None:
    if (found := _sensor(folder, _CameraSensor)) is None:
        return None
    return CameraCalibration(
        topic=topic,
        part=found.comment,
        rate_hz=found.rate_hz,
        mount=found.mount,
        width=found.resolution[0],
        height=found.resolution[1],
        intrinsics=found.intrinsics,
        distortion_model=found.distortion_model,
        distortion=found.distortion_coefficients,
    )
