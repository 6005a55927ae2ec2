"""The compiled filter of two feet, sample by sample, of either foot and either aid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators import foot_ins
from stridetwin.estimators.foot_ins.alignment import GAP_SPEED_MPS, GAP_TURN_RATE_RADPS
from stridetwin.estimators.foot_ins.clipping import is_clipped
from stridetwin.estimators.foot_ins.kernel import MAX_GAP_S, is_possible, step, write_estimate
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.state import (
    ATTITUDE,
    D_ATTITUDE,
    D_POSITION,
    IGNORED,
    LEVER_KNOWN,
    NAVIGATING,
    PHASE,
    T_ALIGN,
    T_LAST,
    T_STATIONARY,
    VELOCITY,
)
from stridetwin.estimators.foot_ins.strapdown import mirror, transpose_rows
from stridetwin.estimators.foot_to_foot.parameters import PairParameters
from stridetwin.estimators.foot_to_foot.published import relative_position_update, step_published
from stridetwin.estimators.foot_to_foot.relative_updates import (
    UNUSED,
    board_in_camera,
    board_update,
    sonar_update,
    write_pose_covariance,
)
from stridetwin.estimators.foot_to_foot.rewind import rewind
from stridetwin.estimators.foot_to_foot.state import IMU, OBSERVATION, RELATIVE, SCALES, Events, Pair, inject_all
from stridetwin.streams.algebra.matrices import copy_matrix
from stridetwin.streams.algebra.tuples import (
    Mat3,
    Vec3,
    axpy,
    cross,
    matvec,
    quaternion_at,
    store_mat3_at,
    to_matrix,
    transposed,
    vec3_at,
)
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Array

_entry_kernel = entry_kernel(Path(__file__).parent, Path(foot_ins.__file__).parent, llvm_level=1)


@njit(**INNER_KERNEL)
def to_inertial_world(nominal: Array, earth: Vec3, rate: Vec3, force: Vec3) -> tuple[Vec3, Vec3]:
    """The sample in a world without rotation: minus the Earth's rate and the Coriolis force.

    ω - Rᵀ ω_E and f - 2 Rᵀ (ω_E × v) (Titterton & Weston 2004, ch. 3); the centrifugal force is part of gravity.

    Args:
        nominal: (22,) nominal state.
        earth: (3,) ω_E, rotation rate of the Earth in world axes, rad/s.
        rate: (3,) ω, angular rate, rad/s.
        force: (3,) f, specific force, m/s².

    Returns:
        Angular rate, rad/s; specific force, m/s².
    """
    coriolis = cross(earth, vec3_at(nominal, VELOCITY))
    to_sensor = transposed(to_matrix(quaternion_at(nominal, ATTITUDE)))
    return axpy(rate, -1.0, matvec(to_sensor, earth)), axpy(force, -2.0, matvec(to_sensor, coriolis))


@njit(**INNER_KERNEL)
def apply_gyro_scale(pair: Pair, foot: int, rate: Vec3, t_ns: int) -> None:
    """Propagates a foot's scale error into its attitude error up to `t_ns`: δθ -= R diag(ω) δs dt.

    This is docs/foot_to_foot.md (8). One foot alone does not observe the scale, because it rotates back in every step;
    two feet that observe each other do. Unmodelled, it appears as a longer or shorter step (Titterton & Weston 2004,
    12.3).

    Nothing is done before the foot's alignment has ended, after a gap longer than `MAX_GAP_S`, for a sample that is out
    of order, and if the scale is no unknown (variance 0).

    Args:
        pair: State of both feet, whose covariance is changed in place.
        foot: Index of the foot in `FEET`.
        rate: (3,) rad/s, angular rate ω of the sample, sensor axes.
        t_ns: Time of the sample.
    """
    memory = pair.feet[foot]
    dt = (t_ns - memory.clock[T_LAST]) * 1e-9
    s, a = SCALES + 3 * foot, memory.row + D_ATTITUDE  # first rows of the foot's scale and attitude errors
    if memory.clock[PHASE] != NAVIGATING or not 0.0 < dt <= MAX_GAP_S or pair.covariance[s, s] == 0.0:
        return
    R = to_matrix(quaternion_at(memory.nominal, ATTITUDE))
    _subtract_scale_error(pair.covariance, a, s, R, rate, dt)
    transpose_rows(pair.covariance, a, 3)  # P <- F P Fᵀ, computed as F (F P)ᵀ
    _subtract_scale_error(pair.covariance, a, s, R, rate, dt)
    mirror(pair.covariance, a, 3)


@njit(**INNER_KERNEL)
def _subtract_scale_error(M: Array, a: int, s: int, R: Mat3, rate: Vec3, dt: float) -> None:
    """Subtracts R diag(ω) dt times the three rows of the scale from the three rows of the attitude, in place.

    Args:
        M: (n, m) matrix with a row per error state.
        a: First row of the foot's attitude error.
        s: First row of the scale errors of its gyro.
        R: (3, 3) rotation, world <- sensor.
        rate: (3,) ω, angular rate, rad/s.
        dt: Length of the interval, s.
    """
    for j in range(M.shape[1]):
        turned = matvec(R, (rate[0] * M[s, j], rate[1] * M[s + 1, j], rate[2] * M[s + 2, j]))
        for i in range(3):
            M[a + i, j] -= turned[i] * dt


@njit(**INNER_KERNEL)
def _is_aligned(pair: Pair, foot: int) -> bool:
    """Whether a foot has been aligned at least once."""
    return bool(pair.feet[foot].clock[LEVER_KNOWN] != 0)


@njit(**INNER_KERNEL)
def _measure_moving_time(pair: Pair) -> float:
    """Time for which both feet moved before they stood still, added up, s."""
    total = 0.0
    for f in range(2):
        clock = pair.feet[f].clock
        total += (clock[T_STATIONARY] - clock[T_ALIGN]) * 1e-9
    return total


@njit(**INNER_KERNEL)
def _widen_start(pair: Pair, before_s: float, moved_s: float) -> None:
    """Makes the right foot's start beside the left one as uncertain as both may have moved since.

    The guess that feet stand side by side is of the first sample. People who stand there do not move; a recording that
    begins in the middle of a walk has feet that stand still one after the other.

    Args:
        pair: State of both feet.
        before_s: Time for which they moved that the covariance already knows of.
        moved_s: Time for which they moved.
    """
    P, o, grown = pair.covariance, pair.feet[1].row, moved_s**2 - before_s**2
    for i in range(3):
        P[o + D_POSITION + i, o + D_POSITION + i] += GAP_SPEED_MPS**2 * grown
    P[o + D_ATTITUDE + 2, o + D_ATTITUDE + 2] += GAP_TURN_RATE_RADPS**2 * grown


@_entry_kernel
def run(
    pair: Pair,
    feet: tuple[KernelParameters, KernelParameters],
    parameters: PairParameters,
    events: Events,
    phase: NDArray[np.int8],
    figure: Array,
    state: Array,
    covariance: Array,
) -> None:
    """Takes N events and writes the estimates after each.

    The proposed method ignores an aid while a foot's sensor is clipped: its error is restored only afterwards.

    Args:
        pair: State of both feet, changed in place.
        feet: Parameters of the left and of the right foot.
        parameters: Parameters of both.
        events: An aid comes right after the IMU sample by which both feet have reached its time.
        phase: (N,) int8, written: of an IMU sample, the phase in which it was used; of an aid, IGNORED.
        figure: (N,) written: of an IMU sample, standard deviation of the stationary foot's speed, m/s; of an aid, its
            innovation's length in standard deviations, or UNUSED.
        state: (N, 22) written: nominal state of the foot of an IMU sample, once the aids that follow it are used.
        covariance: (N, 6, 6) written: of that foot's position (m) and attitude (rad), world axes.
    """
    last, earth = -1, vec3_at(pair.earth, 0)  # last: the newest IMU sample among the events, -1 before the first
    for k in range(len(events.t_ns)):
        kind, t_ns, f, row = events.kind[k], events.t_ns[k], int(events.foot[k]), events.row[k]
        if kind == IMU:
            memory = pair.feet[f]
            begins = not (_is_aligned(pair, 0) and _is_aligned(pair, 1))
            before_s = _measure_moving_time(pair) if _is_aligned(pair, 1) else 0.0
            rate, scales = vec3_at(events.rate[row], 0), vec3_at(pair.scales[f], 0)
            # without the estimated scale errors of the gyro
            rate = (1.0 - scales[0]) * rate[0], (1.0 - scales[1]) * rate[1], (1.0 - scales[2]) * rate[2]
            rate, force = to_inertial_world(memory.nominal, earth, rate, vec3_at(events.force[row], 0))
            if is_possible(rate, force):
                apply_gyro_scale(pair, f, rate, t_ns)
            if parameters.is_published:
                phase[k], figure[k] = step_published(memory, feet[f], parameters, t_ns, rate, force)
            else:
                phase[k], figure[k] = step(memory, feet[f], t_ns, rate, force)
            if begins and _is_aligned(pair, 1):
                _widen_start(pair, before_s, _measure_moving_time(pair))
            inject_all(pair)
            last = k
        else:
            phase[k] = IGNORED  # an aid has no phase
            if not parameters.is_published and (is_clipped(pair.feet[0], feet[0]) or is_clipped(pair.feet[1], feet[1])):
                figure[k] = UNUSED
            elif kind == OBSERVATION:
                m, points, rays, sd = events.numbers[row], events.points[row], events.rays[row], events.ray_sd[row]
                figure[k] = board_update(pair, feet[f], parameters, f, t_ns, m, points, rays, sd)
            elif kind == RELATIVE:
                relative, sd = vec3_at(events.relative[row], 0), events.relative_sd[row]
                figure[k] = relative_position_update(pair, feet[f], parameters, f, t_ns, relative, sd)
            else:
                figure[k] = sonar_update(pair, feet[f], parameters, f, t_ns, events.distance[row])
        if last >= 0:
            write_estimate(pair.feet[int(events.foot[last])], state[last], covariance[last])


@_entry_kernel
def predict_board(
    pair: Pair,
    foot: KernelParameters,
    parameters: PairParameters,
    camera: int,
    t_ns: int,
    earlier_ns: int,
    T: Array,
    covariance: Array,
    T_before: Array,
) -> bool:
    """Predicted pose of the other foot's board in a foot's camera, at `t_ns` on the camera's clock and earlier.

    Args:
        pair: State of both feet.
        foot: Parameters of the foot with the camera.
        parameters: Parameters of both.
        camera: Index in `FEET` of the foot that carries the camera.
        t_ns: Middle of the exposure.
        earlier_ns: How much earlier the earlier pose is.
        T: (3, 4) written: rotation, camera <- board, and position, m.
        covariance: (6, 6) written: of position (m) and rotation vector (rad), camera axes.
        T_before: (3, 4) written: the earlier pose.

    Returns:
        Whether both poses are known; if not, what is written must not be used.
    """
    then_ns = t_ns + round(1e9 * pair.late[camera])  # on the IMUs' clock, by the estimated offset of the camera's
    known_before = _predict_pose(pair, foot, parameters, camera, then_ns - earlier_ns, 1e-9 * earlier_ns, T_before)
    known = _predict_pose(pair, foot, parameters, camera, then_ns, 0.0, T)
    # the covariance follows from the derivatives that the second call has left in `pair.work.jacobian`
    write_pose_covariance(pair.covariance, pair.work, pair.board)
    copy_matrix(pair.board.covariance, covariance)
    return known and known_before


@njit(**INNER_KERNEL)
def _predict_pose(
    pair: Pair, foot: KernelParameters, parameters: PairParameters, camera: int, t_ns: int, earlier_s: float, T: Array
) -> bool:
    """Writes the pose of the other foot's board in a foot's camera; returns whether it is known.

    Args:
        pair: State of both feet.
        foot: Parameters of the foot with the camera.
        parameters: Parameters of both.
        camera: Index in `FEET` of the foot that carries the camera.
        t_ns: Time of the pose, on the clock of the IMUs.
        earlier_s: Time by which `max_delay_s` is extended, s.
        T: (3, 4) written: rotation, camera <- board, and position, m.
    """
    gravity, delay_s = foot.gravity_mps2, parameters.max_delay_s + earlier_s
    # states at that time: a of the foot with the camera, b of the other
    a = rewind(pair.feet[camera], gravity, t_ns, delay_s)
    b = rewind(pair.feet[1 - camera], gravity, t_ns, delay_s)
    p, R = board_in_camera(pair, camera, a, b)
    store_mat3_at(R, T, 0, 0)
    for i in range(3):
        T[i, 3] = p[i]
    return a.known and b.known
