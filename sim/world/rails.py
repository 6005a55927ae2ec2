"""Handrails beside the way: bars at one height above the line through the nosings of stairs."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np

from stridetwin.sim.acts import HoldRail
from stridetwin.sim.config import Gait
from stridetwin.sim.kinematics.smooth import smooth_gaussian
from stridetwin.streams.samples import Array
from stridetwin.streams.terrain_truth import Layout, profile_height

RADIUS_M = 0.02
"""Of a rail."""

# Chosen by hand.
_EXTENDS_M = 0.3  # beyond the stretch along which a hand holds it
_BEND_SD_M = 0.10  # SD of the filter that rounds its bends
_GRID_M = 0.02  # between the places at which its height is computed
_BAR_M = 0.10  # length of one bar
_POST_M = 1.0  # between two posts
_GREY = (0.55, 0.56, 0.58, 1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rail:
    """A handrail.

    Attributes:
        act: The act for which it is there.
        layout: Route in the world.
        grid: (K,) arc lengths, m.
        height: (K,) m, height of its axis in the world there.
    """

    act: HoldRail
    layout: Layout
    grid: Array
    height: Array

    @classmethod
    def along(cls, act: HoldRail, layout: Layout) -> Rail:
        """The rail of an act beside a route."""
        grid = np.arange(act.at_m - 2.0, act.at_m + act.for_m + 2.0, _GRID_M)
        line = smooth_gaussian(_nosing_line(layout, grid), _BEND_SD_M, _GRID_M)
        return cls(act=act, layout=layout, grid=grid, height=line + act.height_m)

    def points(self, s: Array) -> Array:
        """(N, 3) m, points of its axis in the world at (N,) arc lengths."""
        sign = 1.0 if self.act.side == "left" else -1.0
        return np.column_stack([self.layout.way.point(s, sign * self.act.away_m), np.interp(s, self.grid, self.height)])


def _nosing_line(layout: Layout, s: Array) -> Array:
    """(N,) m, height at (N,) arc lengths of the line through the nosings of stairs, elsewhere of the ground.

    It leaves the ground one tread before the first nosing of a stair that leads up, and comes down to it one tread
    behind the last one of a stair that leads down.
    """
    profile = layout.profile
    knots = [(profile[0].s0, profile[0].z0)]
    for i, (a, b) in enumerate(pairwise(profile)):
        if abs(b.z0 - a.z1) < 1e-9:
            knots.append((a.s1, a.z1))
            continue
        if b.z0 > a.z1 and a.terrain != "stair":  # the first riser up
            tread = min(b.s1 - b.s0, 0.4) if b.terrain == "stair" else 0.3
            knots.append((a.s1 - tread, float(profile_height(profile[: i + 1], a.s1 - tread))))
        knots.append((a.s1, max(a.z1, b.z0)))
        if b.z0 < a.z1 and b.terrain != "stair":  # the last riser down
            tread = min(a.s1 - a.s0, 0.4) if a.terrain == "stair" else 0.3
            knots.append((b.s0 + tread, b.z0))
    knots.append((profile[-1].s1, profile[-1].z1))
    places, heights = np.array(sorted(knots)).T
    return np.interp(s, places, heights)


def add_rails(spec: mujoco.MjSpec, gait: Gait, layout: Layout) -> None:
    """Adds the handrails that a walker holds to the world of a model; nothing touches them."""
    for act in gait.acts:
        if not isinstance(act, HoldRail):
            continue
        rail = Rail.along(act, layout)
        begin, end = act.at_m - _EXTENDS_M, act.at_m + act.for_m + _EXTENDS_M
        for a, b in pairwise(rail.points(np.linspace(begin, end, 1 + int(np.ceil((end - begin) / _BAR_M))))):
            _add_bar(spec, a, b)
        posts = np.linspace(begin + 0.05, end - 0.05, 1 + int(np.ceil((end - begin) / _POST_M)))
        for top, ground in zip(rail.points(posts), profile_height(layout.profile, posts)):
            _add_bar(spec, np.array([*top[:2], ground]), top - np.array([0.0, 0.0, RADIUS_M]))


def _add_bar(spec: mujoco.MjSpec, a: Array, b: Array) -> None:
    """Adds a bar between two points in the world, (3,) m."""
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[*a, *b],
        size=[RADIUS_M, 0.0, 0.0],
        rgba=list(_GREY),
        contype=0,
        conaffinity=0,
    )
