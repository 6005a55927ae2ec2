"""Replanning of footsteps: the swing foot lands where it captures the body, at the measured height of the floor.

The body's divergent motion is that of an inverted pendulum, xi = c + c'/omega (capture point: Pratt et al. 2006;
divergent component of motion: Englsberger et al. 2015). The deviation of xi from its plan while a foot is in the air
shifts the foothold of that foot. The planned path of the pelvis then moves to the shifted footprint as the pendulum
would by itself, so that no force is spent on returning at once.

A shifted footprint stays on the plane of the planned one. The distance of the floor from that plane is measured under
the stance foot and predicted under the next one. A foot that does not press on the floor on time continues downward.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.samples import Array

OMEGA = 3.2  # 1/s, sqrt(g / height of the centre of mass)
_FOLLOW = 22.0  # rad/s, how fast a foot in the air follows its new foothold
_PRESSURE_M = 0.02  # largest shift of the centre of pressure under a foot
_BACK = 0.15  # share of the shift that each step removes, towards the planned footprints
_FORWARD_M, _OUTWARD_M, _INWARD_M = 0.15, 0.12, 0.035
_ON_EDGES_M = 0.0  # along the way near a riser: the toes already reach to the edge
_COMMITTED_S = 0.05  # this long before landing, the foothold is fixed
_SEARCH_MPS = 0.3  # downward speed of a late foot
_SETTLE_MPS = 0.05  # and of a foot that is over the floor but does not press


class PlannedFeet(NamedTuple):
    """Plan of the feet at one instant, or with a leading axis at N of them; rows left, right.

    Attributes:
        share: (2,) of the load.
        touching: (2, points) whether a sole point is planned to bear force.
        force_weight: (2, points) relative weight of force at a point: under a foot that stands on its toes alone, it is
            lower the closer the point is to the planned centre of pressure.
        R_sole: (2, 3, 3) axes in the world of the ground's frame under each foot (of the flat foot); in the air, of the
            next footprint.
        p_sole: (2, 3) m, the footprint.
        swinging: (2,) whether a foot is in the air.
        until_landing: (2,) s; 0 in stance.
        R_way: (2, 2) columns forward and left of the way.
        near_edge: (2,) whether the next footprint lies just before or behind a riser.
        p_foot: (2, 3) m; v_foot, a_foot its derivatives.
        R_foot: (2, 3, 3); w_foot (2, 3) rad/s, world axes; dw_foot its derivative.
    """

    share: Array
    touching: NDArray[np.bool_]
    force_weight: Array
    R_sole: Array
    p_sole: Array
    swinging: NDArray[np.bool_]
    until_landing: Array
    R_way: Array
    near_edge: NDArray[np.bool_]
    p_foot: Array
    v_foot: Array
    a_foot: Array
    R_foot: Array
    w_foot: Array
    dw_foot: Array


class Sensed(NamedTuple):
    """Measured state of body and feet at one instant.

    Attributes:
        com: (2, 2) m and m/s, horizontal centre of mass minus its plan, and the rate of that difference.
        floor: (2,) m, height of the floor above the plane of each footprint; NaN for a foot without contact.
        pressing: (2,) whether a foot presses on the floor.
    """

    com: Array
    floor: Array
    pressing: NDArray[np.bool_]


@dataclass(eq=False)
class StepReplan:
    """Shifts of feet and pelvis relative to the plan, world, m; rows left, right.

    Attributes:
        foot: (2, 3, 3) shift of each foot, its rate and acceleration.
        root: (3, 3) shift of the pelvis, its rate and acceleration.
        floor: (2,) m, height of the floor above the plane of each foot's planned footprint.
    """

    foot: Array
    root: Array
    floor: Array

    @classmethod
    def none(cls) -> StepReplan:
        """No shift."""
        return cls(foot=np.zeros((2, 3, 3)), root=np.zeros((3, 3)), floor=np.zeros(2))

    def update(self, dt: float, planned: PlannedFeet, sensed: Sensed, misplaced: Array) -> None:
        """Advances by one control step.

        Args:
            dt: Length of the step, s.
            planned: PlannedFeet state of the feet.
            sensed: Measured state of body and feet.
            misplaced: (2, 2) m, offset of each foot's landing from its foothold.
        """
        _update(self.foot, self.root, self.floor, dt, planned, sensed, misplaced)


@numba.njit(cache=True)
def _update(
    foot: Array, root: Array, floor: Array, dt: float, planned: PlannedFeet, sensed: Sensed, misplaced: Array
) -> None:  # fmt: skip
    swinging, until_landing, share, R_way = planned.swinging, planned.until_landing, planned.share, planned.R_way
    normal = planned.R_sole[:, :, 2]
    com, measured, pressing = sensed
    for k in range(2):
        if not np.isnan(measured[k]):
            floor[k] = measured[k]
        elif swinging[k]:
            floor[k] = floor[1 - k]
    xi = com[0] - root[0, :2] + (com[1] - root[1, :2]) / OMEGA
    wanted = np.empty(3)
    for k in range(2):
        shift, rate, pull = foot[k]
        pull[:] = 0.0
        held = foot[1 - k, 0, :2]
        if swinging[k] and until_landing[k] > _COMMITTED_S:
            # the present deviation grows until landing, minus what the centre of pressure corrects until then
            growth = np.exp(OMEGA * until_landing[k])
            off = np.sign(xi) * np.maximum(growth * np.abs(xi) - (growth - 1.0) * _PRESSURE_M, 0.0)
            ahead, left = R_way.T @ (off + (1.0 - _BACK) * held)
            reach = _ON_EDGES_M if planned.near_edge[k] else _FORWARD_M
            inner, outer = (-_INWARD_M, _OUTWARD_M) if k == 0 else (-_OUTWARD_M, _INWARD_M)
            ahead, left = min(max(ahead, -reach), reach), min(max(left, inner), outer)
            wanted[:2] = R_way[:, 0] * ahead + R_way[:, 1] * left + misplaced[k]
            wanted[2] = floor[k] - (normal[k, 0] * wanted[0] + normal[k, 1] * wanted[1]) / normal[k, 2]
            pull[:] = _FOLLOW * _FOLLOW * (wanted - shift)
        pull -= 2.0 * _FOLLOW * rate
        rate += dt * pull
        if not swinging[k] and not pressing[k]:
            rate[2], pull[2] = -(_SEARCH_MPS if np.isnan(measured[k]) else _SETTLE_MPS), 0.0
        shift += dt * rate
    under = share[0] * foot[0, 0] + share[1] * foot[1, 0]
    rate = OMEGA * (under - root[0])
    root[2] = (rate - root[1]) / dt
    root[1] = rate
    root[0] += dt * rate
