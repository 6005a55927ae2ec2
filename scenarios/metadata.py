"""What a recording's metadata holds about its walk: the layout of the terrain, and the injected faults."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass

from stridetwin.sim.faults.faults import Events, Fault
from stridetwin.sim.world.route import Layout, Slab, Strip
from stridetwin.sim.world.way import CurveSegment, Way
from stridetwin.streams.errors import RecordingError

_TERRAIN, _FAULTS = "terrain", "faults"


@dataclass(frozen=True, kw_only=True)
class InjectedFault:
    """One fault on one stream, from start to end; a mount slip is permanent and ends with the walk."""

    kind: str
    topic: str
    from_s: float
    until_s: float


def terrain_metadata(layout: Layout) -> dict[str, str]:
    """The layout of the terrain as metadata."""
    rows = {
        "way": [asdict(segment) for segment in layout.way.segments],
        "profile": [asdict(strip) for strip in layout.profile],
        "slabs": [asdict(slab) for slab in layout.slabs],
    }
    return {_TERRAIN: json.dumps(rows)}


def terrain_layout(metadata: Mapping[str, str]) -> Layout | None:
    """The layout of the terrain in a recording's metadata; None without one.

    Raises:
        RecordingError: It is not a layout.
    """
    if _TERRAIN not in metadata:
        return None
    try:
        rows = json.loads(metadata[_TERRAIN])
        return Layout(
            way=Way(segments=tuple(CurveSegment(**row) for row in rows["way"])),
            profile=tuple(Strip(**row) for row in rows["profile"]),
            slabs=tuple(Slab(**row) for row in rows["slabs"]),
        )
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise _invalid(_TERRAIN, "a terrain written by StrideTwin", error) from error


def fault_metadata(planned: Iterable[tuple[Fault, Events]]) -> dict[str, str]:
    """The events of planned faults as metadata, in time order."""
    events = [event for _, by_topic in planned for own in by_topic.values() for event in own]
    events.sort(key=lambda e: (e.from_ns, e.topic, e.kind))
    rows = [{"kind": e.kind, "topic": e.topic, "from_s": e.from_ns / 1e9, "until_s": e.until_ns / 1e9} for e in events]
    return {_FAULTS: json.dumps(rows)}


def injected_faults(metadata: Mapping[str, str]) -> list[InjectedFault]:
    """The faults that a recording lists, in time order; empty if none were injected.

    Raises:
        RecordingError: It is not a list of faults.
    """
    try:
        return [InjectedFault(**entry) for entry in json.loads(metadata.get(_FAULTS, "[]"))]
    except (ValueError, TypeError, RecursionError) as error:
        raise _invalid(_FAULTS, "faults written by StrideTwin", error) from error


def _invalid(key: str, expected: str, error: Exception) -> RecordingError:
    return RecordingError(f"invalid metadata {key}: expected {expected}: {' '.join(str(error).split())[:120]}")
