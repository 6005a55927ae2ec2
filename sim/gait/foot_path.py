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

from stridetwin.sim.gait.foot_pitch import FLAT_BY, LEAST_EDGE_M, plan_pitch, step_time
from stridetwin.sim.gait.footsteps import RUN_LANDING_S, Footstep
from stridetwin.sim.gait.style import Style, leg_length
from stridetwin.sim.gait.twist import turn_on_ball
from stridetwin.sim.kinematics.smooth import bump, ease, quintic, soft_ease
from stridetwin.sim.wearer.dimensions import Shoe, Wearer
from stridetwin.streams.algebra.arrays import rot_y, rot_z, slerp
from stridetwin.streams.samples import Array

_REST = 3  # samples at each end that are at rest: position, velocity and acceleration are given there
# (order, value) of the derivatives at an end of a spline: the first and the second are 0; SciPy's stubs forbid pairs
_AT_REST: Any = [(1, 0.0), (2, 0.0)]


def min_jerk_height(rise: float, lower_bound: Array) -> tuple[BSpline, float]:
    """Height that changes by `rise` from rest to rest with the least jerk and nowhere falls below `lower_bound`.

    Without a limit it is the minimum-jerk step (Flash & Hogan 1985); where that would be too low, it touches the limit
    with a bounded acceleration. Solved as a bounded least-squares problem in the samples of the height.

    Args:
        rise: End minus start, m.
        lower_bound: (N,) m above the start, at N uniform instants from the start to the end; -inf for no limit.

    Returns:
        Height over the start, m, as a spline on [0, 1], and the mean square of its third derivative by that parameter.
    """
    n = len(lower_bound)
    inner = slice(_REST, n - _REST)  # samples that are not at rest
    third, Q, R_inverse = _min_jerk_system(n)  # `third` is the third difference D
    # without limit: the inner samples that minimise |D z|², for given ends at rest
    z = np.zeros(n)
    z[-_REST:] = rise
    z[inner] = R_inverse @ (Q.T @ (-third @ z))
    has_limit = np.isfinite(lower_bound[inner])
    shortfall = (lower_bound - z)[inner][has_limit]
    if (shortfall > 0.0).any():
        # the change of the third differences with the least sum of squares that lifts the height by its shortfall. Its
        # direction is the residual of a non-negative least-squares problem, whose last entry is the scale (Lawson &
        # Hanson 1974, ch. 23)
        goal = np.append(np.zeros(R_inverse.shape[1]), 1.0)
        system = np.vstack([R_inverse[has_limit].T, shortfall])
        residual = system @ nnls(system, goal)[0] - goal
        z[inner] -= R_inverse @ (residual[:-1] / residual[-1])
    spline = make_interp_spline(np.linspace(0.0, 1.0, n), z, k=5, bc_type=(_AT_REST, _AT_REST))
    # a third difference over the cube of the step 1 / (n − 1) is the third derivative
    return spline, float(np.mean((third @ z) ** 2)) * (n - 1) ** 6


@cache
def _min_jerk_system(n: int) -> tuple[Array, Array, Array]:
    """Linear system of the path of n samples with the least squares of third differences.

    Returns:
        (n − 3, n) third difference D; Q and R⁻¹ of the QR factorisation of its inner columns, which are those of the
        samples that are not at rest.
    """
    third = np.diff(np.eye(n), 3, axis=0)
    Q, R = np.linalg.qr(third[:, _REST : n - _REST])
    return third, Q, np.linalg.inv(R)


STOPPING_S = 0.022
"""Time from touch-down in which the ground stops a heel that lands at speed. People's heels slide on by 2 to 13 mm
(McGorry, Chang & DiDomenico 2008)."""

# Where the heel rises and how a swing clears an edge; chosen by hand for the ankle angles in `docs/design.md`.
#
# Uphill the ankle bends by the slope as well; on stairs the bent knee slackens the calf.
_MAX_DORSIFLEXION_RAD = np.radians(22.0)  # on the level
_DORSIFLEXION_BY_SLOPE = 1.3  # additional rad per rad of slope uphill
_DORSIFLEXION_ON_STAIRS_RAD = np.radians(14.0)  # additional, on stairs
# Toes bend by 25-30° in push-off, then the shoe rolls over its tip and the hinge, at the ball of the foot, leaves the
# ground before the tip does.
_TOES_BEND_RAD = 0.25  # up to which the toes stay flat while the foot pitches
_TOES_YIELD_RAD = 0.45  # more pitch, in which they cease to bend, after half of it
_DORSIFLEXION_IN_RUN_RAD = np.radians(10.0)  # additional, of a runner, who bends the knee under the load
_RISE_BEFORE = 0.55  # share of a step before toe-off, when the load moves to the ball
_RISE_GAIN = 1.25  # rad of pitch per rad of excess: a rising heel bends the knee and tilts the shank farther
_RISE_SMOOTHING_S = 0.03  # SD of the Gaussian filter
_RISE_FADE_S = 0.12  # in which the additional pitch begins, and in which it ends before toe-off
_PIVOT_FROM = 0.30  # share of swing from which the moving point goes to the pivot of the landing
_PIVOT_LASTS = 0.55  # share of swing that this takes, once the foot is level
_LANDING_SPEED = 0.10  # at which the heel reaches the ground, relative to the mean speed of the swing
_LANDING_BRAKE = 2.8  # deceleration before that, in units of that speed per duration of the swing
_RUN_SPEED, _RUN_BRAKE = 0.27, 6.5  # likewise, of a run
_RUN_FAST_BY = 0.50  # share of swing by which a runner's foot is fast
_RUN_FINE = 201  # instants at which that speed is integrated
_RUN_DROP_MPS = 0.8  # at which the foot of a runner comes down
_SLOPE_WITHOUT_SPEED_RAD = 0.12  # downhill slope from which the heel is only set down
_LAG_OVER = 0.85  # share of swing before touch-down in which the foot lags
_MAX_BUMP_M = 0.4  # higher, an edge lies too near a footprint for a bump, which rises slowly
_WIDER_ARC = 2.0  # path of a foot round one that turns on its ball, relative to that of other turns
_NEAR_EDGE_M = 0.004  # margin before and behind a riser
_NEAR_EDGE_DOWN_M = 0.012  # likewise, going down


@dataclass(frozen=True, kw_only=True, eq=False)
class FootPath:
    """Poses of one foot on a time grid.

    Attributes:
        p_foot_in_world: (N, 3) m, origin of the foot's frame.
        R_world_foot: (N, 3, 3) rotation, foot to world.
        toe_extension: (N,) rad, angle of the toe hinge; 0 for straight toes.
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
_DIRECT = (0.0, 1.0)  # all of swing
# windows to choose from, by the departure of the foot; any of them where a foot pushes off
_FORWARD = {"climb": ((0.05, 1.0), (0.12, 1.0), (0.20, 1.0)), "lower": ((0.0, 0.84), (0.0, 0.92))}
_OVER = (*_FORWARD["climb"], *_FORWARD["lower"])
_FINE = np.linspace(0.0, 1.0, 61)  # shares of swing at which a swing is planned
_FINE_EASE, _FINE_BUMP = soft_ease(_FINE), bump(_FINE)  # a unit step and a unit bump at these shares


def foot_path(steps: Sequence[Footstep], size: Wearer, t: Array, height: Callable[[Array], Array]) -> FootPath:
    """Path of one foot from its footsteps: stance on its pivots, swing over the ground.

    Args:
        steps: Footsteps of the foot in order of time.
        size: Wearer, for the shoe and the length of the leg.
        t: (N,) increasing s.
        height: Height of the ground, m, at (..., 2) points of the world.
    """
    pitch = plan_pitch(steps, t[-1])  # a function of time, because swings are planned at other times than `t`
    theta = pitch(t)
    n = len(t)
    p, R = np.empty((n, 3)), np.empty((n, 3, 3))
    toe, s, heading = np.empty(n), np.empty(n), np.empty(n)
    for i, step in enumerate(steps):
        on = rows_within(t, step.t_touch, step.t_off)
        p[on], R[on], toe[on] = _stance_poses(step, size.shoe, theta[on], t[on])
        if i > 0:
            braking = rows_within(t, step.t_touch, step.t_touch + STOPPING_S)  # no way is left later
            p[braking] -= landing_lag(steps[i - 1], step, size.shoe, t[braking])
        s[on], heading[on] = step.s, step.heading
        if step.twist is not None:
            heading[on] += step.twist.angle(t[on], step.t_touch, step.t_off)
        if i + 1 < len(steps):  # no swing follows the last footstep
            step, to = _as_it_leaves(step, size.shoe), _as_it_lands(steps[i + 1], size.shoe)
            air = slice(on.stop, max(on.stop, int(np.searchsorted(t, to.t_touch))))
            p[air], R[air], toe[air] = _swing_poses(step, to, size, t[air], theta[air], pitch, height)
            # arc length and heading of a foot in the air go smoothly from footprint to footprint
            share = ease((t[air] - step.t_off) / (to.t_touch - step.t_off))
            s[air] = step.s + share * (to.s - step.s)
            heading[air] = step.heading + share * (to.heading - step.heading)
    return FootPath(p_foot_in_world=p, R_world_foot=R, toe_extension=toe, pitch=theta, s=s, heading=heading)


def rows_within(t: Array, begin: float, end: float) -> slice:
    """Rows of (N,) increasing s from `begin` to `end`, both included."""
    first = int(np.searchsorted(t, begin))
    return slice(first, max(first, int(np.searchsorted(t, end, side="right"))))


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
        on = rows_within(t, step.t_touch, step.t_off)
        limit = _MAX_DORSIFLEXION_RAD + _DORSIFLEXION_BY_SLOPE * max(step.slope, 0.0)
        limit += _DORSIFLEXION_ON_STAIRS_RAD if step.arrival != "heel" else 0.0
        limit += _DORSIFLEXION_IN_RUN_RAD if after.is_run else 0.0
        excess = np.maximum(dorsiflexion[on] - limit, 0.0)
        if not (excess > 0.0).any():
            continue
        smooth = gaussian_filter1d(excess, _RISE_SMOOTHING_S / (t[1] - t[0]), mode="nearest")
        # time after toe-off in units of the fade; negative in stance. The additional pitch begins before toe-off and is
        # over by toe-off: then the foot is back on its path, so that the swing does not change
        late = (t[on] - step.t_off) / _RISE_FADE_S
        fade = ease(late + _RISE_BEFORE * step_time(step, after) / _RISE_FADE_S + 1.0) * ease(-late)
        rolling, _, _ = _stance_poses(step, shoe, theta[on], t[on])
        theta[on] += fade * _RISE_GAIN * smooth
        raised, R[on], toe[on] = _stance_poses(step, shoe, theta[on], t[on])
        p[on] += raised - rolling
    return replace(path, p_foot_in_world=p, R_world_foot=R, toe_extension=toe, pitch=theta)


def _as_it_leaves(step: Footstep, shoe: Shoe) -> Footstep:
    """The footstep with the direction that the foot has when it leaves."""
    return step if step.twist is None else _turn_on_ball(step, shoe, step.twist.out_rad)


def _as_it_lands(step: Footstep, shoe: Shoe) -> Footstep:
    """The footstep with the direction that the foot has when it lands."""
    return step if step.twist is None else _turn_on_ball(step, shoe, -step.twist.in_rad)


def _turn_on_ball(step: Footstep, shoe: Shoe, angle: float) -> Footstep:
    """The footstep of a foot that has turned on its ball by an angle, rad."""
    p_foot, R_world_sole = turn_on_ball(step.p_foot_in_world, step.R_world_sole, shoe, angle)
    return replace(step, p_foot_in_world=p_foot, R_world_sole=R_world_sole, heading=step.heading + angle)


def _stance_poses(step: Footstep, shoe: Shoe, theta: Array, t: Array) -> tuple[Array, Array, Array]:
    """Poses of a foot on the ground, from its pitches θ.

    The foot rotates about the heel's edge while θ < 0. While θ ≥ 0 it rotates about the toe hinge, with flat toes,
    until they bend no farther; then the toes roll over their tip, too, by φ (`toe_roll`). Its position is p = p_sole +
    R_sole (c − R_y(θ) c + d − R_y(φ) d) with the pivot c and the way d from the hinge to the tip.

    Args:
        step: Its footprint.
        shoe: Its sole.
        theta: (N,) rad, pitch θ against the ground, toes down positive.
        t: (N,) s; only a foot that turns on its ball depends on it.

    Returns:
        (N, 3) m, positions; (N, 3, 3) rotations, foot to world; (N,) rad, toe extension.
    """
    base, tilt = step.R_world_sole, rot_y(theta)
    heel_edge, toe_hinge = _pivots(shoe)
    pivot = np.where(theta[:, None] < 0.0, heel_edge, toe_hinge)  # (N, 3) m, c in the foot's frame
    shift = pivot - np.einsum("nij,nj->ni", tilt, pivot)  # (N, 3) m, c − R_y(θ) c, in the axes of the footprint
    roll = np.zeros(len(t))
    if step.rolls_off:
        roll = toe_roll(step, theta, t)
        tip = _tip_from_hinge(shoe)
        shift = shift + tip - rot_y(roll) @ tip
    if step.twist is not None:
        spin = rot_z(step.twist.angle(t, step.t_touch, step.t_off))
        turned = base @ spin  # (N, 3, 3), about the toe hinge
        p_turned = step.p_foot_in_world + base @ toe_hinge - turned @ toe_hinge
        return p_turned + np.einsum("nij,nj->ni", turned, shift), turned @ tilt, np.maximum(theta, 0.0)
    return step.p_foot_in_world + shift @ base.T, base @ tilt, np.maximum(theta, 0.0) - roll


def toe_roll(step: Footstep, theta: Array, t: Array) -> Array:
    """(N,) rad, by which the toes have rolled over their tip before toe-off, at (N,) pitches of the foot and (N,) s.

    The angle between foot and toes follows the pitch up to `_TOES_BEND_RAD` and then softly reaches its limit, half of
    `_TOES_YIELD_RAD` later; the toes lift by the rest: the integral of a minimum-jerk step (`ease`).
    """
    if not step.rolls_off:
        return np.zeros_like(theta)
    x = (theta - _TOES_BEND_RAD - step.toes_bend_rad) / _TOES_YIELD_RAD
    inner = np.clip(x, 0.0, 1.0)
    roll = _TOES_YIELD_RAD * (inner**4 * (2.5 + inner * (inner - 3.0)) + np.maximum(x - 1.0, 0.0))
    # a foot that landed on its toes is pitched early in stance, too, without rolling off
    late = t > step.t_touch + FLAT_BY * (step.t_off - step.t_touch) if np.isfinite(step.t_touch) else True
    return np.where(late, roll, 0.0)


def _tip_from_hinge(shoe: Shoe) -> Array:
    """(3,) m, from the toe hinge to the tip of the sole, in the frame of the toes."""
    return np.array([shoe.toe_tip_x - shoe.toe_hinge_x, 0.0, -shoe.toe_hinge_z])


def _pivots(shoe: Shoe) -> tuple[Array, Array]:
    """Points about which a foot on the ground rotates: the heel's edge and the toe hinge, (3,) m each, foot's frame."""
    return np.array([shoe.heel_back_x, 0.0, 0.0]), np.array([shoe.toe_hinge_x, 0.0, shoe.toe_hinge_z])


def _swing_poses(
    a: Footstep,
    b: Footstep,
    size: Wearer,
    t: Array,
    theta: Array,
    pitch: Callable[[Array], Array],
    height: Callable[[Array], Array],
) -> tuple[Array, Array, Array]:
    """Poses of a foot in the air at (N,) s: (N, 3) m, (N, 3, 3) rotations, (N,) rad of toe extension.

    The path of `_swing_positions` is lifted until the sole clears the ground. Where the foot pushes off and a bump of
    up to `_MAX_BUMP_M` suffices, the lift is that bump. Otherwise it is the height with the least jerk
    (`min_jerk_height`), and of the windows in which the foot may move forward, the one with the least total jerk is
    taken.

    Args:
        a: Footstep that the foot leaves.
        b: Footstep that it reaches.
        size: Wearer.
        t: (N,) s, between toe-off and touch-down.
        theta: (N,) rad, pitch of the foot at these instants.
        pitch: Pitch of the foot, rad, at any (N,) s.
        height: Height of the ground, m, at (..., 2) points.
    """
    if len(t) == 0:  # a swing between two instants
        return np.empty((0, 3)), np.empty((0, 3, 3)), np.empty(0)
    share = (t - a.t_off) / (b.t_touch - a.t_off)  # (N,) shares of swing
    s, at = share, _FINE  # shares of the usual swing; (61,) shares of swing at which those of the usual one are `_FINE`
    if b.hesitation is not None:
        s = b.hesitation.usual_share(share, b.t_touch - a.t_off)
        at = b.hesitation.share_at(_FINE, b.t_touch - a.t_off)
    toes = _toe_ends(a, b, pitch)  # values and slopes of the toe extension at both ends
    R, toe = _swing_attitude(a, b, s, theta), quintic(s, *toes)
    # attitude of the foot and points of its sole at the shares `_FINE` of swing
    fine_R = _swing_attitude(a, b, _FINE, pitch(a.t_off + at * (b.t_touch - a.t_off)))
    fine_toe = quintic(_FINE, *toes)
    sole = _sole_points(size.shoe, fine_R, fine_toe)
    # (2,) m, margin before and behind a riser, along the way
    near = (_NEAR_EDGE_DOWN_M if a.departure == "lower" else _NEAR_EDGE_M) * np.array(
        [np.cos(b.heading), np.sin(b.heading)]
    )

    def shortfall(forward: tuple[float, float]) -> Array:
        """(61,) m, missing height at the shares `_FINE` of swing, if the foot moves forward in this window."""
        return _clearance_shortfall(
            _swing_positions(a, b, size, _FINE, fine_R, fine_toe, forward), sole, height, near, b.clearance_m
        )

    # `forward` is the window of forward motion, `lift` (N,) m the height above the smooth path
    forward, lift_m = _DIRECT, _bump_amplitude(shortfall(_DIRECT)) if a.departure in ("push", "back") else np.inf
    if lift_m <= _MAX_BUMP_M:
        lift = bump(s) * lift_m
    else:
        rise = float(b.p_foot_in_world[2] - a.p_foot_in_world[2])
        distance_m = float(np.linalg.norm(b.p_foot_in_world[:2] - a.p_foot_in_world[:2]))
        best = np.inf
        for window in _FORWARD.get(a.departure, _OVER):
            # the shortfall counts from the smooth path, the bound of the height from the start of the swing
            height_spline, jerk = min_jerk_height(rise, shortfall(window) + rise * _FINE_EASE)
            jerk += _mean_square_jerk(distance_m, window)
            if jerk < best:
                best, forward, lift = jerk, window, height_spline(s) - rise * soft_ease(s)
    p = _swing_positions(a, b, size, s, R, toe, forward)
    p[:, 2] += lift
    # a foot over an edge only hovers: on its way back it would meet the riser
    if b.hesitation is not None and abs(b.rise) < LEAST_EDGE_M and abs(a.fall) < LEAST_EDGE_M:
        way = b.p_foot_in_world[:2] - a.p_foot_in_world[:2]
        p[:, :2] -= b.hesitation.returned(share, b.t_touch - a.t_off)[:, None] * way
    return p, R, toe


def _toe_ends(a: Footstep, b: Footstep, pitch: Callable[[Array], Array]) -> tuple[float, float, float, float]:
    """Toe extension at both ends of swing: its value, rad, and rate by the share of swing at toe-off, then at landing.

    At toe-off the toes are extended by what the foot is pitched relative to them. At a landing on the heel they are
    straight, otherwise extended by the pitch of the landing.

    Args:
        a: Footstep that the foot leaves.
        b: Footstep that it reaches.
        pitch: Pitch of the foot, rad, at (N,) s.
    """
    h = 1e-4  # s, for central differences
    ends = np.array([a.t_off, b.t_touch])
    # pitch at both ends, shortly after them and shortly before them; columns: toe-off, touch-down
    bend = pitch(np.concatenate([ends, ends + h, ends - h])).reshape(3, 2)
    bend[:, 0] -= toe_roll(a, bend[:, 0], a.t_off + np.array([0.0, h, -h]))
    (toe_a, toe_b), after, before = bend
    rate_a, rate_b = (after - before) / (2 * h) * _usual_swing_s(a, b)  # per second, then per share of swing
    if a.departure == "back":  # the heel is the last on the ground, with straight toes
        toe_a = rate_a = 0.0
    return float(toe_a), float(rate_a), max(float(toe_b), 0.0), float(rate_b) if b.arrival != "heel" else 0.0


def _swing_attitude(a: Footstep, b: Footstep, s: Array, theta: Array) -> Array:
    """(N, 3, 3) rotation of a swinging foot at (N,) shares of swing: from sole to sole, then by the pitch (N,) rad."""
    return slerp(a.R_world_sole, b.R_world_sole, soft_ease(s)) @ rot_y(theta)


def _swing_positions(
    a: Footstep, b: Footstep, size: Wearer, s: Array, R: Array, toe: Array, forward: tuple[float, float]
) -> Array:
    """(N, 3) m, positions of a swinging foot at (N,) shares `s` of swing, not yet lifted over the ground.

    A point moves through the foot from the pivot of the toe-off to that of the landing. In the world it goes smoothly
    from its place at toe-off to its place at touch-down: horizontally within the window `forward` of swing, vertically
    over all of it. In a turn its path is an arc. Between level steps the style of the step adds its offset
    (`_swing_shape`).

    Args:
        a: Footstep that the foot leaves.
        b: Footstep that it reaches.
        size: Wearer.
        s: (N,) shares of swing, 0-1.
        R: (N, 3, 3) attitude of the foot.
        toe: (N,) rad, extension of the toes.
        forward: Shares of swing at which the horizontal motion begins and ends.
    """
    forward_share, upward_share = soft_ease((s - forward[0]) / (forward[1] - forward[0])), soft_ease(s)
    if b.is_run:
        forward_share = _run_forward(s, b.t_touch - a.t_off, b.swing.landing * _RUN_SPEED, RUN_LANDING_S)
    heel, hinge = _pivots(size.shoe)
    landing = heel if b.arrival == "heel" else hinge  # pivot of the landing
    # likewise, before the swing: in the footprint, and in the foot, where the tip moves with the toes
    leaving = heel if a.departure == "back" else hinge
    leaving_in_foot = leaving
    if a.rolls_off:
        tip = _tip_from_hinge(size.shoe)
        leaving, leaving_in_foot = hinge + tip, hinge + rot_y(-toe) @ tip
    pivot_in_foot = leaving_in_foot + soft_ease((s - _PIVOT_FROM) / _PIVOT_LASTS)[:, None] * (landing - leaving_in_foot)
    start: Array = a.p_foot_in_world + a.R_world_sole @ leaving
    end = b.p_foot_in_world + b.R_world_sole @ landing
    point = start + np.stack([forward_share, forward_share, upward_share], -1) * (end - start)
    # in a turn the foot moves on an arc, so that it keeps its distance when it passes the other one
    outward = np.array([end[1] - start[1], start[0] - end[0], 0.0]) * (b.heading - a.heading) / 8.0
    if a.twist is not None:  # round the other foot, which turns on its ball meanwhile
        outward *= _WIDER_ARC
    point = point + (4.0 * forward_share * (1.0 - forward_share))[:, None] * outward
    if a.departure == "push" and b.arrival == "heel":
        point = point + _swing_shape(b.style, s, b.R_world_sole) * leg_length(size)
        point[:, 2] += b.swing.lift_m * bump(s)
        if b.is_run:  # a runner's foot falls with the body
            swing_s = b.t_touch - a.t_off
            drop = _lag(1.0 - s, RUN_LANDING_S / swing_s, b.swing.landing, 0.0) * (1.0 - ease((1.0 - s) / _LAG_OVER))
            point[:, 2] += _RUN_DROP_MPS * swing_s * drop
    # instants of these shares in a swing that ends then, but does not hesitate
    begin = a.t_off if b.hesitation is None else b.t_touch - _usual_swing_s(a, b)
    point = point - landing_lag(a, b, size.shoe, begin + s * (b.t_touch - begin))
    return point - np.einsum("nij,nj->ni", R, pivot_in_foot)


def landing_lag(a: Footstep, b: Footstep, shoe: Shoe, t: Array) -> Array:
    """(N, 3) m, way that a foot still has to go at (N,) s to where it comes to rest, because it lands at speed.

    The lag grows in swing, along the ground, and is made up for around touch-down: the heel brakes evenly, and from
    touch-down on the ground stops it within `STOPPING_S`. A heel that is set down rests at touch-down.

    Args:
        a: Footstep that the foot leaves.
        b: Footstep that it reaches.
        shoe: Its sole.
        t: (N,) s, from the toe-off of `a` to the toe-off of `b`.
    """
    if a.departure != "push" or b.arrival != "heel" or b.is_run:
        return np.zeros((len(t), 3))
    steep = max(-b.slope, 0.0) / _SLOPE_WITHOUT_SPEED_RAD  # the knee is nearly straight: it cannot take up a blow
    faster = b.swing.landing * max(1.0 - steep, 0.0)
    swing_s = _usual_swing_s(a, b)
    left = np.maximum(b.t_touch + STOPPING_S * min(faster, 1.0) - t, 0.0) / swing_s
    lag = _lag(left, STOPPING_S / swing_s, faster * _LANDING_SPEED, _LANDING_BRAKE)
    lag *= 1.0 - ease((b.t_touch - t) / swing_s / _LAG_OVER)
    heel, hinge = _pivots(shoe)
    way = b.p_foot_in_world + b.R_world_sole @ heel - a.p_foot_in_world - a.R_world_sole @ hinge
    return lag[:, None] * way


def _usual_swing_s(a: Footstep, b: Footstep) -> float:
    """Duration of the swing from `a` to `b`, s, without the time for which it hovers."""
    swing_s = b.t_touch - a.t_off
    if b.hesitation is None or b.hesitation.how == "slow":
        return swing_s
    return swing_s - b.hesitation.for_s


def _run_forward(s: Array, swing_s: float, speed: float, stopping_s: float) -> Array:
    """(N,) share of its way that a runner's foot has made: it is fast for long, and brakes late and hard.

    The speed grows until `_RUN_FAST_BY` of swing. Later it is the smaller, smoothly, of a constant and of what even
    braking leaves before the landing; the constant follows from the whole way.

    Args:
        s: (N,) shares of swing, 0-1.
        swing_s: Duration of the swing.
        speed: Speed of the landing, relative to the mean speed of the swing.
        stopping_s: Time in which the ground stops the heel.
    """
    fine = np.linspace(0.0, 1.0, _RUN_FINE)
    left = 1.0 - fine
    braked = speed * ease(left * swing_s / stopping_s) + _RUN_BRAKE * np.maximum(left - 0.5 * stopping_s / swing_s, 0.0)
    growing, slow, fast = ease(fine / _RUN_FAST_BY), 0.5, 8.0
    way = np.zeros(_RUN_FINE)
    for _ in range(40):  # halves the interval of the constant speed
        most = 0.5 * (slow + fast)
        v = growing * (np.maximum(braked, 1e-6) ** -4.0 + most**-4.0) ** -0.25
        v[braked <= 0.0] = 0.0
        way = np.concatenate([[0.0], np.cumsum(v[1:] + v[:-1])]) * 0.5 / (_RUN_FINE - 1)
        slow, fast = (most, fast) if way[-1] < 1.0 else (slow, most)
    return np.asarray(make_interp_spline(fine, way / way[-1], k=3)(np.clip(s, 0.0, 1.0)))


def _lag(left: Array, stop: float, speed: float, brake: float) -> Array:
    """(N,) lag behind where a foot comes to rest, of one that brakes evenly until the ground stops it.

    Args:
        left: (N,) time left until it rests, as shares of swing.
        stop: Time in which the ground stops it, likewise.
        speed: Speed of the landing, relative to the mean speed of the swing.
        brake: Deceleration before that, in units of that mean speed per duration of the swing.
    """
    x = np.minimum(left / stop, 1.0)
    beyond = np.maximum(left - stop, 0.0)
    # integrals over the time left of `ease`, and of `ease` times the time left
    at_speed = stop * x**4 * (2.5 + x * (x - 3.0)) + beyond
    braking = stop**2 * x**5 * (2.0 + x * (6.0 / 7.0 * x - 2.5)) + beyond * (stop + beyond / 2.0)
    return speed * at_speed + brake * braking


def _swing_shape(style: Style, s: Array, base: Array) -> Array:
    """(N, 3) in leg lengths, offset of a swinging foot from its smooth path, world axes.

    Forward and lift are polynomials in 2 s − 1 with the coefficients of the style, times a bump, so that both ends
    rest.

    Args:
        style: Style of the step.
        s: (N,) shares of swing, 0-1.
        base: (3, 3) rotation of the footprint that the foot reaches.
    """
    powers = np.vander(2 * s - 1, max(len(style.forward), len(style.lift)), increasing=True).T
    ahead, above = style.forward @ powers[: len(style.forward)], style.lift @ powers[: len(style.lift)]
    local = np.stack([ahead, np.zeros_like(s), above], -1) * bump(s)[:, None]
    return local @ base.T


def _sole_points(shoe: Shoe, R: Array, toe: Array) -> tuple[Array, Array]:
    """Points of the sole in world axes, relative to the foot's origin, for (N, 3, 3) attitudes and (N,) toe extensions.

    Returns:
        (N, points, 3) m from the foot's origin to the part (foot or toes) that holds the point, and (N, points, 3) m
        from there to the point. Three points are on the rear foot, three on the toes.
    """
    # points on the rear foot in the foot's frame, and on the toes (hinge, middle, tip) relative to the hinge
    rear = [np.array([x, 0.0, 0.0]) for x in (shoe.heel_back_x, 0.0, 0.5 * shoe.toe_hinge_x)]
    _, hinge = _pivots(shoe)
    tip = [np.array([x * (shoe.toe_tip_x - shoe.toe_hinge_x), 0.0, -shoe.toe_hinge_z]) for x in (0.0, 0.5, 1.0)]
    R_toe = R @ rot_y(-toe)
    none = np.zeros((len(R), 3))
    to_part = np.stack([*(R @ x for x in rear), *[R @ hinge] * len(tip)], 1)
    return to_part, np.stack([*[none] * len(rear), *(R_toe @ x for x in tip)], 1)


def _clearance_shortfall(
    p: Array, sole: tuple[Array, Array], height: Callable[[Array], Array], near: Array, clearance: float
) -> Array:
    """(61,) m, how much higher a swinging foot must be at the shares `_FINE` of swing to clear the ground.

    At both ends, where the foot rests, there is no limit: -inf.

    Args:
        p: (61, 3) m, positions of the foot at these shares.
        sole: Points of the sole at these shares (`_sole_points`).
        height: Height of the ground, m, at (..., 2) points.
        near: (2,) m, ground this far before and behind a point counts, too.
        clearance: Clearance in mid-swing, m.
    """
    to_part, to_point = sole
    points = p[:, None] + to_part + to_point  # (61, points, 3) m in the world
    # highest ground behind, under and before each point; the wanted clearance is whole where the bump has a quarter of
    # its height, and fades to 0 at both ends of the swing
    probes = points[..., :2] + np.multiply.outer((-1.0, 0.0, 1.0), near)[:, None, None]  # (3, 61, points, 2)
    ground = np.max(height(probes), axis=0)
    clearances = clearance * np.minimum(4.0 * _FINE_BUMP, 1.0)[:, None]
    # the ends are the shares of swing at which a bump has at most 3 % of its height
    return np.where(_FINE_BUMP > 0.03, (ground + clearances - points[..., 2]).max(1), -np.inf)


def _bump_amplitude(shortfall: Array) -> float:
    """Smallest amplitude, m, of a bump over swing that lifts the foot by the missing height at every share `_FINE`.

    `shortfall` is that height, (61,) m; -inf where there is no limit.
    """
    has_limit = np.isfinite(shortfall)
    return float(max(0.0, np.max(shortfall[has_limit] / _FINE_BUMP[has_limit])))


def _mean_square_jerk(distance_m: float, window: tuple[float, float]) -> float:
    """Mean square over swing of the third derivative, by the share of swing, of a smooth path over `distance_m`.

    The path counts as a minimum-jerk step within the shares `window` of swing. 720 is the value of a unit step in all
    of swing.
    """
    return 720.0 * distance_m**2 / (window[1] - window[0]) ** 5
