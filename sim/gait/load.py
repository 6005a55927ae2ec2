"""How the load moves: the share that each foot carries and where its centre of pressure is meant to be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.interpolate import PchipInterpolator

from stridetwin.sim.body import Shoe
from stridetwin.sim.gait.foot_path import base_rotation
from stridetwin.sim.gait.footsteps import SETTLE_S, SHIFT_S, Footstep
from stridetwin.sim.gait.smooth import ease
from stridetwin.streams.samples import Array

# centre of pressure along the foot against the share of stance: x as a share of the toe hinge's x, after the
# sketched human-like cycle (heel, then ball, far forward at push-off)
_TRAVEL = {
    "heel": ((0.0, -0.17), (0.08, -0.12), (0.45, 0.83), (0.86, 1.23), (1.0, 1.20)),
    "flat": ((0.0, 0.45), (0.15, 0.40), (0.55, 0.85), (0.86, 1.12), (1.0, 1.10)),
    "forefoot": ((0.0, 1.08), (0.12, 1.00), (0.35, 0.45), (0.60, 0.75), (0.86, 1.12), (1.0, 1.10)),
}
_STANDING = 0.50


def load_shares(steps: Mapping[str, Sequence[Footstep]], t: Array) -> dict[str, Array]:
    """Share of the load on each foot, (N,), summing to 1: it passes over by quintics during double support."""
    raw = {foot: np.zeros_like(t) for foot in steps}
    for foot, own in steps.items():
        other = [s for f in steps if f != foot for s in steps[f]]
        for step in own:
            other_off = min((s.t_off for s in other if s.t_off > step.t_touch), default=np.inf)
            other_touch = max((s.t_touch for s in other if s.t_touch < step.t_off), default=-np.inf)
            up = _taken((t - step.t_touch) / max(other_off - step.t_touch, 1e-6)) if np.isfinite(step.t_touch) else 1.0
            down = (
                1 - _taken(1 - (step.t_off - t) / max(step.t_off - other_touch, 1e-6))
                if np.isfinite(step.t_off)
                else 1.0
            )
            on = (t >= step.t_touch) & (t <= step.t_off)
            raw[foot] = np.where(on, up * down, raw[foot])
    total = sum(raw.values())
    return {foot: r / total for foot, r in raw.items()}


def standing_blend(shares: dict[str, Array], steps: Mapping[str, Sequence[Footstep]], t: Array) -> dict[str, Array]:
    """Shares with the quiet stand at both ends: half on each foot, then over to the foot that stays."""
    first = min(s.t_off for own in steps.values() for s in own)
    last = max(s.t_touch for own in steps.values() for s in own)
    stand = np.maximum(ease((first - t) / SHIFT_S), ease((t - last) / SETTLE_S))
    return {foot: (1 - stand) * s + stand * 0.5 for foot, s in shares.items()}


def pressure_centres(steps: Sequence[Footstep], shoe: Shoe, t: Array) -> Array:
    """(N, 3) wanted centre of pressure of one foot in the world; in swing where the next stance begins."""
    p = np.empty((len(t), 3))
    order = np.clip(np.searchsorted([s.t_touch for s in steps], t, side="right") - 1, 0, len(steps) - 1)
    for i, step in enumerate(steps):
        on = order == i
        knots = np.array(_TRAVEL[step.arrival])
        if np.isfinite(step.t_touch) and np.isfinite(step.t_off):
            u = np.clip((t[on] - step.t_touch) / (step.t_off - step.t_touch), 0.0, 1.0)
            x = PchipInterpolator(knots[:, 0], knots[:, 1])(u)
        elif np.isfinite(step.t_off):
            x = _STANDING + (knots[-1, 1] - _STANDING) * ease((t[on] - step.t_off + SHIFT_S) / SHIFT_S)
        else:
            x = knots[0, 1] + (_STANDING - knots[0, 1]) * ease((t[on] - step.t_touch) / SETTLE_S)
        local = np.stack([x * shoe.toe_hinge_x, np.zeros_like(x), np.zeros_like(x)], -1)
        p[on] = step.p_foot_in_world + local @ base_rotation(step).T
    return p


def _taken(s: Array) -> Array:
    """Share that the new foot has taken over: most of the load passes in the first half of double support."""
    return ease(s / 0.85)
