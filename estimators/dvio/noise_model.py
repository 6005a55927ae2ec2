"""Noise models by the user's parameters: of the IMU, of the factors, and of the calibration before any measurement."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stridetwin.estimators.dvio.parameters import ALL, NOMINAL, DvioParameters
from stridetwin.estimators.dvio.state import FactorParameters, ImuNoise
from stridetwin.streams.rig import ImuCalibration
from stridetwin.streams.samples import Array

# Least noise of a data sheet, where it states none: densities of white noise, then of the biases' random walk.
_MIN_RATE_NOISE, _MIN_FORCE_NOISE = 1e-5, 1e-4
_MIN_RATE_WALK, _MIN_FORCE_WALK = 1e-6, 1e-5
# "Doubled" is as in `DvioParameters`; all of these are hand-chosen.
# Random walk of the IMU's biases, in multiples of the data sheet's. Doubled: none; biases follow faster.
_BIAS_WALK_FACTOR = 4.2
# Turn-on biases, unless the calibration has larger ones. Doubled: none by the first, + 4 % by the second; the vertical
# of a start is less certain.
_MIN_RATE_BIAS_SD_RADPS, _MIN_FORCE_BIAS_SD_MPS2 = 0.01, 0.1
# Errors of a camera that is not mounted as calibrated. Doubled: - 2 % by the first, none by the second with a mount as
# calibrated.
_SLIPPED_POSITION_SD_M, _SLIPPED_ROTATION_SD_RAD = 0.03, 0.04
# Relative errors of the depth camera's scale and of the focal lengths. Doubled: + 20 %, + 24 %.
_DEPTH_SCALE_SD, _FOCAL_SD = 6e-3, 2e-3
# Scale and axis errors of a gyroscope, as noise proportional to the rate: 0.56 % over a second.
_RATE_SHARE_RTS = 5.6e-3
# Error of a sample that is saturated or replaces missing ones; hand-chosen.
_INVALID_RATE_SD_RADPS, _INVALID_FORCE_SD_MPS2 = 1.0, 5.0
# Observations and depths beyond this many standard deviations are down-weighted (Huber); hand-chosen.
_HUBER_SD = 1.05
# Depths of later frames have errors that are correlated with those of the first one; hand-chosen.
LATER_DEPTH_SD = 2.0
"""Standard deviation of a later frame's measured inverse depth, over that of the host's."""


def imu_noise(parameters: DvioParameters, imu: ImuCalibration) -> ImuNoise:
    """Noise of an IMU's samples: that of its data sheet, with lower limits, times a factor.

    The white noise is multiplied by `imu_noise_factor` of the parameters, the random walk of the biases by a constant.
    What the data sheet does not know is added: noise proportional to the rate, and that of invalid samples.
    """
    f, w = parameters.imu_noise_factor, _BIAS_WALK_FACTOR  # on the white noise, and on the biases' random walk
    return ImuNoise(
        rate=f * max(imu.gyroscope_noise_density, _MIN_RATE_NOISE),
        force=f * max(imu.accelerometer_noise_density, _MIN_FORCE_NOISE),
        rate_share=_RATE_SHARE_RTS,
        rate_walk=w * max(imu.gyroscope_random_walk, _MIN_RATE_WALK),
        force_walk=w * max(imu.accelerometer_random_walk, _MIN_FORCE_WALK),
        invalid_rate=_INVALID_RATE_SD_RADPS,
        invalid_force=_INVALID_FORCE_SD_MPS2,
    )


def bias_sd(imu: ImuCalibration) -> Array:
    """(6,) standard deviations of the turn-on biases of gyroscope (rad/s) and accelerometer (m/s²)."""
    rate = max(imu.gyroscope_bias_sd, _MIN_RATE_BIAS_SD_RADPS)
    force = max(imu.accelerometer_bias_sd, _MIN_FORCE_BIAS_SD_MPS2)
    return np.repeat([rate, force], 3)


def factor_parameters(parameters: DvioParameters, focal_px: float, noise: ImuNoise) -> FactorParameters:
    """Noise model of the window's factors, as weights 1 / variance, and which factors the method uses.

    Args:
        parameters: Noise of images and depth, and the method.
        focal_px: Mean focal length of the camera.
        noise: Noise of the IMU, whose random walk the bias factors use.
    """
    depth_sd, method = parameters.inverse_depth_sd_per_m, parameters.method
    return FactorParameters(
        gravity=parameters.gravity_mps2,
        pixel_weight=(focal_px / parameters.pixel_noise_px) ** 2,
        depth_weight=depth_sd**-2,
        later_depth_weight=(LATER_DEPTH_SD * depth_sd) ** -2,
        huber_sd=_HUBER_SD,
        host_depth=method.host_depth == "factor",
        depth_fixed=method.host_depth == "fixed",
        projection_depth=method.projection_depth,
        host_depth_in_prior=method.host_depth_in_prior,
        first_estimates=method.first_estimates,
        rate_walk=noise.rate_walk,
        force_walk=noise.force_walk,
    )


class CalibrationPrior(NamedTuple):
    """Standard deviations of the calibration; 0 where a value is exactly known, or not refined.

    Attributes:
        mount_sd: (2,) standard deviations of the position (m) and rotation (rad) of a camera mounted as calibrated.
        slipped_sd: (2,) standard deviations of position (m) and rotation (rad) of a camera that has slipped.
        offset_sd_s: Standard deviation of the offset of the camera's clock, s.
        depth_scale_sd: Relative standard deviation of the depth camera's scale.
        focal_sd: Relative standard deviation of the focal lengths.
    """

    mount_sd: Array
    slipped_sd: Array
    offset_sd_s: float
    depth_scale_sd: float
    focal_sd: float


def calibration_prior(parameters: DvioParameters) -> CalibrationPrior:
    """Prior of the calibration: which values the method refines, and how far they may be off.

    A method may refine nothing, the mount and the clock, or all; the standard deviation of the others is 0.
    """
    p, method = parameters, parameters.method
    refines_mount_and_clock, refines_all = method.calibration != NOMINAL, method.calibration == ALL
    # a factor False makes a standard deviation 0
    return CalibrationPrior(
        mount_sd=np.array([p.extrinsic_position_sd_m, p.extrinsic_rotation_sd_rad]) * refines_mount_and_clock,
        slipped_sd=np.array([_SLIPPED_POSITION_SD_M, _SLIPPED_ROTATION_SD_RAD]) * refines_all,
        offset_sd_s=p.time_offset_sd_s if refines_mount_and_clock else 0.0,
        depth_scale_sd=_DEPTH_SCALE_SD if refines_all and method.uses_depth else 0.0,
        focal_sd=_FOCAL_SD if refines_all else 0.0,
    )
