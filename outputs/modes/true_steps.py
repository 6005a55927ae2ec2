"""True steps: the predictions that belong to each, the modes that count as right for it, and the slope under it.

A footprint across a ramp's edge, on a slope just below that of a ramp, or beyond a riser of about the least height of a
stair may count as either of two modes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from stridetwin.estimators.locomotion_mode import ModeEstimate, StepPrediction
from stridetwin.outputs.terrain.changes import mode_of
from stridetwin.streams.samples import Footprint
from stridetwin.streams.terrain_truth import Layout

_JUST_LANDED_NS = 150_000_000  # largest delay, or lead, of a reported touch-down
_HEEL_M = 0.045  # distance of the heel behind the place of a footprint
_GENTLE_RAD = math.radians(3.49)
"""Building codes call a slope a ramp from 1:20 (2.9°) on; just below 3.5° either answer serves the walker."""
_LOW_RISER_M = (0.065, 0.075)
"""A stair begins at 70 mm (Zhao et al. 2023); within 5 mm of that, either answer serves the walker."""


def first_steps(
    footprints: Sequence[Footprint], estimates: Sequence[ModeEstimate]
) -> list[tuple[ModeEstimate, StepPrediction] | None]:
    """For each true step the first prediction after the previous foot had landed.

    Args:
        footprints: True footprints, in order; the two initial ones come first and are not steps.
        estimates: In time order.

    Returns:
        For each step the estimate and the step in it; None if there was no such prediction.
    """
    landed = footprints[2:]
    steps: list[tuple[ModeEstimate, StepPrediction] | None] = []
    for prediction in first_predictions(landed, predictions_by_step(landed, estimates)):
        if prediction is None:
            steps.append(None)
        else:
            estimate, k = prediction
            steps.append((estimate, estimate.steps[k]))
    return steps


def first_predictions(
    landed: Sequence[Footprint], by_step: Sequence[Sequence[tuple[ModeEstimate, int]]]
) -> list[tuple[ModeEstimate, int] | None]:
    """For each step the first estimate after the previous foot had landed that predicts it as the next one.

    Args:
        landed: The steps' true footprints, in order.
        by_step: Predictions of each step, see `predictions_by_step`.

    Returns:
        Estimate and index of the step in it; None for the first step and for steps without such an estimate.
    """
    first: list[tuple[ModeEstimate, int] | None] = [None for _ in landed]
    for i in range(1, len(landed)):
        # k is the index of the step in an estimate e: 0 for the next step
        candidates = ((e, k) for e, k in by_step[i] if k == 0 and e.t_ns > landed[i - 1].t_ns)
        first[i] = next(candidates, None)
    return first


def predictions_by_step(
    landed: Sequence[Footprint], estimates: Sequence[ModeEstimate]
) -> list[list[tuple[ModeEstimate, int]]]:
    """For each step the estimates before its touch-down that predict it, with the step's index in each.

    An insole reports a touch-down with a delay: an estimate in between still predicts the step that has landed. A
    touch-down that was guessed may be reported early: an estimate in between already predicts the other foot's step.

    Args:
        landed: The steps' true footprints, in order.
        estimates: In time order.

    Returns:
        For each step pairs of an estimate and the step's index in `ModeEstimate.steps`, in time order.
    """
    t_ns = np.array([f.t_ns for f in landed])
    # estimate.steps[k] predicts step first + k + offset, where `first` is the next true step; the offset is -1 if the
    # touch-down before is reported late (steps[0] has already landed and is skipped), and 1 if the next one is
    # reported early
    predictions: list[list[tuple[ModeEstimate, int]]] = [[] for _ in landed]
    for estimate in estimates:
        first = int(np.searchsorted(t_ns, estimate.t_ns, side="left"))
        next_foot = estimate.steps[0].foot if estimate.steps else ""
        late = early = False
        if first > 0 and estimate.t_ns - t_ns[first - 1] < _JUST_LANDED_NS:
            late = next_foot == landed[first - 1].foot
        if first < len(landed) and t_ns[first] - estimate.t_ns < _JUST_LANDED_NS:
            early = next_foot not in ("", landed[first].foot)
        offset = early - late  # 1, 0 or -1: True counts as 1
        for k in range(late, len(estimate.steps)):  # from 1 on if steps[0] has landed
            step = first + k + offset
            if step < len(landed):  # steps after the end of the walk have no truth
                predictions[step].append((estimate, k))
    return predictions


def alternative_modes(mode: str, from_to: tuple[float, float], layout: Layout, sole_m: float) -> tuple[str, ...]:
    """Modes other than the true one that a step between two places may count as.

    There are some if its footprint overlaps a ramp's edge, if the slope is too gentle for everyone to call it a ramp,
    or if the riser is too low for everyone to call it a stair. Otherwise the result is empty.

    Args:
        mode: True mode.
        from_to: Places of the previous footprint and of this one along the route, m.
        layout: The true terrain.
        sole_m: Length of the soles.
    """
    behind, s = from_to  # the walk goes forward: behind < s
    heel, toe = s - _HEEL_M, s + sole_m - _HEEL_M
    # strips of the ground reach from s0 to s1 along the route, and from the height z0 to z1
    gentle = any(p.s0 <= s < p.s1 and 0.0 < abs(p.slope) < _GENTLE_RAD for p in layout.profile)
    modes = ["LG"] if gentle and mode in ("RA", "RD") else []
    for before, after in pairwise(layout.profile):
        rise = after.z0 - before.z1
        # the step went over a riser of about the least height of a stair
        if behind < after.s0 <= s and _LOW_RISER_M[0] < abs(rise) < _LOW_RISER_M[1]:
            modes += [m for m in ("LG", "SA" if rise > 0 else "SD") if m != mode]
        # the sole lies across an edge at which the slope changes without a riser
        if abs(rise) < 1e-6 and after.slope != before.slope and heel < after.s0 < toe:
            modes += [m for m in (mode_of(before), mode_of(after)) if m != mode]
    return tuple(dict.fromkeys(modes))


def slope_under(s: float, layout: Layout, sole_m: float) -> float:
    """True slope of level ground or a ramp under a whole sole, rad; NaN on treads and across edges.

    Args:
        s: Place of the footprint along the route, m.
        layout: The true terrain.
        sole_m: Length of the sole, which reaches from `_HEEL_M` behind the place forward.
    """
    heel, toe = s - _HEEL_M, s + sole_m - _HEEL_M
    return next(
        (p.slope for p in layout.profile if p.terrain in ("level", "ramp") and p.s0 <= heel and toe <= p.s1), math.nan
    )
