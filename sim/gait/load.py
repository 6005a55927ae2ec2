"""How the load moves: the share that each foot carries and where its centre of pressure is meant to be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.interpolate import PchipInterpolator

from stridetwin.sim.body import Shoe
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
_BALL = 0.03  # inside the borders of what touches
_FLAT_RAD = 5e-4
_PASSING_S = 0.07


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


def pressure_centres(steps: Sequence[Footstep], shoe: Shoe, t: Array, pitch: Array) -> Array:
    """(N, 3) wanted centre of pressure of one foot in the world; in swing where the next stance begins.

    Args:
        steps: The footsteps of this foot, in order.
        shoe: Its sole.
        t: (N,) s.
        pitch: (N,) rad, of the foot against its ground, toes down positive: only the parts of the sole that it leaves
            on the ground can press.
    """
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
        x = _on_the_ball(x, t[on], step, pitch[on])
        local = np.stack([x * shoe.toe_hinge_x, np.zeros_like(x), np.zeros_like(x)], -1)
        p[on] = step.p_foot_in_world + local @ step.R_world_sole.T
    return p


def _on_the_ball(x: Array, t: Array, step: Footstep, pitch: Array) -> Array:
    """Keeps the centre of pressure ahead of the ball while the heel is up, over a riser."""
    stance = (t >= step.t_touch) & (t <= step.t_off)
    ahead = np.maximum(x, 1.0 + _BALL)
    middle = 0.5 * (max(step.t_touch, t[0]) + min(step.t_off, t[-1])) if len(t) else 0.0
    up = stance & (np.abs(pitch) > _FLAT_RAD)
    landing, leaving = t[up & (t < middle)], t[up & (t >= middle)]
    if len(landing) and step.arrival != "heel":
        x = ahead + (x - ahead) * ease((t - landing[-1]) / _PASSING_S)
    if len(leaving) and step.departure != "push":
        x = x + (np.maximum(x, 1.0 + _BALL) - x) * ease((t - leaving[0] + _PASSING_S) / _PASSING_S)
    return x


def _taken(s: Array) -> Array:
    """Share that the new foot has taken over: most of the load passes in the first half of double support."""
    return ease(s / 0.85)
