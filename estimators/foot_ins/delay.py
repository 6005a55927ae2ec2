"""Delay between gyro and accelerometer of one part: found by the zero-velocity updates of filters with other delays.

docs/foot_ins.md, "Delay of a channel".
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.foot_ins import state
from stridetwin.estimators.foot_ins.kernel import is_possible, step, write_estimate
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.streams.algebra.matrices import copy, copy_matrix
from stridetwin.streams.algebra.tuples import (
    Vec3,
    axpy,
    exp,
    matvec,
    multiply,
    normalized,
    quaternion_at,
    store_quaternion_at,
    store_vec3_at,
    times,
    to_matrix,
    vec3_at,
)
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Array

_entry_kernel = entry_kernel(Path(__file__).parent, llvm_level=1)

STEP_S = 0.005  # between the delays of the candidates
# Candidates: multiples of that step by which the force is later than the rate.
MULTIPLES = (-3, -2, -1, 1, 2, 3)
# A delay counts if strides with it have innovations whose logarithm is less by `_LEAST_GAIN` in the mean, and by this
# many standard errors. [real walks, and twin parts with and without delay, seeds 0-2]
_LEAST_GAIN, _LEAST_SIGMAS = 0.25, 5.0
_LIKELY_SIGMAS = 2.0  # from which on a delay is considered in the covariance
_LEAST_STEPS = 1.25  # a shorter delay is less than what other errors of a part shift the best one by [twin]
_LEAST_STRIDES, _MOST_STRIDES = 6, 30  # before a decision
# Standard deviations of the delay that is left: where strides tell of none, and where one was found and compensated.
_NOT_FOUND_SD_S, _FOUND_SD_S = 0.0025, 0.0015
_LEAST_SWING_S = 0.2  # without a stance
_START_SAMPLES = 16  # after which the time between samples is known and the candidates begin
_MOST_INTERVAL_S = 0.012  # slower sensors have no candidates
_FAST_RADPS, _FAST_MPS2 = 3.0, 30.0  # beyond which an exact repetition is a limit
LINE = 64  # samples kept for the later channel

HEAD, FILL, SHIFT, UNIT, PHASE, STRIDES, STOOD_NS, FIRST_NS, LIMITED = range(9)
WAITING, COMPARING, DECIDED = range(3)


class DelayBank(NamedTuple):
    """Filters with other delays than the one in use, until a delay is chosen.

    Attributes:
        candidates: One foot's state for each of `MULTIPLES`.
        place: (9,) int64: newest row and fill of the line; samples by which the force is later than the rate, as used;
            samples per step; phase; strides so far; last time at which the foot stood; time of the first sample, ns;
            whether a channel was limited in this stride.
        line: (LINE, 6) rad/s and m/s², the last samples.
        begun: (7, 2) sum of the normalised innovation squared and number of updates at the begin of the stride; row 0:
            the filter in use, then the candidates.
        gains: (6, 2) by candidate: sum, and sum of squares, of what it gains in a stride: difference of logarithms.
        known: (2,) 1 if the delay is known from an earlier recording, and that delay, s.
    """

    candidates: tuple[
        state.FilterState,
        state.FilterState,
        state.FilterState,
        state.FilterState,
        state.FilterState,
        state.FilterState,
    ]
    place: NDArray[np.int64]
    line: Array
    begun: Array
    gains: Array
    known: Array


def initial_bank(force_later_s: float | None = None) -> DelayBank:
    """A bank without samples; if the delay is known, nothing is compared."""
    place = np.zeros(9, np.int64)
    a, b, c, d, e, f = (state.initial_state() for _ in MULTIPLES)
    return DelayBank(
        candidates=(a, b, c, d, e, f),
        place=place,
        line=np.zeros((LINE, 6)),
        begun=np.zeros((1 + len(MULTIPLES), 2)),
        gains=np.zeros((len(MULTIPLES), 2)),
        known=np.zeros(2) if force_later_s is None else np.array([1.0, force_later_s]),
    )


def sample_rate_hz(memory: state.FilterState) -> float:
    """Rate of the last samples, Hz; 0 before two of them."""
    n = int(memory.clock[state.FILL])
    if n < 2:
        return 0.0
    head = int(memory.clock[state.HEAD])
    span_ns = memory.ring_t_ns[head] - memory.ring_t_ns[(head - n + 1) % state.RING]
    return float((n - 1) / (span_ns * 1e-9))


def force_later_s(memory: state.FilterState, bank: DelayBank) -> float | None:
    """Time by which the force is later than the rate, s; None while the strides were too few to tell."""
    rate_hz = sample_rate_hz(memory)
    if rate_hz == 0.0 or (bank.place[PHASE] != DECIDED and bank.place[STRIDES] <= 2 * _LEAST_STRIDES):
        return None
    return float(bank.place[SHIFT] / rate_hz)


@njit(**INNER_KERNEL)
def _past(bank: DelayBank, back: int, first: int) -> Vec3:
    """Rate (`first` = 0) or force (`first` = 3) of the sample `back` samples ago, or of the oldest one known."""
    row = (bank.place[HEAD] - min(back, bank.place[FILL] - 1)) % LINE
    return vec3_at(bank.line[row], first)


@njit(**INNER_KERNEL)
def copy_state(source: state.FilterState, target: state.FilterState) -> None:
    """Copies everything that a filter knows."""
    copy(source.nominal, target.nominal)
    copy_matrix(source.covariance, target.covariance)
    copy(source.error, target.error)
    copy(source.tilted, target.tilted)
    copy(source.start_sd, target.start_sd)
    for i in range(len(source.clock)):
        target.clock[i] = source.clock[i]
    for i in range(len(source.ring_t_ns)):
        target.ring_t_ns[i] = source.ring_t_ns[i]
    copy_matrix(source.ring, target.ring)
    copy_matrix(source.restored, target.restored)
    copy_matrix(source.force_sum, target.force_sum)
    copy(source.lever, target.lever)
    copy(source.peak, target.peak)
    copy(source.norm, target.norm)
    copy(source.floor, target.floor)
    copy(source.path, target.path)
    copy(source.extreme, target.extreme)
    copy_matrix(source.nis, target.nis)
    copy_matrix(source.hidden, target.hidden)
    copy(source.rest, target.rest)
    copy(source.unlearnt, target.unlearnt)
    copy(source.considered_sd, target.considered_sd)
    copy(source.levelled, target.levelled)
    copy(source.creep, target.creep)
    copy(source.straight, target.straight)
    copy(source.start_s, target.start_s)
    copy_matrix(source.prior, target.prior)
    copy(source.filled, target.filled)


@njit(**INNER_KERNEL)
def step_aligned(
    memory: state.FilterState, bank: DelayBank, parameters: KernelParameters, t_ns: int, rate: Vec3, force: Vec3
) -> tuple[int, float]:
    """`kernel.step` with the earlier channel delayed, so that rate and force belong together.

    Until a delay is chosen, the candidates take each sample, too.
    """
    place = bank.place
    clock = memory.clock
    used = is_possible(rate, force) and (clock[state.PHASE] == state.EMPTY or t_ns > clock[state.T_LAST])
    if not used:
        return step(memory, parameters, t_ns, rate, force)
    if place[FILL] == 0:
        place[FIRST_NS] = t_ns
    place[HEAD] = (place[HEAD] + 1) % LINE
    place[FILL] += 1
    store_vec3_at(rate, bank.line[place[HEAD]], 0)
    store_vec3_at(force, bank.line[place[HEAD]], 3)
    _note_limit(bank, rate, force)
    shift = place[SHIFT]
    phase, speed_sd = step(memory, parameters, t_ns, _past(bank, max(shift, 0), 0), _past(bank, max(-shift, 0), 3))
    if place[PHASE] == WAITING and place[FILL] >= _START_SAMPLES:
        _start(memory, bank, t_ns)
    elif place[PHASE] == COMPARING:
        for k in range(len(bank.candidates)):
            later = MULTIPLES[k] * place[UNIT]
            step(
                bank.candidates[k],
                parameters,
                t_ns,
                _past(bank, max(later, 0), 0),
                _past(bank, max(-later, 0), 3),
            )
        if math.isfinite(speed_sd):
            if (t_ns - place[STOOD_NS]) * 1e-9 > _LEAST_SWING_S:  # a stride ends
                _compare(memory, bank, parameters)
            place[STOOD_NS] = t_ns
    return phase, speed_sd


@njit(**INNER_KERNEL)
def _note_limit(bank: DelayBank, rate: Vec3, force: Vec3) -> None:
    """Notes whether a fast channel repeats its value exactly: it is limited, and that looks like a delay."""
    for i in range(3):
        turns = abs(rate[i]) > _FAST_RADPS and rate[i] == _past(bank, 1, 0)[i]
        pushes = abs(force[i]) > _FAST_MPS2 and force[i] == _past(bank, 1, 3)[i]
        if turns or pushes:
            bank.place[LIMITED] = 1


@njit(**INNER_KERNEL)
def _start(memory: state.FilterState, bank: DelayBank, t_ns: int) -> None:
    """Begins the candidates with the state of the filter in use."""
    place = bank.place
    interval_s = (t_ns - place[FIRST_NS]) * 1e-9 / (place[FILL] - 1)
    if bank.known[0] > 0.0:
        most = LINE - 1
        place[SHIFT] = min(max(round(bank.known[1] / interval_s), -most), most)
        memory.considered_sd[state.DELAY] = _FOUND_SD_S
        place[PHASE] = DECIDED
        return
    if interval_s > _MOST_INTERVAL_S:
        place[PHASE] = DECIDED
        return
    place[UNIT] = min(max(round(STEP_S / interval_s), 1), (LINE - 1) // 3)
    for k in range(len(bank.candidates)):
        copy_state(memory, bank.candidates[k])
    place[PHASE] = COMPARING


@njit(**INNER_KERNEL)
def _stride_nis(memory: state.FilterState, begun: Array) -> float:
    """Mean normalised innovation squared since the begin of the stride, 0 without updates; begins the next one."""
    total, count = memory.nis[state.BY_VELOCITY, 0] - begun[0], memory.nis[state.BY_VELOCITY, 1] - begun[1]
    begun[0], begun[1] = memory.nis[state.BY_VELOCITY, 0], memory.nis[state.BY_VELOCITY, 1]
    return total / count if count > 0.0 else 0.0


@njit(**INNER_KERNEL)
def _compare(memory: state.FilterState, bank: DelayBank, parameters: KernelParameters) -> None:
    """Compares the candidates at the end of a stride, and chooses a delay once one is significantly better."""
    place, gains = bank.place, bank.gains
    in_use = _stride_nis(memory, bank.begun[0])
    limited, place[LIMITED] = place[LIMITED] == 1, 0
    if limited:  # begins the next stride
        for k in range(len(bank.candidates)):
            _stride_nis(bank.candidates[k], bank.begun[1 + k])
        return
    place[STRIDES] += 1
    n = place[STRIDES] - 1  # the first stance is no stride
    best, best_mean, is_sure = -1, 0.0, False
    for k in range(len(bank.candidates)):
        nis = _stride_nis(bank.candidates[k], bank.begun[1 + k])
        if n > 0 and nis > 0.0 and in_use > 0.0:
            gain = math.log(in_use / nis)
            gains[k, 0] += gain
            gains[k, 1] += gain * gain
        mean = gains[k, 0] / max(n, 1)
        if mean > best_mean:
            error = math.sqrt(max(gains[k, 1] / n - mean * mean, 1e-12) / max(n - 1, 1))
            if mean > _LIKELY_SIGMAS * error:
                best, best_mean = k, mean
                is_sure = n >= _LEAST_STRIDES and mean > max(_LEAST_GAIN, _LEAST_SIGMAS * error)
    if best >= 0:  # not sure yet, but likely
        memory.considered_sd[state.DELAY] = abs(MULTIPLES[best]) * STEP_S
    elif n >= _LEAST_STRIDES:
        memory.considered_sd[state.DELAY] = min(_NOT_FOUND_SD_S, parameters.considered_delay_sd_s)
    if is_sure:
        _choose(memory, bank, best)
    elif n >= _MOST_STRIDES:
        place[PHASE] = DECIDED


@njit(**INNER_KERNEL)
def _gain_at(bank: DelayBank, multiple: int) -> float:
    """Sum of the gains of a multiple of the step; 0 is the filter in use."""
    for k in range(len(MULTIPLES)):
        if MULTIPLES[k] == multiple:
            return bank.gains[k, 0]
    return 0.0


@njit(**INNER_KERNEL)
def _choose(memory: state.FilterState, bank: DelayBank, best: int) -> None:
    """Goes on with the state of the best candidate, and with the delay at the top of the parabola of the gains.

    A delay shorter than `_LEAST_STEPS` changes nothing, and the comparison goes on.
    """
    place, middle = bank.place, MULTIPLES[best]
    steps = float(middle)
    if -3 < middle < 3:
        below, top, above = _gain_at(bank, middle - 1), bank.gains[best, 0], _gain_at(bank, middle + 1)
        steps += min(max(0.5 * (above - below) / max(2.0 * top - below - above, 1e-9), -0.5), 0.5)
    if abs(steps) < _LEAST_STEPS:
        return
    copy_state(bank.candidates[best], memory)
    memory.considered_sd[state.DELAY] = _FOUND_SD_S
    place[SHIFT] = round(steps * place[UNIT])
    place[PHASE] = DECIDED


@njit(**INNER_KERNEL)
def extrapolate(x: Array, memory: state.FilterState, bank: DelayBank, gravity: float) -> None:
    """Moves a nominal state (22,) from the time that both channels have reached to that of the newest sample."""
    shift = bank.place[SHIFT]
    if shift == 0 or memory.clock[state.FILL] < 2 or memory.clock[state.PHASE] != state.NAVIGATING:
        return
    newest = state.ring_row(memory, 0)
    dt = (memory.ring_t_ns[newest] - memory.ring_t_ns[state.ring_row(memory, 1)]) * 1e-9
    bias = vec3_at(x, state.GYRO_BIAS)
    force = axpy(state.force_of(memory, newest), -1.0, vec3_at(x, state.ACCEL_BIAS))
    q, v, p = quaternion_at(x, state.ATTITUDE), vec3_at(x, state.VELOCITY), vec3_at(x, state.POSITION)
    for k in range(abs(shift) - 1, -1, -1):
        # rates that are known already, or the last one; forces likewise
        rate = axpy(_past(bank, k if shift > 0 else 0, 0), -1.0, bias)
        if shift < 0:
            force = axpy(_past(bank, k, 3), -1.0, vec3_at(x, state.ACCEL_BIAS))
        half = exp(times(0.5 * dt, rate), state.SERIES_RAD)
        q = normalized(multiply(q, half))
        a = matvec(to_matrix(q), force)
        a = a[0], a[1], a[2] - gravity
        p = axpy(p, dt, axpy(v, 0.5 * dt, a))
        v = axpy(v, dt, a)
        q = normalized(multiply(q, half))
    store_vec3_at(p, x, state.POSITION)
    store_vec3_at(v, x, state.VELOCITY)
    store_quaternion_at(q, x, state.ATTITUDE)


@_entry_kernel
def run(
    memory: state.FilterState,
    bank: DelayBank,
    parameters: KernelParameters,
    t_ns: NDArray[np.int64],
    rate: Array,
    force: Array,
    phase: NDArray[np.int8],
    speed: Array,
    nominal: Array,
    covariance: Array,
) -> None:
    """Takes N samples, and writes the results of `step_aligned` and the estimate after each.

    Args:
        memory: State of the foot, changed in place.
        bank: Its delays, changed in place.
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
        phase[k], speed[k] = step_aligned(memory, bank, parameters, t_ns[k], vec3_at(rate[k], 0), vec3_at(force[k], 0))
        write_estimate(memory, nominal[k], covariance[k])
        extrapolate(nominal[k], memory, bank, parameters.gravity_mps2)
