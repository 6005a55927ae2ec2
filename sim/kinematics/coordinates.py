"""Generalised coordinates of the wearer: the root's position and Euler angles, then every hinge by name."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from stridetwin.streams.algebra.arrays import euler_accelerations_to_body, from_quaternion
from stridetwin.streams.algebra.tuples import multiply
from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.samples import Array

_entry_kernel = entry_kernel(__file__)


@dataclass(frozen=True, kw_only=True, eq=False)
class Coordinates:
    """Layout of the generalised coordinates of a wearer.

    The first six, `names[:6]`, are the root's x, y, z in m and its yaw, pitch, roll in rad; then follow the hinges in
    the model's order, in rad.

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
        """Coordinates (N, names) of consecutive qpos (N, nq) in MuJoCo's layout; the yaw is unwrapped over the rows."""
        R = from_quaternion(q[:, 3:7])  # (N, 3, 3), root to world: R_z(yaw) R_y(pitch) R_x(roll)
        x = np.empty((len(q), len(self.names)))
        x[:, :3] = q[:, :3]
        # yaw, pitch and roll of the root; rounding may carry the sine of the pitch just beyond ±1
        x[:, 3] = np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
        x[:, 4] = -np.arcsin(np.clip(R[:, 2, 0], -1.0, 1.0))
        x[:, 5] = np.arctan2(R[:, 2, 1], R[:, 2, 2])
        x[:, 6:] = q[:, self.qpos]
        return x

    def evaluate(self, splines: BSpline, t: NDArray[np.floating]) -> tuple[Array, Array, Array]:
        """Qpos (N, nq), qvel (N, nv) and qacc (N, nv) at (N,) s, from splines of the coordinates."""
        return self.to_mujoco(splines(t), splines(t, 1), splines(t, 2))

    def position_velocity(self, splines: BSpline, t: NDArray[np.floating]) -> tuple[Array, Array]:
        """Qpos (N, nq) and qvel (N, nv) at (N,) s, from splines of the coordinates; faster than `evaluate`."""
        x, dx = splines(t), splines(t, 1)
        q, v = np.empty((len(x), self.nq)), np.empty((len(x), self.nv))
        _fill_position_velocity(x, dx, self.qpos, self.dof, q, v)
        return q, v

    def to_mujoco(self, x: Array, dx: Array, ddx: Array) -> tuple[Array, Array, Array]:
        """Qpos (N, nq), qvel (N, nv) and qacc (N, nv) in MuJoCo's layout.

        Args:
            x: (N, names) coordinates.
            dx: (N, names) their rates.
            ddx: (N, names) their accelerations.
        """
        n = len(x)
        # the root's acceleration in MuJoCo: linear in world axes (3), then angular in its own axes (3)
        q, v, a = np.empty((n, self.nq)), np.empty((n, self.nv)), np.empty((n, self.nv))
        _fill_position_velocity(x, dx, self.qpos, self.dof, q, v)
        a[:, :3], a[:, self.dof] = ddx[:, :3], ddx[:, 6:]
        a[:, 3:6] = euler_accelerations_to_body(x[:, 3:6], dx[:, 3:6], ddx[:, 3:6])
        return q, v, a


@_entry_kernel
def _fill_position_velocity(
    x: Array, dx: Array, qpos: NDArray[np.int64], dof: NDArray[np.int64], q: Array, v: Array
) -> None:
    """Fills (N, nq) qpos and (N, nv) qvel from (N, names) coordinates and their rates.

    The root's quaternion is R_z(yaw) R_y(pitch) R_x(roll), with w >= 0; its angular velocity is in its own axes.

    Args:
        x: (N, names) coordinates: x, y, z, yaw, pitch, roll of the root, then the hinges.
        dx: (N, names) their rates.
        qpos: (J,) address of each hinge in a row of `q`.
        dof: (J,) address of each hinge in a row of `v`.
        q: Output.
        v: Output.
    """
    for i in range(len(x)):
        # attitude of the root: product of the quaternions (w, x, y, z) about z, y and x, with w >= 0
        half_yaw, half_pitch, half_roll = 0.5 * x[i, 3], 0.5 * x[i, 4], 0.5 * x[i, 5]
        attitude = multiply(
            (math.cos(half_yaw), 0.0, 0.0, math.sin(half_yaw)), (math.cos(half_pitch), 0.0, math.sin(half_pitch), 0.0)
        )
        attitude = multiply(attitude, (math.cos(half_roll), math.sin(half_roll), 0.0, 0.0))
        qw, qx, qy, qz = attitude
        sign = 1.0 if qw >= 0.0 else -1.0
        q[i, 3], q[i, 4], q[i, 5], q[i, 6] = sign * qw, sign * qx, sign * qy, sign * qz
        # angular velocity in the root's own axes, from the rates of yaw, pitch and roll
        sin_pitch, cos_pitch = math.sin(x[i, 4]), math.cos(x[i, 4])
        sin_roll, cos_roll = math.sin(x[i, 5]), math.cos(x[i, 5])
        d_yaw, d_pitch, d_roll = dx[i, 3], dx[i, 4], dx[i, 5]
        v[i, 3] = d_roll - sin_pitch * d_yaw
        v[i, 4] = cos_roll * d_pitch + cos_pitch * sin_roll * d_yaw
        v[i, 5] = -sin_roll * d_pitch + cos_pitch * cos_roll * d_yaw
        # position and linear velocity of the root are copied, and so are the hinges, to their addresses
        for k in range(3):
            q[i, k], v[i, k] = x[i, k], dx[i, k]
        for k in range(len(qpos)):
            q[i, qpos[k]], v[i, dof[k]] = x[i, 6 + k], dx[i, 6 + k]
