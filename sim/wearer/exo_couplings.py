"""The exoskeleton's legs on the wearer: frames of a leg, and the compliant couplings that carry it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stridetwin.sim.config import SIDES
from stridetwin.sim.wearer.coupling import Coupling
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.sim.wearer.exoskeleton import (
    CUFF_SHARE,
    EXO_LEG_BODIES,
    EXO_LEG_JOINTS,
    RANGE_RAD,
    ExoLinks,
    chain,
    outward,
)
from stridetwin.sim.wearer.own_exo import own_couplings
from stridetwin.streams.samples import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class LegFrame:
    """One leg of the worn exoskeleton, a chain of J hinges.

    Attributes:
        bodies: Names, from the pelvis to the tip.
        joints: Names.
        offsets: (J, 3) m, origin of each body in its parent's frame; the first parent is the pelvis.
        axes: (J, 3) axis of each joint.
        stops: (J, 2) rad.
    """

    bodies: tuple[str, ...]
    joints: tuple[str, ...]
    offsets: Array
    axes: Array
    stops: Array


def leg_frame(size: Wearer, side: str) -> LegFrame:
    """A leg of the wearer's exoskeleton.

    Raises:
        ValueError: The wearer has no exoskeleton.
    """
    if size.exo is None:
        raise ValueError("the wearer has no exoskeleton")
    if isinstance(size.exo, ExoLinks):
        offsets, axes = chain(size.exo, side)
        bodies, joints = (tuple(f"{n}_{side}" for n in names) for names in (EXO_LEG_BODIES, EXO_LEG_JOINTS))
        return LegFrame(bodies=bodies, joints=joints, offsets=offsets, axes=axes, stops=RANGE_RAD)
    leg = size.exo.legs[side]
    offsets = np.array([link.offset for link in leg])
    offsets[0] += size.exo.base.offset
    return LegFrame(
        bodies=tuple(link.name for link in leg), joints=tuple(link.joint for link in leg), offsets=offsets,
        axes=np.array([link.axis for link in leg]), stops=np.array([link.stops for link in leg]),
    )  # fmt: skip


def couplings(size: Wearer) -> list[Coupling]:
    """Couplings between the exoskeleton's legs and the wearer: cuffs at thigh and shank, heel holder; [] without it.

    The cuffs push fore-aft and sideways and slide along the limb. The holder is buckled over the instep and leaves the
    forefoot free: the heel can lift and pitch in it. A strap on soft tissue has a stiffness of some kN/m. On a
    wearer whose body is held fixed, a leg has natural frequencies of 7-41 Hz, damped by 0.4-1.3 of critical (with
    modules on hip and knee 2-40 Hz, 0.13-0.9), so that a simulation in steps of 1 ms stays stable.
    """
    if size.exo is None:
        return []
    if not isinstance(size.exo, ExoLinks):
        return own_couplings(size.exo, size)
    links, made = size.exo, []
    for side in SIDES:
        s = outward(side)
        for part, length in (("thigh", links.thigh), ("shank", links.shank)):
            down = CUFF_SHARE[part] * length
            made.append(
                Coupling(
                    name=f"{part}_{side}", exo_body=f"exo_{part}_{side}", body=f"{part}_{side}",
                    p_in_exo=np.array([0.0, -s * links.hip2, -down]), p_in_body=np.array([0.0, 0.0, -down]),
                    stiffness=np.diag([4000.0, 4000.0, 0.0]), damping=np.diag([90.0, 90.0, 20.0]),
                    rotation_stiffness=np.diag([3.0, 3.0, 20.0]), rotation_damping=np.diag([0.1, 0.1, 0.5]),
                )
            )  # fmt: skip
        p_heel = np.array([0.0, 0.0, 0.035])
        p_holder = np.array([size.ankle_x - links.ankle1, 0.0, size.body.ankle_height_m])
        made.append(
            Coupling(
                name=f"heel_{side}", exo_body=f"exo_foot_{side}", body=f"foot_{side}",
                p_in_exo=p_heel - p_holder, p_in_body=p_heel,
                stiffness=np.diag([15e3, 15e3, 15e3]), damping=np.diag([80.0, 80.0, 80.0]),
                rotation_stiffness=np.diag([120.0, 160.0, 120.0]), rotation_damping=np.diag([0.5, 1.0, 0.5]),
            )
        )  # fmt: skip
    return made
