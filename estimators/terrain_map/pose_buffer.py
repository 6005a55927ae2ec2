"""Buffer of the incoming poses; gives the pose at an image's time."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.streams.samples import Array, Odometry


def is_pose(sample: Odometry) -> bool:
    """Whether position and rotation are finite, and the rotation is valid."""
    p, q = sample.p_frame_in_world.tolist(), sample.q_world_frame.tolist()
    return math.isfinite(sum(p)) and 0.5 <= math.hypot(*q) < math.inf


class Poses:
    """The last two poses.

    Args:
        parameters: Limits of a pose's age and speed.
    """

    def __init__(self, parameters: TerrainMapParameters) -> None:
        self._p = parameters
        self._last: Odometry | None = None

    def add(self, pose: Odometry) -> bool:
        """Takes a pose; returns whether it jumped from the previous one, or came after a long gap.

        A pose that is not finite, or not newer than the previous one, is ignored.
        """
        if not is_pose(pose):
            return False
        if self._last is None:
            self._last = pose
            return False
        if pose.t_ns <= self._last.t_ns:
            return False
        moved = math.dist(pose.p_frame_in_world.tolist(), self._last.p_frame_in_world.tolist())
        dt = (pose.t_ns - self._last.t_ns) * 1e-9
        self._last = pose
        return dt > self._p.max_gap_s or (moved > self._p.jump_m and moved > self._p.max_speed_mps * dt)

    def at(self, t_ns: int) -> Array | None:
        """(4, 4) frame to world at a time: the last pose, propagated by its velocity; None if it is too old."""
        pose = self._last
        if pose is None or abs(t_ns - pose.t_ns) > self._p.max_pose_age_s * 1e9:
            return None
        dt = (t_ns - pose.t_ns) * 1e-9
        R = Rotation.from_quat(pose.q_world_frame, scalar_first=True)
        T = np.eye(4)
        T[:3, 3] = pose.p_frame_in_world
        if dt and np.isfinite(pose.v_frame_in_world).all() and np.isfinite(pose.angular_rate).all():
            T[:3, 3] += pose.v_frame_in_world * dt
            R = R * Rotation.from_rotvec(pose.angular_rate * dt)
        T[:3, :3] = R.as_matrix()
        return T
