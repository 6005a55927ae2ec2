"""Updates of a stationary foot: zero velocity and level floor, and the statistic that detects it."""

from __future__ import annotations

import math

from numba import njit

from stridetwin.estimators.foot_ins import filled, state
from stridetwin.estimators.foot_ins.creep import begin_stance, creep_velocity, find_creep, shift_by_creep
from stridetwin.estimators.foot_ins.kalman import (
    apply_gated_update,
    clear,
    correct_probably,
    innovation_norm,
    spread_measurements,
)
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.slope import finish_levelled_step, note_levelled
from stridetwin.estimators.foot_ins.strapdown import shift_covariance
from stridetwin.streams.algebra.tuples import (
    Mat3,
    Vec3,
    axpy,
    cross,
    dot,
    exp,
    matvec,
    multiply,
    normalized,
    quaternion_at,
    store_quaternion_at,
    store_vec3_at,
    to_matrix,
    transposed,
    vec3_at,
)
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

_UNIT: Mat3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

# Angular rate and specific force that count 1 in the motion statistic. [real walks]
GYRO_SCALE_RADPS, ACCEL_SCALE_MPS2 = 0.0017, 0.0045
# Largest error of an uncalibrated accelerometer at rest, as a share of gravity: data sheets give ±3 % at most.
_MAX_NORM_ERROR = 0.05
_CONTACT_S = 10.0  # correlation time of the displacement of the stationary point along the sole [real walks]
_HEIGHT_DRIFT_S = 5.0  # correlation time of the systematic height error: it changes with the gait
_LEVEL_STEP_M = 0.035  # a larger change of height between two steps is no error of a level floor
_SAME_AFTER_NEW = 0.5  # `same_floor` after a step onto a new floor
_NEW_FLOOR_RANGE_M = 0.5  # another floor is anywhere in a range of this width
_SOLE_M = 0.1  # arm by which a tilted sole raises the sensor
_FLOOR_PRIOR = 5.0  # number of level steps that `floor_sd_m` is worth against those of the walk
_STAND_SPEED_MPS = 0.02  # largest speed uncertainty of a foot on a floor [real walks]
_STAND_S = 0.0298  # stationary time before the height of a foot counts [real walks]


@njit(**INNER_KERNEL)
def append_sample(memory: state.FilterState, t_ns: int, rate: Vec3, force: Vec3) -> None:
    """Appends one sample to the ring of the last samples, over the oldest one.

    A row of the ring is the angular rate (entries 0-2, rad/s) and the specific force (entries 3-5, m/s²). `clock[HEAD]`
    is the row of the newest sample, `clock[FILL]` the number of valid rows.
    """
    head = (memory.clock[state.HEAD] + 1) % state.RING
    memory.clock[state.HEAD] = head
    memory.clock[state.FILL] = min(memory.clock[state.FILL] + 1, state.RING)
    memory.ring_t_ns[head] = t_ns
    for i in range(3):
        memory.ring[head, i] = rate[i]
        memory.ring[head, 3 + i] = force[i]


@njit(**INNER_KERNEL)
def motion_statistic(memory: state.FilterState, parameters: KernelParameters) -> float:
    """Energy of the motion over the last `window_s`, dimensionless (SHOE: Skog et al. 2010, eq. 15).

    docs/foot_ins.md (6):

    mean |f - g f̄/|f̄||² / accel_scale² + mean |ω - b_g|² / gyro_scale²

    |g| is the size of the force at rest, as measured in the alignment (`memory.norm`): an uncalibrated accelerometer
    measures gravity with an error of some per cent. Before that, it is the size of the mean force, limited to within
    `_MAX_NORM_ERROR` of gravity. The statistic is small for a foot at rest.
    """
    newest = memory.ring_t_ns[state.ring_row(memory, 0)]
    span = int(parameters.window_s * 1e9)
    bias = vec3_at(memory.nominal, state.GYRO_BIAS)
    # number of samples; sums of |ω - b_g|², of |f|² and of f
    n, rate2, force2, force_sum = 0, 0.0, 0.0, (0.0, 0.0, 0.0)
    for back in range(memory.clock[state.FILL]):
        i = state.ring_row(memory, back)
        if newest - memory.ring_t_ns[i] >= span and back > 0:  # the newest sample always counts
            break
        rate, force = axpy(state.rate_of(memory, i), -1.0, bias), state.force_of(memory, i)
        rate2 += dot(rate, rate)
        force2 += dot(force, force)
        force_sum = axpy(force_sum, 1.0, force)
        n += 1
    size, g = math.sqrt(dot(force_sum, force_sum)) / n, memory.norm[0]  # |f̄| and |g|
    if g == 0.0:  # not aligned yet
        most = _MAX_NORM_ERROR * parameters.gravity_mps2
        g = parameters.gravity_mps2 + min(max(size - parameters.gravity_mps2, -most), most)
    spread2 = force2 / n - 2.0 * g * size + g * g  # mean |f - g f̄/|f̄||², multiplied out
    return max(spread2, 0.0) / ACCEL_SCALE_MPS2**2 + rate2 / n / GYRO_SCALE_RADPS**2


@njit(**INNER_KERNEL)
def stationary_speed_sd(statistic: float, peak: float, parameters: KernelParameters) -> float:
    """Standard deviation of a stationary foot's speed, m/s, by the motion statistic (docs/foot_ins.md (7)).

    It grows with the statistic, without a limit: the caller decides from which value on the foot counts as moving.

    Args:
        statistic: Motion statistic at the sample (`motion_statistic`).
        peak: Slowly decaying peak of it: the stances of a fast gait are less quiet.
        parameters: Parameters of the filter.
    """
    # from this value of the statistic on the trust in zero velocity decreases
    level = max(parameters.stationary_level, parameters.stationary_share * peak)
    return parameters.stationary_speed_mps * math.sqrt(1.0 + (statistic / level) ** parameters.stationary_power)


@njit(**INNER_KERNEL)
def move_contact_point(memory: state.FilterState, parameters: KernelParameters, dt: float) -> None:
    """Propagates the displacement of the stationary point along the sole over `dt` (s): docs/foot_ins.md (13).

    It is a first-order Gauss-Markov process of standard deviation `contact_sd_m` and time constant `_CONTACT_S`. So the
    displacement returns to 0 only slowly: a foot rolls over the same ball in every step. The noise is across the lever
    arm only.
    """
    x, P, o = memory.nominal, memory.covariance, memory.row + state.D_CONTACT
    # share of the displacement that is left after dt; it scales the state, and its rows and columns of P
    kept = math.exp(-dt / _CONTACT_S)
    for i in range(3):
        x[state.CONTACT + i] *= kept
        for j in range(P.shape[0]):
            P[o + i, j] *= kept
            P[j, o + i] *= kept
    add_across_sole(memory, (1.0 - kept * kept) * parameters.contact_sd_m**2)


@njit(**INNER_KERNEL)
def vary_height_drift(memory: state.FilterState, parameters: KernelParameters, dt: float) -> None:
    """Lets the height drift per metre of path change over `dt` (s), as the gait does.

    It is a first-order Gauss-Markov process of standard deviation `height_drift_sd` and time constant
    `_HEIGHT_DRIFT_S`: the drift returns to 0, and its uncertainty to that standard deviation.
    """
    x, P, o = memory.nominal, memory.covariance, memory.row + state.D_DRIFT
    # share of the drift that is left after dt; it scales the state, and its row and column of P
    kept = math.exp(-dt / _HEIGHT_DRIFT_S)
    x[state.DRIFT] *= kept
    for j in range(P.shape[0]):
        P[o, j] *= kept
        P[j, o] *= kept
    P[o, o] += (1.0 - kept * kept) * parameters.height_drift_sd**2


@njit(**INNER_KERNEL)
def add_across_sole(memory: state.FilterState, variance: float) -> None:
    """Adds `variance` (m²) to the covariance of the stationary point, in every direction across the lever arm."""
    P, o, lever = memory.covariance, memory.row + state.D_CONTACT, vec3_at(memory.lever, 0)
    down = axpy((0.0, 0.0, 0.0), 1.0 / max(math.sqrt(dot(lever, lever)), 1e-9), lever)  # unit vector along it
    for i in range(3):
        for j in range(3):
            P[o + i, o + j] += variance * (_UNIT[i][j] - down[i] * down[j])


@njit(**INNER_KERNEL)
def zero_velocity_update(
    memory: state.FilterState,
    parameters: KernelParameters,
    t_ns: int,
    rate: Vec3,
    dt: float,
    statistic: float,
    stationary_speed_sd: float,
) -> None:
    """Update with zero velocity of the sole's stationary point (after Foxlin 2005), docs/foot_ins.md (8)-(10).

    v + w × r = 0 for the velocity v of the sensor, the angular rate w = R (ω - b_g) and the lever arm r from the sensor
    to that point, all in the world.

    It is a measurement in sensor axes, invariant to a rotation of the whole world; so the Jacobian on the attitude is
    [v]x.

    The stationary point of the sole moves from heel to ball as the foot rolls. An arm uncertain by σ_r in every
    direction adds σ_r² (|w|² I - w wᵀ) to the noise, so a rotating foot constrains the speed across its axis little.
    Without this, the update would pull the rise of the heel to zero in every step.

    The foot's true speed in stance is not white noise: within `stationary_correlation_s` all updates share one error,
    so each sample counts as dt / stationary_correlation_s of an update, whatever the sample rate.

    A swinging foot may appear stationary for an instant: it glides without rotation while its force passes g. Then the
    normalised innovation is large, and the update's standard deviation grows in proportion to the excess over
    `innovation_gate` (after Chang 2014, J. Geodesy 88:391). Nothing is ever rejected, so a diverged filter recovers
    within some samples of stance.

    Args:
        memory: State of the foot, changed in place.
        parameters: Parameters of the filter.
        t_ns: Time of the sample.
        rate: (3,) rad/s, ω of the sample.
        dt: Length of the sample's interval, s.
        statistic: Motion statistic at the sample (`motion_statistic`).
        stationary_speed_sd: Standard deviation of a stationary foot's speed, m/s.
    """
    x, work = memory.nominal, memory.work
    R = to_matrix(quaternion_at(x, state.ATTITUDE))
    v = vec3_at(x, state.VELOCITY)
    # w and r as above; r is the lever arm with the point's displacement along the sole
    w = matvec(R, axpy(rate, -1.0, vec3_at(x, state.GYRO_BIAS)))
    r = matvec(R, axpy(vec3_at(memory.lever, 0), 1.0, vec3_at(x, state.CONTACT)))
    # factor on the noise, as many updates share one error
    shared = math.sqrt(max(1.0, parameters.stationary_correlation_s / dt))
    whitening = _whitening(w, shared * stationary_speed_sd, shared * parameters.lever_sd_m)
    clear(work, 3)
    axes = transposed(R)  # the sensor's axes in the world
    for i in range(3):
        _put_column(work.jacobian, state.D_VELOCITY + i, matvec(whitening, _UNIT[i]))
        _put_column(work.jacobian, state.D_ATTITUDE + i, matvec(whitening, cross(v, _UNIT[i])))
        _put_column(work.jacobian, state.D_GYRO_BIAS + i, matvec(whitening, cross(r, axes[i])))
        _put_column(work.jacobian, state.D_CONTACT + i, matvec(whitening, cross(w, axes[i])))
    # velocity of the sole's stationary point by the state beyond that of a shoe that creeps, m/s: should be 0
    creep = find_creep(memory, parameters, t_ns, statistic)
    slip = axpy(axpy(v, 1.0, cross(w, r)), -1.0, creep_velocity(parameters, creep))
    store_vec3_at(matvec(whitening, axpy((0.0, 0.0, 0.0), -1.0, slip)), work.innovation, 0)
    shift_by_creep(memory, creep, -1.0)
    apply_gated_update(memory.covariance, memory.error, work, memory.row, 3, parameters.innovation_gate)
    shift_by_creep(memory, creep, 1.0)
    # statistics of consistency: with the noise of a single sample, not that of the correlated updates; 3 axes
    memory.nis[state.BY_VELOCITY, 0] += innovation_norm(work, 3, 1.0 / (shared * shared)) ** 2 / 3.0
    memory.nis[state.BY_VELOCITY, 1] += 1.0
    inject(memory)


@njit(**INNER_KERNEL)
def _put_column(H: Array, column: int, v: Vec3) -> None:
    """Writes a vector into the first three rows of one column of a Jacobian H (6, m)."""
    H[0, column], H[1, column], H[2, column] = v


@njit(**INNER_KERNEL)
def _whitening(w: Vec3, speed_sd: float, lever_sd: float) -> Mat3:
    """Inverse square root of the noise speed_sd² I + lever_sd² (|w|² I - w wᵀ): docs/foot_ins.md (10).

    A velocity multiplied by it has noise of unit covariance. Along w the noise is speed_sd, across w it is larger. So
    the result is `across` I + k w wᵀ, with k such that its factor along w is 1 / speed_sd.

    Args:
        w: (3,) rad/s, angular rate of the foot, world axes.
        speed_sd: Standard deviation of a stationary foot's speed, m/s.
        lever_sd: Standard deviation of the lever arm in every direction, m.
    """
    w2 = dot(w, w)
    across = 1.0 / math.sqrt(speed_sd**2 + lever_sd**2 * w2)  # one over the noise across w
    k = (1.0 / speed_sd - across) / max(w2, 1e-12)
    return (
        (across + k * w[0] * w[0], k * w[0] * w[1], k * w[0] * w[2]),
        (k * w[1] * w[0], across + k * w[1] * w[1], k * w[1] * w[2]),
        (k * w[2] * w[0], k * w[2] * w[1], across + k * w[2] * w[2]),
    )


@njit(**INNER_KERNEL)
def unknown_bias_statistic(memory: state.FilterState) -> float:
    """Motion statistic of a foot at rest whose gyro is biased by two standard deviations.

    mean |ω|² / gyro_scale² for |ω|² = 4 tr P of the gyro bias, a bound for what the bias alone adds.
    """
    P, o = memory.covariance, memory.row + state.D_GYRO_BIAS
    return 4.0 * (P[o, o] + P[o + 1, o + 1] + P[o + 2, o + 2]) / GYRO_SCALE_RADPS**2


@njit(**INNER_KERNEL)
def inject(memory: state.FilterState) -> None:
    """Adds the foot's accumulated error to its nominal state, and sets the error to 0, in place.

    The error of the attitude is a rotation in world axes, which multiplies the attitude from the left. As position and
    velocity have moved, the covariance is transformed by `shift_covariance`.
    """
    x, error, o = memory.nominal, memory.error, memory.row
    for i in range(state.ATTITUDE):  # position and velocity come first in both
        x[i] += error[o + i]
    # the states after the attitude, which has four entries in the nominal state but three in the error
    for i in range(state.D_GYRO_BIAS, state.STATES):
        x[i + state.GYRO_BIAS - state.D_GYRO_BIAS] += error[o + i]
    rotation = exp(vec3_at(error, o + state.D_ATTITUDE), state.SERIES_RAD)
    store_quaternion_at(normalized(multiply(rotation, quaternion_at(x, state.ATTITUDE))), x, state.ATTITUDE)
    shift_covariance(memory.covariance, o, vec3_at(error, o + state.D_POSITION), vec3_at(error, o + state.D_VELOCITY))
    for i in range(state.STATES):
        error[o + i] = 0.0


@njit(**INNER_KERNEL)
def _floor_variance(memory: state.FilterState, parameters: KernelParameters) -> float:
    """Variance of the height differences on one floor, m².

    The weighted mean of the prior `floor_sd_m`², which counts as `_FLOOR_PRIOR` steps, and of the steps so far:
    `memory.floor[1]` is how many of them were on one floor, `memory.floor[2]` the sum of their squared differences, m².
    """
    return (_FLOOR_PRIOR * parameters.floor_sd_m**2 + memory.floor[2]) / (_FLOOR_PRIOR + memory.floor[1])


@njit(**INNER_KERNEL)
def _learn_level_step(memory: state.FilterState, same: float, step: float, variance: float, spread: float) -> None:
    """Learns from a step by how much steps on one floor differ in height.

    The measured difference is partly the floor's unevenness and partly error of the estimated path. The expected square
    of the floor's part alone is added, weighted by the probability that the floor is the same.

    Args:
        memory: State of the foot. Written are `floor` (entry 0: probability `same`; entry 1: sum of the probabilities;
            entry 2: sum of the squared differences in m²) and `nis[BY_FLOOR]`, the statistics of consistency.
        same: Probability that the step stayed on its floor.
        step: Height of the foot above its last floor, m.
        variance: Variance of the height differences on one floor, m².
        spread: Variance of the step by the path's error, m².
    """
    share = variance / (variance + spread)  # of the step that is expected to be the floor's
    memory.floor[0] = same
    memory.floor[1] += same
    memory.nis[state.BY_FLOOR, 0] += same * step * step / (variance + spread)
    memory.nis[state.BY_FLOOR, 1] += same
    # expected square of the floor's part of the step: square of its mean, and its variance
    memory.floor[2] += same * (share * share * step * step + share * spread)


@njit(**INNER_KERNEL)
def _normal_density(x: float, variance: float) -> float:
    """Density at `x` of the normal distribution of mean 0 with this variance."""
    return math.exp(-0.5 * x * x / variance) / math.sqrt(2.0 * math.pi * variance)


@njit(**INNER_KERNEL)
def level_floor_update(
    memory: state.FilterState, parameters: KernelParameters, t_ns: int, stationary_speed_sd: float
) -> None:
    """Compares the height of a foot that has just become stationary with that of its last floor.

    If it is probably the same floor, the foot's height is corrected, docs/foot_ins.md (14).

    Zero-velocity updates do not observe height, so its error grows with every stride, mostly with one sign. Built
    ground is often level (Abdulrahim, Hide, Moore, Hill 2012). Whether it is here is a hypothesis: the same floor, up
    to its unevenness and the arm of a tilted sole, or another one anywhere within `_NEW_FLOOR_RANGE_M`. The height is
    corrected by the probability of the first (`kalman.correct_probably`). If that is not above a half, as on a stair or
    ramp, the foot stands on a new floor: its height becomes that of the foot, and it is as uncertain as the foot.

    The comparison happens once per stance, after the foot has been surely stationary for `_STAND_S`. In other samples
    the function only follows the contact phase of the foot (swinging or standing).

    Args:
        memory: State of the foot, changed in place.
        parameters: Parameters of the filter.
        t_ns: Time of the sample.
        stationary_speed_sd: Standard deviation of a stationary foot's speed, m/s; inf for a moving foot.
    """
    clock = memory.clock
    if stationary_speed_sd > _STAND_SPEED_MPS:  # not surely stationary
        clock[state.T_LAST_MOTION] = t_ns
        if stationary_speed_sd == math.inf and clock[state.CONTACT_PHASE] == state.STANDING:
            clock[state.CONTACT_PHASE] = state.SWINGING
        return
    # compared in this stance already, or not stationary for long enough
    if clock[state.CONTACT_PHASE] == state.STANDING or (t_ns - clock[state.T_LAST_MOTION]) * 1e-9 < _STAND_S:
        return
    x, P, o, work = memory.nominal, memory.covariance, memory.row, memory.work
    # the lever arm from the sensor to the sole, in the world
    r = matvec(to_matrix(quaternion_at(x, state.ATTITUDE)), vec3_at(memory.lever, 0))
    clear(work, 1)
    h = work.jacobian[0]  # of the sole's height above the floor, by the error states
    # r_z grows by r_y δθ_x - r_x δθ_y with an error δθ of the attitude
    h[state.D_POSITION + 2], h[state.D_ATTITUDE], h[state.D_ATTITUDE + 1], h[state.D_FLOOR] = 1.0, r[1], -r[0], -1.0
    height = x[state.POSITION + 2] + r[2]  # of the sole in the world, m
    has_floor = clock[state.CONTACT_PHASE] != state.NEVER_LANDED  # not at the first landing
    begin_stance(memory, parameters, t_ns)
    clock[state.CONTACT_PHASE] = state.STANDING
    step = height - x[state.FLOOR]  # of the sole above the last floor, m
    lift = _SOLE_M * math.hypot(r[0], r[1]) / max(parameters.lever_arm_m, 1e-9)  # by the tilt of the sole, m
    variance = _floor_variance(memory, parameters) + lift**2
    spread_measurements(P, work, o, 1)
    # ratio of the densities of the step on the same floor and on a new one, which is 1 / `_NEW_FLOOR_RANGE_M`
    likelihood_ratio = _normal_density(step, work.spread[0, 0] + variance) * _NEW_FLOOR_RANGE_M
    same, last_same = 0.0, memory.floor[0]  # probability that this step, and the last one, stayed on its floor
    # that probability of this step before its height counts
    prior = last_same * parameters.same_floor + (1.0 - last_same) * _SAME_AFTER_NEW
    # a jump after filled samples is likelier their error than a new floor
    bad = memory.filled[filled.SINCE_STANCE] > 0.0
    memory.filled[filled.SINCE_STANCE] = 0.0
    most = _LEVEL_STEP_M + (3.0 * math.sqrt(work.spread[0, 0]) if bad else 0.0)
    if has_floor and prior > 0.0 and abs(step) < most:
        same = likelihood_ratio / (likelihood_ratio + 1.0 / prior - 1.0)  # Bayes' rule
        _learn_level_step(memory, same, step, variance, work.spread[0, 0])
        before = x[state.POSITION + 2]
        correct_probably(P, memory.error, work.gain, o, h, -step, variance, same)
        inject(memory)
        note_levelled(memory, before - x[state.POSITION + 2])
    finish_levelled_step(memory, not has_floor)
    if same > 0.5:
        return
    height = x[state.POSITION + 2] + r[2]  # again, as a correction may have moved the foot
    x[state.FLOOR] = height
    h[state.D_FLOOR] = 0.0  # the new floor does not depend on the old one
    spread_measurements(P, work, o, 1)  # of the foot's height: `gain` is P hᵀ, `spread` its variance
    for j in range(P.shape[0]):
        P[o + state.D_FLOOR, j] = P[j, o + state.D_FLOOR] = work.gain[j]
    P[o + state.D_FLOOR, o + state.D_FLOOR] = work.spread[0, 0] + variance
