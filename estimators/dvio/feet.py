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


@dataclass(frozen=True, kw_only=True)
class LegParameters:
    """Velocity from the legs; hand-chosen."""

    speed_sd_mps: float = 0.2
    """Of the camera's speed relative to the trunk, m/s."""
    simultaneous_s: float = 0.06
    """Velocities closer in time count as simultaneous, s."""
    heading_memory_s: float = 10.0
    """Time over which directions of motion are compared, s; an AHRS heading drifts."""
    evidence_min_m2ps: float = 1.0
    """Least product of speeds and time for a heading, m²/s; about a second of walking."""
    agreement_min: float = 0.9
    """Least mean cosine between the directions."""
    velocities: int = 64
    """Number of velocities kept."""


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
        parameters: Of their use.
    """

    def __init__(self, topics: Iterable[str], speeds: Speeds, parameters: LegParameters | None = None) -> None:
        self._parameters = parameters or LegParameters()
        self.topics = frozenset(topics)
        self._speeds = speeds
        self._velocities: deque[LegSpeed] = deque(maxlen=self._parameters.velocities)
        self.reset()

    @classmethod
    def of(cls, exo: Exoskeleton, parameters: LegParameters) -> Feet:
        """For an exoskeleton."""
        return cls(exo.topics, LegSpeeds(exo), parameters)

    def reset(self) -> None:
        """Resets the heading: the odometry's world has a new one from now on."""
        self._rotation, self._weight, self._last_ns = 0j, 0.0, 0

    def take(self, sample: Sample) -> None:
        """Takes a sample of the exoskeleton."""
        if (speed := self._speeds.update(sample)) is not None:
            self._velocities.append(speed)

    def compare(self, t_ns: int, v: Array) -> None:
        """Takes the odometry's velocity (3,), m/s, at a time when it tracked well."""
        leg = self._at(t_ns)
        if leg is None:
            return
        seconds = min((t_ns - self._last_ns) * 1e-9, 0.1)
        keep = np.exp(-seconds / self._parameters.heading_memory_s)
        a, b = complex(*leg.v_back_in_world[:2]), complex(*v[:2])
        self._rotation = keep * self._rotation + seconds * b * a.conjugate()
        self._weight = keep * self._weight + seconds * abs(a) * abs(b)
        self._last_ns = t_ns

    def at(self, t_ns: int) -> LegMeasurement | None:
        """Leg measurement at a time; None if there is none."""
        leg = self._at(t_ns)
        if leg is None:
            return None
        v, p = None, self._parameters
        if self._weight > p.evidence_min_m2ps and abs(self._rotation) > p.agreement_min * self._weight:
            c = self._rotation / abs(self._rotation) * complex(*leg.v_back_in_world[:2])
            v = np.array([c.real, c.imag, leg.v_back_in_world[2]])
        return LegMeasurement(v_in_world=v, resting=leg.resting)

    def _at(self, t_ns: int) -> LegSpeed | None:
        if not self._velocities:
            return None
        leg = min(self._velocities, key=lambda s: abs(s.t_ns - t_ns))
        return leg if abs(leg.t_ns - t_ns) * 1e-9 < self._parameters.simultaneous_s else None
