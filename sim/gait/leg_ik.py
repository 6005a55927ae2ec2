"""Leg inverse kinematics in closed form: three hip angles, knee, two ankle angles from pelvis and foot.

The leg is hip (flexion, adduction, rotation), knee (flexion), ankle (dorsiflexion, inversion); its thigh and shank
span a plane normal to the knee's axis, which fixes every angle (Kajita et al., Introduction to Humanoid Robotics,
ch. 2.5, with this model's order of axes, and a shank that may be twisted).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.streams.algebra.arrays import rot_x, rot_y, rot_z
from stridetwin.streams.samples import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class LegAngles:
    """Angles of one leg at N instants; all are 0 in upright stance.

    Attributes:
        hip_flexion: (N,) rad, thigh forward positive.
        hip_adduction: (N,) rad, thigh inwards positive.
        hip_rotation: (N,) rad, internal rotation positive.
        knee_flexion: (N,) rad, knee bent positive.
        ankle_dorsiflexion: (N,) rad, toes up positive.
        ankle_inversion: (N,) rad, sole inwards positive.
        stretch: (N,) m, excess of the hip-ankle distance over what the knee limit allows (0 = reached).
    """

    hip_flexion: Array
    hip_adduction: Array
    hip_rotation: Array
    knee_flexion: Array
    ankle_dorsiflexion: Array
    ankle_inversion: Array
    stretch: Array


def ankle_in_world(size: Wearer, p_foot_in_world: Array, R_world_foot: Array) -> Array:
    """(N, 3) m, ankle centres in the world, of feet whose frames have the origins (N, 3) m and rotations (N, 3, 3)."""
    return p_foot_in_world + R_world_foot @ np.array([size.ankle_x, 0.0, size.body.ankle_height_m])


def reach(size: Wearer, knee_flexion: Array | float) -> Array:
    """Distance from hip to ankle, m, at a knee flexion in rad: √(a² + b² + 2 a b cos φ), thigh a and shank b."""
    a, b = size.body.thigh_m, size.body.shank_m
    return np.sqrt(a * a + b * b + 2 * a * b * np.cos(knee_flexion))


def solve_leg(
    size: Wearer,
    side: str,
    p_pelvis_in_world: Array,
    R_world_pelvis: Array,
    p_foot_in_world: Array,
    R_world_foot: Array,
    min_knee: float,
) -> LegAngles:
    """Joint angles that bring a foot to its poses, in closed form.

    The knee is flexed by `min_knee` at least; `LegAngles.stretch` is the distance to a foot that is out of reach.

    Args:
        size: Wearer.
        side: `l` or `r`.
        p_pelvis_in_world: (N, 3) m, midpoint of the hip centres.
        R_world_pelvis: (N, 3, 3).
        p_foot_in_world: (N, 3) m.
        R_world_foot: (N, 3, 3).
        min_knee: Least flexion of the knee, rad.
    """
    sign = 1.0 if side == "l" else -1.0
    p_hip = p_pelvis_in_world + R_world_pelvis @ np.array([0.0, sign * size.body.hip_half_width_m, 0.0])
    in_world = p_hip - ankle_in_world(size, p_foot_in_world, R_world_foot)
    r = np.einsum("nji,nj->ni", R_world_foot, in_world)  # ankle to hip, in the foot's frame
    a, b = size.body.thigh_m, size.body.shank_m
    distance = np.linalg.norm(r, axis=1)  # from ankle to hip; `within` is as much of it as the leg reaches
    within = np.minimum(distance, reach(size, min_knee))
    # law of cosines in the triangle of hip, knee and ankle
    knee = np.arccos(np.clip((within**2 - a * a - b * b) / (2 * a * b), -1.0, 1.0))
    # the hip from the ankle in axes that are twisted against the shank: r = R_x(−inversion) R_y(dorsiflexion) v
    twist = sign * size.body.shank_twist_rad
    v_x, v_z = -a * np.sin(knee) * np.cos(twist), b + a * np.cos(knee)
    v_y = a * np.sin(knee) * np.sin(twist) * distance / within
    above = np.hypot(r[:, 1], r[:, 2])
    upright = above * np.sqrt(1.0 - np.minimum((v_y / above) ** 2, 1.0))
    inversion = np.arctan2(r[:, 1], r[:, 2]) - np.arctan2(v_y, upright)
    dorsiflexion = np.arctan2(r[:, 0], upright) - np.arctan2(v_x, v_z)
    R_world_shank = R_world_foot @ rot_x(-inversion) @ rot_y(dorsiflexion) @ rot_z(np.array(-twist))
    # thigh in the pelvis' frame; it equals R_y(−flexion) R_x(roll) R_z(yaw), from which the hip's angles follow
    R = np.swapaxes(R_world_pelvis, 1, 2) @ R_world_shank @ rot_y(-knee)
    roll = -np.arcsin(np.clip(R[:, 1, 2], -1.0, 1.0))
    return LegAngles(
        hip_flexion=-np.arctan2(R[:, 0, 2], R[:, 2, 2]),
        hip_adduction=-sign * roll,
        hip_rotation=-sign * np.arctan2(R[:, 1, 0], R[:, 1, 1]),
        knee_flexion=knee,
        ankle_dorsiflexion=dorsiflexion,
        ankle_inversion=-sign * inversion,
        stretch=distance - within,
    )
