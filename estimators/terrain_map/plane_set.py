"""The known planes, and the label and height of each column of the ground, in a ring buffer that follows the walker."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.terrain_map.estimate import Plane
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.plane_extraction import min_columns
from stridetwin.estimators.terrain_map.plane_fit import (
    SUMS,
    add_point,
    fit_height_planes,
    height_plane_misfit,
    rotate_planes,
    squared_distance,
)
from stridetwin.estimators.terrain_map.voxel_blocks import EDGE, SHAPE
from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent

COLUMNS = SHAPE[0] * EDGE
"""Columns along an edge of the window; a power of two."""
NONE = -1
"""Label of a column without a plane, and id of an empty slot."""


class Surface(NamedTuple):
    """Columns of the window, in the form for compiled code.

    Attributes:
        label: (X, Y) ring, slot of the column's plane, -1 none. Column (i, j) is stored at (i mod X, j mod Y).
        height: (X, Y) ring, m; NaN where never observed.
        noise: (X, Y) ring, m, standard deviation of the height.
        origin: (2,) lowest column of the window.
    """

    label: NDArray[np.int32]
    height: NDArray[np.float32]
    noise: NDArray[np.float32]
    origin: NDArray[np.int64]

    @classmethod
    def empty(cls) -> Surface:
        """A window without columns."""
        label, height = np.full((COLUMNS, COLUMNS), NONE, np.int32), np.full((COLUMNS, COLUMNS), np.nan, np.float32)
        return cls(label, height, np.zeros((COLUMNS, COLUMNS), np.float32), np.zeros(2, np.int64))

    def clear(self) -> None:
        """Removes labels and heights of all columns."""
        self.label[:], self.height[:] = NONE, np.nan

    def move(self, origin: NDArray[np.int64]) -> None:
        """Moves the window's lowest column to (2,) `origin`, and clears the columns that enter it.

        In the ring, a column that enters is stored where one that leaves was.
        """
        for axis in (0, 1):
            shift = int(origin[axis] - self.origin[axis])
            if shift == 0:
                continue
            # first of the lines that enter along this axis, and their places in the ring
            start = self.origin[axis] + COLUMNS if shift > 0 else origin[axis]
            lines = (start + np.arange(min(abs(shift), COLUMNS))) % COLUMNS
            at = (lines, slice(None)) if axis == 0 else (slice(None), lines)
            self.label[at], self.height[at] = NONE, np.nan
        self.origin[:] = origin

    def at(self, columns: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Label and height of columns (..., 2); -1 and NaN outside the window."""
        inside = ((columns >= self.origin) & (columns < self.origin + COLUMNS)).all(axis=-1)
        i, j = columns[..., 0] % COLUMNS, columns[..., 1] % COLUMNS
        return np.where(inside, self.label[i, j], NONE), np.where(inside, self.height[i, j], np.float32(np.nan))


class TopView(NamedTuple):
    """The planes seen in the volume, as columns of a square of the ground.

    Attributes:
        first: (2,) column of the square's corner.
        labels: (n, n) number of each column's plane, -1 = none.
        sums: (P, 11) sums over the columns of each plane, see `plane_fit.SUMS`.
        height: (n, n) m, NaN where unobserved.
        noise: (n, n) m, standard deviation of the height.
    """

    first: NDArray[np.int64]
    labels: NDArray[np.int32]
    sums: Array
    height: NDArray[np.float32]
    noise: NDArray[np.float32]


@entry_kernel(_HERE)
def count_overlaps(surface: Surface, view: TopView, slots: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Counts the columns that new and old planes share.

    Args:
        surface: Columns with the old planes' slots.
        view: Top view with the new planes.
        slots: Number of slots.

    Returns:
        (P, slots) columns that each pair of a new and an old plane shares; (slots,) columns of each old plane that the
        view observes.
    """
    label, first = surface.label, view.first
    # & (COLUMNS - 1) is mod COLUMNS: a column's place in the ring
    both, seen = np.zeros((len(view.sums), slots), np.int64), np.zeros(slots, np.int64)
    for i in range(view.labels.shape[0]):
        for j in range(view.labels.shape[1]):
            before = label[(first[0] + i) & (COLUMNS - 1), (first[1] + j) & (COLUMNS - 1)]
            if before >= 0:
                if view.labels[i, j] >= 0:
                    both[view.labels[i, j], before] += 1
                seen[before] += not math.isnan(view.height[i, j])
    return both, seen


@entry_kernel(_HERE)
def write_view(
    surface: Surface, view: TopView, slots: NDArray[np.int32], same_m: float, keeps_unobserved: bool
) -> None:
    """Writes a view's heights, noise and planes into the columns of the map.

    A column that the view observes without a plane keeps its old plane only if its height has not changed. One that the
    view does not observe loses its plane and height or, with `keeps_unobserved`, keeps both.

    Args:
        surface: Modified in place.
        view: The view.
        slots: (P,) slot of each new plane, -1 = none.
        same_m: A column without a new plane keeps its old plane if its height has changed by less, m.
        keeps_unobserved: Whether an unobserved column keeps its old plane.
    """
    label, height = surface.label, surface.height
    for i in range(view.labels.shape[0]):
        for j in range(view.labels.shape[1]):
            # the column's place in the ring: & (COLUMNS - 1) is mod COLUMNS
            p, q = (view.first[0] + i) & (COLUMNS - 1), (view.first[1] + j) & (COLUMNS - 1)
            z = view.height[i, j]
            if math.isnan(z):
                if keeps_unobserved:
                    continue
                label[p, q] = NONE
            elif view.labels[i, j] >= 0:
                label[p, q] = slots[view.labels[i, j]]
            elif not abs(z - height[p, q]) < same_m:
                label[p, q] = NONE
            height[p, q], surface.noise[p, q] = z, view.noise[i, j]


@entry_kernel(_HERE)
def remove_labels(label: NDArray[np.int32], gone: NDArray[np.bool_]) -> None:
    """Removes the labels marked in `gone`, (slots,), from the ring."""
    for i in range(label.shape[0]):
        for j in range(label.shape[1]):
            if label[i, j] >= 0 and gone[label[i, j]]:
                label[i, j] = NONE


@entry_kernel(_HERE)
def sums_of(surface: Surface, slots: int, voxel_m: float) -> NDArray[np.float64]:
    """(slots, 11) sums over the columns of each slot, m, grid axes, see `plane_fit.SUMS`; 0 for an empty slot."""
    sums, origin = np.zeros((slots, SUMS)), surface.origin
    for i in range(origin[0], origin[0] + COLUMNS):
        row = i & (COLUMNS - 1)  # in the ring: i mod COLUMNS
        for j in range(origin[1], origin[1] + COLUMNS):
            at = row, j & (COLUMNS - 1)
            slot = surface.label[at]
            if slot >= 0:
                add_point(sums[slot], (i + 0.5) * voxel_m, (j + 0.5) * voxel_m, surface.height[at], surface.noise[at])
    return sums


@entry_kernel(_HERE)
def find_borders(surface: Surface, reach: int, least_m: float, most_m: float) -> NDArray[np.int32]:
    """Finds the columns where a plane ends and a lower one begins.

    Args:
        surface: The columns.
        reach: Columns that may lie between the planes.
        least_m: Smallest height difference.
        most_m: Largest height difference.

    Returns:
        (N, 5) slot of the lower and of the upper plane, the upper plane's last column (i, j), and the side of the
        lower plane: 0..3 for +i, -i, +j, -j.
    """
    label, height, origin = surface.label, surface.height, surface.origin
    borders = np.empty((COLUMNS * 64, 5), np.int32)  # further ones are left out
    count = 0
    for i in range(origin[0] + 1, origin[0] + COLUMNS - 1):
        for j in range(origin[1] + 1, origin[1] + COLUMNS - 1):
            # i & (COLUMNS - 1) is the column's place in the ring, i mod COLUMNS
            upper = label[i & (COLUMNS - 1), j & (COLUMNS - 1)]
            if upper < 0:
                continue
            if (
                label[(i + 1) & (COLUMNS - 1), j & (COLUMNS - 1)] == upper
                and label[(i - 1) & (COLUMNS - 1), j & (COLUMNS - 1)] == upper
                and label[i & (COLUMNS - 1), (j + 1) & (COLUMNS - 1)] == upper
                and label[i & (COLUMNS - 1), (j - 1) & (COLUMNS - 1)] == upper
            ):  # most columns
                continue
            z = height[i & (COLUMNS - 1), j & (COLUMNS - 1)]
            for side in range(4):
                di, dj = (side == 0) - (side == 1), (side == 2) - (side == 3)
                if label[(i + di) & (COLUMNS - 1), (j + dj) & (COLUMNS - 1)] == upper:
                    continue
                for step in range(1, reach + 1):
                    p, q = i + di * step, j + dj * step
                    if p < origin[0] or p >= origin[0] + COLUMNS or q < origin[1] or q >= origin[1] + COLUMNS:
                        break
                    lower = label[p & (COLUMNS - 1), q & (COLUMNS - 1)]
                    if lower == upper:
                        break
                    if lower >= 0:
                        drop = z - height[p & (COLUMNS - 1), q & (COLUMNS - 1)]
                        if drop > most_m:
                            continue  # seen between open treads
                        if least_m <= drop <= most_m and count < len(borders):
                            borders[count, 0], borders[count, 1], borders[count, 4] = lower, upper, side
                            borders[count, 2], borders[count, 3] = i, j
                            count += 1
                        break
    return borders[:count]


SLOTS = 256
"""Largest number of planes; each is stored in a slot, which labels its columns."""
_MAX_VOTES = 30.0
"""Upper limit of a plane's votes."""
_SAME_IOU, _INSIDE_SHARE = 0.3, 0.6
"""Limits of docs/terrain_map.md (9): planes are the same if they share so much of their union, or of one of them."""
_APART = 1.5
"""Planes farther apart than this many `plane_noise_m` are distinct."""
_SHARED_COLUMNS, _SLOPE_PRIOR_SD_RAD = 16.0, math.radians(6.0)
"""docs/terrain_map.md (7): columns whose error is shared, and the prior of the ground's slope."""


class PlaneSet:
    """Planes with their votes and columns.

    Args:
        parameters: See `TerrainMapParameters`.
        keeps_unobserved: Whether a column unobserved in a top view keeps its plane.

    Attributes:
        surface: The columns; labels are slots.
        ids: (SLOTS,) id of the plane in each slot, -1 = none.
        votes: (SLOTS,) score of the plane in each slot: confirming frames minus others, at most `_MAX_VOTES`.
    """

    def __init__(self, parameters: TerrainMapParameters, *, keeps_unobserved: bool = False) -> None:
        """Begins without planes; `keeps_unobserved`: a column unobserved in a top view keeps its plane."""
        self._p, self._keeps_unobserved = parameters, keeps_unobserved
        self._min_columns = min_columns(parameters.voxel_size_m)
        self.surface = Surface.empty()
        # removes nothing, but compiles the kernel before a walk: planes are lost only after a while
        remove_labels(self.surface.label, np.zeros(SLOTS, bool))
        self.ids = np.full(SLOTS, NONE, np.int64)
        self.votes = np.zeros(SLOTS)
        self._sums = np.zeros((SLOTS, SUMS))  # over the columns of each slot's plane, see `plane_fit.SUMS`
        # what `planes` last returned, by id, and the sums and votes from which it was computed
        self._last_sums, self._last_votes = self._sums.copy(), self.votes.copy()
        self._last: dict[int, Plane] = {}
        self._next_id = 0

    def clear(self) -> None:
        """Removes every plane and column; ids of later planes continue."""
        self.surface.clear()
        self.ids[:] = NONE
        self.votes[:] = 0.0
        self._sums[:] = 0.0

    def update(self, view: TopView) -> None:
        """Associates the planes of one top view with the known ones, and updates columns, votes and sums."""
        # columns that new and old planes share, and columns of each old plane that the view observes
        common, in_scope = count_overlaps(self.surface, view, SLOTS)
        slots = self._match_slots(common, in_scope, view.sums)
        write_view(self.surface, view, slots, self._p.plane_noise_m, self._keeps_unobserved)
        self._vote(slots, in_scope)
        self.refit()

    def refit(self) -> None:
        """Recomputes the sums over each plane's columns; removes planes with too few."""
        self._sums = sums_of(self.surface, SLOTS, self._p.voxel_size_m)
        few = (self.ids >= 0) & (self._sums[:, 0] < self._min_columns)  # entry 0 is the number of columns
        self._remove(np.flatnonzero(few))

    def planes(self, R_world_grid: Array) -> dict[int, Plane]:
        """The planes by id, in world axes.

        A plane that has not changed since the last call is the same object.

        Args:
            R_world_grid: (3, 3) rotation about the vertical, grid to world axes.
        """
        # A plane of unchanged sums and votes is taken from the last call; the others, `fresh`, are fitted.
        changed = (self._sums != self._last_sums).any(axis=1) | (self.votes != self._last_votes)
        self._last_sums[:], self._last_votes[:] = self._sums, self.votes
        planes = {}  # by id, in the order of the slots: the plane of the last call, if there was one
        fresh = []
        for slot in np.flatnonzero(self.ids >= 0).tolist():
            id_ = int(self.ids[slot])
            if changed[slot] or id_ not in self._last:
                fresh.append(slot)
            planes[id_] = self._last.get(id_)
        self._last = {id_: plane for id_, plane in planes.items() if plane is not None}
        self._last |= self._fit_planes(np.array(fresh, np.int64), R_world_grid)
        return {id_: self._last[id_] for id_ in planes}

    def _fit_planes(self, slots: NDArray[np.int64], R_world_grid: Array) -> dict[int, Plane]:
        """The planes in these slots by id, fitted to the sums over their columns, docs/terrain_map.md (7), (8).

        `slots` (N,) hold planes; `R_world_grid` (3, 3) rotates them from grid to world axes.
        """
        sums = self._sums[slots]
        centres, slopes, covariances, spreads = rotate_planes(
            *fit_height_planes(sums, self._p.plane_sd_m, self._p.slope_sd_rad, _SHARED_COLUMNS, _SLOPE_PRIOR_SD_RAD),
            R_world_grid,
        )
        normals = np.column_stack([-slopes, np.ones(len(slots))])  # (N, 3), up
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        ids, votes = self.ids[slots].tolist(), self.votes[slots].tolist()
        areas = sums[:, 0] * self._p.voxel_size_m**2  # m², number of columns times that of one
        return {
            id_: Plane(
                id=id_,
                centre=centres[n],
                normal=normals[n],
                spread=spreads[n],
                area_m2=area,
                votes=votes[n],
                covariance=covariances[n],
            )
            for n, (id_, area) in enumerate(zip(ids, areas.tolist()))
        }

    def _match_slots(self, common: NDArray[np.int64], in_scope: NDArray[np.int64], sums: Array) -> NDArray[np.int32]:
        """(P,) slot of each new plane: that of the known plane it belongs to, docs/terrain_map.md (9), or a free one.

        If there are too few free slots, the planes with the fewest votes make room, unless they were matched. A new
        plane for which there is none left keeps -1.

        Args:
            common: (P, SLOTS) number of columns that a new and an old plane share.
            in_scope: (SLOTS,) number of columns of each old plane that the view observes.
            sums: (P, 11) sums of the new planes, see `plane_fit.SUMS`.
        """
        sizes = sums[:, 0].astype(np.int64)  # (P,) columns of each new plane
        slots = np.full(len(sizes), NONE, np.int32)
        # pairs of a new plane and an old one's slot that share columns, and how many
        new, old = np.nonzero(common)
        shared = common[new, old]
        union, smaller = sizes[new] + in_scope[old] - shared, np.minimum(sizes[new], in_scope[old])
        # indices of the pairs that share enough, those that share most first
        alike = np.flatnonzero((shared > _SAME_IOU * union) | (shared > _INSIDE_SHARE * np.maximum(smaller, 1)))
        alike = alike[np.argsort(-shared[alike], kind="stable")]
        agrees = self._lies_on_plane(sums[new[alike]], old[alike])
        parts: dict[int, Array] = {}  # by slot: sums of the new planes that the old one has got so far
        for number, slot in zip(new[alike[agrees]].tolist(), old[alike[agrees]].tolist()):
            together = sums[number] + parts.get(slot, 0.0)
            # From afar low treads look like a ramp: each lies near that old plane, but they all on no plane.
            if slots[number] == NONE and squared_distance(together) < self._p.plane_noise_m**2:
                slots[number], parts[slot] = slot, together
        # the new planes that belong to no old one get a free slot and a new id
        free = np.flatnonzero(self.ids < 0)
        wanted = np.flatnonzero(slots == NONE)
        if len(wanted) > len(free):
            taken = np.flatnonzero(self.ids >= 0)
            least_votes = taken[np.argsort(self.votes[taken], kind="stable")[: len(wanted) - len(free)]]
            self._remove(least_votes[~np.isin(least_votes, slots)])
            free = np.flatnonzero(self.ids < 0)
        for number, slot in zip(wanted, free):
            slots[number] = slot
            self.ids[slot] = self._next_id
            self._next_id += 1
        return slots

    def _lies_on_plane(self, new: Array, slots: NDArray[np.intp]) -> NDArray[np.bool_]:
        """(N,) whether each new plane lies on the known plane in its slot, within `_APART` times `plane_noise_m` (RMS).

        Args:
            new: (N, 11) sums of the new planes, see `plane_fit.SUMS`.
            slots: (N,) slot of the known plane to compare each with.
        """
        p = self._p
        # (N,) mean squared height of the new plane's columns over the known plane, m²
        misfit = height_plane_misfit(
            new, self._sums[slots], p.plane_sd_m, p.slope_sd_rad, _SHARED_COLUMNS, _SLOPE_PRIOR_SD_RAD
        )
        return np.asarray(misfit < (_APART * p.plane_noise_m) ** 2)

    def _vote(self, slots: NDArray[np.int32], in_scope: NDArray[np.int64]) -> None:
        """Updates the votes: + 1 for a matched plane, - 1 for one that is in view without a match.

        Planes without votes are removed. A plane is in view if the view observes more than half of its columns.

        Args:
            slots: (P,) slot of each new plane, -1 = none.
            in_scope: (SLOTS,) number of columns of each old plane that the view observes.
        """
        paired = np.zeros(SLOTS, bool)  # slots of the matched planes, and of new ones
        paired[slots[slots >= 0]] = True
        self.votes[paired] = np.minimum(self.votes[paired] + 1.0, _MAX_VOTES)
        lost = (self.ids >= 0) & ~paired & (in_scope > 0.5 * self._sums[:, 0])
        self.votes[lost] -= 1.0
        self._remove(np.flatnonzero(lost & (self.votes <= 0)))

    def _remove(self, slots: NDArray[np.intp]) -> None:
        """Removes the planes in some slots, with their labels; the columns' heights remain."""
        if len(slots):
            self.ids[slots] = NONE
            self.votes[slots] = 0.0
            gone = np.zeros(SLOTS, bool)
            gone[slots] = True
            remove_labels(self.surface.label, gone)
