"""Pinned numbers of both foot filters: see `tests.pinned`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from foot_motion import ADIS16485, LEFT_FOOT, Walk, ranges, rig_of, walk

from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import FootIns, FootInsPath, FootInsSmoother
from stridetwin.estimators.foot_to_foot import FootToFoot
from stridetwin.streams.samples import Block, Imu
from stridetwin.studies.jao2020.jao_simulation import JaoSimulation, SteadyWalk
from tests.pinned import assert_pinned, columns

WALKS = {
    "stairs": {"rise": 0.17, "strides": 6},
    "turning_ramp": {"rise": 0.08, "turn_rad": 1.2, "strides": 8},
    "heel_turns_in_stance": {"slow_heel_rad": 0.1, "strides": 6},
}


def _walk(name: str) -> Walk:
    return walk(**WALKS[name], calibration=ADIS16485, rng=np.random.default_rng(8))


def _clipped(imu: Block[Imu], rate: float, force: float) -> Block[Imu]:
    limits = {"angular_rate": rate, "specific_force": force}
    columns = {name: np.clip(values, -limits[name], limits[name]) for name, values in imu.columns.items()}
    return Block(topic=imu.topic, kind=Imu, t_ns=imu.t_ns, columns=columns)


def _rows(path: FootInsPath, every: int = 25) -> dict[str, np.ndarray]:
    t = path.trajectory
    poses = np.column_stack([t.p_frame_in_world, t.q_world_frame])[::every]
    sds = np.sqrt(np.diagonal(t.covariance, axis1=1, axis2=2))[::every]
    return columns([{"pose": p, "sd": sd} for p, sd in zip(poses, sds)])


@pytest.mark.parametrize("name", WALKS)
def test_one_foot_with_its_calibration(name: str, num_regression: Any) -> None:
    estimator = FootIns(LEFT_FOOT)
    assert_pinned(num_regression, _rows(estimator.run(_walk(name).imu)))


def test_one_foot_of_an_unknown_sensor_at_its_limits(num_regression: Any) -> None:
    estimator = FootIns()
    path = estimator.run(_clipped(_walk("stairs").imu, 5.0, 40.0))
    assert_pinned(num_regression, _rows(path) | columns([estimator.nis]))


def test_one_foot_with_known_limits(num_regression: Any) -> None:
    path = FootIns(rig_of(ranges(5.0, 40.0))).run(_clipped(_walk("stairs").imu, 5.0, 40.0))
    assert_pinned(num_regression, _rows(path))


def test_one_foot_smoothed(num_regression: Any) -> None:
    smoother = FootInsSmoother(0.5, ADIS16485)
    assert_pinned(num_regression, _rows(smoother.run(_walk("turning_ramp").imu)))


@pytest.mark.parametrize("method", ["proposed", "published"])
def test_two_feet(method: str, num_regression: Any) -> None:
    simulation = JaoSimulation(SteadyWalk(strides=5))
    rng = np.random.default_rng(3)
    imus, aids = simulation.inertial(rng)[0], simulation.aiding_measurements(rng)
    paths = FootToFoot(simulation.rig, options=Options(method=method), start=simulation.start()).run(imus, aids)
    rows = {f"{foot}.{name}": values for foot, path in paths.items() for name, values in _rows(path, 60).items()}
    assert_pinned(num_regression, rows)
