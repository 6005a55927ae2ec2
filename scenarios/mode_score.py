"""Predicted steps beside the true footprints: mode right or not, how long before, how far off.

The true mode of a step is that of the ground from the footprint before to its own (`Footprint.mode`). A prediction
counts at the last update before its foot touches down; its lead is how long before that it became right and stayed so.
A footprint whose sole lies across a ramp's edge may count as either of its two modes; the strict figure lets nothing
pass.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from stridetwin.estimators.locomotion_mode import MODES, ModeEstimate, StepPrediction
from stridetwin.scenarios.change_score import ScoredApproach, mode_of, score_approaches
from stridetwin.scenarios.footprints import along_way
from stridetwin.scenarios.laying import Laid
from stridetwin.sim.route import Layout
from stridetwin.streams.samples import Footprint

_JUST_LANDED_NS = 150_000_000
_HEEL_M = 0.045


@dataclass(frozen=True, kw_only=True)
class ScoredMode:
    """A true step and what was told of it before.

    Attributes:
        t_s: Touch-down, s.
        mode: True mode.
        before: True mode of the step before.
        told: The last mode told before touch-down; "" where nothing was.
        allowed: Modes that count as right.
        lead_s: How long before touch-down the told mode had become right for good, 0 where it was wrong.
        probabilities: Of `MODES`, as last told.
        forward_m: Predicted footprint less the true one along the way, when the foot before it had just landed; NaN
            where none was told.
        left_m: Likewise across.
        length_m: How far the true footprint lies from the one before, ahead or aside.
    """

    t_s: float
    mode: str
    before: str
    told: str
    allowed: tuple[str, ...]
    lead_s: float
    probabilities: tuple[float, ...] = ()
    forward_m: float = math.nan
    left_m: float = math.nan
    length_m: float = math.nan

    @property
    def right(self) -> bool:
        """Whether the told mode counts as right."""
        return self.told in self.allowed

    @property
    def strictly_right(self) -> bool:
        """Whether it is the true mode."""
        return self.told == self.mode

    @property
    def transition(self) -> bool:
        """Whether the mode is another than that of the step before."""
        return self.mode != self.before

    @property
    def straddles(self) -> bool:
        """Whether the sole lies across a ramp's edge."""
        return len(self.allowed) > 1


@dataclass(frozen=True, kw_only=True, eq=False)
class ModeScores:
    """One walk.

    Attributes:
        steps: In order.
        approaches: The changes of the ground, in order of the way.
    """

    steps: list[ScoredMode] = field(default_factory=list)
    approaches: list[ScoredApproach] = field(default_factory=list)

    @classmethod
    def of(cls, rows: Mapping[str, Any]) -> ModeScores:
        """From what `rows` gave, through JSON."""
        steps = [_known(row) for row in rows["steps"]]
        for row in steps:
            row.update({name: tuple(row[name]) for name in ("allowed", "probabilities")})
        return cls(
            steps=[ScoredMode(**row) for row in steps],
            approaches=[ScoredApproach(**_known(row)) for row in rows["approaches"]],
        )

    def rows(self) -> dict[str, list[dict[str, Any]]]:
        """`steps` and `approaches` for JSON; NaN is null."""
        return {"steps": [_row(s) for s in self.steps], "approaches": [_row(a) for a in self.approaches]}


def _row(scored: ScoredMode | ScoredApproach) -> dict[str, Any]:
    return {k: (None if isinstance(v, float) and math.isnan(v) else v) for k, v in asdict(scored).items()}


def _known(row: Mapping[str, Any]) -> dict[str, Any]:
    return {k: math.nan if v is None else v for k, v in row.items()}


def score_modes(
    footprints: Sequence[Footprint], told: Sequence[ModeEstimate], laid: Laid, layout: Layout | None, sole_m: float
) -> ModeScores:
    """Every true step and every change of a walk, with what was told of it.

    Args:
        footprints: Of the truth, in order; those of the feet that stand at the start come first.
        told: Estimates in order of time.
        laid: Lays the estimator's world over the true one.
        layout: Of the ground; None: nothing straddles and no change is scored.
        sole_m: Length of the soles.
    """
    landed = footprints[2:]
    by_step = told_by_step(landed, told)
    first = _first_told(landed, by_step)
    straddled: list[tuple[str, ...]] = [() for _ in landed]
    approaches: list[ScoredApproach] = []
    if layout is not None:
        places = along_way([f.p_foot_in_world for f in footprints], layout)[2:]
        straddled = [_straddled(f.mode, s, layout, sole_m) for f, s in zip(landed, places)]
        approaches = score_approaches(landed, places, told, laid, layout)
    steps = []
    before = "LG"
    for i, print_ in enumerate(landed):
        allowed = (print_.mode, *straddled[i])
        own = by_step[i]
        last = own[-1] if own else None
        wrong = [e.t_ns for e, k in own if e.steps[k].mode not in allowed]
        since = [e.t_ns for e, k in own if not wrong or e.t_ns > wrong[-1]]
        forward, left = _miss(print_, first[i], laid)
        steps.append(
            ScoredMode(
                t_s=print_.t_ns * 1e-9, mode=print_.mode, before=before, allowed=allowed,
                told=last[0].steps[last[1]].mode if last else "",
                lead_s=(print_.t_ns - since[0]) * 1e-9 if since else 0.0,
                probabilities=tuple(last[0].steps[last[1]].probabilities[m] for m in MODES) if last else (),
                forward_m=forward, left_m=left,
                length_m=float(np.linalg.norm((print_.p_foot_in_world - footprints[i + 1].p_foot_in_world)[:2])),
            )
        )  # fmt: skip
        before = print_.mode
    return ModeScores(steps=steps, approaches=approaches)


def first_steps(
    footprints: Sequence[Footprint], told: Sequence[ModeEstimate]
) -> list[tuple[ModeEstimate, StepPrediction] | None]:
    """For each true step what was first told of it once the foot before it had landed; None where nothing was.

    Args:
        footprints: As of `score_modes`; those that stand at the start are no steps.
        told: Likewise.
    """
    landed = footprints[2:]
    first = _first_told(landed, told_by_step(landed, told))
    return [None if one is None else (one[0], one[0].steps[one[1]]) for one in first]


def _first_told(
    landed: Sequence[Footprint], by_step: Sequence[Sequence[tuple[ModeEstimate, int]]]
) -> list[tuple[ModeEstimate, int] | None]:
    """Of each step the first estimate that tells it as the next one."""
    found: list[tuple[ModeEstimate, int] | None] = [None for _ in landed]
    for i in range(1, len(landed)):
        asked = ((e, k) for e, k in by_step[i] if k == 0 and e.t_ns > landed[i - 1].t_ns)
        found[i] = next(asked, None)
    return found


def told_by_step(landed: Sequence[Footprint], told: Sequence[ModeEstimate]) -> list[list[tuple[ModeEstimate, int]]]:
    """For each step the estimates before its touch-down that tell of it, and under which number.

    An insole tells of a touch-down a little after it: an estimate in between still waits for the foot that is there. A
    touch-down that was guessed may be told a little before it: an estimate in between waits for the other foot already.
    """
    t_ns = np.array([f.t_ns for f in landed])
    found: list[list[tuple[ModeEstimate, int]]] = [[] for _ in landed]
    for estimate in told:
        first = int(np.searchsorted(t_ns, estimate.t_ns, side="left"))
        next_foot = estimate.steps[0].foot if estimate.steps else ""
        late = early = False
        if first > 0 and estimate.t_ns - t_ns[first - 1] < _JUST_LANDED_NS:
            late = next_foot == landed[first - 1].foot
        if first < len(landed) and t_ns[first] - estimate.t_ns < _JUST_LANDED_NS:
            early = next_foot not in ("", landed[first].foot)
        shift = early - late
        for k in range(late, len(estimate.steps)):
            if first + k + shift < len(landed):
                found[first + k + shift].append((estimate, k))
    return found


def _straddled(mode: str, s: float, layout: Layout, sole_m: float) -> tuple[str, ...]:
    """Other modes that a footprint at an arc length, across a ramp's edge, may count as."""
    heel, toe = s - _HEEL_M, s + sole_m - _HEEL_M
    found = []
    for before, after in pairwise(layout.profile):
        if abs(after.z0 - before.z1) < 1e-6 and after.slope != before.slope and heel < after.s0 < toe:
            found += [m for m in (mode_of(before), mode_of(after)) if m != mode]
    return tuple(found)


def _miss(print_: Footprint, told: tuple[ModeEstimate, int] | None, laid: Laid) -> tuple[float, float]:
    """Error of the footprint as it was first told as the next one, forward and left, m."""
    if told is None:
        return math.nan, math.nan
    estimate, k = told
    p = laid.point(estimate.t_ns, estimate.steps[k].p_foot_in_world[:2])
    w, x, y, z = print_.q_world_foot
    forward = np.array([1.0 - 2.0 * (y * y + z * z), 2.0 * (w * z + x * y)])
    forward /= np.linalg.norm(forward)
    off = p - print_.p_foot_in_world[:2]
    return float(off @ forward), float(off @ [-forward[1], forward[0]])
