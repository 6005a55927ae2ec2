"""Bias variation: flicker noise (the bias instability) and a random walk, sample by sample."""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import lfilter

from stridetwin.sim.noise import Noise
from stridetwin.streams.samples import Array

FLOOR = math.sqrt(2 * math.log(2) / math.pi)
"""Flat bottom of the Allan deviation over the bias instability coefficient B (IEEE Std 952-1997, C.1.3)."""

_SPREAD = 4.0
_TIMES_S = 0.125 * _SPREAD ** np.arange(10)  # 0.1 s to 9 h


class Wander:
    """Several independent biases.

    Flicker noise of power density B²/(2π f) is the sum of first-order Gauss-Markov processes with correlation times
    that are spaced evenly on a logarithmic scale, by a factor r, and with variances that all are B² ln(r)/π.

    Args:
        floor: (K,) flat bottom of each bias's Allan deviation, in its unit.
        walk: (K,) coefficient of its random walk, unit/√s.
        rate_hz: Sample rate.
        noise: Source of the random numbers.
    """

    def __init__(self, floor: Array, walk: Array, rate_hz: float, noise: Noise) -> None:
        self._noise, self._count = noise, len(floor)
        sd = floor / FLOOR * math.sqrt(math.log(_SPREAD) / math.pi)
        self._keep = np.exp(-1 / (rate_hz * _TIMES_S))
        self._step = sd * np.sqrt(1 - self._keep[:, None] ** 2)
        self._walk = walk / math.sqrt(rate_hz)
        self._flicker = sd * noise.normal(1.0, (len(_TIMES_S), self._count))
        self._walked = np.zeros(self._count)

    def draw(self, n: int) -> Array:
        """(n, K) biases of the next samples."""
        white = self._noise.normal(1.0, (n, len(_TIMES_S) + 1, self._count))
        walked = self._walked + np.cumsum(white[:, -1] * self._walk, axis=0)
        total = walked.copy()
        for i, keep in enumerate(self._keep):
            flicker, _ = lfilter([1.0], [1.0, -keep], white[:, i] * self._step[i], axis=0, zi=[keep * self._flicker[i]])
            total += flicker
            self._flicker[i] = flicker[-1]
        self._walked = walked[-1]
        return total
