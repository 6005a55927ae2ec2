"""Trajectories: the output of estimators and the input of scoring."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """Poses of one frame over time.

    Attributes:
        t_ns: (N,) int64, strictly increasing.
        p_frame_in_world: (N, 3) m.
        q_world_frame: (N, 4) unit quaternions (w, x, y, z), frame to world.
        covariance: (N, 6, 6) of position (m) and of rotation about the world axes (rad), or None.
    """

    t_ns: NDArray[np.int64]
    p_frame_in_world: Array
    q_world_frame: Array
    covariance: Array | None = None

    def __post_init__(self) -> None:
        n = len(self.t_ns)
        shapes = {"p_frame_in_world": (n, 3), "q_world_frame": (n, 4), "covariance": (n, 6, 6)}
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is not None and value.shape != shape:
                raise StrideTwinError(f"Trajectory.{name}: invalid shape {value.shape}: expected {shape}")
        if np.any(np.diff(self.t_ns) <= 0):
            raise StrideTwinError("Trajectory.t_ns: stamps must increase strictly")

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, which: slice | NDArray[np.bool_]) -> Trajectory:
        """Some of the poses: a slice, or those of a (N,) mask."""
        return Trajectory(
            t_ns=self.t_ns[which],
            p_frame_in_world=self.p_frame_in_world[which],
            q_world_frame=self.q_world_frame[which],
            covariance=None if self.covariance is None else self.covariance[which],
        )
