"""Sums and values between the samples of a stream with several columns."""

from __future__ import annotations

import numpy as np

from stridetwin.streams.samples import Array


def accumulate(steps: Array, means: Array) -> Array:
    """Integrals (M, D) from the first of M times on, of D columns whose means between the times are known.

    The samples of an IMU are such means: each of the interval that ends at its stamp (docs/design.md, conventions).

    Args:
        steps: (M - 1,) durations between the times, s.
        means: (M - 1, D) means over them.
    """
    return np.vstack((np.zeros(means.shape[1]), np.cumsum(means * steps[:, None], axis=0)))


def interpolate(at: Array, t: Array, values: Array) -> Array:
    """Values (..., D) at times `at` (...), linear between the samples, and constant beyond the first and the last.

    Args:
        at: (...) times of any shape, s.
        t: (M,) increasing times of the samples, s.
        values: (M, D) the samples.
    """
    return np.stack([np.interp(at, t, values[:, column]) for column in range(values.shape[1])], axis=-1)
