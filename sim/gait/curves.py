"""Walking on curves: slower, with shorter steps and wider feet."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stridetwin.sim.way import Way
from stridetwin.streams.samples import Array

TURN_A_STEP_RAD = np.radians(30.0)
_STRAIGHT_FROM_M = 3.0  # radius
_SLOWEST = 0.4
_WIDER_M = 0.045  # on each side at the sharpest turn, so that the outer foot does not tread on the inner one
_PLANNING_M = 0.005


def speed_share(way: Way, s: Array) -> Array:
    """Speed relative to a straight way: it follows curvature to the power -1/3 (Hicheur et al. 2005)."""
    radius = 1.0 / np.maximum(np.abs(way.curvature(s)), 1e-6)
    return np.clip(np.cbrt(radius / _STRAIGHT_FROM_M), _SLOWEST, 1.0)


def turn_share(way: Way, s0: float, s1: float) -> float:
    """Change of heading between two arc lengths, relative to the largest change in one step."""
    return abs(float(way.heading(s1) - way.heading(s0))) / TURN_A_STEP_RAD


def widening(way: Way, s0: float, s1: float) -> float:
    """Additional lateral distance of a foot, m, for a turn between two arc lengths."""
    return _WIDER_M * min(turn_share(way, s0, s1), 1.0)


def paced(way: Way, start: float, stop: float, step: Callable[[Array], Array]) -> tuple[Array, Array]:
    """Arc lengths from start to stop and the steps made until there, for steps of `step(s)` m on a straight way.

    In curves the steps are shorter, as the square root of the speed, and no step turns farther than people do.
    """
    s = np.linspace(start, stop, 2 + int((stop - start) / _PLANNING_M))
    middle = (s[1:] + s[:-1]) / 2
    turning = np.abs(way.curvature(middle)) / TURN_A_STEP_RAD
    density = np.maximum(1.0 / (step(middle) * np.sqrt(speed_share(way, middle))), turning)
    return s, np.concatenate([[0.0], np.cumsum(density * np.diff(s))])
