"""IMU pre-integration between two frames (Zhao et al. 2023, what (7) compares with; after Forster et al. 2017).

A sample is the mean over the interval that ends at its stamp, so rate and force are constant over it, and the
increments of attitude, velocity and position over it are exact to the third order of its turn.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.dvio.algebra import carried, exponential, mul, put, right_jacobian, skew
from stridetwin.estimators.dvio.memory import ImuNoise, Increment
from stridetwin.streams.samples import Array


@njit(error_model="numpy", **INSIDE)
def increment_at(zs: Increment, k: int) -> Increment:
    """The k-th of an array of increments."""
    return Increment(
        zs.dt[k], zs.alpha[k], zs.gamma[k], zs.beta[k], zs.by_bias[k], zs.covariance[k], zs.weight[k], zs.bias[k]
    )


@njit(error_model="numpy", **INSIDE)
def clear(z: Increment, bias: Array) -> None:
    """Makes an increment that of no time, with the biases (6,) of gyroscope and accelerometer that it is taken at."""
    z.dt[0] = 0.0
    z.alpha[:] = 0.0
    z.beta[:] = 0.0
    z.gamma[:] = np.eye(3)
    z.by_bias[:] = 0.0
    z.covariance[:] = 0.0
    z.bias[:] = bias


@njit(error_model="numpy", **INSIDE)
def advance(z: Increment, rate: Array, force: Array, dt: float, rate_density: float, force_density: float) -> None:
    """Takes a stretch of constant rate and force into an increment.

    See docs/dvio.md (1)-(3).

    Args:
        z: Changed in place.
        rate: (3,) told angular rate, rad/s.
        force: (3,) told specific force, m/s².
        dt: s.
        rate_density: Noise, rad/s/√Hz.
        force_density: Noise, m/s²/√Hz.
    """
    phi, a = np.empty(3), np.empty((3, 1))
    for i in range(3):
        phi[i], a[i, 0] = (rate[i] - z.bias[i]) * dt, force[i] - z.bias[3 + i]
    X, A, G = skew(phi), skew(a[:, 0]), z.gamma.copy()
    X2, turned = mul(X, X), mul(X, a)
    XA, Xa = mul(X, A), skew(turned[:, 0])
    # mean of the rotation over the stretch, and its mean weighted with time to go
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
    F, B, turn = np.eye(9), np.zeros((9, 6)), exponential(phi)
    put(F, 0, 3, mul(G, skew(dp)), -1.0)
    put(F, 3, 3, turn.T, 1.0)
    put(F, 6, 3, mul(G, skew(dv)), -1.0)
    for i in range(3):
        F[i, 6 + i] = dt
    put(B, 0, 0, mul(G, p_by_phi), -dt * dt * dt)
    put(B, 0, 3, mul(G, to_p), -dt * dt)
    put(B, 3, 0, right_jacobian(phi), -dt)
    put(B, 6, 0, mul(G, v_by_phi), -dt * dt)
    put(B, 6, 3, mul(G, to_v), -dt)
    # White noise of density s is a bias of standard deviation s / √dt over the stretch.
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
        doubt: Of each: 1 where it was saturated, or stands for missing ones.
        count: How many of them there are; the first is not later than the start, the last not before the end.
        start_ns: From.
        end_ns: To.
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
            # A value off by a constant over the stretch, as a density.
            rate_density += noise.doubtful_rate * np.sqrt(dt)
            force_density += noise.doubtful_force * np.sqrt(dt)
        advance(z, samples[i, :3], samples[i, 3:], dt, rate_density, force_density)
        at = until
        i += 1
