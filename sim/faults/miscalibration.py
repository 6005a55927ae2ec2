"""Errors of the nominal calibration that a recording holds and estimators read; the sensors themselves are right."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field

from stridetwin.sim.faults.faults import Calibration, Fault, Stream
from stridetwin.sim.faults.sample_faults import ForceRange, RateRange
from stridetwin.streams.fields import DEG, MM, number
from stridetwin.streams.rig import CameraCalibration, ImuCalibration
from stridetwin.streams.samples import Ahrs, Encoder, Image, Imu, Insole, Range

_Angle = Annotated[float, number(-180, 180, scale=DEG)]
_Length = Annotated[float, number(-1000, 1000, scale=MM)]


@dataclass(frozen=True, kw_only=True)
class Miscalibration(Fault):
    """An error of the nominal calibration of some sensors, for the whole walk.

    Attributes:
        rotation_rad: Rotation vector from the true to the nominal mount, in the sensor's frame.
        translation_m: Translation from the true to the nominal mount, in the sensor's frame.
        clock_offset_s: Error of the time that the calibration adds to a camera's stamps (`timeshift_cam_imu`).
        gyroscope_rad_s: Range of an IMU's gyroscopes, other than the part's.
        accelerometer_mps2: Range of an IMU's accelerometers, other than the part's.
        thigh_m: Error of the exoskeleton's link above the knee with this encoder; the geometry is not in the rig, so
            `scenarios.exo_geometry` adds it.
        shank_m: Error of the link below that knee.
    """

    on_samples = False
    fits = (Imu, Image, Range, Insole, Ahrs, Encoder)
    rotation_rad: Annotated[tuple[_Angle, _Angle, _Angle], Field(alias="rotation_deg")] = (0.0, 0.0, 0.0)
    translation_m: Annotated[tuple[_Length, _Length, _Length], Field(alias="translation_mm")] = (0.0, 0.0, 0.0)
    clock_offset_s: Annotated[float, number(-1, 1)] = 0.0
    gyroscope_rad_s: RateRange = None
    accelerometer_mps2: ForceRange = None
    thigh_m: Annotated[float, number(-200, 200, key="thigh_mm", scale=MM)] = 0.0
    shank_m: Annotated[float, number(-200, 200, key="shank_mm", scale=MM)] = 0.0

    def suits(self, stream: Stream) -> bool:
        """Whether a sensor has all that is off."""
        is_off = {
            Image: self.clock_offset_s,
            Imu: self.gyroscope_rad_s or self.accelerometer_mps2,
            Encoder: self.thigh_m or self.shank_m,
        }
        return stream.kind in self.fits and all(stream.kind is kind for kind, error in is_off.items() if error)

    def calibrate(self, sensor: Calibration) -> Calibration:
        """The calibration with the error."""
        from scipy.spatial.transform import Rotation  # slow to import, seldom used

        T = np.eye(4)
        T[:3, :3], T[:3, 3] = Rotation.from_rotvec(self.rotation_rad).as_matrix(), self.translation_m
        nominal = replace(sensor, mount=replace(sensor.mount, T_body_sensor=sensor.mount.T_body_sensor @ T))
        if isinstance(nominal, CameraCalibration):
            return replace(nominal, timeshift_cam_imu_s=nominal.timeshift_cam_imu_s + self.clock_offset_s)
        if isinstance(nominal, ImuCalibration):
            gyroscope_rad_s = self.gyroscope_rad_s or nominal.gyroscope_range
            accelerometer_mps2 = self.accelerometer_mps2 or nominal.accelerometer_range
            return replace(nominal, gyroscope_range=gyroscope_rad_s, accelerometer_range=accelerometer_mps2)
        return nominal
