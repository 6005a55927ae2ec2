"""Mean, median and percentiles for compiled code; NumPy's take seconds to compile."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array


@njit(**INNER_KERNEL)
def sort(values: NDArray[np.floating]) -> None:
    """Sorts (N,) values in place by insertion with shrinking gaps (Shell 1959)."""
    n = values.shape[0]
    gap = n // 2
    while gap > 0:
        for i in range(gap, n):
            value, at = values[i], i
            while at >= gap and values[at - gap] > value:
                values[at] = values[at - gap]
                at -= gap
            values[at] = value
        gap //= 2


@njit(**INNER_KERNEL)
def median(ordered: NDArray[np.floating], n: int) -> float:
    """Median of the first n entries of a sorted array (N,)."""
    half = n // 2
    return ordered[half] if n % 2 else (ordered[half - 1] + ordered[half]) / 2


@njit(**INNER_KERNEL)
def percentile(ordered: Array, percent: float) -> float:
    """Percentile of a sorted array (N,), linear between neighbours (Hyndman & Fan 1996, type 7)."""
    last = ordered.shape[0] - 1
    rank = 1 + last * percent / 100.0  # counted from 1, with a fraction
    below = math.floor(rank)
    share = rank - below  # of the upper neighbour
    low = ordered[min(max(below - 1, 0), last)]
    high = ordered[min(max(below, 0), last)]
    return low * (1 - share) + high * share


@njit(**INNER_KERNEL)
def mean(points: Array, first: int, end: int, axis: int) -> float:
    """Mean of one coordinate (`axis`) of points (N, 2), from row `first` to before row `end`."""
    total = 0.0
    for n in range(first, end):
        total += points[n, axis]
    return total / (end - first)
