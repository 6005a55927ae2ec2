"""Stances of the recorded feet: when heel and ball rest on the ground, and where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.motion.parameters import MotionParameters
from stridetwin.sim.wearer.dimensions import Shoe
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Array

Span = tuple[int, int]
"""First row, and one past the last."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FootTrack:
    """Path of one foot at N instants.

    Attributes:
        side: `l` or `r`.
        p: (N, 3) m, foot frame's origin in the world.
        R: (N, 3, 3) foot to world.
        toe: (N,) rad, extension of the toes.
    """

    side: str
    p: Array
    R: Array
    toe: Array

    def point(self, x: float, y: float = 0.0) -> Array:
        """(N, 3) m, path of a point of the sole."""
        return self.p + self.R @ np.array([x, y, 0.0])

    def ball(self, shoe: Shoe, y: float = 0.0) -> Array:
        """(N, 3) m, path of the sole under the toe hinge, if the toes are flat: straight below the hinge's axis."""
        return self.p + self.R @ np.array([shoe.toe_hinge_x, y, shoe.toe_hinge_z]) - [0.0, 0.0, shoe.toe_hinge_z]


@dataclass(frozen=True, kw_only=True, eq=False)
class FootRest:
    """One stance of a foot.

    Attributes:
        side: `l` or `r`.
        ground: Rows on the ground, from touch-down to toe-off.
        heel: Rows in which the heel's edge rests; None if never.
        ball: Rows in which the ball rests; None if never.
        flat: Rows in which both rest; None if never.
        p: (3,) m, the flat foot's origin, or where it would be.
        yaw: Direction of the foot, rad.
        tilt: Inclination of the recorded sole along the foot, rad, toes up positive; NaN if it was never flat.
    """

    side: str
    ground: Span
    heel: Span | None
    ball: Span | None
    flat: Span | None
    p: Array
    yaw: float
    tilt: float


def find_stances(track: FootTrack, shoe: Shoe, dt: float, parameters: MotionParameters) -> list[FootRest]:
    """Stances of one foot in order of time.

    A point of the sole rests while it is slower than `still_mps`; the foot is on the ground as long as its heel or its
    ball is slower than `moving_mps` and about as high as in the rest.

    Args:
        track: Recorded path of the foot.
        shoe: Its sole.
        dt: Time between two rows, s.
        parameters: Speeds and times.
    """
    heel, ball = track.point(shoe.heel_back_x), track.ball(shoe)
    heel_speed, ball_speed = (np.linalg.norm(np.gradient(point, dt, axis=0), axis=1) for point in (heel, ball))
    shortest = max(2, round(parameters.min_rest_s / dt))
    resting = np.minimum(heel_speed, ball_speed) < parameters.still_mps
    stances = []
    for begin, end in _join_rests(_spans(resting, shortest), heel, ball, dt, parameters):
        rows = slice(begin, end)
        heel_rest = _longest(heel_speed[rows] < parameters.still_mps, begin, shortest)
        ball_rest = _longest(ball_speed[rows] < parameters.still_mps, begin, shortest)
        if heel_rest is None and ball_rest is None:
            continue
        both = (max(heel_rest[0], ball_rest[0]), min(heel_rest[1], ball_rest[1])) if heel_rest and ball_rest else (0, 0)
        flat = (
            _flat_part(heel[:, 2] - ball[:, 2], both, shortest, parameters) if both[1] - both[0] >= shortest else None
        )
        if flat is not None:  # the heel that has begun to rise, and the ball that still comes down, do not rest
            assert heel_rest is not None
            assert ball_rest is not None
            heel_rest, ball_rest = (heel_rest[0], flat[1]), (flat[0], ball_rest[1])
        # the foot stays on the ground as long as a point of it moves slowly at the height of its rest
        level = min(heel[rows, 2].min(), ball[rows, 2].min())
        on = np.zeros(len(resting), dtype=bool)
        for point, speed in ((heel, heel_speed), (ball, ball_speed)):
            on |= (speed < parameters.moving_mps) & (point[:, 2] < level + parameters.max_rise_m)
        on[rows] = True
        begin_ground = begin - int(np.argmin(np.append(on[:begin][::-1], False)))
        end_ground = end + int(np.argmin(np.append(on[end:], False)))
        p, yaw, tilt = _rest_pose(track, shoe, flat, heel_rest, ball_rest)
        stances.append(
            FootRest(
                side=track.side,
                ground=(begin_ground, end_ground),
                heel=heel_rest,
                ball=ball_rest,
                flat=flat,
                p=p,
                yaw=yaw,
                tilt=tilt,
            )
        )
    return _without_overlap(stances)


def _flat_part(tilt: Array, span: Span, shortest: int, parameters: MotionParameters) -> Span:
    """Rows of a span in which a sole is as flat as in most of them.

    Args:
        tilt: (N,) m, height of the heel above the ball.
        span: Rows in which both rest.
        shortest: Number of rows of the shortest rest.
        parameters: What is flat.
    """
    rows = slice(*span)
    part = _longest(np.abs(tilt[rows] - np.median(tilt[rows])) < parameters.flat_m, span[0], shortest)
    return span if part is None else part


def stances_of(feet: Sequence[FootTrack], shoe: Shoe, dt: float, parameters: MotionParameters) -> list[FootRest]:
    """Stances of both feet in order of time.

    Raises:
        StrideTwinError: A foot never rests.
    """
    stances_by_side = {track.side: find_stances(track, shoe, dt, parameters) for track in feet}
    for side, stances in stances_by_side.items():
        if not any(stance.flat for stance in stances):
            raise StrideTwinError(f"the {'left' if side == 'l' else 'right'} foot never lies flat and still")
    return sorted((s for stances in stances_by_side.values() for s in stances), key=lambda s: s.ground[0])


def _rest_pose(
    track: FootTrack, shoe: Shoe, flat: Span | None, heel: Span | None, ball: Span | None
) -> tuple[Array, float, float]:
    """Origin (3,), direction and tilt of the foot in a rest; of the point that rests if the foot is never flat."""
    if flat is not None:
        rows = slice(*flat)
        axis = track.R[rows, :, 0].mean(0)
        # the middle between the heel's edge and the ball is where the height is known best
        middle = 0.5 * (shoe.heel_back_x + shoe.toe_hinge_x)
        p = track.point(middle)[rows].mean(0)
        yaw = float(np.arctan2(axis[1], axis[0]))
        p[:2] -= middle * np.array([np.cos(yaw), np.sin(yaw)])
        return p, yaw, float(np.arctan2(axis[2], np.hypot(axis[0], axis[1])))
    span, x = (ball, shoe.toe_hinge_x) if ball is not None else (heel, shoe.heel_back_x)
    assert span is not None
    rows = slice(*span)
    axis = track.R[rows, :, 0].mean(0)
    yaw = float(np.arctan2(axis[1], axis[0]))
    p = (track.point(x) if ball is None else track.ball(shoe))[rows].mean(0)
    p[:2] -= x * np.array([np.cos(yaw), np.sin(yaw)])
    return p, yaw, float("nan")


def _spans(mask: NDArray[np.bool_], shortest: int) -> list[Span]:
    """Runs of true rows that are at least `shortest` long; gaps shorter than that are closed."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    runs = [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2])]
    joined: list[Span] = []
    for begin, end in runs:
        if joined and begin - joined[-1][1] < shortest // 2:
            joined[-1] = (joined[-1][0], end)
        else:
            joined.append((begin, end))
    return [(a, b) for a, b in joined if b - a >= shortest]


def _join_rests(spans: list[Span], heel: Array, ball: Array, dt: float, parameters: MotionParameters) -> list[Span]:
    """Rests of a foot, with those made one between which it moves a little, but neither lifts off nor steps."""
    joined: list[Span] = []
    for begin, end in spans:
        if joined:
            since = joined[-1][1] - 1
            low = np.minimum(heel[since : begin + 1, 2], ball[since : begin + 1, 2])
            moved = max(np.linalg.norm(point[begin] - point[since]) for point in (heel, ball))
            is_near = moved < parameters.same_place_m and (begin - since) * dt < parameters.same_rest_s
            if is_near and np.ptp(low) < parameters.max_rise_m:
                joined[-1] = (joined[-1][0], end)
                continue
        joined.append((begin, end))
    return joined


def _longest(mask: NDArray[np.bool_], begin: int, shortest: int) -> Span | None:
    """Longest run of true rows, counted from row `begin`; None if there is none."""
    spans = _spans(mask, shortest)
    if not spans:
        return None
    a, b = max(spans, key=lambda span: span[1] - span[0])
    return a + begin, b + begin


def _without_overlap(stances: list[FootRest]) -> list[FootRest]:
    """Stances whose rows on the ground do not overlap: the border is half way between the rests."""
    kept: list[FootRest] = []
    for stance in stances:
        if kept and stance.ground[0] < kept[-1].ground[1]:
            border = (stance.ground[0] + kept[-1].ground[1]) // 2
            last = kept[-1]
            kept[-1] = FootRest(**{**vars(last), "ground": (last.ground[0], border)})
            stance = FootRest(**{**vars(stance), "ground": (border, stance.ground[1])})
        kept.append(stance)
    return kept
