"""Level ground keeps its height; stairs and ramps keep theirs."""

from dataclasses import replace

import numpy as np
import pytest
from foot_motion import ADIS16485, LEFT_FOOT, walk

from stridetwin.estimators.foot_ins import FootIns, FootInsParameters


@pytest.mark.parametrize("seed", range(3))
def test_level_ground_stays_level(seed: int) -> None:
    truth = walk(strides=30, slow_heel_rad=0.05, calibration=ADIS16485, rng=np.random.default_rng(seed))
    z = FootIns(LEFT_FOOT).run(truth.imu).trajectory.p_frame_in_world[:, 2]
    new_floors = FootIns(LEFT_FOOT, replace(FootInsParameters(), same_floor=0.0)).run(truth.imu)
    assert abs(z[-1] - z[0]) < 0.01
    assert abs(z[-1] - z[0]) < abs(np.ptp(new_floors.trajectory.p_frame_in_world[[0, -1], 2]))


@pytest.mark.parametrize("rise", [0.04, 0.07, 0.17, 0.34])
def test_what_climbs_is_not_taken_for_level(rise: float) -> None:
    truth = walk(strides=16, rise=rise)
    path = FootIns(LEFT_FOOT).run(truth.imu).trajectory.p_frame_in_world
    error = (path - path[0] - truth.p_imu_in_world + truth.p_imu_in_world[0])[:, 2]
    assert abs(error).max() < 0.05 + 0.02 * 8 * rise
    assert abs(error[-1]) < 0.05


def test_the_height_of_a_level_walk_is_known_and_that_of_a_climb_is_not() -> None:
    level, climb = (
        FootIns(LEFT_FOOT).run(walk(strides=16, rise=rise).imu).trajectory.covariance[-1, 2, 2] for rise in (0.0, 0.17)
    )
    assert level < climb


def test_a_scale_error_costs_height_on_a_stair_and_none_on_level_ground() -> None:
    """An accelerometer that reads 1 % too much along one axis, on level ground and up a stair."""
    for rise in (0.0, 0.17):
        truth = walk(strides=16, rise=rise)
        force = truth.imu.columns["specific_force"] * [1.01, 1.0, 1.0]
        imu = replace(truth.imu, columns={**truth.imu.columns, "specific_force": force})
        path = FootIns().run(imu).trajectory
        assert path.covariance is not None
        way = truth.p_imu_in_world[-1] - truth.p_imu_in_world[0]
        error = float(path.p_frame_in_world[-1, 2] - path.p_frame_in_world[0, 2] - way[2])
        assert abs(error) < (0.02 if rise == 0.0 else 0.15)
        assert abs(error) < 3.0 * path.covariance[-1, 2, 2] ** 0.5


@pytest.mark.parametrize("excess", [0.98, 1.022])
def test_a_foot_rests_on_an_accelerometer_whose_size_of_gravity_is_wrong(excess: float) -> None:
    truth = walk(strides=8)
    bias = np.array([0.0, 0.0, 0.004])
    columns = {
        "specific_force": excess * truth.imu.columns["specific_force"],
        "angular_rate": truth.imu.columns["angular_rate"] + bias,
    }
    estimator = FootIns(parameters=FootInsParameters(gyro_bias_sd_radps=0.01))
    path = estimator.run(replace(truth.imu, columns=columns))
    assert estimator.nis["rest"] > 0.0
    assert path.aligned[-1]
    assert abs(path.trajectory.p_frame_in_world[-1, 2] - path.trajectory.p_frame_in_world[0, 2]) < 0.05


def test_no_probability_of_the_same_floor_makes_every_floor_new() -> None:
    estimator = FootIns(LEFT_FOOT, FootInsParameters(same_floor=0.0))
    estimator.run(walk(strides=8).imu)
    assert "floor" not in estimator.nis
