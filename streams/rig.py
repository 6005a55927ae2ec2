"""The rig: the wearer's sensors, their mounts and their nominal calibration.

A `Rig` contains everything that an estimator may know about the hardware: mounts, intrinsics, noise densities and
rates. It is read and written as one Kalibr-style YAML file (`streams.kalibr`). The nominal calibration may differ from
the true one of the twin.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from stridetwin.streams.errors import StrideTwinError, check_type
from stridetwin.streams.samples import (
    Actuator,
    Ahrs,
    Array,
    Depth,
    Encoder,
    Image,
    Imu,
    Insole,
    Interaction,
    Range,
    Sample,
)

_KINDS: Mapping[str, type[Sample]] = {
    "range": Range,
    "insole": Insole,
    "ahrs": Ahrs,
    "encoder": Encoder,
    "interaction": Interaction,
    "actuator": Actuator,
}
"""Kind of sample by `OtherSensor.kind`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Mount:
    """Pose of a sensor or board on a body.

    Attributes:
        body: Name of the body that carries it: pelvis, torso, head, thigh_l, shank_l, foot_l, exo_back, ...
        T_body_sensor: (4, 4) rigid transform, sensor frame to body frame, m. The foot frame has its origin on the
            sole under the heel's centre, x forward, y left, z up; a camera's frame is optical (x right, y down,
            z forward).
    """

    body: str
    T_body_sensor: Array = field(default_factory=lambda: np.eye(4))


@dataclass(frozen=True, kw_only=True, eq=False)
class ImuCalibration:
    """Inertial sensor: noise as continuous-time densities (Kalibr's convention).

    Attributes:
        topic: Topic of its samples.
        part: Name of the part.
        rate_hz: Sample rate.
        mount: Pose on the body.
        gyroscope_noise_density: rad/s/√Hz.
        gyroscope_random_walk: rad/s²/√Hz.
        accelerometer_noise_density: m/s²/√Hz.
        accelerometer_random_walk: m/s³/√Hz.
        gyroscope_bias_sd: Turn-on bias, rad/s.
        accelerometer_bias_sd: Turn-on bias, m/s².
        gyroscope_range: Largest measurable rate, rad/s; 0 = unknown.
        accelerometer_range: Largest measurable specific force, m/s²; 0 = unknown.
        gyroscope_scale_sd: Relative error of the scale factors after calibration; 0 = unknown.
        gyroscope_misalignment_sd: Of each axis towards the others after calibration, rad; 0 = unknown.
        accelerometer_scale_sd: Relative error of the scale factors after calibration; 0 = unknown.
    """

    topic: str
    part: str
    rate_hz: float
    mount: Mount
    gyroscope_noise_density: float
    gyroscope_random_walk: float
    accelerometer_noise_density: float
    accelerometer_random_walk: float
    gyroscope_bias_sd: float = 0.0
    accelerometer_bias_sd: float = 0.0
    gyroscope_range: float = 0.0
    accelerometer_range: float = 0.0
    gyroscope_scale_sd: float = 0.0
    gyroscope_misalignment_sd: float = 0.0
    accelerometer_scale_sd: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraCalibration:
    """Camera, pinhole with distortion.

    Attributes:
        topic: Topic of its images.
        part: Name of the part.
        rate_hz: Frame rate.
        mount: Pose on the body (optical frame).
        width: Pixels.
        height: Pixels.
        intrinsics: (fu, fv, pu, pv) in pixels; the centre of the top-left pixel is (0, 0), as in OpenCV.
        distortion_model: `radtan` (k1, k2, p1, p2) or `equidistant`.
        distortion: (4,) coefficients.
        depth_topic: Topic of the depth images registered to it, or "".
        imu_topic: Topic of the IMU that Kalibr's `T_cam_imu` refers to, or "".
        timeshift_cam_imu_s: t_imu = t_cam + shift.
        readout_s: Of a rolling shutter, from the first row to the last; the middle one has the image's time. 0: global.
    """

    topic: str
    part: str
    rate_hz: float
    mount: Mount
    width: int
    height: int
    intrinsics: tuple[float, float, float, float]
    distortion_model: str = "radtan"
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    depth_topic: str = ""
    imu_topic: str = ""
    timeshift_cam_imu_s: float = 0.0
    readout_s: float = 0.0

    @property
    def K(self) -> Array:
        """(3, 3) camera matrix."""
        fu, fv, pu, pv = self.intrinsics
        return np.array([[fu, 0.0, pu], [0.0, fv, pv], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, kw_only=True, eq=False)
class Board:
    """Checkerboard that a camera observes: its square at the least x and y is dark, with a white margin around it.

    Attributes:
        name: Such as `foot_l`.
        mount: Pose of the board frame: origin at the board's centre, x along the columns, y along the rows,
            z out of the printed face.
        squares: (columns, rows) of squares.
        square_m: Edge of a square.
    """

    name: str
    mount: Mount
    squares: tuple[int, int]
    square_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class OtherSensor:
    """A sensor without a Kalibr section: sonar, insole, AHRS, encoder, interaction cells, actuator.

    Attributes:
        topic: Topic of its samples.
        kind: range, insole, ahrs, encoder, interaction or actuator.
        part: Name of the part.
        rate_hz: Sample rate.
        mount: Pose on the body.
        parameters: Other nominal parameters (noise, cell positions, resolution), numbers or lists of numbers.
    """

    topic: str
    kind: str
    part: str
    rate_hz: float
    mount: Mount
    parameters: Mapping[str, float | list[float] | list[list[float]]] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rig:
    """Every sensor of one wearer, keyed by topic (boards by name)."""

    imus: Mapping[str, ImuCalibration] = field(default_factory=dict)
    cameras: Mapping[str, CameraCalibration] = field(default_factory=dict)
    boards: Mapping[str, Board] = field(default_factory=dict)
    others: Mapping[str, OtherSensor] = field(default_factory=dict)

    @property
    def topics(self) -> set[str]:
        """Topics of all sensors, the depth images of cameras among them."""
        depth = {camera.depth_topic for camera in self.cameras.values()} - {""}
        return {*self.imus, *self.cameras, *self.others} | depth

    @classmethod
    def check(cls, rig: object, owner: str) -> None:
        """Refuses an argument that is no rig, such as a recording; an estimator calls it first in its constructor.

        Args:
            rig: The argument.
            owner: Name of the estimator.

        Raises:
            ConfigError: It is of another type.
        """
        check_type(owner, "rig", rig, cls, "a Rig, such as the rig of a Recording (recording.rig)")

    def imu(self, topic: str) -> ImuCalibration:
        """Calibration of one IMU.

        Raises:
            StrideTwinError: The rig has no such IMU; the message lists the existing ones.
        """
        if topic not in self.imus:
            raise StrideTwinError(f"the rig has no IMU {topic!r}; it has {', '.join(sorted(self.imus)) or 'none'}")
        return self.imus[topic]


def kinds_of_streams(rig: Rig) -> dict[str, type[Sample]]:
    """The kind of sample of every stream that a rig describes, by topic; a camera may have two, with its depth."""
    cameras = rig.cameras.values()
    return {
        **dict.fromkeys(rig.imus, Imu),
        **{camera.topic: Image for camera in cameras},
        **{camera.depth_topic: Depth for camera in cameras if camera.depth_topic},
        **{sensor.topic: _KINDS[sensor.kind] for sensor in rig.others.values() if sensor.kind in _KINDS},
    }
