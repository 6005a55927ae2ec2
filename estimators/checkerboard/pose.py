"""An observed board: its corners in one image, its pose with covariance, and the second pose that a plane has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

MIN_POINTS, MAX_POINTS = 4, 64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardObservation:
    """Corners of one board in one image; each corner's identity is certain, its position is not.

    Attributes:
        topic: Stream of the image.
        t_ns: Middle of the exposure on the clock of the IMUs (the image's stamp and `timeshift_cam_imu_s`).
        points_in_board: (M, 3) corners in the board's frame, m, 4 ≤ M ≤ 64.
        rays: (M, 2) x / z and y / z of each in the camera's optical frame, lens undistorted.
        ray_sd: (M,) standard deviation of each coordinate of a ray (root mean square of the two), blur included.
    """

    topic: str
    t_ns: int
    points_in_board: Array
    rays: Array
    ray_sd: Array

    def __post_init__(self) -> None:
        """Raises ConfigError where an array has another shape or is not finite."""
        m = len(self.points_in_board)
        if not MIN_POINTS <= m <= MAX_POINTS:
            raise ConfigError("BoardObservation", "points_in_board", m, f"{MIN_POINTS} to {MAX_POINTS} points")
        for name, shape in (("points_in_board", (m, 3)), ("rays", (m, 2)), ("ray_sd", (m,))):
            value = getattr(self, name)
            if np.shape(value) != shape or not np.all(np.isfinite(value)):
                raise ConfigError("BoardObservation", name, value, f"finite numbers of shape {shape}")
        if not np.all(self.ray_sd > 0.0):
            raise ConfigError("BoardObservation", "ray_sd", self.ray_sd, "numbers > 0")


CHI2_GATE = 9.0
"""Solutions are distinguished if their squared residuals differ by more than this: 3 standard deviations."""
_ROUNDS = 12  # of Gauss-Newton, at most
_SETTLED = 1e-9  # m and rad
_LEAST_SPREAD = 1e-3  # least over greatest extent of the corners: below, they are collinear and define no plane


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardPose:
    """One pose that explains an observation.

    Attributes:
        T_camera_board: (4, 4) board frame to the camera's optical frame, m.
        covariance: (6, 6) of (position in the camera's frame, m; rotation about the camera's axes, rad).
        chi2: Sum of the squared residuals of the rays over their standard deviations.
    """

    T_camera_board: Array
    covariance: Array
    chi2: float


def find_board_poses(observation: BoardObservation) -> tuple[BoardPose, ...]:
    """All locally optimal poses for the corners of one image, the most likely first.

    From far away a plane tilted one way looks nearly like that plane tilted the other way: both solutions of Collins &
    Bartoli 2014 (IPPE, IJCV 109:252) are refined on the corners, each weighted by its certainty.

    Returns:
        Two poses, or one if both solutions converge to it; none if the corners are collinear.
    """
    points, rays = observation.points_in_board, observation.rays
    # extents of the corners along their longest direction and across it
    longest, shortest = np.linalg.svd(points[:, :2] - points[:, :2].mean(axis=0), compute_uv=False)
    if shortest < _LEAST_SPREAD * longest:
        return ()
    # number of solutions; rotation vector, rad, and position, m, of each: board frame to optical frame
    count, rotations, positions, _ = cv2.solvePnPGeneric(
        points, rays.reshape(-1, 1, 2), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
    )
    poses: list[BoardPose] = []
    for i in range(count):
        start = np.eye(4)
        start[:3, :3], start[:3, 3] = cv2.Rodrigues(rotations[i])[0], positions[i].ravel()
        pose = _refine_pose(observation, start) if np.isfinite(start).all() else None
        if pose is not None and not any(_is_same(pose, other) for other in poses):
            poses.append(pose)
    return tuple(sorted(poses, key=lambda pose: pose.chi2))


def select_poses(
    poses: Sequence[BoardPose], R_camera_board: ArrayLike | None = None, rotation_sd: float = np.inf
) -> tuple[BoardPose, ...]:
    """The poses that cannot be ruled out.

    Args:
        poses: Results of `find_board_poses`.
        R_camera_board: (3, 3) prior of the board's orientation, such as from both feet's attitudes.
        rotation_sd: Standard deviation of the prior about each axis, rad; inf = no prior.

    Returns:
        Those whose squared residuals, and deviation from the prior, are within `CHI2_GATE` of the least.
    """
    # squared residuals, plus the squared Mahalanobis distance of the rotation from the prior
    costs = [pose.chi2 for pose in poses]
    if R_camera_board is not None and np.isfinite(rotation_sd):
        R_prior = np.asarray(R_camera_board, dtype=float)
        for i, pose in enumerate(poses):
            # (3,) rotation vector from the prior to the pose, rad, camera's axes; (3, 3) its covariance
            off = cv2.Rodrigues(pose.T_camera_board[:3, :3] @ R_prior.T)[0].ravel()
            covariance = pose.covariance[3:, 3:] + rotation_sd**2 * np.eye(3)
            costs[i] += float(off @ np.linalg.solve(covariance, off))
    return tuple(pose for pose, cost in zip(poses, costs) if cost <= min(costs) + CHI2_GATE)


def _refine_pose(observation: BoardObservation, T_camera_board: Array) -> BoardPose | None:
    """The pose of least squared residuals of the rays, by Gauss-Newton from a start.

    Args:
        observation: Corners of the board.
        T_camera_board: (4, 4) pose to start from, m.

    Returns:
        The pose with its covariance; None if a corner comes to lie behind the camera, or if the corners do not
        determine the pose.
    """
    R, p = T_camera_board[:3, :3], T_camera_board[:3, 3]
    sd = np.broadcast_to(observation.ray_sd, len(observation.rays))
    for _ in range(_ROUNDS):
        rotated = observation.points_in_board @ R.T  # (M, 3) m, from the board's origin, camera's axes
        x, y, z = (rotated + p).T
        if z.min() <= 0:  # a corner is not in front of the camera
            return None
        residual = (observation.rays - np.column_stack([x, y]) / z[:, None]) / sd[:, None]
        # derivatives of each ray (x / z, y / z) by position and rotation of the board, both in the camera's axes
        by_position = np.zeros((len(z), 2, 3))
        by_position[:, 0, 0] = by_position[:, 1, 1] = 1 / z
        by_position[:, 0, 2], by_position[:, 1, 2] = -x / z**2, -y / z**2
        by_rotation = np.cross(rotated[:, None, :], by_position)  # P moves by rotation x rotated
        J = np.concatenate([by_position, by_rotation], axis=2) / sd[:, None, None]
        J = J.reshape(-1, 6)
        N = J.T @ J  # information of position and rotation: residuals and J are in standard deviations
        if np.linalg.matrix_rank(N, hermitian=True) < 6:
            return None
        step = np.linalg.solve(N, J.T @ residual.ravel())
        if np.abs(step).max() < _SETTLED:
            break
        p, R = p + step[:3], cv2.Rodrigues(step[3:])[0] @ R
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return BoardPose(T_camera_board=T, covariance=np.asarray(np.linalg.inv(N), float), chi2=float((residual**2).sum()))


def _is_same(a: BoardPose, b: BoardPose) -> bool:
    """Whether two solutions are equal up to rounding."""
    return bool(np.abs(a.T_camera_board - b.T_camera_board).max() < 1e-4)
