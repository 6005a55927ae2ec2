"""The layout of a route in the world, which a recording's metadata holds for reports and viewers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict

from stridetwin.sim.world.route import Layout, Slab, Strip  # plain data: needs no simulator
from stridetwin.sim.world.way import CurveSegment, Way
from stridetwin.streams.errors import RecordingError

KEY = "terrain"


def to_text(layout: Layout) -> str:
    """The layout as JSON."""
    rows = {
        "way": [asdict(segment) for segment in layout.way.segments],
        "profile": [asdict(strip) for strip in layout.profile],
        "slabs": [asdict(slab) for slab in layout.slabs],
    }
    return json.dumps(rows)


def from_metadata(metadata: Mapping[str, str]) -> Layout | None:
    """The layout in a recording's metadata; None without one.

    Raises:
        RecordingError: It is not a layout.
    """
    if KEY not in metadata:
        return None
    try:
        rows = json.loads(metadata[KEY])
        return Layout(
            way=Way(segments=tuple(CurveSegment(**row) for row in rows["way"])),
            profile=tuple(Strip(**row) for row in rows["profile"]),
            slabs=tuple(Slab(**row) for row in rows["slabs"]),
        )
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise RecordingError(f"metadata {KEY}: no terrain of ours: {' '.join(str(error).split())[:120]}") from error
