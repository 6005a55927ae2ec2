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
_WIDE_SHARE = 0.3  # of accelerometers, before any measurement
_MAX_SCALE_ERROR = 0.1  # a larger one is another failure


def estimate_scale_error(excess_mps2: float, gravity_mps2: float, bias_sd_mps2: float, known_scale_sd: float) -> float:
    """Relative error of an accelerometer's scale, from the excess of its force at rest over gravity.

    The excess is a bias plus the error of the scale. Either the part is as calibrated, and its scale error of
    `known_scale_sd` is left to the bias; or its scale is off by `WIDE_SCALE_SD`. Bayes' rule says which is likelier,
    and only in the second case the scale is corrected: docs/dvio.md (17).

    Args:
        excess_mps2: Size of the mean force at rest less gravity.
        gravity_mps2: Size of gravity.
        bias_sd_mps2: Standard deviation of the bias.
        known_scale_sd: Relative standard deviation of the scale as calibrated; 0 where it is exact or unknown.

    Returns:
        The expected error of a part that is likelier not as calibrated, else 0.
    """
    excess = min(max(excess_mps2 / gravity_mps2, -_MAX_SCALE_ERROR), _MAX_SCALE_ERROR)
    bias_variance = (bias_sd_mps2 / gravity_mps2) ** 2
    variances = bias_variance + known_scale_sd**2, bias_variance + max(WIDE_SCALE_SD, known_scale_sd) ** 2
    as_calibrated, off = (
        share / math.sqrt(variance) * math.exp(-0.5 * excess**2 / variance)
        for share, variance in zip((1.0 - _WIDE_SHARE, _WIDE_SHARE), variances)
    )
    return excess * (1.0 - bias_variance / variances[1]) if off > as_calibrated else 0.0
