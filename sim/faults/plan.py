"""Times and places of the faults of a walk: all of them are fixed by the seed before the first sample."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from stridetwin.sim.faults.faults import Event, Events, Fault, LooseStrap
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Actuator, Ahrs, Depth, Encoder, Image, Imu, Insole, Interaction, Range, Sample

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
class _Stream:
    """A stream of a rig.

    Attributes:
        topic: Topic.
        kind: Type of its samples.
        part: Part that sends it.
        body: Body that carries the part.
        housing: Streams of one case share this name.
    """

    topic: str
    kind: type[Sample]
    part: str
    body: str
    housing: str


def _streams(rig: Rig) -> Iterator[_Stream]:
    case = {c.imu_topic: c.topic for c in rig.cameras.values() if c.depth_topic}
    case |= {t.replace("/ahrs", "/imu"): t for t, other in rig.others.items() if other.kind == "ahrs"}
    for t, c in rig.imus.items():
        yield _Stream(topic=t, kind=Imu, part=c.part, body=c.mount.body, housing=case.get(t, t))
    for t, camera in rig.cameras.items():
        yield _Stream(topic=t, kind=Image, part=camera.part, body=camera.mount.body, housing=t)
        if camera.depth_topic:
            depth = camera.depth_topic
            yield _Stream(topic=depth, kind=Depth, part=camera.part, body=camera.mount.body, housing=t)
    for t, other in rig.others.items():
        yield _Stream(topic=t, kind=_OTHERS[other.kind], part=other.part, body=other.mount.body, housing=t)


def _touched(fault: Fault, rig: Rig) -> list[_Stream]:
    streams = [s for s in _streams(rig) if fault.suits(s.kind, s.part)]
    named = [s for s in streams if fnmatchcase(s.topic, fault.topic)]
    if isinstance(fault, LooseStrap):
        cases = {s.housing for s in named}
        return [s for s in streams if s.housing in cases]
    return named


def check_faults(source: object, faults: Sequence[Fault], rig: Rig) -> None:
    """Rejects faults that match no stream that they can act on, or that share a name.

    Args:
        source: Name of the file in errors.
        faults: Faults in the order of the file.
        rig: Every sensor of the scenario.

    Raises:
        ConfigError: Names the fault, the invalid value and what is valid.
    """
    names: list[str] = []
    for i, fault in enumerate(faults):
        if not _touched(fault, rig):
            valid = ", ".join(sorted(s.topic for s in _streams(rig) if fault.suits(s.kind, s.part)))
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
        if fault.at_s is not None and fault.at_s >= duration_s:
            raise ConfigError(source, f"faults[{i}].at_s", fault.at_s, f"0-{duration_s:.1f}, the length of the walk")


def plan_faults(faults: Sequence[Fault], rig: Rig, seed: int, duration_s: float) -> list[tuple[Fault, Events]]:
    """All events of all faults in a walk.

    Random times depend on the walk's seed, the fault's name and the stream alone, so that adding or removing a fault or
    a sensor does not change the other events. Sensors on one strap slip together; occlusions cover colour and depth.

    Args:
        faults: Faults; those without a matching stream in the rig do nothing.
        rig: The sensors that are on.
        seed: Seed of the walk.
        duration_s: Duration of the walk; events begin before its end.

    Returns:
        Each fault with its events by topic, in time order.
    """
    planned: list[tuple[Fault, Events]] = []
    for fault in faults:
        events: dict[str, tuple[Event, ...]] = {}
        for stream in _touched(fault, rig):
            place = getattr(stream, fault.common_to)
            key = (_FAULTS, zlib.crc32(fault.own_name.encode()), zlib.crc32(place.encode()))
            own = tuple(_events(fault, stream, seed, key, round(duration_s * 1e9)))
            if own:
                events[stream.topic] = own
        planned.append((fault, events))
    return planned


def _events(fault: Fault, stream: _Stream, seed: int, key: tuple[int, ...], end_ns: int) -> Iterator[Event]:
    for number, (from_s, until_s) in enumerate(_spans(fault, seed, key)):
        from_ns = round(from_s * 1e9)
        if from_ns >= end_ns:
            return
        if until_s is None or isinstance(fault, LooseStrap):  # a slip is permanent
            until_s = math.inf
        until_ns = end_ns + 1 if until_s * 1e9 > end_ns else round(until_s * 1e9)
        yield Event(
            kind=fault.kind, topic=stream.topic, from_ns=from_ns, until_ns=until_ns, part=stream.part,
            entropy=seed, key=(*key, number),
        )  # fmt: skip


def _spans(fault: Fault, seed: int, key: tuple[int, ...]) -> Iterator[tuple[float, float | None]]:
    """Begin and end of each event, s; the end is None for the rest of the walk."""
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
