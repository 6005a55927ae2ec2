"""The compiled filter, sample by sample."""

from __future__ import annotations

import math

from numba import njit

from stridetwin.estimators.foot_ins import state
from stridetwin.estimators.foot_ins.alignment import align, begin
from stridetwin.estimators.foot_ins.clipping import restore_peaks
from stridetwin.estimators.foot_ins.considered import add_considered, begin_considered
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.rest import bend_path, learn_bias_at_rest
from stridetwin.estimators.foot_ins.slope import HEIGHT_SD
from stridetwin.estimators.foot_ins.stance import (
    append_sample,
    level_floor_update,
    motion_statistic,
    move_contact_point,
    stationary_speed_sd,
    unknown_bias_statistic,
    vary_height_drift,
    zero_velocity_update,
)
from stridetwin.estimators.foot_ins.straight import learn_bias_on_straight_way
from stridetwin.estimators.foot_ins.strapdown import predict
from stridetwin.streams.algebra.matrices import copy
from stridetwin.streams.algebra.tuples import Vec3, axpy, store_vec3_at, vec3_at
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

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
        memory.start_s[0] = t_ns * 1e-9
        store_vec3_at(vec3_at(memory.nominal, state.POSITION), memory.path, 0)  # start of the path, m
        if memory.prior[0, 0] == 0.0:  # no earlier recording tells the class of the part
            undecided = parameters.wide_bias_share * parameters.gyro_wide_bias_sd_radps**2
            memory.unlearnt[state.UNLEARNT_VARIANCE] = undecided
        memory.unlearnt[state.UNLEARNT_HEIGHT] = parameters.stance_height_sd_m**2
        begin_considered(memory, parameters)
        memory.path[3] = parameters.path_scale_sd  # share of the path's length that stays unknown
    elif t_ns <= clock[state.T_LAST]:
        return state.IGNORED, 0.0, 0.0
    dt = (t_ns - clock[state.T_LAST]) * 1e-9
    if dt > MAX_GAP_S:
        begin(memory, t_ns)
    append_sample(memory, t_ns, rate, force)
    statistic = motion_statistic(memory, parameters)
    memory.peak[0] = max(statistic, memory.peak[0] * math.exp(-dt / _PEAK_DECAY_S))  # decaying peak of the statistic
    phase = state.NAVIGATING
    if clock[state.PHASE] == state.ALIGNING:
        phase = state.ALIGNING
        align(memory, parameters, t_ns, force, statistic)
    else:
        clock[state.T_KNOWN] = t_ns  # the last time at which the filter followed the foot
    clock[state.T_LAST] = t_ns
    return phase, dt, statistic


@njit(**INNER_KERNEL)
def _may_rest(memory: state.FilterState, parameters: KernelParameters) -> bool:
    """Whether even the recent peak of the motion statistic is low, but for what an unknown gyro bias adds to it."""
    return memory.peak[0] < parameters.rest_level + unknown_bias_statistic(memory)


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
    if phase == state.ALIGNING:
        learn_bias_at_rest(memory, parameters, rate, dt, _may_rest(memory, parameters))
    if phase != state.NAVIGATING:
        return phase, math.inf
    predict(memory, parameters, rate, force, dt)
    bend_path(memory, dt)
    restore_peaks(memory, parameters)
    move_contact_point(memory, parameters, dt)
    vary_height_drift(memory, parameters, dt)
    speed_sd = stationary_speed_sd(statistic, memory.peak[0], parameters)
    if speed_sd < _MAX_VELOCITY_SD_MPS:  # with a larger one, the foot counts as moving
        zero_velocity_update(memory, parameters, t_ns, rate, dt, statistic, speed_sd)
        memory.clock[state.T_STANCE] = t_ns
    else:
        speed_sd = math.inf
    level_floor_update(memory, parameters, t_ns, speed_sd)
    if memory.clock[state.T_STOOD] == t_ns and parameters.wander_m > 0.0:  # a stance has just begun
        learn_bias_on_straight_way(memory, parameters, t_ns)
    learn_bias_at_rest(memory, parameters, rate, dt, _may_rest(memory, parameters))
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
    unlearnt, turn = memory.unlearnt[state.UNLEARNT_VARIANCE], memory.unlearnt[state.UNLEARNT_TURN]
    bent = vec3_at(memory.unlearnt, state.UNLEARNT_POSITION)
    covariance[2, 2] += memory.unlearnt[state.UNLEARNT_HEIGHT] + memory.levelled[HEIGHT_SD] ** 2
    for i in range(3):
        for j in range(3):
            covariance[i, j] += unlearnt * bent[i] * bent[j]
        covariance[i, 5] += unlearnt * bent[i] * turn
        covariance[5, i] += unlearnt * bent[i] * turn
    covariance[5, 5] += unlearnt * turn * turn
    add_considered(memory, covariance)
