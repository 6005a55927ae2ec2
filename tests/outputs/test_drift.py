"""Figures of a visual-inertial path against what one knows of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from stridetwin.outputs.path.scores import LOST_M, OdometryPath, compare, drift_figures, score
from stridetwin.outputs.truth import TruePath
from stridetwin.streams.trajectory import Trajectory
from tests.pinned import assert_pinned, columns

SIDE_M, RISE_M, HZ = 12.0, 1.0, 20.0
FEW = settings(deadline=None, max_examples=20)


def loop() -> TruePath:
    """A square of 12 m with round corners at 1 m/s, up by a metre along its second side and down along its fourth."""
    s = np.arange(0.0, 4 * SIDE_M, 1.0 / HZ)
    heading = -np.pi / 2 * sum(np.clip(s - SIDE_M * k + 0.5, 0.0, 1.0) for k in range(1, 4))
    v = np.stack([np.cos(heading), np.sin(heading), np.zeros_like(s)], -1)
    v[:, 2] = RISE_M / 4 * (((s > 16) & (s < 20)).astype(float) - ((s > 40) & (s < 44)))
    p = np.cumsum(v, axis=0) / HZ
    return TruePath(
        t_ns=np.round(s * 1e9).astype(np.int64),
        p_frame_in_world=p - p[0],
        v_frame_in_world=v,
        q_world_frame=Rotation.from_euler("z", heading[:, None]).as_quat(scalar_first=True),
    )


TRUTH = loop()


def odometry_of(path: Trajectory, healthy: np.ndarray | None = None) -> OdometryPath:
    return OdometryPath(path=path, healthy=np.ones(len(path), bool) if healthy is None else healthy)


def moved(path: Trajectory, yaw: float, shift: np.ndarray) -> Trajectory:
    turn = Rotation.from_euler("z", yaw)
    attitude = turn * Rotation.from_quat(path.q_world_frame, scalar_first=True)
    return replace(
        path,
        p_frame_in_world=turn.apply(path.p_frame_in_world) + shift,
        q_world_frame=attitude.as_quat(scalar_first=True),
    )


def wandering(seed: int, size: float = 0.05) -> Trajectory:
    """The truth with a smooth error of position and a heading that drifts."""
    rng, n = np.random.default_rng(seed), len(TRUTH.t_ns)
    share = np.linspace(0.0, 1.0, n)[:, None]
    error = size * (rng.normal(size=3) * share + rng.normal(size=3) * np.sin(6.0 * share + rng.normal(size=3)))
    turn = Rotation.from_euler("z", 0.02 * rng.normal() * share)
    return replace(
        TRUTH.poses,
        p_frame_in_world=TRUTH.p_frame_in_world + error,
        q_world_frame=(turn * Rotation.from_quat(TRUTH.q_world_frame, scalar_first=True)).as_quat(scalar_first=True),
    )


def test_the_truth_has_no_error() -> None:
    figures = drift_figures(odometry_of(TRUTH.poses), TRUTH)
    assert figures["failure"] == ""
    for name in ("loop_drift_m", "ape_rmse_m", "rpe_5m_pct", "height_rmse_m", "climb_error_m"):
        assert figures[name] == pytest.approx(0.0, abs=1e-6), name
    assert figures["coverage_pct"] == pytest.approx(100.0)
    assert figures["recovered"]


@FEW
@given(st.integers(0, 10_000), st.floats(-3.0, 3.0), st.floats(-50.0, 50.0))
def test_neither_heading_nor_place_of_its_world_counts(seed: int, yaw: float, shift: float) -> None:
    path = wandering(seed)
    here = drift_figures(odometry_of(path), TRUTH)
    there = drift_figures(odometry_of(moved(path, yaw, np.array([shift, -shift, 0.5 * shift]))), TRUTH)
    for name, value in here.items():
        assert there[name] == pytest.approx(value, abs=1e-7), name


@FEW
@given(st.integers(0, 10_000))
def test_the_aligned_error_is_the_least_that_a_shift_and_a_turn_leave(seed: int) -> None:
    path = wandering(seed, 0.3)

    def rms(x: np.ndarray) -> float:
        error = moved(path, x[0], x[1:]).p_frame_in_world - TRUTH.p_frame_in_world
        return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))

    least = minimize(rms, np.zeros(4), method="BFGS").fun
    assert drift_figures(odometry_of(path), TRUTH)["ape_rmse_m"] == pytest.approx(least, abs=1e-5)


@FEW
@given(st.integers(0, 10_000))
def test_the_relative_error_is_that_of_evo_where_the_vertical_is_right(seed: int) -> None:
    """evo's RPE in metres over all pairs: |trans((Q_i⁻¹ Q_j)⁻¹ (P_i⁻¹ P_j))|, Q true and P estimated poses."""
    path = wandering(seed)
    way = TRUTH.distance_m
    errors = []
    for start in np.searchsorted(way, np.arange(0.0, way[-1] - 5.0, 0.1)):
        end = int(np.searchsorted(way, way[start] + 5.0))
        if end < len(way):
            relative = [_between(p, start, end) for p in (TRUTH.poses, path)]
            errors.append(np.linalg.norm((np.linalg.inv(relative[0]) @ relative[1])[:3, 3]))
    assert drift_figures(odometry_of(path), TRUTH)["rpe_5m_pct"] == pytest.approx(100 * np.mean(errors) / 5.0, rel=1e-6)


def _between(path: Trajectory, i: int, j: int) -> np.ndarray:
    T = np.tile(np.eye(4), (2, 1, 1))
    T[:, :3, :3] = Rotation.from_quat(path.q_world_frame[[i, j]], scalar_first=True).as_matrix()
    T[:, :3, 3] = path.p_frame_in_world[[i, j]]
    return np.asarray(np.linalg.inv(T[0]) @ T[1])


@FEW
@given(st.floats(-0.03, 0.03))
def test_a_closed_loop_hides_a_wrong_scale_and_the_way_over_5_m_does_not(error: float) -> None:
    path = replace(TRUTH.poses, p_frame_in_world=(1 + error) * TRUTH.p_frame_in_world)
    figures = drift_figures(odometry_of(path), TRUTH)
    gap = np.linalg.norm(TRUTH.p_frame_in_world[-1])
    assert figures["loop_drift_m"] == pytest.approx(abs(error) * gap, abs=1e-9)
    # a chord is shorter than its arc
    assert 85.0 * abs(error) < figures["rpe_5m_pct"] + 1e-9 < 101.0 * abs(error) + 1e-8
    assert figures["climb_error_m"] == pytest.approx(abs(error) * RISE_M, rel=0.02, abs=1e-9)


def test_a_steady_drift_is_reported_along_the_worlds_axes() -> None:
    share = np.linspace(0.0, 1.0, len(TRUTH.t_ns))[:, None]
    path = replace(TRUTH.poses, p_frame_in_world=TRUTH.p_frame_in_world + share * [-0.216, 0.023, 0.136])
    figures = drift_figures(odometry_of(path), TRUTH)
    np.testing.assert_allclose(figures["loop_drift_xyz_m"], [-0.216, 0.023, 0.136], atol=1e-12)
    assert figures["loop_drift_m"] == pytest.approx(0.256, abs=1e-3)
    assert figures["height_rmse_m"] == pytest.approx(0.136 / np.sqrt(3), rel=1e-3)


def test_a_loss_that_it_declares_is_a_failure_even_if_it_recovers() -> None:
    healthy = np.ones(len(TRUTH.t_ns), bool)
    healthy[:40], healthy[400:420] = False, False
    figures = drift_figures(odometry_of(TRUTH.poses, healthy), TRUTH)
    assert (figures["failure"], figures["recovered"]) == ("lost", True)
    assert figures["unhealthy_s"] == pytest.approx(1.0)  # that before its first healthy pose is not held against it
    assert figures["coverage_pct"] == pytest.approx(100 * (1 - 40 / len(healthy)), abs=0.1)
    healthy[400:] = False
    assert not drift_figures(odometry_of(TRUTH.poses, healthy), TRUTH)["recovered"]


def test_a_path_that_is_far_off_not_finite_or_not_there_is_a_failure() -> None:
    far = TRUTH.p_frame_in_world + np.linspace(0.0, 1.2 * LOST_M, len(TRUTH.t_ns))[:, None] * [0, 0, 1.0]
    assert drift_figures(odometry_of(replace(TRUTH.poses, p_frame_in_world=far)), TRUTH)["failure"] == "off"
    far[700, 1] = np.nan
    assert drift_figures(odometry_of(replace(TRUTH.poses, p_frame_in_world=far)), TRUTH) == {
        "failure": "not finite",
        "unhealthy_s": 0.0,
        "recovered": False,
    }
    nothing = odometry_of(TRUTH.poses, np.zeros(len(TRUTH.t_ns), bool))
    assert drift_figures(nothing, TRUTH)["failure"] == "silent"


def test_a_covariance_that_is_honest_has_its_errors_inside() -> None:
    rng = np.random.default_rng(3)
    error = 0.02 * rng.standard_normal(TRUTH.p_frame_in_world.shape)
    error[0] = 0.0
    covariance = np.tile(np.diag([4e-4] * 3 + [1e-4] * 3), (len(error), 1, 1))
    path = replace(TRUTH.poses, p_frame_in_world=TRUTH.p_frame_in_world + error, covariance=covariance)
    figures = drift_figures(odometry_of(path), TRUTH)
    assert figures["nees_mean"] == pytest.approx(3.0, abs=0.2)
    assert figures["nees_within_95_pct"] == pytest.approx(95.0, abs=1.5)


def test_pinned_numbers(num_regression: Any) -> None:
    n = len(TRUTH.t_ns)
    covariance = np.linspace(1e-6, 4e-3, n)[:, None, None] * np.diag([1.0, 1.5, 0.5, 0.1, 0.1, 0.3])
    paths = [replace(wandering(seed, size), covariance=covariance) for seed, size in ((1, 0.05), (2, 0.2), (3, 1.5))]
    healthy = np.arange(n) % 400 < 380
    rows = [drift_figures(odometry_of(path, healthy), TRUTH) for path in paths]
    rows += [drift_figures(odometry_of(path), TRUTH) for path in paths]
    rows += [score(compare(path, TRUTH, how)) for path in paths for how in ("start", "yaw", "se3")]
    assert_pinned(num_regression, columns(rows))
