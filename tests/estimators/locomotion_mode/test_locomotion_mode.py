import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import Options
from stridetwin.estimators.locomotion_mode import MODES, LocomotionMode, LocomotionModeParameters
from stridetwin.estimators.locomotion_mode.body import _VIEW_TIME_S, Body
from stridetwin.estimators.locomotion_mode.parameters import Settings
from stridetwin.estimators.locomotion_mode.published import mode_between
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.rig import Mount, Rig
from stridetwin.streams.samples import Insole, Odometry
from tests.estimators.locomotion_mode.walker import RISER, STEP_M, STEPS, TREAD, footprints, samples
from tests.estimators.terrain_map.scenes import RIG, pose
from tests.pinned import SAME_POINTS, assert_pinned, columns

CAMERA = RIG.cameras["/head/color"]


def predictor(method="proposed"):
    return LocomotionMode(RIG, options=Options(method=method))


@pytest.fixture(scope="module")
def walk():
    return samples()


@pytest.fixture(scope="module")
def predicted(walk):
    mode = predictor()
    return [e for e in (mode.update(s) for s in walk) if e is not None]


def last_before(predicted, t_s):
    return [e for e in predicted if e.t_ns < t_s * 1e9][-1]


def test_every_step_is_predicted_before_the_foot_lands(predicted):
    for t, x, foot, mode in footprints()[1:]:
        step = last_before(predicted, t).steps[0]
        assert (step.foot, step.mode) == (foot, mode), t
        assert step.probabilities[mode] > 0.5
        assert (step.p_foot_in_world[1] > 0.03) == (foot == "l")
        assert abs(step.p_foot_in_world[1]) < 0.1
        if mode == "SA":
            assert x > (STEPS - 1) * TREAD or abs(step.p_foot_in_world[0] - x) < 0.05  # the landing leaves room
            assert abs(step.p_foot_in_world[2] - RISER * (1 + math.floor(x / TREAD))) < 0.02


def test_the_first_stair_is_known_two_steps_before_with_its_size(predicted):
    t, *_ = next(p for p in footprints() if p[3] == "SA")
    estimate = last_before(predicted, t - 1.2)
    ahead = [s for s in estimate.steps if s.mode == "SA"]
    assert ahead
    assert abs(ahead[0].t_ns * 1e-9 - t) < 0.3
    change = estimate.change
    assert change is not None
    assert change.mode == "SA"
    assert abs(change.p_in_world[0]) < 0.03
    assert abs(change.riser - RISER) < 0.01
    assert abs(change.tread - TREAD) < 0.015
    assert abs(change.time_s - (t - estimate.t_ns * 1e-9)) < 0.35


@pytest.mark.parametrize("method", ["proposed", "published"])
def test_coming_steps_are_numbered_from_the_next_one(walk, method):
    mode = predictor(method)
    made = [e for e in (mode.update(s) for s in walk[: len(walk) // 2]) if e is not None]
    assert made[-1].step > 2
    for estimate in made:
        assert [s.step for s in estimate.steps] == [estimate.step + k + 1 for k in range(len(estimate.steps))]


def test_a_pose_that_is_not_finite_leaves_the_body_where_it_was():
    mode = predictor()
    for k in range(3):
        mode.update(pose(20_000_000 * k, np.array([0.01 * k, 0.0, 1.6]), Rotation.identity()))
    place, t_ns = mode._body.p.copy(), mode._body.t_ns
    for bad in (np.array([math.nan, 0.0, 1.6]), np.array([0.0, math.inf, 1.6])):
        mode.update(pose(80_000_000, bad, Rotation.identity()))
        np.testing.assert_array_equal(mode._body.p, place)
        assert mode._body.t_ns == t_ns


def test_where_the_body_was_and_where_it_looks():
    body = Body(np.zeros(3), np.eye(3)[:, [1, 2, 0]] * [-1.0, -1.0, 1.0], Settings())  # the optical axis along x
    turn, dt = Rotation.from_euler("z", 0.5), 0.1
    for k in range(40):
        R = Rotation.identity() if k < 20 else turn
        body.add(pose(round(k * dt * 1e9), np.array([0.05 * k, 0.0, 1.6]), R))
    for back in (0.0, 0.5, 1.5):
        np.testing.assert_allclose(body.position_before(back), [0.05 * (39 - back / dt), 0.0, 1.6], atol=1e-9)
    assert body.position_before(100.0)[0] == 0.0  # the oldest
    # the viewing direction follows with a time constant
    settled = 0.5 * (1.0 - (1.0 - dt / _VIEW_TIME_S) ** 20)
    assert math.atan2(body._look[1], body._look[0]) == pytest.approx(settled, rel=0.1)


@pytest.mark.parametrize("method", ["proposed", "published"])
def test_a_head_that_nods_about_its_neck_moves_no_body(method):
    neck, arm = np.array([1.0, 2.0, 1.5]), np.array([0.10, 0.03, 0.12])  # m, world; the camera in the head
    R_head_camera = Rotation.from_matrix([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    T_head_camera = np.eye(4)
    T_head_camera[:3, :3], T_head_camera[:3, 3] = R_head_camera.as_matrix(), arm
    mount = Mount(body="head", T_body_sensor=T_head_camera)
    rig = Rig(cameras={"/head/color": replace(CAMERA, mount=mount)})
    predictor = LocomotionMode(rig, options=Options(method=method))
    places = []
    for k in range(40):
        head = Rotation.from_euler("zy", [0.2, 0.5 * math.sin(0.2 * k)])
        predictor.update(pose(20_000_000 * k, neck + head.apply(arm), head * R_head_camera))
        places.append(predictor._body.p)
    if method == "proposed":
        np.testing.assert_allclose(places, np.tile(neck, (40, 1)), atol=1e-9)
    else:  # Zhao et al. 2023 follow the camera
        assert np.ptp(places, axis=0).max() > 0.05


def test_estimates_are_finite_probabilities_in_order(predicted):
    for e in predicted:
        assert len(e.steps) == LocomotionModeParameters().steps
        for k, s in enumerate(e.steps):
            assert s.step == e.step + k + 1
            assert math.isclose(sum(s.probabilities.values()), 1.0, abs_tol=1e-6)
            assert min(s.probabilities.values()) >= 0.0
            assert np.isfinite(s.p_foot_in_world[:2]).all()
            assert np.isfinite(s.covariance).all()
            assert np.linalg.eigvalsh(s.covariance).min() > 0.0
        assert all(a.t_ns < b.t_ns for a, b in zip(e.steps, e.steps[1:]))


def test_corrupted_samples_are_passed_over(walk, predicted):
    mode, found = predictor(), []
    for sample in walk[: len(walk) // 3]:
        estimate = mode.update(sample)
        if estimate is not None:
            found.append(estimate)
        if isinstance(sample, Insole):
            assert mode.update(replace(sample, force=np.full(4, np.nan))) is None
            assert mode.update(sample) is None
    assert [e.step for e in found] == [e.step for e in predicted[: len(found)]]


def test_a_dead_insole_is_led_along_by_the_other(walk):
    mode = predictor()
    found = [
        e
        for e in (
            mode.update(replace(s, force=np.zeros(4)) if isinstance(s, Insole) and "foot_l" in s.topic else s)
            for s in walk
        )
        if e is not None
    ]
    right = [p for p in footprints() if p[2] == "r"]
    assert found[-1].step >= 2 * (len(right) - 1)
    predicted = [last_before(found, t).steps for t, *_ in right[2:]]
    assert sum(any(s.mode == p[3] for s in steps[:2]) for steps, p in zip(predicted, right[2:])) >= len(predicted) - 1


def test_without_poses_nothing_is_predicted_and_after_a_second_all_begins_anew(walk):
    """Odometry is lost for 1.2 s before the stairs and comes back in a frame that is turned and shifted a little."""
    mode, found, steps = predictor(), [], []
    for s in walk:
        if isinstance(s, Odometry) and 3.0e9 < s.t_ns < 4.2e9:
            continue
        if isinstance(s, Odometry) and s.t_ns >= 4.2e9:
            s = replace(s, p_frame_in_world=s.p_frame_in_world + [0.6, 0.3, 0.2])
        estimate = mode.update(s)
        if estimate is not None:
            found.append(estimate.t_ns * 1e-9)
            steps.append(estimate.step)
    predicted = np.array(found)
    assert not ((predicted > 3.21) & (predicted < 4.2)).any()
    assert (predicted > 4.3).any()
    assert steps[int(np.argmax(predicted > 4.2))] == 0


def test_published_takes_the_same_samples(walk):
    mode = predictor("published")
    found = [e for e in (mode.update(s) for s in walk) if e is not None]
    assert {s.mode for e in found for s in e.steps} <= set(MODES)
    assert {"LG", "SA"} <= {s.mode for e in found for s in e.steps}
    assert all(np.isfinite(s.p_foot_in_world[:2]).all() for e in found for s in e.steps)


def test_published_predicts_the_mode_of_the_ground_under_the_print(walk):
    """Two prints on one tread are no level walking: the terrain under them is a stair."""
    mode = predictor("published")
    for sample in (s for s in walk if s.t_ns < 4.2e9):
        mode.update(sample)

    def predicted(here, there):
        forward = np.array([1.0 if there > here else -1.0, 0.0])
        return mode_between(mode.ground, np.array([here, 0.0]), np.array([there, 0.0]), forward, Settings())[0]

    assert predicted(0.05, 0.20) == "SA"
    assert predicted(0.20, 0.05) == "SD"
    assert predicted(-0.60, 0.15) == "SA"
    assert predicted(0.15, -0.60) == "SD"
    assert predicted(-0.90, -0.40) == "LG"


@pytest.mark.parametrize("method", ["proposed", "published"])
def test_a_touch_down_without_a_pose_makes_no_double_step(walk, method):
    landed = footprints()[3][0]
    mode = predictor(method)
    for s in walk:
        if isinstance(s, Odometry) and abs(s.t_ns * 1e-9 - landed) < 0.3:
            continue
        estimate = mode.update(s)
        if isinstance(s, Odometry):
            body = float(s.p_frame_in_world[0])
        if estimate is not None:
            assert abs(estimate.steps[0].p_foot_in_world[0] - body) < 2.2 * STEP_M


def test_what_is_wrong_is_said():
    with pytest.raises(StrideTwinError, match="expected proposed, published"):
        predictor("best")
    with pytest.raises(ConfigError, match="step_m"):
        LocomotionModeParameters(step_m=-1.0)


def test_pinned_numbers(predicted, num_regression):
    assert_pinned(num_regression, columns(predicted[:: len(predicted) // 20]), SAME_POINTS)


def test_pinned_numbers_of_the_published_method(walk, num_regression):
    mode = predictor("published")
    made = [e for e in (mode.update(s) for s in walk) if e is not None]
    assert_pinned(num_regression, columns(made[:: len(made) // 20]), SAME_POINTS)
