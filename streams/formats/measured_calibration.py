"""Calibration of an IMU read from its own samples: noise at rest, gyro bias, quantisation, and range from its peaks."""

from __future__ import annotations

import math

import numpy as np

from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2
from stridetwin.streams.plausible import median_rate
from stridetwin.streams.rig import ImuCalibration, Mount
from stridetwin.streams.samples import Array, Block, Imu

REST_S = 0.5
"""Length of the windows among which the quietest is the rest."""
REST_RATE_SD_RADPS, REST_FORCE_SD_MPS2 = 0.05, 0.3
"""A rest is not less quiet than this: a person who stands."""
SWAY_RADPS = 0.015
"""A mean rate at rest up to this may be the sway of a person who stands; a larger one is the gyro's bias."""
GYRO_RANGES_RADPS = tuple(math.radians(dps) for dps in (250.0, 500.0, 1000.0, 2000.0, 4000.0))
ACCEL_RANGES_MPS2 = tuple(g * STANDARD_GRAVITY_MPS2 for g in (2.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0))
"""Usual full scales."""
FULL_SCALE_ERROR, PILE, LEAST_LIMITED = 0.02, 0.985, 5
"""A channel is limited if its largest magnitude is a usual full scale up to this error of its calibration, and so many
samples lie above the share `PILE` of it. Slow rotations also dwell at their peaks, but at no usual full scale."""


def measure_imu(block: Block[Imu], topic: str, body: str) -> ImuCalibration:
    """Estimates the calibration of an unknown IMU from its own samples; 0 stands for what they do not determine.

    The noise densities and the gyro bias come from the quietest window of `REST_S`, provided that the sensor rests
    there; ranges come from samples that pile up at a usual full scale.

    Args:
        block: A whole recording.
        topic: Topic of the IMU in a rig.
        body: Body that carries the sensor.
    """
    rate, force = block.columns["angular_rate"], block.columns["specific_force"]
    rate_hz = median_rate(block.t_ns)
    rest = _find_rest(rate, force, max(round(REST_S * rate_hz), 8))  # rows of the quietest window, or None
    gyro, accel, bias = 0.0, 0.0, 0.0  # noise densities of both, and bias of the gyroscope
    if rest is not None:
        gyro = _estimate_noise_density(rate[rest], measure_resolution(rate), rate_hz)
        accel = _estimate_noise_density(force[rest], measure_resolution(force), rate_hz)
        mean = float(np.linalg.norm(rate[rest].mean(axis=0)))
        bias = mean if mean > SWAY_RADPS else 0.0
    return ImuCalibration(
        topic=topic,
        part="",
        rate_hz=rate_hz,
        mount=Mount(body=body),
        gyroscope_noise_density=gyro,
        gyroscope_random_walk=0.0,
        accelerometer_noise_density=accel,
        accelerometer_random_walk=0.0,
        gyroscope_bias_sd=bias,
        gyroscope_range=_find_range(rate, GYRO_RANGES_RADPS),
        accelerometer_range=_find_range(force, ACCEL_RANGES_MPS2),
    )


def _find_rest(rate: Array, force: Array, n: int) -> slice | None:
    """Finds the window with the least spread of the rate; None if the sensor moves even then.

    Args:
        rate: (N, 3) angular rate, rad/s.
        force: (N, 3) specific force, m/s².
        n: Samples of a window; two neighbouring windows overlap by half.

    Returns:
        The rows of the window.
    """
    starts = range(0, len(rate) - n + 1, max(n // 2, 1))
    spread = [float(rate[i : i + n].std(axis=0).max()) for i in starts]  # of the axis that moves most
    if not spread:  # fewer samples than a window has
        return None
    first = starts[int(np.argmin(spread))]
    window = slice(first, first + n)
    quiet = min(spread) < REST_RATE_SD_RADPS and force[window].std(axis=0).max() < REST_FORCE_SD_MPS2
    return window if quiet else None


def _estimate_noise_density(x: Array, count: float, rate_hz: float) -> float:
    """Density of the white noise of samples (N, 3), in their unit per √Hz.

    It is sd(x[k+1] - x[k]) / √2 / √rate, the mean of the three channels; quantisation sets the least noise.

    Args:
        x: (N, 3) samples at rest.
        count: Step of the quantisation, in the unit of the samples; its noise is count / √12.
        rate_hz: Rate of the samples.
    """
    white = np.diff(x, axis=0).std(axis=0).mean() / np.sqrt(2.0)
    return float(max(white, count / np.sqrt(12.0)) / np.sqrt(rate_hz))


def measure_resolution(x: Array) -> float:
    """The quantisation step of samples (N, 3): the least difference within a channel, the largest of the three."""
    steps = [np.diff(np.unique(channel)) for channel in x.T]  # between neighbouring values; none if all are equal
    return float(max((step.min() for step in steps if len(step)), default=0.0))


def _find_range(x: Array, full_scales: tuple[float, ...]) -> float:
    """The magnitude beyond which samples (N, 3) count as limited; 0 if they are not limited by a usual full scale.

    Limited means: the largest magnitude is within 2 % of a full scale, and at least `LEAST_LIMITED` samples reach the
    share `PILE` of that magnitude, which is returned.
    """
    largest = float(abs(x).max())
    is_full_scale = any(abs(largest / full_scale - 1.0) <= FULL_SCALE_ERROR for full_scale in full_scales)
    if is_full_scale and np.count_nonzero(abs(x) >= PILE * largest) >= LEAST_LIMITED:
        return PILE * largest
    return 0.0
