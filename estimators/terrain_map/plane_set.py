"""The set of planes: new planes vote for existing ones, eq. (23), and label the columns of the ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.terrain_map.estimate import Plane
from stridetwin.estimators.terrain_map.height_map import NONE, Surface, forget, overlaps, put_view, sums_of
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.plane_fit import SUMS, height_planes, off_height_plane, turned
from stridetwin.streams.samples import Array

SLOTS = 256


class PlaneSet:
    """Planes with their votes and columns.

    Args:
        parameters: See `TerrainMapParameters`.

    Attributes:
        surface: The columns; labels are slots.
        ids: (SLOTS,) id of the plane in each slot, -1 = none.
        votes: (SLOTS,) score of each.
    """

    def __init__(self, parameters: TerrainMapParameters) -> None:
        self._p = parameters
        self._fewest = round(parameters.strip_area_m2 / parameters.voxel_size_m**2)
        self.surface = Surface()
        self.ids = np.full(SLOTS, NONE, np.int64)
        self.votes = np.zeros(SLOTS)
        self._sums = np.zeros((SLOTS, SUMS))
        self._told_sums, self._told_votes = self._sums.copy(), self.votes.copy()
        self._told: dict[int, Plane] = {}
        self._next_id = 0

    def clear(self) -> None:
        """Removes every plane; ids continue."""
        self.surface.clear()
        self.ids[:] = NONE
        self.votes[:] = 0.0
        self._sums[:] = 0.0

    def update(
        self, first: NDArray[np.int64], labels: NDArray[np.int32], sums: Array, height: NDArray[np.float32],
        noise: NDArray[np.float32],
    ) -> None:  # fmt: skip
        """Takes the planes of one top view.

        Args:
            first: (2,) column of the view's corner.
            labels: (n, n) number of each column's new plane, -1 = none.
            sums: (P, 11) over the columns of each new plane.
            height: (n, n) m, NaN where unobserved.
            noise: (n, n) m.
        """
        s = self.surface
        common, in_scope = overlaps(s.label, first, labels, height, len(sums), SLOTS)
        slots = self._pair(common, in_scope, sums)
        put_view(s.label, s.height, s.noise, first, labels, slots, height, noise, self._p.plane_noise_m)
        self._vote(slots, in_scope)
        self.refit()

    def refit(self) -> None:
        """Recomputes the sums over each plane's columns; removes planes with too few."""
        s = self.surface
        self._sums = sums_of(s.label, s.height, s.noise, s.origin, SLOTS, self._p.voxel_size_m)
        few = (self.ids >= 0) & (self._sums[:, 0] < self._fewest)
        self._remove(np.flatnonzero(few))

    def planes(self, R_world_grid: Array) -> dict[int, Plane]:
        """The planes by id, in world axes; R_world_grid is a (3, 3) rotation about the vertical.

        A plane that has not changed since the last call is the same object.
        """
        changed = (self._sums != self._told_sums).any(axis=1) | (self.votes != self._told_votes)
        self._told_sums[:], self._told_votes[:] = self._sums, self.votes
        found = {}
        fresh = []
        for slot in np.flatnonzero(self.ids >= 0).tolist():
            id_ = int(self.ids[slot])
            if changed[slot] or id_ not in self._told:
                fresh.append(slot)
            found[id_] = self._told.get(id_)
        self._told = {id_: plane for id_, plane in found.items() if plane is not None}
        self._told |= self._fitted(np.array(fresh, np.int64), R_world_grid)
        return {id_: self._told[id_] for id_ in found}

    def _fitted(self, slots: NDArray[np.int64], R_world_grid: Array) -> dict[int, Plane]:
        """The planes of these slots by id."""
        sums = self._sums[slots]
        centres, slopes, covariances, spreads = turned(
            *height_planes(
                sums, self._p.plane_sd_m, self._p.slope_sd_rad, self._p.shared_columns, self._p.slope_prior_sd_rad
            ),
            R_world_grid,
        )
        normals = np.column_stack([-slopes, np.ones(len(slots))])
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        ids, votes, areas = self.ids[slots].tolist(), self.votes[slots].tolist(), sums[:, 0] * self._p.voxel_size_m**2
        return {
            id_: Plane(
                id=id_, centre=centres[n], normal=normals[n], spread=spreads[n], area_m2=area, votes=votes[n],
                covariance=covariances[n],
            )
            for n, (id_, area) in enumerate(zip(ids, areas.tolist()))
        }  # fmt: skip

    def _pair(self, common: NDArray[np.int64], in_scope: NDArray[np.int64], sums: Array) -> NDArray[np.int32]:
        """Slot of each new plane: that of the matching plane, or a free one. See docs/terrain_map.md (9)."""
        sizes = sums[:, 0].astype(np.int64)
        slots = np.full(len(sizes), NONE, np.int32)
        new, old = np.nonzero(common)
        shared = common[new, old]
        union, smaller = sizes[new] + in_scope[old] - shared, np.minimum(sizes[new], in_scope[old])
        alike = np.flatnonzero(
            (shared > self._p.same_iou * union) | (shared > self._p.inside_share * np.maximum(smaller, 1))
        )
        for n in alike[np.argsort(-shared[alike], kind="stable")]:
            if slots[new[n]] == NONE and self._agrees(sums[new[n]], int(old[n])):
                slots[new[n]] = old[n]
        free = np.flatnonzero(self.ids < 0)
        wanted = np.flatnonzero(slots == NONE)
        if len(wanted) > len(free):
            taken = np.flatnonzero(self.ids >= 0)
            least = taken[np.argsort(self.votes[taken], kind="stable")[: len(wanted) - len(free)]]
            self._remove(least[~np.isin(least, slots)])
            free = np.flatnonzero(self.ids < 0)
        for d, slot in zip(wanted, free):
            slots[d] = slot
            self.ids[slot], self._next_id = self._next_id, self._next_id + 1
        return slots

    def _agrees(self, new: Array, slot: int) -> bool:
        """Whether all of a new plane lies on the old one, from its sums."""
        p = self._p
        off = off_height_plane(
            new, self._sums[slot], p.plane_sd_m, p.slope_sd_rad, p.shared_columns, p.slope_prior_sd_rad
        )
        return off < (p.apart * p.plane_noise_m) ** 2

    def _vote(self, slots: NDArray[np.int32], in_scope: NDArray[np.int64]) -> None:
        """A match is a vote for the plane; no match while in view is a vote against it."""
        paired = np.zeros(SLOTS, bool)
        paired[slots[slots >= 0]] = True
        self.votes[paired] = np.minimum(self.votes[paired] + 1.0, self._p.votes_max)
        lost = (self.ids >= 0) & ~paired & (in_scope > 0.5 * self._sums[:, 0])
        self.votes[lost] -= 1.0
        self._remove(np.flatnonzero(lost & (self.votes <= 0)))

    def _remove(self, slots: NDArray[np.intp]) -> None:
        if len(slots):
            self.ids[slots] = NONE
            self.votes[slots] = 0.0
            gone = np.zeros(SLOTS, bool)
            gone[slots] = True
            forget(self.surface.label, gone)
