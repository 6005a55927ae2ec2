"""A walk as geometry: poses of bodies and limbs at evenly spaced instants between the first step and the last."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stridetwin.scenarios.record import make_twin
from stridetwin.scenarios.scenario_file import Scenario
from stridetwin.sim.config import SIDES
from stridetwin.sim.wearer.limbs import Limbs
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.samples import Array

RATE_HZ = 50.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Moving:
    """A body at N instants.

    Attributes:
        T_world_body: (N, 4, 4); for a foot, that of the shoe's upper with the sensors.
        v: (N, 3) m/s of its origin, world axes.
        w: (N, 3) rad/s, world axes.
    """

    T_world_body: Array
    v: Array
    w: Array

    def seats(self, T_body_sensor: Array) -> Array:
        """(N, 4, 4) poses of a sensor mounted on it."""
        return np.asarray(self.T_world_body @ T_body_sensor)

    def velocity(self, p_in_world: Array) -> Array:
        """(N, 3) m/s, velocities of (N, 3) points fixed to it."""
        return self.v + np.cross(self.w, p_in_world - self.T_world_body[:, :3, 3])


@dataclass(frozen=True, kw_only=True, eq=False)
class PosedWalk:
    """A walk.

    Attributes:
        bodies: Bodies with sensors, by name.
        limbs: Limbs that may occlude.
        terrain: The terrain.
        ground: Points on the ground ahead of the walker, (N, A, 3) m in the world.
    """

    bodies: dict[str, Moving]
    limbs: Limbs
    terrain: Terrain
    ground: Array

    def __len__(self) -> int:
        return len(self.ground)


AHEAD_M, ASIDE_M = np.arange(0.5, 2.51, 0.25), (-0.25, 0.0, 0.25)
"""The ground that determines the next steps: m ahead of the pelvis along the route, and to its left."""


def posed_walk(scenario: Scenario, seed: int) -> PosedWalk:
    """The walk of a scenario, independent of its sensors.

    Raises:
        StrideTwinError: The walk is infeasible, or the simulator is not installed.
    """
    bare = replace(scenario, config=replace(scenario.config, sensors=(), fittings={}, faults=()))
    twin = make_twin(bare, seed)
    steps = [step for side in SIDES for step in twin.walk.steps[side]]
    offs = [step.t_off for step in steps if np.isfinite(step.t_off)]
    ends = [step.t_touch for step in steps if np.isfinite(step.t_touch)]
    t = np.arange(min(offs), min(max(ends), twin.duration_s), 1.0 / RATE_HZ)
    q, v = twin.walk.moving(t)
    motion = twin.player().motion(np.round(t * 1e9).astype(np.int64))
    bodies = {}
    for name in motion.tracks:
        track = motion.carrier(name)
        T = track.poses()
        w = np.einsum("nij,nj->ni", T[:, :3, :3], track.w_body)
        bodies[name] = Moving(T_world_body=T, v=track.v_body_in_world, w=w)
    layout = twin.terrain.layout
    s = layout.way.project(bodies["pelvis"].T_world_body[:, :2, 3])
    ahead = np.stack([layout.way.point((s[:, None] + AHEAD_M).ravel(), left) for left in ASIDE_M], axis=1)
    ahead = ahead.reshape(len(t), -1, 2)
    ground = np.concatenate([ahead, twin.terrain.height(ahead)[..., None]], axis=-1)
    return PosedWalk(bodies=bodies, limbs=Limbs.of(twin.model, q, v), terrain=twin.terrain, ground=ground)
