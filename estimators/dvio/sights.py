"""What the window expects of a new frame, and what it makes of what was seen there."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.dvio.algebra import mul, rotate, rotate_back
from stridetwin.estimators.dvio.factors import Terms, at_exposure, seen_at, view
from stridetwin.estimators.dvio.memory import NO_HOST, Window
from stridetwin.estimators.dvio.solver import Work
from stridetwin.streams.samples import Array


@njit(error_model="numpy")
def foresee(
    window: Window, R: Array, p: Array, before: int, expected: Array, start: Array, known: NDArray[np.uint8]
) -> None:
    """Where landmarks will be seen from a pose, and where they are believed to have been seen from a frame.

    Args:
        window: Frames, landmarks, calibration.
        R: (3, 3) world <- IMU.
        p: (3,) m.
        before: Slot of the frame.
        expected: (L, 3) out: x and y on the plane at depth 1, and inverse depth.
        start: (L, 3) out: the same in the frame `before`.
        known: (L,) out: 1 where the landmark is before the camera in both.
    """
    marks, c = window.landmarks, window.calibration
    Rb, pb = at_exposure(window.frames, before, c.offset[0])
    for l in range(len(marks.host)):
        known[l] = 0
        h = marks.host[l]
        if h == NO_HOST:
            continue
        Rh, ph = at_exposure(window.frames, h, c.offset[0])
        xi = marks.inverse_depth[l]
        m = np.array([marks.at[l, h, 0], marks.at[l, h, 1], 1.0])
        world = rotate(Rh, rotate(c.R, m) + xi * c.p) + xi * ph  # times its inverse depth
        q = rotate_back(c.R, rotate_back(R, world - xi * p) - xi * c.p)
        s = rotate_back(c.R, rotate_back(Rb, world - xi * pb) - xi * c.p)
        if q[2] < 0.05 or s[2] < 0.05:
            continue
        expected[l, 0], expected[l, 1], expected[l, 2] = q[0] / q[2], q[1] / q[2], xi / q[2]
        start[l, 0], start[l, 1], start[l, 2] = s[0] / s[2], s[1] / s[2], xi / s[2]
        known[l] = 1


@njit(error_model="numpy")
def cull(window: Window, terms: Terms, work: Work, most: float, alive: NDArray[np.uint8]) -> int:
    """Removes sightings that do not fit what the window believes; a landmark that the newest frame mis-sees is let go.

    Args:
        window: Changed in place.
        terms: What the factors believe.
        work: Room.
        most: Standard deviations.
        alive: (L,) changed: 0 where following the landmark should stop.

    Returns:
        How many sightings of the newest frame remain.
    """
    view(window, terms, work.views)
    n, marks = window.frames.count[0], window.landmarks
    scale, left = window.calibration.scale[0], 0
    for l in range(len(marks.host)):
        h = marks.host[l]
        if h == NO_HOST:
            continue
        x, y = marks.at[l, h]
        for j in range(n):
            if j == h or not marks.seen[l, j]:
                continue
            q, before = seen_at(work.views, h, j, x, y, marks.inverse_depth[l])
            off = math.inf
            if before:
                off = ((q[0] - marks.at[l, j, 0]) ** 2 + (q[1] - marks.at[l, j, 1]) ** 2) * terms.sight_weight
            if off > most * most:
                marks.seen[l, j] = 0
                if j == n - 1:
                    alive[l] = 0
                continue
            if marks.told[l, j] > 0.0 and terms.projection_depth:
                r = scale * q[2] - marks.told[l, j]
                if r * r * terms.depth_weight > most * most:
                    marks.told[l, j] = 0.0
            if j == n - 1:
                left += 1
    return left


@njit(error_model="numpy")
def parallax(window: Window, newest: int, since: int) -> tuple[float, int]:
    """Mean motion of points between two frames that is not due to turning, on the plane at depth 1; and how many.

    Args:
        window: Frames and landmarks.
        newest: Slot.
        since: Slot.
    """
    marks, c, f = window.landmarks, window.calibration, window.frames
    turn = mul(np.ascontiguousarray(f.R[newest].T), f.R[since])
    A = mul(np.ascontiguousarray(c.R.T), mul(turn, c.R))
    total, count = 0.0, 0
    for l in range(len(marks.host)):
        if marks.host[l] == NO_HOST or not (marks.seen[l, newest] and marks.seen[l, since]):
            continue
        q = rotate(A, np.array([marks.at[l, since, 0], marks.at[l, since, 1], 1.0]))
        if q[2] < 0.05:
            continue
        total += math.hypot(q[0] / q[2] - marks.at[l, newest, 0], q[1] / q[2] - marks.at[l, newest, 1])
        count += 1
    return (total / count if count else 0.0), count
