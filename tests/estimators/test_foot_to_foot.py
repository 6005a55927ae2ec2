"""The filter of two feet: Jacobians, one foot alone, faults, and the two ways to feed it."""

from __future__ import annotations

import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from foot_motion import ADIS16485, CALIBRATED, LEFT_FOOT, rig_of, walk
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import FootIns
from stridetwin.estimators.foot_ins.parameters import FootInsParameters, for_sensor
from stridetwin.estimators.foot_ins.state import D_POSITION, D_VELOCITY, NAVIGATING, PHASE, POSITION, STATES, VELOCITY
from stridetwin.estimators.foot_to_foot import (
    BoardObservation,
    FootToFoot,
    FootToFootEstimate,
    FootToFootParameters,
    PublishedParameters,
    RelativePosition,
    follow,
    published,
    relative_updates,
    state,
)
from stridetwin.estimators.foot_to_foot.parameters import for_kernel
from stridetwin.estimators.foot_to_foot.rewind import rewind as compiled_rewind
from stridetwin.estimators.foot_to_foot.state import ALL_STATES, CLOCKS, FEET, MOUNTS, Pair, blank_pair
from stridetwin.sim.config import Level, Route, TwinConfig
from stridetwin.sim.sensors.standard_rig import sensor_rig
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.rig import Mount, Rig
from stridetwin.streams.samples import Block, Imu, Range
from stridetwin.studies.jao2020.jao_simulation import JaoSimulation, SteadyWalk
from tests.estimators.from_python import from_python
from tests.estimators.one_foot import take

inject_all = from_python(state.inject_all)
rewind = from_python(compiled_rewind)
see = from_python(relative_updates.board_update)
reduced = from_python(relative_updates.reduce_measurement)
board_in_camera = from_python(relative_updates.board_in_camera)
step_published = from_python(published.step_published)
relative_position_update = from_python(published.relative_position_update)

GRAVITY = FootInsParameters().gravity_mps2
RIGHT = replace(ADIS16485, topic="/foot_r/imu", mount=Mount(body="foot_r"))


@pytest.fixture(scope="module")
def short() -> tuple[JaoSimulation, dict[str, Block[Imu]], list]:
    """Five strides of the paper's simulation."""
    simulation = JaoSimulation(SteadyWalk(strides=5))
    rng = np.random.default_rng(3)
    return simulation, simulation.inertial(rng)[0], simulation.aiding_measurements(rng)


def estimator_for(simulation: JaoSimulation, method: str = "proposed", **options: object) -> FootToFoot:
    return FootToFoot(simulation.rig, **{"options": Options(method=method), "start": simulation.start()} | options)


def ends(simulation: JaoSimulation, imus: dict[str, Block[Imu]], aids: list, method: str = "proposed") -> np.ndarray:
    paths = estimator_for(simulation, method).run(imus, aids)
    return np.array([simulation.end_error(f, paths[f].trajectory.p_frame_in_world[-1]) for f in imus])


def moving_pair(seed: int) -> Pair:
    """Two feet in the middle of some motion, cameras and boards mounted anyhow."""
    rng = np.random.default_rng(seed)
    mounts = np.column_stack([rng.normal(0, 0.1, (4, 3)), Rotation.random(4, rng=rng).as_quat(scalar_first=True)])
    pair = blank_pair(mounts, np.zeros((4, 6)), 0.0, 0.0, np.zeros((2, 3)), np.zeros(3))
    parameters = for_sensor(FootInsParameters(stationary_speed_mps=1e3), None)
    for foot in range(2):
        k = np.arange(80)
        moves = k[:, None] >= 40
        rate, force = moves * rng.normal(0.0, [[[3.0]], [[5.0]]], (2, 80, 3))
        take(pair.feet[foot], parameters, k * 8_000_000, rate, force + [0.0, 0.0, GRAVITY])
        assert pair.feet[foot].clock[PHASE] == NAVIGATING
    pair.covariance[:] = 0.0
    return pair


def seen(pair: Pair, camera: int, t_ns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    then_ns = t_ns + round(1e9 * pair.late[camera])
    a, b = (rewind(pair.feet[f], GRAVITY, then_ns, 0.1) for f in (camera, 1 - camera))
    assert a.known
    assert b.known
    p, R = board_in_camera(pair, camera, a, b)
    return np.array(p), np.array(R), pair.work.jacobian.copy()


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 1000), st.integers(0, 1), st.integers(0, 12_000_000))
def test_jacobian_of_the_board_in_the_camera_is_its_derivative(seed: int, camera: int, age_ns: int) -> None:
    t_ns = 79 * 8_000_000 - age_ns
    still = moving_pair(seed)
    p, R, G = seen(still, camera, t_ns)
    small = 1e-6
    # The tilt acts on a rewound position through gravity as well, but for 0.5 g age²; and so do the force's biases.
    tolerance = 1e-6 + 50.0 * (age_ns * 1e-9) ** 2
    for i in range(ALL_STATES):
        pair = copy.deepcopy(still)
        pair.error[i] = small
        inject_all(pair)
        p1, R1, _ = seen(pair, camera, t_ns)
        turn = Rotation.from_matrix(R1 @ R.T).as_rotvec()
        np.testing.assert_allclose(np.r_[p1 - p, turn] / small, G[:, i], atol=tolerance + 1e-4)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 1000), st.integers(0, 1), st.integers(0, 40_000_000))
def test_a_turn_of_the_whole_world_is_not_seen(seed: int, camera: int, age_ns: int) -> None:
    pair = moving_pair(seed)
    up, turn = np.array([0.0, 0.0, 1.0]), np.zeros(ALL_STATES)
    for foot in range(2):
        x, o = pair.feet[foot].nominal, STATES * foot
        turn[o : o + 3], turn[o + 3 : o + 6], turn[o + 8] = np.cross(up, x[:3]), np.cross(up, x[3:6]), 1.0
    _, _, G = seen(pair, camera, 79 * 8_000_000 - age_ns)
    np.testing.assert_allclose(G @ turn, 0.0, atol=1e-9)


@given(st.integers(1, 20))
@settings(max_examples=10, deadline=None)
def test_rewinding_meets_the_state_of_then(back: int) -> None:
    parameters = for_sensor(FootInsParameters(stationary_speed_mps=1e3), None)
    rng = np.random.default_rng(back)
    mounts, arms = np.tile([0.0, 0, 0, 1, 0, 0, 0], (4, 1)), np.zeros((2, 3))
    pair = blank_pair(mounts, np.zeros((4, 6)), 0.0, 0.0, arms, np.zeros(3))
    foot, then = pair.feet[0], None
    for k in range(80):
        moves = k >= 40
        force = np.array([0.0, 0.0, GRAVITY]) + rng.normal(0.0, 5.0 * moves, 3)
        take(foot, parameters, k * 8_000_000, rng.normal(0.0, 3.0 * moves, 3), force)
        foot.covariance[:] = 0.0  # so that nothing is corrected
        if k == 79 - back:
            then = foot.nominal.copy()
    found = rewind(foot, GRAVITY, (79 - back) * 8_000_000, 1.0)
    assert found.known
    assert then is not None
    assert found.age == pytest.approx(back * 0.008)
    np.testing.assert_allclose(found.p, then[:3], atol=1e-12)
    np.testing.assert_allclose(found.v, then[3:6], atol=1e-12)
    np.testing.assert_allclose(found.R, Rotation.from_quat(then[6:10], scalar_first=True).as_matrix(), atol=1e-12)


def test_a_board_predicted_far_off_is_found_where_it_is() -> None:
    """Perspective is no straight line: one step from a decimetre off misses by a centimetre, and seems a speed."""
    points = np.array([[0.02 * i, 0.02 * j, 0.0] for i in range(6) for j in range(5)]) - [0.05, 0.04, 0.0]
    p, turn = np.array([0.02, -0.03, 0.45]), Rotation.from_euler("xyz", [0.3, 2.8, 0.2])
    seen = turn.apply(points) + p
    predicted, about = p + [0.05, -0.04, 0.12], Rotation.from_rotvec([0.02, -0.03, 0.01]) * turn
    covariance, sd = np.diag([0.15] * 3 + [0.03] * 3) ** 2, np.full(len(points), 1e-4)
    rays = seen[:, :2] / seen[:, 2:]
    board = state.board_workspace()
    board.covariance[:] = covariance
    pose = tuple(predicted), tuple(tuple(row) for row in about.as_matrix())
    ahead, _ = reduced(board, *pose, len(points), points, rays, sd, 0.0, 8.0)
    T, z = board.reduced.jacobian, board.reduced.innovation
    found = covariance @ T.T @ np.linalg.solve(T @ covariance @ T.T + 64.0 * np.eye(6), z)
    assert ahead
    np.testing.assert_allclose(predicted + found[:3], p, atol=2e-3)


def test_one_foot_alone_is_the_one_foot_filter() -> None:
    truth = walk(strides=6, calibration=ADIS16485, rng=np.random.default_rng(0))
    one = FootIns(rig_of(CALIBRATED)).run(truth.imu)
    two = FootToFoot(rig_of(CALIBRATED)).run({"l": truth.imu})["l"]
    np.testing.assert_allclose(two.trajectory.p_frame_in_world, one.trajectory.p_frame_in_world, atol=1e-12)
    np.testing.assert_allclose(two.trajectory.covariance, one.trajectory.covariance, atol=1e-12)
    np.testing.assert_array_equal(two.standing_speed_sd, one.standing_speed_sd)
    np.testing.assert_array_equal(two.aligned, one.aligned)


def test_two_feet_without_cameras_and_echoes_are_two_one_foot_filters(short) -> None:
    simulation, imus, _ = short
    paths = FootToFoot(replace(simulation.rig, cameras={}), start=simulation.start()).run(imus)
    for foot, start in simulation.start().items():
        alone = FootIns(simulation.rig, start=start, options=Options(foot=foot)).run(imus[foot])
        np.testing.assert_allclose(
            paths[foot].trajectory.p_frame_in_world, alone.trajectory.p_frame_in_world, atol=1e-12
        )


def test_feet_that_nothing_joins_are_said(short) -> None:
    simulation, imus, _ = short
    rig = replace(simulation.rig, cameras={}, others={})
    recording = SimpleNamespace(
        rig=rig, path="walk.mcap", topics=tuple(b.topic for b in imus.values()), block=lambda t: imus[t[len("/foot_")]]
    )
    for estimate in FootToFoot.follow(recording, Options()):
        assert any("nothing joins the feet" in note for note in estimate.notes)


@pytest.mark.parametrize("method", ["proposed", "published", "zupt_relative_distance"])
def test_sample_by_sample_and_block_give_identical_numbers(short, method: str) -> None:
    simulation, imus, aids = short
    paths = estimator_for(simulation, method).run(imus, aids)
    stepwise = estimator_for(simulation, method)
    samples = sorted([*imus["l"], *imus["r"], *aids], key=lambda s: (s.t_ns, not isinstance(s, Imu)))
    last = [e for e in map(stepwise.update, samples) if e is not None][-1]
    path, right = paths["r"].trajectory, last.feet["r"]  # the left foot's last row is older: the right moves it yet
    np.testing.assert_array_equal(right.pose.p_frame_in_world, path.p_frame_in_world[-1])
    np.testing.assert_array_equal(right.pose.q_world_frame, path.q_world_frame[-1])
    np.testing.assert_array_equal(right.covariance[:3, :3], path.covariance[-1, :3, :3])


@pytest.mark.parametrize("method", ["proposed", "zupt_relative_distance"])
@pytest.mark.parametrize("echoes_last", [False, True])  # at equal times; without it topics are in alphabetical order
def test_every_pose_is_the_same_sample_by_sample_and_in_a_block(short, method: str, echoes_last: bool) -> None:
    simulation, imus, aids = short
    echoes = [a for a in aids if isinstance(a, Range)]
    samples = [*imus["l"], *imus["r"], *echoes]
    samples.sort(key=lambda s: (s.t_ns, echoes_last and isinstance(s, Range), s.topic))
    assert {s.t_ns for s in echoes} & set(imus["r"].t_ns.tolist())
    whole = estimator_for(simulation, method).run(imus, echoes)
    for foot, path in follow(estimator_for(simulation, method), samples).items():
        expected = whole[foot].trajectory
        np.testing.assert_array_equal(path.trajectory.t_ns, expected.t_ns)
        np.testing.assert_array_equal(path.trajectory.p_frame_in_world, expected.p_frame_in_world)
        np.testing.assert_array_equal(path.trajectory.q_world_frame, expected.q_world_frame)


def test_blocks_in_pieces_give_the_same_path(short) -> None:
    simulation, imus, aids = short
    whole = estimator_for(simulation).run(imus, aids)
    pieces, cut_ns = estimator_for(simulation), int(2.5e9)
    ends = {}
    for part in (lambda t: t <= cut_ns, lambda t: t > cut_ns):
        rows = {f: part(b.t_ns) for f, b in imus.items()}
        cut = {
            f: replace(b, t_ns=b.t_ns[rows[f]], columns={n: c[rows[f]] for n, c in b.columns.items()})
            for f, b in imus.items()
        }
        ends = pieces.run(cut, [a for a in aids if part(a.t_ns)])
    for foot in FEET:
        np.testing.assert_array_equal(
            ends[foot].trajectory.p_frame_in_world[-1], whole[foot].trajectory.p_frame_in_world[-1]
        )


def assert_sane(estimate: FootToFootEstimate) -> None:
    for foot in estimate.feet.values():
        assert np.all(np.isfinite(foot.pose.p_frame_in_world))
        assert np.linalg.norm(foot.pose.q_world_frame) == pytest.approx(1.0, abs=1e-9)
    assert np.all(np.isfinite(estimate.covariance))
    np.testing.assert_allclose(estimate.covariance, estimate.covariance.T, atol=1e-12)
    assert np.linalg.eigvalsh(estimate.covariance)[0] > -1e-9


def test_estimates_are_sane_after_every_kind_of_sample(short) -> None:
    simulation, imus, aids = short
    estimator = estimator_for(simulation)
    samples = sorted([*imus["l"], *imus["r"], *aids], key=lambda s: (s.t_ns, not isinstance(s, Imu)))
    for sample in samples[:1500]:
        if (estimate := estimator.update(sample)) is not None:
            assert_sane(estimate)


def test_the_joint_covariance_is_that_of_both_feet_with_what_they_share(short) -> None:
    """In the blocks of each foot everything but the position, which knows the scale of the way as well."""
    simulation, imus, aids = short
    estimator = estimator_for(simulation)
    samples = sorted([*imus["l"], *imus["r"], *aids], key=lambda s: (s.t_ns, not isinstance(s, Imu)))
    estimate = [e for s in samples[:1500] if (e := estimator.update(s)) is not None][-1]
    assert estimate.covariance.shape == (30, 30)
    for k, foot in enumerate(FEET):
        own = estimate.covariance[15 * k : 15 * k + 15, 15 * k : 15 * k + 15]
        np.testing.assert_array_equal(own[3:, 3:], estimate.feet[foot].covariance[3:, 3:])
    assert np.linalg.eigvalsh(estimate.covariance).min() > -1e-12
    assert abs(estimate.covariance[:15, 15:]).max() > 0.0


def test_observing_the_other_shoe_holds_the_headings_together(short) -> None:
    simulation, imus, aids = short
    biased = {
        f: replace(b, columns=dict(b.columns) | {"angular_rate": b.columns["angular_rate"] + [0, 0, sign * 0.01]})
        for (f, b), sign in zip(imus.items(), (1, -1))
    }
    blind, seeing = ends(simulation, biased, []), ends(simulation, biased, aids)
    assert np.all(np.abs(blind[:, 1]) > 0.1)
    assert np.all(np.abs(seeing[:, 1]) < 0.02)


def test_a_camera_that_is_covered_leaves_the_feet_to_themselves_and_says_so(short) -> None:
    simulation, imus, aids = short
    covered = [a for a in aids if not (isinstance(a, BoardObservation) and 2e9 < a.t_ns < 4e9)]
    spread = []
    for heard in (aids, covered):
        paths = estimator_for(simulation).run(imus, [a for a in heard if isinstance(a, BoardObservation)])
        left, right = (paths[f].trajectory for f in FEET)
        k = int(np.searchsorted(left.t_ns, int(3.9e9)))
        spread.append(np.trace(left.covariance[k, :3, :3]))
        assert np.linalg.norm(simulation.end_error("r", right.p_frame_in_world[-1])) < 0.1
    assert spread[1] > spread[0]


def test_the_sonar_is_used_where_the_other_shoe_is_not_seen(short) -> None:
    simulation, imus, aids = short
    echoes = [a for a in aids if isinstance(a, Range)]
    alone, heard = (estimator_for(simulation).run(imus, a)["l"].trajectory for a in ([], echoes))
    assert not np.array_equal(alone.p_frame_in_world[-1], heard.p_frame_in_world[-1])
    both, seen_only = (
        estimator_for(simulation).run(imus, a)["l"].trajectory.p_frame_in_world[-1]
        for a in (aids, [a for a in aids if isinstance(a, BoardObservation)])
    )
    assert np.linalg.norm(both - seen_only) < 0.005


def test_an_imu_that_dies_leaves_the_other_foot_as_it_was(short) -> None:
    simulation, imus, aids = short
    dead = {"l": imus["l"]}
    estimator = estimator_for(simulation)
    path = estimator.run(dead, aids)["l"].trajectory
    alone = estimator_for(simulation).run(dead)["l"].trajectory
    np.testing.assert_array_equal(path.p_frame_in_world, alone.p_frame_in_world)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e9])
@pytest.mark.parametrize("method", ["proposed", "published"])
def test_impossible_repeated_and_late_samples_are_ignored(short, value: float, method: str) -> None:
    simulation, imus, _ = short
    clean, troubled = estimator_for(simulation, method), estimator_for(simulation, method)
    for i, sample in enumerate(list(imus["l"])[:200]):
        kept = clean.update(sample)
        bad = replace(sample, t_ns=sample.t_ns - 1, angular_rate=np.array([value, 0.0, 0.0]))
        if i % 20 == 7:
            assert troubled.update(bad) is None
        got = troubled.update(sample)
        assert troubled.update(sample) is None
    assert kept is not None
    assert got is not None
    np.testing.assert_array_equal(got.feet["l"].pose.p_frame_in_world, kept.feet["l"].pose.p_frame_in_world)


def test_an_observation_that_fits_no_board_moves_nothing_far(short) -> None:
    simulation, imus, aids = short
    rng = np.random.default_rng(0)
    wild = [
        replace(a, rays=rng.uniform(-0.7, 0.7, a.rays.shape)) if isinstance(a, BoardObservation) and i % 7 == 0 else a
        for i, a in enumerate(aids)
    ]
    assert np.all(np.linalg.norm(ends(simulation, imus, wild) - ends(simulation, imus, aids), axis=1) < 0.05)


def test_an_observation_too_late_is_left_out(short) -> None:
    simulation, imus, aids = short
    estimator = estimator_for(simulation)
    estimator.run(imus, [])
    before = estimator.update(replace(list(imus["l"])[-1], t_ns=int(imus["l"].t_ns[-1]) + 8_000_000))
    old = next(a for a in aids if isinstance(a, BoardObservation))
    after = estimator.update(old)
    assert before is not None
    assert after is not None
    np.testing.assert_array_equal(after.feet["l"].pose.p_frame_in_world, before.feet["l"].pose.p_frame_in_world)


def test_wrong_use_is_named(short) -> None:
    simulation, imus, _ = short
    with pytest.raises(ConfigError, match="proposed"):
        FootToFoot(simulation.rig, options=Options(method="magic"))
    with pytest.raises(ConfigError, match="threshold"):
        PublishedParameters(threshold=0.0)
    with pytest.raises(StrideTwinError, match="no IMU"):
        FootToFoot(Rig())
    with pytest.raises(StrideTwinError, match="/foot_l/imu"):
        estimator_for(simulation).update(replace(next(iter(imus["l"])), topic="/head/imu"))
    with pytest.raises(ConfigError, match="'r'"):
        FootToFoot(LEFT_FOOT).run(imus)
    with pytest.raises(ConfigError, match="4 to 64"):
        BoardObservation(
            topic="/foot_l/camera", t_ns=0, points_in_board=np.zeros((3, 3)), rays=np.zeros((3, 2)), ray_sd=np.ones(3)
        )
    with pytest.raises(ConfigError, match="three"):
        RelativePosition(topic="/foot_l/camera", t_ns=0, p_other_in_imu=np.zeros(2), sd=0.001)
    with pytest.raises(StrideTwinError, match="/head/camera is on neither foot"):
        estimator_for(simulation).update(
            RelativePosition(topic="/head/camera", t_ns=0, p_other_in_imu=np.ones(3), sd=1)
        )


def test_the_streams_are_imus_cameras_and_sonars_of_the_feet_alone() -> None:
    rig = sensor_rig(TwinConfig(name="all", route=Route(segments=(Level(length_m=2.0),)))).rig
    streams = FootToFoot.streams(rig, Options())
    assert [(s.topic, s.required) for s in streams] == [
        ("/foot_l/imu", True),
        ("/foot_r/imu", True),
        ("/foot_l/camera", False),
        ("/foot_r/camera", False),
        ("/foot_l/sonar", False),
        ("/foot_r/sonar", False),
    ]


def test_feet_start_side_by_side_where_nobody_says_otherwise() -> None:
    rig = Rig(imus={"/foot_l/imu": ADIS16485, "/foot_r/imu": RIGHT})
    still = walk(strides=1)
    paths = FootToFoot(rig).run({"l": still.imu, "r": replace(still.imu, topic="/foot_r/imu")})
    np.testing.assert_allclose(
        paths["l"].trajectory.p_frame_in_world[5] - paths["r"].trajectory.p_frame_in_world[5],
        [0.0, 0.2, 0.0],
        atol=1e-9,
    )
    assert paths["r"].trajectory.covariance[5, 1, 1] > 0.1**2 > paths["l"].trajectory.covariance[5, 1, 1]


def test_relative_position_of_a_board_pose_is_the_papers_equation() -> None:
    rng = np.random.default_rng(1)
    T_imu_camera, T_other_board, T_camera_board = np.eye(4), np.eye(4), np.eye(4)
    for T in (T_imu_camera, T_other_board):
        T[:3, :3], T[:3, 3] = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    T_camera_board[:3, :3] = Rotation.from_rotvec([2.8, 0.3, 0.2]).as_matrix()
    T_camera_board[:3, 3] = 0.01, 0.02, 0.25
    points = np.column_stack([*(m.ravel() for m in np.mgrid[-4:5, -3:4] * 0.005), np.zeros(63)])
    seen = points @ T_camera_board[:3, :3].T + T_camera_board[:3, 3]
    observation = BoardObservation(
        topic="/foot_l/camera",
        t_ns=0,
        points_in_board=points,
        rays=seen[:, :2] / seen[:, 2:],
        ray_sd=np.full(len(points), 1e-4),
    )
    got = RelativePosition.of_observation(
        observation, T_imu_camera=T_imu_camera, T_other_board=T_other_board, R_camera_board=T_camera_board[:3, :3]
    )
    assert got is not None
    C_bf, p_bf = T_other_board[:3, :3], T_other_board[:3, 3]
    want = T_imu_camera[:3, 3] + T_imu_camera[:3, :3] @ (T_camera_board[:3, 3] - T_camera_board[:3, :3] @ C_bf.T @ p_bf)
    np.testing.assert_allclose(got.p_other_in_imu, want, atol=1e-6)
    assert 0.0 < got.sd < 0.05


def test_mounts_are_refined_within_their_prior(short) -> None:
    simulation, imus, aids = short
    estimator = estimator_for(simulation)
    before = np.diag(estimator._pair.covariance)[MOUNTS:].copy()
    estimator.run(imus, aids)
    after = np.diag(estimator._pair.covariance)[MOUNTS:]
    assert np.all(after <= before * (1 + 1e-9))
    assert np.any(after < 0.9 * before)


def test_the_published_method_has_the_calibrations_noise_alone_where_no_range_is_given() -> None:
    parameters = for_sensor(FootInsParameters(), ADIS16485, data_sheet_alone=True)
    assert ADIS16485.accelerometer_range == 0.0
    assert parameters.accel_limit_noise_mps2_rthz == parameters.gyro_limit_noise_radps_rthz == 0.0
    assert parameters.accel_noise_mps2_rthz == ADIS16485.accelerometer_noise_density


def test_the_published_zero_velocity_update_stops_a_foot() -> None:
    pair = moving_pair(3)
    memory, foot = pair.feet[0], for_sensor(FootInsParameters(), None)
    own = PublishedParameters(threshold=1e9, zero_velocity_sd_mps=0.01)
    parameters = for_kernel(FootToFootParameters(published=own), published=True)
    memory.covariance[D_VELOCITY : D_VELOCITY + 3, D_VELOCITY : D_VELOCITY + 3] = np.eye(3)
    t_ns = int(memory.ring_t_ns.max()) + 8_000_000
    memory.nominal[VELOCITY : VELOCITY + 3] = 0.4, -0.3, 0.2
    step_published(memory, foot, parameters, t_ns, (0.0, 0.0, 0.0), (0.0, 0.0, GRAVITY))
    assert np.linalg.norm(memory.nominal[VELOCITY : VELOCITY + 3]) < 0.02


@pytest.mark.parametrize("camera", [0, 1])
def test_the_published_relative_position_moves_both_feet_to_it(camera: int) -> None:
    pair = moving_pair(5)
    parameters, foot = for_kernel(FootToFootParameters(), published=True), for_sensor(FootInsParameters(), None)
    here, there = pair.feet[camera], pair.feet[1 - camera]
    t_ns = int(max(here.ring_t_ns.max(), there.ring_t_ns.max()))
    for memory in (here, there):
        at = memory.row + D_POSITION
        pair.covariance[at : at + 3, at : at + 3] = np.eye(3)
    a = rewind(here, GRAVITY, t_ns, 0.1)
    wanted = np.array([0.3, -0.2, 0.1])  # in the world
    before = [memory.nominal[POSITION : POSITION + 3].copy() for memory in (here, there)]
    measured = tuple((np.array(a.R).T @ wanted).tolist())
    sigmas = relative_position_update(pair, foot, parameters, camera, t_ns, measured, 0.01)
    after = [memory.nominal[POSITION : POSITION + 3] for memory in (here, there)]
    np.testing.assert_allclose(after[1] - after[0], wanted, atol=0.01)
    np.testing.assert_allclose(after[0] - before[0], before[1] - after[1], atol=1e-6)  # equally uncertain
    assert sigmas == pytest.approx(np.linalg.norm(wanted - (before[1] - before[0])) / 0.01, rel=1e-6)


def test_observations_that_cannot_be_used_leave_the_cameras_clock_as_sure_as_it_was() -> None:
    pair, parameters = moving_pair(4), for_kernel(FootToFootParameters(camera_clock_walk_s_rts=0.01))
    t_ns = 79 * 8_000_000
    pair.seen[0] = t_ns - 30_000_000_000
    p, R, _ = seen(pair, 0, t_ns)
    behind = (np.random.default_rng(0).normal(0.0, 0.02, (6, 3)) - [0.0, 0.0, 1.0] - p) @ R
    for _ in range(3):
        one_foot = for_sensor(FootInsParameters(), None)
        assert (
            see(pair, one_foot, parameters, 0, t_ns, 6, behind, np.zeros((6, 2)), np.full(6, 1e-3))
            == relative_updates.UNUSED
        )
    assert pair.covariance[CLOCKS, CLOCKS] == 0.0
