"""Kalman updates of a covariance in place, in a workspace, so that nothing is allocated."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from stridetwin.streams.algebra.matrices import clear as zero
from stridetwin.streams.algebra.matrices import factorise, substitute_backward_in_vector, substitute_forward_in_vector
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

MEASUREMENTS = 6  # at most, of one update


class Workspace(NamedTuple):
    """Arrays of one update of a filter with n error states, by at most 6 measurements of m of these states.

    Attributes:
        jacobian: (6, m) H: one row per measurement, of unit noise, by the m states from a row on.
        innovation: (6,) z: measurement minus its prediction from the nominal state, in standard deviations.
        spread: (6, 6) H P Hᵀ, lower triangle.
        factor: (6, 6) Cholesky factor L of the innovation's covariance S, lower triangle.
        solved: (6,) L⁻¹ z or, after `back_substitute`, S⁻¹ z.
        gain: (n,) P hᵀ of one row h of H.
    """

    jacobian: Array
    innovation: Array
    spread: Array
    factor: Array
    solved: Array
    gain: Array


def workspace(states: int, measured: int) -> Workspace:
    """An empty workspace.

    Args:
        states: Number n of error states.
        measured: Number m of them that measurements depend on.
    """
    m = MEASUREMENTS
    return Workspace(
        jacobian=np.zeros((m, measured)),
        innovation=np.zeros(m),
        spread=np.zeros((m, m)),
        factor=np.zeros((m, m)),
        solved=np.zeros(m),
        gain=np.zeros(states),
    )


@njit(**INNER_KERNEL)
def clear(work: Workspace, m: int) -> None:
    """Sets the first m rows of the workspace's Jacobian to 0, before new measurements are written into them."""
    for i in range(m):
        zero(work.jacobian[i])


@njit(**INNER_KERNEL)
def correct(P: Array, dx: Array, gain: Array, o: int, h: Array, z: float, r: float) -> None:
    """Scalar Kalman update of `P` and of the accumulated error `dx`, in place.

    With the innovation z' and its variance s: k = P hᵀ / s, dx += k z', P -= k h P.

    Args:
        P: (n, n) covariance.
        dx: (n,) error found so far.
        gain: (n,) overwritten by P hᵀ.
        o: First row of the states that `h` is about.
        h: (m,) Jacobian of the measurement by the m states from row `o` on.
        z: Measurement minus its prediction from the nominal state.
        r: Variance of the measurement.
    """
    n = P.shape[0]
    z, s = _innovation(P, dx, gain, o, h, z, r)
    for i in range(n):
        k = gain[i] / s
        dx[i] += k * z
        for j in range(i, n):
            P[i, j] -= k * gain[j]
            P[j, i] = P[i, j]


@njit(**INNER_KERNEL)
def correct_probably(
    P: Array, dx: Array, gain: Array, o: int, h: Array, z: float, r: float, probability: float
) -> None:
    """Scalar Kalman update, in place, by a measurement that applies with a probability only.

    Mean and covariance become those of the mixture of both cases: corrected as by `correct`, and not corrected. With
    the innovation z' and its variance s, the mean moves by the share p = `probability` of the full correction, and the
    covariance loses (p / s - p (1 - p) z'² / s²) of P hᵀ h P: the spread of the two means is part of it (Bar-Shalom &
    Tse 1975).

    Args:
        P: (n, n) covariance.
        dx: (n,) error found so far.
        gain: (n,) overwritten by P hᵀ.
        o: First row of the states that `h` is about.
        h: (m,) Jacobian of the measurement by the m states from row `o` on.
        z: Measurement minus its prediction from the nominal state.
        r: Variance of the measurement.
        probability: p, that the measurement applies.
    """
    n = P.shape[0]
    z, s = _innovation(P, dx, gain, o, h, z, r)
    # factor of P hᵀ h P, which the covariance loses
    lost = probability / s * (1.0 - (1.0 - probability) * z * z / s)
    for i in range(n):
        dx[i] += gain[i] * probability * z / s
        for j in range(i, n):
            P[i, j] -= lost * gain[i] * gain[j]
            P[j, i] = P[i, j]


@njit(**INNER_KERNEL)
def _innovation(P: Array, dx: Array, gain: Array, o: int, h: Array, z: float, r: float) -> tuple[float, float]:
    """The innovation z' = z - h dx and its variance s = h P hᵀ + r; writes P hᵀ into `gain`.

    The error `dx` is part of the prediction, as it is not in the nominal state yet.

    Args:
        P: (n, n) covariance.
        dx: (n,) error found so far.
        gain: (n,) overwritten by P hᵀ.
        o: First row of the states that `h` is about.
        h: (m,) Jacobian of the measurement by the m states from row `o` on.
        z: Measurement minus its prediction from the nominal state.
        r: Variance of the measurement.
    """
    _covariance_times_row(P, gain, o, h)
    s = r
    for j in range(len(h)):
        if h[j] != 0.0:
            z -= h[j] * dx[o + j]
            s += h[j] * gain[o + j]
    return z, s


@njit(**INNER_KERNEL)
def _covariance_times_row(P: Array, gain: Array, o: int, h: Array) -> None:
    """Writes P hᵀ into `gain` (n,), for the row h (m,) by the m states from row `o` of P (n, n) on."""
    zero(gain)
    for j in range(len(h)):
        if h[j] != 0.0:
            for i in range(len(gain)):
                gain[i] += P[o + j, i] * h[j]


@njit(**INNER_KERNEL)
def spread_measurements(P: Array, work: Workspace, o: int, m: int) -> None:
    """Writes H P Hᵀ (m, m), the covariance of the predicted measurements, into `work.spread` (its lower triangle).

    Args:
        P: (n, n) covariance of the error states.
        work: Workspace with the Jacobian H; its `gain` is left as P hᵀ of the last row.
        o: First row of the states that H is about.
        m: Number of measurements, the first rows of H.
    """
    H = work.jacobian
    for i in range(m):
        _covariance_times_row(P, work.gain, o, H[i])
        for k in range(i + 1):
            s = 0.0
            for j in range(H.shape[1]):
                s += H[k, j] * work.gain[o + j]
            work.spread[i, k] = s


@njit(**INNER_KERNEL)
def innovation_norm(work: Workspace, m: int, variance: float) -> float:
    """Length of the innovation of m measurements, in standard deviations, with noise of this variance.

    √(zᵀ S⁻¹ z), S = H P Hᵀ + variance 1, as |L⁻¹ z| with Cholesky's L Lᵀ = S. `spread_measurements` must have been
    called before: it leaves H P Hᵀ in `work.spread`. L is left in `work.factor`, L⁻¹ z in `work.solved`.
    """
    y, length2 = work.solved, 0.0  # y: L⁻¹ z; length2: its squared length
    factorise(work.spread, variance, work.factor, m)
    for i in range(m):
        y[i] = work.innovation[i]
    substitute_forward_in_vector(work.factor, y, m)
    for i in range(m):
        length2 += y[i] * y[i]
    return math.sqrt(length2)


@njit(**INNER_KERNEL)
def back_substitute(work: Workspace, m: int) -> None:
    """Replaces `solved`, L⁻¹ z after `innovation_norm`, by S⁻¹ z."""
    substitute_backward_in_vector(work.factor, work.solved, m)


@njit(**INNER_KERNEL)
def apply_gated_update(P: Array, dx: Array, work: Workspace, o: int, m: int, innovation_gate: float) -> float:
    """Kalman update with m measurements, in place; their noise is increased if the innovation is improbably large.

    This is docs/foot_ins.md (11): if the innovation is k times as long as the gate, k > 1, the noise has k times its
    standard deviation. The measurements are applied one after the other, each of unit noise, as scalar updates.

    Args:
        P: (n, n) covariance, changed in place.
        dx: (n,) error found so far, changed in place.
        work: Workspace with Jacobian and innovation of the measurements.
        o: First row of the states that the Jacobian is about.
        m: Number of measurements.
        innovation_gate: The gate, in standard deviations.

    Returns:
        Length of the innovation in standard deviations, before the noise grows.
    """
    spread_measurements(P, work, o, m)
    length = innovation_norm(work, m, 1.0)
    inflation = max(1.0, length / innovation_gate)
    for i in range(m):
        correct(P, dx, work.gain, o, work.jacobian[i], work.innovation[i], inflation * inflation)
    return length
