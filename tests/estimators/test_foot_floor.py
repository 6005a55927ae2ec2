"""Level ground keeps its height; stairs and ramps keep theirs."""

from dataclasses import replace

import numpy as np
import pytest
from foot_motion import ADIS16485, walk

from stridetwin.estimators.foot_ins import FootIns, FootInsParameters


@pytest.mark.parametrize("seed", range(3))
def test_level_ground_stays_level(seed: int) -> None:
    truth = walk(strides=30, slow_heel_rad=0.05, calibration=ADIS16485, rng=np.random.default_rng(seed))
    z = FootIns(ADIS16485).run(truth.imu).trajectory.p_frame_in_world[:, 2]
    new_floors = FootIns(ADIS16485, replace(FootInsParameters(), same_floor=0.0, same_after_new=0.0)).run(truth.imu)
    assert abs(z[-1] - z[0]) < 0.01
    assert abs(z[-1] - z[0]) < abs(np.ptp(new_floors.trajectory.p_frame_in_world[[0, -1], 2]))


@pytest.mark.parametrize("rise", [0.04, 0.07, 0.17, 0.34])
def test_what_climbs_is_not_taken_for_level(rise: float) -> None:
    truth = walk(strides=16, rise=rise)
    path = FootIns(ADIS16485).run(truth.imu).trajectory.p_frame_in_world
    error = (path - path[0] - truth.p_imu_in_world + truth.p_imu_in_world[0])[:, 2]
    assert abs(error).max() < 0.05 + 0.02 * 8 * rise
    assert abs(error[-1]) < 0.05


def test_the_height_of_a_level_walk_is_known_and_that_of_a_climb_is_not() -> None:
    level, climb = (
        FootIns(ADIS16485).run(walk(strides=16, rise=rise).imu).trajectory.covariance[-1, 2, 2] for rise in (0.0, 0.17)
    )
    assert level < climb
