"""A start in motion: pictures collected until structure from motion and IMU align."""

from __future__ import annotations

import numpy as np

from stridetwin.estimators.dvio import kernel
from stridetwin.estimators.dvio.alignment import Alignment, Beliefs, aligned
from stridetwin.estimators.dvio.core import Core, Picture
from stridetwin.estimators.dvio.memory import blank_increment
from stridetwin.estimators.dvio.structure import Sightings, Structure, structure_of_bearings, structure_with_depth
from stridetwin.streams.samples import Array


class Starter:
    """Follows points from picture to picture and keeps what every third or so of them saw: of constant memory.

    Args:
        core: Its tracker, lens, IMU and calibration serve, as no window needs them yet.
    """

    def __init__(self, core: Core) -> None:
        self._core, self._parameters = core, core.parameters.start
        views, slots = self._parameters.views, core.parameters.landmark_slots
        self._t_ns: list[int] = []
        self._before_ns = 0
        self._seen = np.zeros((views, slots), bool)
        self._at, self._told = np.zeros((views, slots, 2)), np.zeros((views, slots))
        self._alive, self._pixels = np.zeros(slots, bool), np.zeros((slots, 2), np.float32)

    def forget(self) -> None:
        """Begins anew."""
        self._t_ns.clear()
        self._alive[:] = False

    def take(self, picture: Picture) -> Alignment | None:
        """Takes a picture whose time the IMU has reached; returns the state there once it is known well enough."""
        core, t_ns, p = self._core, self._core.imu_time(picture.t_ns), self._parameters
        heard = not self._t_ns or core.inertial.reaches_back(self._t_ns[0])
        if not heard or (self._t_ns and not 0 < t_ns - self._before_ns < p.gap_s * 1e9):
            self.forget()
        core.tracker.take(picture.grey)
        self._follow(t_ns)
        self._before_ns = t_ns
        if self._t_ns and (t_ns - self._t_ns[-1]) * 1e-9 < p.apart_s:
            return None
        self._keep(picture, t_ns)
        if len(self._t_ns) < p.views_min:
            return None
        found = self._align()
        if found is None or found.misfit > p.misfit:
            return None
        variance = found.covariance.diagonal()
        sure = variance[:2].max() < p.tilt_sd_rad**2 and variance[2:5].sum() < p.speed_sd_mps**2
        return found if sure else None

    def _follow(self, t_ns: int) -> None:
        """Points of the picture before, from where the gyroscope has them."""
        ids = np.flatnonzero(self._alive)
        if not len(ids):
            return
        core, x, z = self._core, self._core.inertial, blank_increment()
        kernel.integrate(z, x.t_ns, x.samples, x.doubt, x.count, self._before_ns, t_ns, core.live.bias, core.noise)
        R_ic, was = core.window.calibration.R, self._pixels[ids]
        rays = np.concatenate([core.lens.normalised(was), np.ones((len(ids), 1))], axis=1) @ (R_ic.T @ z.gamma @ R_ic)
        there, good = core.tracker.follow(was, core.lens.pixels(rays[:, :2] / np.maximum(rays[:, 2:], 0.2)))
        self._alive[ids] = good
        self._pixels[ids] = there

    def _keep(self, picture: Picture, t_ns: int) -> None:
        """Writes down what is seen, and looks for new points."""
        core, c = self._core, self._core.window.calibration
        if len(self._t_ns) == self._parameters.views:
            self._t_ns.pop(0)
            for a in (self._seen, self._at, self._told):
                a[:-1] = a[1:].copy()
        k = len(self._t_ns)
        self._t_ns.append(t_ns)
        free = np.flatnonzero(~self._seen[:k].any(axis=0) & ~self._alive)
        wanted = min(core.parameters.landmarks - int(self._alive.sum()), len(free))
        points = core.tracker.find(self._pixels[self._alive], wanted)
        new = free[: len(points)]
        self._pixels[new], self._alive[new] = points, True
        ids = np.flatnonzero(self._alive)
        self._seen[k], self._told[k] = self._alive, 0.0
        self._at[k, ids] = core.lens.normalised(self._pixels[ids]) * (1.0 + c.lens)
        self._told[k, ids] = core.depth(picture, self._pixels[ids]) / c.scale[0]

    def _align(self) -> Alignment | None:
        found = self._structure()
        if found is None:
            return None
        core, x, t_ns = self._core, self._core.inertial, self._t_ns[found.first :]
        increments = blank_increment(len(t_ns) - 1)
        for k in range(len(t_ns) - 1):
            kernel.integrate_into(
                increments, k, x.t_ns, x.samples, x.doubt, x.count, t_ns[k], t_ns[k + 1], core.live.bias, core.noise
            )
        return aligned(found, increments, np.array([x.rate_at(t) for t in t_ns]), self._beliefs())

    def _structure(self) -> Structure | None:
        """Of at least so many pictures as an alignment needs."""
        p, K = self._core.parameters, len(self._t_ns)
        often = self._seen[:K].sum(axis=0) > 1
        s = Sightings(
            seen=self._seen[:K, often], at=self._at[:K, often], told=self._told[:K, often],
            sd=p.pixel_noise_px / self._core.lens.focal_px, told_sd=p.inverse_depth_again_sd_per_m,
        )  # fmt: skip
        found = structure_with_depth(s) if (s.told > 0).any() else structure_of_bearings(s)
        return None if found is None or len(found.R) < self._parameters.views_min else found

    def _beliefs(self) -> Beliefs:
        core, p, c = self._core, self._core.parameters, self._core.window.calibration
        T_imu_camera: Array = np.eye(4)
        T_imu_camera[:3, :3], T_imu_camera[:3, 3] = c.R, c.p
        return Beliefs(
            T_imu_camera=T_imu_camera,
            bias=core.live.bias.copy(),
            bias_sd=core.bias_sd,
            mount_sd=np.repeat([p.extrinsic_position_sd_m, p.extrinsic_rotation_sd_rad], 3),
            offset_sd=p.time_offset_sd_s,
            scale_sd=p.depth_scale_sd,
            gravity=p.gravity_mps2,
        )
