"""Golden accuracy of the one-foot filter on real walks; skipped where the recordings are not at hand."""

import numpy as np
import pytest

from benchmarks import foot_ins_real, real_walks

FOLDER = real_walks.data_folder()
pytestmark = pytest.mark.skipif(FOLDER is None, reason="no recordings: set STRIDETWIN_DATA to their folder")


@pytest.fixture(scope="module")
def walks() -> list:
    return real_walks.load_vicon(FOLDER)


def test_walks_under_motion_capture(walks: list) -> None:
    error = real_walks.spread(foot_ins_real.armse_of(walks).values())
    assert error["mean"] <= 0.06
    assert error["median"] <= 0.045
    assert error["p95"] <= 0.12


def test_half_the_rate(walks: list) -> None:
    error = real_walks.spread(foot_ins_real.armse_of(map(foot_ins_real.halved_rate, walks)).values())
    assert error["mean"] <= 0.06


@pytest.mark.parametrize("factor", [0.8, 1.3])
def test_the_same_walks_at_another_speed(walks: list, factor: float) -> None:
    error = real_walks.spread(foot_ins_real.armse_of(foot_ins_real.stretched(w, factor) for w in walks).values())
    assert error["mean"] <= 0.07


def test_an_unknown_gyro_bias(walks: list) -> None:
    rng = np.random.default_rng(3)
    error = real_walks.spread(foot_ins_real.armse_of(foot_ins_real.biased(w, 0.01, rng) for w in walks).values())
    assert error["mean"] <= 0.08


def test_another_sensor_with_a_turn() -> None:
    for foot in real_walks.load_markers(FOLDER):
        path = foot_ins_real.estimate(foot.imu).trajectory
        error, height = real_walks.stance_error(path.t_ns * 1e-9, path.p_frame_in_world, foot)
        assert error <= 0.15
        assert abs(height) <= 0.6


def test_heights_of_the_walks(walks: list) -> None:
    heights = []
    for walk in walks:
        path = foot_ins_real.estimate(walk.imu).trajectory.p_frame_in_world
        heights.append(abs(foot_ins_real.climb(path) - foot_ins_real.climb(walk.truth)))
    assert np.median(heights) <= 0.03
    assert np.percentile(heights, 95) <= 0.30


def test_a_loop_of_a_sensor_that_nothing_was_tuned_on() -> None:
    end = foot_ins_real.loop_errors(real_walks.load_loop(FOLDER))
    assert end["horizontal_m"] <= 0.10
    assert abs(end["height_m"]) <= min(0.08, 1.96 * end["height_sd_m"])


def test_both_feet_climb_the_same_stairs() -> None:
    climbs = {side: foot_ins_real.climb_of(imu) for side, imu in real_walks.load_stairs(FOLDER).items()}
    assert abs(climbs["left"]["height"] - climbs["right"]["height"]) <= 0.05


@pytest.mark.xfail(strict=True, reason="the right foot is 0.093 m off since only true rest tells the gyro's bias")
def test_each_foot_of_another_sensor_is_within_80_mm() -> None:
    feet = real_walks.load_markers(FOLDER)
    errors = foot_ins_real.marker_errors(feet, [foot_ins_real.estimate(foot.imu) for foot in feet])["stance_rmse_m"]
    assert errors["left"] <= 0.08
    assert errors["right"] <= 0.08


@pytest.mark.parametrize("known", [True, False], ids=["start_known", "side_by_side"])
def test_both_feet_in_one_filter_are_as_good_as_each_alone(known: bool) -> None:
    feet = real_walks.load_markers(FOLDER)
    alone = foot_ins_real.marker_errors(feet, [foot_ins_real.estimate(foot.imu) for foot in feet])
    both = foot_ins_real.both_feet(feet, {f.name[0]: foot_ins_real.known_start(f) for f in feet} if known else None)
    assert both["stance_rmse_m"]["left"] <= 0.08
    for foot in ("left", "right"):
        assert abs(both["height_error_m"][foot]) <= 0.10
        assert both["stance_rmse_m"][foot] == pytest.approx(alone["stance_rmse_m"][foot], abs=1e-4)
    if known:
        assert both["distance_error_rms_m"] <= 0.25
