"""Rigid transforms that lay an estimated path over the true one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.streams.samples import Array
from stridetwin.streams.trajectory import Trajectory

ALIGNMENTS = ("start", "yaw", "se3")


@dataclass(frozen=True, kw_only=True, eq=False)
class Rigid:
    """p ↦ R p + t, from the estimate's world to the truth's.

    Attributes:
        R: (3, 3) rotation.
        t: (3,) m.
    """

    R: Array
    t: Array

    def apply(self, path: Trajectory) -> Trajectory:
        """The path as seen in the truth's world; the covariance of the position turns with it."""
        turned = Rotation.from_matrix(self.R) * Rotation.from_quat(path.q_world_frame, scalar_first=True)
        covariance = path.covariance
        if covariance is not None:
            G = np.kron(np.eye(covariance.shape[-1] // 3), self.R)
            covariance = G @ covariance @ G.T
        return replace(
            path,
            p_frame_in_world=path.p_frame_in_world @ self.R.T + self.t,
            q_world_frame=turned.as_quat(scalar_first=True),
            covariance=covariance,
        )


def align(estimate: Trajectory, truth: Trajectory, how: str) -> Rigid:
    """The transform from the estimate's world to the truth's.

    Args:
        estimate: N poses.
        truth: The N true poses at the same stamps.
        how: `start`: position and yaw agree at the first pose (which inertia cannot tell); `yaw`: the
            least-squares shift and turn about the vertical; `se3`: the least-squares shift and rotation
            (Umeyama 1991, IEEE TPAMI 13(4):376-380, without scale).
    """
    if how == "start":
        R = vertical_turn(_rotation(truth.q_world_frame[0]) @ _rotation(estimate.q_world_frame[0]).T)
        return Rigid(R=R, t=truth.p_frame_in_world[0] - R @ estimate.p_frame_in_world[0])
    mean_e, mean_t = estimate.p_frame_in_world.mean(axis=0), truth.p_frame_in_world.mean(axis=0)
    H = (truth.p_frame_in_world - mean_t).T @ (estimate.p_frame_in_world - mean_e)
    if how == "yaw":
        R = vertical_turn(H)
    elif how == "se3":
        U, _, Vt = np.linalg.svd(H)
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    else:
        raise ValueError(f"alignment {how!r}; valid: {', '.join(ALIGNMENTS)}")
    return Rigid(R=R, t=mean_t - R @ mean_e)


def vertical_turn(M: Array) -> Array:
    """The rotations (..., 3, 3) about z that maximise tr(Rᵀ M) for matrices (..., 3, 3)."""
    a = np.arctan2(M[..., 1, 0] - M[..., 0, 1], M[..., 0, 0] + M[..., 1, 1])
    return np.asarray(Rotation.from_rotvec(a[..., None] * np.array([0.0, 0.0, 1.0])).as_matrix())


def _rotation(q: Array) -> Array:
    return np.asarray(Rotation.from_quat(q, scalar_first=True).as_matrix())
