"""Recorded feet on the ground: soles and toe hinges lie still in rests and do not sink.

A correction of the recorded path is fixed in rests, and elsewhere the smoothest that returns to what the rests on both
sides have in common.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import solveh_banded
from scipy.spatial.transform import Rotation

from stridetwin.sim.motion.parameters import MotionParameters
from stridetwin.sim.motion.rests import FootRest, FootTrack, Span
from stridetwin.sim.wearer.dimensions import Shoe
from stridetwin.streams.samples import Array

_FIRM = 1e5  # weight of a correction in a rest, over that of one between rests
_PRESSED = 0.5  # share of the half width at which a sole that rolls sideways presses
_LIFT_ROUNDS = 6
_TOE_LIMIT_RAD = 1.2
_STEEPEST = 0.37  # rise over length of ground that is no riser


def ground_foot(
    track: FootTrack,
    stances: Sequence[FootRest],
    heights: Array,
    slopes: Array,
    shoe: Shoe,
    height: Callable[[Array], Array],
    dt: float,
    parameters: MotionParameters,
) -> FootTrack:
    """Path of a foot that rests and rolls on the ground.

    Args:
        track: Recorded path in the world.
        stances: Its stances.
        heights: (K,) m, of the ground under them.
        slopes: (K,) rad, inclination along the world's x, uphill positive.
        shoe: Its sole.
        height: Height of the ground, m, at (..., 2) points.
        dt: Time between two rows, s.
        parameters: Times.
    """
    n = len(track.p)
    frames = [sole_frame(s, float(slope)) for s, slope in zip(stances, slopes)]
    origins = [np.array([s.p[0], s.p[1], z]) for s, z in zip(stances, heights)]

    flats = [slice(*s.flat) for s in stances if s.flat is not None]
    turn, firm = np.zeros((n, 3)), np.zeros(n)
    for stance, frame in zip(stances, frames):
        if stance.flat is not None:
            rows = slice(*stance.flat)
            turn[rows] = Rotation.from_matrix(frame @ np.swapaxes(track.R[rows], 1, 2)).as_rotvec()
            firm[rows] = _FIRM
    R = Rotation.from_rotvec(_fill(turn, firm, flats, dt, parameters.ramp_s)).as_matrix() @ track.R

    shift, firm_xy, firm_z = np.zeros((n, 3)), np.zeros(n), np.zeros(n)
    rolled = FootTrack(side=track.side, p=track.p, R=R, toe=track.toe)
    # a soft sole that rolls sideways gives way at its borders: it presses half way to them
    borders = [_PRESSED * y for y in _sides(shoe)]
    corners = [*(rolled.point(shoe.heel_back_x, y) for y in borders), *(rolled.ball(shoe, y) for y in borders)]
    heel, ball = rolled.point(shoe.heel_back_x), rolled.ball(shoe)
    for stance, frame, origin in zip(stances, frames, origins):
        # while a part of it rests, the lowest corner is on the ground's plane; distances are along the vertical
        rows = slice(*rest_rows(stance))
        above = [(c[rows] - origin) @ frame[:, 2] / frame[2, 2] for c in corners]
        shift[rows, 2], firm_z[rows] = -np.min(above, axis=0), _FIRM
        for span, point, x in ((stance.heel, heel, shoe.heel_back_x), (stance.ball, ball, shoe.toe_hinge_x)):
            if span is not None:
                rest = slice(*span)
                shift[rest, :2] = (origin + x * frame[:, 0])[:2] - point[rest, :2]
                firm_xy[rest] = _FIRM
    p = track.p.copy()
    p[:, :2] += _fill(shift[:, :2], firm_xy, flats, dt, parameters.ramp_s)
    p[:, 2] += _fill(shift[:, 2:], firm_z, flats, dt, parameters.ramp_s)[:, 0]
    placed = FootTrack(side=track.side, p=p, R=R, toe=track.toe)
    placed = replace(placed, toe=_toe_angles(placed, shoe, height, dt, parameters))
    return _lift(placed, stances, shoe, height, dt, parameters)


def sole_points(track: FootTrack, shoe: Shoe) -> Array:
    """(N, 8, 3) m, paths of the corners of the sole: heel, ball, both borders, and the flat front of the toes."""
    corners = [track.point(shoe.heel_back_x, y) for y in _sides(shoe)]
    corners += [track.ball(shoe, y) for y in _sides(shoe)]
    hinge = np.array([shoe.toe_hinge_x, 0.0, shoe.toe_hinge_z])
    c, s = np.cos(track.toe), np.sin(track.toe)  # extension turns the toes up: about −y
    for along in (0.5 * (shoe.flat_tip_x - shoe.toe_hinge_x), shoe.flat_tip_x - shoe.toe_hinge_x):
        for y in _sides(shoe):
            x, z = along, -shoe.toe_hinge_z
            local = np.stack([hinge[0] + c * x - s * z, np.full_like(c, y), hinge[2] + s * x + c * z], -1)
            corners.append(track.p + np.einsum("nij,nj->ni", track.R, local))
    return np.stack(corners, axis=1)


def rest_rows(stance: FootRest) -> Span:
    """Rows from the first to the last in which heel or ball rest."""
    spans = [span for span in (stance.heel, stance.ball) if span is not None]
    return min(span[0] for span in spans), max(span[1] for span in spans)


def _sides(shoe: Shoe) -> tuple[float, float]:
    """The right and the left border of a sole, m."""
    return -shoe.half_width, shoe.half_width


def sole_frame(stance: FootRest, slope: float) -> Array:
    """(3, 3) axes of the flat foot on ground that rises along x."""
    normal = np.array([-np.sin(slope), 0.0, np.cos(slope)])
    ahead = np.array([np.cos(stance.yaw), np.sin(stance.yaw), 0.0])
    ahead -= (ahead @ normal) / normal[2] * np.array([0.0, 0.0, 1.0])  # down to the plane, so that the yaw stays
    ahead /= np.linalg.norm(ahead)
    return np.column_stack([ahead, np.cross(normal, ahead), normal])


def _toe_angles(
    track: FootTrack, shoe: Shoe, height: Callable[[Array], Array], dt: float, parameters: MotionParameters
) -> Array:
    """(N,) rad, extension of the toes: least that keeps their tip out of the ground, so that they leave it last."""
    ball = track.ball(shoe)
    above = ball[:, 2] - height(ball[:, :2])
    pitch = np.arcsin(np.clip(-track.R[:, 2, 0], -1.0, 1.0))  # toes down positive
    reach = shoe.flat_tip_x - shoe.toe_hinge_x
    rise = height(ball[:, :2] + reach * track.R[:, :2, 0]) - height(ball[:, :2])
    rise = np.where(np.abs(rise) < _STEEPEST * reach, rise, 0.0)  # of a ramp, not of a riser
    least = pitch - np.arcsin(np.clip((above - rise) / reach, -0.5, 1.0))
    target = np.clip(least, 0.0, _TOE_LIMIT_RAD)
    firm = np.where((least > 0.0) | (above < parameters.max_rise_m), _FIRM, 0.0)
    return _fill(target[:, None], firm, (), dt, parameters.ramp_s)[:, 0]


def _lift(
    track: FootTrack,
    stances: Sequence[FootRest],
    shoe: Shoe,
    height: Callable[[Array], Array],
    dt: float,
    parameters: MotionParameters,
) -> FootTrack:
    """The path, raised smoothly where a part of the sole would be deeper in the ground than it gives way."""
    n = len(track.p)
    lift, active, target = np.zeros(n), np.zeros(n), np.zeros(n)
    for stance in stances:  # a flat sole is on the ground already
        if stance.flat is not None:
            active[slice(*stance.flat)] = 1.0
    for _ in range(_LIFT_ROUNDS):
        raised = FootTrack(side=track.side, p=track.p + lift[:, None] * [0.0, 0.0, 1.0], R=track.R, toe=track.toe)
        corners = sole_points(raised, shoe)
        depth = np.max(height(corners[..., :2]) - corners[..., 2], axis=1) - parameters.soft_m
        deep = depth > parameters.lift_sd_m
        if not deep.any():
            break
        target[deep] = lift[deep] + depth[deep]
        active[deep] = 1.0
        lift = _fill(target[:, None], active * _FIRM, (), dt, parameters.ramp_s)[:, 0]
    return FootTrack(side=track.side, p=track.p + lift[:, None] * [0.0, 0.0, 1.0], R=track.R, toe=track.toe)


def _fill(target: Array, firm: Array, rests: Sequence[slice], dt: float, ramp_s: float) -> Array:
    """(N, C) smooth values that equal a target where it is firm.

    Elsewhere they return, within about `ramp_s`, to the line through the means of the target in rests, or to zero if
    there are none. They minimise firm (c − target)² + (c − line)² + (ramp / 2 π)⁶ (d³c/dt³)².

    Args:
        target: (N, C) values; only firm ones count.
        firm: (N,) their weights; 0 between rests.
        rests: Rows of each rest.
        dt: Time between two rows, s.
        ramp_s: Time of the return.
    """
    n = len(target)
    line = np.zeros_like(target)
    if rests:
        middle = [0.5 * (rest.start + rest.stop - 1) for rest in rests]
        means = np.array([target[rest].mean(0) for rest in rests])
        line = np.stack([np.interp(np.arange(n), middle, means[:, c]) for c in range(target.shape[1])], axis=1)
    smooth = (ramp_s / (2.0 * np.pi) / dt) ** 6
    band = np.zeros((4, n))
    band[0] = 1.0 + firm
    coefficients = (-1.0, 3.0, -3.0, 1.0)
    for i, a in enumerate(coefficients):
        for j in range(i + 1):
            band[i - j, j : n - 3 + j] += smooth * a * coefficients[j]
    right = line + firm[:, None] * target
    return np.asarray(solveh_banded(band, right, lower=True))
