"""Scores of the terrain map: accuracy and completeness of its surface, and errors of the terrain changes ahead."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.estimators.terrain_map import Profile, TerrainMap
from stridetwin.outputs.alignment import YawAlignment
from stridetwin.outputs.base import BAD_SHARE, DESCRIPTIVE, SHARE, Score, Scores
from stridetwin.outputs.coverage import COVERAGE
from stridetwin.outputs.terrain.changes import ScoredChange, TerrainChange, mode_of
from stridetwin.outputs.truth import edges, flights, scoring_time_ns
from stridetwin.streams.samples import Array
from stridetwin.streams.terrain_truth import Layout, Slab, Strip

_HALF_WIDTH_M = 0.5  # of the scored ground
NEAR_M, FAR_M = 0.5, 2.5
"""The range of the ground ahead that is scored."""
_COMPLETE_M = 0.03  # largest error of the height of ground that counts as mapped
_CELL_M = 0.05  # distance of the samples of the ground
_MATCH_M = 0.35  # largest distance between a true flight's begin and its estimate
_MAX_EDGE_SD_M = 0.03
"""An edge with a larger standard deviation counts as not seen."""
_SAME_EDGE_M = 0.14
"""Half of the shortest tread in the scenarios; an edge farther away does not match."""
_TICK_S = 0.5  # time between two samples of the whole ground
_LATE_NS = 200_000_000  # a change that is due for so long has missed its depth image
_FLOOR_BELOW_M = 0.1  # how far the sides of the true ground reach below its lowest point
_STRAIGHT_M = 0.05  # the route is straight up to where it deviates by more from the line ahead
_REACH_M = 6.0
"""Edges farther away are not ahead."""
_FACING = 0.5
"""Least cosine of the angle between the line ahead and the route at an edge that is met from in front."""
_EVERY = 5
"""Of the map's points, every fifth is compared with the true ground."""

SCORES = (
    Score(
        name="accuracy_rmse_mm",
        heading="accuracy mm",
        label="Distance of the mapped ground to the true surface, RMS",
        unit="mm",
        digits=1,
    ),
    Score(name="accuracy_p95_mm", heading="accuracy 95 % mm", label="the same, 95th percentile", unit="mm", digits=1),
    Score(
        name="completeness_pct",
        scale=SHARE,
        heading="complete %",
        unit="%",
        digits=1,
        label="Ground 0.5 to 2.5 m ahead mapped within 3 cm",
    ),
    Score(
        name="edge_rmse_mm", heading="edges mm", label="Edge position along the route, RMS error", unit="mm", digits=1
    ),
    Score(name="edge_mean_mm", scale=DESCRIPTIVE),
    Score(name="edge_false_pct", scale=BAD_SHARE),
    Score(name="found_pct", scale=SHARE, heading="changes found %"),
    Score(name="begin_rmse_mm", heading="begin mm"),
    Score(name="riser_rmse_mm", heading="riser mm"),
    Score(name="tread_rmse_mm", heading="tread mm"),
    Score(name="slope_rmse_deg", heading="slope °"),
    COVERAGE,
)
"""The scores of a terrain map; see `map_figures`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MapScores:
    """Scores of one walk's map against the true terrain.

    Attributes:
        changes: The scored terrain changes, in order along the route.
        accuracy_m: RMS distance of the map's ground ahead on the route from the true mesh.
        accuracy_p95_m: 95th percentile of it.
        completeness: Share of the ground between 0.5 and 2.5 m ahead that is known within 3 cm.
        edge_errors: (E,) m, of every edge ahead with a standard deviation below 3 cm, each half second: estimated minus
            true position straight ahead, to the nearest true edge; inf if there is none within 6 m.
    """

    changes: tuple[ScoredChange, ...]
    accuracy_m: float
    accuracy_p95_m: float
    completeness: float
    edge_errors: Array


def mesh_of(slabs: Sequence[Slab]) -> Array:
    """The true ground as triangles: the top of each slab, and its four sides down to below the lowest top.

    Returns:
        (T, 3, 3) m: triangle, corner, coordinate in the true world.
    """
    # (4, 3) m, corners of each top in order around it
    tops = [
        slab.point([0, slab.length, slab.length, 0], [-slab.right, -slab.right, slab.left, slab.left]) for slab in slabs
    ]
    floor = min(float(top[:, 2].min()) for top in tops) - _FLOOR_BELOW_M
    faces = []  # (4, 3) m each
    for top in tops:
        under = np.column_stack([top[:, :2], np.full(4, floor)])  # the corners below those of the top
        sides = [np.array([under[i], under[j], top[j], top[i]]) for i, j in ((0, 1), (1, 2), (2, 3), (3, 0))]
        faces += [top, *sides]
    # two triangles per face
    return np.array([face[corners] for face in faces for corners in ([0, 1, 2], [0, 2, 3])])


def distance_to(triangles: Array, points: Array) -> Array:
    """(N,) m, distances of (N, 3) points from the surface of (T, 3, 3) triangles.

    A triangle is tested only with the points that are nearer to its bounding box than their smallest distance so far.
    """
    nearest = np.full(len(points), np.inf)
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    # level triangles first: most points lie on them, and upright ones are then mostly skipped
    flattest_first = np.argsort(high[:, 2] - low[:, 2], kind="stable")
    for i in flattest_first.tolist():
        # per axis, the distance from the bounding box
        apart = np.maximum(np.maximum(low[i] - points, points - high[i]), 0.0)
        near = np.flatnonzero((apart**2).sum(axis=1) < nearest**2)
        if len(near):
            nearest[near] = np.minimum(nearest[near], _distance_from_triangle(triangles[i], points[near]))
    return nearest


def _distance_from_triangle(triangle: Array, points: Array) -> Array:
    """(N,) m, distances of (N, 3) points from one triangle.

    The distance is that from the plane for points above or below the triangle, else that from the nearest side.
    """
    a, b, c = triangle
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    over = np.ones(len(points), bool)  # whether each point projects into the triangle
    sides = []
    for start, end in ((a, b), (b, c), (c, a)):
        along, offset = end - start, points - start
        # on the inner side of this side; the nearest point of the side is at `share` of it
        over &= offset @ np.cross(normal, along) >= 0.0
        share = np.clip(offset @ along / (along @ along), 0.0, 1.0)
        sides.append(np.linalg.norm(offset - share[:, None] * along, axis=1))
    return np.asarray(np.where(over, np.abs((points - a) @ normal), np.min(sides, axis=0)))


def true_changes(profile: Sequence[Strip]) -> list[TerrainChange]:
    """Stairs and ramps of a route as terrain changes, in order along it."""
    changes = [  # a flight is one change, at its first edge
        TerrainChange(
            s=flight.s,
            mode="SA" if flight.riser > 0 else "SD",
            riser=flight.riser,
            tread=flight.tread,
            risers=flight.risers,
        )
        for flight in flights(profile)
    ]
    changes += [
        TerrainChange(s=strip.s0, mode=mode_of(strip), slope=strip.slope)
        for strip in profile
        if strip.terrain == "ramp"
    ]
    return sorted(changes, key=lambda change: change.s)


class MapScorer:
    """Scores a map while it is built.

    Args:
        layout: The true terrain.
        path: (F, 2) touch-downs of the walk: time, ns, and place along the route, m.
    """

    def __init__(self, layout: Layout, path: Array) -> None:
        self._layout = layout
        # true changes that are not scored yet, each with the time at which it is due, ns (infinite: never); `sample`
        # removes them one by one and adds their scores to `_changes`
        self._pending = [(change, scoring_time_ns(change.s, *path.T)) for change in true_changes(layout.profile)]
        self._changes: list[ScoredChange] = []
        self._points: list[Array] = []  # per sample, (K, 3) m, points of the map's ground ahead in the true world
        self._complete: list[float] = []  # per sample, the share of the ground ahead that is mapped
        self._edges: list[Array] = []  # per sample, errors of the edges ahead, m
        self._tick_ns = 0  # when the next sample is due

    def sample(self, t_ns: int, mapper: TerrainMap, alignment: YawAlignment, place_m: float) -> bool:
        """Samples a map after a depth image: scores the changes that are due, and each half second the whole ground.

        Args:
            t_ns: Time of the depth image, ns.
            mapper: The map.
            alignment: From the map's world to the true one, now.
            place_m: Place of the camera along the route, m.

        Returns:
            Whether its whole ground was sampled, which happens each half second.
        """
        for change, at_ns in list(self._pending):
            if t_ns >= at_ns:
                self._pending.remove((change, at_ns))
                late = t_ns >= at_ns + _LATE_NS  # no image at that time: the change counts as not found
                self._changes.append(
                    ScoredChange(mode=change.mode, is_detected=False)
                    if late
                    else _score_change(change, mapper, place_m, alignment, self._layout)
                )
        if t_ns < self._tick_ns:
            return False
        self._tick_ns = t_ns + int(_TICK_S * 1e9)
        self._points.append(_ground_ahead(mapper, place_m, alignment, self._layout))
        self._complete.append(_completeness(mapper, place_m, alignment, self._layout))
        self._edges.append(_edge_errors(mapper, place_m, alignment, self._layout))
        return True

    def scores(self) -> MapScores:
        """The scores over all samples so far."""
        points = np.concatenate(self._points) if self._points else np.zeros((0, 3))
        distances = distance_to(
            mesh_of(self._layout.slabs), points
        )  # (N,) m, of the sampled points from the true ground
        return MapScores(
            changes=tuple(self._changes),
            accuracy_m=_rms(distances),
            accuracy_p95_m=float(np.percentile(distances, 95)) if len(distances) else math.nan,
            completeness=float(np.nanmean(self._complete)) if np.isfinite(self._complete).any() else math.nan,
            edge_errors=np.concatenate(self._edges) if self._edges else np.zeros(0),
        )


def map_figures(scores: MapScores) -> Scores:
    """The scores of one walk's map, in the units of a report; undefined scores are left out.

    Returns:
        `accuracy_rmse_mm`, `accuracy_p95_mm`, `completeness_pct`, `edge_rmse_mm`, `edge_mean_mm` of edges within 14 cm
        of a true one, `edge_false_pct`, the share of the others; of the changes `found_pct`, `begin_rmse_mm` of those
        with a mapped begin (also of a ramp whose slope is not found), and of those found `riser_rmse_mm`,
        `tread_rmse_mm`, `slope_rmse_deg`.
    """
    changes = scores.changes
    true = scores.edge_errors[np.abs(scores.edge_errors) < _SAME_EDGE_M]
    figures = {
        "accuracy_rmse_mm": 1e3 * scores.accuracy_m,
        "accuracy_p95_mm": 1e3 * scores.accuracy_p95_m,
        "completeness_pct": 100.0 * scores.completeness,
        "edge_rmse_mm": 1e3 * _rms(true),
        "edge_mean_mm": 1e3 * float(true.mean()) if len(true) else math.nan,
        "edge_false_pct": 100.0 * (1.0 - len(true) / len(scores.edge_errors)) if len(scores.edge_errors) else math.nan,
        "found_pct": 100.0 * float(np.mean([c.is_detected for c in changes])) if changes else math.nan,
        "begin_rmse_mm": 1e3 * _rms([c.distance_m for c in changes]),
        "riser_rmse_mm": 1e3 * _rms([c.riser_m for c in changes]),
        "tread_rmse_mm": 1e3 * _rms([c.tread_m for c in changes]),
        "slope_rmse_deg": math.degrees(_rms([c.slope_rad for c in changes])),
    }
    return {name: float(value) for name, value in figures.items() if math.isfinite(value)}


def _rms(values: Array | Sequence[float]) -> float:
    """RMS of the finite values; NaN if there are none."""
    finite = np.asarray(values, float)[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else math.nan


def _profile_ahead(mapper: TerrainMap, place_m: float, alignment: YawAlignment, layout: Layout) -> Profile:
    """The map's profile straight ahead of a place on the route, corrected for drift.

    Args:
        mapper: The map.
        place_m: The place along the route, m.
        alignment: From the map's world to the true one, now.
        layout: The true terrain.
    """
    heading = float(layout.way.heading(place_m))
    return mapper.profile(alignment.to_estimated(layout.way.point(place_m)), heading - alignment.yaw)


def _score_change(
    change: TerrainChange, mapper: TerrainMap, place_m: float, alignment: YawAlignment, layout: Layout
) -> ScoredChange:
    """Errors of the estimate of one terrain change.

    A ramp is found if the map has a slope of at least 5° shortly beyond its edge; stairs if a flight of two or more
    steps that rises or falls in the same direction begins within `_MATCH_M` of the true begin. A ramp has the error of
    its begin even if it is not found.

    Args:
        change: The true change.
        mapper: The map.
        place_m: Place of the camera along the route, m.
        alignment: From the map's world to the true one, now.
        layout: The true terrain.
    """
    estimate = mapper.estimate
    heading = float(layout.way.heading(change.s)) - alignment.yaw
    forward = np.array([math.cos(heading), math.sin(heading)])
    place = alignment.to_estimated(layout.way.point(change.s))
    if estimate is None:
        return ScoredChange(mode=change.mode, is_detected=False)
    if change.slope:
        # a ramp: the slope break nearest to the true edge gives the begin, even where the slope is not found
        mapped_changes = _profile_ahead(mapper, place_m, alignment, layout).changes
        slope_breaks = [c for c in mapped_changes if c.kind == "slope_break"]
        edge = min((place_m + c.s - change.s for c in slope_breaks), key=abs, default=math.nan)
        # plane and terrain of the mapped ground 0.4 m beyond the edge, or 0.8 m where none is known there
        ground = mapper.ground(place + 0.4 * forward) or mapper.ground(place + 0.8 * forward)
        if ground is None or ground[0].slope < math.radians(5):
            return ScoredChange(mode=change.mode, is_detected=False, distance_m=edge)
        plane, _ = ground
        slope = math.atan(float(plane.gradient @ forward))  # in the direction of the walk
        return ScoredChange(
            mode=change.mode,
            is_detected=True,
            distance_m=edge,
            slope_rad=slope - change.slope,
            slope_sd_rad=plane.slope_sd,
        )
    for flight in sorted(estimate.stairs, key=lambda f: -f.steps):  # the longest first
        # -1 where the walker goes down, against the flight's direction of ascent
        sign = math.copysign(1.0, change.riser)
        if float(flight.up @ forward) * sign < 0.9:  # it rises, or falls, in another direction than the true one
            continue
        # from the true begin to each edge of the flight, m forward; the first one that the walker meets is the begin
        edge_offsets = (flight.edges - float(flight.up @ place)) * sign
        first = min(edge_offsets[np.isfinite(edge_offsets)], default=math.nan)
        if abs(first) < _MATCH_M and flight.steps >= 2:
            return ScoredChange(
                mode=change.mode,
                is_detected=True,
                distance_m=float(first),
                riser_m=flight.riser - abs(change.riser),  # a flight's riser is positive
                tread_m=flight.tread - change.tread,
                # the covariance is that of riser, tread and further parameters
                riser_sd_m=math.sqrt(flight.covariance[0, 0]),
                tread_sd_m=math.sqrt(flight.covariance[1, 1]),
            )
    return ScoredChange(mode=change.mode, is_detected=False)


def _ground_ahead(mapper: TerrainMap, place_m: float, alignment: YawAlignment, layout: Layout) -> Array:
    """(N, 3) m, in the true world: every `_EVERY`-th point of the map's planes that lies ahead on the route.

    Args:
        mapper: The map.
        place_m: Place of the camera along the route, m.
        alignment: From the map's world to the true one, now.
        layout: The true terrain.
    """
    points, plane = mapper.surface_points()  # a point without a plane has the id -1
    ground_points = points[plane >= 0][::_EVERY]
    return points_ahead(alignment.to_true(ground_points), place_m, layout)


def points_ahead(points: Array, place_m: float, layout: Layout) -> Array:
    """(K, 3) m, the points that lie 0.5 to 2.5 m ahead of a place on the route, and within 0.5 m beside it.

    Args:
        points: (N, 3) m in the true world.
        place_m: The place along the route, m.
        layout: The true terrain.
    """
    near = points[np.linalg.norm(points[:, :2] - layout.way.point(place_m), axis=1) < FAR_M]
    s = _places_ahead(place_m, layout)
    if not len(s) or not len(near):  # at the end of the route, or nothing mapped nearby
        return np.zeros((0, 3))
    way, heading = layout.way.point(s), layout.way.heading(s)
    # (P, S, 2) m, from each sample of the route to each point; then (P, 2) from the nearest sample alone
    offsets = near[:, None, :2] - way
    nearest = np.argmin((offsets**2).sum(axis=-1), axis=1)
    offset = offsets[np.arange(len(near)), nearest]
    # in the axes of the route there: forward along it, and to the left
    cos, sin = np.cos(heading[nearest]), np.sin(heading[nearest])
    along, aside = offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin
    # farther along than a cell from the nearest sample are only points before the first one or beyond the last one
    return np.asarray(near[(np.abs(along) < _CELL_M) & (np.abs(aside) < _HALF_WIDTH_M)])


def _places_ahead(place_m: float, layout: Layout) -> Array:
    """(N,) m along the route, where the ground ahead is sampled."""
    return np.arange(place_m + NEAR_M, min(place_m + FAR_M, layout.profile[-1].s1), _CELL_M)


def cells_ahead(place_m: float, layout: Layout) -> tuple[Array, Array]:
    """Places of a grid of 5 cm on the ground ahead: 0.5 to 2.5 m along the route, and 0.5 m to both sides of it.

    Args:
        place_m: Place of the camera along the route, m.
        layout: The true terrain.

    Returns:
        (N,) m along the route, and (N,) m to the left of it; empty at the end of the route.
    """
    across = np.arange(-_HALF_WIDTH_M, _HALF_WIDTH_M + 1e-9, _CELL_M)  # 1e-9 so that both ends are included
    s, aside = (grid.ravel() for grid in np.meshgrid(_places_ahead(place_m, layout), across))
    return s, aside


def _completeness(mapper: TerrainMap, place_m: float, alignment: YawAlignment, layout: Layout) -> float:
    """Share of the ground ahead whose mapped height is within `_COMPLETE_M` of the true one; NaN at the route's end.

    Args:
        mapper: The map.
        place_m: Place of the camera along the route, m.
        alignment: From the map's world to the true one, now.
        layout: The true terrain.
    """
    s, aside = cells_ahead(place_m, layout)
    if not len(s):
        return math.nan
    xy = alignment.to_estimated(layout.way.point(s, aside))
    # (N,) m in the true world; NaN, where nothing is mapped, is within no limit
    height = mapper.heights(xy) - alignment.estimated[2] + alignment.true[2]
    return float(np.mean(np.abs(height - true_heights(layout.profile, s, aside)) < _COMPLETE_M))


def true_heights(profile: Sequence[Strip], s: Array, left: Array | float = 0.0) -> Array:
    """(N,) heights of the true ground, m.

    Args:
        profile: Strips of the route.
        s: (N,) places along the route, m.
        left: Distances to the left of it, m.
    """
    starts = np.array([strip.s0 for strip in profile])
    # (strips, 4): begin along the route, height there, rise per m along the route and per m to the left
    strips = np.array([(strip.s0, strip.z0, math.tan(strip.slope), math.tan(strip.cross_slope)) for strip in profile])
    # number of the strip under each place; the first and the last one continue beyond the ends of the route
    at = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, None)
    s0, z0, slope, cross = strips[at].T
    return np.asarray(z0 + slope * (s - s0) + cross * left)


def _edge_errors(mapper: TerrainMap, place_m: float, alignment: YawAlignment, layout: Layout) -> Array:
    """(E,) errors of the edges in the profile straight ahead, m, each relative to the nearest true edge.

    Edges with a standard deviation of `_MAX_EDGE_SD_M` or more do not count, nor those where the route has turned away.

    Args:
        mapper: The map.
        place_m: Place of the camera along the route, m.
        alignment: From the map's world to the true one, now.
        layout: The true terrain.

    Returns:
        Estimated minus true distance; all inf if there is no true edge near the place (`_edges_along`).
    """
    changes = _profile_ahead(mapper, place_m, alignment, layout).changes
    # mapped edges, m straight ahead
    known = np.array([c.s for c in changes if c.kind == "edge" and c.sd < _MAX_EDGE_SD_M])
    heading = float(layout.way.heading(place_m))
    forward = np.array([math.cos(heading), math.sin(heading)])
    ahead = layout.way.point(place_m) + known[:, None] * forward
    straight = np.linalg.norm(layout.way.point(place_m + known) - ahead, axis=1) < _STRAIGHT_M  # before it turns away
    known = known[straight]
    true = _edges_along(place_m, forward, layout)  # true edges, m straight ahead
    if not len(true):
        return np.full(len(known), math.inf)
    return np.asarray(known - true[np.argmin(np.abs(known[:, None] - true), axis=1)])


def _edges_along(place_m: float, forward: Array, layout: Layout) -> Array:
    """(E,) m, from a place on the route to the true edges near it, along a straight line.

    Args:
        place_m: The place along the route, m.
        forward: (2,) unit vector of the line's direction in the world.
        layout: The true terrain.

    Returns:
        Distances, negative for edges behind; edges that the line does not meet from in front are left out.
    """
    jumps = np.array([s for s, _, _ in edges(layout.profile)])  # places of the true edges, m along the route
    jumps = jumps[np.abs(jumps - place_m) < _REACH_M]
    heading = layout.way.heading(jumps)
    # (J, 2) direction of the route at each edge, perpendicular to the edge
    across = np.stack([np.cos(heading), np.sin(heading)], -1)
    facing = across @ forward  # cosine of the angle between the line and the route at each edge
    # distance of each edge's line from the place, perpendicular to the edge
    away = ((layout.way.point(jumps) - layout.way.point(place_m)) * across).sum(axis=-1)
    # along the line to the edge it is longer by 1 / cos
    return np.asarray(away[facing > _FACING] / facing[facing > _FACING])
