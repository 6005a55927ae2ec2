"""Velocity of the back panel over a stance foot, from the legs' motion while its contact is fixed."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.estimators.contact_terrain.footfall import CellLoads
from stridetwin.estimators.contact_terrain.geometry import SIDES, Exoskeleton
from stridetwin.estimators.contact_terrain.leg import foot_place, leg_angles, links
from stridetwin.estimators.contact_terrain.parameters import DEFAULTS, ContactTerrainParameters
from stridetwin.estimators.contact_terrain.ticks import Attitudes, Tick, TickBuilder
from stridetwin.streams.samples import Array, Sample

# Hand-chosen on tuning seeds: ticks over which the velocity is taken, smallest load of a foot in stance, and the rate
# from which on a foot is not stationary.
_SPAN_TICKS, _LOADED_N, _STATIONARY_RADPS = 5, 100.0, 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class LegSpeed:
    """Velocity of the back panel over the ground.

    Attributes:
        t_ns: Middle of the measurement interval.
        v_back_in_world: (3,) m/s; z is up, x and y have the heading of the AHRS.
        resting: Whether both feet are loaded and neither rotates.
    """

    t_ns: int
    v_back_in_world: Array
    resting: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class _Feet:
    """Both feet at a tick, seen from the back panel in the world's axes.

    Attributes:
        t_ns: Time.
        p: (2, 3) m, of the soles.
        R: (2, 3, 3) world <- soles.
        centre: (2, 3) m, centres of pressure on the soles.
        load: (2,) N.
    """

    t_ns: int
    p: Array
    R: Array
    centre: Array
    load: Array


class LegSpeeds:
    """Velocity of the back panel from the samples of an exoskeleton.

    A foot rolls over the ground and its contact point is stationary: the centre of pressure of each interval is tracked
    through that interval as a point of the sole. Two loaded feet are weighted by load.

    Args:
        exo: Geometry.
        parameters: Of sensors and feet.
    """

    def __init__(self, exo: Exoskeleton, parameters: ContactTerrainParameters = DEFAULTS) -> None:
        self._soles = [exo.legs[side].sole for side in SIDES]
        self._links = [links(exo.legs[side]) for side in SIDES]
        self._ticks, self._attitudes = TickBuilder(exo), Attitudes(parameters)
        self._cells = [CellLoads(), CellLoads()]
        self._last: deque[_Feet] = deque(maxlen=_SPAN_TICKS + 1)

    def update(self, sample: Sample) -> LegSpeed | None:
        """Takes a sample in order of time; None if no foot is in stance, or too little is known yet."""
        speed = None
        for tick in self._ticks.add(sample):
            speed = self._step(tick)
        return speed

    def _step(self, tick: Tick) -> LegSpeed | None:
        self._attitudes.update(tick)
        if tick.dt == 0.0:
            self._last.clear()
        R, rates = self._attitudes.R, np.sqrt((tick.rate[3:] ** 2).sum(axis=1))
        p, R_sole, centre, load = np.zeros((2, 3)), np.zeros((2, 3, 3)), np.zeros((2, 3)), np.zeros(2)
        for i, (sole, leg) in enumerate(zip(self._soles, self._links)):
            q = leg_angles(leg, R, i, tick.knee[i])
            foot, _ = foot_place(leg, R, i, q)
            cells = np.maximum(self._cells[i].update(tick.force[i], float(rates[i]), tick.dt), 0.0)
            load[i] = cells.sum()
            centre[i, :2] = cells @ sole.cells / max(load[i], 1.0)
            p[i], R_sole[i] = foot + R[3 + i] @ sole.T_foot_sole[:3, 3], R[3 + i] @ sole.T_foot_sole[:3, :3]
        self._last.append(_Feet(t_ns=tick.t_ns, p=p, R=R_sole, centre=centre, load=load))
        if len(self._last) <= _SPAN_TICKS:
            return None
        v = velocity(self._last, _LOADED_N)
        if v is None:
            return None
        t_ns = (self._last[0].t_ns + tick.t_ns) // 2
        resting = bool((load > _LOADED_N).all() and rates.max() < _STATIONARY_RADPS)
        return LegSpeed(t_ns=t_ns, v_back_in_world=v, resting=resting)


def velocity(feet: Sequence[_Feet], loaded_n: float) -> Array | None:
    """(3,) m/s of the back panel over some ticks; None where no foot carries `loaded_n` through all of them."""
    seconds = (feet[-1].t_ns - feet[0].t_ns) * 1e-9
    moved, total = np.zeros(3), 0.0
    for i in range(2):
        weight = min(float(f.load[i]) for f in feet)
        if weight < loaded_n:
            continue
        for a, b in zip(list(feet)[:-1], list(feet)[1:]):
            contact = 0.5 * (a.centre[i] + b.centre[i])
            moved -= weight * (b.p[i] - a.p[i] + (b.R[i] - a.R[i]) @ contact)
        total += weight
    return moved / (total * seconds) if total else None
