"""The locomotion mode estimator: poses, insoles and depth in, predicted steps out."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np

from stridetwin.estimators.backends import BACKENDS
from stridetwin.estimators.base import CAMERA_POSES, POSE_STREAM, PROPOSED, Declaration, Options, Stream
from stridetwin.estimators.base import MODES as MODES_KIND
from stridetwin.estimators.contact_terrain import UNKNOWN, StepEstimate
from stridetwin.estimators.locomotion_mode.body import Body
from stridetwin.estimators.locomotion_mode.changes import find_next_change
from stridetwin.estimators.locomotion_mode.estimate import MODES, ModeEstimate, StepPrediction
from stridetwin.estimators.locomotion_mode.falls import FallFinder
from stridetwin.estimators.locomotion_mode.foothold import (
    USUAL_HEIGHT_M,
    Arrival,
    FootholdEstimator,
    PathAhead,
    extrapolate_ground,
    position,
)
from stridetwin.estimators.locomotion_mode.parameters import LocomotionModeParameters, Settings
from stridetwin.estimators.locomotion_mode.pose_trust import PoseTrust
from stridetwin.estimators.locomotion_mode.published import Division, WalkingInformation, predict_published_steps
from stridetwin.estimators.locomotion_mode.rhythm import SIDE, StepRhythm, TouchDowns
from stridetwin.estimators.locomotion_mode.rollout import moments
from stridetwin.estimators.locomotion_mode.segments import (
    BEHIND_M,
    Segment,
    foothold_heights,
    is_under_foot,
    last_flight,
    mix_unseen,
    segments_along,
    slopes_under,
    unseen_probability,
)
from stridetwin.estimators.terrain_map import Profile, Stairs, TerrainMap
from stridetwin.estimators.terrain_map.depth_camera import camera_in_frame, depth_calibration, is_pose, transform
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Depth, Insole, Odometry, Sample

METHODS = (PROPOSED, "published")
INSOLES = ("/foot_l/insole", "/foot_r/insole")
"""Topics of the insoles, left and right."""
_BACK_M = 2.4
"""How far behind the start of the path the ground is read from the map."""
_IN_VIEW_S = 0.5
"""Ground that was in an image of depth so recently is where the image showed it, however the poses drift."""
_SPEED_SD_MPS = 0.25
"""Standard deviation of the change of the body's speed until a foot lands."""
_UNSURE = 0.5
"""From this probability on that drift of the poses changes a step's mode, the mode is unknown."""
_MAX_HEIGHT_M = 2.2
"""A greater height of the body over the ground is wrong."""


class LocomotionMode:
    """Predicts mode, place and time of the next steps, and the next change of the ground.

    Causal, of bounded memory, deterministic, without training. Takes poses of the camera or of its IMU, depth and both
    insoles in time order. It returns an estimate after each depth image in which the map extracts planes, and at each
    touch-down. Step estimates of an exoskeleton (`contact_terrain`) are optional: they correct the feet's position on
    the map and the step lengths, and replace the map where there is none.

    Without insoles it predicts only from the body's position before the first step. A foot with a dead insole is
    predicted from the other foot's touch-downs. Without poses it returns nothing; when they jump, or after a long gap,
    it resets, as the map does. Unobserved ground may be of any mode, and the probabilities reflect this. So may ground
    that is out of view while nothing but the IMU holds the poses (`base.EstimatedPose`): then the mode is `UNKNOWN`.

    Args:
        rig: Rig with a depth camera.
        options: Two of them are read. `poses_of` is the frame of the poses. `method` is one of `METHODS`: `proposed`,
            or `published`, which is Zhao 2023 (16)-(18).
        ground: Map of the ground for the same options; it is updated here with the same samples. None builds one.
        parameters: One set serves everyone. Dimensions of stairs and gates on poses are those of the map's parameters.

    Raises:
        StrideTwinError: The method is unknown, or the rig has no depth camera.
    """

    declaration: ClassVar[Declaration] = Declaration(
        name="locomotion_mode",
        kind=MODES_KIND,
        order=1,
        methods=METHODS,
        backends=BACKENDS,
        budget_s=0.2,
        window_s=0.06,
    )

    def __init__(
        self,
        rig: Rig,
        *,
        options: Options | None = None,
        ground: TerrainMap | None = None,
        parameters: LocomotionModeParameters | None = None,
    ) -> None:
        """Prepares for the depth camera of the rig; without `ground`, it builds a map of its own."""
        Rig.check(rig, "LocomotionMode")
        options = options or Options()
        camera, method = depth_calibration(rig), options.method
        T_frame_camera = camera_in_frame(rig, camera, options.poses_of)
        if method not in METHODS:
            raise ConfigError("LocomotionMode", "method", method, ", ".join(METHODS))
        self.parameters = parameters or LocomotionModeParameters()
        self.ground, self.method = ground or TerrainMap(rig, options=options), method
        self._settings = p = Settings(self.parameters, self.ground.parameters)
        # (4, 4) pose of the followed point in the camera's optical frame, see `_mount_in_frame`
        self._T_camera_followed = np.linalg.inv(camera.mount.T_body_sensor) if method == PROPOSED else np.eye(4)
        self._body = Body(*self._mount_in_frame(T_frame_camera), p)
        self._pose_trust = PoseTrust(p)
        self._touch = TouchDowns(p)
        self._walking = WalkingInformation(p)
        self._rhythm, self._foothold = StepRhythm(p), FootholdEstimator(p)
        self._falls, self._is_looking = FallFinder(), False  # whether a new image is to be searched for falls
        self._seen_ns = -(10**18)  # time of the last image that showed the ground
        self._is_lost = False  # whether the map began anew in the walk and does not show the ground under the foot
        self._stairs: Stairs | None = None  # the last well-known flight: others of the building are alike

    @property
    def inner_estimators(self) -> tuple[TerrainMap, ...]:
        """The map, which is updated here with the same samples."""
        return (self.ground,)

    @classmethod
    def streams(cls, rig: Rig, options: Options) -> tuple[Stream, ...]:
        """Poses, at least one insole, and depth; the same for all options.

        Raises:
            StrideTwinError: The rig has no depth camera.
        """
        insoles = (Stream(role="insole", topic=topic, kind=Insole) for topic in INSOLES)
        return POSE_STREAM, *insoles, Stream(role="depth", topic=depth_calibration(rig).depth_topic, kind=Depth)

    def update(self, sample: Sample | StepEstimate) -> ModeEstimate | None:
        """Takes one sample; returns the new prediction, or None if nothing changed.

        Poses and depth also go to the map. A jump of the poses resets all that is known of the walk. There is a
        prediction after a touch-down, after depth from which the map has extracted planes, and after the first estimate
        of a step by the legs, provided that a recent pose is known.
        """
        if isinstance(sample, Odometry):
            had_ground = self.ground.estimate is not None
            self.ground.update(sample)
            self._is_lost |= had_ground and self.ground.estimate is None  # the map began anew
            if sample.topic == CAMERA_POSES:
                if is_pose(sample):
                    self._body.set_mount(*self._mount_in_frame(transform(sample)))
                return None
            if self._body.add(sample):
                self._rhythm = StepRhythm(self._settings)
                self._foothold.reset()
                self._walking.clear()
                self._pose_trust.clear()
                self._falls.clear()
            self._pose_trust.add(sample)
            return None
        known = self._body.is_known(sample.t_ns)  # whether there is a recent pose
        # `new`: whether the sample changes the prediction
        if isinstance(sample, StepEstimate):
            new = self._foothold.add_step(sample, self._rhythm.foot, self._rhythm.down_ns)
        elif isinstance(sample, Insole):
            detected = self._touch.update(sample)
            foot = detected or self._rhythm.overdue_foot(sample.t_ns)
            if foot:
                self._add_touch_down(foot, sample.t_ns, known, detected is not None)
            new = foot is not None
        else:
            new = isinstance(sample, Depth) and self.ground.update(sample) is not None
            if new:
                self._seen_ns = sample.t_ns
                self._is_looking = True
        if not (new and known):
            return None
        return (
            self._predict_published(sample.t_ns) if self.method == "published" else self._predict_proposed(sample.t_ns)
        )

    def _mount_in_frame(self, T_frame_camera: Array) -> tuple[Array, Array]:
        """The followed point (3,), m, and the camera's rotation (3, 3) in the frame of the poses.

        The point is the carrying body's origin (neck or waist) for the proposed method, and the camera for the
        published one.
        """
        return (T_frame_camera @ self._T_camera_followed)[:3, 3], T_frame_camera[:3, :3]

    def _add_touch_down(self, foot: str, t_ns: int, known: bool, detected: bool) -> None:
        """Handles a touch-down: updates the rhythm and, if the body's pose is known, foothold and step statistics.

        Args:
            foot: `l` or `r`.
            t_ns: Time of the touch-down.
            known: Whether there is a recent pose of the body.
            detected: Whether the insole detected it; otherwise it is inferred.
        """
        line = self._path_ahead() if known else None
        top = self._body.max_height(self._rhythm.down_ns)  # of the body since the touch-down before, m
        landing = self._rhythm.land(foot, t_ns, detected)
        if landing is None:  # the foot only bounced
            return
        if line is None:
            self._foothold.lose_position()
            self._walking.clear()  # else the next step size would be that of two steps
            return
        self._walking.add(Division(foot=foot, t_ns=t_ns, p=self._body.p.copy(), v=self._body.velocity()))
        if self.method == PROPOSED:
            profile = self._read_profile(line)
            ground = self._ground_along(profile, line)
            # mean position of the foot behind, m along the path
            behind, _ = moments(position(self._foothold.stance_density(line)), self._foothold.s)
            self._foothold.land(
                landing,
                line,
                ground,
                foothold_heights(ground, profile, self._foothold.s, self._settings),
                self._body_height(),
                top,
                self._ground_height(line.origin + behind * line.forward),
                self._walking.last_size(),
                self._pose_trust.vertical_m,
            )

    def _body_height(self) -> float:
        """Height of the body over the ground under it, m; a usual one where it is unknown or impossible."""
        height = float(self._body.p[2]) - self._ground_height(self._body.p[:2])
        return height if 0.0 < height < _MAX_HEIGHT_M else USUAL_HEIGHT_M

    def _path_ahead(self) -> PathAhead:
        """The straight path in the walking direction, from `BEHIND_M` behind the body."""
        heading = self._body.heading(2.0 * self._rhythm.step_s)
        forward = np.array([math.cos(heading), math.sin(heading)])
        return PathAhead(self._body.p[:2] - BEHIND_M * forward, forward)

    def _read_profile(self, line: PathAhead) -> Profile:
        """Reads the profile of the ground along a path from the map; its s is 0 at the start of the path.

        It begins `_BACK_M` before, because of an occluded flight only the beginning is mapped.
        """
        heading = math.atan2(line.forward[1], line.forward[0])
        length_m = _BACK_M + BEHIND_M + self.parameters.reach_m
        far = self.ground.profile(line.origin - _BACK_M * line.forward, heading, length_m)
        changes = tuple(replace(change, s=change.s - _BACK_M) for change in far.changes)
        return replace(far, s=far.s - _BACK_M, changes=changes)

    def _ground_along(self, profile: Profile, line: PathAhead) -> list[Segment]:
        """The terrain segments along a path.

        Where the map ends before the stance foot's toes, the ground continues as the legs measured it at the last step.
        """
        step = self._foothold.last_step
        if step is not None:
            # stance foot, and mapped ground, m along the path
            foot, _ = moments(position(self._foothold.stance_density(line)), self._foothold.s)
            seen = profile.s[profile.plane >= 0]
            if not len(seen) or seen[-1] < foot + self.parameters.toe_m:
                return extrapolate_ground(step, foot, self._settings)
        estimate = self.ground.estimate
        if estimate is not None:
            self._stairs = last_flight(estimate, self._stairs)
        fall = self._falls.find(profile, line.origin, line.forward)
        return segments_along(profile, estimate, line.forward, self._settings_with_drift(), self._stairs, fall)

    def _settings_with_drift(self) -> Settings:
        """The settings, with the present drift of the poses, which bends and tilts the map."""
        drift_rad = self._pose_trust.slope_sd_rad(self._speed())
        return self._settings._replace(drift_m=self._pose_trust.vertical_m, drift_slope_rad=drift_rad)

    def _speed(self) -> float:
        """Horizontal speed of the body over the last stride, m/s."""
        stride_s = 2.0 * self._rhythm.step_s
        return float(np.linalg.norm((self._body.p - self._body.position_before(stride_s))[:2])) / stride_s

    def _predict_proposed(self, t_ns: int) -> ModeEstimate:
        """The prediction of the proposed method at a time: coming steps and the next change of the ground.

        The density of the stance foot is rolled out over the ground along the path. A step's place is the mean of its
        density, half a step's width to the side of the path; its mode is the most probable one, where ground that is
        not observed may be of any mode.
        """
        p, foothold, rhythm = self._settings, self._foothold, self._rhythm
        line = self._path_ahead()
        profile = self._read_profile(line)
        if self._is_looking:
            self._falls.look(self.ground, profile, line.origin, line.forward)
            self._is_looking = False
        ground = self._ground_along(profile, line)
        stance, feet = foothold.stance_density(line), rhythm.next_feet()
        if rhythm.is_over_foot(t_ns):
            height = foothold_heights(ground, profile, foothold.s, p)
            top = self._body.max_height(rhythm.down_ns)
            stance = foothold.after_passing(stance, height, top, self._pose_trust.vertical_m)
        chain = foothold.predict_footprints(stance, ground, feet, self._predict_arrival(line, feet[0], t_ns))
        here, _ = moments(position(stance), foothold.s)  # mean position of the stance foot, m along the path
        # (K,) probability that unobserved ground under each step differs; (K, 5) probability of each mode with that
        self._is_lost &= not is_under_foot(profile, here)
        fall = self._falls.find(profile, line.origin, line.forward)
        unseen_there = unseen_probability(profile, foothold.s, here, p, is_lost=self._is_lost, fall=fall)
        unseen = chain.density @ unseen_there
        if self._is_lost:  # the rise to a footprint depends on the ground under the foot behind as well
            behind = np.array([position(stance) @ unseen_there, *unseen[:-1]])
            unseen = np.maximum(unseen, behind)
        # probability that drift of the poses makes the mode of any step another one; ground that is in view moves along
        is_in_view = t_ns - self._seen_ns < _IN_VIEW_S * 1e9
        unsure = 0.0 if is_in_view else self._pose_trust.unsure(self._speed())
        modes = mix_unseen(mix_unseen(chain.modes, unseen), np.full(len(feet), unsure))
        times = rhythm.times(feet, t_ns)  # of each step: landing, ns, and its standard deviation, s
        left = np.array([-line.forward[1], line.forward[0]])
        # (2, 2) rotation from along and across the path to the world
        turn = np.column_stack([line.forward, left])
        slopes = slopes_under(ground, chain.on)  # of each step: slope and its standard deviation, rad
        steps = []
        for k, foot in enumerate(feet):
            s, sd = moments(chain.density[k], foothold.s)
            # feet are half a step's width beside the path
            xy = line.origin + s * line.forward + 0.5 * p.mode.width_m * SIDE[foot] * left
            steps.append(
                StepPrediction(
                    step=rhythm.step + k + 1,
                    foot=foot,
                    mode=UNKNOWN if unsure >= _UNSURE else MODES[int(modes[k].argmax())],
                    probabilities=dict(zip(MODES, modes[k].tolist())),
                    t_ns=times[k][0],
                    t_sd_s=times[k][1],
                    p_foot_in_world=np.array([*xy, self._ground_height(xy)]),
                    covariance=turn @ np.diag([sd**2, p.mode.width_sd_m**2]) @ turn.T,
                    slope=slopes[k][0],
                    slope_sd=slopes[k][1],
                )
            )
        change = find_next_change(
            self.ground.estimate,
            ground,
            here,
            line,
            chain,
            foothold.s,
            [((at_ns - t_ns) * 1e-9, sd_s) for at_ns, sd_s in times],
            foothold.step_m,
            rhythm.step_s,
            p,
        )
        return ModeEstimate(
            t_ns=t_ns,
            step=rhythm.step,
            steps=tuple(steps),
            change=change,
            heading=math.atan2(line.forward[1], line.forward[0]),
            p_body_in_world=self._body.p.copy(),
            step_length=foothold.step_m,
            step_length_sd=foothold.step_sd_m,
            step_time=rhythm.step_s,
        )

    def _predict_arrival(self, line: PathAhead, foot: str, t_ns: int) -> Arrival | None:
        """Where the body will be on a path when a foot lands; None while that foot is not in the air, or poses lack.

        The body goes on with its present velocity, which changes within a step.
        """
        raised_ns = self._touch.find_lift_off_ns(foot)
        velocity = self._body.recent_velocity()
        if raised_ns is None or velocity is None:
            return None
        left_s = self._rhythm.swing_end_s(raised_ns, t_ns)
        return Arrival(BEHIND_M + float(velocity @ line.forward) * left_s, _SPEED_SD_MPS * left_s, self._body_height())

    def _ground_height(self, xy: Array) -> float:
        """Height of the mapped ground at a (2,) position, m; NaN where it is unknown."""
        surface = self.ground.ground(xy)  # plane and terrain
        return math.nan if surface is None else float(surface[0].height(xy))

    def _predict_published(self, t_ns: int) -> ModeEstimate:
        """The prediction of Zhao 2023 (16)-(18) at a time: coming steps without changes of the ground."""
        walking, rhythm, v = self._walking, self._rhythm, self._body.velocity()
        size, step_s = walking.next_size(), walking.step_time()
        # before two touch-downs the usual step time stands in
        step_s = rhythm.step_s if math.isnan(step_s) else step_s
        return ModeEstimate(
            t_ns=t_ns,
            step=rhythm.step,
            change=None,
            steps=predict_published_steps(walking, rhythm, self.ground, self._body.p[:2], step_s, t_ns, self._settings),
            heading=math.atan2(v[1], v[0]),
            p_body_in_world=self._body.p.copy(),
            step_length=size,
            step_length_sd=math.nan,
            step_time=step_s,
        )
