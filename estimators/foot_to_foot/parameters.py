"""Parameters of the filter of two feet, in addition to those of the one-foot filter.

Numbers that no user needs are constants of the modules that use them.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np

from stridetwin.estimators.foot_ins.parameters import FootInsParameters, as_record
from stridetwin.streams.errors import check_numbers

_MAY_BE_ZERO = ("camera_", "board_", "gyro_scale_", "scaled_")  # beginnings of names


@dataclass(frozen=True, kw_only=True)
class PublishedParameters:
    """Parameters of Jao, Wang, Shkel 2020 that the paper leaves open.

    "Doubled" is what twice the value does on the paper's simulation (`studies.jao2020.jao_simulation`, 25 strides of
    seeds 0-2), where the mean error of the end is 0.17 m and the feet are 9 mm off against each other.

    Attributes:
        window_s: Duration of the stance detector's window, s; the best of `benchmarks.jao_open_values` (seeds 0-4).
            Doubled: 0.18 m.
        threshold: γ; the foot is stationary if the sum of the normalised variances is lower; the best of the
            same search. Doubled: no difference above 1 mm.
        zero_velocity_sd_mps: Speed of a stationary foot, m/s; the best of the same search. Doubled: 0.30 m.
        relative_position_sd_m: Effect of the heading that rotates a relative position, m, in addition to its own noise;
            reproduces the paper's spread. Doubled: feet 10 mm off against each other.
        range_sd_m: Standard deviation of a sonar's distance, m; hand-chosen. Doubled: no difference above 1 mm.
    """

    window_s: float = 0.05
    threshold: float = 1e4
    zero_velocity_sd_mps: float = 0.3
    relative_position_sd_m: float = 0.015
    range_sd_m: float = 0.03

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number > 0."""
        check_numbers("PublishedParameters", asdict(self))


@dataclass(frozen=True, kw_only=True)
class FootToFootParameters:
    """One set serves every wearer and rig; the values are hand-chosen on walks of seeds below 1000.

    "Doubled" is what twice the value does on the paper's simulation (`studies.jao2020.jao_simulation`, 25 strides of
    seeds 0-2) with mounts, clocks and gyro scales off by the standard deviations below. There the mean error of the end
    is 12 mm in the plane, and the feet are 2 mm off against each other, with a standard deviation of 6 mm. With the
    sonars alone and exact mounts the error is 22 mm. A value without the word changes none of these by 1 mm.

    Attributes:
        foot: Parameters of each foot; the same as for one foot alone. The published method takes gravity
            and turn-on biases from it; its noise is the calibration's alone.
        published: Parameters that the published method has in addition.
        camera_position_sd_m: Standard deviation of the camera's position about the nominal one on the shoe, m.
        camera_rotation_sd_rad: Standard deviation of the camera's rotation, rad. Doubled: 14 mm.
        board_position_sd_m: Standard deviation of the board's position about the nominal one on the shoe, m.
        board_rotation_sd_rad: Standard deviation of the board's rotation, rad.
        camera_clock_sd_s: Standard deviation of the offset of a camera's clock, s.
        camera_clock_walk_s_rts: Random walk of that offset, s/√s.
        gyro_scale_sd: Scale error of a gyro's axis, relative; estimated only if a camera observes the other shoe,
            because nothing else makes it observable.
        scaled_gyro_noise_radps_rthz: Replaces `foot.gyro_noise_radps_rthz`, which covers scale errors, where they are
            estimated. Doubled: 10 mm, and 8 mm of standard deviation against each other.
        observation_correlation_s: Correlation time of an observation's error, s: observations within it share it.
            Doubled: 7 mm of standard deviation against each other; 29 mm with the sonars alone.
        observation_gate: Innovation of an observation, in standard deviations, beyond which it is down-weighted.
            Doubled: wrong corners of up to 9 standard deviations keep their weight.
        range_sd_m: Standard deviation of a sonar's distance, m: its resolution, and which part of the shoe reflects.
            Doubled: 37 mm with the sonars alone.
        range_gate: Echoes with a larger innovation, in standard deviations, are from something else.
            Doubled: more echoes from the floor are used.
        sonar_after_s: The sonar is used only if the other shoe has not been observed for so long, s. Doubled: a covered
            camera is replaced later.
        max_delay_s: A later board observation or echo is discarded, s. Doubled: older images are used, and up to twice
            as many samples are rewound for one.
        exposure_s: Exposure time of the shoe cameras, s: relates a board's blur to its motion. Doubled: a board is
            searched with twice the smear of its predicted motion.
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

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number ≥ 0, or 0 where only more makes sense."""
        values = _numbers(self)
        check_numbers("FootToFootParameters", values, [name for name in values if name.startswith(_MAY_BE_ZERO)])


def _numbers(parameters: FootToFootParameters | PublishedParameters) -> dict[str, float]:
    """The numbers of a dataclass by name, without the nested groups of parameters."""
    groups = ("foot", "published")
    return {f.name: float(getattr(parameters, f.name)) for f in fields(parameters) if f.name not in groups}


if TYPE_CHECKING:

    @dataclass(frozen=True, kw_only=True)
    class PairParameters(FootToFootParameters, PublishedParameters):
        """The numbers of both groups of parameters, which the kernel of either method reads; see `for_kernel`.

        Attributes:
            is_published: Whether the kernel runs the published method.
        """

        is_published: bool

else:
    PairParameters = np.record


def for_kernel(parameters: FootToFootParameters, published: bool = False) -> PairParameters:
    """The parameters of both feet by name in one record, as the compiled kernel takes them.

    Args:
        parameters: Parameters of the filter.
        published: Whether the kernel runs the published method, whose echoes have a standard deviation of their own.
    """
    # both have a `range_sd_m`: the latter one replaces the former
    values = _numbers(parameters.published) | _numbers(parameters)
    if published:
        values["range_sd_m"] = parameters.published.range_sd_m
    return as_record(PairParameters, {"is_published": published, **values})
