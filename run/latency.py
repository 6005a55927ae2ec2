"""Latency statistics in constant memory: a histogram over the logarithm of the time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypedDict

import numpy as np

_SHORTEST_S, _LONGEST_S, _GROWTH = 1e-6, 1e3, 1.01  # limits of the histogram, and ratio of a bin's two limits
_BINS = math.ceil(math.log(_LONGEST_S / _SHORTEST_S) / math.log(_GROWTH)) + 1


class TimeFigures(TypedDict):
    """Mean, quantiles and maximum of times, ms."""

    mean_ms: float
    p50_ms: float
    p95_ms: float
    p99_ms: float
    max_ms: float


class TravelFigures(TimeFigures):
    """Times from a sample's stamp until its arrival, ms."""

    min_ms: float


class TopicFigures(TimeFigures):
    """Times from the arrival of a topic's samples until an estimator has processed them, and its own part, ms."""

    samples: int
    estimates: int
    work_mean_ms: float
    work_p99_ms: float
    within_budget: bool


class LatencyFigures(TypedDict):
    """Latency for JSON: times by estimator and topic, and times from stamp to arrival by topic."""

    budget_ms: float
    arrival_to_estimate: dict[str, dict[str, TopicFigures]]
    stamp_to_arrival: dict[str, TravelFigures]


class Times:
    """Statistics of times of one kind in constant memory, by a histogram over the logarithm of the time.

    Quantiles are accurate to 1 % from 1 µs to 1000 s; mean, minimum and maximum are exact.

    Attributes:
        count: Number of times.
        least_s: Shortest time, s; infinite without any.
        most_s: Longest time, s; minus infinity without any.
    """

    def __init__(self) -> None:
        """Begins without times."""
        self._counts = np.zeros(_BINS, np.int64)  # of each bin, whose limits grow by the factor `_GROWTH`
        self.count, self._sum = 0, 0.0
        self.least_s, self.most_s = math.inf, -math.inf

    def add(self, seconds: float) -> None:
        """Adds a time; the quantiles do not resolve times below one microsecond."""
        bin_number = int(math.log(seconds / _SHORTEST_S) / math.log(_GROWTH)) if seconds > _SHORTEST_S else 0
        self._counts[min(bin_number, _BINS - 1)] += 1  # the last bin also has all longer times
        self.count += 1
        self._sum += seconds
        self.least_s, self.most_s = min(self.least_s, seconds), max(self.most_s, seconds)

    @property
    def mean_s(self) -> float:
        """Mean, s; 0 without any times."""
        return self._sum / self.count if self.count else 0.0

    def quantile_s(self, share: float) -> float:
        """The time in s that the given share (0-1) of all times does not exceed; 0 without any times.

        It is the upper limit of the bin that holds it, and no more than the longest time.
        """
        if not self.count:
            return 0.0
        # the first bin up to whose end the requested number of times lies
        bin_number = int(np.searchsorted(np.cumsum(self._counts), math.ceil(share * self.count)))
        return min(_SHORTEST_S * _GROWTH ** (bin_number + 1), self.most_s)

    def figures(self) -> TimeFigures:
        """Mean, quantiles and maximum in ms."""
        return TimeFigures(
            mean_ms=1e3 * self.mean_s,
            p50_ms=1e3 * self.quantile_s(0.5),
            p95_ms=1e3 * self.quantile_s(0.95),
            p99_ms=1e3 * self.quantile_s(0.99),
            max_ms=1e3 * max(self.most_s, 0.0) if self.count else 0.0,
        )


class Latency:
    """Latency from the arrival of a sample until an estimator has processed it, by estimator and topic.

    Args:
        budget_s: Limit that 99 % of the samples of each stream must meet, s.
    """

    def __init__(self, budget_s: float) -> None:
        """Begins without samples; the budget is in s."""
        self.budget_s = budget_s
        # by estimator and topic: times from arrival until processed, computing times, number of estimates
        self._whole: dict[tuple[str, str], Times] = {}
        self._work: dict[tuple[str, str], Times] = {}
        self._estimates: dict[tuple[str, str], int] = {}
        self._travel: dict[str, Times] = {}  # from stamp to arrival, by topic

    def add(self, estimator: str, topic: str, *, whole_s: float, work_s: float, estimated: bool) -> None:
        """Adds the times of one sample.

        Args:
            estimator: Name of the estimator.
            topic: Topic of the sample.
            whole_s: From the sample's arrival until the estimator has processed it, s.
            work_s: The part of it in which the estimator computed, s.
            estimated: Whether the sample gave a new estimate.
        """
        key = estimator, topic
        if key not in self._whole:  # its first sample
            self._whole[key], self._work[key], self._estimates[key] = Times(), Times(), 0
        self._whole[key].add(whole_s)
        self._work[key].add(work_s)
        self._estimates[key] += estimated

    def add_travel(self, topic: str, seconds: float) -> None:
        """Adds the time from a sample's stamp until its arrival."""
        self._travel.setdefault(topic, Times()).add(seconds)

    @property
    def took_any(self) -> bool:
        """Whether any estimator has processed a sample."""
        return bool(self._whole)

    @property
    def within(self) -> bool:
        """Whether 99 % of each stream's samples met the budget."""
        return all(times.quantile_s(0.99) <= self.budget_s for times in self._whole.values())

    def data(self) -> LatencyFigures:
        """All statistics as data for JSON: times by estimator and topic, and times from stamp to arrival by topic."""
        estimators: dict[str, dict[str, TopicFigures]] = {}
        for (estimator, topic), whole in self._whole.items():
            work = self._work[estimator, topic]
            estimators.setdefault(estimator, {})[topic] = {
                "samples": whole.count,
                "estimates": self._estimates[estimator, topic],
                **whole.figures(),
                "work_mean_ms": 1e3 * work.mean_s,
                "work_p99_ms": 1e3 * work.quantile_s(0.99),
                "within_budget": whole.quantile_s(0.99) <= self.budget_s,
            }
        travel: dict[str, TravelFigures] = {
            topic: {"min_ms": 1e3 * times.least_s, **times.figures()} for topic, times in self._travel.items()
        }
        return {"budget_ms": 1e3 * self.budget_s, "arrival_to_estimate": estimators, "stamp_to_arrival": travel}

    def table(self) -> list[str]:
        """All statistics as lines of text: a row per estimator and topic, and a row per topic from stamp to arrival."""
        heads = ("mean ms", "p50", "p95", "p99", "max")
        data, lines = self.data(), list[str]()
        if self._whole:
            lines.append(
                _format_row("from arrival to estimate", ("samples", "estimates", *heads, "work mean", "work p99"))
            )
        for estimator, topics in data["arrival_to_estimate"].items():
            for topic, row in topics.items():
                work = [f"{row['work_mean_ms']:.2f}", f"{row['work_p99_ms']:.2f}"]
                line = _format_row(f"{estimator} {topic}", [row["samples"], row["estimates"], *_cells(row), *work])
                lines.append(line + ("" if row["within_budget"] else "  over budget"))
        if self._whole:
            lines.append(f"budget: 99 % within {1e3 * self.budget_s:g} ms: {'kept' if self.within else 'not kept'}")
        if self._travel:
            lines.append(_format_row("from stamp to arrival", ("samples", "min", *heads)))
        for topic, times in data["stamp_to_arrival"].items():
            lines.append(_format_row(topic, [self._travel[topic].count, f"{times['min_ms']:.2f}", *_cells(times)]))
        return lines


def _cells(row: TimeFigures) -> list[str]:
    """Mean, quantiles and maximum of a row of `Latency.data` as text, in ms."""
    return [f"{ms:.2f}" for ms in (row["mean_ms"], row["p50_ms"], row["p95_ms"], row["p99_ms"], row["max_ms"])]


def _format_row(name: str, cells: Sequence[object]) -> str:
    """A line of a table of text: a name and the cells, aligned at the right."""
    return f"{name:<36}" + "".join(f"{c:>11}" for c in cells)
