"""Parameters of the filter of two feet, in addition to those of the one-foot filter."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np

from stridetwin.estimators.foot_ins.parameters import FootInsParameters, as_record
from stridetwin.streams.errors import check_numbers

_MAY_BE_ZERO = ("camera_", "board_", "start_", "gyro_scale_", "scaled_")


@dataclass(frozen=True, kw_only=True)
class PublishedParameters:
    """Parameters of Jao, Wang, Shkel 2020 that the paper leaves open. The last sentence says what twice the value does.

    Attributes:
        window_s: Duration of the stance detector's window, s.
        threshold: γ; the foot is stationary if the sum of the normalised variances is lower.
        zero_velocity_sd_mps: m/s; like the threshold and the window the best of `benchmarks.jao_open_values`.
        relative_position_sd_m: Effect of the heading that rotates a relative position, m, in addition to its own noise.
        range_sd_m: Of a sonar's echo, m.
        max_range_misfit_m: Echoes farther off are from something else, m.
    """

    window_s: float = 0.05
    threshold: float = 1e4
    zero_velocity_sd_mps: float = 0.3
    relative_position_sd_m: float = 0.015
    range_sd_m: float = 0.03
    max_range_misfit_m: float = 0.5

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number > 0."""
        check_numbers("PublishedParameters", asdict(self))


@dataclass(frozen=True, kw_only=True)
class FootToFootParameters:
    """One set serves every wearer and rig. The last sentence of each says what twice the value does.

    Attributes:
        foot: Parameters of each foot; the same as for one foot alone. The published method takes gravity,
            alignment and gaps from it; its noise is the calibration's alone.
        published: Parameters that the published method has in addition.
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
        observation_gate: Innovation of an observation, in standard deviations, beyond which it is down-weighted.
        range_sd_m: Of a sonar's echo, m: its resolution, and which part of the shoe reflects.
        range_gate: Echoes with a larger innovation, in standard deviations, are from something else.
        sonar_after_s: The sonar is used only if the other shoe has not been observed for so long, s.
        max_delay_s: A later board observation or echo is discarded, s.
        exposure_s: Of the shoe cameras: relates a board's blur to its motion, s.
        start_position_sd_m: Position uncertainty of the second foot at a start without given poses, m.
        start_heading_sd_rad: Its heading uncertainty, rad.
        start_separation_m: Distance between the feet there, m.
        start_toe_out_rad: Rotation of each foot outwards there, rad.
    """

    foot: FootInsParameters = field(default_factory=FootInsParameters)
    published: PublishedParameters = PublishedParameters()
    camera_position_sd_m: float = 0.001
    camera_rotation_sd_rad: float = 0.005
    board_position_sd_m: float = 0.001
    board_rotation_sd_rad: float = 0.005
    camera_clock_sd_s: float = 0.005
    camera_clock_walk_s_rts: float = 1e-4
    gyro_scale_sd: float = 0.003
    scaled_gyro_noise_radps_rthz: float = 0.001
    observation_correlation_s: float = 1.0
    observation_gate: float = 4.5
    range_sd_m: float = 0.1
    range_gate: float = 3.0
    sonar_after_s: float = 1.0
    max_delay_s: float = 0.1
    exposure_s: float = 0.002
    start_position_sd_m: float = 0.15
    start_heading_sd_rad: float = 0.2
    start_separation_m: float = 0.2
    start_toe_out_rad: float = 0.1

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number ≥ 0, or 0 where only more makes sense."""
        values = _numbers(self)
        check_numbers("FootToFootParameters", values, [name for name in values if name.startswith(_MAY_BE_ZERO)])


def _numbers(parameters: FootToFootParameters | PublishedParameters) -> dict[str, float]:
    """The values by name, without the groups."""
    groups = ("foot", "published")
    return {f.name: float(getattr(parameters, f.name)) for f in fields(parameters) if f.name not in groups}


if TYPE_CHECKING:

    @dataclass(frozen=True, kw_only=True)
    class PairParameters:
        """What the kernel of either method reads; see `for_kernel`."""

        published: bool
        max_delay_s: float
        camera_clock_walk_s_rts: float
        observation_correlation_s: float
        observation_gate: float
        range_sd_m: float
        range_gate: float
        sonar_after_s: float
        window_s: float
        threshold: float
        zero_velocity_sd_mps: float
        relative_position_sd_m: float
        max_range_misfit_m: float

else:
    PairParameters = np.record


def for_kernel(parameters: FootToFootParameters, published: bool = False) -> PairParameters:
    """The parameters of both feet by name in one record, as the compiled kernel takes them.

    Args:
        parameters: Of the filter.
        published: Whether the kernel runs the published method, whose echoes have a standard deviation of their own.
    """
    values = _numbers(parameters.published) | _numbers(parameters)
    if published:
        values["range_sd_m"] = parameters.published.range_sd_m
    return as_record({"published": published, **values})
