"""How a walker uses stairs: one foot per tread, both feet on each, two treads at a time, or steps by their length.

The walker has one of these habits, and changes it from time to time. The habit is part of the stance foot's density:
often only the body's height over the foot shows where the last step went, and then it shows the habit as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from stridetwin.estimators.locomotion_mode.parameters import Settings
from stridetwin.estimators.locomotion_mode.segments import Segment, edges_before
from stridetwin.streams.samples import Array

HABITS = 4
"""In order: both feet on each tread; steps by their length; one foot per tread; two treads at a time on the way up."""

_BOTH, _BY_LENGTH, _ONE, _TWO = range(HABITS)
"""Index of each habit in arrays (HABITS,)."""
_JOINERS, _TWO_AT_A_TIME = 0.1, 0.03
"""Share of walkers who put both feet on each tread, and of those who take two treads at a time on the way up.

Twice the first: for such walkers the mode of steps is more certain, for all others less. Twice the second: footprints
on stairs are slightly less certain for all others.
"""
_ONE_PER_TREAD = 0.5
"""Share of all others who never set a second foot on a tread, however deep. Doubled: nothing on treads of 0.3 m."""
_JOINER_JOINS, _OTHER_JOINS = 0.97, 0.005
"""q of docs/locomotion_mode.md (14), for walkers who put both feet on each tread, and for all others."""
_HABIT_CHANGE = 0.05
"""c of docs/locomotion_mode.md (13): probability that the walker chooses anew, at each step."""
_AGAINST_HABIT = 0.003
"""γ of docs/locomotion_mode.md (15): weight of a step that walkers of a habit hardly ever take."""
_SKIP = 0.01
"""Probability that a step takes one more tread than usual."""
_MIN_SHARE = 0.01
"""A less probable habit does not affect predictions."""
_TWO_PACES_M = 0.40
"""Shallowest tread with room for a second step."""
_ONE_PACE_M = 0.65
"""Deepest tread that walkers cross in one pace."""


@dataclass(frozen=True, kw_only=True)
class Habit:
    """How walkers of one habit, or of several habits together, take their steps.

    Attributes:
        joins: Probability that the next foot joins the stance foot on its tread, given that this one's step crossed an
            edge; and likewise that each later foot joins the one before it.
        one_per_tread: Whether a foot hardly ever goes on on the tread of the other one.
        treads: Edges that a step usually crosses on the way up.
    """

    joins: tuple[float, float] = (0.0, 0.0)
    one_per_tread: bool = False
    treads: int = 1

    @property
    def is_usual(self) -> bool:
        """Whether steps follow from their length alone, except for those that join."""
        return not self.one_per_tread and self.treads == 1


class Habits:
    """Probabilities of the habits.

    A joint density (HABITS, 2, S) is over the habit, over whether the last step crossed an edge (no, yes) and over the
    stance foot's position; it sums to 1. Only after a step over an edge can the other foot join this one.

    See docs/locomotion_mode.md (13).

    Args:
        settings: Give the lowest step that is an edge.
    """

    def __init__(self, settings: Settings) -> None:
        """Sets the shares of walkers with each habit, and how probably such a walker joins the feet on a tread."""
        self._min_step_height_m = settings.min_step_height_m
        # (HABITS,) share of walkers with each habit, and probability q that such a walker joins the feet on a tread
        other_share = 1.0 - _JOINERS - _TWO_AT_A_TIME
        self.prior: Array = np.empty(HABITS)
        self.prior[_BOTH], self.prior[_TWO] = _JOINERS, _TWO_AT_A_TIME
        self.prior[_ONE], self.prior[_BY_LENGTH] = other_share * _ONE_PER_TREAD, other_share * (1.0 - _ONE_PER_TREAD)
        self.chances: Array = np.full(HABITS, _OTHER_JOINS)
        self.chances[_BOTH] = _JOINER_JOINS

    def joint(self, density: Array, habits: Array) -> Array:
        """(HABITS, 2, S) joint density of a foot whose step crossed no edge.

        Args:
            density: (S,) of the foot's position.
            habits: (HABITS,) probabilities.
        """
        return np.stack([habits[:, None] * density, np.zeros((HABITS, len(density)))], axis=1)

    def after_habit_change(self, joint: Array) -> Array:
        """Joint density (HABITS, 2, S) after the walker may have changed the habit: docs/locomotion_mode.md (13).

        At each step the walker chooses anew, with the probability `_HABIT_CHANGE`, among the habits by the share of
        walkers who have them. So what was seen on one stair is slowly forgotten on level ground.
        """
        change = _HABIT_CHANGE
        return np.asarray((1.0 - change) * joint + change * self.prior[:, None, None] * joint.sum(axis=0))

    def each(self, joint: Array) -> list[tuple[Array, Habit]]:
        """Splits a joint density by habit: for each one its part, (2, S), and what the habit does."""
        return [(part, self._mean_habit(joint, [habit])) for habit, part in enumerate(joint)]

    def group_by_steps(self, joint: Array, ground: Sequence[Segment]) -> list[tuple[Array, Habit]]:
        """Groups of habits by their steps on this ground: (2, S) part of the joint density, and the group's habit.

        Habits whose steps differ at most by joining form one group. Other habits are a group each, and left out if
        improbable. One foot per tread differs only where a tread has room for a second step; two treads at a time
        differs only where two edges in a row lead up.

        Args:
            joint: (HABITS, 2, S) joint density of the stance foot.
            ground: Terrain segments along the path.
        """
        apart = []  # habits whose steps differ on this ground
        if any(_TWO_PACES_M < length <= _ONE_PACE_M for length in _tread_lengths(ground)):
            apart.append(_ONE)
        if any(min(one.drop, other.drop) > self._min_step_height_m for one, other in pairwise(ground)):
            apart.append(_TWO)
        shares = joint.sum(axis=(1, 2))  # (HABITS,) probability of each habit
        together = [habit for habit in range(HABITS) if habit not in apart]
        groups = [together, *([habit] for habit in apart if shares[habit] > _MIN_SHARE)]
        return [(joint[group].sum(axis=0), self._mean_habit(joint, group)) for group in groups]

    def _mean_habit(self, joint: Array, group: list[int]) -> Habit:
        """The habit of a group of habits; its probabilities of joining are means over the walkers of the group.

        Args:
            joint: (HABITS, 2, S) joint density of the stance foot.
            group: Indices of the habits.
        """
        chances = self.chances[group]  # probability of joining by habit
        # probability of each habit of the group: after a step over an edge, and in all
        crossed, shares = joint[group, 1].sum(axis=-1), joint[group].sum(axis=(1, 2))
        # of later steps: mean over all walkers of the group; of the next step: over those whose step crossed an edge
        later = float(shares @ chances / shares.sum()) if shares.sum() > 0.0 else float(chances.mean())
        following = float(crossed @ chances / crossed.sum()) if crossed.sum() > 0.0 else later
        return Habit(joins=(following, later), one_per_tread=group == [_ONE], treads=2 if group == [_TWO] else 1)


def step_weights(ground: Sequence[Segment], habit: Habit, settings: Settings) -> tuple[Array, Array]:
    """(P, P) weights of steps between segments: on even ground (no edge crossed), and over edges.

    No step goes backward. A step over m edges has the weight `_SKIP`^(m−1). Steps that walkers of the habit hardly ever
    take have the weight γ of docs/locomotion_mode.md (15).

    Args:
        ground: P terrain segments.
        habit: How the walker uses stairs.
        settings: Gives the lowest step that is an edge.

    Returns:
        Weights (P, P) from the segment of the row to that of the column: on even ground, over edges.
    """
    edges, order = np.array(edges_before(ground)), np.arange(len(ground))
    # (P, P) from the segment of the row to that of the column: number of edges crossed; whether the step goes forward
    between = edges[None, :] - edges[:, None]
    ahead = order[None, :] >= order[:, None]
    even = (ahead & (between == 0)).astype(float)
    over = np.where(ahead & (between > 0), _SKIP ** np.maximum(between - 1, 0), 0.0)
    if habit.one_per_tread:
        treads = [length <= _ONE_PACE_M for length in _tread_lengths(ground)]
        even[treads, treads] = _AGAINST_HABIT  # a step within a tread, on the diagonal
    if habit.treads > 1:
        least = settings.min_step_height_m
        # number of edges before each segment that do not lead up; `up`: steps that cross none of them
        not_up = np.cumsum([abs(segment.drop) > 0.0 and segment.drop <= least for segment in ground])
        up = (over > 0.0) & (not_up[None, :] == not_up[:, None])
        fewer = between < habit.treads
        weights_up = np.where(fewer, _AGAINST_HABIT, _SKIP ** np.maximum(between - habit.treads, 0))
        over = np.where(up, weights_up, over)
    return even, over


def _tread_lengths(ground: Sequence[Segment]) -> list[float]:
    """Length of each segment, m, if it lies between two edges; inf for others."""
    drops_after = [segment.drop for segment in ground[1:]] + [0.0]  # at the end of each segment, m; 0 without an edge
    return [
        segment.length if segment.drop != 0.0 and drop_after != 0.0 else np.inf
        for segment, drop_after in zip(ground, drops_after)
    ]
