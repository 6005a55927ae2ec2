"""A custom exoskeleton on the wearer: its links, cuffs, motors and sensors, independent of the file format.

Every link has the axes of the wearer's pelvis (x forward, y left, z up) and its origin on its joint while all joints
are at zero: the user's model is converted to this form (`own_exo_model`), and its rig file adds the rest
(`own_exo_rig`). Each leg is a chain of hinges that hangs on a base, which is fixed to the pelvis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.parts.kinds import ActuatorPart, ImuPart
from stridetwin.sim.wearer.actuation import Module
from stridetwin.sim.wearer.coupling import Coupling
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

if TYPE_CHECKING:
    from stridetwin.sim.wearer.body import Wearer

HIGHEST_HZ = 80.0
"""Highest natural frequency of a leg on its cuffs at which a simulation in steps of 1 ms is stable."""
LOOSEST = 1e-7
"""Least ratio of smallest to largest stiffness of a leg on its cuffs; below it a joint is not held."""
_FARTHEST_M = 0.3
STEP_S = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Shape:
    """Visual shape of a link.

    Attributes:
        kind: MuJoCo's type of geom.
        size: (3,) m, as MuJoCo has it.
        pos: (3,) m in the link's frame.
        quat: (4,) w, x, y, z.
        rgba: (4,).
        vertices: (V, 3) m of a mesh, otherwise empty.
        faces: (F, 3) of a mesh, otherwise empty.
    """

    kind: int
    size: Array
    pos: Array
    quat: Array
    rgba: Array
    vertices: Array
    faces: NDArray[np.int32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Link:
    """One rigid link and its hinge.

    Attributes:
        name: Name of its body.
        joint: Name of its hinge.
        offset: (3,) m, origin in the parent's frame.
        axis: (3,) unit vector.
        stops: (2,) rad.
        damping: N m s/rad.
        friction: N m.
        armature: kg m².
        mass: kg.
        com: (3,) m.
        inertia: (3, 3) kg m² about the centre of mass.
        shapes: Visual shapes.
    """

    name: str
    joint: str
    offset: Array
    axis: Array
    stops: Array
    damping: float
    friction: float
    armature: float
    mass: float
    com: Array
    inertia: Array
    shapes: tuple[Shape, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class OnLink:
    """Pose of something on a link: (4, 4) in the frame of the link, with the name of its body."""

    link: str
    T_link: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Cuff:
    """Coupling of a link to the wearer.

    Attributes:
        body: Body of the wearer, such as `thigh_l`.
        link: Name of the link's body.
        p_in_link: (3,) m.
        law: (4, 3, 3) stiffness, damping, rotational stiffness and damping, as in `Coupling`.
        force_cells: Whether it has the force-cell pair of the interaction sensors.
    """

    body: str
    link: str
    p_in_link: Array
    law: Array
    force_cells: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class OwnExo:
    """A custom exoskeleton.

    Attributes:
        source: Name of the model file in errors.
        rig: Name of the rig file in errors.
        description: One line.
        base: Base link, fixed to the pelvis; its offset is in the pelvis' frame, and it has no joint.
        legs: Links from the base to the tip, by side.
        cuffs: Cuffs on the legs.
        modules: Powered joints, by their short name (`hip_l`).
        motors: Sensor part of each powered joint.
        encoders: Short names of the joints with an encoder.
        ahrs: AHRS poses, by place (`back`, `thigh_l`).
        imus: Poses of additional IMUs, and the part of each.
    """

    source: str
    rig: str
    description: str
    base: Link
    legs: Mapping[str, tuple[Link, ...]]
    cuffs: tuple[Cuff, ...]
    modules: Mapping[str, Module]
    motors: Mapping[str, ActuatorPart]
    encoders: tuple[str, ...]
    ahrs: Mapping[str, OnLink]
    imus: Mapping[str, tuple[OnLink, ImuPart]]

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of all links."""
        return (self.base.name, *(link.name for leg in self.legs.values() for link in leg))

    def body_moved_by(self, name: str) -> str:
        """Body that the joint with a short name moves."""
        return next(link.name for leg in self.legs.values() for link in leg if link.joint == hinge_of(name))


def hinge_of(name: str) -> str:
    """Hinge of the joint with a short name: `exo_knee_flexion_l` of `knee_l`."""
    joint, _, side = name.rpartition("_")
    return f"exo_{joint}_flexion_{side}"


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
