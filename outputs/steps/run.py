"""Keeps the steps that an estimator gives for a recording."""

from __future__ import annotations

from typing import Any

from stridetwin.estimators.contact_terrain import StepEstimate
from stridetwin.outputs.base import Collector, Output
from stridetwin.streams.samples import Sample


class StepCollector(Collector[list[StepEstimate]]):
    """The last estimate of each step; step 0, at which the person stands, is left out."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._last: dict[int, StepEstimate] = {}

    def add(self, sample: Sample, estimate: Any) -> None:
        """Replaces the earlier estimate of a step."""
        if estimate is not None and estimate.step > 0:
            self._last[estimate.step] = estimate

    def outputs(self) -> list[Output[list[StepEstimate]]]:
        """The steps, in order."""
        return [Output(name=self._name, estimates=[self._last[step] for step in sorted(self._last)])]
