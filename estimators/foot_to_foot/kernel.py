"""The compiled filter of two feet, sample by sample, of either foot and either aid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators import foot_ins
from stridetwin.estimators.compiled import INSIDE, cached
from stridetwin.estimators.foot_ins.clipping import is_clipped
from stridetwin.estimators.foot_ins.kernel import note_pose_covariance, possible, step
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.state import (
    ATTITUDE,
    D_ATTITUDE,
    IGNORED,
    PHASE,
    T_LAST,
    TRACKING,
    VELOCITY,
    Memory,
)
from stridetwin.estimators.foot_to_foot.parameters import PairParameters
from stridetwin.estimators.foot_to_foot.published import published_step, relative_position_update
from stridetwin.estimators.foot_to_foot.relative_updates import UNUSED, board_in_camera, board_update, sonar_update
from stridetwin.estimators.foot_to_foot.rewind import rewind
from stridetwin.estimators.foot_to_foot.state import IMU, OBSERVATION, RELATIVE, SCALES, Events, Pair, inject_all
from stridetwin.estimators.so3 import rotation_matrix
from stridetwin.streams.samples import Array

_called = cached(Path(__file__).parent, Path(foot_ins.__file__).parent)


@njit(**INSIDE)
def in_inertial_world(memory: Memory, earth: Array, rate: Array, force: Array) -> tuple[Array, Array]:
    """The sample (rad/s, m/s²) in a world without rotation: minus the Earth's rate and the Coriolis force.

    Titterton & Weston 2004, ch. 3; the centrifugal force is part of gravity.
    """
    w, v = earth, memory.nominal[VELOCITY : VELOCITY + 3]
    coriolis = np.array([w[1] * v[2] - w[2] * v[1], w[2] * v[0] - w[0] * v[2], w[0] * v[1] - w[1] * v[0]])
    to_sensor = rotation_matrix(memory.nominal[ATTITUDE : ATTITUDE + 4]).T
    return rate - to_sensor @ earth, force - to_sensor @ (2.0 * coriolis)


@njit(**INSIDE)
def apply_gyro_scale(pair: Pair, foot: int, rate: Array, t_ns: int, max_gap_s: float) -> None:
    """Propagates a foot's scale error into its attitude error up to `t_ns`: δθ -= R diag(ω) δs dt.

    See docs/foot_to_foot.md (8). One foot alone does not observe the scale, because it rotates back in every step; two
    feet that observe each other do. Unmodelled, it appears as a longer or shorter step (Titterton & Weston 2004, 12.3).
    After a gap longer than `max_gap_s` the foot is aligned again, and nothing is done here.
    """
    memory = pair.feet[foot]
    dt = (t_ns - memory.clock[T_LAST]) * 1e-9
    s, a = SCALES + 3 * foot, memory.row + D_ATTITUDE
    if memory.clock[PHASE] != TRACKING or not 0.0 < dt <= max_gap_s or pair.covariance[s, s] == 0.0:
        return
    D = rotation_matrix(memory.nominal[ATTITUDE : ATTITUDE + 4]) * (rate * dt)
    _add_scale_error(pair.covariance, a, s, D)
    _add_scale_error(pair.covariance.T, a, s, D)


@njit(**INSIDE)
def _add_scale_error(M: Array, a: int, s: int, D: Array) -> None:
    """Attitude rows from `a` on minus D times the scale rows from `s` on, in place."""
    for j in range(M.shape[1]):
        s0, s1, s2 = M[s, j], M[s + 1, j], M[s + 2, j]
        for i in range(3):
            M[a + i, j] -= D[i, 0] * s0 + D[i, 1] * s1 + D[i, 2] * s2


@_called
def run(
    pair: Pair, feet: tuple[KernelParameters, KernelParameters], parameters: PairParameters, events: Events,
    phase: NDArray[np.int8], figure: Array, state: Array, covariance: Array,
) -> None:  # fmt: skip
    """Takes N events and writes the estimates after each.

    Args:
        pair: Changed in place.
        feet: Parameters of the left and of the right foot.
        parameters: Parameters of both.
        events: An aid comes right after the IMU sample by which both feet have reached its time.
        phase: (N,) int8, out: of an IMU sample, the phase in which it was used; of an aid, IGNORED.
        figure: (N,) out: of an IMU sample, standard deviation of the stationary foot's speed, m/s; of an aid, its
            normalised innovation, see `relative_updates.board_update`.
        state: (N, 20) out: nominal state of the foot of an IMU sample, once the aids that follow it are used.
        covariance: (N, 6, 6) out: of its position (m) and attitude (rad), world axes.
    """
    last = -1
    for k in range(len(events.t_ns)):
        kind, t_ns, f, row = events.kind[k], events.t_ns[k], events.foot[k], events.row[k]
        if kind == IMU:
            memory = pair.feet[f]
            rate = (1.0 - pair.scales[f]) * events.rate[row]
            rate, force = in_inertial_world(memory, pair.earth, rate, events.force[row])
            if possible(feet[f], rate, force):
                apply_gyro_scale(pair, f, rate, t_ns, feet[f].max_gap_s)
            if parameters.published:
                phase[k], figure[k] = published_step(memory, feet[f], parameters, t_ns, rate, force)
            else:
                phase[k], figure[k] = step(memory, feet[f], t_ns, rate, force)
            inject_all(pair)
            last = k
        else:
            phase[k] = IGNORED
            if not parameters.published and (is_clipped(pair.feet[0], feet[0]) or is_clipped(pair.feet[1], feet[1])):
                figure[k] = UNUSED
            elif kind == OBSERVATION:
                m = events.numbers[row]
                points, rays, sd = events.points[row, :m], events.rays[row, :m], events.ray_sd[row, :m]
                figure[k] = board_update(pair, feet[f], parameters, f, t_ns, points, rays, sd)
            elif kind == RELATIVE:
                relative, sd = events.relative[row], events.relative_sd[row]
                figure[k] = relative_position_update(pair, feet[f], parameters, f, t_ns, relative, sd)
            else:
                figure[k] = sonar_update(pair, feet[f], parameters, f, t_ns, events.distance[row])
        if last >= 0:
            memory = pair.feet[events.foot[last]]
            state[last] = memory.nominal
            note_pose_covariance(memory, covariance[last])


@_called
def predict_board(
    pair: Pair, foot: KernelParameters, parameters: PairParameters, camera: int, t_ns: int, earlier_ns: int
) -> tuple[bool, Array, Array, Array, Array, Array]:
    """Predicted pose of the other foot's board in a foot's camera, at `t_ns` on the camera's clock and earlier.

    Returns:
        Whether it is known; (3,) m; (3, 3) camera <- board; (6, 6) their covariance, camera axes; the earlier pose.
    """
    board, gravity, late = 1 - camera, foot.gravity_mps2, parameters.max_delay_s + 1e-9 * earlier_ns
    then_ns, lead = t_ns + round(1e9 * pair.late[camera]), parameters.max_lead_s
    a = rewind(pair.feet[camera], gravity, then_ns, parameters.max_delay_s, lead)
    b = rewind(pair.feet[board], gravity, then_ns, parameters.max_delay_s, lead)
    p, R, G = board_in_camera(pair, camera, a, b)
    a_0 = rewind(pair.feet[camera], gravity, then_ns - earlier_ns, late, lead)
    b_0 = rewind(pair.feet[board], gravity, then_ns - earlier_ns, late, lead)
    p_0, R_0, _ = board_in_camera(pair, camera, a_0, b_0)
    known = a.known and b.known and a_0.known and b_0.known
    return known, p, R, G @ pair.covariance @ G.T, p_0, R_0
