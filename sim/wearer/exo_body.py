"""The bodies of an exoskeleton in the wearer's model: the built-in one from its leaf files, or a custom one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np

from stridetwin.sim.config import SIDES
from stridetwin.sim.exo_description import Link, Module, OwnExo, hinge_of
from stridetwin.sim.wearer.exoskeleton import CUFF_SHARE, EXO_LEG_BODIES, ExoLinks, chain
from stridetwin.sim.wearer.leaves import attach, read_leaf

_BESIDE_BAR_M = 0.052  # a module, from the bar beside the leg


@dataclass(frozen=True, kw_only=True)
class Band:
    """A strap around a part of the body, m, for a person of the mean girth; half axes along x and y.

    Attributes:
        middle_x: Its middle in the frame of the leaf's body.
        half_x: Of the body part.
        half_y: Likewise.
        clearance: From the skin to the middle of the strap.
    """

    middle_x: float
    half_x: float
    half_y: float
    clearance: float


# as thick as the leaf files' trunk and legs are at these places
_WAIST = Band(middle_x=-0.012, half_x=0.104, half_y=0.158, clearance=0.008)
_LIMB = {
    "thigh": Band(middle_x=0.004, half_x=0.079, half_y=0.079, clearance=0.005),
    "shank": Band(middle_x=-0.010, half_x=0.059, half_y=0.059, clearance=0.005),
}


def add_exoskeleton(pelvis: mujoco.MjsBody, links: ExoLinks, girth: float, modules: Mapping[str, Module]) -> None:
    """Attaches the built-in exoskeleton to the pelvis: the back panel `exo_back` and the bodies of both legs.

    Args:
        pelvis: Body of the wearer.
        links: Lengths.
        girth: Thickness of trunk and limbs over that of the mean person.
        modules: Actuation modules by joint (`exoskeleton.modules`).
    """
    attach(pelvis, back_panel(links, girth), "exo_back")
    # a module's joint, the link above it that carries it, and how far down on that link the joint is, m
    places = (("knee", "exo_thigh", links.thigh), ("hip", "exo_hip_rotation", links.hip5))
    for side in SIDES:
        leg = leg_of(links, girth)
        for joint, link, down in places:
            if (module := modules.get(f"{joint}_{side}")) is not None:
                _add_module(leg, joint, leg.body(link), down, module)
        attach(pelvis, leg, EXO_LEG_BODIES[0], side=side)


def back_panel(links: ExoLinks, girth: float) -> mujoco.MjSpec:
    """Back panel of the exoskeleton from the leaf `exo_back`, fitted to a person of a `girth` relative to the mean."""
    spec = read_leaf("exo_back")
    panel = spec.body("exo_back")
    # the panel's centre of mass moves to its distance behind the hips; plate, box and brackets move as far
    moved = -links.hip6 - panel.ipos[0]
    panel.ipos[0] = -links.hip6
    for name in ("exo_back_plate", "exo_back_box", "exo_bracket_l", "exo_bracket_r"):
        spec.geom(name).pos[0] += moved
    for side, y in (("l", links.hip1), ("r", -links.hip1)):  # the axes of hip abduction, left and right of the middle
        spec.geom(f"exo_bracket_{side}").pos[1] = y
    _lay_strap(spec, "exo_back_strap", _WAIST, girth)
    return spec


def leg_of(links: ExoLinks, girth: float) -> mujoco.MjSpec:
    """Left leg of the exoskeleton from the leaf `exo_leg`, fitted to a person of a `girth` relative to the mean.

    Body offsets follow from the links' lengths; visual shapes and centres of mass are moved with them.
    """
    spec = read_leaf("exo_leg")
    offsets, _ = chain(links, "l")
    for name, offset in zip(EXO_LEG_BODIES, offsets):
        spec.body(name).pos = offset
    # lengths of `ExoLinks`: from the hip, the abduction hinge is `hip6` back, the arm `hip3` above that hinge, and the
    # bars `hip2` to the side; the heel holder is `ankle1` behind the ankle's axis, and the axis of inversion `ankle2`
    # inwards of the bar. `fromto` of a shape: x, y, z of one end, then of the other, m
    arm, beside = -links.hip6, links.hip2  # x of the hinge behind the hip; y of the bars beside the leg
    spec.geom("exo_hip_hinge").fromto[[0, 3]] += arm - spec.geom("exo_hip_arm").fromto[0]
    spec.geom("exo_hip_arm_out").fromto = [arm, 0, 0, arm, beside, links.hip3]
    spec.geom("exo_hip_arm").fromto = [arm, beside, links.hip3, 0, beside, links.hip3]
    spec.geom("exo_hip_rotor").fromto[[1, 4]] = beside
    spec.geom("exo_ankle_hinge").fromto[[1, 4]] += beside - spec.geom("exo_stirrup").fromto[1]
    # centres of mass, as shares of the lengths of the links
    spec.body("exo_hip_abduction").ipos[:2] = -0.6 * links.hip6, 0.6 * beside
    spec.body("exo_thigh").ipos[2], spec.body("exo_shank").ipos[2] = -0.43 * links.thigh, -0.41 * links.shank
    spec.body("exo_ankle").ipos[:2] = -0.4 * links.ankle1, 0.4 * links.ankle2
    spec.geom("exo_stirrup").fromto[:3] = 0, beside, 0
    for part, length in (("thigh", links.thigh), ("shank", links.shank)):
        _fit_bar(spec, part, length, beside, girth)
    return spec


def _fit_bar(leg: mujoco.MjSpec, part: str, length: float, beside: float, girth: float) -> None:
    """Fits the bar beside a limb and its cuff to a person.

    The bracket bridges the clearance from the bar to the skin, and the strap goes around the limb.

    Args:
        leg: The leaf `exo_leg`.
        part: `thigh` or `shank`.
        length: Of the link, m.
        beside: From the joint's axis sideways to the bar, m.
        girth: Thickness of the limb over that of the mean person.
    """
    band, down = _LIMB[part], CUFF_SHARE[part] * length  # `down`: from the top of the link to the cuff
    gap = beside - band.half_y * girth  # from the skin to the bar
    bar, bracket, pad = (leg.geom(f"exo_{part}_{name}") for name in ("bar", "bracket", "pad"))
    # the link's origin is on the bar, and the limb's axis is `beside` inwards of it, along −y; sizes of boxes are half
    # edges
    bar.pos[2], bar.size[2] = -0.5 * length, 0.5 * length
    bracket.pos[1:], bracket.size[1] = (-0.5 * gap, -down), 0.5 * gap
    pad.pos[1:] = -(gap - pad.size[1]), -down
    _lay_strap(leg, f"exo_{part}_strap", band, girth, -beside, -down)


def _lay_strap(
    spec: mujoco.MjSpec, name: str, band: Band, girth: float, y: float = 0.0, z: float | None = None
) -> None:
    """Lays the flat boxes of a strap on an ellipse about the vertical, around a limb or around the trunk.

    Args:
        spec: Leaf with the boxes `name_0`, `name_1`, ...
        name: Name of the strap.
        band: Ellipse for the mean girth.
        girth: Thickness over that of the mean person.
        y: Middle of the ellipse sideways, m.
        z: Height of the strap, m; None keeps that of the leaf.
    """
    boxes = [geom for geom in spec.geoms if geom.name.startswith(f"{name}_")]
    angle = 2 * math.pi * (np.arange(len(boxes) + 1) + 0.5) / len(boxes)
    half_x, half_y = band.half_x * girth + band.clearance, band.half_y * girth + band.clearance
    # corners of a polygon around the ellipse; each of its sides is one box
    ring = np.column_stack([half_x * np.cos(angle), half_y * np.sin(angle)]) / math.cos(math.pi / len(boxes))
    for box, (a, b) in zip(boxes, pairwise(ring)):  # middle of a side, and the vector from end to end
        at, along = 0.5 * (a + b), b - a
        yaw = 0.5 * math.atan2(along[1], along[0])  # half of it, for the quaternion
        box.pos = [band.middle_x + at[0], y + at[1], box.pos[2] if z is None else z]
        box.size[0] = 0.5 * float(np.hypot(*along))
        box.quat = [math.cos(yaw), 0.0, 0.0, math.sin(yaw)]


def _add_module(leg: mujoco.MjSpec, joint: str, above: mujoco.MjsBody, down: float, module: Module) -> None:
    """Bolts an actuation module to the link above its joint.

    The rotor turns with the joint, and the gear has friction; both become properties of the hinge.

    Args:
        leg: The leaf `exo_leg`.
        joint: `hip` or `knee`.
        above: Body of the link above the joint.
        down: From that body's origin down to the joint, m.
        module: The module.
    """
    housing = read_leaf("exo_module")
    body = housing.body("module")
    # the leaf has a mass of 1 kg, so that its inertia is per kg
    body.mass, body.inertia = module.mass_kg, module.mass_kg * np.asarray(body.inertia)
    attach(above, housing, "module", [0.0, _BESIDE_BAR_M, -down], prefix=f"exo_{joint}_")
    hinge = leg.joint(f"exo_{joint}_flexion")
    hinge.armature, hinge.frictionloss = module.reflected_inertia, module.friction_nm
    hinge.damping[0] = module.viscous_nms
    _limit_torque(hinge, module)


def _limit_torque(hinge: mujoco.MjsJoint, module: Module) -> None:
    """Limits the torque of a joint's motor to the repeated peak torque of its module."""
    hinge.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
    hinge.actfrcrange = [-module.torque_max_nm, module.torque_max_nm]


def add_own_exo(spec: mujoco.MjSpec, pelvis: mujoco.MjsBody, exo: OwnExo) -> None:
    """Attaches a custom exoskeleton to the pelvis: its base and both legs, with the limits of its motors."""
    base = _add_link(spec, pelvis, exo.base)
    for leg in exo.legs.values():
        parent = base  # the body that carries the next link
        for link in leg:
            parent = _add_link(spec, parent, link)
            hinge = parent.add_joint(
                name=link.joint,
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=link.axis,
                range=link.stops.tolist(),
                limited=mujoco.mjtLimited.mjLIMITED_TRUE,
                armature=link.armature,
                frictionloss=link.friction,
            )
            hinge.damping[0] = link.damping
    for name, module in exo.modules.items():
        _limit_torque(spec.joint(hinge_of(name)), module)


def _add_link(spec: mujoco.MjSpec, parent: mujoco.MjsBody, link: Link) -> mujoco.MjsBody:
    """Adds the body of a link with its inertia and visual shapes, without its joint."""
    body = parent.add_body(name=link.name, pos=link.offset)
    inertia, axes = np.linalg.eigh(link.inertia)  # principal moments and axes
    if np.linalg.det(axes) < 0:  # a reflection: reversing one axis makes it a rotation
        axes[:, 0] *= -1
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, axes.ravel())
    body.explicitinertial = True
    body.mass, body.ipos, body.inertia, body.iquat = link.mass, link.com, inertia, quat
    for i, shape in enumerate(link.shapes):
        # a shape is only seen: it has no mass and touches nothing
        geom = body.add_geom(
            type=shape.kind, pos=shape.pos, quat=shape.quat, rgba=shape.rgba, mass=0.0, contype=0, conaffinity=0
        )
        if len(shape.vertices):
            mesh = f"{link.name}_{i}"
            # it weighs nothing here, and a flat mesh has an inertia as a shell only
            spec.add_mesh(
                name=mesh,
                uservert=shape.vertices.ravel(),
                userface=shape.faces.ravel(),
                inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
            )
            geom.meshname = mesh
        else:
            geom.size = shape.size
    return body
