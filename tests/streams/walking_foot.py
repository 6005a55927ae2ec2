"""A foot that walks on level ground: force and rate of one IMU on it, consistent with each other."""

from __future__ import annotations

import numpy as np

STRIDES, SWING_S, STANCE_S, STRIDE_M, REST_S, RATE_HZ = 8, 0.6, 0.5, 1.2, 2.0, 100.0
LENGTH_M = STRIDES * STRIDE_M


def pose(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Place ahead and height in m, and pitch in rad, at times (N,) s."""
    cycle = SWING_S + STANCE_S
    stride = np.clip(np.floor((t - REST_S) / cycle), 0, STRIDES - 1)
    u = np.clip((t - REST_S - stride * cycle) / SWING_S, 0.0, 1.0)  # share of the swing
    hump = (4 * u * (1 - u)) ** 4
    ahead = STRIDE_M * (stride + u**4 * (35 - 84 * u + 70 * u**2 - 20 * u**3))
    return ahead, 0.1 * hump, 0.9 * hump * np.sin(2 * np.pi * u)


def foot_walk() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (N,) s, forces (N, 3) m/s² and rates (N, 3) rad/s; x is ahead, z is up; noise of a sensor."""
    h = 1e-3
    t = np.arange(0.0, 2 * REST_S + STRIDES * (SWING_S + STANCE_S), 1 / RATE_HZ)
    (x0, z0, p0), (x1, z1, p1), (x2, z2, p2) = pose(t - h), pose(t), pose(t + h)
    ahead, up = (x0 - 2 * x1 + x2) / h**2, (z0 - 2 * z1 + z2) / h**2 + 9.81
    rng, zero = np.random.default_rng(1), 0.0 * t
    force = np.column_stack([np.cos(p1) * ahead - np.sin(p1) * up, zero, np.sin(p1) * ahead + np.cos(p1) * up])
    gyro = np.column_stack([zero, (p2 - p0) / (2 * h), zero])
    return t, force + rng.normal(0, 0.02, force.shape), gyro + rng.normal(0, 0.002, gyro.shape)
