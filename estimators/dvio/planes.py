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
from numpy.typing import NDArray

from stridetwin.estimators.compiled import INSIDE
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
    Calibration,
    FactorParameters,
    Frames,
    PlaneParameters,
    Planes,
    Window,
)
from stridetwin.estimators.matrices import copy, copy_matrix, dot, inverse, mat3, mul, rotate, rotate_back, vec3
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


def blank_plane_workspace() -> PlaneWorkspace:
    """Buffers to be filled."""
    return PlaneWorkspace(r=np.empty(3), J=np.empty((3, COLUMNS)))


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
    size = math.sqrt(dot(T[0], T[0]))
    for i in range(3):
        T[0, i] /= size
    for i in range(3):
        T[1, i] = n[i - 2] * T[0, i - 1] - n[i - 1] * T[0, i - 2]
    return T


@njit(error_model="numpy", **INSIDE)
def rotate_normal(n: Array, a: float, b: float) -> Array:
    """(3,) unit vector n, moved by a and b along its `tangent`."""
    T, m = tangent(n), vec3()
    for i in range(3):
        m[i] = n[i] + a * T[0, i] + b * T[1, i]
    size = math.sqrt(dot(m, m))
    for i in range(3):
        m[i] /= size
    return m


@njit(error_model="numpy", **INSIDE)
def plane_residual(
    f: Frames, c: Calibration, planes: Planes, factors: FactorParameters, k: int, j: int, measured: Array,
    workspace: PlaneWorkspace,
) -> bool:  # fmt: skip
    """Residual of plane k measured in frame j, s L π − π_measured (3,) 1/m, and its Jacobian, into `workspace`.

    s scales the depth, L the focal lengths. False if the camera is not in front of the plane. See docs/dvio.md (12).
    """
    J, focal, first, scale = workspace.J, vec3(), factors.first_estimates, c.scale[0]
    focal[0] = 1.0 + c.focal[0]
    focal[1] = 1.0 + c.focal[1]
    focal[2] = 1.0
    R, p = at_exposure(f, j, c.offset[0])
    n, d = planes.normal[k], planes.distance[k]
    a = rotate_back(R, n)  # the normal in the axes of the IMU, then of the camera
    m, away = rotate_back(c.R, a), d - dot(n, p) - dot(a, c.p)
    if away < factors.planes.distance_min_m:
        return False
    for i in range(3):
        workspace.r[i] = scale * focal[i] * m[i] / away - measured[i]
    if first and planes.held[k]:
        n, d = planes.normal_first[k], planes.distance_first[k]
    if first and f.held[j]:
        R, p = f.R_first[j], f.p_first[j]
    a = rotate_back(R, n)
    m, away = rotate_back(c.R, a), d - dot(n, p) - dot(a, c.p)
    if away < factors.planes.distance_min_m:
        return False
    # derivatives of the distance by plane, position and attitude
    T, by_away, across = tangent(n), np.zeros(COLUMNS), np.empty((2, 3))
    for i in range(2):
        of_tangent = rotate_back(R, T[i])
        by_away[_PLANE + i] = -dot(T[i], p) - dot(of_tangent, c.p)
        copy(rotate_back(c.R, of_tangent), across[i])
    by_away[_PLANE + 2] = 1.0
    for i in range(3):
        by_away[D_POSITION_IC + i] = -a[i]
        by_away[_OBSERVER + i] = -n[i]
        by_away[_OBSERVER + 3 + i] = a[i - 2] * c.p[i - 1] - a[i - 1] * c.p[i - 2]
    J[:] = 0.0
    for i in range(3):
        g = scale * focal[i] / away
        for e in range(COLUMNS):
            J[i, e] = -g * m[i] / away * by_away[e]
        J[i, _PLANE] += g * across[0, i]
        J[i, _PLANE + 1] += g * across[1, i]
        # [m]x, and Rcᵀ [a]x
        J[i, D_ATTITUDE_IC + (i + 1) % 3] -= g * m[(i + 2) % 3]
        J[i, D_ATTITUDE_IC + (i + 2) % 3] += g * m[(i + 1) % 3]
        for e in range(3):
            J[i, _OBSERVER + 3 + e] += g * (c.R[e - 2, i] * a[e - 1] - c.R[e - 1, i] * a[e - 2])
        J[i, D_SCALE] = focal[i] * m[i] / away
        if i < 2:
            J[i, D_FOCAL + i] = scale * m[i] / away
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
def add_planes(
    window: Window, factors: FactorParameters, workspace: PlaneWorkspace, frames: int, H: Array, b: Array
) -> float:
    """Adds the plane observations of the oldest `frames`; returns the cost."""
    f, c, planes, shared, cost = window.frames, window.calibration, window.planes, window.shared, 0.0
    r, J = workspace.r, workspace.J
    for k in range(planes.used.shape[0]):
        for j in range(frames):
            if not planes.used[k] or not planes.seen[k, j]:
                continue
            if not plane_residual(f, c, planes, factors, k, j, planes.measured[k, j], workspace):
                continue
            W = planes.weight[k, j]
            part, w = huber(_squared(W, r), factors.planes.huber_sd)
            cost += part
            WJ, Wr = mul(W, J), rotate(W, r)
            for e in range(COLUMNS):
                at = _column(e, k, j, shared)
                row = H[at]
                b[at] -= w * (J[0, e] * Wr[0] + J[1, e] * Wr[1] + J[2, e] * Wr[2])
                for i in range(e + 1):
                    row[_column(i, k, j, shared)] += w * (J[0, e] * WJ[0, i] + J[1, e] * WJ[1, i] + J[2, e] * WJ[2, i])
    return cost


@njit(error_model="numpy", **INSIDE)
def cull_planes(
    f: Frames, c: Calibration, planes: Planes, factors: FactorParameters, workspace: PlaneWorkspace
) -> None:
    """Removes outlier observations of planes."""
    for k in range(planes.used.shape[0]):
        for j in range(f.count[0]):
            if planes.used[k] and planes.seen[k, j]:
                fits = plane_residual(f, c, planes, factors, k, j, planes.measured[k, j], workspace)
                planes.seen[k, j] = fits and _squared(planes.weight[k, j], workspace.r) < factors.planes.gate


@njit(error_model="numpy", **INSIDE)
def _apart(measured: Array, r: Array, p: PlaneParameters, scale: float) -> bool:
    """Whether a measured plane is far off the known one of residual `r`, in direction or distance."""
    expected = vec3()
    for i in range(3):
        expected[i] = measured[i] + r[i]
    size, known = math.sqrt(dot(measured, measured)), math.sqrt(dot(expected, expected))
    apart_m = abs(1.0 / size - 1.0 / known) * scale
    return dot(measured, expected) < math.cos(p.match_rad) * size * known or apart_m > p.match_m


@njit(error_model="numpy", **INSIDE)
def _distance2(workspace: PlaneWorkspace, L: Array, k: int, j: int, shared: int, cover: Array) -> float:
    """Squared Mahalanobis distance of a plane measured in frame j from the known plane k, from its residual.

    `L` is the Cholesky factor of the normal equations of all states, `cover` (3, 3) the measurement's covariance.
    """
    n = shared + FRAME * (j + 1)
    Y, S = np.zeros((n, 3)), mat3()
    copy_matrix(cover, S)
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
    return _squared(inverse(S), workspace.r)


@njit(error_model="numpy", **INSIDE)
def match_planes(
    f: Frames, c: Calibration, planes: Planes, factors: FactorParameters, workspace: PlaneWorkspace, L: Array,
    measured: Array, weights: Array, count: int, new: NDArray[np.int64],
) -> int:  # fmt: skip
    """Associates planes measured in the newest frame with known ones; returns the number without a match.

    `measured` (P, 3) 1/m and `weights` (P, 3, 3) are as of `read_planes`, `L` as of `_distance2`. The indices of those
    without a match are written to `new` (P,).
    """
    j, shared, slots, unmatched = f.count[0] - 1, CALIBRATION + PLANE * planes.used.shape[0], planes.used.shape[0], 0
    for k in range(slots):
        planes.seen[k, j] = 0
    for i in range(count):
        best, least, cover = -1, factors.planes.gate, inverse(weights[i])
        twice = False
        for k in range(slots):
            if not planes.used[k] or not plane_residual(f, c, planes, factors, k, j, measured[i], workspace):
                continue
            if _apart(measured[i], workspace.r, factors.planes, c.scale[0]):
                continue
            chi = _distance2(workspace, L, k, j, shared, cover)
            if chi < least:
                best, least, twice = k, chi, planes.seen[k, j] > 0
        if best < 0:
            new[unmatched] = i
            unmatched += 1
        elif not twice:
            planes.seen[best, j] = 1
            copy(measured[i], planes.measured[best, j])
            copy_matrix(weights[i], planes.weight[best, j])
            planes.seen_ns[best] = f.t_ns[j]
    return unmatched


@njit(error_model="numpy", **INSIDE)
def add_plane(f: Frames, c: Calibration, planes: Planes, k: int, measured: Array, weight: Array) -> None:
    """Adds a new plane in slot `k` as measured in the newest frame: (3,) 1/m and (3, 3) inverse covariance."""
    j = f.count[0] - 1
    R, p = at_exposure(f, j, c.offset[0])
    m = vec3()
    for i in range(3):
        m[i] = measured[i] / (c.scale[0] * (1.0 + c.focal[i] if i < 2 else 1.0))
    away = 1.0 / math.sqrt(dot(m, m))
    for i in range(3):
        m[i] *= away
    n, mounted = rotate(R, rotate(c.R, m)), rotate(R, c.p)
    for i in range(3):
        p[i] += mounted[i]
        planes.moved[k, i] = 0.0
    planes.used[k] = 1
    planes.held[k] = 0
    copy(n, planes.normal[k])
    planes.distance[k] = away + dot(n, p)
    for i in range(planes.seen.shape[1]):
        planes.seen[k, i] = 0
    planes.seen[k, j] = 1
    copy(measured, planes.measured[k, j])
    copy_matrix(weight, planes.weight[k, j])
    planes.seen_ns[k] = f.t_ns[j]


@njit(error_model="numpy", **INSIDE)
def move_planes(planes: Planes, step: Array) -> None:
    """Applies a step (N,) of all states."""
    for k in range(planes.used.shape[0]):
        if not planes.used[k]:
            continue
        e = step[CALIBRATION + PLANE * k : CALIBRATION + PLANE * (k + 1)]
        if planes.held[k]:
            m = planes.moved[k]
            for i in range(PLANE):
                m[i] += e[i]
            copy(rotate_normal(planes.normal_first[k], m[0], m[1]), planes.normal[k])
            planes.distance[k] = planes.distance_first[k] + m[2]
        else:
            copy(rotate_normal(planes.normal[k], e[0], e[1]), planes.normal[k])
            planes.distance[k] += e[2]


def hold_planes(planes: Planes, H: Array) -> None:
    """Marks the planes in the prior H: their Jacobians stay at the first linearisation point from now on."""
    for k in np.flatnonzero((planes.used > 0) & (planes.held == 0)):
        o = CALIBRATION + PLANE * k
        if H[o, o] > 0.0:
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
