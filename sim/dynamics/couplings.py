"""Forces of the compliant couplings between exoskeleton and wearer, compiled."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.dynamics.spatial import State, axes_of, chain_of
from stridetwin.sim.wearer.exo_couplings import Coupling
from stridetwin.streams.algebra.tuples import cross, mat3, matmul, matvec, minus, plus, times, transposed, vec3
from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.samples import Array

_entry_kernel = entry_kernel(Path(__file__).parent, llvm_level=1)


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
        """Couplings as arrays, with the ids of their bodies in a model; empty arrays without couplings."""
        bodies = np.array([[model.body(c.exo_body).id, model.body(c.body).id] for c in couplings], dtype=np.int64)
        chain = np.array([[chain_of(model, b) for b in pair] for pair in bodies], dtype=bool)
        # without couplings the arrays would have one axis only: `reshape` gives them the shapes of the class
        return cls(
            bodies.reshape(-1, 2),
            np.reshape([[c.p_in_exo, c.p_in_body] for c in couplings], (-1, 2, 3)),
            np.reshape([c.law for c in couplings], (-1, 4, 3, 3)),
            chain.reshape(-1, 2, model.nv),
        )


@_entry_kernel
def coupling_forces(couplings: CouplingSet, state: State) -> Array:
    """Generalised force (nv,) of all couplings between exoskeleton and wearer.

    The law is that of `exo_couplings.wrench`. In the axes of the exoskeleton's body, the force is K d + D d' and the
    moment is Cᵀ (K_r r + D_r r'). Here d is the displacement of the wearer's point, R the rotation of the wearer's body
    as seen from the exoskeleton's, r its vector part, and C = ½ (tr(R) 1 − R). K, D, K_r and D_r are the four matrices
    of the law. Force and moment act on the exoskeleton at the wearer's point, and with the opposite sign on the wearer.
    Degrees of freedom that move both bodies get no force.
    """
    # columns of `bodies`, `points` and `chain`: the exoskeleton's body, then the wearer's; `law` is K, D, K_r, D_r
    bodies, points, law, chain = couplings
    cdof, cvel = state.cdof, state.cvel  # entries 0-2 are angular, 3-5 linear, about `state.centre`
    applied = np.zeros(len(cdof))
    for c in range(len(bodies)):
        exo, limb = bodies[c, 0], bodies[c, 1]  # ids of the exoskeleton's and the wearer's body
        R_exo = axes_of(state, exo)
        to_exo = transposed(R_exo)
        # the wearer's point in the world, and its displacement from the exoskeleton's point, d
        point = plus(vec3(state.xpos[limb]), matvec(axes_of(state, limb), vec3(points[c, 1])))
        arm = minus(point, vec3(state.centre))
        displacement = minus(matvec(to_exo, minus(point, vec3(state.xpos[exo]))), vec3(points[c, 0]))
        # rates of displacement and rotation, of the wearer's body relative to the exoskeleton's
        w = minus(vec3(cvel[limb]), vec3(cvel[exo]))
        dv = cvel[limb, 3] - cvel[exo, 3], cvel[limb, 4] - cvel[exo, 4], cvel[limb, 5] - cvel[exo, 5]
        rate = matvec(to_exo, plus(dv, cross(w, arm)))
        R = matmul(to_exo, axes_of(state, limb))
        rotation = times(0.5, (R[2][1] - R[1][2], R[0][2] - R[2][0], R[1][0] - R[0][1]))
        # C, half of tr(R) 1 - R: the rate of `rotation` per angular velocity
        t = R[0][0] + R[1][1] + R[2][2]
        change = (
            (0.5 * (t - R[0][0]), -0.5 * R[0][1], -0.5 * R[0][2]),
            (-0.5 * R[1][0], 0.5 * (t - R[1][1]), -0.5 * R[1][2]),
            (-0.5 * R[2][0], -0.5 * R[2][1], 0.5 * (t - R[2][2])),
        )
        rotation_rate = matvec(change, matvec(to_exo, w))
        # wrench on the exoskeleton in world axes: force, and `torque` about the centre
        force = matvec(R_exo, plus(matvec(mat3(law[c, 0]), displacement), matvec(mat3(law[c, 1]), rate)))
        moment = plus(matvec(mat3(law[c, 2]), rotation), matvec(mat3(law[c, 3]), rotation_rate))
        torque = plus(matvec(R_exo, matvec(transposed(change), moment)), cross(arm, force))
        # generalised force: the power of the wrench per unit of the joint's velocity; joints that move only the wearer
        # get it with the opposite sign
        for j in range(len(cdof)):
            if chain[c, 0, j] != chain[c, 1, j]:
                power = 0.0
                for k in range(3):
                    power += cdof[j, k] * torque[k] + cdof[j, 3 + k] * force[k]
                applied[j] += power if chain[c, 0, j] else -power
    return applied
