"""Faults between a sensor and the recorder: each is a generator that passes one topic's samples on and corrupts some.

A fault defines what is corrupted; an `Event` (`sim.faults.plan`) defines when and on which stream. Faults know the
measurement time of every sample, so that one fault may change stamps and the next still finds its events.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Annotated, Any, ClassVar

import numpy as np

from stridetwin.streams.fields import DEG, MM, number, text
from stridetwin.streams.recording.ros_samples import block_of
from stridetwin.streams.samples import (
    Actuator,
    Ahrs,
    Block,
    Depth,
    Encoder,
    Image,
    Imu,
    Insole,
    Interaction,
    Range,
    Sample,
)

NUMBERS = (Imu, Range, Insole, Ahrs, Encoder, Interaction, Actuator)
IMAGES = (Image, Depth)
_LONGEST_S = 36_000


@dataclass(frozen=True, kw_only=True)
class Event:
    """One occurrence of a fault on one stream.

    Attributes:
        kind: Kind of the fault.
        topic: Topic.
        from_ns: First instant.
        until_ns: First instant after the event.
        part: Part name of the sensor.
        entropy: Seed of the walk.
        key: Child stream of this event's own random choices.
    """

    kind: str
    topic: str
    from_ns: int
    until_ns: int
    part: str = ""
    entropy: int = 0
    key: tuple[int, ...] = ()

    def rng(self) -> np.random.Generator:
        """Source of this event's random choices, the same at each call."""
        return np.random.default_rng(np.random.SeedSequence(self.entropy, spawn_key=self.key))


Events = Mapping[str, tuple[Event, ...]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arrival:
    """A sample or block on its way to the recorder.

    Attributes:
        item: A sample, or a block of samples that no fault concerns.
        taken_ns: Measurement time of the sample, whatever its stamp is by now.
        log_ns: Arrival time; (N,) for the samples of a block, None = at their stamps.
    """

    item: Sample | Block[Any]
    taken_ns: int = 0
    log_ns: Any = None

    @property
    def topic(self) -> str:
        """Topic of the item."""
        return self.item.topic

    def but(self, **values: Any) -> Arrival:
        """A copy with other values in its sample."""
        return replace(self, item=replace(self.item, **values))


def arrivals(items: Iterable[Block[Any] | Sample], faults: Iterable[tuple[Fault, Events]]) -> Iterator[Arrival]:
    """Items that arrive at the recorder, given those that the sensors sent.

    Args:
        items: Blocks and samples as the sensors send them.
        faults: Each with its events by topic; they are applied in this order.
    """
    lines: dict[str, list[_Stage]] = {}
    for fault, events in faults:
        for topic in events:
            if not isinstance(fault, LooseStrap):
                lines.setdefault(topic, []).append(_Stage(fault, events[topic]))
    for item in items:
        if item.topic not in lines:
            yield Arrival(item=item)
            continue
        stream: Iterable[Arrival] = _apart(item)
        for stage in lines[item.topic]:
            stream = stage.through(stream)
        yield from _together(stream)
    for line in lines.values():
        stream = ()
        for stage in line:
            stream = stage.last(stream)
        yield from _together(stream)


@dataclass(frozen=True, slots=True)
class _Stage:
    """A fault on one stream, its events there in time order, and its state between samples."""

    fault: Fault
    events: tuple[Event, ...]
    memory: dict[Any, Any] = field(default_factory=dict)

    def through(self, stream: Iterable[Arrival]) -> Iterator[Arrival]:
        """Output for a chunk of the stream."""
        return self.fault.through(stream, self.events, self.memory)

    def last(self, stream: Iterable[Arrival]) -> Iterator[Arrival]:
        """Output for the last chunk."""
        yield from self.through(stream)
        yield from self.fault.left(self.memory)


def _apart(item: Block[Any] | Sample) -> Iterator[Arrival]:
    for sample in item if isinstance(item, Block) else (item,):
        yield Arrival(item=sample, taken_ns=sample.t_ns, log_ns=sample.t_ns)


def _together(stream: Iterable[Arrival]) -> Iterator[Arrival]:
    """Combines samples of one topic to a block, but keeps images one by one."""
    some = list(stream)
    if some and isinstance(some[0].item, IMAGES):
        yield from some
    elif some:
        block = block_of([a.item for a in some if isinstance(a.item, Sample)])
        yield Arrival(item=block, log_ns=np.array([a.log_ns for a in some], np.int64))


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault of some streams, at a given time or at random times.

    Attributes:
        topic: Topic, or a pattern of topics such as `/foot_*/imu`.
        at_s: Start time; None if `rate_per_min` gives the frequency.
        duration_s: Duration; None = to the end of the walk.
        rate_per_min: Mean number of events per minute of walk without the fault, at random times.
        name: Seeds its random times and choices; unique within a walk.
    """

    kind: ClassVar[str]
    fits: ClassVar[tuple[type[Sample], ...]] = NUMBERS + IMAGES
    common_to: ClassVar[str] = "topic"  # or housing, or body: streams that share it share times and choices
    topic: Annotated[str, text()]
    at_s: Annotated[float | None, number(0, _LONGEST_S)] = None
    duration_s: Annotated[float | None, number(0.001, _LONGEST_S)] = None
    rate_per_min: Annotated[float | None, number(0.001, 600)] = None
    name: Annotated[str, text()] = ""

    @property
    def own_name(self) -> str:
        """Its name, or the default name."""
        return self.name or f"{self.kind} {self.topic}"

    def suits(self, sample: type[Sample], part: str) -> bool:
        """Whether it applies to samples of this type from this part."""
        return sample in self.fits

    def through(
        self, stream: Iterable[Arrival], events: tuple[Event, ...], memory: dict[Any, Any]
    ) -> Iterator[Arrival]:
        """Output for a chunk of one topic's stream.

        Args:
            stream: The chunk.
            events: Events of this fault on this topic, in time order.
            memory: State of the fault between chunks.
        """
        for arrival in stream:
            event = at(events, arrival)
            yield from (arrival,) if event is None else self.corrupted(arrival, event)

    def left(self, memory: dict[Any, Any]) -> Iterable[Arrival]:
        """Items still in transit when the stream has ended."""
        return ()

    def corrupted(self, arrival: Arrival, event: Event) -> Iterable[Arrival]:
        """Output for one sample during an event."""
        return (arrival,)


def at(events: tuple[Event, ...], arrival: Arrival) -> Event | None:
    """The event that is active at the measurement time of a sample."""
    i = bisect_right(events, arrival.taken_ns, key=attrgetter("from_ns")) - 1
    return events[i] if i >= 0 and arrival.taken_ns < events[i].until_ns else None


@dataclass(frozen=True, kw_only=True)
class LooseStrap(Fault):
    """A strap that slips: the sensors on it rotate and move on their body, permanently.

    It acts in the twin (`sim.sensors.mount_slip`), not on samples. Sensors on one body that match one pattern hang on
    one strap; an RGB-D camera and its IMU always do.

    Attributes:
        angle_rad: Rotation of one slip, about a random axis.
        shift_m: Translation of one slip, in a random direction.
    """

    kind = "loose_strap"
    common_to = "body"
    fits = (Imu, Image, Depth, Ahrs, Range)
    angle_rad: Annotated[float, number(0, 90, key="angle_deg", scale=DEG)] = math.radians(10)
    shift_m: Annotated[float, number(0, 100, key="shift_mm", scale=MM)] = 0.01
