"""The published detectors and their filter of nine states: still feet, thresholds, formulas, and known figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import real_walks
from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import FootIns, ZeroVelocityDetector, published, state
from stridetwin.estimators.foot_ins.stance import append_sample
from stridetwin.streams.errors import ConfigError
from tests.estimators.from_python import from_python

G = 9.8029
METHODS = tuple(published.THRESHOLDS)
FOLDER = real_walks.data_folder()
_append_sample, _statistic = from_python(append_sample), from_python(published.published_statistic)


def statistic_of(method: str, rate: np.ndarray, force: np.ndarray) -> float:
    """Statistic of the last window of samples at 200 Hz, (N, 3) rad/s and m/s²."""
    memory = state.initial_state()
    for k in range(len(rate)):
        _append_sample(memory, 5_000_000 * k, tuple(rate[k]), tuple(force[k]))
    detector = published.for_kernel(ZeroVelocityDetector(method=method), G)
    return float(_statistic(memory, detector))


def noisy_walk(seed: int) -> real_walks.Block:
    """A second at rest, then half a second of every kind of motion, twice; 200 Hz."""
    rng = np.random.default_rng(seed)
    moves = np.r_[np.zeros(200), np.ones(100), np.zeros(100), np.ones(100)][:, None]
    rate = 0.01 * rng.standard_normal((500, 3)) + moves * 3.0 * rng.standard_normal((500, 3))
    force = [0, 0, G] + 0.05 * rng.standard_normal((500, 3)) + moves * 15.0 * rng.standard_normal((500, 3))
    return real_walks.imu_block(np.arange(500) / 200.0, rate, force)


def test_statistics_are_those_of_the_papers() -> None:
    rng = np.random.default_rng(5)
    rate, force = rng.standard_normal((5, 3)), [1.0, 2.0, 9.0] + rng.standard_normal((5, 3))
    mean = force.mean(0)
    upright = force - G * mean / np.linalg.norm(mean)
    expected = {
        "shoe": (upright**2).sum(1).mean() / 0.00098**2 + (rate**2).sum(1).mean() / 8.7266463e-5**2,
        "ared": (rate**2).sum(1).mean(),
        "amvd": ((force - mean) ** 2).sum(1).mean(),
        "mag": ((np.linalg.norm(force, axis=1) - G) ** 2).mean(),
    }
    for method, value in expected.items():
        assert statistic_of(method, rate, force) == pytest.approx(value, rel=1e-9)


@pytest.mark.parametrize("n", [2, 3, 5])
def test_graph_statistic_is_the_largest_of_all_cuts(n: int) -> None:
    force = np.random.default_rng(n).standard_normal((n, 3))
    cuts = [
        sum(np.linalg.norm(force[i] - force[j]) for i in range(s + 1) for j in range(t, n)) / ((t - s) * (n - t + 1))
        for s in range(n - 1)
        for t in range(s + 1, n)
    ]
    memory = state.initial_state()
    for k in range(n):
        _append_sample(memory, 5_000_000 * k, (0.0, 0.0, 0.0), tuple(force[k]))
    detector = ZeroVelocityDetector(method="mbgtd", window_s=0.005 * n)
    assert _statistic(memory, published.for_kernel(detector, G)) == pytest.approx(max(cuts))


@pytest.mark.parametrize("method", METHODS)
def test_a_still_foot_stands_and_stays(method: str) -> None:
    block = real_walks.imu_block(np.arange(400) / 200.0, np.zeros((400, 3)), np.tile([0.3, -0.4, G], (400, 1)))
    path = FootIns(options=Options(method=method)).run(block)
    assert np.isfinite(path.standing_speed_sd[path.aligned]).all()
    assert np.abs(path.trajectory.p_frame_in_world).max() < 0.01


@settings(max_examples=25, deadline=None)
@given(
    method=st.sampled_from(METHODS),
    seed=st.integers(0, 999),
    factor=st.floats(0.01, 0.99),
)
def test_a_lower_threshold_finds_a_part_of_the_stances(method: str, seed: int, factor: float) -> None:
    """Each sample that counts as standing with a lower threshold does so with a higher one."""
    block = noisy_walk(seed)
    detector = ZeroVelocityDetector(method=method)
    lower = replace(detector, threshold=detector.level * factor)
    found, fewer = (np.isfinite(FootIns(detector=d).run(block).standing_speed_sd) for d in (detector, lower))
    assert not (fewer & ~found).any()
    assert found[40:190].all()  # at rest


@pytest.mark.parametrize("method", METHODS)
def test_samples_and_blocks_give_the_same_numbers(method: str) -> None:
    block = noisy_walk(3)
    whole, single = FootIns(options=Options(method=method)).run(block), FootIns(options=Options(method=method))
    for k, sample in enumerate(block):
        estimate = single.update(sample)
        assert estimate is not None
        np.testing.assert_array_equal(estimate.pose.p_frame_in_world, whole.trajectory.p_frame_in_world[k])
    assert np.isfinite(whole.trajectory.p_frame_in_world).all()


def test_a_bias_at_the_start_is_taken_out() -> None:
    """The heading of a still foot with a biased gyro stays where the mean rate of the start is taken for a bias."""
    n, bias = 1000, np.array([0.0, 0.0, 0.02])
    block = real_walks.imu_block(np.arange(n) / 200.0, np.tile(bias, (n, 1)), np.tile([0.0, 0.0, G], (n, 1)))
    turned = []
    for with_bias in (False, True):
        detector = ZeroVelocityDetector(method="shoe", start_s=0.5, with_bias=with_bias)
        q = FootIns(detector=detector).run(block).trajectory.q_world_frame[-1]
        turned.append(2.0 * np.arctan2(q[3], q[0]))
    assert turned == pytest.approx([0.02 * 4.5, 0.0], abs=1e-3)


def test_wrong_settings_are_refused() -> None:
    with pytest.raises(ConfigError, match="method"):
        FootIns(options=Options(method="own"))
    with pytest.raises(ConfigError, match="threshold"):
        ZeroVelocityDetector(method="shoe", threshold=0.0)
    with pytest.raises(ConfigError, match="smoothed"):
        FootIns.batch(None, Options(method="shoe", lag_s=1.0))


@pytest.mark.skipif(FOLDER is None, reason="no recordings: set STRIDETWIN_DATA to their folder")
@pytest.mark.parametrize(("method", "mean_m", "median_m"), [("shoe", 0.266, 0.155), ("ared", 0.303, 0.244)])
def test_known_figures_of_the_published_filter(method: str, mean_m: float, median_m: float) -> None:
    """pyshoe's figures on the 14 walks; its windows are blocks of five samples, those here end at every sample."""
    assert FOLDER is not None
    walks = real_walks.load_vicon(FOLDER)
    detector = ZeroVelocityDetector(method=method)
    error = real_walks.spread(
        real_walks.armse(FootIns(detector=detector).run(w.imu).trajectory.p_frame_in_world, w.truth) for w in walks
    )
    assert error["mean"] == pytest.approx(mean_m, rel=0.1)
    assert error["median"] == pytest.approx(median_m, rel=0.2)
