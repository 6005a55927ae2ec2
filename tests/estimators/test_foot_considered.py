"""Errors that one foot considers without estimating them, and slopes that it cannot tell from its own drift."""

from dataclasses import replace

import numpy as np
import pytest
from foot_motion import Walk, walk

from stridetwin.estimators.foot_ins import FootIns, state
from stridetwin.estimators.foot_ins.estimate import FootInsPath
from stridetwin.streams.samples import Array, Block, Imu

EPSILON = {state.SCALE_ACROSS: 1e-4, state.SCALE_ALONG: 1e-4, state.DELAY: 1e-4}  # small, so that the effect is linear


def with_rate(block: Block[Imu], rate: Array) -> Block[Imu]:
    return replace(block, columns={**block.columns, "angular_rate": rate})


def disturb(block: Block[Imu], error: int, size: float) -> Block[Imu]:
    """The samples of a gyro with one error; the sensor of `walk` has the sole's normal along z."""
    rate = np.array(block.columns["angular_rate"])
    if error == state.DELAY:
        t = block.t_ns * 1e-9
        rate = np.column_stack([np.interp(t - size, t, channel) for channel in rate.T])
    else:
        axes = [0, 1] if error == state.SCALE_ACROSS else [2]
        rate[:, axes] *= 1.0 + size
    return with_rate(block, rate)


def run(block: Block[Imu]) -> tuple[FootIns, FootInsPath]:
    estimator = FootIns()
    return estimator, estimator.run(block)


@pytest.fixture(scope="module")
def turning() -> Walk:
    return walk(strides=4, turn_rad=1.5, rate_hz=200.0, rest_s=1.0)


@pytest.mark.parametrize("error", EPSILON)
def test_the_derivative_is_what_the_error_does(turning: Walk, error: int) -> None:
    estimator, path = run(turning.imu)
    _, disturbed = run(disturb(turning.imu, error, EPSILON[error]))
    memory = estimator._memory
    found = memory.covariance[memory.considered + error]
    moved = (disturbed.trajectory.p_frame_in_world[-1] - path.trajectory.p_frame_in_world[-1]) / EPSILON[error]
    expected = -found[state.D_POSITION : state.D_POSITION + 3]  # an error is truth less estimate
    size = np.linalg.norm(expected[:2])
    assert size > 0.05  # a scale error of 1 % moves the path by half a millimetre at least
    np.testing.assert_allclose(moved[:2], expected[:2], atol=0.15 * size)


def test_a_delay_that_no_stride_has_told_yet_is_in_the_covariance(turning: Walk) -> None:
    delay_s = 0.005
    _, exact = run(turning.imu)
    _, late = run(disturb(turning.imu, state.DELAY, delay_s))
    moved = late.trajectory.p_frame_in_world[-1] - exact.trajectory.p_frame_in_world[-1]
    P = late.trajectory.covariance[-1][:2, :2]
    assert np.linalg.norm(moved[:2]) > 0.005
    assert moved[:2] @ np.linalg.solve(P, moved[:2]) < 5.99


def test_a_gentle_slope_that_was_levelled_is_in_the_covariance() -> None:
    stride_m = 1.35
    sd, error = {}, {}
    for grade in (0.0, 0.02):  # 0.02 is 1.1 degrees
        flat = walk(strides=24, rise=grade * stride_m, stride_m=stride_m, rate_hz=100.0)
        half = len(flat.t_ns) // 2  # only the way up
        block = replace(flat.imu, t_ns=flat.imu.t_ns[:half], columns={k: v[:half] for k, v in flat.imu.columns.items()})
        _, path = run(block)
        estimated = path.trajectory.p_frame_in_world[:, 2]
        error[grade] = (estimated[-1] - estimated[0]) - (flat.p_imu_in_world[half - 1, 2] - flat.p_imu_in_world[0, 2])
        sd[grade] = np.sqrt(path.trajectory.covariance[-1, 2, 2])
    assert abs(error[0.02]) > 0.15  # the slope of 0.3 m was taken for level ground
    assert abs(error[0.02]) < 2.5 * sd[0.02]
    assert sd[0.0] < 0.05
