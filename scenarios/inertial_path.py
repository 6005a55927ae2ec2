"""Path of an IMU over about a second, by its samples alone.

Without start speed and gravity the path lacks a polynomial of time of the second degree, and a bias of the gyro turns
gravity by another power of it. Without that polynomial, it is what steps and gestures move the sensor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stridetwin.streams.algebra.arrays import exp, log
from stridetwin.streams.samples import Array, Block, Imu, Stamps
from stridetwin.streams.time_series import accumulate

DEGREE = 3
"""Degree of the polynomial of time that is taken out: start, speed, gravity with the accelerometer's bias, and what the
gyro's bias turns of gravity."""
_LONGEST_STEP_S = 0.05
"""A longer step between samples is a gap."""


@dataclass(frozen=True, kw_only=True, eq=False)
class InertialPath:
    """Path of an IMU by its samples alone, from rest and without gravity: it lacks a polynomial of time.

    Attributes:
        t_ns: (M,) stamps of the samples, by the IMU's clock.
        rotation_rad: (M, 3) rotation vectors of `R_start_imu`, which takes the IMU's axes at a stamp into those at the
            first one.
        p_imu_in_start: (M, 3) positions in the IMU's axes at the first stamp, m.
    """

    t_ns: Stamps
    rotation_rad: Array
    p_imu_in_start: Array


def integrate_path(imu: Block[Imu], first_ns: int, last_ns: int) -> InertialPath | None:
    """The path of an IMU by its samples from one time to another; None if they do not cover it, or have a gap.

    The rotation of each step is applied at once, the force in the axes at the middle of its step.

    Args:
        imu: All samples of the IMU, each a mean over the interval that ends at its stamp.
        first_ns: Begin of the path, by the IMU's clock.
        last_ns: End of the path; the samples at or beyond both ends are part of it.
    """
    start, stop = int(np.searchsorted(imu.t_ns, first_ns, "right")) - 1, int(np.searchsorted(imu.t_ns, last_ns)) + 1
    if start < 0 or stop > len(imu.t_ns):
        return None
    t_ns = imu.t_ns[start:stop]
    steps = np.diff(t_ns) * 1e-9  # (M - 1,) s
    dt = steps[:, None]
    rate, force = (imu.columns[name][start + 1 : stop] for name in ("angular_rate", "specific_force"))
    if not len(dt) or dt.max() > _LONGEST_STEP_S or not (np.isfinite(rate).all() and np.isfinite(force).all()):
        return None
    turns, halves = exp(rate * dt), exp(rate * dt / 2)
    R = np.empty((len(t_ns), 3, 3))
    R[0] = np.eye(3)
    for i, turn in enumerate(turns):
        R[i + 1] = R[i] @ turn
    a = np.einsum("nij,njk,nk->ni", R[:-1], halves, force)
    v = accumulate(steps, a)  # (M, 3) m/s, at the samples
    p = accumulate(steps, v[:-1] + a * dt / 2)
    return InertialPath(t_ns=t_ns, rotation_rad=log(R), p_imu_in_start=p)


def measure_motion_m(inertial: InertialPath) -> float:
    """Standard deviation, m, of an inertial path without a polynomial of time: how much there is to compare."""
    without = build_polynomial_remover((inertial.t_ns - inertial.t_ns[0]) * 1e-9, DEGREE)
    return float(np.sqrt(np.mean(np.sum(without(inertial.p_imu_in_start) ** 2, axis=1))))


def build_polynomial_remover(t: Array, degree: int) -> Callable[[Array], Array]:
    """A function that takes out of each column of (K, D) values the polynomial of time that fits it best.

    Args:
        t: (K,) times of the values, s.
        degree: Of the polynomial.
    """
    middle, span = (t[0] + t[-1]) / 2, max(t[-1] - t[0], 1e-9)
    basis, _ = np.linalg.qr(np.vander(2 * (t - middle) / span, degree + 1))
    return lambda values: values - basis @ (basis.T @ values)
