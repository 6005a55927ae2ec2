"""The paper's simulation, reduced: its figure, and the gates of ours."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.jao2020 import jao_simulation


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> dict:
    folder = tmp_path_factory.mktemp("unused")
    cases = [jao_simulation.run_case(ExperimentCase(seed=0, folder=folder))]
    return {**jao_simulation.collect(cases), "cases": cases}


def test_ideal_samples_turn_back_into_the_motion() -> None:
    walk = jao_simulation.SteadyWalk(strides=2)
    t_ns = np.round(np.arange(400) * 1e9 / 120).astype(np.int64)
    truth = walk.foot("l", t_ns)
    rate, force = jao_simulation.ideal_imu(truth)
    earth, dt = jao_simulation.EARTH_RATE_IN_WORLD, np.diff(t_ns) * 1e-9
    R, v = truth.rotation[0], truth.v_body_in_world[0]
    for k in range(len(dt)):
        turn = rate[k] - R.inv().apply(earth)
        middle = R * Rotation.from_rotvec(0.5 * dt[k] * turn)
        v = v + dt[k] * (middle.apply(force[k]) - 2 * np.cross(earth, v) - [0, 0, jao_simulation.GRAVITY_MPS2])
        R = middle * Rotation.from_rotvec(0.5 * dt[k] * turn)
    np.testing.assert_allclose((R * truth.rotation[-1].inv()).as_rotvec(), 0.0, atol=1e-6)
    np.testing.assert_allclose(v, truth.v_body_in_world[-1], atol=1e-3)


def test_feet_are_stationary_in_stance_and_strides_have_the_set_length() -> None:
    walk = jao_simulation.SteadyWalk(strides=3)
    t_ns = np.arange(0, round(walk.duration_s * 1e9), 1_000_000)
    for foot in jao_simulation.FEET:
        track = walk.foot(foot, t_ns)
        speed = np.linalg.norm(track.v_body_in_world, axis=1)
        assert 3.0 < speed.max() < 6.0
        assert np.mean(speed == 0.0) > 0.4
        np.testing.assert_allclose(np.ptp(track.p_body_in_world[:, 0]), 3 * 1.54, atol=1e-9)
        numeric = np.gradient(track.p_body_in_world, 1e-3, axis=0)
        np.testing.assert_allclose(numeric, track.v_body_in_world, atol=0.01)


def test_the_order_of_the_methods_is_the_papers(result: dict) -> None:
    error, west = result["summary"]["mean_end_error_m"], result["summary"]["mean_west_error_m"]["zupt"]
    assert 1.0 < west[0] < 4.0
    assert -4.0 < west[1] < -1.0
    for foot in range(2):
        assert error["zupt_relative_distance"][foot] < error["zupt"][foot]
        assert error["zupt_relative_position"][foot] < 0.15
        assert error["proposed"][foot] < 0.12
    assert max(result["summary"]["mean_abs_north_error_m"]["proposed"]) < 0.01
    assert set(result["paper"]["mean_end_error_m"]) == set(jao_simulation.REPORTED_METHODS) - {"proposed"}


def test_ours_stays_at_the_floor_of_the_drawn_noise(result: dict) -> None:
    """Run by run, what the two gyros' noise alone does to a path that is tied without loss."""
    simulation = jao_simulation.JaoSimulation(jao_simulation.SteadyWalk())
    runs = result["cases"] + [jao_simulation.run_seed(1, methods=("proposed",))]
    for seed, run in enumerate(runs):
        floor = simulation.noise_floor_m(simulation.inertial(np.random.default_rng(seed))[1])[1]
        for end in run["methods"]["proposed"]["end_error_m"]:
            assert abs(end[1] - floor) < 0.06


def test_a_drift_in_common_is_seen_by_nobody(result: dict) -> None:
    found = result["summary"]["mean_end_error_unequal_m"]
    assert found["zupt"][0] > 2.0
    for method in jao_simulation.REPORTED_METHODS[1:]:
        assert np.mean(found[method]) > 0.5


def test_the_table_has_a_row_a_method_with_the_papers_figures(result: dict) -> None:
    rows = {line.split()[0]: line.split()[1:] for line in jao_simulation.table(result)[2:]}
    assert rows["zupt_relative_position"][2:4] == ["0.065", "0.065"]
    assert [len(rows[method]) for method in jao_simulation.REPORTED_METHODS] == [10, 10, 10, 8]
