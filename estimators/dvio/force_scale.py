"""The scale of the accelerometer from the size of gravity: docs/dvio.md (17).

A calibration gives the turn-on bias of a part. A part without one, or one whose driver converts units by a wrong
factor, has a scale error of some per cent beside it. At one attitude both look alike, but a bias stays in the
sensor's axes while the sensor turns, and 3 % of gravity turned by 20° is an acceleration of 0.1 m/s² that nobody made.
"""

from __future__ import annotations

import math

# Hand-chosen on tuning seeds.
WIDE_SCALE_SD = 0.03
"""Relative error of the scale of an accelerometer that is not as calibrated."""
_WIDE_SHARE = 0.5  # of accelerometers, before any measurement
_MAX_SCALE_ERROR = 0.1  # a larger one is another failure
MIN_CHANGE = 2e-3
"""Smaller corrections of a running odometry are not worth a new window."""


def estimate_scale_error(excess_mps2: float, gravity_mps2: float, bias_sd_mps2: float, known_scale_sd: float) -> float:
    """Expected relative error of an accelerometer's scale from the excess of its force at rest over gravity.

    The excess is a bias plus the error of the scale. The scale is that of the calibration, of a known standard
    deviation, or that of a part that is not as calibrated: a mixture of two normal distributions, whose shares follow
    from the excess by Bayes' rule, as in docs/dvio.md (17).

    Args:
        excess_mps2: Size of the mean force at rest less gravity.
        gravity_mps2: Size of gravity.
        bias_sd_mps2: Standard deviation of the bias.
        known_scale_sd: Relative standard deviation of the scale as calibrated; 0 where it is exact or unknown.

    Returns:
        The expectation, 0 without an excess.
    """
    excess = min(max(excess_mps2 / gravity_mps2, -_MAX_SCALE_ERROR), _MAX_SCALE_ERROR)
    bias_variance, expected, total = (bias_sd_mps2 / gravity_mps2) ** 2, 0.0, 0.0
    wide_sd = max(WIDE_SCALE_SD, known_scale_sd)
    for share, scale_sd in ((1.0 - _WIDE_SHARE, known_scale_sd), (_WIDE_SHARE, wide_sd)):
        variance = bias_variance + scale_sd**2
        weight = share / math.sqrt(variance) * math.exp(-0.5 * excess**2 / variance)
        expected += weight * excess * scale_sd**2 / variance
        total += weight
    return expected / total
