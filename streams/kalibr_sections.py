"""The sections of a Kalibr file and of our own section in it, as pydantic models."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, StrictInt, create_model

from stridetwin.streams.fields import Count, FileModel, NotNegative, Number, Positive, Text, field_error
from stridetwin.streams.lenses import DISTORTIONS
from stridetwin.streams.matrix_fields import RigidTransform, to_matrix_rows

OURS = "stridetwin"
"""Key of the section with what Kalibr has no keys for."""
_LARGEST = 1e300
"""Largest magnitude of a sensor's parameter: greater ones are mistakes, or too large for a float."""
_Squares = Annotated[StrictInt, Field(ge=2, le=2**31 - 1)]
BEYOND_NOISE = (
    "gyroscope_bias_sd",
    "accelerometer_bias_sd",
    "gyroscope_range",
    "accelerometer_range",
    "gyroscope_scale_sd",
    "gyroscope_misalignment_sd",
    "accelerometer_scale_sd",
)
"""Attributes of an IMU's calibration that Kalibr has no keys for: biases, ranges and errors of scale and axes."""


class KalibrSection(BaseModel):
    """A section of Kalibr's; other keys have been named before."""

    model_config = ConfigDict(frozen=True)


_POSE = "the keys px, py, pz, qx, qy, qz, qw, which say what each number is"
"""How to write a position with a quaternion."""


def _to_transform_rows(node: object) -> object:
    """The four rows of a transform, as `to_matrix_rows` reads it.

    Raises:
        PydanticCustomError: It is a rotation alone, or has numbers that may be angles or a quaternion of unknown order.
    """
    if isinstance(node, list) and len(node) in (6, 7) and not any(isinstance(item, (list, dict)) for item in node):
        raise field_error(node, f"rows of a matrix, or {_POSE}")
    if isinstance(node, list) and len(node) == 3 and all(isinstance(row, list) and len(row) == 3 for row in node):
        raise field_error(node, "a translation as well: four rows of four numbers")
    rows = to_matrix_rows(node)
    if isinstance(rows, dict):
        raise field_error(node, f"four rows of four numbers, or {_POSE}")
    return rows


_Transform = Annotated[RigidTransform, BeforeValidator(_to_transform_rows)]
"""A transform in any of the forms of other tools."""
_Distortion = Annotated[
    Literal["radtan", "equidistant", "fov", "none"],
    BeforeValidator(lambda node: DISTORTIONS.get(node.lower(), node) if isinstance(node, str) else node or "none"),
]
"""Kalibr's name of a distortion model; those of other tools are translated, and null is none."""


class CameraSection(KalibrSection):
    """A camera section of Kalibr's camera chain."""

    camera_model: Literal["pinhole", "omni", "eucm", "ds"]
    intrinsics: tuple[Positive, Positive, Number, Number]
    distortion_model: _Distortion
    distortion_coeffs: list[Number] = Field(default_factory=list)
    resolution: tuple[Count, Count]
    rostopic: Text | None = None
    timeshift_cam_imu: Number = 0.0
    readout_s: NotNegative = 0.0
    line_delay: NotNegative = 0.0
    T_cam_imu: _Transform | None = None
    T_imu_cam: _Transform | None = None
    T_cn_cnm1: _Transform | None = None
    T_cnm1_cn: _Transform | None = None


class _OmniCamera(CameraSection):
    """A camera of the model `omni`: xi, then the focal lengths and the centre."""

    intrinsics: tuple[NotNegative, Positive, Positive, Number, Number]  # type: ignore[assignment]


_Share = Annotated[Number, Field(ge=0, le=1)]


class _EucmCamera(CameraSection):
    """A camera of the model `eucm`: alpha, beta, then the focal lengths and the centre."""

    intrinsics: tuple[_Share, Positive, Positive, Positive, Number, Number]  # type: ignore[assignment]


class _DsCamera(CameraSection):
    """A camera of the model `ds`: xi, alpha, then the focal lengths and the centre."""

    intrinsics: tuple[  # type: ignore[assignment]
        Annotated[Number, Field(gt=-1, lt=10)], _Share, Positive, Positive, Number, Number
    ]


TRANSFORMS = ("T_cam_imu", "T_imu_cam", "T_cn_cnm1", "T_cnm1_cn")
"""Keys of a camera's section that are transforms."""
_CAMERAS = {"omni": _OmniCamera, "eucm": _EucmCamera, "ds": _DsCamera}
"""The model of a camera's section by `camera_model`; all others are `CameraSection`."""


class ImuNoise(KalibrSection):
    """Noise densities of an IMU, the keys of Kalibr and of EuRoC."""

    gyroscope_noise_density: NotNegative
    gyroscope_random_walk: NotNegative
    accelerometer_noise_density: NotNegative
    accelerometer_random_walk: NotNegative


class ImuSection(ImuNoise):
    """An IMU section of Kalibr's file; other tools do not give the rate."""

    rostopic: Text | None = None
    update_rate: Positive | None = None
    T_i_b: _Transform | None = None


class _RatedImuSection(ImuSection):
    """An IMU section of a file with our own section, which has the rate."""

    update_rate: Positive


class _CameraMount(FileModel):
    """The body that carries a camera, and the camera's pose on it, unless Kalibr's `T_cam_imu` gives it."""

    body: str
    T_body_sensor: RigidTransform | None = None


class _Mount(_CameraMount):
    """The body that carries a sensor or board, and the pose on it."""

    T_body_sensor: RigidTransform


class CameraExtras(FileModel):
    """What a rig knows of a camera beyond Kalibr's section."""

    part: str = ""
    rate_hz: NotNegative
    mount: _CameraMount
    depth_topic: str = ""
    imu_topic: str = ""
    readout_s: NotNegative = 0.0


_bounds_and_scales: dict[str, Any] = {name: (NotNegative, 0.0) for name in BEYOND_NOISE}
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
def make_document_model(
    cameras: tuple[tuple[str, str], ...], imus: tuple[str, ...], has_extras: bool
) -> type[BaseModel]:
    """The pydantic model of a file with these sections, each a field of its name.

    Args:
        cameras: Names of the sections of cameras, `cam0`, ..., each with its `camera_model`.
        imus: Names of the sections of IMUs, `imu0`, ...
        has_extras: Whether the file has our own section, which then must have a part for each of these.
    """
    # pydantic takes a pair for each field: its type and its default, where `...` means required
    sections: dict[str, Any] = {name: (_CAMERAS.get(kind, CameraSection), ...) for name, kind in cameras}
    sections |= {name: (_RatedImuSection if has_extras else ImuSection, ...) for name in imus}
    if has_extras:
        extras: dict[str, Any] = {name: (CameraExtras, ...) for name, _ in cameras} | {
            name: (_ImuExtras, ...) for name in imus
        }
        extras |= {"boards": (dict[str, _Board], {}), "sensors": (list[_Sensor], [])}
        sections[OURS] = (create_model(OURS, __base__=FileModel, **extras), ...)
    return create_model("Calibration", __base__=KalibrSection, **sections)
