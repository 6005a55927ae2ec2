"""Scales of the gyros of two feet: how they rotate a foot, and that observing the other shoe estimates them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.estimators.foot_ins.parameters import FootInsParameters, for_sensor
from stridetwin.estimators.foot_ins.state import ATTITUDE, D_ATTITUDE, STATES
from stridetwin.estimators.foot_to_foot import FootToFoot, FootToFootParameters, kernel
from stridetwin.estimators.foot_to_foot.state import SCALES, blank_pair
from stridetwin.streams.samples import Array
from stridetwin.studies.jao2020.jao_simulation import JaoSimulation, SteadyWalk
from tests.estimators.from_python import from_python
from tests.estimators.one_foot import take

apply_gyro_scale = from_python(kernel.apply_gyro_scale)


@pytest.mark.parametrize("foot", [0, 1])
def test_covariance_of_scale_and_attitude_is_the_derivative_of_one_by_the_other(foot: int) -> None:
    parameters = for_sensor(FootInsParameters(stationary_speed_mps=1e6, rest_level=0.0), None)
    gravity = np.array([0.0, 0.0, parameters.gravity_mps2])
    rates = np.random.default_rng(1).normal(4.0, 3.0, (30, 3))
    arms, mounts = np.zeros((2, 3)), np.tile([0.0, 0, 0, 1, 0, 0, 0], (4, 1))

    def turned(scale: Array, variance: float) -> tuple[Rotation, Array]:
        pair = blank_pair(mounts, np.zeros((4, 6)), 0.0, variance, arms, np.zeros(3))
        for k in range(40):
            take(pair.feet[foot], parameters, k * 8_000_000, np.zeros(3), gravity)
        pair.covariance[:SCALES] = 0.0
        pair.covariance[:, :SCALES] = 0.0
        for k, rate in enumerate(rates, 40):
            scaled = (1.0 - scale) * rate
            apply_gyro_scale(pair, foot, tuple(scaled), k * 8_000_000)
            take(pair.feet[foot], parameters, k * 8_000_000, scaled, gravity)
        a, s = STATES * foot + D_ATTITUDE, SCALES + 3 * foot
        q = pair.feet[foot].nominal[ATTITUDE : ATTITUDE + 4]
        return Rotation.from_quat(q, scalar_first=True), pair.covariance[a : a + 3, s : s + 3].copy()

    tiny = 1e-9
    base, covariance = turned(np.zeros(3), tiny)
    for axis in range(3):
        moved, _ = turned(1e-5 * np.eye(3)[axis], tiny)
        derivative = (moved * base.inv()).as_rotvec() / 1e-5
        np.testing.assert_allclose(covariance[:, axis] / tiny, derivative, atol=0.03)
        assert np.linalg.norm(derivative) > 0.5


def test_a_gyro_scale_error_is_estimated_where_the_other_shoe_is_seen() -> None:
    simulation = JaoSimulation(SteadyWalk(strides=40))
    rng = np.random.default_rng(5)
    imus, aids = simulation.inertial(rng)[0], simulation.aiding_measurements(rng)
    for foot in "lr":
        imus[foot].columns["angular_rate"][:] *= 1.004
    ends, found = {}, {}  # errors along the way
    for sd in (0.003, 0.0):
        estimator = FootToFoot(
            simulation.rig, start=simulation.start(), parameters=FootToFootParameters(gyro_scale_sd=sd)
        )
        paths = estimator.run(imus, aids)
        found[sd] = estimator._pair.scales.copy()
        ends[sd] = max(abs(simulation.end_error(f, paths[f].trajectory.p_frame_in_world[-1])[0]) for f in "lr")
    pitch = np.argmax(np.abs(imus["l"].columns["angular_rate"]).mean(axis=0))
    np.testing.assert_allclose(found[0.003][:, pitch], 0.004, atol=0.002)
    assert not found[0.0].any()
    assert ends[0.003] < 0.5 * ends[0.0]
