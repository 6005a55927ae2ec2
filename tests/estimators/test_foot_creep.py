"""The slow motion of a shoe in stance: what the filter assumes of it, and what its uncertainty does to the path."""

import numpy as np
import pytest
from foot_motion import ADIS16485, Walk, walk

from stridetwin.estimators.foot_ins import FootIns, FootInsParameters, creep, parameters, state
from stridetwin.estimators.foot_ins.estimate import FootInsPath
from stridetwin.estimators.foot_ins.parameters import for_sensor
from tests.estimators.from_python import from_python

MEAN = {state.CREEP_FORWARD: "_CREEP_FORWARD_SHARE", state.CREEP_DOWN: "_CREEP_DOWN_M"}


@pytest.fixture(scope="module")
def turning() -> Walk:
    return walk(strides=5, turn_rad=1.0, rise=0.2, calibration=ADIS16485, rng=np.random.default_rng(2))


@pytest.fixture
def any_foot_creeps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise alone then counts as the motion of a shoe that is not perfectly still."""
    monkeypatch.setattr(parameters, "_CREEP_LEVEL", 1e-3)


def run(of_walk: Walk) -> tuple[FootIns, FootInsPath]:
    estimator = FootIns()
    return estimator, estimator.run(of_walk.imu)


@pytest.mark.parametrize("error", MEAN)
def test_the_derivative_by_the_creep_is_what_another_creep_does(
    turning: Walk, any_foot_creeps: None, monkeypatch: pytest.MonkeyPatch, error: int
) -> None:
    epsilon = 1e-4
    estimator, path = run(turning)
    monkeypatch.setattr(parameters, MEAN[error], getattr(parameters, MEAN[error]) + epsilon)
    _, other = run(turning)
    memory = estimator._memory
    expected = memory.covariance[memory.considered + error, state.D_POSITION : state.D_POSITION + 3]
    moved = (other.trajectory.p_frame_in_world[-1] - path.trajectory.p_frame_in_world[-1]) / epsilon
    assert np.linalg.norm(expected) > 1.0  # m of the path by the whole stride, or by each m that a stance sinks
    np.testing.assert_allclose(moved, expected, atol=0.05 * np.linalg.norm(expected))


def test_a_creep_to_the_left_is_a_creep_forward_turned_left(any_foot_creeps: None) -> None:
    estimator, _ = run(walk(strides=5, calibration=ADIS16485, rng=np.random.default_rng(3)))
    memory = estimator._memory
    forward, left = (
        memory.covariance[memory.considered + error, state.D_POSITION : state.D_POSITION + 2]
        for error in (state.CREEP_FORWARD, state.CREEP_LEFT)
    )
    np.testing.assert_allclose(left, [-forward[1], forward[0]], atol=0.05 * np.linalg.norm(forward))


def test_a_foot_that_stands_perfectly_still_does_not_creep() -> None:
    still = walk(strides=5)
    estimator, _ = run(still)
    memory = estimator._memory
    rows = memory.covariance[memory.considered + state.CREEP_FORWARD :, : state.STATES]
    assert np.abs(rows[:2, state.D_POSITION : state.D_POSITION + 2]).max() < 0.1 * still.distance
    assert np.abs(rows[2, state.D_POSITION + 2]) < 0.1 * 5  # stances


def standing(stride: tuple[float, float, float], duration_s: float) -> state.FilterState:
    """Memory of a foot that has just come to stand after a stride, m."""
    memory = state.initial_state()
    memory.clock[state.CONTACT_PHASE] = state.SWINGING
    memory.nominal[:3] = stride
    from_python(creep.begin_stance)(memory, PARAMETERS, int(1e9 * duration_s))
    memory.clock[state.CONTACT_PHASE] = state.STANDING
    return memory


def creep_after(memory: state.FilterState, since_s: float) -> np.ndarray:
    t_ns = memory.clock[state.T_STOOD] + int(1e9 * since_s)
    return np.array(from_python(creep.find_creep)(memory, PARAMETERS, t_ns, MOVING))


PARAMETERS = for_sensor(FootInsParameters(), None)
MOVING = 1e9  # motion statistic of a shoe that creeps as much as any


def test_the_creep_is_along_the_stride_and_as_slow_as_it() -> None:
    found = creep_after(standing((1.2, -0.5, 0.1), 1.0), 0.3)
    np.testing.assert_allclose(found[:2], [1.2, -0.5], rtol=1e-6)
    assert 0.9 < found[2] < 1.0  # sinks by the whole amount per stride
    back, slow = creep_after(standing((-1.2, 0.5, 0.1), 1.0), 0.3), creep_after(standing((1.2, -0.5, 0.1), 1.6), 0.3)
    np.testing.assert_allclose(back, found * [-1.0, -1.0, 1.0])
    np.testing.assert_allclose(slow, found / 1.6)


def test_who_stands_or_has_not_stepped_yet_does_not_creep() -> None:
    assert not creep_after(standing((1.2, 0.0, 0.0), 1.0), 1.5).any()
    assert not creep_after(state.initial_state(), 0.3).any()
    assert np.abs(creep_after(standing((0.01, 0.0, 0.0), 0.8), 0.3)).max() < 0.1  # on the spot


def test_a_still_stance_halves_the_creep_at_its_level() -> None:
    memory = standing((1.2, 0.0, 0.0), 1.0)
    whole = creep_after(memory, 0.3)
    t_ns = memory.clock[state.T_STOOD] + 300_000_000
    half = from_python(creep.find_creep)(memory, PARAMETERS, t_ns, PARAMETERS.creep_level)
    np.testing.assert_allclose(half, 0.5 * whole, rtol=1e-6)
