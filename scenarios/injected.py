"""The faults that were injected into a walk, as a recording tells them beside its truth."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from stridetwin.sim.faults.faults import Events, Fault
from stridetwin.streams.errors import RecordingError

KEY = "faults"


@dataclass(frozen=True, kw_only=True)
class Injected:
    """One fault on one stream.

    Attributes:
        kind: What went wrong.
        topic: Where.
        from_s: From when on, s of the walk.
        until_s: Until when; a strap that slipped does not come back, so that is the end of the walk.
    """

    kind: str
    topic: str
    from_s: float
    until_s: float


def to_text(planned: Iterable[tuple[Fault, Events]]) -> str:
    """The events of planned faults as JSON, in order of time."""
    events = [event for _, by_topic in planned for own in by_topic.values() for event in own]
    events.sort(key=lambda e: (e.from_ns, e.topic, e.kind))
    return json.dumps(
        [{"kind": e.kind, "topic": e.topic, "from_s": e.from_ns / 1e9, "until_s": e.until_ns / 1e9} for e in events]
    )


def from_metadata(metadata: Mapping[str, str]) -> list[Injected]:
    """What a recording tells of its faults, in order of time; nothing where none were injected.

    Raises:
        RecordingError: It is no list of them.
    """
    try:
        return [Injected(**entry) for entry in json.loads(metadata.get(KEY, "[]"))]
    except (ValueError, TypeError, RecursionError) as error:
        raise RecordingError(f"metadata {KEY}: no faults of ours: {' '.join(str(error).split())[:120]}") from error
