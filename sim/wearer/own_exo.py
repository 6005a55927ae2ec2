"""A custom exoskeleton on the wearer: its couplings, and whether its cuffs hold it."""

from __future__ import annotations

import numpy as np

from stridetwin.sim.exo_description import OwnExo
from stridetwin.sim.wearer.coupling import Coupling
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

HIGHEST_HZ = 80.0
"""Highest natural frequency of a leg on its cuffs at which a simulation in steps of 1 ms is stable."""
LOOSEST = 1e-7
"""Least ratio of smallest to largest stiffness of a leg on its cuffs; below it a joint is not held."""
_FARTHEST_M = 0.3
STEP_S = 1e-3


def own_couplings(own: OwnExo, size: Wearer) -> list[Coupling]:
    """The cuffs, without strain while wearer and exoskeleton stand with every joint at zero.

    Raises:
        ConfigError: A cuff that is too far from its limb.
    """
    at = {own.base.name: own.base.offset}
    for leg in own.legs.values():
        parent = own.base.name
        for link in leg:
            at[link.name] = at[parent] + link.offset
            parent = link.name
    made = []
    for cuff in own.cuffs:
        body, _, side = cuff.body.partition("_")
        p_in_body = at[cuff.link] + cuff.p_in_link - _origins(size, side)[body]
        if not np.linalg.norm(p_in_body - np.clip(p_in_body, *_limb(size, body))) < _FARTHEST_M:
            found = f"{np.round(1e3 * p_in_body).tolist()} mm from the origin of {cuff.body}"
            raise ConfigError(
                own.rig, f"cuffs.{cuff.body}.at_mm", found, f"within {_FARTHEST_M * 1e3:g} mm of the limb"
            )
        made.append(
            Coupling(
                name=cuff.body, exo_body=cuff.link, body=cuff.body, p_in_exo=cuff.p_in_link, p_in_body=p_in_body,
                stiffness=cuff.law[0], damping=cuff.law[1],
                rotation_stiffness=cuff.law[2], rotation_damping=cuff.law[3],
            )
        )  # fmt: skip
    return made


def check_held(own: OwnExo, side: str, mass: Array, stiffness: Array, damping: Array) -> None:
    """Rejects a leg that its cuffs do not hold, or hold too stiffly for its weight and steps of 1 ms.

    Args:
        own: The exoskeleton.
        side: `l` or `r`.
        mass: (J, J) kg m², joints at zero.
        stiffness: (J, J) N m/rad of the cuffs, on a wearer standing upright.
        damping: (J, J) N m s/rad, likewise.

    Raises:
        ConfigError: The leg is not held, or held too stiffly.
    """
    whole, modes = np.linalg.eigh(stiffness)
    if whole[0] < LOOSEST * whole[-1]:
        joint = own.legs[side][int(np.argmax(np.abs(modes[:, 0])))].joint
        raise ConfigError(own.rig, "cuffs", f"none that hold {joint}", "cuffs beyond every joint of a leg")
    fastest = float(np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real.max()) / (2 * np.pi))
    if fastest > HIGHEST_HZ:
        valid = f"up to {HIGHEST_HZ:g} Hz (softer cuffs, or links and armatures with more inertia)"
        raise ConfigError(own.rig, "cuffs", f"leg {side} at {fastest:.0f} Hz on its cuffs", valid)
    decay = float(np.linalg.eigvals(np.linalg.solve(mass, damping)).real.max())
    if decay * STEP_S > 1.0:
        valid = f"up to {1 / STEP_S:g} 1/s (less damping, or links and armatures with more inertia)"
        raise ConfigError(own.rig, "cuffs", f"leg {side} damped at {decay:.0f} 1/s", valid)


def _origins(size: Wearer, side: str) -> dict[str, Array]:
    """(3,) m, origin of each body of a leg in the pelvis' frame, standing upright."""
    y = size.body.hip_half_width_m * (1.0 if side == "l" else -1.0)
    knee, ankle = size.body.thigh_m, size.body.thigh_m + size.body.shank_m
    return {
        "thigh": np.array([0.0, y, 0.0]),
        "shank": np.array([0.0, y, -knee]),
        "foot": np.array([-size.ankle_x, y, -ankle - size.body.ankle_height_m]),
    }


def _limb(size: Wearer, body: str) -> tuple[Array, Array]:
    """(3,) m, lowest and highest point of a limb's axis in its frame."""
    zero = np.zeros(3)
    lengths = {"thigh": -size.body.thigh_m, "shank": -size.body.shank_m}
    if body == "foot":
        return zero, np.array([size.shoe.toe_tip_x, 0.0, size.body.ankle_height_m])
    return np.array([0.0, 0.0, lengths[body]]), zero
