"""Stamps of a sensor's clock for samples measured at true times."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.sensor_config import Clock
from stridetwin.streams.samples import Block

Instants = NDArray[np.int64]
_MOST_JITTER = 0.45  # of a period, so that no sample overtakes the one before


class Stamps:
    """Clock of one stream.

    Args:
        clock: Parameters of the clock.
        rate_hz: Sample rate.
        noise: Source of its jitter.
    """

    def __init__(self, clock: Clock, rate_hz: float, noise: Noise) -> None:
        self._clock, self._noise = clock, noise
        self._most = _MOST_JITTER / rate_hz

    def of(self, t_ns: Instants) -> Instants:
        """(N,) stamps of the next samples, measured at (N,) true times; −1 for stamps before the recording's start."""
        clock = self._clock
        if clock == Clock():
            return t_ns
        late = clock.shift_s + 1e-6 * clock.drift_ppm * (t_ns * 1e-9)
        if clock.jitter_s:
            late = late + np.clip(self._noise.normal(clock.jitter_s, len(t_ns)), -self._most, self._most)
        stamps = t_ns + np.round(late * 1e9).astype(np.int64)
        stamps[stamps < 0] = -1
        return stamps

    def on(self, block: Block[Any]) -> Block[Any]:
        """The block with its clock's stamps, without samples from before the recording's start."""
        stamps = self.of(block.t_ns)
        kept = stamps >= 0
        columns = {name: column[kept] for name, column in block.columns.items()}
        return replace(block, t_ns=stamps[kept], columns=columns)
