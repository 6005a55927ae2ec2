"""Inertial measurement unit: from the true motion of its mount to the counts of its converter."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt, sosfilt_zi

from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.kinds import Accelerometer, Gyroscope, ImuPart
from stridetwin.sim.sensors.strapdown import increments, joined, steadily_before
from stridetwin.sim.sensors.wander import Wander
from stridetwin.sim.track import Track
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.rig import ImuCalibration
from stridetwin.streams.samples import Array, Block, Imu

INNER_HZ = 1000.0
"""Least rate at which a part with limited bandwidth samples the motion internally."""


class ImuModel:
    """Sample k is the mean over (t_{k-1}, t_k].

    A real part samples the motion at `INNER_HZ` or more, with scale factors, misalignment, g-sensitivity, turn-on bias
    and bandwidth (a second-order low-pass filter, whose delay the stamps compensate). The inner steps of a sample are
    then combined without coning or sculling error (`strapdown.joined`). Varying biases and white noise are added, and
    the result is clipped to the range and quantised: the register saturates, not the sensing element. An ideal part
    needs no inner steps: attitude and velocity can be recovered exactly from its samples, and position, by the
    trapezoidal rule for the velocity, up to Δt²/12 times the change of the acceleration. Before the first sample, the
    motion is assumed to be steady.

    Args:
        calibration: Topic and mount.
        part: True parameters of the sensor.
        noise: Source of its errors.
        gravity: m/s², along −z of the world.
    """

    def __init__(
        self, calibration: ImuCalibration, part: ImuPart, noise: Noise, gravity: float = NOMINAL_GRAVITY_MPS2
    ) -> None:
        self._calibration, self._noise = calibration, noise
        self._gravity = np.array([0.0, 0.0, -gravity])
        self.rate_hz = part.rate_hz
        self._range, bandwidth = _six(part, "range"), _six(part, "bandwidth_hz")
        self.steps = math.ceil(INNER_HZ / part.rate_hz) if np.isfinite(bandwidth).any() else 1
        self._filters = [_LowPass(f, self.steps * part.rate_hz) for f in bandwidth]
        self.delay_s = float(np.mean([f.delay_s for f in self._filters]))
        self._bias = noise.normal(1.0, 6) * _six(part, "turn_on_bias")
        self._mix = _mix(part, noise)
        self._wander = Wander(_six(part, "bias_instability"), _six(part, "random_walk"), part.rate_hz, noise.at(0))
        self._white = _six(part, "noise_density") * math.sqrt(part.rate_hz)
        self._resolution = _six(part, "resolution")
        self._last: Track | None = None

    def read(self, body: Track, t_ns: NDArray[np.int64]) -> Block[Imu]:
        """The next samples.

        Args:
            body: Track of the body that carries the sensor, at the ends of the inner steps of every sample (`steps` per
                sample, one for the very first), `delay_s` after their stamps; it continues the previous track.
            t_ns: (N,) instants of the samples.
        """
        sensor = body.mounted(self._calibration.mount.T_body_sensor)
        if self._last is None:
            past = steadily_before(sensor, self.steps, 1 / (self.steps * self.rate_hz))
            sensor, self._last = past[1:].then(sensor), past[:1]
        dt, rate, force = increments(self._last, sensor, self._gravity)
        self._last = sensor[-1:]
        if self.steps > 1:
            sensed = self._followed(np.hstack([rate, force]))
            rate, force = joined(dt, sensed[:, :3], sensed[:, 3:], self.steps)
        else:
            rate, force = np.split(np.hstack([rate, force]) @ self._mix.T + self._bias, 2, axis=1)
        measured = np.hstack([rate, force]) + self._wander.draw(len(t_ns))
        measured += self._noise.normal(self._white, measured.shape)
        measured = _counted(np.clip(measured, -self._range, self._range), self._resolution)
        return Block(
            topic=self._calibration.topic,
            kind=Imu,
            t_ns=t_ns,
            columns={"angular_rate": measured[:, :3], "specific_force": measured[:, 3:]},
        )

    def _followed(self, true: Array) -> Array:
        """(N, 6) rate and force after the bandwidth of the sensing elements."""
        sensed = true @ self._mix.T + self._bias
        for axis, low_pass in enumerate(self._filters):
            sensed[:, axis] = low_pass(sensed[:, axis])
        return sensed


class _LowPass:
    """Second-order Butterworth filter that keeps its state between chunks; it starts in a steady state."""

    def __init__(self, cut_hz: float, rate_hz: float) -> None:
        self._sos, self.delay_s = None, 0.0
        self._state: Array | None = None
        if cut_hz < 0.45 * rate_hz:
            self._sos = butter(2, cut_hz, fs=rate_hz, output="sos")
            # delay for slow motion; the bilinear transform makes it shorter than the analogue filter's
            self.delay_s = math.sqrt(2) / (2.0 * rate_hz * math.tan(math.pi * cut_hz / rate_hz))

    def __call__(self, x: Array) -> Array:
        if self._sos is None:
            return x
        if self._state is None:
            self._state = sosfilt_zi(self._sos) * x[0]
        y, self._state = sosfilt(self._sos, x, zi=self._state)
        return np.asarray(y)


def _six(part: ImuPart, name: str) -> Array:
    """(6,) a parameter of the three gyroscopes, then of the three accelerometers."""
    return np.repeat([getattr(part.gyroscope, name), getattr(part.accelerometer, name)], 3)


def _mix(part: ImuPart, noise: Noise) -> Array:
    """(6, 6) sensitivity of each axis to each component: scale factors, misalignment, g-sensitivity."""
    mix = np.eye(6)
    triads: tuple[Gyroscope | Accelerometer, ...] = (part.gyroscope, part.accelerometer)
    for i, triad in enumerate(triads):
        own = slice(3 * i, 3 * i + 3)
        sd = np.where(np.eye(3, dtype=bool), triad.scale_factor, triad.misalignment)
        mix[own, own] += noise.normal(sd, (3, 3))
    mix[:3, 3:] = noise.normal(part.gyroscope.g_sensitivity, (3, 3))
    return mix


def _counted(x: Array, resolution: Array) -> Array:
    """Quantised to whole counts, for parts that quantise."""
    step = np.where(resolution > 0, resolution, 1.0)
    return np.where(resolution > 0, np.round(x / step) * step, x)
