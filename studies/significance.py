"""Significance of differences between alternatives, such as places or methods, paired by walk: all have the same walks.

Means of few walks have Student's intervals, those of more walks intervals by bootstrap-t: a few values have too few
distinct resamples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TypedDict

import numpy as np
from scipy.special import stdtr, stdtrit

from stridetwin.gate.bootstrap import BootstrapResult, compare_pairs, holm_correct
from stridetwin.streams.samples import Array

SIGNIFICANCE_LEVEL = 0.05
_MIN_WALKS_OF_INTERVAL = 3  # with fewer walks there is no interval
_MIN_WALKS_OF_BOOTSTRAP = 8  # with fewer walks Student's t is used instead of the bootstrap
_COVERAGE = 0.95  # of the intervals
MIN_SEEDS = 5
"""With fewer walks nothing is called significant."""


class IntervalRow(TypedDict):
    """An `Interval` as a mapping for JSON."""

    mean: float
    low: float | None
    high: float | None


Sentences = TypedDict("Sentences", {"words": list[str]})  # noqa: UP013  (a key of JSON, not a name in the code)
"""What a result says in sentences."""


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A mean over walks with its 95 % interval.

    Attributes:
        mean: The mean; NaN if a value is missing.
        low: Lower end; None with one or two walks, or a missing value.
        high: Upper end.
    """

    mean: float
    low: float | None = None
    high: float | None = None

    def row(self) -> IntervalRow:
        """Mean and bounds as a mapping for JSON."""
        return {"mean": self.mean, "low": self.low, "high": self.high}


@dataclass(frozen=True, kw_only=True)
class Difference(Interval):
    """A mean difference over walks; its interval is not corrected for the number of differences.

    Attributes:
        p: Probability of so large a difference by chance, corrected for the number of differences (Holm).
        significant: Whether it is significant.
    """

    p: float
    significant: bool


@dataclass(frozen=True, kw_only=True)
class PairDifference(Difference):
    """The difference of two alternatives: the mean loss of the second minus that of the first.

    Attributes:
        first: Row of the first alternative.
        second: Row of the second one.
    """

    first: int
    second: int


def intervals(values: Array) -> list[Interval]:
    """Means of the C columns of (W, C) values over W walks, with 95 % intervals.

    A column with a missing value (NaN) has the mean NaN and no interval; with one or two walks no column has one.
    """
    result = [Interval(mean=float(np.mean(column))) for column in values.T]
    complete = np.flatnonzero(np.isfinite(values).all(axis=0)).tolist()  # columns without a missing value
    if len(values) > 1 and complete:
        for i, (low, high) in zip(complete, _interval_bounds(_test_means(values[:, complete]), len(values))):
            result[i] = Interval(mean=result[i].mean, low=low, high=high)
    return result


def _test_means(values: Array) -> BootstrapResult:
    """Tests of the means of (W, C) columns: by bootstrap-t, or Student's with fewer than 8 walks."""
    count = len(values)
    if count >= _MIN_WALKS_OF_BOOTSTRAP:
        return compare_pairs(values)
    mean, error = values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(count)
    # (C,) half width of the interval, and probability that Student's variable is below mean / error
    half = float(stdtrit(count - 1, 0.5 + _COVERAGE / 2.0)) * error
    # equal values have no spread: the divisor is at least a tiny part of the mean
    below = stdtr(count - 1, mean / np.maximum(error, 1e-12 * np.abs(mean) + 1e-300))
    return BootstrapResult(
        count=np.full(len(mean), count),
        mean=mean,
        low=mean - half,
        high=mean + half,
        p_above=1.0 - below,
        p_below=below,
    )


def _interval_bounds(result: BootstrapResult, walks: int) -> list[tuple[float | None, float | None]]:
    """Bounds of the intervals of C means over a number of walks; None with fewer than three walks."""
    if walks < _MIN_WALKS_OF_INTERVAL:
        return [(None, None)] * len(result.mean)
    return list(zip(result.low.tolist(), result.high.tolist()))


def compare_places(losses: Array) -> list[PairDifference]:
    """Compares every pair of places with a loss on every walk.

    Args:
        losses: (P, W) of P places on W walks, lower is better.

    Returns:
        The difference of each pair, corrected for their number; empty with fewer than two walks.
    """
    complete = np.flatnonzero(np.isfinite(losses).all(axis=1)).tolist()  # numbers of the places without a missing loss
    pairs = list(combinations(complete, 2))
    if losses.shape[1] < 2 or not pairs:
        return []
    # (W, pairs) loss of the second place minus that of the first
    tested = differences(np.column_stack([losses[b] - losses[a] for a, b in pairs]))
    return [PairDifference(first=a, second=b, **vars(difference)) for (a, b), difference in zip(pairs, tested)]


def differences(changes: Array) -> list[Difference]:
    """Tests of the means of differences, corrected for their number (Holm).

    Args:
        changes: (W, C) differences on W walks, two or more.

    Returns:
        Mean, interval and p-value of each of the C columns; with fewer than `MIN_SEEDS` walks none is significant.
    """
    result = _test_means(changes)
    # two-sided p-values
    corrected = holm_correct(np.minimum(1.0, 2.0 * np.minimum(result.p_above, result.p_below))).tolist()
    enough = len(changes) >= MIN_SEEDS
    return [
        Difference(mean=mean, low=low, high=high, p=p, significant=enough and p < SIGNIFICANCE_LEVEL)
        for mean, (low, high), p in zip(result.mean.tolist(), _interval_bounds(result, len(changes)), corrected)
    ]


def missing_test_reason(walks: int) -> str:
    """Why nothing is called significant over so few walks; "" if they are enough."""
    if walks < 2:
        return "One walk: no difference can be tested for significance."
    if walks < MIN_SEEDS:
        return f"{walks} walks are too few to test significance; expected {MIN_SEEDS} or more seeds."
    return ""


def interval_text(interval: IntervalRow | None) -> str:
    """A mean with its interval, where it has one and walks differ; - for None."""
    if interval is None:
        return "-"
    mean, low, high = (
        None if value is None else f"{value:.4g}" for value in (interval["mean"], interval["low"], interval["high"])
    )
    # without an interval, or if all three are equal as text, the mean alone
    has_no_width = low == mean == high
    return str(mean) if low is None or high is None or has_no_width else f"{mean} ({low} to {high})"


def comparison_text(pairs: Sequence[PairDifference], names: Sequence[str], walks: int) -> list[str]:
    """The comparison of places as sentences, those of the best place first.

    Args:
        pairs: Result of `compare_places`.
        names: Names of the places, best first.
        walks: Number of walks.
    """
    if why := missing_test_reason(walks):
        return [why]
    sentences = []
    for first in sorted({pair.first for pair in pairs}):
        pairs_of_first = [p for p in pairs if p.first == first]
        worse = [names[p.second] for p in pairs_of_first if p.significant]
        similar = [names[p.second] for p in pairs_of_first if not p.significant]
        # the first place of a pair is the better one, as the places are sorted
        if similar:
            sentences.append(f"{names[first]}: the difference from {_join_names(similar)} is not significant.")
        if worse:
            sentences.append(f"{names[first]} is better than {_join_names(worse)} (significant).")
    return sentences


def _join_names(names: Sequence[str]) -> str:
    """Names as a phrase, such as `a, b and c`."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def pareto_front(losses: Array) -> list[int]:
    """Numbers of the Pareto-optimal rows of (P, S) losses of P places by S scores.

    A row is Pareto-optimal if no other row is at least as good in every column and better in one. Rows with a missing
    loss never are.
    """
    optimal = []
    for i in np.flatnonzero(np.isfinite(losses).all(axis=1)).tolist():
        as_good = np.all(losses <= losses[i], axis=1)  # (P,) rows that are at least as good in every column
        if not np.any(as_good & np.any(losses < losses[i], axis=1)):
            optimal.append(i)
    return optimal
