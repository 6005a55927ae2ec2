"""What the IMU says between two frames, that a sensor rests, and the prior: added to the normal equations H d = b."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.dvio.algebra import (
    REORDERED,
    exponential,
    logarithm,
    mul,
    right_jacobian,
    right_jacobian_inverse,
    rotate_back,
    skew,
)
from stridetwin.estimators.dvio.memory import (
    CALIBRATION,
    D_ATTITUDE,
    D_GYRO_BIAS,
    D_POSITION,
    D_VELOCITY,
    FRAME,
    PLANE,
    Frames,
    Increment,
    Window,
)
from stridetwin.estimators.dvio.preintegration import increment_at
from stridetwin.estimators.dvio.terms import Terms
from stridetwin.streams.samples import Array


@njit(error_model="numpy", **INSIDE)
def motion(frames: Frames, z: Increment, k: int, terms: Terms, r: Array, J: Array, first: bool) -> None:
    """IMU residual (7) from frame k to the next and its Jacobian.

    See docs/dvio.md (4).

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


@njit(error_model="numpy", **INSIDE)
def add_motion(window: Window, k: int, terms: Terms, H: Array, b: Array) -> float:
    """Adds the IMU factor (9) from frame k to the next, with the walk of its biases; returns its cost."""
    frames, z = window.frames, increment_at(window.increments, k)
    r, J = np.empty(9), np.empty((9, 2 * FRAME))
    motion(frames, z, k, terms, r, J, terms.first_estimates)
    WJ = mul(z.weight, J)
    o = window.shared + FRAME * k
    cost = 0.0
    for i in range(9):
        wr = 0.0
        for j in range(9):
            wr += z.weight[i, j] * r[j]
        cost += 0.5 * r[i] * wr
        for a in range(2 * FRAME):
            g = J[i, a]
            if g == 0.0:
                continue
            b[o + a] -= g * wr
            row, of = H[o + a, o:], WJ[i]
            for c in range(a + 1):
                row[c] += g * of[c]
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


@njit(error_model="numpy", **INSIDE)
def add_standing(window: Window, k: int, H: Array, b: Array) -> float:
    """Adds the zero velocity of a frame that is known to stand; returns its cost."""
    frames = window.frames
    if not math.isfinite(frames.still_sd[k]):
        return 0.0
    w, cost = 1.0 / frames.still_sd[k] ** 2, 0.0
    for i in range(3):
        at = window.shared + FRAME * k + D_VELOCITY + i
        H[at, at] += w
        b[at] -= w * frames.v[k, i]
        cost += 0.5 * w * frames.v[k, i] ** 2
    return cost


@njit(fastmath=REORDERED, error_model="numpy", **INSIDE)
def add_prior(window: Window, size: int, H: Array, b: Array) -> float:
    """Adds the prior (6) of the first `size` states; returns its cost, up to a constant."""
    d = errors(window, size)
    cost, P = 0.0, window.prior
    for i in range(size):
        h, told, row = 0.0, P.H[i], H[i]
        for j in range(size):
            h += told[j] * d[j]
        b[i] += P.b[i] - h
        cost += d[i] * (0.5 * h - P.b[i])
        for j in range(i + 1):
            row[j] += told[j]
    return cost


@njit(error_model="numpy", **INSIDE)
def errors(window: Window, size: int) -> Array:
    """(size,) how far the states are from their first estimates; 0 of those that the prior does not speak of."""
    d = np.zeros(size)
    d[:CALIBRATION] = window.calibration.moved
    for k in range(len(window.planes.used)):
        if window.planes.used[k] and window.planes.held[k]:
            o = CALIBRATION + PLANE * k
            d[o : o + PLANE] = window.planes.moved[k]
    for k in range(window.frames.count[0]):
        o = window.shared + FRAME * k
        if window.frames.held[k] and o < size:
            d[o : o + FRAME] = window.frames.moved[k]
    return d
