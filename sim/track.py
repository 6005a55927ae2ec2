"""Motion of one frame through time, and of whatever is bolted to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from stridetwin.sim.rotation import cross, matrix_from_quat, quat_from_matrix, quat_product
from stridetwin.streams.samples import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """Poses and velocities of a frame at N instants.

    Attributes:
        t_ns: (N,) int64, strictly increasing.
        p_body_in_world: (N, 3) m.
        q_world_body: (N, 4) unit quaternions (w, x, y, z).
        v_body_in_world: (N, 3) m/s of the origin, world axes.
        w_body: (N, 3) rad/s, the frame's own axes.
    """

    t_ns: NDArray[np.int64]
    p_body_in_world: Array
    q_world_body: Array
    v_body_in_world: Array
    w_body: Array

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, rows: slice | NDArray[np.integer[Any]]) -> Track:
        """Track of some of the instants: a slice, or increasing numbers."""
        return Track(
            t_ns=self.t_ns[rows],
            p_body_in_world=self.p_body_in_world[rows],
            q_world_body=self.q_world_body[rows],
            v_body_in_world=self.v_body_in_world[rows],
            w_body=self.w_body[rows],
        )

    def then(self, after: Track) -> Track:
        """This track and, after its last instant, another one."""
        return Track(
            t_ns=np.concatenate([self.t_ns, after.t_ns]),
            p_body_in_world=np.concatenate([self.p_body_in_world, after.p_body_in_world]),
            q_world_body=np.concatenate([self.q_world_body, after.q_world_body]),
            v_body_in_world=np.concatenate([self.v_body_in_world, after.v_body_in_world]),
            w_body=np.concatenate([self.w_body, after.w_body]),
        )

    @property
    def rotation(self) -> Rotation:
        """Body to world, N of them."""
        return Rotation.from_quat(self.q_world_body, scalar_first=True)

    def mounted(self, T_body_sensor: ArrayLike) -> Track:
        """Track of a frame that is rigidly mounted on this one.

        Args:
            T_body_sensor: (4, 4) sensor frame to body frame.
        """
        T = np.asarray(T_body_sensor, dtype=float)
        R_body_sensor, lever = T[:3, :3], T[:3, 3]
        R_world_body = matrix_from_quat(self.q_world_body)
        return Track(
            t_ns=self.t_ns,
            p_body_in_world=self.p_body_in_world + R_world_body @ lever,
            q_world_body=quat_product(self.q_world_body, quat_from_matrix(R_body_sensor)),
            v_body_in_world=self.v_body_in_world + np.einsum("nij,nj->ni", R_world_body, cross(self.w_body, lever)),
            w_body=self.w_body @ R_body_sensor,
        )

    def poses(self) -> Array:
        """(N, 4, 4) transforms, frame to world."""
        T = np.tile(np.eye(4), (len(self), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = self.rotation.as_matrix(), self.p_body_in_world
        return T
