"""Speed of the walker along the path and the step length there; curves are walked slower, with shorter, wider steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d

from stridetwin.sim.config import Gait
from stridetwin.sim.gait.style import leg_length, pace, shuffled_share, walk_growth
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.sim.world.route import RUN_OUT_M, Layout
from stridetwin.sim.world.way import Way
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


_STEP_AT_PACE_1 = 1.05  # leg lengths, by the walk ratio: 0.66 m at 1.2 m/s for a person of 1.75 m
_BRISK_MPS = 1.2  # speed limit near standing, on ramps and in tight bends
_TO_RISER_MPS = 0.9  # and where stairs begin and end: their steps are slow
_TIGHT_M = 2.0  # radius
_GAIN_MPS2 = 0.5  # largest acceleration
_STAIR_MAX_MPS = 1.6  # speed limit for the cadence on stairs
_QUICKEST_SHUFFLE_S = 0.48
_WOBBLE, _WOBBLE_M = 0.20, 2.0  # speed of a stroll: SD as a fraction, and the distance over which it changes
_GRID_M = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class Tempo:
    """Speed and step length along the way.

    Attributes:
        size: Wearer.
        gait: Gait of the person.
        slow: (K,) arc lengths with a speed limit `most`: the start, the end, stairs, ramps and tight bends.
        most: (K,) m/s.
        grid: (N,) m, arc lengths of `share`.
        share: (N,) speed relative to the preferred one.
    """

    size: Wearer
    gait: Gait
    slow: Array
    most: Array
    grid: Array
    share: Array

    @classmethod
    def along(cls, layout: Layout, size: Wearer, gait: Gait, rng: np.random.Generator) -> Tempo:
        """Tempo of one walk; only a wandering walk uses random numbers."""
        profile = layout.profile
        end = profile[-1].s1 - RUN_OUT_M
        uneven = [np.arange(strip.s0, strip.s1 + _GRID_M, _GRID_M) for strip in profile if strip.terrain != "level"]
        risers = [a.s1 for a, b in pairwise(profile) if a.z1 != b.z0]
        grid = np.arange(0.0, end + _GRID_M, _GRID_M)
        tight = grid[np.abs(layout.way.curvature(grid)) > 1.0 / _TIGHT_M]
        slow = np.concatenate([risers, [0.0, end], tight, *uneven])
        most = np.full(len(slow), _BRISK_MPS)
        most[: len(risers)] = _TO_RISER_MPS
        share = np.ones_like(grid)
        if gait.pattern == "wander":
            smoothing = _WOBBLE_M / _GRID_M
            wobble = gaussian_filter1d(rng.standard_normal(len(grid)), smoothing, mode="reflect")
            # the SD after a Gaussian filter of white noise; the SD of a short way would magnify its mean
            share = np.exp(_WOBBLE * wobble * np.sqrt(2.0 * np.sqrt(np.pi) * smoothing))
        return cls(size=size, gait=gait, slow=slow, most=most, grid=grid, share=share)

    def speed(self, s: Array | float) -> Array:
        """(...) m/s, planned speed on a straight way at (...) arc lengths."""
        s = np.asarray(s, dtype=float)
        away = np.abs(s[..., None] - self.slow)
        most = np.sqrt(np.min(self.most**2 + 2 * _GAIN_MPS2 * away, axis=-1))
        return np.minimum(self.gait.speed_mps * np.interp(s, self.grid, self.share), most)

    def on_stairs(self, s: float) -> float:
        """Speed on the level, m/s, with the same cadence as the walker has on stairs there."""
        return min(self.gait.speed_mps * float(np.interp(s, self.grid, self.share)), _STAIR_MAX_MPS)

    def step(self, s: Array | float) -> Array:
        """(...) m, step length on a straight level way at (...) arc lengths."""
        return preferred_step(self.speed(s), self.size) * shuffled_share(self.gait.shuffle)

    def duration(self, s: float) -> float:
        """Duration of that step, s."""
        least = _QUICKEST_SHUFFLE_S * self.gait.shuffle
        return max(float(self.step(s) / self.speed(s)), least)


def preferred_step(speed_mps: Array | float, size: Wearer) -> Array:
    """Preferred step length on level ground, m, at (...) m/s; sources in `manner.walk_growth`."""
    return _STEP_AT_PACE_1 * walk_growth(np.asarray(speed_mps) * pace(1.0, size)) * leg_length(size)
