"""Predicted terrain changes beside the true ones, 1.5 s before the first foot lands beyond each of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from stridetwin.estimators.locomotion_mode import ModeEstimate
from stridetwin.outputs.alignment import MovingAlignment
from stridetwin.outputs.terrain.changes import ScoredChange, TerrainChange, mode_of
from stridetwin.outputs.truth import flights, scored_at_ns
from stridetwin.streams.samples import Array, Footprint
from stridetwin.streams.terrain_truth import Layout

_STAIR_M = 0.07
_MATCH_M = 0.4


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
