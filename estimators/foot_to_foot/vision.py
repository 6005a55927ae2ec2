"""A camera on one shoe sees the board on the other: what its points say about both feet and how the parts sit."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stridetwin.estimators.foot_ins.algebra import rotation_matrix
from stridetwin.estimators.foot_ins.covariance import correct
from stridetwin.estimators.foot_ins.memory import D_ATTITUDE, D_GYRO_BIAS, D_POSITION, D_VELOCITY, STATES
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.stance import surprise
from stridetwin.estimators.foot_to_foot.memory import ALL_STATES, BOARD, CAMERA, MOUNTS, Pair, inject_all
from stridetwin.estimators.foot_to_foot.parameters import PairParameters
from stridetwin.estimators.foot_to_foot.rewind import cross, rewind
from stridetwin.streams.samples import Array

MIN_DEPTH = 0.02  # m; a board nearer than this, or behind the camera, is not where the filter thinks
UNUSED = -1.0  # the surprise of a measurement that could not be used


@njit
def see(
    pair: Pair,
    foot: KernelParameters,
    parameters: PairParameters,
    camera: int,
    t_ns: int,
    points_in_board: Array,
    rays: Array,
    ray_sd: Array,
) -> float:
    """Update with the picture of the other foot's board.

    The points depend on the state through the board's pose in the camera alone. So the 2M rows are compressed to
    six, the triangle R of a QR decomposition, before they meet the state; what is left over says how well any
    pose of the board explains them. What lens, print and a yielding shoe do wrong they do wrong in every frame of
    one pass of the other shoe, so within `sighting_correlation_s` all sightings share one error. A bad fit and a
    surprise (after Chang 2014, as with zero velocities) widen the noise in proportion.

    Args:
        pair: Changed in place.
        foot: What the one-foot filter believes of the foot with the camera.
        parameters: What the filter of both believes.
        camera: Foot that carries the camera.
        t_ns: Middle of the exposure.
        points_in_board: (M, 3) m, M ≥ 4.
        rays: (M, 2) normalised image coordinates of the points, x right, y down.
        ray_sd: (M,) standard deviation of each coordinate.

    Returns:
        Length of the innovation in standard deviations, or UNUSED.
    """
    board = 1 - camera
    known_a, p_a, R_a, age_a, led_a = rewind(pair.feet[camera], foot.gravity, t_ns, parameters.max_delay_s)
    known_b, p_b, R_b, age_b, led_b = rewind(pair.feet[board], foot.gravity, t_ns, parameters.max_delay_s)
    if not (known_a and known_b):
        return UNUSED
    p, R, G = board_in_camera(pair, camera, p_a, R_a, age_a, led_a, p_b, R_b, age_b, led_b)
    m = len(points_in_board)
    # A turn of a foot since the exposure that its gyro got wrong shifts all points alike.
    turned = foot.gyro_noise**2 * (age_a + age_b)
    A, ahead = _rows(p, R, points_in_board, rays, np.sqrt(ray_sd**2 + m * turned))
    if not ahead:
        return UNUSED
    triangle = np.linalg.qr(A)[1]
    misfit = abs(triangle[6, 6]) / math.sqrt(2 * m - 6)
    frame_s = min(max((t_ns - pair.seen[camera]) * 1e-9, 1e-3), parameters.max_frame_s)
    noise = max(1.0, misfit) * math.sqrt(max(1.0, parameters.sighting_correlation_s / frame_s))
    H = (np.ascontiguousarray(triangle[:6, :6]) / noise) @ G
    z = triangle[:6, 6] / noise
    length = surprise(pair.covariance, H, z)
    doubt = max(1.0, length / parameters.max_sighting_surprise)
    for i in range(6):
        correct(pair.covariance, pair.error, 0, H[i] / doubt, z[i] / doubt, 1.0)
    inject_all(pair)
    pair.seen[camera] = t_ns
    return length


@njit
def board_in_camera(
    pair: Pair,
    camera: int,
    p_a: Array,
    R_a: Array,
    age_a: float,
    led_a: Array,
    p_b: Array,
    R_b: Array,
    age_b: float,
    led_b: Array,
) -> tuple[Array, Array, Array]:
    """Pose of the other foot's board in a foot's camera, and how it depends on the state.

    Args:
        pair: For the mounts.
        camera: Foot a, which carries the camera; the other is b.
        p_a: (3,) position of a's IMU in the world, m.
        R_a: (3, 3) its rotation, world <- IMU.
        age_a: How far before a's newest state that pose is, s.
        led_a: (3,) way that its specific force has led since, world, m.
        p_b: The same of b.
        R_b: The same of b.
        age_b: The same of b.
        led_b: The same of b.

    Returns:
        (3,) m; (3, 3) camera <- board; (6, n) derivatives of the position (m) and of the rotation vector (rad), in
        camera axes, with regard to the error state.
    """
    board = 1 - camera
    mount_a, mount_b = pair.mounts[CAMERA + camera], pair.mounts[BOARD + board]
    R_c, R_m = rotation_matrix(mount_a[3:]), rotation_matrix(mount_b[3:])
    d = p_b + R_b @ mount_b[:3] - p_a  # from a's IMU to the board, world
    in_imu = R_a.T @ d
    to_camera = np.ascontiguousarray((R_a @ R_c).T)  # camera <- world
    out = np.ascontiguousarray(R_c.T)  # camera <- a's IMU
    turn_b = to_camera @ R_b  # camera <- b's IMU

    G = np.zeros((6, ALL_STATES))
    a, b = STATES * camera, STATES * board
    _pose_columns(G, a, -to_camera, cross(to_camera, d), R_a, age_a, led_a)
    _pose_columns(G, b, to_camera, -cross(to_camera, R_b @ mount_b[:3]), R_b, age_b, led_b)
    c = MOUNTS + 6 * (CAMERA + camera)
    G[:3, c : c + 3] = -out
    G[:3, c + 3 : c + 6] = cross(out, in_imu - mount_a[:3])
    G[3:, c + 3 : c + 6] = -out
    m = MOUNTS + 6 * (BOARD + board)
    G[:3, m : m + 3] = turn_b
    G[3:, m + 3 : m + 6] = turn_b
    return out @ (in_imu - mount_a[:3]), turn_b @ R_m, G


@njit
def _pose_columns(G: Array, o: int, turn: Array, by_attitude: Array, R: Array, age: float, led: Array) -> None:
    """Writes a foot's columns of G: those of its pose `age` ago, in terms of its newest state.

    δθ_then = δθ + age R δb_g, and δp_then = δp - age δv + δθ × led: a turned foot would have been pushed another way.
    """
    G[:3, o + D_POSITION : o + D_POSITION + 3] = turn
    G[:3, o + D_VELOCITY : o + D_VELOCITY + 3] = -age * turn
    G[:3, o + D_ATTITUDE : o + D_ATTITUDE + 3] = by_attitude - cross(turn, led)
    G[:3, o + D_GYRO_BIAS : o + D_GYRO_BIAS + 3] = age * (by_attitude @ R)
    G[3:, o + D_ATTITUDE : o + D_ATTITUDE + 3] = turn
    G[3:, o + D_GYRO_BIAS : o + D_GYRO_BIAS + 3] = age * (turn @ R)


@njit
def _rows(p: Array, R: Array, points_in_board: Array, rays: Array, ray_sd: Array) -> tuple[Array, bool]:
    """(2M, 7) derivatives of the rays by the board's pose in the camera, and innovations, in standard deviations.

    Also whether the board lies ahead of the camera.
    """
    A = np.empty((2 * len(rays), 7))
    J = np.zeros((2, 3))
    for i in range(len(rays)):
        arm = R @ points_in_board[i]
        x, y, depth = p[0] + arm[0], p[1] + arm[1], p[2] + arm[2]
        if not depth > MIN_DEPTH:
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
