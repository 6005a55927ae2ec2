"""Light that changes in the course of a walk: a lamp that goes off or on, dusk, or a dark room behind a bright one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stridetwin.sim.config import LightChange, Route
from stridetwin.streams.samples import Array

_GRID_S = 0.02  # in which the time of a place on the way is found
_LEAST_S = 1e-3  # of a change that is sudden


@dataclass(frozen=True, kw_only=True)
class LightCourse:
    """Brightness of sun and sky over that at the start of a walk.

    Attributes:
        t_s: Times of knots, increasing; none for light that does not change.
        log_factor: Natural logarithm of the brightness over that at the start, at each knot; linear between them, so
            that a change has equal ratios in equal times, constant before and after.
    """

    t_s: tuple[float, ...] = ()
    log_factor: tuple[float, ...] = ()

    def factor(self, t_ns: int) -> float:
        """Brightness at a time over that at the start."""
        if not self.t_s:
            return 1.0
        return math.exp(float(np.interp(1e-9 * t_ns, self.t_s, self.log_factor)))


def plan_light(route: Route, duration_s: float, progress: Callable[[Array], Array]) -> LightCourse:
    """The course of the light on a walk.

    Changes begin in order of time, each at the brightness of that time. One at a place that the walk does not reach
    never begins.

    Args:
        route: Its light at the start, and the changes.
        duration_s: Length of the walk.
        progress: Gives the arc length along the way, (N,) m, at (N,) s.
    """
    if not route.light_changes:
        return LightCourse()
    t = np.arange(0.0, duration_s + _GRID_S, _GRID_S)
    farthest = np.maximum.accumulate(progress(np.minimum(t, duration_s)))
    starts = sorted(
        ((start, i) for i, change in enumerate(route.light_changes) if (start := _start(change, t, farthest)) < np.inf)
    )
    times, logs = [0.0], [0.0]
    for start, i in starts:
        change = route.light_changes[i]
        now = float(np.interp(start, times, logs))
        # knots after this start belong to a change that this one ends
        kept = [k for k, time in enumerate(times) if time < start]
        times = [times[k] for k in kept] + [start, start + max(change.over_s, _LEAST_S)]
        logs = [logs[k] for k in kept] + [now, math.log(change.to / route.light)]
    return LightCourse(t_s=tuple(times), log_factor=tuple(logs))


def _start(change: LightChange, t: Array, farthest: Array) -> float:
    """Time at which a change begins, s; inf for one at a place that is not reached.

    Args:
        change: The change.
        t: (N,) s, increasing.
        farthest: (N,) m, largest arc length along the way until then.
    """
    if change.at_s is not None:
        return change.at_s
    assert change.at_m is not None
    i = int(np.searchsorted(farthest, change.at_m))
    return float(t[i]) if i < len(t) else np.inf
