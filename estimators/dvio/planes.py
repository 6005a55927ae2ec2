"""Floors and walls as states that outlast the window, observed as inverse depths that are linear in the image.

A plane n · X = d of the world is π · (x, y, 1) of inverse depth in a camera, π = n_c / (d − n · p_c). It is a state
from the first keyframe that observes it until its slot is needed. Frames that leave the window leave their information
on the plane in the prior. A floor constrains tilt and height, and a wall the heading, without drift.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.dvio.algebra import mul, rotate, rotate_back
from stridetwin.estimators.dvio.projection import at_exposure, huber
from stridetwin.estimators.dvio.state import (
    CALIBRATION,
    D_ATTITUDE_IC,
    D_FOCAL,
    D_OFFSET,
    D_POSITION_IC,
    D_SCALE,
    FRAME,
    PLANE,
    FactorParameters,
    Window,
)
from stridetwin.streams.samples import Array

# An observation's Jacobian has columns of the calibration, of the plane, and of the observing frame's pose.
_PLANE, _OBSERVER, COLUMNS = CALIBRATION, CALIBRATION + PLANE, CALIBRATION + PLANE + 6


class PlaneWorkspace(NamedTuple):
    """Buffers for an observation.

    Attributes:
        r: (3,) residual.
        J: (3, 19) its Jacobian.
    """

    r: Array
    J: Array


@njit(error_model="numpy", **INSIDE)
def _dot(a: Array, b: Array) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(error_model="numpy", **INSIDE)
def tangent(n: Array) -> Array:
    """(2, 3) unit vectors orthogonal to a unit vector and to each other."""
    k = 0
    for i in range(1, 3):
        if abs(n[i]) < abs(n[k]):
            k = i
    T = np.zeros((2, 3))
    T[0, k] = 1.0
    for i in range(3):
        T[0, i] -= n[k] * n[i]
    size = math.sqrt(_dot(T[0], T[0]))
    for i in range(3):
        T[0, i] /= size
    for i in range(3):
        T[1, i] = n[i - 2] * T[0, i - 1] - n[i - 1] * T[0, i - 2]
    return T


@njit(error_model="numpy", **INSIDE)
def rotate_normal(n: Array, a: float, b: float) -> Array:
    """(3,) unit vector n, moved by a and b along its `tangent`."""
    T = tangent(n)
    m = np.empty(3)
    for i in range(3):
        m[i] = n[i] + a * T[0, i] + b * T[1, i]
    return m / math.sqrt(_dot(m, m))


@njit(error_model="numpy", **INSIDE)
def _in_camera(window: Window, n: Array, d: float, R: Array, p: Array) -> tuple[Array, Array, float]:
    """A plane's normal in the axes of IMU and camera of a pose, and the camera's distance from it."""
    a = rotate_back(R, n)
    c = window.calibration
    away = d - _dot(n, p) - _dot(a, c.p)
    return a, rotate_back(c.R, a), away


@njit(error_model="numpy", **INSIDE)
def plane_residual(
    window: Window, factors: FactorParameters, k: int, j: int, measured: Array, workspace: PlaneWorkspace
) -> bool:
    """Residual of plane k measured in frame j, s L π − π_measured (3,) 1/m, and its Jacobian, into `workspace`.

    s scales the depth, L the focal lengths. False if the camera is not in front of the plane. See docs/dvio.md (12).
    """
    f, c, planes, J = window.frames, window.calibration, window.planes, workspace.J
    focal = (1.0 + c.focal[0], 1.0 + c.focal[1], 1.0)
    R, p = at_exposure(f, j, c.offset[0])
    _, m, away = _in_camera(window, planes.normal[k], planes.distance[k], R, p)
    if away < factors.planes.distance_min_m:
        return False
    for i in range(3):
        workspace.r[i] = c.scale[0] * focal[i] * m[i] / away - measured[i]
    n, d = planes.normal[k], planes.distance[k]
    if factors.first_estimates and planes.held[k]:
        n, d = planes.normal_first[k], planes.distance_first[k]
    if factors.first_estimates and f.held[j]:
        R, p = f.R_first[j], f.p_first[j]
    a, m, away = _in_camera(window, n, d, R, p)
    if away < factors.planes.distance_min_m:
        return False
    T = tangent(n)
    # derivatives of the distance by plane, position and attitude
    by_away = np.zeros(COLUMNS)
    for i in range(2):
        by_away[_PLANE + i] = -_dot(T[i], p) - _dot(rotate_back(R, T[i]), c.p)
    by_away[_PLANE + 2] = 1.0
    for i in range(3):
        by_away[D_POSITION_IC + i] = -a[i]
        by_away[_OBSERVER + i] = -n[i]
        by_away[_OBSERVER + 3 + i] = a[i - 2] * c.p[i - 1] - a[i - 1] * c.p[i - 2]
    J[:] = 0.0
    across = rotate_back(c.R, rotate_back(R, T[0])), rotate_back(c.R, rotate_back(R, T[1]))
    for i in range(3):
        g = c.scale[0] * focal[i] / away
        for e in range(COLUMNS):
            J[i, e] = -g * m[i] / away * by_away[e]
        J[i, _PLANE] += g * across[0][i]
        J[i, _PLANE + 1] += g * across[1][i]
        # [m]x, and Rcᵀ [a]x
        J[i, D_ATTITUDE_IC + (i + 1) % 3] -= g * m[(i + 2) % 3]
        J[i, D_ATTITUDE_IC + (i + 2) % 3] += g * m[(i + 1) % 3]
        for e in range(3):
            J[i, _OBSERVER + 3 + e] += g * (c.R[e - 2, i] * a[e - 1] - c.R[e - 1, i] * a[e - 2])
        J[i, D_SCALE] = focal[i] * m[i] / away
        if i < 2:
            J[i, D_FOCAL + i] = c.scale[0] * m[i] / away
        late = 0.0
        for e in range(3):
            late += J[i, _OBSERVER + e] * f.v[j, e] + J[i, _OBSERVER + 3 + e] * f.rate[j, e]
        J[i, D_OFFSET] = late
    return True


@njit(error_model="numpy", **INSIDE)
def _column(i: int, k: int, j: int, shared: int) -> int:
    """Index among all states of a column of an observation's Jacobian."""
    if i < _PLANE:
        return i
    if i < _OBSERVER:
        return CALIBRATION + PLANE * k + i - _PLANE
    return shared + FRAME * j + i - _OBSERVER


@njit(error_model="numpy", **INSIDE)
def _squared(weight: Array, r: Array) -> float:
    s = 0.0
    for i in range(3):
        for j in range(3):
            s += r[i] * weight[i, j] * r[j]
    return s


@njit(error_model="numpy", **INSIDE)
def add_planes(window: Window, factors: FactorParameters, last: int, H: Array, b: Array) -> float:
    """Adds the plane observations of frames up to `last`; returns the cost."""
    planes, shared, cost = window.planes, window.shared, 0.0
    workspace = PlaneWorkspace(np.empty(3), np.empty((3, COLUMNS)))
    for k in range(len(planes.used)):
        if not planes.used[k]:
            continue
        for j in range(last + 1):
            if not planes.seen[k, j] or not plane_residual(window, factors, k, j, planes.measured[k, j], workspace):
                continue
            W, r, J = planes.weight[k, j], workspace.r, workspace.J
            c, w = huber(_squared(W, r), factors.planes.huber_sd)
            cost += c
            WJ, Wr = mul(W, J), rotate(W, r)
            for e in range(COLUMNS):
                row = H[_column(e, k, j, shared)]
                b[_column(e, k, j, shared)] -= w * (J[0, e] * Wr[0] + J[1, e] * Wr[1] + J[2, e] * Wr[2])
                for i in range(e + 1):
                    row[_column(i, k, j, shared)] += w * (J[0, e] * WJ[0, i] + J[1, e] * WJ[1, i] + J[2, e] * WJ[2, i])
    return cost


@njit(error_model="numpy", **INSIDE)
def cull_planes(window: Window, factors: FactorParameters) -> None:
    """Removes outlier observations of planes."""
    planes = window.planes
    workspace = PlaneWorkspace(np.empty(3), np.empty((3, COLUMNS)))
    for k in range(len(planes.used)):
        for j in range(window.frames.count[0]):
            if planes.used[k] and planes.seen[k, j]:
                fits = plane_residual(window, factors, k, j, planes.measured[k, j], workspace)
                planes.seen[k, j] = fits and _squared(planes.weight[k, j], workspace.r) < factors.planes.gate


@njit(error_model="numpy", **INSIDE)
def _distance2(
    window: Window, factors: FactorParameters, L: Array, k: int, j: int, measured: Array, cover: Array,
    workspace: PlaneWorkspace,
) -> float:  # fmt: skip
    """Squared Mahalanobis distance of a plane measured in frame j from the known plane k; inf if it is far off.

    `L` is the Cholesky factor of the normal equations of all states, `cover` (3, 3) the measurement's covariance.
    """
    if not plane_residual(window, factors, k, j, measured, workspace):
        return math.inf
    c = window.calibration
    expected, p = measured + workspace.r, factors.planes
    size, known = math.sqrt(_dot(measured, measured)), math.sqrt(_dot(expected, expected))
    apart_m = abs(1.0 / size - 1.0 / known) * c.scale[0]
    if _dot(measured, expected) < math.cos(p.match_rad) * size * known or apart_m > p.match_m:
        return math.inf
    shared = window.shared
    n = shared + FRAME * (j + 1)
    Y, S = np.zeros((n, 3)), cover.copy()
    for e in range(COLUMNS):
        for i in range(3):
            Y[_column(e, k, j, shared), i] = workspace.J[i, e]
    for a in range(n):
        row = L[a]
        for i in range(3):
            s = Y[a, i]
            for e in range(a):
                s -= row[e] * Y[e, i]
            Y[a, i] = s / row[a]
    for a in range(n):
        for i in range(3):
            for e in range(3):
                S[i, e] += Y[a, i] * Y[a, e]
    return _squared(np.linalg.inv(S), workspace.r)


@njit(error_model="numpy", **INSIDE)
def match_planes(
    window: Window, factors: FactorParameters, L: Array, measured: Array, weights: Array, count: int, new: Array
) -> int:
    """Associates planes measured in the newest frame with known ones; returns the number without a match.

    `measured` (P, 3) 1/m and `weights` (P, 3, 3) are as of `read_planes`, `L` as of `_distance2`. The indices of those
    without a match are written to `new` (P,).
    """
    planes, j, unmatched = window.planes, window.frames.count[0] - 1, 0
    workspace = PlaneWorkspace(np.empty(3), np.empty((3, COLUMNS)))
    planes.seen[:, j] = 0
    for i in range(count):
        best, least, cover = -1, factors.planes.gate, np.linalg.inv(weights[i])
        twice = False
        for k in range(len(planes.used)):
            if not planes.used[k]:
                continue
            chi = _distance2(window, factors, L, k, j, measured[i], cover, workspace)
            if chi < least:
                best, least, twice = k, chi, planes.seen[k, j] > 0
        if best < 0:
            new[unmatched] = i
            unmatched += 1
        elif not twice:
            planes.seen[best, j] = 1
            planes.measured[best, j] = measured[i]
            planes.weight[best, j] = weights[i]
            planes.seen_ns[best] = window.frames.t_ns[j]
    return unmatched


@njit(error_model="numpy", **INSIDE)
def add_plane(window: Window, k: int, measured: Array, weight: Array) -> None:
    """Adds a new plane in slot `k` as measured in the newest frame: (3,) 1/m and (3, 3) inverse covariance."""
    f, c, planes = window.frames, window.calibration, window.planes
    j = f.count[0] - 1
    R, p = at_exposure(f, j, c.offset[0])
    m = np.empty(3)
    for i in range(3):
        m[i] = measured[i] / (c.scale[0] * (1.0 + c.focal[i] if i < 2 else 1.0))
    away = 1.0 / math.sqrt(_dot(m, m))
    n = rotate(R, rotate(c.R, m * away))
    p = p + rotate(R, c.p)
    planes.used[k], planes.held[k] = 1, 0
    planes.normal[k], planes.distance[k] = n, away + _dot(n, p)
    planes.moved[k] = 0.0
    planes.seen[k] = 0
    planes.seen[k, j], planes.measured[k, j], planes.weight[k, j] = 1, measured, weight
    planes.seen_ns[k] = f.t_ns[j]


@njit(error_model="numpy", **INSIDE)
def move_planes(window: Window, step: Array) -> None:
    """Applies a step (N,) of all states."""
    planes = window.planes
    for k in range(len(planes.used)):
        if not planes.used[k]:
            continue
        e = step[CALIBRATION + PLANE * k : CALIBRATION + PLANE * (k + 1)]
        if planes.held[k]:
            m = planes.moved[k]
            m += e
            planes.normal[k] = rotate_normal(planes.normal_first[k], m[0], m[1])
            planes.distance[k] = planes.distance_first[k] + m[2]
        else:
            planes.normal[k] = rotate_normal(planes.normal[k], e[0], e[1])
            planes.distance[k] += e[2]


@njit(error_model="numpy", **INSIDE)
def hold_planes(window: Window, H: Array) -> None:
    """Marks the planes in the prior H: their Jacobians stay at the first linearisation point from now on."""
    planes = window.planes
    for k in range(len(planes.used)):
        o = CALIBRATION + PLANE * k
        if planes.used[k] and not planes.held[k] and H[o, o] > 0.0:
            planes.held[k] = 1
            planes.normal_first[k], planes.distance_first[k] = planes.normal[k], planes.distance[k]
            planes.moved[k] = 0.0


def free_slot(window: Window) -> int | None:
    """A slot for a new plane, if need be that of the one unseen for longest; None if all are observed."""
    planes, n = window.planes, int(window.frames.count[0])
    unseen = ~planes.seen[:, :n].any(axis=1)
    # A plane that neither the prior nor any frame contains carries no information.
    planes.used[unseen & (planes.held == 0)] = 0
    free = np.flatnonzero(planes.used == 0)
    if len(free):
        return int(free[0])
    gone = np.flatnonzero(unseen)
    if not len(gone):
        return None
    k = int(gone[np.argmin(planes.seen_ns[gone])])
    marginalize_plane(window, k)
    return k


def marginalize_plane(window: Window, k: int) -> None:
    """Marginalises a plane that no frame of the window observes out of the prior."""
    planes, H, b = window.planes, window.prior.H, window.prior.b
    own = slice(CALIBRATION + PLANE * k, CALIBRATION + PLANE * (k + 1))
    if planes.held[k]:
        share = H[:, own] @ np.linalg.inv(H[own, own])
        b -= share @ b[own]
        H -= share @ H[own]
    H[own], H[:, own], b[own] = 0.0, 0.0, 0.0
    planes.used[k] = planes.held[k] = 0
    planes.seen[k] = 0
