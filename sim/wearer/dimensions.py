"""Dimensions of the wearer: body, shoe and exoskeleton."""

from __future__ import annotations

from dataclasses import dataclass

from stridetwin.sim.exo_description import OwnExo
from stridetwin.sim.wearer.anthropometry import Anthropometry
from stridetwin.sim.wearer.exoskeleton import ExoLinks

_TOE_SPRING_M = 0.018


@dataclass(frozen=True, kw_only=True)
class Shoe:
    """Sole in the foot's frame, m: where it ends and where it bends."""

    heel_back_x: float
    toe_hinge_x: float
    toe_hinge_z: float
    toe_tip_x: float
    half_width: float

    @property
    def flat_tip_x(self) -> float:
        """Where the sole begins to curve up; nothing in front of it presses on the ground."""
        return self.toe_tip_x - _TOE_SPRING_M


@dataclass(frozen=True, kw_only=True, eq=False)
class Wearer:
    """Dimensions of the person and the exoskeleton, as the gait planner needs them."""

    body: Anthropometry
    girth: float
    shoe: Shoe
    ankle_x: float
    exo: ExoLinks | OwnExo | None
