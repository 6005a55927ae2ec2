"""Forces of the compliant couplings between exoskeleton and wearer, compiled."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numba
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.dynamics.spatial import State, chain_of, cross, rotate
from stridetwin.sim.wearer.exo_couplings import Coupling
from stridetwin.streams.samples import Array


class CouplingSet(NamedTuple):
    """Couplings of a model as arrays.

    Attributes:
        bodies: (C, 2) ids of the exoskeleton's and the wearer's body.
        points: (C, 2, 3) m, in these bodies' frames.
        law: (C, 4, 3, 3) stiffness, damping, rotational stiffness and damping, exoskeleton body's axes.
        chain: (C, 2, nv) degrees of freedom that move each body.
    """

    bodies: NDArray[np.int64]
    points: Array
    law: Array
    chain: NDArray[np.bool_]

    @classmethod
    def of(cls, model: mujoco.MjModel, couplings: Sequence[Coupling]) -> CouplingSet:
        """Compiles couplings for a model."""
        bodies = np.array([[model.body(c.exo_body).id, model.body(c.body).id] for c in couplings], dtype=np.int64)
        points = [[c.p_in_exo, c.p_in_body] for c in couplings]
        law = [[c.stiffness, c.damping, c.rotation_stiffness, c.rotation_damping] for c in couplings]
        chain = [[chain_of(model, b) for b in pair] for pair in bodies]
        return cls(  # reshaped for none, without exoskeleton
            bodies.reshape(-1, 2), np.reshape(points, (-1, 2, 3)), np.reshape(law, (-1, 4, 3, 3)),
            np.array(chain, dtype=bool).reshape(-1, 2, model.nv),
        )  # fmt: skip


@numba.njit(cache=True)
def coupling_forces(couplings: CouplingSet, state: State) -> Array:
    """Generalised force (nv,) of all couplings, as in `exo_couplings.wrench`."""
    bodies, points, law, chain = couplings
    cdof, cvel, centre, xpos, xmat = state.cdof, state.cvel, state.centre, state.xpos, state.xmat
    nv = len(cdof)
    applied = np.zeros(nv)
    point, arm, w, dp = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    displacement, rate, rotation, rotation_rate = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    force, torque, a, b = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for c in range(len(bodies)):
        exo, own = bodies[c]
        R_exo, R_own = xmat[exo].reshape(3, 3), xmat[own].reshape(3, 3)
        rotate(R_own, points[c, 1], point)
        for k in range(3):
            point[k] += xpos[own, k]
            arm[k] = point[k] - centre[k]
            a[k] = point[k] - xpos[exo, k]
            w[k] = cvel[own, k] - cvel[exo, k]
        rotate(R_exo.T, a, displacement)
        cross(w, arm, dp)
        for k in range(3):
            displacement[k] -= points[c, 0, k]
            dp[k] += cvel[own, 3 + k] - cvel[exo, 3 + k]
        rotate(R_exo.T, dp, rate)
        R = R_exo.T @ R_own
        rotation[0], rotation[1], rotation[2] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
        rotation *= 0.5
        change = 0.5 * ((R[0, 0] + R[1, 1] + R[2, 2]) * np.eye(3) - R)
        rotate(R_exo.T, w, a)
        rotate(change, a, rotation_rate)
        rotate(law[c, 0], displacement, a)
        rotate(law[c, 1], rate, b)
        rotate(R_exo, a + b, force)  # on the exoskeleton
        rotate(law[c, 2], rotation, a)
        rotate(law[c, 3], rotation_rate, b)
        rotate(change.T, a + b, rotation_rate)
        rotate(R_exo, rotation_rate, torque)
        cross(arm, force, a)
        torque += a
        for j in range(nv):
            if chain[c, 0, j] != chain[c, 1, j]:
                power = 0.0
                for k in range(3):
                    power += cdof[j, k] * torque[k] + cdof[j, 3 + k] * force[k]
                applied[j] += power if chain[c, 0, j] else -power
    return applied
