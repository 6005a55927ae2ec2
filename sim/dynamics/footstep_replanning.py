"""Replanning of footsteps: the swing foot lands where it captures the body, at the measured height of the floor.

The body's divergent motion is that of an inverted pendulum, xi = c + c'/omega (capture point: Pratt et al. 2006;
divergent component of motion: Englsberger et al. 2015). The deviation of xi from its plan while a foot is in the air
shifts the foothold of that foot. The planned path of the pelvis then moves to the shifted footprint as the pendulum
would by itself, so that no force is spent on returning at once.

A shifted footprint stays on the plane of the planned one. The distance of the floor from that plane is measured under
the stance foot and predicted under the next one. A foot that does not press on the floor on time continues downward.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.samples import Array

_entry_kernel = entry_kernel(Path(__file__).parent, llvm_level=1)

OMEGA = 3.2  # 1/s, sqrt(g / height of the centre of mass)
_FOLLOW = 22.0  # rad/s, how fast a foot in the air follows its new foothold
_PRESSURE_M = 0.02  # largest shift of the centre of pressure under a foot
_BACK = 0.15  # share of the shift that each step removes, towards the planned footprints
# largest shifts of a foothold along the way, away from the other foot, and towards it
_FORWARD_M, _OUTWARD_M, _INWARD_M = 0.15, 0.12, 0.035
_ON_EDGES_M = 0.0  # along the way near a riser: the toes already reach to the edge
_COMMITTED_S = 0.05  # this long before landing, the foothold is fixed
# way of the body's centre of mass per way of a foot in the air: thigh, shank and foot have 0.19 of the mass (de Leva
# 1996) and move by about 0.2, 0.7 and 1.0 of it, and the exoskeleton's leg adds a part
_LEG_SHARE = 0.1
_SEARCH_MPS = 0.3  # downward speed of a late foot
_SETTLE_MPS = 0.05  # and of a foot that is over the floor but does not press


class PlannedFeet(NamedTuple):
    """Plan of the feet at one instant, or with a leading axis at N of them; rows left, right.

    Attributes:
        share: (2,) of the load, 0-1.
        touching: (2, points) whether a sole point is planned to bear force.
        force_weight: (2, points) relative weight of force at a point: under a foot that stands on its toes alone, it is
            lower the closer the point is to the planned centre of pressure.
        R_sole: (2, 3, 3) footprint of each foot: rotation of the flat foot, foot to world, whose third column is the
            normal of the ground; in the air, that of the next footprint.
        p_sole: (2, 3) m, origin of the flat foot on that footprint.
        swinging: (2,) whether a foot is in the air.
        until_landing: (2,) s; 0 in stance.
        R_way: (2, 2) columns forward and left of the way.
        near_edge: (2,) whether the next footprint lies just before or behind a riser.
        p_foot: (2, 3) m, origins of the feet in the world.
        v_foot: (2, 3) m/s, derivative of `p_foot`.
        a_foot: (2, 3) m/s², derivative of `v_foot`.
        R_foot: (2, 3, 3) rotations, foot to world.
        w_foot: (2, 3) rad/s, angular velocities, world axes.
        dw_foot: (2, 3) rad/s², derivative of `w_foot`.
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


class StepReplan(NamedTuple):
    """Shifts of feet and pelvis relative to the plan, world, m; rows left, right. `advance_shifts` overwrites them.

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
        """Zero shifts, with which a walk begins."""
        return cls(foot=np.zeros((2, 3, 3)), root=np.zeros((3, 3)), floor=np.zeros(2))


@_entry_kernel
def advance_shifts(
    shifts: StepReplan,
    dt: float,
    planned: PlannedFeet,
    com: Array,
    measured: Array,
    pressing: NDArray[np.bool_],
    landing_offset: Array,
) -> None:
    """Advances the shifts of feet and pelvis by one control step.

    Let c be the deviation of the centre of mass from its plan, which the shifts of the pelvis and of the leg in the air
    move, ξ = c + c' / ω that of the divergent motion, T the time until landing, and b what the centre of pressure can
    correct. The foothold of a foot in the air shifts by exp(ω T) |ξ| − (exp(ω T) − 1) b in the direction of ξ, plus
    most of the shift of the other foot. This shift is limited along and across the way. The foot follows it critically
    damped. The pelvis follows the feet that bear load at the rate ω.

    Args:
        shifts: Shifts at the step before, which are overwritten.
        dt: Length of the step, s.
        planned: Plan of the feet.
        com: (2, 2) m and m/s, horizontal centre of mass minus its plan, and the rate of that difference.
        measured: (2,) m, height of the floor above the plane of each footprint; NaN for a foot without contact.
        pressing: (2,) whether a foot presses on the floor.
        landing_offset: (2, 2) m, offset of each foot's landing from its foothold.
    """
    foot, root, floor = shifts  # `foot` [k, 0], [k, 1], [k, 2] and `root` [0], [1], [2]: shift, its rate, acceleration
    swinging, until_landing, R_way = planned.swinging, planned.until_landing, planned.R_way
    # floor under each foot: as measured; for a foot in the air, as under the other one
    for k in range(2):
        if not np.isnan(measured[k]):
            floor[k] = measured[k]
        elif swinging[k]:
            floor[k] = floor[1 - k]
    for k in range(2):
        # just before landing the foothold does not change any more; shift of the foothold along and across the way, m
        is_following, ahead, left = swinging[k] and until_landing[k] > _COMMITTED_S, 0.0, 0.0
        if is_following:
            # the present deviation grows until landing, minus what the centre of pressure corrects until then
            growth = math.exp(OMEGA * until_landing[k])
            for axis in range(2):  # x and y of the world
                # what the leg in the air moves the body by following its shift is no deviation: counted as one, it
                # would enlarge the shift, and the feet would swing farther and farther from their plan
                xi = com[0, axis] - root[0, axis] - _LEG_SHARE * foot[k, 0, axis]
                xi += (com[1, axis] - root[1, axis] - _LEG_SHARE * foot[k, 1, axis]) / OMEGA
                foothold_shift = math.copysign(max(growth * abs(xi) - (growth - 1.0) * _PRESSURE_M, 0.0), xi)
                foothold_shift += (1.0 - _BACK) * foot[1 - k, 0, axis]
                ahead += R_way[axis, 0] * foothold_shift
                left += R_way[axis, 1] * foothold_shift
            reach = _ON_EDGES_M if planned.near_edge[k] else _FORWARD_M
            # limits of the shift to the left: the left foot may go farther to the left, the right one to the right
            inner, outer = (-_INWARD_M, _OUTWARD_M) if k == 0 else (-_OUTWARD_M, _INWARD_M)
            ahead, left = min(max(ahead, -reach), reach), min(max(left, inner), outer)
        # the shifted footprint stays on the plane of the planned one, at the height of the floor
        x = R_way[0, 0] * ahead + R_way[0, 1] * left + landing_offset[k, 0]
        y = R_way[1, 0] * ahead + R_way[1, 1] * left + landing_offset[k, 1]
        normal = planned.R_sole[k, 0, 2], planned.R_sole[k, 1, 2], planned.R_sole[k, 2, 2]
        target = x, y, floor[k] - (normal[0] * x + normal[1] * y) / normal[2]
        # the foot goes to the target critically damped at the rate `_FOLLOW`; otherwise its motion decays
        for axis in range(3):
            rate = foot[k, 1, axis]
            acceleration = _FOLLOW * _FOLLOW * (target[axis] - foot[k, 0, axis]) if is_following else 0.0
            acceleration -= 2.0 * _FOLLOW * rate
            rate += dt * acceleration
            # a foot that should stand but does not press yet goes straight down, slower once it is over the floor
            if axis == 2 and not swinging[k] and not pressing[k]:
                rate, acceleration = -(_SEARCH_MPS if np.isnan(measured[k]) else _SETTLE_MPS), 0.0
            foot[k, 2, axis], foot[k, 1, axis] = acceleration, rate
            foot[k, 0, axis] += dt * rate
    # pelvis: its rate is OMEGA times its distance from the shift of the feet, weighted by their loads
    for axis in range(3):
        feet_shift = planned.share[0] * foot[0, 0, axis] + planned.share[1] * foot[1, 0, axis]
        rate = OMEGA * (feet_shift - root[0, axis])
        root[2, axis] = (rate - root[1, axis]) / dt
        root[1, axis] = rate
        root[0, axis] += dt * rate
