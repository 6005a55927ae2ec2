"""What the odometry believes about any rig, and the published methods as choices of terms."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from stridetwin.estimators.dvio.memory import ImuNoise
from stridetwin.estimators.dvio.terms import Terms
from stridetwin.estimators.methods import PROPOSED, current_name
from stridetwin.streams.errors import ConfigError, check_numbers
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.rig import ImuCalibration

HOST_DEPTHS = ("none", "fixed", "factor")


@dataclass(frozen=True, kw_only=True)
class DvioParameters:
    """One set serves head and chest, every gait and room; the defaults are ours.

    Standard deviations are larger than at one instant: errors of one source last (of a patch, of an axis of the IMU),
    and the window takes them as independent.

    Attributes:
        keyframes: In the window, beside the newest frame.
        landmarks: Followed at a time.
        landmark_slots: Landmarks in the window, followed or not.
        steps: Of the optimisation at each frame.
        keyframe_steps: At each keyframe.
        enough: Stop where a step lowers the cost by less than this share.
        keyframe_parallax_px: Mean motion of points that makes a frame a keyframe.
        keyframe_share: Or where less than this share of what the last keyframe saw is still followed.
        keyframe_s: Or after so long.
        host_depth: How the host's told depth of a landmark is used: `none` (never), `fixed` (the landmark keeps it),
            `factor` (11).
        projection_depth: Whether the depths told in the other frames are used (12).
        host_depth_in_prior: Whether (11) of a landmark goes into the prior with it; the paper drops it.
        first_estimates: Jacobians of frames that the prior speaks of stay where they were first taken.
        standing: Whether a sensor that seems to stand is told to.
        sight_sd_px: Of a sighting.
        sight_limit: Standard deviations beyond which a sighting counts less.
        inverse_depth_sd: Of the inverse depth that the host is told, 1/m: that of a depth z is this times z².
        inverse_depth_again_sd: The same of the frames that see it later: many of them tell little more than a few.
        depth_limit: As `sight_limit`.
        depth_min: Nearest depth that counts, m.
        depth_max: Farthest, m.
        depth_edge: Difference of inverse depths about a point that makes an edge, 1/m.
        cull_sd: Sightings further off are removed, standard deviations.
        apart_sd: A point that is told so far from the depth that it should have is not followed, standard deviations.
        gate_px: A point that is seen further from where motion and depth have it is not followed.
        anchored: Whether a point is aligned with the patch of its host, where it is foreseen or was followed to.
        anchor_px: Largest move of this.
        anchor_likeness: Least correlation with the patch.
        forward_backward_px: Largest distance of a point followed there and back.
        corner_least: Cornerness of a new point, grey levels² a pixel².
        extrinsic_position_sd: How well the camera's place on the IMU is told, m; 0 takes it as told.
        extrinsic_rotation_sd: rad.
        time_offset_sd: Of the camera's clock, s.
        depth_scale_sd: Of the depth camera.
        focal_sd: Of the focal lengths, as a share of each.
        gravity: m/s².
        imu_noise_factor: Actual over told noise of the IMU, for scale errors, misalignment and vibration.
        walk_factor: The same of the walk of its biases.
        rate_share: Errors of the gyroscope's scale and axes, as noise by the rate itself, √s: 0.56 % over a second.
        gyro_bias_sd: Turn-on bias, rad/s, where the calibration has less.
        accel_bias_sd: Turn-on bias, m/s², where the calibration has less.
        doubtful_rate: Error of a rate that stands for missing or saturated ones, rad/s.
        doubtful_force: The same of a force, m/s².
        still_s: How long all must be quiet to stand.
        still_rate_sd: Largest scatter of the rate of a sensor that stands, rad/s.
        still_force_sd: Largest scatter of its force, m/s².
        still_speed_sd: Speed of a sensor that stands, m/s.
        align_s: In motion, longest wait for pictures to align with the IMU; then the mean force is taken as up.
        start_s: Span of that mean.
        max_gap_s: A longer gap of the IMU makes a new start.
        planes: Whether floors and walls that the depth picture shows are states too.
        plane_depth_max: Farthest depth that counts for them, m; below the sensor's range.
        plane_doubt: Error of a plane in one picture beyond the noise of its depths: of its direction, rad, and of its
            distance, as a share.
        plane_limit: As `sight_limit`.
        feet: Whether the legs of an exoskeleton tell the speed, where the camera sees little.
        feet_speed_sd: Of the speed of the camera about that of the trunk, m/s.
        wait_s: Longest wait for the depth picture of a colour picture.
    """

    keyframes: int = 9
    landmarks: int = 90
    landmark_slots: int = 256
    steps: int = 1
    keyframe_steps: int = 3
    enough: float = 1e-3
    keyframe_parallax_px: float = 18.0
    keyframe_share: float = 0.6
    keyframe_s: float = 0.4
    host_depth: str = "factor"
    projection_depth: bool = True
    host_depth_in_prior: bool = True
    first_estimates: bool = True
    standing: bool = True
    sight_sd_px: float = 0.35
    sight_limit: float = 1.05
    inverse_depth_sd: float = 0.007
    inverse_depth_again_sd: float = 0.014
    depth_limit: float = 1.05
    depth_min: float = 0.3
    depth_max: float = 6.5
    depth_edge: float = 0.04
    cull_sd: float = 3.5
    apart_sd: float = 5.0
    gate_px: float = 3.0
    anchored: bool = True
    anchor_px: float = 2.0
    anchor_likeness: float = 0.8
    forward_backward_px: float = 0.7
    corner_least: float = 6.0
    extrinsic_position_sd: float = 2e-3
    extrinsic_rotation_sd: float = 5e-3
    time_offset_sd: float = 5e-3
    depth_scale_sd: float = 6e-3
    focal_sd: float = 2e-3
    gravity: float = NOMINAL_GRAVITY_MPS2
    imu_noise_factor: float = 5.6
    walk_factor: float = 4.2
    rate_share: float = 5.6e-3
    gyro_bias_sd: float = 0.01
    accel_bias_sd: float = 0.1
    doubtful_rate: float = 1.0
    doubtful_force: float = 5.0
    still_s: float = 0.25
    still_rate_sd: float = 0.02
    still_force_sd: float = 0.15
    still_speed_sd: float = 0.01
    align_s: float = 3.0
    start_s: float = 1.0
    max_gap_s: float = 0.5
    planes: bool = False
    plane_depth_max: float = 5.0
    plane_doubt: float = 3e-3
    plane_limit: float = 2.5
    feet: bool = False
    feet_speed_sd: float = 0.2
    wait_s: float = 0.05

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is out of range."""
        if self.host_depth not in HOST_DEPTHS:
            raise ConfigError("DvioParameters", "host_depth", self.host_depth, ", ".join(HOST_DEPTHS))
        numbers = {f.name: v for f in fields(self) if not isinstance(v := getattr(self, f.name), bool | str)}
        told = {"extrinsic_position_sd", "extrinsic_rotation_sd", "time_offset_sd", "depth_scale_sd", "focal_sd"}
        check_numbers("DvioParameters", numbers, may_be_zero=told | {"rate_share", "plane_doubt"})
        if self.keyframes < 3:
            raise ConfigError("DvioParameters", "keyframes", self.keyframes, "a whole number ≥ 3")

    @property
    def uses_depth(self) -> bool:
        """Whether any term reads depth."""
        return self.host_depth != "none" or self.projection_depth

    def noise(self, imu: ImuCalibration) -> ImuNoise:
        """Of the samples of an IMU."""
        f, w = self.imu_noise_factor, self.walk_factor
        return ImuNoise(
            rate=f * max(imu.gyroscope_noise_density, 1e-5),
            force=f * max(imu.accelerometer_noise_density, 1e-4),
            rate_share=self.rate_share,
            rate_walk=w * max(imu.gyroscope_random_walk, 1e-6),
            force_walk=w * max(imu.accelerometer_random_walk, 1e-5),
            doubtful_rate=self.doubtful_rate,
            doubtful_force=self.doubtful_force,
        )

    def terms(self, focal_px: float, noise: ImuNoise) -> Terms:
        """Of the factors, for a camera of some focal length."""
        return Terms(
            gravity=self.gravity,
            sight_weight=(focal_px / self.sight_sd_px) ** 2,
            sight_limit=self.sight_limit,
            depth_weight=self.inverse_depth_sd**-2,
            again_weight=self.inverse_depth_again_sd**-2,
            depth_limit=self.depth_limit,
            plane_limit=self.plane_limit,
            host_depth=self.host_depth == "factor",
            depth_fixed=self.host_depth == "fixed",
            projection_depth=self.projection_depth,
            host_depth_in_prior=self.host_depth_in_prior,
            first_estimates=self.first_estimates,
            rate_walk=noise.rate_walk,
            force_walk=noise.force_walk,
        )


_PUBLISHED: dict[str, Any] = {
    "host_depth_in_prior": False,
    "first_estimates": False,
    "standing": False,
    "extrinsic_position_sd": 0.0,
    "extrinsic_rotation_sd": 0.0,
    "time_offset_sd": 0.0,
    "depth_scale_sd": 0.0,
    "focal_sd": 0.0,
    "anchored": False,
    "steps": 2,
}
METHODS: dict[str, DvioParameters] = {
    PROPOSED: DvioParameters(),
    "dvio": DvioParameters(**_PUBLISHED),
    "vins_rgbd": DvioParameters(**_PUBLISHED, host_depth="fixed", projection_depth=False),
    "vins_mono": DvioParameters(**_PUBLISHED, host_depth="none", projection_depth=False),
}
"""The proposed method; Zhao et al. 2023; and its ablations in the manner of Shan et al. 2019 and of Qin et al. 2018."""


def named(method: str) -> DvioParameters:
    """The parameters of a method.

    Raises:
        ConfigError: No such method; the message lists those there are.
    """
    method = current_name(method)
    if method not in METHODS:
        raise ConfigError("Dvio", "method", method, ", ".join(METHODS))
    return METHODS[method]
