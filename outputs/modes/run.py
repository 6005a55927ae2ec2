"""Keeps the predictions that an estimator of modes gives for a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from stridetwin.estimators.locomotion_mode import ModeEstimate
from stridetwin.outputs.aligned_walk import AlignedWalk
from stridetwin.outputs.base import Collector, Output
from stridetwin.streams.samples import Sample


@dataclass(frozen=True, kw_only=True, eq=False)
class ModeRun:
    """All predictions of one estimator in time order, and the walk beside the truth; None without a truth."""

    estimates: list[ModeEstimate]
    walk: AlignedWalk | None = None


class ModeCollector(Collector[ModeRun]):
    """Every prediction, in time order."""

    def __init__(self, name: str, walk: AlignedWalk | None) -> None:
        self._name, self._walk = name, walk
        self._estimates: list[ModeEstimate] = []

    def add(self, sample: Sample, estimate: Any) -> None:
        """Keeps a prediction."""
        if estimate is not None:
            self._estimates.append(estimate)

    def outputs(self) -> list[Output[ModeRun]]:
        """The predictions."""
        return [Output(name=self._name, estimates=ModeRun(estimates=self._estimates, walk=self._walk))]
