"""How far the poses of an odometry can be trusted for the modes of the next steps.

The map joins images by the poses. Where these drift by a slope's height within a step, level ground is mapped as a
ramp, and edges move. An odometry says so: by its covariance, and by a status where nothing but the IMU holds its poses.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from stridetwin.estimators.base import DEPTH_ONLY, IMU_ONLY, TRACKING, EstimatedPose
from stridetwin.estimators.contact_terrain.estimate import probability_above
from stridetwin.estimators.locomotion_mode.parameters import Settings
from stridetwin.streams.samples import Odometry

_OVER_S = 1.0
"""Time over which the growth of the uncertainty counts: the ground of the next step was seen so long ago."""
_PERIOD_S = 0.05
"""Time between two stored variances."""
_IMU_ONLY_FACTOR = 2.0
"""Factor on the reported growth while nothing but the IMU holds the poses: its error grows by what the odometry's noise
model has not, such as vibration and a poorly known bias. Tuned on walks whose light goes out."""
_REMEMBER_S = 1.5
"""Time after a bad stretch in which ground that was mapped during it is still ahead."""
_MIN_SPEED_MPS = 0.5
"""Slowest walk by which a vertical drift becomes a slope."""
_MAX_SLOPE_SD_RAD = 0.15
"""Largest standard deviation of a slope by drift: with more the lean says nothing."""
_HALF_TREAD_M = 0.15
"""An edge that may be off by so much may be on the other side of the foot."""


class _Growth(NamedTuple):
    """Growth of the pose's uncertainty over the last `_OVER_S`, as standard deviations.

    Attributes:
        t_ns: Time.
        vertical_m: Of the height.
        horizontal_m: Of the place.
    """

    t_ns: int
    vertical_m: float
    horizontal_m: float


class PoseTrust:
    """Gives the probability that drift of the poses makes the mode of a step another one than the map shows."""

    def __init__(self, settings: Settings) -> None:
        """Begins without poses: they are trusted."""
        self._slope_rad = settings.mode.min_ramp_slope_rad
        self._max_gap_s = settings.map.max_gap_s
        self._variances: deque[tuple[int, float, float]] = deque()  # time, ns; of height and place, m²
        self._growth: deque[_Growth] = deque()  # of the last `_REMEMBER_S`
        self._held_ns = -1  # time of the last pose that the surroundings held; -1 before the first pose

    def clear(self) -> None:
        """Forgets all poses, as after a jump."""
        self._variances.clear()
        self._growth.clear()
        self._held_ns = -1

    def add(self, pose: Odometry) -> None:
        """Takes a pose in time order; those without a status and a covariance are trusted."""
        if not isinstance(pose, EstimatedPose):
            return
        t_ns = pose.t_ns
        if pose.status != IMU_ONLY or self._held_ns < 0:
            self._held_ns = t_ns
        covariance = pose.covariance
        if covariance is None or (self._variances and t_ns - self._variances[-1][0] < _PERIOD_S * 1e9):
            return
        height, place = float(covariance[2, 2]), float(covariance[0, 0] + covariance[1, 1])
        if not (math.isfinite(height) and math.isfinite(place)):
            return
        self._variances.append((t_ns, height, place))
        while len(self._variances) > 1 and t_ns - self._variances[1][0] >= _OVER_S * 1e9:
            self._variances.popleft()
        while self._growth and t_ns - self._growth[0].t_ns > _REMEMBER_S * 1e9:
            self._growth.popleft()
        if pose.status in (TRACKING, DEPTH_ONLY):  # the surroundings hold the poses relative to the map
            return
        factor = _IMU_ONLY_FACTOR if t_ns - self._held_ns > _OVER_S * 1e9 else 1.0
        before = self._variances[0]
        vertical, horizontal = (
            factor * math.sqrt(max(now - then, 0.0)) for now, then in zip((height, place), before[1:])
        )
        self._growth.append(_Growth(t_ns, vertical, horizontal))

    @property
    def vertical_m(self) -> float:
        """Standard deviation of the drift of the height over a second, m, the largest of the last moments."""
        return max((growth.vertical_m for growth in self._growth), default=0.0)

    def slope_sd_rad(self, speed_mps: float) -> float:
        """Standard deviation of the slope that the vertical drift gives to level ground: docs/locomotion_mode.md (17).

        Args:
            speed_mps: Horizontal speed of the walker, m/s.
        """
        return min(self.vertical_m / (max(speed_mps, _MIN_SPEED_MPS) * _OVER_S), _MAX_SLOPE_SD_RAD)

    def unsure(self, speed_mps: float) -> float:
        """Probability that the drift makes a slope of a ramp, or moves an edge by half a tread, since it was seen.

        See docs/locomotion_mode.md (18).

        Args:
            speed_mps: Horizontal speed of the walker, m/s.
        """
        steep = _probability_beyond(self._slope_rad, self.slope_sd_rad(speed_mps))
        place_sd_m = max((growth.horizontal_m for growth in self._growth), default=0.0)
        moved = _probability_beyond(_HALF_TREAD_M, place_sd_m)
        return 1.0 - (1.0 - steep) * (1.0 - moved)


def _probability_beyond(limit: float, sd: float) -> float:
    """Probability that a normal error of mean 0 is larger than a limit to either side."""
    return 2.0 * probability_above(0.0, limit, sd) if sd > 0.0 else 0.0
