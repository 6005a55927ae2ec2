"""Updates of a stationary foot: zero velocity, zero rate and level floor, and the statistic that detects it."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.state import (
    ACCEL_BIAS,
    ATTITUDE,
    CONTACT,
    D_ACCEL_BIAS,
    D_ATTITUDE,
    D_CONTACT,
    D_FLOOR,
    D_GYRO_BIAS,
    D_POSITION,
    D_VELOCITY,
    FILL,
    FLOOR,
    GYRO_BIAS,
    HEAD,
    LANDED,
    NEVER_LANDED,
    POSITION,
    RING,
    STANDING,
    STATES,
    SWINGING,
    T_STOOD,
    VELOCITY,
    Memory,
    ring_row,
)
from stridetwin.estimators.foot_ins.strapdown import correct, shift
from stridetwin.estimators.so3 import hat, product, quat_exp, rotation_matrix
from stridetwin.streams.samples import Array


@njit(**INSIDE)
def append_sample(memory: Memory, t_ns: int, rate: Array, force: Array) -> None:
    """Appends one sample (rad/s, m/s²) to the ring."""
    head = (memory.clock[HEAD] + 1) % RING
    memory.clock[HEAD] = head
    memory.clock[FILL] = min(memory.clock[FILL] + 1, RING)
    memory.ring_t_ns[head] = t_ns
    memory.ring[head, :3] = rate
    memory.ring[head, 3:] = force


@njit(**INSIDE)
def motion_statistic(memory: Memory, parameters: KernelParameters) -> float:
    """Energy of the motion over the last `window_s`, dimensionless (SHOE: Skog et al. 2010, eq. 15).

    See docs/foot_ins.md (6).

    mean |f - g f̄/|f̄||² / accel_scale² + mean |ω - b_g|² / gyro_scale²
    """
    newest = memory.ring_t_ns[ring_row(memory, 0)]
    span = int(parameters.window_s * 1e9)
    bx, by, bz = memory.nominal[GYRO_BIAS], memory.nominal[GYRO_BIAS + 1], memory.nominal[GYRO_BIAS + 2]
    n = 0
    rate2 = force2 = fx = fy = fz = 0.0
    for back in range(memory.clock[FILL]):
        i = ring_row(memory, back)
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
def stationary_speed_sd(statistic: float, peak: float, parameters: KernelParameters) -> float:
    """Standard deviation of the foot's speed, m/s, as a stationary foot, from the motion statistic.

    See docs/foot_ins.md (7).
    """
    level = max(parameters.stationary_level, parameters.stationary_share * peak)
    return parameters.stationary_speed_mps * math.sqrt(1.0 + (statistic / level) ** parameters.stationary_power)


@njit(**INSIDE)
def move_contact_point(memory: Memory, parameters: KernelParameters, dt: float) -> None:
    """Random displacement of the stationary point along the sole over `dt` (s).

    See docs/foot_ins.md (13).

    A first-order Gauss-Markov process of standard deviation `contact_sd` and time constant `contact_s`, across the
    lever arm: a foot rolls over the same ball in every step.
    """
    x, P, o = memory.nominal, memory.covariance, memory.row + D_CONTACT
    kept = math.exp(-dt / parameters.contact_s)
    x[CONTACT : CONTACT + 3] *= kept
    P[o : o + 3] *= kept
    P[:, o : o + 3] *= kept
    P[o : o + 3, o : o + 3] += (1.0 - kept * kept) * across_sole(memory, parameters.contact_sd_m**2)


@njit(**INSIDE)
def across_sole(memory: Memory, variance: float) -> Array:
    """(3, 3) covariance of a point of the sole, sensor frame: `variance` in every direction across the lever arm."""
    down = memory.lever / max(math.sqrt(memory.lever @ memory.lever), 1e-9)
    return variance * (np.eye(3) - np.outer(down, down))


@njit(**INSIDE)
def zero_velocity_update(
    memory: Memory, parameters: KernelParameters, rate: Array, dt: float, stationary_speed_sd: float
) -> None:
    """Update with v + w × r = 0, w = R (ω - b_g), r the lever arm in the world (after Foxlin 2005).

    See docs/foot_ins.md (8)-(10).

    It is a measurement in sensor axes, invariant to a rotation of the whole world; so the Jacobian on the attitude is
    [v]x.

    The stationary point of the sole moves from heel to ball as the foot rolls. An arm uncertain by σ_r in every
    direction adds σ_r² (|w|² I - w wᵀ) to the noise, so a rotating foot constrains the speed across its axis little.
    Without this, the update would pull the rise of the heel to zero in every step.

    The foot's true speed in stance is not white noise: within `stationary_correlation_s` all updates share one error,
    so each sample counts as dt / stationary_correlation_s of an update, whatever the sample rate.

    A swinging foot may appear stationary for an instant: it glides without rotation while its force passes g. Then
    the normalised innovation is large, and the update's standard deviation grows in proportion to the excess over
    `innovation_gate` (after Chang 2014, J. Geodesy 88:391). Nothing is ever rejected, so a diverged filter recovers
    within some samples of stance.
    """
    x = memory.nominal
    R = rotation_matrix(x[ATTITUDE : ATTITUDE + 4])
    w = R @ (rate - x[GYRO_BIAS : GYRO_BIAS + 3])
    r = R @ (memory.lever + x[CONTACT : CONTACT + 3])
    u = hat(w) @ r
    H = np.zeros((3, STATES))
    H[:, D_VELOCITY : D_VELOCITY + 3] = np.eye(3)
    H[:, D_ATTITUDE : D_ATTITUDE + 3] = hat(x[VELOCITY : VELOCITY + 3])
    H[:, D_GYRO_BIAS : D_GYRO_BIAS + 3] = hat(r) @ R
    H[:, D_CONTACT : D_CONTACT + 3] = hat(w) @ R
    shared = math.sqrt(max(1.0, parameters.stationary_correlation_s / dt))
    W = _whitening(w, shared * stationary_speed_sd, shared * parameters.lever_sd_m)
    H, z = W @ H, W @ (-x[VELOCITY : VELOCITY + 3] - u)
    memory.nis[0] += normalized_innovation(_own_covariance(memory), shared * H, shared * z) ** 2 / 3.0
    memory.nis[1] += 1.0
    _gated_update(memory, H, z, parameters.innovation_gate)


@njit(**INSIDE)
def _gated_update(memory: Memory, H: Array, z: Array, innovation_gate: float) -> None:
    """Update with an innovation z (m,) of unit noise, which grows in proportion to what exceeds `innovation_gate`.

    See docs/foot_ins.md (11).
    """
    inflation = max(1.0, normalized_innovation(_own_covariance(memory), H, z) / innovation_gate)
    for i in range(len(z)):
        correct(memory.covariance, memory.error, memory.row, H[i] / inflation, z[i] / inflation, 1.0)
    inject(memory)


@njit(**INSIDE)
def _own_covariance(memory: Memory) -> Array:
    """(19, 19) covariance of the foot alone."""
    o = memory.row
    return np.ascontiguousarray(memory.covariance[o : o + STATES, o : o + STATES])


@njit(**INSIDE)
def normalized_innovation(P: Array, H: Array, z: Array) -> float:
    """Normalised innovation: length of z (m,), of unit noise and Jacobian H (m, n), in standard deviations."""
    return math.sqrt(z @ np.linalg.solve(H @ P @ H.T + np.eye(len(z)), z))


@njit(**INSIDE)
def _whitening(w: Array, speed_sd: float, lever_sd: float) -> Array:
    """(3, 3) inverse square root of speed_sd² I + lever_sd² (|w|² I - w wᵀ)."""
    w2 = w[0] ** 2 + w[1] ** 2 + w[2] ** 2
    along, across = 1.0 / speed_sd, 1.0 / math.sqrt(speed_sd**2 + lever_sd**2 * w2)
    return across * np.eye(3) + (along - across) / max(w2, 1e-12) * np.outer(w, w)


@njit(**INSIDE)
def zero_rate_update(memory: Memory, parameters: KernelParameters, rate: Array, dt: float) -> None:
    """Update with ω = b_g: a foot at rest for long does not rotate.

    A person who stands for long sways: a rate improbable as a bias is down-weighted, as in `zero_velocity_update`.
    """
    sd = parameters.rest_rate_noise_radps_rthz / math.sqrt(dt)
    H = np.zeros((3, STATES))
    H[:, D_GYRO_BIAS : D_GYRO_BIAS + 3] = np.eye(3) / sd
    z = (rate - memory.nominal[GYRO_BIAS : GYRO_BIAS + 3]) / sd
    _gated_update(memory, H, z, parameters.innovation_gate)


@njit(**INSIDE)
def inject(memory: Memory) -> None:
    """Moves the foot's own error into its nominal state, in place."""
    x = memory.nominal
    error = memory.error[memory.row : memory.row + STATES]
    for i in range(3):
        x[POSITION + i] += error[D_POSITION + i]
        x[VELOCITY + i] += error[D_VELOCITY + i]
        x[GYRO_BIAS + i] += error[D_GYRO_BIAS + i]
        x[ACCEL_BIAS + i] += error[D_ACCEL_BIAS + i]
        x[CONTACT + i] += error[D_CONTACT + i]
    x[FLOOR] += error[D_FLOOR]
    rotation = quat_exp(error[D_ATTITUDE], error[D_ATTITUDE + 1], error[D_ATTITUDE + 2])
    x[ATTITUDE : ATTITUDE + 4] = product(rotation, x[ATTITUDE : ATTITUDE + 4])
    shift(memory.covariance, memory.row, error[D_POSITION : D_POSITION + 3], error[D_VELOCITY : D_VELOCITY + 3])
    error[:] = 0.0


@njit(**INSIDE)
def level_floor_update(memory: Memory, parameters: KernelParameters, t_ns: int, stationary_speed_sd: float) -> None:
    """Compares the height of a foot that has just become stationary with that of its last floor.

    See docs/foot_ins.md (14).

    Zero-velocity updates do not observe height, so its error grows with every stride, mostly with one sign. Built
    ground is level or clearly not. If the foot is stationary and flat, and its height has changed by less than
    `level_step_m` and by no more than the filter's uncertainty, the floor is taken to be the same, up to `floor_sd_m`
    (after Abdulrahim, Hide, Moore, Hill 2012). Elsewhere, on a stair or ramp, the floor is at the foot's height and as
    uncertain as the foot. `stationary_speed_sd` is in m/s, inf for a moving foot.
    """
    clock = memory.clock
    if stationary_speed_sd > parameters.stand_speed_mps:
        clock[T_STOOD] = t_ns
        if stationary_speed_sd == math.inf and clock[LANDED] == STANDING:
            clock[LANDED] = SWINGING
        return
    if clock[LANDED] == STANDING or (t_ns - clock[T_STOOD]) * 1e-9 < parameters.stand_s:
        return
    x, P, o = memory.nominal, memory.covariance, memory.row
    r = rotation_matrix(x[ATTITUDE : ATTITUDE + 4]) @ memory.lever
    h = np.zeros(STATES)  # of the sole's height above the floor
    h[D_POSITION + 2], h[D_ATTITUDE], h[D_ATTITUDE + 1], h[D_FLOOR] = 1.0, r[1], -r[0], -1.0
    height = x[POSITION + 2] + r[2]
    known, clock[LANDED] = clock[LANDED] != NEVER_LANDED, STANDING
    step = height - x[FLOOR]
    flat = math.hypot(r[0], r[1]) <= parameters.level_tilt_rad * parameters.lever_arm_m
    own = np.ascontiguousarray(P[o : o + STATES, o : o + STATES])
    variance = h @ own @ h + parameters.floor_sd_m**2
    possible = abs(step) < min(parameters.level_step_m, parameters.innovation_gate * math.sqrt(variance))
    if known and flat and possible:
        correct(P, memory.error, o, h, -step, parameters.floor_sd_m**2)
        inject(memory)
        return
    x[FLOOR] = height
    h[D_FLOOR] = 0.0
    row = h @ np.ascontiguousarray(P[o : o + STATES])
    P[o + D_FLOOR] = row
    P[:, o + D_FLOOR] = row
    P[o + D_FLOOR, o + D_FLOOR] = h @ own @ h
