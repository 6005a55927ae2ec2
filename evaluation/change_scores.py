"""Terrain changes of a route, and the errors of their estimates 1.5 s before the first foot lands beyond them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from stridetwin.estimators.locomotion_mode import ModeEstimate
from stridetwin.evaluation.alignment import MovingAlignment
from stridetwin.evaluation.truth import flights, scored_at_ns
from stridetwin.streams.samples import Array, Footprint
from stridetwin.streams.terrain_truth import Layout, Strip

_STAIR_M = 0.07
_MATCH_M = 0.4


@dataclass(frozen=True, kw_only=True)
class TerrainChange:
    """A place on the route where stairs, a ramp or level ground begin.

    Attributes:
        s: m along the route.
        mode: Mode of the steps beyond it.
        riser: m, down negative; 0 if no stairs begin.
        tread: m; 0 if no stairs begin.
        risers: Their number.
        slope: rad, down negative; 0 if no ramp begins.
    """

    s: float
    mode: str
    riser: float = 0.0
    tread: float = 0.0
    risers: int = 0
    slope: float = 0.0


@dataclass(frozen=True, kw_only=True)
class ScoredChange:
    """Errors of an estimated terrain change (estimated minus true), and the reported standard deviations; or NaN.

    Attributes:
        mode: True mode of the steps beyond it.
        found: Whether it was detected.
        distance_m: Error of the position along the route.
        riser_m: Error of the height of the risers.
        tread_m: Error of the depth of the treads.
        slope_rad: Error of the slope.
    """

    mode: str
    found: bool
    distance_m: float = math.nan
    distance_sd_m: float = math.nan
    riser_m: float = math.nan
    riser_sd_m: float = math.nan
    tread_m: float = math.nan
    tread_sd_m: float = math.nan
    slope_rad: float = math.nan
    slope_sd_rad: float = math.nan


def mode_changes(layout: Layout) -> list[TerrainChange]:
    """The terrain changes of a route, in order: stairs from the first edge to the last, ramps."""
    found = []
    for flight in flights(layout.profile, _STAIR_M):
        mode = "SA" if flight.riser > 0 else "SD"
        found.append(TerrainChange(s=flight.s, mode=mode, riser=flight.riser, tread=flight.tread))
        found.append(TerrainChange(s=flight.end, mode="LG"))
    for before, after in pairwise(layout.profile):
        if abs(after.z0 - before.z1) < _STAIR_M and after.slope != before.slope:
            found.append(TerrainChange(s=after.s0, mode=mode_of(after), slope=after.slope))
    return sorted(found, key=lambda change: change.s)


def mode_of(strip: Strip) -> str:
    """Mode of the steps along a strip without edges."""
    return "LG" if strip.slope == 0 else "RA" if strip.slope > 0 else "RD"


def score_approaches(
    landed: Sequence[Footprint],
    places: Array,
    estimates: Sequence[ModeEstimate],
    alignment: MovingAlignment,
    layout: Layout,
) -> list[ScoredChange]:
    """Every terrain change that a foot landed beyond, with its estimate; `places` (F,) are m along the route."""
    t_ns = np.array([e.t_ns for e in estimates])
    landed_ns = np.array([f.t_ns for f in landed])
    scored = []
    for change in mode_changes(layout):
        scored_ns = scored_at_ns(change.s, landed_ns, places)
        at = int(np.searchsorted(t_ns, scored_ns, side="right")) - 1
        if math.isfinite(scored_ns):
            known = _score(change, estimates[at], alignment, layout) if at >= 0 else None
            scored.append(known or ScoredChange(mode=change.mode, found=False))
    return scored


def _score(change: TerrainChange, estimate: ModeEstimate, alignment: MovingAlignment, layout: Layout) -> ScoredChange:
    """The change is found if the next predicted one has its mode and lies within 0.4 m."""
    found = estimate.change
    if found is None or found.mode != change.mode:
        return ScoredChange(mode=change.mode, found=False)
    heading = float(layout.way.heading(change.s))
    beyond = alignment.point(estimate.t_ns, found.p_in_world) - layout.way.point(change.s)
    off = float(beyond @ [math.cos(heading), math.sin(heading)])
    if abs(off) > _MATCH_M:
        return ScoredChange(mode=change.mode, found=False)
    return ScoredChange(
        mode=change.mode, found=True, distance_m=off, distance_sd_m=found.distance_sd,
        riser_m=found.riser - change.riser if change.riser else math.nan, riser_sd_m=found.riser_sd,
        tread_m=found.tread - change.tread if change.tread else math.nan, tread_sd_m=found.tread_sd,
        slope_rad=found.slope - change.slope if change.slope else math.nan, slope_sd_rad=found.slope_sd,
    )  # fmt: skip
