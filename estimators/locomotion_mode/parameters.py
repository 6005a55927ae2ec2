"""Public parameters of the mode prediction: insoles, steps, soles, ground, and habits on stairs.

Dimensions of stairs and gates on poses are those of the map (`TerrainMapParameters`). Every other number is a constant
of the module that uses it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import NamedTuple

from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.terrains import KERB_M
from stridetwin.streams.errors import ConfigError, check_numbers

_RISER_MARGIN_M = 0.002
"""A step up or down may be mapped so much lower than the lowest riser of stairs."""


@dataclass(frozen=True, kw_only=True)
class LocomotionModeParameters:
    """Parameters of `LocomotionMode`; the defaults serve every walker, mount, pattern and terrain.

    Each attribute says what it is, where its default comes from, and what happens if it is doubled. "Usual": a common
    value of people or buildings. "Tuned": chosen by hand on simulated walks of seeds below 1000. Equations are those of
    docs/locomotion_mode.md.

    Attributes:
        lift_n: A foot whose load falls below this has left the ground, N over the unloaded insole. Usual.
        touch_n: A foot whose load has risen by this has touched down, N. Usual.
        min_swing_s: Shortest swing, s; a foot that returns sooner has not left the ground. Usual.
        steps: Number of predicted steps.
        step_m: Prior step length, m. Usual.
        step_s: Prior step time, s. Usual.
        step_sd: Standard deviation of length and time between walkers, as a share of the step. Usual.
        step_noise: Standard deviation of a single step about the walker's mean, as a share of the step. Tuned.
        width_m: Lateral distance between left and right footprints, m. Usual.
        width_sd_m: Lateral standard deviation of a footprint, m. Usual.
        heel_m: From the heel's centre back to the sole's end, m. Usual.
        toe_m: From the heel's centre forward to the sole's end, m. Usual.
        overhang_m: Length of a sole that may extend over a free edge without penalty, m. Tuned.
        min_ramp_slope_rad: A step on a greater slope is on a ramp, rad, in (9). Building codes: the gentlest ramps have
            2.9° (1:20).
        usual_riser_m: Riser of hidden stairs that are unlike the last observed ones, m. Usual.
        usual_tread_m: Tread of these, m. Usual.
        riser_sd_m: Smallest standard deviation of a riser, m, in (9). Tuned.
        slope_sd_rad: Smallest standard deviation of a slope, rad. Tuned.
        lean_sd_rad: Standard deviation of the map's lean along the path, rad, in (11). Tuned.
        change_m: Mean distance between changes of unobserved ground, m. Tuned.
        joiners: Share of walkers who put both feet on each tread. Tuned.
        two_at_a_time: Share of walkers who take two treads at a time on the way up. Tuned.
        one_per_tread: Share of all others who never set a second foot on a tread, however deep. Tuned.
        reach_m: The prediction ends this far ahead of the body, m. Tuned.
    """

    lift_n: float = 12.0
    touch_n: float = 30.0
    min_swing_s: float = 0.12
    steps: int = 4
    step_m: float = 0.60
    step_s: float = 0.58
    step_sd: float = 0.15
    step_noise: float = 0.05
    width_m: float = 0.12
    width_sd_m: float = 0.03
    heel_m: float = 0.045
    toe_m: float = 0.21
    overhang_m: float = 0.03
    min_ramp_slope_rad: float = 0.0436
    usual_riser_m: float = 0.18
    usual_tread_m: float = 0.30
    riser_sd_m: float = 0.008
    slope_sd_rad: float = 0.0055
    lean_sd_rad: float = 0.009
    change_m: float = 2.0
    joiners: float = 0.1
    two_at_a_time: float = 0.03
    one_per_tread: float = 0.5
    reach_m: float = 3.6

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number above 0, or the loads exclude each other."""
        check_numbers("LocomotionModeParameters", asdict(self))
        if self.lift_n >= self.touch_n:
            raise ConfigError("LocomotionModeParameters", "lift_n", self.lift_n, "less than touch_n")


class Settings(NamedTuple):
    """Parameters of the prediction, and those of the map that it reads.

    Attributes:
        mode: Of the prediction.
        map: Of the map: dimensions of stairs, and gates on poses.
    """

    mode: LocomotionModeParameters = LocomotionModeParameters()
    map: TerrainMapParameters = TerrainMapParameters()

    @property
    def min_stair_riser_m(self) -> float:
        """Smallest step up or down, m, that is one of stairs."""
        return self.map.min_riser_m - _RISER_MARGIN_M

    @property
    def min_step_height_m(self) -> float:
        """Smallest step up or down, m, that is an edge: halfway between a kerb and the lowest riser of stairs."""
        return 0.5 * (KERB_M + self.map.min_riser_m)
