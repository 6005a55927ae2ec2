"""Inertial measurement unit: interval means that strapdown integration turns back into the motion."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.sim.noise import Noise
from stridetwin.sim.rotation import cross
from stridetwin.sim.track import Track
from stridetwin.streams.rig import ImuCalibration
from stridetwin.streams.samples import Array, Block, Imu

GRAVITY = 9.81


class ImuModel:
    """Sample k is the mean over (t_{k-1}, t_k].

    The angular rate is the constant one that turns the attitude at t_{k-1} into that at t_k; the specific
    force is the constant one, in the turning sensor frame, that makes the velocity's true change. So there is
    no coning or sculling error at any rate: attitude and velocity come back exactly, and position, by the
    trapezoids of the velocity, but for Δt²/12 times the change of the acceleration. Before the very first
    sample the sensor is taken to move steadily.

    Args:
        calibration: The sensor as it really is.
        noise: Its noise; white noise and a constant turn-on bias.
        gravity: m/s², along −z of the world.
    """

    def __init__(self, calibration: ImuCalibration, noise: Noise, gravity: float = GRAVITY) -> None:
        self._calibration, self._noise = calibration, noise
        self._gravity = np.array([0.0, 0.0, -gravity])
        self._bias = noise.normal(1.0, 6) * np.repeat(
            [calibration.gyroscope_bias_sd, calibration.accelerometer_bias_sd], 3
        )
        per_sample = math.sqrt(calibration.rate_hz)
        self._white_sd = np.repeat(
            [calibration.gyroscope_noise_density, calibration.accelerometer_noise_density], 3
        ) * per_sample  # fmt: skip
        self._last: Track | None = None

    def read(self, body: Track) -> Block[Imu]:
        """Samples at the track's instants.

        Args:
            body: Track of the body that carries the sensor, at the sample instants; it follows on the one
                before.
        """
        sensor = body.mounted(self._calibration.mount.T_body_sensor)
        before = self._last or _steadily_before(sensor, 1 / self._calibration.rate_hz)
        rate, force = mean_rate_and_force(before, sensor, self._gravity)
        error = self._bias + self._noise.normal(self._white_sd, (len(sensor), 6))
        self._last = sensor[-1:]
        return Block(
            topic=self._calibration.topic,
            kind=Imu,
            t_ns=sensor.t_ns,
            columns={"angular_rate": rate + error[:, :3], "specific_force": force + error[:, 3:]},
        )


def mean_rate_and_force(before: Track, sensor: Track, gravity: Array) -> tuple[Array, Array]:
    """Constant rate and specific force over each interval.

    With φ = Log(R₀ᵀR₁) the velocity changes by R₀ Γ₁(φ) f Δt + g Δt, where Γ₁ is the left Jacobian of SO(3).

    Args:
        before: One instant, the start of the first interval.
        sensor: N ends of intervals.
        gravity: (3,) in the world, m/s².

    Returns:
        (N, 3) rad/s and (N, 3) m/s², in the sensor frame.
    """
    dt = np.diff(sensor.t_ns, prepend=before.t_ns)[:, None] * 1e-9
    rotation = Rotation.concatenate([before.rotation, sensor.rotation])
    velocity = np.concatenate([before.v_body_in_world, sensor.v_body_in_world])
    start = rotation[:-1]
    phi = (start.inv() * rotation[1:]).as_rotvec()
    push = start.inv().apply(np.diff(velocity, axis=0) / dt - gravity)
    return phi / dt, _left_jacobian_inverse_times(phi, push)


def _left_jacobian_inverse_times(phi: Array, v: Array) -> Array:
    """(N, 3): Γ₁(φ)⁻¹ v = v − φ×v/2 + c φ×(φ×v), c = (1 − (θ/2) cot(θ/2)) / θ² (Barfoot 2017, eq. 7.37)."""
    theta = np.linalg.norm(phi, axis=-1, keepdims=True)
    half = np.maximum(theta, 1e-4) / 2
    c = np.where(theta < 1e-4, 1 / 12, (1 - half / np.tan(half)) / (4 * half**2))
    across = cross(phi, v)
    return v - across / 2 + c * cross(phi, across)


def _steadily_before(sensor: Track, dt: float) -> Track:
    """One instant before the track's first, had rate and velocity been constant until then."""
    first = sensor[:1]
    return Track(
        t_ns=first.t_ns - round(dt * 1e9),
        p_body_in_world=first.p_body_in_world - dt * first.v_body_in_world,
        q_world_body=(first.rotation * Rotation.from_rotvec(-dt * first.w_body)).as_quat(scalar_first=True),
        v_body_in_world=first.v_body_in_world,
        w_body=first.w_body,
    )
