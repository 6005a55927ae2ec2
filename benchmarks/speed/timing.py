"""Shared tools of the speed benchmarks: a stopwatch, the peak memory, and walks replayed back to back."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import numpy as np

from stridetwin.scenarios.record import record
from stridetwin.sim.config import TwinConfig
from stridetwin.sim.twin import Twin
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Array, Sample

Summary = dict[str, dict[str, float]]
"""The figures of each measurement, by its name."""
T = TypeVar("T")


class Stopwatch:
    """Time spent in calls.

    Attributes:
        seconds: (2,) CPU time and wall-clock time since the last reset, s.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Starts again from zero."""
        self.seconds: Array = np.zeros(2)

    def time(self, call: Callable[[], T]) -> T:
        """Adds the time of a call, and returns its result."""
        start = time.process_time(), time.perf_counter()
        result = call()
        self.seconds += time.process_time() - start[0], time.perf_counter() - start[1]
        return result

    @property
    def cpu_s(self) -> float:
        """CPU time, s."""
        return float(self.seconds[0])

    @property
    def wall_s(self) -> float:
        """Wall-clock time, s."""
        return float(self.seconds[1])


def peak_mib() -> float:
    """Peak of this process's resident memory so far, MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


@dataclass(kw_only=True)
class Replay:
    """A walk replayed back to back; each repetition has later time stamps than the one before.

    Iterating gives the number of the repetition, from 0, and each of its samples.

    Attributes:
        read: Starts the walk's samples from the beginning.
        repetitions: How often the walk is replayed.
        span_ns: From the start of one repetition to the start of the next, ns.
    """

    read: Callable[[], Iterable[Sample]]
    repetitions: int
    span_ns: int
    _first_peak_mib: float = 0.0

    def __iter__(self) -> Iterator[tuple[int, Sample]]:
        for repetition in range(self.repetitions):
            for sample in self.read():
                yield repetition, replace(sample, t_ns=sample.t_ns + repetition * self.span_ns)
            self._first_peak_mib = self._first_peak_mib or peak_mib()

    @property
    def memory_growth_mib(self) -> float:
        """Growth of the memory's peak since the end of the first repetition, MiB."""
        return peak_mib() - self._first_peak_mib


@contextmanager
def recorded(config: TwinConfig, seed: int) -> Iterator[Recording]:
    """A walk, recorded into a temporary file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "walk.mcap"
        record(Twin(config, seed), path, lambda stage, share: None)
        yield Recording(path)
