"""How an estimator's world lies over the true one at an instant: a drift that was made is no error of what is seen."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stridetwin.streams.samples import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Laying:
    """A shift, and a turn about the vertical, between two worlds.

    Attributes:
        told: (3,) m, where the estimator believes its frame.
        true: (3,) m, where that is.
        turn: rad, of the true world against the estimator's.
    """

    told: Array
    true: Array
    turn: float = 0.0

    @property
    def rotation(self) -> Array:
        """(2, 2) in plan, from the estimator's world to the true one."""
        c, s = math.cos(self.turn), math.sin(self.turn)
        return np.array([[c, -s], [s, c]])

    def to_true(self, points: Array) -> Array:
        """(..., 2 or 3) m in the true world, of as many in the estimator's."""
        return self._moved(points, self.told, self.true, self.rotation)

    def to_told(self, points: Array) -> Array:
        """(..., 2 or 3) m in the estimator's world, of as many in the true one."""
        return self._moved(points, self.true, self.told, self.rotation.T)

    @staticmethod
    def _moved(points: Array, before: Array, after: Array, rotation: Array) -> Array:
        offset = np.asarray(points, float) - before[: np.shape(points)[-1]]
        offset[..., :2] = offset[..., :2] @ rotation.T
        return np.asarray(offset + after[: offset.shape[-1]])
