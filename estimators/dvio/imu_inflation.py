"""Noise of the IMU as images show it: variance components of the window's increments.

A data sheet gives the white noise of a part. It knows neither the errors of axes and scale nor the vibration of a
mount, and a rig may name another part. So the residuals of each increment are compared with their expected sizes
(Förstner 1979), for gyroscope and accelerometer apart, and larger ones raise the noise of later increments. See
docs/dvio.md (15).
"""

from __future__ import annotations

from collections import deque

import numpy as np

from stridetwin.estimators.dvio import kernel
from stridetwin.estimators.dvio.level import covariance_of
from stridetwin.estimators.dvio.state import CALIBRATION, FRAME, FactorParameters, ImuNoise, WindowState
from stridetwin.streams.samples import Array

# Rows of the IMU residual, docs/dvio.md (4): rotation is the gyroscope's, position and velocity the accelerometer's.
_BY_SENSOR = (np.array([3, 4, 5]), np.array([0, 1, 2, 6, 7, 8]))
# When and how fast the factor follows the residuals; hand-chosen on tuning seeds.
CONSISTENT_SHARE = 0.6
"""RMS of the residuals, of the expected one, that counts as consistent: below 1, because one increment does not show
errors that last for several; parts as calibrated have 0.3 (rates) and 0.45 (forces)."""
_MEMORY = 30.0  # increments that are remembered
_PRIOR_REDUNDANCY = 10.0  # of earlier consistent increments, before the first one
_MAX_RATIO = 4.0  # of squared residuals to their expectation: one bad image is no noise
# An increment is compared after two more keyframes, which measure its velocities.
_INCREMENTS = 3


class ImuInflation:
    """Factor on the noise of gyroscope and accelerometer, at least 1.

    Args:
        nominal: Noise before any image.
    """

    def __init__(self, nominal: ImuNoise) -> None:
        self._nominal = nominal
        self._squared, self._expected = np.zeros(2), np.zeros(2)
        self.factor = np.ones(2)
        # with which the newest increments were integrated
        self._factors: deque[Array] = deque(maxlen=_INCREMENTS)

    @property
    def noise(self) -> ImuNoise:
        """Present noise of the samples."""
        (rate, force), nominal = self.factor, self._nominal
        return nominal._replace(
            rate=rate * nominal.rate, rate_share=rate * nominal.rate_share, force=force * nominal.force
        )

    def restart(self) -> None:
        """Begins a window; what is known of the noise remains."""
        self._factors.clear()

    def update(self, window: WindowState, factors: FactorParameters, L: Array) -> None:
        """Takes the increments up to a keyframe, the newest frame; L is the Cholesky factor of the normal equations."""
        self._factors.append(self.factor)
        if len(self._factors) == _INCREMENTS:
            k = int(window.frames.count[0]) - 1 - _INCREMENTS
            self.add_residuals(*residuals(window, k, factors, L), self._factors[0])

    def add_residuals(self, squared: Array, expected: Array, factor: Array) -> None:
        """Takes squared residuals and their expectation, (2,), of an increment integrated with a factor (2,)."""
        expected = np.maximum(expected, 0.0)
        squared = np.clip(squared, 0.0, _MAX_RATIO * expected)
        kept = 1.0 - 1.0 / _MEMORY
        self._squared = kept * self._squared + factor**2 * squared
        self._expected = kept * self._expected + expected
        prior = _PRIOR_REDUNDANCY * CONSISTENT_SHARE**2
        ratio = (prior + self._squared) / (_PRIOR_REDUNDANCY + self._expected)
        self.factor = np.sqrt(np.maximum(ratio / CONSISTENT_SHARE**2, 1.0))


def residuals(window: WindowState, k: int, factors: FactorParameters, L: Array) -> tuple[Array, Array]:
    """Weighted squared residuals of the increment after frame k, and their expectation, each (2,), by sensor.

    With the noise as assumed, the residuals r = e + J x of an increment of noise e and covariance C have the covariance
    C − J P Jᵀ, where P is that of the states x.
    """
    r, J = np.empty(9), np.empty((9, 2 * FRAME))
    kernel.imu_residual(window, k, factors, r, J)
    # The rest of L is that of the later frames alone, after the earlier ones are eliminated.
    states = slice(CALIBRATION + FRAME * k, CALIBRATION + FRAME * int(window.frames.count[0]))
    P = covariance_of(np.arange(2 * FRAME), L[states, states], states.stop - states.start)
    weight, covariance = window.preintegrations.weight[k], window.preintegrations.covariance[k]
    squared = r * (weight @ r)
    expected = np.diag(weight @ (covariance - J @ P @ J.T))
    return (
        np.array([squared[rows].sum() for rows in _BY_SENSOR]),
        np.array([expected[rows].sum() for rows in _BY_SENSOR]),
    )
