"""Whether one foot joins the other on a tread, as of people who climb step by step.

The walker is of one of two kinds, who join the foot that has crossed an edge nearly always or nearly never, and changes
from time to time. The kind is part of the stance foot's density: often only the body's height over the foot shows
whether the last step joined the other foot, and then it shows the walker's kind as well.
"""

from __future__ import annotations

import numpy as np

from stridetwin.estimators.locomotion_mode.parameters import LocomotionModeParameters
from stridetwin.streams.samples import Array

KINDS = 2
"""Walkers who put both feet on each tread, and others."""


class Joining:
    """The two kinds of walkers.

    A joint density (2, 2, S) is over the kind, over whether the last step crossed an edge (no, yes) and over the
    stance foot's position; it sums to 1. Only after a step over an edge can the other foot join this one.

    See docs/locomotion_mode.md (13).

    Args:
        parameters: One set serves everyone.
    """

    def __init__(self, parameters: LocomotionModeParameters) -> None:
        p = parameters
        self.prior: Array = np.array([p.joiners, 1.0 - p.joiners])
        self.chances: Array = np.array([p.joiner_joins, p.other_joins])
        self._change = p.joining_change

    def joint(self, density: Array, kinds: Array) -> Array:
        """(2, 2, S) of a foot with (S,) density whose step crossed no edge, and (2,) probabilities of the kinds."""
        return np.stack([kinds[:, None] * density, np.zeros((KINDS, len(density)))], axis=1)

    def changed(self, joint: Array) -> Array:
        """(2, 2, S) after the walker may have changed kind, which matters only after a step over an edge."""
        after = joint.copy()
        crossed = joint[:, 1]
        after[:, 1] = (1.0 - self._change) * crossed + self._change * self.prior[:, None] * crossed.sum(axis=0)
        return after

    def next_and_later(self, joint: Array) -> tuple[float, float]:
        """Probability that the next foot joins if it can, and the same of later feet."""
        crossed, kinds = joint[:, 1].sum(axis=-1), joint.sum(axis=(1, 2))
        later = float(kinds @ self.chances / kinds.sum())
        return (float(crossed @ self.chances / crossed.sum()) if crossed.sum() > 0.0 else later), later
