"""The rig as one Kalibr YAML file.

`cam0`, `cam1`, ... and `imu0`, `imu1`, ... follow Kalibr
(https://github.com/ethz-asl/kalibr/wiki/yaml-formats), so that its tools and everything built on them can read
the file. Values without a Kalibr key (mounts, parts, boards, other sensors) are under the key `stridetwin`. A plain
Kalibr calibration can be read, too: its body is then `imu0`, the IMU's own frame, and its camera rates are 0,
undeclared. So are calibrations of other tools (`foreign_calibration`, `realsense_calibration`). Keys of a file that are
not used are named, and values beyond those of a sensor that a person wears are refused (`calibration_limits`).
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import BaseModel

from stridetwin.streams.bounded import LARGEST_SETTING, read_bytes
from stridetwin.streams.calibration_limits import check_camera, check_imu, check_mount
from stridetwin.streams.camera_matrix import convert_camera_matrix, is_camera_matrix
from stridetwin.streams.errors import ConfigError, ConfigFileError, Missing, StrideTwinError, to_line
from stridetwin.streams.files import atomic_file
from stridetwin.streams.foreign_calibration import Converted, convert_calibration
from stridetwin.streams.kalibr_keys import rename_keys
from stridetwin.streams.kalibr_sections import (
    BEYOND_NOISE,
    OURS,
    TRANSFORMS,
    CameraExtras,
    CameraSection,
    ImuNoise,
    ImuSection,
    make_document_model,
)
from stridetwin.streams.lenses import COEFFICIENTS, EXACT_FIT_PX, VALID_LENS, WORST_FIT_PX, Lens, to_rig_lens
from stridetwin.streams.opencv_xml import is_opencv_xml, parse_opencv_xml
from stridetwin.streams.realsense_calibration import (
    convert_realsense_json,
    convert_realsense_text,
    is_realsense_json,
    is_realsense_text,
)
from stridetwin.streams.rig import Board, CameraCalibration, ImuCalibration, Mount, OtherSensor, Rig
from stridetwin.streams.samples import Array
from stridetwin.streams.validation import combine_errors, validate
from stridetwin.streams.yaml_file import FastDumper, clear_opencv_marks, parse_yaml

PLAIN_BODY = "imu0"
"""Body of all sensors of a plain Kalibr calibration: the frame of its IMU."""
_WANTED = (
    f"a Kalibr calibration with cam0, ..., imu0, ... or {OURS}, "
    "or one of OpenVINS, VINS-Fusion, ORB-SLAM3, Basalt, RealSense, EuRoC, ROS, OpenCV or MATLAB (JSON)"
)
"""What an error expects of a calibration file."""
_OTHER_FILES = (
    (re.compile(r"Normalized Residuals|^T_ci:", re.MULTILINE), "Kalibr's report", "camchain-imucam.yaml beside it"),
    (re.compile(r"%PDF"), "a PDF", "the YAML files beside it, such as Kalibr's camchain-imucam.yaml"),
    (re.compile(r"Stream Profiles supported"), "the list of a RealSense's modes", "output of rs-enumerate-devices -c"),
)
"""Files beside a calibration: what is in them, what they are, and what to give."""
_CONTENT = re.compile(r"^[ \t]*[^#\s]", re.MULTILINE)
"""A line that is neither empty nor a comment."""
_YAML_SUFFIXES = (".yaml", ".yml", ".json")
"""Endings of calibration files that are YAML or JSON."""
_MOST_KEYS = 10
"""Most keys of a file that an error lists."""
_DOCUMENT_END = re.compile(r"^---[ \t]*(?:#.*)?$|^\.\.\.[ \t]*$", re.MULTILINE)
"""A line that ends a document of YAML: `---` or `...`."""


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
            **{name: float(getattr(imu, name)) for name in BEYOND_NOISE},
        }
    ours["boards"] = {}
    for name, board in rig.boards.items():
        ours["boards"][name] = {
            "mount": _to_plain_data(board.mount),
            "squares": [int(n) for n in board.squares],
            "square_m": float(board.square_m),
        }
    ours["sensors"] = [_to_plain_data(sensor) for sensor in rig.others.values()]
    document[OURS] = ours
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


@dataclass(frozen=True, kw_only=True, eq=False)
class UnplacedMount(Mount):
    """Mount of a camera whose file does not say where it is; the pose is the identity."""


Warn = Callable[[str], None]
"""Receives a warning about a calibration file, one line."""


def rig_from_yaml(text: str, source: str) -> Rig:
    """A rig from YAML text that StrideTwin has written, without the checks of a user's file.

    Raises:
        StrideTwinError: The text is not YAML, or a value in it is invalid; names the key path and what is valid.
    """
    document = parse_yaml(text, source)
    return _to_rig(_sort_keys(document, source, None, ()), source)


def read_rig(
    path: str | Path,
    *more: str | Path,
    warn: Warn | None = None,
    sizes: Collection[tuple[int, int]] = (),
    needs_rates: bool = True,
) -> Rig:
    """A rig from a calibration file, or from Kalibr's two: camera chain and IMU.

    Besides our own and Kalibr's, these are files of OpenVINS, VINS-Fusion, ORB-SLAM3, Basalt, RealSense, EuRoC and ROS.

    Args:
        path: The file.
        more: Further files, whose sections are added; of two sections with one name the last counts.
        warn: Receives what is not used, and what is approximated; by default it becomes a `UserWarning`.
        sizes: (width, height) of the images, for a file with intrinsics at several resolutions; empty if unknown.
        needs_rates: Whether an IMU without a rate, as in VINS-Fusion's files, is refused; else its rate is 0.

    Raises:
        StrideTwinError: A file cannot be read, or a value in it is invalid or beyond what a person can wear; names
            file, key path and what is valid.
    """
    receive = warn or _warn_user

    def warn_on_one_line(text: str) -> None:
        """Hands a warning on, with marks that come from a file as escapes."""
        receive(to_line(text))

    paths = (path, *more)
    source = " + ".join(map(str, paths))
    merged = Converted()
    for file in map(Path, paths):
        merged.merge(_read_sections(file, sizes))
    if merged.unused:
        warn_on_one_line(f"{source}: keys that are not used: {', '.join(dict.fromkeys(merged.unused))}")
    for note in merged.notes:
        warn_on_one_line(f"{source}: {note}")
    rig = _to_rig(merged, source, warn=warn_on_one_line, is_checked=True)
    missing = next((f"imu{i}.update_rate" for i, imu in enumerate(rig.imus.values()) if not imu.rate_hz), None)
    if needs_rates and missing is not None:
        raise ConfigError(source, missing, Missing(), "the rate of the IMU in Hz")
    return rig


def _warn_user(text: str) -> None:
    """Issues a Python warning about a calibration file."""
    warnings.warn(text, UserWarning, stacklevel=4)


def _read_sections(file: Path, sizes: Collection[tuple[int, int]]) -> Converted:
    """The sections of a calibration file of any tool.

    Args:
        file: The file.
        sizes: (width, height) of the images; empty if unknown.

    Raises:
        StrideTwinError: It cannot be read, or is no calibration.
    """
    text = _read_calibration_text(file)
    if is_realsense_text(text):
        return convert_realsense_text(text, str(file), sizes)
    if is_opencv_xml(text):
        return _sort_keys(parse_opencv_xml(text, str(file)), str(file), None, sizes)
    for pattern, what, valid in _OTHER_FILES:
        if pattern.search(text):
            raise ConfigError(file, "", what, valid)

    def read_neighbour(name: str) -> dict[str, object]:
        """The plain data of another file of the same folder; a flat IMU is moved under `imu0`."""
        beside = file.parent / name
        document = _wrap_flat_imu(parse_yaml(_read_calibration_text(beside), str(beside)))
        if not isinstance(document, dict):
            raise ConfigError(beside, "", document, "a part of a calibration")
        return document

    return _sort_keys(_parse_first_document(text, str(file)), str(file), read_neighbour, sizes)


def _parse_first_document(text: str, source: str) -> object:
    """The plain data of a text with one YAML document, or of the first of several messages that ROS has printed.

    Raises:
        StrideTwinError: It is no YAML, or has several documents; or a file with another ending is none.
    """
    end = next(
        (mark.start() for mark in _DOCUMENT_END.finditer(text) if _CONTENT.search(text[: mark.start()])), len(text)
    )
    is_single = _CONTENT.search(_DOCUMENT_END.sub("", text[end:])) is None
    try:
        document = parse_yaml(text[:end], source)
    except ConfigError:
        raise
    except StrideTwinError:
        if Path(source).suffix.lower() in _YAML_SUFFIXES:
            raise
        raise ConfigError(source, "", "other text than YAML or JSON", _WANTED) from None
    if not is_single and not (isinstance(document, dict) and is_camera_matrix(document)):
        raise ConfigError(source, "", "several documents, separated by ---", "one document")
    return document


def _read_calibration_text(file: Path) -> str:
    """The text of a calibration file without OpenCV's marks.

    Characters that are not UTF-8, as in comments, become U+FFFD.

    Raises:
        StrideTwinError: The file cannot be read, or is too large.
    """
    if os.path.isdir(file):  # false for a name that the system refuses, which reading reports
        names = sorted(entry.name for entry in file.iterdir() if entry.suffix.lower() in _YAML_SUFFIXES)
        has = f"{', '.join(names[:_MOST_KEYS])}" if names else "none"
        raise ConfigError(file, "", "a folder", f"a calibration file; those inside: {has}")
    data = read_bytes(file, LARGEST_SETTING)
    is_utf_16 = data.startswith((b"\xff\xfe", b"\xfe\xff"))
    text = data.decode("utf-16" if is_utf_16 else "utf-8", errors="replace")
    return clear_opencv_marks(text.replace("\r\n", "\n").replace("\r", "\n"))


def _sort_keys(
    document: object,
    source: str,
    read_neighbour: Callable[[str], dict[str, object]] | None,
    sizes: Collection[tuple[int, int]],
) -> Converted:
    """The sections of a calibration's plain data, with keys in Kalibr's spelling, and the keys that are not used.

    Raises:
        ConfigError: The data are no calibration, or a value of another tool's file is missing or invalid.
    """
    document = _wrap_flat_imu(document)
    if not isinstance(document, dict):
        raise ConfigError(source, "", document, _WANTED)
    if _is_kalibr(document):
        return rename_keys(Converted(sections=document), source, is_plain=OURS not in document)
    converted = convert_calibration(document, source, read_neighbour)
    if converted is None and is_camera_matrix(document):
        converted = convert_camera_matrix(document, source, sizes)
    if converted is None and is_realsense_json(document):
        converted = convert_realsense_json(document, source, sizes)
    if converted is None or not converted.sections:
        keys = [*list(document)[:_MOST_KEYS], *(["..."] if len(document) > _MOST_KEYS else [])]
        raise ConfigError(source, "", f"keys {', '.join(keys)}", _WANTED)
    _add_size(converted, sizes)
    return rename_keys(converted, source, is_plain=OURS not in document)


def _add_size(converted: Converted, sizes: Collection[tuple[int, int]]) -> None:
    """Gives cameras without a size that of the images, if these have one size, and says so."""
    for name, section in converted.sections.items():
        if name.startswith("cam") and isinstance(section, dict) and "resolution" not in section and len(sizes) == 1:
            section["resolution"] = list(next(iter(sizes)))
            converted.notes.append(
                f"it has no size of the images: that of the recording's is taken, {section['resolution']}"
            )


def _is_kalibr(document: Mapping[str, object]) -> bool:
    """Whether it has a section of Kalibr's or of ours."""
    return bool(OURS in document or _find_numbered_keys(document, "cam") or _find_numbered_keys(document, "imu"))


def _wrap_flat_imu(document: object) -> object:
    """The document; if it is Kalibr's flat imu.yaml, which has the IMU's keys at the top, it is moved under `imu0`."""
    return {"imu0": document} if isinstance(document, dict) and "update_rate" in document else document


def _to_rig(converted: Converted, source: str, *, warn: Warn | None = None, is_checked: bool = False) -> Rig:
    """Builds a rig from the sections of a file.

    Args:
        converted: The sections, and where their values are in the file.
        source: Names the file in errors.
        warn: Receives what is approximated; None drops it.
        is_checked: Whether values beyond those of a sensor that a person wears are refused.

    Raises:
        StrideTwinError: A value is invalid, or two sensors have one topic.
    """
    document = converted.sections
    cams, imu_names = _find_numbered_keys(document, "cam"), _find_numbered_keys(document, "imu")
    model = make_document_model(
        tuple((name, _read_camera_model(document[name])) for name in cams), imu_names, OURS in document
    )
    with _name_original_places(converted, source):
        calibration: Any = validate(model, document, source)
        extras = getattr(calibration, OURS, None)  # our own section; None in a plain Kalibr file
        if (
            extras is None
            and not is_checked
            and (bare := [n for n in imu_names if not getattr(calibration, n).update_rate])
        ):
            raise ConfigError(source, f"{bare[0]}.update_rate", Missing(), "a number above 0")
        imus = _index_by_topic(
            source, [_to_imu(name, getattr(calibration, name), getattr(extras, name, None)) for name in imu_names]
        )
        cameras = _to_cameras({name: getattr(calibration, name) for name in cams}, extras, imus, source, warn)
        errors: list[StrideTwinError] = []
        if is_checked:
            for name, camera in zip(cams, cameras, strict=True):
                section = getattr(calibration, name)
                transforms = {key: T for key in TRANSFORMS if (T := getattr(section, key)) is not None}
                errors += check_camera(source, name, camera, transforms)
            errors += [
                e for name, imu in zip(imu_names, imus.values(), strict=True) for e in check_imu(source, name, imu)
            ]
            errors += [] if extras is None else _check_mounts(source, cams, cameras, imu_names, imus)
        if errors:
            raise combine_errors(errors)
        return Rig(
            imus=imus,
            cameras=_index_by_topic(source, cameras),
            boards={name: Board(name=name, **_to_rig_fields(b)) for name, b in extras.boards.items()} if extras else {},
            others=_index_by_topic(
                source, [OtherSensor(**_to_rig_fields(s)) for s in extras.sensors] if extras else []
            ),
        )


def _to_cameras(
    sections: Mapping[str, CameraSection],
    extras: BaseModel | None,
    imus: Mapping[str, ImuCalibration],
    source: str,
    warn: Warn | None,
) -> list[CameraCalibration]:
    """The calibrations of a chain of cameras, each of which may refer to the one before it.

    Args:
        sections: Their sections by name, in the order of their numbers.
        extras: Our own section; None in a plain Kalibr file.
        imus: IMUs by topic.
        source: Names the file in errors.
        warn: Receives what is approximated, and cameras without a transform to the IMU; None drops it.

    Raises:
        ConfigError: A value of a section contradicts another one.
    """
    cameras: list[CameraCalibration] = []
    T_cam_imu: Array | None = None
    for name, section in sections.items():
        T_cam_imu = _chain_T_cam_imu(name, section, T_cam_imu, source)
        if T_cam_imu is None and imus and extras is None and warn is not None:
            warn(f"{source}: {name}: no transform to the IMU, such as T_cam_imu: a known mount is kept, else none")
        lens = _to_lens(name, section, source, warn)
        cameras.append(_to_camera(name, section, lens, getattr(extras, name, None), T_cam_imu, imus, source))
    return cameras


def _check_mounts(
    source: str,
    cams: Iterable[str],
    cameras: Iterable[CameraCalibration],
    imu_names: Iterable[str],
    imus: Mapping[str, ImuCalibration],
) -> list[StrideTwinError]:
    """The errors of the mounts of our own section: sensors that are far from the body that carries them."""
    mounts = {name: camera.mount for name, camera in zip(cams, cameras, strict=True)}
    mounts |= {name: imu.mount for name, imu in zip(imu_names, imus.values(), strict=True)}
    return [e for name, mount in mounts.items() for e in check_mount(source, f"{OURS}.{name}", mount)]


@contextmanager
def _name_original_places(converted: Converted, source: str) -> Iterator[None]:
    """Context manager: errors about values of another tool's file name their places in that file."""
    try:
        yield
    except ConfigFileError as error:
        raise combine_errors([_restore_place(e, converted, source) for e in error.errors]) from None
    except ConfigError as error:
        raise _restore_place(error, converted, source) from None


def _restore_place(error: StrideTwinError, converted: Converted, source: str) -> StrideTwinError:
    """The error with the path of its value in the file, if it was read from another key."""
    if not isinstance(error, ConfigError):
        return error
    for place, original in converted.places.items():
        if error.field == place or error.field.startswith((f"{place}[", f"{place}.")):
            return ConfigError(source, original + error.field[len(place) :], error.value, error.valid)
    return error


def _read_camera_model(section: object) -> str:
    """The `camera_model` of a camera's section; "" if it has none."""
    kind = section.get("camera_model") if isinstance(section, dict) else ""
    return kind if isinstance(kind, str) else ""


def _to_lens(name: str, camera: CameraSection, source: str, warn: Warn | None) -> Lens:
    """The lens of a camera section, in a model of the rig.

    Args:
        name: Name of the section.
        camera: The section.
        source: Names the file in errors.
        warn: Receives the error of a lens that is approximated; None drops it.

    Raises:
        ConfigError: The number of coefficients is wrong, or no model of the rig comes near the lens.
    """
    counts, model = COEFFICIENTS[camera.distortion_model], camera.distortion_model
    if len(camera.distortion_coeffs) not in counts:
        valid = f"{' or '.join(map(str, counts))} coefficients of {model}"
        raise ConfigError(source, f"{name}.distortion_coeffs", camera.distortion_coeffs, valid)
    if model == "none" and any(camera.distortion_coeffs):
        valid = "no coefficients, or the distortion_model that they are of"
        raise ConfigError(source, f"{name}.distortion_coeffs", camera.distortion_coeffs, valid)
    description = f"{camera.camera_model} with distortion {model}"
    lens = to_rig_lens(
        camera.camera_model, camera.intrinsics, model, tuple(camera.distortion_coeffs), camera.resolution
    )
    if not lens.error_px <= WORST_FIT_PX:
        valid = f"{VALID_LENS}, which {description} is not"
        raise ConfigError(source, f"{name}.distortion_coeffs", camera.distortion_coeffs, valid)
    if lens.error_px > EXACT_FIT_PX and warn is not None:
        warn(f"{source}: {name}: {description} is fitted by {lens.model}, up to {lens.error_px:.2g} px off")
    return lens


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


def _to_imu(name: str, imu: ImuSection, extras: BaseModel | None) -> ImuCalibration:
    """The calibration of an IMU section.

    Args:
        name: Name of the section, which becomes the topic if the section has none.
        imu: Kalibr's section.
        extras: What a rig knows beyond it; None for a plain file, where the body is the IMU itself.
    """
    noise = {key: getattr(imu, key) for key in ImuNoise.model_fields}
    more: dict[str, Any]
    if extras is None:
        T_body_imu = np.eye(4) if imu.T_i_b is None else _inverse(imu.T_i_b)
        more = {"part": "", "mount": Mount(body=PLAIN_BODY, T_body_sensor=T_body_imu)}
    else:
        more = _to_rig_fields(extras)
    topic = f"/{name}" if imu.rostopic is None else imu.rostopic
    return ImuCalibration(topic=topic, rate_hz=imu.update_rate or 0.0, **noise, **more)


def _to_camera(
    name: str,
    camera: CameraSection,
    lens: Lens,
    extras: CameraExtras | None,
    T_cam_imu: Array | None,
    imus: Mapping[str, ImuCalibration],
    source: str,
) -> CameraCalibration:
    """The calibration of a camera section.

    Args:
        name: Name of the section.
        camera: Kalibr's section.
        lens: Its lens, in a model of the rig.
        extras: What a rig knows beyond it; None for a plain file, whose cameras are mounted in the frame of the IMU.
        T_cam_imu: (4, 4) IMU's frame to camera's, m, of the section or chained; None if unknown.
        imus: IMUs by topic.
        source: Name of the file in errors.

    Raises:
        ConfigError: An unknown IMU, or a mount that contradicts `T_cam_imu`.
    """
    more: dict[str, Any]
    if extras is None:
        mount: Mount = UnplacedMount(body=PLAIN_BODY)
        if T_cam_imu is not None:
            mount = Mount(body=PLAIN_BODY, T_body_sensor=_inverse(T_cam_imu))
        readout_s = camera.readout_s or camera.line_delay * (camera.resolution[1] - 1)
        more = {"part": "", "rate_hz": 0.0, "imu_topic": next(iter(imus), ""), "readout_s": readout_s}
    else:
        if extras.imu_topic and extras.imu_topic not in imus:
            valid = f"'' or one of {', '.join(imus) or 'no IMU at all'}"
            raise ConfigError(source, f"{OURS}.{name}.imu_topic", extras.imu_topic, valid)
        mount = _to_camera_mount(name, camera, extras, T_cam_imu, imus.get(extras.imu_topic), source)
        more = {key: value for key, value in dict(extras).items() if key != "mount"}
    return CameraCalibration(
        topic=f"/{name}" if camera.rostopic is None else camera.rostopic,
        mount=mount,
        width=camera.resolution[0],
        height=camera.resolution[1],
        intrinsics=lens.intrinsics,
        distortion_model=lens.model,
        distortion=lens.distortion,
        timeshift_cam_imu_s=camera.timeshift_cam_imu,
        **more,
    )


def _to_camera_mount(
    name: str,
    camera: CameraSection,
    extras: CameraExtras,
    T_cam_imu: Array | None,
    imu: ImuCalibration | None,
    source: str,
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
    mount, place = extras.mount, f"{OURS}.{name}.mount.T_body_sensor"
    if T_cam_imu is None or imu is None:
        if mount.T_body_sensor is None:
            raise ConfigError(source, place, Missing(), "4 rows of 4 numbers")
        return Mount(body=mount.body, T_body_sensor=mount.T_body_sensor)
    derived = imu.mount.T_body_sensor @ _inverse(T_cam_imu)  # pose of the camera on the IMU's body
    if mount.T_body_sensor is None:
        return Mount(body=mount.body, T_body_sensor=derived)
    if mount.body != imu.mount.body or not np.allclose(mount.T_body_sensor, derived, atol=1e-6):
        valid = f"the transform from {place} and the mount of {imu.topic}; omit the former to use T_cam_imu"
        raise ConfigError(source, f"{name}.T_cam_imu", T_cam_imu.tolist(), valid)
    return Mount(body=mount.body, T_body_sensor=mount.T_body_sensor)


def _chain_T_cam_imu(name: str, camera: CameraSection, previous: Array | None, source: str) -> Array | None:
    """T_cam_imu (4, 4) of a camera: its own, or T_cn_cnm1 times that of the `previous` camera; None if unknown.

    Raises:
        ConfigError: The file gives both directions of a transform, and they contradict each other.
    """
    direct = _choose_direction(f"{name}.T_imu_cam", camera.T_cam_imu, camera.T_imu_cam, source)
    from_previous = _choose_direction(f"{name}.T_cnm1_cn", camera.T_cn_cnm1, camera.T_cnm1_cn, source)
    if direct is not None:
        return direct
    if from_previous is not None and previous is not None:
        return np.asarray(from_previous @ previous)
    return None


def _choose_direction(path: str, forward: Array | None, backward: Array | None, source: str) -> Array | None:
    """A transform (4, 4) of which a file may give both directions; None if it gives neither.

    Args:
        path: Path of the backward one.
        forward: The transform; None without it.
        backward: Its inverse; None without it.
        source: Names the file in errors.

    Raises:
        ConfigError: They contradict each other.
    """
    if backward is None:
        return forward
    if forward is not None and not np.allclose(forward @ backward, np.eye(4), atol=1e-3):
        raise ConfigError(source, path, backward.tolist(), "the inverse of the other direction; omit one of them")
    return _inverse(backward) if forward is None else forward


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
