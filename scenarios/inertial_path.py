"""Path of an IMU over a second, by its samples alone.

Without start speed and gravity the path lacks a polynomial of time of the second degree, and a bias of the gyro turns
gravity by another power of it. Without that polynomial, it is what steps and gestures move the sensor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stridetwin.streams.algebra.arrays import exp, log
from stridetwin.streams.samples import Array, Block, Imu, Stamps

DEGREE = 3
"""Degree of the polynomial of time that is taken out: start, speed, gravity with the accelerometer's bias, and what the
gyro's bias turns of gravity."""
_LONGEST_STEP_S = 0.05
"""A longer step between samples is a gap."""


@dataclass(frozen=True, kw_only=True, eq=False)
class InertialPath:
    """Path of an IMU by its samples alone, from rest and without gravity: it lacks a polynomial of time.

    Attributes:
        t_ns: (M,) stamps.
        rotation_rad: (M, 3) rotation vectors to the axes at the start.
        p_imu_in_start: (M, 3) m.
    """

    t_ns: Stamps
    rotation_rad: Array
    p_imu_in_start: Array


def integrate(imu: Block[Imu], first_ns: int, last_ns: int) -> InertialPath | None:
    """The path of an IMU by its samples from one time to another; None if they do not cover it, or have a gap.

    Args:
        imu: All samples.
        first_ns: Begin.
        last_ns: End.
    """
    start, stop = int(np.searchsorted(imu.t_ns, first_ns, "right")) - 1, int(np.searchsorted(imu.t_ns, last_ns)) + 1
    if start < 0 or stop > len(imu.t_ns):
        return None
    t_ns = imu.t_ns[start:stop]
    dt = np.diff(t_ns)[:, None] * 1e-9
    rate, force = (imu.columns[name][start + 1 : stop] for name in ("angular_rate", "specific_force"))
    if not len(dt) or dt.max() > _LONGEST_STEP_S or not (np.isfinite(rate).all() and np.isfinite(force).all()):
        return None
    turns, halves = exp(rate * dt), exp(rate * dt / 2)
    R = np.empty((len(t_ns), 3, 3))
    R[0] = np.eye(3)
    for i, turn in enumerate(turns):
        R[i + 1] = R[i] @ turn
    a = np.einsum("nij,njk,nk->ni", R[:-1], halves, force)
    v = np.vstack((np.zeros(3), np.cumsum(a * dt, axis=0)))  # (M, 3) at the samples
    p = np.vstack((np.zeros(3), np.cumsum((v[:-1] + a * dt / 2) * dt, axis=0)))
    return InertialPath(t_ns=t_ns, rotation_rad=log(R), p_imu_in_start=p)


def measure_motion_m(inertial: InertialPath) -> float:
    """Standard deviation, m, of an inertial path without a polynomial of time: how much there is to compare."""
    without = polynomial_remover((inertial.t_ns - inertial.t_ns[0]) * 1e-9, DEGREE)
    return float(np.sqrt(np.mean(np.sum(without(inertial.p_imu_in_start) ** 2, axis=1))))


def polynomial_remover(t: Array, degree: int) -> Callable[[Array], Array]:
    """A function that takes the best polynomial of the times t (K,) out of each column of (K, ...) values."""
    middle, span = (t[0] + t[-1]) / 2, max(t[-1] - t[0], 1e-9)
    basis, _ = np.linalg.qr(np.vander(2 * (t - middle) / span, degree + 1))
    return lambda values: values - basis @ (basis.T @ values)
