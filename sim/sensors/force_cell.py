"""Readout of force-sensing resistors: creep, hysteresis, quantisation and filter."""

from __future__ import annotations

import math

import numba
import numpy as np
from scipy.signal import butter, lfilter, sosfilt

from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.figure import G
from stridetwin.sim.parts.kinds import ForceCellPart
from stridetwin.streams.samples import Array

_CREEP_S = (1.0, 10.0, 100.0)  # time constants; a constant load creeps by the same amount per decade
_PLAY = 0.1  # of the load: play of the hysteresis
_FULL_COUNT = 4095


class ForceCells:
    """Several cells of one part.

    The hysteresis is a play whose width grows with the force: (1 − 0.1) F under rising load and (1 + 0.1) F under
    falling load, and a share of the difference to F is measured. The counts x of the converter follow from the
    calibration curve F = b₁ x + b₂ x² (kgf, x in thousands), which also converts them back.

    Args:
        part: Parameters of the cells.
        count: Number of cells.
        rate_hz: Sample rate.
        noise: Source of their errors.
    """

    def __init__(self, part: ForceCellPart, count: int, rate_hz: float, noise: Noise) -> None:
        self._part, self._noise = part, noise
        self._gain = 1 + noise.normal(part.gain, count)
        self._keep = [math.exp(-1 / (rate_hz * tau)) for tau in _CREEP_S]
        self._crept = np.zeros((len(_CREEP_S), 1, count))
        self._play = np.zeros(count)
        cut = part.filter_hz
        self._sos = butter(2, cut, fs=rate_hz, output="sos") if cut < 0.5 * rate_hz else None
        self._filter = np.zeros((1, 2, count))

    def read(self, load: Array) -> Array:
        """(N, count) measured force, N, for the next true loads (N, count), N."""
        measured = self._loop(self._creep(self._gain * load))
        measured = np.clip(measured + self._noise.normal(self._part.noise, load.shape), 0.0, self._part.range)
        if any(self._part.curve):
            measured = _counted(measured, *self._part.curve)
        if self._sos is not None:
            measured, self._filter = sosfilt(self._sos, measured, axis=0, zi=self._filter)
            measured = np.maximum(measured, 0.0)
        return measured

    def _creep(self, load: Array) -> Array:
        total = load.copy()
        for i, keep in enumerate(self._keep):
            late, self._crept[i] = lfilter([1 - keep], [1.0, -keep], load, axis=0, zi=self._crept[i])
            total += self._part.drift * late
        return total

    def _loop(self, load: Array) -> Array:
        share = self._part.hysteresis / (2 * _PLAY)
        if not share:
            return load
        return load + share * (_played(self._play, load) - load)


@numba.njit(cache=True)
def _played(last: Array, load: Array) -> Array:
    """Output of a play for (N, count) loads, from the (count,) state `last`, which is updated."""
    play = np.empty(load.shape)
    for k in range(len(load)):
        for i in range(len(last)):
            last[i] = play[k, i] = min(max(last[i], (1 - _PLAY) * load[k, i]), (1 + _PLAY) * load[k, i])
    return play


def _counted(force: Array, b1: float, b2: float) -> Array:
    """Force after quantisation by the converter, N."""
    kgf = force / G
    x = (-b1 + np.sqrt(np.maximum(b1**2 + 4 * b2 * kgf, 0.0))) / (2 * b2) if b2 else kgf / b1
    counts = np.clip(np.round(1000 * x), 0, _FULL_COUNT) / 1000
    return G * (b1 * counts + b2 * counts**2)
