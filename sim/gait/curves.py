"""How people walk curves: slower, with shorter steps and wider feet."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stridetwin.sim.way import Way
from stridetwin.streams.samples import Array

TURN_A_STEP_RAD = np.radians(30.0)
_STRAIGHT_FROM_M = 3.0  # radius
_SLOWEST = 0.4
_WIDER_M = 0.045  # on each side at the sharpest turn: the outer foot must not tread on the inner one
_PLANNING_M = 0.005


def speed_share(way: Way, s: Array) -> Array:
    """Speed as a share of that on a straight way: it follows curvature to the power -1/3 (Hicheur et al. 2005)."""
    radius = 1.0 / np.maximum(np.abs(way.curvature(s)), 1e-6)
    return np.clip(np.cbrt(radius / _STRAIGHT_FROM_M), _SLOWEST, 1.0)


def turned(way: Way, s0: float, s1: float) -> float:
    """Turn between two arc lengths as a share of the sharpest that one step makes."""
    return abs(float(way.heading(s1) - way.heading(s0))) / TURN_A_STEP_RAD


def widening(way: Way, s0: float, s1: float) -> float:
    """By how much a foot stands farther out, m, for a turn between two arc lengths."""
    return _WIDER_M * min(turned(way, s0, s1), 1.0)


def paced(way: Way, start: float, stop: float, step: Callable[[Array], Array]) -> tuple[Array, Array]:
    """Arc lengths from start to stop and steps made until there, if a full step at s is `step(s)` m long on a line.

    In curves steps are shorter, as the square root of the speed, and none turns further than people's do.
    """
    s = np.linspace(start, stop, 2 + int((stop - start) / _PLANNING_M))
    middle = (s[1:] + s[:-1]) / 2
    turning = np.abs(way.curvature(middle)) / TURN_A_STEP_RAD
    density = np.maximum(1.0 / (step(middle) * np.sqrt(speed_share(way, middle))), turning)
    return s, np.concatenate([[0.0], np.cumsum(density * np.diff(s))])
