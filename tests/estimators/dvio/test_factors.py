"""Residuals of the window and their Jacobians, against finite differences."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stridetwin.estimators.dvio import imu_factors, projection
from stridetwin.estimators.dvio.projection import OBSERVATION, blank_views
from stridetwin.estimators.dvio.state import CALIBRATION, FRAME
from tests.estimators.dvio.scenes import FACTORS, moved, seen_window
from tests.estimators.from_python import from_python

SEEDS = st.integers(0, 10_000)
STEP = 1e-6
view, ray = from_python(projection.update_views), from_python(projection.to_ray)
observation_jacobian, project = from_python(projection.observation_jacobian), from_python(projection.project)
motion = from_python(imu_factors.imu_residual)


@settings(max_examples=10, deadline=None)
@given(seed=SEEDS)
def test_the_jacobian_of_an_observation_is_its_slope(seed):
    window = seen_window(np.random.default_rng(seed))
    window.frames.offset[:] = 0.0
    now = blank_views(4)
    view(window.frames, window.calibration, FACTORS.first_estimates, now)
    at, xi = window.landmarks.at[1, 0], window.landmarks.inverse_depth[1]
    x, y = ray(window.calibration, *at)
    J, Jl = np.zeros((3, OBSERVATION)), np.zeros(3)
    assert observation_jacobian(window.frames, window.calibration, now, 0, 2, x, y, xi, J, Jl)

    def seen(error, of_depth=0.0):
        other = copy.deepcopy(window)
        moved(other, error)
        v = blank_views(4)
        view(other.frames, other.calibration, FACTORS.first_estimates, v)
        x, y = ray(other.calibration, *at)
        return np.array(project(v.rotation[0, 2], v.translation[0, 2], x, y, xi + of_depth, 1e-3)[:3])

    size = CALIBRATION + FRAME * 3
    columns = [
        *range(CALIBRATION),
        *(CALIBRATION + i for i in range(6)),
        *(CALIBRATION + 2 * FRAME + i for i in range(6)),
    ]
    for j, column in enumerate(columns):
        e = np.zeros(size)
        e[column] = STEP
        slope = (seen(e) - seen(-e)) / (2 * STEP)
        assert J[:, j] == pytest.approx(slope, abs=2e-6)
    zero = np.zeros(size)
    assert Jl == pytest.approx((seen(zero, STEP) - seen(zero, -STEP)) / (2 * STEP), abs=2e-6)


@settings(max_examples=10, deadline=None)
@given(seed=SEEDS)
def test_the_jacobian_of_the_motion_is_its_slope(seed):
    rng = np.random.default_rng(seed)
    window = seen_window(rng)
    zs = window.preintegrations
    zs.dt[0], zs.delta_p[0], zs.delta_v[0] = 0.2, 0.1 * rng.normal(size=3), rng.normal(size=3)
    zs.by_bias[0], zs.bias[0] = 0.1 * rng.normal(size=(9, 6)), 0.01 * rng.normal(size=6)
    r, J = np.zeros(9), np.zeros((9, 2 * FRAME))
    motion(window, 0, FACTORS, r, J)

    def residual(error):
        other = copy.deepcopy(window)
        moved(other, np.concatenate([np.zeros(CALIBRATION), error, np.zeros(FRAME)]))
        out, workspace = np.zeros(9), np.zeros((9, 2 * FRAME))
        motion(other, 0, FACTORS, out, workspace)
        return out

    for j in range(2 * FRAME):
        e = np.zeros(2 * FRAME)
        e[j] = STEP
        assert J[:, j] == pytest.approx((residual(e) - residual(-e)) / (2 * STEP), abs=2e-6)
