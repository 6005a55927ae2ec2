"""Nominal calibration that estimators get: camera calibrations with small errors, and figures from data sheets.

Calibration errors are drawn once per walk, from the seed and the camera's topic alone. A rig file has no field for the
scale of a depth camera, so the scale error is applied to the measured depth itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.kinds import ActuatorPart, AhrsPart, EncoderPart, ForceCellPart, SonarPart
from stridetwin.streams.fields import DEGREES, MILLIMETRES, MILLISECONDS, PERCENT, Number
from stridetwin.streams.rig import CameraCalibration, Rig

Parameters = dict[str, Any]
_TYPICAL_LOAD_N = 100.0  # of a cell under a foot
_BITS_WITHOUT_COUNTING = 32  # of an ideal encoder, whose file has 0
# errors that `_miscalibrate` draws
_DRAWN = ("rotation", "position", "intrinsics", "offset", "readout")


@dataclass(frozen=True, kw_only=True)
class CalibrationSd:
    """Standard deviations of calibration errors; all 0 for a perfect calibration.

    A field with an alias has the alias's unit in files (degrees, mm, %, ms), and so have its limits; its value here is
    in SI units, radians or fractions.

    Attributes:
        rotation_rad: Of the mount, about each axis of the camera.
        position_m: Of the mount, along each axis.
        intrinsics: Of focal lengths and principal point, as a fraction of each.
        offset_s: Of the time shift to the IMU.
        depth_scale: Of measured depth, as a fraction of it.
        readout: Of the readout time of a rolling shutter, as a fraction of it.
    """

    rotation_rad: Annotated[Number, Field(ge=0, le=5, alias="rotation_deg"), DEGREES] = 0.0
    position_m: Annotated[Number, Field(ge=0, le=50, alias="position_mm"), MILLIMETRES] = 0.0
    intrinsics: Annotated[Number, Field(ge=0, le=5, alias="intrinsics_pct"), PERCENT] = 0.0
    offset_s: Annotated[Number, Field(ge=0, le=100, alias="offset_ms"), MILLISECONDS] = 0.0
    depth_scale: Annotated[Number, Field(ge=0, le=5, alias="depth_scale_pct"), PERCENT] = 0.0
    readout: Annotated[Number, Field(ge=0, le=20, alias="readout_pct"), PERCENT] = 0.0


def nominal_rig(rig: Rig, sd: Iterable[tuple[str, CalibrationSd]], seed: int) -> Rig:
    """Nominal rig: the calibration that estimators get.

    Args:
        rig: True rig.
        sd: Topics of the cameras, and the accuracy of each calibration.
        seed: Of the walk.
    """
    # calibrations with errors, of the cameras that have any
    miscalibrated = {
        topic: _miscalibrate(rig.cameras[topic], sd_of_camera, seed)
        for topic, sd_of_camera in sd
        if sd_of_camera != CalibrationSd()
    }
    return replace(rig, cameras={**rig.cameras, **miscalibrated}) if miscalibrated else rig


def depth_scale(topic: str, sd: CalibrationSd, seed: int) -> float:
    """Ratio of measured depth to true depth of a camera in the walk of a seed, without noise.

    Args:
        topic: Topic of the camera.
        sd: Accuracy of its calibration.
        seed: Seed of the walk.
    """
    return 1.0 + float(_noise(topic, "depth", seed).normal(sd.depth_scale, 1)[0])


def _miscalibrate(camera: CameraCalibration, sd: CalibrationSd, seed: int) -> CameraCalibration:
    """Calibration of a camera with random errors of mount, intrinsics, time shift and readout time.

    Each error has its own child stream of the camera's topic, so that one does not change the others.
    """
    from scipy.spatial.transform import Rotation  # imported late, so that a scenario is read without it

    draw = {name: _noise(camera.topic, name, seed) for name in _DRAWN}
    error = np.eye(4)  # from the true to the nominal mount, in the camera's axes
    error[:3, :3] = Rotation.from_rotvec(draw["rotation"].normal(sd.rotation_rad, 3)).as_matrix()
    error[:3, 3] = draw["position"].normal(sd.position_m, 3)
    fu, fv, pu, pv = (np.array(camera.intrinsics) * (1.0 + draw["intrinsics"].normal(sd.intrinsics, 4))).tolist()
    return replace(
        camera,
        mount=replace(camera.mount, T_body_sensor=camera.mount.T_body_sensor @ error),
        intrinsics=(fu, fv, pu, pv),
        timeshift_cam_imu_s=camera.timeshift_cam_imu_s + float(draw["offset"].normal(sd.offset_s, 1)[0]),
        readout_s=camera.readout_s * (1.0 + float(draw["readout"].normal(sd.readout, 1)[0])),
    )


def _noise(topic: str, what: str, seed: int) -> Noise:
    """Random numbers for one quantity `what` of the calibration of the camera on a topic, in the walk of a seed."""
    return Noise.of_topic(seed, f"{topic}#calibration of {what}")


def _sonar_parameters(part: SonarPart) -> Parameters:
    """Parameters of a sonar: its range and the SD of a reading, with the rounding to steps.

    A uniform error of one step has the SD step / √12.
    """
    return {
        "beam_rad": part.beam,
        "range_min_m": part.range_min,
        "range_max_m": part.range_max,
        "range_step_m": part.step,
        "range_sd_m": math.hypot(part.noise, part.step / math.sqrt(12)),
    }


def _ahrs_parameters(part: AhrsPart) -> Parameters:
    """Parameters of an AHRS: SDs of tilt, heading and rates, and the largest drift of the heading.

    The SD of the bias of a rate combines its constant and its varying part.
    """
    return {
        "tilt_sd_rad": part.tilt_moving,
        "tilt_bias_sd_rad": part.tilt_bias,
        "heading_bias_sd_rad": part.heading_bias,
        "heading_drift_radps": part.heading_drift,
        "rate_sd_radps": part.rate_noise,
        "rate_bias_sd_radps": math.hypot(part.rate_bias, part.rate_instability),
    }


def _encoder_parameters(part: EncoderPart) -> Parameters:
    """Parameters of an encoder: counts per turn, and the SD of its angle.

    The nonlinearity is the amplitude of a sine, whose SD is the amplitude / √2.
    """
    return {
        "counts": 2.0 ** (part.bits or _BITS_WITHOUT_COUNTING),
        "angle_sd_rad": math.hypot(part.nonlinearity / math.sqrt(2), part.index_offset),
    }


def _insole_parameters(part: ForceCellPart) -> Parameters:
    """Parameters of a force cell under a foot: the SD at a typical load, its range, and the cut-off of its filter."""
    return {
        "force_sd_n": math.hypot(part.noise, part.gain * _TYPICAL_LOAD_N),
        "force_max_n": part.range,
        "filter_hz": part.filter_hz,
    }


def _interaction_parameters(part: ForceCellPart) -> Parameters:
    """Parameters of a force-cell pair in a cuff: those of its cells, and their preload."""
    return _insole_parameters(part) | {"preload_n": part.preload}


def _actuator_parameters(part: ActuatorPart) -> Parameters:
    """Parameters of an actuation module: SDs of torque and speed."""
    return {"torque_sd_nm": part.torque_noise, "speed_sd_radps": part.speed_noise}


NOMINAL: dict[str, Callable[[Any], Parameters]] = {
    "range": _sonar_parameters,
    "ahrs": _ahrs_parameters,
    "encoder": _encoder_parameters,
    "insole": _insole_parameters,
    "interaction": _interaction_parameters,
    "actuator": _actuator_parameters,
}
"""Parameters of a sensor without a Kalibr section, from the figures of its part, by kind of `rig.OtherSensor`."""
