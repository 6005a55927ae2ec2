"""What carries the exoskeleton on the wearer: the frames of its legs, and compliant couplings (straps, heel holders).

The strain of a coupling is the position of the wearer's attachment point relative to the exoskeleton's, in the
exoskeleton body's axes, and the vector part of the relative rotation. Both give an elastic energy whose gradient is the
wrench. Force and counterforce act at one point, the wearer's, so that a coupling adds neither momentum nor angular
momentum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.sim.config import SIDES
from stridetwin.sim.exo_description import OwnExo
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
from stridetwin.streams.algebra.arrays import cross
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

COMPLIANCE = {
    "strap": ((4000.0, 4000.0, 0.0), (90.0, 90.0, 20.0), (3.0, 3.0, 20.0), (0.1, 0.1, 0.5)),
    "holder": ((15e3, 15e3, 15e3), (80.0, 80.0, 80.0), (120.0, 160.0, 120.0), (0.5, 1.0, 0.5)),
}
"""Stiffness (N/m), damping (N s/m), and both of rotation (N m/rad, N m s/rad), each fore-aft, sideways and along the
limb: a strap on soft tissue has some kN/m and slides along the limb, a holder does not."""
_HIGHEST_HZ = 80.0
"""Highest natural frequency of a leg on its cuffs at which a simulation in steps of 1 ms is stable."""
_LOOSEST = 1e-7
"""Least ratio of smallest to largest stiffness of a leg on its cuffs; below it a joint is not held."""
_FARTHEST_M = 0.3
"""Largest distance of a cuff from its limb."""
_STEP_S = 1e-3
"""Time step of a simulation, in which damping may act at most once."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Coupling:
    """Spring and damper between a body of the exoskeleton and one of the wearer.

    Attributes:
        name: `thigh_l`, `shank_l`, `heel_l`, ...
        exo_body: Body of the exoskeleton.
        body: Body of the wearer.
        p_in_exo: (3,) m, attachment in the exoskeleton body's frame.
        p_in_body: (3,) m, attachment in the wearer's body frame.
        law: (4, 3, 3) stiffness, N/m, damping, N s/m, rotational stiffness, N m/rad, and rotational damping,
            N m s/rad, exoskeleton body's axes.
    """

    name: str
    exo_body: str
    body: str
    p_in_exo: Array
    p_in_body: Array
    law: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyState:
    """Pose and twist of a body in any common frame.

    Attributes:
        p: (..., 3) m, origin.
        R: (..., 3, 3) body to common frame.
        v: (..., 3) m/s of the origin.
        w: (..., 3) rad/s, common axes.
    """

    p: Array
    R: Array
    v: Array
    w: Array


def strain(c: Coupling, p_exo: Array, R_exo: Array, p_body: Array, R_body: Array) -> tuple[Array, Array, Array, Array]:
    """Strain of a coupling: displacement and rotation of the wearer's body as seen from the exoskeleton's.

    Args:
        c: Coupling.
        p_exo: (..., 3) m, origin of the exoskeleton's body in a common frame.
        R_exo: (..., 3, 3) its rotation.
        p_body: (..., 3) m, origin of the wearer's body in that frame.
        R_body: (..., 3, 3) its rotation.

    Returns:
        (..., 3) displacement of the wearer's point, m, and (..., 3) vector part of the relative rotation (sine of the
        angle), both in the exoskeleton body's axes; (..., 3, 3) derivative of that vector by the relative rotation; and
        (..., 3) the point where the force acts, in the common frame.
    """
    point = p_body + R_body @ c.p_in_body
    displacement = np.einsum("...ji,...j->...i", R_exo, point - p_exo) - c.p_in_exo
    R = np.swapaxes(R_exo, -1, -2) @ R_body  # of the wearer's body, as seen from the exoskeleton's
    rotation = 0.5 * np.stack(
        [R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1
    )
    change = 0.5 * (np.trace(R, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - R)  # rate of `rotation` per ω
    return displacement, rotation, change, point


def wrench(c: Coupling, exo: BodyState, body: BodyState) -> tuple[Array, Array, Array]:
    """Wrench of the wearer on the exoskeleton at a coupling; the exoskeleton exerts the opposite on the wearer.

    With the strains d and r it is the gradient of ½ dᵀ K d + ½ rᵀ K_r r, plus the damping of their rates. K and K_r are
    the stiffness and the rotational stiffness of the law.

    Args:
        c: Coupling.
        exo: State of the exoskeleton's body.
        body: State of the wearer's body, in the same frame.

    Returns:
        (..., 3) force, N, and (..., 3) torque, N m, in the common axes, and (..., 3) the point where the force acts.
    """
    displacement, rotation, change, point = strain(c, exo.p, exo.R, body.p, body.R)
    # velocity, common axes, of the wearer's point relative to the same point of the exoskeleton's body
    relative = body.v + cross(body.w, point - body.p) - exo.v - cross(exo.w, point - exo.p)
    # rates of displacement and rotation in the axes of the exoskeleton's body
    rate = np.einsum("...ji,...j->...i", exo.R, relative)
    rotation_rate = np.einsum("...ij,...kj,...k->...i", change, exo.R, body.w - exo.w)
    stiffness, damping, rotation_stiffness, rotation_damping = c.law
    force = displacement @ stiffness.T + rate @ damping.T
    moment = rotation @ rotation_stiffness.T + rotation_rate @ rotation_damping.T  # conjugate to `rotation`
    torque = np.einsum("...ji,...j->...i", change, moment)
    return np.einsum("...ij,...j->...i", exo.R, force), np.einsum("...ij,...j->...i", exo.R, torque), point


@dataclass(frozen=True, kw_only=True, eq=False)
class LegFrame:
    """One leg of the worn exoskeleton, a chain of J hinges.

    Attributes:
        bodies: Names of the bodies, from the pelvis to the tip.
        joints: Names of the hinges that move them.
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
    """Bodies, joints, offsets, axes and stops of the leg `side` (`l` or `r`) of the wearer's exoskeleton.

    Raises:
        ValueError: The wearer has no exoskeleton.
    """
    if size.exo is None:
        raise ValueError("the wearer has no exoskeleton")
    if isinstance(size.exo, ExoLinks):
        offsets, axes = chain(size.exo, side)
        bodies, joints = (tuple(f"{n}_{side}" for n in names) for names in (EXO_LEG_BODIES, EXO_LEG_JOINTS))
        return LegFrame(bodies=bodies, joints=joints, offsets=offsets, axes=axes, stops=RANGE_RAD)
    # a custom exoskeleton: its legs hang on its base, which is fixed to the pelvis
    leg = size.exo.legs[side]
    offsets = np.array([link.offset for link in leg])
    offsets[0] += size.exo.base.offset
    return LegFrame(
        bodies=tuple(link.name for link in leg),
        joints=tuple(link.joint for link in leg),
        offsets=offsets,
        axes=np.array([link.axis for link in leg]),
        stops=np.array([link.stops for link in leg]),
    )


def exo_couplings(size: Wearer) -> list[Coupling]:
    """Couplings between the exoskeleton's legs and the wearer: cuffs at thigh and shank, heel holder; [] without it.

    The holder is buckled over the instep and leaves the forefoot free: the heel can lift and pitch in it. On a wearer
    whose body is held fixed, a leg has natural frequencies of 7-41 Hz, damped by 0.4-1.3 of critical (with modules on
    hip and knee 2-40 Hz, 0.13-0.9), so that a simulation in steps of 1 ms stays stable.
    """
    if size.exo is None:
        return []
    if not isinstance(size.exo, ExoLinks):
        return _cuff_couplings(size.exo, size)
    links, cuffs = size.exo, []
    for side in SIDES:
        for part, length in (("thigh", links.thigh), ("shank", links.shank)):
            # place of the cuff on the axis of the limb; the bar of the exoskeleton is `hip2` beside it
            on_limb = np.array([0.0, 0.0, -CUFF_SHARE[part] * length])
            cuffs.append(
                Coupling(
                    name=f"{part}_{side}",
                    exo_body=f"exo_{part}_{side}",
                    body=f"{part}_{side}",
                    p_in_exo=on_limb - [0.0, outward(side) * links.hip2, 0.0],
                    p_in_body=on_limb,
                    law=coupling_law("strap"),
                )
            )
        # in the foot's frame, m: place of the coupling, 35 mm above the sole, and origin of the exoskeleton's foot,
        # `ankle1` behind the ankle's axis
        p_heel = np.array([0.0, 0.0, 0.035])
        p_holder = np.array([size.ankle_x - links.ankle1, 0.0, size.body.ankle_height_m])
        cuffs.append(
            Coupling(
                name=f"heel_{side}",
                exo_body=f"exo_foot_{side}",
                body=f"foot_{side}",
                p_in_exo=p_heel - p_holder,
                p_in_body=p_heel,
                law=coupling_law("holder"),
            )
        )
    return cuffs


def coupling_law(kind: str, diagonals: Sequence[Array | None] = (None,) * 4) -> Array:
    """(4, 3, 3) law of a coupling: stiffness, damping, and both of rotation, as diagonal matrices.

    Args:
        kind: Kind of `COMPLIANCE`, `strap` or `holder`.
        diagonals: (3,) diagonals that replace those of the kind; None keeps one.
    """
    return np.array(
        [np.diag(usual if diagonal is None else diagonal) for usual, diagonal in zip(COMPLIANCE[kind], diagonals)]
    )


def _cuff_couplings(exo: OwnExo, size: Wearer) -> list[Coupling]:
    """Couplings at the cuffs of a custom exoskeleton, without strain while every joint is at zero.

    Raises:
        ConfigError: A cuff that is too far from its limb.
    """
    origins = {exo.base.name: exo.base.offset}  # of each link in the pelvis' frame, all joints at zero, m
    for leg in exo.legs.values():
        parent = exo.base.name
        for link in leg:
            origins[link.name] = origins[parent] + link.offset
            parent = link.name
    cuffs = []
    for cuff in exo.cuffs:
        body, _, side = cuff.body.partition("_")
        p_in_body = origins[cuff.link] + cuff.p_in_link - _limb_origins(size, side)[body]
        on_limb = np.clip(p_in_body, *_limb_box(size, body))  # nearest point of the limb
        if not np.linalg.norm(p_in_body - on_limb) < _FARTHEST_M:
            place = f"{np.round(1e3 * p_in_body).tolist()} mm from the origin of {cuff.body}"
            raise ConfigError(
                exo.rig, f"cuffs.{cuff.body}.at_mm", place, f"within {_FARTHEST_M * 1e3:g} mm of the limb"
            )
        cuffs.append(
            Coupling(
                name=cuff.body,
                exo_body=cuff.link,
                body=cuff.body,
                p_in_exo=cuff.p_in_link,
                p_in_body=p_in_body,
                law=cuff.law,
            )
        )
    return cuffs


def check_cuff_stiffness(exo: OwnExo, side: str, mass: Array, stiffness: Array, damping: Array) -> None:
    """Rejects a leg that its cuffs do not hold, or hold too stiffly for its weight and steps of 1 ms.

    A joint is not held if the least eigenvalue of the stiffness is below `_LOOSEST` times the largest. The highest
    natural frequency √λ(M⁻¹ K) / 2π may be `_HIGHEST_HZ`, the fastest decay λ(M⁻¹ D) one per step.

    Args:
        exo: The exoskeleton.
        side: `l` or `r`.
        mass: (J, J) kg m², joints at zero.
        stiffness: (J, J) N m/rad of the cuffs, on a wearer standing upright.
        damping: (J, J) N m s/rad of the cuffs, in the same posture.

    Raises:
        ConfigError: The leg is not held, or held too stiffly.
    """
    eigenvalues, modes = np.linalg.eigh(stiffness)  # ascending, N m/rad; modes are columns
    if eigenvalues[0] < _LOOSEST * eigenvalues[-1]:
        # the joint that moves most in the loosest mode
        joint = exo.legs[side][int(np.argmax(np.abs(modes[:, 0])))].joint
        raise ConfigError(exo.rig, "cuffs", f"none that hold {joint}", "cuffs beyond every joint of a leg")
    fastest = float(np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real.max()) / (2 * np.pi))
    if fastest > _HIGHEST_HZ:
        valid = f"up to {_HIGHEST_HZ:g} Hz (softer cuffs, or links and armatures with more inertia)"
        raise ConfigError(exo.rig, "cuffs", f"leg {side} at {fastest:.0f} Hz on its cuffs", valid)
    # 1/s, fastest decay by damping alone
    decay = float(np.linalg.eigvals(np.linalg.solve(mass, damping)).real.max())
    if decay * _STEP_S > 1.0:
        valid = f"up to {1 / _STEP_S:g} 1/s (less damping, or links and armatures with more inertia)"
        raise ConfigError(exo.rig, "cuffs", f"leg {side} damped at {decay:.0f} 1/s", valid)


def _limb_origins(size: Wearer, side: str) -> dict[str, Array]:
    """(3,) m by body, `thigh`, `shank` and `foot`: its origin in the pelvis' frame, while the wearer stands upright."""
    y, knee = size.body.hip_half_width_m * outward(side), size.body.thigh_m
    return {
        "thigh": np.array([0.0, y, 0.0]),
        "shank": np.array([0.0, y, -knee]),
        "foot": np.array([-size.ankle_x, y, -(knee + size.body.shank_m) - size.body.ankle_height_m]),
    }


def _limb_box(size: Wearer, body: str) -> tuple[Array, Array]:
    """Lowest and highest corner, (3,) m each, of a box around the axis of a limb in its frame; a foot has a height."""
    if body == "foot":
        return np.zeros(3), np.array([size.shoe.toe_tip_x, 0.0, size.body.ankle_height_m])
    lengths = {"thigh": size.body.thigh_m, "shank": size.body.shank_m}
    return np.array([0.0, 0.0, -lengths[body]]), np.zeros(3)
