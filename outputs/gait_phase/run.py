"""Keeps the phases that an estimator gives for one leg over a recording."""

from __future__ import annotations

from typing import Any

import numpy as np

from stridetwin.estimators.gait_phase import PhaseEstimate
from stridetwin.outputs.base import Collector, Output
from stridetwin.outputs.gait_phase.scores import PhaseSeries
from stridetwin.streams.samples import Sample


class PhaseCollector(Collector[PhaseSeries]):
    """Every phase of one leg.

    Args:
        name: Name of the estimator.
        foot: `l` or `r`.
    """

    def __init__(self, name: str, foot: str) -> None:
        self._name, self._foot = name, foot
        self._estimates: list[PhaseEstimate] = []

    def add(self, sample: Sample, estimate: Any) -> None:
        """Keeps an estimate."""
        if estimate is not None:
            self._estimates.append(estimate)

    def outputs(self) -> list[Output[PhaseSeries]]:
        """One output, named after estimator and foot."""
        return [Output(name=f"{self._name}_{self._foot}", estimates=as_series(self._estimates, self._foot))]


def as_series(estimates: list[PhaseEstimate], foot: str) -> PhaseSeries:
    """Estimates of one foot, `l` or `r`, as columns."""
    return PhaseSeries(
        foot=foot,
        t_ns=np.array([e.t_ns for e in estimates], np.int64),
        phase=np.array([e.phase for e in estimates], float),
        phase_sd=np.array([e.phase_sd for e in estimates], float),
        rate=np.array([e.rate for e in estimates], float),
        walking=np.array([e.walking for e in estimates], bool),
        swing=np.array([e.swing for e in estimates], bool),
        touch_down_ns=np.array([e.touch_down_ns for e in estimates], np.int64),
    )
