"""The wearer's motion as functions of time, whatever its source: planned, recorded from a person, or simulated.

Players, sensors and truth read a walk through these classes alone.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from stridetwin.sim.kinematics.coordinates import Coordinates
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.streams.samples import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Stance:
    """A foot on the ground: its footprint, and from when to when it is there.

    Attributes:
        foot: `l` or `r`.
        p_foot_in_world: (3,) m, the flat foot's origin.
        R_world_sole: (3, 3) of the flat foot: x along the foot in the ground's plane, z the ground's normal.
        terrain: level, stair or ramp.
        mode: Locomotion mode of the step that ends here: LG, SA, SD, RA or RD.
        t_touch: Touch-down, s; -inf for the feet that stand at the start.
        t_off: Toe-off, s; inf for the feet that stand at the end.
    """

    foot: str
    p_foot_in_world: Array
    R_world_sole: Array
    terrain: str
    mode: str
    t_touch: float
    t_off: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Walk(ABC):
    """A walk as functions of time.

    Attributes:
        duration_s: Length of the walk.
        size: Wearer.
        steps: Stances of each foot in order of time, initial stance first.
        coordinates: Layout of the generalised coordinates.
        splines: Splines of the coordinates (`Coordinates.names`).
    """

    duration_s: float
    size: Wearer
    steps: Mapping[str, Sequence[Stance]]
    coordinates: Coordinates
    splines: BSpline

    def state(self, t: NDArray[np.floating]) -> tuple[Array, Array, Array]:
        """Generalised position (N, nq), velocity (N, nv) and acceleration (N, nv) at (N,) s, in MuJoCo's layout."""
        return self.coordinates.evaluate(self.splines, np.clip(t, 0.0, self.duration_s))

    def position_velocity(self, t: NDArray[np.floating]) -> tuple[Array, Array]:
        """Generalised position (N, nq) and velocity (N, nv) at (N,) s, in MuJoCo's layout; faster than `state`."""
        return self.coordinates.position_velocity(self.splines, np.clip(t, 0.0, self.duration_s))

    def stances(self, feet: Iterable[str] | None = None) -> list[Stance]:
        """Stances in order of their touch-downs.

        Args:
            feet: Those whose stances are asked for; None for both.
        """
        return sorted((s for foot in feet or self.steps for s in self.steps[foot]), key=lambda s: s.t_touch)

    @abstractmethod
    def pitch(self, side: str, t: NDArray[np.floating]) -> Array:
        """(N,) rad, pitch of a foot relative to the ground under it, toes down positive."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GivenWalk(Walk):
    """A walk that is given in advance, planned or recorded, so that its loads follow from inverse dynamics.

    Attributes:
        grid: (N,) increasing s, on which the walk was made; it extends beyond both ends.
    """

    grid: Array

    @abstractmethod
    def contact_shares(self, t: NDArray[np.floating]) -> Array:
        """(N, 8) at (N,) s: share of the load and centre of pressure (3, m, world) of the left, then the right foot."""

    @abstractmethod
    def progress(self, t: NDArray[np.floating]) -> Array:
        """(N,) m, arc length of the walker along the way at (N,) s."""
