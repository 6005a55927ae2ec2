"""Noise of the IMU from images: sizes of residuals in a small window, the factor's rule, and a noisy IMU at a wall."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.estimators.dvio import DvioMethod
from stridetwin.estimators.dvio.imu_inflation import CONSISTENT_SHARE, ImuInflation, residuals
from stridetwin.estimators.dvio.optimiser import blank_work, minimise
from stridetwin.estimators.dvio.state import CALIBRATION, FRAME, WindowState
from stridetwin.streams.samples import Imu, Sample
from tests.estimators.dvio.scenes import FACTORS, NOISE, seen_window
from tests.estimators.dvio.test_dvio import errors, followed
from tests.estimators.dvio.wall import IMU_HZ, Wall, rig, swaying

FRAMES, STEP_S, DRAWS = 4, 0.2, 300
SD = np.repeat([3e-3, 3e-3, 3e-2], 3)
EXACT = FACTORS._replace(huber_sd=1e3)


def noisy_increments(rng: np.random.Generator, times: float) -> WindowState:
    """Noisy observations, and increments whose noise is `times` what their covariances say; no planes."""
    w = seen_window(rng, FRAMES, points=30, slots=5)
    f, z, t = w.frames, w.preintegrations, STEP_S
    marks, g = w.landmarks, np.array([0.0, 0.0, -9.81])
    # The host's direction to a point is exact in the model.
    marks.at[:, 1:] += rng.normal(size=marks.at[:, 1:].shape) * EXACT.pixel_weight**-0.5
    marks.rho[:, 1:] += rng.normal(size=marks.rho[:, 1:].shape) * EXACT.later_depth_weight**-0.5
    marks.rho[:, 0] += rng.normal(size=len(marks.rho)) * EXACT.depth_weight**-0.5
    f.bias[:] = f.bias[0]
    for k in range(FRAMES - 1):
        e = times * SD * rng.normal(size=9)
        R = f.R[k]
        z.dt[k], z.bias[k] = t, f.bias[k]
        z.delta_p[k] = R.T @ (f.p[k + 1] - f.p[k] - f.v[k] * t - g * t**2 / 2) + e[:3]
        z.delta_R[k] = R.T @ f.R[k + 1] @ Rotation.from_rotvec(e[3:6]).as_matrix()
        z.delta_v[k] = R.T @ (f.v[k + 1] - f.v[k] - g * t) + e[6:]
        z.by_bias[k, :3, 3:] = -np.eye(3) * t**2 / 2
        z.by_bias[k, 3:6, :3] = z.by_bias[k, 6:, 3:] = -np.eye(3) * t
        z.covariance[k], z.weight[k] = np.diag(SD**2), np.diag(SD**-2)
    shared = range(CALIBRATION)
    w.prior.H[shared, shared] = 1e12
    first = range(CALIBRATION, CALIBRATION + FRAME)
    sd = np.repeat([1e-6, 1e-6, 0.1, 0.01, 0.05], 3)
    w.prior.H[first, first] = sd**-2.0
    w.prior.b[first] = rng.normal(size=FRAME) / sd
    f.in_prior[0] = 1
    f.R_first[0], f.p_first[0], f.v_first[0], f.bias_first[0] = f.R[0], f.p[0], f.v[0], f.bias[0]
    return w


def mean_residuals(times: float, k: int) -> tuple[np.ndarray, np.ndarray]:
    squared, expected = np.zeros(2), np.zeros(2)
    for seed in range(DRAWS):
        w = noisy_increments(np.random.default_rng(seed), times)
        work = blank_work(w)
        minimise(w, EXACT, work, 6, 0.0)
        own = residuals(w, k, EXACT, work.factor)
        squared += own[0] / DRAWS
        expected += own[1] / DRAWS
    return squared, expected


@pytest.mark.parametrize("k", [0, 1])
def test_consistent_residuals_are_of_the_expected_size(k):
    squared, expected = mean_residuals(1.0, k)
    assert (expected > [1.0, 0.5]).all()
    assert (expected < [3.0, 6.0]).all()
    assert squared == pytest.approx(expected, rel=0.15)


def test_residuals_of_noisier_increments_are_larger():
    squared, expected = mean_residuals(4.0, 0)
    assert (squared > 8.0 * expected).all()


def followed_noise(inflation: ImuInflation, noise: tuple[float, float], increments: int) -> np.ndarray:
    """The factor after increments of a redundancy of 2 whose true noise is a multiple of the nominal one."""
    for _ in range(increments):
        used = inflation.factor
        inflation.add_residuals(2.0 * (np.array(noise) / used) ** 2, np.full(2, 2.0), used)
    return inflation.factor


def test_noise_as_stated_stays():
    inflation = ImuInflation(NOISE)
    assert followed_noise(inflation, (0.6, 0.3), 100) == pytest.approx([1.0, 1.0])
    assert inflation.noise == NOISE


def test_the_factor_follows_each_sensor_up_and_down():
    inflation = ImuInflation(NOISE)
    up = followed_noise(inflation, (6.0, 0.3), 120)
    assert up == pytest.approx([6.0 / CONSISTENT_SHARE, 1.0], rel=0.1)
    assert inflation.noise.rate == pytest.approx(up[0] * NOISE.rate)
    assert inflation.noise.force == NOISE.force
    assert inflation.noise.rate_walk == NOISE.rate_walk
    assert followed_noise(inflation, (0.3, 3.0), 400) == pytest.approx([1.0, 3.0 / CONSISTENT_SHARE], rel=0.1)


def test_one_bad_image_is_no_noise():
    inflation = ImuInflation(NOISE)
    followed_noise(inflation, (0.3, 0.4), 30)
    assert followed_noise(inflation, (100.0, 100.0), 1) == pytest.approx([1.0, 1.0], abs=0.1)


def test_a_redundancy_below_zero_is_none():
    """It can be so by rounding, or where the window has not converged."""
    inflation = ImuInflation(NOISE)
    inflation.add_residuals(np.array([5.0, -1.0]), np.array([-1.0, 2.0]), np.ones(2))
    assert (inflation.factor == 1.0).all()


@pytest.fixture(scope="module")
def wall():
    return Wall(swaying, 8.0, seed=2)


def with_noise(samples: list[Sample], times: float) -> Iterator[Sample]:
    """White noise of a multiple of the stated density."""
    rng, part, root_hz = np.random.default_rng(1), rig().imus["/head/imu"], IMU_HZ**0.5
    for s in samples:
        if isinstance(s, Imu):
            rate, force = times * root_hz * rng.normal(size=(2, 3))
            yield replace(
                s,
                angular_rate=s.angular_rate + part.gyroscope_noise_density * rate,
                specific_force=s.specific_force + part.accelerometer_noise_density * force,
            )
        else:
            yield s


def test_parts_as_their_data_sheets_say_are_not_touched(wall):
    samples = list(wall.samples())
    by_images, by_data_sheet = (
        followed(wall, samples, method=DvioMethod(imu_noise_from_images=use))[1] for use in (True, False)
    )
    assert all(
        (a.pose.T_world_frame == b.pose.T_world_frame).all() for a, b in zip(by_images, by_data_sheet, strict=True)
    )


def test_a_mount_that_vibrates_is_found():
    """From two seconds on, as white noise of sixty times the stated density."""
    wall = Wall(swaying, 12.0, seed=2)
    samples = list(wall.samples())
    shaken = [b if b.t_ns > 2e9 else a for a, b in zip(samples, with_noise(samples, 60.0), strict=True)]
    (found, by_images), (_, by_data_sheet) = (
        followed(wall, shaken, method=DvioMethod(imu_noise_from_images=use)) for use in (True, False)
    )
    assert all(25.0 < factor < 120.0 for factor in found.imu_noise_factors)
    assert errors(wall, by_images).mean() < 0.75 * errors(wall, by_data_sheet).mean()
