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

    Further such values are constants of the modules that use them.

    "Doubled" is what twice the value does on the walks of `ContactTerrainParameters`, where the slope is 1.07° off and
    the elevation 8.1 mm (RMS).
    """

    pressing_n: float = 60.0
    """A foot with less on all cells together is off the ground: cells that creep report up to 40 N in the air.
    Doubled: 7.5 mm."""
    markers_min: int = 10
    """Smallest number of markers for a plane fit. Doubled: no difference."""
    virtual_m: float = 0.05
    """Distance from a marker to its virtual one, to the inner side of the foot. Doubled: 1.08°."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number above 0."""
        check_numbers("PublishedParameters", asdict(self))


@dataclass(frozen=True, kw_only=True)
class ContactTerrainParameters:
    """One set serves every exoskeleton, wearer and building; numbers that no user needs are constants of the modules.

    Values called "hand-chosen on the tuning walks" were set on simulated walks of S1-S3, seeds 0-16
    (docs/contact_terrain.md); no program fitted them.

    "Doubled" is what twice the value does to the RMS errors of `shim_building` (seed 3) and `shim_stairs` (seed 5),
    both kinematic: 0.137° in slope and 1.80 mm in elevation, with mean standard deviations of 0.18° and 3.15 mm, and
    every class right. What is not named changes by less than 2 %.
    """

    ahrs_stationary_sd_rad: float = math.radians(0.15)
    """Standard deviation of an AHRS's tilt at rest: `tilt_still_deg` of sim/parts/MW-AHRSv1.yaml. Doubled: 0.126°,
    1.73 mm."""
    ahrs_moving_sd_rad: float = math.radians(0.9)
    """Standard deviation of an AHRS's tilt in full motion: `tilt_moving_deg` of that part. Doubled: 1.84 mm."""
    ahrs_correlation_s: float = 2.0
    """Correlation time of the tilt error; hand-chosen on the tuning walks. Doubled: 0.128°."""
    gyro_drift_rad_per_sqrt_s: float = math.radians(0.03)
    """Random walk of an integrated rate by noise, bias and scale; hand-chosen on the tuning walks. Doubled: 0.152°,
    1.86 mm."""
    mount_rotation_sd_rad: float = math.radians(0.6)
    """Standard deviation of an AHRS's misalignment: tolerance of a calibration in standing; hand-chosen on the tuning
    walks. Doubled: 1.92 mm, standard deviation 3.24 mm."""
    knee_zero_sd_rad: float = math.radians(0.3)
    """Standard deviation of a knee encoder's zero; hand-chosen on the tuning walks. Doubled: 1.75 mm."""
    landed_n: float = 60.0
    """Load above which a foot has landed: cells that creep report up to 40 N of a foot in the air. Doubled: no
    difference; steps of less load are missed."""
    left_n: float = 40.0
    """Load below which a foot has left; hand-chosen on the tuning walks. At 60 N: no difference."""
    plane_sd_m: float = 0.002
    """Unevenness of floors in height; hand-chosen. Doubled: 0.160°, 1.89 mm, standard deviation 3.74 mm."""
    ramp_rad: float = math.radians(2.5)
    """Ground that slopes more is a ramp: half of the gentlest ramp that is built, 5°. Doubled: half of the ramps of
    5° are level ground."""
    riser_m: float = 0.055
    """A footprint farther from the height that slopes explain is on a stair: between a kerb, 40 mm, and 70 mm.
    Doubled: risers below 110 mm are level ground."""
    probability_min: float = 0.70
    """A class less likely than this is `unknown`; hand-chosen on the tuning walks. At half its distance from 1: no
    difference; noisier sensors yield more `unknown`."""
    published: PublishedParameters = PublishedParameters()
    """Parameters of the published method only."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number above 0, or makes no sense."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "published"}
        check_numbers("ContactTerrainParameters", values)
        if self.probability_min >= 1.0:
            raise ConfigError("ContactTerrainParameters", "probability_min", self.probability_min, "a number below 1")
        if self.left_n > self.landed_n:
            raise ConfigError("ContactTerrainParameters", "left_n", self.left_n, "no more than landed_n")


DEFAULTS = ContactTerrainParameters()
