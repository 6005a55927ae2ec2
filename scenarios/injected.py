"""The faults injected into a walk, which a recording lists beside its truth."""

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
        kind: Kind of fault.
        topic: The stream.
        from_s: Start, s of the walk.
        until_s: End; the end of the walk for a mount slip, which is permanent.
    """

    kind: str
    topic: str
    from_s: float
    until_s: float


def to_text(planned: Iterable[tuple[Fault, Events]]) -> str:
    """The events of planned faults as JSON, in time order."""
    events = [event for _, by_topic in planned for own in by_topic.values() for event in own]
    events.sort(key=lambda e: (e.from_ns, e.topic, e.kind))
    return json.dumps(
        [{"kind": e.kind, "topic": e.topic, "from_s": e.from_ns / 1e9, "until_s": e.until_ns / 1e9} for e in events]
    )


def from_metadata(metadata: Mapping[str, str]) -> list[Injected]:
    """The faults that a recording lists, in time order; empty if none were injected.

    Raises:
        RecordingError: It is not a list of faults.
    """
    try:
        return [Injected(**entry) for entry in json.loads(metadata.get(KEY, "[]"))]
    except (ValueError, TypeError, RecursionError) as error:
        raise RecordingError(f"metadata {KEY}: no faults of ours: {' '.join(str(error).split())[:120]}") from error
