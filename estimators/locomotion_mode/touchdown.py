"""Touch-downs from pressure insoles."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stridetwin.estimators.locomotion_mode.parameters import LocomotionModeParameters
from stridetwin.streams.samples import Insole

FEET = {"/foot_l/insole": "l", "/foot_r/insole": "r"}


@dataclass
class _Foot:
    t_ns: int = -1
    least: float = 0.0
    most: float = 0.0
    down: bool = True
    raised_ns: int = 0


class TouchDowns:
    """Tells when a foot touches down.

    What an unloaded insole tells is not zero: cells creep and drift. A foot has left the ground when its load has
    fallen near the least that it told lately, or to a small share of the most: at the start that least is not known. It
    is down again when the load has risen from there by `touch_n`.
    A sample that is late, repeated, not finite or beyond any insole is passed over.

    Args:
        parameters: Loads.
    """

    def __init__(self, parameters: LocomotionModeParameters) -> None:
        self._p = parameters
        self._feet = {foot: _Foot() for foot in FEET.values()}

    def update(self, sample: Insole) -> str | None:
        """The foot that has touched down with this sample, else None."""
        foot = self._feet.get(FEET.get(sample.topic, ""))
        load = float(sample.force.sum())
        if foot is None or sample.t_ns <= foot.t_ns or not 0.0 <= load < self._p.force_max_n:
            return None
        dt = (sample.t_ns - foot.t_ns) * 1e-9 if foot.t_ns >= 0 else 0.0
        foot.t_ns = sample.t_ns
        foot.least = min(load, foot.least + self._p.creep_nps * dt)
        foot.most = max(load, foot.most * math.exp(-dt / self._p.forget_s))
        over = load - foot.least
        if foot.down:
            if over < self._p.lift_n or load < self._p.lift_share * foot.most:
                foot.down, foot.raised_ns, foot.least = False, sample.t_ns, load
            return None
        if over < self._p.touch_n:
            return None
        foot.down = True
        in_air = (sample.t_ns - foot.raised_ns) * 1e-9
        return FEET[sample.topic] if in_air >= self._p.swing_min_s else None
