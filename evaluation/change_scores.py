"""Scores of detected terrain changes: detection rate, errors of position and size.

A terrain change is a place on the route where the mode of the steps changes. It is scored 1.5 s before the first foot
lands beyond it (`asked_ns`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from stridetwin.estimators.locomotion_mode import ModeEstimate
from stridetwin.evaluation.alignment import Laid
from stridetwin.evaluation.truth import asked_ns, flights
from stridetwin.sim.world.route import Layout, Strip
from stridetwin.streams.samples import Array, Footprint

_STAIR_M = 0.07
_MATCH_M = 0.4


@dataclass(frozen=True, kw_only=True)
class ModeChange:
    """A place on the route where the mode of the steps changes.

    Attributes:
        s: m along the route.
        mode: Mode of the steps beyond it.
        riser: m, down negative; 0 if no stair begins.
        tread: m; 0 likewise.
        slope: rad; 0 if no ramp begins.
    """

    s: float
    mode: str
    riser: float = 0.0
    tread: float = 0.0
    slope: float = 0.0


@dataclass(frozen=True, kw_only=True)
class ScoredApproach:
    """A true terrain change, and its estimate when it was scored.

    Attributes:
        mode: Of the steps beyond it.
        found: Whether the next predicted change had this mode and lay within 0.4 m.
        distance_m: Estimated minus true position along the route, NaN if it was not found; likewise below.
        distance_sd_m: Reported by the estimator.
        riser_m: Estimated minus true.
        riser_sd_m: Reported by the estimator.
        tread_m: Estimated minus true.
        tread_sd_m: Reported by the estimator.
        slope_rad: Estimated minus true.
        slope_sd_rad: Reported by the estimator.
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


def mode_changes(layout: Layout) -> list[ModeChange]:
    """The terrain changes of a route, in order: stairs from the first edge to the last, ramps."""
    found = []
    for flight in flights(layout.profile, _STAIR_M):
        mode = "SA" if flight.riser > 0 else "SD"
        found.append(ModeChange(s=flight.s, mode=mode, riser=flight.riser, tread=flight.tread))
        found.append(ModeChange(s=flight.end, mode="LG"))
    for before, after in pairwise(layout.profile):
        if abs(after.z0 - before.z1) < _STAIR_M and after.slope != before.slope:
            found.append(ModeChange(s=after.s0, mode=mode_of(after), slope=after.slope))
    return sorted(found, key=lambda change: change.s)


def mode_of(strip: Strip) -> str:
    """Mode of the steps along a strip without edges."""
    return "LG" if strip.slope == 0 else "RA" if strip.slope > 0 else "RD"


def score_approaches(
    landed: Sequence[Footprint], places: Array, told: Sequence[ModeEstimate], laid: Laid, layout: Layout
) -> list[ScoredApproach]:
    """Every terrain change of a walk that a foot landed beyond, with its estimate.

    Args:
        landed: True footprints, in order.
        places: (F,) m, their positions along the route.
        told: Estimates in time order.
        laid: Alignment of the estimator's world with the true one.
        layout: The true terrain.
    """
    t_ns = np.array([e.t_ns for e in told])
    landed_ns = np.array([f.t_ns for f in landed])
    scored = []
    for change in mode_changes(layout):
        asked = asked_ns(change.s, landed_ns, places)
        at = int(np.searchsorted(t_ns, asked, side="right")) - 1
        if math.isfinite(asked):
            known = _approach(change, told[at], laid, layout) if at >= 0 else None
            scored.append(known or ScoredApproach(mode=change.mode, found=False))
    return scored


def _approach(change: ModeChange, estimate: ModeEstimate, laid: Laid, layout: Layout) -> ScoredApproach:
    found = estimate.change
    if found is None or found.mode != change.mode:
        return ScoredApproach(mode=change.mode, found=False)
    heading = float(layout.way.heading(change.s))
    beyond = laid.point(estimate.t_ns, found.p_in_world) - layout.way.point(change.s)
    off = float(beyond @ [math.cos(heading), math.sin(heading)])
    if abs(off) > _MATCH_M:
        return ScoredApproach(mode=change.mode, found=False)
    return ScoredApproach(
        mode=change.mode, found=True, distance_m=off, distance_sd_m=found.distance_sd,
        riser_m=found.riser - change.riser if change.riser else math.nan, riser_sd_m=found.riser_sd,
        tread_m=found.tread - change.tread if change.tread else math.nan, tread_sd_m=found.tread_sd,
        slope_rad=found.slope - change.slope if change.slope else math.nan, slope_sd_rad=found.slope_sd,
    )  # fmt: skip
