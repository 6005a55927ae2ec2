"""Sensors of the exoskeleton: attitude references on its links; encoders and actuation modules at its joints."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.noise import Noise, Wander
from stridetwin.sim.parts.kinds import ActuatorPart, AhrsPart, EncoderPart
from stridetwin.sim.sensors.model import Instants, SensorModel
from stridetwin.streams.rig import OtherSensor
from stridetwin.streams.samples import Actuator, Ahrs, Array, Block, Encoder

_TILT_S = 2.0
"""Time constant with which a filter's tilt error decays: that of its accelerometer correction."""
_FULL_MOTION_RADPS = 2.0
"""Angular rate from which the sensor counts as in full motion, like a limb in a walk."""


class AhrsModel(SensorModel[OtherSensor, AhrsPart]):
    """Attitude and heading reference without magnetometer.

    Roll and pitch have a constant error and a first-order Gauss-Markov error, whose standard deviation is interpolated
    between those at rest and in motion with the share |ω| / 2 rad/s of full motion. The heading starts with an error,
    drifts at a constant rate within the part's limits, and performs a random walk in motion. The rates keep the bias
    residuals of the filter, which vary slowly.
    """

    def __init__(self, calibration: OtherSensor, part: AhrsPart, noise: Noise) -> None:
        """Draws the constant errors and the start values; the arguments are those of `SensorModel`."""
        super().__init__(calibration, part, noise)
        self._bias = noise.normal(part.tilt_bias, 2)  # rad, constant errors of roll and pitch
        self._keep = math.exp(-1 / (calibration.rate_hz * _TILT_S))  # share of the tilt error after one sample
        # (1, 2) rad, `_keep` times the last tilt error: the state of the filter, as `lfilter` needs it
        self._tilt = self._keep * noise.normal(part.tilt_still, 2)[None]
        self._heading = float(noise.normal(part.heading_bias, 1)[0])  # rad, error so far without the drift
        self._drift = part.heading_drift * float(2 * noise.uniform(1)[0] - 1)  # rad/s, either way
        self._rate_bias = noise.at(0).normal(part.rate_bias, 3)  # rad/s
        self._wander = Wander(np.full(3, part.rate_instability), np.zeros(3), calibration.rate_hz, noise.at(1))

    def read(self, body: Track) -> Block[Ahrs]:
        """The next samples, at the instants of the track of the body that carries the sensor."""
        sensor = body.to_sensor(self._calibration.mount.T_body_sensor)
        white = self._noise.normal(1.0, (len(body), 6))  # unit deviates: three of the attitude, three of the rates
        rate = sensor.w_body + self._rate_bias + self._wander.draw(len(body)) + self._part.rate_noise * white[:, 3:]
        error = self._draw_attitude_error(np.linalg.norm(sensor.w_body, axis=1), sensor.t_ns, white[:, :3])
        q = (Rotation.from_rotvec(error) * sensor.rotation).as_quat(scalar_first=True)
        return self._block(Ahrs, body.t_ns, q_world_sensor=q, angular_rate=rate)

    def _draw_attitude_error(self, rate: Array, t_ns: Instants, white: Array) -> Array:
        """(N, 3) rad, rotation vectors of the attitude error in the world: two of tilt, then the heading error.

        The tilt error (`_tilt`) and the walk of the heading (`_heading`) continue from call to call.

        Args:
            rate: (N,) rad/s, magnitude of the angular rate, which sets the share of full motion.
            t_ns: (N,) instants, for the heading's drift.
            white: (N, 3) unit normal deviates.
        """
        from scipy.signal import lfilter  # takes long to import, so only when a sensor filters

        part, moving = self._part, np.minimum(rate / _FULL_MOTION_RADPS, 1.0)  # share of full motion
        # (N,) rad, SD of the random part that each sample adds to the tilt, so that the tilt has the wanted SD
        step = (part.tilt_still + (part.tilt_moving - part.tilt_still) * moving) * math.sqrt(1 - self._keep**2)
        tilt, self._tilt = lfilter([1.0], [1.0, -self._keep], step[:, None] * white[:, :2], axis=0, zi=self._tilt)
        walked = np.cumsum(part.heading_walk * moving / math.sqrt(self._calibration.rate_hz) * white[:, 2])
        heading = self._heading + walked + self._drift * (t_ns * 1e-9)
        self._heading += float(walked[-1])
        return np.column_stack([self._bias + tilt, heading])


class EncoderModel(SensorModel[OtherSensor, EncoderPart]):
    """Joint angle in whole counts, with an error of the zero position and an error that repeats every turn."""

    def __init__(self, calibration: OtherSensor, part: EncoderPart, noise: Noise) -> None:
        """Draws the constant errors of one encoder; the arguments are those of `SensorModel`."""
        super().__init__(calibration, part, noise)
        self._offset = noise.normal(part.index_offset, 1)[0]  # rad
        self._step = 2 * math.pi / 2**part.bits if part.bits else 0.0  # rad per count; 0 for an ideal encoder
        self._phase = 2 * math.pi * noise.normal(1.0, 1)[0]  # rad, of the error that repeats every turn

    def read(self, t_ns: Instants, angle: Array) -> Block[Encoder]:
        """The next samples, from the true angle (N,), rad, at (N,) instants."""
        measured = angle + self._offset + self._part.nonlinearity * np.sin(angle + self._phase)
        if self._step:
            measured = self._step * np.round(measured / self._step)
        return self._block(Encoder, t_ns, angle=measured)


class ActuatorModel(SensorModel[OtherSensor, ActuatorPart]):
    """Actuation module of one joint: its command, and its torque and speed with white noise."""

    def read(self, t_ns: Instants, command: ArrayLike, torque: ArrayLike, speed: ArrayLike) -> Block[Actuator]:
        """The next samples of an actuation module.

        Without a module, or with an idle one, command and torque of the motor are 0.

        Args:
            t_ns: (N,) instants.
            command: (N,) N m, torque command.
            torque: (N,) N m, true torque.
            speed: (N,) rad/s, true speed of the joint.
        """
        # (N, 2) errors of torque and speed
        white = self._noise.normal(np.array([self._part.torque_noise, self._part.speed_noise]), (len(t_ns), 2))
        return self._block(
            Actuator,
            t_ns,
            torque_command=np.broadcast_to(np.asarray(command, dtype=float), len(t_ns)),
            torque=np.asarray(torque, dtype=float) + white[:, 0],
            speed=np.asarray(speed, dtype=float) + white[:, 1],
        )
