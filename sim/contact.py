"""Distribution of the ground reaction wrench, known from inverse dynamics, between the two feet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.rotation import cross
from stridetwin.streams.samples import Array

LIFTED = 1e-3  # share of the load below which a foot counts as lifted


@dataclass(frozen=True, kw_only=True, eq=False)
class FootLoad:
    """Ground reaction on one foot at N instants.

    Attributes:
        force: (N, 3) N, world.
        torque: (N, 3) N m about the foot frame's origin, world axes.
        cop: (N, 3) m, centre of pressure in the world; undefined while the foot is lifted.
        loaded: (N,) whether the foot bears load.
    """

    force: Array
    torque: Array
    cop: Array
    loaded: NDArray[np.bool_]


def share_out(
    force: Array,
    torque: Array,
    origin: Array,
    shares: dict[str, Array],
    planned: dict[str, Array],
    p_foot: dict[str, Array],
) -> tuple[dict[str, FootLoad], Array, Array]:
    """Splits a total wrench between the feet.

    Each foot takes its share of the force. The centres of pressure are the planned ones, both translated equally in the
    plane so that their weighted mean is the zero-moment point; the moment about the vertical is shared like the force.

    Args:
        force: (N, 3) total force of the ground, world, N.
        torque: (N, 3) its moment about `origin`, N m.
        origin: (N, 3) m, world.
        shares: (N,) by foot, summing to 1.
        planned: (N, 3) m, planned centre of pressure by foot, world.
        p_foot: (N, 3) m, foot frame's origin by foot, world.

    Returns:
        Loads by foot, and the residual force (N, 3) and torque (N, 3) that they do not explain.
    """
    kept = {f: np.where(s > LIFTED, s, 0.0) for f, s in shares.items()}
    whole = np.sum(list(kept.values()), axis=0)
    shares = {f: s / whole for f, s in kept.items()}
    middle = np.sum([shares[f][:, None] * planned[f] for f in shares], axis=0)
    arm_z = middle[:, 2] - origin[:, 2]
    lift = np.maximum(force[:, 2], 1.0)  # in free fall there is no zero-moment point
    x = origin[:, 0] + (arm_z * force[:, 0] - torque[:, 1]) / lift
    y = origin[:, 1] + (arm_z * force[:, 1] + torque[:, 0]) / lift
    shift = np.column_stack([x, y, middle[:, 2]]) - middle
    twist = torque - cross(middle + shift - origin, force)
    loads, left_force, left_torque = {}, force.copy(), torque.copy()
    for foot, share in shares.items():
        own = share[:, None] * force
        cop = planned[foot] + shift
        free = np.column_stack([np.zeros((len(share), 2)), share * twist[:, 2]])
        loads[foot] = FootLoad(
            force=own, torque=cross(cop - p_foot[foot], own) + free, cop=cop, loaded=share > 0.0
        )  # fmt: skip
        left_force -= own
        left_torque -= cross(cop - origin, own) + free
    return loads, left_force, left_torque
