"""Bootstrap-t tests of means and differences of means, for many scores at once with shared resamples of the walks.

Efron & Tibshirani 1993, An Introduction to the Bootstrap, 12.5 and 16.4: the statistic is divided by its own standard
error in every resample, so that few walks of a skewed score do not appear too certain. Intervals bound that error from
below (Polansky 2000 does so by smoothing).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from stridetwin.streams.samples import Array

DRAWS = 50_000
_MAX_DRAWN_AT_ONCE = 2_000_000  # numbers drawn; each takes twice 8 bytes
_MAX_RESAMPLED_MEANS = 10_000_000  # means of all resamples, also held several times
_SEED = 20_240_229
_COVERAGE = 0.95
_MIN_RELATIVE_ERROR = 0.3
"""Of the standard error in a resample, relative to that of all walks; for intervals only.

A resample of few walks that leaves out their one outlier has hardly any spread, and its statistic no bound. Widths of
intervals then had a 99th percentile of up to 215 standard errors; with this bound 8, and the same coverage (of 8, 15
and 30 values, normal to lognormal and with outliers). Tests keep the plain statistic, which raises fewer false alarms.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class BootstrapResult:
    """Bootstrap results for S means (or differences of means).

    Attributes:
        count: (S,) number of values; of two groups the smaller one.
        mean: (S,).
        low: (S,) lower end of the 95 % interval.
        high: (S,) upper end.
        p_above: (S,) probability of a mean at least this large if the truth were 0 or less.
        p_below: (S,) likewise of a mean at most this large.
    """

    count: Array
    mean: Array
    low: Array
    high: Array
    p_above: Array
    p_below: Array


def compare_pairs(changes: ArrayLike, min_draws: int = 0) -> BootstrapResult:
    """Means of changes.

    Args:
        changes: (walks, S), NaN where a value is missing; two or more values in each column.
        min_draws: Resamples, if `DRAWS` are too few.
    """
    return _test_columns([np.asarray(changes, float)], min_draws)


def compare_groups(before: ArrayLike, now: ArrayLike, min_draws: int = 0) -> BootstrapResult:
    """Differences of means, now minus before, of unrelated walks.

    Args:
        before: (walks, S), NaN where a value is missing; two or more values in each column.
        now: (other walks, S).
        min_draws: As in `compare_pairs`.
    """
    return _test_columns([np.asarray(before, float), np.asarray(now, float)], min_draws)


def _test_columns(sides: Sequence[Array], min_draws: int) -> BootstrapResult:
    """Tests of slices of columns that are resampled together; every slice gets the same resamples."""
    draws = max(DRAWS, min_draws)
    step = max(1, _MAX_RESAMPLED_MEANS // draws)
    starts = range(0, sides[0].shape[1], step)
    parts = [_test_means([side[:, start : start + step] for side in sides], draws) for start in starts]
    return BootstrapResult(
        **{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(BootstrapResult)}
    )


def _test_means(sides: Sequence[Array], draws: int) -> BootstrapResult:
    """Tests the mean of one group of walks, or the second group's mean minus the first's."""
    rng = np.random.default_rng(_SEED)
    means, variances, counts = zip(*map(_moments, sides))
    resampled_means, resampled_variances = zip(*(_resample(side, draws, rng) for side in sides))
    mean, resampled_mean = _difference(means), _difference(resampled_means)
    error, resampled_error = (np.sqrt(np.sum(v, axis=0)) for v in (variances, resampled_variances))
    tiny = 1e-9 * np.maximum(np.abs(mean), error) + 1e-300  # equal values have no spread
    error = np.maximum(error, tiny)
    t, resampled_t = mean / error, resampled_mean / np.maximum(resampled_error, tiny)
    tail = (1.0 - _COVERAGE) / 2.0
    bounded_t = resampled_mean / np.maximum(resampled_error, np.maximum(_MIN_RELATIVE_ERROR * error, tiny))
    below, above = np.quantile(bounded_t, [tail, 1.0 - tail], axis=0)
    limit = 1e-9 + np.abs(t) * 1e-12  # equal up to rounding
    return BootstrapResult(
        count=np.min(counts, axis=0),
        mean=mean,
        low=mean - above * error,
        high=mean - below * error,
        p_above=(1.0 + (resampled_t >= t - limit).sum(axis=0)) / (1.0 + draws),
        p_below=(1.0 + (resampled_t <= t + limit).sum(axis=0)) / (1.0 + draws),
    )


def _difference(values: Sequence[Array]) -> Array:
    return values[-1] - values[0] if len(values) > 1 else values[0]


def holm_correct(p: ArrayLike) -> Array:
    """p-values corrected for multiple comparisons (Holm 1979), which controls the family-wise error rate."""
    p = np.asarray(p, float)
    order = np.argsort(p, kind="stable")
    factors = np.arange(len(p), 0, -1)
    corrected = np.empty(len(p))
    corrected[order] = np.minimum(np.maximum.accumulate(p[order] * factors), 1.0)
    return corrected


def _moments(x: Array) -> tuple[Array, Array, Array]:
    """Mean, variance of the mean, and number of values of each column."""
    count = np.isfinite(x).sum(axis=0)
    mean = np.nanmean(x, axis=0)
    variance = np.nansum((x - mean) ** 2, axis=0) / np.maximum(count * (count - 1), 1)
    return mean, variance, count


def _resample(x: Array, draws: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Mean and variance of the mean of each resample of centred columns, (draws, S) each."""
    n, columns = len(x), x.shape[1]
    is_present = np.isfinite(x).astype(float)
    centred = np.where(is_present > 0, x - np.nanmean(x, axis=0), 0.0)
    terms = np.hstack([is_present, centred, centred**2])
    mean, variance = np.empty((draws, columns)), np.empty((draws, columns))
    step = max(1, _MAX_DRAWN_AT_ONCE // n)
    for start in range(0, draws, step):
        rows = min(step, draws - start)
        picked = rng.integers(n, size=(rows, n)) + n * np.arange(rows)[:, None]
        multiplicity = np.bincount(picked.ravel(), minlength=rows * n).reshape(rows, n).astype(float)
        count, total, squares = np.split(multiplicity @ terms, 3, axis=1)
        count = np.maximum(count, 1.0)
        part = slice(start, start + rows)
        mean[part] = total / count
        variance[part] = np.maximum(squares / count - mean[part] ** 2, 0.0) / np.maximum(count - 1.0, 1.0)
    return mean, variance
