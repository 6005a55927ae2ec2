"""The buffer of the IMU's samples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.estimators.dvio import DvioParameters, kernel
from stridetwin.estimators.dvio.nav_state import ImuBuffer
from stridetwin.estimators.dvio.state import blank_preintegration
from stridetwin.streams.rig import ImuCalibration, Mount
from stridetwin.streams.samples import Imu
from tests.estimators.dvio.scenes import NOISE


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0, 5000.0])
def test_reaches_back_for_six_seconds_at_any_rate(rate_hz):
    x = ImuBuffer(
        ImuCalibration(
            topic="/head/imu",
            part="fast",
            rate_hz=rate_hz,
            mount=Mount(body="head"),
            gyroscope_noise_density=2.4e-4,
            gyroscope_random_walk=5e-6,
            accelerometer_noise_density=1.5e-3,
            accelerometer_random_walk=4e-5,
        ),
        DvioParameters(),
    )
    period_ns = round(1e9 / rate_hz)
    rate, force = np.array([0.0, 0.1, 0.0]), np.array([0.0, 0.0, 9.81])
    least, staying = np.inf, 0
    for k in range(round(13 * rate_hz)):
        x.add(Imu(topic="/head/imu", t_ns=k * period_ns, angular_rate=rate, specific_force=force))
        assert x.covers(staying)
        staying = x.oldest_retained_ns
        if k * period_ns >= 6e9:
            least = min(least, x.newest_ns - int(x.t_ns[0]), x.newest_ns - staying)
    assert least >= 6e9
    z = blank_preintegration()
    start = x.newest_ns - 3_000_000_000
    kernel.integrate(z, x.imu_samples, start, x.newest_ns, np.zeros(6), NOISE)
    assert np.linalg.norm(Rotation.from_matrix(z.delta_R).as_rotvec()) == pytest.approx(0.3, rel=1e-6)
