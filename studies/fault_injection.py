"""Fault studies: a recorded walk is replayed once per fault; one table with a line per fault.

A study lists its faults (`FAULTS`) and the columns of its table. Sample faults are those of `sim.faults.faults`;
other faults change samples, the calibration that the estimator reads, or the walk itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.sim.config import TwinConfig
from stridetwin.sim.faults.faults import Fault, arrivals, plan_faults
from stridetwin.streams.rig import Mount, Rig
from stridetwin.streams.samples import Array, Block, Sample
from stridetwin.studies.tables import Column, table_lines

Samples = Iterator[Sample]
SampleType = type[Sample] | tuple[type[Sample], ...]


@dataclass(frozen=True, kw_only=True)
class InjectedFault:
    """One fault of a study.

    Attributes:
        words: Its line of the table.
        faults: Sample faults of the twin.
        samples: Changes the samples further.
        calibration: Changes what the estimator reads as calibration: the rig, or the exoskeleton's geometry.
        walk: Changes the walk; one that differs is simulated on its own.
    """

    words: str
    faults: tuple[Fault, ...] = ()
    samples: Callable[[Samples], Samples] = lambda samples: samples
    calibration: Callable[[Any], Any] = lambda calibration: calibration
    walk: Callable[[TwinConfig], TwinConfig] = lambda config: config

    def inject(self, samples: Iterable[Sample], rig: Rig, seed: int, duration_s: float) -> Samples:
        """The samples of a walk, in time order, as they reach the estimator with this rig."""
        planned = plan_faults(self.faults, rig, seed, duration_s)
        return self.samples(_one_by_one(a.item for a in arrivals(samples, planned)))


def _one_by_one(items: Iterable[Block[Any] | Sample]) -> Samples:
    for item in items:
        yield from item if isinstance(item, Block) else (item,)


def changed(change: Callable[[Any], Sample], *, kinds: SampleType, topic: str = "") -> Callable[[Samples], Samples]:
    """A fault that changes the samples of some kinds, of one topic where one is given, and passes on all others."""

    def inject(samples: Samples) -> Samples:
        for s in samples:
            yield change(s) if isinstance(s, kinds) and topic in ("", s.topic) else s

    return inject


def camera_offset(
    rotvec_deg: Sequence[float], translation_m: Sequence[float] = (0.0, 0.0, 0.0)
) -> Callable[[Rig], Rig]:
    """A calibration error of the cameras' mounts: rotation vector and translation, in the camera's frame."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rotvec_deg, degrees=True).as_matrix()
    T[:3, 3] = translation_m

    def calibration(rig: Rig) -> Rig:
        mounts = {t: Mount(body=c.mount.body, T_body_sensor=c.mount.T_body_sensor @ T) for t, c in rig.cameras.items()}
        return replace(rig, cameras={t: replace(c, mount=mounts[t]) for t, c in rig.cameras.items()})

    return calibration


def imu_range(**ranges: Any) -> Callable[[Rig], Rig]:
    """The IMUs' ranges (`gyroscope_range`, `accelerometer_range`) in the calibration."""
    return lambda rig: replace(rig, imus={t: replace(c, **ranges) for t, c in rig.imus.items()})


def clip(values: Array, limit: float) -> Array:
    """Values limited to ± `limit`."""
    return np.clip(values, -limit, limit)


def by_fault(
    faults: Iterable[str], results: Sequence[Mapping[str, Any]], figures: Callable[[list[Any]], dict[str, Any]]
) -> dict[str, Any]:
    """`summary` and `paper` of a study: the figures of each fault over the rows of all cases; no paper has faults."""
    return {"summary": {name: figures([r["faults"][name] for r in results]) for name in faults}, "paper": {}}


def fault_table(
    faults: Mapping[str, str], summary: Mapping[str, Mapping[str, Any]], columns: Sequence[Column], width: int
) -> list[str]:
    """Lines of text from the description of each fault and the summary of `by_fault`: one line per fault."""
    return table_lines(columns, [(words, summary[name]) for name, words in faults.items()], width)
