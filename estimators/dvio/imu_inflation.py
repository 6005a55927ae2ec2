"""Online scale of the IMU's noise by variance components of the preintegrated measurements (Förstner 1979).

A data sheet gives the white noise of a part. It knows neither the errors of axes and scale nor the vibration of a
mount, and a rig may name another part. So the residuals of each measurement between keyframes are compared with their
expected sizes, separately for gyroscope and accelerometer, and larger ones raise the noise of later measurements. See
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
    """Estimates a factor on the noise of gyroscope and accelerometer, at least 1, from the window's residuals.

    Args:
        nominal: Noise before any image.

    Attributes:
        factor: (2,) present factors of gyroscope and accelerometer.
    """

    def __init__(self, nominal: ImuNoise) -> None:
        """Begins with factors of 1 on the noise `nominal`."""
        self._nominal = nominal
        # (2,) sums over earlier measurements, with exponential forgetting: squared residuals at nominal noise, and
        # their expectation
        self._squared, self._expected = np.zeros(2), np.zeros(2)
        self.factor = np.ones(2)
        # with which the newest increments were integrated
        self._factors: deque[Array] = deque(maxlen=_INCREMENTS)

    @property
    def noise(self) -> ImuNoise:
        """Noise of the samples with the present factors."""
        (rate, force), nominal = self.factor, self._nominal
        return nominal._replace(
            rate=rate * nominal.rate, rate_share=rate * nominal.rate_share, force=force * nominal.force
        )

    def restart(self) -> None:
        """Begins a new window; the factors estimated so far remain."""
        self._factors.clear()

    def update(self, window: WindowState, factors: FactorParameters, L: Array) -> None:
        """Uses the measurement that began three keyframes ago, once the newest frame is a keyframe.

        It is called once per keyframe. The first calls of a window only note the present factors, with which the
        measurement that ends at the newest frame was integrated.

        Args:
            window: The window after its optimisation.
            factors: Noise model of the factors.
            L: Cholesky factor of the window's normal equations.
        """
        # the oldest of the three noted factors is that of the measurement whose turn it is
        self._factors.append(self.factor)
        if len(self._factors) == _INCREMENTS:
            # slot of the frame in which that measurement begins
            k = int(window.frames.count[0]) - 1 - _INCREMENTS
            self.add_residuals(*residuals(window, k, factors, L), self._factors[0])

    def add_residuals(self, squared: Array, expected: Array, factor: Array) -> None:
        """Adds one measurement's squared residuals and recomputes the factors, docs/dvio.md (15).

        Args:
            squared: (2,) weighted squared residuals of gyroscope and accelerometer.
            expected: (2,) their expectation.
            factor: (2,) factors on the noise with which the measurement was integrated.
        """
        expected = np.maximum(expected, 0.0)  # rounding may make a tiny one negative
        squared = np.clip(squared, 0.0, _MAX_RATIO * expected)
        kept = 1.0 - 1.0 / _MEMORY  # share of the earlier sums that is remembered
        self._squared = kept * self._squared + factor**2 * squared
        self._expected = kept * self._expected + expected
        prior = _PRIOR_REDUNDANCY * CONSISTENT_SHARE**2  # squared residuals of earlier, consistent increments
        ratio = (prior + self._squared) / (_PRIOR_REDUNDANCY + self._expected)
        self.factor = np.sqrt(np.maximum(ratio / CONSISTENT_SHARE**2, 1.0))


def residuals(window: WindowState, k: int, factors: FactorParameters, L: Array) -> tuple[Array, Array]:
    """Weighted squared residuals of the IMU factor after frame k, and their expectation, each (2,), by sensor.

    With noise as assumed, the residual r = e + J x of a measurement with noise e of covariance C has the covariance C −
    J P Jᵀ, where P is the covariance of the states x. So r_i (C⁻¹ r)_i has the expectation (C⁻¹ (C − J P Jᵀ))_ii; both
    are summed over the rows of the gyroscope (rotation) and of the accelerometer (position and velocity).

    Args:
        window: The window after its optimisation.
        k: Slot of the frame in which the measurement begins.
        factors: Noise model of the factors.
        L: Lower Cholesky factor of the window's normal equations.
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
