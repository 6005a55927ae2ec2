"""Position, velocity and walking direction of the walker's body, from poses of a camera on head or chest.

A head rotates, so the body's position is that of the joint that carries it: the origin of the body that the camera's
calibration names (neck or waist), which no rotation moves. The walking direction is the displacement over a whole
stride, over which sway cancels, not the camera's viewing direction.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from stridetwin.estimators.locomotion_mode.parameters import LocomotionModeParameters
from stridetwin.estimators.terrain_map.depth_camera import is_pose
from stridetwin.streams.samples import Array, Odometry


class Body:
    """Position, velocity and heading of the body that carries the camera.

    Args:
        p_body_in_frame: (3,) m, the carrying body's origin in the frame of the poses.
        R_frame_camera: (3, 3) rotation of the camera's optical frame in that frame.
        parameters: One set serves everyone.
    """

    def __init__(self, p_body_in_frame: Array, R_frame_camera: Array, parameters: LocomotionModeParameters) -> None:
        self.follow(p_body_in_frame, R_frame_camera)
        self._parameters = p = parameters
        self._history: deque[tuple[int, Array]] = deque(maxlen=round(p.history_s / p.history_period_s) + 2)
        self._look: Array | None = None
        self.t_ns = -1
        self.p = np.zeros(3)

    def follow(self, p_body_in_frame: Array, R_frame_camera: Array) -> None:
        """Replaces the body's origin (3,) m and the camera's rotation (3, 3) in the frame of the poses."""
        self._p = p_body_in_frame
        self._ahead = R_frame_camera[:, 2] - R_frame_camera[:, 1]  # optical axis plus image up

    def add(self, pose: Odometry) -> bool:
        """Takes a pose; returns whether the body jumped, or the pose came after a long gap.

        Late or non-finite poses are ignored.
        """
        q, p = pose.q_world_frame, pose.p_frame_in_world
        if pose.t_ns <= self.t_ns or not is_pose(pose):
            return False
        R = _matrix(*q.tolist())
        place, forward = p + R @ self._p, (R @ self._ahead)[:2]
        forward = forward / max(math.hypot(*forward.tolist()), 1e-9)
        dt = (pose.t_ns - self.t_ns) * 1e-9
        far = math.dist(
            place.tolist(), self.p.tolist()
        ) > self._parameters.jump_m + self._parameters.max_speed_mps * min(dt, 1.0)
        jumped = self.t_ns >= 0 and (far or dt > self._parameters.max_gap_s)
        if jumped:
            self._history.clear()
            self._look = None
        if self._look is None:
            self._look = forward
        share = min(1.0, dt / self._parameters.view_time_s)
        self._look = self._look + share * (forward - self._look)
        self.p, self.t_ns = place, pose.t_ns
        if not self._history or pose.t_ns - self._history[-1][0] >= self._parameters.history_period_s * 1e9:
            self._history.append((pose.t_ns, place))
        return jumped

    def known(self, t_ns: int) -> bool:
        """Whether there is a recent pose."""
        return bool(self._history) and t_ns - self.t_ns < self._parameters.stale_s * 1e9

    def before(self, seconds: float) -> Array:
        """(3,) m, position of the body that long ago, or at the oldest stored instant."""
        at = self.t_ns - int(seconds * 1e9)
        for t_ns, p in reversed(self._history):
            if t_ns <= at:
                return p
        return self._history[0][1]

    def top(self, since_ns: int) -> float:
        """Greatest height of the body since an instant, m."""
        return max((float(p[2]) for t_ns, p in self._history if t_ns >= since_ns), default=float(self.p[2]))

    def heading(self, stride_s: float) -> float:
        """Walking direction over the last stride, rad from the world's x."""
        way = (self.p - self.before(min(stride_s, self._parameters.history_s)))[:2]
        look = np.zeros(2) if self._look is None else self._look
        way = way + self._parameters.still_m * look / max(float(np.linalg.norm(look)), 1e-9)
        return math.atan2(way[1], way[0])

    def velocity(self) -> Array:
        """(3,) m/s, over the last tenth of a second."""
        seconds = self._parameters.velocity_s
        return (self.p - self.before(seconds)) / seconds


def _matrix(w: float, x: float, y: float, z: float) -> Array:
    """(3, 3) rotation of a quaternion of any norm; scipy takes ten times as long, and poses are frequent."""
    k = 2.0 / (w * w + x * x + y * y + z * z)
    return np.array([
        [1.0 - k * (y * y + z * z), k * (x * y - w * z), k * (x * z + w * y)],
        [k * (x * y + w * z), 1.0 - k * (x * x + z * z), k * (y * z - w * x)],
        [k * (x * z - w * y), k * (y * z + w * x), 1.0 - k * (x * x + y * y)],
    ])  # fmt: skip
