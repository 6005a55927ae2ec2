"""Public parameters of the mode prediction: insoles, steps, soles and ground.

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
    value of people or buildings. "Tuned": chosen by hand on simulated walks of seeds below 1000. Effects were seen on
    scripted walks up and down stairs, with one foot or both feet on each tread, and over a ramp of 4°.

    Attributes:
        lift_n: A foot whose load falls below this has left the ground, N over the unloaded insole; less than `touch_n`.
            Usual. Doubled: nothing while feet swing freely.
        touch_n: A foot whose load has risen by this has touched down, N. Usual. Doubled: touch-downs are detected later
            by the time in which the load rises from 30 to 60 N.
        steps: Number of predicted steps. Tuned. Doubled: the first ones become up to 0.3 m shorter, because all must
            end within `reach_m`. With that doubled as well they stay, and the eighth has a mode of probability 0.6.
        step_m: Prior step length, m. Usual. Doubled: the first steps are predicted up to 0.5 m too far.
        step_s: Prior step time, s. Usual. Doubled: the first steps are predicted too late, and the standard deviation
            of landing times is two thirds greater.
        step_sd: Standard deviation of length and time between walkers, as a share of the step. Usual. Doubled: the
            standard deviation of footprints grows by a quarter; the first change of the ground is found less certainly.
        step_noise: Standard deviation of a single step about the walker's mean, as a share of the step. Tuned. Doubled:
            the standard deviation of landing times grows by half, of footprints by an eighth.
        width_m: Lateral distance between left and right footprints, m. Usual. Doubled: footprints lie 6 cm farther out.
        width_sd_m: Lateral standard deviation of a footprint, m. Usual. Doubled: the reported one doubles.
        heel_m: From the heel's centre back to the sole's end, m. Usual. Doubled: footprints on treads lie 2 cm farther
            ahead.
        toe_m: From the heel's centre forward to the sole's end, m. Usual. Doubled: soles of 0.47 m fit on no tread, and
            every other step on stairs is missed.
        min_ramp_slope_rad: A step on a greater slope is on a ramp, rad, in docs/locomotion_mode.md (9). Buildings: the
            gentlest ramps of building codes have 2.9° (1:20). Doubled: steps on a ramp of 4° are level.
        usual_riser_m: Riser of hidden stairs that are unlike the last observed ones, m. Usual. Doubled: half as many
            hidden treads.
        usual_tread_m: Tread of these, m, and length of a usual step over an edge. Usual. Doubled: the first footprints
            after stairs move by up to 0.1 m.
        riser_sd_m: Smallest standard deviation of a riser, m, in docs/locomotion_mode.md (9). Tuned. Doubled: nothing
            on risers of 150 mm; the mode of steps over 50-90 mm is less certain.
        slope_sd_rad: Smallest standard deviation of a slope, rad. Tuned. Doubled: the mode of steps on a ramp of 4° is
            less certain.
        lean_sd_rad: Standard deviation of the map's lean along the path, rad, in docs/locomotion_mode.md (11). Tuned.
            Doubled: more of a gentle slope is taken for lean, and the mode of steps on a ramp of 4° is less certain.
        change_m: Mean distance between changes of unobserved ground, m. Tuned. Doubled: the modes of steps beyond the
            map are more certain.
        reach_m: Predicted footprints end this far ahead of the body, m. Tuned. Doubled: nothing for four steps.
    """

    lift_n: float = 12.0
    touch_n: float = 30.0
    steps: int = 4
    step_m: float = 0.60
    step_s: float = 0.58
    step_sd: float = 0.15
    step_noise: float = 0.05
    width_m: float = 0.12
    width_sd_m: float = 0.03
    heel_m: float = 0.045
    toe_m: float = 0.21
    min_ramp_slope_rad: float = 0.0436
    usual_riser_m: float = 0.18
    usual_tread_m: float = 0.30
    riser_sd_m: float = 0.008
    slope_sd_rad: float = 0.0055
    lean_sd_rad: float = 0.009
    change_m: float = 2.0
    reach_m: float = 3.6

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number above 0, or the loads exclude each other."""
        check_numbers("LocomotionModeParameters", asdict(self))
        if self.lift_n >= self.touch_n:
            raise ConfigError("LocomotionModeParameters", "lift_n", self.lift_n, "less than touch_n")


class Settings(NamedTuple):
    """Parameters of the prediction, and those of the map that it reads.

    Attributes:
        mode: Parameters of the prediction.
        map: Parameters of the map: dimensions of stairs, and gates on poses.
        drift_m: Standard deviation of the drift of the poses' height within a second, m.
        drift_slope_rad: Standard deviation of the slope that it gives to level ground, rad.
    """

    mode: LocomotionModeParameters = LocomotionModeParameters()
    map: TerrainMapParameters = TerrainMapParameters()
    drift_m: float = 0.0
    drift_slope_rad: float = 0.0

    @property
    def min_stair_riser_m(self) -> float:
        """Smallest step up or down, m, that is one of stairs."""
        return self.map.min_riser_m - _RISER_MARGIN_M

    @property
    def min_step_height_m(self) -> float:
        """Smallest step up or down, m, that is an edge: halfway between a kerb and the lowest riser of stairs."""
        return 0.5 * (KERB_M + self.map.min_riser_m)
