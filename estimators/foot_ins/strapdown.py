"""Strapdown navigation over one sample, and its error-state covariance, a block inside a matrix of any size."""

from __future__ import annotations

import math

from numba import njit

from stridetwin.estimators.foot_ins import state
from stridetwin.estimators.foot_ins.considered import propagate_considered
from stridetwin.estimators.foot_ins.filled import find_filled_variances
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.slope import note_levelled
from stridetwin.streams.algebra.tuples import (
    Mat3,
    Vec3,
    axpy,
    dot,
    exp,
    matvec,
    multiply,
    normalized,
    quaternion_at,
    store_quaternion_at,
    to_matrix,
    transposed,
    vec3_at,
)
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

_MAX_STEP_S = 0.03  # a longer step is a gap
# No foot moves for longer without a stance, so the filter has missed one, and its attitude and velocity are worse than
# their noise tells: added then. [a crawling foot moves for 2.2 s]
MOST_SWING_S = 2.5
_MISSED_GYRO_NOISE_RADPS_RTHZ, _MISSED_ACCEL_NOISE_MPS2_RTHZ = 0.03, 1.0
_GAP_GYRO_NOISE_RADPS_RTHZ, _GAP_ACCEL_NOISE_MPS2_RTHZ = 0.3, 3.0  # added in a gap, whose motion is not measured
_MIN_GYRO_RANGE_RADPS, _MIN_ACCEL_RANGE_MPS2 = 7.0, 45.0  # least limits of a sensor of unknown range


@njit(**INNER_KERNEL)
def propagate_covariance(P: Array, o: int, R: Mat3, f_world: Vec3, dt: float, path: float, turn: Vec3) -> None:
    """P <- F P Fᵀ in place, for the foot whose 21 error states begin at row `o`.

    F propagates the error over one interval, docs/foot_ins.md (4). It is the strapdown error model of Titterton &
    Weston 2004, ch. 12, without Earth rotation. P is symmetric: so F P Fᵀ is computed as F (F P)ᵀ.

    Args:
        P: (n, n) covariance of the error states.
        o: First row of the foot's error states.
        R: (3, 3) rotation, sensor to world, in the middle of the interval.
        f_world: (3,) m/s², specific force, world axes.
        dt: Length of the interval, s.
        path: Length of the path over the interval, m.
        turn: (3,) rad, rotation across the sole's normal, world axes, by which an error of the gyro's scale acts.
    """
    _apply_transition(P, o, R, f_world, dt, path, turn)
    transpose_rows(P, o + state.D_POSITION, 9)
    _apply_transition(P, o, R, f_world, dt, path, turn)
    mirror(P, o + state.D_POSITION, 9)


@njit(**INNER_KERNEL)
def transpose_rows(M: Array, first: int, count: int) -> None:
    """Transposes a matrix (n, n) in place that is symmetric except in `count` rows and the same columns.

    Args:
        M: (n, n) the matrix; only elements in these rows and columns are exchanged.
        first: First of the rows and columns.
        count: Number of them.
    """
    for i in range(first, first + count):
        for j in range(M.shape[1]):
            if j < first or j > i:  # each pair once
                M[i, j], M[j, i] = M[j, i], M[i, j]


@njit(**INNER_KERNEL)
def mirror(M: Array, first: int, count: int) -> None:
    """Makes the diagonal block of `count` rows from `first` on exactly symmetric: its upper triangle is copied."""
    for i in range(first, first + count):
        for j in range(first, i):
            M[i, j] = M[j, i]


@njit(**INNER_KERNEL)
def _apply_transition(M: Array, o: int, R: Mat3, f_world: Vec3, dt: float, path: float, turn: Vec3) -> None:
    """M <- F M in place; only the foot's own rows of position, velocity and attitude change.

    Half of the change of the position comes from the velocity before the step, half from that after it.

    Args:
        M: (n, m) matrix with a row per error state.
        o: First row of the foot's error states.
        R: (3, 3) rotation, sensor to world, in the middle of the interval.
        f_world: (3,) m/s², specific force, world axes.
        dt: Length of the interval, s.
        path: Length of the path over the interval, m: times the drift it is an error of the height.
        turn: (3,) rad, rotation across the sole's normal, world axes: times the scale it is an error of the attitude.
    """
    # first rows of the errors of position, velocity, attitude, gyro bias and accelerometer bias
    p, v, a = o + state.D_POSITION, o + state.D_VELOCITY, o + state.D_ATTITUDE
    g, b = o + state.D_GYRO_BIAS, o + state.D_ACCEL_BIAS
    # change of the velocity by the specific force, m/s; an error of the attitude turns it
    dvx, dvy, dvz = f_world[0] * dt, f_world[1] * dt, f_world[2] * dt
    for j in range(M.shape[1]):
        a0, a1, a2 = M[a, j], M[a + 1, j], M[a + 2, j]  # attitude before the step
        # changes of attitude and velocity by the biases
        gyro = matvec(R, (dt * M[g, j], dt * M[g + 1, j], dt * M[g + 2, j]))
        accel = matvec(R, (dt * M[b, j], dt * M[b + 1, j], dt * M[b + 2, j]))
        for i in range(3):
            M[p + i, j] += 0.5 * dt * M[v + i, j]
        M[p + 2, j] -= path * M[o + state.D_DRIFT, j]
        scale = M[o + state.D_SCALE, j]
        M[a, j] -= gyro[0] + scale * turn[0]
        M[a + 1, j] -= gyro[1] + scale * turn[1]
        M[a + 2, j] -= gyro[2] + scale * turn[2]
        M[v, j] += dvz * a1 - dvy * a2 - accel[0]
        M[v + 1, j] += dvx * a2 - dvz * a0 - accel[1]
        M[v + 2, j] += dvy * a0 - dvx * a1 - accel[2]
        for i in range(3):
            M[p + i, j] += 0.5 * dt * M[v + i, j]


@njit(**INNER_KERNEL)
def shift_covariance(P: Array, o: int, dp: Vec3, dv: Vec3) -> None:
    """Transforms the covariance P (n, n) in place after position and velocity were corrected: docs/foot_ins.md (12).

    The foot's rows begin at `o`; the corrections were `dp` (m) and `dv` (m/s), world axes.

    P <- T P Tᵀ, where T adds δθ × dp to the error of the position and δθ × dv to that of the velocity, for an error δθ
    of the attitude. As P is symmetric, it is computed as T (T P)ᵀ.

    A rotation of the whole world about the vertical z is unobservable; in the error it is (z × p, z × v, z) at
    position, velocity and attitude. Where a correction moves p and v, this direction must move along; otherwise the
    filter takes the difference for a heading measurement, which adds up to false certainty. This is the invariant
    filter of Barrau & Bonnabel 2017 (IEEE TAC 62:1797) in the coordinates of the plain one.
    """
    shift_rows(P, o, dp, dv)
    transpose_rows(P, o + state.D_POSITION, 6)
    shift_rows(P, o, dp, dv)
    mirror(P, o + state.D_POSITION, 6)


@njit(**INNER_KERNEL)
def shift_rows(M: Array, o: int, dp: Vec3, dv: Vec3) -> None:
    """M <- T M in place: adds δθ × dp to the rows of the position δp, and δθ × dv to those of the velocity δv.

    δθ are the rows of the attitude. The filter is the invariant one of Barrau & Bonnabel: the errors of position and
    velocity are those after a turn by the attitude error about the origin. So a correction of position and velocity
    changes them by δθ times the correction.

    Args:
        M: (n, m) matrix with a row per error state.
        o: First row of the foot's error states.
        dp: (3,) correction of the position, world axes, m.
        dv: (3,) correction of the velocity, world axes, m/s.
    """
    # first rows of the errors of position, velocity and attitude
    p, v, a = o + state.D_POSITION, o + state.D_VELOCITY, o + state.D_ATTITUDE
    for j in range(M.shape[1]):
        x, y, z = M[a, j], M[a + 1, j], M[a + 2, j]  # δθ
        M[p, j] += y * dp[2] - z * dp[1]
        M[p + 1, j] += z * dp[0] - x * dp[2]
        M[p + 2, j] += x * dp[1] - y * dp[0]
        M[v, j] += y * dv[2] - z * dv[1]
        M[v + 1, j] += z * dv[0] - x * dv[2]
        M[v + 2, j] += x * dv[1] - y * dv[0]


@njit(**INNER_KERNEL)
def force_at_middle(f: Vec3, x: float, y: float, z: float) -> Vec3:
    """Force at the middle of a rotation that changes the velocity as the constant force `f` does over the rotation.

    The rotation is by (x, y, z) rad; `f` (m/s²) and the result are in sensor axes, the result in those at the middle.

    The velocity changes by Γ₁(φ) f dt, Γ₁ the left Jacobian of SO(3), which is Exp(φ/2) (1 + [φ]x²/24) to the second
    order (Barfoot 2017, ch. 7).
    """
    # f + [φ]x² f / 24 = (1 - |φ|²/24) f + (φ · f)/24 φ
    along = (x * f[0] + y * f[1] + z * f[2]) / 24.0
    less = 1.0 - (x * x + y * y + z * z) / 24.0
    return less * f[0] + along * x, less * f[1] + along * y, less * f[2] + along * z


@njit(**INNER_KERNEL)
def propagate_state(
    x: Array, rate: Vec3, force: Vec3, dt: float, gravity: float, down: Vec3
) -> tuple[Mat3, Vec3, float, Vec3]:
    """Propagates a nominal state over one interval, in place: docs/foot_ins.md (2), (3).

    Args:
        x: (22,) nominal state.
        rate: (3,) rad/s, mean over the interval.
        force: (3,) m/s², mean specific force over the interval.
        dt: Length of the interval, s; a negative one exactly reverses the propagation.
        gravity: m/s².
        down: (3,) any length, the sole's normal in the sensor.

    Returns:
        Attitude at the interval's middle, world <- sensor; specific force in the world, m/s²; path length, m; rotation
        across `down` in the world, rad.
    """
    w = axpy(rate, -1.0, vec3_at(x, state.GYRO_BIAS))  # the rate without the gyro's bias
    # part of the rate perpendicular to the sole's normal: the scale error acts on it
    across = axpy(w, -dot(w, down) / max(dot(down, down), 1e-9), down)
    wx, wy, wz = axpy(w, -x[state.SCALE], across)
    # half of the rotation over the interval, applied twice: to the middle and to the end
    half = exp((0.5 * dt * wx, 0.5 * dt * wy, 0.5 * dt * wz), state.SERIES_RAD)
    q_middle = normalized(multiply(quaternion_at(x, state.ATTITUDE), half))
    R = to_matrix(q_middle)
    f_sensor = force_at_middle(axpy(force, -1.0, vec3_at(x, state.ACCEL_BIAS)), dt * wx, dt * wy, dt * wz)
    f_world = matvec(R, f_sensor)
    acceleration = f_world[0], f_world[1], f_world[2] - gravity
    moved = axpy((0.0, 0.0, 0.0), dt, axpy(vec3_at(x, state.VELOCITY), 0.5 * dt, acceleration))
    path = math.copysign(math.sqrt(dot(moved, moved)), dt)  # negative where the propagation is reversed
    for i in range(3):
        x[state.POSITION + i] += moved[i]
        x[state.VELOCITY + i] += dt * acceleration[i]
    x[state.POSITION + 2] -= path * x[state.DRIFT]
    store_quaternion_at(normalized(multiply(q_middle, half)), x, state.ATTITUDE)
    turn = matvec(R, across)
    return R, f_world, path, (dt * turn[0], dt * turn[1], dt * turn[2])


@njit(**INNER_KERNEL)
def predict(memory: state.FilterState, parameters: KernelParameters, rate: Vec3, force: Vec3, dt: float) -> None:
    """Propagates state and covariance over one interval: docs/foot_ins.md (2)-(5).

    The force acts at the attitude of the interval's middle (Titterton & Weston 2004, ch. 11). Scale, alignment and
    sampling errors are white noise that grows with the motion; an axis at its limit has an unknown excess. In an
    interval longer than `_MAX_STEP_S` samples are missing.

    Args:
        memory: State of the foot, changed in place.
        parameters: Parameters of the filter.
        rate: (3,) rad/s, mean over the interval.
        force: (3,) m/s², mean specific force over the interval.
        dt: Length of the interval, s.
    """
    P, o = memory.covariance, memory.row  # o: first row of this foot's error states
    down = vec3_at(memory.lever, 0)  # along the sole's normal
    # attitude and specific force in the middle of the interval; length of the path, m; rotation across the sole, rad
    R, f_world, path, turn = propagate_state(memory.nominal, rate, force, dt, parameters.gravity_mps2, down)
    acceleration = f_world[0], f_world[1], f_world[2] - parameters.gravity_mps2
    propagate_covariance(P, o, R, f_world, dt, path, turn)
    propagate_considered(memory, R, rate, dt, turn)
    note_levelled(memory, path * memory.nominal[state.DRIFT])
    # variances per second of attitude and velocity
    attitude_noise = parameters.gyro_noise_radps_rthz**2
    velocity_noise = parameters.accel_noise_mps2_rthz**2
    velocity_noise += parameters.accel_motion_noise_per_rthz**2 * dot(acceleration, acceleration)
    if memory.clock[state.FILL] > 1:  # the ring has a sample before this one
        change = axpy(force, -1.0, state.force_of(memory, state.ring_row(memory, 1)))
        jerk2 = dot(change, change) / (dt * dt)
        velocity_noise += parameters.accel_jerk_noise_s_rthz**2 * jerk2
    if dt > _MAX_STEP_S:
        attitude_noise += _GAP_GYRO_NOISE_RADPS_RTHZ**2
        velocity_noise += _GAP_ACCEL_NOISE_MPS2_RTHZ**2
    newest = memory.ring_t_ns[state.ring_row(memory, 0)]
    if (newest - memory.clock[state.T_STANCE]) * 1e-9 > MOST_SWING_S:
        attitude_noise += _MISSED_GYRO_NOISE_RADPS_RTHZ**2
        velocity_noise += _MISSED_ACCEL_NOISE_MPS2_RTHZ**2
    # of samples that a driver filled in
    turned, pushed = find_filled_variances(
        memory, dt, math.sqrt(dot(rate, rate)), math.sqrt(dot(acceleration, acceleration))
    )
    axes = transposed(R)  # the sensor's axes in the world
    for i in range(3):
        P[o + state.D_ATTITUDE + i, o + state.D_ATTITUDE + i] += attitude_noise * dt + turned
        P[o + state.D_VELOCITY + i, o + state.D_VELOCITY + i] += velocity_noise * dt + pushed
        P[o + state.D_GYRO_BIAS + i, o + state.D_GYRO_BIAS + i] += parameters.gyro_bias_walk_radps2_rthz**2 * dt
        P[o + state.D_ACCEL_BIAS + i, o + state.D_ACCEL_BIAS + i] += parameters.accel_bias_walk_mps3_rthz**2 * dt
        gyro_range = parameters.gyro_range_radps
        if _may_be_limited(memory.extreme, i, abs(rate[i]), gyro_range, _MIN_GYRO_RANGE_RADPS, parameters.limit_share):
            _add_along(P, o + state.D_ATTITUDE, axes[i], parameters.gyro_limit_noise_radps_rthz**2 * dt)
        accel_range = parameters.accel_range_mps2
        if _may_be_limited(
            memory.extreme, 3 + i, abs(force[i]), accel_range, _MIN_ACCEL_RANGE_MPS2, parameters.limit_share
        ):
            _add_along(P, o + state.D_VELOCITY, axes[i], parameters.accel_limit_noise_mps2_rthz**2 * dt)


@njit(**INNER_KERNEL)
def _may_be_limited(extreme: Array, channel: int, size: float, known: float, least: float, limit_share: float) -> bool:
    """Whether a channel may be limited: near its range or, where unknown, near the largest value so far.

    A limited channel returns to the same extreme in every stride. An unlimited one rarely reaches its largest value, so
    little is lost by down-weighting it there.

    Args:
        extreme: (6,) largest magnitude of each channel so far, at least `least`; updated where the range is unknown.
        channel: Index of the channel: 0-2 angular rate, 3-5 specific force.
        size: Magnitude of the sample, rad/s or m/s².
        known: Range of the channel; 0 if unknown.
        least: Least range of any sensor.
        limit_share: Share of the range from which on a channel may be limited.
    """
    if known > 0.0:
        return size >= limit_share * known
    extreme[channel] = max(extreme[channel], least, size)
    return size >= limit_share * extreme[channel]


@njit(**INNER_KERNEL)
def _add_along(P: Array, row: int, axis: Vec3, variance: float) -> None:
    """Adds variance along a unit axis to the 3×3 block of `P` that begins at row and column `row`, in place."""
    for i in range(3):
        for j in range(3):
            P[row + i, row + j] += variance * (axis[i] * axis[j])
