"""The injected faults of a walk in its recording's metadata."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stridetwin.sim.faults.faults import POSES, Events, Fault
from stridetwin.sim.faults.sample_faults import Restart
from stridetwin.streams.errors import metadata_error
from stridetwin.streams.pose_restart import RESTARTS

_FAULTS = "faults"


@dataclass(frozen=True, kw_only=True)
class InjectedFault:
    """One fault on one stream, from start to end; a mount slip is permanent and ends with the walk."""

    kind: str
    topic: str
    from_s: float
    until_s: float


def fault_metadata(planned: Sequence[tuple[Fault, Events]]) -> dict[str, str]:
    """The events of planned faults as metadata, in time order, and the restarts of an odometry, which replays apply.

    Args:
        planned: Each fault of a walk with its events by topic.

    Returns:
        JSON by key: rows with kind, topic, begin and end of each event; and, if there are any, the restarts
        (`pose_restart.RESTARTS`).
    """
    events = [event for _, by_topic in planned for topic_events in by_topic.values() for event in topic_events]
    events.sort(key=lambda e: (e.from_ns, e.topic, e.kind))
    rows = [{"kind": e.kind, "topic": e.topic, "from_s": e.from_ns / 1e9, "until_s": e.until_ns / 1e9} for e in events]
    # of each restart of an odometry: begin and end, ns; rotation about the vertical, rad; and translation x, y, z, m
    restarts = [
        (e.from_ns, e.until_ns, fault.yaw_rad, *fault.translation_m)
        for fault, by_topic in planned
        if isinstance(fault, Restart)
        for e in by_topic.get(POSES, ())
    ]
    return {_FAULTS: json.dumps(rows)} | ({RESTARTS: json.dumps(sorted(restarts))} if restarts else {})


def read_injected_faults(metadata: Mapping[str, str]) -> list[InjectedFault]:
    """The faults that a recording lists, in time order; empty if none were injected.

    Raises:
        RecordingError: It is not a list of faults.
    """
    try:
        return [InjectedFault(**entry) for entry in json.loads(metadata.get(_FAULTS, "[]"))]
    except (ValueError, TypeError, RecursionError) as error:
        raise metadata_error(_FAULTS, "faults written by StrideTwin", error) from error
