"""Which rows of risers a person can walk: those that lead on from the ground that the walker has under the feet.

Rims of planters, crates, chests and tables make rises as high as those of stairs. They differ in where they stand and
how large they are: no walkable ground leads to a chest from which a table rises, and a crate ends before a step does.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from stridetwin.estimators.terrain_map.estimate import Plane
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.plane_fit import point_toward
from stridetwin.estimators.terrain_map.plane_set import SLOTS, PlaneSet
from stridetwin.estimators.terrain_map.risers import Riser
from stridetwin.streams.samples import Array

_FEET_M = 0.25
"""Radius of the ground under the walker: the feet are no farther from the point under the camera, or soon will be."""
_FEET_SHARE = 0.1
"""Smallest share of that ground that a plane under the feet covers."""
_MIN_EYE_M = 0.8
"""A plane under the feet is at least so far below the camera: chest of a short person over the next tread."""
_STOOD_SHARE, _RECENT_IMAGES = 0.5, 15
"""Share of the ground under the walker from which a plane is what the walker stands on, and images, about a second, for
which the height of the camera over it is remembered."""
_FOLLOWED, _MAX_EVIDENCE = 0.35, 12.0
"""Share of the height between two planes by which the camera rises at least with a walker who steps up, and images, by
the plane's share, over which it is a mean."""
_LOW_M = 0.04
"""A plane that is less higher than another one is as high."""
_MIN_STOOD_EYE_M = 0.95
"""A plane that the walker stands on is at least so far below the camera: chest of a short person."""
_START_M = 0.3
"""Way of the camera from which on the walker has moved: half a step."""
_START_REACH_M = 2.0
"""Before the walker has moved, the lowest plane that begins within this distance counts as the ground."""
_MIN_START_M2 = 0.1
"""Smallest area of that plane."""
_MIN_WIDTH_M = 0.5
"""Shortest edge over which a person walks; building codes ask for stairs of 0.6 m and more."""
_WIDE_EDGES = 2
"""Edges of a flight that must be so long: others may be occluded, by a leg or by the border of the image."""
_BROAD_M = 0.8
"""Shortest of two edges that are stairs though no landing is seen beyond them: furniture is narrower."""
_LANDING_M = 0.8
"""Shorter side of the smallest landing, after building codes; that of two crates side by side is 0.6 m."""
_MAX_TURN_COSINE = math.cos(math.radians(50.0))
"""Largest turn from a riser to the next one of stairs, which may wind."""
_FLIGHT_RISERS = 3
"""So many rises are stairs wherever they lead, and fewer lead to a landing or are broad."""
_LIKE_RATIO = 1.35
"""Largest ratio of the heights of like risers: uneven stairs have up to 1.2, and errors of risers of 0.15 m add 0.1."""
_MIN_LINK_M2 = 0.36
"""A plane of so much area extends to others of its height: the tilt of a smaller one is too uncertain."""
_MAX_GAP_M = 1.0
"""Longest unobserved ground between a ramp and the level that it meets."""

Row = tuple[Riser, ...]
"""Risers of one flight from the lowest, see `find_flights`."""


class WalkedPlanes:
    """The planes that the walker has under the feet, or had.

    Args:
        R_world_grid: (3, 3) grid to world axes.
        parameters: Size of a column.

    Attributes:
        has_moved: Whether the walker has left the place of the first image. Before, as in a single image, too little of
            the ground is known to tell furniture from stairs.
    """

    def __init__(self, R_world_grid: Array, parameters: TerrainMapParameters) -> None:
        """Begins without planes; `R_world_grid` (3, 3) rotates grid to world axes."""
        self._R_world_grid, self._voxel_m = R_world_grid, parameters.voxel_size_m
        reach = round(_FEET_M / self._voxel_m)  # columns
        offsets = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2), axis=-1).reshape(-1, 2)
        # (N, 2) columns of the ground under the feet, relative to that under the camera
        self._under = offsets[(offsets**2).sum(axis=1) <= reach**2]
        self._stood_ids: set[int] = set()  # planes that have been most of the ground under the walker
        self._image = 0  # number of the image
        # by id of a plane that has just been most of that ground: last such image, height of the camera over it, m
        self._stood: dict[int, tuple[int, float]] = {}
        # by id of a plane: images that tell whether the camera rose with it, and the mean share by which it did
        self._followed: dict[int, tuple[float, float]] = {}
        self._start: Array | None = None  # (2,) m, under the camera of the first image
        self.has_moved = False

    def update(self, planes: dict[int, Plane], plane_set: PlaneSet, p_camera_in_world: Array) -> set[int]:
        """Takes the planes of an image, and gives those that have been walked on.

        Args:
            planes: Planes by id.
            plane_set: Their columns.
            p_camera_in_world: (3,) m.

        Returns:
            Ids of planes; before any has been walked on, that of the lowest plane near the camera, or none.
        """
        self._image += 1
        self._stood_ids &= planes.keys()
        self._followed = {id_: known for id_, known in self._followed.items() if id_ in planes}
        self._stood = {
            id_: known
            for id_, known in self._stood.items()
            if id_ in planes and self._image - known[0] <= _RECENT_IMAGES
        }
        if self._start is None:
            self._start = p_camera_in_world[:2].copy()
        self.has_moved |= math.dist(self._start, p_camera_in_world[:2]) > _START_M
        # (2,) column under the camera; v @ R_world_grid is v in grid axes
        column = np.floor(p_camera_in_world[:2] @ self._R_world_grid[:2, :2] / self._voxel_m).astype(np.int64)
        slots, _ = plane_set.surface.at(column + self._under)
        counts = np.bincount(slots[slots >= 0], minlength=SLOTS)
        for slot in np.flatnonzero(counts >= _FEET_SHARE * len(self._under)).tolist():
            plane = planes[int(plane_set.ids[slot])]
            eye_m = float(p_camera_in_world[2] - plane.height(p_camera_in_world[:2]))
            if eye_m > _MIN_EYE_M:
                self._follow_camera(plane, eye_m, float(counts[slot]) / len(self._under), planes)
        walked = {
            id_
            for id_ in self._stood_ids | self._followed.keys()
            if self._followed.get(id_, (0.0, 1.0))[1] >= _FOLLOWED  # else the camera was only held over it
        }
        return walked or _lowest_nearby(planes.values(), p_camera_in_world)

    def _follow_camera(self, plane: Plane, eye_m: float, share: float, planes: dict[int, Plane]) -> None:
        """Compares the height of the camera over a plane with that over others on which the walker has just stood.

        Who steps up onto a plane takes the camera along. Over a box or an open drawer, a camera in the hand stays as
        high as over the floor. The upper one of two planes is the doubtful one.

        Args:
            plane: A plane under the walker.
            eye_m: Height of the camera over it, m.
            share: Share of the ground under the walker.
            planes: Planes by id.
        """
        stands = share >= _STOOD_SHARE and eye_m > _MIN_STOOD_EYE_M
        for other, (_, other_eye_m) in self._stood.items():
            up = float(plane.centre[2] - planes[other].centre[2])
            if up > _LOW_M:
                self._count(plane.id, share, 1.0 - (other_eye_m - eye_m) / up)
            elif up < -_LOW_M and stands:
                self._count(other, share, 1.0 - (other_eye_m - eye_m) / up)
        if stands:
            self._stood[plane.id] = self._image, eye_m
            self._stood_ids.add(plane.id)

    def _count(self, id_: int, share: float, followed: float) -> None:
        """Counts an image that tells by which share of the height of a plane the camera rose."""
        images, mean = self._followed.get(id_, (0.0, 0.0))
        gain = share / (min(images, _MAX_EVIDENCE) + share)
        self._followed[id_] = images + share, mean + gain * (min(max(followed, -1.0), 2.0) - mean)


def _lowest_nearby(planes: Iterable[Plane], p_camera_in_world: Array) -> set[int]:
    """Id of the lowest plane of some area near the camera, or none; `p_camera_in_world` is (3,), m."""
    x, y, z = p_camera_in_world.tolist()
    nearby = []
    for plane in planes:
        a, b = point_toward(plane.centre, plane.spread, x, y, 0.0)  # its nearest side
        is_near = math.hypot(a - x, b - y) < _START_REACH_M
        if is_near and plane.area_m2 >= _MIN_START_M2 and plane.centre[2] < z - _MIN_EYE_M:
            nearby.append(plane)
    return {min(nearby, key=lambda plane: float(plane.centre[2])).id} if nearby else set()


def select_walkable(
    rows: Sequence[Row], planes: dict[int, Plane], walked: set[int], p: TerrainMapParameters
) -> list[Row]:
    """The rows of risers that lead on from walked ground, directly or over ramps, levels and other such rows.

    Two edges of a row, or the only one, are as long as a person is wide. One rise or two lead to a landing, or the two
    are as broad as stairs: on a smaller surface nobody walks on. The way down has no such condition, for the edge of
    the walked ground hides most of what follows. A row of several like risers needs no ground below it: a leg or a
    bystander may occlude its foot. A row that shares a tread with another one is a part of its flight, however short.

    Args:
        rows: Rows of risers from the lowest, see `find_flights`.
        planes: Planes by id.
        walked: Ids of planes that have been walked on.
        p: Smallest riser, and slope of a level.

    Returns:
        Some of the rows, in their order.
    """
    above: dict[int, list[Row]] = {}  # by id of a plane: the rows that lead up from it
    for row in rows:
        above.setdefault(row[0].lower, []).append(row)
    # `id()` of the rows that are as wide as a person; of these, the rows that one can go up from the ground
    wide = {id(row) for row in rows if _count_edges(row, _MIN_WIDTH_M) >= min(_WIDE_EDGES, len(row))}
    climbable = {id(row) for row in rows if id(row) in wide and (_is_broad(row) or _leads_far(row, above, planes, p))}
    ends = {id_ for row in rows if id(row) in wide for id_ in (row[0].lower, row[-1].upper)}
    reached, treads, selected = set(walked), set[int](), set[int]()
    waiting, ground = list(rows), set(walked)  # `ground`: planes reached last, from which other ground may go on
    while waiting:
        reached |= _level_with(ground, ends - reached, planes, p)
        fresh = []
        for row in waiting:
            uppers = [riser.upper for riser in row]
            leads_down = uppers[-1] in reached or not walked.isdisjoint(uppers)
            leads_up = row[0].lower in reached and id(row) in climbable
            leads_on = id(row) in wide and (leads_down or leads_up)
            if leads_on or _is_regular(row) or row[0].lower in treads or not treads.isdisjoint(uppers):
                fresh.append(row)
        if not fresh:
            break
        ground = set()
        for row in fresh:
            selected.add(id(row))
            passed = {row[0].lower, *(riser.upper for riser in row)}
            treads |= {riser.upper for riser in row if not _is_landing(planes[riser.upper])}
            ground |= passed - reached - treads
            reached |= passed
        waiting = [row for row in waiting if id(row) not in selected]
    return [row for row in rows if id(row) in selected]


def _count_edges(row: Row, least_m: float) -> int:
    """Number of edges of a row that are at least `least_m` long, m."""
    return sum(riser.length >= least_m for riser in row)


def _is_broad(row: Row) -> bool:
    """Whether a row has two or more like risers as broad as those of stairs."""
    return _count_edges(row, _BROAD_M) >= _WIDE_EDGES and _are_like(row)


def _is_regular(row: Row) -> bool:
    """Whether a row has several risers of like height, which furniture does not have.

    Its foot may be occluded, and so may parts of its edges: one is as long as a person is wide.
    """
    return len(row) >= _FLIGHT_RISERS and _are_like(row) and _count_edges(row, _MIN_WIDTH_M) > 0


def _are_like(row: Row) -> bool:
    """Whether the risers of a row are of like height."""
    heights = [riser.height for riser in row]
    return max(heights) <= _LIKE_RATIO * min(heights)


def _leads_far(row: Row, above: dict[int, list[Row]], planes: dict[int, Plane], p: TerrainMapParameters) -> bool:
    """Whether a row leads up to a landing, or by as many rises as a flight has, alone or with the rows that follow it.

    Rows follow one another as winding stairs do: like rises, a tread apart, each turned a little against the last one.
    Open drawers, a counter and what stands on it do not.

    Args:
        row: Risers from the lowest.
        above: By id of a plane: the rows that lead up from it.
        planes: Planes by id.
        p: Least tread.
    """
    if len(row) >= _FLIGHT_RISERS or _is_landing(planes[row[-1].upper]):
        return True
    return any(
        _leads_far((*row, *upper_row), above, planes, p)
        for upper_row in above.get(row[-1].upper, [])
        if _follows(row, upper_row, p)
    )


def _follows(row: Row, upper_row: Row, p: TerrainMapParameters) -> bool:
    """Whether a row of risers leads on from another one as the steps of a winding stair do."""
    one, other = row[-1], upper_row[0]
    tread = float(np.subtract(one.middle, other.middle) @ one.down)
    is_ahead = float(one.down @ other.down) > _MAX_TURN_COSINE and p.min_tread_m <= tread <= p.max_tread_m
    return is_ahead and _are_like((*row, *upper_row))


def _is_landing(plane: Plane) -> bool:
    """Whether a plane is at least as long as a landing in every direction.

    Its shorter side is that of a rectangle with the same scatter: a uniform distribution of length l has the variance
    l² / 12, and the smaller eigenvalue of the covariance is that of the shorter side.
    """
    (xx, xy), (_, yy) = plane.spread.tolist()
    least_variance = 0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy)
    return least_variance >= _LANDING_M**2 / 12.0


def _level_with(ground: set[int], wanted: set[int], planes: dict[int, Plane], p: TerrainMapParameters) -> set[int]:
    """Ids of planes among `wanted`, and of ramps, onto which the ground goes on without a riser.

    Level ground goes on wherever it has the same height, however much of it is occluded in between. A ramp must meet
    the other plane, see `_meets`.

    Args:
        ground: Ids of planes that can be reached.
        wanted: Ids of the planes that are asked for.
        planes: Planes by id.
        p: Smallest riser, and slope of a level.
    """
    joined = set[int]()
    large = {id_: plane for id_, plane in planes.items() if plane.area_m2 >= _MIN_LINK_M2}
    ramps = {id_ for id_, plane in large.items() if plane.slope > p.max_tread_slope_rad}
    sources = [large[id_] for id_ in ground if id_ in large]
    targets = [planes[id_] for id_ in (wanted | ramps) - ground]
    while sources and targets:
        # centre (x, y, z), m, and slopes (gx, gy) of each level source
        levels = [(*plane.centre.tolist(), *plane.gradient.tolist()) for plane in sources if plane.id not in ramps]
        fresh = []
        for target in targets:
            if target.id not in ramps:
                u, v, w = target.centre.tolist()
                goes_on = any(abs(z + gx * (u - x) + gy * (v - y) - w) < p.min_riser_m for x, y, z, gx, gy in levels)
                slopes = [plane for plane in sources if plane.id in ramps] if ramps else []
            else:
                goes_on, slopes = False, sources
            if goes_on or any(_meets(plane, target, p) for plane in slopes):
                fresh.append(target)
        joined |= {plane.id for plane in fresh}
        targets = [plane for plane in targets if plane.id not in joined]
        sources = [plane for plane in fresh if plane.id in large]
    return joined


def _meets(one: Plane, other: Plane, p: TerrainMapParameters) -> bool:
    """Whether two planes, one of them a ramp, meet: their borders are near each other and equally high."""
    (x, y), (u, v) = one.centre[:2].tolist(), other.centre[:2].tolist()
    a, b = point_toward(one.centre, one.spread, u, v, 0.0)
    c, d = point_toward(other.centre, other.spread, x, y, 0.0)
    gap = math.hypot(c - a, d - b)
    step = float(one.height(np.array([a, b])) - other.height(np.array([c, d])))
    return gap < _MAX_GAP_M and abs(step) < p.min_riser_m + 0.5 * gap * math.tan(max(one.slope, other.slope))
