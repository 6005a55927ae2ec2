"""The camera's clock by the rotations that images and gyroscope show."""

from __future__ import annotations

import numpy as np
import pytest

from stridetwin.estimators.dvio import Dvio, DvioParameters
from stridetwin.estimators.dvio.clock_search import ClockSearch, fit_rate, fit_shift
from stridetwin.estimators.dvio.nav_state import ImuBuffer
from stridetwin.estimators.dvio.tracker import Lens, image_velocity
from stridetwin.streams.samples import Imu
from tests.estimators.dvio.test_dvio import errors
from tests.estimators.dvio.wall import Wall, rig, swaying


def rate_at(t):
    """(N, 3) rad/s at (N,) s."""
    return np.stack([0.5 * np.sin(3.1 * t), 0.4 * np.cos(1.7 * t), 0.3 * np.sin(5.3 * t)], axis=-1)


def gyroscope(seconds, bias):
    """Samples of `rate_at` with a bias (3,), rad/s."""
    imu = rig().imu("/head/imu")
    buffer = ImuBuffer(imu, DvioParameters())
    step_ns = round(1e9 / imu.rate_hz)
    for k in range(1, round(seconds * imu.rate_hz)):
        middle = np.array([(k - 0.5) * step_ns * 1e-9])
        buffer.add(
            Imu(topic="/head/imu", t_ns=k * step_ns, angular_rate=rate_at(middle)[0] + bias, specific_force=np.ones(3))
        )
    return buffer


@pytest.mark.parametrize("late_s", [-0.12, -0.056, 0.0, 0.03, 0.1])
def test_the_shift_is_that_of_the_camera_whatever_the_bias(late_s):
    buffer = gyroscope(4.0, np.array([0.02, -0.03, 0.01]))
    start_ns = np.arange(5, 36) * 100_000_000
    spans = np.stack([start_ns, start_ns + 100_000_000], axis=1)
    fine = np.linspace(0, 0.1, 41)
    rates = np.array([rate_at(s * 1e-9 + late_s + fine).mean(axis=0) for s in start_ns])
    rates += np.random.default_rng(3).normal(0, 0.01, rates.shape)
    fit = fit_shift(spans, rates, np.tile(1e-4 * np.eye(3), (len(rates), 1, 1)), buffer)
    assert fit is not None
    assert fit.shift_s == pytest.approx(late_s, abs=3e-3)
    assert fit.sd_s < 3e-3
    assert fit.is_unique
    assert fit.advantage > (16.0 if abs(late_s) > 0.02 else -1e-9)


def test_a_camera_that_does_not_turn_has_no_clock():
    buffer = gyroscope(4.0, np.zeros(3))
    buffer.samples[:, :3] = 0.0
    start_ns = np.arange(5, 36) * 100_000_000
    spans = np.stack([start_ns, start_ns + 100_000_000], axis=1)
    rates = np.random.default_rng(4).normal(0, 0.01, (len(spans), 3))
    fit = fit_shift(spans, rates, np.tile(1e-4 * np.eye(3), (len(rates), 1, 1)), buffer)
    assert fit is None or not fit.is_unique or fit.sd_s > 0.01


def test_the_rate_of_a_camera_is_that_of_resting_points():
    rng = np.random.default_rng(5)
    at, rho = rng.uniform(-0.6, 0.6, (50, 2)), rng.uniform(0.2, 1.0, 50)
    velocity, rate = np.array([0.3, -0.1, 1.1]), np.array([0.2, -0.5, 0.1])
    flow = image_velocity(at, rho, velocity, rate) + rng.normal(0, 0.002, (50, 2))
    flow[:8] += 0.7  # a passer-by
    fit = fit_rate(at, flow, rho)
    assert fit is not None
    assert np.abs(fit[0] - rate).max() < 4.0 * np.sqrt(fit[1].diagonal().max())
    assert np.abs(fit[0] - rate).max() < 0.02
    assert fit_rate(at[:5], flow[:5], rho[:5]) is None


@pytest.mark.parametrize("late_s", [-0.1, 0.1])
def test_a_camera_that_is_a_tenth_of_a_second_off_is_found_in_the_first_seconds(late_s):
    wall = Wall(swaying, 8.0, seed=6, late_s=late_s)
    odometry = Dvio(rig())
    made = [e for s in wall.samples() if (e := odometry.update(s)) is not None]
    assert odometry.time_offset_s == pytest.approx(late_s, abs=2e-3)
    assert errors(wall, made)[-1] < 0.05


def test_a_right_clock_stays_as_it_is():
    wall = Wall(swaying, 6.0, seed=2)
    samples = list(wall.samples())
    with_search, without = Dvio(rig()), Dvio(rig())
    without._clock = None
    for s in samples:
        a, b = with_search.update(s), without.update(s)
        assert (a is None) == (b is None)
        if a is not None and b is not None:
            np.testing.assert_array_equal(a.pose.p_frame_in_world, b.pose.p_frame_in_world)


def test_images_without_texture_say_nothing():
    search, blank = ClockSearch(Lens(rig().cameras["/head/color"])), np.full((240, 320), 90, np.uint8)
    for k in range(30):
        search.add_image(k * 33_000_000, blank, None)
    assert search.find_offset(gyroscope(3.0, np.zeros(3)), np.eye(3), 0.004, 0.0, True) == 0.004
    assert not search.is_settled
