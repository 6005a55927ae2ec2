"""Errors of the nominal calibration that a recording holds and estimators read; the sensors themselves are right."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from stridetwin.sim.faults.faults import Fault, affected
from stridetwin.sim.faults.sample_faults import ForceRange, RateRange
from stridetwin.streams.fields import DEG, MM, number
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, OtherSensor, Rig
from stridetwin.streams.samples import Ahrs, Encoder, Image, Imu, Insole, Range

Calibration = ImuCalibration | CameraCalibration | OtherSensor
_Angle = Annotated[float, number(-180, 180, scale=DEG)]
_Length = Annotated[float, number(-1000, 1000, scale=MM)]


class CalibrationFault(Fault):
    """An error of the nominal calibration of some sensors, for the whole walk."""

    def calibration(self, true: Calibration) -> Calibration:
        """The calibration of one sensor with the error."""
        return true


def nominal_rig(rig: Rig, faults: Iterable[Fault]) -> Rig:
    """A rig with the errors that faults of the calibration add to it."""
    for fault in faults:
        if isinstance(fault, CalibrationFault):
            topics = {stream.topic for stream in affected(fault, rig)}
            sensors = {
                group: {t: fault.calibration(c) if t in topics else c for t, c in getattr(rig, group).items()}
                for group in ("imus", "cameras", "others")
            }
            rig = replace(rig, **sensors)
    return rig


@dataclass(frozen=True, kw_only=True)
class NominalMount(CalibrationFault):
    """A mount that is off in the calibration.

    Attributes:
        rotation_rad: Rotation vector from the true to the nominal mount, in the sensor's frame.
        translation_m: Translation of the nominal mount, in the sensor's frame.
    """

    kind = "nominal_mount"
    fits = (Imu, Image, Range, Insole, Ahrs)
    rotation_rad: Annotated[tuple[_Angle, _Angle, _Angle], Field(alias="rotation_deg")] = (0.0, 0.0, 0.0)
    translation_m: Annotated[tuple[_Length, _Length, _Length], Field(alias="translation_mm")] = (0.0, 0.0, 0.0)

    def calibration(self, true: Calibration) -> Calibration:
        """The calibration with the other mount."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = Rotation.from_rotvec(self.rotation_rad).as_matrix(), self.translation_m
        return replace(true, mount=replace(true.mount, T_body_sensor=true.mount.T_body_sensor @ T))


@dataclass(frozen=True, kw_only=True)
class NominalClock(CalibrationFault):
    """The clock of a camera that is off in the calibration.

    Attributes:
        offset_s: Error of the time that the calibration adds to the camera's stamps (`timeshift_cam_imu`).
    """

    kind = "nominal_clock"
    fits = (Image,)
    offset_s: Annotated[float, number(-1, 1)]

    def calibration(self, true: Calibration) -> Calibration:
        """The calibration with the other time offset."""
        assert isinstance(true, CameraCalibration)
        return replace(true, timeshift_cam_imu_s=true.timeshift_cam_imu_s + self.offset_s)


@dataclass(frozen=True, kw_only=True)
class NominalRange(CalibrationFault):
    """Ranges of an IMU in the calibration other than its part's; beside `Saturation`, the ranges that it has.

    Attributes:
        gyroscope_rad_s: Range of the gyroscopes; None leaves it.
        accelerometer_mps2: Range of the accelerometers; None leaves it.
    """

    kind = "nominal_range"
    fits = (Imu,)
    gyroscope_rad_s: RateRange = None
    accelerometer_mps2: ForceRange = None

    def calibration(self, true: Calibration) -> Calibration:
        """The calibration with the other ranges."""
        assert isinstance(true, ImuCalibration)
        return replace(
            true,
            gyroscope_range=self.gyroscope_rad_s or true.gyroscope_range,
            accelerometer_range=self.accelerometer_mps2 or true.accelerometer_range,
        )


@dataclass(frozen=True, kw_only=True)
class NominalLinks(CalibrationFault):
    """Links of the exoskeleton that are off in its nominal geometry: those beside a knee, by the topic of its encoder.

    The geometry is no part of a rig: `scenarios.exo_geometry.nominal_geometry` applies the error.

    Attributes:
        thigh_m: Error of the link from hip to knee.
        shank_m: Error of the link from knee to ankle.
    """

    kind = "nominal_links"
    fits = (Encoder,)
    thigh_m: Annotated[float, number(-200, 200, key="thigh_mm", scale=MM)] = 0.0
    shank_m: Annotated[float, number(-200, 200, key="shank_mm", scale=MM)] = 0.0
