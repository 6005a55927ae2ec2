"""Landmarks of the window: predicted observations, camera factors and outliers.

Camera factors do not depend on velocity or bias. Their equations, landmarks eliminated, therefore hold only the
calibration and six columns per frame pose, and are added to those of all states at the end.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.dvio import projection
from stridetwin.estimators.dvio.state import (
    CALIBRATION,
    D_FOCAL,
    D_SCALE,
    FRAME,
    NO_HOST,
    Calibration,
    FactorParameters,
    Frames,
    Landmarks,
    WindowState,
)
from stridetwin.streams.algebra.matrices import REORDERED, clear, clear_block, multiply, transposed
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

POSE = 6  # errors of a frame that the camera factors depend on: position and attitude
LEAST_INVERSE_DEPTH, MOST_INVERSE_DEPTH = 0.01, 10.0  # 1/m; limits of a landmark's inverse depth
_FRONT = 0.05  # least depth of a point in front of the camera, relative to the host's depth
_LOOSE = 1e-2  # m²; information on an unknown inverse depth: a standard deviation of 10/m
_FIXED = 1e12  # m²; on a fixed one


class CameraEquations(NamedTuple):
    """Normal equations of all camera factors, of M = 10 + 6 F columns, and what recovers the eliminated landmarks.

    Attributes:
        H: (M, M) of calibration and poses; the lower triangle counts.
        b: (M,) right-hand side.
        pairs: (F, 22, 24) sums per host and observing frame: products of the Jacobian's columns and, in column 22, with
            the residual.
        depth_information: (L,) h_ll: information on each landmark's inverse depth.
        b_depth: (L,) right-hand side of each inverse depth.
        cross: (L, M) h_l: between each inverse depth and calibration and poses.
        J: (3, 24) buffer for an observation's Jacobian and residual.
        J_depth: (3,) buffer for an observation's derivative by the inverse depth.
    """

    H: Array
    b: Array
    pairs: Array
    depth_information: Array
    b_depth: Array
    cross: Array
    J: Array
    J_depth: Array


def blank_camera_equations(frames: int, landmarks: int) -> CameraEquations:
    """Preallocated camera equations for F frames and L landmarks."""
    m = CALIBRATION + POSE * frames
    return CameraEquations(
        H=np.zeros((m, m)),
        b=np.zeros(m),
        pairs=np.zeros((frames, projection.OBSERVATION, projection.COLUMNS)),
        depth_information=np.zeros(landmarks),
        b_depth=np.zeros(landmarks),
        cross=np.zeros((landmarks, m)),
        J=np.zeros((3, projection.COLUMNS)),
        J_depth=np.zeros(3),
    )


@njit(fastmath=REORDERED, error_model="numpy", **INNER_KERNEL)
def _add_landmark(
    frames: Frames,
    marks: Landmarks,
    calibration: Calibration,
    factors: FactorParameters,
    views: projection.Views,
    s: CameraEquations,
    l: int,
    last: int,
    host_depth: bool,
) -> float:
    """Adds the observations and measured depths of landmark `l` in frames up to `last`; returns their cost.

    Residuals of docs/dvio.md (7)-(9) with Huber weights; docs/dvio.md (8) only if `host_depth`. Writes the landmark's
    row of `cross`, `depth_information` and `b_depth`, and adds the products of each observing frame to `pairs`.

    Args:
        frames: States of the frames.
        marks: Landmarks with their observations.
        calibration: Estimated calibration.
        factors: Weights, and which depths are used.
        views: Relative poses of the cameras.
        s: Camera equations, changed in place.
        l: Index of the landmark.
        last: Newest frame that counts.
        host_depth: Whether the depth that the host measured is a factor; without effect if depths are fixed.
    """
    # J: (3, 24) derivatives of (x, y, inverse depth) by calibration, host's and observer's pose, then the residual;
    # Jl: (3,) those by the landmark's inverse depth ξ; at: (F, 2) its observations
    J, Jl, at = s.J, s.J_depth, marks.at[l]
    host, xi, scale = marks.host[l], marks.inverse_depth[l], calibration.scale[0]
    x, y = projection.to_ray(calibration, at[host, 0], at[host, 1])
    cross = s.cross[l]  # of this landmark with calibration and poses
    clear(cross)
    # h_ll, b_l and the cost so far; the first begins with a little information, so that it can be inverted
    depth_information, b_depth, cost = _LOOSE, 0.0, 0.0
    rho = marks.rho[l, host]
    if rho > 0.0:
        # measured depth of the host: r = s ξ - ρ_i, docs/dvio.md (8)
        if factors.depth_fixed:
            depth_information += _FIXED
        elif host_depth:
            # The scale applies to the landmark; on the measurement it would lower the cost by shrinking the noise.
            r = scale * xi - rho
            c, w = projection.huber(r * r * factors.depth_weight, factors.huber_sd)
            w *= factors.depth_weight
            cost += c
            depth_information += w * scale * scale
            b_depth -= w * scale * r
            cross[D_SCALE] += w * scale * xi
            s.H[D_SCALE, D_SCALE] += w * xi * xi
            s.b[D_SCALE] -= w * xi * r
    first = CALIBRATION + POSE * host  # first column of the host's pose
    for j in range(last + 1):  # frames that observe the landmark
        if j == host or not marks.seen[l, j]:
            continue
        # where the landmark should be in frame j, its inverse depth there, and whether it is in front of the camera
        px, py, inverse_depth, in_front = projection.project(
            views.rotation[host, j], views.translation[host, j], x, y, xi, projection.LEAST_DEPTH
        )
        if not in_front or not projection.observation_jacobian(frames, calibration, views, host, j, x, y, xi, J, Jl):
            continue
        u, v = projection.to_ray(calibration, at[j, 0], at[j, 1])
        # residuals of image and inverse depth, docs/dvio.md (7); the last has no weight w2 unless a depth is measured
        r0, r1, r2, w2 = px - u, py - v, 0.0, 0.0
        # the focal lengths change the observation (u, v), too
        J[0, D_FOCAL] -= at[j, 0]
        J[1, D_FOCAL + 1] -= at[j, 1]
        c, w0 = projection.huber((r0 * r0 + r1 * r1) * factors.pixel_weight, factors.huber_sd)
        w0 *= factors.pixel_weight
        cost += c
        rho = marks.rho[l, j]
        if factors.projection_depth and rho > 0.0:
            r2 = scale * inverse_depth - rho  # docs/dvio.md (9)
            c, w = projection.huber(r2 * r2 * factors.later_depth_weight, factors.huber_sd)
            w2 = w * factors.later_depth_weight
            cost += c
            for i in range(projection.OBSERVATION):
                J[2, i] *= scale
            Jl[2] *= scale
            J[2, D_SCALE] = inverse_depth
        J[0, projection.RESIDUAL] = r0
        J[1, projection.RESIDUAL] = r1
        J[2, projection.RESIDUAL] = r2
        depth_information += w0 * (Jl[0] * Jl[0] + Jl[1] * Jl[1]) + w2 * Jl[2] * Jl[2]
        b_depth -= w0 * (Jl[0] * r0 + Jl[1] * r1) + w2 * Jl[2] * r2
        # Jᵀ W J and, in column `RESIDUAL`, Jᵀ W r, for the weights W = (w0, w0, w2)
        pair = s.pairs[j]
        for a in range(projection.OBSERVATION):
            v0, v1, v2 = w0 * J[0, a], w0 * J[1, a], w2 * J[2, a]
            for e in range(projection.COLUMNS):
                pair[a, e] += v0 * J[0, e] + v1 * J[1, e] + v2 * J[2, e]
        l0, l1, l2 = w0 * Jl[0], w0 * Jl[1], w2 * Jl[2]
        second = CALIBRATION + POSE * j  # first column of the observer's pose
        for a in range(CALIBRATION):
            cross[a] += l0 * J[0, a] + l1 * J[1, a] + l2 * J[2, a]
        for a in range(POSE):
            i, k = projection.HOST + a, projection.OBSERVER + a
            cross[first + a] += l0 * J[0, i] + l1 * J[1, i] + l2 * J[2, i]
            cross[second + a] += l0 * J[0, k] + l1 * J[1, k] + l2 * J[2, k]
    s.depth_information[l] = depth_information
    s.b_depth[l] = b_depth
    return cost


@njit(fastmath=REORDERED, error_model="numpy", **INNER_KERNEL)
def _eliminate(s: CameraEquations, l: int, host: int, seen: NDArray[np.uint8], last: int) -> None:
    """Eliminates a landmark from the camera equations H and b.

    H -= h_l h_lᵀ / h_ll and b -= h_l b_l / h_ll, the first part of docs/dvio.md (11), for h_l = `cross`, h_ll =
    `depth_information` and b_l = `b_depth` of the landmark.

    Args:
        s: Camera equations, changed in place.
        l: Index of the landmark.
        host: Slot of its host.
        seen: (F,) 1 where a frame observes it; the landmark is linked to these, its host and the calibration alone.
        last: Newest frame that counts.
    """
    cross, variance = s.cross[l], 1.0 / s.depth_information[l]  # 1 / h_ll
    for k in range(-1, last + 1):  # -1 is the calibration
        if k >= 0 and k != host and not seen[k]:
            continue
        start = 0 if k < 0 else CALIBRATION + POSE * k
        end = CALIBRATION + POSE * (k + 1)
        for i in range(start, end):
            f = cross[i] * variance  # entry of h_l / h_ll
            s.b[i] -= f * s.b_depth[l]
            row = s.H[i]
            for e in range(end):
                row[e] -= f * cross[e]


@njit(error_model="numpy", **INNER_KERNEL)
def _add_host_sums(s: CameraEquations, host: int, last: int) -> None:
    """Adds the sums `pairs` of the landmarks that one frame hosts to the camera equations H and b.

    Row a of a pair is of the calibration (0-9), the host's pose (10-15) or the observing frame's pose (16-21); it goes
    to the row of that state in H. Frames up to `last` count.
    """
    first = CALIBRATION + POSE * host  # row of the host's pose in H
    for j in range(host + 1, last + 1):
        pair, second = s.pairs[j], CALIBRATION + POSE * j  # second: row of the observing frame's pose
        for a in range(projection.OBSERVATION):
            i = a  # row of H
            if a >= projection.HOST:
                i = first + a - projection.HOST
            if a >= projection.OBSERVER:
                i = second + a - projection.OBSERVER
            s.b[i] -= pair[a, projection.RESIDUAL]
            row = s.H[i]
            for e in range(CALIBRATION):
                row[e] += pair[a, e]
            # a host is older than its observing frames, so this fills the lower triangle, and full diagonal blocks
            if a >= projection.HOST:
                for e in range(POSE):
                    row[first + e] += pair[a, projection.HOST + e]
            if a >= projection.OBSERVER:
                for e in range(POSE):
                    row[second + e] += pair[a, projection.OBSERVER + e]


@njit(error_model="numpy", **INNER_KERNEL)
def is_usable(marks: Landmarks, l: int, last: int) -> bool:
    """Whether landmark `l` has a host and is observed by another frame, both among the frames up to `last`."""
    host = marks.host[l]
    if host == NO_HOST or host > last:
        return False
    j = 0  # becomes the first observing frame beside the host, or last + 1 without any
    while j <= last and (j == host or not marks.seen[l, j]):
        j += 1
    return j <= last


@njit(error_model="numpy", **INNER_KERNEL)
def add_camera_factors(
    window: WindowState,
    factors: FactorParameters,
    views: projection.Views,
    s: CameraEquations,
    hosts: int,
    last: int,
    host_depth: bool,
    H: Array,
    b: Array,
) -> float:
    """Adds all camera factors of the landmarks of the oldest `hosts` frames and eliminates these; returns the cost.

    Args:
        window: Frames, landmarks and calibration.
        factors: Weights, and which depths are used.
        views: Relative poses of the cameras, up to date.
        s: Camera equations, overwritten.
        hosts: Number of frames, from the oldest, whose landmarks are added.
        last: Newest frame whose observations are used.
        host_depth: Whether the measured depths of the hosts, docs/dvio.md (8), are factors.
        H: (N, N) normal equations of all states, changed in place; the lower triangle counts.
        b: (N,) right-hand side, changed in place.
    """
    frames, marks, calibration = window.frames, window.landmarks, window.calibration
    m, cost, pairs = CALIBRATION + POSE * (last + 1), 0.0, s.pairs  # m: columns of the camera equations in use
    clear_block(s.H, m)
    clear(s.b)
    for host in range(hosts):
        for j in range(last + 1):
            for a in range(projection.OBSERVATION):
                clear(pairs[j, a])
        for l in range(marks.host.shape[0]):
            if marks.host[l] == host and is_usable(marks, l, last):
                cost += _add_landmark(frames, marks, calibration, factors, views, s, l, last, host_depth)
                _eliminate(s, l, host, marks.seen[l], last)
        _add_host_sums(s, host, last)
    # The six columns per pose become the first six of the frame's fifteen.
    for i in range(m):
        row, camera_row = H[state_index(i)], s.H[i]
        b[state_index(i)] += s.b[i]
        for e in range(CALIBRATION):
            row[e] += camera_row[e]
        for k in range(last + 1):
            o, q = CALIBRATION + FRAME * k, CALIBRATION + POSE * k  # first column of frame k in H, and in `s.H`
            for e in range(POSE):
                row[o + e] += camera_row[q + e]
    return cost


@njit(error_model="numpy", **INNER_KERNEL)
def state_index(i: int) -> int:
    """Index among all states of the i-th column of the camera equations (calibration, then six per pose)."""
    if i < CALIBRATION:
        return i
    return CALIBRATION + FRAME * ((i - CALIBRATION) // POSE) + (i - CALIBRATION) % POSE


@njit(error_model="numpy", **INNER_KERNEL)
def predict_observations(
    window: WindowState,
    R: Array,
    p: Array,
    before: int,
    expected: Array,
    start: Array,
    warp: Array,
    known: NDArray[np.uint8],
) -> None:
    """Predicts the observations of the landmarks from a pose, and from the earlier frame in slot `before`.

    Args:
        window: Frames, landmarks and calibration.
        R: (3, 3) world <- IMU at the new image.
        p: (3,) position of the IMU at the new image, m.
        before: Slot of the earlier frame.
        expected: (L, 3) out: x and y on the plane at depth 1 by the nominal intrinsics, and inverse depth.
        start: (L, 2) out: x and y in the frame `before`.
        warp: (L, 2, 2) out: affine map from the host's image about the landmark to the new one.
        known: (L,) out: 1 where the landmark is in front of the camera in both; elsewhere nothing else is written.
    """
    frames, marks, c = window.frames, window.landmarks, window.calibration
    n = frames.count[0]
    # cameras of the n frames, and as the last one that of the new image
    R_camera, p_camera = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    for k in range(n):
        R_host, p_host = projection.pose_at_exposure(frames, k, c.offset[0])
        projection.set_camera(R_host, p_host, c, R_camera[k], p_camera[k])
    projection.set_camera(R, p, c, R_camera[n], p_camera[n])
    # rotation and translation from each frame's camera to the new camera, and to that of the frame `before`
    A, t, A_before, t_before = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3))
    for k in range(n):
        projection.set_relative(transposed(R_camera[n]), p_camera[n], R_camera[k], p_camera[k], A[k], t[k])
        C_before = transposed(R_camera[before])
        projection.set_relative(C_before, p_camera[before], R_camera[k], p_camera[k], A_before[k], t_before[k])
    for l in range(marks.host.shape[0]):
        h, xi = marks.host[l], marks.inverse_depth[l]
        known[l] = 0
        if h == NO_HOST:
            continue
        x, y = projection.to_ray(c, marks.at[l, h, 0], marks.at[l, h, 1])
        u, v, inverse_depth, in_front = projection.project(A[h], t[h], x, y, xi, _FRONT)  # in the new camera
        u_before, v_before, _, was_in_front = projection.project(A_before[h], t_before[h], x, y, xi, _FRONT)
        if not (in_front and was_in_front):
            continue
        known[l] = 1
        # observations are by the nominal focal lengths, u and v by the estimated ones
        expected[l, 0], expected[l, 1] = u / (1.0 + c.focal[0]), v / (1.0 + c.focal[1])
        expected[l, 2] = inverse_depth
        start[l, 0], start[l, 1] = u_before / (1.0 + c.focal[0]), v_before / (1.0 + c.focal[1])
        # derivative of (u, v) by the host's (x, y) on the landmark's plane, where ξ changes by `slope`
        for j in range(2):
            slope = marks.slope[l, j]
            by_depth = A[h, 2, j] + t[h, 2] * slope
            warp[l, 0, j] = (A[h, 0, j] + t[h, 0] * slope - u * by_depth) * inverse_depth / xi
            warp[l, 1, j] = (A[h, 1, j] + t[h, 1] * slope - v * by_depth) * inverse_depth / xi


@njit(error_model="numpy", **INNER_KERNEL)
def cull(
    marks: Landmarks,
    c: Calibration,
    factors: FactorParameters,
    views: projection.Views,
    n: int,
    most: float,
    alive: NDArray[np.uint8],
) -> int:
    """Removes observations with a residual beyond `most` standard deviations, in the first `n` frames.

    A landmark that is an outlier in the newest frame is dropped. An outlying measured depth is removed without its
    observation.

    Args:
        marks: Landmarks, changed in place.
        c: Estimated calibration.
        factors: Weights of the observations, and whether later depths are used.
        views: Relative poses of the cameras, up to date.
        n: Number of frames; the last of them is the newest.
        most: Largest residual, in standard deviations.
        alive: (L,) becomes 0 where a landmark is an outlier in the newest frame.

    Returns:
        Number of remaining observations in the newest frame.
    """
    scale, remaining = c.scale[0], 0
    for l in range(marks.host.shape[0]):
        h = marks.host[l]
        if h == NO_HOST:
            continue
        at, seen, rho = marks.at[l], marks.seen[l], marks.rho[l]
        x, y = projection.to_ray(c, at[h, 0], at[h, 1])
        for j in range(n):
            if j == h or not seen[j]:
                continue
            A, t = views.rotation[h, j], views.translation[h, j]
            # position in frame j, inverse depth there, and whether the landmark is in front of the camera
            px, py, inverse_depth, in_front = projection.project(
                A, t, x, y, marks.inverse_depth[l], projection.LEAST_DEPTH
            )
            off = math.inf  # squared residual in variances; infinite behind the camera
            if in_front:
                u, v = projection.to_ray(c, at[j, 0], at[j, 1])
                off = ((px - u) ** 2 + (py - v) ** 2) * factors.pixel_weight
            if off > most * most:
                seen[j] = 0
                if j == n - 1:
                    alive[l] = 0
                continue
            if rho[j] > 0.0 and factors.projection_depth:
                r = scale * inverse_depth - rho[j]
                if r * r * factors.later_depth_weight > most * most:
                    rho[j] = 0.0
            if j == n - 1:
                remaining += 1
    return remaining


def rehost(marks: Landmarks, c: Calibration, views: projection.Views, alive: NDArray[np.uint8], newest: int) -> None:
    """Moves the landmarks that the oldest frame hosts to the newest frame if it observes them, else drops them.

    Used at marginalisation: observations of these landmarks by the newest frame are not part of the prior, so that each
    counts once. The inverse depth in the newest camera is measured, or ξ / q_z of docs/dvio.md (6).

    Args:
        marks: Landmarks, changed in place.
        c: Estimated calibration.
        views: Relative poses of the cameras, up to date.
        alive: (L,) 1 where a landmark is tracked; others are dropped.
        newest: Slot of the newest frame; the oldest is in slot 0.
    """
    hosted = np.flatnonzero(marks.host == 0)
    rehosted = hosted[(alive[hosted] > 0) & (marks.seen[hosted, newest] > 0)]
    # measured inverse depth in the newest frame, 0 where none; estimated one in the oldest
    rho, xi = marks.rho[rehosted, newest], marks.inverse_depth[rehosted]
    # q_z: depth in the newest camera over that in the oldest
    relative_depth = projection.directions(marks.at[rehosted, 0] * (1.0 + c.focal)) @ views.rotation[0, newest, 2]
    relative_depth += xi * views.translation[0, newest, 2]
    predicted = np.maximum(xi / np.maximum(relative_depth, projection.LEAST_DEPTH), LEAST_INVERSE_DEPTH)
    # a landmark behind the newest camera keeps its inverse depth
    predicted = np.where(relative_depth < projection.LEAST_DEPTH, xi, predicted)
    marks.inverse_depth[rehosted] = np.where(rho > 0.0, rho / c.scale, predicted)
    marks.measured[rehosted[rho > 0.0]] = 1
    marks.host[hosted], marks.seen[hosted] = NO_HOST, 0
    marks.host[rehosted], marks.seen[rehosted, newest] = newest, 1


@njit(error_model="numpy", **INNER_KERNEL)
def parallax(window: WindowState, newest: int, since: int) -> tuple[float, int]:
    """Mean image motion of points between two frames with their rotation removed, and the number of points.

    The motion is on the plane at depth 1 (multiply by the focal length for pixels); 0 without points. `newest` and
    `since` are the slots of the two frames.
    """
    # At inverse depth 0 a point moves by the rotation A alone; the rest of its motion is by translation.
    f, marks, R_camera = window.frames, window.landmarks, window.calibration.R
    A = multiply(transposed(R_camera), multiply(multiply(transposed(f.R[newest]), f.R[since]), R_camera))
    total, count, no_translation = 0.0, 0, np.zeros(3)
    for l in range(marks.host.shape[0]):
        if marks.host[l] == NO_HOST or not (marks.seen[l, newest] and marks.seen[l, since]):
            continue
        u, v, _, in_front = projection.project(
            A, no_translation, marks.at[l, since, 0], marks.at[l, since, 1], 0.0, _FRONT
        )
        if in_front:
            total += math.hypot(u - marks.at[l, newest, 0], v - marks.at[l, newest, 1])
            count += 1
    return (total / count if count else 0.0), count
