"""Footsteps moved on the way: the foot in swing lands where it catches the body.

The body's divergent motion is that of an inverted pendulum, xi = c + c'/omega (capture point: Pratt et al. 2006;
divergent component of motion: Englsberger et al. 2015). What xi is off its plan when a foot is in the air shifts the
place where that foot lands; the planned path of the pelvis then passes over to the shifted footprint as the pendulum
would by itself, so that no force is spent on going back at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.samples import Array

OMEGA = 3.2  # 1/s, sqrt(g / height of the centre of mass)
_FOLLOW = 22.0  # rad/s, how fast a foot in the air follows its new place
_PRESSURE_M = 0.02  # as far the centre of pressure can be shifted under a foot
_BACK = 0.15  # share of the shift that each step gives back, towards the planned footprints
_FORWARD_M, _OUTWARD_M, _INWARD_M = 0.15, 0.12, 0.035
_ON_EDGES_M = 0.015  # along the way where a riser is near
_COMMITTED_S = 0.05  # before landing the foot's place is settled


@dataclass(eq=False)
class StepReplan:
    """Shifts of feet and pelvis against the plan, horizontal, m; rows left, right.

    Attributes:
        foot: (2, 3, 2) shift of each foot, its rate and acceleration.
        root: (3, 2) shift of the pelvis, its rate and acceleration.
    """

    foot: Array
    root: Array

    @classmethod
    def none(cls) -> StepReplan:
        """No shift."""
        return cls(foot=np.zeros((2, 3, 2)), root=np.zeros((3, 2)))

    def update(
        self, dt: float, c_error: Array, dc_error: Array, swinging: NDArray[np.bool_], until_landing: Array,
        share: Array, R_way: Array, near_edge: NDArray[np.bool_],
    ) -> None:  # fmt: skip
        """Moves on by one control step.

        Args:
            dt: Its length, s.
            c_error: (2,) m, centre of mass less its plan.
            dc_error: (2,) m/s, its rate.
            swinging: (2,) whether a foot is in the air by plan.
            until_landing: (2,) s.
            share: (2,) of the load, planned.
            R_way: (2, 2) columns forward and left of the way.
            near_edge: (2,) whether the footprint to come lies before or behind a riser.
        """
        xi = c_error - self.root[0] + (dc_error - self.root[1]) / OMEGA
        for k in range(2):
            held = self.foot[1 - k, 0]
            if swinging[k] and until_landing[k] > _COMMITTED_S:
                # what is off now grows until landing, less what the centre of pressure takes back till then
                growth = np.exp(OMEGA * until_landing[k])
                off = np.sign(xi) * np.maximum(growth * np.abs(xi) - (growth - 1.0) * _PRESSURE_M, 0.0)
                ahead, left = R_way.T @ (off + (1.0 - _BACK) * held)
                reach = _ON_EDGES_M if near_edge[k] else _FORWARD_M
                inner, outer = (-_INWARD_M, _OUTWARD_M) if k == 0 else (-_OUTWARD_M, _INWARD_M)
                wanted = R_way @ np.array([np.clip(ahead, -reach, reach), np.clip(left, inner, outer)])
                pull = _FOLLOW * _FOLLOW * (wanted - self.foot[k, 0])
            else:
                pull = np.zeros(2)
            self.foot[k, 2] = pull - 2.0 * _FOLLOW * self.foot[k, 1]
            self.foot[k, 1] += dt * self.foot[k, 2]
            self.foot[k, 0] += dt * self.foot[k, 1]
        under = share @ self.foot[:, 0]
        rate = OMEGA * (under - self.root[0])
        self.root[2] = (rate - self.root[1]) / dt
        self.root[1] = rate
        self.root[0] += dt * rate
