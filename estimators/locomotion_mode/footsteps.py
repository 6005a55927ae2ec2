"""How long the walker's steps are, in space and time: a Kalman filter over the steps that were made, of two kinds."""

from __future__ import annotations

import math

import numpy as np

from stridetwin.streams.samples import Array

SIDE = {"l": 1.0, "r": -1.0, "": 0.0}
"""Of each foot, left positive; of one that is not known none."""
CLIMB = {"RA": 1.0, "RD": -1.0}
"""Of each kind of ramp, upward positive."""


class StepFilter:
    """Mean of steps of two kinds, such as left and right, and half of what those of the first kind are longer.

    The mean drifts from step to step, single steps scatter about it.

    Args:
        mean: What is expected of someone unknown.
        sd: Deviation between walkers.
        asymmetry_sd: Deviation of half the difference.
        drift: Deviation of the mean's change from step to step.
        noise: Deviation of a step from the mean.
    """

    def __init__(self, mean: float, sd: float, asymmetry_sd: float, drift: float, noise: float) -> None:
        self._x = np.array([mean, 0.0])
        self._P = np.diag([sd**2, asymmetry_sd**2])
        self._drift, self._noise = drift, noise

    def update(self, kind: float, value: float, value_sd: float = 0.0, sure: float = 1.0) -> None:
        """Takes a step.

        See docs/locomotion_mode.md (4).

        Args:
            kind: 1 or -1 (`SIDE`, `CLIMB`), 0 where it is not known.
            value: Its length or time.
            value_sd: Deviation with which that is known.
            sure: How likely it is a step like those that are filtered, 0-1.
        """
        self._P[0, 0] += self._drift**2
        if sure <= 0.0:
            return
        J = np.array([1.0, kind])
        noise = (self._noise**2 + value_sd**2) / sure
        off = value - float(J @ self._x)
        spread = float(J @ self._P @ J) + noise
        # A step that is far off, into a pause or beside an obstacle, says less of the next ones.
        spread *= max(1.0, off**2 / (4.0 * spread))
        gain: Array = self._P @ J / spread
        self._x = self._x + gain * off
        self._P = self._P - np.outer(gain, J @ self._P)
        self._P = 0.5 * (self._P + self._P.T)

    def of(self, kind: float) -> float:
        """Expected step of a kind."""
        return float(self._x[0] + kind * self._x[1])

    @property
    def mean(self) -> float:
        """Expected step of either kind."""
        return float(self._x[0])

    @property
    def sd(self) -> float:
        """Deviation with which the mean is known."""
        return self.sd_of(0.0)

    def sd_of(self, kind: float) -> float:
        """Deviation with which the expected step of a kind is known."""
        J = np.array([1.0, kind])
        return math.sqrt(max(float(J @ self._P @ J), 0.0))
