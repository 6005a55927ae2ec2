"""Predicted terrain changes beside the true ones, 1.5 s before the first foot lands beyond each of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from stridetwin.estimators.locomotion_mode import ModeEstimate
from stridetwin.outputs.alignment import MovingAlignment
from stridetwin.outputs.terrain.changes import ScoredChange, TerrainChange, mode_of
from stridetwin.outputs.truth import flights, scoring_time_ns
from stridetwin.streams.samples import Array, Footprint
from stridetwin.streams.terrain_truth import Layout

_STAIR_M = 0.07  # least rise between two surfaces that counts as a stair
_MATCH_M = 0.4  # largest distance along the route between a predicted change and the true one


def mode_changes(layout: Layout) -> list[TerrainChange]:
    """The terrain changes of a route, in order: begin and end of each flight of stairs, and each change of slope.

    The end of a flight is a change to level ground. Where the slope changes at a riser of a stair, that is no change of
    its own, because it belongs to the flight.
    """
    changes = []
    for flight in flights(layout.profile, _STAIR_M):
        mode = "SA" if flight.riser > 0 else "SD"
        changes.append(TerrainChange(s=flight.s, mode=mode, riser=flight.riser, tread=flight.tread))
        changes.append(TerrainChange(s=flight.end, mode="LG"))
    # strips of ground: z1 is the height at the end of one, z0 that at the begin of the next one
    for before, after in pairwise(layout.profile):
        if abs(after.z0 - before.z1) < _STAIR_M and after.slope != before.slope:
            changes.append(TerrainChange(s=after.s0, mode=mode_of(after), slope=after.slope))
    return sorted(changes, key=lambda change: change.s)


def score_approaches(
    landed: Sequence[Footprint],
    places: Array,
    estimates: Sequence[ModeEstimate],
    alignment: MovingAlignment,
    layout: Layout,
) -> list[ScoredChange]:
    """Scores the prediction of every terrain change that a foot landed beyond, `SCORED_AHEAD_S` before it landed.

    Args:
        landed: True footprints after the two initial ones, in order.
        places: (F,) their places along the route, m.
        estimates: Estimates in time order.
        alignment: From the odometry's world to the true one.
        layout: The true terrain.
    """
    t_ns = np.array([e.t_ns for e in estimates])
    landed_ns = np.array([f.t_ns for f in landed])
    scored = []
    for change in mode_changes(layout):
        # infinite if no foot landed beyond the change, which then is not scored
        scored_ns = scoring_time_ns(change.s, landed_ns, places)
        if not math.isfinite(scored_ns):
            continue
        last = int(np.searchsorted(t_ns, scored_ns, side="right")) - 1  # number of the last estimate up to then
        if last >= 0:
            scored.append(_score_change(change, estimates[last], alignment, layout))
        else:  # no estimate yet
            scored.append(ScoredChange(mode=change.mode, is_detected=False))
    return scored


def _score_change(
    change: TerrainChange, estimate: ModeEstimate, alignment: MovingAlignment, layout: Layout
) -> ScoredChange:
    """Errors of the next terrain change that an estimate predicts.

    The true change is found if the predicted one has its mode and lies within 0.4 m along the route; otherwise all
    errors are NaN. The error of a riser, a tread or a slope is NaN if the true change has no such size (it is 0 then).

    Args:
        change: The true change.
        estimate: The estimate that is scored.
        alignment: From the odometry's world to the true one.
        layout: The true terrain.
    """
    predicted = estimate.change
    if predicted is None or predicted.mode != change.mode:
        return ScoredChange(mode=change.mode, is_detected=False)
    heading = float(layout.way.heading(change.s))
    # (2,) m from the true place to the predicted one in the true world, of which the part along the route counts
    offset = alignment.point(estimate.t_ns, predicted.p_in_world) - layout.way.point(change.s)
    offset_m = float(offset @ [math.cos(heading), math.sin(heading)])
    if abs(offset_m) > _MATCH_M:
        return ScoredChange(mode=change.mode, is_detected=False)
    return ScoredChange(
        mode=change.mode,
        is_detected=True,
        distance_m=offset_m,
        distance_sd_m=predicted.distance_sd,
        riser_m=predicted.riser - change.riser if change.riser else math.nan,
        riser_sd_m=predicted.riser_sd,
        tread_m=predicted.tread - change.tread if change.tread else math.nan,
        tread_sd_m=predicted.tread_sd,
        slope_rad=predicted.slope - change.slope if change.slope else math.nan,
        slope_sd_rad=predicted.slope_sd,
    )
