"""A short recording looped to a wanted length: its best cycle is repeated, each time where the last one ended.

A cycle begins and ends in the same posture with the same speed. Consecutive cycles are displaced by what the cycle
advances and turns, so that a foot which rests then stays where it is. What coordinates differ fades afterwards, so that
the motion is continuous up to its second derivative. Afterwards the feet are put on the ground anew. On stairs a cycle
that climbs is followed by more of the same stairs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stridetwin.sim.motion.fit import FittedWalk, ground_walk, track_feet
from stridetwin.sim.motion.parameters import MotionParameters
from stridetwin.sim.motion.rests import FootTrack
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

_SPEED_S = 0.1  # weight of the speed of a coordinate relative to the coordinate
_MAX_MISMATCH_RAD = 0.20  # RMS over the coordinates, of a cycle that is none
_LONGER = 1.3  # mismatch over the least one up to which a longer cycle is preferred
_STRAIGHT_RAD = np.radians(5.0)  # turns per cycle below this are taken as none
_STANDING_MPS = 0.2  # speed of the pelvis below which the person stands
_WALKING_SHARE = 0.7  # least speed of a cycle, as a share of the usual one
_FOOT_WEIGHT = 8.0  # rad/m, of the places of the feet relative to that of angles
_SETTLE_S = 0.45  # in which what the postures differ at the seam fades; at most half a cycle
_COARSEST_S = 0.0099  # rows that follow faster than this are thinned out


def loop_walk(
    fitted: FittedWalk, duration_s: float, source: str, parameters: MotionParameters | None = None
) -> FittedWalk:
    """The walk, whose best cycle is repeated until it lasts as long as it should; a longer one is cut.

    Args:
        fitted: The recorded walk.
        duration_s: Wanted length.
        source: File, for messages.
        parameters: None for the usual ones.

    Raises:
        ConfigError: The recording holds no whole stride.
    """
    parameters = parameters or MotionParameters()
    stride = max(1, int(np.floor(_COARSEST_S / fitted.dt)) if fitted.dt < _COARSEST_S else 1)
    x, dt = fitted.x[::stride], fitted.dt * stride
    wanted = round(duration_s / dt) + 1
    if wanted <= len(x):
        looped = x[:wanted]
    else:
        feet = track_feet(fitted.skeleton, x)
        looped = _repeat(x, *_find_cycle(x, dt, source, feet, parameters), wanted, dt, feet, parameters)
    skeleton = fitted.skeleton
    paths = skeleton.points(skeleton.poses(looped), fitted.points.bodies, fitted.points.places)
    points = replace(fitted.points, paths=paths, weights=np.full(paths.shape[:2], 1.0 / parameters.marker_sd_m))
    grounded = ground_walk(skeleton, fitted.person, points, looped, dt, parameters)
    return replace(grounded, placement=fitted.placement.then(grounded.placement))


def _find_cycle(
    x: Array, dt: float, source: str, feet: list[FootTrack], parameters: MotionParameters
) -> tuple[int, int]:
    """First row of the best cycle, and the row at which the next one begins.

    Raises:
        ConfigError: No two rows a stride apart have similar postures.
    """
    n, fade = len(x), round(parameters.fade_s / dt)
    shortest = round(parameters.min_cycle_s / dt)
    speed = np.gradient(x, dt, axis=0)
    # forward and sideways speed as the pelvis sees them, m/s, weigh like angular rates
    c, s = np.cos(x[:, 3]), np.sin(x[:, 3])
    seen = np.stack([c * speed[:, 0] + s * speed[:, 1], c * speed[:, 1] - s * speed[:, 0], speed[:, 2]], axis=1)
    # where the feet are, seen from the pelvis
    turned = np.array([[c, s], [-s, c]]).transpose(2, 0, 1)
    apart = [foot.p - x[:, :3] for foot in feet]
    places = [np.hstack([np.einsum("nij,nj->ni", turned, p[:, :2]), p[:, 2:]]) for p in apart]
    features = np.hstack([x[:, 4:], _SPEED_S * speed[:, 3:], _SPEED_S * seen, *(_FOOT_WEIGHT * p for p in places)])
    # a cycle walks: a person who stands returns to the same posture, too
    pace = np.linalg.norm(speed[:, :2], axis=1)
    walked = np.concatenate([[0.0], np.cumsum(pace[:-1] * dt)])
    usual = float(np.median(pace[pace > _STANDING_MPS])) if (pace > _STANDING_MPS).any() else 0.0
    best: list[tuple[float, int, int]] = []
    for begin in range(0, n - shortest - fade):
        ends = np.arange(begin + shortest, n - fade)
        is_walk = walked[ends] - walked[begin] >= _WALKING_SHARE * usual * dt * (ends - begin)
        mismatch = np.sqrt(np.mean((features[ends] - features[begin]) ** 2, axis=1))
        mismatch[~is_walk] = np.inf
        k = int(np.argmin(mismatch))
        best.append((float(mismatch[k]), begin, int(ends[k])))
    least = min(best, default=(np.inf, 0, 0))[0]
    if least > _MAX_MISMATCH_RAD:
        raise ConfigError(
            source,
            "duration_s",
            f"a loop of {n * dt:.1f} s whose postures never return",
            f"no duration_s, or a recording of a whole stride and {parameters.fade_s:g} s more",
        )
    _, begin, end = max((c for c in best if c[0] <= _LONGER * least), key=lambda cycle: cycle[2] - cycle[1])
    return begin, end


def _repeat(
    x: Array, begin: int, end: int, wanted: int, dt: float, feet: list[FootTrack], parameters: MotionParameters
) -> Array:
    """(wanted, D) rows: the part before the cycle, then the cycle again and again.

    A foot that rests where one cycle passes into the next stays where it is; what the postures differ then fades.
    """
    overlap, length = np.arange(round(parameters.fade_s / dt)), end - begin
    turn = float(np.mean(x[end + overlap, 3] - x[begin + overlap, 3]))
    if abs(turn) < _STRAIGHT_RAD:
        turn = 0.0
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    kept = x[:, :3]
    slowest = parameters.still_mps
    for foot in feet:
        speed = np.linalg.norm(np.gradient(foot.p, dt, axis=0), axis=1)
        fastest = max(float(speed[begin + overlap].mean()), float(speed[end + overlap].mean()))
        if fastest < slowest:
            kept, slowest = foot.p, fastest
    shift = np.mean(kept[end + overlap] - kept[begin + overlap] @ R.T, axis=0)
    if abs(shift[2]) < parameters.riser_m:
        shift[2] = 0.0  # level ground
    cycle, tail = x[begin:end].copy(), x[end : end + 3].copy()
    pieces, count = [x[:begin]], begin
    t: Array = np.arange(length, dtype=float) * dt
    settle_s = min(_SETTLE_S, 0.5 * length * dt)
    first = True
    while count < wanted:
        piece = cycle.copy()
        if not first:
            piece += _fade_difference(tail - cycle[:3], t, settle_s, dt)
            tail = _displace(tail, R, shift, turn)
        pieces.append(piece)
        count += length
        cycle = _displace(cycle, R, shift, turn)
        first = False
    return np.concatenate(pieces)[:wanted]


def _fade_difference(difference: Array, t: Array, settle_s: float, dt: float) -> Array:
    """(N, D) a difference that fades to zero, with its speed and acceleration at the start (Bollo 2018).

    Args:
        difference: (3, D) the difference at 0, dt and 2 dt.
        t: (N,) s.
        settle_s: Time after which it is zero, with its first two derivatives.
        dt: Time between two rows, s.
    """
    first, second, third = difference
    speed = (-3.0 * first + 4.0 * second - third) / (2.0 * dt) * settle_s
    acceleration = (first - 2.0 * second + third) / dt**2 * settle_s**2
    s = np.minimum(t / settle_s, 1.0)[:, None]
    place = 1.0 - 10.0 * s**3 + 15.0 * s**4 - 6.0 * s**5
    moving = s - 6.0 * s**3 + 8.0 * s**4 - 3.0 * s**5
    bending = 0.5 * (s**2 - 3.0 * s**3 + 3.0 * s**4 - s**5)
    return np.asarray(place * first + moving * speed + bending * acceleration)


def _displace(x: Array, R: Array, shift: Array, turn: float) -> Array:
    """(N, D) coordinates of the same motion, turned and shifted in the world."""
    moved = x.copy()
    moved[:, :3] = x[:, :3] @ R.T + shift
    moved[:, 3] += turn
    return moved
