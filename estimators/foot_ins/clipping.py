"""Reconstruction of clipped peaks, once the sensor is back within its range."""

from __future__ import annotations

from numba import njit

from stridetwin.estimators.foot_ins import state
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.strapdown import propagate_state, shift_covariance
from stridetwin.streams.algebra.tuples import (
    axpy,
    inverse,
    multiply,
    normalized,
    quaternion_at,
    store_quaternion_at,
    to_matrix,
    vec3_at,
)
from stridetwin.streams.compiled import INNER_KERNEL

_MAX_PEAK_S = 0.15  # a longer clipped peak is not determined by its two ends
# Least number of clipped samples of a peak: shorter impacts on an accelerometer ring and have no such shape.
_MIN_PEAK_RATES, _MIN_PEAK_FORCES = 1, 3
_MIN_LANDING_COSINE = 0.7  # between the vertical and a channel that senses a landing
# In a long peak the cubic is too high: before its toes leave the ground a foot rolls for a while at about the range,
# and the slope of its last snap says nothing of that. But no foot turns much faster than `_USUAL_PEAK_RADPS`. So the
# mean excess over the peak saturates at `_PEAK_SHARE` of what this rate exceeds the range, or, for wide ranges, of
# `_LEAST_EXCESS` of the range. [14 real walks clipped at 250 to 450 °/s; twin: seeds 0-4]
_USUAL_PEAK_RADPS, _PEAK_SHARE, _LEAST_EXCESS = 9.5, 0.6, 0.1
_SATURATION_POWER = 4  # steepness of the transition: at half of the limit 1.5 % of the excess are lost


@njit(**INNER_KERNEL)
def restore_peaks(memory: state.FilterState, parameters: KernelParameters) -> None:
    """Rewinds to before a channel reached its range, and propagates again with the reconstructed peak.

    The peak is the cubic of docs/foot_ins.md (15). It is added to the samples in the ring. The corrections of position,
    velocity and attitude after each of them are written into `memory.restored`, and `memory.clock[RESTORED]` becomes
    the number of samples since the peak began, 0 if no peak has just ended.

    At push-off the foot rotates faster than many a gyro's range, and before landing it brakes beyond many an
    accelerometer's: always in the same direction, by some tenths of a radian or a metre per second. A linear filter
    corrects that only in part. The signal enters and leaves the range with a slope; the cubic between (Hermite) is the
    peak. A channel is processed once two samples are back within the range. The remaining error is the filter's noise
    at the limit. Unknown ranges disable the reconstruction.

    A landing impact is too short for a shape. It is known to push upwards, so on average it hides `impact_excess` per
    sample. Without this, the foot sinks a little at every landing, up stairs and down.
    """
    first = 0  # the oldest sample before a peak, counted back from the newest
    for channel in range(6):
        first = max(first, _reconstruct_peak(memory, parameters, channel))
    memory.clock[state.RESTORED] = first
    if first == 0:
        return
    x, moved, gravity = memory.nominal, memory.restored, parameters.gravity_mps2
    down = vec3_at(memory.lever, 0)
    p, v = vec3_at(x, state.POSITION), vec3_at(x, state.VELOCITY)  # without the peak
    for back in range(first + 1):  # backward from the newest sample, without the peak; stores each state in `moved`
        i = state.ring_row(memory, back)
        for k in range(state.GYRO_BIAS):  # position, velocity and quaternion come before the biases
            moved[back, k] = x[k]
        propagate_state(x, state.rate_of(memory, i), state.force_of(memory, i), -_interval_s(memory, i), gravity, down)
    for back in range(first, -1, -1):  # forward again with the peak; `moved` becomes the difference of the states
        i = state.ring_row(memory, back)
        for channel in range(6):
            memory.ring[i, channel] += memory.hidden[back, channel]  # later reads of the ring include the peak
            memory.hidden[back, channel] = 0.0
        propagate_state(x, state.rate_of(memory, i), state.force_of(memory, i), _interval_s(memory, i), gravity, down)
        for k in range(state.ATTITUDE):
            moved[back, k] = x[k] - moved[back, k]
        before = quaternion_at(moved[back], state.ATTITUDE)
        turn = normalized(multiply(quaternion_at(x, state.ATTITUDE), inverse(before)))  # rotation in the world
        store_quaternion_at(turn, moved[back], state.ATTITUDE)
    shift_covariance(
        memory.covariance,
        memory.row,
        axpy(vec3_at(x, state.POSITION), -1.0, p),
        axpy(vec3_at(x, state.VELOCITY), -1.0, v),
    )


@njit(**INNER_KERNEL)
def is_clipped(memory: state.FilterState, parameters: KernelParameters) -> bool:
    """Whether a channel was at its range in the last two samples, so that its peak is not restored yet.

    An update meanwhile would blame the state for the error, and `restore_peaks` would correct it again.
    """
    for back in range(2):
        for channel in range(6):
            sensor_range = _channel_range(parameters, channel)
            size = abs(memory.ring[state.ring_row(memory, back), channel])
            if sensor_range > 0.0 and size >= parameters.clipped_share * sensor_range:
                return True
    return False


@njit(**INNER_KERNEL)
def _interval_s(memory: state.FilterState, i: int) -> float:
    """Time from the sample before to the sample in the ring's row `i`, s."""
    return (memory.ring_t_ns[i] - memory.ring_t_ns[(i - 1) % state.RING]) * 1e-9


@njit(**INNER_KERNEL)
def _channel_range(parameters: KernelParameters, channel: int) -> float:
    """Range of a channel of the ring, rad/s or m/s²; 0 if unknown."""
    return parameters.gyro_range_radps if channel < 3 else parameters.accel_range_mps2


@njit(**INNER_KERNEL)
def _reconstruct_peak(memory: state.FilterState, parameters: KernelParameters, channel: int) -> int:
    """Writes the hidden part of one channel's peak into `memory.hidden`: docs/foot_ins.md (15).

    A peak has just ended if the two newest samples are within the range and the third newest is not. A peak with too
    few clipped samples may be a landing impact: if the force points up, the same amount is added to each of them.
    Any other peak is a cubic between the slopes with which the signal leaves and enters the range; that of a rate is
    limited by what feet turn.

    Args:
        memory: State of the foot; `hidden` is written, in rad/s or m/s², one row per sample, the newest first.
        parameters: Ranges of the sensor, 0 if unknown, and the share of a range from which on a sample is clipped.
        channel: Column of the ring: 0-2 angular rate, 3-5 specific force.

    Returns:
        Number of samples since the peak began; 0 if none has just ended.
    """
    sensor_range = _channel_range(parameters, channel)
    least = _MIN_PEAK_RATES if channel < 3 else _MIN_PEAK_FORCES
    fill = memory.clock[state.FILL]
    limit = parameters.clipped_share * sensor_range  # a sample of this size or more is clipped
    third_newest = memory.ring[state.ring_row(memory, 2), channel]
    # the range is unknown, the ring has too few samples, or the third newest of them is not clipped
    if sensor_range <= 0.0 or fill < 6 or abs(third_newest) < limit:
        return 0
    # that of the peak: all samples are taken times it, so that the peak is positive
    sign = 1.0 if third_newest > 0.0 else -1.0
    # samples 2 to `end` - 1, counted back from the newest, are clipped; `top` is their sum, later their mean
    end, top = 2, 0.0
    while end < fill - 3 and _read_signed(memory, end, channel, sign) >= limit:
        top += _read_signed(memory, end, channel, sign)
        end += 1
    # x0, x1: the two samples after the peak; x_end, x_before: the two before it
    x0, x1 = _read_signed(memory, 0, channel, sign), _read_signed(memory, 1, channel, sign)
    x_end, x_before = _read_signed(memory, end, channel, sign), _read_signed(memory, end + 1, channel, sign)
    span = (memory.ring_t_ns[state.ring_row(memory, 0)] - memory.ring_t_ns[state.ring_row(memory, end + 1)]) * 1e-9
    dt = span / (end + 1)
    rise, fall = (x_end - x_before) / dt, (x1 - x0) / dt  # slopes at both ends, positive for a peak
    if max(x0, x1, x_end) >= limit:  # the peak goes on, or began before the samples in the ring
        return 0
    if end - 2 < least:  # too short for a shape: a landing, or nothing
        up = to_matrix(quaternion_at(memory.nominal, state.ATTITUDE))[2]  # in the sensor
        if channel < 3 or sign * up[channel - 3] < _MIN_LANDING_COSINE:
            return 0
        for back in range(2, end):
            memory.hidden[back, channel] = sign * parameters.impact_excess * sensor_range
        return end
    if channel < 3:  # a rate that dips below its range between two peaks has a slope beside one of them only
        rise, fall = max(rise, 0.0), max(fall, 0.0)
        no_peak = rise + fall <= 0.0
    else:
        no_peak = min(rise, fall) <= 0.0
    if no_peak or span > _MAX_PEAK_S:  # no peak between these slopes, or too long a one
        return 0
    top /= end - 2
    # time from the last sample before the peak to the range, and from the range to the first sample after it, s
    before, after = min((top - x_end) / max(rise, 1e-9), dt), min((top - x1) / max(fall, 1e-9), dt)
    length = (end - 1) * dt - before - after  # duration of the peak beyond the range, s
    if length <= 0.0:  # no time is left beyond the range
        return 0
    # the slopes are measured outside the range; a peak of even curvature is flatter where it begins
    flatter = 1.0 / (1.0 + (dt + before + after) / length)
    excess = 0.0  # mean of the cubic
    for back in range(2, end):
        u = min(max(((end - back) * dt - before) / length, 0.0), 1.0)  # share of the peak's duration
        memory.hidden[back, channel] = sign * flatter * length * u * (1.0 - u) * (rise * (1.0 - u) + fall * u)
        excess += abs(memory.hidden[back, channel]) / (end - 2)
    if channel < 3:
        most = _PEAK_SHARE * max(_USUAL_PEAK_RADPS - sensor_range, _LEAST_EXCESS * sensor_range)
        for back in range(2, end):
            memory.hidden[back, channel] /= (1.0 + (excess / most) ** _SATURATION_POWER) ** (1.0 / _SATURATION_POWER)
    return end


@njit(**INNER_KERNEL)
def _read_signed(memory: state.FilterState, back: int, channel: int, sign: float) -> float:
    """A channel of the sample `back` samples older than the newest, times `sign`."""
    return sign * memory.ring[state.ring_row(memory, back), channel]
