"""Lays out a route in the world: the way, the strips of ground along it, and every slab that it consists of."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from stridetwin.sim.config import Lanes, Level, Ramp, Route, Segment, Stairs, Turn
from stridetwin.sim.world.route_checks import check_segments
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.terrain_truth import Layout, Slab, Strip
from stridetwin.streams.way import CurveSegment, Way, join_segments

LEAD_IN_M = 2.0  # level ground behind the start
RUN_OUT_M = 2.0  # level ground behind the last segment
SPOT_RADIUS_M = 0.25  # a walker who turns on the spot still steps around a point
_SLAB_ANGLE_RAD = math.radians(10.0)  # arcs are built of straight slabs
_CROSSING_STRAIGHT_M = 0.35  # before and after the diagonal part of a crossing
_CROSSING_RADIUS_M = 1.0  # least radius of the arcs of a crossing
_SAME_HEIGHT_M = 1e-3  # grounds that differ by less may overlap


def lay_out(route: Route) -> Layout:
    """Lays out a route from the world's origin, at height 0, along +x.

    Raises:
        ConfigError: A segment that cannot be built or walked, or that intersects another one; the message names field,
            value and range.
    """
    check_segments(route)
    half = route.width_m / 2
    # the pen moves along the way and collects its lines, strips and slabs
    pen = _Pen(x=-LEAD_IN_M, y=0.0, heading=0.0, z=0.0, s=-LEAD_IN_M)
    pen.lay_straight(LEAD_IN_M, "level", half, half)
    segments = (*route.segments, Level(length_m=RUN_OUT_M))
    for i, segment in enumerate(segments):
        pen.owner = i
        # a level between lanes is a landing as wide as the lanes
        before = segments[i - 1] if i else None
        after = segments[i + 1] if i + 1 < len(segments) else None
        match segment:
            case Turn(angle_rad=angle, radius_m=radius):
                pen.lay_arc(angle, radius or SPOT_RADIUS_M, half)
            case Lanes():
                _lay_lanes(pen, segment, route.width_m)
            case Level() if isinstance(before, Lanes) or isinstance(after, Lanes):
                _lay_landing(pen, segment, before, after, route.width_m)
            case _:
                _lay_segment(pen, segment, half)
    _check_conflicts(pen, len(route.segments))
    return Layout(way=join_segments(pen.segments), profile=tuple(pen.strips), slabs=tuple(pen.slabs))


@dataclass(kw_only=True)
class _Pen:
    """Start of the next segment, and the layout so far.

    Attributes:
        x, y: Start of the next segment in the world, m.
        heading: Its direction, rad.
        z: Height of the ground there, m.
        s: Arc length of the way so far, m.
        owner: Number of the present segment of the route; -1 for the lead-in.
        edge_radius: Radius with which the start of the next slab is rounded, m.
        segments: Lines and arcs of the way.
        strips: Ground along the way.
        slabs: Ground of the whole route, lanes included.
        owners: Segment of the route that each slab belongs to.
        flights: Treads of each winding flight, by number of the slab.
    """

    x: float
    y: float
    heading: float
    z: float
    s: float
    owner: int = -1
    edge_radius: float = 0.0  # of the start of the next slab
    segments: list[CurveSegment] = field(default_factory=list)
    strips: list[Strip] = field(default_factory=list)
    slabs: list[Slab] = field(default_factory=list)
    owners: list[int] = field(default_factory=list)
    flights: list[range] = field(default_factory=list)  # treads of each winding flight, by index of the slab

    def start_beside(self, left: float) -> _Pen:
        """New pen without a layout, on this pen's line and `left` m to its left, for a lane."""
        x, y = self.x - left * math.sin(self.heading), self.y + left * math.cos(self.heading)
        return _Pen(x=x, y=y, heading=self.heading, z=self.z, s=self.s, owner=self.owner)

    def lay_straight(
        self,
        length: float,
        terrain: str,
        left: float,
        right: float,
        rise: float = 0.0,
        cross_slope: float = 0.0,
        recess: float = 0.0,
    ) -> None:
        """Lays a slab along a line, and the way on it.

        Args:
            length: m.
            terrain: Class of the ground.
            left: Extent to the left of the way, m.
            right: Extent to the right of the way, m.
            rise: Change of height over the length, m.
            cross_slope: Tilt sideways, rad.
            recess: By which the slab overhangs its riser, m; the sign gives the end.
        """
        self._add_slab_here(length, left, right, terrain, rise, cross_slope, recess)
        self._advance(length, 0.0, terrain, rise, cross_slope)

    def lay_arc(self, angle: float, radius: float, half_width: float) -> None:
        """Lays level slabs along an arc of the way; their outer corners meet.

        Args:
            angle: rad, left positive.
            radius: m.
            half_width: Of the way, m.
        """
        # each slab is tangent to the arc in its middle, and as long as its outer edge needs
        count = math.ceil(abs(angle) / _SLAB_ANGLE_RAD)
        part = angle / count  # rad, turn of each slab; `reach` is half its length
        reach = (radius + half_width) * math.tan(abs(part) / 2)
        for i in range(count):
            # direction of the slab, and length and direction of the chord from the start of the arc to its middle
            heading = self.heading + (i + 0.5) * part
            chord = 2 * radius * math.sin(abs(part) * (i + 0.5) / 2)
            toward = self.heading + part * (i + 0.5) / 2
            x = self.x + chord * math.cos(toward) - reach * math.cos(heading)
            y = self.y + chord * math.sin(toward) - reach * math.sin(heading)
            self._add_slab(
                Slab(
                    x=x,
                    y=y,
                    heading=heading,
                    length=2 * reach,
                    left=half_width,
                    right=half_width,
                    z0=self.z,
                    z1=self.z,
                    terrain="level",
                )
            )
        self._advance(radius * abs(angle), math.copysign(1.0 / radius, angle))

    def lay_winder(self, length: float, angle: float, half: float, recess: float, down: bool) -> None:
        """Lays a tread of a winding stair on an arc of the way.

        The tread is a rectangle. Its lower edge is radial, and its other end lies under the next higher tread: going
        up, the lower edge is where the pen is; going down, where the arc ends.

        Args:
            length: Along the way, m.
            angle: Of the arc, rad, left positive.
            half: Half width of the way, m.
            recess: By which the tread overhangs its riser, m; the sign gives the end.
            down: Whether the stair leads down.
        """
        radius = length / abs(angle)
        # length of the rectangle, to the outer corner of the next edge; width on the inner side of the bend
        reach = (radius + half) * math.sin(abs(angle))
        inner = radius - (radius - half) * math.cos(angle)  # as far as the next edge begins
        left, right = (inner, half) if angle > 0.0 else (half, inner)
        x, y, heading = self.x, self.y, self.heading
        self._advance(length, angle / length, "stair")
        if down:  # the lower edge is where the pen is now, and the rectangle extends back from it
            heading = self.heading
            x, y = self.x - reach * math.cos(heading), self.y - reach * math.sin(heading)
        self._add_slab(
            Slab(
                x=x,
                y=y,
                heading=heading,
                length=reach,
                left=left,
                right=right,
                z0=self.z,
                z1=self.z,
                terrain="stair",
                recess=recess,
            )
        )

    def lay_crossing(self, length: float, aside: float, left: float, right: float) -> None:
        """Lays a level slab on which the way crosses over to the next lane by two arcs of equal radius.

        Args:
            length: Of the slab, m.
            aside: Distance to the left that the way moves, m.
            left: Extent of the slab to the left of the first part of the way, m.
            right: Extent to the right, m.
        """
        self._add_slab_here(length, left, right)
        # two arcs of radius r that turn by θ and back move the way by 2 r sin θ along the slab, `aslant`, and by
        # 2 r (1 − cos θ) to the side; so tan(θ / 2) is `aside` / `aslant`
        aslant = length - 2 * _CROSSING_STRAIGHT_M
        curvature = 4 * aside / (aslant**2 + aside**2)  # 1/m of the first arc; `run` is the length of each
        run = 2 * math.atan2(abs(aside), aslant) / abs(curvature)
        heading = self.heading
        self._advance(_CROSSING_STRAIGHT_M, 0.0)
        self._advance(run, curvature)
        self._advance(run, -curvature)
        self.heading = heading  # exactly, so that lines before and after are one direction
        self._advance(_CROSSING_STRAIGHT_M, 0.0)

    def _advance(
        self, length: float, curvature: float, terrain: str = "level", rise: float = 0.0, cross_slope: float = 0.0
    ) -> None:
        """Moves the pen along a line or an arc, and adds the segment to the way and its profile.

        Args:
            length: m.
            curvature: 1/m, left positive; 0 for a line.
            terrain: Class of the ground.
            rise: Change of height over the length, m.
            cross_slope: Tilt sideways, rad.
        """
        here = CurveSegment(
            s0=self.s, s1=self.s + length, x=self.x, y=self.y, heading=self.heading, curvature=curvature
        )
        strip = Strip(
            s0=self.s, s1=self.s + length, z0=self.z, z1=self.z + rise, terrain=terrain, cross_slope=cross_slope
        )
        self.segments.append(here)
        last = self.strips[-1] if self.strips else None
        # levels of one height become one strip
        if last and terrain == "level" and replace(last, s0=strip.s0, s1=strip.s1) == strip:
            self.strips[-1] = replace(last, s1=strip.s1)
        else:
            self.strips.append(strip)
        way = Way(segments=(here,))  # gives position and direction at the end of the segment
        self.x, self.y = way.point(here.s1).tolist()
        self.heading = float(way.heading(here.s1))
        self.s, self.z = here.s1, strip.z1

    def _add_slab_here(
        self,
        length: float,
        left: float,
        right: float,
        terrain: str = "level",
        rise: float = 0.0,
        cross: float = 0.0,
        recess: float = 0.0,
    ) -> None:
        """Adds a slab that begins at the pen, in its direction and at its height.

        The arguments are those of `lay_straight`; `cross` is the tilt sideways, rad.
        """
        self._add_slab(
            Slab(
                x=self.x,
                y=self.y,
                heading=self.heading,
                length=length,
                left=left,
                right=right,
                z0=self.z,
                z1=self.z + rise,
                terrain=terrain,
                cross_slope=cross,
                recess=recess,
            )
        )

    def round_last_edge(self, radius: float) -> None:
        """Rounds the end of the last slab with a radius, m."""
        if self.slabs:
            self.slabs[-1] = replace(self.slabs[-1], end_radius=radius)

    def _add_slab(self, slab: Slab) -> None:
        """Adds a slab; merges it with the last one if both are on one level."""
        slab = replace(slab, start_radius=self.edge_radius)
        self.edge_radius = 0.0  # used up by this slab
        if self.slabs and slab.terrain == "level":
            last = self.slabs[-1]
            meets = math.dist(last.point(last.length, 0.0), slab.point(0.0, 0.0)) < 1e-9
            # they must agree in all but place and length
            if meets and replace(last, x=slab.x, y=slab.y, length=slab.length) == slab:
                self.slabs[-1] = replace(last, length=last.length + slab.length)
                return
        self.slabs.append(slab)
        self.owners.append(self.owner)


def _lay_segment(pen: _Pen, segment: Segment, half: float) -> None:
    """Lays one segment, level ground, stairs or a ramp, with the half width `half` in m."""
    match segment:
        case Level(length_m=length, cross_slope_rad=cross):
            pen.lay_straight(length, "level", half, half, cross_slope=cross)
        case Ramp(angle_rad=angle, rise_m=rise, cross_slope_rad=cross, down=down):
            up = -rise if down else rise
            pen.lay_straight(rise / math.tan(angle), "ramp", half, half, rise=up, cross_slope=cross)
        case Stairs(heights_m=heights, tread_m=tread, down=down):
            sign, first = -1.0 if down else 1.0, len(pen.slabs)  # of all heights; number of the flight's first slab
            # overhang of a tread, m, which is all of it without risers below; and its own rise, m
            recess, rise = tread if segment.open_risers else segment.nosing_m, tread * math.tan(segment.tread_slope_rad)
            for i, height in enumerate(heights):  # before each riser but the first, a tread
                if i and segment.turn_rad:
                    pen.lay_winder(tread, segment.turn_rad / (len(heights) - 1), half, sign * recess, down)
                elif i:
                    pen.lay_straight(tread, "stair", half, half, rise=sign * rise, recess=sign * recess)
                # the edge is the upper end of the riser: the end of the last slab, or the start of the next one
                if down:
                    pen.round_last_edge(segment.edge_radius_m)
                else:
                    pen.edge_radius = segment.edge_radius_m
                pen.z += sign * height
            if segment.turn_rad:
                pen.flights.append(range(first, len(pen.slabs)))


def _lay_lanes(pen: _Pen, group: Lanes, width: float) -> None:
    """Lays terrains side by side; the pen continues at the end of the walked one.

    Every lane has a pen of its own, and shorter lanes are extended by a level to the length of the longest one.

    Args:
        pen: Pen of the walked lane.
        group: The lanes, from left to right.
        width: Of one lane, m.
    """
    pens = [pen if i == group.walk else pen.start_beside((group.walk - i) * width) for i in range(len(group.lanes))]
    for lane_pen, lane in zip(pens, group.lanes):
        for segment in lane:
            _lay_segment(lane_pen, segment, width / 2)
    end = max(p.s for p in pens)  # arc length at the end of the longest lane
    for lane_pen in pens:
        if end - lane_pen.s > 1e-6:
            lane_pen.lay_straight(end - lane_pen.s, "level", width / 2, width / 2)
        if lane_pen is not pen:
            pen.slabs += lane_pen.slabs
            pen.owners += lane_pen.owners


def _lay_landing(pen: _Pen, level: Level, before: Segment | None, after: Segment | None, width: float) -> None:
    """Lays a level as wide as the lanes before and after it, on which the way crosses over to the next walked lane.

    Raises:
        ConfigError: The level is too short to cross over.
    """
    sides = []  # m, (left, right) extent that the lanes before and after need
    aside = 0.0  # m to the left, from the lane walked before to the one walked after
    if isinstance(before, Lanes):
        sides.append(_extents_of_lanes(before, width, 0.0))
    if isinstance(after, Lanes):
        if isinstance(before, Lanes):
            aside = (before.walk - after.walk) * width
        sides.append(_extents_of_lanes(after, width, aside))
    left, right = np.max(sides, axis=0).tolist()
    if aside == 0.0:  # the way goes straight on, because no other lane follows
        pen.lay_straight(level.length_m, "level", left, right)
        return
    # length L along the slab of two arcs of at least this radius r that turn by at most 90 degrees (`lay_crossing`):
    # L² ≥ 4 r a − a² and L ≥ a, for a distance a between the lanes
    arcs_m = math.sqrt(max(4 * _CROSSING_RADIUS_M * abs(aside) - aside**2, aside**2))
    shortest = 2 * _CROSSING_STRAIGHT_M + arcs_m
    if level.length_m < shortest - 1e-9:
        at = f"segments[{pen.owner}].length_m"
        valid = f"at least {shortest:.2f} m, to cross over to a lane {abs(aside):.2f} m away"
        raise ConfigError("route", at, level.length_m, valid)
    pen.lay_crossing(level.length_m, aside, left, right)


def _extents_of_lanes(group: Lanes, width: float, aside: float) -> tuple[float, float]:
    """Extent of the lanes to the left and right, m, of a line that is `aside` m to the right of the walked lane.

    `width` is that of one lane, m.
    """
    return (group.walk + 0.5) * width + aside, (len(group.lanes) - group.walk - 0.5) * width - aside


def _are_in_flight(treads: range, i: int, k: int) -> bool:
    """Whether slabs i and k both belong to a winding flight or its landings, and at least one is a tread of it."""
    near = range(treads.start - 1, treads.stop + 1)  # the treads and the landings before and after them
    return (i in treads or k in treads) and i in near and k in near


def _check_conflicts(pen: _Pen, count: int) -> None:
    """Rejects ground that overlaps other ground at another height: a way cannot pass under or through it.

    Treads of a winding flight lie partly under higher ones and under the upper landing; these pairs are not tested.

    Args:
        pen: The layout.
        count: Number of segments of the route, without lead-in and run-out, for messages.

    Raises:
        ConfigError: Names the segment, and what it overlaps.
    """
    for i, (slab, owner) in enumerate(zip(pen.slabs, pen.owners)):
        # points of the slab from 2 cm inside its borders, about 0.25 m apart
        along = np.linspace(0.02, slab.length - 0.02, max(2, math.ceil(slab.length / 0.25)))
        across = np.linspace(0.02 - slab.right, slab.left - 0.02, max(2, math.ceil((slab.left + slab.right) / 0.25)))
        # (P, 3) m, points of the slab's surface
        points = slab.point(*np.meshgrid(along, across)).reshape(-1, 3)
        for k, (other_slab, other_owner) in enumerate(zip(pen.slabs, pen.owners)):
            if k == i or any(_are_in_flight(flight, i, k) for flight in pen.flights):
                continue
            # m along the other slab from its start, and to the left of its axis; slabs that only touch do not overlap,
            # so 1 cm at its borders does not count
            u, v = other_slab.local(points[:, :2])
            inside = (
                (u > 0.01)
                & (u < other_slab.length - 0.01)
                & (v > 0.01 - other_slab.right)
                & (v < other_slab.left - 0.01)
            )
            gap = np.where(inside, points[:, 2] - other_slab.point(u, v)[:, 2], 0.0)
            worst = int(np.argmax(np.abs(gap)))
            if abs(gap[worst]) > _SAME_HEIGHT_M:
                late, early = max(owner, other_owner), min(owner, other_owner)
                names = [
                    "the start" if number < 0 else "the run-out" if number == count else f"segments[{number}]"
                    for number in (late, early)
                ]
                x, y, _ = points[worst]
                valid = f"no overlap with other ground at another height (here {abs(gap[worst]):.2f} m apart)"
                raise ConfigError("route", names[0], f"over {names[1]} at x = {x:.1f}, y = {y:.1f} m", valid)
