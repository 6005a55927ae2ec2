"""Paths of the feet: stance pivots without slip, swing that clears the ground, smooth to the second derivative.

In stance the foot turns about the heel's edge while its pitch is negative (toes up) and about the toe hinge, toes flat,
while it is positive. In swing a point that wanders through the foot from the toe hinge (the pivot it leaves) to the
pivot it lands on moves on soft paths; both pivots rest at their ends, so position, velocity and acceleration
match there whatever the foot's pitch does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import PchipInterpolator, make_interp_spline
from scipy.ndimage import gaussian_filter1d

from stridetwin.sim.body import Shoe, Wearer
from stridetwin.sim.gait.footsteps import Footstep
from stridetwin.sim.gait.smooth import bump, ease, quintic, soft_ease
from stridetwin.sim.gait.style import RISE_KNOTS, SWING_KNOTS, Style, leg_length
from stridetwin.sim.rotation import between, rot_y
from stridetwin.streams.samples import Array

_NEAR_EDGE_M, _NEAR_EDGE_DOWN_M = 0.004, 0.012  # a riser counts this much before and behind it
_HEEL_FIRST_RAD = 0.03  # least toe-up pitch of a landing on the heel
# Higher risers and steeper ramps than these bend the knee and lean the shank farther: the heel stays up for longer, by
# so much a metre or a radian beyond.
_USUAL_RISER_M, _USUAL_FALL_M, _USUAL_SLOPE_RAD = 0.155, 0.095, 0.16  # a fall of a step on a ramp
_HEEL_OFF_BY_FALL, _HEEL_OFF_BY_SLOPE, _PUSH_BY_RISE = 12.0, 2.5, 1.5
_TIPTOE_BY_RISE, _TIPTOE_BY_SLOPE = 2.4, 1.8
_FLAT_BY = 0.6  # of stance at the latest
_PITCH_SMOOTHING_S = 0.020
_PITCH_GRID_S = 0.004
_SETTLING_S = 0.04  # from the end of the landing to a sole that lies exactly flat


@dataclass(frozen=True, kw_only=True, eq=False)
class FootPath:
    """Poses of one foot on a time grid.

    Attributes:
        p_foot_in_world: (N, 3) m.
        R_world_foot: (N, 3, 3).
        toe_extension: (N,) rad.
        pitch: (N,) rad, foot against the ground it stands on or flies over, toes down positive.
        s: (N,) m along the way.
        heading: (N,) rad, direction of the way, not wrapped.
    """

    p_foot_in_world: Array
    R_world_foot: Array
    toe_extension: Array
    pitch: Array
    s: Array
    heading: Array


@dataclass(frozen=True, kw_only=True)
class Arrival:
    """How a foot lands; pitch in rad, toes down positive.

    Attributes:
        before: (share of swing, pitch) on the way down.
        touch: Pitch at touch-down.
        flat_after: When the foot is flat, as a share of the step's duration.
        settling: (share of that time, share of the pitch at touch-down).
    """

    before: tuple[tuple[float, float], ...]
    touch: float
    flat_after: float
    settling: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Departure:
    """How a foot leaves.

    Attributes:
        heel_off_before: When the heel leaves before toe-off, as a share of the step's duration.
        rise: (share of that time, share of the pitch at toe-off).
        off: Pitch at toe-off.
        swing: (share of swing, pitch) after toe-off.
        forward: Shares of swing between which the foot moves forward.
        upward: Shares of swing between which the foot changes to its new ground.
    """

    heel_off_before: float
    rise: tuple[tuple[float, float], ...]
    off: float
    swing: tuple[tuple[float, float], ...]
    forward: tuple[float, float] = (0.0, 1.0)
    upward: tuple[float, float] = (0.0, 1.0)


# Over a riser the foot first rises and then moves forward, or first moves out and then sinks, to land on the forefoot.
_RISE = ((0.0, 0.0), (0.30, 0.05), (0.55, 0.20), (0.80, 0.55), (1.0, 1.0))
_ARRIVALS = {
    "flat": Arrival(before=((0.72, 0.35), (0.88, 0.18)), touch=0.10, flat_after=0.16),
    "forefoot": Arrival(before=((0.76, 0.50), (0.90, 0.52)), touch=0.45, flat_after=0.37),
}
_DEPARTURES = {
    "climb": Departure(heel_off_before=0.42, rise=_RISE, off=0.52, swing=((0.16, 0.85), (0.34, 0.90), (0.52, 0.75)),
                       forward=(0.20, 1.0), upward=(0.0, 0.62)),
    "lower": Departure(heel_off_before=0.57, rise=_RISE, off=0.70, swing=((0.16, 0.95), (0.30, 0.54)),
                       forward=(0.0, 0.90), upward=(0.10, 1.0)),
}  # fmt: skip
_WAITS = (0.0, 0.15, 0.30, 0.45)  # shares of swing that a foot may stay above before it sinks: an edge may be far ahead
_LIFT_SPENT_M = 0.02  # rather than wait
_LANDING_KNOTS = 3  # of the swing's, from which on the pitch prepares the landing


def _arrival(step: Footstep) -> Arrival:
    """How the foot lands: on the heel in the step's own style, else as the terrain asks."""
    if step.arrival != "heel":
        return _ARRIVALS[step.arrival]
    style = step.style
    knots = list(zip(SWING_KNOTS, style.pitch.tolist()))
    return Arrival(before=tuple(knots[-_LANDING_KNOTS:-1]), touch=knots[-1][1], flat_after=float(style.flat_after))


def _departure(step: Footstep, style: Style) -> Departure:
    """How the foot leaves: with a push in the style of the step that it begins, else as the terrain asks."""
    if step.departure != "push":
        return _DEPARTURES[step.departure]
    knots = list(zip(SWING_KNOTS, style.pitch.tolist()))
    return Departure(
        heel_off_before=float(style.heel_off_before),
        rise=tuple(zip(RISE_KNOTS, [0.0, *style.rise.tolist(), 1.0])),
        off=knots[0][1],
        swing=tuple(knots[1:-_LANDING_KNOTS]),
    )


def foot_path(
    steps: Sequence[Footstep], size: Wearer, t: Array, height: Callable[[Array], Array]
) -> FootPath:  # fmt: skip
    """Path of one foot.

    Args:
        steps: The footsteps of this foot, in order.
        size: Wearer.
        t: (N,) s, increasing.
        height: Height of the ground at (..., 2) points, m.
    """
    pitch_of = _pitch(steps, t[-1])
    theta = pitch_of(t)
    n = len(t)
    p, R = np.empty((n, 3)), np.empty((n, 3, 3))
    toe, s, heading = np.empty(n), np.empty(n), np.empty(n)
    for i, step in enumerate(steps):
        on = (t >= step.t_touch) & (t <= step.t_off)
        p[on], R[on], toe[on] = _stance(step, size.shoe, theta[on])
        s[on], heading[on] = step.s, step.heading
        if i + 1 < len(steps):
            to = steps[i + 1]
            air = (t > step.t_off) & (t < to.t_touch)
            p[air], R[air], toe[air] = _swing(step, to, size, t[air], theta[air], pitch_of, height)
            share = ease((t[air] - step.t_off) / (to.t_touch - step.t_off))
            s[air] = step.s + share * (to.s - step.s)
            heading[air] = step.heading + share * (to.heading - step.heading)
    return FootPath(p_foot_in_world=p, R_world_foot=R, toe_extension=toe, pitch=theta, s=s, heading=heading)


def _stance(step: Footstep, shoe: Shoe, theta: Array) -> tuple[Array, Array, Array]:
    base, tilt = step.R_world_sole, rot_y(theta)
    heel = np.array([shoe.heel_back_x, 0.0, 0.0])
    hinge = np.array([shoe.toe_hinge_x, 0.0, shoe.toe_hinge_z])
    pivot = np.where(theta[:, None] < 0.0, heel, hinge)
    local = pivot - np.einsum("nij,nj->ni", tilt, pivot)
    return step.p_foot_in_world + local @ base.T, base @ tilt, np.maximum(theta, 0.0)


def _swing(
    a: Footstep, b: Footstep, size: Wearer, t: Array, theta: Array, pitch_of: Callable[[Array], Array],
    height: Callable[[Array], Array],
) -> tuple[Array, Array, Array]:  # fmt: skip
    if len(t) == 0:
        return np.empty((0, 3)), np.empty((0, 3, 3)), np.empty(0)
    s = (t - a.t_off) / (b.t_touch - a.t_off)
    fine = np.linspace(0.0, 1.0, 81)[1:-1]
    fine_theta = pitch_of(a.t_off + fine * (b.t_touch - a.t_off))
    down = a.departure == "lower"
    near = (_NEAR_EDGE_DOWN_M if down else _NEAR_EDGE_M) * np.array([np.cos(b.heading), np.sin(b.heading)])
    lifts = {
        wait: _lift_needed(
            _swing_without_lift(a, b, size, fine, fine_theta, pitch_of, wait),
            size.shoe,
            fine,
            height,
            near,
            b.clearance_m,
        )
        for wait in (_WAITS if down else _WAITS[:1])
    }
    least = min(lifts.values()) + _LIFT_SPENT_M
    wait, lift = next((wait, lift) for wait, lift in lifts.items() if lift <= least)
    p, R, toe = _swing_without_lift(a, b, size, s, theta, pitch_of, wait)
    p = p.copy()
    p[:, 2] += lift * bump(s)
    return p, R, toe


def _swing_without_lift(
    a: Footstep, b: Footstep, size: Wearer, s: Array, theta: Array, pitch_of: Callable[[Array], Array], wait: float
) -> tuple[Array, Array, Array]:
    shoe, manner = size.shoe, _departure(a, b.style)
    windows = manner.forward, (manner.upward[0] + wait, manner.upward[1])
    forward, upward = (soft_ease((s - first) / (last - first)) for first, last in windows)
    hinge = np.array([shoe.toe_hinge_x, 0.0, shoe.toe_hinge_z])
    landing = np.array([shoe.heel_back_x, 0.0, 0.0]) if b.arrival == "heel" else hinge
    within = hinge + soft_ease((s - 0.30) / 0.55)[:, None] * (landing - hinge)  # once the foot has come level
    start: Array = a.p_foot_in_world + a.R_world_sole @ hinge
    end = b.p_foot_in_world + b.R_world_sole @ landing
    share = np.stack([forward, forward, upward], -1)
    point = start + share * (end - start)
    # in a turn the foot goes round, so that it passes the other one at its distance
    outward = np.array([end[1] - start[1], start[0] - end[0], 0.0]) * (b.heading - a.heading) / 8.0
    point = point + (4.0 * forward * (1.0 - forward))[:, None] * outward
    if a.departure == "push" and b.arrival == "heel":
        point = point + _swing_shape(b.style, s, b.R_world_sole) * leg_length(size)
    R = between(a.R_world_sole, b.R_world_sole, soft_ease(s)) @ rot_y(theta)
    # the toes leave flat on the ground, stay raised in the air and meet the ground as the landing needs
    toe_a, toe_b = pitch_of(np.array([a.t_off]))[0], max(pitch_of(np.array([b.t_touch]))[0], 0.0)
    toe = quintic(s, toe_a, _rate(pitch_of, a, b, a.t_off), toe_b,
                   _rate(pitch_of, a, b, b.t_touch) if b.arrival != "heel" else 0.0)  # fmt: skip
    return point - np.einsum("nij,nj->ni", R, within), R, toe


def _swing_shape(style: Style, s: Array, base: Array) -> Array:
    """(N, 3) way of a swinging foot off its soft path, in legs; at rest at both ends."""
    powers = np.vander(2 * s - 1, len(style.forward), increasing=True).T
    ahead, above = style.forward @ powers, style.lift @ powers
    local = np.stack([ahead, np.zeros_like(s), above], -1) * bump(s)[:, None]
    return local @ base.T


def _rate(pitch_of: Callable[[Array], Array], a: Footstep, b: Footstep, t: float) -> float:
    h = 1e-4
    change = pitch_of(np.array([t + h])) - pitch_of(np.array([t - h]))
    return float(change[0] / (2 * h) * (b.t_touch - a.t_off))


def _lift_needed(
    path: tuple[Array, Array, Array], shoe: Shoe, s: Array, height: Callable[[Array], Array], near: Array,
    clearance: float,
) -> float:  # fmt: skip
    """Amplitude of the lift bump that keeps the sole `clearance` off the ground, `near` (2,) before and behind too."""
    p, R, toe = path
    points = [p + R @ np.array([x, 0.0, 0.0]) for x in (shoe.heel_back_x, 0.0, 0.5 * shoe.toe_hinge_x)]
    R_toe = R @ rot_y(-toe)
    hinge = p + R @ np.array([shoe.toe_hinge_x, 0.0, shoe.toe_hinge_z])
    for x in (0.0, 0.5, 1.0):
        arm = np.array([x * (shoe.toe_tip_x - shoe.toe_hinge_x), 0.0, -shoe.toe_hinge_z])
        points.append(hinge + R_toe @ arm)
    sole = np.stack(points, 1)  # (N, points, 3)
    ground = np.max([height(sole[..., :2] + d * near) for d in (-1.0, 0.0, 1.0)], axis=0)
    lift = bump(s)
    wanted = clearance * np.minimum(4.0 * lift, 1.0)[:, None]
    missing = (ground + wanted - sole[..., 2]).max(1)
    inside = lift > 0.08
    return float(max(0.0, np.max(missing[inside] / lift[inside])))


def _pitch(steps: Sequence[Footstep], t_end: float) -> Callable[[Array], Array]:
    """Pitch of the foot against the ground as a smooth function of time."""
    flat = -10.0
    knots: list[tuple[float, float]] = [(flat, 0.0)]
    flats: list[tuple[float, float]] = []
    for a, b in pairwise(steps):
        swing = b.t_touch - a.t_off
        leave, land = _departure(a, b.style), _arrival(b)
        step_time = swing / (1.0 - float(b.style.double_support))
        heel_off = leave.heel_off_before * step_time
        usual_fall = _USUAL_RISER_M if a.departure == "lower" else _USUAL_FALL_M
        fall, rise = max(a.fall - usual_fall, 0.0), max(b.rise - _USUAL_RISER_M, 0.0)
        climb = max(-a.fall - _USUAL_RISER_M, 0.0)
        steep = max(a.slope - _USUAL_SLOPE_RAD, -b.slope - _USUAL_SLOPE_RAD, 0.0)
        heel_off = min(heel_off * (1.0 + _HEEL_OFF_BY_FALL * fall + _HEEL_OFF_BY_SLOPE * steep), 0.9 * (a.t_off - flat))
        tiptoe = _TIPTOE_BY_RISE * rise
        if b.arrival == "flat":
            tiptoe += _TIPTOE_BY_SLOPE * max(b.slope - _USUAL_SLOPE_RAD, 0.0)
        off = leave.off + _PUSH_BY_RISE * climb
        flats.append((flat, a.t_off - heel_off))
        knots += [(a.t_off + (u - 1.0) * heel_off, share * off) for u, share in leave.rise]
        # uphill the sole comes down nearly parallel to the slope: the ankle has no more room to raise the toes
        uphill = min(max(b.slope, 0.0), -land.touch - _HEEL_FIRST_RAD) if land.touch < 0.0 else 0.0
        knots += [(a.t_off + u * swing, angle + tiptoe) for u, angle in leave.swing]
        knots += [(a.t_off + u * swing, angle + uphill + tiptoe) for u, angle in land.before]
        flat = b.t_touch + min((land.flat_after + tiptoe) * step_time, _FLAT_BY * (b.t_off - b.t_touch))
        touch = land.touch + uphill + tiptoe
        knots += [(b.t_touch + u * (flat - b.t_touch), share * touch) for u, share in ((0.0, 1.0), *land.settling)]
        knots.append((flat, 0.0))
    knots.append((t_end + 10.0, 0.0))
    flats.append((flat, t_end + 10.0))
    at = np.array(knots)
    grid = np.arange(-1.0, t_end + 1.0, _PITCH_GRID_S)
    raw = PchipInterpolator(at[:, 0], at[:, 1])(grid)
    smooth = gaussian_filter1d(raw, _PITCH_SMOOTHING_S / _PITCH_GRID_S, truncate=5.0)
    spline = make_interp_spline(grid, smooth, k=5)

    def pitch(t: Array) -> Array:
        lifted = np.ones_like(t)  # what smoothing leaves of a flat foot's pitch fades out
        for first, last in flats:
            lifted -= ease((t - first) / _SETTLING_S) * ease((last - t) / _SETTLING_S)
        return spline(t) * lifted

    return pitch
