"""The contact terrain estimator: samples of the legs in, slope and height of each step out."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

from stridetwin.estimators.base import PROPOSED, STEPS, Declaration, Options, Stream
from stridetwin.estimators.contact_terrain.estimate import StepEstimate, TerrainSvm
from stridetwin.estimators.contact_terrain.geometry import (
    METADATA_KEY,
    Exoskeleton,
    parse_exoskeleton,
    read_exoskeleton,
)
from stridetwin.estimators.contact_terrain.parameters import DEFAULTS, ContactTerrainParameters
from stridetwin.estimators.contact_terrain.proposed import Proposed
from stridetwin.estimators.contact_terrain.published import Published
from stridetwin.estimators.contact_terrain.ticks import TickBuilder
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Ahrs, Encoder, Insole, Sample

METHODS = (PROPOSED, "published")


class ContactTerrain:
    """Estimates slope, elevation and class of each step from an exoskeleton's AHRS, encoders and insoles.

    Causal, of constant memory, deterministic. Samples of all streams come in time order, in any order at one instant;
    samples of other streams, and lost or corrupted ones (`ticks`), are ignored.

    Args:
        rig: Not read: the geometry lists the sensors.
        svm: Classifies the steps of `published`; None leaves their modes unknown.
        options: `method` is one of `METHODS`: `proposed`, or `published`, which is Shim et al. 2019. The geometry is
            read from the file `exoskeleton` or, without one, from the texts `metadata`.
        exoskeleton: Geometry, in place of that of the options.
        parameters: Parameters of sensors, walkers and buildings; one set serves all.

    Raises:
        ConfigError: The method is unknown.
        StrideTwinError: There is no geometry, or it cannot be read.
    """

    declaration: ClassVar[Declaration] = Declaration(
        name="contact_terrain",
        kind=STEPS,
        order=1,
        methods=METHODS,
        budget_s=0.05,
        needs="an exoskeleton's AHRS, encoders and insoles",
    )

    def __init__(
        self,
        rig: Rig,
        *,
        svm: TerrainSvm | None = None,
        options: Options | None = None,
        exoskeleton: Exoskeleton | None = None,
        parameters: ContactTerrainParameters = DEFAULTS,
    ) -> None:
        """Builds the method that the options name, for the given geometry or that of the options."""
        Rig.check(rig, "ContactTerrain")
        options = options or Options()
        method = options.method
        exo = exoskeleton or _load_geometry(options)
        if method not in METHODS:
            raise ConfigError("ContactTerrain", "method", method, " or ".join(METHODS))
        self._ticks = TickBuilder(exo)
        self._method: Proposed | Published = (
            Proposed(exo, parameters) if method == PROPOSED else Published(exo, svm, parameters.published)
        )

    @classmethod
    def streams(cls, rig: Rig, options: Options) -> tuple[Stream, ...]:
        """AHRS, encoders and insoles, as the exoskeleton's geometry names them; `rig` is not read.

        Raises:
            StrideTwinError: There is no geometry, or it cannot be read.
        """
        exo = _load_geometry(options)
        streams = [Stream(role=exo.back.topic, topic=exo.back.topic, kind=Ahrs)]
        for leg in exo.legs.values():
            kinds = {leg.thigh.topic: Ahrs, leg.foot.topic: Ahrs, leg.knee.topic: Encoder, leg.sole.topic: Insole}
            streams += [Stream(role=topic, topic=topic, kind=kind) for topic, kind in kinds.items()]
        return tuple(streams)

    def update(self, sample: Sample) -> StepEstimate | None:
        """Takes one sample; returns the new estimate of the last footprint, or None if nothing changed."""
        estimate = None
        for tick in self._ticks.add(sample):  # none until the streams of an instant are complete; at most two
            estimate = self._method.update(tick) or estimate  # the newest one
        return estimate

    def run(self, samples: Iterable[Sample]) -> list[StepEstimate]:
        """Takes all samples in turn; returns the last estimate of each step, in the order of the steps.

        Step 0, the feet on the ground at the start, is left out.
        """
        last: dict[int, StepEstimate] = {}
        for sample in samples:
            estimate = self.update(sample)
            if estimate is not None and estimate.step > 0:
                last[estimate.step] = estimate
        return [last[step] for step in sorted(last)]


def _load_geometry(options: Options) -> Exoskeleton:
    """The exoskeleton's geometry from the options' file, else from their metadata.

    Raises:
        StrideTwinError: There is none, or it cannot be read.
    """
    if options.exoskeleton is not None:
        return read_exoskeleton(options.exoskeleton)
    if METADATA_KEY not in options.metadata:
        raise StrideTwinError(f"{options.source}: no exoskeleton geometry; pass --exoskeleton FILE")
    return parse_exoskeleton(options.metadata[METADATA_KEY], f"{options.source}: {METADATA_KEY}")
