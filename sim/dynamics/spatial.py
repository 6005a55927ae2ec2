"""Jacobians of points from MuJoCo's spatial motion axes, compiled.

`cdof` and `cdof_dot` hold each degree of freedom's motion (angular, linear) about the whole body's centre of mass,
which saves a call into the engine for every point.
"""

from __future__ import annotations

import mujoco
import numba
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.samples import Array


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
    """Jacobian of a body's point and of its rotation, world axes.

    Args:
        cdof: (nv, 6).
        chain: (nv,) degrees of freedom that move the body.
        centre: (3,) m, the point that `cdof` refers to.
        point: (3,) m, world.
        linear: (3, nv), filled.
        angular: (3, nv), filled.
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
    """Acceleration of a body's point at zero joint acceleration (J' q'), world axes.

    Args:
        cdof_dot: (nv, 6).
        chain: (nv,) degrees of freedom that move the body.
        centre: (3,) m, the point that `cdof_dot` refers to.
        qvel: (nv,).
        v_point: (3,) m/s, velocity of the point.
        w: (3,) rad/s, angular velocity of the body.
        point: (3,) m.
        linear: (3,), filled.
        angular: (3,), filled.
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
    turn = np.empty(3)
    cross(angular, r, turn)
    linear += turn
    cross(w, v_point, turn)
    linear += turn
