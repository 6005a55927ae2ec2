"""Where a wearer is whose odometry is lost: the pose that was known last, and how far it may be away by now."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stridetwin.estimators.dvio.nav_state import NavState
from stridetwin.streams.samples import Array

# Hand-chosen on tuning seeds.
RUNNING_SPEED_MPS = 6.0
"""A faster wearer is an odometry that has failed already."""
_STRAYED_NS = 100_000_000  # since when it has been one
_STRAYED_SHARE = 0.5  # of the way since then, as standard deviation of the position
LOST_WALK_M_RTS = 1.0
"""Growth of the position error while lost, because the wearer walks on: steps to all sides."""
# Beside them, a velocity on each axis that lasts: 1 m/s over ground, ten metres straight on.
_LOST_SPEED_SD_MPS, _LOST_MEMORY_S = 0.7, 10.0


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownPose:
    """A pose at a time.

    Attributes:
        t_ns: When it was the wearer's.
        p: (3,) m, IMU in the world.
        R: (3, 3) world <- IMU.
        covariance: (6, 6) of the errors of position (m) and attitude (rad, about the IMU's axes).
    """

    t_ns: int
    p: Array
    R: Array
    covariance: Array


class PoseMemory:
    """The last plausible pose, the last one at a speed of people, and the last one that images or depth held."""

    def __init__(self) -> None:
        """Begins with the origin, which is exact."""
        origin = KnownPose(t_ns=0, p=np.zeros(3), R=np.eye(3), covariance=np.zeros((6, 6)))
        self._plausible = self._sensible = self._held = origin

    def remember(self, nav: NavState, covariance: Array, is_held: bool) -> None:
        """Keeps a plausible state's pose.

        Args:
            nav: The state.
            covariance: (6, 6) of the errors of its position (m) and attitude (rad, about the IMU's axes).
            is_held: Whether images or depth hold it.
        """
        pose = KnownPose(t_ns=int(nav.t_ns[0]), p=nav.p.copy(), R=nav.R.copy(), covariance=covariance)
        self._plausible = pose
        if nav.v @ nav.v < RUNNING_SPEED_MPS**2:
            self._sensible = pose
        if is_held:
            self._held = pose

    def find_last_known(self, now_ns: int, trusts_held: bool) -> KnownPose:
        """The pose from which a lost wearer walks on: the last plausible one, unless another one is better.

        Where the speed was one at which nobody moves, the position is the last one before that, and as uncertain as it
        has strayed since. Where dead reckoning knows less than that a wearer walks, it is the last one that was held.

        Args:
            now_ns: When the odometry is lost.
            trusts_held: Whether the last pose that was held is a choice.

        Returns:
            The pose; its time is the one from which on nothing is known of the position.
        """
        p, covariance, since_ns = self._plausible.p, self._plausible.covariance.copy(), now_ns
        strayed = self._plausible.p - self._sensible.p
        if self._sensible.t_ns < now_ns - _STRAYED_NS:
            p, covariance = self._sensible.p, self._sensible.covariance.copy()
            covariance[range(3), range(3)] += _STRAYED_SHARE**2 * float(strayed @ strayed)
        held, walked = self._held, compute_strayed_variance((now_ns - self._held.t_ns) * 1e-9)
        held_variance = float(np.trace(held.covariance[:3, :3])) + 3 * walked
        if trusts_held and held_variance < float(np.trace(covariance[:3, :3])):
            p, since_ns = held.p, held.t_ns
            covariance[:3], covariance[:, :3] = 0.0, 0.0
            covariance[:3, :3] = held.covariance[:3, :3] + walked * np.eye(3)
        return KnownPose(t_ns=since_ns, p=p, R=self._plausible.R, covariance=covariance)


def compute_strayed_variance(lost_s: float) -> float:
    """Variance of the position on each axis, m², that a wearer adds while the odometry is lost: docs/dvio.md (21)."""
    share = lost_s / _LOST_MEMORY_S
    lasting = 2 * (_LOST_SPEED_SD_MPS * _LOST_MEMORY_S) ** 2 * (share + math.expm1(-share))
    return LOST_WALK_M_RTS**2 * lost_s + lasting
