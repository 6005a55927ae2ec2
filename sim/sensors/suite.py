"""All sensors of a rig, read from the motion: one block per topic and chunk."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.noise import Noise
from stridetwin.sim.playback import Loads, Motion, Player
from stridetwin.sim.sensors.exo_sensors import ActuatorModel, AhrsModel, EncoderModel
from stridetwin.sim.sensors.force_cells import InsoleModel, InteractionModel
from stridetwin.sim.sensors.imu import ImuModel
from stridetwin.sim.sensors.model import Instants, Stamps, instants, step_ends
from stridetwin.sim.sensors.mount_slip import MountSlips
from stridetwin.sim.sensors.sonar import SonarModel
from stridetwin.sim.sensors.standard_rig import MountedSensor, SensorRig
from stridetwin.sim.walk import Walk
from stridetwin.sim.world.bystanders import Crowd
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, OtherSensor
from stridetwin.streams.samples import Array, Block, Sample


class SensorSuite:
    """Every sensor of the rig except the cameras.

    Args:
        sensor_rig: The sensors with their true calibration.
        terrain: Ground, for the sonars.
        crowd: Bystanders, for the sonars.
        seed: Seed of the walk.
        mount_slips: Slips of the sensor mounts.
        gravity_mps2: Gravity of the walk, for inertial sensors.
    """

    def __init__(
        self,
        sensor_rig: SensorRig,
        terrain: Terrain,
        crowd: Crowd,
        seed: int,
        mount_slips: MountSlips | None = None,
        gravity_mps2: float = NOMINAL_GRAVITY_MPS2,
    ) -> None:
        """Makes the model and the clock of every sensor, each with its own random numbers of the walk."""
        self._mount_slips = mount_slips or MountSlips()
        # (sensor, its model, the stamps of its clock)
        self._models: list[tuple[MountedSensor, Any, Stamps]] = []
        for topic, sensor in sensor_rig.sensors.items():
            if not isinstance(sensor.calibration, CameraCalibration):
                stamps = Stamps(sensor.clock, sensor.calibration.rate_hz, Noise.of_topic(seed, f"{topic}#clock"))
                model = _make_model(sensor, terrain, crowd, Noise.of_topic(seed, topic), gravity_mps2)
                self._models.append((sensor, model, stamps))

    @property
    def rates(self) -> set[float]:
        """Sample rates at which the motion of the whole body is needed, Hz."""
        return {s.calibration.rate_hz for s, _, _ in self._models if not isinstance(s.calibration, ImuCalibration)}

    @property
    def latency_s(self) -> float:
        """Largest delay from an instant to the motion that an inertial sensor's filter needs for it, s."""
        return max((m.delay_s for s, m, _ in self._models if isinstance(s.calibration, ImuCalibration)), default=0.0)

    def read(
        self, player: Player[Walk], motion: Motion, loads: Loads, after_ns: int, until_ns: int
    ) -> Iterator[Block[Sample]]:
        """One block per topic, with the samples after `after_ns` and up to `until_ns`.

        Args:
            player: Player of the walk, for inertial sensors.
            motion: Motion at the instants of all `rates`.
            loads: Loads at evenly spaced instants up to `until_ns`.
            after_ns: True time.
            until_ns: True time.
        """
        for sensor, model, stamps in self._models:
            t_ns = instants(sensor.calibration.rate_hz, after_ns, until_ns)
            if not len(t_ns):
                continue  # a slow sensor has no sample in this chunk
            if isinstance(sensor.calibration, ImuCalibration):
                # an inertial sensor reads the motion more often, and later by the delay of its filter
                ends = step_ends(sensor.calibration.rate_hz, model.steps, t_ns) + round(model.delay_s * 1e9)
                carrier = player.track(sensor.calibration.mount.body, ends)
                block = model.read(self._mount_slips.mount_track(sensor.calibration.topic, carrier), t_ns)
            elif isinstance(sensor.calibration, OtherSensor):
                body = sensor.calibration.mount.body  # an insole moves with the foot, not with the shoe's upper
                carrier = motion.tracks[body] if sensor.calibration.kind == "insole" else motion.carrier(body)
                carrier = self._mount_slips.mount_track(sensor.calibration.topic, carrier[motion.rows(t_ns)])
                block = _read_block(sensor.calibration, model, carrier, motion, loads, t_ns)
            yield stamps.stamp_block(block)


_MODELS: dict[str, Any] = {
    "range": SonarModel,
    "insole": InsoleModel,
    "ahrs": AhrsModel,
    "encoder": EncoderModel,
    "interaction": InteractionModel,
    "actuator": ActuatorModel,
}
"""Model of each kind of `rig.OtherSensor`."""


def _make_model(sensor: MountedSensor, terrain: Terrain, crowd: Crowd, noise: Noise, gravity_mps2: float) -> Any:
    """Model of a sensor, by its kind; gravity (m/s²) concerns inertial sensors alone."""
    calibration: Any = sensor.calibration  # of an inertial or another sensor, which the part fits
    part: Any = sensor.part
    if isinstance(calibration, ImuCalibration):
        return ImuModel(calibration, part, noise, gravity_mps2)
    surroundings = (terrain, crowd) if calibration.kind == "range" else ()
    return _MODELS[calibration.kind](calibration, part, *surroundings, noise)


def _read_block(
    sensor: OtherSensor, model: Any, carrier: Track, motion: Motion, loads: Loads, t_ns: Instants
) -> Block[Sample]:
    """Samples of a sensor that is neither IMU nor camera, at (N,) instants.

    Args:
        sensor: Its calibration.
        model: Its model.
        carrier: Track of the frame that holds its mount, at these instants.
        motion: Motion of the whole body, for angles, speeds and cuff forces.
        loads: Ground reaction and motor torques, interpolated to these instants.
        t_ns: (N,) instants.
    """
    rows = motion.rows(t_ns)
    place, _, side = sensor.topic.split("/")[-2].rpartition("_")  # foot_l, thigh_r, knee_l; the back has no side
    match sensor.kind:
        case "range":
            return model.read(carrier, motion.tracks["foot_r" if side == "l" else "foot_l"][rows])
        case "insole":
            load = loads.feet[side]
            force, torque = (_interpolate(loads.t_ns, values, t_ns) for values in (load.force, load.torque))
            return model.read(carrier, force, torque)
        case "ahrs":
            return model.read(carrier)
        case "encoder":
            return model.read(t_ns, motion.angle[f"exo_{place}_flexion_{side}"][rows])
        case "interaction":
            # the sensor counts a push on the front of the limb positive, the motion a push forward
            return model.read(t_ns, -motion.cuff_force[f"{place}_{side}"][rows])
        case _:  # an actuator: the command is followed exactly
            hinge = f"exo_{place}_flexion_{side}"
            torque = np.interp(t_ns, loads.t_ns, loads.motors.get(hinge, np.zeros(len(loads.t_ns))))
            return model.read(t_ns, torque, torque, motion.speed[hinge][rows])


def _interpolate(at_ns: Instants, values: Array, t_ns: Instants) -> Array:
    """(N, 3) linear interpolation of vectors.

    Args:
        at_ns: (K,) instants of the values.
        values: (K, 3).
        t_ns: (N,) instants of the result.
    """
    return np.column_stack([np.interp(t_ns, at_ns, column) for column in values.T])
