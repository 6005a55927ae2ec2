"""Updates by what one shoe measures of the other: points of its board (camera), and its distance (sonar)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.stance import normalized_innovation
from stridetwin.estimators.foot_ins.state import D_ATTITUDE, D_GYRO_BIAS, D_POSITION, D_VELOCITY, STATES
from stridetwin.estimators.foot_ins.strapdown import correct
from stridetwin.estimators.foot_to_foot.parameters import PairParameters
from stridetwin.estimators.foot_to_foot.rewind import PastState, cross, rewind
from stridetwin.estimators.foot_to_foot.state import (
    ALL_STATES,
    BOARD,
    CAMERA,
    CLOCKS,
    ECHOES,
    MOUNTS,
    NEVER,
    OBSERVATIONS,
    Pair,
    inject_all,
)
from stridetwin.estimators.so3 import quat_exp, rotation_matrix
from stridetwin.streams.samples import Array

UNUSED = -1.0  # the normalised innovation of an unused measurement


@njit(**INSIDE)
def board_update(
    pair: Pair, foot: KernelParameters, parameters: PairParameters, camera: int, t_ns: int, points_in_board: Array,
    rays: Array, ray_sd: Array,
) -> float:  # fmt: skip
    """Update with the image of the other foot's board.

    See docs/foot_to_foot.md (5), (7).

    The points depend on the state only through the board's pose in the camera. So the 2M rows are compressed to six,
    the triangle R of a QR decomposition, before the update; the remainder measures how well any pose of the board
    explains them. Errors of lens, print and a yielding shoe are the same in every frame of one pass of the other shoe,
    so within `observation_correlation_s` all observations share one error. A bad fit and a large normalised innovation
    (after Chang 2014, as with zero velocities) increase the noise in proportion.

    Args:
        pair: Changed in place.
        foot: Parameters of the foot with the camera.
        parameters: Of both feet.
        camera: Foot that carries the camera.
        t_ns: Middle of the exposure, on the camera's clock.
        points_in_board: (M, 3) m, M ≥ 4.
        rays: (M, 2) normalised image coordinates of the points, x right, y down.
        ray_sd: (M,) standard deviation of each coordinate.

    Returns:
        Length of the innovation in standard deviations, or UNUSED.
    """
    then_ns = t_ns + round(1e9 * pair.late[camera])
    a = rewind(pair.feet[camera], foot.gravity_mps2, then_ns, parameters.max_delay_s, parameters.max_lead_s)
    b = rewind(pair.feet[1 - camera], foot.gravity_mps2, then_ns, parameters.max_delay_s, parameters.max_lead_s)
    if not (a.known and b.known):
        return UNUSED
    since_s = (t_ns - pair.seen[camera]) * 1e-9
    walked = 0.0 if pair.seen[camera] == NEVER else parameters.camera_clock_walk_s_rts**2 * since_s
    p, R, G = board_in_camera(pair, camera, a, b)
    by_clock = G[:, CLOCKS + camera]
    predicted = G @ pair.covariance @ G.T + walked * np.outer(by_clock, by_clock)
    m = len(points_in_board)
    # An error of a foot's rotation since the exposure moves all points alike.
    rotated = foot.gyro_noise_radps_rthz**2 * (abs(a.age) + abs(b.age))
    sd = np.sqrt(ray_sd**2 + m * rotated)
    frame_s = min(max(since_s, 1e-3), parameters.max_frame_s)
    shared = math.sqrt(max(1.0, parameters.observation_correlation_s / frame_s))
    ahead, T, z, alone = _reduced_measurement(parameters, p, R, predicted, points_in_board, rays, sd, shared)
    if not ahead:
        return UNUSED
    pair.covariance[CLOCKS + camera, CLOCKS + camera] += walked  # once: the next observation counts from this one
    H, z = (T / (alone * shared)) @ G, z / (alone * shared)
    length = normalized_innovation(pair.covariance, H, z)
    pair.nis[OBSERVATIONS, 0] += normalized_innovation(pair.covariance, shared * H, shared * z) ** 2 / 6.0
    pair.nis[OBSERVATIONS, 1] += 1.0
    inflation = max(1.0, length / parameters.observation_gate)
    for i in range(6):
        correct(pair.covariance, pair.error, 0, H[i] / inflation, z[i] / inflation, 1.0)
    inject_all(pair)
    pair.seen[camera] = t_ns
    return length


@njit(**INSIDE)
def _reduced_measurement(
    parameters: PairParameters, p: Array, R: Array, covariance: Array, points_in_board: Array, rays: Array,
    ray_sd: Array, shared: float,
) -> tuple[bool, Array, Array, float]:  # fmt: skip
    """An image's linear measurement of the difference of the board's pose from the predicted one.

    See docs/foot_to_foot.md (6).

    A badly predicted pose is far from where the rays' Jacobian holds: a board that is a quarter nearer is
    overcorrected. So the rays are linearised again at the updated board pose until it converges (iterated Kalman
    filter; Jazwinski 1970, 9.7, in the six dimensions that matter). `shared` is the factor by which the noise grows as
    observations share their error.

    Returns:
        Whether the board is in front of the camera; (6, 6) derivatives by the pose; (6,) innovations, both in standard
        deviations of the rays; misfit, at least 1, by which these are too small.
    """
    u, T, z, alone = np.zeros(6), np.eye(6), np.zeros(6), 1.0  # u: estimated minus predicted pose
    for i in range(int(parameters.relinearizations)):
        q = quat_exp(u[3], u[4], u[5])
        A, ahead = _rows(parameters, p + u[:3], rotation_matrix(q) @ R, points_in_board, rays, ray_sd)
        if not ahead:
            return i > 0, T, z, alone
        triangle = np.linalg.qr(A)[1]
        T = np.ascontiguousarray(triangle[:6, :6])
        z = triangle[:6, 6] + T @ u
        alone = max(1.0, abs(triangle[6, 6]) / math.sqrt(2 * len(rays) - 6))
        noise = alone * shared
        gain = covariance @ T.T @ np.linalg.inv(T @ covariance @ T.T + noise**2 * np.eye(6))
        before, u = u, gain @ z
        moved = T @ (u - before)
        if moved @ moved < (parameters.settled_sd * noise) ** 2:
            break
    return True, T, z, alone


@njit(**INSIDE)
def board_in_camera(pair: Pair, camera: int, a: PastState, b: PastState) -> tuple[Array, Array, Array]:
    """Pose of the other foot's board in a foot's camera, and how it depends on the state.

    See docs/foot_to_foot.md (1), (2). `a` is the past state of the foot with the camera, `b` that of the other.

    Returns:
        (3,) m; (3, 3) camera <- board; (6, n) derivatives of the position (m) and of the rotation vector (rad), in
        camera axes, with regard to the error state.
    """
    board = 1 - camera
    mount_a, mount_b = pair.mounts[CAMERA + camera], pair.mounts[BOARD + board]
    R_c, R_m = rotation_matrix(mount_a[3:]), rotation_matrix(mount_b[3:])
    arm = b.R @ mount_b[:3]
    d = b.p + arm - a.p  # from a's IMU to the board, world
    in_imu = a.R.T @ d
    to_camera = np.ascontiguousarray((a.R @ R_c).T)  # camera <- world
    out = np.ascontiguousarray(R_c.T)  # camera <- a's IMU
    R_camera_b = to_camera @ b.R  # camera <- b's IMU

    G = np.zeros((6, ALL_STATES))
    by_a, by_b = cross(to_camera, d), -cross(to_camera, arm)
    _pose_columns(G, STATES * camera, -to_camera, by_a, a)
    _pose_columns(G, STATES * board, to_camera, by_b, b)
    G[:3, CLOCKS + camera] = to_camera @ (b.v - a.v) + by_a @ a.rate + by_b @ b.rate
    G[3:, CLOCKS + camera] = to_camera @ (b.rate - a.rate)
    c = MOUNTS + 6 * (CAMERA + camera)
    G[:3, c : c + 3] = -out
    G[:3, c + 3 : c + 6] = cross(out, in_imu - mount_a[:3])
    G[3:, c + 3 : c + 6] = -out
    m = MOUNTS + 6 * (BOARD + board)
    G[:3, m : m + 3] = R_camera_b
    G[3:, m + 3 : m + 6] = R_camera_b
    return out @ (in_imu - mount_a[:3]), R_camera_b @ R_m, G


@njit(**INSIDE)
def _pose_columns(G: Array, o: int, to_camera: Array, by_attitude: Array, past: PastState) -> None:
    """Writes a foot's columns of G: those of its pose at that time, in terms of its newest state.

    See docs/foot_to_foot.md (3).

    δθ_then = δθ + age R δb_g, and δp_then = δp - age δv + δθ × displacement: the force acts in the rotated direction.
    """
    G[:3, o + D_POSITION : o + D_POSITION + 3] = to_camera
    G[:3, o + D_VELOCITY : o + D_VELOCITY + 3] = -past.age * to_camera
    G[:3, o + D_ATTITUDE : o + D_ATTITUDE + 3] = by_attitude - cross(to_camera, past.displacement)
    G[:3, o + D_GYRO_BIAS : o + D_GYRO_BIAS + 3] = past.age * (by_attitude @ past.R)
    G[3:, o + D_ATTITUDE : o + D_ATTITUDE + 3] = to_camera
    G[3:, o + D_GYRO_BIAS : o + D_GYRO_BIAS + 3] = past.age * (to_camera @ past.R)


@njit(**INSIDE)
def _rows(
    parameters: PairParameters, p: Array, R: Array, points_in_board: Array, rays: Array, ray_sd: Array
) -> tuple[Array, bool]:
    """(2M, 7) derivatives of the rays by the board's pose in the camera, and innovations, in standard deviations.

    See docs/foot_to_foot.md (4).

    Also whether the board is in front of the camera.
    """
    A = np.empty((2 * len(rays), 7))
    J = np.zeros((2, 3))
    for i in range(len(rays)):
        arm = R @ points_in_board[i]
        x, y, depth = p[0] + arm[0], p[1] + arm[1], p[2] + arm[2]
        if not depth > parameters.board_depth_min_m:
            return A, False
        x, y = x / depth, y / depth
        scale = 1.0 / (depth * ray_sd[i])
        J[0, 0], J[0, 2] = scale, -x * scale
        J[1, 1], J[1, 2] = scale, -y * scale
        A[2 * i : 2 * i + 2, :3] = J
        A[2 * i : 2 * i + 2, 3:6] = -cross(J, arm)
        A[2 * i, 6] = (rays[i, 0] - x) / ray_sd[i]
        A[2 * i + 1, 6] = (rays[i, 1] - y) / ray_sd[i]
    return A, True


@njit(**INSIDE)
def sonar_update(
    pair: Pair, foot: KernelParameters, parameters: PairParameters, sonar: int, t_ns: int, distance: float
) -> float:
    """Update with the distance (m) between a foot's sonar and the reflecting point of the other foot.

    See docs/foot_to_foot.md (9).

    The published system uses the positions alone. Here the attitudes at both ends enter too, and the sonar is used only
    if the other shoe has not been observed for `sonar_after_s`: an echo comes from some part of it, always with the
    same sign, so all within `observation_correlation_s` share one error. Most echoes of a real walk are from the floor
    or from things beyond: those too far from the predicted distance are rejected.

    Returns:
        Length of the innovation in standard deviations, or UNUSED.
    """
    if not parameters.published and (t_ns - pair.seen.max()) * 1e-9 < parameters.sonar_after_s:
        return UNUSED
    other = 1 - sonar
    a = rewind(pair.feet[sonar], foot.gravity_mps2, t_ns, parameters.max_delay_s, parameters.max_lead_s)
    b = rewind(pair.feet[other], foot.gravity_mps2, t_ns, parameters.max_delay_s, parameters.max_lead_s)
    arm_a, arm_b = a.R @ pair.sonars[sonar], b.R @ pair.echoes[other]
    d = b.p + arm_b - a.p - arm_a
    size = math.sqrt(d @ d)
    if not (a.known and b.known and size > 0.0):
        return UNUSED
    to = np.ascontiguousarray((d / (size * parameters.range_sd_m)).reshape(1, 3))
    H = np.zeros((1, ALL_STATES))
    of_a, of_b = STATES * sonar, STATES * other
    H[:, of_a + D_POSITION : of_a + D_POSITION + 3] = -to
    H[:, of_b + D_POSITION : of_b + D_POSITION + 3] = to
    if not parameters.published:
        H[:, of_a + D_ATTITUDE : of_a + D_ATTITUDE + 3] = cross(to, arm_a)
        H[:, of_b + D_ATTITUDE : of_b + D_ATTITUDE + 3] = -cross(to, arm_b)
    z = np.array([(distance - size) / parameters.range_sd_m])
    length = normalized_innovation(pair.covariance, H, z)
    if parameters.published:
        used, inflation = abs(distance - size) < parameters.max_range_misfit_m, 1.0
    else:
        echo_s = min(max((t_ns - pair.heard[sonar]) * 1e-9, 1e-3), parameters.observation_correlation_s)
        used, inflation = length < parameters.range_gate, math.sqrt(parameters.observation_correlation_s / echo_s)
    if not used:
        return UNUSED
    pair.heard[sonar] = t_ns
    pair.nis[ECHOES, 0] += length**2
    pair.nis[ECHOES, 1] += 1.0
    correct(pair.covariance, pair.error, 0, H[0] / inflation, z[0] / inflation, 1.0)
    inject_all(pair)
    return length
