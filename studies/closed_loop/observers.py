"""Observations of a controller of the exoskeleton: sensor streams or estimates."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

import numpy as np

from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Actuator, Ahrs, Array, Encoder, Insole, Interaction, Sample


class Observer(Protocol):
    """From samples to observations; it knows the nominal rig and no truth."""

    def reset(self) -> None:
        """Starts a walk."""
        ...

    def update(self, samples: Iterable[Sample]) -> None:
        """Processes the samples that arrived, in time order."""
        ...

    def observation(self) -> dict[str, Array]:
        """Arrays by name, always of the same names and shapes."""
        ...


class Streams:
    """The latest value of each sensor of the exoskeleton, NaN before the first sample.

    By topic, without the leading slash: encoders (1,) rad; insoles (4,) N; AHRS (7,) quaternion and rad/s; interaction
    (2,) N; actuators (3,) torque command and torque, N m, and speed, rad/s.

    Args:
        rig: The sensors.
    """

    def __init__(self, rig: Rig) -> None:
        size = {"encoder": 1, "insole": 4, "ahrs": 7, "interaction": 2, "actuator": 3}
        self._size = {topic: size[s.kind] for topic, s in rig.others.items() if s.kind in size}
        Streams.reset(self)

    def reset(self) -> None:
        """As `Observer`."""
        self._latest = {topic: np.full(n, np.nan) for topic, n in self._size.items()}

    def update(self, samples: Iterable[Sample]) -> None:
        """As `Observer`."""
        for sample in samples:
            if sample.topic in self._latest:
                self._latest[sample.topic] = _value(sample)

    def observation(self) -> dict[str, Array]:
        """As `Observer`."""
        return {topic.lstrip("/"): value.copy() for topic, value in self._latest.items()}


def _value(sample: Sample) -> Array:
    match sample:
        case Encoder():
            return np.array([sample.angle])
        case Insole() | Interaction():
            return np.asarray(sample.force, float)
        case Ahrs():
            return np.concatenate([sample.q_world_sensor, sample.angular_rate])
        case Actuator():
            return np.array([sample.torque_command, sample.torque, sample.speed])
    raise TypeError(f"{sample.topic} has no value to observe")
