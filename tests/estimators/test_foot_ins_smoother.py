"""The fixed-lag smoother: against Rauch, Tung and Striebel with plain gains, against the filter, and as a stream."""

import numpy as np
import pytest
from foot_motion import ADIS16485, CALIBRATED, LEFT_FOOT, Walk, rig_of, walk
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import FootIns, FootInsParameters, FootInsPath, FootInsSmoother, StartPose
from stridetwin.estimators.foot_ins.parameters import for_sensor
from stridetwin.estimators.foot_ins.state import IGNORED, STATES, initial_state
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Imu
from tests.estimators.one_foot import take


@pytest.fixture(scope="module")
def short() -> Walk:
    return walk(strides=3, rest_s=0.6, turn_rad=0.4, calibration=ADIS16485, rng=np.random.default_rng(3))


@pytest.fixture(scope="module")
def longer() -> Walk:
    return walk(strides=8, turn_rad=1.0, calibration=ADIS16485, rng=np.random.default_rng(4))


def cut(block: Block[Imu], n: int) -> Block[Imu]:
    return Block(topic=block.topic, kind=Imu, t_ns=block.t_ns[:n], columns={k: v[:n] for k, v in block.columns.items()})


def rauch_tung_striebel(imu: Block[Imu]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Smoothed error (N, 21) of each filtered state, its covariance and the filtered one, by gains through a clone."""
    parameters = for_sensor(FootInsParameters(), CALIBRATED)
    memory = initial_state(np.zeros((2 * STATES, 2 * STATES)), np.zeros(2 * STATES))
    own, clone = slice(0, STATES), slice(STATES, 2 * STATES)
    P, error = memory.covariance, memory.error
    filtered, cloned, gain, found = [], [], [], []
    for sample in imu:
        P[clone, :] = P[own, :]
        P[:, clone] = P[:, own]
        error[clone] = 0.0
        phase = take(memory, parameters, sample.t_ns, sample.angular_rate, sample.specific_force)
        assert phase != IGNORED
        scale = np.sqrt(np.maximum(np.diagonal(P[own, own]), 1e-30))
        inverse = np.linalg.pinv(P[own, own] / np.outer(scale, scale), rcond=1e-12, hermitian=True)
        gain.append(P[clone, own] @ (inverse / np.outer(scale, scale)))
        filtered.append(P[own, own].copy())
        cloned.append(P[clone, clone].copy())
        found.append(error[clone].copy())
    x, S = [np.zeros(STATES)], [filtered[-1]]
    for k in range(len(filtered) - 1, 0, -1):
        x.append(found[k] + gain[k] @ x[-1])
        S.append(cloned[k] + gain[k] @ (S[-1] - filtered[k]) @ gain[k].T)
    return np.array(x[::-1]), np.array(S[::-1]), np.array(filtered)


def test_a_lag_of_the_whole_walk_is_rauch_tung_striebel(short: Walk) -> None:
    error, covariance, filtered = rauch_tung_striebel(short.imu)
    plain = FootIns(rig_of(CALIBRATED)).run(short.imu)
    smooth = FootInsSmoother(10.0, CALIBRATED).run(short.imu)
    aligned = plain.aligned & np.roll(plain.aligned, 1)
    moved = smooth.trajectory.p_frame_in_world - plain.trajectory.p_frame_in_world
    sd = np.sqrt(np.diagonal(plain.trajectory.covariance, axis1=1, axis2=2))
    turned = Rotation.from_quat(smooth.trajectory.q_world_frame, scalar_first=True)
    turned *= Rotation.from_quat(plain.trajectory.q_world_frame, scalar_first=True).inv()
    assert np.max(np.abs(error[:, :3])) > 2e-3  # smoothing has something to say
    np.testing.assert_allclose(((moved - error[:, :3]) / sd[:, :3])[aligned], 0.0, atol=1e-4)
    np.testing.assert_allclose(((turned.as_rotvec() - error[:, 6:9]) / sd[:, 3:])[aligned], 0.0, atol=1e-4)
    # without the errors that are considered, not estimated: both reports have them alike
    considered = np.diagonal(plain.trajectory.covariance[:, 3:, 3:] - filtered[:, 6:9, 6:9], axis1=1, axis2=2)
    got = np.diagonal(smooth.trajectory.covariance, axis1=1, axis2=2)[:, 3:] - considered
    np.testing.assert_allclose(got[aligned], np.diagonal(covariance, axis1=1, axis2=2)[aligned, 6:9], rtol=1e-3)


@pytest.mark.parametrize("at", [150, 333, 400])
def test_a_lag_is_the_whole_interval_from_its_end(longer: Walk, at: int) -> None:
    lag_s, later = 0.75, 90
    by_lag = FootInsSmoother(lag_s, ADIS16485).run(longer.imu).trajectory
    whole = FootInsSmoother(10.0, ADIS16485).run(cut(longer.imu, at + later + 1)).trajectory
    np.testing.assert_allclose(by_lag.p_frame_in_world[at], whole.p_frame_in_world[at], atol=1e-9)
    np.testing.assert_allclose(by_lag.q_world_frame[at], whole.q_world_frame[at], atol=1e-9)
    np.testing.assert_allclose(by_lag.covariance[at], whole.covariance[at], rtol=1e-6, atol=1e-12)


def test_no_lag_is_the_filter(longer: Walk) -> None:
    plain, smooth = FootIns(rig_of(CALIBRATED)).run(longer.imu), FootInsSmoother(0.0, CALIBRATED).run(longer.imu)
    np.testing.assert_array_equal(smooth.trajectory.t_ns, plain.trajectory.t_ns)
    np.testing.assert_array_equal(smooth.trajectory.p_frame_in_world, plain.trajectory.p_frame_in_world)
    np.testing.assert_array_equal(smooth.v_imu_in_world, plain.v_imu_in_world)
    np.testing.assert_array_equal(smooth.standing_speed_sd, plain.standing_speed_sd)
    np.testing.assert_allclose(smooth.trajectory.covariance, plain.trajectory.covariance, rtol=1e-12)


def test_what_follows_never_makes_it_less_sure(longer: Walk) -> None:
    plain, smooth = FootIns(rig_of(CALIBRATED)).run(longer.imu), FootInsSmoother(1.0, CALIBRATED).run(longer.imu)
    P, S = plain.trajectory.covariance, smooth.trajectory.covariance
    sd = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    scale = sd[:, :, None] * sd[:, None, :]
    assert np.linalg.eigvalsh((P - S) / scale)[:, 0].min() > -0.01  # the state that it refers to has moved a little
    assert np.linalg.eigvalsh(S / scale)[:, 0].min() > 0.0
    ratio = np.sqrt(np.trace(S[:, :3, :3], axis1=1, axis2=2) / np.trace(P[:, :3, :3], axis1=1, axis2=2))
    assert ratio.max() < 1.0 + 1e-3
    assert ratio[plain.aligned].min() < 0.9


def within_swing(path: FootInsPath, truth: Walk) -> float:
    """RMS of the position's error in swing, less the straight line between the errors of the stances about it, m."""
    error = path.trajectory.p_frame_in_world - truth.p_imu_in_world
    speed = np.linalg.norm(np.gradient(truth.p_imu_in_world, truth.t_ns * 1e-9, axis=0), axis=1)
    edges = np.flatnonzero(np.diff(np.r_[0, speed < 0.01, 0])).reshape(-1, 2)
    stands = [(a + b) // 2 for a, b in edges if b - a > 10]
    line = np.column_stack([np.interp(np.arange(len(error)), stands, error[stands, i]) for i in range(3)])
    return float(np.sqrt(((error - line)[speed > 0.3] ** 2).sum(1).mean()))


def test_the_middle_of_a_swing_is_better_known() -> None:
    ratio = []
    for seed in range(3):
        truth = walk(strides=6, turn_rad=0.5, calibration=ADIS16485, rng=np.random.default_rng(seed))
        start = StartPose(p_imu_in_world=truth.p_imu_in_world[0], q_world_imu=truth.q_world_imu[0])
        plain = within_swing(FootIns(LEFT_FOOT, start=start).run(truth.imu), truth)
        ratio.append(within_swing(FootInsSmoother(1.0, ADIS16485, start=start).run(truth.imu), truth) / plain)
    assert np.mean(ratio) < 0.7


def test_sample_by_sample_and_block_give_identical_numbers(longer: Walk) -> None:
    whole = FootInsSmoother(0.5, ADIS16485).run(longer.imu)
    stepwise = FootInsSmoother(0.5, ADIS16485)
    estimates = [e for e in map(stepwise.update, longer.imu) if e is not None]
    rest = stepwise.finish()
    n = len(estimates)
    assert 0 < len(rest.trajectory) == len(whole.trajectory) - n < 70
    assert all(late.t_ns - e.t_ns >= 500_000_000 for e, late in zip(estimates, list(longer.imu)[-n:]))
    p = whole.trajectory.p_frame_in_world
    np.testing.assert_array_equal([e.pose.p_frame_in_world for e in estimates], p[:n])
    np.testing.assert_array_equal(rest.trajectory.p_frame_in_world, p[n:])
    np.testing.assert_array_equal([e.v_imu_in_world for e in estimates], whole.v_imu_in_world[:n])
    np.testing.assert_array_equal([e.aligned for e in estimates], whole.aligned[:n])
    pose = np.r_[0:3, 6:9]
    np.testing.assert_array_equal(
        [e.covariance[np.ix_(pose, pose)] for e in estimates], whole.trajectory.covariance[:n]
    )
    assert stepwise.held == 0


@settings(max_examples=25, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(-(10**7), 10**9), st.floats(width=32) | st.floats(-60.0, 60.0)), min_size=1, max_size=60
    ),
    st.floats(0.0, 1.0),
)
def test_every_usable_sample_is_estimated_once_in_order(stream: list[tuple[int, float]], lag_s: float) -> None:
    t_ns = np.cumsum([step for step, _ in stream])
    value = np.array([v for _, v in stream])
    columns = {
        "angular_rate": np.column_stack([value, -value, value / 3]),
        "specific_force": np.full((len(t_ns), 3), 5.6),
    }
    imu = Block(topic="/foot_l/imu", kind=Imu, t_ns=t_ns, columns=columns)
    plain, smooth = FootIns().run(imu).trajectory, FootInsSmoother(lag_s).run(imu).trajectory
    np.testing.assert_array_equal(smooth.t_ns, plain.t_ns)
    assert np.all(np.isfinite(smooth.p_frame_in_world))
    assert np.all(np.isfinite(smooth.covariance))


def test_a_sensor_too_fast_for_the_window_has_a_shorter_lag() -> None:
    smoother = FootInsSmoother(0.02)
    held, returned = [], 0
    for k in range(300):
        still = Imu(topic="/f", t_ns=k * 100_000, angular_rate=np.zeros(3), specific_force=np.array([0.0, 0.0, 9.8]))
        returned += smoother.update(still) is not None
        held.append(smoother.held)
    assert max(held) <= 21
    assert returned == 300 - held[-1]


def test_a_lag_keeps_the_calibration_of_the_rig(longer: Walk) -> None:
    options, rig = Options(lag_s=0.5), Rig(imus={"/foot_l/imu": ADIS16485})
    smooth = FootIns.batch(rig, options).run(longer.imu).trajectory
    np.testing.assert_array_equal(
        smooth.covariance, FootInsSmoother(0.5, ADIS16485).run(longer.imu).trajectory.covariance
    )
    plain = FootIns.batch(None, options).run(longer.imu).trajectory
    np.testing.assert_array_equal(plain.covariance, FootInsSmoother(0.5).run(longer.imu).trajectory.covariance)
    assert not np.array_equal(plain.covariance, smooth.covariance)


@pytest.mark.parametrize("lag_s", [-0.1, 11.0, float("nan")])
def test_a_bad_lag_is_refused(lag_s: float) -> None:
    with pytest.raises(ConfigError, match="lag_s"):
        FootInsSmoother(lag_s)


def test_a_filter_without_a_lag_refuses_one() -> None:
    with pytest.raises(ConfigError, match="lag_s"):
        FootIns(options=Options(lag_s=0.5))
