"""All sensors of a rig, read from the motion: one block a topic and chunk."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.bystanders import Crowd
from stridetwin.sim.noise import Noise
from stridetwin.sim.playback import Loads, Motion
from stridetwin.sim.sensors.ahrs import AhrsModel
from stridetwin.sim.sensors.imu import ImuModel
from stridetwin.sim.sensors.insole import InsoleModel
from stridetwin.sim.sensors.joint import ActuatorModel, EncoderModel, InteractionModel
from stridetwin.sim.sensors.sonar import SonarModel
from stridetwin.sim.terrain import Terrain
from stridetwin.streams.rig import OtherSensor, Rig
from stridetwin.streams.samples import Block

Instants = NDArray[np.int64]


def instants(rate_hz: float, after_ns: int, until_ns: int) -> Instants:
    """Whole sample times k / rate with after < t <= until, rounded to nanoseconds."""
    first = int(np.floor(after_ns * 1e-9 * rate_hz))
    last = int(np.ceil(until_ns * 1e-9 * rate_hz))
    t = np.round(np.arange(first, last + 1) * (1e9 / rate_hz)).astype(np.int64)
    return t[(t > after_ns) & (t <= until_ns)]


class SensorSuite:
    """Every sensor of the rig but the cameras.

    Args:
        rig: The sensors as they really are.
        terrain: Ground, for the sonars.
        crowd: Bystanders, for the sonars.
        seed: Seed of the walk.
        ideal: No noise.
    """

    def __init__(self, rig: Rig, terrain: Terrain, crowd: Crowd, seed: int, ideal: bool) -> None:
        def noise(topic: str) -> Noise:
            return Noise.of_topic(seed, topic, ideal)

        self._imus = [(c, ImuModel(c, noise(t))) for t, c in rig.imus.items()]
        self._others = [(c, _model(c, terrain, crowd, noise(t))) for t, c in rig.others.items()]

    @property
    def rates(self) -> set[float]:
        """Sample rates, Hz."""
        return {c.rate_hz for c, _ in self._imus} | {c.rate_hz for c, _ in self._others}

    def read(self, motion: Motion, loads: Loads, after_ns: int, until_ns: int) -> Iterator[Block[Any]]:
        """One block a topic, with the samples after `after_ns` and up to `until_ns`."""
        for imu, model in self._imus:
            rows = motion.rows(instants(imu.rate_hz, after_ns, until_ns))
            yield model.read(motion.carrier(imu.mount.body)[rows])
        for other, model in self._others:
            t_ns = instants(other.rate_hz, after_ns, until_ns)
            if len(t_ns):
                yield _read(other, model, motion, loads, t_ns)


def _model(sensor: OtherSensor, terrain: Terrain, crowd: Crowd, noise: Noise) -> Any:
    match sensor.kind:
        case "range":
            return SonarModel(sensor, terrain, crowd, noise)
        case "insole":
            return InsoleModel(sensor, noise)
        case "ahrs":
            return AhrsModel(sensor, noise)
        case "encoder":
            return EncoderModel(sensor, noise)
        case "interaction":
            return InteractionModel(sensor, noise)
        case "actuator":
            return ActuatorModel(sensor, noise)
    raise ValueError(f"no model for a sensor of kind {sensor.kind!r}")


def _read(sensor: OtherSensor, model: Any, motion: Motion, loads: Loads, t_ns: Instants) -> Block[Any]:
    rows, body = motion.rows(t_ns), sensor.mount.body
    place, _, side = sensor.topic.split("/")[-2].rpartition("_")  # foot_l, thigh_r, knee_l; the back has no side
    match sensor.kind:
        case "range":
            other = "foot_r" if side == "l" else "foot_l"
            return model.read(motion.tracks[body][rows], motion.tracks[other][rows])
        case "insole":
            at = np.searchsorted(loads.t_ns, t_ns)
            load = loads.feet[side]
            return model.read(motion.tracks[body][rows], load.force[at], load.torque[at])
        case "ahrs":
            return model.read(motion.tracks[body][rows])
        case "encoder":
            return model.read(t_ns, motion.angle[f"exo_{place}_flexion_{side}"][rows])
        case "interaction":
            return model.read(t_ns, -motion.cuff_force[f"{place}_{side}"][rows])  # a push forward is felt behind
        case _:  # nothing commands the modules: their motors give no torque
            return model.read(t_ns, 0.0, np.zeros(len(t_ns)), motion.speed[f"exo_{place}_flexion_{side}"][rows])
