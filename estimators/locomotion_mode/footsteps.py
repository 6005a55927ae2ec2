"""The walker's step lengths and times: a Kalman filter over past steps of two kinds."""

from __future__ import annotations

import math

import numpy as np

from stridetwin.streams.samples import Array

SIDE = {"l": 1.0, "r": -1.0, "": 0.0}
"""Sign of each foot, left positive; 0 if unknown."""
CLIMB = {"RA": 1.0, "RD": -1.0}
"""Sign of each kind of ramp, upward positive."""


class StepFilter:
    """Estimates the mean of steps of two kinds, such as left and right, and half the difference between the kinds.

    The mean drifts from step to step, and single steps scatter about it.

    Args:
        mean: Prior mean.
        sd: Standard deviation between walkers.
        asymmetry_sd: Standard deviation of half the difference.
        drift: Standard deviation of the mean's change from step to step.
        noise: Standard deviation of a step from the mean.
    """

    def __init__(self, mean: float, sd: float, asymmetry_sd: float, drift: float, noise: float) -> None:
        self._x = np.array([mean, 0.0])
        self._P = np.diag([sd**2, asymmetry_sd**2])
        self._drift, self._noise = drift, noise

    def update(self, kind: float, value: float, value_sd: float = 0.0, sure: float = 1.0) -> None:
        """Takes a step.

        See docs/locomotion_mode.md (4).

        Args:
            kind: 1 or -1 (`SIDE`, `CLIMB`), 0 if unknown.
            value: Its length or time.
            value_sd: Standard deviation of that value.
            sure: Probability that the step is comparable to the others, 0-1.
        """
        self._P[0, 0] += self._drift**2
        if sure <= 0.0:
            return
        J = np.array([1.0, kind])
        noise = (self._noise**2 + value_sd**2) / sure
        off = value - float(J @ self._x)
        spread = float(J @ self._P @ J) + noise
        # An outlier, such as a step into a pause or beside an obstacle, gets less weight.
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
        """Standard deviation of the estimated mean."""
        return self.sd_of(0.0)

    def sd_of(self, kind: float) -> float:
        """Standard deviation of the expected step of a kind."""
        J = np.array([1.0, kind])
        return math.sqrt(max(float(J @ self._P @ J), 0.0))
