"""Updates by what one shoe measures of the other: points of its board (camera), and its distance (sonar)."""

from __future__ import annotations

import math

from numba import njit

from stridetwin.estimators.foot_ins.kalman import (
    Workspace,
    apply_gated_update,
    back_substitute,
    clear,
    correct,
    innovation_norm,
    spread_measurements,
)
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.state import (
    ATTITUDE,
    D_ATTITUDE,
    D_GYRO_BIAS,
    D_POSITION,
    D_VELOCITY,
    POSITION,
    SERIES_RAD,
    STATES,
    VELOCITY,
    FilterState,
)
from stridetwin.estimators.foot_to_foot.parameters import PairParameters
from stridetwin.estimators.foot_to_foot.rewind import PastState, rewind
from stridetwin.estimators.foot_to_foot.state import (
    BOARD,
    CAMERA,
    CLOCKS,
    ECHOES,
    MOUNTS,
    NEVER,
    OBSERVATIONS,
    BoardWorkspace,
    Pair,
    inject_all,
)
from stridetwin.streams.algebra.matrices import clear as zero
from stridetwin.streams.algebra.matrices import clear_block
from stridetwin.streams.algebra.tuples import (
    Mat3,
    Vec3,
    axpy,
    cross,
    dot,
    exp,
    matmul,
    matvec,
    multiply,
    normalized,
    quaternion_at,
    rows_cross,
    scale_matrix,
    store_mat3_at,
    store_quaternion_at,
    store_vec3_at,
    to_matrix,
    transposed,
    vec3_at,
)
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

UNUSED = -1.0  # the normalised innovation of an unused measurement
_MAX_FRAME_S = 0.05  # largest time that one observation counts for
_MIN_BOARD_DEPTH_M = 0.02  # a board predicted nearer than this, or behind the camera, is invalid
_MAX_LINEARIZATIONS = 5  # per image
# Echoes farther off the predicted distance are from something else, in the published method, which leaves this open;
# hand-chosen. Doubled: echoes from the floor up to 1 m off are used.
_MAX_RANGE_MISFIT_M = 0.5
_APART_RAD = 0.3  # standard deviation of a heading that an image tells better than a linear update would
_USUAL_DEPTH_M = 0.4  # of a board that a shoe camera sees
_TURNED_RAD = 0.01  # smaller turns of a foot that is placed anew are left to the update
_SETTLED_SD = 0.1  # smaller changes of the board's pose, in standard deviations of the image, end the iteration


@njit(**INNER_KERNEL)
def board_update(
    pair: Pair,
    foot: KernelParameters,
    parameters: PairParameters,
    camera: int,
    t_ns: int,
    m: int,
    points_in_board: Array,
    rays: Array,
    ray_sd: Array,
) -> float:
    """Update with the points of the other foot's board in an image, docs/foot_to_foot.md (5), (7).

    The points depend on the state only through the board's pose in the camera. So the 2M rows are compressed to six,
    the triangle R of a QR decomposition, before the update; the remainder measures how well any pose of the board
    explains them. Errors of lens, print and a yielding shoe are the same in every frame of one pass of the other shoe,
    so within `observation_correlation_s` all observations share one error. A bad fit and a large normalised innovation
    (after Chang 2014, as with zero velocities) increase the noise in proportion.

    Args:
        pair: State of both feet, changed in place.
        foot: Parameters of the foot with the camera.
        parameters: Parameters of both feet.
        camera: Index in `FEET` of the foot that carries the camera.
        t_ns: Middle of the exposure, on the camera's clock.
        m: Number of points, ≥ 4: the first rows of the following.
        points_in_board: (M, 3) m, points in the board's frame.
        rays: (M, 2) normalised image coordinates of the points, x right, y down.
        ray_sd: (M,) standard deviation of each coordinate.

    Returns:
        Length of the innovation in standard deviations, or UNUSED.
    """
    then_ns = t_ns + round(1e9 * pair.late[camera])  # on the IMUs' clock, by the estimated offset of the camera's
    heading = STATES + D_ATTITUDE + 2  # of the right foot
    if pair.covariance[heading, heading] > _APART_RAD**2:
        _place_right_foot(pair, foot, parameters, camera, then_ns, m, points_in_board, rays, ray_sd)
    # states at the exposure: a of the foot with the camera, b of the other
    a = rewind(pair.feet[camera], foot.gravity_mps2, then_ns, parameters.max_delay_s)
    b = rewind(pair.feet[1 - camera], foot.gravity_mps2, then_ns, parameters.max_delay_s)
    if not (a.known and b.known):
        return UNUSED
    since_s = (t_ns - pair.seen[camera]) * 1e-9
    # variance by which the camera's clock has drifted since its last observation, s²
    clock_variance = 0.0 if pair.seen[camera] == NEVER else parameters.camera_clock_walk_s_rts**2 * since_s
    p, R = board_in_camera(pair, camera, a, b)  # predicted pose; its derivatives are now in `work.jacobian`
    work, board, P = pair.work, pair.board, pair.covariance
    write_pose_covariance(pair.covariance, work, board)  # of the predicted pose, into `board.covariance`
    for i in range(6):  # the drift of the clock is part of the predicted pose's covariance
        for j in range(6):
            by_clock = work.jacobian[i, CLOCKS + camera] * work.jacobian[j, CLOCKS + camera]
            board.covariance[i, j] += clock_variance * by_clock
    # An error of a foot's rotation since the exposure moves all m points alike: with m times its variance in each, they
    # count as one measurement of it.
    rotation_variance = m * foot.gyro_noise_radps_rthz**2 * (abs(a.age) + abs(b.age))
    frame_s = min(max(since_s, 1e-3), _MAX_FRAME_S)  # time that this observation counts for
    shared = math.sqrt(max(1.0, parameters.observation_correlation_s / frame_s))
    # a bad fit increases the noise of this image by the factor `image_misfit`; that of all images grows by `shared`
    in_front, image_misfit = reduce_measurement(
        board, p, R, m, points_in_board, rays, ray_sd, rotation_variance, shared
    )
    if not in_front:
        return UNUSED
    P[CLOCKS + camera, CLOCKS + camera] += clock_variance  # once: the next observation counts from this one
    _measure_states(work, board.reduced, 1.0 / (image_misfit * shared))
    length = apply_gated_update(P, pair.error, work, 0, 6, parameters.observation_gate)
    # statistics of consistency: with the noise of a single image, not that of the correlated ones; 6 numbers
    pair.nis[OBSERVATIONS, 0] += innovation_norm(work, 6, 1.0 / (shared * shared)) ** 2 / 6.0
    pair.nis[OBSERVATIONS, 1] += 1.0
    inject_all(pair)
    pair.seen[camera] = t_ns
    return length


@njit(**INNER_KERNEL)
def _place_right_foot(
    pair: Pair,
    foot: KernelParameters,
    parameters: PairParameters,
    camera: int,
    then_ns: int,
    m: int,
    points_in_board: Array,
    rays: Array,
    ray_sd: Array,
) -> None:
    """Turns and moves the right foot until its board, or the left one's in its camera, is where an image shows it.

    Feet that began apart (docs/foot_to_foot.md) have headings that no linear update corrects at once: it takes an arc
    for a straight line. The covariance stays as wide as it is; the update that follows starts from the right place.
    Arguments are those of `board_update`, and the exposure on the IMUs' clock.
    """
    memory, sign = pair.feet[1], 1.0 if camera == 0 else -1.0  # a camera that turns shows the board turn the other way
    for _ in range(_MAX_LINEARIZATIONS):
        a = rewind(pair.feet[camera], foot.gravity_mps2, then_ns, parameters.max_delay_s)
        b = rewind(pair.feet[1 - camera], foot.gravity_mps2, then_ns, parameters.max_delay_s)
        if not (a.known and b.known):
            return
        p, R = board_in_camera(pair, camera, a, b)
        write_pose_covariance(pair.covariance, pair.work, pair.board)
        R_world_camera = matmul(a.R, to_matrix(quaternion_at(pair.mounts[CAMERA + camera], 3)))
        in_front, _ = reduce_measurement(pair.board, p, R, m, points_in_board, rays, ray_sd, 0.0, 1.0)
        if not in_front:  # the guess is behind the camera: begin where the first point is seen, at a usual distance
            ahead = (_USUAL_DEPTH_M * rays[0, 0], _USUAL_DEPTH_M * rays[0, 1], _USUAL_DEPTH_M)
            to_there = matvec(R_world_camera, axpy(ahead, -1.0, p))
            _move_foot(memory, 0.0, (sign * to_there[0], sign * to_there[1], sign * to_there[2]))
            continue
        moved = matvec(R_world_camera, vec3_at(pair.board.moved[0], 0))
        turn = sign * dot(R_world_camera[2], vec3_at(pair.board.moved[0], 3))
        if abs(turn) <= _TURNED_RAD:  # the foot looks in the right direction
            _move_foot(memory, 0.0, (sign * moved[0], sign * moved[1], sign * moved[2]))
            return
        _move_foot(memory, turn, (0.0, 0.0, 0.0))


@njit(**INNER_KERNEL)
def _move_foot(memory: FilterState, turn: float, shift: Vec3) -> None:
    """Turns a foot about the vertical through it, rad, and moves it, m; the start of its path goes with it."""
    x, turned = memory.nominal, exp((0.0, 0.0, turn), SERIES_RAD)
    R, p = to_matrix(turned), vec3_at(memory.nominal, POSITION)
    before = matvec(R, axpy(vec3_at(memory.path, 0), -1.0, p))  # from the foot to the start of its path
    store_quaternion_at(normalized(multiply(turned, quaternion_at(x, ATTITUDE))), x, ATTITUDE)
    store_vec3_at(matvec(R, vec3_at(x, VELOCITY)), x, VELOCITY)
    store_vec3_at(axpy(p, 1.0, shift), x, POSITION)
    store_vec3_at(axpy(axpy(p, 1.0, shift), 1.0, before), memory.path, 0)


@njit(**INNER_KERNEL)
def write_pose_covariance(P: Array, work: Workspace, board: BoardWorkspace) -> None:
    """Writes the covariance G P Gᵀ (6, 6) of the board's predicted pose into `board.covariance`.

    Args:
        P: (n, n) covariance of the error states.
        work: Workspace whose `jacobian` holds G (6, n), the pose's derivatives, as `board_in_camera` has written them.
        board: Workspace of the image.
    """
    spread_measurements(P, work, 0, 6)
    for i in range(6):
        for j in range(i + 1):
            board.covariance[i, j] = board.covariance[j, i] = work.spread[i, j]


@njit(**INNER_KERNEL)
def _measure_states(work: Workspace, reduced: Workspace, weight: float) -> None:
    """Makes the measurement T of the pose one of all states: replaces the derivatives G of the pose by `weight` T G.

    Args:
        work: Workspace with G (6, n), into which measurement and innovation are written.
        reduced: Workspace with T (6, 6) and the innovation (6,) of the pose.
        weight: One over the standard deviation of the measurement.
    """
    T, G, column = reduced.jacobian, work.jacobian, work.solved  # `column` (6,) is scratch memory
    for j in range(G.shape[1]):  # column by column, so that G can be replaced in place
        for i in range(6):
            column[i] = G[i, j]
            G[i, j] = 0.0
        for i in range(6):
            for k in range(6):
                G[i, j] += weight * T[i, k] * column[k]
    for i in range(6):
        work.innovation[i] = weight * reduced.innovation[i]


@njit(**INNER_KERNEL)
def reduce_measurement(
    board: BoardWorkspace,
    p: Vec3,
    R: Mat3,
    m: int,
    points_in_board: Array,
    rays: Array,
    ray_sd: Array,
    rotated: float,
    shared: float,
) -> tuple[bool, float]:
    """An image's linear measurement of how the board's pose differs from the predicted one: docs/foot_to_foot.md (6).

    A badly predicted pose is far from where the rays' Jacobian holds: a board that is a quarter nearer is
    overcorrected. So the rays are linearised again at the updated board pose until it converges (iterated Kalman
    filter; Jazwinski 1970, 9.7, in the six dimensions that matter).

    Args:
        board: Workspace with the covariance of the predicted pose. The derivatives T (6, 6) by the pose and the
            innovations z (6,), both in standard deviations of the rays, are written into its part `reduced`.
        p: (3,) m, predicted position of the board in the camera.
        R: Predicted rotation, camera <- board.
        m: Number of points.
        points_in_board: (M, 3) m, points in the board's frame.
        rays: (M, 2) normalised image coordinates of the points, x right, y down.
        ray_sd: (M,) standard deviation of each coordinate.
        rotated: Variance common to all rays, by the feet's rotation since the exposure.
        shared: Factor by which the noise grows as observations share their error.

    Returns:
        Whether the board is in front of the camera; misfit of this image: factor, at least 1, by which its noise is
        larger than `ray_sd`. T and z are not divided by it yet.
    """
    work, C, triangle = board.reduced, board.covariance, board.triangle
    # u (6,): estimated minus predicted pose, position (m) before rotation (rad); change (6,): its last change
    T, z, u, change, image_misfit = work.jacobian, work.innovation, board.moved[0], board.moved[1], 1.0
    zero(u)
    for turn in range(_MAX_LINEARIZATIONS):  # number of the linearisation
        R_now = matmul(to_matrix(exp(vec3_at(u, 3), SERIES_RAD)), R)
        p_now = axpy(p, 1.0, vec3_at(u, 0))
        if not _linearise_rays(board, p_now, R_now, m, points_in_board, rays, ray_sd, rotated):
            return turn > 0, image_misfit  # a linearisation before this one is used, if there was one
        # length of the residuals that no pose explains, over its expectation: 2M coordinates, 6 unknowns
        image_misfit = max(1.0, abs(triangle[6, 6]) / math.sqrt(2 * m - 6))
        # the innovations are relative to the pose u; T u added makes them relative to the predicted pose
        for i in range(6):
            z[i] = triangle[i, 6]
            for j in range(6):
                T[i, j] = triangle[i, j]
                z[i] += T[i, j] * u[j]
        noise = image_misfit * shared
        # u <- C Tᵀ (T C Tᵀ + noise² 1)⁻¹ z
        spread_measurements(C, work, 0, 6)
        innovation_norm(work, 6, noise * noise)
        back_substitute(work, 6)
        for j in range(6):
            work.gain[j] = 0.0
            for i in range(6):
                work.gain[j] += T[i, j] * work.solved[i]
        moved2 = 0.0  # squared change of the predicted rays, in standard deviations
        for i in range(6):
            change[i] = -u[i]
            u[i] = 0.0
            for j in range(6):
                u[i] += C[i, j] * work.gain[j]
            change[i] += u[i]
        for i in range(6):
            moved = 0.0
            for j in range(6):
                moved += T[i, j] * change[j]
            moved2 += moved * moved
        if moved2 < (_SETTLED_SD * noise) ** 2:
            break
    return True, image_misfit


@njit(**INNER_KERNEL)
def board_in_camera(pair: Pair, camera: int, a: PastState, b: PastState) -> tuple[Vec3, Mat3]:
    """Pose of the other foot's board in a foot's camera, and its derivatives: docs/foot_to_foot.md (1), (2).

    The derivatives G (6, n) of the position (m) and of the rotation vector (rad), in camera axes, by the error state,
    are written into `pair.work.jacobian`.

    Args:
        pair: State of both feet.
        camera: Index in `FEET` of the foot that carries the camera.
        a: Past state of the foot with the camera.
        b: Past state of the other foot.

    Returns:
        Position, m; rotation, camera <- board.
    """
    board, G = 1 - camera, pair.work.jacobian  # board: index of the foot that carries it
    # a row of `mounts` is position (entries 0-2) and quaternion (3-6) in the foot's IMU
    mount_a, mount_b = pair.mounts[CAMERA + camera], pair.mounts[BOARD + board]
    R_c, R_m = to_matrix(quaternion_at(mount_a, 3)), to_matrix(quaternion_at(mount_b, 3))
    arm = matvec(b.R, vec3_at(mount_b, 0))  # from b's IMU to its board, world
    d = axpy(axpy(b.p, 1.0, arm), -1.0, a.p)  # from a's IMU to the board, world
    from_camera = axpy(matvec(transposed(a.R), d), -1.0, vec3_at(mount_a, 0))  # from a's camera to the board, a's IMU
    to_camera = transposed(matmul(a.R, R_c))  # camera <- world
    R_camera_a = transposed(R_c)  # camera <- a's IMU
    R_camera_b = matmul(to_camera, b.R)  # camera <- b's IMU

    clear(pair.work, 6)
    # derivatives of the board's position by the rotations of a and b, in world axes
    by_a, by_b = rows_cross(to_camera, d), scale_matrix(-1.0, rows_cross(to_camera, arm))
    _put_pose_columns(G, STATES * camera, scale_matrix(-1.0, to_camera), by_a, a)
    _put_pose_columns(G, STATES * board, to_camera, by_b, b)
    # derivatives of position and rotation by the camera's clock: velocity and angular rate of the board
    rates = axpy(matvec(by_a, a.rate), 1.0, matvec(by_b, b.rate))
    p_rate = axpy(matvec(to_camera, axpy(b.v, -1.0, a.v)), 1.0, rates)
    R_rate = matvec(to_camera, axpy(b.rate, -1.0, a.rate))
    for i in range(3):
        G[i, CLOCKS + camera], G[3 + i, CLOCKS + camera] = p_rate[i], R_rate[i]
    # derivatives by the two mounts; c and m are their first columns, position before rotation
    c, m = MOUNTS + 6 * (CAMERA + camera), MOUNTS + 6 * (BOARD + board)
    store_mat3_at(scale_matrix(-1.0, R_camera_a), G, 0, c)
    store_mat3_at(rows_cross(R_camera_a, from_camera), G, 0, c + 3)
    store_mat3_at(scale_matrix(-1.0, R_camera_a), G, 3, c + 3)
    store_mat3_at(R_camera_b, G, 0, m)
    store_mat3_at(R_camera_b, G, 3, m + 3)
    return matvec(R_camera_a, from_camera), matmul(R_camera_b, R_m)


@njit(**INNER_KERNEL)
def _put_pose_columns(G: Array, o: int, to_camera: Mat3, by_attitude: Mat3, past: PastState) -> None:
    """Writes a foot's columns of G: those of its past pose, in terms of its newest state (docs/foot_to_foot.md (3)).

    δθ_then = δθ + age R δb_g, and δp_then = δp - age δv + δθ × displacement: the force acts in the rotated direction.

    Args:
        G: (6, n) derivatives of the board's pose.
        o: First column of the foot.
        to_camera: (3, 3) derivative of the board's position by the foot's past position.
        by_attitude: (3, 3) derivative of it by the foot's past attitude.
        past: Past state of the foot.
    """
    by_displacement = rows_cross(to_camera, past.displacement)
    store_mat3_at(to_camera, G, 0, o + D_POSITION)
    store_mat3_at(scale_matrix(-past.age, to_camera), G, 0, o + D_VELOCITY)
    for i in range(3):
        store_vec3_at(axpy(by_attitude[i], -1.0, by_displacement[i]), G[i], o + D_ATTITUDE)
    store_mat3_at(scale_matrix(past.age, matmul(by_attitude, past.R)), G, 0, o + D_GYRO_BIAS)
    store_mat3_at(to_camera, G, 3, o + D_ATTITUDE)
    store_mat3_at(scale_matrix(past.age, matmul(to_camera, past.R)), G, 3, o + D_GYRO_BIAS)


@njit(**INNER_KERNEL)
def _linearise_rays(
    board: BoardWorkspace, p: Vec3, R: Mat3, m: int, points_in_board: Array, rays: Array, ray_sd: Array, rotated: float
) -> bool:
    """Linearises the rays about a pose of the board, docs/foot_to_foot.md (4), and compresses them to a triangle.

    Args:
        board: Workspace whose `triangle` (7, 7) is written: R of the QR decomposition of the (2M, 6) derivatives and
            the innovations, both in standard deviations.
        p: (3,) m, position of the board in the camera.
        R: Rotation, camera <- board.
        m: Number of points.
        points_in_board: (M, 3) m, points in the board's frame.
        rays: (M, 2) normalised image coordinates of the points, x right, y down.
        ray_sd: (M,) standard deviation of each coordinate.
        rotated: Variance common to all rays.

    Returns:
        Whether the board is in front of the camera.
    """
    row = board.row
    clear_block(board.triangle, 7)
    for i in range(m):
        arm = matvec(R, vec3_at(points_in_board[i], 0))  # from the board's origin to the point, camera axes
        x, y, depth = axpy(p, 1.0, arm)
        if not depth > _MIN_BOARD_DEPTH_M:
            return False
        x, y, sd = x / depth, y / depth, math.sqrt(ray_sd[i] ** 2 + rotated)
        scale = 1.0 / (depth * sd)
        for k in range(2):  # x and y of the ray; `row` is the derivative by position (0-2) and rotation (3-5)
            by_point = (scale, 0.0, -x * scale) if k == 0 else (0.0, scale, -y * scale)
            store_vec3_at(by_point, row, 0)
            store_vec3_at(cross(arm, by_point), row, 3)
            # innovation: measured minus predicted
            row[6] = (rays[i, k] - (x if k == 0 else y)) / sd
            _add_row(board.triangle, row)
    return True


@njit(**INNER_KERNEL)
def _add_row(triangle: Array, row: Array) -> None:
    """Adds a row to the R of a QR decomposition, by Givens rotations, in place.

    Args:
        triangle: (n, n) upper triangle R; afterwards RᵀR is larger by the outer product of the row with itself.
        row: (n,) the row, overwritten.
    """
    for k in range(len(row)):  # rotates row k of the triangle with the row, so that entry k of the row becomes 0
        size = math.sqrt(triangle[k, k] ** 2 + row[k] ** 2)
        if row[k] != 0.0 and size > 0.0:
            c, s = triangle[k, k] / size, row[k] / size
            for j in range(k, len(row)):
                above, below = triangle[k, j], row[j]
                triangle[k, j] = c * above + s * below
                row[j] = c * below - s * above


@njit(**INNER_KERNEL)
def sonar_update(
    pair: Pair, foot: KernelParameters, parameters: PairParameters, sonar: int, t_ns: int, distance: float
) -> float:
    """Update with the distance between a foot's sonar and the other foot, docs/foot_to_foot.md (9).

    The published system uses the positions alone. Here the attitudes at both ends enter too, and the sonar is used only
    if the other shoe has not been observed for `sonar_after_s`: an echo comes from some part of it, always with the
    same sign, so all within `observation_correlation_s` share one error. Most echoes of a real walk are from the floor
    or from things beyond: those too far from the predicted distance are rejected.

    Args:
        pair: State of both feet, changed in place.
        foot: Parameters of the foot with the sonar.
        parameters: Parameters of both feet.
        sonar: Index in `FEET` of the foot that carries the sonar.
        t_ns: Time of the echo.
        distance: Measured distance to the reflecting point of the other foot, m.

    Returns:
        Length of the innovation in standard deviations, or UNUSED.
    """
    since_s = (t_ns - max(pair.seen[0], pair.seen[1])) * 1e-9  # since the last board observation of either camera
    if not parameters.is_published and since_s < parameters.sonar_after_s:
        return UNUSED
    other, work = 1 - sonar, pair.work
    # states at the echo: a of the foot with the sonar, b of the other
    a = rewind(pair.feet[sonar], foot.gravity_mps2, t_ns, parameters.max_delay_s)
    b = rewind(pair.feet[other], foot.gravity_mps2, t_ns, parameters.max_delay_s)
    # from each IMU to the foot's sonar, world; that of the other foot is taken for the reflecting point
    arm_a, arm_b = matvec(a.R, vec3_at(pair.sonars[sonar], 0)), matvec(b.R, vec3_at(pair.sonars[other], 0))
    d = axpy(axpy(b.p, 1.0, arm_b), -1.0, axpy(a.p, 1.0, arm_a))  # from the sonar to the reflecting point, world, m
    size = math.sqrt(dot(d, d))
    if not (a.known and b.known and size > 0.0):
        return UNUSED
    zero_vector = 0.0, 0.0, 0.0
    direction = axpy(zero_vector, 1.0 / (size * parameters.range_sd_m), d)  # unit vector over the standard deviation
    clear(work, 1)
    h = work.jacobian[0]  # of the distance, in standard deviations, by the error states
    of_a, of_b = STATES * sonar, STATES * other  # first error states of both feet
    store_vec3_at(axpy(zero_vector, -1.0, direction), h, of_a + D_POSITION)
    store_vec3_at(direction, h, of_b + D_POSITION)
    if not parameters.is_published:
        store_vec3_at(cross(direction, arm_a), h, of_a + D_ATTITUDE)
        store_vec3_at(cross(arm_b, direction), h, of_b + D_ATTITUDE)
    work.innovation[0] = (distance - size) / parameters.range_sd_m
    spread_measurements(pair.covariance, work, 0, 1)
    length = innovation_norm(work, 1, 1.0)
    if parameters.is_published:
        used, variance = abs(distance - size) < _MAX_RANGE_MISFIT_M, 1.0
    else:
        # time that this echo counts for: all echoes within the correlation time together count as one
        echo_s = min(max((t_ns - pair.heard[sonar]) * 1e-9, 1e-3), parameters.observation_correlation_s)
        used, variance = length < parameters.range_gate, parameters.observation_correlation_s / echo_s
    if not used:
        return UNUSED
    pair.heard[sonar] = t_ns
    pair.nis[ECHOES, 0] += length**2
    pair.nis[ECHOES, 1] += 1.0
    correct(pair.covariance, pair.error, work.gain, 0, h, work.innovation[0], variance)
    inject_all(pair)
    return length
