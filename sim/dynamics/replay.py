"""Playback of a simulated walk, with the recorded contact loads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.dynamics.simulated_walk import SimulatedWalk
from stridetwin.sim.playback import Loads, Motion, Player


class Replay(Player[SimulatedWalk]):
    """Plays a simulated walk."""

    def loads(self, t_ns: NDArray[np.int64], motion: Motion) -> Loads:
        """Contact loads and joint torques at (N,) instants; the residual is the assistance at the root alone."""
        t = t_ns * 1e-9
        torque, push, turn = self._walk.efforts(t)
        names = self._walk.coordinates.names[6:]
        motors = {name: torque[:, k] for k, name in enumerate(names) if name.startswith("exo_")}
        return Loads(
            t_ns=t_ns, feet=self._walk.feet(t), joint_torque=torque, residual_force=push, residual_torque=turn,
            motors=motors,
        )  # fmt: skip
