"""Generalised coordinates of the wearer: the root's position and Euler angles, then every hinge by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from stridetwin.sim.rotation import (
    euler_accelerations_to_body,
    euler_rates_to_body,
    from_euler,
    matrix_from_quat,
    quat_from_matrix,
)  # fmt: skip
from stridetwin.streams.samples import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Coordinates:
    """Layout: `names[:6]` is the root (x, y, z, yaw, pitch, roll), the rest are hinges in the model's order.

    Attributes:
        names: All coordinates.
        qpos: (J,) address of each hinge in qpos.
        dof: (J,) address of each hinge in qvel.
        nq: Size of qpos.
        nv: Size of qvel.
    """

    ROOT: ClassVar[tuple[str, ...]] = ("root_x", "root_y", "root_z", "root_yaw", "root_pitch", "root_roll")
    names: tuple[str, ...]
    qpos: NDArray[np.int64]
    dof: NDArray[np.int64]
    nq: int
    nv: int

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Coordinates:
        """Layout of a model whose first joint is the free root and whose other joints are hinges."""
        hinges = [model.joint(i) for i in range(1, model.njnt)]
        return cls(
            names=(*cls.ROOT, *(j.name for j in hinges)),
            qpos=np.array([j.qposadr[0] for j in hinges]),
            dof=np.array([j.dofadr[0] for j in hinges]),
            nq=model.nq,
            nv=model.nv,
        )

    def from_mujoco(self, q: Array) -> Array:
        """Coordinates (N, names) of qpos (N, nq) that follow on each other; the yaw does not jump."""
        R = matrix_from_quat(q[:, 3:7])
        x = np.empty((len(q), len(self.names)))
        x[:, :3] = q[:, :3]
        x[:, 3] = np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
        x[:, 4] = -np.arcsin(np.clip(R[:, 2, 0], -1.0, 1.0))
        x[:, 5] = np.arctan2(R[:, 2, 1], R[:, 2, 2])
        x[:, 6:] = q[:, self.qpos]
        return x

    def at(self, splines: BSpline, t: NDArray[np.floating[Any]]) -> tuple[Array, Array, Array]:
        """`to_mujoco` of splines of the coordinates at (N,) s."""
        return self.to_mujoco(splines(t), splines(t, 1), splines(t, 2))

    def to_mujoco(self, x: Array, dx: Array, ddx: Array) -> tuple[Array, Array, Array]:
        """Qpos (N, nq), qvel (N, nv), qacc (N, nv) of coordinates, rates and accelerations (N, names)."""
        n = len(x)
        q, v, a = np.empty((n, self.nq)), np.empty((n, self.nv)), np.empty((n, self.nv))
        q[:, :3], v[:, :3], a[:, :3] = x[:, :3], dx[:, :3], ddx[:, :3]
        q[:, 3:7] = quat_from_matrix(from_euler(x[:, 3:6]))
        v[:, 3:6] = euler_rates_to_body(x[:, 3:6], dx[:, 3:6])
        a[:, 3:6] = euler_accelerations_to_body(x[:, 3:6], dx[:, 3:6], ddx[:, 3:6])
        q[:, self.qpos], v[:, self.dof], a[:, self.dof] = x[:, 6:], dx[:, 6:], ddx[:, 6:]
        return q, v, a
