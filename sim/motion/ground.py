"""The terrain under a recorded walk, found from where its feet rest: levels, risers with their edges, and ramps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from stridetwin.sim.config import Level, Ramp, Route, Segment, Stairs
from stridetwin.sim.motion.parameters import MotionParameters
from stridetwin.sim.motion.rests import FootRest, FootTrack
from stridetwin.sim.wearer.dimensions import Shoe
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Array

_BEFORE_M = 0.3  # from the world's origin to the first footprint
_BEHIND_M = 1.5  # by which the walk may reach behind the origin
_BEYOND_M = 1.0  # level ground beyond the walk
_BESIDE_M = 0.7  # ground beside the outermost footprint
_MIN_WIDTH_M = 2.4
_STRAIGHT = 0.9  # distance of the ends over the length of the path, of a walk in one direction
_LONG_FLIGHT = 8  # risers from which the depth of a tread is found more finely
_TREADS_M = (0.20, 0.55)  # depths of treads that are tried
_USUAL_RISER_M, _HIGHEST_RISER_M = 0.17, 0.25
_BUILDERS_STEP_M, _BUILDERS_SD_M = 0.63, 0.03
_UNLIKELY_RISER_M, _UNLIKELY_SD_M = 0.10, 0.02  # height below which a riser is rather a part of a ramp
_HEIGHT_SD_M, _TILT_SD_RAD = 0.005, 0.015  # of soles in their rests, beside what they have in common
_BIAS_SD_M, _BIAS_SD_RAD = 0.02, 0.03  # of heights between the sides, and of the tilt of each sole
_RAMP_EVIDENCE = 25.0  # by which the squared errors of a ramp, in standard deviations, are below those of steps
_STEEPEST_RAD, _LOWEST_RAMP_M = 0.34, 0.06
_RAMP_STEPS, _FINE_RAMP_M = 60, 0.01  # places at which a ramp may begin or end, and how finely they are found
_SHORTEST_RAMP_M, _AROUND_SOLE_M = 0.4, 0.15
_SWING_WEIGHT = 0.3  # of the depth of a swinging foot in a step, relative to that of a footprint
_ROWS = 400  # of the paths of the feet from which edges are placed


@dataclass(frozen=True, kw_only=True, eq=False)
class RoutePlacement:
    """How the laboratory lies in the world of the twin.

    Attributes:
        turn: Rotation from the laboratory to the world about the vertical, rad.
        shift: (3,) m, origin of the laboratory in the world.
    """

    turn: float
    shift: Array

    def then(self, other: RoutePlacement) -> RoutePlacement:
        """This placement, after which the other one is applied."""
        return RoutePlacement(turn=self.turn + other.turn, shift=other.points(self.shift))

    def points(self, x: Array) -> Array:
        """(..., 3) points of the laboratory in the world."""
        return x @ self.matrix.T + self.shift

    @property
    def matrix(self) -> Array:
        """(3, 3) rotation from the laboratory to the world."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, kw_only=True, eq=False)
class Ground:
    """Terrain of a recorded walk.

    Attributes:
        route: Segments.
        heights: (K,) m, height of the ground under each stance, in the order of the stances that were given; NaN of a
            foot that never lies flat and is at none of the heights of the others: it has not landed.
        slopes: (K,) rad, inclination along x under each stance, uphill positive.
        riser_mm, tread_mm: Heights, up positive, and depths of the risers that were found, for people.
        ramp_deg: Inclination of the ramp that was found, for people; None if there is none.
        lift_m: Height by which the recording has to be raised, so that its ground is where the route is.
    """

    route: Route
    heights: Array
    slopes: Array
    riser_mm: tuple[float, ...]
    tread_mm: tuple[float, ...]
    ramp_deg: float | None = None
    lift_m: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class _RampFit:
    """A ramp between two levels.

    Attributes:
        begin, end: m, places along x.
        slope: Rise over length, up along x positive.
        cost: Squared errors of the rests, in standard deviations.
    """

    begin: float
    end: float
    slope: float
    cost: float


def place_route(stances: Sequence[FootRest], path: Array) -> RoutePlacement:
    """Where the laboratory lies in the world: the walk begins near the origin and goes along x.

    Args:
        stances: Stances of both feet, in order of time.
        path: (N, 3) m, the pelvis in the laboratory.
    """
    places = np.array([stance.p for stance in stances])
    steps = np.diff(path[:, :2], axis=0)
    net, length = path[-1, :2] - path[0, :2], np.linalg.norm(steps, axis=1).sum()
    if np.linalg.norm(net) > _STRAIGHT * length or np.ptp(places[:, 2]) > _USUAL_RISER_M:
        heading = np.arctan2(net[1], net[0])
    else:  # a walk that turns begins along x
        early = path[: max(2, len(path) // 8), :2]
        moved = early[-1] - early[0]
        heading = np.arctan2(moved[1], moved[0]) if np.linalg.norm(moved) > 0.3 else stances[0].yaw
    rotation = RoutePlacement(turn=-float(heading), shift=np.zeros(3))
    turned, feet = rotation.points(path), rotation.points(places)
    x = min(feet[0, 0] - _BEFORE_M, turned[:, 0].min() + _BEHIND_M, feet[:, 0].min() + _BEHIND_M)
    y = 0.5 * (feet[:, 1].min() + feet[:, 1].max())
    first = next((k for k, stance in enumerate(stances) if stance.flat is not None), 0)
    return replace(rotation, shift=-np.array([x, y, feet[first, 2]]))


def find_ground(
    stances: Sequence[FootRest], tracks: Sequence[FootTrack], shoe: Shoe, parameters: MotionParameters
) -> Ground:
    """Terrain under stances that are in the world of the route, in order of time.

    Rests at one height within half a riser are one level. The edges of a flight are evenly spaced; they are placed
    where the feet enter its steps least, in rests and in swing.

    Args:
        stances: Stances in order of time.
        tracks: Paths of both feet in the world.
        shoe: Their soles.
        parameters: Limits of risers and slopes.

    Raises:
        StrideTwinError: Heights that are no stairs of the twin.
    """
    z = _without_bias(stances, parameters)
    order = np.argsort([s.ground[0] for s in stances], kind="stable")
    groups: list[list[int]] = []
    flat = np.array([s.flat is not None for s in stances])
    if not flat.any():
        raise StrideTwinError("no foot ever lies flat on the ground: a terrain cannot be found; give the terrain")
    for k in order[flat[order]]:
        if groups and abs(z[k] - np.mean(z[groups[-1]])) < parameters.riser_m:
            groups[-1].append(int(k))
        else:
            groups.append([int(k)])
    frames = np.array([0.0 if s.flat is None else s.flat[1] - s.flat[0] for s in stances])
    levels = np.array([float(np.average(z[g], weights=frames[g])) for g in groups])
    feet = np.array([s.p for s in stances])
    ramp = _find_ramp([s for s in stances if s.flat is not None], shoe)
    if ramp is not None:
        tilts = _tilt_errors([s for s in stances if s.flat is not None], levels, z[flat])
        if ramp.cost + _RAMP_EVIDENCE < tilts and abs(ramp.slope) >= parameters.min_slope_rad:
            return _lay_ramp(ramp, stances, tracks, shoe)
    reach = max(float(np.max([t.p[:, 0].max() for t in tracks])), 0.0) + _BEYOND_M
    aside = float(np.abs(feet[:, 1]).max())
    width = max(_MIN_WIDTH_M, 2 * (aside + _BESIDE_M))
    heights, slopes = np.empty(len(stances)), np.zeros(len(stances))
    first = float(levels[0])
    levels = levels - first
    for group, level in zip(groups, levels):
        heights[group] = level
    for k in np.flatnonzero(~flat):
        nearest = levels[int(np.argmin(np.abs(levels - (z[k] - first))))]
        heights[k] = nearest if abs(nearest - (z[k] - first)) < parameters.riser_m else np.nan
    if len(groups) == 1:
        route = Route(segments=(Level(length_m=reach),), width_m=width)
        return Ground(route=route, heights=heights, slopes=slopes, riser_mm=(), tread_mm=())
    rises = np.diff(levels)
    if len(np.unique(np.sign(rises))) > 1 or np.abs(rises).max() > 2.4 * _HIGHEST_RISER_M:
        raise StrideTwinError(
            f"footprints change their height by {', '.join(f'{1e3 * r:.0f}' for r in rises)} mm one after another; "
            "a terrain is found for level ground and one flight of stairs: give the terrain"
        )
    risers, bounds = _riser_bounds(groups, rises, stances, shoe)
    edges = _place_edges(risers, bounds, levels[0], tracks, shoe, parameters)
    down = bool(rises[0] < 0)
    tread = float(edges[1] - edges[0]) if len(edges) > 1 else 0.30
    flight = Stairs(risers=len(risers), riser_m=tuple(abs(r) for r in risers), tread_m=tread, down=down)
    segments: tuple[Segment, ...] = (
        Level(length_m=float(edges[0])),
        flight,
        Level(length_m=max(0.6, reach - float(edges[-1]))),
    )
    return Ground(
        route=Route(segments=segments, width_m=width),
        heights=heights,
        slopes=slopes,
        riser_mm=tuple(1e3 * r for r in risers),
        tread_mm=(1e3 * tread,) if len(edges) > 1 else (),
    )


def _find_ramp(rests: Sequence[FootRest], shoe: Shoe) -> _RampFit | None:
    """The ramp that fits heights and tilts of flat soles best; None of a walk that does not climb.

    Of all places at which it may begin and end, slope, height, the height of the right soles over the left ones and the
    tilt of both soles are linear least squares.

    Args:
        rests: Rests in the world of the route.
        shoe: Their soles.
    """
    yaw = np.array([rest.yaw for rest in rests])
    x = np.array([rest.p[0] for rest in rests]) + 0.5 * (shoe.heel_back_x + shoe.toe_hinge_x) * np.cos(yaw)
    z = np.array([rest.p[2] for rest in rests])
    if np.ptp(z) < _LOWEST_RAMP_M or np.ptp(x) < _SHORTEST_RAMP_M:
        return None
    right = np.array([rest.side == "r" for rest in rests]).astype(float)
    target = np.concatenate([z / _HEIGHT_SD_M, [rest.tilt / _TILT_SD_RAD for rest in rests], np.zeros(3)])
    # columns: height, slope, bias of the right side, tilts of the left and the right sole
    fixed = np.zeros((len(target), 5))
    fixed[: len(x), 0], fixed[: len(x), 2] = 1.0 / _HEIGHT_SD_M, right / _HEIGHT_SD_M
    fixed[len(x) : -3, 3], fixed[len(x) : -3, 4] = (1.0 - right) / _TILT_SD_RAD, right / _TILT_SD_RAD
    fixed[-3:, 2:] = np.diag([1.0 / _BIAS_SD_M, 1.0 / _BIAS_SD_RAD, 1.0 / _BIAS_SD_RAD])

    def solve(begins: Array, ends: Array) -> tuple[Array, Array]:
        """(G, 5) values and (G,) costs of ramps that begin and end at (G,) m."""
        A = np.tile(fixed, (len(begins), 1, 1))
        A[:, : len(x), 1] = (np.clip(x, begins[:, None], ends[:, None]) - begins[:, None]) / _HEIGHT_SD_M
        is_on = (x > begins[:, None]) & (x < ends[:, None])
        A[:, len(x) : -3, 1] = is_on * np.cos(yaw) / _TILT_SD_RAD
        A_t = np.swapaxes(A, 1, 2)
        values = np.linalg.solve(A_t @ A + 1e-9 * np.eye(5), (A_t @ target)[..., None])[..., 0]
        errors = (A @ values[..., None])[..., 0] - target
        return values, np.sum(errors**2, axis=1) + 1e-3 * (ends - begins)  # the shorter of two that fit alike

    places = np.linspace(x.min() - _AROUND_SOLE_M, x.max() + _AROUND_SOLE_M, _RAMP_STEPS)
    step = float(places[1] - places[0])
    begins, ends = (grid.ravel() for grid in np.meshgrid(places, places, indexing="ij"))
    while True:
        is_long = ends - begins >= _SHORTEST_RAMP_M
        begins, ends = begins[is_long], ends[is_long]
        values, costs = solve(begins, ends)
        best = int(np.argmin(costs))
        if step < _FINE_RAMP_M:
            break
        offsets = np.linspace(-step, step, 9)
        begins, ends = (
            grid.ravel() for grid in np.meshgrid(begins[best] + offsets, ends[best] + offsets, indexing="ij")
        )
        step = float(offsets[1] - offsets[0])
    begin, end, slope = float(begins[best]), float(ends[best]), float(values[best, 1])
    if abs(np.arctan(slope)) > _STEEPEST_RAD or abs(slope) * (end - begin) < _LOWEST_RAMP_M:
        return None
    # where no rest is beyond an end, the ramp goes on under the whole sole
    if not (x < begin).any():
        begin = float(x.min()) - shoe.toe_tip_x - _AROUND_SOLE_M
    if not (x > end).any():
        end = float(x.max()) + shoe.toe_tip_x + _AROUND_SOLE_M
    return _RampFit(begin=begin, end=end, slope=slope, cost=float(costs[best]))


def _tilt_errors(rests: Sequence[FootRest], levels: Array, z: Array) -> float:
    """Squared errors, in standard deviations, of soles on levels: of their tilts, heights and of unlikely risers.

    Args:
        rests: Flat rests.
        levels: (G,) m, heights of the levels in walking order.
        z: (K,) m, heights of the rests.
    """
    cost = float(np.sum((np.min(np.abs(z[:, None] - levels), axis=1) / _HEIGHT_SD_M) ** 2))
    for side in ("l", "r"):
        tilts = np.array([rest.tilt for rest in rests if rest.side == side])
        if len(tilts):  # with a common tilt, whose scatter is that of soles
            share = len(tilts) / _TILT_SD_RAD**2
            common = share * tilts.mean() / (share + _BIAS_SD_RAD**-2)
            cost += float(np.sum(((tilts - common) / _TILT_SD_RAD) ** 2)) + (common / _BIAS_SD_RAD) ** 2
    risers = np.abs(np.diff(levels))
    return cost + float(np.sum((np.maximum(_UNLIKELY_RISER_M - risers, 0.0) / _UNLIKELY_SD_M) ** 2))


def _lay_ramp(ramp: _RampFit, stances: Sequence[FootRest], tracks: Sequence[FootTrack], shoe: Shoe) -> Ground:
    """The ground of stances on a ramp between two levels."""
    begin = max(ramp.begin, 0.05)  # the route begins with a level
    x = np.array([s.p[0] for s in stances])
    middle = x + 0.5 * (shoe.heel_back_x + shoe.toe_hinge_x) * np.cos([s.yaw for s in stances])
    is_on = (middle > begin) & (middle < ramp.end)
    slopes = np.where(is_on, np.arctan(ramp.slope), 0.0)
    heights = ramp.slope * (np.where(is_on, x, np.clip(middle, begin, ramp.end)) - begin)
    recorded = np.array([s.p[2] for s in stances]) + np.tan(slopes) * (x - middle)
    flat = np.array([s.flat is not None for s in stances])
    lift = float(np.median((heights - recorded)[flat]))
    # a foot that never lies flat, and is not at the height of the ground, has not landed
    heights[~flat & (np.abs(recorded + lift - heights) > _UNLIKELY_SD_M)] = np.nan
    reach = max(float(np.max([t.p[:, 0].max() for t in tracks])), 0.0) + _BEYOND_M
    width = max(_MIN_WIDTH_M, 2 * (float(np.max(np.abs([s.p[1] for s in stances]))) + _BESIDE_M))
    angle = float(np.arctan(abs(ramp.slope)))
    segments: tuple[Segment, ...] = (
        Level(length_m=begin),
        Ramp(angle_rad=angle, rise_m=abs(ramp.slope) * (ramp.end - begin), down=ramp.slope < 0.0),
        Level(length_m=max(0.6, reach - ramp.end)),
    )
    return Ground(
        route=Route(segments=segments, width_m=width),
        heights=heights,
        slopes=slopes,
        riser_mm=(),
        tread_mm=(),
        ramp_deg=float(np.degrees(np.arctan(ramp.slope))),
        lift_m=lift,
    )


def _without_bias(stances: Sequence[FootRest], parameters: MotionParameters) -> Array:
    """(K,) m, heights of the stances, corrected for the height of the right sole over the left one.

    On level ground it is the difference of their medians; on stairs, that which makes consecutive risers most alike.
    """
    z = np.array([s.p[2] for s in stances])
    right = np.array([s.side == "r" for s in stances])
    flat = np.array([s.flat is not None for s in stances])
    if right.all() or not right.any():
        return z
    if not (right & flat).any() or not (~right & flat).any():
        return z
    if np.ptp(z[right & flat]) < parameters.riser_m and np.ptp(z[~right & flat]) < parameters.riser_m:
        bias = float(np.median(z[right & flat]) - np.median(z[~right & flat]))
        return z - bias * right if abs(bias) < parameters.riser_m else z
    steps, sign = np.diff(z[flat]), np.diff(right[flat].astype(float))
    used = (sign != 0.0) & (np.abs(steps) > parameters.riser_m)
    if used.sum() < 3:
        return z
    A = np.column_stack([np.ones(used.sum()), sign[used]])
    bias = float(np.linalg.lstsq(A, steps[used], rcond=None)[0][1])
    return z - bias * right


def _riser_bounds(
    groups: list[list[int]], rises: Array, stances: Sequence[FootRest], shoe: Shoe
) -> tuple[list[float], list[tuple[float, float]]]:
    """Heights of the risers between groups of stances, m, and for each the range of x in which its edge lies.

    On the way up the tip of a foot below is in front of the riser, and the heel of a foot above is behind it; if feet
    overhang the edge, then its ball is. On the way down the ball of a foot above has not passed the edge, and the heel
    of a foot below has.
    """
    risers: list[float] = []
    bounds: list[tuple[float, float]] = []

    def x_of(stance: FootRest, along: float) -> float:
        return float(stance.p[0] + along * np.cos(stance.yaw))

    for (before, after), rise in zip(pairwise(groups), rises.tolist()):
        low = max(x_of(stances[k], shoe.flat_tip_x if rise > 0 else shoe.toe_hinge_x) for k in before)
        high = min(x_of(stances[k], shoe.heel_back_x) for k in after)
        if high < low:
            high = max(low, min(x_of(stances[k], shoe.toe_hinge_x) for k in after))
        count = 1 if abs(rise) <= _HIGHEST_RISER_M else max(2, round(abs(rise) / _USUAL_RISER_M))
        for _ in range(count):  # a foot that takes two treads at a time leaves their common edge open
            risers.append(rise / count)
            bounds.append((low, high))
    return risers, bounds


def _place_edges(
    risers: list[float],
    bounds: list[tuple[float, float]],
    begin: float,
    tracks: Sequence[FootTrack],
    shoe: Shoe,
    parameters: MotionParameters,
) -> Array:
    """(E,) m, x of evenly spaced edges at which the feet enter the steps least.

    Args:
        risers: Heights of the risers, m.
        bounds: Range of x of each edge, m.
        begin: Height of the level before the first, m.
        tracks: Paths of both feet in the world.
        shoe: Their soles.
        parameters: Play of the soles at the edges.
    """
    low, high = np.array(bounds).T
    number = np.arange(len(risers))
    treads = np.arange(*_TREADS_M, 0.005) if len(risers) > 1 else np.array([0.3])
    tops = begin + np.concatenate([[0.0], np.cumsum(risers)])
    rows = slice(None, None, max(1, len(tracks[0].p) // _ROWS))
    soles = np.concatenate(
        [
            track.point(x, y)[rows]
            for track in tracks
            for x in (shoe.heel_back_x, shoe.toe_hinge_x, shoe.flat_tip_x)
            for y in (-shoe.half_width, shoe.half_width)
        ]
    )
    soles = soles[np.argsort(soles[:, 0])]
    # depth of all soles up to one along x in each step: in the steps between two edges are those between their places
    deep = np.clip(tops - soles[:, 2:], 0.0, 0.10) ** 2
    summed = np.vstack([np.zeros(len(tops)), np.cumsum(deep, axis=0)])
    margin = parameters.edge_margin_m
    step_number = np.arange(len(tops))

    def place(treads: Array) -> Array:
        """(E,) m, x of the best edges with one of some depths of treads."""
        middle = np.mean(0.5 * (low + high) - number * treads[:, None], axis=1)
        first = middle[:, None] + np.arange(-0.12, 0.121, 0.005)
        edges = first[..., None] + number * treads[:, None, None]  # (T, F, E)
        outside = np.maximum(low - edges, 0.0) + np.maximum(edges - high, 0.0)
        # narrow ranges count more: an edge may be anywhere in a wide one
        off = (edges - 0.5 * (low + high)) / (high - low + margin)
        cost = np.sum((outside / margin) ** 2, axis=2) + np.sum(off**2, axis=2)
        # Blondel's rule of builders: two risers and a tread are a step of 0.63 m
        builders_step = 2.0 * abs(float(np.mean(risers))) + treads
        cost += (((builders_step - _BUILDERS_STEP_M) / _BUILDERS_SD_M) ** 2)[:, None]
        row = np.searchsorted(soles[:, 0], edges)
        ends = np.concatenate([row, np.full((*first.shape, 1), len(soles))], axis=2)
        begins = np.concatenate([np.zeros((*first.shape, 1), dtype=int), row], axis=2)
        entered = np.sum(summed[ends, step_number] - summed[begins, step_number], axis=2)
        cost += _SWING_WEIGHT * entered / margin**2 / len(soles)
        return np.asarray(edges[np.unravel_index(int(np.argmin(cost)), cost.shape)])

    edges = place(treads)
    if len(risers) >= _LONG_FLIGHT:  # errors of the tread add up
        edges = place(float(edges[1] - edges[0]) + np.arange(-0.005, 0.0051, 0.0002))
    return edges
