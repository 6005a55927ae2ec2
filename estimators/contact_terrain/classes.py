"""Which way of walking a step belongs to, learnt from steps: a support vector machine (Shim et al. 2019, section 3)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Array


class TerrainSvm:
    """Classifies steps by slope and elevation, each divided by its largest magnitude in training.

    Args:
        slope: (N,) rad of the training steps.
        elevation: (N,) m.
        modes: (N,) their modes.

    Raises:
        StrideTwinError: scikit-learn is not installed, or there are not two modes at least to tell apart.
    """

    def __init__(self, slope: ArrayLike, elevation: ArrayLike, modes: ArrayLike) -> None:
        try:
            from sklearn.svm import SVC
        except ModuleNotFoundError as error:
            raise StrideTwinError(
                "scikit-learn is not installed; classes that are learnt need it: pip install 'stridetwin[learn]'"
            ) from error
        labels = np.asarray(modes)
        if len(np.unique(labels)) < 2:
            raise StrideTwinError(f"the steps to learn from are of {len(np.unique(labels))} modes; valid: 2 or more")
        features = np.column_stack([np.asarray(slope, dtype=float), np.asarray(elevation, dtype=float)])
        self._scale: Array = np.maximum(np.abs(features).max(axis=0), 1e-9)
        self._machine: Any = SVC(kernel="rbf", C=100.0, gamma=10.0).fit(features / self._scale, labels)

    def classify(self, slope: float, elevation: float) -> str:
        """Mode of one step.

        Args:
            slope: rad.
            elevation: m.
        """
        return str(self._machine.predict(np.array([[slope, elevation]]) / self._scale)[0])
