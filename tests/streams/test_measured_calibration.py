"""What the samples of an unknown IMU show of it."""

import math

import numpy as np
import pytest

from stridetwin.streams.formats.measured_calibration import measure_imu, measure_resolution
from stridetwin.streams.samples import Block, Imu

RATE_HZ = 200.0
G = 9.80665


def samples(rng, rest_s=2.0, moving_s=6.0, gyro=0.0, accel=0.0, bias=0.0, limit_g=None):
    """A sensor at rest, then swung with peaks of many sizes; `gyro` and `accel` are noise densities."""
    n, k = round(rest_s * RATE_HZ), round(moving_s * RATE_HZ)
    t = np.arange(n + k) / RATE_HZ
    swing = np.r_[np.zeros(n), np.sin(2 * np.pi * 1.7 * t[n:]) * rng.uniform(0.5, 1.0, k)]
    rate = bias + swing[:, None] * [1.0, 6.0, 0.5] + gyro * math.sqrt(RATE_HZ) * rng.standard_normal((n + k, 3))
    force = swing[:, None] * [150.0, 20.0, 250.0] + [0.0, 0.0, G]
    force = force + accel * math.sqrt(RATE_HZ) * rng.standard_normal((n + k, 3))
    if limit_g is not None:
        force = np.clip(force, -limit_g * G, limit_g * G)
    t_ns = np.round(t * 1e9).astype(np.int64)
    return Block(topic="/foot/imu", kind=Imu, t_ns=t_ns, columns={"angular_rate": rate, "specific_force": force})


def measured(block):
    return measure_imu(block, "/foot_l/imu", "foot_l")


@pytest.mark.parametrize("seed", range(3))
def test_noise_and_rate_are_read_at_rest(seed):
    imu = measured(samples(np.random.default_rng(seed), gyro=2e-4, accel=2e-3))
    assert imu.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    assert imu.gyroscope_noise_density == pytest.approx(2e-4, rel=0.25)
    assert imu.accelerometer_noise_density == pytest.approx(2e-3, rel=0.25)
    assert (imu.topic, imu.mount.body) == ("/foot_l/imu", "foot_l")


def test_a_bias_is_separated_from_the_sway_of_a_person():
    rng = np.random.default_rng(1)
    assert measured(samples(rng, gyro=1e-4, bias=0.004)).gyroscope_bias_sd == 0.0
    assert measured(samples(rng, gyro=1e-4, bias=0.03)).gyroscope_bias_sd == pytest.approx(0.03 * 3**0.5, rel=0.05)


@pytest.mark.parametrize("limit_g", [8.0, 16.0])
def test_the_range_is_read_from_clipped_peaks(limit_g):
    imu = measured(samples(np.random.default_rng(2), limit_g=limit_g))
    assert imu.accelerometer_range == pytest.approx(limit_g * G, rel=0.02)
    assert imu.gyroscope_range == 0.0


def test_peaks_that_end_at_no_usual_full_scale_are_not_clipped():
    imu = measured(samples(np.random.default_rng(2), limit_g=10.3))
    assert imu.accelerometer_range == 0.0


def test_counts_are_seen_and_bound_the_noise_from_below():
    block = samples(np.random.default_rng(4))
    step = 0.01
    force = np.round(block.columns["specific_force"] / step) * step
    assert measure_resolution(force) == pytest.approx(step, rel=1e-6)
    imu = measured(Block(topic="", kind=Imu, t_ns=block.t_ns, columns={**block.columns, "specific_force": force}))
    assert imu.accelerometer_noise_density >= 0.99 * step / math.sqrt(12.0 * RATE_HZ)


def test_a_sensor_that_never_rests_shows_no_noise():
    imu = measured(samples(np.random.default_rng(5), rest_s=0.0))
    assert imu.gyroscope_noise_density == imu.accelerometer_noise_density == imu.gyroscope_bias_sd == 0.0
