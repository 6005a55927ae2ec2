"""Predicted landmark observations of a new frame, and outlier removal."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.dvio.algebra import mul, rotate, rotate_back
from stridetwin.estimators.dvio.planes import cull_planes
from stridetwin.estimators.dvio.projection import at_exposure, project, ray, view
from stridetwin.estimators.dvio.solver import Work
from stridetwin.estimators.dvio.state import NO_HOST, Calibration, FactorParameters, Window
from stridetwin.streams.samples import Array


@njit(error_model="numpy", **INSIDE)
def _between(R: Array, p: Array, Rh: Array, ph: Array, c: Calibration) -> tuple[Array, Array]:
    """Camera at IMU pose (Rh, ph) to camera at IMU pose (R, p): (3, 3) rotation and (3,) translation, m."""
    Rc = np.ascontiguousarray(c.R.T)
    M = mul(np.ascontiguousarray(R.T), Rh)
    return mul(Rc, mul(M, c.R)), rotate(Rc, rotate(M, c.p) + rotate_back(R, ph - p) - c.p)


@njit(error_model="numpy", **INSIDE)
def predict_observations(
    window: Window,
    R: Array,
    p: Array,
    before: int,
    expected: Array,
    start: Array,
    warp: Array,
    known: NDArray[np.uint8],
) -> None:
    """Predicts landmark observations from a pose and from an earlier frame.

    Args:
        window: Frames, landmarks, calibration.
        R: (3, 3) world <- IMU.
        p: (3,) m.
        before: Slot of the frame.
        expected: (L, 3) out: x and y on the plane at depth 1 by the nominal intrinsics, and inverse depth.
        start: (L, 3) out: the same in the frame `before`.
        warp: (L, 2, 2) out: affine map from the host's image about the landmark to the new one.
        known: (L,) out: 1 where the landmark is in front of the camera in both.
    """
    marks, c, f = window.landmarks, window.calibration, window.frames
    n = f.count[0]
    Rb, pb = at_exposure(f, before, c.offset[0])
    rotation, translation = np.empty((n, 2, 3, 3)), np.empty((n, 2, 3))
    for k in range(n):
        Rh, ph = at_exposure(f, k, c.offset[0])
        rotation[k, 0], translation[k, 0] = _between(R, p, Rh, ph, c)
        rotation[k, 1], translation[k, 1] = _between(Rb, pb, Rh, ph, c)
    for l in range(len(marks.host)):
        known[l] = 0
        h = marks.host[l]
        if h == NO_HOST:
            continue
        x, y = ray(c, marks.at[l, h])
        xi, m = marks.inverse_depth[l], np.array([x, y, 1.0])
        q = rotate(rotation[h, 0], m) + xi * translation[h, 0]
        s = rotate(rotation[h, 1], m) + xi * translation[h, 1]
        if q[2] < 0.05 or s[2] < 0.05:
            continue
        u, v = 1.0 + c.focal[0], 1.0 + c.focal[1]
        expected[l, 0], expected[l, 1], expected[l, 2] = q[0] / q[2] / u, q[1] / q[2] / v, xi / q[2]
        start[l, 0], start[l, 1], start[l, 2] = s[0] / s[2] / u, s[1] / s[2] / v, xi / s[2]
        for j in range(2):
            by = rotation[h, 0, :, j] + translation[h, 0] * marks.slope[l, j]
            for i in range(2):
                warp[l, i, j] = (by[i] - q[i] / q[2] * by[2]) / q[2]
        known[l] = 1


@njit(error_model="numpy", **INSIDE)
def cull(window: Window, factors: FactorParameters, work: Work, most: float, alive: NDArray[np.uint8]) -> int:
    """Removes outlier observations; a landmark that is an outlier in the newest frame is dropped.

    Args:
        window: Changed in place.
        factors: Noise model of the factors.
        work: Workspace.
        most: Limit, standard deviations.
        alive: (L,) changed: 0 where tracking of the landmark should stop.

    Returns:
        Number of remaining observations of the newest frame.
    """
    cull_planes(window, factors)
    view(window, factors, work.views)
    n, marks = window.frames.count[0], window.landmarks
    scale, left = window.calibration.scale[0], 0
    for l in range(len(marks.host)):
        h = marks.host[l]
        if h == NO_HOST:
            continue
        x, y = ray(window.calibration, marks.at[l, h])
        for j in range(n):
            if j == h or not marks.seen[l, j]:
                continue
            px, py, depth, before = project(work.views, h, j, x, y, marks.inverse_depth[l])
            off = math.inf
            if before:
                u, v = ray(window.calibration, marks.at[l, j])
                off = ((px - u) ** 2 + (py - v) ** 2) * factors.pixel_weight
            if off > most * most:
                marks.seen[l, j] = 0
                if j == n - 1:
                    alive[l] = 0
                continue
            if marks.rho[l, j] > 0.0 and factors.projection_depth:
                r = scale * depth - marks.rho[l, j]
                if r * r * factors.later_depth_weight > most * most:
                    marks.rho[l, j] = 0.0
            if j == n - 1:
                left += 1
    return left


@njit(error_model="numpy", **INSIDE)
def parallax(window: Window, newest: int, since: int) -> tuple[float, int]:
    """Mean motion of points between two frames without that of rotation, on the plane at depth 1; and their number.

    Args:
        window: Frames and landmarks.
        newest: Slot.
        since: Slot.
    """
    marks, c, f = window.landmarks, window.calibration, window.frames
    rotation = mul(np.ascontiguousarray(f.R[newest].T), f.R[since])
    A = mul(np.ascontiguousarray(c.R.T), mul(rotation, c.R))
    total, count = 0.0, 0
    for l in range(len(marks.host)):
        if marks.host[l] == NO_HOST or not (marks.seen[l, newest] and marks.seen[l, since]):
            continue
        q = rotate(A, np.array([marks.at[l, since, 0], marks.at[l, since, 1], 1.0]))
        if q[2] < 0.05:
            continue
        total += math.hypot(q[0] / q[2] - marks.at[l, newest, 0], q[1] / q[2] - marks.at[l, newest, 1])
        count += 1
    return (total / count if count else 0.0), count
