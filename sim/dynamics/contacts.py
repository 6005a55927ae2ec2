"""The engine's contacts: a term that their constraints omit, and what the soles sense of them.

MuJoCo demands of a contact that J q'' = a_ref with a_ref = -b v - k r (its documentation, "Computation", constraint
model): the acceleration of contact points at zero joint acceleration, J' q', is missing. Under a stance foot, while the
leg swings over it, J' q' is some m/s², and only the damping b opposes it: the foot slides at J' q' / b, tens of mm/s in
fast walking whatever the friction. Here the term is subtracted from the reference acceleration, so that contact points
do not slide.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.config import SIDES
from stridetwin.sim.dynamics.footstep_replanning import PlannedFeet
from stridetwin.sim.dynamics.soles import PER_FOOT
from stridetwin.sim.dynamics.spatial import State, bias_acceleration, velocity
from stridetwin.streams.algebra.tuples import minus, vec3
from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.samples import Array

_entry_kernel = entry_kernel(Path(__file__).parent, llvm_level=1)

_FLOOR_M = 0.015  # a contact farther than this from its plan is an edge, not the floor
_UPRIGHT = 0.9  # cosine between a floor's normal and that of the planned footprint, at least
_BEARS_M = 0.0003  # a point bears force from here on; assuming force too early lets the foot slap
_LIFTS_M = 0.0015  # and until it is this far off, so that a trembling foot stays in contact
_EARLY_S = 0.08  # this long before its planned landing, a foot in contact may already bear force


class Contacts(NamedTuple):
    """The engine's contacts at one instant.

    Attributes:
        geom: (C, 2) the geoms that touch.
        pos: (C, 3) m, middle between the two surfaces.
        frame: (C, 9) axes in rows; the first one points from the first geom to the second.
        dist: (C,) m between the two surfaces.
        address: (C,) first row of the constraint forces, -1 where a contact makes none.
    """

    geom: NDArray[np.int32]
    pos: Array
    frame: Array
    dist: Array
    address: NDArray[np.int32]

    @classmethod
    def of(cls, data: mujoco.MjData) -> Contacts:
        """Views of the engine's contacts, to be taken after `mj_step1`."""
        contact = data.contact
        return cls(contact.geom, contact.pos, contact.frame, contact.dist, contact.efc_address)


@_entry_kernel
def subtract_bias(
    body: NDArray[np.int32], chain: NDArray[np.bool_], contacts: Contacts, state: State, aref: Array
) -> None:
    """Subtracts J' q' from the reference acceleration of every contact; call it between `mj_step1` and `mj_step2`.

    J' q' is the acceleration of the second geom's contact point relative to the first one's at zero joint acceleration,
    in the axes of the contact. Contacts that make no constraint are left out.

    Args:
        body: (ngeom,) body of each geom; 0 for geoms fixed to the world.
        chain: (nbody, nv) degrees of freedom that move each body.
        contacts: The engine's contacts.
        state: The engine's state.
        aref: (nefc,) reference accelerations, which are overwritten.
    """
    geoms, pos, frame, _, address = contacts
    for c in range(len(address)):
        if address[c] < 0:
            continue  # a contact without constraint has no reference acceleration
        point = vec3(pos[c])
        for end in range(2):  # the two geoms that touch
            b = body[geoms[c, end]]
            if b == 0:
                continue  # the world does not move
            v, w = velocity(state, b, point)
            arm = minus(point, vec3(state.centre))
            bias, _ = bias_acceleration(state.cdof_dot, chain[b], state.qvel, v, w, arm)
            sign = 1.0 if end == 1 else -1.0  # the contact's motion is that of the second geom minus the first
            for row in range(3):
                for axis in range(3):
                    aref[address[c] + row] -= sign * frame[c, 3 * row + axis] * bias[axis]


def sole_point_numbers(model: mujoco.MjModel) -> NDArray[np.int64]:
    """(ngeom,) number of the sole point that a geom is, 0 to 15, the left foot's first; -1 for all others."""
    point = np.full(model.ngeom, -1, dtype=np.int64)
    for k, side in enumerate(SIDES):
        for i in range(PER_FOOT):
            point[model.geom(f"sole_{side}_{i}").id] = k * PER_FOOT + i
    return point


@_entry_kernel
def sense_floor(
    point: NDArray[np.int64], contacts: Contacts, feet: PlannedFeet, before: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], Array]:
    """Which sole points may bear force, and how high the floor is under each foot.

    A contact counts as the floor if its normal is that of the planned footprint and it lies within `_FLOOR_M` of it;
    faces of risers and edges do not count. Use the result of each control step as `before` in the next one.

    Args:
        point: (ngeom,) numbers of the sole points (`sole_point_numbers`).
        contacts: The engine's contacts.
        feet: Plan of the feet.
        before: (2, points) which points might bear force in the previous control step.

    Returns:
        (2, points) whether a point may bear force; (2,) m, height of the floor above the plane of the planned
        footprint, NaN for a foot without contact.
    """
    geoms, pos, frame, dist, _ = contacts
    R_sole, p_sole, swinging = feet.R_sole, feet.p_sole, feet.swinging
    may_bear = np.zeros((2, PER_FOOT), dtype=np.bool_)
    total, count = np.zeros(2), np.zeros(2)  # by foot: sum of the floor's heights, and number of contacts in it
    for c in range(len(dist)):
        n = max(point[geoms[c, 0]], point[geoms[c, 1]])  # number of the sole point; the other geom has -1
        if n < 0:
            continue  # no sole takes part
        side = n // PER_FOOT
        early = swinging[side] and feet.until_landing[side] < _EARLY_S
        if swinging[side] and not early:
            continue  # a foot in the air that brushes against something
        upright = 0.0  # cosine between the contact's normal and that of the footprint; its sign depends on the order
        for axis in range(3):
            upright += frame[c, axis] * R_sole[side, axis, 2]
        if abs(upright) < _UPRIGHT:
            continue  # the face of a riser, or an edge under overhanging toes
        # height of the floor above the plane of the footprint, measured vertically: a contact point lies midway between
        # the two surfaces, so the floor is half their distance below it
        above = 0.0
        for axis in range(3):
            above += (pos[c, axis] - p_sole[side, axis]) * R_sole[side, axis, 2] / R_sole[side, 2, 2]
        above -= 0.5 * dist[c] / R_sole[side, 2, 2]
        if abs(above) > _FLOOR_M:
            continue  # an edge, not the floor
        i = n % PER_FOOT
        near = _LIFTS_M if before[side, i] else _BEARS_M  # hysteresis: a point bears force until it is farther off
        may_bear[side, i] = dist[c] < near and (early or feet.touching[side, i])
        total[side] += above
        count[side] += 1.0
    for side in range(2):  # the sum becomes the mean
        total[side] = total[side] / count[side] if count[side] > 0.0 else np.nan
    return may_bear, total
