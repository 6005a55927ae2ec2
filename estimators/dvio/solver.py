"""The window's non-linear least squares (15): landmarks eliminated first, then Cholesky; Levenberg–Marquardt."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.dvio.algebra import exponential, mul
from stridetwin.estimators.dvio.factors import add_motion, add_prior, add_standing
from stridetwin.estimators.dvio.memory import CALIBRATION, D_LENS, D_SCALE, FRAME, NO_HOST, Window
from stridetwin.estimators.dvio.terms import Terms
from stridetwin.estimators.dvio.views import HOST, SEER, SIGHT, Views, blank_views, huber, ray, seen_at, sight, view
from stridetwin.streams.samples import Array

_LOOSE = 1e-2  # m²; information on an inverse depth of which nothing is known: a standard deviation of 10/m
_FIXED = 1e12  # m²; on one that may not change
LEAST_INVERSE_DEPTH, MOST_INVERSE_DEPTH = 0.01, 10.0
# Sums may be taken in any order, so that they run on vector units; NaN and infinity keep their meaning.
_REORDERED = {"reassoc", "contract", "nsz"}
_FIRST_DAMPING, _MOST_DAMPING = 1e-9, 1e2


class Work(NamedTuple):
    """Room for the normal equations, so that nothing is allocated from frame to frame.

    Attributes:
        H: (N, N) of frames and calibration; the lower triangle counts.
        b: (N,).
        factor: (N, N) its Cholesky factor.
        step: (N,).
        Hl: (L,) of each landmark.
        bl: (L,).
        cross: (L, N) between landmark and the rest.
        views: Of the frames.
        saved: (F, 21 + 15) states before a step, and how far they had moved.
        saved_calibration: (26,).
        saved_depth: (L,).
    """

    H: Array
    b: Array
    factor: Array
    step: Array
    Hl: Array
    bl: Array
    cross: Array
    views: Views
    saved: Array
    saved_calibration: Array
    saved_depth: Array


def blank_work(frames: int, landmarks: int) -> Work:
    """Room for F frames and L landmarks."""
    n = CALIBRATION + FRAME * frames
    return Work(
        H=np.zeros((n, n)),
        b=np.zeros(n),
        factor=np.zeros((n, n)),
        step=np.zeros(n),
        Hl=np.zeros(landmarks),
        bl=np.zeros(landmarks),
        cross=np.zeros((landmarks, n)),
        views=blank_views(frames),
        saved=np.zeros((frames, 36)),
        saved_calibration=np.zeros(26),
        saved_depth=np.zeros(landmarks),
    )


@njit(fastmath=_REORDERED, error_model="numpy")
def add_landmark(
    window: Window, terms: Terms, work: Work, l: int, last: int, host_depth: bool, J: Array, Jl: Array
) -> float:
    """Adds the sightings (10) and told depths (13), (14) of a landmark; returns their cost.

    Args:
        window: Frames and landmarks.
        terms: Which factors there are.
        work: H, b, and the landmark's own Hl, bl and cross are changed; its row of `cross` is made 0 first.
        l: Slot of the landmark.
        last: Slot of the last frame whose sightings count.
        host_depth: Whether (11) is there.
        J: (3, 22) room.
        Jl: (3,) room.
    """
    marks, H, b = window.landmarks, work.H, work.b
    host, xi, scale = marks.host[l], marks.inverse_depth[l], window.calibration.scale[0]
    x, y = ray(window.calibration, marks.at[l, host])
    cross = work.cross[l]
    cross[:] = 0.0
    Hl, bl, cost = _LOOSE, 0.0, 0.0
    told = marks.told[l, host]
    if told > 0.0:
        if terms.depth_fixed:
            Hl += _FIXED
        elif host_depth:
            # Scaled on the side of the landmark: a scale on what is told would win by shrinking its noise.
            r = scale * xi - told
            c, w = huber(r * r * terms.depth_weight, terms.depth_limit)
            w *= terms.depth_weight
            cost += c
            Hl += w * scale * scale
            bl -= w * scale * r
            cross[D_SCALE] += w * scale * xi
            H[D_SCALE, D_SCALE] += w * xi * xi
            b[D_SCALE] -= w * xi * r
    first = CALIBRATION + FRAME * host
    for j in range(last + 1):
        if j == host or not marks.seen[l, j]:
            continue
        px, py, depth, before = seen_at(work.views, host, j, x, y, xi)
        if not before or not sight(window, work.views, host, j, x, y, xi, J, Jl):
            continue
        u, v = ray(window.calibration, marks.at[l, j])
        r0, r1, r2, w2 = px - u, py - v, 0.0, 0.0
        J[0, D_LENS] -= marks.at[l, j, 0]
        J[1, D_LENS + 1] -= marks.at[l, j, 1]
        c, w0 = huber((r0 * r0 + r1 * r1) * terms.sight_weight, terms.sight_limit)
        w0 *= terms.sight_weight
        cost += c
        told = marks.told[l, j]
        if terms.projection_depth and told > 0.0:
            r2 = scale * depth - told
            c, w = huber(r2 * r2 * terms.again_weight, terms.depth_limit)
            w2 = w * terms.again_weight
            cost += c
            for i in range(SIGHT):
                J[2, i] *= scale
            Jl[2] *= scale
            J[2, D_SCALE] = depth
        Hl += w0 * (Jl[0] * Jl[0] + Jl[1] * Jl[1]) + w2 * Jl[2] * Jl[2]
        bl -= w0 * (Jl[0] * r0 + Jl[1] * r1) + w2 * Jl[2] * r2
        second = CALIBRATION + FRAME * j
        for a in range(SIGHT):
            v0, v1, v2 = w0 * J[0, a], w0 * J[1, a], w2 * J[2, a]
            # a host is older than a seer, so that what is filled is the lower triangle, and squares across it
            ia, blocks = a, 0
            if a >= HOST:
                ia, blocks = first + a - HOST, 1
            if a >= SEER:
                ia, blocks = second + a - SEER, 2
            cross[ia] += v0 * Jl[0] + v1 * Jl[1] + v2 * Jl[2]
            b[ia] -= v0 * r0 + v1 * r1 + v2 * r2
            row = H[ia]
            for e in range(CALIBRATION):
                row[e] += v0 * J[0, e] + v1 * J[1, e] + v2 * J[2, e]
            if blocks > 0:
                for e in range(6):
                    row[first + e] += v0 * J[0, HOST + e] + v1 * J[1, HOST + e] + v2 * J[2, HOST + e]
            if blocks > 1:
                for e in range(6):
                    row[second + e] += v0 * J[0, SEER + e] + v1 * J[1, SEER + e] + v2 * J[2, SEER + e]
    work.Hl[l], work.bl[l] = Hl, bl
    return cost


@njit(fastmath=_REORDERED, error_model="numpy")
def eliminate(work: Work, l: int, host: int, seen: NDArray[np.uint8], last: int, index: NDArray[np.int64]) -> None:
    """Takes a landmark out of the normal equations (Schur complement).

    Args:
        work: H and b are changed.
        l: Its slot.
        host: Slot of its host.
        seen: (F,) by which frames it is seen.
        last: Slot of the last frame that counts.
        index: Room for F.
    """
    n = 0
    for k in range(last + 1):
        if k == host or seen[k]:
            index[n] = CALIBRATION + FRAME * k
            n += 1
    cross, H, b, share = work.cross[l], work.H, work.b, 1.0 / work.Hl[l]
    for i in range(CALIBRATION):
        f = cross[i] * share
        b[i] -= f * work.bl[l]
        for e in range(CALIBRATION):
            H[i, e] -= f * cross[e]
    for m in range(n):
        for i in range(index[m], index[m] + 6):
            f = cross[i] * share
            b[i] -= f * work.bl[l]
            row = H[i]
            for e in range(CALIBRATION):
                row[e] -= f * cross[e]
            for k in range(m + 1):
                o = index[k]
                for e in range(6):
                    row[o + e] -= f * cross[o + e]


@njit(error_model="numpy")
def usable(window: Window, l: int, last: int) -> bool:
    """Whether a landmark has a host and is seen by another frame."""
    if window.landmarks.host[l] == NO_HOST or window.landmarks.host[l] > last:
        return False
    others = 0
    for j in range(last + 1):
        others += window.landmarks.seen[l, j] and j != window.landmarks.host[l]
    return others > 0


@njit(error_model="numpy")
def linearise(window: Window, terms: Terms, work: Work) -> float:
    """Normal equations of all factors, landmarks eliminated; returns the cost."""
    n = window.frames.count[0]
    size = CALIBRATION + FRAME * n
    work.H[:size, :size] = 0.0
    work.b[:size] = 0.0
    view(window, terms, work.views)
    cost = add_prior(window, size, work.H, work.b)
    for k in range(n):
        cost += add_standing(window.frames, k, work.H, work.b)
        if k + 1 < n:
            cost += add_motion(window, k, terms, work.H, work.b)
    J, Jl, index = np.zeros((3, SIGHT)), np.zeros(3), np.zeros(size, np.int64)
    for l in range(len(window.landmarks.host)):
        if usable(window, l, n - 1):
            cost += add_landmark(window, terms, work, l, n - 1, terms.host_depth, J, Jl)
            eliminate(work, l, window.landmarks.host[l], window.landmarks.seen[l], n - 1, index)
    return cost


@njit(fastmath=_REORDERED, error_model="numpy")
def solve(work: Work, size: int, damping: float) -> bool:
    """Step of the first `size` states, damped by a share of the diagonal; False where H is not positive definite."""
    A, L, x = work.H, work.factor, work.step
    for i in range(size):
        for j in range(i):
            L[i, j] = A[i, j]
        L[i, i] = A[i, i] * (1.0 + damping) + 1e-9
    for j in range(size):
        d = L[j, j]
        for k in range(j):
            d -= L[j, k] * L[j, k]
        if not d > 0.0:
            return False
        d = np.sqrt(d)
        L[j, j] = d
        for i in range(j + 1, size):
            s = L[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            L[i, j] = s / d
    for i in range(size):
        s = work.b[i]
        for k in range(i):
            s -= L[i, k] * x[k]
        x[i] = s / L[i, i]
    for i in range(size - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, size):
            s -= L[k, i] * x[k]
        x[i] = s / L[i, i]
    return True


@njit(error_model="numpy")
def move(window: Window, work: Work) -> None:
    """Takes the step."""
    frames, c, d = window.frames, window.calibration, work.step
    c.p[:] += d[0:3]
    c.R[:] = mul(c.R, exponential(d[3:6]))
    c.offset[0] += d[6]
    c.scale[0] += d[7]
    c.lens[:] += d[8:10]
    c.moved[:] += d[:CALIBRATION]
    for k in range(frames.count[0]):
        o = CALIBRATION + FRAME * k
        e = d[o : o + FRAME]
        if frames.held[k]:
            m = frames.moved[k]
            m += e
            frames.p[k] = frames.p_first[k] + m[0:3]
            frames.R[k] = mul(frames.R_first[k], exponential(m[3:6]))
            frames.v[k] = frames.v_first[k] + m[6:9]
            frames.bias[k] = frames.bias_first[k] + m[9:15]
        else:
            frames.p[k] += e[0:3]
            frames.R[k] = mul(frames.R[k], exponential(e[3:6]))
            frames.v[k] += e[6:9]
            frames.bias[k] += e[9:15]
    n = CALIBRATION + FRAME * frames.count[0]
    marks = window.landmarks
    for l in range(len(marks.host)):
        if usable(window, l, frames.count[0] - 1):
            s = work.bl[l]
            for i in range(n):
                s -= work.cross[l, i] * d[i]
            xi = marks.inverse_depth[l] + s / work.Hl[l]
            marks.inverse_depth[l] = min(max(xi, LEAST_INVERSE_DEPTH), MOST_INVERSE_DEPTH)


@njit(error_model="numpy")
def _copy(window: Window, work: Work, back: bool) -> None:
    """Saves the states, or takes them back."""
    frames, c, s = window.frames, window.calibration, work.saved_calibration
    if back:
        c.R[:] = s[:9].copy().reshape(3, 3)
        c.p[:], c.offset[0], c.scale[0], c.lens[:], c.moved[:] = s[9:12], s[12], s[13], s[14:16], s[16:26]
        window.landmarks.inverse_depth[:] = work.saved_depth
    else:
        s[:9], s[9:12], s[12], s[13] = c.R.ravel(), c.p, c.offset[0], c.scale[0]
        s[14:16], s[16:26] = c.lens, c.moved
        work.saved_depth[:] = window.landmarks.inverse_depth
    for k in range(frames.count[0]):
        s = work.saved[k]
        if back:
            frames.R[k] = s[:9].copy().reshape(3, 3)
            frames.p[k], frames.v[k], frames.bias[k], frames.moved[k] = s[9:12], s[12:15], s[15:21], s[21:36]
        else:
            s[:9], s[9:12], s[12:15] = frames.R[k].ravel(), frames.p[k], frames.v[k]
            s[15:21], s[21:36] = frames.bias[k], frames.moved[k]


@njit(error_model="numpy")
def minimise(window: Window, terms: Terms, work: Work, steps: int, enough: float) -> float:
    """Moves the states towards the minimum of (15).

    Args:
        window: Changed in place.
        terms: What the factors believe.
        work: Room; its factor is that of the last normal equations.
        steps: At most so many.
        enough: Stop where a step lowers the cost by less than this share.

    Returns:
        The cost before the last step that was taken.
    """
    size = CALIBRATION + FRAME * window.frames.count[0]
    damping, cost = _FIRST_DAMPING, linearise(window, terms, work)
    for i in range(steps):
        if not solve(work, size, damping):
            damping = max(10 * damping, 1e-4)
            continue
        _copy(window, work, False)
        move(window, work)
        if i == steps - 1:
            break
        new = linearise(window, terms, work)
        if new <= cost * (1.0 + 1e-9) + 1e-9:
            done = cost - new < enough * abs(cost)
            cost, damping = new, max(0.1 * damping, 1e-12)
            if done:
                break
        else:
            _copy(window, work, True)
            damping = max(10 * damping, 1e-4)
            linearise(window, terms, work)
            if damping > _MOST_DAMPING:
                break
    return cost
