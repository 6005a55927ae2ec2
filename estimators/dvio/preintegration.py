"""IMU pre-integration between two frames (Zhao et al. 2023, what (7) compares with; after Forster et al. 2017).

A sample is the mean over the interval that ends at its stamp, so rate and force are constant over it, and the
increments of attitude, velocity and position over it are exact to the third order of its turn.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.dvio.algebra import carried, exponential, mul, right_jacobian, skew
from stridetwin.estimators.dvio.memory import ImuNoise, Increment
from stridetwin.streams.samples import Array


@njit(error_model="numpy")
def clear(z: Increment, bias: Array) -> None:
    """Makes an increment that of no time, with the biases (6,) of gyroscope and accelerometer that it is taken at."""
    z.dt[0] = 0.0
    z.alpha[:] = 0.0
    z.beta[:] = 0.0
    z.gamma[:] = np.eye(3)
    z.by_bias[:] = 0.0
    z.covariance[:] = 0.0
    z.bias[:] = bias


@njit(error_model="numpy")
def advance(z: Increment, rate: Array, force: Array, dt: float, rate_density: float, force_density: float) -> None:
    """Takes a stretch of constant rate and force into an increment.

    Args:
        z: Changed in place.
        rate: (3,) told angular rate, rad/s.
        force: (3,) told specific force, m/s².
        dt: s.
        rate_density: Noise, rad/s/√Hz.
        force_density: Noise, m/s²/√Hz.
    """
    phi = (rate - z.bias[:3]) * dt
    a = force - z.bias[3:]
    X, G = skew(phi), z.gamma.copy()
    X2 = mul(X, X)
    eye = np.eye(3)
    to_v = eye + X / 2.0 + X2 / 6.0  # mean of the rotation over the stretch, and its mean weighted with time to go
    to_p = eye / 2.0 + X / 6.0 + X2 / 24.0
    A, of_a = skew(a), np.ascontiguousarray(a.reshape(3, 1))
    turned = mul(X, of_a)[:, 0]
    XA = mul(X, A) + skew(turned)
    v_by_phi, p_by_phi = -(A / 2.0 + XA / 6.0), -(A / 6.0 + XA / 24.0)
    dv, dp = mul(to_v, of_a)[:, 0] * dt, mul(to_p, of_a)[:, 0] * (dt * dt)
    F = np.eye(9)
    F[0:3, 3:6] = -mul(G, skew(dp))
    for i in range(3):
        F[i, 6 + i] = dt
    turn = exponential(phi)
    F[3:6, 3:6] = turn.T
    F[6:9, 3:6] = -mul(G, skew(dv))
    B = np.zeros((9, 6))
    B[0:3, 0:3] = mul(G, p_by_phi) * (-dt * dt * dt)
    B[0:3, 3:6] = mul(G, to_p) * (-dt * dt)
    B[3:6, 0:3] = right_jacobian(phi) * -dt
    B[6:9, 0:3] = mul(G, v_by_phi) * (-dt * dt)
    B[6:9, 3:6] = mul(G, to_v) * -dt
    z.by_bias[:] = mul(F, z.by_bias) + B
    # White noise of density s is a bias of standard deviation s / √dt over the stretch.
    P = carried(F, z.covariance)
    scaled = B.copy()
    scaled[:, :3] *= rate_density / np.sqrt(dt)
    scaled[:, 3:] *= force_density / np.sqrt(dt)
    z.covariance[:] = P + mul(scaled, np.ascontiguousarray(scaled.T))
    for i in range(3):
        moved = z.beta[i] * dt
        for j in range(3):
            moved += G[i, j] * dp[j]
        z.alpha[i] += moved
    for i in range(3):
        for j in range(3):
            z.beta[i] += G[i, j] * dv[j]
    z.gamma[:] = mul(G, turn)
    z.dt[0] += dt


@njit(error_model="numpy")
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
        turn = samples[i, :3] - bias[:3]
        share = noise.rate_share**2 * (turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
        rate_density, force_density = np.sqrt(noise.rate**2 + share), noise.force
        if doubt[i]:
            # A value off by a constant over the stretch, as a density.
            rate_density += noise.doubtful_rate * np.sqrt(dt)
            force_density += noise.doubtful_force * np.sqrt(dt)
        advance(z, samples[i, :3], samples[i, 3:], dt, rate_density, force_density)
        at = until
        i += 1
