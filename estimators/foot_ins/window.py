"""Window of the fixed-lag smoother: transitions of the error from sample to sample, and their sums, compiled.

Fixed-interval smoothing runs backward from the interval's end: the information of sample k+1, mapped through the
propagation of the error from k to k+1, applies to k. In the form of Bryson & Frazier 1963 (Bierman 1973, Automatica
9:503) it needs no inverse of a covariance, which here is singular: the start is known, and the floor is as high as the
stationary foot. A transition, from one sample to a later one, has three parts: Ψ maps the error (propagation,
corrections, shifts, new floors), and the corrections add the information J = Σ g gᵀ / s and the evidence
j = Σ g z / s about the initial error, where g = Ψ_iᵀ h with Ψ up to correction i. With both summed over all later
samples

    x_smoothed = x ⊕ P j,   P_smoothed = P - P J P.

Two consecutive transitions combine to Ψ = Ψ_b Ψ_a, J = J_a + Ψ_aᵀ J_b Ψ_a, j = j_a + Ψ_aᵀ j_b. That is associative, so
the transition over a sliding window takes three products per sample, however long the window is (two stacks, of which
the older is summed from its end).

When a clipped peak is restored (`clipping`), the filter's state jumps, and with it the stored samples since the peak
began: their error is now that of the state with the peak. So P becomes T_k P T_kᵀ, Ψ becomes T_k Ψ T_(k-1)⁻¹, and J
and j are mapped through T_(k-1)⁻¹, where T is the effect of `shift_covariance` on an error.

The filter computes Ψ, J and j as a by-product: `augment` extends its covariance by 21 rows, with covariance 0 of their
own and I with the error. Every linear operation on the error turns I into Ψᵀ; each correction subtracts g gᵀ / s from
the zeros and adds g z / s to the error of these rows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.foot_ins import state
from stridetwin.estimators.foot_ins.stance import inject
from stridetwin.estimators.foot_ins.strapdown import mirror, shift_covariance, shift_rows, transpose_rows
from stridetwin.streams.algebra.matrices import (
    add_transposed_matvec,
    add_transposed_product,
    clear,
    clear_block,
    copy,
    copy_matrix,
    multiply_into,
)
from stridetwin.streams.algebra.tuples import (
    Vec3,
    axpy,
    cross,
    multiply,
    normalized,
    quaternion_at,
    store_quaternion_at,
    store_vec3_at,
    vec3_at,
)
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

OLDEST, HELD, SUMMED = range(3)  # of `place`


class TransitionWindow(NamedTuple):
    """A ring of C samples, from the oldest held to the newest.

    Attributes:
        place: (3,) int64: row of the oldest sample; how many are held; how many of these, from the oldest on, have rows
            of `transition`, `information` and `evidence` that are summed up to the last of these.
        t_ns: (C,) int64, times.
        phase: (C,) int8, phase in which each was used.
        speed: (C,) standard deviation of the standing foot's speed, m/s.
        nominal: (C, 22) filtered nominal states.
        covariance: (C, 21, 21) of their errors.
        transition: (C + 1, 21, 21) Ψ from the sample before to this one; row C: over the samples not yet summed.
        information: (C + 1, 21, 21) J of the same transitions.
        evidence: (C + 1, 21) j of the same transitions.
        path: (4,) `FilterState.path` at the newest sample.
        unlearnt: (6,) `FilterState.unlearnt` at the newest sample.
        levelled: (7,) `FilterState.levelled` at the newest sample.
        considered: (C, 6, 21) derivatives of the filtered error by the considered errors.
        released: The sample that left last, smoothed.
        scratch: (2, 21, 21) overwritten.
    """

    place: NDArray[np.int64]
    t_ns: NDArray[np.int64]
    phase: NDArray[np.int8]
    speed: Array
    nominal: Array
    covariance: Array
    transition: Array
    information: Array
    evidence: Array
    path: Array
    unlearnt: Array
    considered: Array
    levelled: Array
    released: state.FilterState
    scratch: Array


def empty_window(capacity: int) -> TransitionWindow:
    """An empty window of at most `capacity` samples."""
    transition = np.zeros((capacity + 1, state.STATES, state.STATES))
    transition[capacity] = np.eye(state.STATES)  # over no samples
    return TransitionWindow(
        place=np.zeros(3, np.int64),
        t_ns=np.zeros(capacity, np.int64),
        phase=np.zeros(capacity, np.int8),
        speed=np.zeros(capacity),
        nominal=np.zeros((capacity, state.NOMINAL)),
        covariance=np.zeros((capacity, state.STATES, state.STATES)),
        transition=transition,
        information=np.zeros((capacity + 1, state.STATES, state.STATES)),
        evidence=np.zeros((capacity + 1, state.STATES)),
        path=np.zeros(4),
        unlearnt=np.zeros(6),
        levelled=np.zeros(state.LEVELLED),
        considered=np.zeros((capacity, state.CONSIDERED, state.STATES)),
        released=state.initial_state(),
        scratch=np.zeros((2, state.STATES, state.STATES)),
    )


def initial_augmented_state() -> state.FilterState:
    """State of a foot without samples, whose covariance has the rows that `augment` needs."""
    n = 2 * state.STATES
    rows = n + state.CONSIDERED
    return state.initial_state(np.zeros((rows, rows)), np.zeros(rows), considered=n)


@njit(**INNER_KERNEL)
def augment(memory: state.FilterState) -> None:
    """Prepares the additional 21 rows of covariance and error for the next sample, in place.

    Their covariance with each other is 0, with the foot's own 21 errors the identity; their error is 0. After the
    filter's step they hold the transition over the sample: see the module's docstring.
    """
    P, n = memory.covariance, 2 * state.STATES
    for i in range(state.STATES, n):
        for j in range(P.shape[0]):
            P[i, j] = P[j, i] = 1.0 if i == j + state.STATES else 0.0
        memory.error[i] = 0.0


@njit(**INNER_KERNEL)
def apply_restored(window: TransitionWindow, memory: state.FilterState) -> None:
    """Corrects the stored samples since a clipped peak began by the result of `restore_peaks`, in place.

    Two samples after a peak, the filter restores it and so moves its own state; the samples stored since the peak
    began are moved here. `memory.restored` has a row per sample, counted back from the newest: correction of position
    (entries 0-2, m), velocity (3-5, m/s) and attitude (quaternion, 6-9). It is added to the stored nominal states;
    covariances and transitions are mapped to the errors of the corrected states.

    Args:
        window: The samples held.
        memory: State after the sample at which the peak was restored, which the window does not hold yet.
    """
    place, capacity = window.place, len(window.t_ns)
    held, summed = place[HELD], place[SUMMED]  # numbers of samples
    moved = memory.restored  # the corrections
    reach = 0  # how many samples of the peak the window still holds, from the newest on
    for back in range(1, min(memory.clock[state.RESTORED], held) + 1):
        # both must be the same sample: the window's, and the filter's in its ring
        if window.t_ns[(place[OLDEST] + held - back) % capacity] != memory.ring_t_ns[state.ring_row(memory, back)]:
            break
        reach = back
    if reach == 0:
        return
    for back in range(1, reach + 1):  # samples back from the newest, 1 is the newest that the window holds
        i = (place[OLDEST] + held - back) % capacity
        x, dp, dv = window.nominal[i], vec3_at(moved[back], state.POSITION), vec3_at(moved[back], state.VELOCITY)
        store_vec3_at(axpy(vec3_at(x, state.POSITION), 1.0, dp), x, state.POSITION)
        store_vec3_at(axpy(vec3_at(x, state.VELOCITY), 1.0, dv), x, state.VELOCITY)
        q = multiply(quaternion_at(moved[back], state.ATTITUDE), quaternion_at(x, state.ATTITUDE))
        store_quaternion_at(normalized(q), x, state.ATTITUDE)
        shift_covariance(window.covariance[i], 0, dp, dv)
        if held - back >= summed:  # its transition is that from the sample before, not a sum
            _shift_transition(window, i, moved, back, back + 1, reach)
    last_summed = held - summed + 1  # the last sample that sums of transitions reach to, counted back
    if last_summed <= reach:
        for k in range(summed):  # the sum from the sample before sample k, counted from the oldest, to the last summed
            _shift_transition(window, (place[OLDEST] + k) % capacity, moved, last_summed, held - k + 1, reach)
    _shift_transition(window, capacity, moved, 1, last_summed, reach)  # the transition over all samples not yet summed
    # the transition of the newest sample, which `append` is about to take from the rows of `augment`
    dp, dv = vec3_at(moved[1], state.POSITION), vec3_at(moved[1], state.VELOCITY)
    _unshift_symmetric(memory.covariance, state.STATES, dp, dv)
    _unshift_row(memory.error, state.STATES, dp, dv)


@njit(**INNER_KERNEL)
def _shift_transition(window: TransitionWindow, row: int, moved: Array, end: int, begin: int, reach: int) -> None:
    """Maps a transition to the errors of the states with the restored peak, in place.

    Ψ <- T_end Ψ T_begin⁻¹; J and j are mapped through T_begin⁻¹. T maps the error of a stored state to that of the
    corrected state: where position and velocity were moved by `dp` and `dv`, it adds δθ × dp and δθ × dv to their
    errors for an error δθ of the attitude (`strapdown.shift_rows`).

    Args:
        window: The samples held.
        row: Row of the transition.
        moved: (RING, 10) corrections `FilterState.restored`.
        end: Sample at the transition's end, counted back from the newest.
        begin: Sample at its beginning, counted back from the newest.
        reach: Samples back that the window holds of the peak; older ones stay as they are.
    """
    if end <= reach:
        shift_rows(window.transition[row], 0, vec3_at(moved[end], state.POSITION), vec3_at(moved[end], state.VELOCITY))
    if begin <= reach:
        dp, dv = vec3_at(moved[begin], state.POSITION), vec3_at(moved[begin], state.VELOCITY)
        _unshift_columns(window.transition[row], 0, dp, dv)
        _unshift_symmetric(window.information[row], 0, dp, dv)
        _unshift_row(window.evidence[row], 0, dp, dv)


@njit(**INNER_KERNEL)
def _unshift_symmetric(M: Array, o: int, dp: Vec3, dv: Vec3) -> None:
    """M <- T⁻ᵀ M T⁻¹ in place for a symmetric matrix M (n, n), with T of `_shift_transition`.

    The foot's error states begin at row and column `o`. `dp` (m) and `dv` (m/s) are the corrections of position and
    velocity. As M is symmetric, both products are taken from the right, with a transposition between.
    """
    _unshift_columns(M, o, dp, dv)
    transpose_rows(M, o + state.D_ATTITUDE, 3)
    _unshift_columns(M, o, dp, dv)
    mirror(M, o + state.D_ATTITUDE, 3)


@njit(**INNER_KERNEL)
def _unshift_columns(M: Array, o: int, dp: Vec3, dv: Vec3) -> None:
    """M <- M T⁻¹ in place, row by row, for M (m, n) with the foot's error states from column `o` on."""
    for i in range(M.shape[0]):
        _unshift_row(M[i], o, dp, dv)


@njit(**INNER_KERNEL)
def _unshift_row(row: Array, o: int, dp: Vec3, dv: Vec3) -> None:
    """Multiplies a row (n,) by T⁻¹ in place: of its columns, those of the attitude become a + p × dp + v × dv.

    p, v and a are its entries for position, velocity and attitude, with the foot's error states from column `o` on. T
    is that of `_shift_transition` for the corrections `dp` (m) and `dv` (m/s).
    """
    by_position = cross(vec3_at(row, o + state.D_POSITION), dp)
    by_velocity = cross(vec3_at(row, o + state.D_VELOCITY), dv)
    attitude = axpy(axpy(vec3_at(row, o + state.D_ATTITUDE), 1.0, by_position), 1.0, by_velocity)
    store_vec3_at(attitude, row, o + state.D_ATTITUDE)


@njit(**INNER_KERNEL)
def append(window: TransitionWindow, memory: state.FilterState, phase: int, speed: float) -> None:
    """Stores the filter's state after a sample; the window must not be full.

    The transition from the sample before to this one (Ψ, J, j) is read from the additional 21 rows of covariance and
    error, which `augment` has prepared. The sum over the samples not yet summed, in row C of the arrays, is extended.

    Args:
        window: The samples held, changed in place.
        memory: State of the filter after the sample.
        phase: Phase in which the filter used the sample.
        speed: Standard deviation of a stationary foot's speed, m/s; inf if it is moving.
    """
    capacity = len(window.t_ns)
    i = (window.place[OLDEST] + window.place[HELD]) % capacity  # the ring's row after the newest
    window.place[HELD] += 1
    window.t_ns[i], window.phase[i], window.speed[i] = memory.clock[state.T_LAST], phase, speed
    P, n = memory.covariance, state.STATES
    copy(memory.path, window.path)
    copy(memory.unlearnt, window.unlearnt)
    copy(memory.levelled, window.levelled)
    copy(memory.considered_sd, window.released.considered_sd)
    for k in range(state.CONSIDERED):
        copy(P[memory.considered + k, : state.STATES], window.considered[i, k])
    copy(memory.nominal, window.nominal[i])
    for k in range(n):
        for j in range(n):
            window.covariance[i, k, j] = P[k, j]
            window.transition[i, k, j] = P[k, n + j]
            window.information[i, k, j] = -P[n + k, n + j]
        window.evidence[i, k] = memory.error[n + k]
    _compose(window, capacity, i)


@njit(**INNER_KERNEL)
def _compose(window: TransitionWindow, earlier: int, later: int) -> None:
    """Extends the transition of row `earlier` by that of row `later`, in place: docs/foot_ins.md (16).

    Ψ <- Ψ_later Ψ, J <- J + Ψᵀ J_later Ψ, j <- j + Ψᵀ j_later; row `later` does not change.
    """
    # A and B are Ψ of both; JA and BA use the same scratch memory one after the other
    A, B, JA = window.transition[earlier], window.transition[later], window.scratch[0]
    add_transposed_matvec(A, window.evidence[later], window.evidence[earlier])
    multiply_into(window.information[later], A, JA)
    add_transposed_product(A, JA, window.information[earlier])
    BA = window.scratch[0]
    multiply_into(B, A, BA)
    copy_matrix(BA, A)


@njit(**INNER_KERNEL)
def _symmetrize(A: Array, out: Array) -> None:
    """Writes (A + Aᵀ)/2 into `out`."""
    for i in range(state.STATES):
        for j in range(state.STATES):
            out[i, j] = 0.5 * (A[i, j] + A[j, i])


@njit(**INNER_KERNEL)
def release_oldest(window: TransitionWindow) -> int:
    """Moves the oldest sample, smoothed with all later ones, into `released`: docs/foot_ins.md (17).

    If no held sample has sums left, the transitions of all of them are summed from the newest back to the oldest, and
    row C starts again as the identity. The later samples' information is then the sum in the next sample's row,
    continued by the sum in row C.

    Returns:
        Row of the sample in the ring. One must be held.
    """
    place, capacity = window.place, len(window.t_ns)
    i = place[OLDEST]
    if place[SUMMED] == 0:
        for k in range(place[HELD] - 2, -1, -1):  # from the second newest: each gets the sum of the one after it
            _compose(window, (i + k) % capacity, (i + k + 1) % capacity)
        place[SUMMED] = place[HELD]
        clear_block(window.transition[capacity], state.STATES)
        clear_block(window.information[capacity], state.STATES)
        clear(window.evidence[capacity])
        for k in range(state.STATES):
            window.transition[capacity, k, k] = 1.0
    place[OLDEST] = (i + 1) % capacity
    place[HELD] -= 1
    place[SUMMED] -= 1
    # `first` and `second` are scratch memory of (21, 21), used for one product after the other
    released, P, first, second = window.released, window.covariance[i], window.scratch[0], window.scratch[1]
    # `released.work.gain` is used as scratch memory of (21,)
    # information and evidence of all later samples: those not yet summed, then with the sum of the next sample's row
    J, evidence, evidence_sum = window.information[capacity], window.evidence[capacity], released.work.gain
    if place[SUMMED] > 0:
        oldest = place[OLDEST]
        A = window.transition[oldest]  # Ψ over the summed samples
        multiply_into(J, A, first)
        copy_matrix(window.information[oldest], second)
        add_transposed_product(A, first, second)
        copy(window.evidence[oldest], evidence_sum)
        add_transposed_matvec(A, evidence, evidence_sum)
        J, evidence = second, evidence_sum
    _symmetrize(J, first)
    multiply_into(P, first, second)
    multiply_into(second, P, first)
    _symmetrize(first, second)  # P J P
    for k in range(state.STATES):
        released.error[k] = 0.0
        for m in range(state.STATES):
            released.covariance[k, m] = P[k, m] - second[k, m]
            released.error[k] += P[k, m] * evidence[m]
    copy(window.nominal[i], released.nominal)
    copy(window.path, released.path)
    copy(window.unlearnt, released.unlearnt)
    copy(window.levelled, released.levelled)
    for k in range(state.CONSIDERED):
        c = released.considered + k
        for m in range(state.STATES):
            released.covariance[c, m] = released.covariance[m, c] = window.considered[i, k, m]
    released.clock[state.T_LAST] = window.t_ns[i]
    inject(released)  # x ⊕ P j
    return i
