"""Where the exoskeleton's frame settles on the wearer: quasi-static balance of its compliant couplings.

Each leg of the frame hangs on the pelvis by six joints (order of Shim et al. 2019) and is tied to the wearer at the
thigh cuff, the shank cuff and the shoe. Its joint angles minimise the elastic energy of these couplings (Gauss-Newton
on all instants at once); what stays of the misalignment gives the interaction forces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stridetwin.sim.body import Wearer
from stridetwin.sim.rotation import rot_x, rot_y, rot_z
from stridetwin.streams.samples import Array

CUFF_STIFFNESS = 2500.0  # N/m, strap and soft tissue
SHOE_STIFFNESS = 60e3  # N/m
SHOE_TURN_STIFFNESS = 300.0  # N m/rad
THIGH_CUFF_Z = -0.215  # in the exoskeleton's thigh frame
SHANK_CUFF_Z = -0.185
_PIVOT_BACK_X = -0.150
_SIDE_Y = 0.118
_ITERATIONS = 4
_ADDUCTION, _ROTATION, _FLEXION, _KNEE, _DORSIFLEXION, _INVERSION = range(6)


@dataclass(frozen=True, kw_only=True, eq=False)
class ExoLeg:
    """One leg of the frame.

    Attributes:
        angles: (N, 6) rad in the order of `body.EXO_LEG_JOINTS`.
        thigh_force: (N,) N, fore-aft force of the thigh cuff on the wearer, forward positive.
        shank_force: (N,) N, likewise.
    """

    angles: Array
    thigh_force: Array
    shank_force: Array


def fit_exo_leg(
    size: Wearer, side: str, R_world_pelvis: Array, p_pelvis: Array, R_world_thigh: Array, R_world_shank: Array,
    p_foot: Array, R_world_foot: Array,
) -> ExoLeg:  # fmt: skip
    """Angles and cuff forces of one leg, from the wearer's pose (each (N, 3) or (N, 3, 3), world)."""
    to_pelvis = np.swapaxes(R_world_pelvis, 1, 2)
    foot = np.einsum("nij,nj->ni", to_pelvis, p_foot - p_pelvis)
    R_thigh, R_shank, R_foot = to_pelvis @ R_world_thigh, to_pelvis @ R_world_shank, to_pelvis @ R_world_foot
    if side == "r":  # the right leg is the left one reflected on the sagittal plane
        flip = np.diag([1.0, -1.0, 1.0])
        foot = foot @ flip
        R_thigh, R_shank, R_foot = flip @ R_thigh @ flip, flip @ R_shank @ flip, flip @ R_foot @ flip
    hip = np.array([0.0, size.body.hip_half_width_m, 0.0])
    knee = hip + R_thigh @ np.array([0.0, 0.0, -size.body.thigh_m])
    targets = (
        hip + R_thigh @ np.array([0.0, 0.0, THIGH_CUFF_Z]),
        knee + R_shank @ np.array([0.0, 0.0, SHANK_CUFF_Z]),
        foot,
    )
    n = len(foot)
    q = np.zeros((n, 6))
    q[:, _FLEXION] = np.arctan2(-R_thigh[:, 0, 2], R_thigh[:, 2, 2])
    q[:, _KNEE] = np.arccos(np.clip(np.einsum("ni,ni->n", R_thigh[:, :, 2], R_shank[:, :, 2]), -1, 1))
    ankle = np.swapaxes(R_shank, 1, 2) @ R_foot
    q[:, _DORSIFLEXION] = np.arctan2(-ankle[:, 0, 2], ankle[:, 2, 2])
    for _ in range(_ITERATIONS):
        residual, jacobian, _ = _couplings(size, q, targets, R_foot)
        normal = np.einsum("nki,nkj->nij", jacobian, jacobian) + 1e-3 * np.eye(6)
        q = q - np.linalg.solve(normal, np.einsum("nki,nk->ni", jacobian, residual)[..., None])[..., 0]
    _, _, slip = _couplings(size, q, targets, R_foot)
    return ExoLeg(angles=q, thigh_force=CUFF_STIFFNESS * slip[0], shank_force=CUFF_STIFFNESS * slip[1])


def _couplings(
    size: Wearer, q: Array, targets: tuple[Array, Array, Array], R_foot: Array
) -> tuple[Array, Array, tuple[Array, Array]]:
    """Residuals (N, 10) of the couplings in √J, their Jacobian (N, 10, 6), and the cuffs' fore-aft misalignment."""
    n = len(q)
    x, y, z = np.eye(3)
    back = np.array([_PIVOT_BACK_X, size.body.hip_half_width_m, 0.0])
    R1 = rot_x(-q[:, _ADDUCTION])
    rotation_pivot = back + R1 @ (_SIDE_Y * y)
    R2 = R1 @ rot_z(-q[:, _ROTATION])
    hip = rotation_pivot + R2 @ (-_PIVOT_BACK_X * x)
    R3 = R2 @ rot_y(-q[:, _FLEXION])
    knee = hip + R3 @ (-size.exo_thigh_m * z)
    R4 = R3 @ rot_y(q[:, _KNEE])
    ankle = knee + R4 @ (-size.exo_shank_m * z)
    R5 = R4 @ rot_y(-q[:, _DORSIFLEXION])
    inner = ankle + R5 @ (-_SIDE_Y * y)
    R6 = R5 @ rot_x(-q[:, _INVERSION])
    foot = inner + R6 @ np.array([-size.ankle_x, 0.0, -size.body.ankle_height_m])
    thigh_cuff = hip + R3 @ np.array([0.0, -_SIDE_Y, THIGH_CUFF_Z])
    shank_cuff = knee + R4 @ np.array([0.0, -_SIDE_Y, SHANK_CUFF_Z])
    axes = np.stack(
        [np.broadcast_to(-x, (n, 3)), -R1[:, :, 2], -R2[:, :, 1], R3[:, :, 1], -R4[:, :, 1], -R5[:, :, 0]], 1
    )
    pivots = np.stack([np.broadcast_to(back, (n, 3)), rotation_pivot, hip, knee, ankle, inner], 1)

    def moves(point: Array, joints: int) -> Array:
        J = np.cross(axes, point[:, None] - pivots)
        J[:, joints:] = 0.0
        return np.swapaxes(J, 1, 2)

    rows_r, rows_j, slips = [], [], []
    for point, target, frame, joints in ((thigh_cuff, targets[0], R3, 3), (shank_cuff, targets[1], R4, 4)):
        across = np.swapaxes(frame, 1, 2)[:, :2]  # the cuff slides along the limb, it pushes fore-aft and sideways
        rows_r.append(np.sqrt(CUFF_STIFFNESS) * np.einsum("nij,nj->ni", across, point - target))
        rows_j.append(np.sqrt(CUFF_STIFFNESS) * across @ moves(point, joints))
        slips.append(np.einsum("ni,ni->n", frame[:, :, 0], point - target))
    rows_r.append(np.sqrt(SHOE_STIFFNESS) * (foot - targets[2]))
    rows_j.append(np.sqrt(SHOE_STIFFNESS) * moves(foot, 6))
    error = 0.5 * sum(np.cross(R_foot[:, :, i], R6[:, :, i]) for i in range(3))  # rotation vector, small angles
    rows_r.append(np.sqrt(SHOE_TURN_STIFFNESS) * error)
    rows_j.append(np.sqrt(SHOE_TURN_STIFFNESS) * np.swapaxes(axes, 1, 2))
    return np.concatenate(rows_r, 1), np.concatenate(rows_j, 1), (slips[0], slips[1])
