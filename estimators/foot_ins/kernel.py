"""The compiled filter, sample by sample."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.foot_ins import state
from stridetwin.estimators.foot_ins.alignment import align, begin
from stridetwin.estimators.foot_ins.clipping import restore_peaks
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.stance import (
    append_sample,
    level_floor_update,
    motion_statistic,
    move_contact_point,
    stationary_speed_sd,
    unknown_bias_statistic,
    vary_height_drift,
    zero_rate_update,
    zero_velocity_update,
)
from stridetwin.estimators.foot_ins.strapdown import predict
from stridetwin.streams.algebra.matrices import copy
from stridetwin.streams.algebra.tuples import Vec3, axpy, store_vec3_at, vec3_at
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Array

_entry_kernel = entry_kernel(Path(__file__).parent, llvm_level=1)

_MAX_RATE_RADPS = 100.0  # a larger angular rate is ignored: no foot moves so
_MAX_FORCE_MPS2 = 5000.0  # a larger specific force is ignored
MAX_GAP_S = 0.3  # after a longer gap the filter aligns again
_PEAK_DECAY_S = 0.2  # decay time of the statistic's peak [real walks]
_MAX_VELOCITY_SD_MPS = 2.0  # zero-velocity updates with a larger standard deviation are skipped


@njit(**INNER_KERNEL)
def is_possible(rate: Vec3, force: Vec3) -> bool:
    """Whether a sensor on a foot can have measured this; False for NaN."""
    possible = True
    for i in range(3):
        possible = possible and abs(rate[i]) <= _MAX_RATE_RADPS
        possible = possible and abs(force[i]) <= _MAX_FORCE_MPS2
    return possible


@njit(**INNER_KERNEL)
def add_sample(
    memory: state.FilterState, parameters: KernelParameters, t_ns: int, rate: Vec3, force: Vec3
) -> tuple[int, float, float]:
    """Takes a sample into the ring of the last samples and, until the filter is aligned, into the alignment.

    The first sample begins an alignment and sets the start of the path. After a gap of more than `MAX_GAP_S` the filter
    begins a new alignment. Impossible samples, and those not later than the last one, change nothing.

    Args:
        memory: State of the foot, changed in place.
        parameters: Parameters of the filter.
        t_ns: Time of the sample.
        rate: (3,) rad/s, angular rate.
        force: (3,) m/s², specific force.

    Returns:
        Phase in which the sample is used (IGNORED, ALIGNING or NAVIGATING); time since the last one, s; motion
        statistic.
    """
    clock = memory.clock
    if not is_possible(rate, force):
        return state.IGNORED, 0.0, 0.0
    if clock[state.PHASE] == state.EMPTY:
        begin(memory, t_ns)
        clock[state.T_LAST] = t_ns
        store_vec3_at(vec3_at(memory.nominal, state.POSITION), memory.path, 0)  # start of the path, m
        memory.path[3] = parameters.path_scale_sd  # share of the path's length that stays unknown
    elif t_ns <= clock[state.T_LAST]:
        return state.IGNORED, 0.0, 0.0
    dt = (t_ns - clock[state.T_LAST]) * 1e-9
    if dt > MAX_GAP_S:
        begin(memory, t_ns)
    append_sample(memory, t_ns, rate, force)
    statistic = motion_statistic(memory, parameters)
    phase = state.NAVIGATING
    if clock[state.PHASE] == state.ALIGNING:
        phase = state.ALIGNING
        memory.peak[0] = statistic  # recent peak of the statistic
        align(memory, parameters, t_ns, force, statistic)
    else:
        clock[state.T_KNOWN] = t_ns  # the last time at which the filter followed the foot
    clock[state.T_LAST] = t_ns
    return phase, dt, statistic


@njit(**INNER_KERNEL)
def step(
    memory: state.FilterState, parameters: KernelParameters, t_ns: int, rate: Vec3, force: Vec3
) -> tuple[int, float]:
    """One step of the filter: propagates the state over the sample's interval, then applies all updates that are due.

    These are the reconstruction of a clipped peak, zero velocity, level floor and, for a foot long at rest, zero rate.

    Args:
        memory: State of the foot, changed in place.
        parameters: Parameters of the filter.
        t_ns: End of the sample's interval.
        rate: (3,) rad/s, mean over the interval.
        force: (3,) m/s², mean specific force over the interval.

    Returns:
        Phase in which the sample was used (IGNORED, ALIGNING or NAVIGATING); standard deviation of the stationary
        foot's speed, m/s, inf while it is not detected as stationary.
    """
    phase, dt, statistic = add_sample(memory, parameters, t_ns, rate, force)
    if phase != state.NAVIGATING:
        return phase, math.inf
    memory.peak[0] = max(statistic, memory.peak[0] * math.exp(-dt / _PEAK_DECAY_S))  # decaying peak of the statistic
    predict(memory, parameters, rate, force, dt)
    restore_peaks(memory, parameters)
    move_contact_point(memory, parameters, dt)
    vary_height_drift(memory, parameters, dt)
    speed_sd = stationary_speed_sd(statistic, memory.peak[0], parameters)
    if speed_sd < _MAX_VELOCITY_SD_MPS:  # with a larger one, the foot counts as moving
        zero_velocity_update(memory, parameters, rate, dt, speed_sd)
    else:
        speed_sd = math.inf
    level_floor_update(memory, parameters, t_ns, speed_sd)
    # at rest for long: even the recent peak of the statistic is low, but for what an unknown gyro bias adds to it
    if memory.peak[0] < parameters.rest_level + unknown_bias_statistic(memory):
        zero_rate_update(memory, parameters, rate, dt)
    return state.NAVIGATING, speed_sd


@njit(**INNER_KERNEL)
def write_estimate(memory: state.FilterState, nominal: Array, covariance: Array) -> None:
    """Writes the nominal state, and the covariance of position and attitude, into the last two arguments.

    The filter may be wrong about the length of the path by a constant share, which no update of one foot can observe.
    This error is no state of the filter. Only the reported covariance of the position has it: along the straight line
    from the first sample to here, it adds the variance (share × length)².

    Args:
        memory: State of the foot. `memory.row` is the first of this foot's 21 rows in `memory.covariance`, which may
            hold both feet. `memory.path` is the position of the first sample (entries 0-2, m) and the share (entry 3).
        nominal: (22,) written: nominal state.
        covariance: (6, 6) written: of position (m) and attitude (rad), world axes.
    """
    P = memory.covariance
    position, attitude = memory.row + state.D_POSITION, memory.row + state.D_ATTITUDE
    way = axpy(vec3_at(memory.nominal, state.POSITION), -1.0, vec3_at(memory.path, 0))  # from the first sample, m
    copy(memory.nominal, nominal)
    for i in range(3):
        for j in range(3):
            covariance[i, j] = P[position + i, position + j] + memory.path[3] ** 2 * (way[i] * way[j])
            covariance[i, 3 + j] = P[position + i, attitude + j]
            covariance[3 + i, j] = P[attitude + i, position + j]
            covariance[3 + i, 3 + j] = P[attitude + i, attitude + j]


@_entry_kernel
def run(
    memory: state.FilterState,
    parameters: KernelParameters,
    t_ns: NDArray[np.int64],
    rate: Array,
    force: Array,
    phase: NDArray[np.int8],
    speed: Array,
    nominal: Array,
    covariance: Array,
) -> None:
    """Takes N samples, and writes the results of `step` and the estimate after each.

    Args:
        memory: State of the foot, changed in place.
        parameters: Parameters of the filter.
        t_ns: (N,) int64, times.
        rate: (N, 3) rad/s, angular rate.
        force: (N, 3) m/s², specific force.
        phase: (N,) int8, written: phase in which each sample was used.
        speed: (N,) written: standard deviation of a stationary foot's speed, m/s; inf where it is not stationary.
        nominal: (N, 22) written: nominal states.
        covariance: (N, 6, 6) written: of position (m) and attitude (rad), world axes.
    """
    for k in range(len(t_ns)):
        phase[k], speed[k] = step(memory, parameters, t_ns[k], vec3_at(rate[k], 0), vec3_at(force[k], 0))
        write_estimate(memory, nominal[k], covariance[k])
