"""The kinds of parts and their parameters, in SI and radians; files use the units of data sheets."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stridetwin.sim.parts.figure import DEG, G, figure, numbers, word


@dataclass(frozen=True, kw_only=True)
class Part:
    """Parameters of every part.

    Attributes:
        name: Name of the part.
        description: Manufacturer and type.
        rate_hz: Sample rate.
        mass_kg: Mass as worn, with its case; 0 if unknown.
    """

    name: str
    description: str
    rate_hz: float = figure("rate_hz", 1, 2000)
    mass_kg: float = figure("mass_g", 0, 5000, scale=1e-3, default=0.0)


@dataclass(frozen=True, kw_only=True)
class Gyroscope:
    """Three gyroscopes.

    Attributes:
        noise_density: rad/s/√Hz (IEEE Std 952: the angle random walk N).
        bias_instability: rad/s, the flat bottom of the Allan deviation.
        random_walk: rad/s²/√Hz (IEEE Std 952: the rate random walk K).
        turn_on_bias: Standard deviation from one start to the next, rad/s.
        scale_factor: Standard deviation, a fraction.
        misalignment: Standard deviation of each axis towards each of the others, rad.
        g_sensitivity: Standard deviation of the rate error caused by a specific force, rad/s per m/s².
        range: rad/s.
        bandwidth_hz: −3 dB.
        resolution: One count, rad/s; 0 for none.
        delay_s: How much earlier than its stamp the motion of a sample is, as the filter of a driver makes it; the
            delay of `bandwidth_hz` is no part of it.
        warm_up: Standard deviation of the change of the bias until the part is warm, rad/s; with a time constant of
            five minutes.
    """

    noise_density: float = figure("noise_density_dps_per_rthz", 0, 1, scale=DEG, ideal=0.0)
    bias_instability: float = figure("bias_instability_deg_per_h", 0, 3600, scale=DEG / 3600, ideal=0.0)
    random_walk: float = figure("random_walk_deg_per_h_per_rts", 0, 600, scale=DEG / 3600, ideal=0.0, default=0.0)
    turn_on_bias: float = figure("turn_on_bias_dps", 0, 30, scale=DEG, ideal=0.0)
    scale_factor: float = figure("scale_factor_pct", 0, 10, scale=0.01, ideal=0.0, default=0.0)
    misalignment: float = figure("misalignment_deg", 0, 5, scale=DEG, ideal=0.0, default=0.0)
    g_sensitivity: float = figure("g_sensitivity_dps_per_g", 0, 1, scale=DEG / G, ideal=0.0, default=0.0)
    range: float = figure("range_dps", 50, 10000, scale=DEG, ideal=math.inf)
    bandwidth_hz: float = figure("bandwidth_hz", 5, 2000, ideal=math.inf)
    resolution: float = figure("resolution_dps", 0, 1, scale=DEG, ideal=0.0, default=0.0)
    delay_s: float = figure("delay_ms", 0, 50, scale=1e-3, ideal=0.0, default=0.0)
    warm_up: float = figure("warm_up_dps", 0, 30, scale=DEG, ideal=0.0, default=0.0)


@dataclass(frozen=True, kw_only=True)
class Accelerometer:
    """Three accelerometers.

    Attributes:
        noise_density: m/s²/√Hz, the velocity random walk.
        bias_instability: m/s², the flat bottom of the Allan deviation.
        random_walk: m/s³/√Hz.
        turn_on_bias: Standard deviation from one start to the next, m/s².
        scale_factor: Standard deviation, a fraction.
        misalignment: Standard deviation of each axis towards each of the others, rad.
        range: m/s².
        bandwidth_hz: −3 dB.
        resolution: One count, m/s²; 0 for none.
        delay_s: How much earlier than its stamp the motion of a sample is, as the filter of a driver makes it; the
            delay of `bandwidth_hz` is no part of it.
        warm_up: Standard deviation of the change of the bias until the part is warm, m/s²; with a time constant of five
            minutes.
    """

    noise_density: float = figure("noise_density_ug_per_rthz", 0, 10000, scale=1e-6 * G, ideal=0.0)
    bias_instability: float = figure("bias_instability_ug", 0, 10000, scale=1e-6 * G, ideal=0.0)
    random_walk: float = figure("random_walk_ug_per_rts", 0, 1000, scale=1e-6 * G, ideal=0.0, default=0.0)
    turn_on_bias: float = figure("turn_on_bias_mg", 0, 300, scale=1e-3 * G, ideal=0.0)
    scale_factor: float = figure("scale_factor_pct", 0, 10, scale=0.01, ideal=0.0, default=0.0)
    misalignment: float = figure("misalignment_deg", 0, 5, scale=DEG, ideal=0.0, default=0.0)
    range: float = figure("range_g", 1, 500, scale=G, ideal=math.inf)
    bandwidth_hz: float = figure("bandwidth_hz", 5, 2000, ideal=math.inf)
    resolution: float = figure("resolution_mg", 0, 50, scale=1e-3 * G, ideal=0.0, default=0.0)
    delay_s: float = figure("delay_ms", 0, 50, scale=1e-3, ideal=0.0, default=0.0)
    warm_up: float = figure("warm_up_mg", 0, 300, scale=1e-3 * G, ideal=0.0, default=0.0)


@dataclass(frozen=True, kw_only=True)
class ImuPart(Part):
    """Inertial measurement unit."""

    gyroscope: Gyroscope
    accelerometer: Accelerometer


@dataclass(frozen=True, kw_only=True)
class AhrsPart(Part):
    """Attitude and heading reference without magnetometer, as Shim et al. 2019 use theirs.

    Attributes:
        tilt_bias: Standard deviation of the constant error of roll and pitch, rad.
        tilt_still: Standard deviation of the varying error at rest, rad.
        tilt_moving: Standard deviation of the varying error in full motion, rad.
        heading_bias: Standard deviation of the heading at the start, rad.
        heading_drift: Largest drift, rad/s.
        heading_walk: rad/√s in full motion.
        rate_noise: Standard deviation of each rate, rad/s.
        rate_bias: Standard deviation of the residual bias of each rate after filtering, rad/s.
        rate_instability: Instability of that bias: flat bottom of its Allan deviation, rad/s.
    """

    tilt_bias: float = figure("tilt_bias_deg", 0, 10, scale=DEG, ideal=0.0)
    tilt_still: float = figure("tilt_still_deg", 0, 10, scale=DEG, ideal=0.0)
    tilt_moving: float = figure("tilt_moving_deg", 0, 20, scale=DEG, ideal=0.0)
    heading_bias: float = figure("heading_bias_deg", 0, 180, scale=DEG, ideal=0.0)
    heading_drift: float = figure("heading_drift_deg_per_min", 0, 60, scale=DEG / 60, ideal=0.0)
    heading_walk: float = figure("heading_walk_deg_per_rtmin", 0, 60, scale=DEG / math.sqrt(60), ideal=0.0, default=0.0)
    rate_noise: float = figure("rate_noise_dps", 0, 10, scale=DEG, ideal=0.0)
    rate_bias: float = figure("rate_bias_dps", 0, 10, scale=DEG, ideal=0.0, default=0.0)
    rate_instability: float = figure(
        "rate_bias_instability_deg_per_h", 0, 3600, scale=DEG / 3600, ideal=0.0, default=0.0
    )


@dataclass(frozen=True, kw_only=True)
class Imager:
    """Image sensor behind a lens.

    Attributes:
        width: Pixels.
        height: Pixels.
        focal: Focal length, pixels.
        distortion_model: Of the lens, `radtan` (Brown-Conrady) or `equidistant`.
        distortion: Its four coefficients.
        exposure_s: Exposure time; the longest one if exposure is automatic.
        auto_exposure_s: Time constant of the automatic exposure; 0 for a fixed one.
        shutter: `global` or `rolling`.
        readout_s: From the first row to the last of a rolling shutter.
        vignetting: Loss of light in the corners, a fraction.
        full_well: Electrons of a white pixel.
        read_noise: Standard deviation, electrons.
        colour: `colour` or `grey`.
    """

    width: float = figure("width_px", 16, 4096)
    height: float = figure("height_px", 16, 4096)
    focal: float = figure("focal_px", 10, 10000)
    distortion_model: str = word("distortion_model", "radtan", "equidistant")
    distortion: tuple[float, float, float, float] = numbers("distortion", 4, -2, 2)
    exposure_s: float = figure("exposure_ms", 0, 100, scale=1e-3, ideal=0.0)
    auto_exposure_s: float = figure("auto_exposure_s", 0, 10, ideal=0.0, default=0.0)
    shutter: str = word("shutter", "global", "rolling", ideal="global")
    readout_s: float = figure("readout_ms", 0, 50, scale=1e-3, ideal=0.0, default=0.0)
    vignetting: float = figure("vignetting_pct", 0, 95, scale=0.01, ideal=0.0, default=0.0)
    full_well: float = figure("full_well_e", 100, 1e6, ideal=math.inf)
    read_noise: float = figure("read_noise_e", 0, 1000, ideal=0.0)
    colour: str = word("pixels", "colour", "grey")

    @property
    def rolling_s(self) -> float:
        """Readout time of a rolling shutter, s; 0 for a global one."""
        return self.readout_s if self.shutter == "rolling" else 0.0


@dataclass(frozen=True, kw_only=True)
class DepthSensor:
    """Stereo depth, registered to the image.

    Attributes:
        range_min: m.
        range_max: m.
        noise: Standard deviation over z², 1/m.
        noise_px: Correlation length of the noise, pixels.
        disparity_step: Smallest step of the disparity over focal length and baseline, 1/m; 0 for none.
        resolution: One count, m; 0 for none.
        edge_px: Pixels beside a depth discontinuity where depth is missing or between the two surfaces.
        slant: Angle between line of sight and surface below which there is no stereo match, rad.
        dark: Grey value, a fraction of white, below which there is no stereo match.
    """

    range_min: float = figure("range_min_m", 0, 10)
    range_max: float = figure("range_max_m", 0.5, 100)
    noise: float = figure("noise_per_m", 0, 0.1, ideal=0.0)
    noise_px: float = figure("noise_correlation_px", 1, 32, default=1.0)
    disparity_step: float = figure("disparity_step_per_m", 0, 0.1, ideal=0.0, default=0.0)
    resolution: float = figure("resolution_mm", 0, 100, scale=1e-3, ideal=0.0, default=0.0)
    edge_px: float = figure("edge_px", 0, 16, ideal=0.0, default=0.0)
    slant: float = figure("slant_deg", 0, 45, scale=DEG, ideal=0.0, default=0.0)
    dark: float = figure("dark_pct", 0, 100, scale=0.01, ideal=0.0, default=0.0)


@dataclass(frozen=True, kw_only=True)
class CameraPart(Part):
    """Camera without depth."""

    imager: Imager


@dataclass(frozen=True, kw_only=True)
class RgbdPart(Part):
    """Camera with depth."""

    imager: Imager
    depth: DepthSensor


@dataclass(frozen=True, kw_only=True)
class SonarPart(Part):
    """Ultrasonic ranger.

    Attributes:
        beam: Full width of the cone, rad.
        range_min: m.
        range_max: m.
        step: One count, m; 0 for none.
        noise: Standard deviation before counting, m.
        ghost: Probability that a reading comes from an indirect echo.
    """

    beam: float = figure("beam_deg", 1, 170, scale=DEG)
    range_min: float = figure("range_min_m", 0, 5, ideal=0.0, default=0.0)
    range_max: float = figure("range_max_m", 0.1, 50)
    step: float = figure("step_mm", 0, 1000, scale=1e-3, ideal=0.0, default=0.0)
    noise: float = figure("noise_mm", 0, 1000, scale=1e-3, ideal=0.0)
    ghost: float = figure("ghost_pct", 0, 100, scale=0.01, ideal=0.0, default=0.0)


@dataclass(frozen=True, kw_only=True)
class EncoderPart(Part):
    """Absolute encoder.

    Attributes:
        bits: Resolution in bits per turn; 0 for no quantisation.
        nonlinearity: Largest error over a turn, rad.
        index_offset: Standard deviation of the zero position, rad.
    """

    bits: float = figure("resolution_bits", 0, 32, ideal=0.0)
    nonlinearity: float = figure("accuracy_deg", 0, 10, scale=DEG, ideal=0.0)
    index_offset: float = figure("index_offset_deg", 0, 30, scale=DEG, ideal=0.0, default=0.0)


@dataclass(frozen=True, kw_only=True)
class ForceCellPart(Part):
    """Force-sensing resistor with its converter and filter.

    Attributes:
        range: N.
        curve: (b1, b2) of the calibration, force in kgf = b1 x + b2 x², x = counts / 1000; zeros: no counting.
        hysteresis: Width of the loop between loading and unloading, a fraction of the force.
        drift: Creep under constant load, a fraction of it per decade of time.
        gain: Standard deviation of a cell's sensitivity, a fraction (repeatability and linearity).
        noise: Standard deviation, N.
        filter_hz: Cut-off of the second-order Butterworth filter behind it.
        preload: Preload of a cell under a strap, N.
    """

    range: float = figure("range_kgf", 0.1, 1000, scale=G, ideal=math.inf)
    curve: tuple[float, float] = numbers("calibration_kgf", 2, -100, 100, ideal=(0.0, 0.0))
    hysteresis: float = figure("hysteresis_pct", 0, 30, scale=0.01, ideal=0.0, default=0.0)
    drift: float = figure("drift_pct_per_decade", 0, 30, scale=0.01, ideal=0.0, default=0.0)
    gain: float = figure("gain_pct", 0, 30, scale=0.01, ideal=0.0, default=0.0)
    noise: float = figure("noise_n", 0, 50, ideal=0.0)
    filter_hz: float = figure("filter_hz", 1, 1000, ideal=math.inf)
    preload: float = figure("preload_n", 0, 100, default=0.0)


@dataclass(frozen=True, kw_only=True)
class ActuatorPart(Part):
    """Measured torque and speed of an actuation module: standard deviations, N m and rad/s."""

    torque_noise: float = figure("torque_noise_nm", 0, 50, ideal=0.0)
    speed_noise: float = figure("speed_noise_radps", 0, 10, ideal=0.0)


PART_CLASSES: dict[str, type[Part]] = {
    "imu": ImuPart,
    "ahrs": AhrsPart,
    "camera": CameraPart,
    "rgbd": RgbdPart,
    "sonar": SonarPart,
    "encoder": EncoderPart,
    "force_cell": ForceCellPart,
    "actuator": ActuatorPart,
}
