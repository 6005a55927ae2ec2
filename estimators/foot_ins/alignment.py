"""Initial alignment: the vertical from the first stationary window or, without one, from the mean force."""

from __future__ import annotations

import math

from numba import njit

from stridetwin.estimators.foot_ins import state
from stridetwin.estimators.foot_ins.considered import settle_considered
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.stance import add_across_sole, unknown_bias_statistic
from stridetwin.streams.algebra.matrices import clear
from stridetwin.streams.algebra.tuples import (
    Quaternion,
    Vec3,
    axpy,
    dot,
    exp,
    matvec,
    multiply,
    normalized,
    quaternion_at,
    store_quaternion_at,
    store_vec3_at,
    to_matrix,
    vec3_at,
)
from stridetwin.streams.compiled import INNER_KERNEL

_ALIGN_S = 0.1  # stationary time of an alignment
_ALIGN_TIMEOUT_S = 2.0  # after this time the filter starts without a stationary window
# Errors of an alignment at rest and of one in motion: the tilt, and the speed of the foot.
_TILT_SD_RAD, _SPEED_SD_MPS = 0.0175, 0.01
_MOVING_TILT_SD_RAD, _MOVING_SPEED_SD_MPS = 0.2, 1.0
GAP_SPEED_MPS, GAP_TURN_RATE_RADPS = 1.5, 0.5  # motion of the wearer while the filter is lost


@njit(**INNER_KERNEL)
def begin(memory: state.FilterState, t_ns: int) -> None:
    """Starts an alignment: the search for a stationary window, from the sample of time `t_ns` on.

    It empties the ring of samples and the force sums, forgets the contact with the floor, and sets the velocity to 0.
    Position, heading and biases are kept. The attitude so far is stored in `memory.tilted`, which `level_attitude`
    starts from.
    """
    memory.clock[state.PHASE] = state.ALIGNING
    memory.norm[0] = 0.0  # size of the force at rest: unknown
    memory.clock[state.T_ALIGN] = t_ns
    memory.clock[state.T_STATIONARY] = t_ns
    memory.clock[state.FILL] = 0
    memory.clock[state.CONTACT_PHASE] = state.NEVER_LANDED
    memory.clock[state.T_LAST_MOTION] = t_ns
    memory.clock[state.T_STANCE] = t_ns
    clear(memory.force_sum[0])
    clear(memory.force_sum[1])
    settle_considered(memory)
    store_quaternion_at(quaternion_at(memory.nominal, state.ATTITUDE), memory.tilted, 0)
    store_vec3_at((0.0, 0.0, 0.0), memory.nominal, state.VELOCITY)


@njit(**INNER_KERNEL)
def align(memory: state.FilterState, parameters: KernelParameters, t_ns: int, force: Vec3, statistic: float) -> None:
    """Takes one sample into the alignment, which levels the attitude by the mean force.

    The alignment ends once the foot was stationary for `_ALIGN_S`. After a swing a stance counts that is less quiet, as
    in the updates of zero velocity, with larger standard deviations. It also ends, with the largest ones, after
    `_ALIGN_TIMEOUT_S` in motion. At its end the phase becomes NAVIGATING. At the end of the first alignment the lever
    arm is also set: from the sensor straight down to the sole, by `lever_arm_m`.

    Args:
        memory: State of the foot, changed in place. Its `force_sum` has a row for the stationary period and a row for
            the whole alignment: sum of the force (entries 0-2, m/s²) and number of samples (entry 3).
        parameters: Parameters of the filter.
        t_ns: Time of the sample.
        force: (3,) m/s², specific force.
        statistic: Motion statistic at the sample.
    """
    clock, force_sum = memory.clock, memory.force_sum
    # how much less quiet a stance after a swing may be than one of a person who stands
    unrest = max(1.0, parameters.stationary_share * memory.peak[0] / parameters.stationary_level)
    if statistic > unrest * parameters.stationary_level + unknown_bias_statistic(memory):  # the foot moves: start again
        clock[state.T_STATIONARY] = t_ns
        clear(force_sum[0])
    for k in range(2):
        for i in range(3):
            force_sum[k, i] += force[i]
        force_sum[k, 3] += 1.0
    stationary = (t_ns - clock[state.T_STATIONARY]) * 1e-9 >= _ALIGN_S
    late = (t_ns - clock[state.T_ALIGN]) * 1e-9 >= _ALIGN_TIMEOUT_S
    period = 0 if stationary or not late else 1  # row of `force_sum`: stationary period, or the whole alignment
    level_attitude(memory, vec3_at(force_sum[period], 0))
    tilt_sd = min(_TILT_SD_RAD * math.sqrt(unrest), _MOVING_TILT_SD_RAD) if stationary else _MOVING_TILT_SD_RAD
    speed_sd = min(_SPEED_SD_MPS * math.sqrt(unrest), _MOVING_SPEED_SD_MPS) if stationary else _MOVING_SPEED_SD_MPS
    _set_covariance(memory, parameters, t_ns, tilt_sd, speed_sd)
    if stationary or late:  # the alignment ends
        size = math.sqrt(dot(vec3_at(force_sum[0], 0), vec3_at(force_sum[0], 0))) / max(force_sum[0, 3], 1.0)
        memory.norm[0] = size if stationary else parameters.gravity_mps2
        _widen_accel_bias(memory, memory.norm[0] - parameters.gravity_mps2)
        clock[state.PHASE] = state.NAVIGATING
        clock[state.HEADING_KNOWN] = 1
        if clock[state.LEVER_KNOWN] == 0:  # the first alignment
            clock[state.LEVER_KNOWN] = 1
            up = to_matrix(quaternion_at(memory.nominal, state.ATTITUDE))[2]  # in the sensor
            store_vec3_at(axpy((0.0, 0.0, 0.0), -parameters.lever_arm_m, up), memory.lever, 0)
            P, o = memory.covariance, memory.row + state.D_CONTACT
            for i in range(3):  # the stationary point is uncertain only across the sole
                for j in range(3):
                    P[o + i, o + j] = 0.0
            add_across_sole(memory, parameters.contact_sd_m**2)


@njit(**INNER_KERNEL)
def _widen_accel_bias(memory: state.FilterState, excess: float) -> None:
    """Makes the accelerometer's bias at least as uncertain as the excess (m/s²) of the force at rest over gravity."""
    P, o = memory.covariance, memory.row + state.D_ACCEL_BIAS
    for i in range(o, o + 3):
        P[i, i] = max(P[i, i], excess * excess)


@njit(**INNER_KERNEL)
def level_attitude(memory: state.FilterState, force: Vec3) -> None:
    """Rotates the initial attitude the shortest way until the mean force points up; an unknown heading becomes 0.

    The rotation starts from `memory.tilted` each time. If each call continued from the last result, the small
    rotations would add up to a false change of heading while the mean settles. The heading is that of the sensor's x
    axis or, if x is within 26° of the vertical (its cosine is at least 0.9), that of the z axis.

    Args:
        memory: State of the foot, whose attitude is written. `memory.tilted` is the quaternion, sensor to world, from
            the beginning of the alignment.
        force: (3,) sum of the specific force, sensor axes.
    """
    q = quaternion_at(memory.tilted, 0)
    x, y, z = matvec(to_matrix(q), force)  # the force in the world of that attitude
    size = math.sqrt(x * x + y * y + z * z)
    if size > 0.0:
        q = normalized(multiply(_rotation_to_vertical(x / size, y / size, z / size), q))
    if memory.clock[state.HEADING_KNOWN] == 0:
        R = to_matrix(q)
        # of the sensor's x axis, the first column of R, or of its z axis where x is nearly vertical
        heading = math.atan2(R[1][0], R[0][0]) if abs(R[2][0]) < 0.9 else math.atan2(R[1][2], R[0][2])
        q = normalized(multiply(exp((0.0, 0.0, -heading), state.SERIES_RAD), q))
    store_quaternion_at(q, memory.nominal, state.ATTITUDE)


@njit(**INNER_KERNEL)
def _rotation_to_vertical(x: float, y: float, z: float) -> Quaternion:
    """The shortest rotation of a unit vector (x, y, z) onto the vertical: a quaternion (w, x, y, z), not normalised.

    A vector that points straight down is rotated by half a turn about x: there the shortest rotation is not unique.
    """
    return (1.0 + z, y, -x, 0.0) if z > -0.999999 else (0.0, 1.0, 0.0, 0.0)


@njit(**INNER_KERNEL)
def _set_covariance(
    memory: state.FilterState, parameters: KernelParameters, t_ns: int, tilt_sd: float, speed_sd: float
) -> None:
    """Sets the covariance of an alignment.

    All correlations become 0. Velocity, roll and pitch get the variances of the alignment. The variances of position
    and heading are kept and grow by what the wearer may have moved since the foot was last tracked; those of the biases
    are kept. At the first alignment, when the lever arm is not known yet, all of these get their initial values, and so
    do the variances of contact, floor, height drift and gyro scale, which are otherwise kept.

    Args:
        memory: State of the foot, changed in place.
        parameters: Parameters of the filter.
        t_ns: Time of the sample; position and heading lose certainty since the last tracked one.
        tilt_sd: Standard deviation of roll and pitch, rad.
        speed_sd: Standard deviation of each axis of the velocity, m/s.
    """
    P, clock, o = memory.covariance, memory.clock, memory.row  # o: first of this foot's rows in P
    for i in range(o, o + state.STATES):
        for j in range(P.shape[0]):
            if j != i:
                P[i, j] = P[j, i] = 0.0
    # time without tracking, s, now and at the last call; `growth` in s² is added to the variances, at each call anew
    lost, lost_before = (t_ns - clock[state.T_KNOWN]) * 1e-9, (clock[state.T_LAST] - clock[state.T_KNOWN]) * 1e-9
    growth = lost**2 - lost_before**2
    # levered: not the first alignment; memory.start_sd: standard deviations of position and heading of the start
    levered = clock[state.LEVER_KNOWN] != 0
    for i in range(3):
        p, g, b = o + state.D_POSITION + i, o + state.D_GYRO_BIAS + i, o + state.D_ACCEL_BIAS + i
        P[p, p] = P[p, p] + GAP_SPEED_MPS**2 * growth if levered else memory.start_sd[0] ** 2
        P[o + state.D_VELOCITY + i, o + state.D_VELOCITY + i] = speed_sd**2
        if not levered:
            P[g, g], P[b, b] = parameters.gyro_bias_sd_radps**2, parameters.accel_bias_sd_mps2**2
    tilt, heading = o + state.D_ATTITUDE, o + state.D_ATTITUDE + 2
    P[tilt, tilt] = P[tilt + 1, tilt + 1] = tilt_sd**2
    heading_growth = GAP_TURN_RATE_RADPS**2 * growth
    P[heading, heading] = P[heading, heading] + heading_growth if levered else memory.start_sd[1] ** 2
    if not levered:
        for i in range(state.D_CONTACT, state.STATES):
            P[o + i, o + i] = 0.0
        P[o + state.D_DRIFT, o + state.D_DRIFT] = parameters.height_drift_sd**2
        P[o + state.D_SCALE, o + state.D_SCALE] = parameters.gyro_scale_sd**2
        _use_prior(memory)


@njit(**INNER_KERNEL)
def _use_prior(memory: state.FilterState) -> None:
    """Replaces the variances of biases and scale by those from an earlier recording, as far as it knew them."""
    P, prior, o = memory.covariance, memory.prior, memory.row
    if prior[0, 0] == 0.0:
        return
    for i in range(3):
        for j in range(3):
            P[o + state.D_GYRO_BIAS + i, o + state.D_GYRO_BIAS + j] = prior[i, j]
            P[o + state.D_ACCEL_BIAS + i, o + state.D_ACCEL_BIAS + j] = prior[3 + i, 3 + j]
    if prior[6, 6] > 0.0:
        P[o + state.D_SCALE, o + state.D_SCALE] = prior[6, 6]
