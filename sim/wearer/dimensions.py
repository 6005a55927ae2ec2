"""Dimensions of the wearer: body, shoe and exoskeleton."""

from __future__ import annotations

from dataclasses import dataclass

from stridetwin.sim.exo_description import OwnExo
from stridetwin.sim.wearer.anthropometry import Anthropometry
from stridetwin.sim.wearer.exoskeleton import ExoLinks

_TOE_SPRING_M = 0.018  # length of the front of the sole that curves up


@dataclass(frozen=True, kw_only=True)
class Shoe:
    """Sole of a shoe in the foot's frame, m: its ends, its width and its toe hinge.

    Attributes:
        heel_back_x: Back edge of the heel.
        toe_hinge_x: Axis of the toe hinge.
        toe_hinge_z: Height of that axis above the sole.
        toe_tip_x: Front end.
        half_width: Half of its width.
    """

    heel_back_x: float
    toe_hinge_x: float
    toe_hinge_z: float
    toe_tip_x: float
    half_width: float

    @property
    def flat_tip_x(self) -> float:
        """Front end of the flat part of the sole, m; nothing in front of it presses on the ground."""
        return self.toe_tip_x - _TOE_SPRING_M


@dataclass(frozen=True, kw_only=True, eq=False)
class Wearer:
    """Dimensions of the person and the exoskeleton, as the gait planner needs them.

    Attributes:
        body: Lengths and masses of the person.
        girth: Thickness of trunk and limbs over that of the mean person.
        shoe: Sole of the shoes.
        ankle_x: Ankle's axis in the foot's frame, m.
        exo: Links of the built-in exoskeleton, or a custom one; None without it.
    """

    body: Anthropometry
    girth: float
    shoe: Shoe
    ankle_x: float
    exo: ExoLinks | OwnExo | None
