import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.outputs.alignment import Rigid, align
from stridetwin.outputs.path.scores import armse_2d, compare, nees_position, relative_errors_m, score
from stridetwin.outputs.truth import TruePath
from stridetwin.streams.errors import RecordingError
from stridetwin.streams.samples import Block, Odometry
from stridetwin.streams.trajectory import Trajectory

T_NS = np.arange(0, 20_000_000_001, 20_000_000)


def walk(length=12.0):
    """A gentle curve that turns and climbs."""
    t = T_NS * 1e-9
    p = np.column_stack([length * t / 20, np.sin(t / 3), 0.2 * np.sin(t / 5)])
    v = np.column_stack([np.full_like(t, length / 20), np.cos(t / 3) / 3, 0.04 * np.cos(t / 5)])
    q = Rotation.from_euler("ZYX", np.column_stack([0.3 * np.sin(t / 4), 0.2 * t / 20, 0 * t + 0.1]))
    return TruePath(t_ns=T_NS, p_frame_in_world=p, v_frame_in_world=v, q_world_frame=q.as_quat(scalar_first=True))


def turned(path, yaw, shift, rotation=None):
    R = Rotation.from_rotvec([0, 0, yaw]) if rotation is None else rotation
    return Rigid(R=R.as_matrix(), t=np.asarray(shift, float)).apply(path)


def offset(path, error):
    return Trajectory(t_ns=path.t_ns, p_frame_in_world=path.p_frame_in_world + error, q_world_frame=path.q_world_frame)


yaws = st.floats(-3.1, 3.1)
shifts = st.tuples(*[st.floats(-50, 50)] * 3)


def test_the_truth_itself_has_no_error():
    scores = score(compare(walk().poses, walk()))
    for key in (
        "ape_rmse_m",
        "ape_max_m",
        "end_error_m",
        "end_error_pct",
        "rpe_1m_pct",
        "rpe_5m_pct",
        "armse_2d_m",
    ):
        assert scores[key] == pytest.approx(0, abs=1e-7)
    assert scores["coverage_pct"] == 100
    assert scores["duration_s"] == 20
    assert "nees_position_mean" not in scores


@settings(deadline=None, max_examples=25)
@given(yaw=yaws, shift=shifts, how=st.sampled_from(["start", "yaw", "se3"]))
def test_scores_do_not_see_where_the_estimator_put_its_world(yaw, shift, how):
    path = walk()
    drift = 0.01 * (T_NS * 1e-9)[:, None] * [1.0, -0.5, 0.2]
    estimate = offset(path.poses, drift)
    here, there = (score(compare(e, path, how)) for e in (estimate, turned(estimate, yaw, shift)))
    assert here == pytest.approx(there, abs=1e-7)


@settings(deadline=None, max_examples=25)
@given(angles=st.tuples(*[st.floats(-1.4, 1.4)] * 3), shift=shifts)
def test_se3_alignment_undoes_any_rigid_transform(angles, shift):
    truth = walk().poses
    estimate = turned(truth, 0, shift, Rotation.from_euler("ZYX", angles))
    back = align(estimate, truth, "se3").apply(estimate)
    assert back.p_frame_in_world == pytest.approx(truth.p_frame_in_world, abs=1e-8)
    assert np.abs(np.sum(back.q_world_frame * truth.q_world_frame, axis=1)) == pytest.approx(1, abs=1e-9)


def test_a_steady_drift_appears_in_every_score():
    path = walk()
    t = (T_NS * 1e-9)[:, None]
    comparison = compare(offset(path.poses, 0.01 * t * [1.0, 0, 0] + 0.005 * t * [0, 0, 1.0]), path)
    scores = score(comparison)
    total = np.hypot(0.2, 0.1)
    assert scores["end_error_m"] == pytest.approx(total, rel=1e-6)
    assert scores["ape_max_m"] == pytest.approx(total, rel=1e-6)
    assert scores["ape_mean_m"] == pytest.approx(total / 2, rel=1e-3)
    assert scores["ape_rmse_m"] == pytest.approx(total / np.sqrt(3), rel=2e-3)
    assert scores["end_height_error_m"] == pytest.approx(0.1, rel=1e-6)
    assert scores["end_error_pct"] == pytest.approx(100 * total / scores["distance_m"])
    speed = scores["distance_m"] / 20
    assert scores["rpe_5m_pct"] == pytest.approx(100 * total / 20 / speed, rel=0.05)


def test_relative_errors_need_a_path_as_long_as_the_span():
    comparison = compare(walk(length=1.0).poses, walk(length=1.0))
    assert len(relative_errors_m(comparison, 50.0)) == 0


def test_truth_between_samples_is_a_cubic():
    t = np.array([0, 1_000_000_000, 2_500_000_000])
    s = t * 1e-9
    cubic = np.polynomial.Polynomial([1.0, -2.0, 0.5, 0.3])
    p, v = (np.column_stack([f(s), 0 * s, 0 * s]) for f in (cubic, cubic.deriv()))
    q = Rotation.from_rotvec(np.outer(s, [0, 0, 0.4])).as_quat(scalar_first=True)
    path = TruePath(t_ns=t, p_frame_in_world=p, v_frame_in_world=v, q_world_frame=q)
    at = np.array([0, 300_000_000, 1_700_000_000, 2_500_000_000])
    poses = path.at(at)
    assert poses.p_frame_in_world[:, 0] == pytest.approx(cubic(at * 1e-9), abs=1e-12)
    angle = 2 * np.arctan2(poses.q_world_frame[:, 3], poses.q_world_frame[:, 0])
    assert angle == pytest.approx(0.4 * at * 1e-9, abs=1e-9)
    with pytest.raises(ValueError, match="outside"):
        path.at(np.array([2_500_000_001]))


def test_an_honest_covariance_has_nees_three_and_95_percent_within():
    rng = np.random.default_rng(1)
    path = walk()
    half = np.array([[0.05, 0, 0], [0.02, 0.03, 0], [0.0, 0.01, 0.02]])
    covariance = np.zeros((len(T_NS), 6, 6))
    covariance[:, :3, :3] = half @ half.T
    error = rng.normal(size=(len(T_NS), 3)) @ half.T
    error[0] = 0
    estimate = Trajectory(
        t_ns=T_NS,
        p_frame_in_world=path.p_frame_in_world + error,
        q_world_frame=path.q_world_frame,
        covariance=covariance,
    )
    moved = turned(estimate, 1.2, (3, 4, 5))
    scores = score(compare(moved, path))
    assert scores["nees_position_mean"] == pytest.approx(3, abs=0.3)
    assert scores["nees_position_within_95_pct"] == pytest.approx(95, abs=2)
    assert nees_position(compare(moved, path)) == pytest.approx(nees_position(compare(estimate, path)), abs=1e-6)


def test_estimates_that_cannot_be_scored_are_refused():
    path = walk()
    bad = offset(path.poses, np.where(T_NS[:, None] == T_NS[7], np.nan, 0.0) * np.ones(3))
    with pytest.raises(RecordingError, match=r"not finite at t = 0\.140 s"):
        compare(bad, path)
    late = Trajectory(t_ns=T_NS + 10**12, p_frame_in_world=path.p_frame_in_world, q_world_frame=path.q_world_frame)
    with pytest.raises(RecordingError, match=r"0 poses of the estimate lie within the truth's 0\.000-20\.000 s"):
        compare(late, path)


def test_truth_must_be_a_finite_path():
    columns = {
        "p_frame_in_world": np.zeros((2, 3)),
        "v_frame_in_world": np.zeros((2, 3)),
        "q_world_frame": np.tile([1.0, 0, 0, 0], (2, 1)),
        "angular_rate": np.zeros((2, 3)),
    }
    block = Block(topic="/truth/x/odometry", kind=Odometry, t_ns=np.array([0, 10**9]), columns=columns)
    TruePath.of(block)
    columns["p_frame_in_world"][1, 2] = np.inf
    with pytest.raises(RecordingError, match=r"/truth/x/odometry: not finite at 1\.000 s"):
        TruePath.of(block)


def slow_armse(estimate, truth):
    """As the benchmark's own loop has it."""
    e, g = estimate[:, :2] - estimate[0, :2], truth[:, :2] - truth[0, :2]
    i = next(k for k in range(len(e)) if np.hypot(*e[k]) > 0.8)
    a = np.arctan2(g[i, 1], g[i, 0]) - np.arctan2(e[i, 1], e[i, 0])
    total = 0.0
    for (ex, ey), (gx, gy) in zip(e, g, strict=True):
        x, y = np.cos(a) * ex - np.sin(a) * ey, np.sin(a) * ex + np.cos(a) * ey
        total += np.sqrt(((x - gx) ** 2 + (y - gy) ** 2) / 2)
    return total / len(e)


@settings(deadline=None, max_examples=20)
@given(yaw=yaws, scale=st.floats(0.9, 1.1))
def test_armse_is_what_the_benchmark_defines(yaw, scale):
    truth = walk().p_frame_in_world
    estimate = scale * turned(walk().poses, yaw, (1, 2, 3)).p_frame_in_world
    assert armse_2d(estimate, truth) == pytest.approx(slow_armse(estimate, truth), abs=1e-12)
    assert armse_2d(truth * [1, 1, 5], truth) == pytest.approx(0, abs=1e-12)
