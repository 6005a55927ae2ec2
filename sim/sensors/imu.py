"""Inertial measurement unit: from the true motion of its mount to the counts of its converter.

Its samples are interval means of rate and specific force, from which strapdown integration recovers the motion.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.noise import Noise, Wander
from stridetwin.sim.parts.kinds import Accelerometer, Gyroscope, ImuPart
from stridetwin.sim.sensors.model import SensorModel
from stridetwin.streams.algebra.tuples import (
    IDENTITY,
    apply,
    apply_inverse_left_jacobian,
    apply_left_jacobian,
    exp,
    inverse,
    log,
    minus,
    multiply,
    plus,
    quaternion,
    store_vec3,
    times,
    vec3,
)
from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.rig import ImuCalibration
from stridetwin.streams.samples import Array, Block, Imu

_entry_kernel = entry_kernel(__file__)


def compute_increments(before: Track, sensor: Track, gravity: Array) -> tuple[Array, Array, Array]:
    """Constant rate and specific force over each interval.

    The rate is the constant one that rotates the attitude at an interval's start to that at its end. The specific force
    is the constant one, in the rotating sensor frame, that gives the true change of velocity: with φ = Log(R₀ᵀR₁) the
    velocity changes by R₀ Γ₁(φ) f Δt + g Δt, where Γ₁ is the left Jacobian of SO(3).

    Args:
        before: One instant, the start of the first interval.
        sensor: N ends of intervals.
        gravity: (3,) in the world, m/s².

    Returns:
        (N,) s, (N, 3) rad/s and (N, 3) m/s², in the sensor frame.
    """
    return _compute_increments(*_columns(before), *_columns(sensor), gravity)


def _columns(track: Track) -> tuple[NDArray[np.int64], Array, Array]:
    """Instants (N,) ns, attitudes (N, 4), body to world, and velocities (N, 3) m/s, world axes, of a track."""
    return track.t_ns, track.q_world_body, track.v_body_in_world


@_entry_kernel
def _compute_increments(
    t0: NDArray[np.int64], q0: Array, v0: Array, t: NDArray[np.int64], q: Array, v: Array, gravity: Array
) -> tuple[Array, Array, Array]:
    """Durations (N,) s, constant rates (N, 3) rad/s and specific forces (N, 3) m/s² of the intervals, sensor frame.

    With φ = Log(R₀ᵀ R₁) they are Δt, φ / Δt and Γ₁(φ)⁻¹ R₀ᵀ ((v₁ − v₀) / Δt − g), where Γ₁ is the left Jacobian of
    SO(3). Index 0 is the start of an interval, index 1 its end; each interval starts at the end of the one before.

    Args:
        t0: (1,) ns, start of the first interval.
        q0: (1, 4) attitude there, sensor to world.
        v0: (1, 3) m/s, velocity there, world axes.
        t: (N,) ns, ends of the intervals.
        q: (N, 4) attitudes there.
        v: (N, 3) m/s, velocities there.
        gravity: (3,) g in the world, m/s².
    """
    n = len(t)
    dts, rates, forces = np.empty(n), np.empty((n, 3)), np.empty((n, 3))
    # at the start of the interval: time, rotation from the world to the sensor, and velocity
    t_last, to_sensor, v_last, g = t0[0], inverse(quaternion(q0[0])), vec3(v0[0]), vec3(gravity)
    for i in range(n):
        dt, attitude, velocity = (t[i] - t_last) * 1e-9, quaternion(q[i]), vec3(v[i])
        phi = log(multiply(to_sensor, attitude))
        # mean specific force in the sensor's axes at the start
        push = apply(to_sensor, minus(times(1 / dt, minus(velocity, v_last)), g))
        dts[i] = dt
        store_vec3(times(1 / dt, phi), rates[i])
        store_vec3(apply_inverse_left_jacobian(phi, push), forces[i])
        t_last, to_sensor, v_last = t[i], inverse(attitude), velocity
    return dts, rates, forces


@_entry_kernel
def combine_increments(dt: Array, rate: Array, force: Array, steps: int) -> tuple[Array, Array]:
    """Constant rate and specific force over every `steps` intervals, without coning or sculling error.

    Rotation and velocity change of the `steps` intervals are composed, and converted to the constant rate and force
    with which one long interval has the same rotation and velocity change.

    Args:
        dt: (N,) s.
        rate: (N, 3) rad/s.
        force: (N, 3) m/s².
        steps: Divides N.

    Returns:
        (N / steps, 3) rad/s and (N / steps, 3) m/s².
    """
    n = len(dt) // steps
    rates, forces = np.empty((n, 3)), np.empty((n, 3))
    for i in range(n):
        # since the start of the long interval: rotation, and change of velocity in the sensor's axes at that start
        rotation, change, duration = IDENTITY, (0.0, 0.0, 0.0), 0.0
        for k in range(i * steps, (i + 1) * steps):
            phi = times(dt[k], vec3(rate[k]))
            push = apply_left_jacobian(phi, times(dt[k], vec3(force[k])))
            change = plus(change, apply(rotation, push))
            rotation = multiply(rotation, exp(phi))
            duration += dt[k]
        total = log(rotation)
        store_vec3(times(1 / duration, total), rates[i])
        store_vec3(apply_inverse_left_jacobian(total, times(1 / duration, change)), forces[i])
    return rates, forces


def extrapolate_back(sensor: Track, steps: int, dt: float) -> Track:
    """Track of the `steps` instants before the first of `sensor`, `dt` s apart, at constant velocity and rate."""
    first = sensor[:1]
    ago = dt * np.arange(steps, 0, -1)[:, None]  # (steps, 1) s before the first instant
    return Track(
        t_ns=first.t_ns - np.round(ago[:, 0] * 1e9).astype(np.int64),
        p_body_in_world=first.p_body_in_world - ago * first.v_body_in_world,
        q_world_body=(first.rotation * Rotation.from_rotvec(-ago * first.w_body)).as_quat(scalar_first=True),
        v_body_in_world=np.repeat(first.v_body_in_world, steps, axis=0),
        w_body=np.repeat(first.w_body, steps, axis=0),
    )


_WARM_UP_S = 300.0  # time constant of a part's temperature after it is switched on [estimated]
INNER_HZ = 1000.0
"""Least rate at which a part with limited bandwidth samples the motion internally."""


class ImuModel(SensorModel[ImuCalibration, ImuPart]):
    """Inertial measurement unit: sample k is the mean of rate and specific force over (t_{k-1}, t_k].

    A real part samples the motion at `INNER_HZ` or more, with scale factors, misalignment, g-sensitivity, turn-on bias
    and bandwidth (a second-order low-pass filter, whose delay the stamps compensate). The inner steps of a sample are
    then combined without coning or sculling error (`combine_increments`). Varying biases and white noise are added, and
    the result is clipped to the range and quantised: the register saturates, not the sensing element. An ideal part
    needs no inner steps: attitude and velocity can be recovered exactly from its samples, and position, by the
    trapezoidal rule for the velocity, up to Δt²/12 times the change of the acceleration. Before the first sample, the
    motion is assumed to be steady.

    A channel with a delay gives what a part without it gives that much earlier: its inner steps are delayed after the
    filter and before they are combined, as constant rates and forces that a sample's limits may cut anywhere. So whole
    samples of delay shift the samples, and the rotation over any time is kept.

    Args:
        calibration: Topic, rate and mount.
        part: True parameters of the sensor.
        noise: Source of its errors.
        gravity: Along −z of the world, m/s².

    Attributes:
        rate_hz: Sample rate.
        steps: Inner steps per sample.
        delay_s: Mean delay of the six low-pass filters, s; 0 for an ideal part.
    """

    def __init__(
        self, calibration: ImuCalibration, part: ImuPart, noise: Noise, gravity: float = NOMINAL_GRAVITY_MPS2
    ) -> None:
        """Draws the constant errors of one unit; six-vectors are three axes of rate, then three of specific force."""
        super().__init__(calibration, part, noise)
        self._gravity = np.array([0.0, 0.0, -gravity])
        self.rate_hz = part.rate_hz
        self._range, bandwidth = _six_axes(part, "range"), _six_axes(part, "bandwidth_hz")
        # inner steps per sample; a part with unlimited bandwidth is ideal and needs none
        self.steps = math.ceil(INNER_HZ / part.rate_hz) if np.isfinite(bandwidth).any() else 1
        delays_s = part.gyroscope.delay_s, part.accelerometer.delay_s
        if any(delays_s):  # limits of samples cut inner steps, so there have to be short ones
            self.steps = math.ceil(INNER_HZ / part.rate_hz)
        self._filters = [_LowPass(f, self.steps * part.rate_hz) for f in bandwidth]
        # of the gyroscope, and of the accelerometer; None for a part without delay
        self._delays = [_Delay(d * self.steps * part.rate_hz) for d in delays_s] if any(delays_s) else None
        self.delay_s = float(np.mean([f.delay_s for f in self._filters]))
        self._bias = noise.normal(1.0, 6) * _six_axes(part, "turn_on_bias")
        self._mix = _draw_sensitivity(part, noise)  # (6, 6), from true to sensed rate and force
        self._wander = Wander(
            _six_axes(part, "bias_instability"), _six_axes(part, "random_walk"), part.rate_hz, noise.at(0)
        )
        # (6,) change of each bias until the part is warm, from random numbers of its own
        self._warm_up = noise.at(1).normal(1.0, 6) * _six_axes(part, "warm_up")
        # (6,) SD of the white noise of a sample
        self._white = _six_axes(part, "noise_density") * math.sqrt(part.rate_hz)
        self._resolution = _six_axes(part, "resolution")
        self._last: Track | None = None  # the last instant of the track so far

    def read(self, body: Track, t_ns: NDArray[np.int64]) -> Block[Imu]:
        """The next samples.

        Biases, filters and the end of the last track (`_last`) are kept for the next call.

        Args:
            body: Track of the body that carries the sensor, at the ends of the inner steps of every sample (`steps` per
                sample, one for the very first), `delay_s` after their stamps; it continues the previous track.
            t_ns: (N,) instants of the samples.
        """
        sensor = body.to_sensor(self._calibration.mount.T_body_sensor)
        if self._last is None:  # the first call: steady motion before it
            past = extrapolate_back(sensor, self.steps, 1 / (self.steps * self.rate_hz))
            # the first sample gets all its inner steps; the instant before them starts the first interval
            self._last = past[:1]
            sensor = past[1:].append_track(sensor)
        dt, rate, force = compute_increments(self._last, sensor, self._gravity)
        self._last = sensor[-1:]
        sensed = self._filter(np.hstack([rate, force]))
        if self._delays is not None:
            # both channels at the earlier instants of one of them, so that rotation and force belong together
            of_gyroscope, of_accelerometer = (delay(sensed) for delay in self._delays)
            rate, _ = combine_increments(dt, of_gyroscope[:, :3], of_gyroscope[:, 3:], self.steps)
            _, force = combine_increments(dt, of_accelerometer[:, :3], of_accelerometer[:, 3:], self.steps)
        elif self.steps > 1:
            rate, force = combine_increments(dt, sensed[:, :3], sensed[:, 3:], self.steps)
        else:  # an ideal part, or one that sends samples as often as it reads the motion
            rate, force = np.split(sensed, 2, axis=1)
        measured = np.hstack([rate, force]) + self._wander.draw(len(t_ns))
        if self._warm_up.any():
            measured += (1.0 - np.exp(t_ns[:, None] * (-1e-9 / _WARM_UP_S))) * self._warm_up
        measured += self._noise.normal(self._white, measured.shape)
        measured = _quantize(np.clip(measured, -self._range, self._range), self._resolution)
        return self._block(Imu, t_ns, angular_rate=measured[:, :3], specific_force=measured[:, 3:])

    def _filter(self, true: Array) -> Array:
        """(N, 6) rate and specific force at the inner steps, after the errors and the low-pass filters.

        `true` (N, 6) are the true ones. The state of the filters is kept for the next call.
        """
        sensed = true @ self._mix.T + self._bias
        for axis, low_pass in enumerate(self._filters):
            sensed[:, axis] = low_pass(sensed[:, axis])
        return sensed


class _LowPass:
    """Second-order Butterworth filter that keeps its state between chunks; it starts in a steady state.

    A cut-off that is not well below half the sample rate, such as inf, makes a filter that changes nothing.

    Args:
        cut_hz: Cut-off frequency.
        rate_hz: Sample rate.

    Attributes:
        delay_s: Delay of slow motion, s; 0 of a filter that changes nothing.
    """

    def __init__(self, cut_hz: float, rate_hz: float) -> None:
        """Designs the filter for a cut-off and a sample rate; a high cut-off leaves it out."""
        self._sos, self.delay_s = None, 0.0
        self._state: Array | None = None
        if cut_hz < 0.45 * rate_hz:
            from scipy.signal import butter  # takes long to import, so only when a sensor filters

            self._sos = butter(2, cut_hz, fs=rate_hz, output="sos")
            # delay for slow motion; the bilinear transform makes it shorter than the analogue filter's
            self.delay_s = math.sqrt(2) / (2.0 * rate_hz * math.tan(math.pi * cut_hz / rate_hz))

    def __call__(self, x: Array) -> Array:
        """(N,) filtered values of the next (N,) samples; the state is kept for the next call."""
        if self._sos is None:
            return x
        from scipy.signal import sosfilt, sosfilt_zi

        if self._state is None:
            self._state = sosfilt_zi(self._sos) * x[0]  # as after a long time at the first value
        y, self._state = sosfilt(self._sos, x, zi=self._state)
        return np.asarray(y)


class _Delay:
    """Delay of constant values over equal steps that keeps its state between chunks; it starts in a steady state.

    A part of a step is exact for values that are constant over each step: a delayed step covers the end of one step and
    the beginning of the next, and has the mean over both.

    Args:
        steps: Length of the delay in steps, also with a fraction.
    """

    def __init__(self, steps: float) -> None:
        self._whole, self._fraction = int(steps), steps % 1.0
        self._past: Array | None = None  # (whole + 1, K) values of the steps before the next ones

    def __call__(self, x: Array) -> Array:
        """(N, K) values in place of the next (N, K) ones; the last ones are kept for the next call."""
        if self._past is None:
            self._past = np.repeat(x[:1], self._whole + 1, axis=0)  # as after a long time at the first value
        known = np.vstack([self._past, x])
        self._past = known[len(x) :]
        # the steps `whole` before the next ones, and those before these
        later, earlier = known[1 : len(x) + 1], known[: len(x)]
        return (1.0 - self._fraction) * later + self._fraction * earlier


def _six_axes(part: ImuPart, name: str) -> Array:
    """(6,) one parameter of a part: that of the gyroscope three times, then that of the accelerometer three times."""
    return np.repeat([getattr(part.gyroscope, name), getattr(part.accelerometer, name)], 3)


def _draw_sensitivity(part: ImuPart, noise: Noise) -> Array:
    """(6, 6) sensitivity of each axis to the true rate (3) and specific force (3), drawn from the part's tolerances.

    It has scale factors on the diagonal, misalignment beside it, and g-sensitivity from force to rate.
    """
    mix = np.eye(6)
    triads: tuple[Gyroscope | Accelerometer, ...] = (part.gyroscope, part.accelerometer)
    for triad, rows in zip(triads, (slice(3), slice(3, 6))):
        # (3, 3) SDs of the entries: the scale factor on the diagonal, the misalignment elsewhere
        sd = np.where(np.eye(3, dtype=bool), triad.scale_factor, triad.misalignment)
        mix[rows, rows] += noise.normal(sd, (3, 3))
    mix[:3, 3:] = noise.normal(part.gyroscope.g_sensitivity, (3, 3))
    return mix


def _quantize(x: Array, resolution: Array) -> Array:
    """(N, K) values rounded to whole counts of the resolution (K,); unchanged where that is 0."""
    step = np.where(resolution > 0, resolution, 1.0)  # any step without counts, so that nothing is divided by 0
    return np.where(resolution > 0, np.round(x / step) * step, x)
