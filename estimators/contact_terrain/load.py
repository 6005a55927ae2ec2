"""Loads under a foot from cells that creep, drift, die or stick.

What a cell tells of a foot in the air is not load. Each cell's least value of the last strides, counted in time that
the foot spent turning, is taken off what it tells: creep and drift go, a cell that sticks comes to nothing, and a dead
one was nothing before.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.contact_terrain.parameters import DEFAULTS, CellParameters
from stridetwin.streams.samples import Array


class CellLoads:
    """The cells of one insole.

    Args:
        parameters: What counts as rotating, as felt and as a stride.
    """

    def __init__(self, parameters: CellParameters = DEFAULTS.cells) -> None:
        self._parameters = parameters
        self._least = np.full((2, 4), np.inf)  # of this stride and the last
        self._most = np.full((3, 4), -np.inf)  # of one more: two may pass in one long swing, as over two risers
        self._turned = 0.0
        self._told = np.zeros(4)

    def update(self, force: Array, rate: float, dt: float) -> Array:
        """(4,) N, load on each cell.

        Args:
            force: (4,) N as told.
            rate: How fast the foot turns, rad/s.
            dt: Since the last tick, s.
        """
        self._told = force
        self._most[0] = np.maximum(self._most[0], force)
        if rate > self._parameters.turning_radps:
            self._least[0] = np.minimum(self._least[0], force)
            self._turned += dt
        if self._turned > self._parameters.stride_s:
            self._turned = 0.0
            self._least[1], self._least[0] = self._least[0], force
            self._most[1:], self._most[0] = self._most[:-1].copy(), force
        if not np.isfinite(self._least[1]).all():  # before the first stride nothing is known of an unloaded cell
            return force
        load: Array = force - self._least.min(axis=0)
        return load

    def empty(self) -> None:
        """The foot is in the air: what the cells tell now is no load."""
        self._least = np.stack([self._told, self._told])

    @property
    def alive(self) -> NDArray[np.bool_]:
        """(4,) whether each cell has felt anything in the last strides."""
        felt: NDArray[np.bool_] = self._most.max(axis=0) - self._least.min(axis=0) > self._parameters.felt_n
        return felt
