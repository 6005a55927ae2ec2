"""Heights along the way, as a recording's metadata carries them for reports and viewers."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Protocol

KEY = "terrain"


class StripLike(Protocol):
    """What the simulator knows of one piece of the way; fields as in `Strip`."""

    @property
    def x0(self) -> float: ...  # noqa: D102
    @property
    def x1(self) -> float: ...  # noqa: D102
    @property
    def z0(self) -> float: ...  # noqa: D102
    @property
    def z1(self) -> float: ...  # noqa: D102
    @property
    def terrain(self) -> str: ...  # noqa: D102


@dataclass(frozen=True, kw_only=True)
class Strip:
    """One flat or sloping piece of the way, across its whole width.

    Attributes:
        x0: Where it begins, m.
        x1: Where it ends, m.
        z0: Height at x0, m.
        z1: Height at x1, m.
        terrain: level, stair or ramp.
    """

    x0: float
    x1: float
    z0: float
    z1: float
    terrain: str


def to_text(profile: Iterable[StripLike]) -> str:
    """The profile as JSON."""
    return json.dumps([asdict(Strip(x0=s.x0, x1=s.x1, z0=s.z0, z1=s.z1, terrain=s.terrain)) for s in profile])


def from_metadata(metadata: Mapping[str, str]) -> list[Strip]:
    """The profile of a recording's metadata; empty where it has none."""
    return [Strip(**strip) for strip in json.loads(metadata.get(KEY, "[]"))]
