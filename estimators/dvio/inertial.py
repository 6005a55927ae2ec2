"""Buffer of the newest valid IMU samples, with detection of a stationary sensor."""

from __future__ import annotations

import math

import numpy as np

from stridetwin.estimators.dvio.parameters import DvioParameters
from stridetwin.streams.rig import ImuCalibration
from stridetwin.streams.samples import Array, Imu

_HELD_S = 6.0  # at least; longer than a start in motion, or than a gap in vision followed by a late image
_SATURATED = 0.995
_MOST = np.repeat([100.0, 1000.0], 3)  # rad/s, m/s²; no head moves faster


class Inertial:
    """A buffer of samples in time order.

    A sample that is not finite, out of range or not later than the last one is rejected. A sample is invalid if it is
    saturated, or if it follows missing samples (it then replaces them, as the mean with the previous one). Samples of
    the last 6 s are kept, at the nominal rate.

    Args:
        calibration: Rate and ranges.
    """

    def __init__(self, calibration: ImuCalibration) -> None:
        self._half = math.ceil(_HELD_S * calibration.rate_hz) + 1
        self.t_ns = np.zeros(2 * self._half, np.int64)
        self.samples = np.zeros((2 * self._half, 6))
        self.invalid = np.zeros(2 * self._half, np.uint8)
        self.count = 0
        self.period_s = 1.0 / calibration.rate_hz
        ranges = (calibration.gyroscope_range or np.inf, calibration.accelerometer_range or np.inf)
        self._limit = np.repeat(ranges, 3) * _SATURATED

    def take(self, sample: Imu) -> bool:
        """Takes a sample; False where it is ignored."""
        if self.count and sample.t_ns <= self.t_ns[self.count - 1]:
            return False
        x = np.empty(6)
        x[:3], x[3:] = sample.angular_rate, sample.specific_force
        size = np.abs(x)
        if not (size <= _MOST).all():
            return False
        half = self._half
        if self.count == 2 * half:
            for a in (self.t_ns, self.samples, self.invalid):
                a[:half] = a[half:].copy()
            self.count = half
        i = self.count
        missing = i > 0 and (sample.t_ns - self.t_ns[i - 1]) * 1e-9 > 1.7 * self.period_s
        self.t_ns[i] = sample.t_ns
        self.samples[i] = 0.5 * (x + self.samples[i - 1]) if missing else x
        self.invalid[i] = missing or bool((size >= self._limit).any())
        self.count += 1
        return True

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest sample."""
        return int(self.t_ns[self.count - 1])

    @property
    def staying_ns(self) -> int:
        """Stamp of the oldest sample that remains after the next one."""
        return int(self.t_ns[max(self.count - self._half, 0)])

    def gap_s(self) -> float:
        """Time between the two newest samples, s."""
        return (self.newest_ns - int(self.t_ns[self.count - 2])) * 1e-9 if self.count > 1 else 0.0

    def rate_at(self, t_ns: int) -> Array:
        """(3,) measured angular rate near a time, rad/s."""
        i = int(np.searchsorted(self.t_ns[: self.count], t_ns))
        i = min(max(i, 1), self.count - 1)
        share = (t_ns - self.t_ns[i - 1]) / (self.t_ns[i] - self.t_ns[i - 1])
        # a sample is the mean over the period that ends with it
        j = min(i + 1, self.count - 1) if share > 0.5 else max(i - 1, 0)
        weight = abs(share - 0.5)
        return np.asarray((1 - weight) * self.samples[i, :3] + weight * self.samples[j, :3])

    def since(self, t_ns: int, until_ns: int) -> Array:
        """(N, 6) samples within (t_ns, until_ns]."""
        i, j = np.searchsorted(self.t_ns[: self.count], [t_ns, until_ns], side="right")
        return self.samples[i:j]

    def reaches_back(self, t_ns: int) -> bool:
        """Whether the samples are complete from a time on."""
        return self.count > 0 and int(self.t_ns[0]) <= t_ns

    def stationary(self, until_ns: int, parameters: DvioParameters) -> bool:
        """Whether the sensor was stationary just before a time, by the scatter of its samples."""
        start = until_ns - round(parameters.stationary_s * 1e9)
        if not self.reaches_back(start):
            return False
        x = self.since(start, until_ns)
        if len(x) < 0.7 * parameters.stationary_s / self.period_s:
            return False
        spread = x.std(axis=0)
        return bool(
            spread[:3].max() < parameters.stationary_rate_sd_radps
            and spread[3:].max() < parameters.stationary_force_sd_mps2
        )
