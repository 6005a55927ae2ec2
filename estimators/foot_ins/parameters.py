"""What the one-foot filter believes about any foot and any sensor."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import NamedTuple

from stridetwin.streams.errors import check_numbers
from stridetwin.streams.rig import ImuCalibration


@dataclass(frozen=True, kw_only=True)
class FootInsParameters:
    """One set serves every sensor, rate and gait; noise is a continuous-time density, windows are in seconds.

    Attributes:
        gravity: m/s².
        lever_arm: From the sensor straight down (as it first stood) to the point that stands still, m.
        lever_sd: How far that point may be from there in any one sample, m.
        contact_sd: How far the point that stands still wanders along the sole, and remembers that it did, m.
        contact_s: How long it remembers, s.
        gyro_noise: Scale and sampling errors of the angular rate, rad/s/√Hz, beside the calibration's noise.
        gyro_limit_noise: Added about an axis that is at its limit, rad/s/√Hz.
        accel_noise: Noise of the specific force at rest, m/s²/√Hz, beside the calibration's.
        accel_motion_noise: What scale, alignment and sampling errors add for 1 m/s², 1/√Hz.
        accel_jerk_noise: What sampling adds where the specific force changes by 1 m/s³, s/√Hz.
        accel_limit_noise: Added along an axis that is at a known limit, m/s²/√Hz.
        accel_extreme_noise: Added where the limit is not known, and may be none.
        impact_excess: What a landing hides of an upward force in each sample at a known limit, as a share of the range.
        gyro_bias_walk: rad/s²/√Hz, beside the calibration's.
        accel_bias_walk: m/s³/√Hz, beside the calibration's.
        gyro_bias_sd: Turn-on bias, rad/s, where the calibration has none.
        accel_bias_sd: Turn-on bias, m/s², where the calibration has none.
        gyro_range: Limit of the gyro, rad/s, where the calibration has none; 0 = the largest magnitude met so far on
            the axis.
        accel_range: Limit of the accelerometer, m/s², likewise.
        gyro_range_min: No gyro is taken to be limited below this, rad/s.
        accel_range_min: No accelerometer is taken to be limited below this, m/s².
        limit_share: Share of the range above which a sample counts as limited.
        window_s: Span of the motion statistic, s.
        gyro_scale: Angular rate that counts 1 in the statistic, rad/s.
        accel_scale: Specific force that counts 1 in the statistic, m/s².
        peak_decay_s: Time constant by which the statistic's peak is forgotten, s.
        still_level: Statistic at which any foot begins to lose its standing.
        still_share: The same as a share of the recent peak, so that a fast gait may stand less quietly.
        still_power: Steepness of the loss of trust above that level.
        still_velocity: Speed of a standing foot, m/s.
        still_correlation_s: How long such a speed lasts: updates within this time share their error, s.
        max_velocity_sd: An update less certain than this is left out, m/s.
        max_surprise: Innovation, in standard deviations, beyond which an update is trusted less.
        level_step: A smaller change of the floor's height between two steps is none, m; 0 = each floor is new.
        level_tilt: A foot that leans more, against how it first stood, is on no level floor, rad.
        floor_sd: How far the height of a foot on the same floor differs from step to step, m.
        stand_speed: A foot whose speed is known no better does not stand on a floor yet, m/s.
        stand_s: How long it has to stand before its height counts, s.
        rest_level: Peak of the statistic below which the foot rests: its mean rate is the gyro's bias.
        rest_rate_noise: Turning of a foot at rest, rad/s/√Hz.
        align_s: Still time that an alignment takes, s.
        align_timeout_s: After this the filter starts without having stood still, s.
        tilt_sd: Error of an alignment at rest, rad.
        moving_tilt_sd: Error of an alignment in motion, rad.
        moving_speed: Speed of a foot that never stood still, m/s.
        max_step_s: A longer step is a gap, s.
        max_gap_s: A longer gap is not bridged: the filter aligns anew, s.
        gap_gyro_noise: What a gap hides, rad/s/√Hz.
        gap_accel_noise: What a gap hides, m/s²/√Hz.
        gap_speed: Speed of the wearer while the filter is lost, m/s.
        gap_turn_rate: Turning of the wearer while the filter is lost, rad/s.
    """

    gravity: float = 9.8029
    lever_arm: float = 0.072
    lever_sd: float = 0.04
    contact_sd: float = 0.058
    contact_s: float = 10.0
    gyro_noise: float = 0.0022
    gyro_limit_noise: float = 0.057
    accel_noise: float = 0.0034
    accel_motion_noise: float = 0.0019
    accel_jerk_noise: float = 2.15e-5
    accel_limit_noise: float = 3.0
    accel_extreme_noise: float = 0.141
    impact_excess: float = 0.5
    gyro_bias_walk: float = 1e-5
    accel_bias_walk: float = 1e-4
    gyro_bias_sd: float = 3.3e-4
    accel_bias_sd: float = 0.07
    gyro_range: float = 0.0
    accel_range: float = 0.0
    gyro_range_min: float = 7.0
    accel_range_min: float = 45.0
    limit_share: float = 0.94
    window_s: float = 0.0243
    gyro_scale: float = 0.0017
    accel_scale: float = 0.0045
    peak_decay_s: float = 0.2
    still_level: float = 2890.0
    still_share: float = 0.008
    still_power: float = 4.63
    still_velocity: float = 0.01
    still_correlation_s: float = 0.018
    max_velocity_sd: float = 2.0
    max_surprise: float = 3.0
    level_step: float = 0.0175
    level_tilt: float = 0.06
    floor_sd: float = 0.0053
    stand_speed: float = 0.02
    stand_s: float = 0.0298
    rest_level: float = 880.0
    rest_rate_noise: float = 3.2e-4
    align_s: float = 0.1
    align_timeout_s: float = 2.0
    tilt_sd: float = 0.0175
    moving_tilt_sd: float = 0.2
    moving_speed: float = 1.0
    max_step_s: float = 0.03
    max_gap_s: float = 0.3
    gap_gyro_noise: float = 0.3
    gap_accel_noise: float = 3.0
    gap_speed: float = 1.5
    gap_turn_rate: float = 0.5

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number ≥ 0, or 0 where only more makes sense."""
        may_be_zero = {"gyro_range", "accel_range", "impact_excess", "lever_arm", "lever_sd", "contact_sd"}
        may_be_zero |= {"level_step", "rest_level"}
        values = asdict(self)
        may_be_zero |= {name for name in values if name.endswith(("_noise", "_walk"))}
        check_numbers("FootInsParameters", values, may_be_zero)


class KernelParameters(NamedTuple):
    """`FootInsParameters` for one sensor, as the compiled kernel takes them; same names and units."""

    gravity: float
    lever_arm: float
    lever_sd: float
    contact_sd: float
    contact_s: float
    gyro_noise: float
    gyro_limit_noise: float
    accel_noise: float
    accel_motion_noise: float
    accel_limit_noise: float
    accel_jerk_noise: float
    impact_excess: float
    gyro_bias_walk: float
    accel_bias_walk: float
    gyro_bias_sd: float
    accel_bias_sd: float
    gyro_range: float
    accel_range: float
    gyro_range_min: float
    accel_range_min: float
    limit_share: float
    window_s: float
    gyro_scale: float
    accel_scale: float
    peak_decay_s: float
    still_level: float
    still_share: float
    still_power: float
    still_velocity: float
    still_correlation_s: float
    max_velocity_sd: float
    max_surprise: float
    level_step: float
    level_tilt: float
    floor_sd: float
    stand_speed: float
    stand_s: float
    rest_level: float
    rest_rate_noise: float
    align_s: float
    align_timeout_s: float
    tilt_sd: float
    moving_tilt_sd: float
    moving_speed: float
    max_step_s: float
    max_gap_s: float
    gap_gyro_noise: float
    gap_accel_noise: float
    gap_speed: float
    gap_turn_rate: float


def for_sensor(parameters: FootInsParameters, calibration: ImuCalibration | None) -> KernelParameters:
    """What the kernel is told: the parameters, with the sensor's own noise added where a calibration says it.

    Args:
        parameters: What holds for any sensor.
        calibration: Noise densities and turn-on biases of this one; None = unknown.
    """
    values = {name: float(value) for name, value in asdict(parameters).items()}
    if calibration is not None:
        for name, density in (
            ("gyro_noise", calibration.gyroscope_noise_density),
            ("accel_noise", calibration.accelerometer_noise_density),
            ("gyro_bias_walk", calibration.gyroscope_random_walk),
            ("accel_bias_walk", calibration.accelerometer_random_walk),
            ("rest_rate_noise", calibration.gyroscope_noise_density),
        ):
            values[name] = math.hypot(values[name], density)
        values["gyro_bias_sd"] = calibration.gyroscope_bias_sd or values["gyro_bias_sd"]
        values["accel_bias_sd"] = calibration.accelerometer_bias_sd or values["accel_bias_sd"]
        values["gyro_range"] = calibration.gyroscope_range or values["gyro_range"]
        values["accel_range"] = calibration.accelerometer_range or values["accel_range"]
    extreme_noise = values.pop("accel_extreme_noise")
    if values["accel_range"] == 0.0:
        values["accel_limit_noise"] = extreme_noise
    return KernelParameters(**values)
