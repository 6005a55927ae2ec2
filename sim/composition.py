"""The MuJoCo model of a walk, composed: terrain, wearer, sensors, soles and bystanders."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco

from stridetwin.sim.config import TwinConfig
from stridetwin.sim.dynamics.soles import add_soles
from stridetwin.sim.sensors.standard_rig import SensorRig, sensor_rig
from stridetwin.sim.wearer.body import add_wearer
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.sim.wearer.sensor_bodies import add_rig
from stridetwin.sim.world.bystanders import add_bystanders
from stridetwin.sim.world.rails import add_rails
from stridetwin.sim.world.terrain import Terrain


@dataclass(frozen=True, kw_only=True, eq=False)
class Composition:
    """The model of a walk before it is compiled, and what it was made from.

    Attributes:
        spec: The model; contacts are off outside the forward simulation.
        terrain: Ground.
        size: Dimensions of the wearer.
        sensor_rig: The sensors with their true calibration.
    """

    spec: mujoco.MjSpec
    terrain: Terrain
    size: Wearer
    sensor_rig: SensorRig


def compose(config: TwinConfig, seed: int = 0) -> Composition:
    """Composes the model of a walk from terrain, wearer, sensors, soles and bystanders; no motion is planned.

    Args:
        config: Scenario.
        seed: Of the walk, which draws its floor.

    Raises:
        ConfigError: A value that cannot be built.
    """
    sensors = sensor_rig(config)
    terrain = Terrain.from_route(config.route, seed)
    spec = mujoco.MjSpec()
    terrain.add_to(spec)
    add_rails(spec, config.gait, terrain.layout)
    size = add_wearer(spec, config.person, config.exo)
    add_rig(spec, sensors.rig)
    add_soles(spec, size)
    add_bystanders(spec, config.route.bystanders)
    spec.option.gravity = [0.0, 0.0, -config.gravity_mps2]
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONTACT  # the forward simulation switches contacts on
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # the sparse one of 4.0.0 is wrong for Newton
    return Composition(spec=spec, terrain=terrain, size=size, sensor_rig=sensors)
