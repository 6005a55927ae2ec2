"""Features that a simulated head camera tracks, and the IMU beside it: exact motion, noise of both, no images."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.scenarios.image_rotation import PairTracks
from stridetwin.streams.rig import CameraCalibration, Mount
from stridetwin.streams.samples import Block, Imu

HZ, FRAME_HZ, SECONDS = 200, 30, 9.0
SIZE, FOCAL = (640, 480), 600.0
LOOKS_AHEAD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""Rotation of a camera's axes (x right, y down, z forward) into those of an IMU with x forward and z up."""


@dataclass(frozen=True, kw_only=True)
class CameraWalk:
    """A walk in a room; the true camera has focal length `FOCAL`, and the calibration is right by default.

    Attributes:
        arm: Position of the camera on the IMU, m.
        flat: Whether all features are on a wall ahead.
        readout_s: Of a rolling shutter.
        depth_factor: By which measured depths are too large.
        seed: Of the noise.
        segments: Segments of 45 images.
    """

    arm: tuple[float, float, float] = (0.05, 0.02, -0.03)
    flat: bool = False
    readout_s: float = 0.0
    depth_factor: float = 1.0
    seed: int = 0
    segments: int = 3
    pixel_noise: float = 0.15
    T_imu_cam: np.ndarray = field(init=False)

    def __post_init__(self):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = LOOKS_AHEAD, self.arm
        object.__setattr__(self, "T_imu_cam", T)

    def pose(self, t):
        """Rotations and positions of the IMU in the world at times (N,), s."""
        w = 2 * np.pi * 0.9
        roll, pitch, yaw = (
            0.03 * np.sin(w * t + 0.4),
            0.2 + 0.06 * np.sin(2 * w * t + 1) + 0.05 * np.sin(1.7 * t),
            0.08 * np.sin(w * t) + 0.3 * np.sin(0.8 * t),
        )
        p = np.stack(
            (1.1 * t + 0.02 * np.sin(2 * w * t), 0.03 * np.sin(w * t + 0.7), 1.6 + 0.025 * np.cos(2 * w * t)), axis=-1
        )
        return Rotation.from_euler("ZYX", np.stack((yaw, pitch, roll), axis=-1)), p

    def imu(self):
        """Samples of the IMU."""
        t, rng, e = np.arange(round(SECONDS * HZ)) / HZ, np.random.default_rng(self.seed), 1e-4
        (R, _), (before, _), (middle, p) = (self.pose(t - d) for d in (0.0, 1 / HZ, 0.5 / HZ))
        p_before, p_after = (self.pose(t - 0.5 / HZ + d)[1] for d in (-e, e))
        # means over the interval that ends at a stamp
        rate = (before.inv() * R).as_rotvec() * HZ
        force = middle.inv().apply((p_after - 2 * p + p_before) / e**2 + np.array([0, -9.81, 0]))
        columns = {
            "angular_rate": rate + rng.normal(0.005, 0.003, rate.shape),
            "specific_force": force + rng.normal(0.03, 0.03, force.shape),
        }
        return Block(topic="/head/imu", kind=Imu, t_ns=np.rint(t * 1e9).astype(np.int64), columns=columns)

    def camera(self, focal=FOCAL, readout_s=0.0):
        """The calibration."""
        return CameraCalibration(
            topic="/head/color",
            part="",
            rate_hz=FRAME_HZ,
            mount=Mount(body="head", T_body_sensor=self.T_imu_cam),
            width=SIZE[0],
            height=SIZE[1],
            intrinsics=(focal, focal, (SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2),
            depth_topic="/head/depth",
            imu_topic="/head/imu",
            readout_s=readout_s,
        )

    def project(self, points, t):
        """Pixels and depths of points (N, 3) in the world, each at its time (N,)."""
        R, p = self.pose(t)
        body = R.inv().apply(points - p)
        seen = (body - np.array(self.arm)) @ LOOKS_AHEAD
        return FOCAL * seen[:, :2] / seen[:, 2:] + (np.array(SIZE) - 1) / 2, seen[:, 2]

    def expose(self, points, t):
        """Pixels and depths of points in an image at t, whose rows are read one after another."""
        at = np.full(len(points), t)
        for _ in range(3):
            pixels, depth = self.project(points, at)
            at = t + self.readout_s * (pixels[:, 1] / SIZE[1] - 0.5)
        return pixels, depth

    def tracks(self):
        """Tracks of each segment."""
        rng = np.random.default_rng(self.seed + 1)
        segments = []
        for k in range(self.segments):
            start = 0.3 + k * (SECONDS - 2.5) / max(1, self.segments - 1)
            times = start + np.arange(45) / FRAME_HZ
            pairs = []
            for t, following in itertools.pairwise(times):
                points = self._see(rng, t)
                (before, depth), (after, _) = self.expose(points, t), self.expose(points, following)
                noise = rng.normal(0, self.pixel_noise, after.shape)
                far = depth * self.depth_factor * (1 + rng.normal(0, 0.004, len(depth)) * depth)
                stamps = (round(t * 1e9), round(following * 1e9))
                pairs.append(PairTracks(t_ns=stamps, before=before, after=after + noise, depth=far, tracked_px=1.6))
            segments.append(pairs)
        return segments

    def _see(self, rng, t):
        """70 points in the world on the floor, at the walls or on one wall ahead."""
        R, p = self.pose(np.array([t]))
        pixels = rng.uniform((20, 20), (SIZE[0] - 20, SIZE[1] - 20), (70, 2))
        rays = np.column_stack(((pixels - (np.array(SIZE) - 1) / 2) / FOCAL, np.ones(70))) @ LOOKS_AHEAD.T
        rays = R.apply(rays)
        place = p[0] + R.apply(np.array(self.arm))[0]
        if self.flat:
            reach = (place[0] + 3.0 - place[0]) / rays[:, 0]
        else:
            with np.errstate(divide="ignore"):
                floor = np.where(rays[:, 2] < 0, -place[2] / rays[:, 2], np.inf)
            walls = 1.4 / np.maximum(np.abs(rays[:, 1]), 1e-6)
            ahead = 4.0 / np.maximum(rays[:, 0], 1e-6)
            reach = np.minimum(np.minimum(floor, walls), ahead)
        return place + rays * reach[:, None]
