"""Jacobians of points from MuJoCo's spatial motion axes, compiled: no call into the engine for every point."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numba
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.samples import Array


class State(NamedTuple):
    """The engine's state, as views of its memory.

    Attributes:
        cdof: (nv, 6) motion (angular, linear) of each degree of freedom about `centre`.
        cdof_dot: (nv, 6) its rate.
        cvel: (nbody, 6) angular and linear velocity of each body about `centre`.
        centre: (3,) m, the walker's centre of mass.
        qvel: (nv,).
        xpos: (nbody, 3) m, origins of the bodies.
        xmat: (nbody, 9) their axes.
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
        return cls(data.cdof, data.cdof_dot, data.cvel, data.subtree_com[1], data.qvel, data.xpos, data.xmat)


def chain_of(model: mujoco.MjModel, body: int) -> NDArray[np.bool_]:
    """(nv,) degrees of freedom that move a body."""
    chain = np.zeros(model.nv, dtype=bool)
    while body > 0:
        first, count = model.body_dofadr[body], model.body_dofnum[body]
        if count:
            chain[first : first + count] = True
        body = model.body_parentid[body]
    return chain


@numba.njit(cache=True)
def cross(a: Array, b: Array, out: Array) -> None:
    """Cross product of two (3,) vectors into `out`."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True)
def rotate(R: Array, a: Array, out: Array) -> None:
    """R (3, 3) times a (3,) into `out`; for so few numbers faster than a BLAS call."""
    for k in range(3):
        out[k] = R[k, 0] * a[0] + R[k, 1] * a[1] + R[k, 2] * a[2]


@numba.njit(cache=True)
def jacobian(cdof: Array, chain: NDArray[np.bool_], centre: Array, point: Array, linear: Array, angular: Array) -> None:
    """Fills the Jacobian (3, nv) of a point (3,) of a body and that of its rotation, world axes.

    `chain` are the degrees of freedom that move the body; `cdof` and `centre` as in `State`.
    """
    x, y, z = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    for j in range(len(cdof)):
        if chain[j]:
            for k in range(3):
                angular[k, j] = cdof[j, k]
            linear[0, j] = cdof[j, 3] + cdof[j, 1] * z - cdof[j, 2] * y
            linear[1, j] = cdof[j, 4] + cdof[j, 2] * x - cdof[j, 0] * z
            linear[2, j] = cdof[j, 5] + cdof[j, 0] * y - cdof[j, 1] * x
        else:
            for k in range(3):
                angular[k, j] = 0.0
                linear[k, j] = 0.0


@numba.njit(cache=True)
def bias_acceleration(
    cdof_dot: Array, chain: NDArray[np.bool_], centre: Array, qvel: Array, v_point: Array, w: Array, point: Array,
    linear: Array, angular: Array,
) -> None:  # fmt: skip
    """Fills the acceleration at zero joint acceleration (J' q') of a point (3,) of a body, and of its rotation.

    The point's velocity `v_point` and the body's angular velocity `w` are in world axes; the rest as for `jacobian`.
    """
    r = point - centre
    for k in range(3):
        angular[k] = 0.0
        linear[k] = 0.0
    for j in range(len(qvel)):
        if chain[j]:
            for k in range(3):
                angular[k] += cdof_dot[j, k] * qvel[j]
                linear[k] += cdof_dot[j, 3 + k] * qvel[j]
    product = np.empty(3)
    cross(angular, r, product)
    linear += product
    cross(w, v_point, product)
    linear += product
