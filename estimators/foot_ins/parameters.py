"""Parameters of the one-foot filter, for any foot and any sensor."""

from __future__ import annotations

import math
from collections import namedtuple
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING

from stridetwin.streams.errors import check_numbers
from stridetwin.streams.rig import ImuCalibration


@dataclass(frozen=True, kw_only=True)
class FootInsParameters:
    """One set serves every sensor, rate and gait; noise is a continuous-time density, windows are in seconds.

    Values marked [real walks] were chosen by a search of the mean 2-D error on the 14 walks of `foot_imu_vicon`, their
    variants, `dual_foot_walk` and twin walks of seeds 0-4 (docs/foot_ins.md, "Measured"; `python -m
    benchmarks.foot_ins_real --halves` repeats the search of eight of them by halves). The others are hand-chosen bounds
    of consumer sensors and of walking.
    """

    gravity_mps2: float = 9.8029
    """Local gravity, set for the real walks (origin unrecorded); another site has its own."""
    lever_arm_m: float = 0.072
    """From the sensor straight down (as it first stood) to the point that stands still, m. [real walks]"""
    lever_sd_m: float = 0.04
    """How far that point may be from there in any one sample, m. [real walks]"""
    contact_sd_m: float = 0.058
    """How far the point that stands still wanders along the sole, and remembers that it did, m. [real walks]"""
    contact_s: float = 10.0
    """How long it remembers, s. [real walks]"""
    gyro_noise_radps_rthz: float = 0.0022
    """Scale and sampling errors of the angular rate, rad/s/√Hz, beside the calibration's noise. [real walks]"""
    gyro_limit_noise_radps_rthz: float = 0.057
    """Added about an axis that is at its limit, rad/s/√Hz. [real walks]"""
    accel_noise_mps2_rthz: float = 0.0034
    """Noise of the specific force at rest, m/s²/√Hz, beside the calibration's. [real walks]"""
    accel_motion_noise_per_rthz: float = 0.0019
    """What scale, alignment and sampling errors add for 1 m/s², 1/√Hz. [real walks]"""
    accel_jerk_noise_s_rthz: float = 2.15e-5
    """What sampling adds where the specific force changes by 1 m/s³, s/√Hz. [real walks]"""
    accel_limit_noise_mps2_rthz: float = 3.0
    """Added along an axis that is at a known limit, m/s²/√Hz. [real walks]"""
    accel_extreme_noise_mps2_rthz: float = 0.141
    """Added where the limit is not known, and may be none. [real walks]"""
    impact_excess: float = 0.5
    """What a landing hides of an upward force in each sample at a known limit, as a share of the range. [real walks]"""
    gyro_bias_walk_radps2_rthz: float = 1e-5
    """rad/s²/√Hz, beside the calibration's."""
    accel_bias_walk_mps3_rthz: float = 1e-4
    """m/s³/√Hz, beside the calibration's."""
    gyro_bias_sd_radps: float = 3.3e-4
    """Turn-on bias, rad/s, where the calibration has none."""
    accel_bias_sd_mps2: float = 0.07
    """Turn-on bias, m/s², where the calibration has none."""
    gyro_range_radps: float = 0.0
    """Limit of the gyro, rad/s, where the calibration has none; 0 = the largest magnitude met so far on the axis."""
    accel_range_mps2: float = 0.0
    """Limit of the accelerometer, m/s², likewise."""
    gyro_range_min_radps: float = 7.0
    """No gyro is taken to be limited below this, rad/s."""
    accel_range_min_mps2: float = 45.0
    """No accelerometer is taken to be limited below this, m/s²."""
    limit_share: float = 0.94
    """Share of the range above which a sample counts as limited. [real walks]"""
    window_s: float = 0.0243
    """Span of the motion statistic, s. [real walks]"""
    gyro_scale_radps: float = 0.0017
    """Angular rate that counts 1 in the statistic, rad/s. [real walks]"""
    accel_scale_mps2: float = 0.0045
    """Specific force that counts 1 in the statistic, m/s². [real walks]"""
    peak_decay_s: float = 0.2
    """Time constant by which the statistic's peak is forgotten, s. [real walks]"""
    still_level: float = 2890.0
    """Statistic at which any foot begins to lose its standing. [real walks]"""
    still_share: float = 0.008
    """The same as a share of the recent peak, so that a fast gait may stand less quietly. [real walks]"""
    still_power: float = 4.63
    """Steepness of the loss of trust above that level. [real walks]"""
    still_velocity_mps: float = 0.01
    """Speed of a standing foot, m/s. [real walks]"""
    still_correlation_s: float = 0.018
    """How long such a speed lasts: updates within this time share their error, s. [real walks]"""
    max_velocity_sd_mps: float = 2.0
    """An update less certain than this is left out, m/s."""
    innovation_gate: float = 3.0
    """Innovation, in standard deviations, beyond which an update is trusted less. [real walks]"""
    level_step_m: float = 0.0175
    """A smaller change of the floor's height between two steps is none, m; 0 = each floor is new. [real walks]"""
    level_tilt_rad: float = 0.06
    """A foot that leans more, against how it first stood, is on no level floor, rad. [real walks]"""
    floor_sd_m: float = 0.0053
    """How far the height of a foot on the same floor differs from step to step, m. [real walks]"""
    stand_speed_mps: float = 0.02
    """A foot whose speed is known no better does not stand on a floor yet, m/s. [real walks]"""
    stand_s: float = 0.0298
    """How long it has to stand before its height counts, s. [real walks]"""
    rest_level: float = 880.0
    """Peak of the statistic below which the foot rests: its mean rate is the gyro's bias. [real walks]"""
    rest_rate_noise_radps_rthz: float = 3.2e-4
    """Turning of a foot at rest, rad/s/√Hz. [real walks]"""
    align_s: float = 0.1
    """Still time that an alignment takes, s."""
    align_timeout_s: float = 2.0
    """After this the filter starts without having stood still, s."""
    tilt_sd_rad: float = 0.0175
    """Error of an alignment at rest, rad."""
    moving_tilt_sd_rad: float = 0.2
    """Error of an alignment in motion, rad."""
    moving_speed_mps: float = 1.0
    """Speed of a foot that never stood still, m/s."""
    max_step_s: float = 0.03
    """A longer step is a gap, s."""
    max_gap_s: float = 0.3
    """A longer gap is not bridged: the filter aligns anew, s."""
    gap_gyro_noise_radps_rthz: float = 0.3
    """What a gap hides, rad/s/√Hz."""
    gap_accel_noise_mps2_rthz: float = 3.0
    """What a gap hides, m/s²/√Hz."""
    gap_speed_mps: float = 1.5
    """Speed of the wearer while the filter is lost, m/s."""
    gap_turn_rate_radps: float = 0.5
    """Turning of the wearer while the filter is lost, rad/s."""

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
        may_be_zero |= {"level_step_m", "rest_level"}
        values = asdict(self)
        may_be_zero |= {name for name in values if "_noise" in name or "_walk" in name}
        check_numbers("FootInsParameters", values, may_be_zero)


if TYPE_CHECKING:
    KernelParameters = FootInsParameters
else:
    KernelParameters = namedtuple("KernelParameters", [f.name for f in fields(FootInsParameters)])
    KernelParameters.__doc__ = "`FootInsParameters` for one sensor, as the compiled kernel takes them."


def for_sensor(parameters: FootInsParameters, calibration: ImuCalibration | None) -> KernelParameters:
    """What the kernel is told: the parameters, with the sensor's own noise added where a calibration says it.

    Args:
        parameters: What holds for any sensor.
        calibration: Noise densities and turn-on biases of this one; None = unknown.
    """
    values = {name: float(value) for name, value in asdict(parameters).items()}
    if calibration is not None:
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
    return KernelParameters(**values)
