"""Images, depth and IMU of a camera that walks over a textured floor towards a wall, from a few formulas."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Block, Depth, Image, Imu

WIDTH, HEIGHT, F = 320, 240, 200.0
IMU_HZ, IMAGE_HZ, SECONDS = 200, 25, 8.0
PX_PER_M, FLOOR_M = 60, (24.0, 10.0)
WALL_M = 16.0
"""Distance of the wall from the start; further than depth is measured until the walk comes near."""
FARTHEST_M = 8.0
G = 9.81
# optical axes in the body's (x forward, y left, z up), looking straight ahead
OPTICAL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def position(t: np.ndarray) -> np.ndarray:
    """(N, 3) m of the head, which bounces 2.5 cm at 1.8 Hz and sways."""
    step = 2 * np.pi * 1.8 * t
    x = 1.2 * t + 0.012 * np.sin(step + 1.0)
    return np.column_stack((x, 0.02 * np.sin(step / 2), 1.6 + 0.025 * np.sin(step)))


def attitude(t: np.ndarray) -> Rotation:
    """Body to world: looks 30° down, and around."""
    yaw, pitch = 0.2 * np.sin(2 * np.pi * 0.5 * t), 0.52 + 0.04 * np.sin(2 * np.pi * 0.9 * t)
    return Rotation.from_euler("ZYX", np.column_stack((yaw, pitch, 0.02 * np.sin(2 * np.pi * 0.9 * t))))


@dataclass
class FloorWalk:
    """The walk as it was: images, depth in m, poses of the camera and samples of the IMU, which are at one place."""

    t_ns: np.ndarray
    pixels: list[np.ndarray]
    depth: list[np.ndarray]
    T_world_camera: np.ndarray
    imu: Block[Imu]

    def samples(self, depth_factor: float = 1.0) -> Iterator[Image | Depth]:
        for t, pixels, depth in zip(self.t_ns.tolist(), self.pixels, self.depth):
            yield Image(topic="/head/color", t_ns=t, pixels=pixels)
            yield Depth(topic="/head/depth", t_ns=t, depth=(depth * depth_factor).astype(np.float32))


def rig(focal_factor: float = 1.0, with_imu: bool = True) -> Rig:
    T_body_camera = np.eye(4)
    T_body_camera[:3, :3] = OPTICAL
    mount = Mount(body="head")
    imu = ImuCalibration(
        topic="/head/imu",
        part="",
        rate_hz=float(IMU_HZ),
        mount=mount,
        gyroscope_noise_density=1e-3,
        gyroscope_random_walk=2e-5,
        accelerometer_noise_density=1e-2,
        accelerometer_random_walk=3e-4,
    )
    camera = CameraCalibration(
        topic="/head/color",
        part="",
        rate_hz=float(IMAGE_HZ),
        mount=Mount(body="head", T_body_sensor=T_body_camera),
        width=WIDTH,
        height=HEIGHT,
        intrinsics=(focal_factor * F, focal_factor * F, (WIDTH - 1) / 2, (HEIGHT - 1) / 2),
        depth_topic="/head/depth",
        imu_topic="/head/imu" if with_imu else "",
    )
    return Rig(imus={imu.topic: imu} if with_imu else {}, cameras={camera.topic: camera})


def walk_over_floor(seed: int = 1) -> FloorWalk:
    """The walk, with noise of a consumer IMU and 1 % of noise in depth at 2 m."""
    rng = np.random.default_rng(seed)
    texture = cv2.GaussianBlur(
        rng.integers(0, 256, (int(FLOOR_M[1] * PX_PER_M), int(FLOOR_M[0] * PX_PER_M)), np.uint8), (0, 0), 1.0
    )
    texture = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX)
    t = np.arange(0.2, SECONDS - 0.2, 1 / IMAGE_HZ)
    R = attitude(t).as_matrix() @ OPTICAL
    p = position(t)
    K = np.array([[F, 0, (WIDTH - 1) / 2], [0, F, (HEIGHT - 1) / 2], [0, 0, 1]])
    rays = np.stack([*np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), np.ones((HEIGHT, WIDTH))], axis=-1)
    rays = rays @ np.linalg.inv(K).T
    pixels, depths = [], []
    for R_world_camera, centre in zip(R, p):
        directions = rays @ R_world_camera.T
        with np.errstate(divide="ignore"):
            floor = np.where(directions[..., 2] < -1e-3, -centre[2] / directions[..., 2], np.inf)
            wall = np.where(directions[..., 0] > 1e-3, (WALL_M - centre[0]) / directions[..., 0], np.inf)
        is_wall, depth = wall < floor, np.minimum(floor, wall)
        at = centre + directions * np.where(np.isfinite(depth), depth, 0.0)[..., None]
        u = np.where(is_wall, WALL_M + at[..., 2], at[..., 0] + 1.0) * PX_PER_M
        v = (at[..., 1] + FLOOR_M[1] / 2) * PX_PER_M
        grey = cv2.remap(texture, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR)
        noise = cv2.resize(rng.normal(0, 0.005, (HEIGHT // 4, WIDTH // 4)), (WIDTH, HEIGHT))
        depth = np.where(depth < FARTHEST_M, depth + noise * depth**2, 0.0)
        pixels.append(grey)
        depths.append(depth)
    T = np.tile(np.eye(4), (len(t), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R, p
    return FloorWalk(np.rint(t * 1e9).astype(np.int64), pixels, depths, T, _inertial(rng))


def _inertial(rng: np.random.Generator) -> Block[Imu]:
    t, h = np.arange(1, int(SECONDS * IMU_HZ)) / IMU_HZ, 1e-3
    middle = t - 0.5 / IMU_HZ  # a sample is the mean of the interval before it
    a = (position(middle + h) - 2 * position(middle) + position(middle - h)) / h**2
    R = attitude(middle)
    rate = (attitude(middle - h).inv() * attitude(middle + h)).as_rotvec() / (2 * h)
    force = R.inv().apply(a + [0, 0, G])
    columns = {
        "angular_rate": rate + rng.normal(0, 0.003, rate.shape) + [0.01, -0.01, 0.005],
        "specific_force": force + rng.normal(0, 0.03, force.shape) + [0.1, 0.05, -0.1],
    }
    return Block(topic="/head/imu", kind=Imu, t_ns=np.rint(t * 1e9).astype(np.int64), columns=columns)
