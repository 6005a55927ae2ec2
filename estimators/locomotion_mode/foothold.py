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
from stridetwin.estimators.locomotion_mode.parameters import Settings
from stridetwin.estimators.locomotion_mode.rhythm import CLIMB, SIDE, STEP_DRIFT, StepFilter, StepLanding, usual_steps
from stridetwin.estimators.locomotion_mode.rollout import Chain, Likelihoods, mix_chains, moments, roll_out
from stridetwin.estimators.locomotion_mode.segments import (
    BEHIND_M,
    CLEARANCE_SD_M,
    MIN_FOOTHOLD_M,
    OCCLUDED_EDGE_SD_M,
    Segment,
    segment_under,
    surface_along,
)
from stridetwin.streams.samples import Array

_STRIDE = 3
"""Footprints of a stride: two steps have three."""
GRID_M = 0.03
"""Cell of the density over the next footprints."""
USUAL_HEIGHT_M = 1.3
"""Prior height of neck and waist over the ground."""
_LEAN_RAD = 0.032
"""ζ of docs/locomotion_mode.md (12): at touch-down the body is ahead of the middle between the feet by this share of
its height."""
_CLIMB_LEAN = 0.12
"""Additional lead uphill on a ramp, as a share of height and slope."""
_BODY_SD_M = 0.035
"""Standard deviation of that lead."""
_EDGE_AHEAD_M, _EDGE_AHEAD_SD_M = 0.05, 0.07
"""Distance of the foot ahead of the body after a step over an edge as long as a usual tread, and its deviation."""
_EDGE_AHEAD_SHARE = 0.35
"""Growth of that distance with the length of the step beyond a usual tread: 0.10 m over two treads at a time on five
walks of tuning seeds."""
_JOINED_AHEAD_M, _JOINED_AHEAD_SD_M = 0.13, 0.05
"""Distance of the body ahead of both feet after a step that joins them, and its standard deviation: 0.15 m up and
0.12 m down on five walks of tuning seeds."""
_TOP_SD_M = 0.035
"""Standard deviation of the body's rise over the stance foot, relative to level ground."""
_TOP_ASYMMETRY_SD_M, _TOP_DRIFT_M, _TOP_NOISE_M = 1e-3, 0.005, 0.01
"""Height of the body's top over a foot: standard deviation of half the difference between left and right, random walk
per step, and standard deviation of a single step."""
_MAX_HEIGHT_SD_M = 0.05
"""Largest standard deviation of a usable body height."""
_ADAPT_SD = 0.06
"""Relative standard deviation of the common change of all steps up to the next edge."""
_RAMP_STEP, _RAMP_STEP_SD = 0.80, 0.12
"""Prior ratio of step lengths on ramps to those on level ground, and its standard deviation."""
_CLIMB_SD = 0.06
"""Standard deviation of half the ratio's difference between uphill and downhill."""
_SHORT_STEPS, _SHORT_SHARE, _SHORT_NOISE = 0.05, 0.4, 0.6
"""Share of steps that are shorter than usual, in turns or pauses; their length as a share of a usual one; and standard
deviation as a share of that."""
_SHORT_SD = 1.0
"""Short steps are considered where the body is so many standard deviations behind the place that a usual step needs."""
_STANDING_SD_M, _WALKING_SD_M = 0.08, 0.25
"""Standard deviation of the first foot about the body, at the start and after a reset during the walk."""
_ROTATION_RAD = 0.2
"""From this rotation on, the foot's lateral position gives its position along the new path."""
_LATERAL_SD_M = 0.10
"""Lateral standard deviation of the foot from the body's path."""
_ROTATION_SD_RAD = 0.25
"""A step that rotates by more does not update the step statistics."""
_DOUBTFUL_CROSSING, _SURE_CROSSING = 0.5, 0.9
"""Probability that a step crossed an edge, up to which it is no evidence for a habit, and from which on it is a full
one; between them the evidence grows evenly. Tuned on turns before stairs."""
_ELEVATION_SD_M, _SLOPE_MATCH_SD_RAD = 0.01, 0.0175
"""Standard deviations of the map's height differences and slopes where an exoskeleton measured them."""
_LIKELIHOOD_FLOOR = 1e-3
"""Lower limit of a position's likelihood: the map may be wrong under the foot, and people duck."""
_MAX_TREADS = 6
"""Largest number of extrapolated treads."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredStep(StepEstimate):
    """A step as the exoskeleton's legs measured it.

    Attributes:
        length: Horizontal distance from the previous footprint along the path, m.
        length_sd: Standard deviation of `length`, m.
    """

    length: float
    length_sd: float


def measure_step(estimates: Sequence[StepEstimate]) -> MeasuredStep | None:
    """The last step measured by the legs, with its length along the whole stride; None if it is not fully known.

    The feet are side by side, so the length is the step's component along the displacement of two steps. It is unknown
    if a step between is missing or a value is not finite.

    Args:
        estimates: Estimates of the last steps in order, three at most.
    """
    if len(estimates) < _STRIDE or any(b.step != a.step + 1 for a, b in pairwise(estimates)):
        return None
    first, before, now = estimates[-_STRIDE:]  # the first and the last are a stride apart
    stride = (now.p_sole_in_world - first.p_sole_in_world)[:2]
    toward = stride / max(math.hypot(*stride.tolist()), 1e-9)
    length = float((now.p_sole_in_world - before.p_sole_in_world)[:2] @ toward)
    length_sd = math.sqrt(max(float(toward @ now.covariance[:2, :2] @ toward), 0.0))
    step = MeasuredStep(**vars(now), length=length, length_sd=length_sd)
    known = (step.length, step.length_sd, step.elevation, step.elevation_sd, step.slope, step.slope_sd)
    return step if all(map(math.isfinite, known)) else None


def step_likelihood(step: MeasuredStep, s: Array, ground: Sequence[Segment], before: Array) -> Array:
    """(S,) likelihood of each landing position given the measured step, about 1 at best.

    Product of normal densities of the differences in length, height and slope between map and legs, plus a floor.

    Args:
        step: The step as the legs measured it.
        s: (S,) m along the path.
        ground: Terrain segments along it.
        before: (S,) density of the previous footprint; sums to 1. It depends on the body's lean, which is the same at
            every step, so the length of the last step does not reduce that uncertainty.
    """
    height, slope, slope_sd = surface_along(ground, s)
    # mean and standard deviation of the previous footprint's height and position, m
    height_before, s_before = float(before @ height), float(before @ s)
    height_before_sd, s_before_sd = (
        math.sqrt(max(float(before @ (values - mean) ** 2), 0.0))
        for values, mean in ((height, height_before), (s, s_before))
    )
    differences = (  # (S,) each: of length, height and slope, in standard deviations
        (s - s_before - step.length) / math.hypot(s_before_sd, step.length_sd, _BODY_SD_M),
        (height - height_before - step.elevation) / math.hypot(height_before_sd, step.elevation_sd, _ELEVATION_SD_M),
        (slope - step.slope) / np.sqrt(slope_sd**2 + step.slope_sd**2 + _SLOPE_MATCH_SD_RAD**2),
    )
    return np.asarray(np.exp(-0.5 * sum(x**2 for x in differences)) + _LIKELIHOOD_FLOOR)


def extrapolate_ground(step: MeasuredStep, foot: float, p: Settings) -> list[Segment]:
    """Terrain segments of ground that was not observed, continued as the legs measured the last step.

    Stairs continue with equal treads, ramps with their slope, and other ground is level.

    Args:
        step: The measured step.
        foot: Position of the foot of that step, m along the path.
        p: Dimensions and standard deviations.
    """
    stairs = step.mode in ("SA", "SD")
    slope = 0.0 if stairs or step.mode == "LG" else step.slope
    slope_sd = math.hypot(p.mode.slope_sd_rad, step.slope_sd)
    tread = min(max(step.length, MIN_FOOTHOLD_M), p.map.max_tread_m)
    first_edge = foot + p.mode.toe_m + CLEARANCE_SD_M  # just ahead of the toes
    edges = [first_edge + k * tread for k in range(_MAX_TREADS)] if stairs else []
    bounds = [-math.inf, *edges, math.inf]  # m along the path; segment k is between bounds k and k + 1
    return [
        Segment(
            start=a,
            start_sd=OCCLUDED_EDGE_SD_M if k else 0.0,
            end=b,
            end_sd=OCCLUDED_EDGE_SD_M if k < len(edges) else 0.0,
            drop=step.elevation if k else 0.0,
            drop_sd=step.elevation_sd,
            slope=slope,
            slope_sd=slope_sd,
            mapped_slope=slope,
            mode=step.mode if step.mode in ("RA", "RD") else "LG",
        )
        for k, (a, b) in enumerate(pairwise(bounds))
    ]


class Arrival(NamedTuple):
    """Where the body is expected to be when the foot in the air lands.

    Attributes:
        s: Position of the body, m along the path.
        sd: Standard deviation of that position, m.
        height_m: Height of the body over the ground, m.
    """

    s: float
    sd: float
    height_m: float


class PathAhead(NamedTuple):
    """The path straight ahead.

    Attributes:
        origin: (2,) m, its start, `BEHIND_M` behind the body.
        forward: (2,) unit vector.
    """

    origin: Array
    forward: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class _Stance:
    """Density of the stance foot along a line in the world, jointly with the walker's habit.

    Attributes:
        line: The path on which the foot landed.
        s: (S,) m along it.
        density: (HABITS, 2, S) by habit, by whether the foot's step crossed an edge (no, yes), and by position; sums to
            1.
    """

    line: PathAhead
    s: Array
    density: Array

    def along(self, line: PathAhead, s: Array) -> Array:
        """(HABITS, 2, S) the density over the cells of another line, at s (S,), m along it; sums to 1.

        If the walker has hardly turned, positions are projected onto the new line; otherwise each part becomes a normal
        density there. If the foot is not on the new line's cells at all, its position is uniform.
        """
        angle = _angle_between(self.line.forward, line.forward)
        rows = self.density.reshape(-1, len(self.s))  # one per habit and kind of step
        if abs(angle) > _ROTATION_RAD:
            rows_on_line = [self._rotate_row(row, angle, line, s) for row in rows]
        else:
            # (S,) m along this line, of the new line's cells
            s_here = (line.origin - self.line.origin + s[:, None] * line.forward) @ self.line.forward
            rows_on_line = [np.interp(s_here, self.s, row, left=0.0, right=0.0) for row in rows]
        density = np.reshape(rows_on_line, (*self.density.shape[:-1], len(s)))
        total = float(density.sum())
        shares = self.density.sum(axis=-1, keepdims=True)  # (HABITS, 2, 1) probabilities without the position
        return density / total if total > 1e-9 else np.repeat(shares / len(s), len(s), axis=-1)

    def _rotate_row(self, row: Array, turn: float, line: PathAhead, s: Array) -> Array:
        """One row of the density over the cells of a line into which the walker has turned by a large angle.

        It becomes a normal density: the lateral uncertainty is now part of the position along the new line.

        Args:
            row: (S,) part of the density along this line, of one habit and kind of step.
            turn: Angle from this line to the new one, rad.
            line: The new line.
            s: (S,) m along it.

        Returns:
            (S,) the row over the new cells, with the sum that it had.
        """
        share = float(row.sum())
        mean, sd = moments(row / max(share, 1e-300), self.s)
        # place of the mean, m along the new line, and standard deviation along it
        new_mean = (self.line.origin + mean * self.line.forward - line.origin) @ line.forward
        new_sd = math.hypot(math.cos(turn) * sd, math.sin(turn) * _LATERAL_SD_M)
        return share * _normalize(_normal_density(s - new_mean, new_sd))


@dataclass(frozen=True, kw_only=True, eq=False)
class _LastLanding:
    """The last touch-down from camera and insoles; a later step estimate of the legs is combined with it.

    Attributes:
        stance: Joint density of the foot.
        before: (S,) density of the foot behind over the same cells.
        ground: Terrain segments along the line.
        mode: Mode of the ground under both feet; "" if it differs.
        even: Probability that neither an edge nor a rotation lay between them.
        length: Filter of the length of steps on level ground, before the update by this step.
        ramps: Filter of the ratio of steps on ramps to those on level ground, before that update.
    """

    stance: _Stance
    before: Array
    ground: Sequence[Segment]
    mode: str
    even: float
    length: StepFilter
    ramps: StepFilter


class FootholdEstimator:
    """Estimates the position of the stance foot and the step lengths.

    Args:
        settings: Priors of steps and habits, and the reach of the prediction.

    Attributes:
        s: (S,) m, centres of the cells along the path ahead; the first cell begins `BEHIND_M` behind the body.
        last_step: The last step as the legs measured it; None if they did not.
    """

    def __init__(self, settings: Settings) -> None:
        """Begins with an unknown walker who stands."""
        self._p = settings
        self._habits = Habits(settings)
        cells = round((BEHIND_M + settings.mode.reach_m) / GRID_M)
        self.s: Array = np.asarray(GRID_M * (np.arange(cells) + 0.5), float)
        self.reset(_STANDING_SD_M)

    def reset(self, sd_m: float = _WALKING_SD_M) -> None:
        """Resets to an unknown walker: the foot is then at the body, with the standard deviation `sd_m`, m."""
        self._length = usual_steps(self._p.mode.step_m, self._p)  # length of steps on level ground, m
        # greatest height of the body over a foot, m
        self._tall = StepFilter(USUAL_HEIGHT_M, USUAL_HEIGHT_M, _TOP_ASYMMETRY_SD_M, _TOP_DRIFT_M, _TOP_NOISE_M)
        # length of steps on ramps over that on level ground, uphill and downhill
        self._ramps = StepFilter(_RAMP_STEP, _RAMP_STEP_SD, _CLIMB_SD, STEP_DRIFT, self._p.mode.step_noise)
        self._stance: _Stance | None = None  # None: the foot's position follows from the body alone
        self._shares = self._habits.prior  # (HABITS,) probability of each habit, for when the position is lost
        self._sd_m = sd_m
        self._alike = 0  # steps in a row on ground of one mode
        self._straight = 1.0  # probability that the walker did not turn in the last step
        self._landed: _LastLanding | None = None  # None if the last step could not be measured
        self.last_step: MeasuredStep | None = None  # the last step as the legs measured it
        self._step_estimates: list[StepEstimate] = []  # the last step estimates of the legs

    def lose_position(self) -> None:
        """Handles a touch-down without a pose of the body: the foot's position becomes unknown."""
        self._stance, self._sd_m, self._alike = None, _WALKING_SD_M, 0

    @property
    def step_m(self) -> float:
        """Expected length of a step on even ground, m."""
        return self._length.mean()

    @property
    def step_sd_m(self) -> float:
        """Standard deviation of the expected step length on even ground, m."""
        return self._length.sd()

    def stance_density(self, line: PathAhead) -> Array:
        """(HABITS, 2, S) density of the stance foot over the cells of a line, jointly with the habit.

        By habit, by whether the foot's step crossed an edge (no, yes), and by position; sums to 1. Where the foot's
        position is unknown, it is a normal density about the body.
        """
        if self._stance is None:
            density = np.exp(-0.5 * ((self.s - BEHIND_M) / self._sd_m) ** 2)
            return self._habits.joint(density / density.sum(), self._shares)
        return self._stance.along(line, self.s)

    def after_passing(self, stance: Array, height: Array | None, top: float, drift_m: float = 0.0) -> Array:
        """Corrects the density of the stance foot once the body has passed over it.

        The body's greatest height is a leg's length over the foot, which tells treads apart: docs/locomotion_mode.md
        (12), second part. The density is unchanged while the walker's leg is not known well enough.

        Args:
            stance: (..., S) density before.
            height: (S,) m, height of the ground along the path; None: unknown.
            top: Greatest height of the body over the foot, m.
            drift_m: Standard deviation of the drift of the poses' height within a step, m.
        """
        sd = math.hypot(_TOP_SD_M, self._tall.sd(), drift_m)
        if height is None or sd > _MAX_HEIGHT_SD_M:
            return stance
        # (S,) difference of the body's height over the ground there from its usual one, in standard deviations
        off = (top - height - self._tall.mean()) / sd
        density = stance * (np.exp(-0.5 * off**2) + _LIKELIHOOD_FLOOR)
        return np.asarray(density / density.sum())

    def predict_footprints(
        self, stance: Array, ground: Sequence[Segment], feet: Sequence[str], arrival: Arrival | None = None
    ) -> Chain:
        """Predicts the next footprints from the density of the stance foot, mixed over the habits.

        Where the body will be behind the place that a usual step needs, the step may be a short one: people shorten
        single steps in turns, into pauses and after them. Both kinds are mixed by their likelihoods:
        docs/locomotion_mode.md (19).

        Args:
            stance: (HABITS, 2, S) density by habit, by whether the foot's step crossed an edge, and by position.
            ground: Terrain segments along the path.
            feet: `l` or `r` of each coming step.
            arrival: Where the body will be when the first of them lands; None: unknown, as while both are down.
        """
        groups = self._habits.group_by_steps(stance, ground)  # pairs: (2, S) part of the density, and its habit
        shares = np.array([part.sum() for part, _ in groups])
        if arrival is None or not feet[0]:
            return mix_chains([self._roll_out(part, ground, feet, habit) for part, habit in groups], shares)
        before, _ = moments(position(stance), self.s)
        landing = self._landing_likelihoods(before, arrival, ground)._replace(step=0)
        usual = [self._roll_out(part, ground, feet, habit, landing) for part, habit in groups]
        behind = before + 0.5 * self._length.mean() + _LEAN_RAD * arrival.height_m - arrival.s  # of a usual step, m
        if behind < _SHORT_SD * math.hypot(arrival.sd, _BODY_SD_M):
            return mix_chains(usual, shares)
        short = [self._roll_out(part, ground, feet, habit, landing, is_short=True) for part, habit in groups]
        evidence = np.array([chain.evidence for chain in (*usual, *short)])
        kinds = np.repeat([1.0 - _SHORT_STEPS, _SHORT_STEPS], len(groups))
        weights = kinds * np.maximum(evidence, 1e-300)
        return mix_chains([*usual, *short], weights)

    def _roll_out(
        self,
        stance: Array,
        ground: Sequence[Segment],
        feet: Sequence[str],
        habit: Habit,
        landing: Likelihoods | None = None,
        *,
        is_short: bool = False,
    ) -> Chain:
        """Chain of the coming steps for the part of the stance density that belongs to one habit.

        Args:
            stance: (2, S) that part, by whether the last step crossed an edge (no, yes).
            ground: Terrain segments along the path.
            feet: `l` or `r` of each coming step.
            habit: The habit.
            landing: Likelihoods of the position of one of the steps; None: unknown.
            is_short: Whether the first step is shorter than usual, by any part.
        """
        lengths = [self._length.mean(SIDE[foot]) for foot in feet]
        first_noise = None
        if is_short:
            lengths[0], first_noise = _SHORT_SHARE * lengths[0], _SHORT_NOISE
        # standard deviation common to all steps, m: of the estimated length, and of its change up to the next edge
        shared = math.hypot(self._length.sd(), _ADAPT_SD * self._length.mean())
        # by mode RA and RD: step length over that on level ground, and its standard deviation
        ratios = {mode: (self._ramps.mean(kind), self._ramps.sd(kind)) for mode, kind in CLIMB.items()}
        return roll_out(stance, self.s, ground, lengths, shared, ratios, self._p, habit, landing, first_noise)

    def _landing_likelihoods(
        self, before: float, body: Arrival, ground: Sequence[Segment], between: float = 0.0
    ) -> Likelihoods:
        """Likelihoods of a landing position given the body's position: docs/locomotion_mode.md (12).

        Args:
            before: Position of the foot behind, m along the path.
            body: Where the body is when the foot lands.
            ground: Terrain segments along the path.
            between: Length of the steps that were not detected since the foot behind landed, m.
        """
        ahead = self.s - body.s  # position relative to the body
        went = self.s - before - between  # (S,) length of the last step for each landing position, m
        # (S,) deviation of the foot from where the body implies it, after a step on even ground and over an edge, m
        off_even = ahead + self._body_lead(ground, body.height_m) - 0.5 * went
        off_over = ahead - _EDGE_AHEAD_M - _EDGE_AHEAD_SHARE * (went - self._p.mode.usual_tread_m)
        return Likelihoods(
            even=_normal_density(off_even, math.hypot(_BODY_SD_M, body.sd)),
            over=_normal_density(off_over, math.hypot(_EDGE_AHEAD_SD_M, body.sd)),
            beside=_normal_density(ahead + _JOINED_AHEAD_M, math.hypot(_JOINED_AHEAD_SD_M, body.sd)),
        )

    def land(
        self,
        landing: StepLanding,
        line: PathAhead,
        ground: Sequence[Segment],
        height: Array | None,
        body: float,
        top: float,
        floor: float,
        went_m: float | None,
        drift_m: float = 0.0,
    ) -> None:
        """Estimates where a foot has landed, and updates the step statistics.

        The walk from the foot behind is rolled out by one step, or by two if a landing was not detected. The body's
        position at touch-down tells where the foot is likely to be, differently after a step on even ground, over an
        edge, and one that joins the feet: docs/locomotion_mode.md (12).

        Args:
            landing: The touch-down.
            line: The path.
            ground: Terrain segments along it.
            height: (S,) m, height of the ground along it; None: unknown.
            body: Height of the body over the ground, m.
            top: Greatest height of the body since the previous touch-down, m.
            floor: Observed height of the ground under the foot behind, m; NaN if unobserved.
            went_m: Distance the body moved since the previous touch-down; None: unknown.
            drift_m: Standard deviation of the drift of the poses' height within a step, m.
        """
        stance = self.after_passing(self.stance_density(line), height, top, drift_m)
        last_forward = None if self._stance is None else self._stance.line.forward  # (2,) direction of the last step
        behind = position(stance)  # (S,) density of the foot behind
        before, _ = moments(behind, self.s)  # its mean position, m along the path
        # length of the steps that were not detected, m
        between = sum(self._length.mean(SIDE[foot]) for foot in landing.feet[:-1])
        likelihoods = self._landing_likelihoods(before, Arrival(BEHIND_M, 0.0, body), ground, between)
        chains = [
            self._roll_out(part, ground, landing.feet, habit, likelihoods)
            for part, habit in self._habits.each(self._habits.after_habit_change(stance))
        ]
        straight = 1.0  # probability that the walker has not turned since the last step
        if last_forward is not None:
            straight = math.exp(-0.5 * (_angle_between(last_forward, line.forward) / _ROTATION_SD_RAD) ** 2)
        self._shares = self._weigh_habits(stance, chains, min(straight, self._straight))
        self._straight = straight
        density = np.array([share * chain.last for share, chain in zip(self._shares, chains)])  # (HABITS, 2, S)
        self._stance = _Stance(line=line, s=self.s, density=density)
        self._landed = None
        if landing.measurable:
            self._learn(landing.feet[-1], self._stance, behind, chains, ground, straight, went_m)
            if (
                self._alike > 1 and math.isfinite(floor) and drift_m < _TOP_SD_M
            ):  # on even ground the body's top shows the leg's length
                self._tall.update(0.0, top - floor)

    def _weigh_habits(self, stance: Array, chains: Sequence[Chain], straight: float) -> Array:
        """(HABITS,) probability of each habit after a landing: docs/locomotion_mode.md (16).

        The likelihoods of the chains count as far as the step is evidence: not in a turn, where steps are short for
        another reason, nor where it is doubtful whether this step or the one before it crossed an edge.

        Args:
            stance: (HABITS, 2, S) density of the foot behind.
            chains: One step from the stance foot for each habit.
            straight: Probability that the walker has turned neither in this step nor in the one before it.
        """
        before = self._habits.after_habit_change(stance).sum(axis=(1, 2))
        after = _normalize(np.array([chain.evidence for chain in chains]))
        crossed_before = float(stance[:, 1].sum())
        crossed_now = float(after @ np.array([chain.last[1].sum() for chain in chains]))
        doubt = (_SURE_CROSSING - max(crossed_before, crossed_now)) / (_SURE_CROSSING - _DOUBTFUL_CROSSING)
        trust = straight * (1.0 - min(max(doubt, 0.0), 1.0))
        return np.asarray(trust * after + (1.0 - trust) * before / before.sum())

    def _learn(
        self,
        foot: str,
        now: _Stance,
        stance: Array,
        chains: Sequence[Chain],
        ground: Sequence[Segment],
        straight: float,
        went_m: float | None,
    ) -> None:
        """Updates the step statistics: a step on level ground updates all steps, a step on a ramp those on ramps.

        A step over an edge, and one that joins the other foot, updates none.

        Args:
            foot: Foot that has landed.
            now: Joint density of that foot.
            stance: (S,) density of the foot behind.
            chains: One step from the stance foot for each habit.
            ground: Terrain segments along the path.
            straight: Probability that the walker has not turned since the last step.
            went_m: Distance that the body moved during the step; None: unknown.
        """
        # mean and standard deviation of both feet's positions, m along the path
        before, before_sd = moments(stance, self.s)
        landing_s, landing_sd = moments(self._shares @ [chain.density[0] for chain in chains], self.s)
        sd = math.hypot(landing_sd, before_sd)
        # probability of a step over an edge, or of one that joins the other foot
        off_level = self._shares @ [float(chain.modes[0, 1] + chain.modes[0, 2] + chain.joined[0]) for chain in chains]
        # probability that the step is comparable to others; twice `off_level` is subtracted, so that a step that is as
        # likely off the level as on it updates nothing
        even = straight * (1.0 - min(1.0, 2.0 * float(off_level)))
        # the terrain segments under both feet
        segment_behind, segment_ahead = (ground[segment_under(ground, s, self._p)] for s in (before, landing_s))
        mode = segment_behind.mode if segment_behind.mode == segment_ahead.mode else ""
        self._landed = _LastLanding(
            stance=now,
            before=stance,
            ground=ground,
            mode=mode,
            even=even,
            length=copy(self._length),
            ramps=copy(self._ramps),
        )
        self._alike = self._alike + 1 if mode and even > 0.5 else 0
        length = landing_s - before
        if self._alike > 1 and went_m is not None:  # the body moves as far as the feet, and is known better
            length, sd = went_m, 0.5 * _BODY_SD_M
        self._update_length(foot, mode, length, sd, even)

    def _update_length(self, foot: str, mode: str, length: float, sd: float, even: float) -> None:
        """Updates the step length on ground of a mode; does nothing if the mode differs under the feet.

        Args:
            foot: `l` or `r`, the foot that has landed.
            mode: LG, RA or RD; "" if it differs under the feet.
            length: Length of the step, m.
            sd: Standard deviation of it, m.
            even: Probability that the step is comparable to others.
        """
        if mode == "LG":
            self._length.update(SIDE[foot], length, sd, even)
        elif mode:
            level = self._length.mean(SIDE[foot])
            self._ramps.update(CLIMB[mode], length / level, sd / level, even)

    def add_step(self, estimate: StepEstimate, foot: str, down_ns: int) -> bool:
        """Takes the legs' estimate of the step that ended with the last touch-down.

        It corrects the density of the foot that has landed, and repeats the update of the step lengths with the
        measured length in place of the camera's.

        Args:
            estimate: Estimate of the step; a later one of the same step replaces it.
            foot: Foot that touched down last.
            down_ns: Time of that touch-down.

        Returns:
            Whether it is the first usable estimate of that step; False also if it belongs to another step.
        """
        if not self._step_estimates or self._step_estimates[-1].step != estimate.step:  # of a new step
            self._step_estimates = [*self._step_estimates[-2:], estimate]
        self._step_estimates[-1] = estimate
        step, landed = measure_step(self._step_estimates), self._landed
        if step is None or step.foot != foot or estimate.t_ns < down_ns:  # not fully known, or not of this touch-down
            return False
        is_first = self.last_step is None or self.last_step.step != step.step
        self.last_step = step
        if landed is None:  # camera and insoles did not measure the step: nothing to correct
            return is_first
        stance = landed.stance
        density = stance.density * step_likelihood(step, self.s, landed.ground, landed.before)
        self._stance = replace(stance, density=density / density.sum())
        # back to before the camera's update by this step
        self._length, self._ramps = copy(landed.length), copy(landed.ramps)
        self._update_length(step.foot, landed.mode, step.length, step.length_sd, landed.even)
        return is_first

    def _body_lead(self, ground: Sequence[Segment], height_m: float) -> Array:
        """(S,) m, how far the body is ahead of the middle between the feet at touch-down, for each landing position.

        It is ζ H of docs/locomotion_mode.md (12): a share ζ, greater on the way up a ramp, of the body's height H over
        the ground, `height_m`.
        """
        lean = np.full(len(self.s), _LEAN_RAD)
        for segment in ground:
            if segment.mode == "RA":
                lean[(self.s >= segment.start) & (self.s < segment.end)] += _CLIMB_LEAN * segment.slope
        return np.asarray(height_m * lean)


def position(joint: Array) -> Array:
    """(S,) density of the foot's position alone: a joint density (HABITS, 2, S), summed over habit and kind of step."""
    return np.asarray(joint.sum(axis=(0, 1)))


def _angle_between(a: Array, b: Array) -> float:
    """Angle from one (2,) direction to another, rad, positive to the left."""
    return math.atan2(a[0] * b[1] - a[1] * b[0], a @ b)


def _normalize(density: Array) -> Array:
    """The density (S,) scaled to sum 1; uniform if it is zero."""
    total = density.sum()
    return density / total if total > 1e-9 else np.full(len(density), 1.0 / len(density))


def _normal_density(off: Array, sd: float) -> Array:
    """Normal density of offsets (S,) with a standard deviation, up to the factor 1/√(2π)."""
    return np.asarray(np.exp(-0.5 * (off / sd) ** 2) / sd, float)
