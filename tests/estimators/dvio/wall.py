"""A camera with IMU before a painted wall: what it measures, without a renderer."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Depth, Image, Imu, Sample

WIDTH, HEIGHT, FOCAL = 320, 240, 200.0
IMU_HZ, CAMERA_HZ = 200, 30
WALL_M, PER_M, SIDE = 2.5, 150, 1500
GRAVITY = np.array([0.0, 0.0, -9.81])
# Optical axes: x right, y down, z forward; the wearer looks along the world's x.
R_WORLD_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
P_CAMERA_IN_IMU = np.array([0.03, -0.007, -0.016])
Motion = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def rig(**imu: float) -> Rig:
    """What the odometry is measured."""
    T = np.eye(4)
    T[:3, 3] = P_CAMERA_IN_IMU
    camera = CameraCalibration(
        topic="/head/color",
        part="wall",
        rate_hz=CAMERA_HZ,
        mount=Mount(body="head", T_body_sensor=T),
        width=WIDTH,
        height=HEIGHT,
        intrinsics=(FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2),
        depth_topic="/head/depth",
        imu_topic="/head/imu",
    )
    measured = ImuCalibration(
        topic="/head/imu",
        part="wall",
        rate_hz=IMU_HZ,
        mount=Mount(body="head"),
        gyroscope_noise_density=2.4e-4,
        gyroscope_random_walk=5e-6,
        accelerometer_noise_density=1.5e-3,
        accelerometer_random_walk=4e-5,
        gyroscope_bias_sd=0.02,
        accelerometer_bias_sd=0.1,
        gyroscope_range=17.0,
        accelerometer_range=39.0,
        **imu,
    )
    return Rig(cameras={"/head/color": camera}, imus={"/head/imu": measured})


def still(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) places of the IMU, m, and (N, 3) rotation vectors from the world to how it is held."""
    return np.zeros((len(t), 3)), np.zeros((len(t), 3))


def swaying(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """At rest for a second, then about and turning, as a head does."""
    on = np.clip(t - 1.0, 0.0, 1.0) ** 2 * (3 - 2 * np.clip(t - 1.0, 0.0, 1.0))
    p = np.stack([0.25 * np.sin(2.1 * t), 0.5 * np.sin(1.3 * t), 0.15 * np.sin(5.0 * t)], axis=1)
    turn = np.stack([0.10 * np.sin(1.7 * t), 0.15 * np.sin(2.3 * t), 0.2 * np.sin(1.1 * t)], axis=1)
    return on[:, None] * p, on[:, None] * turn


class Wall:
    """Samples of a motion, and its truth.

    Args:
        motion: Places and rotation vectors by time.
        seconds: How long.
        seed: Of paint and noise.
        bias: (6,) of the IMU.
        late_s: How much later than measured images are taken.
    """

    def __init__(
        self, motion: Motion, seconds: float, seed: int = 0, bias: np.ndarray | None = None, late_s: float = 0.0
    ) -> None:
        self._rng = np.random.default_rng(seed)
        self._motion, self.seconds, self._late = motion, seconds, late_s
        self._bias = np.zeros(6) if bias is None else bias
        coarse = self._rng.uniform(60, 200, (SIDE // 12, SIDE // 12)).astype(np.float32)
        fine = self._rng.uniform(-25, 25, (SIDE // 3, SIDE // 3)).astype(np.float32)
        size = (SIDE, SIDE)
        self._paint = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC) + cv2.resize(fine, size)
        v, u = np.mgrid[:HEIGHT, :WIDTH]
        self._rays = np.stack(
            [(u - (WIDTH - 1) / 2) / FOCAL, (v - (HEIGHT - 1) / 2) / FOCAL, np.ones(u.shape)], axis=-1
        )

    def pose(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """(3, 3) world <- IMU and (3,) place of the IMU."""
        p, turn = self._motion(np.array([t]))
        return Rotation.from_rotvec(turn[0]).as_matrix() @ R_WORLD_CAMERA, p[0]

    def samples(self) -> Iterator[Sample]:
        """In time order, images after the IMU's of the same time."""
        n = round(self.seconds * IMU_HZ)
        t = np.arange(n + 1) / IMU_HZ
        _, turn = self._motion(t)
        R = Rotation.from_rotvec(turn) * Rotation.from_matrix(R_WORLD_CAMERA)
        h = 1e-4
        after, before = self._motion(t + h)[0], self._motion(t - h)[0]
        v = (after - before) / (2 * h)
        rate = (R[:-1].inv() * R[1:]).as_rotvec() * IMU_HZ
        middle = R[:-1] * Rotation.from_rotvec(0.5 * rate / IMU_HZ)
        force = middle.inv().apply(np.diff(v, axis=0) * IMU_HZ - GRAVITY)
        measured = np.hstack([rate, force]) + self._bias
        measured += self._rng.normal(size=measured.shape) * np.repeat([2.4e-4, 1.5e-3], 3) * np.sqrt(IMU_HZ)
        due = 0
        for k in range(n):
            t_ns = round((k + 1) * 1e9 / IMU_HZ)
            while round(due * 1e9 / CAMERA_HZ) < t_ns:
                yield from self.images(round(due * 1e9 / CAMERA_HZ))
                due += 1
            yield Imu(topic="/head/imu", t_ns=t_ns, angular_rate=measured[k, :3], specific_force=measured[k, 3:])

    def images(self, t_ns: int) -> tuple[Image, Depth]:
        """Colour and depth stamped with a time."""
        R, p = self.pose(t_ns * 1e-9 + self._late)
        c = p + R @ P_CAMERA_IN_IMU
        K = np.array([[FOCAL, 0, (WIDTH - 1) / 2], [0, FOCAL, (HEIGHT - 1) / 2], [0, 0, 1]])
        corner = np.array([WALL_M, SIDE / 2 / PER_M, SIDE / 2 / PER_M])
        along = np.stack([[0, -1 / PER_M, 0], [0, 0, -1 / PER_M], corner - c], axis=1)
        H = K @ R.T @ along
        grey = cv2.warpPerspective(self._paint, H, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR, borderValue=128)
        grey = np.clip(grey + self._rng.normal(0, 1.5, grey.shape), 0, 255).astype(np.uint8)
        inverse = (self._rays @ R[0]) / (WALL_M - c[0])
        coarse = self._rng.normal(0, 4e-3, (HEIGHT // 4, WIDTH // 4)).astype(np.float32)
        inverse += cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST)
        depth = np.where(inverse > 0.12, 1 / np.maximum(inverse, 0.12), 0).astype(np.float32)
        return (
            Image(topic="/head/color", t_ns=t_ns, pixels=grey),
            Depth(topic="/head/depth", t_ns=t_ns, depth=depth),
        )
