"""Slope and step height from the legs as an estimator: samples in, steps out."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from stridetwin.estimators.contact_terrain.classes import TerrainSvm
from stridetwin.estimators.contact_terrain.estimate import StepEstimate
from stridetwin.estimators.contact_terrain.geometry import Exoskeleton
from stridetwin.estimators.contact_terrain.parameters import DEFAULTS, ContactTerrainParameters
from stridetwin.estimators.contact_terrain.proposed import Proposed
from stridetwin.estimators.contact_terrain.published import Published
from stridetwin.estimators.contact_terrain.ticks import Gather, Tick
from stridetwin.estimators.methods import PROPOSED, current_name
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Sample

METHODS = (PROPOSED, "published")


class _Method(Protocol):
    def update(self, tick: Tick) -> StepEstimate | None: ...


class ContactTerrain:
    """From an exoskeleton's AHRS, encoders and insoles: slope, elevation and class of each step.

    Causal, of constant memory, deterministic. Samples of all streams come in time order, in any order at one instant;
    samples of other streams, and those that are lost or spoilt (`ticks`), are passed over.

    Args:
        exo: Geometry; `read_exoskeleton`.
        method: `proposed` or `published`, Shim et al. 2019.
        svm: Classes for `published`; None leaves them unknown.
        parameters: Of sensors, walkers and buildings; one set serves all.

    Raises:
        ConfigError: There is no such method.
    """

    def __init__(
        self,
        exo: Exoskeleton,
        method: str = PROPOSED,
        svm: TerrainSvm | None = None,
        parameters: ContactTerrainParameters = DEFAULTS,
    ) -> None:
        method = current_name(method)
        if method not in METHODS:
            raise ConfigError("ContactTerrain", "method", method, " or ".join(METHODS))
        self._gather = Gather(exo, parameters.ticks)
        self._method: _Method = (
            Proposed(exo, parameters) if method == PROPOSED else Published(exo, svm, parameters.published)
        )

    def update(self, sample: Sample) -> StepEstimate | None:
        """Takes one sample; returns what is now known of the last footprint, None where nothing new is."""
        told = None
        for tick in self._gather.add(sample):
            told = self._method.update(tick) or told
        return told

    def run(self, samples: Iterable[Sample]) -> list[StepEstimate]:
        """Takes samples as `update` would; returns the last estimate of each step, in order, step 0 left out."""
        last: dict[int, StepEstimate] = {}
        for sample in samples:
            estimate = self.update(sample)
            if estimate is not None and estimate.step > 0:
                last[estimate.step] = estimate
        return [last[step] for step in sorted(last)]
