"""The gyro's turn-on bias, learnt from what is truly rest: docs/foot_ins.md (18)."""

from __future__ import annotations

import math

from numba import njit

from stridetwin.estimators.foot_ins import state
from stridetwin.estimators.foot_ins.kalman import apply_gated_update, clear
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.stance import inject
from stridetwin.streams.algebra.matrices import clear as zero
from stridetwin.streams.algebra.tuples import Vec3, axpy, dot, quaternion_at, store_vec3_at, to_matrix, vec3_at
from stridetwin.streams.compiled import INNER_KERNEL

_BLOCK_S = 0.1  # span over which rates are averaged before their spread counts
_LEAST_BLOCKS = 3  # of a rest: over fewer the spread is too uncertain
_FIRST_S = 1.0  # of a rest that goes on: what it told is used from here on
_LONGEST_S = 10.0  # of a rest, after which the next one begins: the bias wanders
# A foot that stands sways: the mean of its rate over a rest is off by `_SWAY_S` over the rest's length times the spread
# of the blocks' rates, because sway turns back. [real walks: over 0.3, 0.5, 1 and 2 s the error is 0.9, 0.55, 0.35 and
# 0.2 of the spread, which is 0.27 to 0.4 s over the length; the largest is rounded up, because rests are few]
_SWAY_S = 0.45
_MAX_SWAY_RADPS = 0.0087  # with a larger spread the foot is not at rest [real walks: errors have long tails beyond]
# Spread of the rates of a standing foot before its blocks count, and the number of blocks that this is worth.
_PRIOR_SWAY_RADPS, _PRIOR_BLOCKS = 0.0017, 1.0

# Entries of `FilterState.rest`: samples, time and sum of the rates of the current block; blocks so far, their time, sum
# and sum of squares; sum of squared changes from sample to sample, and their number; information so far, and its mean.
SAMPLES, BLOCK_S, BLOCK_SUM = 0, 1, 2
BLOCKS, REST_S, SUM, SQUARES = 5, 6, 7, 10
CHANGES2, CHANGES = 11, 12
INFORMATION, MEAN = 13, 14
USED, USED_MEAN = 17, 18


@njit(**INNER_KERNEL)
def learn_bias_at_rest(
    memory: state.FilterState, parameters: KernelParameters, rate: Vec3, dt: float, is_quiet: bool
) -> None:
    """Takes one sample into the rest of a foot that may stand still, whose mean rate is the gyro's bias.

    Slow turning is no rest, although its rates are small: so the spread of the rates decides. Averages over blocks of
    `_BLOCK_S` differ by the sensor's noise and by the sway of the foot. With the noise's density N, the length T of the
    rest and the sway's spread s, the mean of all has the variance N²/T + (`_SWAY_S` s / T)². What a longer rest adds is
    the difference of the informations (inverse variances), which the update applies; so a rest counts once, however
    often it is asked. A spread beyond `_MAX_SWAY_RADPS` ends the rest.

    Args:
        memory: State of the foot, changed in place.
        parameters: Parameters of the filter.
        rate: (3,) rad/s, angular rate of the sample.
        dt: Length of the sample's interval, s.
        is_quiet: Whether the motion statistic allows a rest.
    """
    rest = memory.rest
    if not is_quiet:
        _finish_rest(memory, parameters)
        return
    if memory.clock[state.FILL] > 1:  # the ring has a sample before this one
        change = axpy(rate, -1.0, state.rate_of(memory, state.ring_row(memory, 1)))
        rest[CHANGES2] += dot(change, change)
        rest[CHANGES] += 1.0
    rest[SAMPLES] += 1.0
    rest[BLOCK_S] += dt
    for i in range(3):
        rest[BLOCK_SUM + i] += rate[i]
    if rest[BLOCK_S] < _BLOCK_S - 0.5 * dt or rest[CHANGES] == 0.0:
        return
    for i in range(3):
        mean = rest[BLOCK_SUM + i] / rest[SAMPLES]
        rest[SUM + i] += mean
        rest[SQUARES] += mean * mean
        rest[BLOCK_SUM + i] = 0.0
    # variance of a sample's noise on one axis, by the changes; and of a block's mean
    noise2 = rest[CHANGES2] / rest[CHANGES] / 6.0
    block_noise2 = noise2 / rest[SAMPLES]
    density2 = max(noise2 * rest[BLOCK_S] / rest[SAMPLES], parameters.rest_rate_noise_radps_rthz**2)
    rest[REST_S] += rest[BLOCK_S]
    rest[BLOCKS] += 1.0
    rest[SAMPLES] = rest[BLOCK_S] = 0.0
    n, whole = rest[BLOCKS], vec3_at(rest, SUM)
    squares = rest[SQUARES] - dot(whole, whole) / n  # about the mean, on three axes
    # spread of the blocks beyond the noise, variance on one axis, with what a standing foot sways otherwise
    excess2 = max(squares - 3.0 * (n - 1.0) * block_noise2, 0.0) / 3.0
    sway2 = (excess2 + _PRIOR_BLOCKS * _PRIOR_SWAY_RADPS**2) / (n - 1.0 + _PRIOR_BLOCKS)
    if sway2 > _MAX_SWAY_RADPS**2 and n > 1.0:
        _finish_rest(memory, parameters)
        return
    if n < _LEAST_BLOCKS:
        return
    T = rest[REST_S]
    information = 1.0 / (density2 / T + sway2 * (_SWAY_S / T) ** 2)
    if information > rest[INFORMATION]:  # otherwise the foot sways more than before
        rest[INFORMATION] = information
        for i in range(3):
            rest[MEAN + i] = whole[i] / n
    if T >= _FIRST_S:
        _use_rest(memory, parameters)
    if T >= _LONGEST_S:
        _finish_rest(memory, parameters)


@njit(**INNER_KERNEL)
def _finish_rest(memory: state.FilterState, parameters: KernelParameters) -> None:
    """Uses what a rest has told and the filter has not used yet, and forgets it."""
    if memory.rest[INFORMATION] > memory.rest[USED]:
        _use_rest(memory, parameters)
    zero(memory.rest)


@njit(**INNER_KERNEL)
def _use_rest(memory: state.FilterState, parameters: KernelParameters) -> None:
    """Updates the bias by what the rest tells beyond what was used of it."""
    rest = memory.rest
    gained = rest[INFORMATION] - rest[USED]
    if gained <= 0.0 or memory.clock[state.PHASE] != state.NAVIGATING:
        return
    mean = vec3_at(rest, MEAN)
    if memory.unlearnt[state.UNLEARNT_VARIANCE] > 0.0:
        _decide_class(memory, parameters, mean, 1.0 / rest[INFORMATION])
    # what the longer rest adds, as a measurement of its own
    weighted = axpy(axpy((0.0, 0.0, 0.0), rest[INFORMATION], mean), -rest[USED], vec3_at(rest, USED_MEAN))
    _bias_update(memory, parameters, axpy((0.0, 0.0, 0.0), 1.0 / gained, weighted), math.sqrt(1.0 / gained))
    rest[USED] = rest[INFORMATION]
    store_vec3_at(mean, rest, USED_MEAN)


@njit(**INNER_KERNEL)
def _decide_class(memory: state.FilterState, parameters: KernelParameters, mean: Vec3, variance: float) -> None:
    """Decides by the first rest whether the turn-on bias is that of a calibrated or of a consumer part.

    Args:
        memory: State of the foot, changed in place.
        parameters: Parameters of the filter.
        mean: (3,) rad/s, mean rate over the rest.
        variance: Its variance on each axis, (rad/s)².
    """
    unlearnt = memory.unlearnt
    narrow2, wide2 = parameters.gyro_bias_sd_radps**2, parameters.gyro_wide_bias_sd_radps**2
    log_ratio = 0.0
    for i in range(3):
        log_ratio += 0.5 * mean[i] ** 2 * (1.0 / (narrow2 + variance) - 1.0 / (wide2 + variance))
        log_ratio -= 0.5 * math.log((wide2 + variance) / (narrow2 + variance))
    # `UNLEARNT_VARIANCE` is the prior probability times the variance of the wide class
    wide = parameters.wide_bias_share
    wide = wide / (wide + (1.0 - wide) * math.exp(-min(log_ratio, 50.0)))
    add_unlearnt(memory, wide * (wide2 - narrow2))
    unlearnt[state.UNLEARNT_VARIANCE] = 0.0


@njit(**INNER_KERNEL)
def add_unlearnt(memory: state.FilterState, variance: float) -> None:
    """Adds a variance (rad/s)² to the bias on each axis, with the path that a constant bias has bent so far."""
    P, o, x, unlearnt = memory.covariance, memory.row, memory.nominal, memory.unlearnt
    up = to_matrix(quaternion_at(x, state.ATTITUDE))[2]  # in the sensor
    for i in range(3):
        for j in range(3):
            same = 1.0 if i == j else 0.0
            P[o + state.D_GYRO_BIAS + i, o + state.D_GYRO_BIAS + j] += variance * (same - up[i] * up[j])
    turn = unlearnt[state.UNLEARNT_TURN]
    g = memory.work.gain  # the error of every state by the bias about the vertical
    zero(g)
    for i in range(3):
        g[o + state.D_POSITION + i] = unlearnt[state.UNLEARNT_POSITION + i]
        g[o + state.D_GYRO_BIAS + i] = up[i]
    g[o + state.D_VELOCITY] = -turn * x[state.VELOCITY + 1]
    g[o + state.D_VELOCITY + 1] = turn * x[state.VELOCITY]
    g[o + state.D_ATTITUDE + 2] = turn
    for i in range(o, o + state.STATES):
        for j in range(o, o + state.STATES):
            P[i, j] += variance * g[i] * g[j]


@njit(**INNER_KERNEL)
def bend_path(memory: state.FilterState, dt: float) -> None:
    """Propagates by `dt` (s) what a bias of 1 rad/s about the vertical does to heading (rad) and position (m)."""
    unlearnt, x = memory.unlearnt, memory.nominal
    turn = unlearnt[state.UNLEARNT_TURN] - 0.5 * dt
    unlearnt[state.UNLEARNT_POSITION] -= dt * turn * x[state.VELOCITY + 1]
    unlearnt[state.UNLEARNT_POSITION + 1] += dt * turn * x[state.VELOCITY]
    unlearnt[state.UNLEARNT_TURN] -= dt


@njit(**INNER_KERNEL)
def _bias_update(memory: state.FilterState, parameters: KernelParameters, rate: Vec3, sd: float) -> None:
    """Update with ω = b_g, of a standard deviation of `sd` (rad/s) on each axis.

    If the rate is improbable as a bias, the noise of the update grows in proportion to the excess of the innovation
    over `innovation_gate`.
    """
    work = memory.work
    clear(work, 3)
    for i in range(3):
        work.jacobian[i, state.D_GYRO_BIAS + i] = 1.0 / sd
        work.innovation[i] = (rate[i] - memory.nominal[state.GYRO_BIAS + i]) / sd
    length = apply_gated_update(memory.covariance, memory.error, work, memory.row, 3, parameters.innovation_gate)
    memory.nis[state.BY_RATE, 0] += length**2 / 3.0  # per degree of freedom: 3 axes
    memory.nis[state.BY_RATE, 1] += 1.0
    inject(memory)
