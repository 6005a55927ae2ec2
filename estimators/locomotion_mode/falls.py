"""Where the ground that is mapped ends ahead though the camera has looked beyond: it falls there, or has no depth.

Of a stair that leads down, a narrow or noisy camera may map nothing but the ground before it. Level ground beyond the
edge would have been in the images. They show something farther away instead, or no depth where that is out of range.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from stridetwin.estimators.locomotion_mode.segments import BEHIND_M, Fall
from stridetwin.estimators.terrain_map import Profile, TerrainMap
from stridetwin.estimators.terrain_map.depth_camera import BEHIND, GROUND, NO_DEPTH
from stridetwin.streams.samples import Array

_CELL_M = 0.06
"""Edge of a cell in which looks are counted, in plan."""
_LANES_M = (-0.12, 0.0, 0.12)
"""Lanes to the left of the path in which ground is expected."""
_REACH_M = 0.9
"""Way beyond the end of the mapped ground in which it is expected."""
_SAME_HEIGHT_M = 0.07
"""Looks at a cell count together while the expected heights differ by less: the least riser."""
_MOST_CELLS = 4000
"""Cells that are remembered; the oldest ones are forgotten first."""
_MIN_LOOKS = 6
"""Fewest looks into a cell that count: three lanes of two images."""
_MOST_GROUND, _LEAST_BEHIND = 0.25, 0.1
"""Largest share of looks that show ground where there is none, and least share of the looks into the first cells that
show something behind, where the ground falls."""
_FIRST_M = 0.3
"""Length of these first cells: a tread."""
_MIN_LENGTH_M = 0.18
"""Shortest stretch without the expected ground: the least tread."""


class _Looks(NamedTuple):
    """Looks into a cell.

    Attributes:
        height: Expected height of the ground, m.
        ground: How many show ground there.
        behind: How many show something farther away.
        nothing: How many show no depth.
    """

    height: float
    ground: int
    behind: int
    nothing: int


class FallFinder:
    """Counts what the camera shows beyond the end of the mapped ground.

    Bounded in memory: the oldest of `_MOST_CELLS` cells are forgotten.
    """

    def __init__(self) -> None:
        """Begins without looks."""
        self._cells: dict[tuple[int, int], _Looks] = {}

    def clear(self) -> None:
        """Forgets all looks, as when the map begins anew."""
        self._cells.clear()

    def look(self, ground: TerrainMap, profile: Profile, origin: Array, forward: Array) -> None:
        """Takes the last depth image.

        Args:
            ground: The map.
            profile: Profile of the ground along the path.
            origin: (2,) start of the path, m.
            forward: (2,) unit vector of the path.
        """
        end = _end_of_ground(profile)
        if end is None:
            return
        end_m, height, slope = end
        along = np.arange(end_m + 0.5 * _CELL_M, end_m + _REACH_M, _CELL_M)
        left = np.array([-forward[1], forward[0]])
        lanes = np.repeat(_LANES_M, len(along))
        s = np.tile(along, len(_LANES_M))
        points = np.column_stack([origin + s[:, None] * forward + lanes[:, None] * left, height + slope * (s - end_m)])
        codes = ground.look_for_ground(points)
        for place, z, code in zip(origin + s[:, None] * forward, points[:, 2].tolist(), codes.tolist()):
            if code not in (GROUND, BEHIND, NO_DEPTH):
                continue
            key = _cell(place)
            looks = self._cells.pop(key, None)  # put back as the newest one
            if looks is None or abs(looks.height - z) > _SAME_HEIGHT_M:
                looks = _Looks(z, 0, 0, 0)
            self._cells[key] = looks._replace(
                ground=looks.ground + int(code == GROUND),
                behind=looks.behind + int(code == BEHIND),
                nothing=looks.nothing + int(code == NO_DEPTH),
            )
        while len(self._cells) > _MOST_CELLS:
            del self._cells[next(iter(self._cells))]

    def find(self, profile: Profile, origin: Array, forward: Array) -> Fall | None:
        """The end of the ground ahead on a path; None where the camera has not looked beyond, or has seen ground there.

        Args:
            profile: Profile of the ground along the path.
            origin: (2,) start of the path, m.
            forward: (2,) unit vector of the path.
        """
        end = _end_of_ground(profile)
        if end is None:
            return None
        end_m, height, slope = end
        length_m, looks_all, behind = 0.0, 0, 0
        # the cell in which the ground ends shows it as well
        for s in np.arange(end_m + 1.5 * _CELL_M, end_m + _REACH_M, _CELL_M).tolist():
            looks = self._cells.get(_cell(origin + s * forward))
            if looks is None or abs(looks.height - height - slope * (s - end_m)) > _SAME_HEIGHT_M:
                break
            total = looks.ground + looks.behind + looks.nothing
            if total < _MIN_LOOKS or looks.ground > _MOST_GROUND * total:
                break
            length_m = s + 0.5 * _CELL_M - end_m
            if length_m < _FIRST_M:  # farther on, what lies behind may be out of range
                looks_all, behind = looks_all + total, behind + looks.behind
        if length_m < _MIN_LENGTH_M:
            return None
        return Fall(s=end_m, length=length_m, is_deep=behind > _LEAST_BEHIND * looks_all)


def _cell(place: Array) -> tuple[int, int]:
    """Indices of the cell at a (2,) place in plan, m."""
    return math.floor(place[0] / _CELL_M), math.floor(place[1] / _CELL_M)


def _end_of_ground(profile: Profile) -> tuple[float, float, float] | None:
    """Where the mapped ground ends ahead on a path: m along it, height, m, and slope (rise over run).

    None if it ends behind the body, or is not mapped at all.
    """
    seen = np.flatnonzero((profile.plane >= 0) & np.isfinite(profile.height))
    if not len(seen) or profile.s[seen[-1]] < BEHIND_M - 0.5:
        return None
    last = seen[-1]
    on = seen[profile.plane[seen] == profile.plane[last]]
    length = float(profile.s[last] - profile.s[on[0]])
    is_long = length > 0.5 and profile.slope is not None
    slope = math.tan(float(profile.slope[last])) if is_long and profile.slope is not None else 0.0
    return float(profile.s[last]), float(profile.height[last]), slope
