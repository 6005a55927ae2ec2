"""The window's factors: residuals and their Jacobians, added to the normal equations H d = b."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from stridetwin.estimators.dvio.algebra import (
    exponential,
    logarithm,
    mul,
    right_jacobian,
    right_jacobian_inverse,
    rotate,
    rotate_back,
    skew,
)
from stridetwin.estimators.dvio.memory import (
    CALIBRATION,
    D_ATTITUDE,
    D_GYRO_BIAS,
    D_LENS,
    D_OFFSET,
    D_POSITION,
    D_VELOCITY,
    FRAME,
    Calibration,
    Frames,
    Increment,
    Window,
)
from stridetwin.streams.samples import Array

SIGHT = CALIBRATION + 12  # columns of a sighting's Jacobian: calibration, host's pose, seer's pose
_LEAST_DEPTH = 1e-3  # of a point before the camera, over the host's depth


class Terms(NamedTuple):
    """What the factors believe, and which of them there are.

    Attributes:
        gravity: m/s².
        sight_weight: 1 / variance of a sighting on the plane at depth 1.
        sight_limit: Sightings further off than this many standard deviations count less (Huber).
        depth_weight: 1 / variance of an inverse depth that the host is told, m².
        again_weight: The same of one that another frame is told.
        depth_limit: As `sight_limit`.
        host_depth: (11) is there.
        depth_fixed: A landmark keeps the depth that the host was told.
        projection_depth: (12) is there.
        host_depth_in_prior: (11) goes into the prior as well.
        first_estimates: Jacobians of frames that the prior speaks of are taken at their first estimates.
        rate_walk: Of the gyroscope's bias, rad/s²/√Hz.
        force_walk: Of the accelerometer's bias, m/s³/√Hz.
    """

    gravity: float
    sight_weight: float
    sight_limit: float
    depth_weight: float
    again_weight: float
    depth_limit: float
    host_depth: bool
    depth_fixed: bool
    projection_depth: bool
    host_depth_in_prior: bool
    first_estimates: bool
    rate_walk: float
    force_walk: float


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


@njit(error_model="numpy")
def motion(frames: Frames, z: Increment, k: int, terms: Terms, r: Array, J: Array, first: bool) -> None:
    """IMU residual (7) from frame k to the next and its Jacobian.

    Args:
        frames: Of the window.
        z: The increment between the two.
        k: Slot.
        terms: Gravity.
        r: (9,) out: position, rotation, velocity.
        J: (9, 30) out: by the states of both, with the residual's rotation where it is now.
        first: Whether Jacobians are taken at first estimates.
    """
    dt = z.dt[0]
    Ri, Rj = frames.R[k], frames.R[k + 1]
    g = np.array([0.0, 0.0, -terms.gravity])
    off = frames.bias[k] - z.bias
    moved = np.zeros(9)
    for i in range(9):
        for j in range(6):
            moved[i] += z.by_bias[i, j] * off[j]
    turned = moved[3:6].copy()
    p = rotate_back(Ri, frames.p[k + 1] - frames.p[k] - frames.v[k] * dt - 0.5 * g * dt * dt)
    v = rotate_back(Ri, frames.v[k + 1] - frames.v[k] - g * dt)
    expected = mul(z.gamma, exponential(turned))
    M = mul(np.ascontiguousarray(Ri.T), Rj)
    e = logarithm(mul(np.ascontiguousarray(expected.T), M))
    for i in range(3):
        r[i] = p[i] - z.alpha[i] - moved[i]
        r[3 + i] = e[i]
        r[6 + i] = v[i] - z.beta[i] - moved[6 + i]
    Ri0, Rj0 = Ri, Rj
    pi, vi, pj, vj = frames.p[k], frames.v[k], frames.p[k + 1], frames.v[k + 1]
    if first and frames.held[k]:
        Ri0, pi, vi = frames.R_first[k], frames.p_first[k], frames.v_first[k]
    if first and frames.held[k + 1]:
        Rj0, pj, vj = frames.R_first[k + 1], frames.p_first[k + 1], frames.v_first[k + 1]
    p = rotate_back(Ri0, pj - pi - vi * dt - 0.5 * g * dt * dt)
    v = rotate_back(Ri0, vj - vi - g * dt)
    back = np.ascontiguousarray(Ri0.T)
    inverse = right_jacobian_inverse(e)
    by_turn = mul(inverse, mul(np.ascontiguousarray(Rj0.T), Ri0))
    P, V = skew(p), skew(v)
    # Log(Exp(-Jr(turned) B db) E) of E = Exp(e)
    by_bias = mul(inverse, mul(np.ascontiguousarray(exponential(e).T), right_jacobian(turned)))
    B = mul(by_bias, np.ascontiguousarray(z.by_bias[3:6]))
    J[:] = 0.0
    n = FRAME
    for i in range(3):
        for j in range(3):
            J[i, D_POSITION + j] = -back[i, j]
            J[i, D_ATTITUDE + j] = P[i, j]
            J[i, D_VELOCITY + j] = -back[i, j] * dt
            J[i, n + D_POSITION + j] = back[i, j]
            J[3 + i, D_ATTITUDE + j] = -by_turn[i, j]
            J[3 + i, n + D_ATTITUDE + j] = inverse[i, j]
            J[6 + i, D_ATTITUDE + j] = V[i, j]
            J[6 + i, D_VELOCITY + j] = -back[i, j]
            J[6 + i, n + D_VELOCITY + j] = back[i, j]
        for j in range(6):
            J[i, D_GYRO_BIAS + j] = -z.by_bias[i, j]
            J[3 + i, D_GYRO_BIAS + j] = -B[i, j]
            J[6 + i, D_GYRO_BIAS + j] = -z.by_bias[6 + i, j]


@njit(error_model="numpy")
def add_motion(window: Window, k: int, terms: Terms, H: Array, b: Array) -> float:
    """Adds the IMU factor (9) from frame k to the next, with the walk of its biases; returns its cost."""
    frames, zs = window.frames, window.increments
    z = Increment(zs.dt[k], zs.alpha[k], zs.gamma[k], zs.beta[k], zs.by_bias[k], zs.covariance[k], zs.bias[k])
    r, J = np.empty(9), np.empty((9, 2 * FRAME))
    motion(frames, z, k, terms, r, J, terms.first_estimates)
    weight = np.linalg.inv(z.covariance)
    WJ = mul(weight, J)  # type: ignore[arg-type]
    o = CALIBRATION + FRAME * k
    cost = 0.0
    for i in range(9):
        wr = 0.0
        for j in range(9):
            wr += weight[i, j] * r[j]
        cost += 0.5 * r[i] * wr
    for a in range(2 * FRAME):
        for c in range(a + 1):
            h = 0.0
            for i in range(9):
                h += J[i, a] * WJ[i, c]
            H[o + a, o + c] += h
        g = 0.0
        for i in range(9):
            g += WJ[i, a] * r[i]
        b[o + a] -= g
    dt = z.dt[0]
    for i in range(6):
        walk = terms.rate_walk if i < 3 else terms.force_walk
        w = 1.0 / (walk * walk * dt)
        step = frames.bias[k + 1, i] - frames.bias[k, i]
        at = o + D_GYRO_BIAS + i
        H[at, at] += w
        H[at + FRAME, at + FRAME] += w
        H[at + FRAME, at] -= w
        b[at] += w * step
        b[at + FRAME] -= w * step
        cost += 0.5 * w * step * step
    return cost


@njit(error_model="numpy")
def add_standing(frames: Frames, k: int, H: Array, b: Array) -> float:
    """Adds the zero velocity of a frame that is known to stand; returns its cost."""
    if not math.isfinite(frames.still_sd[k]):
        return 0.0
    w, cost = 1.0 / frames.still_sd[k] ** 2, 0.0
    for i in range(3):
        at = CALIBRATION + FRAME * k + D_VELOCITY + i
        H[at, at] += w
        b[at] -= w * frames.v[k, i]
        cost += 0.5 * w * frames.v[k, i] ** 2
    return cost


@njit(error_model="numpy")
def add_prior(window: Window, size: int, H: Array, b: Array) -> float:
    """Adds the prior (6) of the first `size` states; returns its cost, up to a constant."""
    d = errors(window, size)
    cost, P = 0.0, window.prior
    for i in range(size):
        h = 0.0
        for j in range(size):
            h += P.H[i, j] * d[j]
        b[i] += P.b[i] - h
        cost += d[i] * (0.5 * h - P.b[i])
        for j in range(i + 1):
            H[i, j] += P.H[i, j]
    return cost


@njit(error_model="numpy")
def errors(window: Window, size: int) -> Array:
    """(size,) how far the states are from their first estimates; 0 of those that the prior does not speak of."""
    d = np.zeros(size)
    d[:CALIBRATION] = window.calibration.moved
    for k in range(window.frames.count[0]):
        o = CALIBRATION + FRAME * k
        if window.frames.held[k] and o < size:
            d[o : o + FRAME] = window.frames.moved[k]
    return d
