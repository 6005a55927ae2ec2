"""How fast the walker goes where, and how long a step is there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d

from stridetwin.sim.body import Wearer
from stridetwin.sim.config import Gait
from stridetwin.sim.gait.manner import shuffled_share, walk_growth
from stridetwin.sim.gait.style import leg_length, pace
from stridetwin.sim.route import RUN_OUT_M, Strip
from stridetwin.streams.samples import Array

_STEP_AT_PACE_1 = 1.05  # legs, by the walk ratio: 0.66 m at 1.2 m/s for a person of 1.75 m
_BRISK_MPS = 1.2  # nobody goes faster than this from or to standing, and on ramps
_GAIN_MPS2 = 0.5  # and only gets faster at this rate
_STAIR_MAX_MPS = 1.6  # nor climbs stairs as if walking faster
_QUICKEST_SHUFFLE_S = 0.48
_WOBBLE, _WOBBLE_M = 0.20, 2.0  # speed of a stroll: deviation (fraction, SD) and the way on which it changes
_GRID_M = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class Tempo:
    """Speed and step length along the way.

    Attributes:
        size: Wearer.
        gait: How the person walks.
        slow: (K,) arc lengths where the walker may go no faster than briskly: the start, the end, stairs and ramps.
        grid: (N,) m, arc lengths of `share`.
        share: (N,) speed as a share of the preferred one.
    """

    size: Wearer
    gait: Gait
    slow: Array
    grid: Array
    share: Array

    @classmethod
    def along(cls, profile: Sequence[Strip], size: Wearer, gait: Gait, rng: np.random.Generator) -> Tempo:
        """Tempo of one walk; only a wanderer's takes random numbers."""
        end = profile[-1].s1 - RUN_OUT_M
        uneven = [np.arange(strip.s0, strip.s1 + _GRID_M, _GRID_M) for strip in profile if strip.terrain != "level"]
        risers = [a.s1 for a, b in pairwise(profile) if a.z1 != b.z0]
        slow = np.sort(np.concatenate([[0.0, end], risers, *uneven]))
        grid = np.arange(0.0, end + _GRID_M, _GRID_M)
        share = np.ones_like(grid)
        if gait.pattern == "wander":
            wobble = gaussian_filter1d(rng.standard_normal(len(grid)), _WOBBLE_M / _GRID_M, mode="reflect")
            share = np.exp(_WOBBLE * wobble / max(float(wobble.std()), 1e-9))
        return cls(size=size, gait=gait, slow=slow, grid=grid, share=share)

    def speed(self, s: Array | float) -> Array:
        """(...) m/s, wanted on a straight way at (...) arc lengths."""
        s = np.asarray(s, dtype=float)
        away = np.min(np.abs(s[..., None] - self.slow), axis=-1)
        most = np.sqrt(_BRISK_MPS**2 + 2 * _GAIN_MPS2 * away)
        return np.minimum(self.gait.speed_mps * np.interp(s, self.grid, self.share), most)

    def on_stairs(self, s: float) -> float:
        """M/s on the level that goes with the walker's cadence on stairs there."""
        return min(self.gait.speed_mps * float(np.interp(s, self.grid, self.share)), _STAIR_MAX_MPS)

    def step(self, s: Array | float) -> Array:
        """(...) m, length of a step on a straight level way at (...) arc lengths."""
        return preferred_step(self.speed(s), self.size) * shuffled_share(self.gait.shuffle)

    def duration(self, s: float) -> float:
        """Duration of that step, s."""
        least = _QUICKEST_SHUFFLE_S * self.gait.shuffle
        return max(float(self.step(s) / self.speed(s)), least)


def preferred_step(speed_mps: Array | float, size: Wearer) -> Array:
    """Preferred step length on level ground, m, at (...) m/s; sources in `manner.walk_growth`."""
    return _STEP_AT_PACE_1 * walk_growth(np.asarray(speed_mps) * pace(1.0, size)) * leg_length(size)
