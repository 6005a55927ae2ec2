"""Sensors at the exoskeleton's joints and cuffs: encoders, force cells and actuation modules."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stridetwin.sim.noise import Noise
from stridetwin.streams.rig import OtherSensor
from stridetwin.streams.samples import Actuator, Array, Block, Encoder, Interaction

Instants = NDArray[np.int64]


class EncoderModel:
    """Joint angle in whole counts.

    Args:
        calibration: The encoder, with `counts` a turn and `angle_sd_rad`.
        noise: White noise before counting; ideal encoders do not count.
    """

    def __init__(self, calibration: OtherSensor, noise: Noise) -> None:
        self._calibration, self._noise = calibration, noise
        self._step = 2 * math.pi / calibration.number("counts")
        self._sd = calibration.number("angle_sd_rad")

    def read(self, t_ns: Instants, angle: Array) -> Block[Encoder]:
        """Samples of the true angle (N,), rad, at (N,) instants."""
        noisy = angle + self._noise.normal(self._sd, len(t_ns))
        told = noisy if self._noise.ideal else self._step * np.round(noisy / self._step)
        return Block(topic=self._calibration.topic, kind=Encoder, t_ns=t_ns, columns={"angle": told})


class InteractionModel:
    """Two preloaded springs, each on a force cell: a push loads one and unloads the other, until that one is free.

    What the two differ by is the push, its sign the direction (Shim et al. 2019, figure 8).

    Args:
        calibration: The pair, with `preload_n` and `force_sd_n`.
        noise: White noise on both.
    """

    def __init__(self, calibration: OtherSensor, noise: Noise) -> None:
        self._calibration, self._noise = calibration, noise
        self._preload = calibration.number("preload_n")
        self._sd = calibration.number("force_sd_n")

    def read(self, t_ns: Instants, force: Array) -> Block[Interaction]:
        """Samples of the cuff's force on the limb (N,), N, positive where it presses on the limb's front."""
        push = np.stack([force, -force], axis=-1)
        pair = np.maximum(self._preload + 0.5 * push, np.maximum(push, 0.0))
        told = np.maximum(pair + self._noise.normal(self._sd, pair.shape), 0.0)
        return Block(topic=self._calibration.topic, kind=Interaction, t_ns=t_ns, columns={"force": told})


class ActuatorModel:
    """Actuation module of one joint.

    Args:
        calibration: The module, with `torque_sd_nm` and `speed_sd_radps`.
        noise: White noise on torque and speed.
    """

    def __init__(self, calibration: OtherSensor, noise: Noise) -> None:
        self._calibration, self._noise = calibration, noise
        self._sd = np.array([calibration.number(n) for n in ("torque_sd_nm", "speed_sd_radps")])

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
