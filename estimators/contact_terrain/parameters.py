"""Parameters of the contact terrain estimator for walkers, sensors and buildings.

The exoskeleton's own compliance is `geometry.Compliance`.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields

from stridetwin.streams.errors import ConfigError, check_numbers


@dataclass(frozen=True, kw_only=True)
class PublishedParameters:
    """Values that Shim et al. 2019 do not specify; chosen by hand, docs/contact_terrain.md lists the reasons.

    The last sentence of each says what twice the value does.
    """

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

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number above 0."""
        check_numbers("PublishedParameters", asdict(self))


@dataclass(frozen=True, kw_only=True)
class ContactTerrainParameters:
    """One set serves every exoskeleton, wearer and building.

    Values called "hand-chosen on the tuning walks" were set on simulated walks of S1-S3, seeds 0-16
    (docs/contact_terrain.md); no program fitted them. The last sentence of each says what twice the value does.
    """

    ahrs_stationary_sd_rad: float = math.radians(0.15)
    """Standard deviation of an AHRS's tilt at rest: `tilt_still_deg` of sim/parts/MW-AHRSv1.yaml."""
    ahrs_moving_sd_rad: float = math.radians(0.9)
    """The same in full motion: `tilt_moving_deg` of the same part."""
    ahrs_correlation_s: float = 2.0
    """Correlation time of the tilt error; hand-chosen on the tuning walks."""
    gyro_drift_rad_per_sqrt_s: float = math.radians(0.03)
    """Random walk of an integrated rate by noise, bias and scale; hand-chosen on the tuning walks."""
    mount_rotation_sd_rad: float = math.radians(0.6)
    """Misalignment of an AHRS: tolerance of a calibration in standing; hand-chosen on the tuning walks."""
    knee_zero_sd_rad: float = math.radians(0.3)
    """Zero of a knee encoder, likewise."""
    segment_length_sd_m: float = 0.003
    """Length of a thigh or shank, likewise."""
    landed_n: float = 60.0
    """Load above which a foot has landed: cells that creep report up to 40 N of a foot in the air."""
    left_n: float = 40.0
    """Load below which a foot has left."""
    one_plane_share: float = 0.85
    """Share of steps whose footprint lies in the plane of the one before; hand-chosen."""
    plane_sd_m: float = 0.002
    """Unevenness of floors in height; hand-chosen."""
    parallel_sd_rad: float = math.radians(0.2)
    """Unevenness of floors in slope; hand-chosen."""
    level_share: float = 0.6
    """Share of footprints on level ground; hand-chosen."""
    ramp_rad: float = math.radians(2.5)
    """Ground that slopes more is a ramp: half of the gentlest ramp that is built, 5°."""
    tread_ramp_rad: float = 2.0 * math.radians(2.5)
    """Slope above which the ground beyond a riser is a ramp: most such ground is a tread."""
    riser_m: float = 0.055
    """A footprint farther from the height that slopes explain is on a stair: between a kerb, 40 mm, and 70 mm."""
    probability_min: float = 0.70
    """A class less likely than this is `unknown`; hand-chosen on the tuning walks."""
    published: PublishedParameters = PublishedParameters()
    """Parameters of the published method only."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number above 0, or a share or an order makes no sense."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "published"}
        check_numbers("ContactTerrainParameters", values)
        for name in ("one_plane_share", "level_share", "probability_min"):
            if values[name] >= 1.0:
                raise ConfigError("ContactTerrainParameters", name, values[name], "a number below 1")
        if self.left_n > self.landed_n:
            raise ConfigError("ContactTerrainParameters", "left_n", self.left_n, "no more than landed_n")


DEFAULTS = ContactTerrainParameters()
