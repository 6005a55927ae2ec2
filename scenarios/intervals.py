"""Quantiles for the confidence intervals of what is measured over few blocks of images."""

from __future__ import annotations

_NORMAL_975 = 1.959964
"""97.5 % quantile of the standard normal distribution."""


def student_quantile(freedom: float) -> float:
    """The 97.5 % quantile of Student's distribution (Abramowitz and Stegun 1972, 26.7.5), for two-sided 95 % intervals.

    Args:
        freedom: Degrees of freedom: accurate to 1 % from 3 on, to 0.1 % from 5 on.
    """
    z, n = _NORMAL_975, float(freedom)
    return (
        z
        + (z**3 + z) / (4 * n)
        + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * n**2)
        + (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * n**3)
    )
