"""Objects on or beside the way that are not walkable ground: paint, shadows, tables, walls."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.sim.config import Thing
from stridetwin.sim.route import RUN_OUT_M, Layout, Strip
from stridetwin.sim.solids import Box
from stridetwin.sim.surroundings import Landmark
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

LENGTHS_M = {"stripe": 0.30, "shadow": 1.20, "table": 0.70, "wall": 0.15}
_TABLE_WIDTH_M, _TABLE_M, _BOARD_M, _LEG_M = 1.40, 0.72, 0.04, 0.06
_WALL_WIDTH_M, _WALL_M = 3.0, 2.5
_LIFT_M = 0.001  # height of paint, so that the ground does not shine through
_BODY_M = 0.40  # clearance from the middle of the way, and beyond the end of the walk


@dataclass(frozen=True, kw_only=True, eq=False)
class Painted:
    """A level rectangle on the ground: (4, 3) corners, m, anticlockwise seen from above, and its material."""

    corners: Array
    material: str


def painted(things: Sequence[Thing], layout: Layout, width_m: float) -> list[Painted]:
    """Flat objects on the way, as wide as it: a marking is half white, half black."""
    found = []
    for thing in things:
        middle, end = thing.at_m + LENGTHS_M[thing.kind] / 2, thing.at_m + LENGTHS_M[thing.kind]
        if thing.kind == "stripe":
            found.append(_area(thing, thing.at_m, middle, layout, width_m, "white_paint"))
            found.append(_area(thing, middle, end, layout, width_m, "black_paint"))
        elif thing.kind == "shadow":
            found.append(_area(thing, thing.at_m, end, layout, width_m, "shadow"))
    return found


def _area(thing: Thing, start: float, end: float, layout: Layout, width_m: float, material: str) -> Painted:
    half, s = 0.5 * width_m, np.array([start, start, end, end])
    xy = layout.way.point(s, thing.left_m + half * np.array([1.0, -1.0, -1.0, 1.0]))
    z = _strip(layout, start).z0 + _LIFT_M
    return Painted(corners=np.column_stack([xy, np.full(4, z)]), material=material)


def standing(things: Sequence[Thing], layout: Layout) -> tuple[Landmark, ...]:
    """Upright objects: tables on two sides, and walls."""
    found: list[Landmark] = []
    for thing in things:
        if thing.kind == "wall":
            found.append(Landmark(box=_box(thing, layout, _WALL_WIDTH_M, 0.0, _WALL_M), material="plaster"))
        elif thing.kind == "table":
            found.append(Landmark(box=_box(thing, layout, _TABLE_WIDTH_M, _TABLE_M - _BOARD_M, _TABLE_M),
                                  material="wood"))  # fmt: skip
            for side in (-1.0, 1.0):
                aside = side * (_TABLE_WIDTH_M / 2 - 0.1)
                leg = _box(thing, layout, _LEG_M, 0.0, _TABLE_M - _BOARD_M, aside)
                found.append(Landmark(box=leg, material="wood"))
    return tuple(found)


def _box(thing: Thing, layout: Layout, width: float, bottom: float, top: float, aside: float = 0.0) -> Box:
    """A box across the way on its ground, from one height above it to another."""
    length = LENGTHS_M[thing.kind]
    s, z = thing.at_m + length / 2, _strip(layout, thing.at_m).z0
    x, y = layout.way.point(s, thing.left_m + aside).tolist()
    return Box(x=x, y=y, yaw=float(layout.way.heading(s)), length=length, width=width, bottom=z + bottom, top=z + top)


def _strip(layout: Layout, s: float) -> Strip:
    return next((strip for strip in layout.profile if s < strip.s1), layout.profile[-1])


def check_things(things: Sequence[Thing], layout: Layout) -> None:
    """Rejects objects that are not on one level, and those that obstruct the walker.

    Raises:
        ConfigError: The message names the object, its place, and what is valid.
    """
    first, last = layout.profile[0].s0, layout.profile[-1].s1
    walked = layout.way.point(np.arange(0.0, last - RUN_OUT_M, 0.05))
    for i, thing in enumerate(things):
        strip, end = _strip(layout, thing.at_m), thing.at_m + LENGTHS_M[thing.kind]
        level = strip.terrain == "level" and strip.cross_slope == 0.0
        if not (level and first <= thing.at_m and end <= strip.s1 + 1e-9):
            valid = f"a place on one level of the way, {LENGTHS_M[thing.kind]:g} m long"
            raise ConfigError("route", f"things[{i}].at_m", thing.at_m, valid)
        for mark in standing((thing,), layout):
            if _distance(mark.box, walked).min() < _BODY_M:
                valid = f"{_BODY_M:g} m clear of where the walker goes"
                raise ConfigError("route", f"things[{i}]", f"a {thing.kind} at {thing.at_m:g} m", valid)


def _distance(box: Box, xy: Array) -> Array:
    """(N,) m, distance of (N, 2) points from a box in plan view."""
    cos, sin = math.cos(box.yaw), math.sin(box.yaw)
    along, left = ((xy - [box.x, box.y]) @ np.array([[cos, -sin], [sin, cos]])).T
    out = np.maximum(np.abs(np.stack([along, left])) - np.array([[box.length], [box.width]]) / 2, 0.0)
    return np.asarray(np.hypot(*out))
