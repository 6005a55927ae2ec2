"""Term that the engine's contact constraints omit: acceleration of contact points at zero joint acceleration.

MuJoCo demands of a contact that J q'' = a_ref with a_ref = -b v - k r (its documentation, "Computation", constraint
model): the term J' q' is missing. Under a stance foot, while the leg swings over it, J' q' is some m/s², and only the
damping b opposes it: the foot slides at J' q' / b, tens of mm/s in fast walking whatever the friction. Here the term is
subtracted from the reference acceleration, so that contact points do not slide.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numba
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.dynamics.couplings import chain_of
from stridetwin.sim.dynamics.spatial import bias_acceleration, cross
from stridetwin.streams.samples import Array


class Contacts(NamedTuple):
    """The engine's contacts at one instant.

    Attributes:
        geom: (C, 2) the geoms that touch.
        pos: (C, 3) m, middle between the two surfaces.
        frame: (C, 9) axes in rows; the first one points from the first geom to the second.
        address: (C,) first row of the constraint forces, -1 where a contact makes none.
    """

    geom: NDArray[np.int32]
    pos: Array
    frame: Array
    address: NDArray[np.int32]

    @classmethod
    def of(cls, data: mujoco.MjData) -> Contacts:
        """Those of a state."""
        contact = data.contact
        return cls(contact.geom, contact.pos, contact.frame, contact.efc_address)


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactBias:
    """Bodies of a model that may touch static geometry.

    Attributes:
        body: (ngeom,) body of each geom; 0 for geoms fixed to the world.
        chain: (nbody, nv) degrees of freedom that move each body.
    """

    body: NDArray[np.int32]
    chain: NDArray[np.bool_]

    @classmethod
    def of(cls, model: mujoco.MjModel) -> ContactBias:
        """Finds the bodies of a model."""
        body = model.body_weldid[model.geom_bodyid]
        return cls(body=body, chain=np.array([chain_of(model, b) for b in range(model.nbody)]))

    def apply(self, data: mujoco.MjData) -> None:
        """Corrects the reference accelerations of all contacts; call it between `mj_step1` and `mj_step2`."""
        _apply(
            self.body, self.chain, Contacts.of(data), data.cvel, data.cdof_dot, data.subtree_com[1], data.qvel,
            data.efc_aref,
        )  # fmt: skip


@numba.njit(cache=True)
def _apply(
    body: NDArray[np.int32], chain: NDArray[np.bool_], contacts: Contacts, cvel: Array, cdof_dot: Array,
    centre: Array, qvel: Array, aref: Array,
) -> None:  # fmt: skip
    geoms, pos, frame, address = contacts
    v, bias, turn = np.empty(3), np.empty(3), np.empty(3)
    for c in range(len(address)):
        if address[c] < 0:
            continue
        for which in range(2):
            b = body[geoms[c, which]]
            if b == 0:
                continue
            w = cvel[b, :3].copy()
            cross(w, pos[c] - centre, v)
            v += cvel[b, 3:]
            bias_acceleration(cdof_dot, chain[b], centre, qvel, v, w, pos[c], bias, turn)
            sign = 1.0 if which == 1 else -1.0
            for row in range(3):
                for axis in range(3):
                    aref[address[c] + row] -= sign * frame[c, 3 * row + axis] * bias[axis]
