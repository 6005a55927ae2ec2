"""Faults between a sensor and the recorder: each is a generator that passes one topic's samples on and corrupts some.

A fault defines what is corrupted; an `Event` defines when and on which stream (`plan_faults`): all events of a walk are
fixed by the seed before the first sample. Faults know the measurement time of every sample, so that one fault may
change stamps and the next still finds its events.
"""

from __future__ import annotations

import math
import re
import zlib
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from operator import attrgetter
from typing import Annotated, Any, ClassVar, Self

import numpy as np

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.fields import DEG, MM, float_field, text_field
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, OtherSensor, Rig
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
    Odometry,
    Range,
    Sample,
)

NUMBERS = (Imu, Range, Insole, Ahrs, Encoder, Interaction, Actuator)
IMAGES = (Image, Depth)
POSES = "/poses"
"""Stream of an odometry's poses on their way to estimators of terrain and modes; `estimators.base.POSES`."""
Calibration = ImuCalibration | CameraCalibration | OtherSensor
_LONGEST_S = 36_000


@dataclass(frozen=True, kw_only=True)
class Event:
    """One occurrence of a fault of some kind on one stream.

    Attributes:
        from_ns, until_ns: First instant, and first instant after the event.
        part: Part name of the sensor.
        entropy, key: Seed of the walk, and child stream of this event's own random choices.
        rig: The nominal calibration.
    """

    kind: str
    topic: str
    from_ns: int
    until_ns: int
    part: str = ""
    entropy: int = 0
    key: tuple[int, ...] = ()
    rig: Rig = field(default_factory=Rig, compare=False, repr=False)

    def rng(self, *instant_ns: int) -> np.random.Generator:
        """Source of this event's random choices, or of those at one instant; the same at each call."""
        return np.random.default_rng(np.random.SeedSequence(self.entropy, spawn_key=(*self.key, *instant_ns)))


EventsOfTopic = tuple[Event, ...]
"""Events of one fault on one topic, in time order."""
Events = Mapping[str, EventsOfTopic]
Memory = dict[Any, Any]
"""State of a fault on one topic between chunks."""


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
    """Items that arrive at the recorder, given those that the sensors sent; faults are applied in their order."""
    lines: dict[str, list[tuple[Fault, EventsOfTopic, Memory]]] = {}
    truth_readers: dict[str, list[Memory]] = {}
    for fault, events in faults:
        for topic, own in events.items() if fault.on_samples else ():
            memory: Memory = {}
            lines.setdefault(topic, []).append((fault, own, memory))
            truth_readers.setdefault(fault.truth_topic(own[0]), []).append(memory)
    for item in items:
        for memory in truth_readers.get(item.topic, ()):
            memory.setdefault("truth", []).extend(item if isinstance(item, Block) else [item])
        if item.topic not in lines:
            yield Arrival(item=item)
            continue
        stream: Iterable[Arrival] = _apart(item)
        for fault, own, memory in lines[item.topic]:
            stream = fault.through(stream, own, memory)
        yield from _together(stream)
    for line in lines.values():
        stream = ()
        for fault, own, memory in line:
            stream = _last(stream, fault, own, memory)
        yield from _together(stream)


def _last(stream: Iterable[Arrival], fault: Fault, events: EventsOfTopic, memory: Memory) -> Iterator[Arrival]:
    """Output of a fault for the last chunk of a stream."""
    yield from fault.through(stream, events, memory)
    yield from fault.left(memory)


def _apart(item: Block[Any] | Sample) -> Iterator[Arrival]:
    for sample in item if isinstance(item, Block) else (item,):
        yield Arrival(item=sample, taken_ns=sample.t_ns, log_ns=sample.t_ns)


def _together(stream: Iterable[Arrival]) -> Iterator[Arrival]:
    """Combines samples of one topic to a block, but keeps images one by one."""
    some = list(stream)
    if some and isinstance(some[0].item, IMAGES):
        yield from some
    elif some:
        # imported late, so that a scenario is read without it
        from stridetwin.streams.recording.ros_samples import block_of

        block = block_of([a.item for a in some if isinstance(a.item, Sample)])
        yield Arrival(item=block, log_ns=np.array([a.log_ns for a in some], np.int64))


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault of some sensors, for the whole walk.

    Attributes:
        topic: Topic, or a pattern of topics such as `/foot_*/imu`.
        name: Seeds its random times and choices; unique within a walk.
    """

    kind: ClassVar[str]  # in files: the name of the class, as in loose_strap
    fits: ClassVar[tuple[type[Sample], ...]] = NUMBERS + IMAGES
    on_samples: ClassVar[bool] = True  # otherwise it acts elsewhere
    common_to: ClassVar[str] = "topic"  # or housing, or body: streams that share it share times and choices
    topic: Annotated[str, text_field()]
    name: Annotated[str, text_field()] = ""

    def __init_subclass__(cls) -> None:
        cls.kind = re.sub("(?<=[a-z])(?=[A-Z])", "_", cls.__name__).lower()

    @property
    def own_name(self) -> str:
        """Its name, or the default name."""
        return self.name or f"{self.kind} {self.topic}"

    def suits(self, stream: Stream) -> bool:
        """Whether it applies to a stream, if its topic matches."""
        return stream.kind in self.fits

    def calibrate(self, sensor: Calibration) -> Calibration:
        """The nominal calibration of one of its sensors, given the one without this fault."""
        return sensor

    def truth_topic(self, event: Event) -> str:
        """Stream of the truth that it needs, which `arrivals` collects in its memory under `truth`; "" for none."""
        return ""

    def through(self, stream: Iterable[Arrival], events: EventsOfTopic, memory: Memory) -> Iterator[Arrival]:
        """Output for a chunk of one topic's stream."""
        for arrival in stream:
            event = at(events, arrival)
            yield from (arrival,) if event is None else self.corrupted(arrival, event)

    def left(self, memory: Memory) -> Iterable[Arrival]:
        """Items still in transit when the stream has ended."""
        return ()

    def corrupted(self, arrival: Arrival, event: Event) -> Iterable[Arrival]:
        """Output for one sample during an event."""
        return (arrival,)


@dataclass(frozen=True, kw_only=True)
class TimedFault(Fault):
    """A fault at a given time or at random times.

    Attributes:
        at_s: Start time; None if `rate_per_min` gives the frequency.
        duration_s: Duration; None = to the end of the walk.
        rate_per_min: Mean number of events per minute of walk without the fault, at random times.
    """

    at_s: Annotated[float | None, float_field(0, _LONGEST_S)] = None
    duration_s: Annotated[float | None, float_field(0.001, _LONGEST_S)] = None
    rate_per_min: Annotated[float | None, float_field(0.001, 600)] = None


def at(events: EventsOfTopic, arrival: Arrival) -> Event | None:
    """The event that is active at the measurement time of a sample."""
    i = bisect_right(events, arrival.taken_ns, key=attrgetter("from_ns")) - 1
    return events[i] if i >= 0 and arrival.taken_ns < events[i].until_ns else None


@dataclass(frozen=True, kw_only=True)
class LooseStrap(TimedFault):
    """A strap that slips: the sensors on it rotate and move on their body, permanently.

    It acts in the twin (`sim.sensors.mount_slip`), not on samples. Sensors on one body that match one pattern hang on
    one strap; an RGB-D camera and its IMU always do.

    Attributes:
        angle_rad: Rotation of one slip, about a random axis.
        shift_m: Translation of one slip, in a random direction.
    """

    common_to = "body"
    on_samples = False
    fits = (Imu, Image, Depth, Ahrs, Range)
    angle_rad: Annotated[float, float_field(0, 90, key="angle_deg", scale=DEG)] = math.radians(10)
    shift_m: Annotated[float, float_field(0, 100, key="shift_mm", scale=MM)] = 0.01


_OTHERS: dict[str, type[Sample]] = {
    "range": Range, "insole": Insole, "ahrs": Ahrs, "encoder": Encoder, "interaction": Interaction,
    "actuator": Actuator,
}  # fmt: skip
_FAULTS = zlib.crc32(b"faults")  # separates their child streams from the sensors' noise


@dataclass(frozen=True, kw_only=True)
class Stream:
    """A stream of a rig, the part that sends it, and the body that carries it; streams of one case share `housing`."""

    topic: str
    kind: type[Sample]
    part: str
    body: str
    housing: str


def _streams(rig: Rig) -> Iterator[Stream]:
    case = {c.imu_topic: c.topic for c in rig.cameras.values() if c.depth_topic}
    case |= {t.replace("/ahrs", "/imu"): t for t, other in rig.others.items() if other.kind == "ahrs"}
    for t, c in rig.imus.items():
        yield Stream(topic=t, kind=Imu, part=c.part, body=c.mount.body, housing=case.get(t, t))
    for t, camera in rig.cameras.items():
        yield Stream(topic=t, kind=Image, part=camera.part, body=camera.mount.body, housing=t)
        if camera.depth_topic:
            yield Stream(topic=camera.depth_topic, kind=Depth, part=camera.part, body=camera.mount.body, housing=t)
    for t, other in rig.others.items():
        yield Stream(topic=t, kind=_OTHERS[other.kind], part=other.part, body=other.mount.body, housing=t)
    for camera in [c for c in rig.cameras.values() if c.depth_topic][:1]:
        yield Stream(topic=POSES, kind=Odometry, part="", body=camera.mount.body, housing=POSES)


def _affected(fault: Fault, rig: Rig) -> list[Stream]:
    streams = [s for s in _streams(rig) if fault.suits(s)]
    named = [s for s in streams if fnmatchcase(s.topic, fault.topic)]
    if isinstance(fault, LooseStrap):
        cases = {s.housing for s in named}
        return [s for s in streams if s.housing in cases]
    return named


def check_faults(source: object, faults: Sequence[Fault], rig: Rig) -> None:
    """Rejects faults of the file `source` that match no stream of the rig that they can act on, or that share a name.

    Raises:
        ConfigError: Names the fault, the invalid value and what is expected.
    """
    names: list[str] = []
    for i, fault in enumerate(faults):
        if not _affected(fault, rig):
            valid = ", ".join(sorted(s.topic for s in _streams(rig) if fault.suits(s)))
            raise ConfigError(source, f"faults[{i}].topic", fault.topic, f"{valid or 'none here'} ({fault.kind}), or *")
        if fault.own_name in names:
            raise ConfigError(source, f"faults[{i}].name", fault.own_name, "a name of its own for each fault")
        names.append(fault.own_name)


def check_times(source: object, faults: Sequence[Fault], duration_s: float) -> None:
    """Rejects faults that begin after the end of a walk of `duration_s`.

    Raises:
        ConfigError: Names the fault, its time and the length of the walk.
    """
    for i, fault in enumerate(faults):
        if isinstance(fault, TimedFault) and fault.at_s is not None and fault.at_s >= duration_s:
            raise ConfigError(source, f"faults[{i}].at_s", fault.at_s, f"0-{duration_s:.1f}, the length of the walk")


def plan_faults(faults: Sequence[Fault], rig: Rig, seed: int, duration_s: float) -> list[tuple[Fault, Events]]:
    """All events of all faults in a walk of `duration_s`, each fault with its events by topic, in time order.

    One without times is an event that lasts the whole walk.

    Random times depend on the walk's seed, the fault's name and the stream alone, so that adding or removing a fault or
    a sensor does not change the other events. Sensors on one strap slip together; occlusions cover colour and depth.
    Faults without a matching stream in the rig do nothing.
    """
    planned: list[tuple[Fault, Events]] = []
    for fault in faults:
        events: dict[str, EventsOfTopic] = {}
        for stream in _affected(fault, rig):
            place = getattr(stream, fault.common_to)
            key = (_FAULTS, zlib.crc32(fault.own_name.encode()), zlib.crc32(place.encode()))
            own = tuple(_events(fault, stream, seed, key, round(duration_s * 1e9), rig))
            if own:
                events[stream.topic] = own
        planned.append((fault, events))
    return planned


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultPlan:
    """All faults of one walk, ready to be injected: by the recorder, or into a recording that is replayed.

    Attributes:
        rig: The nominal calibration with the errors that the faults add to it.
        planned: Each fault with its events by topic.
    """

    rig: Rig
    planned: Sequence[tuple[Fault, Events]]

    @classmethod
    def of(cls, faults: Sequence[Fault], rig: Rig, seed: int, duration_s: float) -> Self:
        """The plan for a walk of `duration_s` with a seed and the nominal calibration without these faults."""
        planned = plan_faults(faults, rig, seed, duration_s)
        for fault, events in planned:
            sensors: dict[str, Any] = {
                group: {t: fault.calibrate(c) if t in events else c for t, c in getattr(rig, group).items()}
                for group in ("imus", "cameras", "others")
            }
            rig = replace(rig, **sensors)
        return cls(rig=rig, planned=planned)

    def arrivals(self, items: Iterable[Block[Any] | Sample]) -> Iterator[Arrival]:
        """Items that arrive at the recorder, given those that the sensors sent."""
        return arrivals(items, self.planned)

    def samples(self, items: Iterable[Block[Any] | Sample]) -> Iterator[Sample]:
        """Single samples that arrive at an estimator, in order of arrival, given those that the sensors sent."""
        for arrival in self.arrivals(items):
            yield from arrival.item if isinstance(arrival.item, Block) else (arrival.item,)


def _events(fault: Fault, stream: Stream, seed: int, key: tuple[int, ...], end_ns: int, rig: Rig) -> Iterator[Event]:
    for count, (from_s, until_s) in enumerate(_spans(fault, seed, key)):
        from_ns = round(from_s * 1e9)
        if from_ns >= end_ns:
            return
        if until_s is None or isinstance(fault, LooseStrap):  # a slip is permanent
            until_s = math.inf
        until_ns = end_ns + 1 if until_s * 1e9 > end_ns else round(until_s * 1e9)
        yield Event(
            kind=fault.kind, topic=stream.topic, from_ns=from_ns, until_ns=until_ns, part=stream.part,
            entropy=seed, key=(*key, count), rig=rig,
        )  # fmt: skip


def _spans(fault: Fault, seed: int, key: tuple[int, ...]) -> Iterator[tuple[float, float | None]]:
    """Begin and end of each event, s; the end is None for the rest of the walk."""
    if not isinstance(fault, TimedFault):
        yield 0.0, None
        return
    if fault.at_s is not None:
        yield fault.at_s, None if fault.duration_s is None else fault.at_s + fault.duration_s
        return
    assert fault.rate_per_min is not None
    assert fault.duration_s is not None
    rng, t = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key)), 0.0
    while True:
        t += rng.exponential(60.0 / fault.rate_per_min)
        yield t, t + fault.duration_s
        t += fault.duration_s
