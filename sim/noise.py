"""Sensor noise and bias variation (flicker noise, the bias instability, plus a random walk), sample by sample.

Each topic has its own child stream, so a sensor's noise does not depend on the other sensors.
"""

from __future__ import annotations

import math
import zlib
from typing import Self

import numpy as np

from stridetwin.streams.samples import Array


class Noise:
    """Source of normal deviates for one sensor, or a silent one.

    Args:
        seeds: Child sequence of this sensor, or None for no noise at all.
    """

    def __init__(self, seeds: np.random.SeedSequence | None) -> None:
        """Starts the sequence of random numbers; without `seeds` all functions return their silent values."""
        self._seeds = seeds
        self._rng = None if seeds is None else np.random.default_rng(seeds)

    @classmethod
    def of_topic(cls, seed: int, topic: str) -> Self:
        """Noise of one topic in the walk of a seed, keyed by a checksum of its name rather than its place in a list."""
        return cls(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(topic.encode()),)))

    def normal(self, sd: float | Array, shape: int | tuple[int, ...]) -> Array:
        """Normal deviates of standard deviation `sd`, drawn row by row; zeros where silent."""
        return np.zeros(shape) if self._rng is None else sd * self._rng.standard_normal(shape)

    def uniform(self, shape: int | tuple[int, ...]) -> Array:
        """Uniform deviates between 0 and 1, drawn row by row; ones where silent, so that rare events do not occur."""
        return np.ones(shape) if self._rng is None else self._rng.random(shape)

    def at(self, t_ns: int) -> Noise:
        """Noise of one image or other event by its time `t_ns`, independent of the draws before it.

        Other whole numbers select further independent sequences of a sensor. A silent source stays silent.
        """
        if self._seeds is None:
            return self
        return Noise(np.random.SeedSequence(self._seeds.entropy, spawn_key=(*self._seeds.spawn_key, t_ns)))

    def integers(self, high: tuple[int, ...]) -> tuple[int, ...]:
        """One random whole number from 0 to below each of `high`; zeros where silent."""
        if self._rng is None:
            return (0,) * len(high)
        return tuple(int(i) for i in self._rng.integers(high))


FLOOR = math.sqrt(2 * math.log(2) / math.pi)
"""Flat bottom of the Allan deviation over the bias instability coefficient B (IEEE Std 952-1997, C.1.3)."""

_SPREAD = 4.0  # ratio r of neighbouring correlation times
_TIMES_S = 0.125 * _SPREAD ** np.arange(10)  # 0.1 s to 9 h


class Wander:
    """Several independent biases, each with flicker noise and a random walk.

    Flicker noise of power density B²/(2π f) is the sum of first-order Gauss-Markov processes with correlation times
    that are spaced evenly on a logarithmic scale, by a factor r, and with variances that all are B² ln(r)/π.

    Args:
        floor: (K,) flat bottom of each bias's Allan deviation, in its unit.
        walk: (K,) coefficient of its random walk, unit/√s.
        rate_hz: Sample rate.
        noise: Source of the random numbers.
    """

    def __init__(self, floor: Array, walk: Array, rate_hz: float, noise: Noise) -> None:
        """Draws the start values; P = `len(_TIMES_S)` below is the number of Gauss-Markov processes per bias."""
        self._noise, self._count = noise, len(floor)
        sd = floor / FLOOR * math.sqrt(math.log(_SPREAD) / math.pi)  # (K,) of each process
        self._keep = np.exp(-1 / (rate_hz * _TIMES_S))  # (P,) share of a process that remains after one sample
        self._step = sd * np.sqrt(1 - self._keep[:, None] ** 2)  # (P, K) SD of the innovation of one sample
        self._walk = walk / math.sqrt(rate_hz)  # (K,) SD of one step of the random walk
        self._flicker = sd * noise.normal(1.0, (len(_TIMES_S), self._count))  # (P, K) last values of the processes
        self._walked = np.zeros(self._count)  # (K,) last values of the random walks

    def draw(self, n: int) -> Array:
        """(n, K) biases of the next n samples: flicker noise and random walk of each of the K biases.

        The last values of all processes (`_flicker`) and random walks (`_walked`) are kept for the next call.
        """
        from scipy.signal import lfilter  # takes long to import, so only when a sensor filters

        # the last of the second axis drives the random walk, the others the processes
        white = self._noise.normal(1.0, (n, len(_TIMES_S) + 1, self._count))
        walked = self._walked + np.cumsum(white[:, -1] * self._walk, axis=0)
        total = walked.copy()
        for i, keep in enumerate(self._keep):
            # one process of every bias: x_k = keep x_(k-1) + step; `zi` carries the last value over
            innovation = white[:, i] * self._step[i]
            flicker, _ = lfilter([1.0], [1.0, -keep], innovation, axis=0, zi=[keep * self._flicker[i]])
            total += flicker
            self._flicker[i] = flicker[-1]
        self._walked = walked[-1]
        return total
