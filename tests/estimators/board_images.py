"""Images of a checkerboard, drawn pixel by pixel through a lens: nothing here is shared with the detector."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stridetwin.streams.rig import Board, CameraCalibration, Mount
from stridetwin.streams.samples import Array, Image

BOARD = Board(name="other", mount=Mount(body="foot_r"), squares=(6, 9), square_m=0.005)
LENSES = {
    "pinhole": ("radtan", (0.0, 0.0, 0.0, 0.0)),
    "radtan": ("radtan", (-0.22, 0.05, 0.001, -0.002)),
    "equidistant": ("equidistant", (0.02, -0.01, 0.004, -0.001)),
}
_FINE = 3


def camera(lens: str = "pinhole", timeshift_s: float = 0.0) -> CameraCalibration:
    """A small camera of 73 degrees."""
    model, distortion = LENSES[lens]
    return CameraCalibration(
        topic="/foot_l/camera",
        part="",
        rate_hz=60.0,
        mount=Mount(body="foot_l"),
        width=400,
        height=300,
        intrinsics=(270.0, 272.0, 201.0, 148.0),
        distortion_model=model,
        distortion=distortion,
        timeshift_cam_imu_s=timeshift_s,
    )


def project(T_camera_board: Array, points_in_board: Array, lens: str) -> Array:
    """(N, 2) pixels by OpenCV."""
    c = camera(lens)
    turn, place = cv2.Rodrigues(T_camera_board[:3, :3])[0], T_camera_board[:3, 3]
    if c.distortion_model == "equidistant":
        points = points_in_board.reshape(-1, 1, 3)
        return cv2.fisheye.projectPoints(points, turn, place, c.K, np.array(c.distortion))[0].reshape(-1, 2)
    return cv2.projectPoints(points_in_board, turn, place, c.K, np.array(c.distortion))[0].reshape(-1, 2)


class Scene:
    """Draws a board before a mottled ground.

    Args:
        lens: One of `LENSES`.
    """

    def __init__(self, lens: str = "pinhole") -> None:
        c = camera(lens)
        self._size = (c.height, c.width)
        fine = (np.arange(_FINE) + 0.5) / _FINE - 0.5
        x = (np.arange(c.width)[:, None] + fine).ravel()
        y = (np.arange(c.height)[:, None] + fine).ravel()
        pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 1, 2)
        undistort = cv2.fisheye.undistortPoints if c.distortion_model == "equidistant" else cv2.undistortPoints
        self._rays = undistort(pixels, c.K, np.array(c.distortion)).reshape(-1, 2)
        ground = np.random.default_rng(5).uniform(40, 190, (30, 40)).astype(np.float32)
        self._ground = cv2.resize(ground, (c.width * _FINE, c.height * _FINE)).ravel()

    def bright(self, T_camera_board: Array, dark: float = 15.0, light: float = 200.0) -> Array:
        """(H, W) exact brightness, averaged over each pixel."""
        r = np.column_stack([self._rays, np.ones(len(self._rays))])
        R, p = T_camera_board[:3, :3], T_camera_board[:3, 3]
        depth = (R[:, 2] @ p) / (r @ R[:, 2])
        u, v = (((r * depth[:, None] - p) @ R[:, :2]) / BOARD.square_m).T
        column, row = np.floor(u + 3), np.floor(v + 4.5)
        printed = (np.abs(u) < 3) & (np.abs(v) < 4.5) & ((column + row) % 2 == 0)
        plate = (np.abs(u) < 4) & (np.abs(v) < 5.5) & (depth > 0)
        fine = np.where(plate, np.where(printed, dark, light), self._ground)
        height, width = self._size
        return fine.reshape(height, _FINE, width, _FINE).mean(axis=(1, 3))


def pose(x: float, y: float, z: float, roll: float, tilt: float, turn: float) -> Array:
    """(4, 4) board that faces the camera when tilt and turn are 0."""
    T = np.eye(4)
    T[:3, :3] = (Rotation.from_rotvec([tilt, turn, 0.0]) * Rotation.from_euler("zx", [roll, np.pi])).as_matrix()
    T[:3, 3] = x, y, z
    return T


def random_pose(rng: np.random.Generator) -> Array:
    """A board that is wholly in view, 4 to 12 pixels a square."""
    z = rng.uniform(0.12, 0.28)
    x, y = rng.uniform(-0.35, 0.35) * z, rng.uniform(-0.2, 0.2) * z
    return pose(x, y, z, rng.uniform(-np.pi, np.pi), rng.uniform(-0.7, 0.7), rng.uniform(-0.7, 0.7))


def image_of(brightness: Array, rng: np.random.Generator, noise: float = 1.5, t_ns: int = 0) -> Image:
    """The image that a camera with read noise gives."""
    noisy: NDArray[np.float64] = brightness + rng.normal(0.0, noise, brightness.shape)
    return Image(topic="/foot_l/camera", t_ns=t_ns, pixels=np.clip(np.round(noisy), 0, 255).astype(np.uint8))
