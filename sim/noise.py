"""Sensor noise: one child stream per topic, so that a sensor's noise does not depend on the other sensors."""

from __future__ import annotations

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
        self._seeds = seeds
        self._rng = None if seeds is None else np.random.default_rng(seeds)

    @classmethod
    def of_topic(cls, seed: int, topic: str) -> Self:
        """Noise of one topic, keyed by a checksum of its name rather than its position in a list.

        Args:
            seed: Seed of the walk.
            topic: Name of the stream.
        """
        return cls(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(topic.encode()),)))

    def normal(self, sd: float | Array, shape: int | tuple[int, ...]) -> Array:
        """Normal deviates of standard deviation `sd`, drawn row by row; zeros where silent."""
        return np.zeros(shape) if self._rng is None else sd * self._rng.standard_normal(shape)

    def uniform(self, shape: int | tuple[int, ...]) -> Array:
        """Uniform deviates between 0 and 1, drawn row by row; ones where silent, so that rare events do not occur."""
        return np.ones(shape) if self._rng is None else self._rng.random(shape)

    def at(self, t_ns: int) -> Noise:
        """Noise of one image or other event by its time, independent of the draws before it."""
        if self._seeds is None:
            return self
        return Noise(np.random.SeedSequence(self._seeds.entropy, spawn_key=(*self._seeds.spawn_key, t_ns)))

    def integers(self, high: tuple[int, ...]) -> tuple[int, ...]:
        """One whole number below each of `high`; zeros where silent."""
        return tuple(int(i) for i in self._rng.integers(high)) if self._rng is not None else (0,) * len(high)
