"""Footholds of what a walker does on the way: each act inserts steps where the walker has come to a stand for it.

An act inserts an even number of steps, so that the feet alternate as before. Each kind of act has a module of its own;
this one joins their footholds, and gives the steps their time and style.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from stridetwin.sim.acts import Act, Backwards, Hesitate, HoldRail, LookBack, Pivot, ShuffleInPlace, SideStep
from stridetwin.sim.config import Gait
from stridetwin.sim.gait.backwards import place_backward_steps, stand_before
from stridetwin.sim.gait.foot_placement import Foothold
from stridetwin.sim.gait.hesitation import take_half_steps
from stridetwin.sim.gait.look_back import looking_time
from stridetwin.sim.gait.pivots import place_pivot
from stridetwin.sim.gait.shuffling import place_shuffling_steps
from stridetwin.sim.gait.side_steps import Aside, place_side_steps
from stridetwin.sim.gait.style import Style, level_style
from stridetwin.sim.wearer.dimensions import Shoe
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.way import Way

MIN_APART_M = 1.0
"""Least distance between two acts for which the walker slows down, or between one and a stop, m."""

# Steps that do not lead on are short and slow. They are made on flat feet (chosen by hand).
_SUPPORT = 0.32  # share of such a step with both feet on the ground
_FLATTER = 0.25  # pitch of the feet relative to that of the slowest walk
_HEIGHT_LEGS = 0.985  # mean height of the pelvis, leg lengths
_STILLER = 0.05  # its oscillation, relative to that of the slowest walk


def check_acts(gait: Gait) -> None:
    """Rejects acts that are too near to each other or to a stop, or that no runner does.

    Raises:
        ConfigError: The message names field, value and what is valid.
    """
    standing = [act for act in gait.acts if act.shortens]
    walked = [act for act in gait.acts if act.stands or not isinstance(act, LookBack | HoldRail)]
    if walked and gait.pattern == "run":
        raise ConfigError("gait", "acts.kind", walked[0].kind, "in a run, look_back without standing, and hold_rail")
    places = sorted([act.at_m for act in standing] + ([stop.at_m for stop in gait.stops] if standing else []))
    for before, after in pairwise(places):
        if after - before < MIN_APART_M:
            valid = f"at least {MIN_APART_M:g} m after the act or stop at {before:g} m"
            raise ConfigError("gait", "acts.at_m", after, valid)


def perform_acts(
    holds: Sequence[Foothold], gait: Gait, way: Way, half_width_m: float, shoe: Shoe, rng: np.random.Generator
) -> list[Foothold]:
    """Footholds with the steps of all acts, and beside the middle of the way where the walker has stepped aside.

    Args:
        holds: Footholds in order; those where the walker stops for an act name it.
        gait: Gait of the person.
        way: The way.
        half_width_m: Half of the width of the way, m.
        shoe: Sole, on whose ball the feet turn.
        rng: Draws the steps of a shuffle in place.

    Raises:
        ConfigError: An act that leaves the way, or for which it is too short or not straight.
    """
    for entry in sorted((act for act in gait.acts if not act.shortens), key=lambda act: act.at_m):
        if isinstance(entry, Hesitate):
            holds = take_half_steps(holds, entry)
        elif isinstance(entry, LookBack):
            holds = _look_back(holds, entry)
    performed: list[Foothold] = []
    aside, whole_turns_rad = Aside(), 0.0
    for i, hold in enumerate(holds):
        if i + 1 < len(holds):  # the last step only brings the feet together
            aside = aside.after(hold.foot)
        performed.append(replace(hold, left_m=aside.left_m, yaw_rad=whole_turns_rad))
        act = hold.act
        if isinstance(act, SideStep):
            steps, aside = place_side_steps(act, performed[-1], aside, half_width_m)
            performed += steps
        elif isinstance(act, Backwards):
            performed[-1] = stand_before(performed[-1])
            performed += place_backward_steps(act, holds[: i + 1], performed[-1], way)
        elif isinstance(act, ShuffleInPlace):
            performed += place_shuffling_steps(act, performed[-1], rng)
        elif isinstance(act, Pivot):
            performed[-1], steps, aside = place_pivot(act, performed[-1], aside, shoe)
            performed += steps
            whole_turns_rad = steps[-1].yaw_rad
        elif isinstance(act, LookBack) and act.standing:
            performed[-1] = replace(performed[-1], pause_s=hold.pause_s + looking_time(act))
    return performed


def _look_back(holds: Sequence[Foothold], act: Act) -> list[Foothold]:
    """The footholds with a look back at the first one from its place on.

    Raises:
        ConfigError: There is no such foothold.
    """
    i = next((i for i, hold in enumerate(holds) if hold.s >= act.at_m and hold.act is None), None)
    if i is None:
        raise ConfigError("gait", "acts.at_m", act.at_m, "a place with a step behind it")
    return [*holds[:i], replace(holds[i], act=act), *holds[i + 1 :]]


def act_style() -> Style:
    """Style of a step of an act."""
    style = level_style(0.0)  # that of the slowest walk of the table
    return replace(
        style,
        double_support=_SUPPORT,
        pitch=_FLATTER * style.pitch,
        height=np.append(_HEIGHT_LEGS, _STILLER * style.height[1:]),
        forward=0.0 * style.forward,
        lift=0.0 * style.lift,
    )
