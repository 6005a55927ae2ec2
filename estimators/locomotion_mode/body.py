"""Position, velocity and walking direction of the walker's body, from poses of a camera on head or chest.

A head rotates, so the body's position is that of the joint that carries it: the origin of the body that the camera's
calibration names (neck or waist), which no rotation moves. The walking direction is the displacement over a whole
stride, over which sway cancels, not the camera's viewing direction.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from stridetwin.estimators.contact_terrain.ticks import rotation_matrix
from stridetwin.estimators.locomotion_mode.parameters import Settings
from stridetwin.estimators.terrain_map.depth_camera import is_pose
from stridetwin.streams.samples import Array, Odometry

_STILL_M = 0.15
"""A walker who moved less within a stride is taken to walk in the camera's viewing direction."""
_HISTORY_S, _HISTORY_PERIOD_S = 2.0, 0.02
"""Time for which positions are stored, and between two of them."""
_VIEW_TIME_S = 1.5
"""Time constant of the camera's viewing direction."""
_JUMP_SLACK_M = 0.5
"""The body has jumped if it moved farther than its largest speed explains, and this."""
_MAX_POSE_AGE_S = 0.2
"""Without a pose for longer, nothing is predicted."""
_VELOCITY_S = 0.1
"""Time over which the velocity is measured."""


class Body:
    """Position, velocity and walking direction of the body that carries the camera.

    Args:
        p_body_in_frame: (3,) m, the carrying body's origin in the frame of the poses.
        R_frame_camera: (3, 3) rotation of the camera's optical frame in that frame.
        settings: Largest gap and speed of the poses, which are the map's.

    Attributes:
        t_ns: Time of the last pose; -1 before the first.
        p: (3,) position of the body in the world, m.
    """

    def __init__(self, p_body_in_frame: Array, R_frame_camera: Array, settings: Settings) -> None:
        """Begins without poses; body's origin (3,) m and camera's rotation (3, 3) are those in their frame."""
        self.set_mount(p_body_in_frame, R_frame_camera)
        self._max_gap_s, self._max_speed_mps = settings.map.max_gap_s, settings.map.max_speed_mps
        # times (ns) and positions (3,) of the body in the last `_HISTORY_S`
        self._history: deque[tuple[int, Array]] = deque(maxlen=round(_HISTORY_S / _HISTORY_PERIOD_S) + 2)
        self._look: Array | None = None  # (2,) horizontal viewing direction of the camera, averaged over time
        self.t_ns = -1
        self.p = np.zeros(3)

    def set_mount(self, p_body_in_frame: Array, R_frame_camera: Array) -> None:
        """Sets the body's origin (3,) m and the camera's rotation (3, 3) in the frame of the poses."""
        self._p_body_in_frame = p_body_in_frame
        # (3,) optical axis plus the image's up direction, in the frame of the poses: its horizontal part is ahead also
        # where the camera looks straight down
        self._ahead_in_frame = R_frame_camera[:, 2] - R_frame_camera[:, 1]

    def add(self, pose: Odometry) -> bool:
        """Takes a pose, and updates position, history and viewing direction.

        Late or non-finite poses are ignored.

        Returns:
            Whether the body jumped, or the pose came after a long gap; the history then begins anew.
        """
        if pose.t_ns <= self.t_ns or not is_pose(pose):
            return False
        R = rotation_matrix(pose.q_world_frame)
        p_body = pose.p_frame_in_world + R @ self._p_body_in_frame  # (3,) m, world
        forward = (R @ self._ahead_in_frame)[:2]
        forward = forward / max(math.hypot(*forward.tolist()), 1e-9)  # (2,) horizontal viewing direction
        dt = (pose.t_ns - self.t_ns) * 1e-9
        # farther than the largest speed explains, which counts for 1 s at most
        is_far = math.dist(p_body.tolist(), self.p.tolist()) > _JUMP_SLACK_M + self._max_speed_mps * min(dt, 1.0)
        jumped = self.t_ns >= 0 and (is_far or dt > self._max_gap_s)
        if jumped:
            self._history.clear()
            self._look = None
        if self._look is None:
            self._look = forward
        share = min(1.0, dt / _VIEW_TIME_S)  # of the new direction in the average
        self._look = self._look + share * (forward - self._look)
        self.p, self.t_ns = p_body, pose.t_ns
        if not self._history or pose.t_ns - self._history[-1][0] >= _HISTORY_PERIOD_S * 1e9:
            self._history.append((pose.t_ns, p_body))
        return jumped

    def is_known(self, t_ns: int) -> bool:
        """Whether the last pose is at most `_MAX_POSE_AGE_S` old at a time."""
        return bool(self._history) and t_ns - self.t_ns < _MAX_POSE_AGE_S * 1e9

    def position_before(self, seconds: float) -> Array:
        """(3,) m, position of the body `seconds` before its last pose, or at the oldest stored instant."""
        return self._find_before(seconds)[1]

    def _find_before(self, seconds: float) -> tuple[int, Array]:
        """Time, ns, and (3,) position, m, of the newest stored pose from at least `seconds` before the last one.

        The oldest one if none is from so long before.
        """
        wanted_ns = self.t_ns - int(seconds * 1e9)
        for t_ns, p in reversed(self._history):  # the newest first
            if t_ns <= wanted_ns:
                return t_ns, p
        return self._history[0]

    def max_height(self, since_ns: int) -> float:
        """Greatest height of the body since an instant, m, world z; the present one if none is stored since then."""
        return max((float(p[2]) for t_ns, p in self._history if t_ns >= since_ns), default=float(self.p[2]))

    def heading(self, stride_s: float) -> float:
        """Walking direction, rad from the world's x: of the displacement over the last stride of `stride_s`.

        A walker who hardly moves is taken to walk in the camera's viewing direction.
        """
        way = (self.p - self.position_before(min(stride_s, _HISTORY_S)))[:2]
        look = np.zeros(2) if self._look is None else self._look
        # as if the walker had gone `_STILL_M` more in the viewing direction: that decides only for one who hardly moves
        way = way + _STILL_M * look / max(float(np.linalg.norm(look)), 1e-9)
        return math.atan2(way[1], way[0])

    def recent_velocity(self) -> Array | None:
        """(2,) m/s, horizontal, over at least the last `_VELOCITY_S`; None if no pose is stored of about that time."""
        if not self._history:
            return None
        t_ns, p = self._find_before(_VELOCITY_S)
        span_ns, least_ns = self.t_ns - t_ns, int(_VELOCITY_S * 1e9)
        return (self.p - p)[:2] / (span_ns * 1e-9) if least_ns <= span_ns < 2 * least_ns else None

    def velocity(self) -> Array:
        """(3,) m/s, displacement over the last `_VELOCITY_S` divided by that time."""
        return (self.p - self.position_before(_VELOCITY_S)) / _VELOCITY_S
