"""Description of a custom exoskeleton: links, cuffs, motors and sensors, independent of the file format.

Every link has the axes of the wearer's pelvis (x forward, y left, z up) and its origin on its joint while all joints
are at zero. Each leg is a chain of hinges that hangs on a base, which is fixed to the pelvis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.parts.kinds import ActuatorPart, ImuPart
from stridetwin.streams.samples import Array


@dataclass(frozen=True, kw_only=True)
class Module:
    """One actuation module; torques, speeds and frictions are those at the joint.

    Attributes:
        gear: Ratio.
        rotor_inertia: kg m², motor and wave generator.
        friction_nm: Dry friction.
        viscous_nms: N m s/rad.
        torque_max_nm: Repeated peak torque of the gear.
        speed_max_radps: Highest input speed of the gear over the ratio.
        mass_kg: Motor, gear, driver and housing.
    """

    gear: float
    rotor_inertia: float
    friction_nm: float
    viscous_nms: float
    torque_max_nm: float
    speed_max_radps: float
    mass_kg: float

    @property
    def reflected_inertia(self) -> float:
        """Inertia of the rotor reflected to the joint, kg m²."""
        return self.rotor_inertia * self.gear**2


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
        axis: (3,) unit vector, axis of the hinge.
        stops: (2,) rad, least and largest angle of the hinge.
        damping: N m s/rad, of the hinge.
        friction: N m, dry friction of the hinge.
        armature: kg m², inertia of its rotor at the joint.
        mass: kg.
        com: (3,) m, centre of mass in the link's frame.
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
    """Pose of something on a link.

    Attributes:
        link: Name of the link's body.
        T_link: (4, 4) pose in the frame of the link, m.
    """

    link: str
    T_link: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Cuff:
    """Coupling of a link to the wearer.

    Attributes:
        body: Body of the wearer, such as `thigh_l`.
        link: Name of the link's body.
        p_in_link: (3,) m, its place in the link's frame.
        law: (4, 3, 3) stiffness, N/m, damping, N s/m, rotational stiffness, N m/rad, and rotational damping,
            N m s/rad (`Coupling`).
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
        motors: Sensor part of each powered joint, by its short name.
        encoders: Short names of the joints with an encoder.
        ahrs: AHRS poses, by place (`back`, `thigh_l`).
        imus: Pose and part of each additional IMU, by place.
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
        """Name of the body that the joint with the short name `name`, such as `knee_l`, moves."""
        return next(link.name for leg in self.legs.values() for link in leg if link.joint == hinge_of(name))


def hinge_of(name: str) -> str:
    """Name of the hinge, in the wearer's model, of the joint with a short name: `exo_knee_flexion_l` of `knee_l`."""
    joint, _, side = name.rpartition("_")
    return f"exo_{joint}_flexion_{side}"
