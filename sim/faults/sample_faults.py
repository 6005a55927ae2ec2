"""Faults of any stream and its values: lost, late, repeated, exchanged, frozen, NaN and clipped samples."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from typing import Annotated

import numpy as np

from stridetwin.sim.faults.faults import NUMBERS, Arrival, Event, EventsOfTopic, Memory, Stream, StreamFault, at
from stridetwin.sim.parts.library import full_scales
from stridetwin.streams.fields import DEG, flag, number, words
from stridetwin.streams.samples import Array, Imu, Insole, Interaction

RateRange = Annotated[float | None, number(0.1, 10_000, key="gyroscope_deg_s", scale=DEG)]
ForceRange = Annotated[float | None, number(0.1, 10_000)]
CELLS = ("heel", "lateral_ball", "medial_ball", "toe")


@dataclass(frozen=True, kw_only=True)
class Dropout(StreamFault):
    """Samples that never arrive."""

    kind = "dropout"

    def corrupted(self, arrival: Arrival, event: Event) -> Iterable[Arrival]:
        """Nothing."""
        return ()


@dataclass(frozen=True, kw_only=True)
class Loss(StreamFault):
    """Single samples that never arrive, at random; colour and depth of one frame are lost together.

    Attributes:
        share: Lost share of the samples.
    """

    kind = "loss"
    common_to = "housing"
    share: Annotated[float, number(0.001, 1)] = 0.1

    def corrupted(self, arrival: Arrival, event: Event) -> Iterable[Arrival]:
        """The sample, or nothing."""
        return () if event.rng(arrival.taken_ns).random() < self.share else (arrival,)


@dataclass(frozen=True, kw_only=True)
class Exchange(StreamFault):
    """Samples that arrive under the topic of the other side, as if left and right were exchanged."""

    kind = "exchange"

    def suits(self, stream: Stream) -> bool:
        """Whether the stream belongs to a side."""
        return stream.kind in self.fits and _other_side(stream.topic) != stream.topic

    def corrupted(self, arrival: Arrival, event: Event) -> Iterable[Arrival]:
        """The sample under the other topic."""
        return (arrival.but(topic=_other_side(arrival.topic)),)


def _other_side(topic: str) -> str:
    return re.sub("_([lr])(?=/)", lambda side: "_r" if side[1] == "l" else "_l", topic)


@dataclass(frozen=True, kw_only=True)
class Freeze(StreamFault):
    """Repeats the last value before the event, with new stamps."""

    kind = "freeze"

    def through(self, stream: Iterable[Arrival], events: EventsOfTopic, memory: Memory) -> Iterator[Arrival]:
        """As `StreamFault.through`; a stream that begins frozen repeats its first value."""
        for arrival in stream:
            if at(events, arrival) is None:
                memory["last"] = arrival.item
                yield arrival
            else:
                held = memory.setdefault("last", arrival.item)
                yield replace(arrival, item=replace(held, t_ns=arrival.item.t_ns))


@dataclass(frozen=True, kw_only=True)
class Repeat(StreamFault):
    """Each sample twice, with the same stamp."""

    kind = "repeat"

    def corrupted(self, arrival: Arrival, event: Event) -> Iterable[Arrival]:
        """The sample, twice."""
        return arrival, arrival


@dataclass(frozen=True, kw_only=True)
class Nan(StreamFault):
    """NaN values."""

    kind = "nan"
    fits = NUMBERS

    def corrupted(self, arrival: Arrival, event: Event) -> Iterable[Arrival]:
        """The sample with NaN for every value."""
        values = {f.name: getattr(arrival.item, f.name) for f in fields(arrival.item)[2:]}
        return (arrival.but(**{k: np.full_like(v, np.nan, float)[()] for k, v in values.items()}),)


@dataclass(frozen=True, kw_only=True)
class Late(StreamFault):
    """Samples that arrive late but in order; those measured after the event wait for them.

    Attributes:
        delay_s: Delay.
    """

    kind = "late"
    delay_s: Annotated[float, number(0.001, 60)] = 0.25

    def through(self, stream: Iterable[Arrival], events: EventsOfTopic, memory: Memory) -> Iterator[Arrival]:
        """As `StreamFault.through`: stamps do not change, arrival times do."""
        for arrival in stream:
            late = 0 if at(events, arrival) is None else round(self.delay_s * 1e9)
            memory["free"] = log_ns = max(arrival.log_ns + late, memory.get("free", 0))
            yield arrival if log_ns == arrival.log_ns else replace(arrival, log_ns=log_ns)


@dataclass(frozen=True, kw_only=True)
class OutOfOrder(StreamFault):
    """Samples that arrive out of order: of every two, the later arrives first."""

    kind = "out_of_order"

    def through(self, stream: Iterable[Arrival], events: EventsOfTopic, memory: Memory) -> Iterator[Arrival]:
        """As `StreamFault.through`; an overtaken sample arrives together with the one that overtook it."""
        for arrival in stream:
            overtaken = memory.pop("held", None)
            if overtaken is not None:
                yield arrival
                yield replace(overtaken, log_ns=arrival.log_ns)
            elif at(events, arrival) is not None:
                memory["held"] = arrival
            else:
                yield arrival

    def left(self, memory: Memory) -> Iterable[Arrival]:
        """A sample that was never overtaken."""
        return tuple(memory.values())


@dataclass(frozen=True, kw_only=True)
class ClockJump(StreamFault):
    """A sensor clock with an offset during the event; arrival times are unaffected.

    Attributes:
        jump_s: Offset of its stamps (negative: behind).
    """

    kind = "clock_jump"
    jump_s: Annotated[float, number(-3600, 3600)]

    def corrupted(self, arrival: Arrival, event: Event) -> Iterable[Arrival]:
        """The sample with an offset in its stamp."""
        return (arrival.but(t_ns=arrival.item.t_ns + round(self.jump_s * 1e9)),)


@dataclass(frozen=True, kw_only=True)
class Saturation(StreamFault):
    """A range that is smaller than the part's; the calibration does not say so (`NominalRange` does).

    Attributes:
        fraction: Clipping level, as a share of the part's full scale, where no other level is given.
        gyroscope_rad_s: Clipping level of an IMU's rates; with it or the next one, only what they name is clipped.
        accelerometer_mps2: Clipping level of an IMU's specific force.
    """

    kind = "saturation"
    fits = (Imu, Insole, Interaction)
    fraction: Annotated[float, number(0.001, 1)] = 0.5
    gyroscope_rad_s: RateRange = None
    accelerometer_mps2: ForceRange = None

    def suits(self, stream: Stream) -> bool:
        """Whether the full scale of the part is known, or the levels are those of an IMU."""
        return stream.kind in self.fits and (stream.kind is Imu if self._levels else bool(full_scales(stream.part)))

    @property
    def _levels(self) -> dict[str, float]:
        levels = {"angular_rate": self.gyroscope_rad_s, "specific_force": self.accelerometer_mps2}
        return {name: level for name, level in levels.items() if level is not None}

    def corrupted(self, arrival: Arrival, event: Event) -> Iterable[Arrival]:
        """The sample with clipped values."""
        limits = self._levels or {name: self.fraction * scale for name, scale in full_scales(event.part).items()}
        return (arrival.but(**{n: np.clip(getattr(arrival.item, n), -m, m) for n, m in limits.items()}),)


@dataclass(frozen=True, kw_only=True)
class DeadCell(StreamFault):
    """One cell of an insole that no longer measures its load, or all cells.

    Attributes:
        cell: One of `CELLS`, or `all`.
        stuck: Whether it keeps its value from the start of the event; otherwise it reads 0.
    """

    kind = "dead_cell"
    fits = (Insole,)
    cell: Annotated[str, words((*CELLS, "all"))] = "heel"
    stuck: Annotated[bool, flag()] = False

    def through(self, stream: Iterable[Arrival], events: EventsOfTopic, memory: Memory) -> Iterator[Arrival]:
        """As `StreamFault.through`."""
        cells = [*range(len(CELLS))] if self.cell == "all" else [CELLS.index(self.cell)]
        for arrival in stream:
            event = at(events, arrival)
            if event is not None and isinstance(arrival.item, Insole):
                force: Array = arrival.item.force.copy()
                force[cells] = memory.setdefault(event, force[cells]) if self.stuck else 0.0
                arrival = arrival.but(force=force)
            yield arrival
