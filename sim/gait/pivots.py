"""Quick turns on the spot: a foot lands on its ball, the body spins on it, and the other foot comes round.

The foot on the side of the turn leads (a spin turn: Hase & Stein 1999, J Neurophysiol 81:2914-2922). It lands with a
part of the turn done, makes the rest on its ball with the heel up, and lies flat only then; the other foot begins to
turn on its ball before it leaves. So a heel that is down never slides.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from stridetwin.sim.acts import Pivot
from stridetwin.sim.gait.foot_placement import Foothold
from stridetwin.sim.gait.side_steps import Aside
from stridetwin.sim.gait.twist import Twist
from stridetwin.sim.wearer.dimensions import Shoe
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

# Chosen by hand, within the rotations of hips in people: 45° to either side (Norkin & White 2009).
_BEFORE_LANDING = 0.45  # share of the turn after which the leading foot lands
_BEFORE_LEAVING = 0.20  # share of the turn that the other foot makes before it leaves
_LEAD_S, _FOLLOW_S = 0.60, 0.80  # times of the two steps
_STANCE_M = 0.12  # of the leading foot's heel from between the feet
_HALF_WIDTH_M = 0.06  # of the other stances
_ADJUST_S = 0.6  # time of a small step on the spot before the walker turns back, and after it
_FACING_S = 0.8  # of standing after the turn back, at least
_WHOLE_TURN_RAD = math.pi - 1e-6


def place_pivot(act: Pivot, hold: Foothold, aside: Aside, shoe: Shoe) -> tuple[Foothold, list[Foothold], Aside]:
    """Footholds of a turn on the spot and of the turn back, or on by as much if it is half a turn.

    Args:
        act: The act.
        hold: Foothold before it, of the foot that does not lead.
        aside: Where the walker is beside the way before it.
        shoe: Sole, whose ball the feet turn on.

    Returns:
        The foothold before it, from which that foot leaves turning; the footholds that follow; and where the walker is
        beside the way after them.

    Raises:
        ConfigError: The turn is too small.
    """
    if abs(act.angle_rad) < act.MIN_RAD:
        raise ConfigError("gait", "acts.angle_deg", math.degrees(act.angle_rad), "at least 45 to either side")
    before, first = _turn(hold, act.angle_rad, shoe)
    first[-1] = replace(first[-1], pause_s=act.for_s)
    if abs(act.angle_rad) >= _WHOLE_TURN_RAD:  # on in the same direction: the walker comes back to the place, too
        first[-1], second = _turn(first[-1], act.angle_rad, shoe)
        second[-1] = replace(second[-1], pause_s=_FACING_S)
        steps = [*first, *second]
    else:  # a small step first, as the other foot leads the turn back; and another one, so that the feet alternate
        small = _step_on_spot(first[-1])
        small, second = _turn(small, -act.angle_rad, shoe)
        second[-1] = replace(second[-1], pause_s=_FACING_S / 2)  # the ball's turn is over before that foot leaves
        steps = [*first, small, *second, replace(_step_on_spot(second[-1]), pause_s=_FACING_S)]
    return before, steps, Aside(left_m=steps[-1].left_m, goal_m=aside.goal_m)


def _turn(hold: Foothold, angle: float, shoe: Shoe) -> tuple[Foothold, list[Foothold]]:
    """The two steps of a turn by `angle`, rad, and the foothold `hold` of the other foot with its turn before it."""
    sign = 1.0 if angle > 0.0 else -1.0
    lands = _BEFORE_LANDING * angle
    # the leading foot lands with its heel beside the pelvis, which has made half of that turn. The places are relative
    # to the middle between the feet before, in their direction
    heel = _rotate(lands / 2, 0.0, sign * _STANCE_M)
    ball = heel + _rotate(lands, shoe.toe_hinge_x, 0.0)
    middle = ball - _rotate(angle, shoe.toe_hinge_x, sign * _HALF_WIDTH_M)
    ahead, left = _rotate(hold.yaw_rad, *middle.tolist())
    lead = replace(
        hold,
        foot=hold.other_foot,
        s=hold.s + float(ahead),
        left_m=hold.left_m + float(left),
        yaw_rad=hold.yaw_rad + angle,
        manner="pivot",
        time_s=_LEAD_S,
        pause_s=0.0,
        act=None,
        twist=Twist(in_rad=angle - lands),
    )
    follow = replace(lead, foot=hold.foot, manner="place", time_s=_FOLLOW_S, twist=None)
    return replace(hold, twist=replace(hold.twist or Twist(), out_rad=_BEFORE_LEAVING * angle)), [lead, follow]


def _step_on_spot(hold: Foothold) -> Foothold:
    """A small step of the other foot, onto the place where it stands."""
    return replace(hold, foot=hold.other_foot, manner="place", time_s=_ADJUST_S, pause_s=0.0, twist=None)


def _rotate(angle: float, x: float, y: float) -> Array:
    """(2,) vector (x, y) turned by an angle, rad."""
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([cos * x - sin * y, sin * x + cos * y])
