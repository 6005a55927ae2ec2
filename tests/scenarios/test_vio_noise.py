"""The benchmark of the odometry with worse IMUs: the errors that it adds."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import vio_noise
from stridetwin.streams.samples import Imu
from tests.estimators.dvio.wall import IMU_HZ, rig

RATE, FORCE = np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 9.8])


@pytest.fixture
def worse(monkeypatch):
    samples = [Imu(t_ns=k, topic="/head/imu", angular_rate=RATE, specific_force=FORCE) for k in range(4000)]
    monkeypatch.setattr(vio_noise, "odometry_samples", lambda recording, mount: iter(samples))

    def of(part):
        made = list(vio_noise.worse(SimpleNamespace(rig=rig()), part, 3))
        return np.array([s.angular_rate for s in made]), np.array([s.specific_force for s in made])

    return of


def test_a_part_as_its_data_sheet_keeps_its_samples(worse):
    rates, forces = worse(vio_noise.Part())
    assert (rates == RATE).all()
    assert (forces == FORCE).all()


def test_white_noise_has_the_multiple_of_the_density(worse):
    rates, forces = worse(vio_noise.Part(noise=10.0))
    part = rig().imus["/head/imu"]
    assert rates.std(axis=0) == pytest.approx(10 * part.gyroscope_noise_density * IMU_HZ**0.5, rel=0.05)
    assert forces.std(axis=0) == pytest.approx(10 * part.accelerometer_noise_density * IMU_HZ**0.5, rel=0.05)
    assert rates.mean(axis=0) == pytest.approx(RATE, abs=3e-3)


def test_errors_of_axes_are_constant(worse):
    rates, forces = worse(vio_noise.Part(axes_sd=0.02))
    assert (rates == rates[0]).all()
    assert 0.0 < np.linalg.norm(rates[0] - RATE) < 0.3
    assert 0.0 < np.linalg.norm(forces[0] - FORCE) < 1.0
