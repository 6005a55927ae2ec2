"""Sensors at the exoskeleton's joints and cuffs: encoders, force cells and actuation modules."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.kinds import ActuatorPart, EncoderPart, ForceCellPart
from stridetwin.sim.sensors.force_cell import ForceCells
from stridetwin.streams.rig import OtherSensor
from stridetwin.streams.samples import Actuator, Array, Block, Encoder, Interaction

Instants = NDArray[np.int64]


class EncoderModel:
    """Joint angle in whole counts, with an error of the zero position and an error that repeats every turn.

    Args:
        calibration: Topic and mount.
        part: True parameters of the encoder.
        noise: Source of its errors.
    """

    def __init__(self, calibration: OtherSensor, part: EncoderPart, noise: Noise) -> None:
        self._calibration = calibration
        self._offset = noise.normal(part.index_offset, 1)[0]
        self._step = 2 * math.pi / 2**part.bits if part.bits else 0.0
        self._nonlinearity, self._phase = part.nonlinearity, 2 * math.pi * noise.normal(1.0, 1)[0]

    def read(self, t_ns: Instants, angle: Array) -> Block[Encoder]:
        """Samples of the true angle (N,), rad, at (N,) instants."""
        measured = angle + self._offset + self._nonlinearity * np.sin(angle + self._phase)
        if self._step:
            measured = self._step * np.round(measured / self._step)
        return Block(topic=self._calibration.topic, kind=Encoder, t_ns=t_ns, columns={"angle": measured})


class InteractionModel:
    """Two preloaded springs, each on a force cell: a force loads one and unloads the other, until that one is free.

    The difference of the two is the force, and its sign the direction (Shim et al. 2019, figure 8).

    Args:
        calibration: Topic and mount.
        part: True parameters of the cells.
        noise: Source of their errors.
    """

    def __init__(self, calibration: OtherSensor, part: ForceCellPart, noise: Noise) -> None:
        self._calibration, self._preload = calibration, part.preload
        self._cells = ForceCells(part, 2, calibration.rate_hz, noise)

    def read(self, t_ns: Instants, force: Array) -> Block[Interaction]:
        """Samples of the cuff's force on the limb (N,), N, positive where it presses on the limb's front."""
        push = np.stack([force, -force], axis=-1)
        measured = self._cells.read(np.maximum(self._preload + 0.5 * push, np.maximum(push, 0.0)))
        return Block(topic=self._calibration.topic, kind=Interaction, t_ns=t_ns, columns={"force": measured})


class ActuatorModel:
    """Actuation module of one joint.

    Args:
        calibration: Topic and mount.
        part: White noise on torque and speed.
        noise: Source of the noise.
    """

    def __init__(self, calibration: OtherSensor, part: ActuatorPart, noise: Noise) -> None:
        self._calibration, self._noise = calibration, noise
        self._sd = np.array([part.torque_noise, part.speed_noise])

    def read(self, t_ns: Instants, command: ArrayLike, torque: ArrayLike, speed: ArrayLike) -> Block[Actuator]:
        """Samples of the command (N,) and the true torque (N,), N m, and the joint's true speed (N,), rad/s.

        Without an actuation module, or with an idle one, command and torque of the motor are 0.
        """
        n = len(t_ns)
        white = self._noise.normal(self._sd, (n, 2))
        return Block(
            topic=self._calibration.topic,
            kind=Actuator,
            t_ns=t_ns,
            columns={
                "torque_command": np.broadcast_to(np.asarray(command, dtype=float), n),
                "torque": np.asarray(torque, dtype=float) + white[:, 0],
                "speed": np.asarray(speed, dtype=float) + white[:, 1],
            },
        )
