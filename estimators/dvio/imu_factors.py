"""IMU factors of the window: pre-integration between frames, zero velocity, and the prior, added to H d = b.

Pre-integration follows Zhao et al. 2023, (7), after Forster et al. 2017. A sample is the mean over the interval that
ends at its stamp, so rate and force are constant over it; the increments of attitude, velocity and position over it
are exact to the third order of its rotation.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.dvio.algebra import REORDERED, carried, mul, put, rotate_back
from stridetwin.estimators.dvio.state import (
    CALIBRATION,
    D_ATTITUDE,
    D_GYRO_BIAS,
    D_POSITION,
    D_VELOCITY,
    FRAME,
    PLANE,
    Frames,
    ImuNoise,
    Increment,
    Terms,
    Window,
)
from stridetwin.estimators.so3 import exp, hat, log, right_jacobian, right_jacobian_inverse
from stridetwin.streams.samples import Array


@njit(error_model="numpy", **INSIDE)
def increment_at(zs: Increment, k: int) -> Increment:
    """The k-th of an array of increments."""
    return Increment(
        zs.dt[k], zs.alpha[k], zs.gamma[k], zs.beta[k], zs.by_bias[k], zs.covariance[k], zs.weight[k], zs.bias[k]
    )


@njit(error_model="numpy", **INSIDE)
def clear(z: Increment, bias: Array) -> None:
    """Resets an increment to zero duration, at the biases (6,) of gyroscope and accelerometer."""
    z.dt[0] = 0.0
    z.alpha[:] = 0.0
    z.beta[:] = 0.0
    z.gamma[:] = np.eye(3)
    z.by_bias[:] = 0.0
    z.covariance[:] = 0.0
    z.bias[:] = bias


@njit(error_model="numpy", **INSIDE)
def advance(z: Increment, rate: Array, force: Array, dt: float, rate_density: float, force_density: float) -> None:
    """Adds an interval of constant rate and force to an increment.

    See docs/dvio.md (1)-(3).

    Args:
        z: Changed in place.
        rate: (3,) measured angular rate, rad/s.
        force: (3,) measured specific force, m/s².
        dt: s.
        rate_density: Noise, rad/s/√Hz.
        force_density: Noise, m/s²/√Hz.
    """
    phi, a = np.empty(3), np.empty((3, 1))
    for i in range(3):
        phi[i], a[i, 0] = (rate[i] - z.bias[i]) * dt, force[i] - z.bias[3 + i]
    X, A, G = hat(phi), hat(a[:, 0]), z.gamma.copy()
    X2, turned = mul(X, X), mul(X, a)
    XA, Xa = mul(X, A), hat(turned[:, 0])
    # mean of the rotation over the interval, and its mean weighted with the remaining time
    to_v, to_p, v_by_phi, p_by_phi = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            one = 1.0 if i == j else 0.0
            both = XA[i, j] + Xa[i, j]
            to_v[i, j] = one + X[i, j] / 2.0 + X2[i, j] / 6.0
            to_p[i, j] = one / 2.0 + X[i, j] / 6.0 + X2[i, j] / 24.0
            v_by_phi[i, j] = -(A[i, j] / 2.0 + both / 6.0)
            p_by_phi[i, j] = -(A[i, j] / 6.0 + both / 24.0)
    dv, dp = mul(to_v, a)[:, 0], mul(to_p, a)[:, 0]
    for i in range(3):
        dv[i] *= dt
        dp[i] *= dt * dt
    F, B, turn = np.eye(9), np.zeros((9, 6)), exp(phi)
    put(F, 0, 3, mul(G, hat(dp)), -1.0)
    put(F, 3, 3, turn.T, 1.0)
    put(F, 6, 3, mul(G, hat(dv)), -1.0)
    for i in range(3):
        F[i, 6 + i] = dt
    put(B, 0, 0, mul(G, p_by_phi), -dt * dt * dt)
    put(B, 0, 3, mul(G, to_p), -dt * dt)
    put(B, 3, 0, right_jacobian(phi), -dt)
    put(B, 6, 0, mul(G, v_by_phi), -dt * dt)
    put(B, 6, 3, mul(G, to_v), -dt)
    # White noise of density s is a bias of standard deviation s / √dt over the interval.
    by_rate, by_force = rate_density / np.sqrt(dt), force_density / np.sqrt(dt)
    P, by_bias = carried(F, z.covariance), mul(F, z.by_bias)
    for i in range(9):
        for j in range(6):
            z.by_bias[i, j] = by_bias[i, j] + B[i, j]
        for j in range(9):
            rates = B[i, 0] * B[j, 0] + B[i, 1] * B[j, 1] + B[i, 2] * B[j, 2]
            forces = B[i, 3] * B[j, 3] + B[i, 4] * B[j, 4] + B[i, 5] * B[j, 5]
            z.covariance[i, j] = P[i, j] + by_rate * by_rate * rates + by_force * by_force * forces
    for i in range(3):
        moved = z.beta[i] * dt
        for j in range(3):
            moved += G[i, j] * dp[j]
        z.alpha[i] += moved
    for i in range(3):
        for j in range(3):
            z.beta[i] += G[i, j] * dv[j]
    put(z.gamma, 0, 0, mul(G, turn), 1.0)
    z.dt[0] += dt


@njit(error_model="numpy", **INSIDE)
def integrate(
    z: Increment,
    t_ns: NDArray[np.int64],
    samples: Array,
    doubt: NDArray[np.uint8],
    count: int,
    start_ns: int,
    end_ns: int,
    bias: Array,
    noise: ImuNoise,
) -> None:
    """Pre-integrates from `start_ns` to `end_ns`.

    Args:
        z: Overwritten.
        t_ns: Stamps of the samples, rising.
        samples: Rate (rad/s) and force (m/s²) of each, 6 columns.
        doubt: Of each: 1 if it is saturated or replaces missing samples.
        count: Number of samples; the first is not later than the start, the last not before the end.
        start_ns: Start time.
        end_ns: End time.
        bias: (6,) of gyroscope and accelerometer.
        noise: Of the sensor.
    """
    clear(z, bias)
    at = start_ns
    i = np.searchsorted(t_ns[:count], start_ns, side="right")
    while at < end_ns and i < count:
        until = min(t_ns[i], end_ns)
        dt = (until - at) * 1e-9
        share = 0.0
        for k in range(3):
            share += (noise.rate_share * (samples[i, k] - bias[k])) ** 2
        rate_density, force_density = np.sqrt(noise.rate**2 + share), noise.force
        if doubt[i]:
            # A constant error over the interval, as a density.
            rate_density += noise.doubtful_rate * np.sqrt(dt)
            force_density += noise.doubtful_force * np.sqrt(dt)
        advance(z, samples[i, :3], samples[i, 3:], dt, rate_density, force_density)
        at = until
        i += 1


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
        J: (9, 30) out: with respect to the states of both, at the residual's current rotation.
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
    expected = mul(z.gamma, exp(turned))
    M = mul(np.ascontiguousarray(Ri.T), Rj)
    e = log(mul(np.ascontiguousarray(expected.T), M))
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
    P, V = hat(p), hat(v)
    # Log(Exp(-Jr(turned) B db) E) of E = Exp(e)
    by_bias = mul(inverse, mul(np.ascontiguousarray(exp(e).T), right_jacobian(turned)))
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
    """Adds the IMU factor (9) from frame k to the next, with the random walk of its biases; returns its cost."""
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
    """Adds the zero-velocity update of a frame known to be stationary; returns its cost."""
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
    """(size,) deviation of the states from their first estimates; 0 for those that the prior does not contain."""
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
