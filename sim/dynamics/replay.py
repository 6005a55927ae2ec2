"""Plays back what was simulated, with the loads that the contacts carried."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.dynamics.simulated_walk import SimulatedWalk
from stridetwin.sim.playback import Loads, Motion, Player
from stridetwin.sim.shock import UpperMotion


class Replay(Player):
    """Plays a simulated walk.

    Args:
        model: Compiled model of the wearer on the terrain.
        walk: What the simulation did.
        uppers: What the shoes' uppers do, by name of the foot.
    """

    def __init__(
        self, model: mujoco.MjModel, walk: SimulatedWalk, uppers: Mapping[str, UpperMotion] | None = None
    ) -> None:
        super().__init__(model, walk, uppers)
        self._simulated = walk

    def loads(self, t_ns: NDArray[np.int64], motion: Motion) -> Loads:
        """Contact loads and joint torques at (N,) instants; the residual is what the root was given, nothing else."""
        t = t_ns * 1e-9
        torque, push, turn = self._simulated.efforts(t)
        return Loads(
            t_ns=t_ns, feet=self._simulated.feet(t), joint_torque=torque, residual_force=push, residual_torque=turn
        )
