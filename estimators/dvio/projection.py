"""Camera projection: a landmark's image position, its residuals and their Jacobians."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from stridetwin.estimators.dvio.state import CALIBRATION, D_FOCAL, D_OFFSET, D_SCALE, Calibration, Frames
from stridetwin.streams.algebra.matrices import apply, copy, copy_matrix, empty_vec3, exp, multiply, transposed
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

# An observation's Jacobian has columns of the calibration (0-9), then of the host's pose (10-15), then of the observing
# frame's (16-21). Column 22 is the residual, and column 23 pads to the width of the vector units.
HOST, OBSERVER, OBSERVATION = CALIBRATION, CALIBRATION + 6, CALIBRATION + 12
RESIDUAL, COLUMNS = OBSERVATION, OBSERVATION + 2
LEAST_DEPTH = 1e-3  # least depth of a point in front of the camera, relative to the host's depth


class Views(NamedTuple):
    """Relative poses of the window's cameras, at the current states and at those where Jacobians are taken.

    A host is older than the frames that observe its landmarks ("observers"), so entry [i, j] has i < j.

    Attributes:
        rotation: (F, F, 3, 3) observer's camera <- host's camera.
        translation: (F, F, 3) position of the host's camera in the observer's, m.
        rotation_first: (F, F, 3, 3) as `rotation`, at the linearisation states.
        translation_first: (F, F, 3) as `translation`, at the linearisation states.
        C: (F, 3, 3) camera <- world, at the linearisation states.
        CR: (F, F, 3, 3) observer's camera <- host's IMU, at the linearisation states.
    """

    rotation: Array
    translation: Array
    rotation_first: Array
    translation_first: Array
    C: Array
    CR: Array


def blank_views(frames: int) -> Views:
    """Preallocated views of F frames; `update_views` fills them."""
    F = frames
    pair, vector = (F, F, 3, 3), (F, F, 3)
    return Views(
        rotation=np.zeros(pair),
        translation=np.zeros(vector),
        rotation_first=np.zeros(pair),
        translation_first=np.zeros(vector),
        C=np.zeros((F, 3, 3)),
        CR=np.zeros(pair),
    )


def directions(at: Array) -> Array:
    """(..., 3) rays (x, y, 1) of points (..., 2) on the plane at depth 1."""
    return np.concatenate([at, np.ones((*at.shape[:-1], 1))], axis=-1)


@njit(error_model="numpy", **INNER_KERNEL)
def pose_at_exposure(frames: Frames, k: int, offset: float) -> tuple[Array, Array]:
    """Pose of the IMU when the image of the frame in slot `k` was taken, by the present time offset (s).

    The frame's state is of the time that an earlier estimate of the offset gave (`frames.offset`). By the difference of
    the two offsets it moves on at its velocity and angular rate: docs/dvio.md (5).

    Returns:
        (3, 3) rotation, world <- IMU, and (3,) position, m.
    """
    late = offset - frames.offset[k]
    p, rotation = empty_vec3(), empty_vec3()
    for i in range(3):
        p[i] = frames.p[k, i] + frames.v[k, i] * late
        rotation[i] = frames.rate[k, i] * late
    return multiply(frames.R[k], exp(rotation)), p


@njit(error_model="numpy", **INNER_KERNEL)
def set_camera(R: Array, p: Array, c: Calibration, R_camera: Array, p_camera: Array) -> None:
    """Writes the pose of the camera in the world, for a pose of the IMU: R R_c and p + R p_c.

    Args:
        R: (3, 3) rotation, world <- IMU.
        p: (3,) position of the IMU, m.
        c: Calibration with the camera's mount R_c, p_c on the IMU.
        R_camera: (3, 3) out: rotation, world <- camera.
        p_camera: (3,) out: position of the camera, m.
    """
    copy_matrix(multiply(R, c.R), R_camera)
    offset = apply(R, c.p)  # from the IMU to the camera, in the world's axes
    for i in range(3):
        p_camera[i] = p[i] + offset[i]


@njit(error_model="numpy", **INNER_KERNEL)
def set_relative(C: Array, p: Array, R_host: Array, p_host: Array, rotation: Array, translation: Array) -> None:
    """Writes the pose of a host's camera in an observer's camera: rotation C R_host, translation C (p_host − p).

    Args:
        C: (3, 3) rotation, observer's camera <- world.
        p: (3,) position of the observer's camera in the world, m.
        R_host: (3, 3) rotation, world <- host's camera.
        p_host: (3,) position of the host's camera in the world, m.
        rotation: (3, 3) out: observer's camera <- host's camera.
        translation: (3,) out: position of the host's camera in the observer's, m.
    """
    away = empty_vec3()
    for i in range(3):
        away[i] = p_host[i] - p[i]
    copy_matrix(multiply(C, R_host), rotation)
    copy(apply(C, away), translation)


@njit(error_model="numpy", **INNER_KERNEL)
def update_views(frames: Frames, c: Calibration, first_estimates: bool, views: Views) -> None:
    """Fills the views of all frames in use, each at the exposure of its image.

    Args:
        frames: States of the frames.
        c: Estimated calibration.
        first_estimates: Whether Jacobians of frames in the prior are taken at their first estimates.
        views: Overwritten.
    """
    n = frames.count[0]
    # cameras in the world by the present states, and by those where Jacobians are taken
    R, p, R_first, p_first = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3))
    R_imu = np.empty((n, 3, 3))  # world <- IMU, where Jacobians are taken
    for k in range(n):
        R_k, p_k = pose_at_exposure(frames, k, c.offset[0])
        set_camera(R_k, p_k, c, R[k], p[k])
        if first_estimates and frames.in_prior[k]:
            R_k, p_k = frames.R_first[k], frames.p_first[k]
        copy_matrix(R_k, R_imu[k])
        set_camera(R_k, p_k, c, R_first[k], p_first[k])
        copy_matrix(transposed(R_first[k]), views.C[k])
    for j in range(1, n):  # observers, each after its hosts i
        C, C_first = transposed(R[j]), views.C[j]  # camera <- world
        for i in range(j):
            set_relative(C, p[j], R[i], p[i], views.rotation[i, j], views.translation[i, j])
            set_relative(
                C_first, p_first[j], R_first[i], p_first[i], views.rotation_first[i, j], views.translation_first[i, j]
            )
            copy_matrix(multiply(C_first, R_imu[i]), views.CR[i, j])


@njit(error_model="numpy", **INNER_KERNEL)
def to_ray(calibration: Calibration, x: float, y: float) -> tuple[float, float]:
    """Corrects an observation (x, y) on the plane at depth 1 for the estimated error of the focal lengths.

    The argument is by the nominal focal lengths; `calibration.focal` holds the relative corrections of x and y.
    """
    return x * (1.0 + calibration.focal[0]), y * (1.0 + calibration.focal[1])


@njit(error_model="numpy", **INNER_KERNEL)
def project(
    A: Array, s: Array, x: float, y: float, inverse_depth: float, least: float
) -> tuple[float, float, float, bool]:
    """Projects a landmark along (x, y, 1) in its host's camera into an observer's camera: docs/dvio.md (6).

    q = A (x, y, 1) + ξ s is the point times its inverse depth ξ in the host, in the observer's axes.

    Args:
        A: (3, 3) rotation of `Views` from the host to the observer.
        s: (3,) translation of `Views`, m.
        x: First coordinate of the ray on the host's plane at depth 1.
        y: Second coordinate of that ray.
        inverse_depth: ξ, 1/m.
        least: Smallest depth in the observer, as a share of the depth in the host, of a point in front of the camera.

    Returns:
        x and y on the plane at depth 1 of the observer, the inverse depth there, and whether the point is in front of
        the observer's camera. If it is not, the three numbers are q and must not be used.
    """
    q0 = A[0, 0] * x + A[0, 1] * y + A[0, 2] + inverse_depth * s[0]
    q1 = A[1, 0] * x + A[1, 1] * y + A[1, 2] + inverse_depth * s[1]
    q2 = A[2, 0] * x + A[2, 1] * y + A[2, 2] + inverse_depth * s[2]
    if q2 < least:
        return q0, q1, q2, False
    return q0 / q2, q1 / q2, inverse_depth / q2, True


@njit(error_model="numpy", **INNER_KERNEL)
def observation_jacobian(
    frames: Frames,
    c: Calibration,
    views: Views,
    host: int,
    observer: int,
    x: float,
    y: float,
    inverse_depth: float,
    J: Array,
    Jl: Array,
) -> bool:
    """Derivatives of a landmark's x, y and inverse depth in an observer's camera, at the linearisation states.

    They are those of `project`, docs/dvio.md (6). Every product is written out, because this runs a thousand times per
    image and allocation is slow.

    Args:
        frames: Velocities and rates, for the derivative by the time offset.
        c: Estimated calibration.
        views: Relative poses of the cameras, from `update_views`.
        host: Slot of the host.
        observer: Slot of the observer.
        x: First coordinate of the ray on the host's plane at depth 1.
        y: Second coordinate of that ray.
        inverse_depth: ξ, 1/m.
        J: (3, ≥ 22) out: of (x, y, inverse depth) by the calibration (columns 0-9: 0-2 position and 3-5 rotation of the
            mount, 6 time offset, 7 depth scale, 8-9 focal lengths), the host's pose (10-15) and the observer's (16-21).
        Jl: (3,) out: by the inverse depth.

    Returns:
        False, and nothing is written, if the landmark is not in front of the camera.
    """
    # q: the point times its inverse depth, in the observer's camera
    A, s = views.rotation_first[host, observer], views.translation_first[host, observer]
    q0 = A[0, 0] * x + A[0, 1] * y + A[0, 2] + inverse_depth * s[0]
    q1 = A[1, 0] * x + A[1, 1] * y + A[1, 2] + inverse_depth * s[1]
    q2 = A[2, 0] * x + A[2, 1] * y + A[2, 2] + inverse_depth * s[2]
    if q2 < LEAST_DEPTH:
        return False
    C, CR, R, p, xi = views.C[observer], views.CR[host, observer], c.R, c.p, inverse_depth
    # h: the point times its inverse depth, in the host's IMU axes
    h0 = R[0, 0] * x + R[0, 1] * y + R[0, 2] + xi * p[0]
    h1 = R[1, 0] * x + R[1, 1] * y + R[1, 2] + xi * p[1]
    h2 = R[2, 0] * x + R[2, 1] * y + R[2, 2] + xi * p[2]
    # In the observer's IMU: z = Rc q + ξ p; Rcᵀ [z]x = [u]x Rcᵀ with u = q + ξ Rcᵀ p
    u0 = q0 + xi * (R[0, 0] * p[0] + R[1, 0] * p[1] + R[2, 0] * p[2])
    u1 = q1 + xi * (R[0, 1] * p[0] + R[1, 1] * p[1] + R[2, 1] * p[2])
    u2 = q2 + xi * (R[0, 2] * p[0] + R[1, 2] * p[1] + R[2, 2] * p[2])
    a, b = HOST, OBSERVER  # first columns of the two poses
    for i in range(3):  # of the point times its inverse depth, in the observer's camera
        for j in range(3):
            J[i, j] = xi * (CR[i, j] - R[j, i])
            J[i, a + j] = xi * C[i, j]
            J[i, b + j] = -xi * C[i, j]
        # -A [m]x, to which [q]x is added, and -CR [h]x
        J[i, 3] = A[i, 2] * y - A[i, 1]
        J[i, 4] = A[i, 0] - A[i, 2] * x
        J[i, 5] = A[i, 1] * x - A[i, 0] * y
        J[i, a + 3] = CR[i, 2] * h1 - CR[i, 1] * h2
        J[i, a + 4] = CR[i, 0] * h2 - CR[i, 2] * h0
        J[i, a + 5] = CR[i, 1] * h0 - CR[i, 0] * h1
        J[i, D_FOCAL] = A[i, 0] * x / (1.0 + c.focal[0])
        J[i, D_FOCAL + 1] = A[i, 1] * y / (1.0 + c.focal[1])
    J[0, 4] -= q2
    J[0, 5] += q1
    J[1, 3] += q2
    J[1, 5] -= q0
    J[2, 3] -= q1
    J[2, 4] += q0
    for j in range(3):
        J[0, b + 3 + j] = u1 * R[j, 2] - u2 * R[j, 1]
        J[1, b + 3 + j] = u2 * R[j, 0] - u0 * R[j, 2]
        J[2, b + 3 + j] = u0 * R[j, 1] - u1 * R[j, 0]
    # A later exposure moves both poses by their velocities and rates.
    for i in range(3):
        late = 0.0
        for j in range(3):
            late += J[i, a + j] * frames.v[host, j] + J[i, a + 3 + j] * frames.rate[host, j]
            late += J[i, b + j] * frames.v[observer, j] + J[i, b + 3 + j] * frames.rate[observer, j]
        J[i, D_OFFSET] = late
        J[i, D_SCALE] = 0.0
    # from the derivatives of q to those of (q_x / q_z, q_y / q_z, ξ / q_z)
    w = 1.0 / q2
    px, py, pz = q0 * w, q1 * w, xi * w
    for j in range(OBSERVATION):
        g = J[2, j] * w
        J[0, j] = J[0, j] * w - px * g
        J[1, j] = J[1, j] * w - py * g
        J[2, j] = -pz * g
    Jl[0] = (s[0] - px * s[2]) * w
    Jl[1] = (s[1] - py * s[2]) * w
    Jl[2] = (1.0 - pz * s[2]) * w
    return True


@njit(error_model="numpy", **INNER_KERNEL)
def huber(squared: float, limit: float) -> tuple[float, float]:
    """Huber cost and weight of a squared residual in variances.

    Up to `limit` standard deviations the cost is half the square and the weight is 1; beyond, the cost grows linearly
    and the weight decreases.
    """
    if squared <= limit * limit:
        return 0.5 * squared, 1.0
    size = math.sqrt(squared)
    return limit * (size - 0.5 * limit), limit / size
