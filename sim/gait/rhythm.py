"""Steps in time: a phase that counts them, and quantities that change smoothly from step to step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from stridetwin.sim.gait.footsteps import SETTLE_S, SHIFT_S, Footstep
from stridetwin.streams.samples import Array

_SMOOTHING_S = 0.09


@dataclass(frozen=True, kw_only=True, eq=False)
class Rhythm:
    """The walking steps of both feet in order of time.

    Attributes:
        steps: (K) footsteps with a touch-down.
        begin: (K,) s, when each step begins: the touch-down before it.
        end: (K,) s, its own touch-down.
    """

    steps: Sequence[Footstep]
    begin: Array
    end: Array

    @classmethod
    def of(cls, steps: Mapping[str, Sequence[Footstep]]) -> Rhythm:
        """Rhythm of the footsteps of both feet."""
        everyone = [s for own in steps.values() for s in own]
        order = sorted((s for s in everyone if np.isfinite(s.t_touch)), key=lambda s: s.t_touch)
        end = np.array([s.t_touch for s in order])
        first_off = min(s.t_off for s in everyone)
        share = float(order[0].style.double_support)
        begin = np.concatenate([[(first_off - share * end[0]) / (1.0 - share)], end[:-1]])
        return cls(steps=order, begin=begin, end=end)

    def phase(self, t: Array) -> Array:
        """(N,) number of steps made at (N,) uniform s, smooth; constant before the first and after the last."""
        knots = np.concatenate([[self.begin[0]], self.end])
        lead = self.end[0] - self.begin[0], self.end[-1] - self.begin[-1]
        knots = np.concatenate([[knots[0] - lead[0]], knots, [knots[-1] + lead[1]]])
        count = np.arange(-1.0, len(knots) - 1.0)
        inside = np.clip(t, knots[0], knots[-1])
        return _smooth(PchipInterpolator(knots, count)(inside), t)

    def blend(self, t: Array, values: Array, before: float, after: float) -> Array:
        """(N,) at (N,) uniform s: each of (K,) values in the middle of its step, `before` and `after` in stance."""
        middle = (self.begin + self.end) / 2
        at = np.concatenate([[self.begin[0] - SHIFT_S / 2], middle, [self.end[-1] + SETTLE_S / 2]])
        return _smooth(np.interp(t, at, np.concatenate([[before], values, [after]])), t)

    def styled(self, t: Array, name: str, rest: float, index: int | None = None) -> Array:
        """(N,) a field of the steps' styles, blended as in `blend`."""
        values = [getattr(step.style, name) for step in self.steps]
        return self.blend(t, np.array([v if index is None else v[index] for v in values]), rest, rest)


def _smooth(x: Array, t: Array) -> Array:
    return gaussian_filter1d(x, _SMOOTHING_S / (t[1] - t[0]), mode="nearest", truncate=5.0)
