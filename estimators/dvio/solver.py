"""The window's non-linear least squares (15), and marginalisation of its oldest frame into the prior (6).

Landmarks are eliminated first, then Cholesky; Levenberg–Marquardt.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.dvio.algebra import REORDERED, mul
from stridetwin.estimators.dvio.imu_factors import add_motion, add_prior, add_zero_velocity, errors
from stridetwin.estimators.dvio.landmarks import (
    POSE,
    CameraEquations,
    add_camera_factors,
    blank_camera_equations,
    state,
    usable,
)
from stridetwin.estimators.dvio.planes import add_planes, hold_planes, move_planes
from stridetwin.estimators.dvio.projection import Views, blank_views, project, ray, view
from stridetwin.estimators.dvio.state import CALIBRATION, FRAME, NO_HOST, PLANE, FactorParameters, Window
from stridetwin.estimators.so3 import exp
from stridetwin.streams.samples import Array

LEAST_INVERSE_DEPTH, MOST_INVERSE_DEPTH = 0.01, 10.0
_FIRST_DAMPING, _MOST_DAMPING = 1e-9, 1e2


class Work(NamedTuple):
    """Preallocated buffers for the normal equations.

    Attributes:
        H: (N, N) of frames and calibration; the lower triangle counts.
        b: (N,).
        factor: (N, N) its Cholesky factor.
        step: (N,).
        camera: Camera factors.
        views: Of the frames.
        saved: (F, 21 + 15) states before a step, and their deviations from the first estimates.
        saved_calibration: (26,).
        saved_depth: (L,).
        saved_planes: (K, 7).
    """

    H: Array
    b: Array
    factor: Array
    step: Array
    camera: CameraEquations
    views: Views
    saved: Array
    saved_calibration: Array
    saved_depth: Array
    saved_planes: Array


def blank_work(frames: int, landmarks: int, planes: int = 0) -> Work:
    """Buffers for F frames, L landmarks and K planes."""
    n = CALIBRATION + PLANE * planes + FRAME * frames
    return Work(
        H=np.zeros((n, n)), b=np.zeros(n), factor=np.zeros((n, n)), step=np.zeros(n),
        camera=blank_camera_equations(frames, landmarks), views=blank_views(frames), saved=np.zeros((frames, 36)),
        saved_calibration=np.zeros(26), saved_depth=np.zeros(landmarks), saved_planes=np.zeros((planes, 7)),
    )  # fmt: skip


@njit(error_model="numpy", **INSIDE)
def linearise(window: Window, factors: FactorParameters, work: Work) -> float:
    """Normal equations of all factors, landmarks eliminated; returns the cost."""
    n = window.frames.count[0]
    size = window.shared + FRAME * n
    work.H[:size, :size] = 0.0
    work.b[:size] = 0.0
    view(window, factors, work.views)
    cost = add_prior(window, size, work.H, work.b)
    for k in range(n):
        cost += add_zero_velocity(window, k, work.H, work.b)
        if k + 1 < n:
            cost += add_motion(window, k, factors, work.H, work.b)
    cost += add_planes(window, factors, n - 1, work.H, work.b)
    return cost + add_camera_factors(
        window, factors, work.views, work.camera, n, n - 1, factors.host_depth, work.H, work.b
    )


@njit(fastmath=REORDERED, error_model="numpy", **INSIDE)
def factorise(L: Array, size: int) -> bool:
    """Cholesky factor of the leading `size` rows, in place in the lower triangle; False where there is none.

    Four rows at a time, so that their common factor is read once; faster than LAPACK at this size.
    """
    for j in range(size):
        a = L[j]
        d = a[j]
        for k in range(j):
            d -= a[k] * a[k]
        if not d > 0.0:
            return False
        d = np.sqrt(d)
        a[j] = d
        i = j + 1
        while i + 3 < size:
            w, x, y, z = L[i], L[i + 1], L[i + 2], L[i + 3]
            dw, dx, dy, dz = w[j], x[j], y[j], z[j]
            for k in range(j):
                dw -= w[k] * a[k]
                dx -= x[k] * a[k]
                dy -= y[k] * a[k]
                dz -= z[k] * a[k]
            w[j], x[j], y[j], z[j] = dw / d, dx / d, dy / d, dz / d
            i += 4
        for r in range(i, size):
            w = L[r]
            dw = w[j]
            for k in range(j):
                dw -= w[k] * a[k]
            w[j] = dw / d
    return True


@njit(fastmath=REORDERED, error_model="numpy", **INSIDE)
def solve(work: Work, size: int, damping: float) -> bool:
    """Step of the first `size` states, damped by a fraction of the diagonal; False if H is not positive definite."""
    A, L, x = work.H, work.factor, work.step
    for i in range(size):
        for j in range(i):
            L[i, j] = A[i, j]
        L[i, i] = A[i, i] * (1.0 + damping) + 1e-9
    if not factorise(L, size):
        return False
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


@njit(error_model="numpy", **INSIDE)
def move(window: Window, work: Work) -> None:
    """Applies the step."""
    frames, c, d = window.frames, window.calibration, work.step
    c.p[:] += d[0:3]
    c.R[:] = mul(c.R, exp(d[3:6]))
    c.offset[0] += d[6]
    c.scale[0] += d[7]
    c.focal[:] += d[8:10]
    c.moved[:] += d[:CALIBRATION]
    move_planes(window, d)
    for k in range(frames.count[0]):
        o = window.shared + FRAME * k
        e = d[o : o + FRAME]
        if frames.held[k]:
            m = frames.moved[k]
            m += e
            frames.p[k] = frames.p_first[k] + m[0:3]
            frames.R[k] = mul(frames.R_first[k], exp(m[3:6]))
            frames.v[k] = frames.v_first[k] + m[6:9]
            frames.bias[k] = frames.bias_first[k] + m[9:15]
        else:
            frames.p[k] += e[0:3]
            frames.R[k] = mul(frames.R[k], exp(e[3:6]))
            frames.v[k] += e[6:9]
            frames.bias[k] += e[9:15]
    seen, marks = work.camera, window.landmarks
    by_pose = np.empty(CALIBRATION + POSE * frames.count[0])
    for i in range(len(by_pose)):
        by_pose[i] = d[state(i, window.shared)]
    for l in range(len(marks.host)):
        if usable(window, l, frames.count[0] - 1):
            s = seen.b_own[l]
            for i in range(len(by_pose)):
                s -= seen.cross[l, i] * by_pose[i]
            xi = marks.inverse_depth[l] + s / seen.own[l]
            marks.inverse_depth[l] = min(max(xi, LEAST_INVERSE_DEPTH), MOST_INVERSE_DEPTH)


@njit(error_model="numpy", **INSIDE)
def _copy(row: Array, at: int, values: Array, back: bool) -> int:
    """Copies (N,) values to a row from `at` on, or back; returns where they end."""
    for i in range(len(values)):
        if back:
            values[i] = row[at + i]
        else:
            row[at + i] = values[i]
    return at + len(values)


@njit(error_model="numpy", **INSIDE)
def _save(window: Window, work: Work, back: bool) -> None:
    """Saves the states, or restores them."""
    frames, planes, c, row = window.frames, window.planes, window.calibration, work.saved_calibration
    at = _copy(row, 0, c.R.reshape(9), back)
    for values in (c.p, c.offset, c.scale, c.focal, c.moved):
        at = _copy(row, at, values, back)
    _copy(work.saved_depth, 0, window.landmarks.inverse_depth, back)
    for k in range(len(planes.used)):
        at = _copy(work.saved_planes[k], 0, planes.normal[k], back)
        at = _copy(work.saved_planes[k], at, planes.distance[k : k + 1], back)
        _copy(work.saved_planes[k], at, planes.moved[k], back)
    for k in range(frames.count[0]):
        at = _copy(work.saved[k], 0, frames.R[k].reshape(9), back)
        for values in (frames.p[k], frames.v[k], frames.bias[k], frames.moved[k]):
            at = _copy(work.saved[k], at, values, back)


@njit(error_model="numpy", **INSIDE)
def minimise(window: Window, factors: FactorParameters, work: Work, steps: int, enough: float) -> float:
    """Moves the states towards the minimum of docs/dvio.md (10), in at most `steps`; returns a recent cost.

    Stops if a step lowers the cost by less than the share `enough`. The factor in `work` is that of the last equations.
    """
    size = window.shared + FRAME * window.frames.count[0]
    damping, cost = _FIRST_DAMPING, linearise(window, factors, work)
    for i in range(steps):
        if not solve(work, size, damping):
            damping = max(10 * damping, 1e-4)
            continue
        _save(window, work, False)
        move(window, work)
        if i == steps - 1:
            break
        new = linearise(window, factors, work)
        if new <= cost * (1.0 + 1e-9) + 1e-9:
            done = cost - new < enough * abs(cost)
            cost, damping = new, max(0.1 * damping, 1e-12)
            if done:
                break
        else:
            _save(window, work, True)
            damping = max(10 * damping, 1e-4)
            linearise(window, factors, work)
            if damping > _MOST_DAMPING:
                break
    return cost


@njit(error_model="numpy", **INSIDE)
def hold(window: Window, H: Array, last: int) -> None:
    """Marks frames up to `last` as in the prior H: their Jacobians stay at the first linearisation point."""
    f = window.frames
    for k in range(1, last + 1):
        o = window.shared + FRAME * k
        if not f.held[k] and H[o, o] > 0.0:
            f.held[k] = 1
            f.R_first[k], f.p_first[k], f.v_first[k], f.bias_first[k] = f.R[k], f.p[k], f.v[k], f.bias[k]
            f.moved[k] = 0.0


@njit(error_model="numpy", **INSIDE)
def without_oldest(H: Array, b: Array, shared: int, size: int) -> None:
    """Eliminates the oldest frame from H d = b of `size` states; its rows become free. See docs/dvio.md (11).

    The lower triangle of H counts; on return H is symmetric. The first `shared` states belong to no frame.
    """
    o, m = shared, shared + FRAME
    for i in range(size):
        for j in range(i):
            H[j, i] = H[i, j]
    own = H[o:m, o:m].copy()
    scale = np.empty(FRAME)
    for i in range(FRAME):
        scale[i] = 1.0 / np.sqrt(max(own[i, i], 1e-12))
    for i in range(FRAME):
        for j in range(FRAME):
            own[i, j] *= scale[i] * scale[j]
        own[i, i] += 1e-12
    inverse = np.linalg.inv(own)
    for i in range(FRAME):
        for j in range(FRAME):
            inverse[i, j] *= scale[i] * scale[j]
    share = np.zeros((size, FRAME))
    for i in range(size):
        if o <= i < m:
            continue
        for j in range(FRAME):
            s = 0.0
            for k in range(FRAME):
                s += H[i, o + k] * inverse[k, j]
            share[i, j] = s
    for i in range(size):
        if o <= i < m:
            continue
        for k in range(FRAME):
            b[i] -= share[i, k] * b[o + k]
        for j in range(i + 1):
            if o <= j < m:
                continue
            s = H[i, j]
            for k in range(FRAME):
                s -= share[i, k] * H[o + k, j]
            H[i, j] = s
            H[j, i] = s


@njit(error_model="numpy", **INSIDE)
def rehost_landmarks(window: Window, work: Work, alive: NDArray[np.uint8], newest: int) -> None:
    """Moves the landmarks of the oldest frame to the newest one if it observes them, else drops them.

    Their observations by the newest frame are not used for the prior.
    """
    marks, c = window.landmarks, window.calibration
    for l in range(len(marks.host)):
        if marks.host[l] == 0:
            if not (alive[l] and marks.seen[l, newest]):
                marks.host[l] = NO_HOST
                marks.seen[l] = 0
                continue
            x, y = ray(c, marks.at[l, 0])
            _, _, depth, before = project(work.views, 0, newest, x, y, marks.inverse_depth[l])
            if marks.rho[l, newest] > 0.0:
                marks.inverse_depth[l], marks.measured[l] = marks.rho[l, newest] / c.scale[0], 1
            elif before:
                marks.inverse_depth[l] = max(depth, LEAST_INVERSE_DEPTH)
            marks.seen[l] = 0
            marks.seen[l, newest] = 1
            marks.host[l] = newest


@njit(error_model="numpy", **INSIDE)
def marginalize_oldest(window: Window, factors: FactorParameters, work: Work, alive: NDArray[np.uint8]) -> None:
    """Marginalises the oldest frame with the landmarks that it hosts; `drop_oldest` then takes it out of the window.

    Each observation is used once: those of these landmarks by the newest frame stay with it, which becomes their host.
    The window holds three frames or more.
    """
    n = window.frames.count[0]
    shared = window.shared
    size = shared + FRAME * n
    work.H[:size, :size] = 0.0
    work.b[:size] = 0.0
    view(window, factors, work.views)
    add_prior(window, size, work.H, work.b)
    add_zero_velocity(window, 0, work.H, work.b)
    add_motion(window, 0, factors, work.H, work.b)
    add_planes(window, factors, 0, work.H, work.b)
    host_depth = factors.host_depth and factors.host_depth_in_prior
    add_camera_factors(window, factors, work.views, work.camera, 1, n - 2, host_depth, work.H, work.b)
    without_oldest(work.H, work.b, shared, size)
    hold(window, work.H, n - 2)
    hold_planes(window, work.H)
    d = errors(window, size)
    d[shared : shared + FRAME] = 0.0
    prior = window.prior
    prior.H[:] = 0.0
    prior.b[:] = 0.0
    for i in range(size - FRAME):
        a = i if i < shared else i + FRAME
        s = work.b[a]
        for j in range(size - FRAME):
            c = j if j < shared else j + FRAME
            prior.H[i, j] = work.H[a, c]
            s += work.H[a, c] * d[c]
        prior.b[i] = s
    rehost_landmarks(window, work, alive, n - 1)


def drop_oldest(window: Window) -> None:
    """Moves every slot one to the front, over the oldest frame."""
    frames, marks = window.frames, window.landmarks
    n = int(frames.count[0])
    for a in (*frames[1:], *window.preintegrations):
        a[: n - 1] = a[1:n]
    planes = window.planes
    for a in (marks.seen, marks.at, marks.rho, planes.seen, planes.measured, planes.weight):
        a[:, : n - 1] = a[:, 1:n]
    marks.seen[:, n - 1] = 0
    planes.seen[:, n - 1] = 0
    marks.host[marks.host > 0] -= 1
    frames.held[n - 1] = 0
    frames.count[0] = n - 1
