"""The keys of Kalibr's sections: other spellings are renamed, and keys that are not used are listed."""

from __future__ import annotations

import re
from typing import Literal

from stridetwin.streams.calibration_keys import Section, has_no_effect
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.foreign_calibration import NOISE, Converted
from stridetwin.streams.matrix_fields import join_rows

_CAMERA_KEYS = frozenset(
    (
        "camera_model",
        "intrinsics",
        "distortion_model",
        "distortion_coeffs",
        "resolution",
        "rostopic",
        "timeshift_cam_imu",
    )
    + ("line_delay", "readout_s", "T_cam_imu", "T_imu_cam", "T_cn_cnm1", "T_cnm1_cn")
)
"""Keys of a camera's section that are used."""
_IMU_KEYS = frozenset(("rostopic", "update_rate", "T_i_b", *NOISE))
"""Keys of an IMU's section that are used."""
_NO_EFFECT = {"cam_overlaps", "comment", "cam_name", "name"}
"""Keys that no calibration depends on."""
_HARMLESS = {"model": ("calibrated", "kalibr")}
"""Values of keys that say that nothing is to be corrected."""
_OTHER_NAMES = {
    "distortion_coefficients": "distortion_coeffs",
    "topic": "rostopic",
    "rate_hz": "update_rate",
    "T_cam_imu0": "T_cam_imu",
}
"""Our spelling of a key, by that of other tools."""
_CAM, _IMU = r"(?:camera|cam|c)\d*", r"(?:imu|body|i|b)\d*"
"""Names of the frames of a camera and of its IMU in the key of a transform, as `cam0` and `body`."""
_TO_CAMERA = re.compile(rf"T_?{_CAM}_?(?:{_IMU}|s)|{_CAM}_T_{_IMU}|(?:T_?)?{_IMU}_?to_?{_CAM}", re.IGNORECASE)
"""Spellings of T_cam_imu, which takes points from the IMU's frame to the camera's. S is okvis' name of the IMU."""
_TO_IMU = re.compile(rf"T_?(?:{_IMU}|s)_?{_CAM}|T_?b_?s|{_IMU}_T_{_CAM}|(?:T_?)?{_CAM}_?to_?{_IMU}", re.IGNORECASE)
"""Spellings of T_imu_cam, the pose of a camera in the IMU's frame. S in T_BS is the sensor."""
_BETWEEN = re.compile(r"T_?(?:cam|c)(\d+)_?(?:cam|c)(\d+)", re.IGNORECASE)
"""A transform between two numbered cameras."""


def rename_keys(converted: Converted, source: str, *, is_plain: bool) -> Converted:
    """The sections of a calibration with keys in Kalibr's spelling; those that are not used are added to `unused`.

    Args:
        converted: The sections as they are in the file.
        source: Names the file in errors.
        is_plain: Whether the file has no section of ours, whose mounts replace the transforms between IMUs.

    Raises:
        ConfigError: Two keys of a section are two spellings of one.
    """
    result = Converted(places=dict(converted.places), unused=list(converted.unused), notes=list(converted.notes))
    for name, node in converted.sections.items():
        if not isinstance(node, dict):
            if name == "stridetwin" or re.fullmatch(r"(?:cam|imu)\d{1,3}", name):
                result.sections[name] = node
            elif not has_no_effect(node):
                result.unused.append(name)
        elif name == "stridetwin":
            result.sections[name] = node
        elif match := re.fullmatch(r"(cam|imu)(\d{1,3})", name):
            is_camera = match[1] == "cam"
            section = _rename_section(name, node, int(match[2]), is_camera, result, source)
            if not is_camera and not is_plain:
                section.pop("T_i_b", None)
            result.sections[name] = section
        elif not has_no_effect(node):
            result.unused.append(name)
    return result


def _rename_section(name: str, node: Section, number: int, is_camera: bool, result: Converted, source: str) -> Section:
    """One section with keys in Kalibr's spelling.

    Args:
        name: Name of the section.
        node: Its keys.
        number: The number in its name.
        is_camera: Whether it is a camera's, or an IMU's.
        result: Takes the places of renamed keys, and the keys that are not used.
        source: Names the file in errors.

    Raises:
        ConfigError: Two of its keys are two spellings of one.
    """
    section: Section = {}
    for key, value in _join_parts(node).items() if is_camera else node.items():
        ours = _to_kalibr_key(key, number, is_camera)
        if ours is None:
            if not _is_harmless(key, value):
                result.unused.append(f"{name}.{key}")
            continue
        if ours in section:
            raise ConfigError(source, f"{name}.{key}", value, f"{ours} under one name alone")
        section[ours] = value
        if ours != key:
            result.places[f"{name}.{ours}"] = f"{name}.{key}"
    return section


def _join_parts(node: Section) -> Section:
    """A camera's section with a rotation `R_imu_cam` and a translation `t_imu_cam` as one transform `T_imu_cam`.

    A translation alone is no transform: its key, in lower case, is not used.
    """
    joined = {f"T{key[1:]}" if _is_whole_transform(key, value) else key: value for key, value in node.items()}
    for key in node:
        if key.startswith("R_") and _find_transform_to_imu(f"T_{key[2:]}"):
            translation = next((name for prefix in "tp" if (name := f"{prefix}_{key[2:]}") in node), "")
            rows = join_rows(node[key], node.get(translation))
            if rows is not None:
                del joined[key], joined[translation]
                joined[f"T_{key[2:]}"] = rows
    return joined


def _is_whole_transform(key: str, value: object) -> bool:
    """Whether a key `t_cam_imu` is that of a whole transform, of three rows or more of lists."""
    return key.startswith("t_") and isinstance(value, list) and len(value) > 2 and isinstance(value[0], list)


def _to_kalibr_key(key: str, number: int, is_camera: bool) -> str | None:
    """Kalibr's spelling of a key in the section of camera or IMU `number`; None if it is not used."""
    if key in (_CAMERA_KEYS if is_camera else _IMU_KEYS):
        return key
    spelling = _OTHER_NAMES.get(key, "")
    if spelling in (_CAMERA_KEYS if is_camera else _IMU_KEYS):
        return spelling
    return (_find_transform_between(key, number) or _find_transform_to_imu(key)) if is_camera else None


def _find_transform_to_imu(key: str) -> Literal["T_cam_imu", "T_imu_cam"] | None:
    """Which transform between camera and IMU a key of a camera's section means; None for another key."""
    if key.startswith("t_"):  # a translation
        return None
    if _TO_CAMERA.fullmatch(key):
        return "T_cam_imu"
    return "T_imu_cam" if _TO_IMU.fullmatch(key) else None


def _find_transform_between(key: str, number: int) -> Literal["T_cn_cnm1", "T_cnm1_cn"] | None:
    """Which transform between camera `number` and the one before it a key means; None for another key."""
    match = _BETWEEN.fullmatch(key)
    ends = (int(match[1]), int(match[2])) if match else None
    if ends == (number, number - 1):
        return "T_cn_cnm1"
    return "T_cnm1_cn" if ends == (number - 1, number) else None


def _is_harmless(key: str, value: object) -> bool:
    """Whether an unknown key changes nothing: it is of no calibration, or its value corrects nothing."""
    return key in _NO_EFFECT or value in _HARMLESS.get(key, ()) or has_no_effect(value)
