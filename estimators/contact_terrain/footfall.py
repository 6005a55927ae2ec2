"""One foot's stay on the ground: how it landed, which point of it holds, and how it lies when it is flat."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from stridetwin.estimators.compiled import cached
from stridetwin.estimators.contact_terrain.geometry import Sole
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent

ON_N, OFF_N = 60.0, 40.0
"""Load with which a foot has landed, and below which it has left."""
BOUNCE_S = 0.12
"""A foot that comes back sooner has not left."""
TOES_DOWN = math.radians(8.0)
"""A foot that comes down with its toes that much lower lands on the forefoot."""
FLAT_RADPS = 0.6
"""A foot that turns faster is not flat."""
STILL_RADPS = 0.2
SHARED = 0.05
"""Weight of a flat foot's attitude while the other foot carries load too."""
STRAINED, FREE_ENOUGH = 0.02, 1.0
"""Weight of a flat foot's attitude while its ankle is at a stop, and the weight of others that makes it unneeded."""
HEEL_RISES = math.radians(1.5)
"""A foot whose toes point that much further down than they did when it was flat is on its way off."""
FLAT_TICKS = 6


class Footfall:
    """A foot from one landing to the next.

    Attributes:
        step: Number of the step that ended with this landing; 0 for feet that stand at the start.
        on_heel: It landed on the heel and not on the forefoot.
        forward, up: (3,) sums of the sole's axes in the world over the ticks in which it was flat.
        weight: Sum of the weights of these ticks.
        ticks: Their number.
    """

    def __init__(self, step: int, on_heel: bool) -> None:
        self.step, self.on_heel = step, on_heel
        self.forward, self.up = np.zeros(3), np.zeros(3)
        self.weight, self.ticks = 0.0, 0
        self._highest, self._free = -math.inf, 0.0

    def lie(self, R_world_sole: Array, rate: float, loaded: bool, alone: bool, free: bool) -> bool:
        """Takes the attitude of a foot that is down; returns whether it is flat in this tick.

        Args:
            R_world_sole: (3, 3).
            rate: How fast the foot turns, rad/s.
            loaded: Whether it carries anything to speak of.
            alone: Whether the other foot carries nothing: a foot that has just landed is still pressed flat.
            free: Whether the ankle is clear of its stops: at a stop the leg turns the exoskeleton's foot off the shoe.
        """
        pitch = math.asin(max(-1.0, min(1.0, R_world_sole[2, 0])))
        if not loaded or rate > FLAT_RADPS or pitch < self._highest - HEEL_RISES:
            return False
        self._highest = max(self._highest, pitch)
        weight = (1.0 if alone else SHARED) / (1.0 + (rate / STILL_RADPS) ** 2)
        self._free += weight if free else 0.0
        weight *= 1.0 if free else STRAINED
        self.forward += weight * R_world_sole[:, 0]
        self.up += weight * R_world_sole[:, 2]
        self.weight += weight
        self.ticks += 1
        return True

    @property
    def flat(self) -> bool:
        """Whether it has been flat for long enough to tell how the ground lies."""
        return self.ticks >= FLAT_TICKS

    @property
    def strained(self) -> float:
        """How much of its attitude rests on ticks in which its ankle was at a stop, 0-1."""
        return max(0.0, 1.0 - self._free / FREE_ENOUGH)

    def R_world_sole(self) -> Array:
        """(3, 3) mean attitude of the flat sole."""
        return _axes(self.forward, self.up)


@cached(_HERE)
def _axes(forward: Array, up: Array) -> Array:
    """(3, 3) rotation whose z axis is along `up`, and whose x axis is as near to `forward` as that allows."""
    z = up / math.sqrt(up @ up)
    x = forward - (forward @ z) * z
    x /= math.sqrt(x @ x)
    R = np.empty((3, 3))
    R[:, 0], R[:, 1], R[:, 2] = x, np.cross(z, x), z
    return R


def holds(sole: Sole, on_heel: bool) -> Array:
    """(3,) m on the sole, the point that stays where it is: the heel's edge, or the hinge about which the toes bend."""
    return np.array([sole.heel_x, 0.0, 0.0]) if on_heel else np.array([sole.hinge_x, 0.0, sole.hinge_z])
