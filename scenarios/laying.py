"""How an estimator's world lies over the true one at an instant: a drift that was made is no error of what is seen."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stridetwin.streams.samples import Array
from stridetwin.streams.trajectory import Trajectory


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


class Laid:
    """Lays an estimator's world over the true one as it was at each instant: a drift that was made is no error here.

    Args:
        told: Poses as the estimator was given them.
        truth: True poses of the same frame at the same stamps.
    """

    def __init__(self, told: Trajectory, truth: Trajectory) -> None:
        self._t_ns = told.t_ns
        self._told, self._true = told.p_frame_in_world, truth.p_frame_in_world
        self._turn = _yaw(truth.q_world_frame) - _yaw(told.q_world_frame)

    def at(self, t_ns: int) -> Laying:
        """As it is laid at a time."""
        i = max(0, int(np.searchsorted(self._t_ns, t_ns, side="right")) - 1)
        return Laying(told=self._told[i], true=self._true[i], turn=float(self._turn[i]))

    def point(self, t_ns: int, p: Array) -> Array:
        """(2,) or (3,) m in the true world, of as many in the estimator's at a time."""
        return self.at(t_ns).to_true(p)


def _yaw(q: Array) -> Array:
    w, x, y, z = q.T
    return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
