"""The ground along the path as terrain segments, level or sloping, between edges and slope breaks."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from stridetwin.estimators.contact_terrain.estimate import probability_above
from stridetwin.estimators.locomotion_mode.estimate import MODES
from stridetwin.estimators.locomotion_mode.parameters import Settings
from stridetwin.estimators.locomotion_mode.vertical import remove_lean
from stridetwin.estimators.terrain_map import Change, Profile, Stairs, TerrainEstimate
from stridetwin.streams.samples import Array

BEHIND_M = 1.2
"""A path begins at s = 0, this far behind the body."""
MIN_FOOTHOLD_M = 0.22
"""Shortest tread that a foot is placed on. The map's `min_tread_m` is less, as it also bounds measured distances."""
OCCLUDED_EDGE_SD_M = 0.04
"""Standard deviation of an occluding edge."""
CLEARANCE_SD_M = 0.02
"""Standard deviation of a sole's apparent depth inside a riser."""
PLACE_SD_M = 0.008
"""Smallest standard deviation of the distance to a change."""
_OVERHANG_M, _OVERHANG_SD_M = 0.03, 0.03
"""Length of a sole that may extend over a free edge without penalty, and standard deviation of the overhang beyond it.

With twice the first, footprints lie 2 cm farther back up stairs, and 1 cm farther ahead down stairs.
"""
_ACROSS_SD_M = 0.05
"""Standard deviation of a sole's length beyond a slope break."""
_MIN_EDGE_SD_M = 0.01
"""Smallest standard deviation of an edge in the probability that a sole is beyond it."""
_KNOWN_RISER_SD_M, _KNOWN_TREAD_SD_M = 0.01, 0.03
"""Standard deviations below which a riser, and a tread, is well known."""
_UNDER_M, _BEGIN_SD_M = 0.5, 0.1
"""Ground first observed farther ahead of the body than this begins there, with this standard deviation."""
_MAX_SEGMENTS = 10
"""Largest number of segments along a path; farther ones are omitted."""
_HIDDEN_PER_SD = 4.0
"""Length occluded behind an edge, divided by the edge's standard deviation in the map."""
_HIDDEN_RISER_SD, _HIDDEN_TREAD_SD = 0.40, 0.15
"""Relative standard deviations of unobserved risers and treads from usual ones."""
_ALIKE_RISER_SD, _ALIKE_TREAD_SD = 0.05, 0.05
"""Relative standard deviations of those of stairs like the last observed ones."""
_ALIKE_FALL_M = 0.03
"""Largest difference between a height drop and a whole number of the last observed risers."""
_LEVEL_SD_RAD = 0.0175
"""Standard deviation of the slope where nothing is known of the ground."""
_STEEP_RAD = 0.19
"""Steepest slope of a usual ramp, rad: 11°. Steeper ones are ramps, too, unless they continue a flight."""
_SAME_PITCH = (0.5, 1.7)
"""Ratio of a slope to the pitch of the flight before it, between which it is taken for more of that flight. Tuned on
walks with a narrow, noisy camera."""
_FALL_UNSURE, _NO_DEPTH_UNSURE = 0.4, 0.7
"""Probability that a step is of any mode where the ground ends and images show something behind, and where they show no
depth: what falls there may be more than a riser, and what has no depth may be black or wet."""
_MIN_SEEN_M = 0.08
"""Shortest stretch over which a slope is taken: a cell of the plane extraction."""
_MAP_SD_M = 0.015
"""Standard deviation of the mapped height of one end of a plane over the other, by drift of the poses."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Segment:
    """A terrain segment between two changes.

    Attributes:
        start: m along the path, -inf for the first.
        start_sd: Standard deviation of `start`, m.
        end: m, inf for the last.
        end_sd: Standard deviation of `end`, m.
        drop: Height at its start over the end of the previous segment, m; 0 at a slope break.
        drop_sd: Standard deviation where unobserved, m.
        slope: rad, uphill positive.
        slope_sd: Standard deviation of `slope`, rad.
        mapped_slope: Slope in the map, which may lean.
        mode: Mode of steps within the segment: LG, RA or RD.
    """

    start: float
    start_sd: float
    end: float
    end_sd: float
    drop: float
    drop_sd: float
    slope: float
    slope_sd: float
    mapped_slope: float
    mode: str

    @property
    def length(self) -> float:
        """Length from start to end, m."""
        return self.end - self.start


class Fall(NamedTuple):
    """The end of the mapped ground ahead, beyond which an image would show more ground if it went on.

    Attributes:
        s: Where it ends, m along the path.
        length: Length beyond it in which ground is missing, m.
        is_deep: Whether images show something farther away there; otherwise they show no depth.
    """

    s: float
    length: float
    is_deep: bool


def last_flight(estimate: TerrainEstimate, before: Stairs | None) -> Stairs | None:
    """The well-known flight with the most steps, as flights of one building are alike; `before` if there is none."""
    most = np.array([_KNOWN_RISER_SD_M, _KNOWN_TREAD_SD_M]) ** 2  # largest variances of riser and tread
    known = [
        flight for flight in estimate.stairs if flight.steps > 1 and bool((np.diag(flight.covariance)[:2] < most).all())
    ]
    return max(known, key=lambda flight: flight.steps, default=before)


def segments_along(
    profile: Profile,
    estimate: TerrainEstimate | None,
    forward: Array,
    p: Settings,
    usual: Stairs | None = None,
    fall: Fall | None = None,
) -> list[Segment]:
    """Cuts a profile at its changes into terrain segments; at most one segment lies behind s = 0.

    Args:
        profile: Profile of the ground along the path.
        estimate: Planes and terrains of the map; None: unknown.
        forward: (2,) unit vector of the path.
        p: Dimensions and standard deviations.
        usual: Stairs like those here; None: none observed.
        fall: Where the mapped ground ends though the camera has looked beyond; None: it does not.
    """
    changes = _without_tread_breaks(_without_small_objects(profile.changes, p), p)
    changes, until = _passable_changes(changes, profile, estimate, p)  # until: impassable beyond, m along the path
    bounds = [_Bound(-math.inf, 0.0, 0.0)]
    seen = profile.s[profile.plane >= 0]  # m along the path, where the ground is mapped
    if len(seen) and seen[0] > BEHIND_M + _UNDER_M:  # distant ground does not give the slope under the feet
        bounds.append(_Bound(float(seen[0]), _BEGIN_SD_M, 0.0))
    for change in changes:
        bounds += _to_bounds(change, usual, p)
    if fall is not None and fall.is_deep and fall.s < until:
        bounds += _assume_fall(fall, usual, p)
    first = max(k for k, bound in enumerate(bounds) if bound.s < 0.0)  # the last bound behind the start of the path
    bounds = [*bounds[first : first + _MAX_SEGMENTS], _Bound(math.inf, 0.0, 0.0)]
    bounds = _split_smeared_flights(bounds, profile, estimate, forward, until, p)
    # slope of each segment in the map and its standard deviation, rad; indices of the segments with a mapped slope
    mapped, sd, known = np.zeros(len(bounds) - 1), np.full(len(bounds) - 1, _LEVEL_SD_RAD), []
    for k, (one, other) in enumerate(pairwise(bounds)):
        measured = None
        if not (_is_tread(one, other, p) or one.is_tread):  # a tread is level
            measured = _read_slope(profile, estimate, forward, one.s, min(other.s, until), p)
        if measured is not None:
            mapped[k], sd[k] = measured
            known.append(k)
    slope = mapped.copy()
    # whether two such segments are neighbours and meet in a slope break
    breaks = np.array([j == i + 1 and bounds[j].drop == 0.0 for i, j in pairwise(known)], bool)
    slope[known], sd[known] = remove_lean(
        mapped[known], sd[known], breaks, math.hypot(p.mode.lean_sd_rad, p.drift_slope_rad)
    )
    return [
        Segment(
            start=one.s,
            start_sd=one.sd,
            end=other.s,
            end_sd=other.sd,
            drop=one.drop,
            drop_sd=one.drop_sd,
            slope=float(slope[k]),
            slope_sd=float(sd[k]),
            mapped_slope=float(mapped[k]),
            mode=_mode_of_slope(float(slope[k]), p),
        )
        for k, (one, other) in enumerate(pairwise(bounds))
    ]


def _mode_of_slope(slope: float, p: Settings) -> str:
    """Mode of steps on ground of a slope (rad, uphill positive): LG up to `min_ramp_slope_rad`, else RA or RD."""
    if abs(slope) < p.mode.min_ramp_slope_rad:
        return "LG"
    return "RA" if slope > 0 else "RD"


def _without_small_objects(changes: Iterable[Change], p: Settings) -> list[Change]:
    """The changes in order, without those that are stepped over: ground that soon returns to its previous level.

    No foot is placed on a strip shorter than any tread, nor into a hole shorter than a step; these are small objects
    and reflections.
    """
    kept: list[Change] = []
    for change in sorted(changes, key=lambda c: c.s):
        kept.append(change)
        risen = 0.0  # from before edge k until after this change, m
        for k in range(len(kept) - 1, -1, -1):  # back over the edges before this change, to where the object may begin
            if kept[k].kind != "edge":
                break
            risen += kept[k].drop
            # longest object or hole: a strip without a foothold or, behind an edge higher than a riser, a tread
            longest = MIN_FOOTHOLD_M if abs(kept[k].drop) < p.map.max_riser_m else p.map.max_tread_m
            if abs(risen) < p.min_step_height_m and 0.0 < change.s - kept[k].s < longest:
                del kept[k:]  # the ground has returned to its level: neither end of the object is a change
                break
    return kept


def _without_tread_breaks(changes: list[Change], p: Settings) -> list[Change]:
    """The changes without slope breaks on treads: between two edges a tread apart the ground is level.

    The two sides of a tread are mapped at different times, which may draw a slope break between them.
    """
    edges = [change.s for change in changes if change.kind == "edge"]
    treads = [(start, end) for start, end in pairwise(edges) if end - start <= p.map.max_tread_m]  # m along the path
    return [
        change
        for change in changes
        if change.kind == "edge" or not any(start < change.s < end for start, end in treads)
    ]


def _passable_changes(
    changes: list[Change], profile: Profile, estimate: TerrainEstimate | None, p: Settings
) -> tuple[list[Change], float]:
    """The changes between the last impassable edge behind the walker and the first one ahead.

    Args:
        changes: All changes in order along the path.
        profile: Profile of the ground along the path.
        estimate: Planes and terrains of the map; None: unknown.
        p: Dimensions of steps.

    Returns:
        The changes; place of the impassable edge ahead, m along the path, inf without one.
    """
    first = 0  # index of the first change beyond the last impassable one behind the walker
    for k, change in enumerate(changes):
        if _is_impassable(change, profile, estimate, p):
            if change.s > BEHIND_M:  # ahead of the walker
                return changes[first:k], change.s
            first = k + 1
    return changes[first:], math.inf


def _is_impassable(change: Change, profile: Profile, estimate: TerrainEstimate | None, p: Settings) -> bool:
    """Whether an edge is impassable: a rise above a riser where no flight continues, or too steep a drop.

    `change.drop` is the rise of the ground in m, negative where it falls. A deep fall may be passable: the larger the
    standard deviation of the edge's place, the more treads may be hidden behind it.
    """
    if change.drop <= 0.0:
        return -change.drop > p.map.max_riser_m * (1.0 + _HIDDEN_PER_SD * change.sd / MIN_FOOTHOLD_M)
    if change.drop <= p.map.max_riser_m:
        return False
    beyond = profile.plane[(profile.s > change.s) & (profile.plane >= 0)]  # mapped planes behind it, the nearest first
    flights = estimate.stairs if estimate else ()
    continues_in_flight = any(int(plane) in flight.planes for plane in beyond[:1] for flight in flights)
    return not continues_in_flight


class _Bound(NamedTuple):
    """Bound between two segments.

    Attributes:
        s: Place along the path, m.
        sd: Standard deviation of the place, m.
        drop: Height by which the ground rises there, m; negative where it falls, 0 at a slope break.
        drop_sd: Standard deviation of the drop, m.
        is_tread: Whether a tread begins there though its end is not seen.
    """

    s: float
    sd: float
    drop: float
    drop_sd: float = 0.0
    is_tread: bool = False


def _split_smeared_flights(
    bounds: list[_Bound],
    profile: Profile,
    estimate: TerrainEstimate | None,
    forward: Array,
    until: float,
    p: Settings,
) -> list[_Bound]:
    """Bounds in which a slope that continues a flight with the flight's own pitch is a row of treads.

    Of the last treads ahead, a narrow or noisy camera shows little more than the edges, and the map joins them to one
    plane. Ramps are gentler, and hardly any begins where a stair of the same pitch ends. The treads are as long as the
    one before, and fall or rise together as the plane does.

    Args:
        bounds: Bounds of the segments; the last one is at inf.
        profile: Profile of the ground along the path.
        estimate: Planes of the map; None: unknown.
        forward: (2,) unit vector of the path.
        until: Impassable beyond, m along the path.
        p: Dimensions and standard deviations.
    """
    seen = profile.s[profile.plane >= 0]
    split = bounds[:2]
    for k in range(2, len(bounds)):
        before, one, other = bounds[k - 2], bounds[k - 1], bounds[k]
        measured = None
        if _is_tread(before, one, p) and before.drop * one.drop > 0.0 and not _is_tread(one, other, p):
            measured = _read_slope(profile, estimate, forward, one.s, min(other.s, until), p)
        if measured is not None:
            tread, rise = one.s - before.s, math.tan(measured[0])  # m, and per metre
            ratio = rise * tread / one.drop  # of the slope to the pitch of the flight
            if abs(measured[0]) > _STEEP_RAD and _SAME_PITCH[0] < ratio < _SAME_PITCH[1]:
                split[-1] = one._replace(is_tread=True)
                length = min(other.s, float(seen[-1])) - one.s
                count = round(length / tread) if other.drop == 0.0 and math.isfinite(other.s) else int(length / tread)
                spacing = length / count if count and math.isfinite(other.s) else tread
                edges = [
                    _Bound(one.s + j * spacing, OCCLUDED_EDGE_SD_M, rise * spacing, is_tread=True)
                    for j in range(1, count + 1)
                ]
                if edges and math.isfinite(other.s):  # the last edge is where the slope ends
                    other = edges.pop()._replace(is_tread=False)
                split += edges
        split.append(other)
    return split


def _is_tread(one: _Bound, other: _Bound, p: Settings) -> bool:
    """Whether the ground between two edges is a tread, and so level, whatever its mapped slope.

    A tread is mapped over several steps. A pose correction in between gives its two sides different heights.
    """
    return one.drop != 0.0 and other.drop != 0.0 and other.s - one.s <= p.map.max_tread_m


def _to_bounds(change: Change, usual: Stairs | None, p: Settings) -> list[_Bound]:
    """Converts a change to the edges that can be stepped over.

    A camera looking down over an edge sees the ground up to the edge, but not what it occludes. The edge is where the
    upper ground ends; if the drop is more than a riser, treads are occluded and assumed. The upper ground appears to
    end too early, by about the estimated standard deviation, because pixels at discontinuities and sparse columns are
    removed.

    Args:
        change: Edge or slope break.
        usual: Stairs like those here; None: none observed.
        p: Dimensions and standard deviations.

    Returns:
        One bound or, for a deep fall, that of each assumed step; `drop` is negative where the ground falls.
    """
    if change.drop >= 0.0:
        return [_Bound(change.s, change.sd, change.drop)]
    hidden = _HIDDEN_PER_SD * change.sd  # length of ground that the edge occludes, m
    # of the assumed steps: riser and tread, m, their relative standard deviations, and how many make up the fall
    riser, tread, riser_sd, tread_sd = _assume_steps(-change.drop, usual, p)
    count = round(-change.drop / riser)
    sd = min(change.sd, OCCLUDED_EDGE_SD_M)
    edge_s = change.s + max(sd - PLACE_SD_M, 0.0)  # the upper ground appears to end too early
    first = _Bound(edge_s, sd, change.drop)
    if -change.drop < p.map.max_riser_m or count < 2 or hidden < MIN_FOOTHOLD_M:  # a single step
        return [first]
    if hidden / (count - 1) < MIN_FOOTHOLD_M:  # so many treads do not fit into the hidden length
        count = 1 + int(hidden / MIN_FOOTHOLD_M)
    tread, drop = min(hidden / max(count - 1, 1), tread), change.drop / count
    return [  # the standard deviation of the place grows from tread to tread
        _Bound(edge_s + k * tread, OCCLUDED_EDGE_SD_M + tread_sd * k * tread, drop, riser_sd * abs(drop))
        for k in range(count)
    ]


def _assume_fall(fall: Fall, usual: Stairs | None, p: Settings) -> list[_Bound]:
    """The bounds of treads that lead down where the mapped ground ends, as far as ground is missing."""
    riser, tread = (p.mode.usual_riser_m, p.mode.usual_tread_m) if usual is None else (usual.riser, usual.tread)
    count = max(1, round(fall.length / tread))
    return [
        _Bound(fall.s + k * tread, OCCLUDED_EDGE_SD_M * (1 + k), -riser, _HIDDEN_RISER_SD * riser) for k in range(count)
    ]


def _assume_steps(fall: float, last_stairs: Stairs | None, p: Settings) -> tuple[float, float, float, float]:
    """Riser and tread of occluded stairs, m, and the relative standard deviation of each.

    Args:
        fall: By how much the ground drops behind the edge, m.
        last_stairs: The stairs that the map saw last, which the occluded ones resemble if a whole number of their
            risers makes up the fall; None before the first ones.
        p: Settings, with the riser and tread of common stairs, which are assumed otherwise.
    """
    if last_stairs is not None:
        whole_risers = round(fall / last_stairs.riser)
        if abs(fall - whole_risers * last_stairs.riser) < _ALIKE_FALL_M:
            return last_stairs.riser, last_stairs.tread, _ALIKE_RISER_SD, _ALIKE_TREAD_SD
    return p.mode.usual_riser_m, p.mode.usual_tread_m, _HIDDEN_RISER_SD, _HIDDEN_TREAD_SD


def _read_slope(
    profile: Profile, estimate: TerrainEstimate | None, forward: Array, start: float, end: float, p: Settings
) -> tuple[float, float] | None:
    """Slope of the map between two positions along the path and its standard deviation, rad; None without a plane.

    It is that of the plane with the most points of the profile there or, where the profile has slopes of its own, their
    median over this plane.

    Args:
        profile: Profile of the ground along the path.
        estimate: Planes of the map; None: unknown.
        forward: (2,) unit vector of the path.
        start: First position, m along the path.
        end: Second position, m along the path.
        p: Standard deviations.
    """
    planes = {} if estimate is None else estimate.planes
    inside = (profile.s > start) & (profile.s < end) & (profile.plane >= 0)
    known = [int(i) for i in profile.plane[inside] if int(i) in planes]
    if not known or estimate is None:
        return None
    plane = planes[int(np.bincount(known).argmax())]  # the most frequent id
    on = inside & (profile.plane == plane.id)
    seen = profile.s[on]
    # slope by drift of the poses, rad
    bent = math.hypot(_MAP_SD_M, p.drift_m) / max(float(seen[-1] - seen[0]), _MIN_SEEN_M)
    slope, sd = math.atan(float(plane.gradient @ forward)), plane.slope_sd
    if profile.slope is not None and profile.slope_sd is not None:
        slope, sd = float(np.median(profile.slope[on])), float(np.median(profile.slope_sd[on]))
    return slope, math.hypot(p.mode.slope_sd_rad, sd, bent)


def half_sole(p: Settings) -> float:
    """Distance from the heel's centre forward to the middle of the sole, m."""
    return 0.5 * (p.mode.toe_m - p.mode.heel_m)


def segment_under(ground: Sequence[Segment], s: float, p: Settings) -> int:
    """Index of the segment under the middle of a sole whose heel's centre is at s, m along the path."""
    middle = s + half_sole(p)
    return next(k for k, segment in enumerate(ground) if middle < segment.end)


def surface_along(ground: Sequence[Segment], s: Array) -> tuple[Array, Array, Array]:
    """Height and slope of the ground at positions along the path.

    The height follows the mapped slopes, because it is compared with the map; the slope is the true one.

    Args:
        ground: Terrain segments.
        s: (S,) m along the path.

    Returns:
        (S,) height over the first segment's at s = 0, m; (S,) slope, rad; (S,) its standard deviation, rad.
    """
    height, slope, slope_sd = (np.zeros(len(s)) for _ in range(3))
    base = 0.0  # height at the start of the segment, m
    for k, segment in enumerate(ground):  # the first segment has no start: its height is 0 at s = 0
        here = (s >= segment.start) & (s < segment.end) if k else s < segment.end
        begin = segment.start if k else 0.0
        base += segment.drop if k else 0.0
        height[here] = base + math.tan(segment.mapped_slope) * (s[here] - begin)
        slope[here], slope_sd[here] = segment.slope, segment.slope_sd
        if math.isfinite(segment.end):
            base += math.tan(segment.mapped_slope) * (segment.end - begin)
    return height, slope, slope_sd


def slopes_under(ground: Sequence[Segment], on: Array) -> list[tuple[float, float]]:
    """Mean slope under each of K footprints and its standard deviation, rad.

    Args:
        ground: P terrain segments.
        on: (K, P) probability of each segment under each footprint; rows sum to 1.
    """
    slope, sd = np.array([(segment.slope, segment.slope_sd) for segment in ground]).T
    mean = on @ slope
    variance = on @ (sd**2 + slope**2) - mean**2  # of the mixture of the segments
    return list(zip(mean.tolist(), np.sqrt(np.maximum(variance, 0.0)).tolist()))


def foothold_heights(ground: Sequence[Segment], profile: Profile, s: Array, p: Settings) -> Array | None:
    """(S,) m, height of the ground that carries a sole whose heel's centre is at s (S,); None if nothing is observed.

    Heels overhang edges: it is the ground under the sole's middle, extended to the heel's centre, also where
    unobserved.

    Args:
        ground: Terrain segments along the path.
        profile: Profile of the ground along the path, whose heights are in the world.
        s: (S,) m along the path, positions of the heel's centre.
        p: Dimensions of the sole.
    """
    known = np.isfinite(profile.height)
    if not known.any():
        return None
    # height of the map over that of the segments, which begins at 0
    segment_height, _, _ = surface_along(ground, profile.s[known])
    off = np.median(profile.height[known] - segment_height)
    half = half_sole(p)
    middle, ends = s + half, [segment.end for segment in ground]  # (S,) of the sole; (P,) of the segments, m
    slope = np.array([segment.mapped_slope for segment in ground])[np.searchsorted(ends, middle, side="right")]
    height, _, _ = surface_along(ground, middle)
    return np.asarray(height - half * np.tan(slope) + off)  # back along the slope to the heel's centre


def edges_before(ground: Sequence[Segment]) -> list[int]:
    """Number of edges up to the start of each of P segments, its own start included; slope breaks do not count."""
    return np.cumsum([abs(segment.drop) > 0.0 for segment in ground]).tolist()


def mode_table(ground: Sequence[Segment], p: Settings) -> Array:
    """(P, P, 5) probability of each mode of a step from one segment to another: docs/locomotion_mode.md (9)."""
    table = np.zeros((len(ground), len(ground), len(MODES)))  # of steps from segment a to b; 0 for steps backward
    for b, segment in enumerate(ground):
        # probabilities that the ground that is stepped onto is a ramp up, and one down
        up, down = (
            probability_above(sign * segment.slope, p.mode.min_ramp_slope_rad, segment.slope_sd) for sign in (1.0, -1.0)
        )
        risen = 0.0  # sum of the edges between a and b, m
        for a in range(b, -1, -1):
            high = low = 0.0  # probabilities that the step goes up, and down, by a stair's height
            if risen != 0.0:
                high, low = (
                    probability_above(sign * risen, p.min_stair_riser_m, p.mode.riser_sd_m) for sign in (1.0, -1.0)
                )
            flat = 1.0 - up - down
            table[a, b] = flat * (1.0 - high - low), flat * high, flat * low, up, down  # LG, SA, SD, RA, RD
            risen += ground[a].drop
    return table


def foothold_weights(ground: Sequence[Segment], s: Array, p: Settings) -> Array:
    """(P, S) weight u of a foothold at s on each segment: docs/locomotion_mode.md (6).

    The whole sole is supported, and toes end before a riser.

    Args:
        ground: Terrain segments.
        s: (S,) m along the path, of the heel's centre.
        p: Dimensions of the sole.
    """
    weights = np.ones((len(ground), len(s)))
    middle = s + half_sole(p)  # of the sole
    start, start_sd, end, end_sd, drop = np.array([(g.start, g.start_sd, g.end, g.end_sd, g.drop) for g in ground]).T
    # Behind: a riser after a step down, a free edge after a step up, else a slope break. `inside` is the distance of
    # the heel or the toes from that end of the segment, m.
    inside = s - p.mode.heel_m - start[1:, None]
    weights[1:] *= _foothold_weight(inside, start_sd[1:], drop[1:]) * _probability_beyond(
        middle, start[1:], start_sd[1:]
    )
    # Ahead: a riser before a step up, a free edge before a step down. With both signs reversed, to be before the end is
    # to be beyond it.
    inside = end[:-1, None] - s - p.mode.toe_m
    weights[:-1] *= _foothold_weight(inside, end_sd[:-1], -drop[1:]) * _probability_beyond(
        -middle, -end[:-1], end_sd[:-1]
    )
    return weights


def _foothold_weight(inside: Array, sd: Array, fall: Array) -> Array:
    """(N, S) weight exp(−x²/2σ²) of a sole whose heel or toes extend by x, m, farther beyond an end than allowed.

    Args:
        inside: (N, S) m, negative where the sole extends beyond the segment's end.
        sd: (N,) standard deviation of the end, m.
        fall: (N,) height drop beyond the end, m; < 0 where the ground rises, which allows no overhang.
    """
    spread = np.where(fall < 0.0, CLEARANCE_SD_M, np.where(fall > 0.0, _OVERHANG_SD_M, _ACROSS_SD_M))
    allowed = np.where(fall > 0.0, _OVERHANG_M, 0.0)
    beyond = np.maximum(0.0, -inside - allowed[:, None])
    return np.asarray(np.exp(-0.5 * (beyond / np.hypot(spread, sd)[:, None]) ** 2))


def _probability_beyond(s: Array, start: Array, sd: Array) -> Array:
    """(N, S) probability that each position lies beyond each edge.

    (1 + tanh(x / 1.2)) / 2 is within 0.02 of the normal distribution.

    Args:
        s: (S,) m, positions.
        start: (N,) m, edges.
        sd: (N,) standard deviation of each edge, m.
    """
    return np.asarray(0.5 * (1.0 + np.tanh((s - start[:, None]) / (1.2 * np.maximum(sd, _MIN_EDGE_SD_M))[:, None])))


def is_under_foot(profile: Profile, here: float) -> bool:
    """Whether the map shows ground within a sole's length of a place `here`, m along the path."""
    return bool((np.abs(profile.s[profile.plane >= 0] - here) < MIN_FOOTHOLD_M).any())


def unseen_probability(
    profile: Profile, s: Array, here: float, p: Settings, *, is_lost: bool = False, fall: Fall | None = None
) -> Array:
    """(S,) probability that the ground at a position is of another mode than assumed, because it is not observed.

    Changes are random, one per `change_m` on average. Between two observed positions two changes would be needed; from
    the stance foot, whose ground may be unobserved, one is enough.

    Args:
        profile: Profile of the ground along the path.
        s: (S,) m along the path.
        here: Position of the stance foot, m: there is ground.
        p: Rate of changes.
        is_lost: Whether the map began anew during the walk and does not show the ground under that foot yet: that may
            be a stair, whose treads are the shorter way to a change.
        fall: Where the mapped ground ends though the camera has looked beyond; None: it does not.
    """
    seen = profile.s[profile.plane >= 0]
    bounds = np.concatenate([[-np.inf], seen, [np.inf]])  # m along the path, observed
    i = np.searchsorted(seen, s)  # index in `bounds` of the last one before each position
    back, ahead = s - bounds[i], bounds[i + 1] - s  # distance to the nearest observed position on either side, m
    # probability of a change on either side; -expm1(-x) = 1 - exp(-x) is that of a change within a length
    between = np.expm1(-back / p.mode.change_m) * np.expm1(-ahead / p.mode.change_m)
    if is_lost:
        return np.asarray(np.expm1(-back / p.map.max_tread_m) * np.expm1(-ahead / p.map.max_tread_m))
    chance = np.minimum(between, -np.expm1(-np.abs(s - here) / p.mode.change_m))
    if fall is not None:  # the middle of the sole is beyond the end
        beyond = s + half_sole(p) > fall.s
        chance[beyond] = np.maximum(chance[beyond], _FALL_UNSURE if fall.is_deep else _NO_DEPTH_UNSURE)
    return np.asarray(chance)


def mix_unseen(modes: Array, chance: Array) -> Array:
    """(K, 5) mode probabilities where each of the K steps may, with probability `chance` (K,), be of any mode."""
    return np.asarray((1.0 - chance[:, None]) * modes + chance[:, None] / len(MODES))


def path_scale(ground: Sequence[Segment], s: Array, ratios: Mapping[str, tuple[float, float]]) -> tuple[Array, Array]:
    """(S,) path length in units of level ground, m, and (S,) its local relative uncertainty.

    The path is longer where steps are shorter.

    Args:
        ground: Terrain segments.
        s: (S,) m along the path, evenly spaced.
        ratios: Step length relative to level ground and its standard deviation, by mode of the segment.
    """
    ratio, sd = np.ones(len(s)), np.zeros(len(s))  # of the step length to that on level ground, in each cell
    for segment in ground:
        if segment.mode in ratios:
            inside = (s >= segment.start) & (s < segment.end)
            ratio[inside], sd[inside] = ratios[segment.mode]
    return np.cumsum((s[1] - s[0]) / ratio), sd / ratio
