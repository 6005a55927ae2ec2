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
from pydantic import Field

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.fields import DEG, DEGREES, MILLIMETRES, Number, Text
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

# sample types that hold numbers, and those that hold pixels
NUMBERS = (Imu, Range, Insole, Ahrs, Encoder, Interaction, Actuator)
IMAGES = (Image, Depth)
POSES = "/poses"
"""Stream of an odometry's poses on their way to estimators of terrain and modes; `estimators.base.POSES`."""
Calibration = ImuCalibration | CameraCalibration | OtherSensor
_LONGEST_S = 36_000  # largest time in a scenario file, 10 h


@dataclass(frozen=True, kw_only=True)
class Event:
    """One occurrence of a fault of some kind on one stream.

    Attributes:
        kind: Kind of the fault, as in scenario files.
        topic: Topic of the stream.
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
        """Random numbers of this event, or of one instant of it; each call starts the same sequence."""
        return np.random.default_rng(np.random.SeedSequence(self.entropy, spawn_key=(*self.key, *instant_ns)))


EventsOfTopic = tuple[Event, ...]
"""Events of one fault on one topic, in time order."""
Events = Mapping[str, EventsOfTopic]
Memory = dict[Any, Any]
"""State of a fault on one topic between chunks.

Each kind of fault has its own entries, initially none. The entry `truth` is common: `arrivals` appends to it the
samples of the ground truth that the fault asks for (`Fault.truth_topic`)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampleInTransit:
    """A sample or block on its way to the recorder.

    Attributes:
        item: A sample, or a block of samples that no fault concerns.
        taken_ns: Measurement time of the sample, whatever its stamp is by now.
        log_ns: Arrival time; (N,) for the samples of a block, None = at their stamps.
    """

    item: Sample | Block[Sample]
    taken_ns: int = 0
    log_ns: Any = None

    @property
    def topic(self) -> str:
        """Topic of the item."""
        return self.item.topic

    def with_values(self, **values: object) -> SampleInTransit:
        """Copy of this arrival whose sample has other values in the named fields."""
        fields: dict[str, Any] = dict(values)
        return replace(self, item=replace(self.item, **fields))


def arrivals(
    items: Iterable[Block[Sample] | Sample], faults: Iterable[tuple[Fault, Events]]
) -> Iterator[SampleInTransit]:
    """Items as they arrive at the recorder, with faults applied in the given order.

    Topics that no fault concerns pass unchanged, as blocks. When the items have ended, samples that faults still hold
    back arrive last.

    Args:
        items: Blocks and samples that the sensors sent, in chunks by time.
        faults: Each fault with its events by topic (`plan_faults`).
    """
    # by topic: the faults that its samples pass, one after the other, each with its events and its state on this topic
    lines: dict[str, list[tuple[Fault, EventsOfTopic, Memory]]] = {}
    # by topic of the ground truth: states of the faults that need it; its samples are collected in memory["truth"]
    truth_readers: dict[str, list[Memory]] = {}
    for fault, events in faults:
        if not fault.on_samples:
            continue  # acts on mounts, poses or the calibration, not here
        for topic, topic_events in events.items():
            memory: Memory = {}
            lines.setdefault(topic, []).append((fault, topic_events, memory))
            # "" for a fault that needs no truth; no item has this topic
            truth_readers.setdefault(fault.truth_topic(topic_events[0]), []).append(memory)
    for item in items:
        # keep the ground truth for the faults that need it; it passes on like any other item
        for memory in truth_readers.get(item.topic, ()):
            memory.setdefault("truth", []).extend(item if isinstance(item, Block) else [item])
        if item.topic not in lines:  # no fault concerns it
            yield SampleInTransit(item=item)
            continue
        # chained generators: each sample passes all faults of the topic
        stream: Iterable[SampleInTransit] = _split_block(item)
        for fault, topic_events, memory in lines[item.topic]:
            stream = fault.process(stream, topic_events, memory)
        yield from _merge_samples(stream)
    # the end of all streams: each fault releases what it holds back, and the faults after it still process that
    for line in lines.values():
        stream = ()
        for fault, topic_events, memory in line:
            stream = _process_last(stream, fault, topic_events, memory)
        yield from _merge_samples(stream)


def _process_last(
    stream: Iterable[SampleInTransit], fault: Fault, events: EventsOfTopic, memory: Memory
) -> Iterator[SampleInTransit]:
    """Arrivals after a fault at the end of a stream: what the faults before it release, then what it holds back itself.

    Args:
        stream: Arrivals that the faults before it held back.
        fault: The fault.
        events: Its events on this topic.
        memory: Its state on this topic.
    """
    yield from fault.process(stream, events, memory)
    yield from fault.flush(memory)


def _split_block(item: Block[Sample] | Sample) -> Iterator[SampleInTransit]:
    """Each sample of a block, or a single sample, as an arrival at its own stamp."""
    for sample in item if isinstance(item, Block) else (item,):
        yield SampleInTransit(item=sample, taken_ns=sample.t_ns, log_ns=sample.t_ns)


def _merge_samples(stream: Iterable[SampleInTransit]) -> Iterator[SampleInTransit]:
    """Arrivals of one topic merged to one block, with an arrival time for each sample; images stay single.

    Nothing comes back for a stream without arrivals.
    """
    arrivals = list(stream)
    if arrivals and isinstance(arrivals[0].item, IMAGES):
        yield from arrivals
    elif arrivals:
        # imported late, so that a scenario is read without it
        from stridetwin.streams.recording.ros_samples import block_of

        block = block_of([a.item for a in arrivals if isinstance(a.item, Sample)])
        yield SampleInTransit(item=block, log_ns=np.array([a.log_ns for a in arrivals], np.int64))


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault of some sensors, for the whole walk.

    Attributes:
        topic: Topic, or a pattern of topics such as `/foot_*/imu`.
        name: Seeds its random times and choices; unique within a walk.
    """

    kind: ClassVar[str]  # in files: the name of the class, as in loose_strap
    sample_types: ClassVar[tuple[type[Sample], ...]] = NUMBERS + IMAGES
    on_samples: ClassVar[bool] = True  # otherwise it acts elsewhere
    common_to: ClassVar[str] = "topic"  # or housing, or body: streams that share it share times and choices
    topic: Text
    name: Text = ""

    def __init_subclass__(cls) -> None:
        # `LooseStrap` becomes `loose_strap`
        cls.kind = re.sub("(?<=[a-z])(?=[A-Z])", "_", cls.__name__).lower()

    @property
    def full_name(self) -> str:
        """The name of the fault, by default its kind and topic."""
        return self.name or f"{self.kind} {self.topic}"

    def applies_to(self, stream: SensorStream) -> bool:
        """Whether the fault can act on a stream whose topic matches."""
        return stream.kind in self.sample_types

    def calibrate(self, sensor: Calibration) -> Calibration:
        """Nominal calibration of a sensor with this fault, given the one without it.

        Most faults do not change the calibration, so that by default it comes back as it is.
        """
        return sensor

    def truth_topic(self, event: Event) -> str:
        """Topic of the ground truth that the fault needs at an event, "" for none.

        `arrivals` collects the samples of that topic in the fault's memory under `truth`. Most faults need none and do
        not look at the event.
        """
        return ""

    def process(
        self, stream: Iterable[SampleInTransit], events: EventsOfTopic, memory: Memory
    ) -> Iterator[SampleInTransit]:
        """Arrivals after this fault, for one chunk of one topic's stream.

        Args:
            stream: Arrivals before this fault.
            events: Events on this topic, in time order.
            memory: State of the fault on this topic, kept from chunk to chunk.
        """
        for arrival in stream:
            event = active_event(events, arrival)
            # this default needs no memory; subclasses that do override the function
            yield from (arrival,) if event is None else self.corrupt(arrival, event)

    def flush(self, memory: Memory) -> Iterable[SampleInTransit]:
        """Arrivals that the fault still holds back in `memory` when the stream has ended; most faults hold none."""
        return ()

    def corrupt(self, arrival: SampleInTransit, event: Event) -> Iterable[SampleInTransit]:
        """Arrivals in place of one arrival during an event: none, one or several."""
        return (arrival,)


@dataclass(frozen=True, kw_only=True)
class TimedFault(Fault):
    """A fault at a given time or at random times.

    Attributes:
        at_s: Start time; None if `rate_per_min` gives the frequency.
        duration_s: Duration; None = to the end of the walk.
        rate_per_min: Mean number of events per minute of walk without the fault, at random times.
    """

    at_s: Annotated[Number | None, Field(ge=0, le=_LONGEST_S)] = None
    duration_s: Annotated[Number | None, Field(ge=0.001, le=_LONGEST_S)] = None
    rate_per_min: Annotated[Number | None, Field(ge=0.001, le=600)] = None


def active_event(events: EventsOfTopic, arrival: SampleInTransit) -> Event | None:
    """The event that is active at the measurement time of a sample, or None; `events` are in time order."""
    i = bisect_right(events, arrival.taken_ns, key=attrgetter("from_ns")) - 1  # the last event that has begun
    return events[i] if i >= 0 and arrival.taken_ns < events[i].until_ns else None


@dataclass(frozen=True, kw_only=True)
class LooseStrap(TimedFault):
    """A strap that slips: the sensors on it rotate and move on their body, permanently.

    It acts in the twin (`sim.sensors.mount_slip`), not on samples. Sensors on one body that match one pattern hang on
    one strap; an RGB-D camera and its IMU always do.

    In scenario files the two fields are in degrees and mm, and so are their limits.

    Attributes:
        angle_rad: Rotation of one slip, about a random axis.
        shift_m: Translation of one slip, in a random direction.
    """

    common_to = "body"
    on_samples = False
    sample_types = (Imu, Image, Depth, Ahrs, Range)
    angle_rad: Annotated[Number, Field(ge=0, le=90, alias="angle_deg"), DEGREES] = 10 * DEG
    shift_m: Annotated[Number, Field(ge=0, le=100, alias="shift_mm"), MILLIMETRES] = 0.01


# sample type by the kind of a sensor in `Rig.others`
_OTHERS: dict[str, type[Sample]] = {
    "range": Range,
    "insole": Insole,
    "ahrs": Ahrs,
    "encoder": Encoder,
    "interaction": Interaction,
    "actuator": Actuator,
}
_FAULTS = zlib.crc32(b"faults")  # separates their child streams from the sensors' noise


@dataclass(frozen=True, kw_only=True)
class SensorStream:
    """A stream of a rig on which a fault can act.

    Attributes:
        topic: Topic of its samples.
        kind: Type of its samples.
        part: Part name of the sensor that sends it; "" for estimated poses.
        body: Body that carries the sensor.
        housing: Topic that names the case of the sensor; streams of sensors in one case share it.
    """

    topic: str
    kind: type[Sample]
    part: str
    body: str
    housing: str


def _streams_of_rig(rig: Rig) -> Iterator[SensorStream]:
    """Every stream of a rig that a fault can act on.

    An RGB-D camera, its depth and its IMU share a housing, and so do an AHRS and the IMU inside it. An RGB-D camera
    also stands for the stream of estimated poses, `POSES`.
    """
    # by topic of an IMU inside a camera or an AHRS: the housing, which has that sensor's topic; others are their own
    shared_housing = {c.imu_topic: c.topic for c in rig.cameras.values() if c.depth_topic}
    shared_housing |= {t.replace("/ahrs", "/imu"): t for t, sensor in rig.others.items() if sensor.kind == "ahrs"}
    for t, imu in rig.imus.items():
        yield SensorStream(topic=t, kind=Imu, part=imu.part, body=imu.mount.body, housing=shared_housing.get(t, t))
    for t, camera in rig.cameras.items():
        yield SensorStream(topic=t, kind=Image, part=camera.part, body=camera.mount.body, housing=t)
        if camera.depth_topic:
            yield SensorStream(
                topic=camera.depth_topic, kind=Depth, part=camera.part, body=camera.mount.body, housing=t
            )
    for t, sensor in rig.others.items():
        yield SensorStream(topic=t, kind=_OTHERS[sensor.kind], part=sensor.part, body=sensor.mount.body, housing=t)
    rgbd_cameras = [c for c in rig.cameras.values() if c.depth_topic]
    for camera in rgbd_cameras[:1]:  # the first one alone estimates poses; there may be none
        yield SensorStream(topic=POSES, kind=Odometry, part="", body=camera.mount.body, housing=POSES)


def _find_streams(fault: Fault, rig: Rig) -> list[SensorStream]:
    """Streams of a rig on which a fault acts: those that its topic names, and for a strap their whole housings."""
    streams = [s for s in _streams_of_rig(rig) if fault.applies_to(s)]
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
        if not _find_streams(fault, rig):
            # topics of all streams on which a fault of this kind can act
            valid = ", ".join(sorted(s.topic for s in _streams_of_rig(rig) if fault.applies_to(s)))
            raise ConfigError(source, f"faults[{i}].topic", fault.topic, f"{valid or 'none here'} ({fault.kind}), or *")
        if fault.full_name in names:
            raise ConfigError(source, f"faults[{i}].name", fault.full_name, "a name of its own for each fault")
        names.append(fault.full_name)


def check_times(source: object, faults: Sequence[Fault], duration_s: float) -> None:
    """Rejects faults that begin after the end of a walk of `duration_s`.

    Raises:
        ConfigError: Names the fault, its time and the length of the walk.
    """
    for i, fault in enumerate(faults):
        if isinstance(fault, TimedFault) and fault.at_s is not None and fault.at_s >= duration_s:
            raise ConfigError(source, f"faults[{i}].at_s", fault.at_s, f"0-{duration_s:.1f}, the length of the walk")


def plan_faults(faults: Sequence[Fault], rig: Rig, seed: int, duration_s: float) -> list[tuple[Fault, Events]]:
    """All events of all faults in one walk, each fault with its events by topic, in time order.

    A fault without times is one event that lasts the whole walk. Random times depend on the walk's seed, the fault's
    name and the stream alone, so that adding or removing a fault or a sensor does not change the other events. Sensors
    on one strap slip together; occlusions cover colour and depth. Faults without a matching stream in the rig do
    nothing.

    Args:
        faults: The faults.
        rig: Nominal calibration, which names the streams.
        seed: Seed of the walk.
        duration_s: Length of the walk.
    """
    planned: list[tuple[Fault, Events]] = []
    for fault in faults:
        events: dict[str, EventsOfTopic] = {}
        for stream in _find_streams(fault, rig):
            # topic, housing or body: streams that have it in common get the same random numbers
            shared_by = getattr(stream, fault.common_to)
            # child stream of the walk's random numbers
            key = (_FAULTS, zlib.crc32(fault.full_name.encode()), zlib.crc32(shared_by.encode()))
            stream_events = tuple(_generate_events(fault, stream, seed, key, round(duration_s * 1e9), rig))
            if stream_events:  # topics without events are left out, so that their samples pass unchanged
                events[stream.topic] = stream_events
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
        """Plan of the faults of a walk, with the errors that they add to its nominal calibration.

        Args:
            faults: The faults.
            rig: Nominal calibration without these faults.
            seed: Seed of the walk.
            duration_s: Length of the walk.
        """
        planned = plan_faults(faults, rig, seed, duration_s)
        # each fault adds its error to the calibration of the sensors on which it has events
        for fault, events in planned:
            changed_groups: dict[str, Any] = {}
            for group in ("imus", "cameras", "others"):  # fields of the rig: calibrations by topic
                calibrations = getattr(rig, group)
                changed_groups[group] = {t: fault.calibrate(c) if t in events else c for t, c in calibrations.items()}
            rig = replace(rig, **changed_groups)
        return cls(rig=rig, planned=planned)

    def arrivals(self, items: Iterable[Block[Sample] | Sample]) -> Iterator[SampleInTransit]:
        """Items as they arrive at the recorder, given those that the sensors sent, in chunks by time."""
        return arrivals(items, self.planned)

    def samples(self, items: Iterable[Block[Sample] | Sample]) -> Iterator[Sample]:
        """Single samples as they arrive at an estimator, given the items that the sensors sent, in chunks by time."""
        for arrival in self.arrivals(items):
            yield from arrival.item if isinstance(arrival.item, Block) else (arrival.item,)


def _generate_events(
    fault: Fault, stream: SensorStream, seed: int, key: tuple[int, ...], end_ns: int, rig: Rig
) -> Iterator[Event]:
    """Events of a fault on one stream, in time order, until the end of the walk.

    Args:
        fault: The fault.
        stream: The stream.
        seed: Seed of the walk.
        key: Child stream of the random numbers, common to the streams that share the events.
        end_ns: End of the walk.
        rig: Nominal calibration.
    """
    for count, (from_s, until_s) in enumerate(_draw_spans(fault, seed, key)):
        from_ns = round(from_s * 1e9)
        if from_ns >= end_ns:
            return
        if until_s is None or isinstance(fault, LooseStrap):  # a slip is permanent
            until_s = math.inf
        # an event that outlasts the walk ends just after its last instant, which it includes
        until_ns = end_ns + 1 if until_s * 1e9 > end_ns else round(until_s * 1e9)
        yield Event(
            kind=fault.kind,
            topic=stream.topic,
            from_ns=from_ns,
            until_ns=until_ns,
            part=stream.part,
            entropy=seed,
            key=(*key, count),
            rig=rig,
        )


def _draw_spans(fault: Fault, seed: int, key: tuple[int, ...]) -> Iterator[tuple[float, float | None]]:
    """Begin and end of each event of a fault, s; an end of None is the end of the walk.

    A fault without times, or with a start time, has one event. A fault with a rate has endlessly many; each begins
    after an exponentially distributed time without the fault. The caller stops at the end of the walk.

    Args:
        fault: The fault.
        seed: Seed of the walk.
        key: Child stream of the random numbers.
    """
    if not isinstance(fault, TimedFault):
        yield 0.0, None
        return
    if fault.at_s is not None:
        yield fault.at_s, None if fault.duration_s is None else fault.at_s + fault.duration_s
        return
    # a fault in a scenario file has a start time, or a rate and a duration
    assert fault.rate_per_min is not None
    assert fault.duration_s is not None
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
    t = 0.0  # s, end of the event before
    while True:
        t += rng.exponential(60.0 / fault.rate_per_min)
        yield t, t + fault.duration_s
        t += fault.duration_s
