"""The faults of one walk, ready to be injected: by the recorder, and into a recording that is replayed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Self

from stridetwin.sim.faults.calibration_faults import nominal_rig
from stridetwin.sim.faults.faults import Arrival, Events, Fault, arrivals, plan_faults
from stridetwin.sim.faults.pose_faults import pose_restarts
from stridetwin.streams.pose_restart import PoseRestart
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Sample


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultPlan:
    """All faults of one walk.

    Attributes:
        rig: The nominal calibration with the errors that the faults add to it.
        planned: Each fault with its events by topic.
    """

    rig: Rig
    planned: Sequence[tuple[Fault, Events]]

    @classmethod
    def of(cls, faults: Sequence[Fault], rig: Rig, seed: int, duration_s: float) -> Self:
        """The plan for a walk of `duration_s` with a seed and the nominal calibration without these faults."""
        return cls(rig=nominal_rig(rig, faults), planned=plan_faults(faults, rig, seed, duration_s))

    @property
    def pose_restarts(self) -> list[PoseRestart]:
        """Restarts of the odometry, in time order."""
        return pose_restarts(self.planned)

    def arrivals(self, items: Iterable[Block[Any] | Sample]) -> Iterator[Arrival]:
        """Items that arrive at the recorder, given those that the sensors sent."""
        return arrivals(items, self.planned)

    def samples(self, items: Iterable[Block[Any] | Sample]) -> Iterator[Sample]:
        """Single samples that arrive at an estimator, in order of arrival, given those that the sensors sent."""
        for arrival in self.arrivals(items):
            yield from arrival.item if isinstance(arrival.item, Block) else (arrival.item,)
