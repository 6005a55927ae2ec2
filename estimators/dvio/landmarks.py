"""Camera factors: normal equations of all observations and measured depths, with landmarks eliminated.

Camera factors do not depend on velocity or bias. Their equations therefore hold only the calibration and six columns
per frame pose, and are added to those of all states at the end.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.dvio.algebra import REORDERED
from stridetwin.estimators.dvio.projection import (
    COLUMNS,
    HOST,
    OBSERVATION,
    OBSERVER,
    RESIDUAL,
    Views,
    huber,
    observation_jacobian,
    project,
    ray,
)
from stridetwin.estimators.dvio.state import CALIBRATION, D_FOCAL, D_SCALE, FRAME, NO_HOST, FactorParameters, Window
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
    """Adds the observations (10) and measured depths (13), (14) of a landmark; returns their cost.

    See docs/dvio.md (7)-(9).

    Args:
        window: Frames and landmarks.
        factors: Which factors there are.
        views: Of the frames.
        s: Sums per observing frame, and the landmark's own row.
        l: Slot of the landmark.
        last: Slot of the last frame whose observations count.
        host_depth: Whether (11) is used.
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
    """Takes a landmark out of the normal equations (Schur complement).

    See docs/dvio.md (11).

    Args:
        s: H and b are changed.
        l: Its slot.
        host: Slot of its host.
        seen: (F,) frames that observe it.
        last: Slot of the last frame that counts.
    """
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
    window: Window,
    factors: FactorParameters,
    views: Views,
    s: CameraEquations,
    hosts: int,
    last: int,
    host_depth: bool,
    H: Array,
    b: Array,
) -> float:
    """Adds all camera factors of the landmarks of some hosts and eliminates these landmarks; returns the cost.

    Args:
        window: Frames and landmarks.
        factors: Which factors there are.
        views: Of the frames.
        s: Workspace.
        hosts: Number of oldest frames whose landmarks count.
        last: Slot of the last frame whose observations count.
        host_depth: Whether (11) is used.
        H: (N, N) of all states, changed; the lower triangle counts.
        b: (N,) changed.
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
