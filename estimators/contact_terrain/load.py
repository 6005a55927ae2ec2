"""Loads under a foot from cells that creep, drift, die or stick.

A cell's output with the foot in the air is not load. Each cell's minimum over the last strides, counted in time that
the foot spent rotating, is subtracted. This removes creep and drift; a stuck or dead cell then reports zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.contact_terrain.parameters import DEFAULTS, CellParameters
from stridetwin.streams.samples import Array


class CellLoads:
    """The cells of one insole.

    Args:
        parameters: Thresholds of rotation, load and stride.
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
            force: (4,) N, as measured.
            rate: Angular rate of the foot, rad/s.
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
        """Marks the foot as in the air: the current readings are not load."""
        self._least = np.stack([self._told, self._told])

    @property
    def alive(self) -> NDArray[np.bool_]:
        """(4,) whether each cell has measured a load in the last strides."""
        felt: NDArray[np.bool_] = self._most.max(axis=0) - self._least.min(axis=0) > self._parameters.felt_n
        return felt
