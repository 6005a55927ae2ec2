"""Distribution of the load: the share of each foot and its planned centre of pressure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from stridetwin.sim.gait.foot_path import STOPPING_S, landing_lag, rows_within, toe_roll
from stridetwin.sim.gait.footsteps import SETTLE_S, WEIGHT_SHIFT_S, Footstep
from stridetwin.sim.gait.style import TRAVEL_KNOTS
from stridetwin.sim.kinematics.smooth import ease
from stridetwin.sim.wearer.dimensions import Shoe
from stridetwin.streams.samples import Array

_FLAT_RAD = 5e-4  # pitch up to which a foot counts as flat
_Knots = tuple[tuple[float, float], ...]


# Path of the centre of pressure under one foot, chosen by hand; on the heel it follows the style of the step.
#
# Knots are (share of stance, x as a share of the toe hinge's x).
_FLAT_KNOTS: _Knots = ((0.0, 0.45), (0.15, 0.40), (0.55, 0.85), (0.86, 1.12), (1.0, 1.10))
_FOREFOOT_KNOTS: _Knots = (
    (0.0, 1.34),  # under the toes until the heel is down
    (0.17, 1.32),
    (0.23, 1.06),
    (0.32, 0.45),
    (0.46, 0.60),
    (0.62, 0.95),
    (0.86, 1.06),
    (1.0, 1.08),
)
# Backwards: how it begins after a landing on the toes, how it ends on the heel, and before walking on forwards.
_TOE_KNOTS: _Knots = ((0.0, 1.20), (0.15, 1.10), (0.40, 0.65))
_BALL_KNOTS: _Knots = ((0.0, 1.10), (0.40, 1.04))  # of a foot that turns on its ball
_BACK_KNOTS: _Knots = ((0.72, 0.10), (1.0, -0.20))
_ON_KNOTS: _Knots = ((0.65, 0.80), (0.86, 1.08), (1.0, 1.08))
_STANDING_X = 0.50  # share of the toe hinge's x, in quiet stance
_BALL_MARGIN = 0.03  # likewise, from the border of the area in contact
_HEEL_MARGIN_M = 0.003  # from the heel's edge
_PASSING_S = 0.07  # transition when the foot becomes flat or ceases to be flat
_ROLLING_RAD = 0.05  # by which the toes have rolled when only their tip presses
_MIN_TIP_ON_TREAD_M = 0.005  # least part of a tread that the tip needs to stand on
_SHIFT_S = 0.45  # within which the load moves from both feet to one at the end of a pause, and before it to both
_STANDING_FADE_S = 0.05  # SD of the filter of the time that a walker stands still
_MAX_DROP_M = 0.03  # ground that is lower by more belongs to another tread


def load_shares(steps: Mapping[str, Sequence[Footstep]], t: Array) -> dict[str, Array]:
    """Share of the load on each foot at (N,) s, by foot; the shares sum to 1.

    A foot alone on the ground bears all. In double support the load moves by a cubic of the time, and in a pause both
    feet bear half (`_load_share`). In a flight, in which there is no load (`in_flight`), the shares move evenly from
    foot to foot.
    """
    raw = {foot: np.zeros_like(t) for foot in steps}  # not yet scaled to a sum of 1
    for foot, foot_steps in steps.items():
        other_steps = _steps_of_other_foot(steps, foot)
        for step in foot_steps:
            # double support begins again with the other foot's touch-down before this toe-off
            other_off = _end_of_double_support(step, other_steps)
            before = max((s for s in other_steps if s.t_touch <= step.t_touch), key=lambda s: s.t_touch)
            following = max((s for s in other_steps if s.t_touch < step.t_off), key=lambda s: s.t_touch)
            # the load comes up after touch-down and goes down before toe-off; never for feet that stand at an end
            on = rows_within(t, step.t_press, step.t_off)
            up, down = np.ones_like(t[on]), np.ones_like(t[on])
            if np.isfinite(step.t_touch) and before.t_off >= step.t_touch:  # otherwise after a flight
                up = _load_share(step, t[on], step.t_touch, other_off)
            if np.isfinite(step.t_off) and following.t_touch >= step.t_touch:  # otherwise before a flight
                down = 1 - _load_share(following, t[on], following.t_touch, step.t_off)
            raw[foot][on] = up * down
    flight = in_flight(steps, t)
    total = np.where(flight, 1.0, sum(raw.values()))
    ground = ~flight
    return {foot: np.interp(t, t[ground], (r / total)[ground]) for foot, r in raw.items()}


def in_flight(steps: Mapping[str, Sequence[Footstep]], t: Array) -> NDArray[np.bool_]:
    """(N,) whether no foot is on the ground at (N,) s."""
    ground = np.zeros(len(t), bool)
    for step in (step for foot_steps in steps.values() for step in foot_steps):
        ground[rows_within(t, step.t_press, step.t_off)] = True
    return ~ground


def add_quiet_stance(shares: dict[str, Array], steps: Mapping[str, Sequence[Footstep]], t: Array) -> dict[str, Array]:
    """Shares of the load, by foot, with quiet stance at both ends: half on each foot, then a shift to the stance foot.

    Args:
        shares: (N,) shares of the walk by foot.
        steps: Footsteps by foot.
        t: (N,) s.
    """
    first = min(s.t_off for foot_steps in steps.values() for s in foot_steps)  # s, first toe-off
    last = max(s.t_touch for foot_steps in steps.values() for s in foot_steps)  # s, last touch-down
    # (N,) 1 in quiet stance, 0 while walking
    stand = np.maximum(ease((first - t) / WEIGHT_SHIFT_S), ease((t - last) / SETTLE_S))
    return {foot: (1 - stand) * s + stand * 0.5 for foot, s in shares.items()}


def standing_time(steps: Mapping[str, Sequence[Footstep]], t: Array) -> Array:
    """(N,) s for which the walker has stood still in pauses by each of (N,) uniform s; it does not decrease.

    It counts between two shifts of the load: to both feet after a touch-down, and from both before the next toe-off;
    and on one foot while the other one hesitates.

    Args:
        steps: Footsteps by foot.
        t: (N,) uniform s.
    """
    standing = np.zeros(len(t))
    for foot, foot_steps in steps.items():
        other_steps = _steps_of_other_foot(steps, foot)
        for step in foot_steps:
            end = _end_of_double_support(step, other_steps)
            if _is_pause(step, step.t_touch, end):
                begin = step.t_touch + _SHIFT_S
                standing += np.clip(t, begin, end - _SHIFT_S) - begin
        for before, step in pairwise(foot_steps):
            if step.hesitation is not None:  # the body waits over the other foot
                share = (t - before.t_off) / (step.t_touch - before.t_off)
                standing += step.hesitation.for_s * step.hesitation.lost_share(share, step.t_touch - before.t_off)
    return np.asarray(gaussian_filter1d(standing, _STANDING_FADE_S / (t[1] - t[0]), mode="nearest"))


def cop_travel(steps: Sequence[Footstep], t: Array, standing: Array) -> Array:
    """(N,) planned centre of pressure under one foot at (N,) s, along the foot, as a share of the toe hinge's x.

    It follows from the time in stance without pauses, in which it rests, and the kind of landing alone;
    `pressure_centres` limits it to the contact area.

    Args:
        steps: Footsteps of the foot in order of time.
        t: (N,) s.
        standing: (N,) s for which the walker has stood still in pauses (`standing_time`).
    """
    walking = t - standing
    x = np.empty(len(t))
    for step, on in _rows_of_steps(steps, t):
        # (K, 2) share of stance, x as a share of the toe hinge's x
        knots = np.array(_FOREFOOT_KNOTS if step.arrival == "forefoot" else _FLAT_KNOTS)
        if step.arrival == "heel":
            knots = np.column_stack([TRAVEL_KNOTS, step.style.travel])
        if step.arrival in ("toe", "ball") or step.departure == "back":
            begin = {"toe": _TOE_KNOTS, "ball": _BALL_KNOTS}.get(step.arrival, _FLAT_KNOTS[:2])
            knots = np.array(begin + (_BACK_KNOTS if step.departure == "back" else _ON_KNOTS))
        if np.isfinite(step.t_touch) and np.isfinite(step.t_off):
            touch, off = np.interp([step.t_touch, step.t_off], t, walking)
            u = np.clip((walking[on] - touch) / (off - touch), 0.0, 1.0)  # share of stance
            x[on] = PchipInterpolator(knots[:, 0], knots[:, 1])(u)
        elif np.isfinite(step.t_off):  # a foot that stands at the start: from quiet stance to the end of a stance
            x[on] = _STANDING_X + (knots[-1, 1] - _STANDING_X) * ease(
                (t[on] - step.t_off + WEIGHT_SHIFT_S) / WEIGHT_SHIFT_S
            )
        else:  # a foot that stands at the end: from the begin of a stance to quiet stance
            x[on] = knots[0, 1] + (_STANDING_X - knots[0, 1]) * ease((t[on] - step.t_touch) / SETTLE_S)
    return x


def pressure_centres(
    steps: Sequence[Footstep], shoe: Shoe, t: Array, travels: Array, pitch: Array, height: Callable[[Array], Array]
) -> Array:
    """(N, 3) m, planned centre of pressure of one foot in the world; in swing, that at the end of the last stance.

    Args:
        steps: The footsteps of this foot, in order.
        shoe: Sole of this foot.
        t: (N,) s.
        travels: (N,) centre of pressure along the foot by time alone, as a share of the toe hinge's x (`cop_travel`).
        pitch: (N,) rad, of the foot relative to its ground, toes down positive: only the parts of the sole on the
            ground can press.
        height: Height of the ground, m, at (2,) m: toes whose tip overhangs an edge press at their hinge alone.
    """
    p = np.empty((len(t), 3))
    before: Footstep | None = None
    for step, on in _rows_of_steps(steps, t):
        x = _limit_to_contact(travels[on], t[on], step, pitch[on], shoe)
        if _tip_overhangs(step, shoe, height):
            x = np.minimum(x, 1.0)  # not in front of the toe hinge
        p[on] = step.p_foot_in_world + (x * shoe.toe_hinge_x)[:, None] * step.R_world_sole[:, 0]
        if before is not None:  # a heel that lands at speed is still on its way
            braking = rows_within(t, step.t_press, step.t_touch + STOPPING_S)
            p[braking] -= landing_lag(before, step, shoe, t[braking])
        before = step
    return p


def _rows_of_steps(steps: Sequence[Footstep], t: Array) -> Iterator[tuple[Footstep, slice]]:
    """Each footstep with the rows of (N,) increasing times from its touch-down to the next touch-down of this foot."""
    begin = np.searchsorted(t, [step.t_press for step in steps])
    begin[0] = 0  # the first footstep takes all rows before its touch-down, too
    for step, a, b in zip(steps, begin, [*begin[1:], len(t)]):
        yield step, slice(int(a), int(b))


def _tip_overhangs(step: Footstep, shoe: Shoe, height: Callable[[Array], Array]) -> bool:
    """Whether the tip of a shoe that is longer than its tread has no ground of that tread below it."""
    tip = step.p_foot_in_world + step.R_world_sole[:, 0] * (shoe.flat_tip_x + _MIN_TIP_ON_TREAD_M)
    return float(tip[2] - height(tip[:2])) > _MAX_DROP_M


def _limit_to_contact(x: Array, t: Array, step: Footstep, pitch: Array, shoe: Shoe) -> Array:
    """Centre of pressure (N,) within the part of the sole that touches the ground, as a share of the toe hinge's x.

    Until the sole is flat it is at the heel's edge (after a landing on the heel) or in front of the ball; after the
    heel has risen it is in front of the ball. The transitions take `_PASSING_S`.

    Args:
        x: (N,) wanted centre of pressure.
        t: (N,) s.
        step: The footstep.
        pitch: (N,) rad, pitch of the foot relative to its ground.
        shoe: Sole of the foot.
    """
    stance = np.flatnonzero((t >= step.t_touch) & (t <= step.t_off))
    if not len(stance):
        return x  # these rows have no stance
    tilt = np.abs(pitch)
    # rows with a flat sole; where it never lies flat, those with the least tilt
    flat = stance[tilt[stance] <= max(_FLAT_RAD, tilt[stance].min())]
    if flat[0] > stance[0]:  # the foot lands tilted
        flat_from = _flat_time(t, tilt, flat[0] - 1, flat[0])
        tilted = np.maximum(x, 1.0 + _BALL_MARGIN)  # on the ball, or at the heel's edge
        if step.arrival == "heel":
            tilted = np.full_like(x, (shoe.heel_back_x + _HEEL_MARGIN_M) / shoe.toe_hinge_x)
        x = tilted + (x - tilted) * ease((t - flat_from) / _PASSING_S)
    if flat[-1] < stance[-1]:  # the heel rises before toe-off
        flat_until = _flat_time(t, tilt, flat[-1] + 1, flat[-1])
        last = np.maximum(x, 1.0 + _BALL_MARGIN)  # on the ball, or at the heel's edge
        if step.departure == "back":
            last = np.full_like(x, (shoe.heel_back_x + _HEEL_MARGIN_M) / shoe.toe_hinge_x)
        x = x + (last - x) * ease((t - flat_until) / _PASSING_S + 1.0)
        rolled = toe_roll(step, pitch, t)
        x = x + (np.maximum(x, shoe.flat_tip_x / shoe.toe_hinge_x) - x) * ease(rolled / _ROLLING_RAD)
    return x


def _flat_time(t: Array, tilt: Array, i: int, flat: int) -> float:
    """Time at which the tilt of a foot passes `_FLAT_RAD`, s, between two neighbouring rows.

    Args:
        t: (N,) s.
        tilt: (N,) rad, magnitude of the pitch.
        i: Row in which the foot is tilted.
        flat: Row beside it in which the foot is flat.
    """
    share = (tilt[i] - _FLAT_RAD) / max(tilt[i] - tilt[flat], 1e-9)
    return float(t[i] + min(share, 1.0) * (t[flat] - t[i]))


def _load_share(step: Footstep, t: Array, begin: float, end: float) -> Array:
    """(N,) share of the load on the foot of `step`, 0-1, at (N,) s of the double support that it begins.

    The load moves within the share `transfer` of double support. It is a cubic of the time, not the smoother quintic:
    people load the heel at once, and a foot that hardly presses at touch-down bounces. In a pause the load moves to
    both feet, and from both to this one within the last `_SHIFT_S`.

    Args:
        step: The footstep.
        t: (N,) s.
        begin: Touch-down of this foot, s.
        end: Toe-off of the other foot, s.
    """
    if _is_pause(step, begin, end):
        return 0.5 * _rise_cubic((t - begin) / _SHIFT_S) + 0.5 * _rise_cubic((t - end) / _SHIFT_S + 1.0)
    # standing at the start has no begin, and standing at the end has no end: the load has moved, or does not move
    progress = 1.0 - (end - t) / max(end - begin, 1e-6) if np.isfinite(end) else np.zeros(len(t))
    return _rise_cubic(progress / float(step.style.transfer))


def _steps_of_other_foot(steps: Mapping[str, Sequence[Footstep]], foot: str) -> list[Footstep]:
    """Footsteps of the foot that is not `foot`, from footsteps by foot."""
    return [step for other, other_steps in steps.items() if other != foot for step in other_steps]


def _end_of_double_support(step: Footstep, other_steps: Sequence[Footstep]) -> float:
    """Time at which the double support that `step` begins ends, s: the other foot's next toe-off; inf without one."""
    return min((s.t_off for s in other_steps if s.t_off > step.t_touch), default=np.inf)


def _is_pause(step: Footstep, begin: float, end: float) -> bool:
    """Whether the walker stands on both feet in the double support from `begin` to `end`, s, that `step` begins."""
    return step.pause_s > 0.0 and np.isfinite(end) and end - begin > 2 * _SHIFT_S


def _rise_cubic(s: Array) -> Array:
    """(...) cubic that rises from 0 at s = 0 to 1 at s = 1, without slope at both, and is constant elsewhere."""
    s = np.clip(s, 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)
