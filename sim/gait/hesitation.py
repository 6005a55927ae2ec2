"""Hesitation: a swing that slows down, hovers or goes back before it lands; and half steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stridetwin.sim.acts import Hesitate
from stridetwin.sim.gait.foot_placement import Foothold
from stridetwin.sim.gait.style import Style
from stridetwin.sim.kinematics.smooth import bump
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

# Chosen by hand.
_AT = 0.55  # share of the usual swing at which the foot slows down
_BRAKING_S = 0.25  # time in which it comes to rest, and in which it goes on
_BACK = 0.30  # of its way, by which a foot that retraces goes back
_FINE = np.linspace(0.0, 1.0, 401)  # shares of swing at which the inverse is tabulated
_HALF_STEPS = (0.25, 0.5, 0.75)  # shares of the way between two footholds of the other foot


@dataclass(frozen=True, kw_only=True)
class Hesitation:
    """How the swing of one step hesitates.

    Attributes:
        how: `slow`, `hover` or `retrace`.
        for_s: By how much longer the swing is.
    """

    how: str
    for_s: float

    def usual_share(self, share: Array, swing_s: float) -> Array:
        """(N,) share of the usual swing that a foot has made at (N,) shares of the swing of `swing_s` seconds."""
        usual_s = swing_s - self.for_s
        if self.how == "slow":
            return np.asarray(share)
        return np.asarray((share * swing_s - self._lost_s(share * swing_s - _AT * usual_s)) / usual_s)

    def share_at(self, usual: Array, swing_s: float) -> Array:
        """(N,) shares of the swing of `swing_s` seconds at which a foot has made (N,) shares of the usual swing."""
        return np.interp(usual, self.usual_share(_FINE, swing_s), _FINE)

    def returned(self, share: Array, swing_s: float) -> Array:
        """(N,) share of its way by which a foot is back at (N,) shares of the swing of `swing_s` seconds."""
        if self.how != "retrace":
            return np.zeros_like(share)
        since = share * swing_s - _AT * (swing_s - self.for_s)
        return _BACK * bump(since / (self.for_s + self._braking_s))

    def lost_share(self, share: Array, swing_s: float) -> Array:
        """(N,) share of `for_s` that has passed at (N,) shares of the swing of `swing_s` seconds."""
        if self.how == "slow":
            return np.clip(share, 0.0, 1.0)
        return self._lost_s(share * swing_s - _AT * (swing_s - self.for_s)) / self.for_s

    @property
    def _braking_s(self) -> float:
        """Time in which the foot comes to rest, s: no longer than it then rests."""
        return min(_BRAKING_S, self.for_s)

    def _lost_s(self, since: Array) -> Array:
        """(N,) s by which the foot is late, (N,) s after it began to brake; smooth to the third derivative."""
        brake = self._braking_s
        return brake * (_integral(since / brake) - _integral((since - self.for_s) / brake))


def _integral(x: Array) -> Array:
    """(N,) integral of the minimum-jerk step `ease` from 0 to x: x⁴ (2.5 - 3 x + x²), and x - 1/2 from x = 1 on."""
    inside = np.clip(x, 0.0, 1.0)
    return inside**4 * (2.5 + inside * (inside - 3.0)) + np.maximum(x - 1.0, 0.0)


def lengthen_swing(style: Style, longer: float) -> Style:
    """Style of a step whose swing is longer: `longer` is the duration of the step relative to the usual one."""
    return replace(
        style,
        double_support=style.double_support / longer,
        heel_off_before=style.heel_off_before / longer,
        flat_after=style.flat_after / longer,
    )


def take_half_steps(holds: Sequence[Foothold], act: Hesitate) -> list[Foothold]:
    """The footholds with four steps of half the length in place of two, from the step to the act's place on.

    Args:
        holds: Footholds in order.
        act: The act.

    Raises:
        ConfigError: There is no room for them.
    """
    i = next((i for i, hold in enumerate(holds) if hold.s >= act.at_m), len(holds))
    valid = "a place amid a level or a ramp, away from other acts and stops"
    if not 0 < i < len(holds) - 2:
        raise ConfigError("gait", "acts.at_m", act.at_m, valid)
    before, hold, after = holds[i - 1], holds[i], holds[i + 1]
    busy = any(h.act is not None or h.pause_s > 0.0 for h in (before, hold, after))
    if busy or not before.strip is hold.strip is after.strip or hold.strip.terrain == "stair":
        raise ConfigError("gait", "acts.at_m", act.at_m, valid)
    steps = [
        replace(hold, foot=foot, s=before.s + share * (after.s - before.s))
        for foot, share in zip((hold.foot, after.foot, hold.foot), _HALF_STEPS)
    ]
    return [*holds[:i], *steps, *holds[i + 1 :]]
