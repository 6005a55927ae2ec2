"""The sliding window's core: takes one image after the other, tracks points and optimises."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.dvio import kernel
from stridetwin.estimators.dvio.feet import Footing
from stridetwin.estimators.dvio.inertial import Inertial
from stridetwin.estimators.dvio.nav_state import Live, blank_live
from stridetwin.estimators.dvio.parameters import DvioParameters
from stridetwin.estimators.dvio.plane_cells import sample_pixels
from stridetwin.estimators.dvio.planes import free_slot
from stridetwin.estimators.dvio.solver import blank_work, shift
from stridetwin.estimators.dvio.state import (
    CALIBRATION,
    D_SCALE,
    D_VELOCITY,
    FRAME,
    NO_HOST,
    PLANES,
    Window,
    blank_increment,
    blank_window,
)
from stridetwin.estimators.dvio.structure_from_motion import perspective
from stridetwin.estimators.dvio.tracker import Lens, Tracker
from stridetwin.streams.rig import CameraCalibration, ImuCalibration
from stridetwin.streams.samples import Array

_TAKEN_AS_TOLD = 1e-7  # standard deviation of quantities that are not estimated


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """One image of the camera.

    Attributes:
        t_ns: On the camera's clock.
        grey: (H, W).
        depth: (H, W) m, 0 where none; or None.
    """

    t_ns: int
    grey: NDArray[np.uint8]
    depth: NDArray[np.float32] | None


class Core:
    """The window, its point tracker, and the state propagated from its newest frame.

    Args:
        camera: Calibration.
        imu: Calibration.
        T_imu_camera: (4, 4) camera to IMU.
        parameters: Parameters for any rig.
    """

    def __init__(
        self, camera: CameraCalibration, imu: ImuCalibration, T_imu_camera: Array, parameters: DvioParameters
    ) -> None:
        self.parameters, self.noise = parameters, parameters.noise(imu)
        turn_on = [
            max(imu.gyroscope_bias_sd, parameters.gyro_bias_sd_radps),
            max(imu.accelerometer_bias_sd, parameters.accel_bias_sd_mps2),
        ]
        self.bias_sd = np.repeat(turn_on, 3)
        self.inertial = Inertial(imu)
        self.lens = Lens(camera)
        self.terms = parameters.terms(self.lens.focal_px, self.noise)
        slots = parameters.landmark_slots
        self.tracker = Tracker(self.lens.shape, parameters)
        self._frames = parameters.keyframes + 2
        planes = PLANES if parameters.planes and parameters.uses_depth else 0
        self._work = blank_work(self._frames, slots, planes)
        self.window: Window = blank_window(self._frames, slots, T_imu_camera, camera.timeshift_cam_imu_s, planes)
        self.live: Live = blank_live()
        # `live` at the newest frame, or later, as far back as IMU samples are kept: a late image restarts from it
        self._behind: Live = blank_live()
        self._room = blank_increment()
        self._alive = np.zeros(slots, np.uint8)
        self._pixels = np.zeros((slots, 2), np.float32)
        if planes:
            at = sample_pixels(self.lens.shape)
            self._rays = self.lens.normalised(at.reshape(-1, 2)).reshape(at.shape)
            self._told_planes = np.zeros((planes, 3)), np.zeros((planes, 3, 3)), np.zeros(planes, np.int64)
        self._newest_is_key = False
        self.seen = 0

    @property
    def sees(self) -> bool:
        """Whether the newest frame has enough observations."""
        return self.seen >= self.parameters.observations_min

    def imu_time(self, t_ns: int) -> int:
        """A camera stamp on the IMU's clock, by the estimated offset."""
        return t_ns + round(self.window.calibration.offset[0] * 1e9)

    def start(self, picture: Picture, covariance: Array) -> None:
        """Begins a window with an image, at the state `live`.

        Args:
            picture: The first image.
            covariance: (15, 15) of the state.
        """
        w, p = self.window, self.parameters
        f, c = w.frames, w.calibration
        self._alive[:] = 0
        w.landmarks.host[:], w.landmarks.seen[:] = NO_HOST, 0
        w.planes.used[:], w.planes.held[:], w.planes.seen[:] = 0, 0, 0
        f.held[:], f.count[0] = 0, 1
        self._place(0, picture.t_ns, self.live)
        self._hold(0)
        w.prior.H[:], w.prior.b[:] = 0.0, 0.0
        sd = np.array(
            [p.extrinsic_position_sd_m] * 3
            + [p.extrinsic_rotation_sd_rad] * 3
            + [p.time_offset_sd_s, p.depth_scale_sd]
            + [p.focal_sd] * 2
        )
        if not p.uses_depth:
            sd[D_SCALE] = 0.0
        n = CALIBRATION
        w.prior.H[range(n), range(n)] = np.maximum(sd, _TAKEN_AS_TOLD) ** -2
        w.prior.b[:n] = w.prior.H[range(n), range(n)] * c.moved
        own = slice(w.shared, w.shared + FRAME)
        w.prior.H[own, own] = np.linalg.inv(covariance)
        self.live.covariance[:] = covariance
        self._leave_behind()
        self.tracker.forget()
        self.tracker.take(picture.grey)
        self._find(picture, 0)
        self._anchor(picture, 0)
        self._newest_is_key = True
        self.seen = int(self._alive.sum())

    def start_covariance(self, place: Array, heading_sd: float, tilt_sd: float, speed_sd: float) -> Array:
        """(15, 15) of a state with biases of their a-priori spread.

        Args:
            place: (3, 3) m².
            heading_sd: rad.
            tilt_sd: Of the vertical, rad.
            speed_sd: m/s.
        """
        P = np.zeros((FRAME, FRAME))
        R = self.live.R
        P[:3, :3] = place
        P[3:6, 3:6] = R.T @ np.diag([tilt_sd**2, tilt_sd**2, heading_sd**2]) @ R
        P[6:9, 6:9] = np.eye(3) * speed_sd**2
        P[range(9, 15), range(9, 15)] = self.bias_sd**2
        return P

    def take(self, picture: Picture, still: bool, footing: Footing | None = None) -> None:
        """Takes the next image; the IMU samples up to its time are already here.

        Args:
            picture: The next image.
            still: Whether the IMU is stationary.
            footing: Leg measurement at that time, used when the camera observes little.
        """
        w, p, f = self.window, self.parameters, self.window.frames
        before = int(f.count[0]) - 1
        slot = before + 1 if self._newest_is_key else before
        t_ns = self.imu_time(picture.t_ns)
        x = self.inertial
        foreseen = self._foreseen(before, t_ns)
        moved = self._follow(picture, foreseen, before, slot)
        few = self._alive.sum() < p.observations_min
        still &= moved < p.still_px or (few and footing is not None and footing.resting)
        f.count[0] = slot + 1
        self._place(slot, picture.t_ns, foreseen)
        f.held[slot] = 0
        f.still_sd[slot] = p.still_speed_sd_mps if still and p.standing else np.inf
        if p.feet:
            self._tell_speed(slot, footing.v_in_world if few and footing is not None else None)
        kernel.integrate_into(
            w.increments, slot - 1, x.t_ns, x.samples, x.doubt, x.count,
            f.t_ns[slot - 1], f.t_ns[slot], f.bias[slot - 1], self.noise,
        )  # fmt: skip
        key = self._is_key(slot)
        kernel.minimise(w, self.terms, self._work, p.keyframe_steps if key else p.steps, p.cost_tolerance)
        self._measure()
        o = w.shared + FRAME * slot
        L = self._work.factor[o : o + FRAME, o : o + FRAME]
        inverse = np.linalg.inv(np.tril(L))
        self.live.covariance[:] = inverse.T @ inverse
        self.seen = kernel.cull(w, self.terms, self._work, p.cull_sd, self._alive)
        if key:
            self._find(picture, slot)
            self._see_planes(picture)
            if slot >= p.keyframes:
                kernel.forget_oldest(w, self.terms, self._work, self._alive)
                shift(w)
            self._anchor(picture, int(f.count[0]) - 1)
        self._newest_is_key = key
        s = int(f.count[0]) - 1
        self.live.t_ns[0] = f.t_ns[s]
        self.live.R[:], self.live.p[:], self.live.v[:], self.live.bias[:] = f.R[s], f.p[s], f.v[s], f.bias[s]
        self._leave_behind()

    def carry(self, until_ns: int) -> None:
        """Propagates `live` to a time that the IMU has reached."""
        self._carry(self.live, until_ns)
        # A state older than the samples could not be propagated any more.
        self._carry(self._behind, self.inertial.staying_ns)

    def go_back(self, t_ns: int) -> bool:
        """Sets `live` to the propagated state at a time since the newest frame; False if that is too long ago."""
        if t_ns < self._behind.t_ns[0]:
            return False
        for a, b in zip(self.live, self._behind, strict=True):
            a[:] = b
        self._carry(self.live, t_ns)
        return True

    @property
    def newest_ns(self) -> int:
        """Time of the newest frame, on the IMU's clock."""
        f = self.window.frames
        return int(f.t_ns[f.count[0] - 1])

    @property
    def joined(self) -> bool:
        """Whether the IMU samples are complete since the frame to which the next image's frame will be linked."""
        f = self.window.frames
        return self.inertial.reaches_back(int(f.t_ns[f.count[0] - (1 if self._newest_is_key else 2)]))

    @property
    def sound(self) -> bool:
        """Whether the newest state is physically possible for a person."""
        return bool(kernel.sound(self.live))

    def _carry(self, state: Live, until_ns: int) -> None:
        x = self.inertial
        if until_ns > state.t_ns[0]:
            kernel.carry(
                state,
                self._room,
                x.t_ns,
                x.samples,
                x.doubt,
                x.count,
                until_ns,
                self.noise,
                self.parameters.gravity_mps2,
            )

    def _leave_behind(self) -> None:
        for a, b in zip(self._behind, self.live, strict=True):
            a[:] = b

    def _place(self, slot: int, t_ns: int, state: Live) -> None:
        f = self.window.frames
        f.offset[slot] = self.window.calibration.offset[0]
        f.t_ns[slot] = self.imu_time(t_ns)
        f.R[slot], f.p[slot], f.v[slot], f.bias[slot] = state.R, state.p, state.v, state.bias
        f.rate[slot] = self.inertial.rate_at(int(f.t_ns[slot])) - state.bias[:3]
        f.still_sd[slot] = np.inf

    def _hold(self, slot: int) -> None:
        """Marks a frame as in the prior: its Jacobians stay at its current state."""
        f = self.window.frames
        f.held[slot] = 1
        f.R_first[slot], f.p_first[slot], f.v_first[slot] = f.R[slot], f.p[slot], f.v[slot]
        f.bias_first[slot], f.moved[slot] = f.bias[slot], 0.0

    def _tell_speed(self, slot: int, v: Array | None) -> None:
        """Sets the measured velocity (3,) of the newest frame, m/s, or none, as a prior of that frame."""
        f, prior, first = self.window.frames, self.window.prior, self.window.shared + FRAME * slot
        own = slice(first, first + FRAME)
        # The slot may have held another frame before.
        prior.H[own], prior.H[:, own], prior.b[own] = 0.0, 0.0, 0.0
        if v is None:
            return
        self._hold(slot)
        weight = self.parameters.feet_speed_sd_mps**-2
        for i in range(3):
            at = own.start + D_VELOCITY + i
            prior.H[at, at] = weight
            prior.b[at] = weight * (v[i] - f.v[slot, i])

    def _foreseen(self, before: int, t_ns: int) -> Live:
        f = self.window.frames
        state = blank_live()
        state.t_ns[0] = f.t_ns[before]
        state.R[:], state.p[:], state.v[:], state.bias[:] = f.R[before], f.p[before], f.v[before], f.bias[before]
        self._carry(state, t_ns)
        return state

    def _follow(self, picture: Picture, foreseen: Live, before: int, slot: int) -> float:
        """Tracks landmarks into the image and stores their observations in the slot; returns their mean motion, px."""
        w, marks, p = self.window, self.window.landmarks, self.parameters
        n = len(marks.host)
        expected, start, warp, known = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 2, 2)), np.zeros(n, np.uint8)
        kernel.foresee(w, foreseen.R, foreseen.p, before, expected, start, warp, known)
        marks.seen[:, slot] = 0
        w.planes.seen[:, slot] = 0
        ids = np.flatnonzero((self._alive > 0) & (known > 0))
        self._alive[:] = 0
        was = self._pixels[ids]
        shift = self.lens.pixels(expected[ids, :2]) - self.lens.pixels(start[ids, :2])
        foreseen_at, warps = was + shift, warp[ids]
        self.tracker.take(picture.grey)
        there, good = foreseen_at, np.zeros(len(ids), bool)
        if p.anchored:
            there, good = self.tracker.align(ids, foreseen_at, warps, p.anchor_px, p.anchor_likeness)
        elsewhere = good.sum() < p.predicted_share * len(ids)
        if elsewhere:
            there, good = self.tracker.follow(was, foreseen_at)
        # Reject moving points: they are not where the wearer's motion and the point's depth predict them.
        off = np.linalg.norm(there - foreseen_at, axis=1)
        speed_sd = float(np.sqrt(np.trace(self.live.covariance[6:9, 6:9])))
        dt = (foreseen.t_ns[0] - w.frames.t_ns[before]) * 1e-9
        unsure = np.where(marks.measured[ids] > 0, 0.0, 1.0)
        moved = np.linalg.norm(shift, axis=1)
        gate = p.gate_px + 2 * self.lens.focal_px * speed_sd * dt * expected[ids, 2] + unsure * (10.0 + moved)
        fits = off < gate
        if good.sum() >= p.points_min and (good & fits).sum() < 0.5 * good.sum():
            fits = self._agree(ids, there, good)
        good &= fits
        if p.anchored and elsewhere:
            there, good = self.tracker.settle(ids, there, warps, good, p.anchor_px, p.anchor_likeness)
        ids, there, was = ids[good], there[good], was[good]
        told = self.depth(picture, there)
        # Reject points at another depth, or occluded by something in front.
        apart = np.abs(w.calibration.scale[0] * expected[ids, 2] - told) > p.apart_sd * p.inverse_depth_sd_per_m
        here = ~(apart & (told > 0) & (marks.measured[ids] > 0))
        ids, there, was, told = ids[here], there[here], was[here], told[here]
        at = self.lens.normalised(there)
        self._alive[ids] = 1
        self._pixels[ids] = there
        marks.seen[ids, slot] = 1
        marks.at[ids, slot] = at
        marks.told[ids, slot] = told
        return float(np.median(np.linalg.norm(there - was, axis=1))) if len(ids) >= p.points_min else np.inf

    def _measure(self) -> None:
        """Marks landmarks as measured whose depth is known from motion."""
        marks = self.window.landmarks
        l = np.flatnonzero((self._alive > 0) & (marks.measured == 0))
        sure = marks.inverse_depth[l] ** 2 * self._work.sightings.own[l] > self.parameters.measured_sd**2
        marks.measured[l[sure & (marks.seen[l].sum(axis=1) > 2)]] = 1

    def _agree(self, ids: NDArray[np.int64], there: NDArray[np.float32], good: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(N,) which points one camera pose explains, if the predicted one explains few."""
        w, marks = self.window, self.window.landmarks
        f, c = w.frames, w.calibration
        use = good & (marks.measured[ids] > 0)
        agree = np.zeros(len(ids), bool)
        h = marks.host[ids]
        m = np.concatenate([marks.at[ids, h], np.ones((len(ids), 1))], axis=1) / marks.inverse_depth[ids][:, None]
        points = np.einsum("nij,nj->ni", f.R[h], m @ c.R.T + c.p) + f.p[h]
        at = self.lens.normalised(there)
        if (
            pose := perspective(points[use], at[use], 3.0 / self.lens.focal_px, self.parameters.points_min)
        ) is not None:
            agree[use] = pose[2]
        return agree

    def depth(self, picture: Picture, points: NDArray[np.float32]) -> Array:
        """(N,) measured inverse depths at (N, 2) px, 1/m; 0 where none is reliable."""
        told = np.zeros(len(points))
        p = self.parameters
        if picture.depth is not None and p.uses_depth and len(points):
            kernel.read_depth(picture.depth, points, p.depth_min_m, p.depth_max_m, p.depth_edge_per_m, told)
        return told

    def _find(self, picture: Picture, slot: int) -> None:
        """New landmarks, hosted by the slot."""
        marks, p = self.window.landmarks, self.parameters
        free = np.flatnonzero(marks.host == NO_HOST)
        taken = self._pixels[self._alive > 0]
        points = self.tracker.find(taken, min(p.landmarks - len(taken), len(free)))
        ids = free[: len(points)]
        told = self.depth(picture, points)
        marks.host[ids] = slot
        marks.seen[ids] = 0
        marks.seen[ids, slot] = 1
        marks.at[ids, slot] = self.lens.normalised(points)
        marks.told[ids, slot] = told
        marks.measured[ids] = told > 0
        scale = self.window.calibration.scale[0]
        marks.inverse_depth[ids] = np.where(told > 0, told / scale, p.unknown_inverse_depth_per_m)
        self._alive[ids] = 1
        self._pixels[ids] = points

    def _see_planes(self, picture: Picture) -> None:
        """Planes in the depth image of the newest frame: observations of known ones, or new ones."""
        p, w = self.parameters, self.window
        if not len(w.planes.used) or picture.depth is None:
            return
        told, weights, new = self._told_planes
        count = kernel.read_planes(
            picture.depth,
            self._rays,
            p.depth_min_m,
            p.plane_depth_max_m,
            p.inverse_depth_sd_per_m,
            p.plane_doubt,
            told,
            weights,
        )
        strangers = kernel.match_planes(w, self.terms, self._work.factor, told, weights, count, new)
        for i in new[:strangers]:
            k = free_slot(w)
            if k is not None:
                kernel.found_plane(w, k, told[i], weights[i])

    def _anchor(self, picture: Picture, slot: int) -> None:
        """Stores the patches of the landmarks that the slot hosts."""
        marks, p = self.window.landmarks, self.parameters
        if not p.anchored:
            return
        ids = np.flatnonzero((marks.host == slot) & (self._alive > 0))
        points = self._pixels[ids]
        self.tracker.anchor(ids, points)
        slope = np.zeros((len(ids), 2))
        if picture.depth is not None and p.uses_depth and len(ids):
            kernel.read_slope(picture.depth, points, p.depth_min_m, p.depth_max_m, p.inverse_depth_sd_per_m, slope)
        marks.slope[ids] = slope * self.lens.focal_px

    def _is_key(self, slot: int) -> bool:
        """Whether the newest frame differs enough from the last keyframe to be one."""
        p, f = self.parameters, self.window.frames
        moved, common = kernel.parallax(self.window, slot, slot - 1)
        return bool(
            moved * self.lens.focal_px > p.keyframe_parallax_px
            or common < p.keyframe_share * self.window.landmarks.seen[:, slot - 1].sum()
            or (f.t_ns[slot] - f.t_ns[slot - 1]) * 1e-9 > p.keyframe_s
        )
