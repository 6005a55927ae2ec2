"""The ground along a line: its height, edges and slope breaks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.terrain_map.bends import Stretch, straight_stretches
from stridetwin.estimators.terrain_map.estimate import Change, Plane, Profile, Stairs, TerrainEstimate
from stridetwin.estimators.terrain_map.order_statistics import median, sort
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.plane_fit import BORDER_M, height_toward
from stridetwin.estimators.terrain_map.plane_set import COLUMNS, PlaneSet, Surface
from stridetwin.estimators.terrain_map.terrains import KERB_M, STRIP_M, is_flat
from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent

_HALF_WIDTH_M = 0.24
"""The line is as wide as a person walks, to either side."""
_LANE_M = 0.04
"""Distance between parallel lanes."""
_MIN_LANES = 4
"""Smallest number of lanes on a plane, or with a known height, of the 13 every `_LANE_M` over the line's width."""
_MIN_SAMPLES = 3
"""Smallest number of samples on a plane for it to count."""
_BORDER_REACH_M = 0.15
"""Largest distance of a slope break from the gap between two planes."""
_MIN_BREAK_SD = 4.0
"""Smallest slope break, in standard deviations of the difference of two slopes."""
_MIN_COSINE = 0.3
"""Smallest cosine between line and ascent at which the line crosses an edge."""
_UNEVEN_M, _UNEVEN_RISER_M = 0.06, 0.03
"""Largest distance of an edge, and of a riser, from the equal steps of its flight."""
_EVEN_SD_M = 0.015
"""Standard deviation of an edge inferred from the others of its flight."""
_INFERRED_REACH_M = 0.05
"""Largest distance of an inferred edge from the unobserved gap."""


def read_profile(
    estimate: TerrainEstimate | None,
    planes: PlaneSet,
    R_world_grid: Array,
    p: TerrainMapParameters,
    origin: Array,
    heading: float,
    length_m: float,
) -> Profile:
    """Reads the profile of the ground along a line: height, plane and slope at each sample, and its changes.

    Where a plane bends along the line, each straight stretch has its own height and slope.

    Args:
        estimate: Planes and terrains; None gives a profile without ground.
        planes: Columns of the map.
        R_world_grid: (3, 3) grid to world axes.
        p: Size of a column, standard deviations, and the smallest slope break.
        origin: (2,) start of the line, m, world.
        heading: Direction of the line in the world, rad from x.
        length_m: Length of the line, m.
    """
    # samples along the line, and parallel lanes to its left (positive) and right, m
    s = np.arange(0.0, length_m, p.voxel_size_m) + p.voxel_size_m / 2
    lanes = np.arange(-_HALF_WIDTH_M, _HALF_WIDTH_M + 0.01, _LANE_M)
    if estimate is None:
        nothing = np.full(len(s), np.nan)
        return Profile(s=s, height=nothing, plane=np.full(len(s), -1), changes=())
    forward = np.array([math.cos(heading), math.sin(heading)])
    # in grid axes, where v @ R_world_grid is v: start of the line in columns, and columns per metre along it
    turn = R_world_grid[:2, :2]
    start_column, columns_per_m = origin @ turn / p.voxel_size_m, forward @ turn / p.voxel_size_m
    slot, height = _read_lanes(planes.surface, start_column, columns_per_m, s, lanes)  # (N,) each
    plane = np.where(slot >= 0, planes.ids[slot], -1)
    runs = _find_straight_runs(s, height, plane, estimate, origin, forward, p)
    # where a plane is known, its own height and slope replace those of the columns
    slope, slope_sd = np.full(len(s), np.nan), np.full(len(s), np.nan)
    for id_ in _plane_ids(plane):
        whole_plane = estimate.planes[id_]
        on = plane == id_  # (N,) samples on this plane
        height[on] = whole_plane.height(origin + s[on, None] * forward)
        slope[on], slope_sd[on] = math.atan(float(whole_plane.gradient @ forward)), whole_plane.slope_sd
    for run in runs:
        if run.stretch is not None:  # the plane bends along the line
            on = np.zeros(len(s), bool)
            on[run.first : run.last + 1] = True
            on = on & (plane == run.plane.id)
            height[on] = run.plane.height(origin + s[on, None] * forward)
            slope[on] = math.atan(run.stretch.slope)
            slope_sd[on] = math.hypot(p.slope_sd_rad, run.stretch.slope_sd)
    changes = _find_changes(s, runs, estimate, origin, forward, p)
    return Profile(s=s, height=height, plane=plane, changes=changes, slope=slope, slope_sd=slope_sd)


def _plane_ids(plane: NDArray[np.int64]) -> list[int]:
    """Ids of the planes (N,) along a line, in ascending order, without -1."""
    return sorted(set(plane.tolist()) - {-1})


@entry_kernel(_HERE)
def _read_lanes(
    surface: Surface, origin: Array, forward: Array, s: Array, lanes: Array
) -> tuple[NDArray[np.int64], Array]:
    """The ground along a line, by majority over parallel lanes.

    Args:
        surface: The columns.
        origin: (2,) start of the line, columns.
        forward: (2,) columns per metre along the line.
        s: (N,) m along it.
        lanes: (L,) m to its left.

    Returns:
        (N,) slot of the majority plane, -1 where too few lanes have one; (N,) m, median of the lanes' heights, NaN
        where too few are known.
    """
    label, height, first = surface.label, surface.height, surface.origin
    slot, middle = np.full(len(s), -1), np.full(len(s), math.nan)
    slots, heights = np.empty(len(lanes), np.int32), np.empty(len(lanes), np.float32)
    for n in range(len(s)):
        known = 0  # lanes of known height
        for lane in range(len(lanes)):
            i = math.floor(origin[0] + s[n] * forward[0] - lanes[lane] * forward[1])
            j = math.floor(origin[1] + s[n] * forward[1] + lanes[lane] * forward[0])
            slots[lane] = -1
            if i < first[0] or i >= first[0] + COLUMNS or j < first[1] or j >= first[1] + COLUMNS:
                continue
            # i & (COLUMNS - 1) is the column's place in the ring, i mod COLUMNS
            slots[lane] = label[i & (COLUMNS - 1), j & (COLUMNS - 1)]
            z = height[i & (COLUMNS - 1), j & (COLUMNS - 1)]
            if not math.isnan(z):
                heights[known] = z
                known += 1
        most = _MIN_LANES - 1  # lanes on the majority plane so far; that needs at least `_MIN_LANES`
        for lane in range(len(lanes)):
            count = 0
            for other in range(len(lanes)):
                count += slots[other] == slots[lane]
            if slots[lane] >= 0 and count > most:
                slot[n], most = slots[lane], count
        if known >= _MIN_LANES:
            sort(heights[:known])
            middle[n] = median(heights, known)
    return slot, middle


class _Run(NamedTuple):
    """A straight run of samples on one plane.

    Attributes:
        first: First sample.
        last: Last sample.
        plane: The plane; where it bends along the line, with height and slope of the stretch.
        stretch: The straight stretch of a plane that bends; None where it does not.
    """

    first: int
    last: int
    plane: Plane
    stretch: Stretch | None


def _find_straight_runs(
    s: Array,
    height: Array,
    plane: NDArray[np.int64],
    estimate: TerrainEstimate,
    origin: Array,
    forward: Array,
    p: TerrainMapParameters,
) -> list[_Run]:
    """Runs of samples on one plane along a line, cut where the plane's columns bend.

    Args:
        s: (N,) m along the line.
        height: (N,) m, height of each sample, NaN where unknown.
        plane: (N,) id of each sample's plane, -1 = none.
        estimate: Gives the planes.
        origin: (2,) start of the line, m.
        forward: (2,) unit vector of the line.
        p: Smallest slope break.
    """
    runs = []
    for first, last, id_ in _find_runs(plane):
        whole_plane = estimate.planes[id_]
        stretches = straight_stretches(s, np.where(plane == id_, height, np.nan), first, last, p.min_slope_break_rad)
        if len(stretches) < 2:
            runs.append(_Run(first, last, whole_plane, None))
        else:
            runs += [
                _Run(stretch.first, stretch.last, _tilt_along(whole_plane, stretch, origin, forward), stretch)
                for stretch in stretches
            ]
    return runs


def _flatten_strip(plane: Plane, forward: Array) -> Plane:
    """The plane, level along a line if it is shorter than any tread in that direction, (2,) `forward`.

    The slope of such a strip is that of a few voxels at an edge, and the next plane may be several treads away.
    """
    # a uniform distribution of length l has the variance l² / 12
    if 12.0 * float(forward @ plane.spread @ forward) >= STRIP_M**2:
        return plane
    gradient = plane.gradient - float(plane.gradient @ forward) * forward
    normal = np.array([-gradient[0], -gradient[1], 1.0])
    return replace(plane, normal=normal / np.linalg.norm(normal))


def _tilt_along(plane: Plane, stretch: Stretch, origin: Array, forward: Array) -> Plane:
    """The plane with the height and slope of a stretch along the line, and its own slope across the line.

    The line begins at `origin` (2,), m, and has the direction `forward` (2,).
    """
    # the plane's gradient, with the component along the line replaced by the stretch's slope
    gradient = plane.gradient + (stretch.slope - float(plane.gradient @ forward)) * forward
    normal = np.array([-gradient[0], -gradient[1], 1.0])
    centre = np.array([*(origin + stretch.s * forward), stretch.height])
    return replace(plane, centre=centre, normal=normal / np.linalg.norm(normal))


def _find_changes(
    s: Array, runs: Sequence[_Run], estimate: TerrainEstimate, origin: Array, forward: Array, p: TerrainMapParameters
) -> tuple[Change, ...]:
    """The edges and slope breaks between consecutive runs.

    Between two stretches of one plane there is always a slope break, at the bend. Between two planes
    `_edge_or_slope_break` decides.

    Args:
        s: (N,) m along the line.
        runs: Runs in order.
        estimate: Gives the mapped flights.
        origin: (2,) start of the line, m.
        forward: (2,) unit vector of the line.
        p: Standard deviations, and the smallest slope break.
    """
    changes = []
    for before, after in pairwise(runs):
        one, other, stretch = before.plane, after.plane, after.stretch
        if stretch is not None and before.stretch is not None and one.id == other.id:
            bend = math.atan(stretch.slope) - math.atan(before.stretch.slope)
            sd = max(stretch.break_sd, 2.0 * p.edge_sd_m)
            changes.append(Change(kind="slope_break", s=stretch.break_s, sd=sd, drop=0.0, bend=bend))
            continue
        end, start = float(s[before.last]), float(s[after.first])
        # a strip gives its own height, whatever slope its few voxels have
        if before.stretch is None:
            one = _flatten_strip(one, forward)
        if after.stretch is None:
            other = _flatten_strip(other, forward)
        change = _edge_or_slope_break(end, start, one, other, estimate, origin, forward, p)
        if change is not None:
            changes.append(change)
    return tuple(changes)


def _find_runs(plane: NDArray[np.int64]) -> list[tuple[int, int, int]]:
    """First and last sample of each run on one plane, and the plane's id; a plane split by another has two runs.

    `plane` (N,) are the planes' ids, -1 = none. Runs of fewer than `_MIN_SAMPLES` are left out, so a plane that only
    they interrupt has one run.
    """
    known = np.flatnonzero(plane >= 0)  # indices of the samples with a plane
    ends = np.flatnonzero(np.diff(plane[known])) + 1  # where another plane begins among them
    runs: list[tuple[int, int, int]] = []
    for samples in np.split(known, ends):  # all on one plane
        if len(samples) < _MIN_SAMPLES:
            continue
        first, last, id_ = int(samples[0]), int(samples[-1]), int(plane[samples[0]])
        if runs and runs[-1][2] == id_:  # only a short run lay between: the last run continues
            runs[-1] = runs[-1][0], last, id_
        else:
            runs.append((first, last, id_))
    return runs


def _edge_or_slope_break(
    end: float,
    start: float,
    one: Plane,
    other: Plane,
    estimate: TerrainEstimate,
    origin: Array,
    forward: Array,
    p: TerrainMapParameters,
) -> Change | None:
    """The change between two neighbouring planes along a line: an edge, a slope break, or None for neither.

    A slope break needs a bend beyond `min_slope_break_rad` and `_MIN_BREAK_SD`, and planes that meet near the gap
    between them, or differ there by less than a kerb in height. Otherwise a height difference of at least a kerb is an
    edge: at the edge of a mapped flight if there is one, else at the end of the upper plane.

    Args:
        end: Last sample of the plane before, m along the line.
        start: First sample of the plane after, m along the line.
        one: Plane before.
        other: Plane after.
        estimate: Gives the mapped flights.
        origin: (2,) start of the line, m.
        forward: (2,) unit vector of the line.
        p: Standard deviations, and the smallest slope break.
    """
    middle = 0.5 * (end + start)
    place = origin + middle * forward
    drop = float(other.height(place) - one.height(place))  # negative: the ground goes down
    slope_before, slope_after = float(one.gradient @ forward), float(other.gradient @ forward)  # rise over run
    bend = math.atan(slope_after) - math.atan(slope_before)  # rad
    bend_sd = math.hypot(_slope_sd(one, forward), _slope_sd(other, forward))
    bends = abs(bend) > max(p.min_slope_break_rad, _MIN_BREAK_SD * bend_sd)
    if not bends and is_flat(one, p) and is_flat(other, p):  # treads: their heights where they are well observed
        x, y = place.tolist()
        after, before = (height_toward(q.centre, q.gradient, q.spread, x, y, BORDER_M) for q in (other, one))
        drop = after - before
    bend_slope = slope_after - slope_before
    reach = abs(start - end) / 2 + _BORDER_REACH_M  # of a slope break from the middle of the gap, m
    if bends and abs(drop) < max(abs(bend_slope) * reach, KERB_M):
        # The planes meet where they are equally high, but no farther away than the map may have drawn their border.
        away = -drop / bend_slope  # from the middle of the gap, m
        s = middle + min(max(away, -reach), reach)
        place = origin + s * forward
        sd = math.hypot(_height_sd(one, place, p), _height_sd(other, place, p)) / abs(bend_slope)
        sd = math.hypot(sd, max(abs(away) - reach, 0.0))  # and by how much farther away they meet
        return Change(kind="slope_break", s=s, sd=max(sd, 2.0 * p.edge_sd_m), drop=0.0, bend=bend)
    if abs(drop) < KERB_M:
        return None
    # An edge: its position and standard deviation, `known`, from a flight that has it, or that it continues.
    for flight in (*estimate.stairs, *estimate.rises):
        known = _locate_edge_in_flight(flight, one.id, other.id, origin, forward, p.edge_sd_m)
        if known is None:
            known = _locate_edge_next_to_flight(flight, one.id, other.id, drop, origin, forward)
            # an inferred edge must lie in the gap between the planes, or near it
            if known is not None and not end - _INFERRED_REACH_M < known[0] < start + _INFERRED_REACH_M:
                known = None
        if known is not None:
            edge_s, edge_sd = known
            return Change(kind="edge", s=edge_s, sd=edge_sd, drop=drop, bend=0.0)
    # no flight: at the end of the upper plane
    s = end + p.voxel_size_m / 2 if drop < 0 else start - p.voxel_size_m / 2
    sd = max(abs(start - end) / 4, p.voxel_size_m / 2)  # the edge may lie anywhere in the gap
    return Change(kind="edge", s=s, sd=sd, drop=drop, bend=0.0)


def _slope_sd(plane: Plane, forward: Array) -> float:
    """Standard deviation of a plane's slope (rise over run) along a (2,) direction."""
    return math.sqrt(max(float(forward @ plane.covariance[1:, 1:] @ forward), 0.0))


def _height_sd(plane: Plane, place: Array, p: TerrainMapParameters) -> float:
    """Standard deviation of a plane's height at a (2,) position, m, without the pose error common to all planes."""
    # the pose error is in the covariance of every plane, docs/terrain_map.md (8)
    shared = np.diag([p.plane_sd_m, p.slope_sd_rad, p.slope_sd_rad]) ** 2
    J = np.array([1.0, *(place - plane.centre[:2])])  # derivative of the height by height at the centre and slopes
    return math.sqrt(max(float(J @ (plane.covariance - shared) @ J), 0.0))


def _locate_edge_in_flight(
    flight: Stairs, one: int, other: int, origin: Array, forward: Array, min_sd_m: float
) -> tuple[float, float] | None:
    """Position of the edge between two planes of a flight, m along a line, and its standard deviation.

    It is the measured edge, unless it is far from its place in the fitted flight, as when a leg occludes it: then the
    other edges determine it. None if the planes are not neighbours in the flight, or the line is nearly parallel to its
    edges.

    Args:
        flight: The flight.
        one: Id of one of the planes.
        other: Id of the other.
        origin: (2,) start of the line, m.
        forward: (2,) unit vector of the line.
        min_sd_m: Smallest standard deviation of a measured edge, m.
    """
    for k in range(flight.steps):
        if {flight.planes[k], flight.planes[k + 1]} == {one, other}:
            even = flight.start + k * flight.tread  # place of edge k in the fitted flight, m along the ascent
            if flight.steps > 2 and abs(float(flight.edges[k]) - even) > _UNEVEN_M:
                return _edge_crossing(flight, even, _EVEN_SD_M, origin, forward)
            sd = max(math.sqrt(max(flight.covariance[3, 3], 0.0)), min_sd_m)  # entry 3 is the start
            return _edge_crossing(flight, float(flight.edges[k]), sd, origin, forward)
    return None


def _locate_edge_next_to_flight(
    flight: Stairs, one: int, other: int, drop: float, origin: Array, forward: Array
) -> tuple[float, float] | None:
    """Position of the edge one tread beyond either end of a flight, m along a line, and its standard deviation.

    The riser of such an edge was observed, but not its position. None if there is no such edge.

    Args:
        flight: The flight.
        one: Id of the plane before the edge.
        other: Id of the plane after the edge.
        drop: Height after minus height before, m; must be close to the flight's riser in size.
        origin: (2,) start of the line, m.
        forward: (2,) unit vector of the line.
    """
    if flight.steps < 2 or abs(abs(drop) - flight.riser) > _UNEVEN_RISER_M:
        return None
    # whether the edge goes up in the flight's direction of ascent
    climbs = drop * float(flight.up @ forward) > 0.0
    upper, lower = (other, one) if drop > 0.0 else (one, other)
    if climbs and lower == flight.planes[-1]:
        return _edge_crossing(flight, flight.start + flight.steps * flight.tread, _EVEN_SD_M, origin, forward)
    if climbs and upper == flight.planes[0]:
        return _edge_crossing(flight, flight.start - flight.tread, _EVEN_SD_M, origin, forward)
    return None


def _edge_crossing(flight: Stairs, edge: float, sd: float, origin: Array, forward: Array) -> tuple[float, float] | None:
    """Position where a line crosses a flight's edge, m along the line, and its standard deviation.

    None if the line is nearly parallel to the edge.

    Args:
        flight: The flight.
        edge: Position of the edge along the flight's ascent, m.
        sd: Standard deviation of that position, m.
        origin: (2,) start of the line, m.
        forward: (2,) unit vector of the line.
    """
    along = float(flight.up @ forward)  # cosine between line and ascent; negative where the line leads down
    if abs(along) < _MIN_COSINE:
        return None
    return (edge - float(flight.up @ origin)) / along, sd / abs(along)
