"""Parameters of the contact terrain estimator for walkers, sensors and buildings.

The exoskeleton's own compliance is `geometry.Compliance`.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import NamedTuple

from stridetwin.streams.errors import ConfigError, check_numbers


class AttitudeNoise(NamedTuple):
    """Noise model of the five attitudes, in the form for compiled code."""

    stationary_sd_rad: float = math.radians(0.15)
    """Standard deviation of an AHRS's tilt at rest: `tilt_still_deg` of sim/parts/MW-AHRSv1.yaml."""
    moving_sd_rad: float = math.radians(0.9)
    """The same in full motion: `tilt_moving_deg` of the same part."""
    full_motion_radps: float = 2.0
    """Angular rate from which on the motion is full; hand-chosen on the tuning walks."""
    correlation_s: float = 2.0
    """Correlation time of the tilt error; hand-chosen on the tuning walks."""
    drift_rad_per_sqrt_s: float = math.radians(0.03)
    """Random walk of an integrated rate by noise, bias and scale; hand-chosen on the tuning walks."""
    lost_sd_rad: float = math.radians(0.15)
    """Motion of a limb that one lost sample hides; hand-chosen on the tuning walks."""


@dataclass(frozen=True, kw_only=True)
class TickParameters:
    """Joining of samples of several streams into one tick."""

    hold_s: float = 0.06
    """A late stream is extrapolated for this long; six samples at 100 Hz, hand-chosen."""
    together_s: float = 0.003
    """Largest difference of the time stamps of one instant; a third of the period at 100 Hz."""
    rate_max_radps: float = 50.0
    """A faster AHRS sample counts as lost: beyond the range of any gyro on a limb."""
    norm_error_max: float = 0.02
    """A quaternion whose squared norm differs from 1 by more counts as lost: 32-bit rounding is far below."""
    force_max_n: float = 5000.0
    """A larger force on a cell counts as lost: several times a running person's weight."""


@dataclass(frozen=True, kw_only=True)
class CellParameters:
    """Loads from the cells of an insole; hand-chosen on the tuning walks."""

    rotating_radps: float = 1.0
    """A foot that rotates faster may be in the air."""
    alive_n: float = 40.0
    """A cell whose force changes less within strides is dead or stuck."""
    stride_s: float = 0.6
    """Rotating time of somewhat more than one stride."""


@dataclass(frozen=True, kw_only=True)
class FootfallParameters:
    """When a foot is on the ground and when it lies flat; hand-chosen on the tuning walks."""

    landed_n: float = 60.0
    """Load above which a foot has landed: cells that creep report up to 40 N of a foot in the air."""
    left_n: float = 40.0
    """Load below which a foot has left."""
    bounce_s: float = 0.12
    """A foot that touches down again sooner has not left the ground."""
    toes_down_rad: float = math.radians(8.0)
    """A foot pitched down by more at touch-down lands on the forefoot."""
    flat_radps: float = 0.6
    """A foot that rotates faster is not flat."""
    stationary_radps: float = 0.2
    """At this rate the attitude of a flat foot has half its weight."""
    shared_weight: float = 0.05
    """Weight of a flat foot's attitude while the other foot carries load too."""
    strained_weight: float = 0.02
    """Weight of a flat foot's attitude while its ankle is at a stop."""
    free_weight: float = 1.0
    """Sum of the other weights at which attitudes with the ankle at a stop are not needed."""
    heel_rises_rad: float = math.radians(1.5)
    """A foot pitched down by this relative to its flat attitude is lifting its heel."""
    flat_ticks: int = 6
    """Ticks for which a foot has to be flat before its slope is estimated."""
    loaded_n: float = 100.0
    """Load from which on a foot counts as carrying weight."""
    both_n: float = 150.0
    """Load on both feet from which on a tick has full weight."""
    single_support_n: float = 300.0
    """The load in single support is above this."""
    swing_radps: float = 3.0
    """A foot on the ground seldom rotates faster."""
    crept_share: float = 0.15
    """Share of the other foot's load that the cells of a foot in the air may report together."""
    landing_radps: float = 0.7
    """Angular rate at which a foot that landed on its heel has half its weight."""


@dataclass(frozen=True, kw_only=True)
class OffsetParameters:
    """Prior of the constant offsets, and of the ground under consecutive footprints."""

    rotation_sd_rad: float = math.radians(0.6)
    """Misalignment of an AHRS: tolerance of a calibration in standing; hand-chosen on the tuning walks."""
    knee_sd_rad: float = math.radians(0.3)
    """Zero of a knee encoder, likewise."""
    length_sd_m: float = 0.003
    """Length of a thigh or shank, likewise."""
    rotation_walk_rad: float = math.radians(0.05)
    """Change of an attitude's offset from step to step; hand-chosen on the tuning walks."""
    plane_sd_m: float = 0.002
    """Unevenness of floors in height; hand-chosen."""
    parallel_sd_rad: float = math.radians(0.2)
    """Unevenness of floors in slope; hand-chosen."""
    one_plane_share: float = 0.85
    """Share of steps whose footprint lies in the plane of the one before; hand-chosen."""
    plane_spread_m_rad: float = 0.25 * math.radians(15.0)
    """Volume over which the residuals of other steps are spread: 0.25 m times 15° of slope change (buildings)."""
    level_share: float = 0.6
    """Share of footprints on level ground; hand-chosen."""
    level_sd_rad: float = math.radians(0.2)
    """Standard deviation of the slope of such ground; hand-chosen."""
    level_spread_rad: float = math.radians(30.0)
    """Range over which the slopes of other ground are spread (buildings)."""


@dataclass(frozen=True, kw_only=True)
class ClassParameters:
    """Locomotion modes from geometry: every threshold but the last is a dimension in the world."""

    ramp_rad: float = math.radians(2.5)
    """Ground that slopes more is a ramp: half of the gentlest ramp that is built, 5°."""
    tread_ramp_rad: float = 2.0 * math.radians(2.5)
    """Slope above which the ground beyond a riser is a ramp: most such ground is a tread."""
    riser_m: float = 0.055
    """A footprint farther from the height that slopes explain is on a stair: between a kerb, 40 mm, and 70 mm."""
    probability_min: float = 0.70
    """A class less likely than this is `unknown`; hand-chosen on the tuning walks."""


@dataclass(frozen=True, kw_only=True)
class PublishedParameters:
    """Values that Shim et al. 2019 do not specify; chosen by hand, docs/contact_terrain.md lists the reasons."""

    pressing_n: float = 60.0
    """A foot with less on all cells together is off the ground: cells that creep report up to 40 N in the air."""
    rotating_radps: float = 0.8
    """A foot that rotates faster is not flat, unless its centre of pressure is in the middle."""
    heel_share: float = 0.35
    """The heel side ends at this share of the way from the heel's cell to the toe's."""
    front_share: float = 0.65
    """The front begins at this share of the same way."""
    markers_min: int = 10
    """Smallest number of markers for a plane fit."""
    svm_c: float = 100.0
    """Penalty C of the support vector machine."""
    svm_gamma: float = 10.0
    """Width γ of its radial basis function, per squared share of the largest slope and elevation."""
    virtual_m: float = 0.05
    """Distance from a marker to its virtual one, to the inner side of the foot."""


@dataclass(frozen=True, kw_only=True)
class ContactTerrainParameters:
    """One set serves every exoskeleton, wearer and building.

    Values called "hand-chosen on the tuning walks" were set on simulated walks of S1-S3, seeds 0-16
    (docs/contact_terrain.md); no program fitted them.

    Attributes:
        attitudes: Fusion of AHRS and gyros.
        ticks: Joining of the streams.
        cells: Loads from the insoles' cells.
        footfall: Contact and foot-flat.
        offsets: Prior of the offsets and of the ground.
        classes: Locomotion modes.
        published: Parameters of the published method only.
    """

    attitudes: AttitudeNoise = field(default_factory=AttitudeNoise)
    ticks: TickParameters = TickParameters()
    cells: CellParameters = CellParameters()
    footfall: FootfallParameters = FootfallParameters()
    offsets: OffsetParameters = OffsetParameters()
    classes: ClassParameters = ClassParameters()
    published: PublishedParameters = PublishedParameters()

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number above 0, or a share or an order makes no sense."""
        groups = {name: group for name, group in vars(self).items() if name != "attitudes"}
        values = {"attitudes": self.attitudes._asdict(), **{name: asdict(group) for name, group in groups.items()}}
        for name, group in values.items():
            check_numbers(f"ContactTerrainParameters.{name}", group)
        for name, key in (("offsets", "one_plane_share"), ("offsets", "level_share"), ("classes", "probability_min")):
            if values[name][key] >= 1.0:
                raise ConfigError(f"ContactTerrainParameters.{name}", key, values[name][key], "a number below 1")
        if self.footfall.left_n > self.footfall.landed_n:
            raise ConfigError(
                "ContactTerrainParameters.footfall", "left_n", self.footfall.left_n, "no more than landed_n"
            )


DEFAULTS = ContactTerrainParameters()
