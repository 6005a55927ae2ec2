"""Paths of the feet: stance pivots without slip, swing that clears the ground, smooth to the second derivative.

In stance the foot turns about the heel's edge while its pitch is negative (toes up) and about the toe hinge, toes flat,
while it is positive. In swing a point that wanders through the foot from the toe hinge (the pivot it leaves) to the
pivot it lands on moves on minimum-jerk paths; both pivots rest at their ends, so position, velocity and acceleration
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
from stridetwin.sim.gait.footsteps import DOUBLE_SUPPORT, Footstep
from stridetwin.sim.gait.smooth import bump, ease, quintic
from stridetwin.sim.rotation import between, rot_y
from stridetwin.streams.samples import Array

CLEARANCE_M = 0.018
_NEAR_EDGE_M = 0.004  # a riser counts this much before and behind it
_HEEL_FIRST_RAD = 0.03  # least toe-up pitch of a landing on the heel
# Higher risers and steeper ramps than these bend the knee and lean the shank farther: the heel stays up for longer, by
# so much a metre or a radian beyond.
_USUAL_RISER_M, _USUAL_FALL_M, _USUAL_SLOPE_RAD = 0.155, 0.095, 0.16  # a fall of a step on a ramp
_HEEL_OFF_BY_FALL, _HEEL_OFF_BY_SLOPE, _PUSH_BY_RISE = 12.0, 2.5, 1.5
_TIPTOE_BY_RISE, _TIPTOE_BY_SLOPE = 2.4, 1.8
_PITCH_SMOOTHING_S = 0.012
_PITCH_GRID_S = 0.004


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
    """

    before: tuple[tuple[float, float], ...]
    touch: float
    flat_after: float


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


# Level: fitted to the norms of reference/gait_norms_level.csv. Over a riser the foot first rises and then moves
# forward, or first moves out and then sinks, to land on the forefoot.
_RISE = ((0.0, 0.0), (0.30, 0.05), (0.55, 0.20), (0.80, 0.55), (1.0, 1.0))
ARRIVALS = {
    "heel": Arrival(before=((0.76, -0.15), (0.90, -0.40)), touch=-0.215, flat_after=0.166),
    "flat": Arrival(before=((0.72, 0.30), (0.88, 0.13)), touch=0.06, flat_after=0.14),
    "forefoot": Arrival(before=((0.76, 0.28), (0.90, 0.40)), touch=0.42, flat_after=0.34),
}
DEPARTURES = {
    "push": Departure(heel_off_before=0.60, rise=_RISE, off=0.73, swing=((0.16, 1.00), (0.30, 1.06), (0.45, 0.65))),
    "climb": Departure(heel_off_before=0.42, rise=_RISE, off=0.52, swing=((0.16, 0.68), (0.34, 0.66), (0.52, 0.52)),
                       forward=(0.20, 1.0), upward=(0.0, 0.62)),
    "lower": Departure(heel_off_before=0.50, rise=_RISE, off=0.70, swing=((0.16, 0.85), (0.30, 0.68)),
                       forward=(0.0, 0.74), upward=(0.36, 1.0)),
}  # fmt: skip


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
            p[air], R[air], toe[air] = _swing(step, to, size.shoe, t[air], theta[air], pitch_of, height)
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
    a: Footstep, b: Footstep, shoe: Shoe, t: Array, theta: Array, pitch_of: Callable[[Array], Array],
    height: Callable[[Array], Array],
) -> tuple[Array, Array, Array]:  # fmt: skip
    if len(t) == 0:
        return np.empty((0, 3)), np.empty((0, 3, 3)), np.empty(0)
    s = (t - a.t_off) / (b.t_touch - a.t_off)
    flat = _swing_without_lift(a, b, shoe, s, theta, pitch_of)
    fine = np.linspace(0.0, 1.0, 81)[1:-1]
    fine_theta = pitch_of(a.t_off + fine * (b.t_touch - a.t_off))
    ahead = np.array([np.cos(b.heading), np.sin(b.heading)])
    lift = _lift_needed(_swing_without_lift(a, b, shoe, fine, fine_theta, pitch_of), shoe, fine, height, ahead)
    p, R, toe = flat
    p = p.copy()
    p[:, 2] += lift * bump(s)
    return p, R, toe


def _swing_without_lift(
    a: Footstep, b: Footstep, shoe: Shoe, s: Array, theta: Array, pitch_of: Callable[[Array], Array]
) -> tuple[Array, Array, Array]:
    manner = DEPARTURES[a.departure]
    forward, upward = (ease((s - first) / (last - first)) for first, last in (manner.forward, manner.upward))
    hinge = np.array([shoe.toe_hinge_x, 0.0, shoe.toe_hinge_z])
    landing = np.array([shoe.heel_back_x, 0.0, 0.0]) if b.arrival == "heel" else hinge
    within = hinge + ease((s - 0.30) / 0.55)[:, None] * (landing - hinge)  # once the foot has come level
    start: Array = a.p_foot_in_world + a.R_world_sole @ hinge
    end = b.p_foot_in_world + b.R_world_sole @ landing
    share = np.stack([forward, forward, upward], -1)
    point = start + share * (end - start)
    # in a turn the foot goes round, so that it passes the other one at its distance
    outward = np.array([end[1] - start[1], start[0] - end[0], 0.0]) * (b.heading - a.heading) / 8.0
    point += (4.0 * forward * (1.0 - forward))[:, None] * outward
    R = between(a.R_world_sole, b.R_world_sole, ease(s)) @ rot_y(theta)
    # the toes leave flat on the ground, stay raised in the air and meet the ground as the landing needs
    toe_a, toe_b = pitch_of(np.array([a.t_off]))[0], max(pitch_of(np.array([b.t_touch]))[0], 0.0)
    toe = quintic(s, toe_a, _rate(pitch_of, a, b, a.t_off), toe_b,
                   _rate(pitch_of, a, b, b.t_touch) if b.arrival != "heel" else 0.0)  # fmt: skip
    return point - np.einsum("nij,nj->ni", R, within), R, toe


def _rate(pitch_of: Callable[[Array], Array], a: Footstep, b: Footstep, t: float) -> float:
    h = 1e-4
    change = pitch_of(np.array([t + h])) - pitch_of(np.array([t - h]))
    return float(change[0] / (2 * h) * (b.t_touch - a.t_off))


def _lift_needed(
    path: tuple[Array, Array, Array], shoe: Shoe, s: Array, height: Callable[[Array], Array], ahead: Array
) -> float:
    """Amplitude of the lift bump that keeps every point of the sole clear of the ground, m; `ahead` is the way's."""
    p, R, toe = path
    points = [p + R @ np.array([x, 0.0, 0.0]) for x in (shoe.heel_back_x, 0.0, 0.5 * shoe.toe_hinge_x)]
    R_toe = R @ rot_y(-toe)
    hinge = p + R @ np.array([shoe.toe_hinge_x, 0.0, shoe.toe_hinge_z])
    for x in (0.0, 0.5, 1.0):
        arm = np.array([x * (shoe.toe_tip_x - shoe.toe_hinge_x), 0.0, -shoe.toe_hinge_z])
        points.append(hinge + R_toe @ arm)
    sole = np.stack(points, 1)  # (N, points, 3)
    ground = np.max([height(sole[..., :2] + d * ahead) for d in (-_NEAR_EDGE_M, 0.0, _NEAR_EDGE_M)], axis=0)
    lift = bump(s)
    wanted = CLEARANCE_M * np.minimum(4.0 * lift, 1.0)[:, None]
    missing = (ground + wanted - sole[..., 2]).max(1)
    inside = lift > 0.08
    return float(max(0.0, np.max(missing[inside] / lift[inside])))


def _pitch(steps: Sequence[Footstep], t_end: float) -> Callable[[Array], Array]:
    """Pitch of the foot against the ground as a smooth function of time."""
    flat = -10.0
    knots: list[tuple[float, float]] = [(flat, 0.0)]
    for a, b in pairwise(steps):
        swing = b.t_touch - a.t_off
        leave, land = DEPARTURES[a.departure], ARRIVALS[b.arrival]
        step_time = swing / (1.0 - DOUBLE_SUPPORT)
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
        knots += [(a.t_off + (u - 1.0) * heel_off, share * off) for u, share in leave.rise]
        # uphill the sole comes down nearly parallel to the slope: the ankle has no more room to raise the toes
        uphill = min(max(b.slope, 0.0), -land.touch - _HEEL_FIRST_RAD) if land.touch < 0.0 else 0.0
        knots += [(a.t_off + u * swing, angle + tiptoe) for u, angle in leave.swing]
        knots += [(a.t_off + u * swing, angle + uphill + tiptoe) for u, angle in land.before]
        flat = b.t_touch + (land.flat_after + tiptoe) * step_time
        knots += [(b.t_touch, land.touch + uphill + tiptoe), (flat, 0.0)]
    knots.append((t_end + 10.0, 0.0))
    at = np.array(knots)
    grid = np.arange(-1.0, t_end + 1.0, _PITCH_GRID_S)
    raw = PchipInterpolator(at[:, 0], at[:, 1])(grid)
    smooth = gaussian_filter1d(raw, _PITCH_SMOOTHING_S / _PITCH_GRID_S, truncate=5.0)
    return make_interp_spline(grid, smooth, k=5)
