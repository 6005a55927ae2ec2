"""The contact point about which the exoskeleton moves, carried from foot to foot (Shim et al. 2019, 2.2.3)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stridetwin.estimators.contact_terrain.phases import Phase
from stridetwin.streams.samples import Array


def pivot_foot(phases: Sequence[Phase], load: Array, last: int) -> int:
    """Which foot, 0 or 1, carries the pivot.

    The one that presses; of two, the one that is flat; of two that are both flat or both not, the one with more load.

    Args:
        phases: Of both feet.
        load: (2,) N.
        last: The foot that carried it; kept while no foot presses.
    """
    on = [phase is not Phase.FOOT_OFF for phase in phases]
    if on[0] != on[1]:
        return int(on[1])
    if not on[0]:
        return last
    flat = [phase is Phase.FOOT_FLAT for phase in phases]
    return int(flat[1]) if flat[0] != flat[1] else int(load[1] > load[0])


class Pivot:
    """The pivot in the world, whose origin is where it first is.

    Attributes:
        foot: Foot that carries it, 0 or 1.
        p_in_world: (3,) m.
    """

    def __init__(self) -> None:
        self.foot = 0
        self.p_in_world = np.zeros(3)
        self._cop: list[Array | None] = [None, None]

    def move(self, foot: int, cop_in_foot: Sequence[Array | None], R_world_base: Array, T_base_foot: Array) -> None:
        """Carries the pivot on by what changes in this tick: equations (12)-(16).

        Args:
            foot: That carries it from now on.
            cop_in_foot: (3,) m of each foot's centre of pressure in its last frame, None where it does not press.
            R_world_base: (3, 3).
            T_base_foot: (2, 4, 4) poses of the last frames in frame 0.
        """
        latest = [last if cop is None else cop for cop, last in zip(cop_in_foot, self._cop)]
        here, there = latest[foot], self._cop[foot] if foot == self.foot else latest[self.foot]
        if here is not None and there is not None:
            p_here = T_base_foot[foot, :3, :3] @ here + T_base_foot[foot, :3, 3]
            p_there = T_base_foot[self.foot, :3, :3] @ there + T_base_foot[self.foot, :3, 3]
            self.p_in_world = self.p_in_world + R_world_base @ (p_here - p_there)
        self.foot, self._cop = foot, latest
