"""What all sensor models share: their pattern, the instants of their samples, and the stamps of their clocks."""

from __future__ import annotations

from dataclasses import replace
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.sensor_config import Clock
from stridetwin.streams.rig import ImuCalibration, OtherSensor
from stridetwin.streams.samples import Array, Block, Sample

Instants = NDArray[np.int64]
_MOST_JITTER = 0.45  # of a period, so that no sample overtakes the one before

CalibrationT = TypeVar("CalibrationT", bound=ImuCalibration | OtherSensor)
PartT = TypeVar("PartT")
SampleT = TypeVar("SampleT", bound=Sample)


class SensorModel(Generic[CalibrationT, PartT]):
    """Pattern of every sensor model except the cameras: nominal output, then errors, then stamps.

    `read` of a model takes the true motion or load at the next instants, computes the nominal output in the sensor's
    frame, adds the errors of the part in the order in which they arise, and returns a block at the true times. The
    state of its errors continues from chunk to chunk. `SensorSuite` replaces the times by the stamps of the clock.

    Args:
        calibration: Topic, rate and mount.
        part: True parameters of the sensor.
        noise: Source of its errors.
    """

    def __init__(self, calibration: CalibrationT, part: PartT, noise: Noise) -> None:
        self._calibration, self._part, self._noise = calibration, part, noise

    def _block(self, kind: type[SampleT], t_ns: Instants, **columns: Array) -> Block[SampleT]:
        """Block of samples of this sensor's topic, from columns by field of the sample."""
        return Block(topic=self._calibration.topic, kind=kind, t_ns=t_ns, columns=columns)


def instants(rate_hz: float, after_ns: int, until_ns: int) -> Instants:
    """(N,) ns, sample times k / `rate_hz` in (`after_ns`, `until_ns`], rounded to ns, with whole k; N may be 0."""
    # numbers k of the samples just outside both ends
    first, last = np.floor(after_ns * 1e-9 * rate_hz), np.ceil(until_ns * 1e-9 * rate_hz)
    t = np.round(np.arange(first, last + 1) * (1e9 / rate_hz)).astype(np.int64)
    return t[(t > after_ns) & (t <= until_ns)]


def step_ends(rate_hz: float, steps: int, t_ns: Instants) -> Instants:
    """(M,) ns, ends of the inner steps of a sensor that reads the motion more often than it sends samples.

    Each sample has `steps` inner steps, the last of which ends at the sample. The sample at time 0 has a single one,
    since the walk has no motion before.

    Args:
        rate_hz: Sample rate.
        steps: Inner steps per sample.
        t_ns: (N,) consecutive whole sample times.
    """
    samples = np.round(t_ns * (rate_hz * 1e-9)).astype(np.int64)  # their numbers k
    first = max(steps * (int(samples[0]) - 1) + 1, 0)  # number of the first inner step since time 0
    return np.round(np.arange(first, steps * int(samples[-1]) + 1) * (1e9 / (rate_hz * steps))).astype(np.int64)


class Stamps:
    """Clock of one stream: it turns true sample times into stamps.

    Args:
        clock: Offset, drift, jitter and latency.
        rate_hz: Sample rate, which limits the jitter: stamps never change their order.
        noise: Source of the jitter.
    """

    def __init__(self, clock: Clock, rate_hz: float, noise: Noise) -> None:
        self._clock, self._noise = clock, noise
        self._most = _MOST_JITTER / rate_hz  # s, largest jitter of one stamp

    def stamp(self, t_ns: Instants) -> Instants:
        """(N,) ns, stamps of the next samples, from their (N,) true times; −1 for stamps before the recording's start.

        A stamp differs from the true time by the clock's constant shift, its drift since the start of the walk, and a
        random jitter. The jitter is at most `_most`, so that stamps keep their order.
        """
        clock = self._clock
        if clock == Clock():  # an exact clock
            return t_ns
        late = clock.shift_s + 1e-6 * clock.drift_ppm * (t_ns * 1e-9)  # (N,) s, stamp minus true time
        if clock.jitter_s:
            late = late + np.clip(self._noise.normal(clock.jitter_s, len(t_ns)), -self._most, self._most)
        stamps = t_ns + np.round(late * 1e9).astype(np.int64)
        stamps[stamps < 0] = -1
        return stamps

    def stamp_block(self, block: Block[Sample]) -> Block[Sample]:
        """Block with the stamps of this clock, without samples that it stamps before the recording's start."""
        stamps = self.stamp(block.t_ns)
        kept = stamps >= 0
        return replace(block, t_ns=stamps[kept], columns={name: x[kept] for name, x in block.columns.items()})
