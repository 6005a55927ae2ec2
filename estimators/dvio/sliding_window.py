"""The sliding window: takes one image after the other, tracks points and optimises."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.dvio import kernel
from stridetwin.estimators.dvio.depth_link import PlaneReader, Planes, link_frames
from stridetwin.estimators.dvio.force_scale import estimate_scale_error
from stridetwin.estimators.dvio.imu_inflation import ImuInflation
from stridetwin.estimators.dvio.level import LevelGround, covariance_of
from stridetwin.estimators.dvio.mount_prior import MountPrior
from stridetwin.estimators.dvio.nav_state import STATIONARY_S, ImuBuffer, NavState, blank_nav_state, copy_of, state_of
from stridetwin.estimators.dvio.noise_model import bias_sd, calibration_prior, factor_parameters, imu_noise
from stridetwin.estimators.dvio.optimiser import (
    blank_work,
    drop_oldest,
    fix_first_estimate,
    marginalize_oldest,
    minimise,
    preintegrate,
)
from stridetwin.estimators.dvio.parameters import DvioParameters
from stridetwin.estimators.dvio.patches import read_slope
from stridetwin.estimators.dvio.plane_cells import SIDE, sample_pixels
from stridetwin.estimators.dvio.projection import directions
from stridetwin.estimators.dvio.state import (
    CALIBRATION,
    FRAME,
    LANDMARK_SLOTS,
    NO_HOST,
    WindowState,
    blank_preintegration,
    blank_window,
)
from stridetwin.estimators.dvio.structure_from_motion import solve_pnp
from stridetwin.estimators.dvio.tracker import CameraFrame, Lens, Tracker
from stridetwin.streams.rig import CameraCalibration, ImuCalibration
from stridetwin.streams.samples import Array

# Hand-chosen on tuning seeds.
STATIONARY_SPEED_SD_MPS = 0.01
"""Speed of a stationary sensor."""
_KEYFRAME_STEPS = 3  # of the optimisation
_COST_TOLERANCE = 1e-3  # relative decrease of the cost at which it stops
# A frame is a keyframe if points have moved by more than this on average, if fewer than this share of the last
# keyframe's points are still tracked, or after this time.
_KEYFRAME_PARALLAX_PX, _MIN_TRACKED_SHARE, _MAX_KEYFRAME_S = 18.0, 0.6, 0.4
_MAX_DEPTH_ERROR_SD = 5.0  # a point is dropped if its measured depth is farther from the prediction
# A point farther from its prediction is dropped; the prediction's uncertainty is added. Twice this: no difference where
# nothing else moves, but passers-by are followed more often.
_GATE_PX = 3.0
_CULL_SD = 3.5  # observations farther off after the optimisation are removed; twice this: 60 % larger errors
_UNMEASURED_GATE_PX = 10.0  # added to the gate, with its motion, for a point whose depth is not measured
_MIN_PREDICTED_SHARE = 0.5  # if fewer points are where they were predicted, all are searched for
_MAX_PNP_ERROR_PX = 3.0  # of an inlier of the pose that decides where most points are mispredicted
_MIN_POINTS = 8  # with fewer only the IMU is used
_MIN_OBSERVATIONS = 10  # a frame with fewer counts as dead reckoning
_UNKNOWN_INVERSE_DEPTH_PER_M = 0.15  # of a new landmark without measured depth: 6.7 m, typical of a room
_MEASURED_SD = 8.0  # from this many standard deviations of inverse depth on, parallax counts as a measurement
# Motion of points up to which the camera may be stationary: per frame, and over `STATIONARY_S` or more (at 2 m and
# 390 px focal length, 10 mm/s).
_MAX_STATIONARY_PX, _MAX_STATIONARY_DRIFT_PX = 0.25, 0.5
_FIXED_SD = 1e-7  # standard deviation of quantities that are not estimated
# Error of the motion between two frames by the IMU alone beside its noise: of a tilt (rad), which gravity turns into an
# acceleration, and of the gyroscope's bias (rad/s).
_LINK_TILT_SD_RAD, _LINK_RATE_SD_RADPS = 0.02, 0.02
_PLANES = 6  # largest number of planes read from a depth image


class SlidingWindow:
    """The window of frames and landmarks, its point tracker, and the state propagated from its newest frame.

    Args:
        camera: Calibration of the camera.
        imu: Calibration of the IMU.
        T_imu_camera: (4, 4) camera to IMU, m.
        parameters: Parameters for any rig.

    Attributes:
        parameters: The parameters.
        noise: Present noise of the IMU's samples: that of the start, raised by `inflation`.
        inflation: Factor on that noise, estimated from images.
        bias_sd: (6,) standard deviations of the turn-on biases, rad/s and m/s².
        calibration_prior: Standard deviations of the calibration before any measurement.
        inertial: Buffer of IMU samples.
        lens: Maps pixels to rays and back.
        factors: Weights of the factors, and which are used.
        tracker: Finds points in images and tracks them.
        window: Frames, landmarks, calibration and prior.
        nav: State propagated by the IMU from the newest frame.
        seen: Number of observations in the newest frame.
        first_offset_s: Offset of the camera's clock with which the window began, s.
    """

    def __init__(
        self, camera: CameraCalibration, imu: ImuCalibration, T_imu_camera: Array, parameters: DvioParameters
    ) -> None:
        """Begins with an empty window; `T_imu_camera` is the nominal mount (4, 4), camera to IMU, m."""
        self.parameters, self.noise = parameters, imu_noise(parameters, imu)
        # factor on that noise, by images; priors of biases and calibration; samples; intrinsics; weights of the factors
        self.inflation = ImuInflation(self.noise)
        self.bias_sd, self.calibration_prior = bias_sd(imu), calibration_prior(parameters)
        self._known_scale_sd = imu.accelerometer_scale_sd
        self.inertial = ImuBuffer(imu, parameters)
        self.lens = Lens(camera)
        self.factors = factor_parameters(parameters, self.lens.focal_px, self.noise)
        self.tracker = Tracker(self.lens.shape)
        self._frames = parameters.keyframes + 2  # slots for frames; one more than are ever in use
        self.window: WindowState = blank_window(self._frames, LANDMARK_SLOTS, T_imu_camera, camera.timeshift_cam_imu_s)
        self._work = blank_work(self.window)  # buffers of the optimisation
        self.nav: NavState = blank_nav_state()
        # `nav` at the newest frame, or later, as far back as IMU samples are kept: a late image restarts from it
        self._previous: NavState = blank_nav_state()
        self._preintegration = blank_preintegration()  # buffer of `_propagate`
        # per landmark slot: 1 if the point is tracked into the newest image, and where it is there, px
        self._alive = np.zeros(LANDMARK_SLOTS, np.uint8)
        self._pixels = np.zeros((LANDMARK_SLOTS, 2), np.float32)
        self._depth_range_m = float(parameters.min_depth_m), float(parameters.max_depth_m)
        # the rays of the depth samples, and buffers for the planes that are read from them, with their weights
        at = sample_pixels(self.lens.shape)
        self._rays = self.lens.to_normalized(at.reshape(-1, 2)).reshape(at.shape)
        self._measured_planes = np.zeros((_PLANES, 3)), np.zeros((_PLANES, 3, 3))
        # planes of the newest keyframe's depth image, with which those of later frames are compared in the dark
        reads_planes = parameters.method.level_ground and parameters.method.uses_depth
        self._plane_reader = (
            PlaneReader(self._rays, self._depth_range_m[0], parameters.inverse_depth_sd_per_m) if reads_planes else None
        )
        self._key_planes: Planes | None = None
        self._newest_is_key = False  # if not, the next image replaces the newest frame
        self._mount = MountPrior(self.calibration_prior.mount_sd, self.calibration_prior.slipped_sd)
        method = parameters.method
        self._level = LevelGround(parameters.level_ground_sd_rad, used=method.level_ground and method.uses_depth)
        self.seen = 0
        self.first_offset_s = float(camera.timeshift_cam_imu_s)

    @property
    def is_resting(self) -> bool:
        """Whether neither the IMU nor the images of the newest frame show a motion."""
        f = self.window.frames
        return bool(np.isfinite(f.zero_velocity_sd[f.count[0] - 1]))

    @property
    def is_held_by_depth(self) -> bool:
        """Whether planes in the depth image measure motion that leads to the newest frame, as images do not."""
        newest = int(self.window.frames.count[0]) - 1
        return newest > 0 and self._work.links[newest - 1] is not None

    @property
    def is_tracking(self) -> bool:
        """Whether the newest frame has enough observations."""
        return self.seen >= _MIN_OBSERVATIONS

    def imu_time(self, t_ns: int) -> int:
        """A camera stamp on the IMU's clock, by the estimated offset."""
        return t_ns + round(self.window.calibration.offset[0] * 1e9)

    def start(self, frame: CameraFrame, covariance: Array) -> None:
        """Starts a new window with an image, as its first frame, at the state `nav`.

        All landmarks and frames are dropped. The estimated calibration stays; its prior is centred on it, with the
        standard deviations of a first start, but those of the mount are as `MountPrior` has estimated them. New points
        are searched for in the image; `seen` becomes their number.

        Args:
            frame: The image.
            covariance: (15, 15) covariance of `nav`, which becomes the prior of the frame.
        """
        w, prior = self.window, self.calibration_prior
        f, c = w.frames, w.calibration
        self.first_offset_s = float(c.offset[0])
        self._alive[:] = 0  # no landmark is tracked
        w.landmarks.host[:], w.landmarks.seen[:] = NO_HOST, 0
        f.in_prior[:], f.count[0] = 0, 1
        self._set_frame(0, frame.t_ns, self.nav)
        fix_first_estimate(w, 0)
        w.prior.H[:], w.prior.b[:] = 0.0, 0.0
        sensor_sd = [prior.offset_sd_s, prior.depth_scale_sd, prior.focal_sd, prior.focal_sd]
        sd = np.concatenate([self._mount.start(c.moved[:6]), sensor_sd])
        n = CALIBRATION
        w.prior.H[range(n), range(n)] = np.maximum(sd, _FIXED_SD) ** -2
        # centred on the present calibration, which deviates by `moved` from the prior's linearisation point
        w.prior.b[:n] = w.prior.H[range(n), range(n)] * c.moved
        state = slice(CALIBRATION, CALIBRATION + FRAME)
        w.prior.H[state, state] = np.linalg.inv(covariance)
        self._work.links[:] = [None] * len(self._work.links)
        self._level.restart()
        self.inflation.restart()
        self.nav.covariance[:] = covariance
        self._previous = copy_of(self.nav)
        self.tracker.reset()
        self.tracker.set_image(frame.grey)
        self._add_landmarks(frame, 0)
        self._store_patches(frame, 0)
        self._key_planes = self._read_planes(frame)
        self._newest_is_key = True
        self.seen = int(self._alive.sum())

    def start_covariance(self, position_covariance: Array, heading_sd: float, tilt_sd: float, speed_sd: float) -> Array:
        """(15, 15) covariance of a start at `nav` with biases of their a-priori spread.

        Args:
            position_covariance: (3, 3) m², covariance of the position.
            heading_sd: Standard deviation of the heading, rad.
            tilt_sd: Standard deviation of the tilt about both horizontal axes, rad.
            speed_sd: Standard deviation of the velocity on each axis, m/s.
        """
        P = np.zeros((FRAME, FRAME))
        R = self.nav.R
        P[:3, :3] = position_covariance
        # attitude errors are about the IMU's axes; the vertical and the heading are about the world's
        P[3:6, 3:6] = R.T @ np.diag([tilt_sd**2, tilt_sd**2, heading_sd**2]) @ R
        P[6:9, 6:9] = np.eye(3) * speed_sd**2
        P[range(9, 15), range(9, 15)] = self.bias_sd**2
        return P

    def process_image(self, frame: CameraFrame, stationary: bool) -> None:
        """Adds the next image: tracks points, optimises, and adds points and a prior on keyframes.

        If the newest frame is no keyframe, the new one replaces it. A keyframe also measures level ground, and the
        oldest frame is marginalised once there are enough. Afterwards `nav` is the state of the new frame with its
        covariance, and `seen` the number of its observations.

        Args:
            frame: The image; the IMU samples up to its time must be in the buffer.
            stationary: Whether the IMU measures no motion. The velocity is then measured as 0 if the points do not move
                either.
        """
        w, p, f = self.window, self.parameters, self.window.frames
        before = int(f.count[0]) - 1  # slot of the newest frame so far
        slot = before + 1 if self._newest_is_key else before  # of the new frame
        t_ns = self.imu_time(frame.t_ns)
        predicted = state_of(f, before)
        self._propagate(predicted, t_ns)
        moved_px = self._track_landmarks(frame, predicted, before, slot)
        stationary &= moved_px < _MAX_STATIONARY_PX and self._drift_px(slot, frame.t_ns) < _MAX_STATIONARY_DRIFT_PX
        f.count[0] = slot + 1
        self._set_frame(slot, frame.t_ns, predicted)
        f.in_prior[slot] = 0
        f.zero_velocity_sd[slot] = STATIONARY_SPEED_SD_MPS if stationary and p.method.zero_velocity_updates else np.inf
        # the IMU factor from the last keyframe to the new frame
        preintegrate(
            w.preintegrations,
            slot - 1,
            self.inertial.imu_samples,
            f.t_ns[slot - 1],
            f.t_ns[slot],
            f.bias[slot - 1],
            self.noise,
        )
        self._work.links[slot - 1] = None
        if w.landmarks.seen[:, slot].sum() < _MIN_OBSERVATIONS:
            self._link_by_depth(frame, slot, predicted)
        key = self._is_key(slot)  # whether the new frame becomes a keyframe
        steps = _KEYFRAME_STEPS if key else p.method.steps
        minimise(w, self.factors, self._work, steps, _COST_TOLERANCE)
        self._mark_observable_depths()
        # The newest frame is the last in the equations, so the last block L of the Cholesky factor gives its
        # covariance, (L Lᵀ)⁻¹.
        o = CALIBRATION + FRAME * slot
        L = self._work.factor[o : o + FRAME, o : o + FRAME]
        inverse = np.linalg.inv(L)
        self.seen = self._cull()
        if key:
            self._key_planes = self._read_planes(frame)
            self._add_landmarks(frame, slot)
            if self._mount.is_adaptive:
                self._mount.update(w, covariance_of(np.arange(6), self._work.factor, CALIBRATION + FRAME * (slot + 1)))
            self._observe_level_ground(frame, slot)
            if p.method.imu_noise_from_images:
                self.inflation.update(w, self.factors, self._work.factor)
                self.noise = self.inflation.noise
            if slot >= p.keyframes:
                marginalize_oldest(w, self.factors, self._work, self._alive)
                drop_oldest(w, self._work.links)
            self._store_patches(frame, int(f.count[0]) - 1)
        self._newest_is_key = key
        newest = int(f.count[0]) - 1  # one less than `slot` after the oldest frame is gone
        self.nav = state_of(f, newest)._replace(covariance=inverse.T @ inverse)
        self._previous = copy_of(self.nav)

    def _read_planes(self, frame: CameraFrame) -> Planes | None:
        """Planes of a depth image; None without one, or if the method does not use them."""
        if self._plane_reader is None or frame.depth is None:
            return None
        return self._plane_reader.read(frame.depth, self.window.calibration)

    def _link_by_depth(self, frame: CameraFrame, slot: int, predicted: NavState) -> None:
        """Links the new frame in a slot to the keyframe before it by the planes that both see: docs/dvio.md (18).

        Args:
            frame: The new image.
            slot: Its slot; the keyframe is in the one before.
            predicted: State at the new image by the IMU.
        """
        planes = None if self._key_planes is None else self._read_planes(frame)
        if planes is None or self._key_planes is None:
            return
        w = self.window
        z, dt = w.preintegrations.covariance[slot - 1], float(w.preintegrations.dt[slot - 1, 0])
        speed_variance = float(self.nav.covariance.diagonal()[6:9].max())
        covariance = z[:6, :6] + np.diag(
            [speed_variance * dt**2 + (_LINK_TILT_SD_RAD * self.parameters.gravity_mps2 * dt**2 / 2) ** 2] * 3
            + [(_LINK_RATE_SD_RADPS * dt) ** 2] * 3
        )
        earlier = state_of(w.frames, slot - 1)
        self._work.links[slot - 1] = link_frames(
            self._key_planes, planes, earlier, predicted, covariance, w.calibration
        )

    def propagate(self, until_ns: int) -> None:
        """Propagates `nav` to a time on the IMU's clock that its samples cover.

        `_previous`, the state from which `rewind_to` restarts, is `nav` as it was at the newest frame. It is moved on,
        too, to the oldest IMU sample that will still be in the buffer, if that is later than the newest frame.
        """
        self._propagate(self.nav, until_ns)
        # A state from before the samples that are kept could not be propagated any more.
        self._propagate(self._previous, self.inertial.oldest_retained_ns)

    def rotation_between(self, start_ns: int, end_ns: int) -> Array:
        """(3, 3) rotation by the gyroscope, from the IMU's axes at a later time to those at an earlier one.

        The bias of `nav` is taken off; the samples must reach back to the earlier time.
        """
        z = blank_preintegration()
        if end_ns > start_ns:
            kernel.integrate(z, self.inertial.imu_samples, start_ns, end_ns, self.nav.bias, self.noise)
        return z.delta_R

    def correct_force_scale(self, excess_mps2: float) -> float:
        """Corrects the scale of the accelerometer by an excess of force along gravity.

        Args:
            excess_mps2: Measured force less gravity at rest, or the estimated bias along gravity.

        Returns:
            The relative correction, 0 where none is made.
        """
        p, scale_sd = self.parameters, self._known_scale_sd
        error = estimate_scale_error(excess_mps2, p.gravity_mps2, float(self.bias_sd[3]), scale_sd)
        if not p.method.refines_all or error == 0.0:
            return 0.0
        self.inertial.rescale_forces(1.0 + error)
        return error

    def return_to(self, state: NavState) -> None:
        """Makes an earlier state `nav`, and the one from which `rewind_to` restarts; IMU samples must cover it."""
        self.nav, self._previous = copy_of(state), copy_of(state)

    def rewind_to(self, t_ns: int) -> bool:
        """Sets `nav` to the state at an earlier time since the newest frame, by propagating `_previous` to it.

        An image can arrive after later IMU samples, so `nav` may be beyond its time.

        Returns:
            False if that time is before `_previous`, from which on IMU samples are kept; `nav` is then unchanged.
        """
        if t_ns < self._previous.t_ns[0]:
            return False
        self.nav = copy_of(self._previous)
        self._propagate(self.nav, t_ns)
        return True

    @property
    def newest_ns(self) -> int:
        """Time of the newest frame, on the IMU's clock."""
        f = self.window.frames
        return int(f.t_ns[f.count[0] - 1])

    @property
    def is_imu_complete(self) -> bool:
        """Whether the IMU samples cover all the time since the frame that the next image will be linked to."""
        # the newest frame if it is a keyframe, else the one before, because the next image replaces the newest
        f = self.window.frames
        return self.inertial.covers(int(f.t_ns[f.count[0] - (1 if self._newest_is_key else 2)]))

    @property
    def is_plausible(self) -> bool:
        """Whether the newest state is finite, with a speed and biases that a person with a consumer IMU can have."""
        return bool(kernel.is_plausible(self.nav))

    def _propagate(self, state: NavState, until_ns: int) -> None:
        """Propagates a state in place to a later time by the buffered IMU samples; an earlier time changes nothing.

        `_preintegration` is only a buffer here.
        """
        if until_ns > state.t_ns[0]:
            z = self._preintegration
            kernel.integrate(z, self.inertial.imu_samples, state.t_ns[0], until_ns, state.bias, self.noise)
            kernel.add_increment(state, z, self.noise, self.parameters.gravity_mps2)
            state.t_ns[0] = until_ns

    def _set_frame(self, slot: int, t_ns: int, state: NavState) -> None:
        """Sets the frame in a slot to a state, stamped with an image's time `t_ns` on the camera's clock.

        The frame's angular rate is that of the gyroscope at that time, and it counts as moving.
        """
        f = self.window.frames
        # the estimate of the clock's offset by which `f.t_ns` follows from the stamp
        f.offset[slot] = self.window.calibration.offset[0]
        f.t_ns[slot] = self.imu_time(t_ns)
        f.R[slot], f.p[slot], f.v[slot], f.bias[slot] = state.R, state.p, state.v, state.bias
        f.rate[slot] = self.inertial.rate_at(int(f.t_ns[slot])) - state.bias[:3]
        f.zero_velocity_sd[slot] = np.inf  # no measurement of its velocity

    def _track_landmarks(self, frame: CameraFrame, predicted: NavState, before: int, slot: int) -> float:
        """Tracks landmarks into a new image and stores their observations in its slot.

        A point is aligned with the patch of its host frame near its prediction (methods with `anchored`). If that fails
        for too many points, optical flow searches for all of them. Points that are not where the predicted pose and
        their depth put them, or at another depth, are rejected: something moves there, or hides them. `_alive` and
        `_pixels` are then those of the new image.

        Args:
            frame: The new image.
            predicted: State at the image, propagated by the IMU.
            before: Slot of the frame in which the points were tracked last.
            slot: Slot of the new frame; may equal `before`.

        Returns:
            Median motion of the tracked points since the last image, px; inf if they are fewer than `_MIN_POINTS`.
        """
        w, marks, p = self.window, self.window.landmarks, self.parameters
        n = len(marks.host)  # number of landmark slots
        # known: 1 where the landmark is in front of both cameras, so that the others are written.
        # expected: x, y and inverse depth in the new image; start: x, y in the last one; warp: from host to new image
        expected, start, warp, known = np.zeros((n, 3)), np.zeros((n, 2)), np.zeros((n, 2, 2)), np.zeros(n, np.uint8)
        kernel.predict_observations(w, predicted.R, predicted.p, before, expected, start, warp, known)
        ids = np.flatnonzero((self._alive > 0) & (known > 0))
        marks.seen[:, slot] = 0
        self._alive[:] = 0  # set again below, for the landmarks that are tracked
        previous_px, inverse_depth, warps = self._pixels[ids], expected[ids, 2], warp[ids]
        # predicted motion since the last image, added to where the point was seen there
        motion = self.lens.pixels(expected[ids, :2]) - self.lens.pixels(start[ids])
        predicted_px = previous_px + motion
        self.tracker.set_image(frame.grey)
        tracked_px, good = predicted_px, np.zeros(len(ids), bool)  # good: which points are tracked
        if p.method.anchored:
            tracked_px, good = self.tracker.align(ids, predicted_px, warps)
        # Too few are near their predictions: the prediction is poor, so optical flow searches for them farther away.
        mispredicted = good.sum() < _MIN_PREDICTED_SHARE * len(ids)
        if mispredicted:
            tracked_px, good = self.tracker.track(previous_px, predicted_px)
        # Reject moving points: they are not where the wearer's motion and the point's depth predict them.
        distance_px = np.linalg.norm(tracked_px - predicted_px, axis=1)
        # standard deviation of the speed by the covariance of the velocity; time since the last image, s
        speed_sd = float(np.sqrt(np.trace(self.nav.covariance[6:9, 6:9])))
        dt = (predicted.t_ns[0] - w.frames.t_ns[before]) * 1e-9
        # The gate widens by two standard deviations of the motion that an error of the velocity causes, and by the
        # motion of points of unknown depth.
        unsure = np.where(marks.measured[ids] > 0, 0.0, 1.0)  # 1 where the depth is not measured
        moved = np.linalg.norm(motion, axis=1)
        gate = (
            _GATE_PX + 2 * self.lens.focal_px * speed_sd * dt * inverse_depth + unsure * (_UNMEASURED_GATE_PX + moved)
        )
        fits = distance_px < gate
        # Most points contradict the predicted pose: then a pose by P3P decides which of them rest.
        if good.sum() >= _MIN_POINTS and (good & fits).sum() < _MIN_PREDICTED_SHARE * good.sum():
            fits = self._pnp_inliers(ids, tracked_px, good)
        good &= fits
        if p.method.anchored and mispredicted:  # flow drifts: the patches correct its result
            tracked_px, good = self.tracker.align_fine(ids, tracked_px, warps, good)
        # only the tracked points from here on
        ids, tracked_px, previous_px, inverse_depth = (
            ids[good],
            tracked_px[good],
            previous_px[good],
            inverse_depth[good],
        )
        rate = self.inertial.rate_at(int(predicted.t_ns[0])) - predicted.bias[:3]
        image_time_px = self.lens.at_image_time(
            tracked_px, inverse_depth, w.calibration, predicted.R, predicted.v, rate
        )
        rho = self.inverse_depths(frame, image_time_px)  # measured; 0 where none is reliable
        # Reject points at another depth, or occluded by something in front.
        is_off_depth = (
            np.abs(w.calibration.scale[0] * inverse_depth - rho) > _MAX_DEPTH_ERROR_SD * p.inverse_depth_sd_per_m
        )
        is_consistent = ~(is_off_depth & (rho > 0) & (marks.measured[ids] > 0))
        ids, tracked_px, previous_px, rho, at = (
            ids[is_consistent],
            tracked_px[is_consistent],
            previous_px[is_consistent],
            rho[is_consistent],
            self.lens.to_normalized(image_time_px[is_consistent]),
        )
        self._alive[ids] = 1
        self._pixels[ids] = tracked_px
        marks.seen[ids, slot] = 1
        marks.at[ids, slot] = at
        marks.rho[ids, slot] = rho
        return float(np.median(np.linalg.norm(tracked_px - previous_px, axis=1))) if len(ids) >= _MIN_POINTS else np.inf

    def _drift_px(self, slot: int, t_ns: int) -> float:
        """Median image motion, px, up to the frame in `slot`, since the newest frame at least `STATIONARY_S` older.

        It shows a slow motion, of which two successive images show too little. It is 0 if there is no such frame or
        there are too few common points. `t_ns` is the stamp of the image in the slot.
        """
        f, marks = self.window.frames, self.window.landmarks
        # slot of the earlier frame; -1 if there is none
        since = int(np.searchsorted(f.t_ns[:slot], t_ns - round(STATIONARY_S * 1e9), "right")) - 1
        both = (marks.seen[:, [since, slot]] > 0).all(axis=1)
        motion = self.lens.focal_px * np.linalg.norm(marks.at[both, slot] - marks.at[both, since], axis=1)
        return float(np.median(motion)) if since >= 0 and len(motion) >= _MIN_POINTS else 0.0

    def _cull(self) -> int:
        """Removes observations beyond `_CULL_SD` standard deviations; returns how many the newest frame still has.

        The relative camera poses (`work.views`) are updated before. A point that is an outlier in the newest frame is
        no longer alive.
        """
        w, factors, work = self.window, self.factors, self._work
        kernel.update_views(w.frames, w.calibration, factors.first_estimates, work.views)
        count = w.frames.count[0]
        remaining = kernel.cull(w.landmarks, w.calibration, factors, work.views, count, _CULL_SD, self._alive)
        return int(remaining)

    def _mark_observable_depths(self) -> None:
        """Marks landmarks as measured whose depth motion alone determines.

        Their inverse depth is at least `_MEASURED_SD` times its standard deviation.
        """
        marks = self.window.landmarks
        l = np.flatnonzero((self._alive > 0) & (marks.measured == 0))  # landmarks in question
        # squared inverse depth over its variance; at least three frames must see the point
        sure = marks.inverse_depth[l] ** 2 * self._work.camera.depth_information[l] > _MEASURED_SD**2
        in_three_frames = marks.seen[l].sum(axis=1) > 2
        marks.measured[l[sure & in_three_frames]] = 1

    def _pnp_inliers(
        self, ids: NDArray[np.int64], tracked_px: NDArray[np.float32], good: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """(N,) which points one camera pose explains (P3P, RANSAC), where the predicted pose explains few.

        Only tracked points of measured depth can be inliers. All are False if no pose explains enough of them.

        Args:
            ids: (N,) landmarks.
            tracked_px: (N, 2) px, where they are in the newest image.
            good: (N,) which of them were tracked.
        """
        w, marks = self.window, self.window.landmarks
        f, c = w.frames, w.calibration
        use = good & (marks.measured[ids] > 0)
        is_inlier = np.zeros(len(ids), bool)
        h = marks.host[ids]  # (N,) slots of the host frames
        m = directions(marks.at[ids, h]) / marks.inverse_depth[ids, None]  # (N, 3) m, in the host's camera
        points = np.einsum("nij,nj->ni", f.R[h], m @ c.R.T + c.p) + f.p[h]  # (N, 3) m, in the world
        at = self.lens.to_normalized(tracked_px)
        pose = solve_pnp(points[use], at[use], _MAX_PNP_ERROR_PX / self.lens.focal_px, _MIN_POINTS)
        if pose is not None:
            is_inlier[use] = pose[2]  # after rotation and translation: the inliers among the points given
        return is_inlier

    def inverse_depths(self, frame: CameraFrame, points: NDArray[np.float32]) -> Array:
        """(N,) measured inverse depths at (N, 2) px, 1/m; 0 where none is reliable."""
        rho = np.zeros(len(points))  # written by `read_depth`
        if frame.depth is not None and self.parameters.method.uses_depth and len(points):
            kernel.read_depth(frame.depth, points, *self._depth_range_m, rho)
        return rho

    def _add_landmarks(self, frame: CameraFrame, slot: int) -> None:
        """Searches for new points in an image and adds them as landmarks that the frame in a slot hosts.

        As many are added as are missing from `landmarks` tracked points, away from those. A point without measured
        depth begins at `_UNKNOWN_INVERSE_DEPTH_PER_M`.
        """
        marks, p = self.window.landmarks, self.parameters
        free = np.flatnonzero(marks.host == NO_HOST)
        taken = self._pixels[self._alive > 0]
        points = self.tracker.find(taken, min(p.landmarks - len(taken), len(free)))
        ids = free[: len(points)]
        rho, f = self.inverse_depths(frame, points), self.window.frames  # rho: 0 where not measured
        rho_guess = np.where(rho > 0, rho, _UNKNOWN_INVERSE_DEPTH_PER_M)
        image_time_px = self.lens.at_image_time(
            points, rho_guess, self.window.calibration, f.R[slot], f.v[slot], f.rate[slot]
        )
        if image_time_px is not points:  # a rolling shutter: depth images are taken at the image's time
            rho = self.inverse_depths(frame, image_time_px)
        marks.host[ids] = slot
        marks.seen[ids] = 0
        marks.seen[ids, slot] = 1
        marks.at[ids, slot] = self.lens.to_normalized(image_time_px)
        marks.rho[ids, slot] = rho
        marks.measured[ids] = rho > 0
        scale = self.window.calibration.scale[0]  # of measured depths: true over measured
        marks.inverse_depth[ids] = np.where(rho > 0, rho / scale, _UNKNOWN_INVERSE_DEPTH_PER_M)
        self._alive[ids] = 1
        self._pixels[ids] = points

    def _observe_level_ground(self, frame: CameraFrame, slot: int) -> None:
        """Measures the tilt by level ground in the depth image of the newest keyframe, once per stretch of path.

        The measurement is added to the window's prior; the one in `slot` is the newest frame.
        """
        w = self.window
        if frame.depth is None or not self._level.is_due(w.frames.p[slot]):
            return
        rho, weights = self._measured_planes  # buffers: planes (P, 3), 1/m, and inverses of their covariances
        sd = float(self.parameters.inverse_depth_sd_per_m)
        count = kernel.read_planes(frame.depth, self._rays, SIDE, self._depth_range_m[0], sd, rho, weights)
        self._level.observe(w, self._work.factor, slot, rho[:count], weights[:count], self._mount)

    def _store_patches(self, frame: CameraFrame, slot: int) -> None:
        """Stores the patches of the tracked landmarks that the slot hosts, and the slopes of their inverse depths.

        Does nothing in methods that do not align points with patches (`anchored`). A slope is 0 without depth.
        """
        marks, p = self.window.landmarks, self.parameters
        if not p.method.anchored:
            return
        ids = np.flatnonzero((marks.host == slot) & (self._alive > 0))
        points = self._pixels[ids]
        self.tracker.store_patches(ids, points)
        marks.slope[ids] = 0.0
        if frame.depth is not None and p.method.uses_depth:
            slope = read_slope(frame.depth, points, *self._depth_range_m, p.inverse_depth_sd_per_m)
            marks.slope[ids] = slope * self.lens.focal_px  # from 1/m per pixel to 1/m on the plane at depth 1

    def _is_key(self, slot: int) -> bool:
        """Whether the newest frame becomes a keyframe: by parallax, by lost points, or after `_MAX_KEYFRAME_S`."""
        f = self.window.frames
        # motion since the last keyframe without that by rotation, on the plane at depth 1, and number of common points
        moved, common = kernel.parallax(self.window, slot, slot - 1)
        return bool(
            moved * self.lens.focal_px > _KEYFRAME_PARALLAX_PX
            or common < _MIN_TRACKED_SHARE * self.window.landmarks.seen[:, slot - 1].sum()
            or (f.t_ns[slot] - f.t_ns[slot - 1]) * 1e-9 > _MAX_KEYFRAME_S
        )
