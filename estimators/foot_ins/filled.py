"""Noise of samples that a driver filled in by straight lines: docs/foot_ins.md, "Filled samples"."""

from __future__ import annotations

import math

from numba import njit

from stridetwin.estimators.foot_ins import state
from stridetwin.streams.algebra.tuples import Vec3, axpy, dot
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

# A line: the second difference of three axes is this share of the change, or less than a last digit. [rad/s, m/s²]
_LINE_SHARE = 1e-5
_LAST_DIGIT_RADPS, _LAST_DIGIT_MPS2 = 3e-6, 3e-5
_MOVING_RADPS, _MOVING_MPS2 = 0.02, 0.2  # smaller changes from sample to sample are rest, where lines do no harm
# What a line misses of a signal of angular frequency Ω over the time L: Ω² L³ / 12 times its size. [for 5 Hz of the
# rate of a foot, and 15 Hz of its acceleration]
_RATE_CURVATURE_PER_S2, _FORCE_CURVATURE_PER_S2 = 160.0, 1500.0
_MOST_SHARE = 0.3  # of size times length, that a line misses at most

RATE_S, RATE_VARIANCE, FORCE_S, FORCE_VARIANCE, SINCE_STANCE = range(state.FILLED)  # entries of `FilterState.filled`


@njit(**INNER_KERNEL)
def _is_line(newest: Vec3, middle: Vec3, oldest: Vec3, least: float, last_digit: float) -> bool:
    """Whether three samples, equally far apart, lie on a line that is not level."""
    change, before = axpy(newest, -1.0, middle), axpy(middle, -1.0, oldest)
    bend = axpy(change, -1.0, before)
    size2 = dot(change, change)
    return size2 > least * least and math.sqrt(dot(bend, bend)) < _LINE_SHARE * math.sqrt(size2) + last_digit


@njit(**INNER_KERNEL)
def _grow(filled: Array, row: int, is_line: bool, dt: float, size: float, curvature: float) -> float:
    """Variance that one more sample of a line adds, or 0; entries `row` and `row` + 1 are its length and variance."""
    if not is_line:
        filled[row] = filled[row + 1] = 0.0
        return 0.0
    # the first line of three samples has two intervals
    length = filled[row] + dt if filled[row] > 0.0 else 2.0 * dt
    missed = size * min(curvature * length**3, _MOST_SHARE * length)
    added = max(missed * missed - filled[row + 1], 0.0)
    filled[row], filled[row + 1] = length, filled[row + 1] + added
    return added


@njit(**INNER_KERNEL)
def find_filled_variances(
    memory: state.FilterState, dt: float, rate: float, acceleration: float
) -> tuple[float, float]:
    """Variances that the newest sample adds to attitude (rad²) and velocity (m²/s²), because it continues a line.

    Drivers fill lost packets by straight lines. A line of a moving foot is so exact that no sensor measures it: its
    second difference is 0 in three axes. What the true signal did in between is unknown; the longer the line and the
    faster the foot, the more.

    Args:
        memory: State of the foot, whose ring holds the newest sample.
        dt: Length of the sample's interval, s.
        rate: rad/s, size of the angular rate.
        acceleration: m/s², size of the acceleration.
    """
    if memory.clock[state.FILL] < 3:
        return 0.0, 0.0
    a, b, c = state.ring_row(memory, 0), state.ring_row(memory, 1), state.ring_row(memory, 2)
    # equally far apart, to the accuracy of the stamps
    first, second = memory.ring_t_ns[a] - memory.ring_t_ns[b], memory.ring_t_ns[b] - memory.ring_t_ns[c]
    even = abs(first - second) * 10 < first
    turns = even and _is_line(
        state.rate_of(memory, a), state.rate_of(memory, b), state.rate_of(memory, c), _MOVING_RADPS, _LAST_DIGIT_RADPS
    )
    pushes = even and _is_line(
        state.force_of(memory, a), state.force_of(memory, b), state.force_of(memory, c), _MOVING_MPS2, _LAST_DIGIT_MPS2
    )
    attitude = _grow(memory.filled, RATE_S, turns, dt, rate, _RATE_CURVATURE_PER_S2)
    velocity = _grow(memory.filled, FORCE_S, pushes, dt, acceleration, _FORCE_CURVATURE_PER_S2)
    if attitude > 0.0 or velocity > 0.0:
        memory.filled[SINCE_STANCE] = 1.0
    return attitude, velocity
