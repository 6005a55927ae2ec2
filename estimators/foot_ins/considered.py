"""Errors that the filter considers but does not estimate: scale of the gyro, delay of a channel, creep of a shoe.

docs/foot_ins.md, "Considered errors".
"""

from __future__ import annotations

from numba import njit

from stridetwin.estimators.foot_ins import state
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.streams.algebra.tuples import Mat3, Vec3, axpy, matvec, times, vec3_at
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array


@njit(**INNER_KERNEL)
def begin_considered(memory: state.FilterState, parameters: KernelParameters) -> None:
    """Sets the standard deviations of the considered errors at the first sample of a foot."""
    memory.considered_sd[state.SCALE_ACROSS] = parameters.considered_scale_sd
    memory.considered_sd[state.SCALE_ALONG] = parameters.considered_scale_sd
    memory.considered_sd[state.DELAY] = parameters.considered_delay_sd_s
    memory.considered_sd[state.CREEP_FORWARD] = parameters.creep_forward_sd
    memory.considered_sd[state.CREEP_LEFT] = parameters.creep_forward_sd
    memory.considered_sd[state.CREEP_DOWN] = parameters.creep_down_sd_m


@njit(**INNER_KERNEL)
def propagate_considered(memory: state.FilterState, R: Mat3, rate: Vec3, dt: float, across: Vec3) -> None:
    """Adds what each considered error of size 1 does to the attitude over one interval.

    The rows of the considered errors in the covariance hold the derivative of every error state by each of them. They
    have no variance of their own: propagation and updates of the covariance then change them as they change the error
    of a filter that does not know of these errors (Schmidt 1966; Woodbury & Junkins 2010, AIAA 2010-7752). A scale
    error rotates by a share of the rotation, across or along the sole's normal. A rate that is late by τ rotates by τ
    times the change of the rate.

    Args:
        memory: State of the foot, changed in place; its ring holds the sample.
        R: (3, 3) rotation, sensor to world, in the middle of the interval.
        rate: (3,) rad/s, angular rate of the sample.
        dt: Length of the interval, s.
        across: (3,) rad, rotation across the sole's normal over the interval, world axes.
    """
    if memory.considered < 0:
        return
    rotation = matvec(R, times(dt, axpy(rate, -1.0, vec3_at(memory.nominal, state.GYRO_BIAS))))
    _add_rotation(memory, state.SCALE_ACROSS, across)
    _add_rotation(memory, state.SCALE_ALONG, axpy(rotation, -1.0, across))
    if memory.clock[state.FILL] > 1:  # the ring has a sample before this one
        missing = axpy(state.rate_of(memory, state.ring_row(memory, 1)), -1.0, rate)  # of the true rate, times dt / τ
        _add_rotation(memory, state.DELAY, matvec(R, missing))


@njit(**INNER_KERNEL)
def _add_rotation(memory: state.FilterState, error: int, rotation: Vec3) -> None:
    """Adds a rotation (rad, world axes) to the derivative of the attitude's error by one considered error."""
    P, c, a = memory.covariance, memory.considered + error, memory.row + state.D_ATTITUDE
    for i in range(3):
        P[c, a + i] -= rotation[i]
        P[a + i, c] = P[c, a + i]


@njit(**INNER_KERNEL)
def settle_considered(memory: state.FilterState) -> None:
    """Moves what the considered errors have done so far into the covariance, and begins anew.

    An alignment calls this, which sets all correlations to 0.
    """
    P, c = memory.covariance, memory.considered
    if c < 0:
        return
    for error in range(state.CONSIDERED):
        variance = memory.considered_sd[error] ** 2
        for i in range(c):
            for j in range(c):
                P[i, j] += variance * P[c + error, i] * P[c + error, j]
        for j in range(P.shape[0]):
            P[c + error, j] = P[j, c + error] = 0.0


@njit(**INNER_KERNEL)
def add_considered(memory: state.FilterState, covariance: Array) -> None:
    """Adds the considered errors to a reported covariance (6, 6) of position (m) and attitude (rad), in place."""
    P, c = memory.covariance, memory.considered
    if c < 0:
        return
    for error in range(state.CONSIDERED):
        variance = memory.considered_sd[error] ** 2
        for i in range(6):
            row = memory.row + (state.D_POSITION + i if i < 3 else state.D_ATTITUDE + i - 3)
            for j in range(6):
                column = memory.row + (state.D_POSITION + j if j < 3 else state.D_ATTITUDE + j - 3)
                covariance[i, j] += variance * P[c + error, row] * P[c + error, column]
