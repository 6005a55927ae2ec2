"""Rigid transforms from an estimator's world to the true one: fixed for a whole path, or per instant.

The alignment at an instant removes the drift of the poses, so that it does not count as an error of the terrain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.streams.samples import Array
from stridetwin.streams.trajectory import Trajectory

ALIGNMENTS = ("start", "yaw", "se3")


@dataclass(frozen=True, kw_only=True, eq=False)
class Rigid:
    """A rigid transform p ↦ R p + t from the estimate's world to the truth's.

    Attributes:
        R: (3, 3) rotation.
        t: (3,) m.
    """

    R: Array
    t: Array

    def apply(self, path: Trajectory) -> Trajectory:
        """The path in the truth's world; its covariances, along the axes of the world, are rotated with it."""
        attitudes = Rotation.from_matrix(self.R) * Rotation.from_quat(path.q_world_frame, scalar_first=True)
        covariance = path.covariance
        if covariance is not None:
            # block-diagonal: one R for each three components, position and, where there are six, rotation
            R_blocks = np.kron(np.eye(covariance.shape[-1] // 3), self.R)
            covariance = R_blocks @ covariance @ R_blocks.T
        return replace(
            path,
            p_frame_in_world=path.p_frame_in_world @ self.R.T + self.t,
            q_world_frame=attitudes.as_quat(scalar_first=True),
            covariance=covariance,
        )


def align(estimate: Trajectory, truth: Trajectory, how: str) -> Rigid:
    """Computes the transform from the world of an estimated path to that of the truth.

    Only the four directions that inertia and gravity cannot observe are aligned, except with `se3`.

    Args:
        estimate: N poses.
        truth: The N true poses at the same stamps.
        how: `start`: position and yaw agree at the first pose; `yaw`: the least-squares translation and rotation about
            the vertical; `se3`: the least-squares translation and rotation (Umeyama 1991, IEEE TPAMI 13(4):376-380,
            without scale).

    Raises:
        ValueError: No such alignment.
    """
    if how == "start":
        R = vertical_rotation(_rotation(truth.q_world_frame[0]) @ _rotation(estimate.q_world_frame[0]).T)
        return Rigid(R=R, t=truth.p_frame_in_world[0] - R @ estimate.p_frame_in_world[0])
    # (3,) m, mean positions of estimate and truth, and (3, 3) sum of the products of their offsets from these
    mean_e, mean_t = estimate.p_frame_in_world.mean(axis=0), truth.p_frame_in_world.mean(axis=0)
    H = (truth.p_frame_in_world - mean_t).T @ (estimate.p_frame_in_world - mean_e)
    if how == "yaw":
        R = vertical_rotation(H)
    elif how == "se3":
        # the factor det(U Vᵀ) keeps R a rotation where the best fit would be a reflection
        U, _, Vt = np.linalg.svd(H)
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    else:
        raise ValueError(f"invalid alignment {how!r}: expected {', '.join(ALIGNMENTS)}")
    return Rigid(R=R, t=mean_t - R @ mean_e)


def vertical_rotation(M: Array) -> Array:
    """The rotations (..., 3, 3) about z that maximise tr(Rᵀ M) for matrices (..., 3, 3).

    The angle is atan2(M₂₁ - M₁₂, M₁₁ + M₂₂). With M = Σ t eᵀ of centred points this is the least-squares rotation about
    the vertical from points e to points t; with a rotation matrix M it is the nearest such rotation.
    """
    a = np.arctan2(M[..., 1, 0] - M[..., 0, 1], M[..., 0, 0] + M[..., 1, 1])
    return np.asarray(Rotation.from_rotvec(a[..., None] * np.array([0.0, 0.0, 1.0])).as_matrix())


def _rotation(q: Array) -> Array:
    """(3, 3) rotation matrix of a quaternion (w, x, y, z)."""
    return np.asarray(Rotation.from_quat(q, scalar_first=True).as_matrix())


@dataclass(frozen=True, kw_only=True, eq=False)
class YawAlignment:
    """A translation and a rotation about the vertical between two worlds.

    Attributes:
        estimated: (3,) m, estimated position of the frame.
        true: (3,) m, its true position.
        yaw: rad, rotation from the estimator's world to the true one.
    """

    estimated: Array
    true: Array
    yaw: float = 0.0

    @property
    def rotation(self) -> Array:
        """(2, 2) in the horizontal plane, from the estimator's world to the true one."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([[c, -s], [s, c]])

    def to_true(self, points: Array) -> Array:
        """Points in the true world from points in the estimator's; both (..., 2 or 3) m."""
        return self._transform_points(points, self.estimated, self.true, self.rotation)

    def to_estimated(self, points: Array) -> Array:
        """Points in the estimator's world from points in the true one; both (..., 2 or 3) m."""
        return self._transform_points(points, self.true, self.estimated, self.rotation.T)

    @staticmethod
    def _transform_points(points: Array, origin: Array, target: Array, rotation: Array) -> Array:
        """Points (..., 2 or 3) rotated about the vertical around `origin`, which then becomes `target`, m."""
        # points of two coordinates use the horizontal part of `origin` and `target`
        offset = np.asarray(points, float) - origin[: np.shape(points)[-1]]
        offset[..., :2] = offset[..., :2] @ rotation.T
        return np.asarray(offset + target[: offset.shape[-1]])


class MovingAlignment:
    """Aligns an estimator's world with the true one at each instant, which removes the drift.

    Args:
        estimate: Poses that the estimator received.
        truth: True poses of the same frame at the same stamps.
    """

    def __init__(self, estimate: Trajectory, truth: Trajectory) -> None:
        self._t_ns = estimate.t_ns
        self._estimated, self._true = estimate.p_frame_in_world, truth.p_frame_in_world  # (N, 3) m
        # (N,) rad, rotation from the estimator's world to the true one at each pose
        self._yaw = _yaw(truth.q_world_frame) - _yaw(estimate.q_world_frame)

    def at(self, t_ns: int) -> YawAlignment:
        """The alignment at the last pose up to a time, or at the first pose."""
        i = max(0, int(np.searchsorted(self._t_ns, t_ns, side="right")) - 1)
        return YawAlignment(estimated=self._estimated[i], true=self._true[i], yaw=float(self._yaw[i]))

    def point(self, t_ns: int, p: Array) -> Array:
        """A point in the true world from one in the estimator's world at a time; (2,) or (3,) m."""
        return self.at(t_ns).to_true(p)


def _yaw(q: Array) -> Array:
    """(N,) rotation about the vertical of (N, 4) quaternions (w, x, y, z), rad."""
    w, x, y, z = q.T
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
