"""A recorded walk, spoilt anew: faults of samples are those of `sim.faults`; others are done to samples or rig."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from stridetwin.sim.fault_plan import plan_faults
from stridetwin.sim.faults import Fault, arrivals
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Sample

Samples = Iterator[Sample]


@dataclass(frozen=True, kw_only=True)
class Spoilt:
    """One thing that goes wrong.

    Attributes:
        words: What it is.
        faults: Of the samples.
        samples: What else becomes of them.
    """

    words: str
    faults: tuple[Fault, ...] = ()
    samples: Callable[[Samples], Samples] = lambda samples: samples

    def arriving(self, samples: Iterable[Sample], rig: Rig, seed: int, duration_s: float) -> Samples:
        """The samples as they reach the estimator.

        Args:
            samples: Of the walk, in order of time.
            rig: The estimator's.
            seed: Of the walk.
            duration_s: Of the walk.
        """
        planned = plan_faults(self.faults, rig, seed, duration_s)
        return self.samples(_one_by_one(a.item for a in arrivals(samples, planned)))


@dataclass(frozen=True, kw_only=True)
class SpoiltRig(Spoilt):
    """One thing that goes wrong, with the samples or with what is told of the rig.

    Attributes:
        rig: What the estimator is told.
    """

    rig: Callable[[Rig], Rig] = lambda rig: rig


def _one_by_one(items: Iterable[Block[Any] | Sample]) -> Samples:
    for item in items:
        yield from item if isinstance(item, Block) else (item,)
