"""Paths of the feet: stance rotates about pivots without slip, swing clears the ground; smooth to second order.

In stance the foot rotates about the heel's edge while its pitch is negative (toes up), and about the toe hinge, toes
flat, while it is positive. In swing a point that moves through the foot, from the toe hinge (the pivot that it leaves)
to the pivot that it lands on, follows smooth paths. Both pivots rest at their ends, so that position, velocity and
acceleration match there for any pitch of the foot. Over an obstacle the foot takes the smoothest rise or fall.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import nnls

from stridetwin.sim.gait.foot_pitch import pitch_of, step_time
from stridetwin.sim.gait.footsteps import Footstep
from stridetwin.sim.gait.style import Style, leg_length
from stridetwin.sim.kinematics.smooth import bump, ease, quintic, soft_ease
from stridetwin.sim.wearer.dimensions import Shoe, Wearer
from stridetwin.streams.samples import Array
from stridetwin.streams.so3 import rot_y, slerp

_REST = 3  # samples at each end that are at rest: position, velocity and acceleration are given there
_AT_REST: Any = [(1, 0.0), (2, 0.0)]  # SciPy's stubs do not allow pairs


def smoothest_above(rise: float, least: Array) -> tuple[BSpline, float]:
    """Height that changes by `rise` from rest to rest with the least jerk and nowhere falls below `least`.

    Without a limit it is the minimum-jerk step (Flash & Hogan 1985); where that would be too low, it touches the limit
    with a bounded acceleration. Solved as a bounded least-squares problem in the samples of the height.

    Args:
        rise: End minus start, m.
        least: (N,) m above the start, at N uniform instants from the start to the end; -inf for no limit.

    Returns:
        Height over the start, m, as a spline on [0, 1], and the mean square of its third derivative by that parameter.
    """
    n = len(least)
    inner = slice(_REST, n - _REST)
    third, Q, free = _least_jerk(n)
    z = np.zeros(n)
    z[-_REST:] = rise
    z[inner] = free @ (Q.T @ (-third @ z))
    limited = np.isfinite(least[inner])
    short = (least - z)[inner][limited]
    if (short > 0.0).any():
        # the least change of the residual that lifts the height by its shortfall (Lawson & Hanson 1974, ch. 23)
        goal = np.append(np.zeros(free.shape[1]), 1.0)
        system = np.vstack([free[limited].T, short])
        left = system @ nnls(system, goal)[0] - goal
        z[inner] -= free @ (left[:-1] / left[-1])
    spline = make_interp_spline(np.linspace(0.0, 1.0, n), z, k=5, bc_type=(_AT_REST, _AT_REST))
    return spline, float(np.mean((third @ z) ** 2)) * (n - 1) ** 6


@cache
def _least_jerk(n: int) -> tuple[Array, Array, Array]:
    """Third difference of n samples, and the Q and inverse R of the samples that are not at rest."""
    third = np.diff(np.eye(n), 3, axis=0)
    Q, R = np.linalg.qr(third[:, _REST : n - _REST])
    return third, Q, np.linalg.inv(R)


# Where the heel rises and how a swing clears an edge; chosen by hand for the ankle angles in `docs/design.md`.
#
# Uphill the ankle bends by the slope as well; on stairs the bent knee slackens the calf.
_MAX_DORSIFLEXION_RAD = np.radians(22.0)  # on the level
_DORSIFLEXION_BY_SLOPE = 1.3  # additional rad per rad of slope uphill
_DORSIFLEXION_ON_STAIRS_RAD = np.radians(14.0)  # additional, on stairs
_RISE_BEFORE = 0.55  # share of a step before toe-off, when the load moves to the ball
_RISE_GAIN = 1.25  # rad of pitch per rad of excess: a rising heel bends the knee and tilts the shank farther
_RISE_SMOOTHING_S = 0.03  # SD of the Gaussian filter
_RISE_FADE_S = 0.12  # in which the additional pitch begins, and in which it ends before toe-off
_PIVOT_FROM = 0.30  # share of swing from which the moving point goes to the pivot of the landing
_PIVOT_LASTS = 0.55  # share of swing that this takes, once the foot is level
_MAX_BUMP_M = 0.4  # higher, an edge lies too near a footprint for a bump, which rises slowly
_NEAR_EDGE_M = 0.004  # margin before and behind a riser
_NEAR_EDGE_DOWN_M = 0.012  # likewise, going down


@dataclass(frozen=True, kw_only=True, eq=False)
class FootPath:
    """Poses of one foot on a time grid.

    Attributes:
        p_foot_in_world: (N, 3) m.
        R_world_foot: (N, 3, 3).
        toe_extension: (N,) rad.
        pitch: (N,) rad, foot relative to the ground under it, toes down positive.
        s: (N,) m along the way.
        heading: (N,) rad, direction of the way, unwrapped.
    """

    p_foot_in_world: Array
    R_world_foot: Array
    toe_extension: Array
    pitch: Array
    s: Array
    heading: Array


# Shares of swing in which the foot moves forward; over a riser, the one with the least total jerk.
_DIRECT = (0.0, 1.0)
_FORWARD = {"climb": ((0.05, 1.0), (0.12, 1.0), (0.20, 1.0)), "lower": ((0.0, 0.84), (0.0, 0.92))}
_OVER = (*_FORWARD["climb"], *_FORWARD["lower"])
_FINE = np.linspace(0.0, 1.0, 61)  # shares of swing at which a swing is planned
_FINE_EASE, _FINE_BUMP = soft_ease(_FINE), bump(_FINE)


def foot_path(
    steps: Sequence[Footstep], size: Wearer, t: Array, height: Callable[[Array], Array]
) -> FootPath:  # fmt: skip
    """Path of one foot at (N,) increasing s, from its footsteps in order and the ground's height at (..., 2) points."""
    pitch = pitch_of(steps, t[-1])
    theta = pitch(t)
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
            p[air], R[air], toe[air] = _swing(step, to, size, t[air], theta[air], pitch, height)
            share = ease((t[air] - step.t_off) / (to.t_touch - step.t_off))
            s[air] = step.s + share * (to.s - step.s)
            heading[air] = step.heading + share * (to.heading - step.heading)
    return FootPath(p_foot_in_world=p, R_world_foot=R, toe_extension=toe, pitch=theta, s=s, heading=heading)


def with_heel_rise(path: FootPath, steps: Sequence[Footstep], shoe: Shoe, t: Array, dorsiflexion: Array) -> FootPath:
    """Path on which the heel leaves the ground where the ankle cannot bend farther.

    The ankle angle shows how far the foot is behind the body, how steep the ground is and how deep the body sinks.
    Where it would bend farther than people's do, from the middle of single support on, the foot rotates about the toes
    instead, by the excess.

    Args:
        path: Path of the foot at (N,) s.
        steps: Its footsteps, in order.
        shoe: Its sole.
        t: (N,) uniform s.
        dorsiflexion: (N,) rad, of the ankle on this path.
    """
    p, R = path.p_foot_in_world.copy(), path.R_world_foot.copy()
    toe, theta = path.toe_extension.copy(), path.pitch.copy()
    for step, after in pairwise(steps):
        on = (t >= step.t_touch) & (t <= step.t_off)
        late = (t[on] - step.t_off) / _RISE_FADE_S
        # at toe-off the foot is back on its path, so that the swing does not change
        inside = ease(late + _RISE_BEFORE * step_time(step, after) / _RISE_FADE_S + 1.0) * ease(-late)
        limit = _MAX_DORSIFLEXION_RAD + _DORSIFLEXION_BY_SLOPE * max(step.slope, 0.0)
        limit += _DORSIFLEXION_ON_STAIRS_RAD if step.arrival != "heel" else 0.0
        beyond = np.maximum(dorsiflexion[on] - limit, 0.0)
        smooth = gaussian_filter1d(beyond, _RISE_SMOOTHING_S / (t[1] - t[0]), mode="nearest")
        theta[on] += inside * _RISE_GAIN * smooth
        p[on], R[on], toe[on] = _stance(step, shoe, theta[on])
    return replace(path, p_foot_in_world=p, R_world_foot=R, toe_extension=toe, pitch=theta)


def _stance(step: Footstep, shoe: Shoe, theta: Array) -> tuple[Array, Array, Array]:
    base, tilt = step.R_world_sole, rot_y(theta)
    pivot = np.where(theta[:, None] < 0.0, *_pivots(shoe))
    local = pivot - np.einsum("nij,nj->ni", tilt, pivot)
    return step.p_foot_in_world + local @ base.T, base @ tilt, np.maximum(theta, 0.0)


def _pivots(shoe: Shoe) -> tuple[Array, Array]:
    """(3,) m in the foot's frame, the heel's edge, and the toe hinge."""
    return np.array([shoe.heel_back_x, 0.0, 0.0]), np.array([shoe.toe_hinge_x, 0.0, shoe.toe_hinge_z])


def _swing(
    a: Footstep, b: Footstep, size: Wearer, t: Array, theta: Array, pitch: Callable[[Array], Array],
    height: Callable[[Array], Array],
) -> tuple[Array, Array, Array]:  # fmt: skip
    if len(t) == 0:
        return np.empty((0, 3)), np.empty((0, 3, 3)), np.empty(0)
    s = (t - a.t_off) / (b.t_touch - a.t_off)
    toes = _toe_ends(a, b, pitch)
    R, toe = _swing_attitude(a, b, s, theta), quintic(s, *toes)
    fine_R = _swing_attitude(a, b, _FINE, pitch(a.t_off + _FINE * (b.t_touch - a.t_off)))
    sole = _sole(size.shoe, fine_R, quintic(_FINE, *toes))
    near = (_NEAR_EDGE_DOWN_M if a.departure == "lower" else _NEAR_EDGE_M) * np.array(
        [np.cos(b.heading), np.sin(b.heading)]
    )

    def missing(forward: tuple[float, float]) -> Array:
        return _missing(_swing_without_lift(a, b, size, _FINE, fine_R, forward), sole, height, near, b.clearance_m)

    forward, lift_m = _DIRECT, _bump_needed(missing(_DIRECT)) if a.departure == "push" else np.inf
    if lift_m <= _MAX_BUMP_M:
        lift = bump(s) * lift_m
    else:
        rise = float(b.p_foot_in_world[2] - a.p_foot_in_world[2])
        far = float(np.linalg.norm(b.p_foot_in_world[:2] - a.p_foot_in_world[:2]))
        best = np.inf
        for window in _FORWARD.get(a.departure, _OVER):
            over, jerk = smoothest_above(rise, missing(window) + rise * _FINE_EASE)
            jerk += _jerk(far, window)
            if jerk < best:
                best, forward, lift = jerk, window, over(s) - rise * soft_ease(s)
    p = _swing_without_lift(a, b, size, s, R, forward)
    p[:, 2] += lift
    return p, R, toe


def _toe_ends(a: Footstep, b: Footstep, pitch: Callable[[Array], Array]) -> tuple[float, float, float, float]:
    """Toe extension and its rate by the share of swing at toe-off, then at touch-down.

    The toes are flat on the ground at toe-off, raised in the air, and at the pitch of the landing at touch-down.
    """
    h = 1e-4
    ends = np.array([a.t_off, b.t_touch])
    (toe_a, toe_b), after, before = pitch(np.concatenate([ends, ends + h, ends - h])).reshape(3, 2)
    rate_a, rate_b = (after - before) / (2 * h) * (b.t_touch - a.t_off)
    return float(toe_a), float(rate_a), max(float(toe_b), 0.0), float(rate_b) if b.arrival != "heel" else 0.0


def _swing_attitude(a: Footstep, b: Footstep, s: Array, theta: Array) -> Array:
    return slerp(a.R_world_sole, b.R_world_sole, soft_ease(s)) @ rot_y(theta)


def _swing_without_lift(
    a: Footstep, b: Footstep, size: Wearer, s: Array, R: Array, forward: tuple[float, float]
) -> Array:  # fmt: skip
    ahead, upward = soft_ease((s - forward[0]) / (forward[1] - forward[0])), soft_ease(s)
    heel, hinge = _pivots(size.shoe)
    landing = heel if b.arrival == "heel" else hinge
    within = hinge + soft_ease((s - _PIVOT_FROM) / _PIVOT_LASTS)[:, None] * (landing - hinge)
    start: Array = a.p_foot_in_world + a.R_world_sole @ hinge
    end = b.p_foot_in_world + b.R_world_sole @ landing
    point = start + np.stack([ahead, ahead, upward], -1) * (end - start)
    # in a turn the foot moves on an arc, so that it keeps its distance when it passes the other one
    outward = np.array([end[1] - start[1], start[0] - end[0], 0.0]) * (b.heading - a.heading) / 8.0
    point = point + (4.0 * ahead * (1.0 - ahead))[:, None] * outward
    if a.departure == "push" and b.arrival == "heel":
        point = point + _swing_shape(b.style, s, b.R_world_sole) * leg_length(size)
    return point - np.einsum("nij,nj->ni", R, within)


def _swing_shape(style: Style, s: Array, base: Array) -> Array:
    """(N, 3) offset of a swinging foot from its smooth path, in leg lengths; at rest at both ends."""
    powers = np.vander(2 * s - 1, len(style.forward), increasing=True).T
    ahead, above = style.forward @ powers, style.lift @ powers
    local = np.stack([ahead, np.zeros_like(s), above], -1) * bump(s)[:, None]
    return local @ base.T


def _sole(shoe: Shoe, R: Array, toe: Array) -> tuple[Array, Array]:
    """(N, points, 3) of points of the sole from the foot to its part, and within that part, in world axes."""
    rear = [np.array([x, 0.0, 0.0]) for x in (shoe.heel_back_x, 0.0, 0.5 * shoe.toe_hinge_x)]
    _, hinge = _pivots(shoe)
    tip = [np.array([x * (shoe.toe_tip_x - shoe.toe_hinge_x), 0.0, -shoe.toe_hinge_z]) for x in (0.0, 0.5, 1.0)]
    R_toe = R @ rot_y(-toe)
    none = np.zeros((len(R), 3))
    to_part = np.stack([*(R @ x for x in rear), *[R @ hinge] * len(tip)], 1)
    return to_part, np.stack([*[none] * len(rear), *(R_toe @ x for x in tip)], 1)


def _missing(
    p: Array, sole: tuple[Array, Array], height: Callable[[Array], Array], near: Array, clearance: float
) -> Array:
    """(N,) m, how much higher the foot at (N, 3) must be at `_FINE` to keep `clearance` above the ground.

    Ground `near` (2,) m before and behind counts too. At both ends, where the foot rests, there is no limit: -inf.
    """
    points = p[:, None] + sole[0] + sole[1]  # (N, points, 3)
    ground = np.max(height(points[..., :2] + np.multiply.outer((-1.0, 0.0, 1.0), near)[:, None, None]), axis=0)
    wanted = clearance * np.minimum(4.0 * _FINE_BUMP, 1.0)[:, None]
    return np.where(_FINE_BUMP > 0.03, (ground + wanted - points[..., 2]).max(1), -np.inf)


def _bump_needed(missing: Array) -> float:
    """Amplitude of the bump that lifts the foot by the missing height at `_FINE`."""
    asked = np.isfinite(missing)
    return float(max(0.0, np.max(missing[asked] / _FINE_BUMP[asked])))


def _jerk(far: float, window: tuple[float, float]) -> float:
    """Mean square third derivative, by the share of swing, of a smooth path of `far` m within a window of the swing."""
    return 720.0 * far**2 / (window[1] - window[0]) ** 5
