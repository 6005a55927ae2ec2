"""The compiled step of the window's least squares, docs/dvio.md (10): it moves all states."""

from __future__ import annotations

import numpy as np
from numba import njit

from stridetwin.estimators.dvio.landmarks import (
    LEAST_INVERSE_DEPTH,
    MOST_INVERSE_DEPTH,
    POSE,
    CameraEquations,
    is_usable,
    state_index,
)
from stridetwin.estimators.dvio.state import CALIBRATION, FRAME, Calibration, Frames, Landmarks
from stridetwin.streams.algebra.matrices import copy_matrix, exp, multiply
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array


@njit(error_model="numpy", **INNER_KERNEL)
def _step_calibration(c: Calibration, d: Array) -> None:
    """Adds a step d (10,) to the calibration in place, and to its deviation `moved`.

    Entries of d: 0-2 position (m) and 3-5 rotation (rad) of the mount, 6 clock (s), 7 depth scale, 8-9 focal lengths.
    """
    for i in range(3):
        c.p[i] += d[i]
    copy_matrix(multiply(c.R, exp(d[3:6])), c.R)
    c.offset[0] += d[6]
    c.scale[0] += d[7]
    for i in range(2):
        c.focal[i] += d[8 + i]
    for i in range(CALIBRATION):
        c.moved[i] += d[i]


@njit(error_model="numpy", **INNER_KERNEL)
def _step_frame(f: Frames, k: int, e: Array) -> None:
    """Adds a step e (15,) to the frame in slot k, in place.

    Entries of e: 0-2 position (m), 3-5 attitude (rad, error on the right), 6-8 velocity (m/s), 9-14 biases.
    A frame in the prior is recomputed from its first estimate and the sum of all steps since, which is what the prior
    refers to.
    """
    R, p, v, bias = f.R[k], f.p[k], f.v[k], f.bias[k]
    R_0, p_0, v_0, bias_0 = R, p, v, bias  # the state to which `e` is added
    if f.in_prior[k]:
        moved = f.moved[k]  # sum of all steps since the first estimate
        for i in range(FRAME):
            moved[i] += e[i]
        R_0, p_0, v_0, bias_0, e = f.R_first[k], f.p_first[k], f.v_first[k], f.bias_first[k], moved
    copy_matrix(multiply(R_0, exp(e[3:6])), R)
    for i in range(3):
        p[i] = p_0[i] + e[i]
        v[i] = v_0[i] + e[6 + i]
    for i in range(6):
        bias[i] = bias_0[i] + e[9 + i]


@njit(error_model="numpy", **INNER_KERNEL)
def apply_step(frames: Frames, marks: Landmarks, calibration: Calibration, camera: CameraEquations, d: Array) -> None:
    """Applies a step d (N,) of all states to frames and calibration, and the step that follows for each landmark.

    An eliminated inverse depth changes by (b_l − h_lᵀ d) / h_ll, with h_l over calibration and poses; it stays within
    `LEAST_INVERSE_DEPTH` and `MOST_INVERSE_DEPTH`.

    Args:
        frames: Frames, changed in place.
        marks: Landmarks, whose inverse depths change.
        calibration: Calibration, changed in place.
        camera: Camera equations from which the step was computed: b_l is `b_depth`, h_l `cross`, h_ll
            `depth_information`.
        d: (N,) step: calibration, then each frame from the oldest.
    """
    n = frames.count[0]
    _step_calibration(calibration, d)
    for k in range(n):
        _step_frame(frames, k, d[CALIBRATION + FRAME * k : CALIBRATION + FRAME * (k + 1)])
    # the part of the step that landmarks depend on: calibration and poses, without velocities and biases
    pose_step = np.empty(CALIBRATION + POSE * n)
    for i in range(pose_step.shape[0]):
        pose_step[i] = d[state_index(i)]
    for l in range(marks.host.shape[0]):
        if is_usable(marks, l, n - 1):
            remainder = camera.b_depth[l]  # b_l - h_lᵀ d
            for i in range(pose_step.shape[0]):
                remainder -= camera.cross[l, i] * pose_step[i]
            xi = marks.inverse_depth[l] + remainder / camera.depth_information[l]
            marks.inverse_depth[l] = min(max(xi, LEAST_INVERSE_DEPTH), MOST_INVERSE_DEPTH)
