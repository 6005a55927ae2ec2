"""A foot that turns on its ball while it is on the ground, with the heel up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stridetwin.sim.kinematics.smooth import ease
from stridetwin.sim.wearer.dimensions import Shoe
from stridetwin.streams.algebra.arrays import rot_z
from stridetwin.streams.samples import Array

_IN_S, _OUT_S = 0.70, 0.17  # times in which a foot turns after it lands, and before it leaves; chosen by hand


@dataclass(frozen=True, kw_only=True)
class Twist:
    """How far a foot turns on its ball in a stance.

    Attributes:
        in_rad: From the landing until it is flat, left positive.
        out_rad: From heel-off until it leaves.
    """

    in_rad: float = 0.0
    out_rad: float = 0.0

    def angle(self, t: Array, t_touch: float, t_off: float) -> Array:
        """(N,) rad, direction of the foot relative to its flat footprint at (N,) s of a stance."""
        angle = np.zeros(len(t))
        if self.in_rad:
            angle -= self.in_rad * (1.0 - ease((t - t_touch) / _IN_S))
        if self.out_rad:
            angle += self.out_rad * ease((t - t_off) / _OUT_S + 1.0)
        return angle


def turn_on_ball(p_foot: Array, R_world_sole: Array, shoe: Shoe, angle: float) -> tuple[Array, Array]:
    """Pose of a flat foot that has turned on its ball: (3,) m, and (3, 3).

    Args:
        p_foot: (3,) m, its origin before.
        R_world_sole: (3, 3) its rotation before.
        shoe: Its sole.
        angle: Of the turn, rad, left positive.
    """
    ball = np.array([shoe.toe_hinge_x, 0.0, shoe.toe_hinge_z])
    turned = R_world_sole @ rot_z(np.array(angle))
    return p_foot + R_world_sole @ ball - turned @ ball, turned
