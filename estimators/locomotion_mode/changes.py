"""Where the ground ahead first becomes another one, and what it is there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.estimators.locomotion_mode.estimate import MODES
from stridetwin.estimators.locomotion_mode.parameters import LocomotionModeParameters
from stridetwin.estimators.locomotion_mode.pieces import Piece, mode_table
from stridetwin.estimators.terrain_map import Stairs, TerrainEstimate
from stridetwin.streams.samples import Array

_MATCH_M = 0.15
_PARALLEL = 0.8


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """A change along the way.

    Attributes:
        mode: Of the first step beyond it.
        at: m along the way.
        sd: m.
        piece: Number of the piece that begins there.
    """

    mode: str
    at: float
    sd: float
    piece: int


def first_change(ground: Sequence[Piece], here: int, mode: str, p: LocomotionModeParameters) -> Found | None:
    """The first bound ahead beyond which steps are of another mode than now.

    Stairs end at their last edge: the step over it still climbs, those beyond it do not.

    Args:
        ground: Pieces along the way.
        here: Number of the piece under the foot.
        mode: Of the steps that lead here and on.
        p: Thresholds.
    """
    table = mode_table(ground, p)
    for k in range(here + 1, len(ground)):
        into = MODES[int(table[k - 1, k].argmax())]
        if into not in (mode, "LG"):
            return Found(mode=into, at=ground[k].start, sd=ground[k].start_sd, piece=k)
        onward = MODES[int(table[k, k].argmax())]
        if mode in ("SA", "SD"):
            last = k + 1 == len(ground) or MODES[int(table[k, k + 1].argmax())] != mode
            if into == mode and last and ground[k].length > p.tread_max_m:
                return Found(mode=onward, at=ground[k].start, sd=ground[k].start_sd, piece=k)
        elif into != mode:
            return Found(mode=into, at=ground[k].start, sd=ground[k].start_sd, piece=k)
    return None


def flight_at(estimate: TerrainEstimate, place: Array, forward: Array, up: bool) -> Stairs | None:
    """The stairs with an edge at a place of the way.

    Args:
        estimate: What the map knows.
        place: (2,) m, where the way crosses the edge.
        forward: (2,) unit vector of the way.
        up: Whether the way leads up them.

    Returns:
        The stairs with most steps that have one there.
    """
    best: tuple[Stairs, float] | None = None
    for flight in estimate.stairs:
        along = float(flight.up @ forward) * (1.0 if up else -1.0)
        if along < _PARALLEL:
            continue
        away = np.abs(flight.edges - float(flight.up @ place))
        off = float(np.min(away[np.isfinite(away)], initial=math.inf))
        if off < _MATCH_M and (best is None or flight.steps > best[0].steps):
            best = flight, off
    return None if best is None else best[0]
