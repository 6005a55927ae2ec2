"""Prior of the camera's mount, whose spread is itself estimated: most mounts are as calibrated, some have slipped.

The prior is Student's t: normal, with a variance that is itself unknown, which follows the estimated mount (expectation
maximisation). A mount as calibrated thus keeps the accuracy of its calibration, and one that is off is not held back.
The variance of the rotation begins as the calibration has it: if it begins wide, a wrong rotation explains the first
images of a plain corridor, and the odometry diverges. That of the position begins wide and waits for a measurement,
because walking measures it slowly. The calibration is never marginalised, so its own prior remains a separate summand
of the window's prior, which can be exchanged. See docs/dvio.md (13).
"""

from __future__ import annotations

import numpy as np

from stridetwin.estimators.dvio.state import D_ATTITUDE_IC, D_POSITION_IC, WindowState
from stridetwin.streams.samples import Array

GROUPS = (slice(D_POSITION_IC, D_POSITION_IC + 3), slice(D_ATTITUDE_IC, D_ATTITUDE_IC + 3))
"""Columns of the calibration's errors that share a variance: position, rotation."""
_POSITION, _ROTATION = 0, 1  # indices of these groups
# Hand-chosen on tuning seeds.
_FREEDOM = 1.0  # degrees of freedom of the t prior; 1: a Cauchy distribution
_MEASURED_SHARE = 0.25  # of its variance; the position's follows once the mount is known to this share of it


class MountPrior:
    """Variances of the mount's position (m²) and rotation (rad²) in the prior of a window: docs/dvio.md (13).

    Args:
        nominal_sd: (2,) standard deviations of a mount as calibrated, m and rad; 0: exactly known.
        slipped_sd: (2,) those of a mount that has slipped; the position begins with them.
    """

    def __init__(self, nominal_sd: Array, slipped_sd: Array) -> None:
        """Both (2,) are standard deviations of position (m) and rotation (rad): as calibrated, and slipped."""
        # (2,) limits of the variances of position and rotation, and the present ones
        self._least = nominal_sd**2
        self._most = np.where(nominal_sd > 0, np.maximum(nominal_sd, slipped_sd), 0.0) ** 2
        self._variance = np.array([self._most[0], self._least[1]])
        self._mean = np.zeros(6)  # centre of the prior, as deviation `moved` of the calibration

    def start(self, mean: Array) -> Array:
        """(6,) standard deviations of the mount for a window that starts: position (m) before rotation (rad).

        `mean` (6,) is the deviation `moved` of the calibration about which the prior of this window is centred; it is
        kept for later changes of the variances.
        """
        self._mean = mean.copy()
        return np.repeat(self.sd, 3)

    @property
    def sd(self) -> Array:
        """(2,) present standard deviations of position, m, and rotation, rad."""
        return np.asarray(np.sqrt(self._variance))

    @property
    def is_adaptive(self) -> bool:
        """Whether the variances may change: some mount is neither exactly known nor fixed as calibrated."""
        return bool((self._most > self._least).any())

    def update(self, window: WindowState, covariance: Array) -> None:
        """Updates the variances from the estimated mount, docs/dvio.md (13), and the window's prior with them.

        A variance becomes (σ_0² + |e|² + tr P) / 4, for the nominal one σ_0², the deviation e of the estimated mount
        from the prior's centre, and the covariance P of that estimate; it stays between its limits.

        Args:
            window: The sliding window, whose calibration is the estimate and whose prior is changed.
            covariance: (6, 6) of the mount, position (m) before rotation (rad).
        """
        for i, group in enumerate(GROUPS):  # position, then rotation: the columns of the calibration's errors
            # the position's variance stays until motion has measured the mount; a variance of 0 means exactly known
            before, spread = self._variance[i], float(covariance.diagonal()[group].sum())
            waits = i == _POSITION and spread > 3.0 * _MEASURED_SHARE * before
            if before == 0.0 or waits:
                continue
            deviation = window.calibration.moved[group] - self._mean[group]
            # three axes share the variance
            estimated = (_FREEDOM * self._least[i] + deviation @ deviation + spread) / (_FREEDOM + 3.0)
            self._exchange(window, i, min(max(estimated, self._least[i]), self._most[i]))

    def widen(self, window: WindowState) -> bool:
        """Gives the rotation the variance of a slipped mount; returns False if the rotation is exactly known."""
        if self._variance[_ROTATION] == 0.0:
            return False
        self._exchange(window, _ROTATION, self._most[_ROTATION])
        return True

    def _exchange(self, window: WindowState, i: int, after: float) -> None:
        """Replaces the variance of one group (0 position, 1 rotation) in the window's prior by `after`.

        The prior is a sum, so the difference of the inverse variances is added to it, about the centre `_mean`.
        """
        prior, group = window.prior, GROUPS[i]
        change = 1.0 / after - 1.0 / self._variance[i]
        at = np.arange(group.start, group.stop)  # rows of the group, of whose block only the diagonal changes
        prior.H[at, at] += change
        prior.b[group] += change * self._mean[group]
        self._variance[i] = after
