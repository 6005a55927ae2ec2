"""Fixed-lag smoother of the one-foot inertial navigation, compiled.

Fixed-interval smoothing runs backward from the interval's end: the information of sample k+1, mapped through the
propagation of the error from k to k+1, applies to k. In the form of Bryson & Frazier 1963 (Bierman 1973, Automatica
9:503) it needs no inverse of a covariance, which here is singular: the start is known, and the floor is as high as the
stationary foot. Between two samples the error is mapped by Ψ (propagation, corrections, shifts, new floors), and the
corrections add the information J = Σ g gᵀ / s and the evidence j = Σ g z / s about the initial error, where
g = Ψ_iᵀ h with Ψ up to correction i. With both summed over all later samples

    x_smoothed = x ⊕ P j,   P_smoothed = P - P J P.

Two consecutive passages combine to Ψ = Ψ_b Ψ_a, J = J_a + Ψ_aᵀ J_b Ψ_a, j = j_a + Ψ_aᵀ j_b. That is associative, so the
passage over a sliding window takes three products per sample, however long the window is (two stacks, of which the
older is summed from its end).

When a clipped peak is restored (`clipping`), the filter's state jumps, and with it the stored samples since the peak
began: their error is now that of the state with the peak. So P becomes T_k P T_kᵀ, Ψ becomes T_k Ψ T_(k-1)⁻¹, and J
and j are mapped through T_(k-1)⁻¹, where T is the effect of `shift` on an error.

The filter computes Ψ, J and j as a by-product: `augment` extends its covariance by 19 rows, with covariance 0 of their
own and I with the error. Every linear operation on the error turns I into Ψᵀ; each correction subtracts g gᵀ / s from
the zeros and adds g z / s to the error of these rows.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.compiled import INSIDE, cached
from stridetwin.estimators.foot_ins.estimate import FootInsEstimate, FootInsPath, StartPose, standing_nis
from stridetwin.estimators.foot_ins.kernel import note_pose_covariance, step
from stridetwin.estimators.foot_ins.parameters import FootInsParameters, KernelParameters, for_sensor
from stridetwin.estimators.foot_ins.stance import inject
from stridetwin.estimators.foot_ins.state import (
    ATTITUDE,
    D_ATTITUDE,
    D_POSITION,
    D_VELOCITY,
    GYRO_BIAS,
    IGNORED,
    NOMINAL,
    POSITION,
    RESTORED,
    STATES,
    T_LAST,
    TRACKING,
    VELOCITY,
    Memory,
    blank,
    ring_row,
)
from stridetwin.estimators.foot_ins.strapdown import shift, shift_rows
from stridetwin.estimators.so3 import product
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import ImuCalibration
from stridetwin.streams.samples import Array, Block, Imu

_called = cached(Path(__file__).parent)

OLDEST, HELD, SUMMED = range(3)  # of `place`

# Of N samples: time, phase, standing speed (m/s), (N, 20) state, (N, 6, 6) covariance of position and attitude.
Rows = tuple[NDArray[np.int64], NDArray[np.int8], Array, Array, Array]


class Window(NamedTuple):
    """A ring of C samples, from the oldest held to the newest.

    Attributes:
        place: (3,) int64: row of the oldest sample; how many are held; how many of these, from the oldest on, have rows
            of `transition`, `information` and `evidence` that are summed up to the last of these.
        t_ns: (C,) int64.
        phase: (C,) int8 in which each was used.
        speed: (C,) standard deviation of the standing foot's speed, m/s.
        nominal: (C, 20) filtered.
        covariance: (C, 19, 19) filtered.
        transition: (C + 1, 19, 19) Ψ of the passage from the sample before; row C: over the samples not yet summed.
        information: (C + 1, 19, 19) J of the same.
        evidence: (C + 1, 19) j of the same.
        given: Output for a sample that leaves.
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
    given: Memory


def empty_window(capacity: int) -> Window:
    """An empty window of at most `capacity` samples."""
    transition = np.zeros((capacity + 1, STATES, STATES))
    transition[capacity] = np.eye(STATES)
    return Window(
        place=np.zeros(3, np.int64), t_ns=np.zeros(capacity, np.int64), phase=np.zeros(capacity, np.int8),
        speed=np.zeros(capacity), nominal=np.zeros((capacity, NOMINAL)),
        covariance=np.zeros((capacity, STATES, STATES)), transition=transition,
        information=np.zeros((capacity + 1, STATES, STATES)), evidence=np.zeros((capacity + 1, STATES)),
        given=blank(),
    )  # fmt: skip


def augmented_memory() -> Memory:
    """Memory of a foot whose covariance has the rows that `augment` needs."""
    return blank(np.zeros((2 * STATES, 2 * STATES)), np.zeros(2 * STATES))


@njit(**INSIDE)
def augment(memory: Memory) -> None:
    """Prepares the additional rows for the next sample, in place."""
    P = memory.covariance
    P[:, STATES:] = 0.0
    P[STATES:] = 0.0
    for i in range(STATES):
        P[i, STATES + i] = P[STATES + i, i] = 1.0
    memory.error[STATES:] = 0.0


@njit(**INSIDE)
def apply_restored(window: Window, memory: Memory) -> None:
    """Corrects the stored samples since a clipped peak began by the result of `restore`, in place.

    `memory` is that after the sample at which the peak was restored, which the window does not hold yet.
    """
    place, capacity = window.place, len(window.t_ns)
    held, summed, moved = place[HELD], place[SUMMED], memory.restored
    reach = 0  # samples back, from the newest held; older ones have left the window
    for back in range(1, min(memory.clock[RESTORED], held) + 1):
        if window.t_ns[(place[OLDEST] + held - back) % capacity] != memory.ring_t_ns[ring_row(memory, back)]:
            break
        reach = back
    if reach == 0:
        return
    for back in range(1, reach + 1):
        i = (place[OLDEST] + held - back) % capacity
        x = window.nominal[i]
        x[:ATTITUDE] += moved[back, :ATTITUDE]
        x[ATTITUDE:GYRO_BIAS] = product(moved[back, ATTITUDE:], x[ATTITUDE:GYRO_BIAS])
        shift(window.covariance[i], 0, moved[back, POSITION:VELOCITY], moved[back, VELOCITY:ATTITUDE])
        if held - back >= summed:
            _move(window, i, moved, back, back + 1, reach)
    last_summed = held - summed + 1
    if last_summed <= reach:
        for k in range(summed):
            _move(window, (place[OLDEST] + k) % capacity, moved, last_summed, held - k + 1, reach)
    _move(window, capacity, moved, 1, last_summed, reach)
    dp, dv = moved[1, POSITION:VELOCITY], moved[1, VELOCITY:ATTITUDE]
    _begin_at(memory.covariance[:, STATES:], dp, dv)
    _begin_at(memory.covariance[STATES:].T, dp, dv)
    _begin_at(memory.error[STATES:].reshape(1, STATES), dp, dv)


@njit(**INSIDE)
def _move(window: Window, row: int, moved: Array, end: int, begin: int, reach: int) -> None:
    """Moves the ends of a row's passage, given in samples back; those beyond `reach` stay."""
    if end <= reach:
        shift_rows(window.transition[row], 0, moved[end, POSITION:VELOCITY], moved[end, VELOCITY:ATTITUDE])
    if begin <= reach:
        dp, dv = moved[begin, POSITION:VELOCITY], moved[begin, VELOCITY:ATTITUDE]
        _begin_at(window.transition[row], dp, dv)
        _begin_at(window.information[row], dp, dv)
        _begin_at(window.information[row].T, dp, dv)
        _begin_at(window.evidence[row].reshape(1, STATES), dp, dv)


@njit(**INSIDE)
def _begin_at(M: Array, dp: Array, dv: Array) -> None:
    """M <- M T⁻¹ in place, T as of `strapdown.shift`."""
    p, v, a = D_POSITION, D_VELOCITY, D_ATTITUDE
    for i in range(M.shape[0]):
        for k in range(3):
            m, n = (k + 1) % 3, (k + 2) % 3
            M[i, a + k] += M[i, p + m] * dp[n] - M[i, p + n] * dp[m] + M[i, v + m] * dv[n] - M[i, v + n] * dv[m]


@njit(**INSIDE)
def append(window: Window, memory: Memory, phase: int, speed: float) -> None:
    """Stores the filter's state after a sample that it used in `phase`; the window must not be full."""
    capacity = len(window.t_ns)
    i = (window.place[OLDEST] + window.place[HELD]) % capacity
    window.place[HELD] += 1
    window.t_ns[i], window.phase[i], window.speed[i] = memory.clock[T_LAST], phase, speed
    window.nominal[i] = memory.nominal
    window.covariance[i] = memory.covariance[:STATES, :STATES]
    window.transition[i] = memory.covariance[:STATES, STATES:]
    window.information[i] = -memory.covariance[STATES:, STATES:]
    window.evidence[i] = memory.error[STATES:]
    _join(window, capacity, i, capacity)


@njit(**INSIDE)
def _join(window: Window, earlier: int, later: int, into: int) -> None:
    """Writes the passage of row `earlier` and then of row `later` into a row, which may be one of these.

    See docs/foot_ins.md (16).
    """
    A, B = window.transition[earlier], window.transition[later]
    evidence = window.evidence[earlier] + A.T @ window.evidence[later]
    information = window.information[earlier] + A.T @ (window.information[later] @ A)
    window.transition[into] = B @ A
    window.information[into] = information
    window.evidence[into] = evidence


@njit(**INSIDE)
def release_oldest(window: Window) -> int:
    """Moves the oldest sample, smoothed with all later ones, into `given`; returns its row. One must be held.

    See docs/foot_ins.md (17).
    """
    place, capacity = window.place, len(window.t_ns)
    i = place[OLDEST]
    if place[SUMMED] == 0:
        for k in range(place[HELD] - 2, -1, -1):
            _join(window, (i + k) % capacity, (i + k + 1) % capacity, (i + k) % capacity)
        place[SUMMED] = place[HELD]
        window.transition[capacity] = np.eye(STATES)
        window.information[capacity] = 0.0
        window.evidence[capacity] = 0.0
    place[OLDEST] = (i + 1) % capacity
    place[HELD] -= 1
    place[SUMMED] -= 1
    J, j = window.information[capacity], window.evidence[capacity]
    if place[SUMMED] > 0:
        A = window.transition[place[OLDEST]]
        J = window.information[place[OLDEST]] + A.T @ (J @ A)
        j = window.evidence[place[OLDEST]] + A.T @ j
    given, P = window.given, window.covariance[i]
    less = P @ (0.5 * (J + J.T)) @ P
    given.nominal[:] = window.nominal[i]
    given.covariance[:] = P - 0.5 * (less + less.T)
    given.error[:] = P @ j
    given.clock[T_LAST] = window.t_ns[i]
    inject(given)
    return i


@njit(**INSIDE)
def _write(window: Window, out: Rows, k: int) -> None:
    """Gives the oldest sample and writes it into row `k`."""
    i = release_oldest(window)
    out[0][k], out[1][k], out[2][k] = window.t_ns[i], window.phase[i], window.speed[i]
    out[3][k] = window.given.nominal
    note_pose_covariance(window.given, out[4][k])


@_called
def run(
    memory: Memory, window: Window, parameters: KernelParameters, lag_ns: int, t_ns: NDArray[np.int64], rate: Array,
    force: Array, out: Rows,
) -> int:  # fmt: skip
    """Takes N samples; after each, outputs the oldest held one if it is `lag_ns` old or the window is full.

    Args:
        memory: Of `augmented_memory`, changed in place.
        window: Changed in place.
        parameters: Of the filter.
        lag_ns: Age at which a sample leaves the window.
        t_ns: (N,) int64.
        rate: (N, 3) rad/s.
        force: (N, 3) m/s².
        out: Buffer of N rows, of which the first are written.

    Returns:
        Number of rows written.
    """
    n = 0
    for k in range(len(t_ns)):
        augment(memory)
        phase, speed = step(memory, parameters, t_ns[k], rate[k], force[k])
        if phase == IGNORED:
            continue
        if phase == TRACKING and memory.clock[RESTORED] > 0:
            apply_restored(window, memory)
        append(window, memory, phase, speed)
        full = window.place[HELD] == len(window.t_ns)
        if full or t_ns[k] - window.t_ns[window.place[OLDEST]] >= lag_ns:
            _write(window, out, n)
            n += 1
    return n


@_called
def drain(window: Window, out: Rows, n: int) -> int:
    """Outputs all held samples, from row `n` of `out` on; returns the end row."""
    while window.place[HELD] > 0:
        _write(window, out, n)
        n += 1
    return n


MAX_LAG_S = 10.0
MAX_RATE_HZ = 1000.0  # faster sensors have the same number of samples held, and a shorter lag


class FootInsSmoother:
    """`FootIns` with a fixed lag: each pose is smoothed with the following `lag_s`.

    Within a swing the filter's error grows until the next zero velocity. With the lag, the correction is spread over
    the swing, and the path has no steps (Colomar, Nilsson, Händel 2012, "Smoothing for ZUPT-aided INSs", IPIN). There,
    corrections are held back to the end of a step and smoothed as errors of an open loop, because a closed loop has no
    error left to smooth. Here the loop is closed at every sample without loss: each correction's information is kept
    about the error that it corrected (`window`). The result is that of smoothing each interval of
    `lag_s` from its end. An alignment (the first, or after a long gap) carries no information on earlier samples.

    Causal but for the lag, of constant memory, deterministic; the filter inside gives the numbers of `FootIns`.

    Args:
        lag_s: Age at which a sample's pose is returned, s, up to 10; a second covers a whole swing.
        calibration: As of `FootIns`.
        parameters: As of `FootIns`.
        start: As of `FootIns`.

    Raises:
        ConfigError: A lag that is not between 0 and 10 s.
    """

    def __init__(
        self, lag_s: float = 1.0, calibration: ImuCalibration | None = None,
        parameters: FootInsParameters | None = None, start: StartPose | None = None,
    ) -> None:  # fmt: skip
        if not 0.0 <= lag_s <= MAX_LAG_S:
            raise ConfigError("FootInsSmoother", "lag_s", lag_s, f"0 to {MAX_LAG_S:g} s")
        self._lag_ns = round(lag_s * 1e9)
        self._parameters = for_sensor(parameters or FootInsParameters(), calibration)
        self._memory = augmented_memory()
        self._sample = np.empty(1, np.int64), np.empty((1, 3)), np.empty((1, 3))  # `update` allocates nothing for these
        self._row = _rows(1)
        self._window = empty_window(math.ceil(lag_s * MAX_RATE_HZ) + 1)
        if start is not None:
            start.place(self._memory)

    def update(self, sample: Imu) -> FootInsEstimate | None:
        """Takes one sample; returns the oldest estimate not yet returned, None while it is too young."""
        t_ns, rate, force = self._sample
        t_ns[0], rate[0], force[0] = sample.t_ns, sample.angular_rate, sample.specific_force
        out = self._row
        if run(self._memory, self._window, self._parameters, self._lag_ns, t_ns, rate, force, out) == 0:
            return None
        return FootInsEstimate.of(self._window.given, int(out[1][0]), float(out[2][0]))

    def run(self, block: Block[Imu]) -> FootInsPath:
        """The path over the usable samples of a block and those held before, the last ones smoothed with less."""
        out = _rows(len(block) + self.held)
        n = self._take(block.t_ns, block.columns["angular_rate"], block.columns["specific_force"], out)
        return self._path(out, n)

    def finish(self) -> FootInsPath:
        """The samples not yet returned, smoothed with what is available."""
        return self._path(_rows(self.held), 0)

    @property
    def nis(self) -> float:
        """As of `FootIns`: of the filter's innovations, which smoothing does not change."""
        return standing_nis(self._memory)

    @property
    def held(self) -> int:
        """Number of samples not yet returned."""
        return int(self._window.place[HELD])

    def _path(self, out: Rows, n: int) -> FootInsPath:
        """The first `n` rows, and all that is still held."""
        n = drain(self._window, out, n)
        return FootInsPath.of(out[0][:n], out[1][:n], out[2][:n], out[3][:n], out[4][:n])

    def _take(self, t_ns: NDArray[np.int64], rate: Array, force: Array, out: Rows) -> int:
        return run(
            self._memory, self._window, self._parameters, self._lag_ns, np.ascontiguousarray(t_ns, dtype=np.int64),
            np.ascontiguousarray(rate, dtype=np.float64), np.ascontiguousarray(force, dtype=np.float64), out,
        )  # fmt: skip


def _rows(n: int) -> Rows:
    """Buffers for `n` samples, as `FootInsPath.of` takes them."""
    return np.empty(n, np.int64), np.empty(n, np.int8), np.empty(n), np.empty((n, NOMINAL)), np.empty((n, 6, 6))
