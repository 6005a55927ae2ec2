"""Position of the stance foot and the walker's step lengths, from the body's position and an exoskeleton's steps.

The camera observes the ground ahead; an exoskeleton measures length, height and slope of the last step. This corrects
the foot's position on the map, and replaces the map where there is none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from stridetwin.estimators.contact_terrain import StepEstimate
from stridetwin.estimators.locomotion_mode.habits import Habit, Habits
from stridetwin.estimators.locomotion_mode.parameters import LocomotionModeParameters
from stridetwin.estimators.locomotion_mode.rhythm import CLIMB, SIDE, Landing, StepFilter
from stridetwin.estimators.locomotion_mode.rollout import Chain, Likelihoods, mixed, moments, roll_out
from stridetwin.estimators.locomotion_mode.segments import Segment, segment_under, surface_along
from stridetwin.streams.samples import Array

_STRIDE = 3
"""Footprints per stride."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredStep(StepEstimate):
    """A step as the legs measured it.

    Attributes:
        length: Horizontal distance from the previous footprint along the path, m.
        length_sd: Standard deviation, m.
    """

    length: float
    length_sd: float


def measured_step(estimates: Sequence[StepEstimate]) -> MeasuredStep | None:
    """The last of some steps; None if a step between is missing or a value is unknown.

    The feet are side by side, so a step's length is its component along the whole stride.

    Args:
        estimates: Estimates of the last steps in order, three at most.
    """
    if len(estimates) < _STRIDE or any(b.step != a.step + 1 for a, b in pairwise(estimates)):
        return None
    first, before, now = estimates[-_STRIDE:]
    stride = (now.p_sole_in_world - first.p_sole_in_world)[:2]
    toward = stride / max(math.hypot(*stride.tolist()), 1e-9)
    length = float((now.p_sole_in_world - before.p_sole_in_world)[:2] @ toward)
    length_sd = math.sqrt(max(float(toward @ now.covariance[:2, :2] @ toward), 0.0))
    made = MeasuredStep(**vars(now), length=length, length_sd=length_sd)
    known = (made.length, made.length_sd, made.elevation, made.elevation_sd, made.slope, made.slope_sd)
    return made if all(map(math.isfinite, known)) else None


def step_likelihood(
    step: MeasuredStep, s: Array, ground: Sequence[Segment], before: Array, p: LocomotionModeParameters
) -> Array:
    """(S,) likelihood of each landing position given the measured step, about 1 at best.

    Args:
        step: The step as the legs measured it.
        s: (S,) m along the path.
        ground: Terrain segments along it.
        before: (S,) density of the previous footprint; sums to 1. It depends on the body's lean, which is the same at
            every step, so the length of the last step does not reduce that uncertainty.
        p: Standard deviations.
    """
    height, slope, slope_sd = surface_along(ground, s)
    high, far = float(before @ height), float(before @ s)
    high_sd, far_sd = (math.sqrt(max(float(before @ (v - m) ** 2), 0.0)) for v, m in ((height, high), (s, far)))
    off = (
        (s - far - step.length) / math.hypot(far_sd, step.length_sd, p.body_sd_m),
        (height - high - step.elevation) / math.hypot(high_sd, step.elevation_sd, p.elevation_sd_m),
        (slope - step.slope) / np.sqrt(slope_sd**2 + step.slope_sd**2 + p.slope_match_sd_rad**2),
    )
    return np.asarray(np.exp(-0.5 * sum(x**2 for x in off)) + p.likelihood_floor)


def extrapolated(step: MeasuredStep, foot: float, p: LocomotionModeParameters) -> list[Segment]:
    """Extrapolates the measured ground where it was not observed: equal treads, the same slope, or level ground.

    The foot of the last step is at `foot`, m along the path.
    """
    stairs = step.mode in ("SA", "SD")
    slope = 0.0 if stairs or step.mode == "LG" else step.slope
    slope_sd = math.hypot(p.slope_sd_rad, step.slope_sd)
    tread = min(max(step.length, p.tread_min_m), p.tread_max_m)
    first = foot + p.toe_m + p.clearance_sd_m
    edges = [first + k * tread for k in range(p.treads_max)] if stairs else []
    bounds = [-math.inf, *edges, math.inf]
    return [
        Segment(
            start=a, start_sd=p.occluded_edge_sd_m if k else 0.0,
            end=b, end_sd=p.occluded_edge_sd_m if k < len(edges) else 0.0,
            drop=step.elevation if k else 0.0, drop_sd=step.elevation_sd, slope=slope, slope_sd=slope_sd,
            mapped_slope=slope, mode=step.mode if step.mode in ("RA", "RD") else "LG",
        )
        for k, (a, b) in enumerate(pairwise(bounds))
    ]  # fmt: skip


class Line(NamedTuple):
    """The path straight ahead.

    Attributes:
        origin: (2,) m, its start, `behind_m` behind the body.
        forward: (2,) unit vector.
    """

    origin: Array
    forward: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class _Stance:
    """Joint density of the stance foot (see `Habits`) along a line in the world, offset by the usual lateral width."""

    line: Line
    s: Array
    density: Array

    def along(self, line: Line, s: Array, p: LocomotionModeParameters) -> Array:
        """Joint density over the cells of another line."""
        turn = _turn(self.line.forward, line.forward)
        rows = self.density.reshape(-1, len(self.s))
        if abs(turn) > p.rotation_rad:
            made = [self._turned(row, turn, line, s, p) for row in rows]
        else:
            old = (line.origin - self.line.origin + s[:, None] * line.forward) @ self.line.forward
            made = [np.interp(old, self.s, row, left=0.0, right=0.0) for row in rows]
        density = np.reshape(made, (*self.density.shape[:-1], len(s)))
        total = float(density.sum())
        shares = self.density.sum(axis=-1, keepdims=True)
        return density / total if total > 1e-9 else np.repeat(shares / len(s), len(s), axis=-1)

    def _turned(self, row: Array, turn: float, line: Line, s: Array, p: LocomotionModeParameters) -> Array:
        """(S,) part of the density on a line that turns by an angle, rad: the lateral position matters."""
        share = float(row.sum())
        mean, sd = moments(row / max(share, 1e-300), self.s)
        at = (self.line.origin + mean * self.line.forward - line.origin) @ line.forward
        across = math.hypot(math.cos(turn) * sd, math.sin(turn) * p.lateral_sd_m)
        return share * _normed(_normal(s - at, across))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Landed:
    """The last touch-down from camera and insoles; a later step estimate of the legs is combined with it.

    Attributes:
        stance: Joint density of the foot.
        before: (S,) density of the foot behind over the same cells.
        ground: Terrain segments along the line.
        mode: Mode of the ground under both feet; "" if it differs.
        even: Probability that neither an edge nor a rotation lay between them.
        length, ramps: Step length filters before the update by this step.
    """

    stance: _Stance
    before: Array
    ground: Sequence[Segment]
    mode: str
    even: float
    length: StepFilter
    ramps: StepFilter


class Foothold:
    """Estimates the position of the stance foot and the step lengths.

    Args:
        parameters: One set serves everyone.
    """

    def __init__(self, parameters: LocomotionModeParameters) -> None:
        self._p = p = parameters
        self._habits = Habits(p)
        self.s: Array = np.asarray(p.grid_m * (np.arange(round((p.behind_m + p.reach_m) / p.grid_m)) + 0.5), float)
        self.reset(p.standing_sd_m)

    def reset(self, sd_m: float | None = None) -> None:
        """Resets: the walker is unknown, and the foot's position follows from the body alone."""
        p = self._p
        shares = p.step_sd, p.asymmetry_sd, p.step_drift, p.step_noise
        self._length = StepFilter(p.step_m, *(share * p.step_m for share in shares), outlier_sd=p.outlier_sd)
        top = p.usual_height_m, p.usual_height_m, p.top_asymmetry_sd_m, p.top_drift_m, p.top_noise_m
        self._tall = StepFilter(*top, outlier_sd=p.outlier_sd)  # top of the body over a foot, m
        self._ramps = StepFilter(
            p.ramp_step, p.ramp_step_sd, p.climb_sd, p.step_drift, p.step_noise, outlier_sd=p.outlier_sd
        )
        self._stance: _Stance | None = None
        self._shares = self._habits.prior  # (HABITS,) probability of each habit, for when the position is lost
        self._sd_m = p.walking_sd_m if sd_m is None else sd_m
        self._alike = 0  # steps in a row on ground of one mode
        self._landed: _Landed | None = None
        self.last_step: MeasuredStep | None = None  # the last step as the legs measured it
        self._step_estimates: list[StepEstimate] = []  # the last step estimates of the legs

    def lose_position(self) -> None:
        """Handles a touch-down at an unknown position."""
        self._stance, self._sd_m, self._alike = None, self._p.walking_sd_m, 0

    @property
    def step_m(self) -> float:
        """Expected length of a step on even ground, m."""
        return self._length.mean

    @property
    def step_sd_m(self) -> float:
        """Its standard deviation, m."""
        return self._length.sd

    def standing(self, line: Line) -> Array:
        """Joint density of the stance foot over the cells of a line, see `Habits`."""
        if self._stance is None:
            density = np.exp(-0.5 * ((self.s - self._p.behind_m) / self._sd_m) ** 2)
            return self._habits.joint(density / density.sum(), self._shares)
        return self._stance.along(line, self.s, self._p)

    def after_passing(self, stance: Array, height: Array | None, top: float) -> Array:
        """Density of the stance foot once the body has passed over it: it is a leg's length below the body's top.

        Args:
            stance: (..., S) density before.
            height: (S,) m, height of the ground along the path; None: unknown.
            top: Greatest height of the body over the foot, m.
        """
        sd = math.hypot(self._p.top_sd_m, self._tall.sd)
        if height is None or sd > self._p.height_sd_m:
            return stance
        density = stance * (np.exp(-0.5 * ((top - height - self._tall.mean) / sd) ** 2) + self._p.likelihood_floor)
        return np.asarray(density / density.sum())

    def rolled(self, stance: Array, ground: Sequence[Segment], feet: Sequence[str]) -> Chain:
        """The next footprints from the joint density of the stance foot; see `Habits` and `roll_out`."""
        groups = self._habits.that_differ(stance, ground)
        chains = [self._rolled(part, ground, feet, habit) for part, habit in groups]
        return mixed(chains, np.array([part.sum() for part, _ in groups]))

    def _rolled(
        self, stance: Array, ground: Sequence[Segment], feet: Sequence[str], habit: Habit,
        landing: Likelihoods | None = None,
    ) -> Chain:  # fmt: skip
        lengths = [self._length.of(SIDE[foot]) for foot in feet]
        shared = math.hypot(self._length.sd, self._p.adapt_sd * self._length.mean)
        ratios = {mode: (self._ramps.of(kind), self._ramps.sd_of(kind)) for mode, kind in CLIMB.items()}
        return roll_out(stance, self.s, ground, lengths, shared, ratios, self._p, habit, landing)

    def land(
        self, landing: Landing, line: Line, ground: Sequence[Segment], height: Array | None, body: float, top: float,
        floor: float, went_m: float | None,
    ) -> None:  # fmt: skip
        """Estimates where a foot has landed, and updates the step statistics.

        See docs/locomotion_mode.md (12).

        Args:
            landing: The touch-down.
            line: The path.
            ground: Terrain segments along it.
            height: (S,) m, height of the ground along it; None: unknown.
            body: Height of the body over the ground, m.
            top: Greatest height of the body since the previous touch-down, m.
            floor: Observed height of the ground under the foot behind, m; NaN if unobserved.
            went_m: Distance the body moved since the previous touch-down; None: unknown.
        """
        p, stance = self._p, self.after_passing(self.standing(line), height, top)
        came = None if self._stance is None else self._stance.line.forward
        behind = position(stance)
        before, _ = moments(behind, self.s)
        between = sum(self._length.of(SIDE[foot]) for foot in landing.feet[:-1])
        ahead = self.s - p.behind_m  # position relative to the body
        went = self.s - before - between
        even = ahead + self._leaning(ground, body) - 0.5 * went
        over = ahead - p.edge_ahead_m - p.edge_ahead_share * (went - p.tread_m)
        likelihoods = Likelihoods(
            even=_normal(even, p.body_sd_m), over=_normal(over, p.edge_ahead_sd_m),
            beside=_normal(ahead + p.joined_ahead_m, p.joined_ahead_sd_m),
        )  # fmt: skip
        chains = [
            self._rolled(part, ground, landing.feet, habit, likelihoods)
            for part, habit in self._habits.each(self._habits.changed(stance))
        ]
        self._shares = _normed(np.array([chain.evidence for chain in chains]))
        density = np.array([share * chain.last for share, chain in zip(self._shares, chains)])
        self._stance = _Stance(line=line, s=self.s, density=density)
        self._landed = None
        if landing.measurable:
            straight = (
                1.0 if came is None else math.exp(-0.5 * (_turn(came, line.forward) / self._p.rotation_sd_rad) ** 2)
            )
            self._learn(landing.feet[-1], self._stance, behind, chains, ground, straight, went_m)
            if self._alike > 1 and math.isfinite(floor):
                self._tall.update(0.0, top - floor)

    def _learn(
        self, foot: str, now: _Stance, stance: Array, chains: Sequence[Chain], ground: Sequence[Segment],
        straight: float, went_m: float | None,
    ) -> None:  # fmt: skip
        """Updates the step statistics: a step on level ground updates all steps, a step on a ramp those on ramps.

        A step over an edge, and one that joins the other foot, updates none.
        """
        before, before_sd = moments(stance, self.s)
        made, made_sd = moments(self._shares @ [chain.density[0] for chain in chains], self.s)
        sd = math.hypot(made_sd, before_sd)
        other = self._shares @ [float(chain.modes[0, 1] + chain.modes[0, 2] + chain.joined[0]) for chain in chains]
        even = straight * (1.0 - min(1.0, 2.0 * float(other)))
        here, there = (ground[segment_under(ground, s, self._p)] for s in (before, made))
        mode = here.mode if here.mode == there.mode else ""
        self._landed = _Landed(
            stance=now, before=stance, ground=ground, mode=mode, even=even,
            length=copy(self._length), ramps=copy(self._ramps),
        )  # fmt: skip
        self._alike = self._alike + 1 if mode and even > 0.5 else 0
        length = made - before
        if self._alike > 1 and went_m is not None:  # the body moves as far as the feet, and is known better
            length, sd = went_m, 0.5 * self._p.body_sd_m
        self._lengthen(foot, mode, length, sd, even)

    def _lengthen(self, foot: str, mode: str, length: float, sd: float, even: float) -> None:
        """Updates the step length (m) on ground of a mode; does nothing if the mode differs under the feet."""
        if mode == "LG":
            self._length.update(SIDE[foot], length, sd, even)
        elif mode:
            level = self._length.of(SIDE[foot])
            self._ramps.update(CLIMB[mode], length / level, sd / level, even)

    def add_step(self, estimate: StepEstimate, foot: str, down_ns: int) -> bool:
        """Takes the legs' estimate of the step that ended with the last touch-down; returns whether it is the first.

        Args:
            estimate: Estimate of the step.
            foot: Foot that touched down last.
            down_ns: Time of that touch-down.
        """
        if not self._step_estimates or self._step_estimates[-1].step != estimate.step:
            self._step_estimates = [*self._step_estimates[-2:], estimate]
        self._step_estimates[-1] = estimate
        step, landed = measured_step(self._step_estimates), self._landed
        if step is None or step.foot != foot or estimate.t_ns < down_ns:
            return False
        first, self.last_step = self.last_step is None or self.last_step.step != step.step, step
        if landed is None:
            return first
        stance = landed.stance
        density = stance.density * step_likelihood(step, self.s, landed.ground, landed.before, self._p)
        self._stance = replace(stance, density=density / density.sum())
        self._length, self._ramps = copy(landed.length), copy(landed.ramps)
        self._lengthen(step.foot, landed.mode, step.length, step.length_sd, landed.even)
        return first

    def _leaning(self, ground: Sequence[Segment], height_m: float) -> Array:
        """(S,) m, how far the body is ahead of the middle between the feet at touch-down, by landing position."""
        p, lean = self._p, np.full(len(self.s), self._p.lean_rad)
        for segment in ground:
            if segment.mode == "RA":
                lean[(self.s >= segment.start) & (self.s < segment.end)] += p.climb_lean * segment.slope
        return np.asarray(height_m * lean)


def position(joint: Array) -> Array:
    """(S,) density of the foot's position of a joint density, see `Habits`."""
    return np.asarray(joint.sum(axis=(0, 1)))


def _turn(one: Array, other: Array) -> float:
    """Angle from one (2,) direction to another, rad."""
    return math.atan2(one[0] * other[1] - one[1] * other[0], one @ other)


def _normed(density: Array) -> Array:
    """Normalised to sum 1; uniform if all zero."""
    total = density.sum()
    return density / total if total > 1e-9 else np.full(len(density), 1.0 / len(density))


def _normal(off: Array, sd: float) -> Array:
    """A normal density, up to a common factor."""
    return np.asarray(np.exp(-0.5 * (off / sd) ** 2) / sd, float)
