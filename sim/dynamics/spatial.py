"""Jacobians of points from MuJoCo's spatial motion axes, compiled: no call into the engine for every point."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numba
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.algebra.tuples import Mat3, Vec3, cross, minus, plus, times, vec3
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array


class State(NamedTuple):
    """The engine's state, as views of its memory; all vectors are in world axes.

    Attributes:
        cdof: (nv, 6) motion (angular, linear) of each degree of freedom about `centre`.
        cdof_dot: (nv, 6) its rate.
        cvel: (nbody, 6) angular and linear velocity of each body about `centre`.
        centre: (3,) m, the walker's centre of mass.
        qvel: (nv,) generalised velocities.
        xpos: (nbody, 3) m, origins of the bodies.
        xmat: (nbody, 9) their rotations, body to world, row by row.
    """

    cdof: Array
    cdof_dot: Array
    cvel: Array
    centre: Array
    qvel: Array
    xpos: Array
    xmat: Array

    @classmethod
    def of(cls, data: mujoco.MjData) -> State:
        """Views that follow the state as it changes."""
        # body 1 is the root of the walker, whose subtree is the whole walker
        return cls(data.cdof, data.cdof_dot, data.cvel, data.subtree_com[1], data.qvel, data.xpos, data.xmat)


def chain_of(model: mujoco.MjModel, body: int) -> NDArray[np.bool_]:
    """(nv,) whether each degree of freedom moves a body: those of its own joints and of all bodies that carry it."""
    chain = np.zeros(model.nv, dtype=bool)
    while body > 0:  # 0 is the world
        first, count = model.body_dofadr[body], model.body_dofnum[body]
        if count:  # a body without joints has no address
            chain[first : first + count] = True
        body = model.body_parentid[body]
    return chain


@numba.njit(**INNER_KERNEL)
def axes_of(state: State, body: int) -> Mat3:
    """(3, 3) rotation of a body, body to world, as a tuple of its three rows."""
    R = state.xmat[body]
    return (R[0], R[1], R[2]), (R[3], R[4], R[5]), (R[6], R[7], R[8])


@numba.njit(**INNER_KERNEL)
def velocity(state: State, body: int, point: Vec3) -> tuple[Vec3, Vec3]:
    """Velocity of a point of a body, m/s, and angular velocity of the body, rad/s, both in world axes.

    The point is given in the world, m.
    """
    c = state.cvel[body]  # angular (3), then linear velocity (3) at the centre
    w, v_centre = (c[0], c[1], c[2]), (c[3], c[4], c[5])
    return plus(v_centre, cross(w, minus(point, vec3(state.centre)))), w


@numba.njit(**INNER_KERNEL)
def jacobian(cdof: Array, chain: NDArray[np.bool_], arm: Vec3, rows: Array, linear: int, angular: int) -> None:
    """Writes the Jacobian (3, nv) of a point of a body and that of the body's rotation into rows of a matrix.

    Column j is the velocity of the point, linear + angular × arm, or the angular velocity of the body, per unit of
    qvel[j]. It is 0 for degrees of freedom that do not move the body. World axes.

    Args:
        cdof: (nv, 6) motion of each degree of freedom about the centre of `State`: angular (3), linear (3).
        chain: (nv,) the degrees of freedom that move the body.
        arm: The point minus the centre of `State`, m.
        rows: (m, nv) output.
        linear: First of the three rows for the point; -1 for none.
        angular: First of the three rows for the rotation; -1 for none.
    """
    x, y, z = arm
    for j in range(len(cdof)):
        if linear >= 0:
            rows[linear, j] = cdof[j, 3] + cdof[j, 1] * z - cdof[j, 2] * y if chain[j] else 0.0
            rows[linear + 1, j] = cdof[j, 4] + cdof[j, 2] * x - cdof[j, 0] * z if chain[j] else 0.0
            rows[linear + 2, j] = cdof[j, 5] + cdof[j, 0] * y - cdof[j, 1] * x if chain[j] else 0.0
        if angular >= 0:
            for k in range(3):
                rows[angular + k, j] = cdof[j, k] if chain[j] else 0.0


@numba.njit(**INNER_KERNEL)
def bias_acceleration(
    cdof_dot: Array, chain: NDArray[np.bool_], qvel: Array, v_point: Vec3, w: Vec3, arm: Vec3
) -> tuple[Vec3, Vec3]:
    """Accelerations J' q' of a point of a body, m/s², and of the body's rotation, rad/s², at zero joint acceleration.

    Both are in world axes.

    Args:
        cdof_dot: (nv, 6) rate of the motion axes (`State`).
        chain: (nv,) degrees of freedom that move the body.
        qvel: (nv,) joint velocities.
        v_point: Velocity of the point, world axes, m/s.
        w: Angular velocity of the body, world axes, rad/s.
        arm: The point minus the centre of `State`, m.
    """
    angular, linear = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for j in range(len(qvel)):
        if chain[j]:
            c = cdof_dot[j]  # angular (3), then linear rate (3) about the centre
            angular = plus(angular, times(qvel[j], (c[0], c[1], c[2])))
            linear = plus(linear, times(qvel[j], (c[3], c[4], c[5])))
    return plus(plus(linear, cross(angular, arm)), cross(w, v_point)), angular
