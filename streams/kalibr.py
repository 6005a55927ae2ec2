"""The rig as one Kalibr YAML file.

`cam0`, `cam1`, ... and `imu0`, `imu1`, ... follow Kalibr
(https://github.com/ethz-asl/kalibr/wiki/yaml-formats), so that its tools and everything built on them can read
the file. Values without a Kalibr key (mounts, parts, boards, other sensors) are under the key `stridetwin`. A plain
Kalibr calibration can be read, too: its body is then `imu0`, the IMU's own frame, and its camera rates are 0,
undeclared.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StrictInt, create_model

from stridetwin.streams.errors import ConfigError, Missing
from stridetwin.streams.fields import Count, FileModel, NotNegative, Number, Positive, field_error
from stridetwin.streams.files import atomic_file
from stridetwin.streams.matrix_fields import RigidTransform
from stridetwin.streams.rig import Board, CameraCalibration, ImuCalibration, Mount, OtherSensor, Rig
from stridetwin.streams.samples import Array
from stridetwin.streams.validation import validate
from stridetwin.streams.yaml_file import FastDumper, parse_yaml, read_yaml

PLAIN_BODY = "imu0"
"""Body of all sensors of a plain Kalibr calibration: the frame of its IMU."""
_OURS = "stridetwin"
"""Key of the section with what Kalibr has no keys for."""
_WANTED = f"a Kalibr calibration with cam0, ..., imu0, ... or {_OURS}"
_LARGEST = 1e300
"""Largest magnitude of a sensor's parameter: greater ones are mistakes, or too large for a float."""
_Squares = Annotated[StrictInt, Field(ge=2, le=2**31 - 1)]
_BEYOND_NOISE = (
    "gyroscope_bias_sd",
    "accelerometer_bias_sd",
    "gyroscope_range",
    "accelerometer_range",
    "gyroscope_scale_sd",
    "gyroscope_misalignment_sd",
    "accelerometer_scale_sd",
)
"""Attributes of an IMU's calibration that Kalibr has no keys for: biases, ranges and errors of scale and axes."""


def rig_to_yaml(rig: Rig) -> str:
    """The YAML text of a rig: Kalibr's sections of cameras and IMUs, and under a key of our own what else it knows.

    Raises:
        ConfigError: A camera's IMU is on another body.
        StrideTwinError: A camera names an IMU that the rig lacks.
    """
    document: dict[str, Any] = {}  # sections `cam0`, ..., `imu0`, ... of Kalibr
    ours: dict[str, Any] = {}  # what Kalibr has no keys for, by the same names
    for i, camera in enumerate(rig.cameras.values()):
        document[f"cam{i}"] = {
            "camera_model": "pinhole",
            "intrinsics": _to_plain_data(camera.intrinsics),
            "distortion_model": camera.distortion_model,
            "distortion_coeffs": _to_plain_data(camera.distortion),
            "resolution": [int(camera.width), int(camera.height)],
            "rostopic": camera.topic,
            "timeshift_cam_imu": float(camera.timeshift_cam_imu_s),
        }
        if (T_cam_imu := _compute_T_cam_imu(rig, camera)) is not None:
            document[f"cam{i}"]["T_cam_imu"] = T_cam_imu.tolist()
        ours[f"cam{i}"] = {
            "part": camera.part,
            "rate_hz": float(camera.rate_hz),
            "mount": _to_plain_data(camera.mount),
            "depth_topic": camera.depth_topic,
            "imu_topic": camera.imu_topic,
        }
        if camera.readout_s:
            ours[f"cam{i}"]["readout_s"] = float(camera.readout_s)
    for i, imu in enumerate(rig.imus.values()):
        document[f"imu{i}"] = {
            "rostopic": imu.topic,
            "update_rate": float(imu.rate_hz),
            **{name: float(getattr(imu, name)) for name in ImuNoise.model_fields},
            "T_i_b": np.eye(4).tolist(),  # Kalibr's transform between its IMUs, which is not read here
        }
        ours[f"imu{i}"] = {
            "part": imu.part,
            "mount": _to_plain_data(imu.mount),
            **{name: float(getattr(imu, name)) for name in _BEYOND_NOISE},
        }
    ours["boards"] = {}
    for name, board in rig.boards.items():
        ours["boards"][name] = {
            "mount": _to_plain_data(board.mount),
            "squares": [int(n) for n in board.squares],
            "square_m": float(board.square_m),
        }
    ours["sensors"] = [_to_plain_data(sensor) for sensor in rig.others.values()]
    document[_OURS] = ours
    return str(yaml.dump(document, Dumper=FastDumper, sort_keys=False, default_flow_style=None, width=120))


def _to_plain_data(value: Any) -> Any:
    """Plain data of a value: dataclasses and mappings as dicts, text as it is, numbers and arrays as floats."""
    if is_dataclass(value):
        return {f.name: _to_plain_data(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {key: _to_plain_data(item) for key, item in value.items()}
    return value if isinstance(value, str) else np.asarray(value, float).tolist()


def write_rig(rig: Rig, path: str | Path) -> None:
    """Writes a rig as a YAML file, atomically."""
    with atomic_file(path) as temporary:
        temporary.write_text(rig_to_yaml(rig), encoding="utf-8")


def rig_from_yaml(text: str, source: str) -> Rig:
    """A rig from YAML text.

    Raises:
        StrideTwinError: The text is not YAML, or a value in it is invalid; names the key path and what is valid.
    """
    return _to_rig(_wrap_flat_imu(parse_yaml(text, source)), source)


def read_rig(path: str | Path, *more: str | Path) -> Rig:
    """A rig from a YAML file, or from Kalibr's two: camera chain and IMU.

    Args:
        path: The file.
        more: Further files, whose sections are added; of two sections with one name the last counts.

    Raises:
        StrideTwinError: A file cannot be read, or a value in it is invalid; names file, key path and what is valid.
    """
    paths = (path, *more)
    sections = [_wrap_flat_imu(read_yaml(p)) for p in paths]
    source = " + ".join(map(str, paths))
    if any(not isinstance(section, dict) for section in sections):
        raise ConfigError(source, "", sections[0], _WANTED)
    return _to_rig({key: value for section in sections for key, value in section.items()}, source)


def _wrap_flat_imu(document: Any) -> Any:
    """The document; if it is Kalibr's flat imu.yaml, which has the IMU's keys at the top, it is moved under `imu0`."""
    return {"imu0": document} if isinstance(document, dict) and "update_rate" in document else document


class _Kalibr(BaseModel):
    """A section of Kalibr's; keys that are not read are left alone."""

    model_config = ConfigDict(frozen=True)


class _Camera(_Kalibr):
    """A camera section of Kalibr's camera chain."""

    camera_model: Literal["pinhole"]
    intrinsics: tuple[Positive, Positive, Number, Number]
    distortion_model: Literal["radtan", "equidistant"]
    distortion_coeffs: tuple[Number, Number, Number, Number]
    resolution: tuple[Count, Count]
    rostopic: str
    timeshift_cam_imu: Number = 0.0
    T_cam_imu: RigidTransform | None = None
    T_cn_cnm1: RigidTransform | None = None


class ImuNoise(_Kalibr):
    """Noise densities of an IMU, the keys of Kalibr and of EuRoC."""

    gyroscope_noise_density: NotNegative
    gyroscope_random_walk: NotNegative
    accelerometer_noise_density: NotNegative
    accelerometer_random_walk: NotNegative


class _Imu(ImuNoise):
    """An IMU section of Kalibr's file."""

    rostopic: str | None = None
    update_rate: Positive


class _CameraMount(FileModel):
    """The body that carries a camera, and the camera's pose on it, unless Kalibr's `T_cam_imu` gives it."""

    body: str
    T_body_sensor: RigidTransform | None = None


class _Mount(_CameraMount):
    """The body that carries a sensor or board, and the pose on it."""

    T_body_sensor: RigidTransform


class _CameraExtras(FileModel):
    """What a rig knows of a camera beyond Kalibr's section."""

    part: str = ""
    rate_hz: NotNegative
    mount: _CameraMount
    depth_topic: str = ""
    imu_topic: str = ""
    readout_s: NotNegative = 0.0


_bounds_and_scales: dict[str, Any] = {name: (NotNegative, 0.0) for name in _BEYOND_NOISE}
_ImuExtras = create_model("_ImuExtras", __base__=FileModel, part=(str, ""), mount=(_Mount, ...), **_bounds_and_scales)


class _Board(FileModel):
    """A board of a rig."""

    mount: _Mount
    squares: tuple[_Squares, _Squares]
    square_m: Positive


def _to_parameter(node: Any) -> Any:
    """A parameter of a sensor as floats: a number, or lists of numbers.

    Raises:
        PydanticCustomError: Anything else, or a number that is too large.
    """
    if isinstance(node, list):
        return [_to_parameter(item) for item in node]
    if isinstance(node, bool) or not isinstance(node, (int, float)) or not abs(node) < _LARGEST:
        raise field_error(node, "a number, or lists of numbers")
    return float(node)


class _Sensor(FileModel):
    """A sensor of a rig that has no section in Kalibr's format."""

    topic: str
    kind: Literal["range", "insole", "ahrs", "encoder", "interaction", "actuator"]
    part: str = ""
    rate_hz: Positive
    mount: _Mount
    parameters: dict[str, Annotated[Any, AfterValidator(_to_parameter)]] = Field(default_factory=dict)


@lru_cache(maxsize=16)
def _document_model(cameras: tuple[str, ...], imus: tuple[str, ...], has_extras: bool) -> type[BaseModel]:
    """The pydantic model of a file with these sections, each a field of its name.

    Args:
        cameras: Names of the sections of cameras, `cam0`, ...
        imus: Names of the sections of IMUs, `imu0`, ...
        has_extras: Whether the file has our own section, which then must have a part for each of these.
    """
    # pydantic takes a pair for each field: its type and its default, where `...` means required
    sections: dict[str, Any] = {name: (_Camera, ...) for name in cameras} | {name: (_Imu, ...) for name in imus}
    if has_extras:
        extras: dict[str, Any] = {name: (_CameraExtras, ...) for name in cameras} | {
            name: (_ImuExtras, ...) for name in imus
        }
        extras |= {"boards": (dict[str, _Board], {}), "sensors": (list[_Sensor], [])}
        sections[_OURS] = (create_model(_OURS, __base__=FileModel, **extras), ...)
    return create_model("Calibration", __base__=_Kalibr, **sections)


def _to_rig(document: Any, source: str) -> Rig:
    """Builds a rig from the plain data of a file.

    Raises:
        StrideTwinError: The data are no calibration, a value is invalid, or two sensors have one topic.
    """
    keys = document if isinstance(document, dict) else ()
    cams, imu_names = _find_numbered_keys(keys, "cam"), _find_numbered_keys(keys, "imu")
    if not (cams or imu_names or _OURS in keys):
        raise ConfigError(source, "", document, _WANTED)
    calibration: Any = validate(_document_model(cams, imu_names, _OURS in keys), document, source)
    extras = getattr(calibration, _OURS, None)  # our own section; None in a plain Kalibr file
    imus = _index_by_topic(
        source, [_to_imu(name, getattr(calibration, name), getattr(extras, name, None)) for name in imu_names]
    )
    cameras: list[CameraCalibration] = []
    previous: Array | None = None  # T_cam_imu of the camera before, which the next one may refer to
    for name in cams:
        camera = getattr(calibration, name)
        previous = _chain_T_cam_imu(camera, previous)
        cameras.append(_to_camera(name, camera, getattr(extras, name, None), previous, imus, source))
    return Rig(
        imus=imus,
        cameras=_index_by_topic(source, cameras),
        boards={name: Board(name=name, **_to_rig_fields(b)) for name, b in extras.boards.items()} if extras else {},
        others=_index_by_topic(source, [OtherSensor(**_to_rig_fields(s)) for s in extras.sensors] if extras else []),
    )


def _find_numbered_keys(keys: Iterable[str], stem: str) -> tuple[str, ...]:
    """The keys `cam0`, `cam1`, ... of a file, by number; `stem` is `cam` or `imu`."""
    names = [key for key in keys if re.fullmatch(rf"{stem}\d{{1,3}}", key)]
    return tuple(sorted(names, key=lambda key: int(key.removeprefix(stem))))


def _index_by_topic(source: str, items: list[Any]) -> dict[str, Any]:
    """Sensors by topic.

    Raises:
        ConfigError: Two sensors of a kind have one topic.
    """
    by_topic: dict[str, Any] = {}
    for item in items:
        if item.topic in by_topic:
            raise ConfigError(source, "rostopic", item.topic, "a topic that no other sensor of its kind has")
        by_topic[item.topic] = item
    return by_topic


def _to_rig_fields(model: BaseModel) -> dict[str, Any]:
    """The fields of a file's model by name, with its `mount` converted to the rig's `Mount`."""
    values = dict(model)
    return values | {"mount": Mount(**dict(values["mount"]))}


def _to_imu(name: str, imu: _Imu, extras: BaseModel | None) -> ImuCalibration:
    """The calibration of an IMU section.

    Args:
        name: Name of the section, which becomes the topic if the section has none.
        imu: Kalibr's section.
        extras: What a rig knows beyond it; None for a plain file, where the body is the IMU itself.
    """
    noise = dict(imu)  # all fields of the section: the noise densities are left once the others are taken out
    topic, rate = noise.pop("rostopic"), noise.pop("update_rate")
    more: dict[str, Any] = _to_rig_fields(extras) if extras else {"part": "", "mount": Mount(body=PLAIN_BODY)}
    return ImuCalibration(topic=f"/{name}" if topic is None else topic, rate_hz=rate, **noise, **more)


def _to_camera(
    name: str,
    camera: _Camera,
    extras: _CameraExtras | None,
    T_cam_imu: Array | None,
    imus: Mapping[str, ImuCalibration],
    source: str,
) -> CameraCalibration:
    """The calibration of a camera section.

    Args:
        name: Name of the section.
        camera: Kalibr's section.
        extras: What a rig knows beyond it; None for a plain file, whose cameras are mounted in the frame of the IMU.
        T_cam_imu: (4, 4) IMU's frame to camera's, m, of the section or chained; None if unknown.
        imus: IMUs by topic.
        source: Name of the file in errors.

    Raises:
        ConfigError: An unknown IMU, or a mount that contradicts `T_cam_imu`.
    """
    more: dict[str, Any]
    if extras is None:
        mount = Mount(body=PLAIN_BODY, T_body_sensor=np.eye(4) if T_cam_imu is None else _inverse(T_cam_imu))
        more = {"part": "", "rate_hz": 0.0, "imu_topic": next(iter(imus), "")}
    else:
        if extras.imu_topic and extras.imu_topic not in imus:
            wanted = f"'' or one of {', '.join(imus) or 'no IMU at all'}"
            raise ConfigError(source, f"{_OURS}.{name}.imu_topic", extras.imu_topic, wanted)
        mount = _to_camera_mount(name, camera, extras, T_cam_imu, imus.get(extras.imu_topic), source)
        more = {key: value for key, value in dict(extras).items() if key != "mount"}
    return CameraCalibration(
        topic=camera.rostopic,
        mount=mount,
        width=camera.resolution[0],
        height=camera.resolution[1],
        intrinsics=camera.intrinsics,
        distortion_model=camera.distortion_model,
        distortion=camera.distortion_coeffs,
        timeshift_cam_imu_s=camera.timeshift_cam_imu,
        **more,
    )


def _to_camera_mount(
    name: str, camera: _Camera, extras: _CameraExtras, T_cam_imu: Array | None, imu: ImuCalibration | None, source: str
) -> Mount:
    """A camera's mount, checked against Kalibr's T_cam_imu: they must agree, or one of them must be omitted.

    Args:
        name: Name of the section.
        camera: Kalibr's section.
        extras: What a rig knows beyond it, with the mount.
        T_cam_imu: (4, 4) IMU's frame to camera's, m; None if unknown.
        imu: The camera's IMU; None without one.
        source: Name of the file in errors.

    Raises:
        ConfigError: The two contradict each other, or both are missing.
    """
    mount, place = extras.mount, f"{_OURS}.{name}.mount.T_body_sensor"
    if T_cam_imu is None or imu is None:
        if mount.T_body_sensor is None:
            raise ConfigError(source, place, Missing(), "4 rows of 4 numbers")
        return Mount(body=mount.body, T_body_sensor=mount.T_body_sensor)
    derived = imu.mount.T_body_sensor @ _inverse(T_cam_imu)  # pose of the camera on the IMU's body
    if mount.T_body_sensor is None:
        return Mount(body=mount.body, T_body_sensor=derived)
    if mount.body != imu.mount.body or not np.allclose(mount.T_body_sensor, derived, atol=1e-6):
        wanted = f"the transform from {place} and the mount of {imu.topic}; omit the former to use T_cam_imu"
        T_declared = camera.T_cam_imu if camera.T_cam_imu is not None else T_cam_imu
        raise ConfigError(source, f"{name}.T_cam_imu", T_declared.tolist(), wanted)
    return Mount(body=mount.body, T_body_sensor=mount.T_body_sensor)


def _chain_T_cam_imu(camera: _Camera, previous: Array | None) -> Array | None:
    """T_cam_imu (4, 4) of a camera: its own, or T_cn_cnm1 times that of the `previous` camera; None if unknown."""
    if camera.T_cam_imu is not None:
        return camera.T_cam_imu
    if camera.T_cn_cnm1 is not None and previous is not None:
        return np.asarray(camera.T_cn_cnm1 @ previous)
    return None


def _compute_T_cam_imu(rig: Rig, camera: CameraCalibration) -> Array | None:
    """T_cam_imu (4, 4) of a camera, from its mount and that of its IMU; None without an IMU.

    Raises:
        ConfigError: The IMU is on another body.
    """
    if not camera.imu_topic:
        return None
    imu = rig.imu(camera.imu_topic)
    if imu.mount.body != camera.mount.body:
        raise ConfigError(camera.topic, "imu_topic", camera.imu_topic, f"an IMU on the same body, {camera.mount.body}")
    return _inverse(camera.mount.T_body_sensor) @ imu.mount.T_body_sensor  # T_cam_body T_body_imu


def _inverse(T: Array) -> Array:
    """The inverse (4, 4) of a rigid transform: Rᵀ and -Rᵀ p."""
    R, p = T[:3, :3], T[:3, 3]
    inverse = np.eye(4)
    inverse[:3, :3], inverse[:3, 3] = R.T, -R.T @ p
    return inverse
