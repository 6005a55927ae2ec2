"""Parameters of the one-foot filter, for any foot and any sensor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from stridetwin.streams.errors import check_numbers
from stridetwin.streams.rig import ImuCalibration, Mount

_MAY_BE_ZERO = (
    "lever_arm_m",
    "lever_sd_m",
    "contact_sd_m",
    "gyro_noise_radps_rthz",
    "accel_noise_mps2_rthz",
    "accel_motion_noise_per_rthz",
    "accel_jerk_noise_s_rthz",
    "impact_excess",
    "rest_level",
    "height_drift_sd",
    "same_floor",
    "path_scale_sd",
)


@dataclass(frozen=True, kw_only=True)
class FootInsParameters:
    """One set serves every sensor, rate and gait; noise is a continuous-time density, windows are in seconds.

    Values marked [real walks] were chosen by a search of the mean 2-D error on the 14 walks of `foot_imu_vicon`, their
    variants, `dual_foot_walk` and twin walks of seeds 0-4 (docs/foot_ins.md, "How accurate it is"; `python -m
    benchmarks.foot_ins_real --days` repeats the search of eight of them by days). The others are hand-chosen bounds
    of consumer sensors and of walking.

    "Doubled" is what twice the value does to the means over the 14 walks, where the 2-D error is 45 mm, that of the
    height at the end 47 mm, and their standard deviations are 58 mm on each axis, 29 mm in height and 1.1° in
    heading. An error that is not named changes by less than 2 mm.
    """

    gravity_mps2: float = 9.8029
    """Local gravity, set for the real walks (origin unrecorded); site-dependent. An error of 0.02 m/s² changes less
    than 1 mm, because it becomes a bias of the accelerometer."""
    lever_arm_m: float = 0.072
    """Vertical distance from the sensor (at its first stationary attitude) to the stationary point, m. [real walks]
    Doubled: height 81 mm."""
    lever_sd_m: float = 0.04
    """Uncorrelated displacement of that point per sample, m. [real walks] Doubled: height 55 mm."""
    contact_sd_m: float = 0.058
    """Correlated displacement of the stationary point along the sole, m. [real walks] Doubled: height 54 mm."""
    gyro_noise_radps_rthz: float = 0.0022
    """Scale and sampling errors of the angular rate, rad/s/√Hz, in addition to the calibration's noise. [real walks]
    Doubled: standard deviations of 67 mm and 1.7°."""
    accel_noise_mps2_rthz: float = 0.0034
    """Noise of the specific force at rest, m/s²/√Hz, in addition to the calibration's. [real walks] Doubled: height
    58 mm."""
    accel_motion_noise_per_rthz: float = 0.0019
    """Scale, alignment and sampling errors per 1 m/s², 1/√Hz. [real walks] Doubled: height 50 mm, standard
    deviations of 73 mm and, in height, 37 mm."""
    accel_jerk_noise_s_rthz: float = 2.15e-5
    """Sampling errors per 1 m/s³ of change of the specific force, s/√Hz. [real walks] Doubled: 2-D 50 mm, its standard
    deviation 77 mm."""
    gyro_bias_sd_radps: float = 3.3e-4
    """Turn-on bias of a calibrated sensor, rad/s, if the calibration has none; the first rest decides whether the
    sensor is one or has the bias of a consumer part. Doubled: the heading's standard deviation grows by 5 %."""
    accel_bias_sd_mps2: float = 0.07
    """Turn-on bias, m/s², if the calibration has none. Doubled: no difference above 1 mm."""
    path_scale_sd: float = 0.02
    """Unknown share of the length of a way, by scale errors, if the calibration has no `accelerometer_scale_sd`.
    [real walks] Doubled: twice the standard deviation along the way from the start, and the same path."""
    limit_share: float = 0.94
    """Share of the range above which a sample counts as saturated. [real walks]
    Twice as far from 1: 2-D 46 mm, height 39 mm, and the heading's standard deviation grows by 18 %."""
    clipped_share: float = 0.99
    """Share of a known range from which on a sample counts as clipped, so that its peak is restored. Twice as far from
    1: samples within 2 % of the range are replaced too; nothing without a known range."""
    impact_excess: float = 0.5
    """Clipped part of a landing's upward force per sample at a known limit, as a share of the range. [real walks]
    Doubled: every clipped sample of a landing lifts the foot twice as much; nothing without a known range."""
    window_s: float = 0.0243
    """Span of the motion statistic, s. [real walks] Doubled: height 105 mm."""
    stationary_level: float = 2890.0
    """Statistic above which the trust in zero velocity decreases for any foot. [real walks] Doubled: height 59 mm."""
    stationary_share: float = 0.008
    """That statistic as a share of the recent peak, for less quiet stances of a fast gait. [real walks]
    Doubled: 2-D 47 mm, height 25 mm."""
    stationary_power: float = 4.63
    """Steepness of the loss of trust above that level. [real walks] Doubled: height 73 mm."""
    stationary_speed_mps: float = 0.01
    """Speed of a stationary foot, m/s. [real walks] Doubled: height 264 mm, whose standard deviation is 262 mm."""
    stationary_correlation_s: float = 0.018
    """Correlation time of that speed: updates within it share their error, s. [real walks] Doubled: height 51 mm,
    standard deviation 66 mm."""
    innovation_gate: float = 3.0
    """Innovation, in standard deviations, beyond which an update is down-weighted. [real walks] Doubled: height
    40 mm, and a swing that seems stationary for an instant is stopped the more."""
    rest_level: float = 880.0
    """Peak of the statistic below which the foot is at rest: its mean rate is the gyro's bias. [real walks]
    Doubled: no difference above 1 mm."""
    height_drift_sd: float = 0.015
    """Systematic height error per metre of path: standard deviation. [real walks] Doubled: height 44 mm, its standard
    deviation 37 mm."""
    same_floor: float = 0.9
    """Probability that a foot lands on the floor that it left, before its height is considered; 0 = each is new.
    Twice as far from 1: height 49 mm."""
    floor_sd_m: float = 0.01
    """Height differences of a foot on the same floor from step to step, m. [real walks] Doubled: height 52 mm, its
    standard deviation 39 mm."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number ≥ 0, or 0 where only more makes sense."""
        check_numbers("FootInsParameters", asdict(self), _MAY_BE_ZERO)


if TYPE_CHECKING:

    @dataclass(frozen=True, kw_only=True)
    class KernelParameters(FootInsParameters):
        """The parameters together with what the calibration of a sensor determines; see `for_sensor`.

        Attributes:
            gyro_limit_noise_radps_rthz: Noise added to the rate about an axis that is at its limit, rad/s/√Hz.
            accel_limit_noise_mps2_rthz: Noise added to the specific force along an axis at its limit, m/s²/√Hz.
            gyro_bias_walk_radps2_rthz: Random walk of the gyro's bias, rad/s²/√Hz.
            accel_bias_walk_mps3_rthz: Random walk of the accelerometer's bias, m/s³/√Hz.
            rest_rate_noise_radps_rthz: Noise of the rate of a foot at rest, sensor and sway together, rad/s/√Hz.
            gyro_wide_bias_sd_radps: Turn-on bias of a consumer part, rad/s.
            wide_bias_share: Probability that the sensor is one; 0 if its calibration gives the bias.
            gyro_scale_sd: Standard deviation of the gyro's scale error; 0: it is not estimated.
            considered_scale_sd: Scale error of the gyro that is considered, not estimated; 0 if the calibration tells.
            considered_delay_sd_s: Delay between the gyro and the accelerometer, likewise, s.
            creep_forward_share: Way that a shoe creeps forward in stance, as a share of the stride.
            creep_down_m: Way that it sinks in a stance, m.
            creep_level: Motion statistic of a stance in which a shoe creeps by half as much.
            creep_forward_sd: Standard deviation of the former from foot to foot, and of such a creep to the left;
                considered, not estimated.
            creep_down_sd_m: Standard deviation of the latter, likewise, m.
            wander_m: How far the middle of a straight way is off the line between its ends, m.
            stance_height_sd_m: Height above the floor from stance to stance, m, in the reported covariance alone.
            gyro_range_radps: Largest measurable rate, rad/s; 0 if unknown.
            accel_range_mps2: Largest measurable specific force, m/s²; 0 if unknown.
        """

        gyro_limit_noise_radps_rthz: float
        accel_limit_noise_mps2_rthz: float
        gyro_bias_walk_radps2_rthz: float
        accel_bias_walk_mps3_rthz: float
        rest_rate_noise_radps_rthz: float
        gyro_wide_bias_sd_radps: float
        wide_bias_share: float
        considered_scale_sd: float
        considered_delay_sd_s: float
        creep_forward_share: float
        creep_down_m: float
        creep_level: float
        creep_forward_sd: float
        creep_down_sd_m: float
        wander_m: float
        stance_height_sd_m: float
        gyro_scale_sd: float
        gyro_range_radps: float
        accel_range_mps2: float

else:
    KernelParameters = np.record

_GYRO_LIMIT_NOISE_RADPS_RTHZ = 0.057  # added about an axis that is at its limit [real walks]
_ACCEL_LIMIT_NOISE_MPS2_RTHZ = 3.0  # added along an axis that is at a known limit [real walks]
_ACCEL_EXTREME_NOISE_MPS2_RTHZ = 0.141  # added if the limit is unknown and may not exist [real walks]
_GYRO_BIAS_WALK_RADPS2_RTHZ = 1e-5  # in addition to the calibration's
_ACCEL_BIAS_WALK_MPS3_RTHZ = 1e-4  # in addition to the calibration's
_REST_RATE_NOISE_RADPS_RTHZ = 3.2e-4  # rotation rate of a foot at rest [real walks]
_WIDE_BIAS_SD_RADPS = (
    3.5e-3  # turn-on bias of consumer parts, 0.1 to 0.5 °/s: the class of a sensor that nobody calibrated
)
_WIDE_BIAS_SHARE = 0.5  # of unknown sensors that are of that class; the others have `gyro_bias_sd_radps`
# Creep of a shoe in stance. [14 real walks: without it a stride is too short by 1.2 % and ends 3 mm too high, in the
# medians; twin feet of seeds 0-7: 0.4 % and 8 mm, with standard deviations of 0.4 % and 4.5 mm from foot to foot]
_CREEP_FORWARD_SHARE, _CREEP_FORWARD_SD = 0.002, 0.004  # as shares of a stride; the latter to the left, too
_CREEP_DOWN_M, _CREEP_DOWN_SD_M = 0.004, 0.004
_CREEP_LEVEL = 500.0  # quietest moments of stances have 1000 to 6000, sensors at rest 4 to 100 [real walks and twin]
# How far the middle of a straight way is off the line between its ends. [doubled and halved: `demo` of seeds 0-11,
# `dual_foot_walk` and the walks over corners; docs/foot_ins.md]
_WANDER_M = 0.12
_STANCE_HEIGHT_SD_M = 0.012  # height of an unknown sensor above the floor, from stance to stance [real walks]
_UNKNOWN_SCALE_SD = 0.007  # of a gyro that nobody calibrated [data sheets of consumer parts: 1 to 3 % at most]
_UNKNOWN_DELAY_SD_S = 0.005  # between its channels and the accelerometer's [six parts: 0, 0, 2.5, 2.5, 3.8 and 12.5 ms]
_MISALIGNMENT_NOISE_PER_RTHZ = 0.6  # noise of the angular rate per rad of the gyro's misalignment [twin]

# Parameters for motion, limits and scale errors, which `for_sensor` leaves out on request.
_ADDED_NOISE = (
    "gyro_noise_radps_rthz",
    "gyro_limit_noise_radps_rthz",
    "accel_noise_mps2_rthz",
    "accel_motion_noise_per_rthz",
    "accel_jerk_noise_s_rthz",
    "accel_limit_noise_mps2_rthz",
    "gyro_bias_walk_radps2_rthz",
    "accel_bias_walk_mps3_rthz",
    "height_drift_sd",
    "path_scale_sd",
    "creep_forward_share",
    "creep_forward_sd",
    "creep_down_m",
    "creep_down_sd_m",
)
_UNKNOWN = ImuCalibration(
    topic="",
    part="",
    rate_hz=0.0,
    mount=Mount(body=""),
    gyroscope_noise_density=0.0,
    gyroscope_random_walk=0.0,
    accelerometer_noise_density=0.0,
    accelerometer_random_walk=0.0,
)

RecordT = TypeVar("RecordT")


def as_record(kind: type[RecordT], values: Mapping[str, float]) -> RecordT:
    """Numbers under their names, as one argument of a compiled function.

    Args:
        kind: `np.record`, under the name by which a type checker knows the attributes, such as `KernelParameters`.
        values: Numbers by attribute.
    """
    dtype = np.dtype([(name, type(value)) for name, value in values.items()], align=True)
    record: RecordT = np.rec.array([tuple(values.values())], dtype=dtype)[0]  # the one row of a record array
    return record


def for_sensor(
    parameters: FootInsParameters,
    calibration: ImuCalibration | None,
    *,
    data_sheet_alone: bool = False,
    is_sensor_considered: bool = True,
) -> KernelParameters:
    """The kernel's parameters of one sensor, by name in one record.

    Noise densities add to those of the calibration; a bias, scale error or range of the calibration replaces what is
    assumed without one. A scale error of the gyro is not estimated unless the calibration gives its standard deviation:
    strikes at the limit of an accelerometer look the same (0.01 bends `dual_foot_walk` by 0.3 m).

    Args:
        parameters: Parameters for any sensor.
        calibration: Calibration of the sensor; None: a consumer sensor without one.
        data_sheet_alone: The noise is the calibration's, a misalignment's included, without any other addition for
            motion, limits and scale errors, and shoes do not creep.
        is_sensor_considered: Whether scale and delay of a sensor of unknown calibration are considered.
    """
    imu = calibration or _UNKNOWN  # in which every number is 0, which means unknown
    is_calibrated = imu.accelerometer_scale_sd > 0.0
    values = {name: float(value) for name, value in asdict(parameters).items()} | {
        "gyro_limit_noise_radps_rthz": _GYRO_LIMIT_NOISE_RADPS_RTHZ,
        "accel_limit_noise_mps2_rthz": (
            _ACCEL_LIMIT_NOISE_MPS2_RTHZ if imu.accelerometer_range > 0.0 else _ACCEL_EXTREME_NOISE_MPS2_RTHZ
        ),
        "gyro_bias_walk_radps2_rthz": _GYRO_BIAS_WALK_RADPS2_RTHZ,
        "accel_bias_walk_mps3_rthz": _ACCEL_BIAS_WALK_MPS3_RTHZ,
        "rest_rate_noise_radps_rthz": _REST_RATE_NOISE_RADPS_RTHZ,
        "gyro_wide_bias_sd_radps": _WIDE_BIAS_SD_RADPS,
        "wide_bias_share": 0.0 if imu.gyroscope_bias_sd > 0.0 else _WIDE_BIAS_SHARE,
        "gyro_scale_sd": imu.gyroscope_scale_sd,
        "considered_scale_sd": 0.0 if is_calibrated or imu.gyroscope_scale_sd > 0.0 else _UNKNOWN_SCALE_SD,
        "considered_delay_sd_s": 0.0 if is_calibrated else _UNKNOWN_DELAY_SD_S,
        "creep_forward_share": _CREEP_FORWARD_SHARE,
        "creep_down_m": _CREEP_DOWN_M,
        "creep_level": _CREEP_LEVEL,
        "creep_forward_sd": _CREEP_FORWARD_SD,
        "creep_down_sd_m": _CREEP_DOWN_SD_M,
        "wander_m": _WANDER_M,
        "stance_height_sd_m": 0.0 if is_calibrated else _STANCE_HEIGHT_SD_M,
        "gyro_range_radps": imu.gyroscope_range,
        "accel_range_mps2": imu.accelerometer_range,
    }
    if not is_sensor_considered:
        values |= {"considered_scale_sd": 0.0, "considered_delay_sd_s": 0.0}
    if data_sheet_alone:  # 0 is added to the calibration's noise below
        values |= dict.fromkeys(_ADDED_NOISE, 0.0)
    if imu.gyroscope_misalignment_sd > 0.0:
        # a calibration that knows the misalignment replaces the noise that stands for it
        values["gyro_noise_radps_rthz"] = _MISALIGNMENT_NOISE_PER_RTHZ * imu.gyroscope_misalignment_sd
    # noise of the calibration in addition: the variances add, so the densities add as the sides of a right triangle
    for name, density in (
        ("gyro_noise_radps_rthz", imu.gyroscope_noise_density),
        ("accel_noise_mps2_rthz", imu.accelerometer_noise_density),
        ("gyro_bias_walk_radps2_rthz", imu.gyroscope_random_walk),
        ("accel_bias_walk_mps3_rthz", imu.accelerometer_random_walk),
        ("rest_rate_noise_radps_rthz", imu.gyroscope_noise_density),
    ):
        values[name] = math.hypot(values[name], density)
    # what the calibration does not know is 0 there, and stays as the parameters have it
    values["gyro_bias_sd_radps"] = imu.gyroscope_bias_sd or values["gyro_bias_sd_radps"]
    if values["gyro_bias_sd_radps"] >= _WIDE_BIAS_SD_RADPS:  # as wide as that of any part
        values["wide_bias_share"] = 0.0
    values["accel_bias_sd_mps2"] = imu.accelerometer_bias_sd or values["accel_bias_sd_mps2"]
    values["path_scale_sd"] = imu.accelerometer_scale_sd or values["path_scale_sd"]
    return as_record(KernelParameters, {name: float(value) for name, value in values.items()})
