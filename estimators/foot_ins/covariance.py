"""Covariance of an error-state filter: one foot's block inside a matrix of any size."""

from __future__ import annotations

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.foot_ins.memory import D_ACCEL_BIAS, D_ATTITUDE, D_GYRO_BIAS, D_POSITION, D_VELOCITY
from stridetwin.streams.samples import Array


@njit(**INSIDE)
def propagate(P: Array, o: int, R: Array, f_world: Array, dt: float) -> None:
    """P <- F P Fᵀ in place, for the foot whose 15 error states begin at row `o`.

    See docs/foot_ins.md (4).

    F is the strapdown error model of Titterton & Weston 2004, ch. 12, over one step; the Earth stands still.

    Args:
        P: (n, n) covariance.
        o: First row of the foot.
        R: (3, 3) attitude over the step, world <- sensor.
        f_world: (3,) specific force in the world, m/s².
        dt: s.
    """
    _transition(P, o, R, f_world, dt)
    _transition(P.T, o, R, f_world, dt)


@njit(**INSIDE)
def _transition(M: Array, o: int, R: Array, f_world: Array, dt: float) -> None:
    """M <- F M in place; only the foot's own rows change."""
    p, v, a = o + D_POSITION, o + D_VELOCITY, o + D_ATTITUDE
    g, b = o + D_GYRO_BIAS, o + D_ACCEL_BIAS
    fx, fy, fz = f_world[0] * dt, f_world[1] * dt, f_world[2] * dt
    D = R * dt
    for j in range(M.shape[1]):
        a0, a1, a2 = M[a, j], M[a + 1, j], M[a + 2, j]
        g0, g1, g2 = M[g, j], M[g + 1, j], M[g + 2, j]
        b0, b1, b2 = M[b, j], M[b + 1, j], M[b + 2, j]
        for i in range(3):
            M[p + i, j] += 0.5 * dt * M[v + i, j]
            M[a + i, j] -= D[i, 0] * g0 + D[i, 1] * g1 + D[i, 2] * g2
        M[v, j] += fz * a1 - fy * a2 - D[0, 0] * b0 - D[0, 1] * b1 - D[0, 2] * b2
        M[v + 1, j] += fx * a2 - fz * a0 - D[1, 0] * b0 - D[1, 1] * b1 - D[1, 2] * b2
        M[v + 2, j] += fy * a0 - fx * a1 - D[2, 0] * b0 - D[2, 1] * b1 - D[2, 2] * b2
        for i in range(3):
            M[p + i, j] += 0.5 * dt * M[v + i, j]


@njit(**INSIDE)
def shift(P: Array, o: int, dp: Array, dv: Array) -> None:
    """Covariance of the error seen from a corrected state, in place.

    See docs/foot_ins.md (12).

    To turn the whole world about the vertical changes nothing that a foot can measure; in the error that turn is
    (z × p, z × v, z) at position, velocity and attitude. Where a correction moves p and v, it must move along, or the
    filter takes the difference for a measurement of the heading, which adds up to a false certainty. This is the
    invariant filter of Barrau & Bonnabel 2017 (IEEE TAC 62:1797) in the coordinates of the plain one.

    Args:
        P: (n, n) covariance.
        o: First row of the foot.
        dp: (3,) correction of the position, m.
        dv: (3,) correction of the velocity, m/s.
    """
    shift_rows(P, o, dp, dv)
    shift_rows(P.T, o, dp, dv)


@njit(**INSIDE)
def shift_rows(M: Array, o: int, dp: Array, dv: Array) -> None:
    """M <- T M in place, δp + δθ × dp and δv + δθ × dv; see `shift`."""
    p, v, a = o + D_POSITION, o + D_VELOCITY, o + D_ATTITUDE
    for j in range(M.shape[1]):
        x, y, z = M[a, j], M[a + 1, j], M[a + 2, j]
        M[p, j] += y * dp[2] - z * dp[1]
        M[p + 1, j] += z * dp[0] - x * dp[2]
        M[p + 2, j] += x * dp[1] - y * dp[0]
        M[v, j] += y * dv[2] - z * dv[1]
        M[v + 1, j] += z * dv[0] - x * dv[2]
        M[v + 2, j] += x * dv[1] - y * dv[0]


@njit(**INSIDE)
def correct(P: Array, dx: Array, o: int, h: Array, z: float, r: float) -> None:
    """Scalar Kalman update of `P` and of the accumulated error `dx`, in place.

    Args:
        P: (n, n) covariance.
        dx: (n,) error found so far.
        o: First row of the states that the measurement depends on.
        h: (m,) row of the measurement's Jacobian, with regard to these m states.
        z: What was measured minus what the nominal state predicts.
        r: Variance of the measurement.
    """
    n = P.shape[0]
    Ph = np.zeros(n)
    for j in range(len(h)):
        if h[j] != 0.0:
            z -= h[j] * dx[o + j]
            for i in range(n):
                Ph[i] += P[o + j, i] * h[j]
    s = r
    for j in range(len(h)):
        s += h[j] * Ph[o + j]
    for i in range(n):
        k = Ph[i] / s
        dx[i] += k * z
        for j in range(i, n):
            P[i, j] -= k * Ph[j]
            P[j, i] = P[i, j]
