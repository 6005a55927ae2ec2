"""A synthetic walk of a foot: force and rate of one IMU that agree with each other, for tests of files and units."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

RATE_HZ = 100.0
STRIDES, SWING_S, STANCE_S, STRIDE_M = 12, 0.6, 0.5, 1.2
Array = NDArray[np.float64]


def simulate_foot(
    seed: int = 0, noise: float = 1.0, turning: Collection[int] | None = None
) -> tuple[Array, Array, Array]:
    """Twelve strides over level ground after 2 s at rest: t (N,) s, force (N, 3) m/s², rate (N, 3) rad/s.

    The foot pitches, rolls and turns in swing, so that every axis of the rate matters; x ahead, y left, z up at rest.

    Args:
        seed: Of the noise.
        noise: Multiplies that of the sensor.
        turning: Numbers of the strides in which the foot turns by 0.8 rad to the side and rolls; in all others it
            pitches alone, as on a way straight ahead. None: it turns to and fro, and rolls, in each stride.
    """
    step_s = 1e-3  # of the differences
    t = np.arange(0.0, 2.0 + STRIDES * (SWING_S + STANCE_S) + 2.0, 1.0 / RATE_HZ)
    before, now, after = (_poses(t + shift, turning) for shift in (-step_s, 0.0, step_s))
    acceleration = (before[0] - 2.0 * now[0] + after[0]) / step_s**2 + [0.0, 0.0, 9.81]
    rate = (before[1].inv() * after[1]).as_rotvec() / (2.0 * step_s)
    random = np.random.default_rng(seed).normal
    force = now[1].inv().apply(acceleration) + noise * random(0.0, 0.02, (len(t), 3))
    return t, force, rate + noise * random(0.0, 0.002, (len(t), 3))


def _poses(t: Array, turning: Collection[int] | None) -> tuple[Array, Rotation]:
    """Position (N, 3) m and attitude of the foot at times (N,) s."""
    stride = np.clip(np.floor((t - 2.0) / (SWING_S + STANCE_S)), 0, STRIDES)
    since = np.clip((t - 2.0 - stride * (SWING_S + STANCE_S)) / SWING_S, 0.0, 1.0)
    u = np.where(stride < STRIDES, since, 0.0)  # share of the swing
    progress = u**4 * (35 - 84 * u + 70 * u**2 - 20 * u**3)
    bump = (4 * u * (1 - u)) ** 4
    position = np.column_stack([STRIDE_M * (stride + progress), np.zeros_like(t), 0.1 * bump])
    yaw, roll = 0.3 * bump, 0.25 * bump * np.cos(2 * np.pi * u)
    if turning is not None:
        past = sum((stride > number).astype(float) for number in turning)
        is_turning = np.isin(stride, list(turning))
        yaw, roll = 0.8 * (past + is_turning * progress), roll * is_turning
    angles = np.column_stack([yaw, 0.9 * bump * np.sin(2 * np.pi * u), roll])
    return position, Rotation.from_euler("ZYX", angles)
