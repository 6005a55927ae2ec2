"""The published prediction: Zhao 2023 (16)-(18), and the ground under the predicted point (sections II-D and F).

The paper does not specify the offsets of left and right feet, nor how a mode follows from the ground. Here the offset
is half a step ahead of and half a step's width beside the camera's point, where a foot is when the other touches down.
The mode is that of the terrain under the predicted footprint: on a ramp by its slope along the walking direction, on a
tread by whether the stairs lead up or down there. Before and beyond a flight the ground is level; there the height
over the previous footprint identifies a step onto the landing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stridetwin.estimators.locomotion_mode.estimate import MODES, StepPrediction
from stridetwin.estimators.locomotion_mode.parameters import Settings
from stridetwin.estimators.locomotion_mode.rhythm import SIDE, SOON_S, StepRhythm
from stridetwin.estimators.terrain_map import Ramp, Stairs, TerrainMap
from stridetwin.streams.samples import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Division:
    """A touch-down with the camera's position and velocity.

    Attributes:
        foot: `l` or `r`.
        t_ns: Time of the touch-down.
        p: (3,) position of the camera, m.
        v: (3,) velocity of the camera, m/s.
    """

    foot: str
    t_ns: int
    p: Array
    v: Array


class WalkingInformation:
    """The last three touch-downs, from which Zhao 2023 (16)-(18) predict the next step.

    Args:
        settings: Width of a step.
    """

    def __init__(self, settings: Settings) -> None:
        self._width_m = settings.mode.width_m
        self._divisions: list[Division] = []  # the last three touch-downs at most, in order

    def clear(self) -> None:
        """Removes all touch-downs."""
        self._divisions = []

    def add(self, division: Division) -> None:
        """Takes a touch-down."""
        self._divisions = [*self._divisions[-2:], division]

    @property
    def last(self) -> Division | None:
        """The latest touch-down."""
        return self._divisions[-1] if self._divisions else None

    def sizes(self) -> list[float]:
        """Step sizes δ between the last three touch-downs, m, in order: Zhao 2023 (16), docs/locomotion_mode.md (1)."""
        pairs = zip(self._divisions, self._divisions[1:])  # of consecutive touch-downs
        return [float(np.linalg.norm((after.p - before.p)[:2])) for before, after in pairs]

    def last_size(self) -> float | None:
        """The latest step size, m; None with fewer than two touch-downs."""
        sizes = self.sizes()
        return sizes[-1] if sizes else None

    def step_time(self) -> float:
        """Time between the last two touch-downs, s; NaN with fewer than two."""
        if len(self._divisions) < 2:
            return math.nan
        return (self._divisions[-1].t_ns - self._divisions[-2].t_ns) * 1e-9

    def next_size(self) -> float:
        """Predicted size of the next step, m: Zhao 2023 (17), docs/locomotion_mode.md (2).

        Never negative; the last size if there is only one, NaN if there is none.
        """
        sizes = self.sizes()
        if len(sizes) < 2:
            return sizes[0] if sizes else math.nan
        return max(0.0, 2.0 * sizes[1] - sizes[0])  # linear extrapolation

    def footprint(self, ahead: int = 1) -> tuple[Array, Array] | None:
        """Predicted footprint (2,), m, and unit vector (2,) of the walking direction; None while the walk is unknown.

        Zhao 2023 (18) with the foot's offset from the camera, docs/locomotion_mode.md (3). The paper gives the first
        coming footprint, `ahead` = 1; each further one is one step size on.
        """
        return self._foot_position(self.next_size(), ahead)

    def stance(self) -> Array | None:
        """(2,) m, position of the foot that touched down last; None if it is unknown.

        The foot is taken to be half a step ahead of the camera, and half a step's width beside it.
        """
        size = self.last_size()
        footprint = None if size is None else self._foot_position(size, 0)
        return None if footprint is None else footprint[0]

    def _foot_position(self, size: float, ahead: int) -> tuple[Array, Array] | None:
        """A footprint, and the walking direction; None if the camera does not move or the step size is unknown.

        Feet lie half a step ahead of the camera, and alternately half a step's width to either side.

        Args:
            size: Size of a step, m.
            ahead: Number of steps after the last touch-down; 0 for the foot that has touched down.

        Returns:
            (2,) m, the footprint; (2,) unit vector of the direction.
        """
        speed = 0.0 if self.last is None else float(np.linalg.norm(self.last.v[:2]))
        if self.last is None or speed == 0.0 or not math.isfinite(size):
            return None
        forward = self.last.v[:2] / speed
        # `side` is the sign of the foot that lands so many steps ahead, left positive
        left, side = np.array([-forward[1], forward[0]]), SIDE[self.last.foot] * (-1.0) ** ahead
        offset = 0.5 * size * forward + 0.5 * self._width_m * side * left
        return self.last.p[:2] + forward * size * ahead + offset, forward


def mode_between(
    ground: TerrainMap, here: Array, there: Array, forward: Array, settings: Settings
) -> tuple[str, float]:
    """Mode of a step from one place to another, and the height of the ground there; LG and NaN if unknown.

    Args:
        ground: The map.
        here: (2,) m, previous footprint.
        there: (2,) m, new footprint.
        forward: (2,) unit vector of the walking direction.
        settings: Thresholds of ramps and stairs.
    """
    surface_there, surface_here = ground.ground(there), ground.ground(here)
    if surface_there is None:
        return "LG", math.nan
    plane, terrain = surface_there  # terrain: ramp, stairs, level ground, or None where that is unknown
    height = float(plane.height(there))
    slope = math.atan(float(plane.gradient @ forward))
    if isinstance(terrain, Ramp) and abs(slope) > settings.mode.min_ramp_slope_rad:
        return ("RA" if slope > 0 else "RD"), height
    if isinstance(terrain, Stairs):
        return ("SA" if float(terrain.up @ forward) > 0.0 else "SD"), height
    if surface_here is None:
        return "LG", height
    risen = height - float(surface_here[0].height(here))
    # from a ramp, or at the same height, onto ground that is neither ramp nor stairs
    if isinstance(surface_here[1], Ramp) or abs(risen) < settings.min_step_height_m:
        return "LG", height
    return ("SA" if risen > 0 else "SD"), height


def predict_published_steps(
    walking: WalkingInformation,
    rhythm: StepRhythm,
    ground: TerrainMap,
    body: Array,
    step_s: float,
    t_ns: int,
    settings: Settings,
) -> tuple[StepPrediction, ...]:
    """Predicts the coming steps by Zhao 2023 (16)-(18) and the map; a step whose place is unknown is LG at the camera.

    Args:
        walking: The last touch-downs.
        rhythm: Feet and times of the steps.
        ground: The map.
        body: (2,) m, position of the camera.
        step_s: Time of a step.
        t_ns: Current time.
        settings: Thresholds of ramps and stairs.
    """
    size = walking.next_size()  # of a step, m
    before = walking.stance()  # (2,) m, previous footprint; None while it is unknown
    steps = []
    for k, foot in enumerate(rhythm.next_feet()):
        footprint = walking.footprint(k + 1)
        # time of the landing; one that is overdue is expected `SOON_S` from now, each later one as much later
        at_ns = max(rhythm.down_ns + int(1e9 * (k + 1) * step_s), t_ns + int(1e9 * SOON_S * (k + 1)))
        place, height, mode = body, math.nan, "LG"
        if footprint is not None:
            place, forward = footprint
            here = place - forward * size if before is None else before
            mode, height = mode_between(ground, here, place, forward, settings)
            before = place
        steps.append(
            StepPrediction(
                step=rhythm.step + k + 1,
                foot=foot,
                mode=mode,
                probabilities={m: float(m == mode) for m in MODES},
                t_ns=at_ns,
                t_sd_s=math.nan,
                p_foot_in_world=np.array([*place, height]),
                covariance=np.full((2, 2), math.nan),
            )
        )
    return tuple(steps)
