"""The gyro's bias about the vertical, learnt on long straight ways: docs/foot_ins.md (21)."""

from __future__ import annotations

import math

from numba import njit

from stridetwin.estimators.foot_ins import state
from stridetwin.estimators.foot_ins.kalman import clear, correct_probably, spread_measurements
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.stance import inject
from stridetwin.streams.algebra.matrices import clear as zero
from stridetwin.streams.algebra.tuples import dot, quaternion_at, to_matrix, vec3_at
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

_LEAST_WAY_M = 20.0  # of a straight way before it counts
_LEAST_STRIDES = 8.0
_LONGER = 1.2  # factor by which it has to grow before it counts again
_SHORTEST_STRIDE_M = 0.3  # people who shuffle or turn in place go nowhere
_LONGEST_STRIDE_S = 2.5  # of somebody who does not stop
_TURN_RAD = 0.25  # of one stride from the next: nobody goes straight on
_OFF_M = 0.15  # of a stance from the arc so far: a step aside
_SCATTER_M = 0.05  # of stances about the arc, standard deviation, above which the way is not straight
_LONGEST_WAY_M = 60.0  # of a way, after which the next one begins: roads bend, and biases wander
# Before its bend is looked at, a way is one on which nobody wants to turn, or a gentle curve.
_CURVE_SHARE = 0.3  # probability of the latter
_CURVE_SD_PER_M = 0.004  # standard deviation of its curvature, 1/m

# Entries of `FilterState.straight`: number of strides; time of the first and last stance, s; position of the last one,
# m; bias at the beginning, rad/s; direction of the first stride, rad, and of the last one; end of the polyline of the
# strides, m: along the first one, which is the way, and to its left; sums of the powers 0 to 4 of the way; sums of the
# offset to the left times the powers 0 to 2, and of its square; way at which it counted last, m; information then, and
# the bias that it told, rad/s; variance of the bias at the beginning, (rad/s)²
STRIDES, T_FIRST, T_LAST, PLACE, BIAS, COURSE, LAST_COURSE, END = 0, 1, 2, 3, 5, 6, 7, 8
POWERS, OFFSETS, SQUARES, COUNTED_WAY, USED, USED_BIAS, VARIANCE = 10, 15, 18, 19, 20, 21, 22


@njit(**INNER_KERNEL)
def learn_bias_on_straight_way(memory: state.FilterState, parameters: KernelParameters, t_ns: int) -> None:
    """Takes the stance that has just begun into the way; a long straight one tells the gyro's bias.

    Who goes straight on for a long way does so better than a gyro whose bias was learnt on a foot that swayed. The
    strides are joined to a polyline with the bias that the filter had at the beginning: a later correction of the bias
    turns each of them back by its effect since the start of the filter. The bend of the polyline is then the error of
    that bias, however often it was corrected. A way that bends more than filter and wandering explain is a curve.

    Args:
        memory: State of the foot, changed in place.
        parameters: Parameters of the filter.
        t_ns: Time of the sample.
    """
    way, x = memory.straight, memory.nominal
    seconds = t_ns * 1e-9
    up = to_matrix(quaternion_at(x, state.ATTITUDE))[2]  # in the sensor
    bias = dot(up, vec3_at(x, state.GYRO_BIAS))
    dx, dy = x[state.POSITION] - way[PLACE], x[state.POSITION + 1] - way[PLACE + 1]
    length, lasted = math.hypot(dx, dy), seconds - way[T_LAST]
    if way[T_LAST] == 0.0 or length < _SHORTEST_STRIDE_M or lasted > _LONGEST_STRIDE_S:
        _begin(memory, seconds, bias)
        return
    course = math.atan2(dy, dx) + (bias - way[BIAS]) * (seconds - memory.start_s[0])
    if way[STRIDES] == 0.0:
        way[COURSE] = way[LAST_COURSE] = course
    turn = _wrap(course - way[LAST_COURSE])
    along = _wrap(course - way[COURSE])
    way[LAST_COURSE] = course
    way[END] += length * math.cos(along)
    way[END + 1] += length * math.sin(along)
    way[PLACE], way[PLACE + 1] = x[state.POSITION], x[state.POSITION + 1]
    way[T_LAST] = seconds
    way[STRIDES] += 1.0
    offset, s = way[END + 1], way[END]
    if abs(turn) > _TURN_RAD:
        _begin(memory, seconds, bias)
        return
    if way[STRIDES] >= 5.0:
        level, slope, bend, scatter2 = _fit_arc(memory)
        if abs(offset - level - s * (slope + s * bend)) > _OFF_M or scatter2 > _SCATTER_M**2:
            _begin(memory, seconds, bias)
            return
    power = 1.0
    for i in range(5):
        way[POWERS + i] += power
        if i < 3:
            way[OFFSETS + i] += offset * power
        power *= s
    way[SQUARES] += offset * offset
    if s >= max(_LEAST_WAY_M, _LONGER * way[COUNTED_WAY]) and way[STRIDES] >= _LEAST_STRIDES:
        _use_way(memory, parameters, seconds, bias)


@njit(**INNER_KERNEL)
def _measure_bias(memory: state.FilterState) -> Array:
    """Writes the Jacobian of the bias about the vertical into the workspace's first row, and returns that row."""
    up = to_matrix(quaternion_at(memory.nominal, state.ATTITUDE))[2]  # in the sensor
    clear(memory.work, 1)
    h = memory.work.jacobian[0]
    for i in range(3):
        h[state.D_GYRO_BIAS + i] = up[i]
    return h


@njit(**INNER_KERNEL)
def _wrap(angle: float) -> float:
    """The angle within half a turn, rad."""
    return math.atan2(math.sin(angle), math.cos(angle))


@njit(**INNER_KERNEL)
def _begin(memory: state.FilterState, seconds: float, bias: float) -> None:
    """Begins a new way at the present stance."""
    way = memory.straight
    zero(way)
    way[T_FIRST] = way[T_LAST] = seconds
    way[BIAS] = bias
    _measure_bias(memory)
    spread_measurements(memory.covariance, memory.work, memory.row, 1)
    way[VARIANCE] = memory.work.spread[0, 0]
    way[PLACE], way[PLACE + 1] = memory.nominal[state.POSITION], memory.nominal[state.POSITION + 1]
    way[POWERS] = 1.0  # its first stance, at 0


@njit(**INNER_KERNEL)
def _fit_arc(memory: state.FilterState) -> tuple[float, float, float, float]:
    """Offset a + b s + c s² of the stances to the left by least squares: a (m), b, c (1/m), mean square left."""
    way = memory.straight
    s0, s1, s2, s3, s4 = way[POWERS], way[POWERS + 1], way[POWERS + 2], way[POWERS + 3], way[POWERS + 4]
    d0, d1, d2 = way[OFFSETS], way[OFFSETS + 1], way[OFFSETS + 2]
    # about the mean of s, so that the equations are well conditioned
    m = s1 / s0
    p2 = s2 / s0 - m * m
    p3 = s3 / s0 - 3.0 * m * s2 / s0 + 2.0 * m**3
    p4 = s4 / s0 - 4.0 * m * s3 / s0 + 6.0 * m * m * s2 / s0 - 3.0 * m**4
    q0, q1 = d0 / s0, d1 / s0 - m * d0 / s0
    q2 = d2 / s0 - 2.0 * m * d1 / s0 + m * m * d0 / s0
    skew = p3 / p2
    square = p4 - p2 * p2 - p3 * skew  # of the part of u² that is neither constant nor linear
    along = q2 - p2 * q0 - skew * q1  # the offset's share of it
    bend = along / square
    tilt = (q1 - bend * p3) / p2
    level = q0 - bend * p2
    scatter2 = max(way[SQUARES] / s0 - q0 * q0 - q1 * q1 / p2 - along * along / square, 0.0)
    return level - m * tilt + m * m * bend, tilt - 2.0 * m * bend, bend, scatter2


@njit(**INNER_KERNEL)
def _use_way(memory: state.FilterState, parameters: KernelParameters, seconds: float, bias: float) -> None:
    """Updates the bias by what the way tells beyond what was used of it; a curve begins a new way.

    Which it is follows from the bias before the way. Mean and covariance are those of the mixture, as for a floor.
    """
    way, P, o, work = memory.straight, memory.covariance, memory.row, memory.work
    _, _, bend, _ = _fit_arc(memory)
    s = way[END]
    speed = s / (seconds - way[T_FIRST])
    told = way[BIAS] + 2.0 * bend * speed
    variance = (8.0 * parameters.wander_m * speed / s**2) ** 2
    straight2 = way[VARIANCE] + variance  # of what a straight way tells
    curved2 = straight2 + (_CURVE_SD_PER_M * speed) ** 2
    error = told - way[BIAS]
    odds = math.sqrt(straight2 / curved2) * math.exp(0.5 * error**2 * (1.0 / straight2 - 1.0 / curved2))
    probability = (1.0 - _CURVE_SHARE) / (1.0 - _CURVE_SHARE + _CURVE_SHARE * odds)
    if probability < 0.5:
        _begin(memory, seconds, bias)
        return
    gained = 1.0 / variance - way[USED]  # information of the longer way beyond what was used
    if gained > 0.0:
        fresh = (told / variance - way[USED] * way[USED_BIAS]) / gained
        h = _measure_bias(memory)
        correct_probably(P, memory.error, work.gain, o, h, fresh - bias, 1.0 / gained, probability)
        inject(memory)
        # the polyline goes on from where the correction has moved the foot
        way[PLACE], way[PLACE + 1] = memory.nominal[state.POSITION], memory.nominal[state.POSITION + 1]
        way[USED], way[USED_BIAS] = 1.0 / variance, told
    way[COUNTED_WAY] = s
    if s > _LONGEST_WAY_M:
        _begin(memory, seconds, bias)
