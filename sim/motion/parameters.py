"""Parameters of the way from a recording to a motion."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class MotionParameters:
    """How markers are fitted, rests are found, and gaps, noise and cuts are smoothed.

    Chosen on the three recordings of `docs/people.md`, unless another origin is given.

    Attributes:
        marker_sd_m: Scatter of a marker about its place on the body: skin and marker noise (Cappozzo et al. 1996 have
            5-20 mm on the thigh).
        outlier_m: Residual from which a marker counts less (Huber 1964).
        cutoff_hz: Frequency at which the smoothing of the legs' joints passes one half, so that landings are kept.
        trunk_cutoff_hz: That of pelvis, trunk and arms: that of Butterworth filters of gait, 6-8 Hz.
        limit_sd_rad: Stiffness of the joint limits, as a standard deviation beyond them.
        posture_sd_rad: Scatter of joint angles about standing; it decides where no marker does.
        calibration_frames: Most frames from which lengths and places are fitted.
        calibration_rounds: Gauss-Newton steps of that fit.
        rounds: Gauss-Newton steps of the fit of a whole recording.
        foot_sd_m: Scatter of the feet about their corrected paths.
        follow_hz: Frequency up to which the trunk follows what the feet are corrected.
        leg_follow_hz: Frequency up to which the joints of the legs do; the feet are where they have to be in any case.
        still_mps: Speed below which a point of the sole rests.
        moving_mps: Speed above which it has certainly left its rest.
        min_rest_s: Shortest rest.
        flat_m: Height of the heel over the ball, beyond the usual one in a rest, from which a sole is no longer flat.
        same_place_m, same_rest_s: Way and time of a foot between two rests that are still one.
        max_rise_m: Height above its stance at which a point is no longer on the ground.
        ramp_s: Time in which a foot passes from its recorded path to its rest.
        soft_m: Depth by which the border of a sole may give way in the ground.
        lift_sd_m: Depth into the ground that is left to a foot.
        riser_m: Least difference of height of two rests that is a riser; lower ones are errors or thresholds.
        min_slope_rad: Least inclination that is a ramp.
        edge_margin_m: Play of the sole at the edge of a tread, while risers are placed.
        fade_s: Time in which one cycle of a loop passes to the next.
        min_cycle_s: Shortest cycle that may be looped.
        max_gap_s: Longest time without a marker that is interpolated.
    """

    marker_sd_m: float = 0.006
    outlier_m: float = 0.025
    cutoff_hz: float = 12.0
    trunk_cutoff_hz: float = 7.0
    limit_sd_rad: float = 0.02
    posture_sd_rad: float = 0.6
    calibration_frames: int = 90
    calibration_rounds: int = 8
    rounds: int = 4
    foot_sd_m: float = 0.0001
    follow_hz: float = 1.5
    leg_follow_hz: float = 5.0
    still_mps: float = 0.25
    moving_mps: float = 0.60
    min_rest_s: float = 0.06
    flat_m: float = 0.006
    same_place_m: float = 0.04
    same_rest_s: float = 0.30
    max_rise_m: float = 0.012
    ramp_s: float = 0.16
    soft_m: float = 0.0035
    lift_sd_m: float = 0.0005
    riser_m: float = 0.04
    min_slope_rad: float = 0.04
    edge_margin_m: float = 0.01
    fade_s: float = 0.20
    min_cycle_s: float = 0.6
    max_gap_s: float = 0.25
