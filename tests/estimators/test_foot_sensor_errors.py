"""What the one-foot filter knows of its sensor: bias by rests, delay of a channel, filled samples, earlier walks."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foot_motion import Walk, ranges, rig_of, walk

from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import FootIns
from stridetwin.estimators.foot_ins.learnt import read_learnt, write_learnt
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array, Block, Imu

BIAS_RADPS = np.radians([0.25, -0.3, 0.28])


def with_columns(truth: Walk, rate: Array, force: Array) -> Block[Imu]:
    """The samples of a walk with other rates and forces, each (N, 3)."""
    return replace(truth.imu, columns={"angular_rate": rate, "specific_force": force})


def with_noise(truth: Walk, bias_radps: Array) -> Block[Imu]:
    """The samples of a walk by a noisy sensor with a gyro bias (3,) in rad/s."""
    rng = np.random.default_rng(5)
    rate, force = truth.imu.columns["angular_rate"], truth.imu.columns["specific_force"]
    return with_columns(
        truth,
        rate + bias_radps + rng.normal(0.0, 0.0015, rate.shape),
        force + rng.normal(0.0, 0.01, force.shape),
    )


def late_forces(truth: Walk, samples: int) -> Block[Imu]:
    """The samples of a walk by a noisy sensor whose force is late."""
    imu = with_noise(truth, np.zeros(3))
    force = imu.columns["specific_force"]
    return with_columns(
        truth, imu.columns["angular_rate"], np.vstack([np.repeat(force[:1], samples, 0), force[:-samples]])
    )


def test_a_rest_teaches_the_bias_of_a_consumer_part_and_its_certainty():
    filter_of_foot = FootIns()
    filter_of_foot.run(with_noise(walk(rate_hz=200.0), BIAS_RADPS))
    learnt = filter_of_foot.learnt
    sd = np.sqrt(np.diag(learnt.gyro_bias_covariance))
    np.testing.assert_allclose(learnt.gyro_bias_radps, BIAS_RADPS, atol=np.radians(0.05))
    assert (abs(learnt.gyro_bias_radps - BIAS_RADPS) < 3.0 * sd).all()


def test_slow_turning_is_no_bias():
    truth = walk(rate_hz=200.0)
    t = truth.imu.t_ns * 1e-9
    turning = np.radians(3.0) * np.sin(2.0 * np.pi * t / 1.5) * (t < 2.0)
    rate = truth.imu.columns["angular_rate"] + np.outer(turning, [0.0, 0.0, 1.0])
    filter_of_foot = FootIns()
    filter_of_foot.run(with_columns(truth, rate, truth.imu.columns["specific_force"]))
    learnt = filter_of_foot.learnt
    assert abs(learnt.gyro_bias_radps[2]) < np.radians(0.3)  # a tenth of the rates
    assert abs(learnt.gyro_bias_radps[2]) < 3.0 * np.sqrt(learnt.gyro_bias_covariance[2, 2])


def test_without_a_rest_the_heading_is_less_certain():
    truth = walk(rate_hz=200.0)
    imu = with_noise(truth, np.zeros(3))
    begun = imu.t_ns > 2.1e9  # the first step begins at 2 s
    columns = {name: column[begun] for name, column in imu.columns.items()}
    hurried = replace(imu, t_ns=imu.t_ns[begun], columns=columns)
    yaw_sd = [np.sqrt(FootIns().run(block).trajectory.covariance[-1, 5, 5]) for block in (imu, hurried)]
    assert yaw_sd[1] > 2.0 * yaw_sd[0]


def test_a_late_channel_is_found_and_its_error_removed():
    truth = walk(rate_hz=200.0, strides=25)
    late = late_forces(truth, 3)
    found, blind = FootIns(), FootIns()
    path = found.run(late).trajectory
    assert found.learnt.force_later_s == pytest.approx(0.015, abs=0.0051)
    blind._bank.place[4] = 2  # decided: no delay
    plain = blind.run(late).trajectory
    end = truth.p_imu_in_world[-1, :2] - truth.p_imu_in_world[0, :2]
    errors = [np.linalg.norm(p.p_frame_in_world[-1, :2] - end) for p in (path, plain)]
    assert errors[0] < 0.6 * errors[1]


def test_a_prompt_sensor_gets_no_delay():
    filter_of_foot = FootIns()
    filter_of_foot.run(with_noise(walk(rate_hz=200.0, strides=25), np.zeros(3)))
    assert filter_of_foot.learnt.force_later_s == 0.0


def test_update_and_run_agree_with_a_delay():
    truth = walk(rate_hz=200.0)
    late = late_forces(truth, 3)
    path = FootIns().run(late)
    one_by_one = FootIns()
    estimate = None
    for sample in late:
        estimate = one_by_one.update(sample) or estimate
    assert estimate is not None
    np.testing.assert_array_equal(estimate.pose.p_frame_in_world, path.trajectory.p_frame_in_world[-1])
    np.testing.assert_array_equal(estimate.covariance[:3, :3], path.trajectory.covariance[-1, :3, :3])


def test_filled_samples_cost_certainty():
    truth = walk(rate_hz=200.0)
    imu = with_noise(truth, np.zeros(3))
    rate, force = imu.columns["angular_rate"].copy(), imu.columns["specific_force"].copy()
    fast = np.flatnonzero(np.linalg.norm(rate, axis=1) > 3.0)
    for first in fast[fast % 40 == 0]:
        for x in (rate, force):
            x[first : first + 5] = np.linspace(x[first], x[first + 4], 5)
    full, filled = (FootIns().run(block).trajectory.covariance[-1] for block in (imu, with_columns(truth, rate, force)))
    assert np.trace(filled[:3, :3]) > np.trace(full[:3, :3])


def test_what_a_walk_taught_starts_the_next_one(tmp_path: Path):
    first = FootIns()
    first.run(with_noise(walk(rate_hz=200.0), BIAS_RADPS))
    file = tmp_path / "walk.calibration.json"
    write_learnt(first.learnt, file)
    again = read_learnt(file)
    np.testing.assert_array_equal(again.gyro_bias_radps, first.learnt.gyro_bias_radps)
    np.testing.assert_allclose(again.gyro_bias_covariance, first.learnt.gyro_bias_covariance, rtol=1e-12)
    hurried = with_noise(walk(rate_hz=200.0, rest_s=0.3), BIAS_RADPS)
    sd, error = [], []
    for options in (Options(), Options(calibration_from=file)):
        later = FootIns(options=options)
        sd.append(np.sqrt(later.run(hurried).trajectory.covariance[-1, 5, 5]))
        error.append(np.linalg.norm(later.learnt.gyro_bias_radps - BIAS_RADPS))
    assert sd[1] < sd[0]
    assert error[1] < error[0]


@pytest.mark.parametrize(
    ("name", "value", "valid"),
    [
        ("format", "other", "stridetwin foot_ins calibration 1"),
        ("rate_hz", 0.0, "a number from"),
        ("gyro_bias_radps", [9.0, 0.0, 0.0], "three numbers"),
        ("gyro_bias_covariance", [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]], "negative eigenvalues"),
        ("force_later_s", "late", "a number from"),
    ],
)
def test_a_calibration_that_does_not_fit_is_refused(tmp_path: Path, name: str, value: object, valid: str):
    first = FootIns()
    first.run(with_noise(walk(rate_hz=200.0, strides=3), BIAS_RADPS))
    file = tmp_path / "walk.calibration.json"
    write_learnt(first.learnt, file)
    file.write_text(json.dumps(json.loads(file.read_text()) | {name: value}))
    with pytest.raises(ConfigError, match=valid) as caught:
        FootIns(options=Options(calibration_from=file))
    assert "\n" not in str(caught.value)


def test_a_calibration_of_another_rate_is_refused(tmp_path: Path):
    first = FootIns()
    first.run(with_noise(walk(rate_hz=200.0, strides=3), BIAS_RADPS))
    file = tmp_path / "walk.calibration.json"
    write_learnt(first.learnt, file)
    with pytest.raises(ConfigError, match="the rate of this recording"):
        FootIns(rig_of(ranges()), options=Options(calibration_from=file))
