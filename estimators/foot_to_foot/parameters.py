"""Parameters of the filter of two feet, in addition to those of the one-foot filter."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from stridetwin.estimators.foot_ins.parameters import FootInsParameters, as_record
from stridetwin.streams.errors import check_numbers

GROUPS = ("foot", "tracking", "exchange")


@dataclass(frozen=True, kw_only=True)
class TrackingParameters:
    """Search for the other shoe's board; hand-chosen."""

    region_sd: float = 3.0
    """Half width of the search region, standard deviations of the prediction ..."""
    region_min_px: float = 12.0
    """... and pixels in addition: an overconfident prediction misidentifies the corners of a partly visible board."""
    lost_px: float = 60.0
    """With a less certain prediction the whole image is searched ..."""
    lost_every_s: float = 0.1
    """... at most once in this time, because that takes longer, s."""
    missed_s: float = 2.0
    """After this time without a board at its prediction, which may then be wrong, whole images are searched, s ..."""
    missed_every_s: float = 0.3
    """... once in this time, s. A stride is no integer multiple of it."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number > 0."""
        check_numbers("TrackingParameters", asdict(self))


@dataclass(frozen=True, kw_only=True)
class ExchangeParameters:
    """Evidence that left and right are exchanged, as log-likelihoods; hand-chosen."""

    rotation_sd_rad: float = 0.3
    """A plane's orientation in an image, and the feet's headings while unknown, rad."""
    evidence_max_sd: float = 4.0
    """Largest evidence of one image, standard deviations."""
    apart_s: float = 0.05
    """Closer images are not independent, s."""
    uncertain: float = 4.0
    """With this much evidence for an exchange no observation is used."""
    certain: float = 20.0
    """With this much the exchange, or that there is none, is certain ..."""
    margin: float = 10.0
    """... if the next assignment is this much less likely."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number > 0."""
        check_numbers("ExchangeParameters", asdict(self))


@dataclass(frozen=True, kw_only=True)
class _Common:
    """Parameters of both methods.

    Attributes:
        foot: Parameters of each foot; the same as for one foot alone. The published method takes gravity,
            alignment and gaps from it; its noise is the calibration's alone.
        max_delay_s: A later board observation or echo is discarded, s.
        max_lead_s: Longest extrapolation of the newest IMU sample, s, for a camera whose clock is late.
        exposure_s: Of the shoe cameras: relates a board's blur to its motion, s.
        start_position_sd_m: Position uncertainty of the second foot at a start without given poses, m.
        start_heading_sd_rad: Its heading uncertainty, rad.
        start_separation_m: Distance between the feet there, m.
        start_toe_out_rad: Rotation of each foot outwards there, rad.
        tracking: Search for the boards in the images.
        exchange: Detection of exchanged shoes, cameras or IMUs.
    """

    foot: FootInsParameters = field(default_factory=FootInsParameters)
    max_delay_s: float = 0.1
    max_lead_s: float = 0.05
    exposure_s: float = 0.002
    start_position_sd_m: float = 0.15
    start_heading_sd_rad: float = 0.2
    start_separation_m: float = 0.2
    start_toe_out_rad: float = 0.1
    tracking: TrackingParameters = TrackingParameters()
    exchange: ExchangeParameters = ExchangeParameters()

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number ≥ 0, or 0 where only more makes sense."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in GROUPS}
        may_be_zero = ("camera_", "board_", "start_", "gyro_scale_", "scaled_")
        check_numbers(type(self).__name__, values, [name for name in values if name.startswith(may_be_zero)])


@dataclass(frozen=True, kw_only=True)
class FootToFootParameters(_Common):
    """One set serves every wearer and rig.

    Attributes:
        camera_position_sd_m: Of the camera's nominal position on the shoe, m.
        camera_rotation_sd_rad: Of its nominal rotation, rad.
        board_position_sd_m: The same for the board, m.
        board_rotation_sd_rad: rad.
        camera_clock_sd_s: Of a camera's clock offset, s.
        camera_clock_walk_s_rts: Random walk of that offset, s/√s.
        gyro_scale_sd: Scale error of a gyro's axis, relative; estimated only if a camera observes the other shoe,
            because nothing else makes it observable.
        scaled_gyro_noise_radps_rthz: Replaces `foot.gyro_noise_radps_rthz` there, which covers scale errors.
        observation_correlation_s: Correlation time of an observation's error, s: observations within it share it.
        max_frame_s: Largest time that one observation counts for, s.
        observation_gate: Innovation of an observation, in standard deviations, beyond which it is down-weighted.
        range_sd_m: Of a sonar's echo, m: its resolution, and which part of the shoe reflects.
        range_gate: Echoes with a larger innovation, in standard deviations, are from something else.
        board_depth_min_m: A board predicted nearer than this, or behind the camera, is invalid, m.
        relinearizations: Largest number of linearisations per image.
        settled_sd: Smaller changes of the board's pose, in standard deviations of the image, end the iteration.
        sonar_after_s: The sonar is used only if the other shoe has not been observed for so long, s.
    """

    camera_position_sd_m: float = 0.001
    camera_rotation_sd_rad: float = 0.005
    board_position_sd_m: float = 0.001
    board_rotation_sd_rad: float = 0.005
    camera_clock_sd_s: float = 0.005
    camera_clock_walk_s_rts: float = 1e-4
    gyro_scale_sd: float = 0.003
    scaled_gyro_noise_radps_rthz: float = 0.001
    observation_correlation_s: float = 1.0
    max_frame_s: float = 0.05
    observation_gate: float = 4.5
    range_sd_m: float = 0.1
    range_gate: float = 3.0
    board_depth_min_m: float = 0.02
    relinearizations: float = 5.0
    settled_sd: float = 0.1
    sonar_after_s: float = 1.0


@dataclass(frozen=True, kw_only=True)
class PublishedParameters(_Common):
    """Parameters of Jao, Wang, Shkel 2020 that the paper leaves open.

    Attributes:
        window_s: Duration of the stance detector's window, s.
        accel_spread_mps2: Amplitude σ̄_a by which the accelerometer's standard deviation is normalised, m/s².
        gyro_spread_radps: Amplitude σ̄_g of the gyro, rad/s.
        threshold: γ; the foot is stationary if the sum of the normalised variances is lower.
        zero_velocity_sd_mps: m/s; like the threshold and the window the best of `benchmarks.jao_open_values`.
        relative_position_sd_m: Effect of the heading that rotates a relative position, m, in addition to its own noise.
        range_sd_m: Of a sonar's echo, m.
        max_range_misfit_m: Echoes farther off are from something else, m.
    """

    window_s: float = 0.05
    accel_spread_mps2: float = 0.0045
    gyro_spread_radps: float = 0.0017
    threshold: float = 1e4
    zero_velocity_sd_mps: float = 0.3
    relative_position_sd_m: float = 0.015
    range_sd_m: float = 0.03
    max_range_misfit_m: float = 0.5

    @property
    def noise_of_the_calibration_alone(self) -> FootInsParameters:
        """The one-foot parameters without their additions to a sensor's data sheet."""
        return replace(
            self.foot, gyro_noise_radps_rthz=0.0, gyro_limit_noise_radps_rthz=0.0, accel_noise_mps2_rthz=0.0,
            accel_motion_noise_per_rthz=0.0, accel_jerk_noise_s_rthz=0.0, accel_limit_noise_mps2_rthz=0.0,
            accel_extreme_noise_mps2_rthz=0.0, gyro_bias_walk_radps2_rthz=0.0, accel_bias_walk_mps3_rthz=0.0,
            height_drift_sd=0.0, path_scale_sd=0.0,
        )  # fmt: skip


if TYPE_CHECKING:

    @dataclass(frozen=True, kw_only=True)
    class PairParameters(FootToFootParameters, PublishedParameters):
        """The parameters of both methods."""

        published: bool = False

else:
    PairParameters = np.record

_NAMES = [f.name for kind in (FootToFootParameters, PublishedParameters) for f in fields(kind) if f.name not in GROUPS]


def for_kernel(parameters: FootToFootParameters | PublishedParameters) -> PairParameters:
    """Parameters of either method, by name in one record, as the compiled kernel takes them; 0 those of the other."""
    values: dict[str, Any] = dict.fromkeys(_NAMES, 0.0)
    values |= {f.name: float(getattr(parameters, f.name)) for f in fields(parameters) if f.name not in GROUPS}
    return as_record({"published": isinstance(parameters, PublishedParameters), **values})
