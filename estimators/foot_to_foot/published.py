"""The system of Jao, Wang, Shkel 2020 (IEEE/ION PLANS): hard zero velocities and the vector between the feet.

The 30 error states are the paper's in another order. Two misprints are read as the text has them: the columns of
A(t) follow the state vector, and the foot is stationary if the variances are *low*. Measurements are linear in the
error, so sequential updates equal the paper's batch.
"""

from __future__ import annotations

import math

from numba import njit

from stridetwin.estimators.foot_ins.kalman import clear, correct
from stridetwin.estimators.foot_ins.kernel import add_sample
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.stance import ACCEL_SCALE_MPS2, GYRO_SCALE_RADPS, inject
from stridetwin.estimators.foot_ins.state import (
    D_POSITION,
    D_VELOCITY,
    FILL,
    NAVIGATING,
    STATES,
    VELOCITY,
    FilterState,
    ring_row,
)
from stridetwin.estimators.foot_ins.strapdown import predict
from stridetwin.estimators.foot_to_foot.parameters import PairParameters
from stridetwin.estimators.foot_to_foot.relative_updates import UNUSED
from stridetwin.estimators.foot_to_foot.rewind import rewind
from stridetwin.estimators.foot_to_foot.state import Pair, inject_all
from stridetwin.streams.algebra.tuples import Vec3, axpy, dot, matvec
from stridetwin.streams.compiled import INNER_KERNEL


@njit(**INNER_KERNEL)
def variance_statistic(memory: FilterState, parameters: PairParameters) -> float:
    """σ_a²/σ̄_a² + σ_g²/σ̄_g² over the last `window_s`, the variances summed over the axes (Jao 2020, Sec. II-D).

    docs/foot_to_foot.md (10). σ_g² and σ_a² are variances of angular rate and specific force. The amplitudes σ̄ are
    constants: `GYRO_SCALE_RADPS` and `ACCEL_SCALE_MPS2`, the same as in the one-foot filter's motion statistic.
    """
    total = 0.0
    for channel in range(6):  # of the ring: 0-2 angular rate, 3-5 specific force
        scale = GYRO_SCALE_RADPS if channel < 3 else ACCEL_SCALE_MPS2
        total += _variance(memory, parameters.window_s, channel) / scale**2
    return total


@njit(**INNER_KERNEL)
def _variance(memory: FilterState, window_s: float, channel: int) -> float:
    """Variance of one channel over the last `window_s`, of at least two samples if there are two.

    Channels 0-2 are the angular rate, (rad/s)², 3-5 the specific force, (m/s²)².
    """
    newest = memory.ring_t_ns[ring_row(memory, 0)]
    # number, sum and sum of the squares of the values
    n, total, squares = 0, 0.0, 0.0
    for back in range(memory.clock[FILL]):
        i = ring_row(memory, back)
        if (newest - memory.ring_t_ns[i]) * 1e-9 >= window_s and back > 1:
            break
        value = memory.ring[i, channel]
        total += value
        squares += value * value
        n += 1
    return squares / n - (total / n) ** 2


@njit(**INNER_KERNEL)
def step_published(
    memory: FilterState, foot: KernelParameters, parameters: PairParameters, t_ns: int, rate: Vec3, force: Vec3
) -> tuple[int, float]:
    """Takes one sample of a foot: hard zero velocities while the variances are low.

    Args:
        memory: State of the foot, changed in place.
        foot: Parameters of the foot.
        parameters: Parameters of both feet.
        t_ns: End of the sample's interval.
        rate: (3,) rad/s, mean over the interval.
        force: (3,) m/s², mean specific force over the interval.

    Returns:
        Phase in which the sample was used (IGNORED, ALIGNING or NAVIGATING); standard deviation of the stationary
        foot's speed, m/s, inf while it is not detected as stationary.
    """
    phase, dt, _ = add_sample(memory, foot, t_ns, rate, force)
    if phase != NAVIGATING:
        return phase, math.inf
    predict(memory, foot, rate, force, dt)
    if variance_statistic(memory, parameters) >= parameters.threshold:
        return NAVIGATING, math.inf
    for i in range(3):  # zero velocity, one axis after the other
        clear(memory.work, 1)
        h = memory.work.jacobian[0]
        h[D_VELOCITY + i] = 1.0
        # the measured velocity is 0, so the innovation is minus the estimated one
        z, variance = -memory.nominal[VELOCITY + i], parameters.zero_velocity_sd_mps**2
        correct(memory.covariance, memory.error, memory.work.gain, memory.row, h, z, variance)
    inject(memory)
    return NAVIGATING, parameters.zero_velocity_sd_mps


@njit(**INNER_KERNEL)
def relative_position_update(
    pair: Pair,
    foot: KernelParameters,
    parameters: PairParameters,
    camera: int,
    t_ns: int,
    p_other_in_imu: Vec3,
    sd: float,
) -> float:
    """Update with the vector between the feet, rotated into the world by the attitude of the camera's foot.

    It is z_feet of the paper, docs/foot_to_foot.md (10). Its Jacobian H_feet has ±I at the two positions and 0 at the
    attitudes: as printed, it omits the error of the attitude that rotated the vector, and the filter takes the heading
    of the camera's foot as free of error.

    Args:
        pair: State of both feet, changed in place.
        foot: Parameters of the foot with the camera.
        parameters: Parameters of both.
        camera: Index in `FEET` of the foot that carries the camera.
        t_ns: Middle of the exposure, on the clock of the IMUs.
        p_other_in_imu: (3,) m, position of the other foot's IMU in this foot's.
        sd: Standard deviation of the position on each axis, m.

    Returns:
        Length of the innovation in units of `sd`, or UNUSED.
    """
    # states at the exposure: a of the foot with the camera, b of the other
    a = rewind(pair.feet[camera], foot.gravity_mps2, t_ns, parameters.max_delay_s)
    b = rewind(pair.feet[1 - camera], foot.gravity_mps2, t_ns, parameters.max_delay_s)
    if not (a.known and b.known):
        return UNUSED
    z = axpy(matvec(a.R, p_other_in_imu), -1.0, axpy(b.p, -1.0, a.p))  # measured minus predicted, world axes, m
    variance = sd**2 + parameters.relative_position_sd_m**2  # the second for the heading, which H takes as exact
    for i in range(3):
        clear(pair.work, 1)
        h = pair.work.jacobian[0]
        h[STATES * (1 - camera) + D_POSITION + i] = 1.0
        h[STATES * camera + D_POSITION + i] = -1.0
        correct(pair.covariance, pair.error, pair.work.gain, 0, h, z[i], variance)
    inject_all(pair)
    return math.sqrt(dot(z, z)) / sd
