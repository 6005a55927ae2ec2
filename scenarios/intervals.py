"""Confidence intervals and tests of what is measured over few blocks of images."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.samples import Array

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


def exceeds_zero(values: Array) -> NDArray[np.bool_]:
    """Whether the mean over the first axis is significantly above 0, by Student's test.

    Args:
        values: (B, ...) independent values, two at least.

    Returns:
        (...) booleans.
    """
    error = values.std(axis=0, ddof=1) / math.sqrt(len(values))
    return np.asarray(values.mean(axis=0) > student_quantile(len(values) - 1) * error)
