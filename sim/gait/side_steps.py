"""Steps to the side: the foot on that side leads, the other one closes up to it; and the way back to the middle."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from stridetwin.sim.acts import MIN_ASIDE_M, SideStep, StepAside
from stridetwin.sim.gait.foot_placement import Foothold
from stridetwin.streams.errors import ConfigError

# Chosen by hand.
_WIDEST_M = 0.36  # of one step
_STEP_S = 0.62  # time of one step
_EDGE_M = 0.25  # from the border of the way to the middle between the feet
_BACK_M = 0.15  # by which each stride comes back to the middle


@dataclass(frozen=True, kw_only=True)
class Aside:
    """Where the walker is beside the middle of the way.

    Attributes:
        left_m: To the left, m.
        goal_m: Where the walker is going on to, likewise.
    """

    left_m: float = 0.0
    goal_m: float = 0.0

    def after(self, foot: str) -> Aside:
        """Where the walker is after the next step, with the foot `l` or `r`.

        The foot on the side of the goal goes there; the other one keeps its distance from it, so that the feet never
        cross.
        """
        left = self.goal_m - self.left_m
        if left == 0.0 or (left > 0.0) != (foot == "l"):
            return self
        return replace(self, left_m=self.goal_m - math.copysign(max(abs(left) - _BACK_M, 0.0), left))


def place_side_steps(act: SideStep, hold: Foothold, aside: Aside, half_width_m: float) -> tuple[list[Foothold], Aside]:
    """Footholds of side steps, and where the walker is after them.

    Args:
        act: The act.
        hold: Foothold before it, of the foot that does not lead.
        aside: Where the walker is before it.
        half_width_m: Half of the width of the way, m.

    Raises:
        ConfigError: A side step that is too small, or leaves the way.
    """
    if abs(act.left_m) < MIN_ASIDE_M:
        raise ConfigError("gait", "acts.left_m", act.left_m, f"at least {MIN_ASIDE_M:g} m to either side")
    goal, most = aside.left_m + act.left_m, half_width_m - _EDGE_M
    if abs(goal) > most:
        valid = f"{-most:.2f} to {most:.2f} m from the middle of the way after the act, which is {goal:.2f} m"
        raise ConfigError("gait", "acts.left_m", act.left_m, valid)
    lead, count = hold.other_foot, math.ceil(abs(act.left_m) / _WIDEST_M)
    steps = []
    for k in range(1, count + 1):
        left = aside.left_m + act.left_m * k / count
        for foot in (lead, hold.foot):
            steps.append(replace(hold, foot=foot, left_m=left, manner="place", time_s=_STEP_S, act=None, pause_s=0.0))
    steps[-1] = replace(steps[-1], pause_s=act.for_s)
    return steps, Aside(left_m=goal, goal_m=aside.left_m if isinstance(act, StepAside) else goal)
