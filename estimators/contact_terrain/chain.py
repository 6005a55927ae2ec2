"""Where a point of a foot is, seen from the back panel, and how that moves with every offset that the filter knows."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stridetwin.estimators.compiled import cached
from stridetwin.estimators.contact_terrain.leg import Links, forward
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent

# Offsets: turns of the frames of back, thighs and feet (rad, frame axes), knees (rad), thighs and shanks (m), and how
# much lower than at push-off a loaded heel sits in its holder (m)
BACK, THIGH, FOOT, KNEE, LENGTH, SAG, OFFSETS = 0, 3, 9, 15, 17, 21, 22


@cached(_HERE)
def foot_place(leg: Links, R: Array, side: int, q: Array) -> tuple[Array, Array]:
    """Where a foot's last frame is, seen from frame 0 in world axes.

    Args:
        leg: Links.
        R: (5, 3, 3) attitudes of back, thighs and feet.
        side: 0 or 1.
        q: Angles of all joints, rad; `leg.leg_angles`.

    Returns:
        (3,) m, origin of the last frame; (3, OFFSETS) its derivative by the offsets.
    """
    poses = forward(leg.table, leg.turns, q)
    R_base = np.ascontiguousarray(R[0])
    hip, at_knee = _at(R_base, poses[leg.thigh - 1]), _at(R_base, poses[leg.knee - 1])
    ankle, foot = _at(R_base, poses[leg.knee]), _at(R_base, poses[-1])
    axis = R_base @ np.ascontiguousarray(poses[leg.knee - 1, :3, 2])
    J = np.zeros((3, OFFSETS))
    J[:, BACK : BACK + 3] = turning(hip, R[0])
    J[:, THIGH + 3 * side : THIGH + 3 * side + 3] = turning(ankle - hip, R[1 + side])
    J[:, FOOT + 3 * side : FOOT + 3 * side + 3] = turning(foot - ankle, R[3 + side])
    J[:, KNEE + side] = np.cross(axis, ankle - at_knee)
    J[:, LENGTH + 2 * side] = (at_knee - hip) / np.sqrt(np.sum((at_knee - hip) ** 2))
    J[:, LENGTH + 2 * side + 1] = (ankle - at_knee) / np.sqrt(np.sum((ankle - at_knee) ** 2))
    return foot, J


@cached(_HERE)
def turning(arm: Array, R: Array) -> Array:
    """(3, 3) derivative of a vector by a small turn of the frame that carries it, in that frame's axes.

    Args:
        arm: (3,) m, the vector in the world.
        R: (3, 3) of the frame.
    """
    x, y, z = arm
    return np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]) @ np.ascontiguousarray(R)


@cached(_HERE)
def _at(R_base: Array, pose: Array) -> Array:
    return R_base @ np.ascontiguousarray(pose[:3, 3])
