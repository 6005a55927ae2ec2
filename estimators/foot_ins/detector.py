"""How much the foot moves: one number over the last few hundredths of a second, and the recent peak of it."""

from __future__ import annotations

import math

from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.foot_ins.memory import FILL, GYRO_BIAS, HEAD, RING, Memory
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.streams.samples import Array


@njit(**INSIDE)
def push(memory: Memory, t_ns: int, rate: Array, force: Array) -> None:
    """Appends one sample (rad/s, m/s²) to the ring."""
    head = (memory.clock[HEAD] + 1) % RING
    memory.clock[HEAD] = head
    memory.clock[FILL] = min(memory.clock[FILL] + 1, RING)
    memory.ring_t_ns[head] = t_ns
    memory.ring[head, :3] = rate
    memory.ring[head, 3:] = force


@njit(**INSIDE)
def motion(memory: Memory, parameters: KernelParameters) -> float:
    """Energy of the motion over the last `window_s`, dimensionless (SHOE: Skog et al. 2010, eq. 15).

    See docs/foot_ins.md (6).

    mean |f - g f̄/|f̄||² / accel_scale² + mean |ω - b_g|² / gyro_scale²
    """
    newest = memory.ring_t_ns[memory.clock[HEAD]]
    span = int(parameters.window_s * 1e9)
    bx, by, bz = memory.nominal[GYRO_BIAS], memory.nominal[GYRO_BIAS + 1], memory.nominal[GYRO_BIAS + 2]
    n = 0
    rate2 = force2 = fx = fy = fz = 0.0
    for back in range(memory.clock[FILL]):
        i = (memory.clock[HEAD] - back) % RING
        if newest - memory.ring_t_ns[i] >= span and back > 0:
            break
        s = memory.ring[i]
        rate2 += (s[0] - bx) ** 2 + (s[1] - by) ** 2 + (s[2] - bz) ** 2
        force2 += s[3] * s[3] + s[4] * s[4] + s[5] * s[5]
        fx, fy, fz = fx + s[3], fy + s[4], fz + s[5]
        n += 1
    g = parameters.gravity_mps2
    spread2 = force2 / n - 2.0 * g * math.sqrt(fx * fx + fy * fy + fz * fz) / n + g * g
    return max(spread2, 0.0) / parameters.accel_scale_mps2**2 + rate2 / n / parameters.gyro_scale_radps**2


@njit(**INSIDE)
def standing_speed(statistic: float, peak: float, parameters: KernelParameters) -> float:
    """Standard deviation of the foot's speed, m/s, so far as the statistic tells it stands.

    See docs/foot_ins.md (7).
    """
    level = max(parameters.still_level, parameters.still_share * peak)
    return parameters.still_velocity_mps * math.sqrt(1.0 + (statistic / level) ** parameters.still_power)
