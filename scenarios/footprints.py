"""True footprints: those of a recording, where they lie along the way, and when what is ahead of them is asked for."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from stridetwin.sim.route import Layout
from stridetwin.streams.recording import Recording
from stridetwin.streams.samples import Array, Footprint

FOOTPRINTS = "/truth/footprints"
ASKED_S = 1.5
"""How long before a foot lands beyond a change of the ground its place and size are asked for."""
_REACH_M = 1.5  # no step is longer: a jogger's are up to 1.4 m


def true_footprints(recording: Recording) -> list[Footprint]:
    """In order; those of the feet that stand at the start come first."""
    return list(recording.block(FOOTPRINTS))


def along_way(p_feet_in_world: ArrayLike, layout: Layout) -> Array:
    """(F,) m along the way, of (F, 3) m, all footprints of a walk in order."""
    return layout.way.project(np.asarray(p_feet_in_world, float).reshape(-1, 3)[:, :2], _REACH_M)


def asked_ns(s: float, t_ns: Array, places: Array) -> float:
    """When a change of the ground is asked for: `ASKED_S` before the first foot lands beyond it.

    Args:
        s: Its arc length, m.
        t_ns: (F,) touch-downs, in order.
        places: (F,) m along the way.

    Returns:
        ns; infinite where no foot lands beyond it.
    """
    beyond = np.flatnonzero(places > s)
    return float(t_ns[beyond[0]]) - ASKED_S * 1e9 if len(beyond) else math.inf
