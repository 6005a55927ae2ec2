"""Velocity of a worn camera from the feet on the ground: noisy but free of drift."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from stridetwin.estimators.contact_terrain.geometry import Exoskeleton
from stridetwin.estimators.contact_terrain.speed import LegSpeed, LegSpeeds
from stridetwin.streams.samples import Array, Sample

_NEAR_S = 0.06  # velocities closer in time count as simultaneous
_MEMORY_S = 10.0  # span over which headings are compared; an AHRS heading drifts
_ENOUGH = 1.0  # m²/s; about a second of walking
_ALIKE = 0.9  # mean cosine between the two directions
_KEPT = 64


@dataclass(frozen=True, kw_only=True, eq=False)
class LegMeasurement:
    """Leg measurement at one time.

    Attributes:
        v_in_world: (3,) m/s, of the trunk in the odometry's world; None while the heading is unknown there.
        resting: Whether both feet are stationary on the ground.
    """

    v_in_world: Array | None
    resting: bool


class Speeds(Protocol):
    """Computes velocities from samples."""

    def update(self, sample: Sample) -> LegSpeed | None:
        """Takes samples in time order; returns None if there is no new velocity."""


class Feet:
    """Velocities from the legs, rotated into the odometry's world.

    The AHRS have their own heading. It is estimated by comparing directions of motion while the odometry tracks well.

    Args:
        topics: Input streams.
        speeds: Computes velocities from their samples.
    """

    def __init__(self, topics: Iterable[str], speeds: Speeds) -> None:
        self.topics = frozenset(topics)
        self._speeds = speeds
        self._speeds_kept: deque[LegSpeed] = deque(maxlen=_KEPT)
        self.reset()

    @classmethod
    def of(cls, exo: Exoskeleton) -> Feet:
        """For an exoskeleton."""
        return cls(exo.topics, LegSpeeds(exo))

    def reset(self) -> None:
        """Resets the heading: the odometry's world has a new one from now on."""
        self._turn, self._weight, self._last_ns = 0j, 0.0, 0

    def take(self, sample: Sample) -> None:
        """Takes a sample of the exoskeleton."""
        if (speed := self._speeds.update(sample)) is not None:
            self._speeds_kept.append(speed)

    def compare(self, t_ns: int, v: Array) -> None:
        """Takes the odometry's velocity (3,), m/s, at a time when it tracked well."""
        leg = self._at(t_ns)
        if leg is None:
            return
        seconds = min((t_ns - self._last_ns) * 1e-9, 0.1)
        keep = np.exp(-seconds / _MEMORY_S)
        a, b = complex(*leg.v_back_in_world[:2]), complex(*v[:2])
        self._turn = keep * self._turn + seconds * b * a.conjugate()
        self._weight = keep * self._weight + seconds * abs(a) * abs(b)
        self._last_ns = t_ns

    def at(self, t_ns: int) -> LegMeasurement | None:
        """Leg measurement at a time; None if there is none."""
        leg = self._at(t_ns)
        if leg is None:
            return None
        v = None
        if self._weight > _ENOUGH and abs(self._turn) > _ALIKE * self._weight:
            c = self._turn / abs(self._turn) * complex(*leg.v_back_in_world[:2])
            v = np.array([c.real, c.imag, leg.v_back_in_world[2]])
        return LegMeasurement(v_in_world=v, resting=leg.resting)

    def _at(self, t_ns: int) -> LegSpeed | None:
        if not self._speeds_kept:
            return None
        leg = min(self._speeds_kept, key=lambda s: abs(s.t_ns - t_ns))
        return leg if abs(leg.t_ns - t_ns) * 1e-9 < _NEAR_S else None
