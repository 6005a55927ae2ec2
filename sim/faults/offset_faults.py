"""Values that are off by an offset that may grow: insoles, joint encoders, and headings of AHRSs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.sim.faults.faults import Arrival, Event, StreamFault
from stridetwin.streams.fields import DEG, number
from stridetwin.streams.samples import Ahrs, Encoder, Insole


def _seconds_since(arrival: Arrival, event: Event) -> float:
    return 1e-9 * (arrival.taken_ns - event.from_ns)


@dataclass(frozen=True, kw_only=True)
class InsoleOffset(StreamFault):
    """Cells of an insole whose zero is off, and drifts.

    Attributes:
        offset_n: Offset of every cell when the event begins.
        drift_n_per_s: Its change.
        max_offset_n: Largest magnitude that it reaches.
    """

    kind = "insole_offset"
    fits = (Insole,)
    offset_n: Annotated[float, number(-1000, 1000)] = 0.0
    drift_n_per_s: Annotated[float, number(-1000, 1000)] = 0.0
    max_offset_n: Annotated[float, number(0, 1000)] = 1000.0

    def corrupted(self, arrival: Arrival, event: Event) -> Iterable[Arrival]:
        """The sample with the offset in each cell; forces may be negative."""
        assert isinstance(arrival.item, Insole)
        offset_n = self.offset_n + self.drift_n_per_s * _seconds_since(arrival, event)
        return (arrival.but(force=arrival.item.force + np.clip(offset_n, -self.max_offset_n, self.max_offset_n)),)


@dataclass(frozen=True, kw_only=True)
class EncoderOffset(StreamFault):
    """A joint encoder whose zero is off: from the start, or since its shaft slipped.

    Attributes:
        offset_rad: Offset of the angle, flexion positive.
    """

    kind = "encoder_offset"
    fits = (Encoder,)
    offset_rad: Annotated[float, number(-180, 180, key="offset_deg", scale=DEG)]

    def corrupted(self, arrival: Arrival, event: Event) -> Iterable[Arrival]:
        """The sample with the offset."""
        assert isinstance(arrival.item, Encoder)
        return (arrival.but(angle=arrival.item.angle + self.offset_rad),)


@dataclass(frozen=True, kw_only=True)
class YawDrift(StreamFault):
    """An AHRS whose heading drifts about the vertical; its tilt and rates stay right.

    Attributes:
        rate_rad_s: Drift of the heading, to the left positive.
    """

    kind = "yaw_drift"
    fits = (Ahrs,)
    rate_rad_s: Annotated[float, number(-3600, 3600, key="rate_deg_per_min", scale=DEG / 60)]

    def corrupted(self, arrival: Arrival, event: Event) -> Iterable[Arrival]:
        """The sample with the wrong heading."""
        assert isinstance(arrival.item, Ahrs)
        yaw = Rotation.from_rotvec([0.0, 0.0, self.rate_rad_s * _seconds_since(arrival, event)])
        q = yaw * Rotation.from_quat(arrival.item.q_world_sensor, scalar_first=True)
        return (arrival.but(q_world_sensor=q.as_quat(scalar_first=True)),)
