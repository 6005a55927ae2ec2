"""Published filters of one foot: nine states, and a detector with one threshold that decides when the foot stands.

They are here to compare with, and to test other sensors or simulated walks by: `FootIns(options=Options(method=...))`.
Filter and detectors are those of pyshoe (Wagstaff, Peretroukhin, Kelly 2020, IEEE Sensors J. 20:957), after Skog,
Händel, Nilsson, Rantakokko 2010 (IEEE TBME 57:2657). docs/foot_ins.md, "Published methods".
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.foot_ins import state
from stridetwin.estimators.foot_ins.alignment import begin, level_attitude
from stridetwin.estimators.foot_ins.kalman import clear, correct, innovation_norm, spread_measurements
from stridetwin.estimators.foot_ins.kernel import MAX_GAP_S, is_possible, write_estimate
from stridetwin.estimators.foot_ins.parameters import as_record
from stridetwin.estimators.foot_ins.stance import append_sample
from stridetwin.estimators.foot_ins.strapdown import propagate_covariance, propagate_state
from stridetwin.streams.algebra.tuples import (
    Vec3,
    axpy,
    dot,
    exp,
    multiply,
    normalized,
    quaternion_at,
    store_quaternion_at,
    store_vec3_at,
    vec3_at,
)
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.errors import ConfigError, check_numbers
from stridetwin.streams.samples import Array

_entry_kernel = entry_kernel(Path(__file__).parent, llvm_level=1)

THRESHOLDS = {"shoe": 8.5e7, "ared": 0.55, "amvd": 2.0, "mag": 2.0, "mbgtd": 1.0}
"""Published methods, and the threshold of each; see `ZeroVelocityDetector.threshold`.

Those of SHOE and ARED are pyshoe's for its walks under motion capture; those of AMVD and MBGTD are the ends of the
ranges in which pyshoe searches one for every walk, as no single one serves all of them; MAG has that of AMVD.
"""
_WINDOW_S = {"shoe": 0.025, "ared": 0.025, "amvd": 0.025, "mag": 0.025, "mbgtd": 0.01}  # five samples, and two
_SHOE, _ARED, _AMVD, _MAG, _MBGTD = range(5)
_ACCEL_SD_MPS2, _GYRO_SD_RADPS = 0.00098, 8.7266463e-5  # of pyshoe's SHOE
# Noise of a sample in pyshoe's filter, m/s² and rad/s, and the time between samples to which it belongs, s.
_PROCESS_ACCEL_SD_MPS2, _PROCESS_GYRO_SD_RADPS, _SAMPLE_S = 0.5, math.radians(0.5), 1.0 / 200.0
_START_SD, _START_TILT_SD_RAD = 1e-5, math.radians(0.1)  # of position (m) and velocity (m/s); of the attitude
_GAP_SPEED_MPS = 1.5  # motion of the wearer in a gap


@dataclass(frozen=True, kw_only=True)
class ZeroVelocityDetector:
    """A published detector of stances, and what the filter of nine states takes from it.

    Attributes:
        method: One of `THRESHOLDS`.
        threshold: The foot stands while the statistic is below it, in its own unit: none for `shoe`, rad²/s²
            for `ared`, m²/s⁴ for `amvd` and `mag`, m/s² for `mbgtd`. None takes that of `THRESHOLDS`.
        window_s: Span of the statistic, s. None takes pyshoe's: five samples at 200 Hz, for `mbgtd` two.
        speed_sd_mps: Standard deviation of the speed of a standing foot, m/s.
        start_s: Time at rest at the beginning, whose mean force is vertical, s.
        with_bias: Whether the mean rate over that time is taken for the gyro's bias; pyshoe takes none.
    """

    method: str
    threshold: float | None = None
    window_s: float | None = None
    speed_sd_mps: float = 0.01
    start_s: float = 0.1
    with_bias: bool = False

    def __post_init__(self) -> None:
        """Raises ConfigError for an unknown method, and where a number is not finite and positive."""
        if self.method not in THRESHOLDS:
            raise ConfigError("ZeroVelocityDetector", "method", self.method, ", ".join(THRESHOLDS))
        numbers = {"window_s": self.span_s, "speed_sd_mps": self.speed_sd_mps, "start_s": self.start_s}
        check_numbers("ZeroVelocityDetector", numbers | {"threshold": self.level}, ())

    @property
    def span_s(self) -> float:
        """The window in use, s."""
        return _WINDOW_S[self.method] if self.window_s is None else self.window_s

    @property
    def level(self) -> float:
        """The threshold in use."""
        return THRESHOLDS[self.method] if self.threshold is None else self.threshold


if TYPE_CHECKING:

    @dataclass(frozen=True, kw_only=True)
    class DetectorRecord:
        """The numbers of a `ZeroVelocityDetector` for the kernel, and gravity in m/s²."""

        method: int
        threshold: float
        window_s: float
        speed_sd_mps: float
        start_s: float
        with_bias: int
        gravity_mps2: float

else:
    DetectorRecord = np.record


def for_kernel(detector: ZeroVelocityDetector, gravity_mps2: float) -> DetectorRecord:
    """The numbers of a detector in one record."""
    values = {
        "method": [*THRESHOLDS].index(detector.method),
        "threshold": float(detector.level),
        "window_s": float(detector.span_s),
        "speed_sd_mps": float(detector.speed_sd_mps),
        "start_s": float(detector.start_s),
        "with_bias": int(detector.with_bias),
        "gravity_mps2": float(gravity_mps2),
    }
    return as_record(DetectorRecord, values)


@njit(**INNER_KERNEL)
def _count_window(memory: state.FilterState, span_s: float) -> int:
    """Number of the newest samples that are less than a span (s) old; the newest always counts."""
    newest, span = memory.ring_t_ns[state.ring_row(memory, 0)], round(span_s * 1e9)
    n = 1
    while n < memory.clock[state.FILL] and newest - memory.ring_t_ns[state.ring_row(memory, n)] < span:
        n += 1
    return n


@njit(**INNER_KERNEL)
def _farthest_halves(memory: state.FilterState, n: int) -> float:
    """Statistic MBGTD of the last n samples, m/s²: how far two parts of the window are from each other.

    The memory-based graph-theoretic detector as in pyshoe: samples are the nodes of a graph, with the distance
    |f_i - f_j| of their forces as the length of an edge. The samples up to s are one part, those from t on the other:

    max over 0 ≤ s < t < n of  Σ_{i ≤ s, j ≥ t} |f_i - f_j| / ((t - s) (n - t + 1))

    Column 0 of `memory.hidden`, which this filter does not need otherwise, keeps Σ_{i ≤ s} |f_i - f_j| for every j, so
    n² distances are enough.
    """
    to_first_part = memory.hidden[:, 0]
    for j in range(n):
        to_first_part[j] = 0.0
    largest = 0.0
    for s in range(n - 1):
        of_s = state.force_of(memory, state.ring_row(memory, n - 1 - s))  # the window's oldest sample is 0
        for j in range(s + 1, n):
            apart = axpy(state.force_of(memory, state.ring_row(memory, n - 1 - j)), -1.0, of_s)
            to_first_part[j] += math.sqrt(dot(apart, apart))
        total = 0.0
        for t in range(n - 1, s, -1):
            total += to_first_part[t]
            largest = max(largest, total / ((t - s) * (n - t + 1)))
    return largest


@njit(**INNER_KERNEL)
def published_statistic(memory: state.FilterState, detector: DetectorRecord) -> float:
    """Statistic of a published detector over the last `window_s`: small for a foot at rest.

    With means over the window, f the specific force, f̄ its mean, ω the angular rate and g gravity (Skog et al. 2010):

    - SHOE, stance hypothesis optimal estimation: mean |f - g f̄/|f̄||² / σ_a² + mean |ω|² / σ_ω²
    - ARED, angular rate energy: mean |ω|²
    - AMVD, moving variance of the acceleration: mean |f - f̄|²
    - MAG, magnitude of the acceleration: mean (|f| - g)²
    - MBGTD: `_farthest_halves`

    σ_a and σ_ω are those of pyshoe, so that its thresholds apply. A bias that the start has shown is taken out of ω.
    """
    n, g = _count_window(memory, detector.window_s), detector.gravity_mps2
    if detector.method == _MBGTD:
        return _farthest_halves(memory, n)
    bias = vec3_at(memory.nominal, state.GYRO_BIAS)
    rate2, force2, excess2, force_sum = 0.0, 0.0, 0.0, (0.0, 0.0, 0.0)
    for back in range(n):
        row = state.ring_row(memory, back)
        rate, force = axpy(state.rate_of(memory, row), -1.0, bias), state.force_of(memory, row)
        rate2 += dot(rate, rate) / n
        force2 += dot(force, force) / n
        excess2 += (math.sqrt(dot(force, force)) - g) ** 2 / n
        force_sum = axpy(force_sum, 1.0 / n, force)
    size2 = dot(force_sum, force_sum)  # |f̄|²
    if detector.method == _ARED:
        return rate2
    if detector.method == _AMVD:
        return max(force2 - size2, 0.0)
    if detector.method == _MAG:
        return excess2
    spread2 = force2 - 2.0 * g * math.sqrt(size2) + g * g  # mean |f - g f̄/|f̄||², multiplied out
    return max(spread2, 0.0) / _ACCEL_SD_MPS2**2 + rate2 / _GYRO_SD_RADPS**2


@njit(**INNER_KERNEL)
def _start(memory: state.FilterState, detector: DetectorRecord, t_ns: int, rate: Vec3, force: Vec3) -> None:
    """Takes one sample of the rest at the beginning, or after a gap; levels the attitude by the mean force.

    Row 0 of `memory.force_sum` holds the sum of the force and the number of samples, row 1 the sum of the rate.
    """
    P, sums = memory.covariance, memory.force_sum
    for i in range(3):
        sums[0, i] += force[i]
        sums[1, i] += rate[i]
    sums[0, 3] += 1.0
    level_attitude(memory, vec3_at(sums[0], 0))
    for i in range(3):
        v, a = state.D_VELOCITY + i, state.D_ATTITUDE + i
        P[v, v], P[a, a] = _START_SD**2, _START_TILT_SD_RAD**2
    if (t_ns - memory.clock[state.T_ALIGN]) * 1e-9 >= detector.start_s:
        if detector.with_bias == 1 and memory.clock[state.HEADING_KNOWN] == 0:
            mean_rate = axpy((0.0, 0.0, 0.0), 1.0 / sums[0, 3], vec3_at(sums[1], 0))
            store_vec3_at(mean_rate, memory.nominal, state.GYRO_BIAS)
        memory.clock[state.PHASE] = state.NAVIGATING
        memory.clock[state.HEADING_KNOWN] = 1


@njit(**INNER_KERNEL)
def _forget(memory: state.FilterState, t_ns: int, gap_s: float) -> None:
    """Begins a new start after a gap: the wearer may have walked on, so the position is known less."""
    begin(memory, t_ns)
    P = memory.covariance
    for i in range(state.STATES):
        for j in range(state.STATES):
            if i != j or i >= state.D_VELOCITY:
                P[i, j] = 0.0
    for i in range(3):
        P[i, i] += (_GAP_SPEED_MPS * gap_s) ** 2


@njit(**INNER_KERNEL)
def _stop(memory: state.FilterState, speed_sd: float) -> None:
    """Kalman update with a velocity of 0, of the standard deviation `speed_sd` on each axis, m/s."""
    x, error, work = memory.nominal, memory.error, memory.work
    clear(work, 3)
    for i in range(3):
        work.jacobian[i, state.D_VELOCITY + i] = 1.0 / speed_sd
        work.innovation[i] = -x[state.VELOCITY + i] / speed_sd
    spread_measurements(memory.covariance, work, 0, 3)
    memory.nis[state.BY_VELOCITY, 0] += innovation_norm(work, 3, 1.0) ** 2 / 3.0
    memory.nis[state.BY_VELOCITY, 1] += 1.0
    for i in range(3):
        correct(memory.covariance, error, work.gain, 0, work.jacobian[i], work.innovation[i], 1.0)
    for i in range(state.ATTITUDE):  # position and velocity come first in both
        x[i] += error[i]
    rotation = exp(vec3_at(error, state.D_ATTITUDE), state.SERIES_RAD)
    store_quaternion_at(normalized(multiply(rotation, quaternion_at(x, state.ATTITUDE))), x, state.ATTITUDE)
    for i in range(len(error)):
        error[i] = 0.0


@njit(**INNER_KERNEL)
def _step(memory: state.FilterState, detector: DetectorRecord, t_ns: int, rate: Vec3, force: Vec3) -> tuple[int, float]:
    """One step of the filter of nine states; biases and all other states of `memory` stay 0 and certain.

    Returns:
        Phase in which the sample was used; standard deviation of the speed of a standing foot, m/s, inf if it moves.
    """
    clock, P = memory.clock, memory.covariance
    if not is_possible(rate, force) or (clock[state.PHASE] != state.EMPTY and t_ns <= clock[state.T_LAST]):
        return state.IGNORED, math.inf
    dt = (t_ns - clock[state.T_LAST]) * 1e-9
    if clock[state.PHASE] == state.EMPTY:
        begin(memory, t_ns)
        for i in range(3):
            P[i, i] = _START_SD**2
    elif dt > MAX_GAP_S:
        _forget(memory, t_ns, dt)
    clock[state.T_LAST] = t_ns
    append_sample(memory, t_ns, rate, force)
    if clock[state.PHASE] == state.ALIGNING:
        _start(memory, detector, t_ns, rate, force)
        return state.ALIGNING, math.inf
    gravity = detector.gravity_mps2
    R, f_world, path, turn = propagate_state(memory.nominal, rate, force, dt, gravity, vec3_at(memory.lever, 0))
    propagate_covariance(P, 0, R, f_world, dt, path, turn)
    for i in range(3):
        P[state.D_VELOCITY + i, state.D_VELOCITY + i] += _PROCESS_ACCEL_SD_MPS2**2 * _SAMPLE_S * dt
        P[state.D_ATTITUDE + i, state.D_ATTITUDE + i] += _PROCESS_GYRO_SD_RADPS**2 * _SAMPLE_S * dt
    if published_statistic(memory, detector) >= detector.threshold:
        return state.NAVIGATING, math.inf
    _stop(memory, detector.speed_sd_mps)
    clock[state.T_STANCE] = t_ns
    return state.NAVIGATING, detector.speed_sd_mps


@_entry_kernel
def run(
    memory: state.FilterState,
    detector: DetectorRecord,
    t_ns: NDArray[np.int64],
    rate: Array,
    force: Array,
    phase: NDArray[np.int8],
    speed: Array,
    nominal: Array,
    covariance: Array,
) -> None:
    """Takes N samples, and writes the results of `_step` and the estimate after each.

    Args:
        memory: State of the foot, changed in place.
        detector: Of `for_kernel`.
        t_ns: (N,) int64, times.
        rate: (N, 3) rad/s, angular rate.
        force: (N, 3) m/s², specific force.
        phase: (N,) int8, written: phase in which each sample was used.
        speed: (N,) written: standard deviation of a standing foot's speed, m/s; inf where it moves.
        nominal: (N, 22) written: nominal states.
        covariance: (N, 6, 6) written: of position (m) and attitude (rad), world axes.
    """
    for k in range(len(t_ns)):
        phase[k], speed[k] = _step(memory, detector, t_ns[k], vec3_at(rate[k], 0), vec3_at(force[k], 0))
        write_estimate(memory, nominal[k], covariance[k])
