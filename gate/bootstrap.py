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
"""Least number of resamples of a test."""
_MAX_DRAWN_AT_ONCE = 2_000_000  # numbers drawn; each takes twice 8 bytes
_MAX_RESAMPLED_MEANS = 10_000_000  # means of all resamples, also held several times
_SEED = 20_240_229  # of the resamples, so that equal values give equal results
_COVERAGE = 0.95  # of the intervals
_MIN_RELATIVE_ERROR = 0.3
"""Of the standard error in a resample, relative to that of all walks; for intervals only.

A resample of few walks that leaves out their one outlier has hardly any spread, and its statistic no bound. Widths of
intervals then had a 99th percentile of up to 215 standard errors; with this bound 8, and the same coverage (of 8, 15
and 30 values, normal to lognormal and with outliers). Tests keep the plain statistic, which raises fewer false alarms.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class BootstrapResult:
    """Bootstrap-t results of S means, or of S differences of means; `compare_pairs` and `compare_groups` return them.

    Attributes:
        count: (S,) number of values; of two groups the smaller one.
        mean: (S,) means, or differences of means.
        low: (S,) lower end of the 95 % interval.
        high: (S,) upper end.
        p_above: (S,) probability of a mean at least this large if the truth were 0 or less.
        p_below: (S,) probability of a mean at most this large if the truth were 0 or more.
    """

    count: Array
    mean: Array
    low: Array
    high: Array
    p_above: Array
    p_below: Array


def compare_pairs(changes: ArrayLike, min_draws: int = 0) -> BootstrapResult:
    """Tests whether mean changes differ from 0, for walks that are measured before and after a change.

    Use it where both measurements are of the same walks; `compare_groups` is for unrelated walks. All S columns share
    the resamples of the walks.

    Args:
        changes: (walks, S) values after minus before, NaN where a value is missing; two or more values in each column.
        min_draws: Least number of resamples; `DRAWS` if that is more.

    Returns:
        Means of the S columns with their 95 % intervals and one-sided p-values.
    """
    return _test_columns([np.asarray(changes, float)], min_draws)


def compare_groups(before: ArrayLike, now: ArrayLike, min_draws: int = 0) -> BootstrapResult:
    """Tests differences of means, now minus before, of two groups of unrelated walks.

    Args:
        before: (walks, S) values of the first group, NaN where one is missing; two or more values in each column.
        now: (walks, S) values of the other group, whose number of walks may differ.
        min_draws: Least number of resamples; `DRAWS` if that is more.

    Returns:
        The S differences with their 95 % intervals and one-sided p-values.
    """
    return _test_columns([np.asarray(before, float), np.asarray(now, float)], min_draws)


def _test_columns(sides: Sequence[Array], min_draws: int) -> BootstrapResult:
    """Tests slices of the columns one after the other, so that memory stays bounded.

    The generator starts anew for every slice, so all columns get the same resamples of the walks.

    Args:
        sides: One group of values (walks, S), whose means are tested, or two groups, whose differences of means are.
        min_draws: Least number of resamples.
    """
    draws = max(DRAWS, min_draws)
    # columns of a slice: all their resampled means are in memory at once
    step = max(1, _MAX_RESAMPLED_MEANS // draws)
    starts = range(0, sides[0].shape[1], step)
    parts = [_test_means([side[:, start : start + step] for side in sides], draws) for start in starts]
    # every field of the result is an array over the columns, joined from those of the slices
    return BootstrapResult(
        **{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(BootstrapResult)}
    )


def _test_means(sides: Sequence[Array], draws: int) -> BootstrapResult:
    """Bootstrap-t test of the mean of one group, or of the second group's minus the first's.

    Efron & Tibshirani 1993, 12.5 and 16.4.

    With the mean m and its standard error s, a resample with mean m* (of centred values) and error s* has the statistic
    t* = m* / s*. The interval is m - t*(97.5 %) s to m - t*(2.5 %) s, where s* is at least `_MIN_RELATIVE_ERROR` s; the
    p-value is the share of t* at least as extreme as m / s, without that bound.

    Args:
        sides: One group of values (walks, S), or two.
        draws: Number of resamples.
    """
    rng = np.random.default_rng(_SEED)
    # of each group: (S,) means, squared standard errors and counts, and the first two of every resample, (draws, S)
    means, variances, counts = zip(*map(_moments, sides))
    resampled_means, resampled_variances = zip(*(_resample(side, draws, rng) for side in sides))
    mean, resampled_mean = _difference(means), _difference(resampled_means)
    # the squared standard errors of two groups add up
    error, resampled_error = (np.sqrt(np.sum(v, axis=0)) for v in (variances, resampled_variances))
    # least standard error, because equal values have no spread, and the statistics divide by it
    tiny = 1e-9 * np.maximum(np.abs(mean), error) + 1e-300
    error = np.maximum(error, tiny)  # standard error (S,) of the mean or difference
    t, resampled_t = mean / error, resampled_mean / np.maximum(resampled_error, tiny)
    tail = (1.0 - _COVERAGE) / 2.0
    bounded_t = resampled_mean / np.maximum(resampled_error, np.maximum(_MIN_RELATIVE_ERROR * error, tiny))
    # the quantiles change sides: the upper one gives the lower end of the interval
    below, above = np.quantile(bounded_t, [tail, 1.0 - tail], axis=0)
    limit = 1e-9 + np.abs(t) * 1e-12  # statistics that differ by up to this count as equal
    # the p-values count the walks themselves as one more resample, so that none is 0
    return BootstrapResult(
        count=np.min(counts, axis=0),
        mean=mean,
        low=mean - above * error,
        high=mean - below * error,
        p_above=(1.0 + (resampled_t >= t - limit).sum(axis=0)) / (1.0 + draws),
        p_below=(1.0 + (resampled_t <= t + limit).sum(axis=0)) / (1.0 + draws),
    )


def _difference(values: Sequence[Array]) -> Array:
    """The second value minus the first, or the only value."""
    return values[-1] - values[0] if len(values) > 1 else values[0]


def holm_correct(p: ArrayLike) -> Array:
    """Corrects (N,) p-values for multiple comparisons (Holm 1979), and returns them in the same order.

    The probability that any of the N tests is a false alarm is then at most the level to which they are compared.
    The k-th smallest of N p-values is multiplied by N - k + 1; a corrected value is at least those of smaller p-values,
    and at most 1.
    """
    p = np.asarray(p, float)
    order = np.argsort(p, kind="stable")
    factors = np.arange(len(p), 0, -1)  # N for the smallest p-value, 1 for the largest
    corrected = np.empty(len(p))
    corrected[order] = np.minimum(np.maximum.accumulate(p[order] * factors), 1.0)
    return corrected


def _moments(x: Array) -> tuple[Array, Array, Array]:
    """Mean, variance of the mean, and number of the values in each column of (walks, S); NaN is left out."""
    count = np.isfinite(x).sum(axis=0)
    mean = np.nanmean(x, axis=0)
    variance = np.nansum((x - mean) ** 2, axis=0) / np.maximum(count * (count - 1), 1)
    return mean, variance, count


def _resample(x: Array, draws: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Mean and variance of the mean of each resample of the centred columns of `x` (walks, S), (draws, S) each.

    A resample draws as many walks as there are, with replacement. How often it draws each walk times sums over walks
    gives count, sum and sum of squares of all columns at once.

    Args:
        x: (walks, S) values, NaN where one is missing.
        draws: Number of resamples.
        rng: Draws the walks.
    """
    n, columns = len(x), x.shape[1]
    is_present = np.isfinite(x).astype(float)
    centred = np.where(is_present > 0, x - np.nanmean(x, axis=0), 0.0)
    terms = np.hstack([is_present, centred, centred**2])  # (walks, 3 S): summands of count, sum, sum of squares
    mean, variance = np.empty((draws, columns)), np.empty((draws, columns))
    step = max(1, _MAX_DRAWN_AT_ONCE // n)
    for start in range(0, draws, step):
        rows = min(step, draws - start)
        # resample k draws numbers k n to k n + n - 1, so that one `bincount` counts the walks of all resamples
        picked = rng.integers(n, size=(rows, n)) + n * np.arange(rows)[:, None]
        multiplicity = np.bincount(picked.ravel(), minlength=rows * n).reshape(rows, n).astype(float)
        count, total, squares = np.split(multiplicity @ terms, 3, axis=1)
        count = np.maximum(count, 1.0)  # a resample may have drawn no walk with a value
        part = slice(start, start + rows)
        mean[part] = total / count
        # variance of the mean: (mean square - square of the mean) / (count - 1)
        variance[part] = np.maximum(squares / count - mean[part] ** 2, 0.0) / np.maximum(count - 1.0, 1.0)
    return mean, variance
