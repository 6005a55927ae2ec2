"""IMU factors of the window: pre-integration between frames, zero velocity, and the prior, added to H d = b.

Pre-integration follows Zhao et al. 2023, (7), after Forster et al. 2017. A sample is the mean over the interval that
ends at its stamp, so rate and force are constant over it; the changes of attitude, velocity and position over
it are exact to the third order of its rotation.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.dvio.algebra import REORDERED, mul, propagated, put, rotate_back
from stridetwin.estimators.dvio.state import (
    CALIBRATION,
    D_ATTITUDE,
    D_GYRO_BIAS,
    D_POSITION,
    D_VELOCITY,
    FRAME,
    PLANE,
    FactorParameters,
    Frames,
    ImuNoise,
    ImuSamples,
    Preintegration,
    Window,
)
from stridetwin.estimators.so3 import exp, hat, log, right_jacobian, right_jacobian_inverse
from stridetwin.streams.samples import Array


@njit(error_model="numpy", **INSIDE)
def preintegration_at(zs: Preintegration, k: int) -> Preintegration:
    """The k-th of an array."""
    return Preintegration(
        zs.dt[k], zs.delta_p[k], zs.delta_R[k], zs.delta_v[k], zs.by_bias[k], zs.covariance[k], zs.weight[k], zs.bias[k]
    )


@njit(error_model="numpy", **INSIDE)
def clear(z: Preintegration, bias: Array) -> None:
    """Resets an increment to zero duration, at the biases (6,) of gyroscope and accelerometer."""
    z.dt[0] = 0.0
    z.delta_p[:] = 0.0
    z.delta_v[:] = 0.0
    z.delta_R[:] = np.eye(3)
    z.by_bias[:] = 0.0
    z.covariance[:] = 0.0
    z.bias[:] = bias


@njit(error_model="numpy", **INSIDE)
def advance(z: Preintegration, rate: Array, force: Array, dt: float, rate_density: float, force_density: float) -> None:
    """Adds an interval of `dt` (s) of constant measured rate (rad/s) and force (m/s²) to a measurement, in place.

    The noise densities are in rad/s/√Hz and m/s²/√Hz. See docs/dvio.md (1)-(3).
    """
    phi, a = np.empty(3), np.empty((3, 1))
    for i in range(3):
        phi[i], a[i, 0] = (rate[i] - z.bias[i]) * dt, force[i] - z.bias[3 + i]
    X, A, G = hat(phi), hat(a[:, 0]), z.delta_R.copy()
    X2, Xf = mul(X, X), mul(X, a)
    XA, Xa = mul(X, A), hat(Xf[:, 0])
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
    F, B, rotation = np.eye(9), np.zeros((9, 6)), exp(phi)
    put(F, 0, 3, mul(G, hat(dp)), -1.0)
    put(F, 3, 3, rotation.T, 1.0)
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
    P, by_bias = propagated(F, z.covariance), mul(F, z.by_bias)
    for i in range(9):
        for j in range(6):
            z.by_bias[i, j] = by_bias[i, j] + B[i, j]
        for j in range(9):
            rates = B[i, 0] * B[j, 0] + B[i, 1] * B[j, 1] + B[i, 2] * B[j, 2]
            forces = B[i, 3] * B[j, 3] + B[i, 4] * B[j, 4] + B[i, 5] * B[j, 5]
            z.covariance[i, j] = P[i, j] + by_rate * by_rate * rates + by_force * by_force * forces
    for i in range(3):
        moved = z.delta_v[i] * dt
        for j in range(3):
            moved += G[i, j] * dp[j]
        z.delta_p[i] += moved
    for i in range(3):
        for j in range(3):
            z.delta_v[i] += G[i, j] * dv[j]
    put(z.delta_R, 0, 0, mul(G, rotation), 1.0)
    z.dt[0] += dt


@njit(error_model="numpy", **INSIDE)
def integrate(z: Preintegration, imu: ImuSamples, start_ns: int, end_ns: int, bias: Array, noise: ImuNoise) -> None:
    """Pre-integrates into `z` from `start_ns` to `end_ns`, at the biases (6,).

    The first sample is not later than the start, and the last one not before the end.
    """
    clear(z, bias)
    at = start_ns
    i = np.searchsorted(imu.t_ns, start_ns, side="right")
    while at < end_ns and i < len(imu.t_ns):
        until = min(imu.t_ns[i], end_ns)
        dt = (until - at) * 1e-9
        share = 0.0
        for k in range(3):
            share += (noise.rate_share * (imu.values[i, k] - bias[k])) ** 2
        rate_density, force_density = np.sqrt(noise.rate**2 + share), noise.force
        if imu.invalid[i]:
            # A constant error over the interval, as a density.
            rate_density += noise.invalid_rate * np.sqrt(dt)
            force_density += noise.invalid_force * np.sqrt(dt)
        advance(z, imu.values[i, :3], imu.values[i, 3:], dt, rate_density, force_density)
        at = until
        i += 1


@njit(error_model="numpy", **INSIDE)
def motion(
    frames: Frames, z: Preintegration, k: int, factors: FactorParameters, r: Array, J: Array, first: bool
) -> None:
    """IMU residual (7) from frame k to the next, `r` (9,) of position, rotation and velocity, and its Jacobian.

    `J` (9, 30) is with respect to the states of both, at first estimates if `first`. See docs/dvio.md (4).
    """
    dt = z.dt[0]
    Ri, Rj = frames.R[k], frames.R[k + 1]
    g = np.array([0.0, 0.0, -factors.gravity])
    off = frames.bias[k] - z.bias
    moved = np.zeros(9)
    for i in range(9):
        for j in range(6):
            moved[i] += z.by_bias[i, j] * off[j]
    rotation = moved[3:6].copy()
    p = rotate_back(Ri, frames.p[k + 1] - frames.p[k] - frames.v[k] * dt - 0.5 * g * dt * dt)
    v = rotate_back(Ri, frames.v[k + 1] - frames.v[k] - g * dt)
    expected = mul(z.delta_R, exp(rotation))
    M = mul(np.ascontiguousarray(Ri.T), Rj)
    e = log(mul(np.ascontiguousarray(expected.T), M))
    for i in range(3):
        r[i] = p[i] - z.delta_p[i] - moved[i]
        r[3 + i] = e[i]
        r[6 + i] = v[i] - z.delta_v[i] - moved[6 + i]
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
    # Log(Exp(-Jr(rotation) B db) E) of E = Exp(e)
    by_bias = mul(inverse, mul(np.ascontiguousarray(exp(e).T), right_jacobian(rotation)))
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
def add_motion(window: Window, k: int, factors: FactorParameters, H: Array, b: Array) -> float:
    """Adds the IMU factor (9) from frame k to the next, with the random walk of its biases; returns its cost."""
    frames, z = window.frames, preintegration_at(window.preintegrations, k)
    r, J = np.empty(9), np.empty((9, 2 * FRAME))
    motion(frames, z, k, factors, r, J, factors.first_estimates)
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
        walk = factors.rate_walk if i < 3 else factors.force_walk
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
def add_zero_velocity(window: Window, k: int, H: Array, b: Array) -> float:
    """Adds the zero-velocity update of a frame known to be stationary; returns its cost."""
    frames = window.frames
    if not math.isfinite(frames.zero_velocity_sd[k]):
        return 0.0
    w, cost = 1.0 / frames.zero_velocity_sd[k] ** 2, 0.0
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
        h, prior_row, row = 0.0, P.H[i], H[i]
        for j in range(size):
            h += prior_row[j] * d[j]
        b[i] += P.b[i] - h
        cost += d[i] * (0.5 * h - P.b[i])
        for j in range(i + 1):
            row[j] += prior_row[j]
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
