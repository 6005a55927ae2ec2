"""Compiled steps of the window's least squares, docs/dvio.md (10): moving the states, and marginalisation (11)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.dvio.landmarks import (
    LEAST_INVERSE_DEPTH,
    MOST_INVERSE_DEPTH,
    POSE,
    CameraEquations,
    state,
    usable,
)
from stridetwin.estimators.dvio.state import CALIBRATION, FRAME, Calibration, Frames, Landmarks
from stridetwin.estimators.matrices import copy_matrix, inverse, mul
from stridetwin.estimators.so3 import exp
from stridetwin.streams.samples import Array


@njit(error_model="numpy", **INSIDE)
def _move_calibration(c: Calibration, d: Array) -> None:
    for i in range(3):
        c.p[i] += d[i]
    copy_matrix(mul(c.R, exp(d[3:6])), c.R)
    c.offset[0] += d[6]
    c.scale[0] += d[7]
    for i in range(2):
        c.focal[i] += d[8 + i]
    for i in range(CALIBRATION):
        c.moved[i] += d[i]


@njit(error_model="numpy", **INSIDE)
def _move_frame(f: Frames, k: int, e: Array) -> None:
    """Moves a frame by its step (15,): from its first estimate by all steps since, if the prior contains it."""
    R, p, v, bias = f.R[k], f.p[k], f.v[k], f.bias[k]
    R_0, p_0, v_0, bias_0 = R, p, v, bias
    if f.held[k]:
        m = f.moved[k]
        for i in range(FRAME):
            m[i] += e[i]
        R_0, p_0, v_0, bias_0, e = f.R_first[k], f.p_first[k], f.v_first[k], f.bias_first[k], m
    copy_matrix(mul(R_0, exp(e[3:6])), R)
    for i in range(3):
        p[i] = p_0[i] + e[i]
        v[i] = v_0[i] + e[6 + i]
    for i in range(6):
        bias[i] = bias_0[i] + e[9 + i]


@njit(error_model="numpy", **INSIDE)
def move(frames: Frames, marks: Landmarks, calibration: Calibration, camera: CameraEquations, d: Array) -> None:
    """Applies the step d (N,) of all states, and what follows from it for the landmarks."""
    n = frames.count[0]
    _move_calibration(calibration, d)
    for k in range(n):
        _move_frame(frames, k, d[CALIBRATION + FRAME * k : CALIBRATION + FRAME * (k + 1)])
    by_pose = np.empty(CALIBRATION + POSE * n)
    for i in range(by_pose.shape[0]):
        by_pose[i] = d[state(i)]
    for l in range(marks.host.shape[0]):
        if usable(marks, l, n - 1):
            s = camera.b_own[l]
            for i in range(by_pose.shape[0]):
                s -= camera.cross[l, i] * by_pose[i]
            xi = marks.inverse_depth[l] + s / camera.own[l]
            marks.inverse_depth[l] = min(max(xi, LEAST_INVERSE_DEPTH), MOST_INVERSE_DEPTH)


@njit(error_model="numpy", **INSIDE)
def without_oldest(H: Array, b: Array, size: int) -> None:
    """Eliminates the oldest frame from H d = b of `size` states; its rows become free. See docs/dvio.md (11).

    The lower triangle of H counts; on return H is symmetric.
    """
    o, m = CALIBRATION, CALIBRATION + FRAME
    for i in range(size):
        for j in range(i):
            H[j, i] = H[i, j]
    own, scale = np.empty((FRAME, FRAME)), np.empty(FRAME)
    for i in range(FRAME):
        for j in range(FRAME):
            own[i, j] = H[o + i, o + j]
    for i in range(FRAME):
        scale[i] = 1.0 / math.sqrt(max(own[i, i], 1e-12))
    for i in range(FRAME):
        for j in range(FRAME):
            own[i, j] *= scale[i] * scale[j]
        own[i, i] += 1e-12
    cover = inverse(own)
    for i in range(FRAME):
        for j in range(FRAME):
            cover[i, j] *= scale[i] * scale[j]
    share = np.zeros((size, FRAME))
    for i in range(size):
        if o <= i < m:
            continue
        for j in range(FRAME):
            s = 0.0
            for k in range(FRAME):
                s += H[i, o + k] * cover[k, j]
            share[i, j] = s
    for i in range(size):
        if o <= i < m:
            continue
        for k in range(FRAME):
            b[i] -= share[i, k] * b[o + k]
        for j in range(i + 1):
            if o <= j < m:
                continue
            s = H[i, j]
            for k in range(FRAME):
                s -= share[i, k] * H[o + k, j]
            H[i, j] = s
            H[j, i] = s


@njit(error_model="numpy", **INSIDE)
def marginalize(H: Array, b: Array, d: Array, size: int, prior_H: Array, prior_b: Array) -> None:
    """Makes H d = b of `size` states the prior of all but the oldest frame.

    `d` (N,) are the states' deviations from their first estimates, about which the prior is.
    """
    without_oldest(H, b, size)
    prior_H[:] = 0.0
    prior_b[:] = 0.0
    for i in range(size - FRAME):
        a = i if i < CALIBRATION else i + FRAME
        s = b[a]
        for j in range(size - FRAME):
            c = j if j < CALIBRATION else j + FRAME
            prior_H[i, j] = H[a, c]
            s += H[a, c] * d[c]
        prior_b[i] = s
