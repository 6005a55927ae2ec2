"""Parameters of the one-foot filter, for any foot and any sensor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stridetwin.streams.errors import check_numbers
from stridetwin.streams.rig import ImuCalibration


@dataclass(frozen=True, kw_only=True)
class FootInsParameters:
    """One set serves every sensor, rate and gait; noise is a continuous-time density, windows are in seconds.

    Values marked [real walks] were chosen by a search of the mean 2-D error on the 14 walks of `foot_imu_vicon`, their
    variants, `dual_foot_walk` and twin walks of seeds 0-4 (docs/foot_ins.md, "Measured"; `python -m
    benchmarks.foot_ins_real --days` repeats the search of eight of them by days). The others are hand-chosen bounds
    of consumer sensors and of walking.
    """

    gravity_mps2: float = 9.8029
    """Local gravity, set for the real walks (origin unrecorded); site-dependent."""
    lever_arm_m: float = 0.072
    """Vertical distance from the sensor (at its first stationary attitude) to the stationary point, m. [real walks]"""
    lever_sd_m: float = 0.04
    """Uncorrelated displacement of that point per sample, m. [real walks]"""
    contact_sd_m: float = 0.058
    """Correlated displacement of the stationary point along the sole, m. [real walks]"""
    contact_s: float = 10.0
    """Correlation time of that displacement, s. [real walks]"""
    gyro_noise_radps_rthz: float = 0.0022
    """Scale and sampling errors of the angular rate, rad/s/√Hz, in addition to the calibration's noise. [real walks]"""
    gyro_limit_noise_radps_rthz: float = 0.057
    """Added about an axis that is at its limit, rad/s/√Hz. [real walks]"""
    accel_noise_mps2_rthz: float = 0.0034
    """Noise of the specific force at rest, m/s²/√Hz, in addition to the calibration's. [real walks]"""
    accel_motion_noise_per_rthz: float = 0.0019
    """Scale, alignment and sampling errors per 1 m/s², 1/√Hz. [real walks]"""
    accel_jerk_noise_s_rthz: float = 2.15e-5
    """Sampling errors per 1 m/s³ of change of the specific force, s/√Hz. [real walks]"""
    accel_limit_noise_mps2_rthz: float = 3.0
    """Added along an axis that is at a known limit, m/s²/√Hz. [real walks]"""
    accel_extreme_noise_mps2_rthz: float = 0.141
    """Added if the limit is unknown and may not exist. [real walks]"""
    impact_excess: float = 0.5
    """Clipped part of a landing's upward force per sample at a known limit, as a share of the range. [real walks]"""
    gyro_bias_walk_radps2_rthz: float = 1e-5
    """rad/s²/√Hz, in addition to the calibration's."""
    accel_bias_walk_mps3_rthz: float = 1e-4
    """m/s³/√Hz, in addition to the calibration's."""
    gyro_bias_sd_radps: float = 3.3e-4
    """Turn-on bias, rad/s, if the calibration has none."""
    accel_bias_sd_mps2: float = 0.07
    """Turn-on bias, m/s², if the calibration has none."""
    gyro_range_radps: float = 0.0
    """Limit of the gyro, rad/s, if the calibration has none; 0 = the largest magnitude so far on the axis."""
    accel_range_mps2: float = 0.0
    """Limit of the accelerometer, m/s², likewise."""
    gyro_range_min_radps: float = 7.0
    """Least limit of a gyro, rad/s."""
    accel_range_min_mps2: float = 45.0
    """Least limit of an accelerometer, m/s²."""
    limit_share: float = 0.94
    """Share of the range above which a sample counts as saturated. [real walks]"""
    clipped_share: float = 0.99
    """Share of a known range from which on a sample counts as clipped, so that its peak is restored."""
    peak_max_s: float = 0.15
    """A longer clipped peak is not determined by its two ends, s."""
    peak_rates_min: float = 1.0
    """Least number of clipped samples of a peak of the angular rate."""
    peak_forces_min: float = 3.0
    """The same of the force; shorter impacts on an accelerometer ring and have no such shape."""
    landing_cosine_min: float = 0.7
    """Least cosine between the vertical and a channel that senses a landing."""
    rate_max_radps: float = 100.0
    """A larger angular rate is ignored, rad/s: no foot moves so."""
    force_max_mps2: float = 5000.0
    """A larger specific force is ignored, m/s²."""
    window_s: float = 0.0243
    """Span of the motion statistic, s. [real walks]"""
    gyro_scale_radps: float = 0.0017
    """Angular rate that counts 1 in the statistic, rad/s. [real walks]"""
    accel_scale_mps2: float = 0.0045
    """Specific force that counts 1 in the statistic, m/s². [real walks]"""
    peak_decay_s: float = 0.2
    """Decay time of the statistic's peak, s. [real walks]"""
    stationary_level: float = 2890.0
    """Statistic above which the trust in zero velocity decreases for any foot. [real walks]"""
    stationary_share: float = 0.008
    """The same as a share of the recent peak, for less quiet stances of a fast gait. [real walks]"""
    stationary_power: float = 4.63
    """Steepness of the loss of trust above that level. [real walks]"""
    stationary_speed_mps: float = 0.01
    """Speed of a stationary foot, m/s. [real walks]"""
    stationary_correlation_s: float = 0.018
    """Correlation time of that speed: updates within it share their error, s. [real walks]"""
    max_velocity_sd_mps: float = 2.0
    """Updates with a larger standard deviation are skipped, m/s."""
    innovation_gate: float = 3.0
    """Innovation, in standard deviations, beyond which an update is down-weighted. [real walks]"""
    height_drift_sd: float = 0.015
    """Systematic height error per metre of path: standard deviation. [real walks]"""
    height_drift_s: float = 5.0
    """Correlation time of that error, s: it changes with the gait."""
    level_step_m: float = 0.035
    """A larger change of height between two steps is no error of a level floor, m."""
    same_floor: float = 0.9
    """Probability that a foot lands on the floor that it left, before its height is considered; 0 = each is new."""
    same_after_new: float = 0.5
    """The same after a step onto a new floor."""
    new_floor_range_m: float = 0.5
    """Another floor is anywhere in a range of this width, m."""
    sole_m: float = 0.1
    """Arm by which a tilted sole raises the sensor, m."""
    floor_sd_m: float = 0.01
    """Height differences of a foot on the same floor from step to step, m. [real walks]"""
    floor_prior: float = 5.0
    """Number of level steps that `floor_sd_m` is worth against those of the walk."""
    gyro_scale_sd: float = 0.0
    """Scale error of the gyro across the sole's normal, if the calibration has no `gyroscope_scale_sd`: strikes at the
    limit of an accelerometer look the same (0.01 bends `dual_foot_walk` by 0.3 m)."""
    path_scale_sd: float = 0.02
    """Unknown share of the length of a way, by scale errors, if the calibration has no `accelerometer_scale_sd`.
    [real walks]"""
    misalignment_noise_per_rthz: float = 0.6
    """Noise of the angular rate per rad of the gyro's misalignment, 1/√Hz, if the calibration gives it. [twin]"""
    stand_speed_mps: float = 0.02
    """Largest speed uncertainty of a foot on a floor, m/s. [real walks]"""
    stand_s: float = 0.0298
    """Stationary time before its height counts, s. [real walks]"""
    rest_level: float = 880.0
    """Peak of the statistic below which the foot is at rest: its mean rate is the gyro's bias. [real walks]"""
    rest_rate_noise_radps_rthz: float = 3.2e-4
    """Rotation rate of a foot at rest, rad/s/√Hz. [real walks]"""
    norm_error_max: float = 0.05
    """Largest error of an uncalibrated accelerometer at rest, as a share of gravity: data sheets give ±3 % at most."""
    align_s: float = 0.1
    """Stationary time of an alignment, s."""
    align_timeout_s: float = 2.0
    """After this time the filter starts without a stationary window, s."""
    tilt_sd_rad: float = 0.0175
    """Error of an alignment at rest, rad."""
    aligned_speed_mps: float = 0.01
    """Speed of the foot after an alignment at rest, m/s."""
    moving_tilt_sd_rad: float = 0.2
    """Error of an alignment in motion, rad."""
    moving_speed_mps: float = 1.0
    """Speed of a foot that was never stationary, m/s."""
    max_step_s: float = 0.03
    """A longer step is a gap, s."""
    max_gap_s: float = 0.3
    """After a longer gap the filter aligns again, s."""
    gap_gyro_noise_radps_rthz: float = 0.3
    """Noise of a gap, rad/s/√Hz."""
    gap_accel_noise_mps2_rthz: float = 3.0
    """Noise of a gap, m/s²/√Hz."""
    gap_speed_mps: float = 1.5
    """Speed of the wearer while the filter is lost, m/s."""
    gap_turn_rate_radps: float = 0.5
    """Rotation rate of the wearer while the filter is lost, rad/s."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number ≥ 0, or 0 where only more makes sense."""
        may_be_zero = {
            "gyro_range_radps",
            "accel_range_mps2",
            "impact_excess",
            "lever_arm_m",
            "lever_sd_m",
            "contact_sd_m",
        }
        may_be_zero |= {
            "same_floor",
            "same_after_new",
            "rest_level",
            "height_drift_sd",
            "path_scale_sd",
            "gyro_scale_sd",
            "sole_m",
        }
        values = asdict(self)
        may_be_zero |= {name for name in values if "_noise" in name or "_walk" in name}
        check_numbers("FootInsParameters", values, may_be_zero)


if TYPE_CHECKING:
    KernelParameters = FootInsParameters
else:
    KernelParameters = np.record


def as_record(values: Mapping[str, float]) -> Any:
    """Numbers under their names, as one argument of a compiled function."""
    dtype = np.dtype([(name, type(value)) for name, value in values.items()], align=True)
    return np.rec.array([tuple(values.values())], dtype=dtype)[0]


def for_sensor(parameters: FootInsParameters, calibration: ImuCalibration | None) -> KernelParameters:
    """The kernel's parameters, by name in one record: these, with the noise and limits of the calibration."""
    values = {name: float(value) for name, value in asdict(parameters).items()}
    if calibration is not None:
        values["path_scale_sd"] = calibration.accelerometer_scale_sd or values["path_scale_sd"]
        values["gyro_scale_sd"] = calibration.gyroscope_scale_sd or values["gyro_scale_sd"]
        misalignment = calibration.gyroscope_misalignment_sd
        if misalignment > 0.0:
            values["gyro_noise_radps_rthz"] = values["misalignment_noise_per_rthz"] * misalignment
        for name, density in (
            ("gyro_noise_radps_rthz", calibration.gyroscope_noise_density),
            ("accel_noise_mps2_rthz", calibration.accelerometer_noise_density),
            ("gyro_bias_walk_radps2_rthz", calibration.gyroscope_random_walk),
            ("accel_bias_walk_mps3_rthz", calibration.accelerometer_random_walk),
            ("rest_rate_noise_radps_rthz", calibration.gyroscope_noise_density),
        ):
            values[name] = math.hypot(values[name], density)
        values["gyro_bias_sd_radps"] = calibration.gyroscope_bias_sd or values["gyro_bias_sd_radps"]
        values["accel_bias_sd_mps2"] = calibration.accelerometer_bias_sd or values["accel_bias_sd_mps2"]
        values["gyro_range_radps"] = calibration.gyroscope_range or values["gyro_range_radps"]
        values["accel_range_mps2"] = calibration.accelerometer_range or values["accel_range_mps2"]
    if values["accel_range_mps2"] == 0.0:
        values["accel_limit_noise_mps2_rthz"] = values["accel_extreme_noise_mps2_rthz"]
    return as_record(values)
