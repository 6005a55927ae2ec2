"""Landmarks of the window: predicted observations, camera factors and outliers.

Camera factors do not depend on velocity or bias. Their equations, landmarks eliminated, therefore hold only the
calibration and six columns per frame pose, and are added to those of all states at the end.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.dvio.algebra import REORDERED, mul, rotate, rotate_back
from stridetwin.estimators.dvio.planes import cull_planes
from stridetwin.estimators.dvio.projection import (
    COLUMNS,
    HOST,
    OBSERVATION,
    OBSERVER,
    RESIDUAL,
    Views,
    at_exposure,
    huber,
    observation_jacobian,
    project,
    ray,
    view,
)
from stridetwin.estimators.dvio.state import (
    CALIBRATION,
    D_FOCAL,
    D_SCALE,
    FRAME,
    NO_HOST,
    Calibration,
    FactorParameters,
    Window,
)
from stridetwin.streams.samples import Array

POSE = 6
_LOOSE = 1e-2  # m²; information on an unknown inverse depth: a standard deviation of 10/m
_FIXED = 1e12  # m²; on a fixed one


class CameraEquations(NamedTuple):
    """Normal equations of the observations, M = 10 + 6 F columns, and what is needed to recover the landmarks.

    Attributes:
        H: (M, M) of calibration and poses; the lower triangle counts.
        b: (M,).
        pairs: (F, 22, 24) sums per host and observing frame: products of the Jacobian and, in column 22,
                with the residual.
        own: (L,) information on each inverse depth.
        b_own: (L,).
        cross: (L, M) between landmark and the rest.
        J: (3, 24) buffer for an observation's Jacobian and residual.
        J_own: (3,) buffer for its derivative by the inverse depth.
    """

    H: Array
    b: Array
    pairs: Array
    own: Array
    b_own: Array
    cross: Array
    J: Array
    J_own: Array


def blank_camera_equations(frames: int, landmarks: int) -> CameraEquations:
    """Workspace for F frames and L landmarks."""
    m = CALIBRATION + POSE * frames
    return CameraEquations(
        H=np.zeros((m, m)), b=np.zeros(m), pairs=np.zeros((frames, OBSERVATION, COLUMNS)), own=np.zeros(landmarks),
        b_own=np.zeros(landmarks), cross=np.zeros((landmarks, m)), J=np.zeros((3, COLUMNS)), J_own=np.zeros(3),
    )  # fmt: skip


@njit(fastmath=REORDERED, error_model="numpy", **INSIDE)
def _add(
    window: Window, factors: FactorParameters, views: Views, s: CameraEquations, l: int, last: int, host_depth: bool
) -> float:
    """Adds the observations and measured depths of landmark `l` in frames up to `last`; returns their cost.

    See docs/dvio.md (7)-(9); (8) only if `host_depth`.
    """
    marks, J, Jl = window.landmarks, s.J, s.J_own
    host, xi, scale = marks.host[l], marks.inverse_depth[l], window.calibration.scale[0]
    x, y = ray(window.calibration, marks.at[l, host])
    cross = s.cross[l]
    cross[:] = 0.0
    own, b_own, cost = _LOOSE, 0.0, 0.0
    rho = marks.rho[l, host]
    if rho > 0.0:
        if factors.depth_fixed:
            own += _FIXED
        elif host_depth:
            # The scale applies to the landmark; on the measurement it would lower the cost by shrinking the noise.
            r = scale * xi - rho
            c, w = huber(r * r * factors.depth_weight, factors.depth_limit)
            w *= factors.depth_weight
            cost += c
            own += w * scale * scale
            b_own -= w * scale * r
            cross[D_SCALE] += w * scale * xi
            s.H[D_SCALE, D_SCALE] += w * xi * xi
            s.b[D_SCALE] -= w * xi * r
    first = CALIBRATION + POSE * host
    for j in range(last + 1):
        if j == host or not marks.seen[l, j]:
            continue
        px, py, depth, before = project(views, host, j, x, y, xi)
        if not before or not observation_jacobian(window, views, host, j, x, y, xi, J, Jl):
            continue
        u, v = ray(window.calibration, marks.at[l, j])
        r0, r1, r2, w2 = px - u, py - v, 0.0, 0.0
        J[0, D_FOCAL] -= marks.at[l, j, 0]
        J[1, D_FOCAL + 1] -= marks.at[l, j, 1]
        c, w0 = huber((r0 * r0 + r1 * r1) * factors.pixel_weight, factors.pixel_limit)
        w0 *= factors.pixel_weight
        cost += c
        rho = marks.rho[l, j]
        if factors.projection_depth and rho > 0.0:
            r2 = scale * depth - rho
            c, w = huber(r2 * r2 * factors.later_depth_weight, factors.depth_limit)
            w2 = w * factors.later_depth_weight
            cost += c
            for i in range(OBSERVATION):
                J[2, i] *= scale
            Jl[2] *= scale
            J[2, D_SCALE] = depth
        J[0, RESIDUAL], J[1, RESIDUAL], J[2, RESIDUAL] = r0, r1, r2
        own += w0 * (Jl[0] * Jl[0] + Jl[1] * Jl[1]) + w2 * Jl[2] * Jl[2]
        b_own -= w0 * (Jl[0] * r0 + Jl[1] * r1) + w2 * Jl[2] * r2
        pair = s.pairs[j]
        for a in range(OBSERVATION):
            v0, v1, v2 = w0 * J[0, a], w0 * J[1, a], w2 * J[2, a]
            for e in range(COLUMNS):
                pair[a, e] += v0 * J[0, e] + v1 * J[1, e] + v2 * J[2, e]
        l0, l1, l2 = w0 * Jl[0], w0 * Jl[1], w2 * Jl[2]
        second = CALIBRATION + POSE * j
        for a in range(CALIBRATION):
            cross[a] += l0 * J[0, a] + l1 * J[1, a] + l2 * J[2, a]
        for a in range(POSE):
            i, k = HOST + a, OBSERVER + a
            cross[first + a] += l0 * J[0, i] + l1 * J[1, i] + l2 * J[2, i]
            cross[second + a] += l0 * J[0, k] + l1 * J[1, k] + l2 * J[2, k]
    s.own[l], s.b_own[l] = own, b_own
    return cost


@njit(fastmath=REORDERED, error_model="numpy", **INSIDE)
def _eliminate(s: CameraEquations, l: int, host: int, seen: NDArray[np.uint8], last: int) -> None:
    """Takes a landmark, seen by the frames `seen` (F,), out of the equations. See docs/dvio.md (11)."""
    cross, share = s.cross[l], 1.0 / s.own[l]
    for k in range(-1, last + 1):
        if k >= 0 and k != host and not seen[k]:
            continue
        start = 0 if k < 0 else CALIBRATION + POSE * k
        end = CALIBRATION + POSE * (k + 1)
        for i in range(start, end):
            f = cross[i] * share
            s.b[i] -= f * s.b_own[l]
            row = s.H[i]
            for e in range(end):
                row[e] -= f * cross[e]


@njit(error_model="numpy", **INSIDE)
def _gather(s: CameraEquations, host: int, last: int) -> None:
    """Adds the sums of one host's landmarks to the normal equations."""
    first = CALIBRATION + POSE * host
    for j in range(host + 1, last + 1):
        pair, second = s.pairs[j], CALIBRATION + POSE * j
        for a in range(OBSERVATION):
            i = a
            if a >= HOST:
                i = first + a - HOST
            if a >= OBSERVER:
                i = second + a - OBSERVER
            s.b[i] -= pair[a, RESIDUAL]
            row = s.H[i]
            for e in range(CALIBRATION):
                row[e] += pair[a, e]
            # a host is older than its observing frames, so this fills the lower triangle, and full diagonal blocks
            if a >= HOST:
                for e in range(POSE):
                    row[first + e] += pair[a, HOST + e]
            if a >= OBSERVER:
                for e in range(POSE):
                    row[second + e] += pair[a, OBSERVER + e]


@njit(error_model="numpy", **INSIDE)
def usable(window: Window, l: int, last: int) -> bool:
    """Whether a landmark has a host and is observed by another frame."""
    if window.landmarks.host[l] == NO_HOST or window.landmarks.host[l] > last:
        return False
    others = 0
    for j in range(last + 1):
        others += window.landmarks.seen[l, j] and j != window.landmarks.host[l]
    return others > 0


@njit(error_model="numpy", **INSIDE)
def add_camera_factors(
    window: Window, factors: FactorParameters, views: Views, s: CameraEquations, hosts: int, last: int,
    host_depth: bool, H: Array, b: Array,
) -> float:  # fmt: skip
    """Adds all camera factors of the landmarks of the oldest `hosts` frames and eliminates these; returns the cost.

    H (N, N) and b (N,) are those of all states; of H the lower triangle counts. Observations of frames up to `last` are
    used, and (8) only if `host_depth`.
    """
    m, cost = CALIBRATION + POSE * (last + 1), 0.0
    s.H[:m, :m] = 0.0
    s.b[:m] = 0.0
    for host in range(hosts):
        s.pairs[: last + 1] = 0.0
        for l in range(len(window.landmarks.host)):
            if window.landmarks.host[l] == host and usable(window, l, last):
                cost += _add(window, factors, views, s, l, last, host_depth)
                _eliminate(s, l, host, window.landmarks.seen[l], last)
        _gather(s, host, last)
    for i in range(m):
        row = H[state(i, window.shared)]
        b[state(i, window.shared)] += s.b[i]
        for e in range(CALIBRATION):
            row[e] += s.H[i, e]
        for k in range(last + 1):
            o, q = window.shared + FRAME * k, CALIBRATION + POSE * k
            for e in range(POSE):
                row[o + e] += s.H[i, q + e]
    return cost


@njit(error_model="numpy", **INSIDE)
def state(i: int, shared: int) -> int:
    """Index among all states of the i-th of calibration and poses."""
    if i < CALIBRATION:
        return i
    return shared + FRAME * ((i - CALIBRATION) // POSE) + (i - CALIBRATION) % POSE


@njit(error_model="numpy", **INSIDE)
def _between(R: Array, p: Array, Rh: Array, ph: Array, c: Calibration) -> tuple[Array, Array]:
    """Camera at IMU pose (Rh, ph) to camera at IMU pose (R, p): (3, 3) rotation and (3,) translation, m."""
    Rc = np.ascontiguousarray(c.R.T)
    M = mul(np.ascontiguousarray(R.T), Rh)
    return mul(Rc, mul(M, c.R)), rotate(Rc, rotate(M, c.p) + rotate_back(R, ph - p) - c.p)


@njit(error_model="numpy", **INSIDE)
def predict_observations(
    window: Window, R: Array, p: Array, before: int, expected: Array, start: Array, warp: Array,
    known: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Predicts the observations of the landmarks from a pose, and from the earlier frame in slot `before`.

    Args:
        window: Frames, landmarks, calibration.
        R: (3, 3) world <- IMU.
        p: (3,) m.
        before: Slot.
        expected: (L, 3) out: x and y on the plane at depth 1 by the nominal intrinsics, and inverse depth.
        start: (L, 3) out: the same in the frame `before`.
        warp: (L, 2, 2) out: affine map from the host's image about the landmark to the new one.
        known: (L,) out: 1 where the landmark is in front of the camera in both.
    """
    marks, c, f = window.landmarks, window.calibration, window.frames
    n = f.count[0]
    Rb, pb = at_exposure(f, before, c.offset[0])
    rotation, translation = np.empty((n, 2, 3, 3)), np.empty((n, 2, 3))
    for k in range(n):
        Rh, ph = at_exposure(f, k, c.offset[0])
        rotation[k, 0], translation[k, 0] = _between(R, p, Rh, ph, c)
        rotation[k, 1], translation[k, 1] = _between(Rb, pb, Rh, ph, c)
    for l in range(len(marks.host)):
        known[l] = 0
        h = marks.host[l]
        if h == NO_HOST:
            continue
        x, y = ray(c, marks.at[l, h])
        xi, m = marks.inverse_depth[l], np.array([x, y, 1.0])
        q = rotate(rotation[h, 0], m) + xi * translation[h, 0]
        s = rotate(rotation[h, 1], m) + xi * translation[h, 1]
        if q[2] < 0.05 or s[2] < 0.05:
            continue
        u, v = 1.0 + c.focal[0], 1.0 + c.focal[1]
        expected[l, 0], expected[l, 1], expected[l, 2] = q[0] / q[2] / u, q[1] / q[2] / v, xi / q[2]
        start[l, 0], start[l, 1], start[l, 2] = s[0] / s[2] / u, s[1] / s[2] / v, xi / s[2]
        for j in range(2):
            by = rotation[h, 0, :, j] + translation[h, 0] * marks.slope[l, j]
            for i in range(2):
                warp[l, i, j] = (by[i] - q[i] / q[2] * by[2]) / q[2]
        known[l] = 1


@njit(error_model="numpy", **INSIDE)
def cull(window: Window, factors: FactorParameters, views: Views, most: float, alive: NDArray[np.uint8]) -> int:
    """Removes observations beyond `most` standard deviations; returns the number of remaining ones of the newest frame.

    A landmark that is an outlier in the newest frame is dropped: its `alive` becomes 0. Fills `views`.
    """
    cull_planes(window, factors)
    view(window, factors, views)
    n, marks = window.frames.count[0], window.landmarks
    scale, left = window.calibration.scale[0], 0
    for l in range(len(marks.host)):
        h = marks.host[l]
        if h == NO_HOST:
            continue
        x, y = ray(window.calibration, marks.at[l, h])
        for j in range(n):
            if j == h or not marks.seen[l, j]:
                continue
            px, py, depth, before = project(views, h, j, x, y, marks.inverse_depth[l])
            off = math.inf
            if before:
                u, v = ray(window.calibration, marks.at[l, j])
                off = ((px - u) ** 2 + (py - v) ** 2) * factors.pixel_weight
            if off > most * most:
                marks.seen[l, j] = 0
                if j == n - 1:
                    alive[l] = 0
                continue
            if marks.rho[l, j] > 0.0 and factors.projection_depth:
                r = scale * depth - marks.rho[l, j]
                if r * r * factors.later_depth_weight > most * most:
                    marks.rho[l, j] = 0.0
            if j == n - 1:
                left += 1
    return left


@njit(error_model="numpy", **INSIDE)
def parallax(window: Window, newest: int, since: int) -> tuple[float, int]:
    """Mean motion of points between two frames without rotation, on the plane at depth 1; and their number."""
    marks, c, f = window.landmarks, window.calibration, window.frames
    rotation = mul(np.ascontiguousarray(f.R[newest].T), f.R[since])
    A = mul(np.ascontiguousarray(c.R.T), mul(rotation, c.R))
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
