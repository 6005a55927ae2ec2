"""Reconstruction of clipped peaks, once the sensor is back within its range."""

from __future__ import annotations

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.foot_ins.algebra import product, rotation_matrix
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.state import (
    ATTITUDE,
    FILL,
    GYRO_BIAS,
    HEAD,
    POSITION,
    RESTORED,
    RING,
    VELOCITY,
    Memory,
)
from stridetwin.estimators.foot_ins.strapdown import propagate_state, shift
from stridetwin.streams.samples import Array

AT_LIMIT = 0.99  # share of the range above which a sample counts as clipped
LONGEST_S = 0.15  # a longer peak is not determined by its two ends
LEAST_RATES, LEAST_FORCES = 1, 3  # clipped samples; a shorter impact on an accelerometer rings, and has no such shape
UPWARD = 0.7  # least cosine between a channel that senses the floor and the vertical


@njit(**INSIDE)
def restore(memory: Memory, parameters: KernelParameters) -> None:
    """Rewinds to before a channel reached its range, and propagates again with the reconstructed peak.

    See docs/foot_ins.md (15).

    At push-off the foot rotates faster than many a gyro's range, and before landing it brakes beyond many an
    accelerometer's: always in the same direction, by some tenths of a radian or a metre per second. A linear filter
    corrects that only in part. The signal enters and leaves the range with a slope; the cubic between (Hermite) is the
    peak. A channel is processed once two samples are back within the range. The remaining error is the filter's noise
    at the limit.

    A landing impact is too short for a shape. It is known to push upwards, so on average it hides `impact_excess` per
    sample. Without this, the foot sinks a little at every landing, up stairs and down.

    Args:
        memory: Nominal state and ring change if a peak has ended; the correction is recorded.
        parameters: With the ranges; unknown ranges disable the reconstruction.
    """
    first = 0
    hidden = np.zeros((RING, 6))
    for channel in range(6):
        known = parameters.gyro_range_radps if channel < 3 else parameters.accel_range_mps2
        least = LEAST_RATES if channel < 3 else LEAST_FORCES
        first = max(first, _peak(memory, channel, known, least, parameters.impact_excess, hidden))
    memory.clock[RESTORED] = first
    if first == 0:
        return
    head, x = memory.clock[HEAD], memory.nominal
    p, v = x[POSITION : POSITION + 3].copy(), x[VELOCITY : VELOCITY + 3].copy()
    moved = memory.restored
    for back in range(first + 1):
        i = (head - back) % RING
        moved[back] = x[:GYRO_BIAS]
        propagate_state(
            memory.nominal, memory.ring[i, :3], memory.ring[i, 3:], -_dt(memory, i), parameters.gravity_mps2
        )
    for back in range(first, -1, -1):
        i = (head - back) % RING
        memory.ring[i] += hidden[back]  # later reads of the ring include the peak
        propagate_state(memory.nominal, memory.ring[i, :3], memory.ring[i, 3:], _dt(memory, i), parameters.gravity_mps2)
        moved[back, :ATTITUDE] = x[:ATTITUDE] - moved[back, :ATTITUDE]
        moved[back, ATTITUDE + 1 :] *= -1.0
        moved[back, ATTITUDE:] = product(x[ATTITUDE:GYRO_BIAS], moved[back, ATTITUDE:])
    shift(memory.covariance, memory.row, x[POSITION : POSITION + 3] - p, x[VELOCITY : VELOCITY + 3] - v)


@njit(**INSIDE)
def is_clipped(memory: Memory, parameters: KernelParameters) -> bool:
    """Whether a channel is clipped, or too recently so for `restore` to have reconstructed its peak.

    An update meanwhile would blame the state for the error, and the same peak would be added a second time.
    """
    for back in range(2):
        for channel in range(6):
            known = parameters.gyro_range_radps if channel < 3 else parameters.accel_range_mps2
            if known > 0.0 and abs(memory.ring[(memory.clock[HEAD] - back) % RING, channel]) >= AT_LIMIT * known:
                return True
    return False


@njit(**INSIDE)
def _dt(memory: Memory, i: int) -> float:
    """Length of the interval of the ring's sample `i`, s."""
    return (memory.ring_t_ns[i] - memory.ring_t_ns[(i - 1) % RING]) * 1e-9


@njit(**INSIDE)
def _peak(memory: Memory, channel: int, known: float, least: int, excess: float, hidden: Array) -> int:
    """Writes the hidden part of one channel into `hidden` (RING, 6), the newest sample first.

    Args:
        memory: Not changed.
        channel: Of the ring.
        known: Its range, 0 if unknown.
        least: Least number of clipped samples of a peak.
        excess: Mean hidden by a landing in each such sample, as a share of the range.
        hidden: Changed in place.

    Returns:
        Number of samples since the peak began; 0 if none has just ended.
    """
    head, fill = memory.clock[HEAD], memory.clock[FILL]
    limit = AT_LIMIT * known
    last = memory.ring[(head - 2) % RING, channel]
    if known <= 0.0 or fill < 6 or abs(last) < limit:
        return 0
    sign = 1.0 if last > 0.0 else -1.0
    end = 2
    while end < fill - 3 and sign * memory.ring[(head - end) % RING, channel] >= limit:
        end += 1
    x = np.empty(end + 2)
    for back in range(end + 2):
        x[back] = sign * memory.ring[(head - back) % RING, channel]
    span = (memory.ring_t_ns[head] - memory.ring_t_ns[(head - end - 1) % RING]) * 1e-9
    dt = span / (end + 1)
    rise, fall = (x[end] - x[end + 1]) / dt, (x[1] - x[0]) / dt
    if max(x[0], x[1], x[end]) >= limit:
        return 0
    if end - 2 < least:
        to_world = rotation_matrix(memory.nominal[ATTITUDE : ATTITUDE + 4])
        if channel < 3 or sign * to_world[2, channel - 3] < UPWARD:
            return 0
        hidden[2:end, channel] = sign * excess * known
        return end
    if min(rise, fall) <= 0.0 or span > LONGEST_S:
        return 0
    top = x[2:end].mean()
    before, after = min((top - x[end]) / rise, dt), min((top - x[1]) / fall, dt)
    length = (end - 1) * dt - before - after
    if length <= 0.0:
        return 0
    # the slopes are measured outside the range; a peak of even curvature is flatter where it begins
    flatter = 1.0 / (1.0 + (dt + before + after) / length)
    for back in range(2, end):
        u = min(max(((end - back) * dt - before) / length, 0.0), 1.0)
        hidden[back, channel] = sign * flatter * length * u * (1.0 - u) * (rise * (1.0 - u) + fall * u)
    return end
