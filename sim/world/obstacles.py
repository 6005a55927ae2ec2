"""Surroundings of the way, clear of the walker: planters and pillars outdoors, walls and furniture in a room.

Objects on or beside the way are not walkable ground: paint, shadows, tables, walls. The walls of a corridor are
directly at the borders of the way.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from operator import itemgetter

import numpy as np

from stridetwin.sim.config import Thing
from stridetwin.sim.world.route import RUN_OUT_M
from stridetwin.sim.world.solids import Solid, corners
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array
from stridetwin.streams.terrain_truth import Layout, Slab, Strip, profile_height

_SEED = 20260  # the world looks the same in every walk


# Sizes and distances of objects, m; chosen by hand, as large as such objects commonly are.
_CLEARANCE_M = 0.35  # between walkable ground and objects outdoors and in rooms
_SPACING_M = 2.2  # of objects along the way
_ROOM_MARGIN_M = 3.0  # from the way to the walls of a room
_ROOM_HEIGHT_M = 2.7  # of walls of rooms and corridors
_CORRIDOR_WALL_M = 0.12  # thickness of a corridor's walls
_BRICK_M = 0.2  # length of the parts that they are tested in
_TABLE_WIDTH_M = 1.40
_TABLE_HEIGHT_M = 0.72
_BOARD_M = 0.04  # thickness of a table's board
_LEG_M = 0.06  # width of a table's leg
_SEAT_M = 0.45  # height and width of a chair's seat
_BACK_HEIGHT_M = 0.90  # height of its back
_CRATE_WIDTH_M = 0.60
_CRATE_HEIGHT_M = 0.20  # that of a step
_WALL_WIDTH_M = 3.0
_WALL_HEIGHT_M = 2.5
# door frame: thickness of its wall, width of jambs and head, and clear height (DIN 18101 has 2.111 m)
_DOOR_WALL_M, _JAMB_M, _DOOR_HEIGHT_M = 0.10, 0.05, 2.10
_HEAD_ROOM_M = 2.05  # of a walker of 1.95 m in shoes who rises with every step: what is higher obstructs nobody
_PAINT_LIFT_M = 0.001  # height of paint, so that the ground does not shine through
_LEAST_WALL_M = 0.01  # narrower walls beside a door are left out
_BODY_CLEARANCE_M = 0.40  # clearance from the middle of the way, and beyond the end of the walk
# length along the way by the kind of a thing
LENGTHS_M = {
    "stripe": 0.30,
    "shadow": 1.20,
    "mat": 0.90,
    "table": 0.70,
    "chair": 0.45,
    "crate": 0.40,
    "wall": 0.15,
    "glass": 0.02,
    "door": 0.14,
}
GLASS = "glass"
"""Material that cameras look through."""


@dataclass(frozen=True, kw_only=True)
class Landmark:
    """A box beside the way or on it, of one material.

    Attributes:
        box: Its shape in the world.
        material: Name of its texture or colour (`scenery`).
    """

    box: Solid
    material: str


@dataclass(frozen=True, kw_only=True)
class _Frame:
    """A pose beside the way: its position and direction, and the height of the ground on the way there.

    Attributes:
        x, y: Position in the world, m.
        yaw: Direction, rad.
        z: Height of the ground, m.
    """

    x: float
    y: float
    yaw: float
    z: float

    def box(
        self,
        material: str,
        length: float,
        width: float,
        bottom: float,
        top: float,
        along: float = 0.0,
        left: float = 0.0,
    ) -> Landmark:
        """A box at this frame, or translated along its direction and to its left.

        Args:
            material: Its material.
            length: m, along the direction.
            width: m.
            bottom: Height of its underside in the world, m.
            top: Height of its top in the world, m.
            along: Translation along the direction, m.
            left: Translation to the left, m.
        """
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        solid = Solid.box(
            x=self.x + cos * along - sin * left,
            y=self.y + sin * along + cos * left,
            yaw=self.yaw,
            length=length,
            width=width,
            bottom=bottom,
            top=top,
        )
        return Landmark(box=solid, material=material)


def surroundings(
    scenery: str, layout: Layout, bottom_m: float, things: Sequence[Landmark] = ()
) -> tuple[Landmark, ...]:
    """The given things, and the landmarks of a scenery that are clear of the ground and of each other.

    Args:
        scenery: `outdoor`, `room` or `corridor`.
        layout: Route in the world.
        bottom_m: Height down to which the landmarks reach.
        things: Upright things of the route, which always stay.
    """
    # each group is one object, such as a table of several boxes: all of it is placed, or nothing
    make_groups = {"outdoor": _outdoor_objects, "room": _room_objects, "corridor": _corridor_walls}[scenery]
    groups = make_groups(layout, bottom_m)
    clearance = 0.0 if scenery == "corridor" else _CLEARANCE_M  # a corridor's walls stand at the borders of the way
    landmarks = list(things)
    for group in groups:
        if all(_is_clear(mark.box, layout, landmarks, clearance) for mark in group):
            landmarks += group
    return tuple(landmarks)


def floor(scenery: str, layout: Layout) -> tuple[Slab, ...]:
    """The floor of a room around the whole layout, at its lowest height; nothing in other sceneries."""
    if scenery != "room":
        return ()
    low, high = _room_corners(layout)
    z = min(min(slab.z0, slab.z1) for slab in layout.slabs)
    half = (high[1] - low[1]) / 2
    # from the middle of the low-x wall along x
    slab = Slab(
        x=float(low[0]),
        y=float(low[1] + high[1]) / 2,
        heading=0.0,
        length=float(high[0] - low[0]),
        left=float(half),
        right=float(half),
        z0=z,
        z1=z,
        terrain="level",
    )
    return (slab,)


def _room_corners(layout: Layout) -> tuple[Array, Array]:
    """Corners of the inside of a room around the way, (2,) m each: lowest x and y, and highest x and y."""
    points = layout.way.point(np.arange(layout.profile[0].s0, layout.profile[-1].s1, 0.1))
    return points.min(axis=0) - _ROOM_MARGIN_M, points.max(axis=0) + _ROOM_MARGIN_M


def _is_clear(box: Solid, layout: Layout, landmarks: list[Landmark], clearance: float) -> bool:
    """Whether a box keeps a distance to all walkable ground, and overlaps none of the landmarks.

    Args:
        box: The box.
        layout: Route in the world.
        landmarks: Landmarks so far.
        clearance: Least distance to the ground that is walked on, m.
    """
    # points of the footprint, at most about 0.2 m apart, borders included
    along = np.linspace(-box.length / 2, box.length / 2, max(2, math.ceil(box.length / 0.2)))
    across = np.linspace(-box.width / 2, box.width / 2, max(2, math.ceil(box.width / 0.2)))
    u, v = np.meshgrid(along, across)
    cos, sin = math.cos(box.yaw), math.sin(box.yaw)
    points = np.stack([box.x + cos * u - sin * v, box.y + sin * u + cos * v], axis=-1)
    for slab in layout.slabs:
        p, q = slab.local(points)  # m along the slab from its start, and to the left of its axis
        beside = (p < -clearance) | (p > slab.length + clearance)
        # within rounding, a wall may stand on the border
        beside |= (q > slab.left + clearance - 1e-9) | (q < -slab.right - clearance + 1e-9)
        if not beside.all():
            return False
    return all(_are_apart(box, mark.box) for mark in landmarks)


def _are_apart(a: Solid, b: Solid) -> bool:
    """Whether two boxes do not overlap in plan view: on one of their axes, their projections are apart."""
    reach = math.hypot(a.length, a.width) / 2 + math.hypot(b.length, b.width) / 2
    if math.hypot(a.x - b.x, a.y - b.y) > reach + 1e-6:
        return True  # so far apart that they cannot meet
    p, q = corners(a)[:4, :2], corners(b)[:4, :2]
    for yaw in (a.yaw, a.yaw + math.pi / 2, b.yaw, b.yaw + math.pi / 2):
        axis = np.array([math.cos(yaw), math.sin(yaw)])
        # boxes that touch, within rounding, do not overlap
        if (p @ axis).max() < (q @ axis).min() + 1e-6 or (q @ axis).max() < (p @ axis).min() + 1e-6:
            return True
    return False


def _outdoor_objects(layout: Layout, bottom: float) -> Iterator[list[Landmark]]:
    """Planters and pillars along both sides of the way and a wall beyond its end, down to the height `bottom`, m.

    Yields:
        The boxes of one object.
    """
    rng = np.random.default_rng(_SEED)
    first, last = layout.profile[0], layout.profile[-1]
    half = layout.slabs[0].left + _CLEARANCE_M  # m, from the middle of the way to the objects
    for side in (-1.0, 1.0):
        # arc lengths; the left side starts 1 m later
        for i, s in enumerate(np.arange(first.s0 + 0.5 + (side > 0), last.s1, _SPACING_M).tolist()):
            if side < 0:  # the side of the film camera: nothing that occludes the walker
                yield _planter(rng, _place_beside(layout, s, side, half), bottom, side, hedge_m=(0.12, 0.30))
            elif i % 3 == 0:  # one pillar to two planters
                yield _pillar(rng, _place_beside(layout, s, side, half), bottom, side)
            else:
                yield _planter(rng, _place_beside(layout, s, side, half), bottom, side, hedge_m=(0.35, 0.80))
    x, y = layout.way.point(last.s1).tolist()
    end = _Frame(x=x, y=y, yaw=float(layout.way.heading(last.s1)), z=last.z1)
    # a wall 2 m beyond the end, 9 m wider than the way and 2.8 m high
    yield [end.box("brick", 0.3, 9.0 + 2 * layout.slabs[0].left, bottom, last.z1 + 2.8, along=2.0)]


def _place_beside(layout: Layout, s: float, side: float, half: float) -> _Frame:
    """Frame of the nearest place beside the way, on a side, that no slab covers; lanes count, too.

    Args:
        layout: Route in the world.
        s: Arc length along the way, m.
        side: 1 for the left, -1 for the right.
        half: Least distance from the middle of the way, m.
    """
    x, y = layout.way.point(s).tolist()
    yaw = float(layout.way.heading(s))
    reach = half  # m, from the middle of the way
    for slab in layout.slabs:  # a slab beside this place in the direction of the way, such as a lane, moves it outwards
        p, q = slab.local(np.array([x, y]))
        if 0.0 <= p <= slab.length and math.cos(slab.heading - yaw) > 0.99:  # parallel within 8°
            reach = max(reach, float(slab.left - q if side > 0 else slab.right + q) + _CLEARANCE_M)
    x, y = layout.way.point(s, side * reach).tolist()
    return _Frame(x=x, y=y, yaw=yaw, z=float(profile_height(layout.profile, s)))


def _pillar(rng: np.random.Generator, at: _Frame, bottom: float, side: float) -> list[Landmark]:
    """A square pillar with a stone cap beside the way, on the side `side` (1 left, -1 right).

    `rng` draws its width, its place and its height, in m.
    """
    size = rng.uniform(0.3, 0.45)
    left = side * (size / 2 + rng.uniform(0.0, 0.5) + 0.05)
    top = at.z + rng.uniform(1.7, 2.6)
    shaft = at.box("plaster", size, size, bottom, top, left=left)
    return [shaft, at.box("stone", size + 0.1, size + 0.1, top, top + 0.08, left=left)]


def _planter(
    rng: np.random.Generator, at: _Frame, bottom: float, side: float, hedge_m: tuple[float, float]
) -> list[Landmark]:
    """A stone trough with a hedge of a height in `hedge_m` beside the way, on the side `side` (1 left, -1 right).

    `rng` draws its length, its depth, its place, and the heights of trough and hedge, in m.
    """
    length, depth = rng.uniform(1.0, 1.7), rng.uniform(0.4, 0.55)
    left = side * (depth / 2 + rng.uniform(0.0, 0.3))
    rim = at.z + rng.uniform(0.1, 0.2)
    top = rim + rng.uniform(*hedge_m)
    trough = at.box("stone", length, depth, bottom, rim, left=left)
    return [trough, at.box("leaves", length - 0.1, depth - 0.1, rim - 0.01, top, left=left)]


def _corridor_walls(layout: Layout, bottom: float) -> Iterator[list[Landmark]]:
    """Walls along both sides of all straight parts, around their ends if there is space, and across both ends.

    They reach down to the height `bottom`, m.

    Yields:
        The box of one wall.
    """
    lines, profile = layout.way.segments, layout.profile
    half, top = layout.slabs[0].left, max(max(s.z0, s.z1) for s in profile) + _ROOM_HEIGHT_M
    built: list[Landmark] = []  # parts of walls so far, which later ones must not meet
    # walls across both ends
    for line, along in ((lines[0], -_CORRIDOR_WALL_M), (lines[-1], lines[-1].s1 - lines[-1].s0 + _CORRIDOR_WALL_M)):
        end = _Frame(x=line.x, y=line.y, yaw=line.heading, z=0.0)
        yield [end.box("brick", _CORRIDOR_WALL_M, 2 * half, bottom, top, along=along)]
    for line in lines:
        if line.curvature:
            continue  # walls stand beside straight parts only
        start, length = _Frame(x=line.x, y=line.y, yaw=line.heading, z=0.0), line.s1 - line.s0
        for side in (-1.0, 1.0):
            left = side * (half + _CORRIDOR_WALL_M / 2)
            # a wall is tested in short parts; neighbouring parts that are free and of one material become one box
            bricks = []  # (material, place along the line) of each part; "" where there is no space
            for along in np.arange(-2 * half, length + 2 * half, _BRICK_M).tolist():
                # along the wall, stretches of `_SPACING_M`: one of brick to two of plaster
                material = "brick" if math.floor((line.s0 + along) / _SPACING_M + side) % 3 == 0 else "plaster"
                brick = start.box(material, _BRICK_M, _CORRIDOR_WALL_M, bottom, top, along=along, left=left)
                free = _is_clear(brick.box, layout, built, 0.0)
                if free:
                    built.append(brick)
                bricks.append((material if free else "", along))
            for material, run in groupby(bricks, key=itemgetter(0)):
                if material:
                    places = [along for _, along in run]
                    middle, long = (places[0] + places[-1]) / 2, len(places) * _BRICK_M
                    yield [start.box(material, long, _CORRIDOR_WALL_M, bottom, top, along=middle, left=left)]


def _room_objects(layout: Layout, bottom: float) -> Iterator[list[Landmark]]:
    """Four walls with shelves and posters along them, and tables and chests in between, wherever there is space.

    The walls reach down to the height `bottom`, m; everything else stands on the lowest ground.

    Yields:
        The boxes of one object, which the caller leaves out where there is no space.
    """
    rng = np.random.default_rng(_SEED)
    low, high = _room_corners(layout)
    middle, (length, width) = (low + high) / 2, high - low
    z = min(min(slab.z0, slab.z1) for slab in layout.slabs)
    room = _Frame(x=middle[0], y=middle[1], yaw=0.0, z=z)
    top = max(max(s.z0, s.z1) for s in layout.profile) + _ROOM_HEIGHT_M
    for sign in (-1.0, 1.0):
        yield [room.box("plaster", length, 0.1, bottom, top, left=sign * (width / 2 + 0.05))]
        yield [room.box("plaster", 0.1, width, bottom, top, along=sign * (length / 2 + 0.05))]
    for quarter in range(4):  # along the four walls, with the walls' direction as x
        # length of the wall, and distance to the opposite one
        along, away = (length, width) if quarter % 2 == 0 else (width, length)
        wall = _Frame(x=middle[0], y=middle[1], yaw=quarter * math.pi / 2, z=z)
        # every 1.9 m a shelf, 0.4 m deep and just off the wall, and a poster between it and the next one
        for u in np.arange(0.9 - along / 2, along / 2 - 0.9, 1.9).tolist():
            size, tall = rng.uniform(0.8, 1.5), rng.uniform(0.8, 2.0)
            beside, material = u + rng.uniform(-0.2, 0.2), str(rng.choice(["wood", "brick", "stone"]))
            yield [wall.box(material, size, 0.4, z, z + tall, along=beside, left=0.22 - away / 2)]
            # a poster has random numbers of its own, so that it changes no other object
            yield _poster(np.random.default_rng([_SEED, quarter, round(100 * (u + along))]), wall, u + 0.95, away)
    # tables and chests on a grid of 1.7 m, each moved and rotated at random
    for u in np.arange(low[0] + 1.4, high[0] - 1.0, 1.7).tolist():
        for v in np.arange(low[1] + 1.4, high[1] - 1.0, 1.7).tolist():
            at = _Frame(x=u + rng.uniform(-0.3, 0.3), y=v + rng.uniform(-0.3, 0.3), yaw=rng.uniform(0, math.pi), z=z)
            yield _table(rng, at) if rng.uniform() < 0.5 else _chest(rng, at)


def _poster(rng: np.random.Generator, wall: _Frame, along: float, away: float) -> list[Landmark]:
    """A sheet on a wall, where no shelf occludes it.

    Args:
        rng: Draws its size and height.
        wall: Frame in the middle of the room, along the wall.
        along: Place along the wall, m.
        away: Distance between this wall and the opposite one, m.
    """
    bottom = wall.z + rng.uniform(1.0, 1.5)
    length, top = rng.uniform(0.4, 0.7), bottom + rng.uniform(0.4, 0.9)
    return [wall.box("poster", length, 0.02, bottom, top, along=along, left=0.015 - away / 2)]


def _table(rng: np.random.Generator, at: _Frame) -> list[Landmark]:
    """A table of random size at a place in a room."""
    length, width, height = rng.uniform(0.9, 1.4), rng.uniform(0.5, 0.7), rng.uniform(0.68, 0.76)
    # underside of the board, and places of the two upright boards that carry it
    below, ends = at.z + height - 0.04, [e * (length / 2 - 0.08) for e in (-1, 1)]
    sides = [at.box("wood", 0.05, width - 0.1, at.z, below, along=along) for along in ends]
    return [*sides, at.box("wood", length, width, below, at.z + height)]


def _chest(rng: np.random.Generator, at: _Frame) -> list[Landmark]:
    """A chest of random size at a place in a room."""
    length, width, height = rng.uniform(0.4, 0.9), rng.uniform(0.4, 0.6), rng.uniform(0.35, 0.6)
    return [at.box(str(rng.choice(["brick", "leaves"])), length, width, at.z, at.z + height)]


_BANDS = {"stripe": ("white_paint", "black_paint"), "shadow": ("shadow",), "mat": ("black_paint",)}
"""Materials of a flat object along the way, each on an equal part of its length."""


def floor_markings(things: Sequence[Thing], layout: Layout, width_m: float) -> Iterator[tuple[Array, str]]:
    """Flat objects on the way, as wide as the way: stripes, shadows and mats.

    Args:
        things: Things of the route.
        layout: Route in the world.
        width_m: Width of the way.

    Yields:
        (4, 3) m, corners of a level rectangle, anticlockwise seen from above, and its material.
    """
    for thing in things:
        bands = _BANDS.get(thing.kind, ())
        for k, material in enumerate(bands):
            # arc lengths of both ends of the band
            start, end = (thing.at_m + i * LENGTHS_M[thing.kind] / len(bands) for i in (k, k + 1))
            left = thing.left_m + 0.5 * width_m * np.array([1.0, -1.0, -1.0, 1.0])
            xy = layout.way.point(np.array([start, start, end, end]), left)
            yield np.column_stack([xy, np.full(4, _strip_at(layout, start).z0 + _PAINT_LIFT_M)]), material


def upright_things(things: Sequence[Thing], layout: Layout, width_m: float) -> tuple[Landmark, ...]:
    """Boxes of the upright things on or beside the way: tables, chairs, crates, walls, panes of glass and doors.

    Args:
        things: Things of the route.
        layout: Route in the world.
        width_m: Width of the way, which the wall of a door fills.
    """
    boxes: list[Landmark] = []
    for thing in things:
        if thing.kind == "door":
            boxes += _door(thing, _frame_of_thing(replace(thing, left_m=0.0), layout), width_m)
        elif thing.kind in _UPRIGHT:
            boxes += _UPRIGHT[thing.kind](_frame_of_thing(thing, layout))
    return tuple(boxes)


def _door(thing: Thing, at: _Frame, width_m: float) -> Iterator[Landmark]:
    """A wall across the way with an opening in a wooden frame: two walls, two jambs, the head, and the wall above it.

    Args:
        thing: The door, with the place and the width of its opening.
        at: Frame in the middle of the way.
        width_m: Width of the way.
    """
    deep, lintel = LENGTHS_M["door"], at.z + _DOOR_HEIGHT_M + _JAMB_M
    ends = [thing.left_m + side * (thing.opening_m / 2 + _JAMB_M) for side in (-1.0, 1.0)]  # outer edges of the frame
    for border, end in zip((-width_m / 2, width_m / 2), ends):
        if abs(border - end) > _LEAST_WALL_M:
            middle = (border + end) / 2
            yield at.box("plaster", _DOOR_WALL_M, abs(border - end), at.z, at.z + _ROOM_HEIGHT_M, left=middle)
        jamb = end - math.copysign(_JAMB_M / 2, end - thing.left_m)
        yield at.box("wood", deep, _JAMB_M, at.z, lintel, left=jamb)
    yield at.box("wood", deep, thing.opening_m, at.z + _DOOR_HEIGHT_M, lintel, left=thing.left_m)
    yield at.box("plaster", _DOOR_WALL_M, ends[1] - ends[0], lintel, at.z + _ROOM_HEIGHT_M, left=thing.left_m)


def _frame_of_thing(thing: Thing, layout: Layout) -> _Frame:
    """Frame in the middle of a thing on the way, at the height of its ground."""
    s = thing.at_m + LENGTHS_M[thing.kind] / 2
    x, y = layout.way.point(s, thing.left_m).tolist()
    return _Frame(x=x, y=y, yaw=float(layout.way.heading(s)), z=_strip_at(layout, thing.at_m).z0)


def _single_box(kind: str, material: str, width: float, height: float, at: _Frame) -> Iterator[Landmark]:
    """A thing of one box that stands on the ground at `at`, with the length of its kind; width and height in m."""
    yield at.box(material, LENGTHS_M[kind], width, at.z, at.z + height)


def _long_table(at: _Frame) -> Iterator[Landmark]:
    """Yields the parts of a long table: its board, and the two boards that carry it."""
    # height of the board's underside, and distance of each upright board from the middle
    below, side = at.z + _TABLE_HEIGHT_M - _BOARD_M, _TABLE_WIDTH_M / 2 - 0.1
    yield at.box("wood", LENGTHS_M["table"], _TABLE_WIDTH_M, below, below + _BOARD_M)
    for left in (-side, side):
        yield at.box("wood", LENGTHS_M["table"], _LEG_M, at.z, below, left=left)


def _chair(at: _Frame) -> Iterator[Landmark]:
    """A seat on four legs, and a back across the way."""
    # distance of the legs from the middle along both axes, and height of the seat's underside
    half, below = (_SEAT_M - _LEG_M) / 2, at.z + _SEAT_M - _BOARD_M
    yield at.box("wood", _SEAT_M, _SEAT_M, below, below + _BOARD_M)
    yield at.box("wood", _BOARD_M, _SEAT_M, below + _BOARD_M, at.z + _BACK_HEIGHT_M, along=(_SEAT_M - _BOARD_M) / 2)
    for along, left in ((-half, -half), (-half, half), (half, -half), (half, half)):
        yield at.box("wood", _LEG_M, _LEG_M, at.z, below, along=along, left=left)


# boxes of an upright thing by its kind, at a frame
_UPRIGHT: dict[str, Callable[[_Frame], Iterator[Landmark]]] = {
    "wall": partial(_single_box, "wall", "plaster", _WALL_WIDTH_M, _WALL_HEIGHT_M),
    "glass": partial(_single_box, "glass", GLASS, _WALL_WIDTH_M, _WALL_HEIGHT_M),
    "crate": partial(_single_box, "crate", "wood", _CRATE_WIDTH_M, _CRATE_HEIGHT_M),
    "table": _long_table,
    "chair": _chair,
}


def _strip_at(layout: Layout, s: float) -> Strip:
    """Strip of the profile at an arc length: the first one before the start, the last one beyond the end."""
    return next((strip for strip in layout.profile if s < strip.s1), layout.profile[-1])


def check_things(things: Sequence[Thing], layout: Layout, width_m: float) -> None:
    """Rejects objects that are not on one level, those that obstruct the walker, and doors wider than the way.

    Args:
        things: Things of the route.
        layout: Route in the world.
        width_m: Width of the way.

    Raises:
        ConfigError: The message names the object, its place, and what is valid.
    """
    first, last = layout.profile[0].s0, layout.profile[-1].s1
    # (N, 2) m, where the walker's middle goes, every 5 cm
    walked = layout.way.point(np.arange(0.0, last - RUN_OUT_M, 0.05))
    for i, thing in enumerate(things):
        strip, end = _strip_at(layout, thing.at_m), thing.at_m + LENGTHS_M[thing.kind]
        level = strip.terrain == "level" and strip.cross_slope == 0.0
        if not (level and first <= thing.at_m and end <= strip.s1 + 1e-9):
            valid = f"a place on one level of the way, {LENGTHS_M[thing.kind]:g} m long"
            raise ConfigError("route", f"things[{i}].at_m", thing.at_m, valid)
        if thing.kind == "door" and 2 * (abs(thing.left_m) + _JAMB_M) + thing.opening_m > width_m + 1e-9:
            most = max(width_m - 2 * (abs(thing.left_m) + _JAMB_M), 0.0)
            valid = f"{most:.2f} or less: the frame is within the way of {width_m:g} m"
            raise ConfigError("route", f"things[{i}].opening_m", thing.opening_m, valid)
        for mark in upright_things((thing,), layout, width_m):
            if mark.box.bottom > strip.z0 + _HEAD_ROOM_M:
                continue  # overhead
            if _distance_from_box(mark.box, walked).min() < _BODY_CLEARANCE_M:
                valid = f"{_BODY_CLEARANCE_M:g} m clear of where the walker goes"
                raise ConfigError("route", f"things[{i}]", f"a {thing.kind} at {thing.at_m:g} m", valid)


def _distance_from_box(box: Solid, xy: Array) -> Array:
    """(N,) m, distance of (N, 2) points from a box in plan view."""
    cos, sin = math.cos(box.yaw), math.sin(box.yaw)
    along, left = ((xy - [box.x, box.y]) @ np.array([[cos, -sin], [sin, cos]])).T  # in the box's own axes
    # how far a point is beyond the sides of the box along each axis, 0 within
    out = np.maximum(np.abs(np.stack([along, left])) - np.array([[box.length], [box.width]]) / 2, 0.0)
    return np.asarray(np.hypot(*out))
