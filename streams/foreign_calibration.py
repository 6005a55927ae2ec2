"""Calibration files of other tools as sections of a Kalibr file.

Read are OpenVINS (`estimator_config.yaml`), VINS-Fusion and VINS-Mono with the camera files of camodocal, ORB-SLAM3
(both versions of its settings), Basalt (JSON), and a single `sensor.yaml` of EuRoC. A transform
`T_a_b` takes points from frame b to frame a; each tool's direction is that of its own documentation.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field

from stridetwin.streams.calibration_keys import Keys, Section, has_no_effect
from stridetwin.streams.errors import FieldLocation

NOISE = (
    "gyroscope_noise_density",
    "gyroscope_random_walk",
    "accelerometer_noise_density",
    "accelerometer_random_walk",
)
"""Kalibr's keys of an IMU's noise: gyroscope's density and random walk, then the accelerometer's."""
_UNKNOWN_EXTRINSIC = 2
"""Value of VINS' `estimate_extrinsic` for a transform that is not known."""
ReadNeighbour = Callable[[str], dict[str, object]]
"""Reads the file that a file names, from the same folder."""


@dataclass
class Converted:
    """What a calibration file says, in Kalibr's words.

    Attributes:
        sections: Sections `cam0`, ..., `imu0`, ... of a Kalibr file.
        places: Path of a value in the file, by its path in these sections where the two differ.
        unused: Paths of keys that are not used.
        notes: Further remarks for the user.
    """

    sections: dict[str, object] = field(default_factory=dict)
    places: dict[str, str] = field(default_factory=dict)
    unused: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, name: str, section: Section, places: dict[str, str] | None = None) -> None:
        """Adds a section, and the paths of its keys in the file."""
        self.sections[name] = section
        self.places.update({f"{name}.{key}": path for key, path in (places or {}).items()})

    def merge(self, other: Converted) -> None:
        """Adds what another file says; of two sections with one name its own counts."""
        self.sections.update(other.sections)
        self.places.update(other.places)
        self.unused += [path for path in other.unused if path not in self.unused]
        self.notes += other.notes


def convert_calibration(document: dict[str, object], source: str, read: ReadNeighbour | None) -> Converted | None:
    """What a calibration of another tool says, in Kalibr's words; None if it is of no known tool.

    Args:
        document: Plain data of the file.
        source: Names the file in errors.
        read: Reads files beside it; None if there are none.

    Raises:
        ConfigError: A value is missing or invalid, or a file that it names cannot be read.
    """
    keys = Keys(document, FieldLocation(source=source))
    for is_of_tool, convert in (
        (_is_openvins, _convert_openvins),
        (_is_orb_slam, _convert_orb_slam),
        (_is_vins, _convert_vins),
        (_is_basalt, _convert_basalt),
        (_is_sensor_file, _convert_sensor_file),
    ):
        if is_of_tool(document):
            result = convert(keys, read)
            result.unused += keys.list_unused()
            return result
    return None


def _is_openvins(document: dict[str, object]) -> bool:
    """Whether it is OpenVINS' `estimator_config.yaml`, which names the files of the calibration."""
    return any(key in document for key in ("relative_config_imu", "relative_config_imucam"))


def _convert_openvins(keys: Keys, read: ReadNeighbour | None) -> Converted:
    """The sections of the two Kalibr files that the configuration names."""
    result = Converted()
    for key in ("relative_config_imu", "relative_config_imucam"):
        if key in keys:
            result.sections.update(_read_beside(keys, key, read)[1])
    return result


def _read_beside(keys: Keys, key: str, read: ReadNeighbour | None) -> tuple[str, dict[str, object]]:
    """The name of the file that a key names, and its plain data; it must be in the same folder.

    Raises:
        ConfigError: It is a file elsewhere, or no folder is known.
    """
    name = keys.take_text(key, "")
    if read is None or not re.fullmatch(r"[^/\\\0-\x1f]+", name) or name in (".", ".."):
        raise keys.place.key(key).error(name, "the name of a file in the same folder; copy it there")
    return name, read(name)


def _is_orb_slam(document: dict[str, object]) -> bool:
    """Whether it is a settings file of ORB-SLAM2 or ORB-SLAM3, with keys such as `Camera1.fx`."""
    return any(re.match(r"Camera\d?\.|IMU\.|Tbc$", key) for key in document)


def _convert_orb_slam(keys: Keys, read: ReadNeighbour | None) -> Converted:
    """Cameras, IMU and transforms of settings for ORB-SLAM3.

    `IMU.T_b_c1` and `Tbc` are poses of the first camera in the IMU's frame, `Stereo.T_c1_c2` and `Tlr` of the second
    one in that of the first; the noise is given as densities.
    """
    del read
    result = Converted()
    keys.drop("File.version")
    if "LEFT.K" in keys:
        valid = "settings of the images as they are: Camera.fx is that of rectified images; convert them to version 1.0"
        raise keys.place.key("LEFT.K").error(keys.take("LEFT.K"), valid)
    kind = keys.take_text("Camera.type", "PinHole")
    first = "Camera1" if "Camera1.fx" in keys else "Camera"
    prefixes = {"cam0": first} if f"{first}.fx" in keys else {}
    if "Camera2.fx" in keys:
        prefixes["cam1"] = "Camera2"
    has_size = prefixes and "Camera.width" in keys  # settings of a single camera may lack it
    size = keys.take_numbers(("Camera.width", "Camera.height")) if has_size else []
    for name, prefix in prefixes.items():
        camera = _take_orb_camera(keys, prefix, kind)
        if size:
            camera["resolution"] = [to_whole(value) for value in size]
        result.add(
            name, camera, {"intrinsics": f"{prefix}.fx, fy, cx, cy", "resolution": "Camera.width, Camera.height"}
        )
    for key in ("IMU.T_b_c1", "Tbc"):
        if "cam0" in prefixes and (rows := keys.take_transform(key)) is not None:
            _extend(result, "cam0", "T_imu_cam", rows, key)
    for key in ("Stereo.T_c1_c2", "Tlr"):
        if "cam1" in prefixes and (rows := keys.take_transform(key)) is not None:
            _extend(result, "cam1", "T_cnm1_cn", rows, key)
    noise = ("IMU.NoiseGyro", "IMU.GyroWalk", "IMU.NoiseAcc", "IMU.AccWalk")
    if any(key in keys for key in noise):
        imu: Section = dict(zip(NOISE, keys.take_numbers(noise), strict=True))
        if "IMU.Frequency" in keys:
            imu["update_rate"] = keys.take_number("IMU.Frequency")
        result.add("imu0", imu, dict(zip(NOISE, noise, strict=True)) | {"update_rate": "IMU.Frequency"})
    for key in ("RGBD.DepthMapFactor", "DepthMapFactor"):
        if key in keys:
            factor = keys.take_number(key)
            result.notes.append(f"{key}: the unit of depth is not part of a calibration; give --depth-scale {factor:g}")
    return result


def _take_orb_camera(keys: Keys, prefix: str, kind: str) -> Section:
    """The lens of one camera of ORB-SLAM3.

    Raises:
        ConfigError: A number is missing, or the type is none of ORB-SLAM3's.
    """
    section: Section = {
        "camera_model": "pinhole",
        "intrinsics": [keys.take_number(f"{prefix}.{key}") for key in ("fx", "fy", "cx", "cy")],
    }
    if kind == "KannalaBrandt8":
        coefficients = [keys.take_number(f"{prefix}.k{i}") for i in (1, 2, 3, 4)]
        return section | {"distortion_model": "equidistant", "distortion_coeffs": coefficients}
    if kind == "Rectified":
        return section | {"distortion_model": "none", "distortion_coeffs": []}
    if kind != "PinHole":
        raise keys.place.key("Camera.type").error(kind, "PinHole, KannalaBrandt8, Rectified")
    coefficients = [keys.take_number(f"{prefix}.{key}", 0.0) for key in ("k1", "k2", "p1", "p2", "k3")]
    return section | {"distortion_model": "radtan", "distortion_coeffs": coefficients}


def _is_vins(document: dict[str, object]) -> bool:
    """Whether it is a configuration of VINS-Fusion or VINS-Mono, or a camera file of camodocal."""
    names = r"(?:body|imu)_T_cam\d?|cam\d?_T_(?:body|imu)|cam\d_calib|extrinsicRotation|model_type$|image\d?_topic"
    return any(re.match(names, key) for key in document)


def _convert_vins(keys: Keys, read: ReadNeighbour | None) -> Converted:
    """Cameras, IMU and transforms of a configuration of VINS-Fusion, VINS-Mono or a camera file of camodocal.

    `body_T_camN`, and `extrinsicRotation` with `extrinsicTranslation`, are poses of a camera in the IMU's frame, and
    `td` is added to the stamps of images.
    """
    result = Converted()
    keys.drop("num_of_cam", "cam0_name", "camera_name")
    shift = keys.take_number("td", 0.0)
    rolls, readout_s = keys.take_number("rolling_shutter", 0.0) != 0, keys.take_number("rolling_shutter_tr", 0.0)
    topics = {"cam0": "image0_topic" if "image0_topic" in keys else "image_topic", "cam1": "image1_topic"}
    for i, (name, topic) in enumerate(topics.items()):
        camera = _take_vins_camera(keys, f"cam{i}_calib", read, result, is_first=i == 0)
        if camera is None:
            continue
        if topic in keys:
            camera["rostopic"] = keys.take_text(topic, "")
        camera |= {"timeshift_cam_imu": shift, "readout_s": readout_s if rolls else 0.0}
        result.add(name, camera, {"timeshift_cam_imu": "td", "readout_s": "rolling_shutter_tr"})
        _take_vins_pose(keys, i, result)
    _note_estimated(keys, result)
    keys.drop("image_width", "image_height")  # of the images of all cameras, which their files also have
    noise = ("gyr_n", "gyr_w", "acc_n", "acc_w")
    has_imu = keys.take("imu") != 0
    if has_imu and any(key in keys for key in noise):
        imu: Section = dict(zip(NOISE, keys.take_numbers(noise), strict=True))
        if "imu_topic" in keys:
            imu["rostopic"] = keys.take_text("imu_topic", "")
        result.add("imu0", imu, dict(zip(NOISE, noise, strict=True)))
    return result


def _take_vins_pose(keys: Keys, number: int, result: Converted) -> None:
    """Adds the transform between a camera and the IMU to the camera's section, if the configuration has it."""
    suffixes = (f"{number}", "") if number == 0 else (f"{number}",)
    for suffix in suffixes:
        for key, direction in (
            (f"body_T_cam{suffix}", "T_imu_cam"),
            (f"imu_T_cam{suffix}", "T_imu_cam"),
            (f"cam{suffix}_T_body", "T_cam_imu"),
            (f"cam{suffix}_T_imu", "T_cam_imu"),
        ):
            if (pose := keys.take_transform(key)) is not None:
                _extend(result, f"cam{number}", direction, pose, key)
    if number == 0 and "extrinsicRotation" in keys:
        pose = keys.take_transform("extrinsicRotation", translation="extrinsicTranslation")
        _extend(result, "cam0", "T_imu_cam", pose, "extrinsicRotation")


def _note_estimated(keys: Keys, result: Converted) -> None:
    """Says that a transform or a time shift is only where VINS begins; a transform that is not known is left out."""
    mode = keys.take_number("estimate_extrinsic", 0.0)
    if mode == _UNKNOWN_EXTRINSIC:
        result.notes.append(
            "estimate_extrinsic: 2 says that the transform to the IMU is not known: it is not used; give the one that "
            "VINS has written (extrinsic_parameter.csv)"
        )
        for section in result.sections.values():
            if isinstance(section, dict):
                section.pop("T_imu_cam", None)
                section.pop("T_cam_imu", None)
    elif mode:
        result.notes.append(
            "estimate_extrinsic: the transform to the IMU is the one from which VINS begins; it is used"
        )
    if keys.take_number("estimate_td", 0.0):
        result.notes.append("estimate_td: td is the shift of the clock from which VINS begins; it is used")


def _take_vins_camera(
    keys: Keys, calib: str, read: ReadNeighbour | None, result: Converted, *, is_first: bool
) -> Section | None:
    """A camera of VINS: from the file that the key `calib` names, or from the configuration itself.

    Args:
        keys: The configuration.
        calib: Key of the camera's file.
        read: Reads files beside it.
        result: Takes the unused keys of the camera's file.
        is_first: Whether the configuration itself may describe this camera.

    Returns:
        Its section; None if the configuration has no such camera.
    """
    if calib in keys:
        name, document = _read_beside(keys, calib, read)
        camera = Keys(document, FieldLocation(source=f"{keys.place.source}: {name}"))
        camera.drop("camera_name")
        section = _take_camodocal(camera)
        result.unused += [f"{name}: {path}" for path in camera.list_unused()]
        return section
    return _take_camodocal(keys) if is_first and "model_type" in keys else None


def _take_camodocal(keys: Keys) -> Section:
    """A camera in the words of camodocal: `model_type`, `projection_parameters` and `distortion_parameters`.

    Raises:
        ConfigError: A value is missing, or the model is Scaramuzza's, which has no counterpart.
    """
    kind = keys.take_text("model_type", "PINHOLE").upper()
    section: Section = {"resolution": [to_whole(v) for v in keys.take_numbers(("image_width", "image_height"))]}
    if kind not in ("PINHOLE", "PINHOLE_FULL", "KANNALA_BRANDT", "MEI"):
        valid = "PINHOLE, PINHOLE_FULL, KANNALA_BRANDT, MEI; calibrate with Kalibr instead"
        raise keys.place.key("model_type").error(kind, valid)
    projection = keys.take_keys("projection_parameters")
    if kind == "KANNALA_BRANDT":
        coefficients = projection.take_numbers(("k2", "k3", "k4", "k5"))
        pinhole = projection.take_numbers(("mu", "mv", "u0", "v0"))
        return section | make_lens("pinhole", pinhole, "equidistant", coefficients)
    names = ("k1", "k2", "p1", "p2") if kind != "PINHOLE_FULL" else ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    distortion = keys.take_keys("distortion_parameters").take_numbers(names)
    if kind == "MEI":
        xi = keys.take_keys("mirror_parameters").take_number("xi")
        intrinsics = projection.take_numbers(("gamma1", "gamma2", "u0", "v0"))
        return section | make_lens("omni", [xi, *intrinsics], "radtan", distortion)
    return section | make_lens("pinhole", projection.take_numbers(("fx", "fy", "cx", "cy")), "radtan", distortion)


def _is_basalt(document: dict[str, object]) -> bool:
    """Whether it is Basalt's JSON file, with or without its outer key `value0`."""
    inner = document.get("value0", document)
    lenses = inner.get("intrinsics") if isinstance(inner, dict) else None
    return isinstance(lenses, list) and any(isinstance(lens, dict) for lens in lenses)


_BASALT_LENSES: dict[str, tuple[str, tuple[str, ...], str, tuple[str, ...]]] = {
    "pinhole": ("pinhole", (), "none", ()),
    "pinhole-radtan8": ("pinhole", (), "radtan", ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "kb4": ("pinhole", (), "equidistant", ("k1", "k2", "k3", "k4")),
    "ds": ("ds", ("xi", "alpha"), "none", ()),
    "eucm": ("eucm", ("alpha", "beta"), "none", ()),
    "ucm": ("eucm", ("alpha",), "none", ()),
    "fov": ("pinhole", (), "fov", ("w",)),
}
"""Kalibr's model, its parameters, its distortion and the coefficients of that, by Basalt's name of a camera."""


def _convert_basalt(keys: Keys, read: ReadNeighbour | None) -> Converted:
    """Cameras, IMU and transforms of Basalt's JSON file.

    `T_imu_cam` are poses of cameras in the IMU's frame, `cam_time_offset_ns` is added to the stamps of images, and the
    noise is given as continuous densities, of which the largest axis counts.
    """
    del read
    result = Converted()
    inner = keys.take_keys("value0") if "value0" in keys else keys
    poses = inner.take("T_imu_cam")
    sizes = inner.take("resolution")
    shift = inner.take_number("cam_time_offset_ns", 0.0) * 1e-9
    for i, camera in enumerate(inner.take_items("intrinsics")):
        section = _take_basalt_lens(camera)
        if not isinstance(sizes, list) or i >= len(sizes):
            raise inner.place.key("resolution").error(sizes, "a width and a height for each camera")
        section |= {"resolution": sizes[i], "timeshift_cam_imu": shift}
        places = {
            "resolution": f"resolution[{i}]",
            "intrinsics": f"intrinsics[{i}]",
            "timeshift_cam_imu": "cam_time_offset_ns",
        }
        result.add(f"cam{i}", section, {key: inner.place.key(path).path for key, path in places.items()})
        if isinstance(poses, list) and i < len(poses):
            _extend(result, f"cam{i}", "T_imu_cam", poses[i], inner.place.key(f"T_imu_cam[{i}]").path)
    noise = ("gyro_noise_std", "gyro_bias_std", "accel_noise_std", "accel_bias_std")
    if any(key in inner for key in noise):
        imu: Section = {ours: max(map(abs, inner.take_list(key))) for ours, key in zip(NOISE, noise, strict=True)}
        if "imu_update_rate" in inner:
            imu["update_rate"] = inner.take_number("imu_update_rate")
        places = dict(zip(NOISE, noise, strict=True)) | {"update_rate": "imu_update_rate"}
        result.add("imu0", imu, {key: inner.place.key(path).path for key, path in places.items()})
    for key in inner:
        if (value := inner.take(key)) is not None and not has_no_effect(value):
            result.unused.append(inner.place.key(key).path)
    return result


def _take_basalt_lens(camera: Keys) -> Section:
    """A camera of Basalt: `camera_type`, and its parameters under `intrinsics`.

    Raises:
        ConfigError: The type is unknown, or a parameter is missing.
    """
    kind = camera.take_text("camera_type", "")
    if kind not in _BASALT_LENSES:
        raise camera.place.key("camera_type").error(kind, ", ".join(_BASALT_LENSES))
    model, parameters, distortion, coefficients = _BASALT_LENSES[kind]
    values = camera.take_keys("intrinsics")
    terms = values.take_numbers(parameters) + ([1.0] if kind == "ucm" else [])  # ucm is eucm with beta 1
    lens = make_lens(
        model, [*terms, *values.take_numbers(("fx", "fy", "cx", "cy"))], distortion, values.take_numbers(coefficients)
    )
    values.drop("rpmax")  # how far from the centre the model holds
    return lens


def _is_sensor_file(document: dict[str, object]) -> bool:
    """Whether it is a single `sensor.yaml` of the EuRoC layout."""
    return "sensor_type" in document or ("T_BS" in document and "rate_hz" in document)


def _convert_sensor_file(keys: Keys, read: ReadNeighbour | None) -> Converted:
    """The camera or IMU of a `sensor.yaml`, whose `T_BS` is its pose in the body's frame, that of the IMU in EuRoC."""
    del read
    result = Converted()
    keys.drop("sensor_type", "comment")
    if "intrinsics" not in keys:
        imu: Section = dict(zip(NOISE, keys.take_numbers(NOISE), strict=True))
        result.add("imu0", imu | {"update_rate": keys.take_number("rate_hz")}, {"update_rate": "rate_hz"})
        pose = keys.take("T_BS")
        if not has_no_effect(_read_rows(pose)):
            result.unused.append("T_BS")
        return result
    coefficients = keys.take_list("distortion_coefficients") if "distortion_coefficients" in keys else []
    model = keys.take_text("distortion_model", "radtan" if coefficients else "none")
    lens = make_lens(keys.take_text("camera_model", "pinhole"), keys.take_list("intrinsics"), model, coefficients)
    result.add("cam0", lens | {"resolution": [to_whole(value) for value in keys.take_list("resolution")]})
    if (pose := keys.take_transform("T_BS")) is not None:
        _extend(result, "cam0", "T_imu_cam", pose, "T_BS")
    keys.drop("rate_hz")  # stamps give the rate of a camera
    return result


def _read_rows(pose: object) -> object:
    """The rows of a matrix, also of OpenCV's, for `has_no_effect`."""
    keys = Keys({"pose": pose}, FieldLocation(source=""))
    return keys.take_transform("pose")


def make_lens(model: str, intrinsics: list[float], distortion: str, coefficients: list[float]) -> Section:
    """The keys of a lens in a camera's section."""
    return {
        "camera_model": model,
        "intrinsics": intrinsics,
        "distortion_model": distortion,
        "distortion_coeffs": coefficients,
    }


def to_whole(value: float) -> object:
    """A number of pixels as an int; one that is not whole is kept for the validation to refuse."""
    return int(value) if value == int(value) else value


def _extend(result: Converted, name: str, key: str, value: object, path: str) -> None:
    """Adds a key to a section that exists, with its path in the file."""
    section = result.sections[name]
    if isinstance(section, dict):
        section[key] = value
    result.places[f"{name}.{key}"] = path
