"""Heights along the way, as a recording's metadata carries them for reports and viewers."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict

from stridetwin.sim.route import Strip  # plain data: needs no simulator

KEY = "terrain"


def to_text(profile: Iterable[Strip]) -> str:
    """The profile as JSON."""
    return json.dumps([asdict(strip) for strip in profile])


def from_metadata(metadata: Mapping[str, str]) -> list[Strip]:
    """The profile of a recording's metadata; empty where it has none."""
    return [Strip(**strip) for strip in json.loads(metadata.get(KEY, "[]"))]
