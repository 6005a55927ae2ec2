"""Parameters of the odometry that users may change, and the published methods as choices of factors.

Numbers that no user needs are constants of the modules that use them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from stridetwin.estimators.base import PROPOSED
from stridetwin.streams.errors import ConfigError, check_numbers
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2

HOST_DEPTHS = ("none", "fixed", "factor")
CALIBRATIONS = NOMINAL, MOUNT_AND_CLOCK, ALL = ("nominal", "mount_and_clock", "all")


@dataclass(frozen=True, kw_only=True)
class DvioMethod:
    """Choice of factors and extensions; the defaults are the proposed method, `METHODS` has the published ones."""

    host_depth: str = "factor"
    """Use of the depth that its host frame measures of a landmark: `none`, `fixed` (the landmark keeps it), or `factor`
    (docs/dvio.md (8))."""
    projection_depth: bool = True
    """Whether the depths that other frames measure are used (docs/dvio.md (9))."""
    host_depth_in_prior: bool = True
    """Whether docs/dvio.md (8) is marginalised into the prior; Zhao et al. 2023 drop it."""
    first_estimates: bool = True
    """Whether Jacobians of frames in the prior are kept at the first linearisation point (Huang et al. 2010)."""
    calibration: str = ALL
    """What is refined: `nominal` (nothing), `mount_and_clock`, or `all`: also the depth scale and the focal lengths,
    the mount with the heavy-tailed prior of docs/dvio.md (13), a clock that is far off, docs/dvio.md (16), and the
    scale of the accelerometer, docs/dvio.md (17)."""
    zero_velocity_updates: bool = True
    """Whether a stationary sensor is a measurement of the velocity."""
    imu_noise_from_images: bool = True
    """Whether the noise of the IMU becomes larger where images show that it is (docs/dvio.md (15))."""
    level_ground: bool = True
    """Whether planes in depth images are used: ground that looks level measures the tilt (docs/dvio.md (12)), and all
    planes measure the motion where images show nothing, docs/dvio.md (18)."""
    anchored: bool = True
    """Whether a point is aligned with the patch of its host frame, so that tracking does not drift."""
    steps: int = 1
    """Optimisation steps per frame; a keyframe has three."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is out of range."""
        for name, values in (("host_depth", HOST_DEPTHS), ("calibration", CALIBRATIONS)):
            if getattr(self, name) not in values:
                raise ConfigError("DvioMethod", name, getattr(self, name), ", ".join(values))
        check_numbers("DvioMethod", {"steps": self.steps})

    @property
    def refines_all(self) -> bool:
        """Whether every calibration is refined, also those that may be far off."""
        return self.calibration == ALL

    @property
    def uses_depth(self) -> bool:
        """Whether any factor reads measured depth."""
        return self.host_depth != "none" or self.projection_depth


@dataclass(frozen=True, kw_only=True)
class DvioParameters:
    """Parameters of the odometry; one set serves head and chest, every gait and room.

    Values without another origin were chosen by hand on twin walks of tuning seeds, below 1000. Standard deviations of
    noise are larger than at one instant: errors of one source (a patch, an axis of the IMU) are correlated in time, and
    the window treats them as independent.

    "Doubled" is the change of the mean APE, 7.3 mm, of two such walks (`dvio_walk`, seed 3; `dvio_stairs`, seed 4) with
    twice the value: two walks resolve only large effects. "None" is less than 1 %.
    """

    pixel_noise_px: float = 0.35
    """Noise of an observed point, px. Doubled: + 22 %; images count less against depth and IMU."""
    inverse_depth_sd_per_m: float = 0.007
    """Noise of a measured inverse depth, 1/m: at a depth z, that of the depth is z² times this. Later frames of a point
    have twice as much, because their errors are correlated with the first one's. The D435's product page has less than
    2 % at 2 m, 0.01/m. Doubled: + 35 %; the scale is less certain, and passers-by at another depth are kept longer."""
    imu_noise_factor: float = 5.6
    """Noise of the IMU at the start, in multiples of the data sheet's, for scale errors, misalignment and vibration;
    images only raise it. Doubled: + 16 %; larger covariances in dead reckoning."""
    extrinsic_position_sd_m: float = 2e-3
    """Error of the camera's calibrated position on the IMU, m; 0: exactly known. Doubled: none."""
    extrinsic_rotation_sd_rad: float = 5e-3
    """Error of its calibrated rotation, rad; 0: exactly known. Doubled: + 1 %; in a plain corridor a wrong rotation
    explains the first images more easily."""
    time_offset_sd_s: float = 5e-3
    """Error of the camera's clock, s; 0: exactly known. Doubled: none with a clock that is 1 ms off."""
    level_ground_sd_rad: float = 3e-3
    """How level ground is as built, rad: DIN 18202 allows 10 mm over 4 m. Its measured normal errs by 1 mrad.
    Doubled: + 5 %, and + 14 % of the height error."""
    gravity_mps2: float = NOMINAL_GRAVITY_MPS2
    """Local gravity, m/s²: 9.78 at the equator, 9.83 at the poles. With 9.83 instead of the walks' 9.81: + 3 %."""
    min_depth_m: float = 0.3
    """Nearest depth used, m: the D435's product page has 0.3 to 3 m as ideal. Doubled: none where nothing is nearer
    than 0.6 m."""
    max_depth_m: float = 6.5
    """Farthest depth used, m: the D435's farther depths are too noisy. Doubled: none with a sensor that ends at 6 m."""
    stationary_rate_sd_radps: float = 0.02
    """Largest scatter of the rate of a stationary sensor within 0.25 s, rad/s. Doubled: none; slow turns count
    as stationary more often, unless points move in the images."""
    stationary_force_sd_mps2: float = 0.15
    """Largest scatter of the specific force of a stationary sensor within 0.25 s, m/s². Doubled: none, likewise."""
    keyframes: int = 9
    """Keyframes in the window, in addition to the newest frame; at least 3. Doubled: + 120 %, and 15 % more time."""
    landmarks: int = 90
    """Points tracked at a time, as far as an image has so many corners; the window holds 256, tracked or not. Doubled:
    + 7 %."""
    max_depth_wait_s: float = 0.05
    """Longest wait for the depth image of a colour image, s. Doubled: none, unless depth images are late."""
    method: DvioMethod = DvioMethod()
    """Which factors and extensions are used."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is out of range."""
        may_be_zero = {"extrinsic_position_sd_m", "extrinsic_rotation_sd_rad", "time_offset_sd_s"}
        check_numbers("DvioParameters", {n: v for n, v in vars(self).items() if n != "method"}, may_be_zero)
        if self.keyframes < 3:
            raise ConfigError("DvioParameters", "keyframes", self.keyframes, "a whole number ≥ 3")
        if self.min_depth_m >= self.max_depth_m:
            raise ConfigError("DvioParameters", "min_depth_m", self.min_depth_m, "less than max_depth_m")


# Zhao et al. 2023 refine no calibration; VINS-Mono and VINS-RGBD refine the mount and the camera's clock
# (`estimate_extrinsic: 1`, `estimate_td: 1`).
_DVIO = DvioMethod(
    host_depth_in_prior=False,
    first_estimates=False,
    calibration=NOMINAL,
    zero_velocity_updates=False,
    imu_noise_from_images=False,
    level_ground=False,
    anchored=False,
    steps=2,
)
_VINS = replace(_DVIO, calibration=MOUNT_AND_CLOCK, projection_depth=False)
METHODS: dict[str, DvioParameters] = {
    PROPOSED: DvioParameters(),
    "dvio": DvioParameters(method=_DVIO),
    "vins_rgbd": DvioParameters(method=replace(_VINS, host_depth="fixed")),
    "vins_mono": DvioParameters(method=replace(_VINS, host_depth="none")),
}
"""The proposed method; Zhao et al. 2023; and its ablations in the manner of Shan et al. 2019 and of Qin et al. 2018."""


def method_parameters(method: str) -> DvioParameters:
    """The parameters of a method by its name.

    Raises:
        ConfigError: Unknown method; the message lists the available ones.
    """
    if method not in METHODS:
        raise ConfigError("Dvio", "method", method, ", ".join(METHODS))
    return METHODS[method]
