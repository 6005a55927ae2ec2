"""Flights of stairs along a way, as the ground truly is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from stridetwin.sim.route import Strip


@dataclass(frozen=True, kw_only=True)
class Flight:
    """Risers with treads between them.

    Attributes:
        s: Arc length of its first edge, m.
        end: Of its last one, m.
        riser: Mean height of its risers, m, down negative.
        tread: Mean depth of its treads, m; 0 for a single riser.
        risers: How many.
    """

    s: float
    end: float
    riser: float
    tread: float
    risers: int


def edges(profile: Sequence[Strip], least_m: float = 1e-6) -> list[tuple[float, float, Strip]]:
    """Where the ground jumps by so much at least: arc length, m; height, m; and the strip that begins there."""
    jumps = [(after.s0, after.z0 - before.z1, after) for before, after in pairwise(profile)]
    return [jump for jump in jumps if abs(jump[1]) >= least_m]


def flights(profile: Sequence[Strip], least_m: float = 1e-6) -> list[Flight]:
    """The flights of a way, in order; lower risers than `least_m` are none."""
    found: list[Flight] = []
    s, heights = [], []
    for place, height, onto in edges(profile, least_m):
        s.append(place)
        heights.append(height)
        if onto.terrain == "stair":
            continue
        tread = (s[-1] - s[0]) / (len(s) - 1) if len(s) > 1 else 0.0
        found.append(Flight(s=s[0], end=s[-1], riser=float(np.mean(heights)), tread=tread, risers=len(s)))
        s, heights = [], []
    return found
