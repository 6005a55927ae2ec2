"""The one-foot filter on a foot in closed form: accuracy, faults, and the two ways to feed it."""

import numpy as np
import pytest
from foot_motion import ADIS16485, LEFT_FOOT, Walk, ranges, rig_of, walk
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.estimators.foot_ins import FootIns, FootInsEstimate, FootInsParameters, StartPose
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Block, Imu


def start_of(truth: Walk) -> StartPose:
    return StartPose(p_imu_in_world=truth.p_imu_in_world[0], q_world_imu=truth.q_world_imu[0])


def block_like(truth: Walk, keep: np.ndarray | slice = slice(None), **columns: np.ndarray) -> Block[Imu]:
    return Block(
        topic=truth.imu.topic,
        kind=Imu,
        t_ns=truth.imu.t_ns[keep],
        columns={name: columns.get(name, value)[keep] for name, value in truth.imu.columns.items()},
    )


def end_error(truth: Walk, imu: Block[Imu] | None = None) -> float:
    path = FootIns(start=start_of(truth)).run(imu or truth.imu)
    return float(np.linalg.norm(path.trajectory.p_frame_in_world[-1] - truth.p_imu_in_world[-1]))


def assert_sane(estimate: FootInsEstimate) -> None:
    for value in (estimate.pose.p_frame_in_world, estimate.v_imu_in_world, estimate.covariance):
        assert np.all(np.isfinite(value))
    assert np.linalg.norm(estimate.pose.q_world_frame) == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_array_equal(estimate.covariance, estimate.covariance.T)
    assert np.linalg.eigvalsh(estimate.covariance)[0] > -1e-9


@pytest.mark.parametrize("rise", [0.0, 0.17, 0.10], ids=["level", "stairs", "ramp"])
@pytest.mark.parametrize("seed", range(3))
def test_end_error_stays_below_one_percent_of_the_way(rise: float, seed: int) -> None:
    truth = walk(rise=rise, calibration=ADIS16485, rng=np.random.default_rng(seed))
    path = FootIns(LEFT_FOOT, start=start_of(truth)).run(truth.imu)
    error = path.trajectory.p_frame_in_world[-1] - truth.p_imu_in_world[-1]
    assert np.linalg.norm(error) < 0.01 * truth.distance


@pytest.mark.parametrize("rate_hz", [100.0, 200.0, 250.0, 1000.0])
def test_any_rate_gives_the_same_path_and_the_same_certainty(rate_hz: float) -> None:
    reference = walk(rate_hz=200.0)
    truth = walk(rate_hz=rate_hz)
    sd = [np.sqrt(np.diagonal(FootIns().run(w.imu).trajectory.covariance[-1])) for w in (reference, truth)]
    assert end_error(truth) < 0.005 * truth.distance
    np.testing.assert_allclose(sd[1], sd[0], rtol=0.25)


@pytest.mark.parametrize(
    "R_foot_imu",
    [
        np.diag([1.0, -1.0, -1.0]),
        np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]),
        np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    ],
    ids=["z_down", "x_down", "sideways"],
)
def test_mounting_does_not_matter(R_foot_imu: np.ndarray) -> None:
    plain, turned = walk(), walk(R_foot_imu=R_foot_imu)
    paths = [FootIns(start=start_of(w)).run(w.imu).trajectory.p_frame_in_world for w in (plain, turned)]
    np.testing.assert_allclose(paths[1], paths[0], atol=1e-6)


@pytest.mark.parametrize("flip", [1.0, -1.0], ids=["z_up", "z_down"])
def test_without_a_start_pose_the_sensor_begins_at_the_origin_with_heading_zero(flip: float) -> None:
    tilt = Rotation.from_euler("xyz", [12.0, -20.0, 70.0], degrees=True).as_matrix() @ np.diag([1.0, flip, flip])
    path = FootIns().run(walk(R_foot_imu=tilt).imu).trajectory
    x_axis = Rotation.from_quat(path.q_world_frame[5], scalar_first=True).apply([1.0, 0.0, 0.0])
    np.testing.assert_array_equal(path.p_frame_in_world[0], 0.0)
    assert np.arctan2(x_axis[1], x_axis[0]) == pytest.approx(0.0, abs=1e-9)


def test_turns_are_followed() -> None:
    truth = walk(turn_rad=np.pi, calibration=ADIS16485, rng=np.random.default_rng(5))
    path = FootIns(LEFT_FOOT, start=start_of(truth)).run(truth.imu).trajectory
    error = np.linalg.norm(path.p_frame_in_world - truth.p_imu_in_world, axis=1)
    assert error.max() < 0.01 * truth.distance


def test_a_rest_shows_the_gyro_bias() -> None:
    bias = np.array([0.006, -0.005, 0.006])
    truth = walk()
    biased = block_like(truth, angular_rate=truth.imu.columns["angular_rate"] + bias)
    assert end_error(truth, biased) < 0.02 * truth.distance


def test_a_heel_that_rises_slowly_does_not_pull_the_path_down() -> None:
    truth = walk(slow_heel_rad=0.1)
    uncertain, fixed = (
        FootIns(parameters=p, start=start_of(truth)).run(truth.imu).trajectory.p_frame_in_world[-1, 2]
        - truth.p_imu_in_world[-1, 2]
        for p in (
            FootInsParameters(same_floor=0.0),
            FootInsParameters(same_floor=0.0, lever_sd_m=0.0, contact_sd_m=0.0, innovation_gate=1e9),
        )
    )
    assert fixed < -0.03 * truth.distance
    assert abs(uncertain) < 0.01 * truth.distance


def glide(strides: int = 8, speed: float = 3.0, rate_hz: float = 200.0) -> Block[Imu]:
    """A foot that never turns, and in each stride glides at constant speed for 40 ms: it looks still while it does."""
    kick = speed * rate_hz / 20 * (1.0 - np.cos(2 * np.pi * (np.arange(20) + 0.5) / 20))
    stride = np.concatenate([kick, np.zeros(8), -kick, np.zeros(80)])
    ahead = np.concatenate([np.zeros(400), np.tile(stride, strides)])
    force = np.column_stack([ahead, np.zeros_like(ahead), np.full_like(ahead, FootInsParameters().gravity_mps2)])
    t_ns = np.arange(1, len(ahead) + 1) * round(1e9 / rate_hz)
    columns = {"angular_rate": np.zeros_like(force), "specific_force": force}
    return Block(topic="/foot_l/imu", kind=Imu, t_ns=t_ns, columns=columns)


def test_a_swing_that_seems_stationary_for_an_instant_is_not_stopped() -> None:
    imu = glide()
    ahead = imu.columns["specific_force"][:, 0]
    way = np.cumsum(np.cumsum(ahead) / 200.0)[-1] / 200.0
    robust, credulous = (
        FootIns(parameters=p).run(imu).trajectory.p_frame_in_world[-1, 0]
        for p in (FootInsParameters(), FootInsParameters(innovation_gate=1e9))
    )
    assert abs(robust - way) < 0.15 * way
    assert abs(credulous - way) > 0.90 * way


@given(st.floats(1.0, 20.0), st.integers(0, 2))
def test_a_filter_gone_astray_finds_back_where_the_foot_stands(jump: float, axis: int) -> None:
    """A shock that the sensor reports and the foot never felt: standing brings the speed down, whatever its size."""
    imu = glide(strides=0)
    imu.columns["specific_force"][200, axis] += jump * 200.0
    path = FootIns().run(imu)
    assert np.linalg.norm(path.v_imu_in_world[-1]) < 0.02


def test_error_is_consistent_with_the_covariance() -> None:
    squared = []
    for seed in range(8):
        truth = walk(calibration=ADIS16485, rng=np.random.default_rng(seed))
        path = FootIns(LEFT_FOOT, start=start_of(truth)).run(truth.imu).trajectory
        error = (path.p_frame_in_world[-1] - truth.p_imu_in_world[-1])[:2]
        squared.append(error @ np.linalg.solve(path.covariance[-1, :2, :2], error))
    assert np.mean(squared) < 5.0  # 2 if consistent; larger = too sure of itself


def test_a_jolt_while_the_vertical_is_looked_for_does_not_turn_the_heading() -> None:
    truth = walk()
    force = truth.imu.columns["specific_force"].copy()
    force[1:4] = [[-4.2, 0.4, -3.8], [8.0, 9.0, 2.0], [0.0, -12.0, 7.0]]
    paths = [
        FootIns(start=start_of(truth)).run(imu).trajectory.q_world_frame[-1]
        for imu in (truth.imu, block_like(truth, specific_force=force))
    ]
    turn = Rotation.from_quat(paths[1], scalar_first=True) * Rotation.from_quat(paths[0], scalar_first=True).inv()
    assert abs(turn.as_rotvec()[2]) < 1e-3


def test_innovations_say_how_well_the_motion_fits_the_filter() -> None:
    truth = walk(calibration=ADIS16485, rng=np.random.default_rng(0))
    filters = [FootIns(LEFT_FOOT, start=start_of(truth)) for _ in range(2)]
    assert not filters[0].nis
    shaken = truth.imu.columns["angular_rate"] + np.random.default_rng(1).normal(0.0, 0.2, (len(truth.imu), 3))
    for estimator, imu in zip(filters, (truth.imu, block_like(truth, angular_rate=shaken))):
        estimator.run(imu)
    assert 0.0 < 3.0 * filters[0].nis["standing"] < filters[1].nis["standing"]


def test_sample_by_sample_and_block_give_identical_numbers() -> None:
    truth = walk(strides=4, calibration=ADIS16485, rng=np.random.default_rng(0))
    path = FootIns(LEFT_FOOT).run(truth.imu)
    stepwise = FootIns(LEFT_FOOT)
    estimates = [e for e in map(stepwise.update, truth.imu) if e is not None]
    np.testing.assert_array_equal([e.pose.p_frame_in_world for e in estimates], path.trajectory.p_frame_in_world)
    np.testing.assert_array_equal([e.pose.q_world_frame for e in estimates], path.trajectory.q_world_frame)
    np.testing.assert_array_equal([e.v_imu_in_world for e in estimates], path.v_imu_in_world)
    np.testing.assert_array_equal([e.standing_speed_sd for e in estimates], path.standing_speed_sd)
    np.testing.assert_array_equal([e.aligned for e in estimates], path.aligned)
    pose = np.r_[0:3, 6:9]
    np.testing.assert_array_equal([e.covariance[np.ix_(pose, pose)] for e in estimates], path.trajectory.covariance)


def test_a_block_in_pieces_gives_the_same_path() -> None:
    truth = walk(strides=4)
    whole = FootIns().run(truth.imu).trajectory.p_frame_in_world
    pieces = FootIns()
    cut = len(truth.imu) // 3
    parts = [pieces.run(block_like(truth, s)).trajectory.p_frame_in_world for s in (slice(cut), slice(cut, None))]
    np.testing.assert_array_equal(np.vstack(parts), whole)


def test_zero_velocity_is_claimed_in_stance_and_not_in_swing() -> None:
    truth = walk()
    path = FootIns().run(truth.imu)
    speed = np.linalg.norm(np.gradient(truth.p_imu_in_world, truth.t_ns * 1e-9, axis=0), axis=1)
    sd = path.standing_speed_sd
    assert np.all(sd[speed > 1.0] > 0.1)
    assert np.mean(sd[path.aligned & (speed < 1e-3)] < 0.05) > 0.8


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e9])
def test_an_impossible_sample_is_ignored(value: float) -> None:
    truth = walk(strides=2)
    estimator = FootIns()
    for i, sample in enumerate(truth.imu):
        if i % 50 == 17:
            bad = Imu(
                topic=sample.topic,
                t_ns=sample.t_ns - 1,
                angular_rate=np.array([0.0, value, 0.0]),
                specific_force=sample.specific_force,
            )
            assert estimator.update(bad) is None
        last = estimator.update(sample)
    clean = FootIns().run(truth.imu).trajectory
    assert last is not None
    np.testing.assert_array_equal(last.pose.p_frame_in_world, clean.p_frame_in_world[-1])


def test_a_repeated_or_late_sample_is_ignored() -> None:
    truth = walk(strides=2)
    samples = list(truth.imu)
    estimator = FootIns()
    for i, sample in enumerate(samples):
        last = estimator.update(sample)
        assert estimator.update(sample) is None
        assert estimator.update(samples[max(0, i - 3)]) is None
    clean = FootIns().run(truth.imu).trajectory
    assert last is not None
    np.testing.assert_array_equal(last.pose.p_frame_in_world, clean.p_frame_in_world[-1])


@pytest.mark.parametrize("gap_s", [0.05, 0.1])
def test_a_short_gap_is_bridged(gap_s: float) -> None:
    truth = walk()
    t = truth.t_ns * 1e-9
    keep = (t < 6.1) | (t > 6.1 + gap_s)
    path = FootIns(start=start_of(truth)).run(block_like(truth, keep))
    error = np.linalg.norm(path.trajectory.p_frame_in_world - truth.p_imu_in_world[keep], axis=1)
    assert np.all(path.aligned[t[keep] > 1.0])
    assert error[-1] < 0.6
    assert error[-1] < 3.5 * np.sqrt(np.trace(path.trajectory.covariance[-1, :3, :3]))


def test_after_a_long_gap_the_filter_says_that_it_is_lost_and_aligns_anew() -> None:
    truth = walk()
    t = truth.t_ns * 1e-9
    keep = (t < 6.0) | (t > 9.0)
    path = FootIns(start=start_of(truth)).run(block_like(truth, keep))
    tk = t[keep]
    before, after = np.flatnonzero(tk < 6.0)[-1], np.flatnonzero(tk > 9.0)[0]
    p, cov = path.trajectory.p_frame_in_world, path.trajectory.covariance
    assert cov is not None
    assert not path.aligned[after]
    assert path.aligned[-1]
    np.testing.assert_array_equal(p[after], p[before])
    assert np.sqrt(cov[after, 0, 0]) > 3.0
    way = p[-1] - p[np.flatnonzero(path.aligned & (tk > 9.0))[0]]
    true_way = truth.p_imu_in_world[-1] - truth.p_imu_in_world[keep][np.flatnonzero(path.aligned & (tk > 9.0))[0]]
    assert np.linalg.norm(way - true_way) < 0.1 * np.linalg.norm(true_way)


def test_a_foot_that_is_never_stationary_is_tracked_with_little_trust() -> None:
    truth = walk(rest_s=0.0)
    t = truth.t_ns * 1e-9
    path = FootIns().run(block_like(truth, t > 0.5))
    sd = np.sqrt(np.diagonal(path.trajectory.covariance, axis1=1, axis2=2))
    assert path.aligned[-1]
    assert np.all(np.isfinite(sd))


def test_a_limited_gyro_costs_certainty_and_less_accuracy_than_trusting_it() -> None:
    truth = walk()
    new_floors = FootInsParameters(same_floor=0.0, path_scale_sd=0.0, height_drift_sd=0.0)
    limited = block_like(truth, angular_rate=np.clip(truth.imu.columns["angular_rate"], -5.0, 5.0))
    limited, unlimited = (
        FootIns(rig_of(ranges(limit)), parameters=new_floors, start=start_of(truth)).run(limited).trajectory
        for limit in (5.0, 0.0)
    )
    end = truth.p_imu_in_world[-1]
    assert np.trace(limited.covariance[-1, :3, :3]) > np.trace(unlimited.covariance[-1, :3, :3])
    assert np.linalg.norm(limited.p_frame_in_world[-1] - end) < np.linalg.norm(unlimited.p_frame_in_world[-1] - end)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.integers(-(10**7), 2 * 10**9),
            st.lists(st.floats(width=32) | st.floats(-60.0, 60.0), min_size=6, max_size=6),
        ),
        min_size=1,
        max_size=60,
    )
)
def test_nothing_that_a_sensor_says_yields_a_nan(stream: list[tuple[int, list[float]]]) -> None:
    estimator, t_ns = FootIns(), 0
    for step_ns, values in stream:
        t_ns += step_ns
        sample = Imu(
            topic="/foot_l/imu",
            t_ns=t_ns,
            angular_rate=np.array(values[:3], float),
            specific_force=np.array(values[3:], float),
        )
        estimate = estimator.update(sample)
        if estimate is not None:
            assert estimate.t_ns == t_ns
            assert_sane(estimate)


@pytest.mark.parametrize(
    ("field", "value"),
    [("gravity_mps2", 0.0), ("window_s", -1.0), ("stationary_power", float("nan")), ("gyro_noise_radps_rthz", -1e-3)],
)
def test_a_bad_parameter_is_refused_by_name(field: str, value: float) -> None:
    with pytest.raises(ConfigError, match=field):
        FootInsParameters(**{field: value})


def test_a_bad_start_pose_is_refused_by_name() -> None:
    with pytest.raises(ConfigError, match="q_world_imu"):
        StartPose(p_imu_in_world=np.zeros(3), q_world_imu=np.zeros(4))
    with pytest.raises(ConfigError, match="p_imu_in_world"):
        StartPose(p_imu_in_world=np.zeros(2), q_world_imu=np.array([1.0, 0.0, 0.0, 0.0]))
