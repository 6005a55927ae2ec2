"""The true terrain of a walk: the way, the strips of ground along it, and every slab that it consists of.

The twin lays it out and writes it to the recording's metadata; scores, reports and viewers read it from there.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike

from stridetwin.streams.errors import metadata_error
from stridetwin.streams.samples import Array
from stridetwin.streams.way import CurveSegment, Way

_KEY = "terrain"  # in the metadata


@dataclass(frozen=True, kw_only=True)
class Strip:
    """One flat or sloping segment of the way.

    Attributes:
        s0, s1: Arc length of its start and end, m.
        z0, z1: Height of the way there, m.
        terrain: level, stair or ramp.
        cross_slope: Lateral tilt, rad, left side up positive.
    """

    s0: float
    s1: float
    z0: float
    z1: float
    terrain: str
    cross_slope: float = 0.0

    @property
    def slope(self) -> float:
        """Inclination along the way, rad, uphill positive."""
        return math.atan((self.z1 - self.z0) / (self.s1 - self.s0))

    def height(self, s: float, left: float) -> float:
        """Height of its plane at an arc length and at m to the left of the way."""
        return self.z0 + math.tan(self.slope) * (s - self.s0) + math.tan(self.cross_slope) * left


def profile_height(profile: Sequence[Strip], s: ArrayLike) -> Array:
    """(...) m, height of the way at (...) arc lengths `s`, m; beyond its ends that of the end.

    Args:
        profile: Strips in the order of the way.
        s: (...) arc lengths, m.
    """
    at = np.asarray(s, dtype=float)
    ends_s = [arc_length for strip in profile for arc_length in (strip.s0, strip.s1)]
    ends_z = [height for strip in profile for height in (strip.z0, strip.z1)]
    return np.interp(at, ends_s, ends_z)  # each strip is linear between its two ends


@dataclass(frozen=True, kw_only=True)
class Slab:
    """One flat segment of ground, a rectangle in plan view.

    Attributes:
        x, y: Start of its axis in the world, m.
        heading: Direction of its axis, rad.
        length: Along its axis, m.
        left, right: Extent to both sides of its axis, m.
        z0, z1: Height at the start and at the end of its axis, m.
        terrain: level, stair or ramp.
        cross_slope: Lateral tilt, rad, left side up positive.
        recess: How far the riser below it stands back from its lower edge, m: from the start of its axis, or, negative,
            from the end; its whole length makes it a plank.
        start_radius, end_radius: Of its rounded edges at the start and at the end of its axis, m.
    """

    x: float
    y: float
    heading: float
    length: float
    left: float
    right: float
    z0: float
    z1: float
    terrain: str
    cross_slope: float = 0.0
    recess: float = 0.0
    start_radius: float = 0.0
    end_radius: float = 0.0

    def point(self, along: ArrayLike, left: ArrayLike) -> Array:
        """(..., 3) points of its top in the world, m, at (...) m along its axis and (...) m to the left of it."""
        along, left = np.asarray(along, dtype=float), np.asarray(left, dtype=float)
        cos, sin = math.cos(self.heading), math.sin(self.heading)  # the axis is (cos, sin), its left side (-sin, cos)
        z = self.z0 + (self.z1 - self.z0) * along / self.length + math.tan(self.cross_slope) * left
        return np.stack([self.x + cos * along - sin * left, self.y + sin * along + cos * left, z], -1)

    def local(self, xy: Array) -> tuple[Array, Array]:
        """Where points (..., 2) of the world, m, are on the slab: (...) m along its axis, (...) m to the left of it."""
        cos, sin = math.cos(self.heading), math.sin(self.heading)  # the axis is (cos, sin), its left side (-sin, cos)
        dx, dy = xy[..., 0] - self.x, xy[..., 1] - self.y  # from the start of the axis, in the world
        return cos * dx + sin * dy, cos * dy - sin * dx


@dataclass(frozen=True, kw_only=True)
class Layout:
    """A route in the world.

    Attributes:
        way: Plane curve that the walk follows, from behind the start to beyond the end (`sim/world/route.py`).
        profile: Strips along the way in order; there is a riser where one's z1 differs from the next one's z0.
        slabs: All walkable ground, including that beside the way.
    """

    way: Way
    profile: tuple[Strip, ...]
    slabs: tuple[Slab, ...]


def terrain_metadata(layout: Layout) -> dict[str, str]:
    """The layout of the terrain as metadata of a recording."""
    rows = {
        "way": [asdict(segment) for segment in layout.way.segments],
        "profile": [asdict(strip) for strip in layout.profile],
        "slabs": [asdict(slab) for slab in layout.slabs],
    }
    return {_KEY: json.dumps(rows)}


def terrain_layout(metadata: Mapping[str, str]) -> Layout | None:
    """The layout of the terrain in a recording's metadata; None without one.

    Raises:
        RecordingError: It is not a layout.
    """
    if _KEY not in metadata:
        return None
    try:
        rows = json.loads(metadata[_KEY])
        return Layout(
            way=Way(segments=tuple(CurveSegment(**row) for row in rows["way"])),
            profile=tuple(Strip(**row) for row in rows["profile"]),
            slabs=tuple(Slab(**row) for row in rows["slabs"]),
        )
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise metadata_error(_KEY, "a terrain written by StrideTwin", error) from error
