"""What cameras see: where a landmark lies in a picture, its residuals and their Jacobians."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from stridetwin.estimators.dvio.algebra import exponential, mul, rotate, rotate_back, skew
from stridetwin.estimators.dvio.memory import CALIBRATION, D_LENS, D_OFFSET, Calibration, Frames, Window
from stridetwin.estimators.dvio.terms import Terms
from stridetwin.streams.samples import Array

SIGHT = CALIBRATION + 12  # columns of a sighting's Jacobian: calibration, host's pose, seer's pose
_LEAST_DEPTH = 1e-3  # of a point before the camera, over the host's depth


class Views(NamedTuple):
    """Cameras of the window's frames, now and where Jacobians are taken, and from each to each other.

    Attributes:
        turn: (F, F, 3, 3) seer's camera <- host's camera.
        shift: (F, F, 3) host's camera in the seer's.
        turn_first: As `turn`, where Jacobians are taken.
        shift_first: As `shift`.
        C: (F, 3, 3) camera <- world, where Jacobians are taken.
        CR: (F, F, 3, 3) seer's camera <- host's IMU, likewise.
        between: (F, F, 3) from the seer's IMU to the host's, seer's IMU axes, likewise.
    """

    turn: Array
    shift: Array
    turn_first: Array
    shift_first: Array
    C: Array
    CR: Array
    between: Array


def blank_views(frames: int) -> Views:
    """Views of F frames, to be filled."""
    F = frames
    pair, vector = (F, F, 3, 3), (F, F, 3)
    return Views(
        turn=np.zeros(pair), shift=np.zeros(vector), turn_first=np.zeros(pair), shift_first=np.zeros(vector),
        C=np.zeros((F, 3, 3)), CR=np.zeros(pair), between=np.zeros(vector),
    )  # fmt: skip


@njit(error_model="numpy")
def at_exposure(frames: Frames, k: int, offset: float) -> tuple[Array, Array]:
    """Pose of a frame's IMU when its picture was taken, by what the time offset is believed to be now.

    Args:
        frames: Of the window.
        k: Slot.
        offset: s.

    Returns:
        (3, 3) world <- IMU and (3,) m.
    """
    late = offset - frames.offset[k]
    R = mul(frames.R[k], exponential(frames.rate[k] * late))
    return R, frames.p[k] + frames.v[k] * late


@njit(error_model="numpy")
def view(window: Window, terms: Terms, views: Views) -> None:
    """Fills the views of all frames."""
    frames, c = window.frames, window.calibration
    n = frames.count[0]
    Rc = np.ascontiguousarray(c.R.T)
    R, p = np.empty((n, 3, 3)), np.empty((n, 3))
    R0, p0 = np.empty((n, 3, 3)), np.empty((n, 3))
    for k in range(n):
        Rk, pk = at_exposure(frames, k, c.offset[0])
        R[k], p[k] = Rk, pk
        first = terms.first_estimates and frames.held[k]
        R0[k] = frames.R_first[k] if first else Rk
        p0[k] = frames.p_first[k] if first else pk
        views.C[k] = mul(Rc, np.ascontiguousarray(R0[k].T))
    for i in range(n):
        for j in range(n):
            M = mul(np.ascontiguousarray(R[j].T), R[i])
            moved = rotate_back(R[j], p[i] - p[j])
            views.turn[i, j] = mul(Rc, mul(M, c.R))
            views.shift[i, j] = rotate(Rc, rotate(M, c.p) + moved - c.p)
            M = mul(np.ascontiguousarray(R0[j].T), R0[i])
            moved = rotate_back(R0[j], p0[i] - p0[j])
            views.CR[i, j] = mul(Rc, M)
            views.between[i, j] = moved
            views.turn_first[i, j] = mul(views.CR[i, j], c.R)
            views.shift_first[i, j] = rotate(Rc, rotate(M, c.p) + moved - c.p)


@njit(error_model="numpy")
def ray(calibration: Calibration, at: Array) -> tuple[float, float]:
    """Where a sighting (2,) lies on the plane at depth 1, by what the focal lengths are believed to be."""
    return at[0] * (1.0 + calibration.lens[0]), at[1] * (1.0 + calibration.lens[1])


@njit(error_model="numpy")
def seen_at(views: Views, host: int, seer: int, x: float, y: float, inverse_depth: float) -> tuple[Array, bool]:
    """Where a landmark is seen, as (8), with the division by the depth that (1) has.

    Args:
        views: Of the frames.
        host: Slot of the frame in whose camera the landmark lies along (x, y, 1).
        seer: Slot of the frame that sees it.
        x: On the plane at depth 1.
        y: On it.
        inverse_depth: In the host's camera, 1/m.

    Returns:
        (3,) x and y on the plane at depth 1 and inverse depth in the seer's camera, and whether it lies before it.
    """
    A, s = views.turn[host, seer], views.shift[host, seer]
    q = np.empty(3)
    for i in range(3):
        q[i] = A[i, 0] * x + A[i, 1] * y + A[i, 2] + inverse_depth * s[i]
    if q[2] < _LEAST_DEPTH:
        return q, False
    return np.array([q[0] / q[2], q[1] / q[2], inverse_depth / q[2]]), True


@njit(error_model="numpy")
def sight(
    window: Window, views: Views, host: int, seer: int, x: float, y: float, inverse_depth: float, J: Array, Jl: Array
) -> bool:
    """Jacobians of what `seen_at` gives.

    Args:
        window: Frames and calibration.
        views: Of the frames.
        host: Slot.
        seer: Slot, another one.
        x: As of `seen_at`.
        y: As of `seen_at`.
        inverse_depth: As of `seen_at`.
        J: (3, 22) out: by calibration, host's pose and seer's pose.
        Jl: (3,) out: by the inverse depth.

    Returns:
        False where the landmark is not before the camera; then nothing is written.
    """
    frames, c = window.frames, window.calibration
    A, s = views.turn_first[host, seer], views.shift_first[host, seer]
    q = np.empty(3)
    for i in range(3):
        q[i] = A[i, 0] * x + A[i, 1] * y + A[i, 2] + inverse_depth * s[i]
    if q[2] < _LEAST_DEPTH:
        return False
    C, CR = views.C[seer], views.CR[host, seer]
    m = np.array([x, y, 1.0])
    in_host = rotate(c.R, m) + inverse_depth * c.p  # of the point times its inverse depth, host's IMU axes
    G = np.zeros((3, SIGHT))
    Q = skew(q)
    turn_m = mul(A, skew(m))
    by_host = mul(CR, skew(in_host))
    # In the seer's IMU: z = Rc q + ξ p; Rcᵀ [z]x = [q + ξ Rcᵀ p]x Rcᵀ
    lever = rotate_back(c.R, c.p) * inverse_depth
    by_seer = mul(skew(q + lever), np.ascontiguousarray(c.R.T))
    a, b = CALIBRATION, CALIBRATION + 6
    for i in range(3):
        for j in range(3):
            G[i, j] = inverse_depth * (CR[i, j] - c.R[j, i])
            G[i, 3 + j] = Q[i, j] - turn_m[i, j]
            G[i, a + j] = inverse_depth * C[i, j]
            G[i, a + 3 + j] = -by_host[i, j]
            G[i, b + j] = -inverse_depth * C[i, j]
            G[i, b + 3 + j] = by_seer[i, j]
    for i in range(3):
        late = 0.0
        for j in range(3):
            late += G[i, a + j] * frames.v[host, j] + G[i, a + 3 + j] * frames.rate[host, j]
            late += G[i, b + j] * frames.v[seer, j] + G[i, b + 3 + j] * frames.rate[seer, j]
        G[i, D_OFFSET] = late
        G[i, D_LENS] = A[i, 0] * x / (1.0 + c.lens[0])
        G[i, D_LENS + 1] = A[i, 1] * y / (1.0 + c.lens[1])
    w = 1.0 / q[2]
    px, py, pz = q[0] * w, q[1] * w, inverse_depth * w
    for j in range(SIGHT):
        g = G[2, j] * w
        J[0, j] = G[0, j] * w - px * g
        J[1, j] = G[1, j] * w - py * g
        J[2, j] = -pz * g
    Jl[0] = (s[0] - px * s[2]) * w
    Jl[1] = (s[1] - py * s[2]) * w
    Jl[2] = (1.0 - pz * s[2]) * w
    return True


@njit(error_model="numpy")
def huber(squared: float, limit: float) -> tuple[float, float]:
    """Cost and weight of a residual of so many standard deviations, squared."""
    if squared <= limit * limit:
        return 0.5 * squared, 1.0
    size = math.sqrt(squared)
    return limit * (size - 0.5 * limit), limit / size
