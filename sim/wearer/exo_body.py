"""The exoskeleton as MuJoCo bodies: joints and masses where the D-H table puts them, and its visual shape."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from stridetwin.sim.config import SIDES
from stridetwin.sim.exo_description import Module
from stridetwin.sim.wearer.exoskeleton import CUFF_SHARE, EXO_LEG_BODIES, EXO_LEG_JOINTS, RANGE_RAD, ExoLinks, chain
from stridetwin.streams.samples import Array

# 9.5 kg: back panel with controllers and batteries, and twice the leg. Links of a leg: mass, kg; centre of mass as a
# share of the link; inertia about it, kg m²
_BACK_KG = 3.5
_LINKS = {
    "exo_hip_abduction": (0.4, 0.0, (0.0030, 0.0050, 0.0040)),
    "exo_hip_rotation": (0.4, 0.5, (0.0008, 0.0008, 0.0006)),
    "exo_thigh": (0.9, 0.43, (0.0120, 0.0120, 0.0010)),
    "exo_shank": (0.7, 0.41, (0.0090, 0.0090, 0.0006)),
    "exo_ankle": (0.2, 0.5, (0.0010, 0.0006, 0.0012)),
    "exo_foot": (0.4, 0.0, (0.0010, 0.0012, 0.0012)),
}
_MATERIALS = {
    "exo_frame": (0.14, 0.15, 0.17, 1.0), "exo_accent": (0.93, 0.47, 0.10, 1.0), "exo_strap": (0.30, 0.31, 0.34, 1.0),
    "exo_module": (0.55, 0.57, 0.60, 1.0),
}  # fmt: skip
_STRAP_PARTS = 10


def add_exoskeleton(
    spec: mujoco.MjSpec, pelvis: mujoco.MjsBody, links: ExoLinks, girth: float, modules: Mapping[str, Module]
) -> None:
    """Attaches the exoskeleton to the pelvis: back panel `exo_back`, and the bodies `EXO_LEG_BODIES` of each leg.

    Args:
        spec: Model.
        pelvis: Body that wears the back panel.
        links: Lengths.
        girth: Thickness of trunk and limbs over that of the mean person.
        modules: Actuation modules by joint; `actuation.modules`.
    """
    for name, rgba in _MATERIALS.items():
        spec.add_material(name=name, rgba=rgba, specular=0.4, shininess=0.5)
    _back(pelvis, links, girth)
    for side in SIDES:
        leg = _leg(pelvis, links, side)
        _dress(leg, links, girth, 1.0 if side == "l" else -1.0)
        _power(leg, links, side, modules)


def _leg(pelvis: mujoco.MjsBody, links: ExoLinks, side: str) -> dict[str, mujoco.MjsBody]:
    """The six bodies of a leg with their joints and masses."""
    offsets, axes = chain(links, side)
    beyond = np.vstack([offsets[1:], [[0.02, 0.0, -0.04]]])
    bodies, parent = {}, pelvis
    for i, name in enumerate(EXO_LEG_BODIES):
        body = parent.add_body(name=f"{name}_{side}", pos=offsets[i])
        body.add_joint(
            name=f"{EXO_LEG_JOINTS[i]}_{side}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=axes[i],
            range=RANGE_RAD[i].tolist(), limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        )  # fmt: skip
        mass, share, inertia = _LINKS[name]
        body.explicitinertial = True
        body.mass, body.inertia, body.iquat = mass, list(inertia), [1, 0, 0, 0]
        body.ipos = share * beyond[i]
        bodies[name] = parent = body
    outer = np.array([0.0, 1.0 if side == "l" else -1.0, 0.0])
    # the arm reaches round the hip from the back panel; the stirrup from the bar round the heel
    bodies["exo_hip_abduction"].ipos = [-0.6 * links.hip6, *(0.6 * (offsets[1] + [0, 0, links.hip4]))[1:]]
    bodies["exo_shank"].ipos = [0, 0, -0.41 * links.shank]
    bodies["exo_ankle"].ipos = 0.4 * links.ankle2 * outer - [0.4 * links.ankle1, 0, 0]
    bodies["exo_foot"].ipos = [0.03, 0.0, -0.05]
    return bodies


def _power(
    leg: Mapping[str, mujoco.MjsBody], links: ExoLinks, side: str, modules: Mapping[str, Module]
) -> None:  # fmt: skip
    """Bolts the modules to the links above their joints and adds rotor inertia and gear friction to the joints."""
    outer = 1.0 if side == "l" else -1.0
    for joint, carrier, driven, down in (
        ("hip", "exo_hip_rotation", "exo_thigh", links.hip5), ("knee", "exo_thigh", "exo_shank", links.thigh),
    ):  # fmt: skip
        module = modules.get(f"{joint}_{side}")
        if module is None:
            continue
        hinge = leg[driven].joints[0]
        hinge.armature, hinge.frictionloss = module.reflected_inertia, module.friction_nm
        hinge.damping[0] = module.viscous_nms
        hinge.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
        hinge.actfrcrange = [-module.torque_max_nm, module.torque_max_nm]
        housing = leg[carrier].add_body(name=f"exo_{joint}_module_{side}", pos=[0, 0.052 * outer, -down])
        housing.explicitinertial = True
        housing.mass, housing.ipos, housing.iquat = module.mass_kg, [0, 0, 0], [1, 0, 0, 0]
        housing.inertia = (module.mass_kg * np.array([0.0012, 0.0014, 0.0012])).tolist()
        _rod(housing, f"exo_{joint}_gear_{side}", (0, -0.022 * outer, 0), (0, 0.010 * outer, 0), 0.044, "exo_module")
        _rod(housing, f"exo_{joint}_motor_{side}", (0, 0.010 * outer, 0), (0, 0.034 * outer, 0), 0.036, "exo_accent")


def _back(pelvis: mujoco.MjsBody, links: ExoLinks, girth: float) -> None:
    body = pelvis.add_body(name="exo_back")
    body.explicitinertial = True
    body.mass, body.iquat = _BACK_KG, [1, 0, 0, 0]
    body.ipos, body.inertia = [-links.hip6, 0, 0.09], [0.06, 0.03, 0.05]
    x = -links.hip6
    _box(body, "exo_back_plate", (x, 0, 0.11), (0.012, 0.105, 0.120), "exo_frame")
    _box(body, "exo_back_box", (x - 0.034, 0, 0.13), (0.022, 0.080, 0.075), "exo_accent")
    lift = links.hip4 + links.hip5 - links.hip3
    for y in (links.hip1, -links.hip1):
        _box(body, "", (x, y, 0.5 * lift + 0.02), (0.010, 0.020, 0.045), "exo_frame")
    _strap(body, (-0.012, 0, 0.055), (0.104 * girth + 0.008, 0.158 * girth + 0.008), 0.026, 14)


def _dress(leg: Mapping[str, mujoco.MjsBody], links: ExoLinks, girth: float, outer: float) -> None:
    """Adds the visual shape of one leg; `outer` is 1 on the left and -1 on the right."""
    hip, rotor, thigh, shank, ankle, foot = (leg[name] for name in EXO_LEG_BODIES)
    beside = links.hip2 * outer
    corner = (-links.hip6, beside, links.hip3)
    _rod(hip, "", (-links.hip6 - 0.022, 0, 0), (-links.hip6 + 0.012, 0, 0), 0.026, "exo_accent")
    _bar(hip, (-links.hip6, 0, 0), corner, 0.014)
    _bar(hip, corner, (0, beside, links.hip3), 0.014)
    _rod(hip, "", (0, beside, links.hip3 + 0.016), (0, beside, links.hip3 - links.hip4), 0.026, "exo_frame")
    _rod(rotor, "", (0, 0, 0.0), (0, 0, -links.hip5 + 0.02), 0.018, "exo_accent")
    _rod(rotor, "", (0, 0.022 * outer, -links.hip5), (0, -0.006 * outer, -links.hip5), 0.034, "exo_frame")
    _rod(thigh, "", (0, -0.006 * outer, 0), (0, -0.020 * outer, 0), 0.038, "exo_accent")
    for bar, length, width, skin, middle, down in (
        (thigh, links.thigh, 0.018, 0.079 * girth, 0.004, CUFF_SHARE["thigh"] * links.thigh),
        (shank, links.shank, 0.015, 0.059 * girth, -0.010, CUFF_SHARE["shank"] * links.shank),
    ):
        _box(bar, "", (0, 0, -0.5 * length), (width, 0.007, 0.5 * length), "exo_frame")
        gap = links.hip2 - skin  # from the bar to the skin
        _box(bar, "", (0, -0.5 * gap * outer, -down), (0.016, 0.5 * gap, 0.012), "exo_frame")
        _box(bar, "", (middle, -(gap - 0.006) * outer, -down), (0.045, 0.006, 0.050), "exo_strap")
        _strap(bar, (middle, -beside, -down), (skin + 0.005, skin + 0.005), 0.022, _STRAP_PARTS)
    _rod(shank, "", (0, 0.020 * outer, 0), (0, -0.010 * outer, 0), 0.034, "exo_accent")
    _rod(ankle, "", (0, beside + 0.016 * outer, 0), (0, beside - 0.012 * outer, 0), 0.024, "exo_accent")
    behind = -links.ankle1 - 0.012
    _bar(ankle, (0, beside, 0), (behind, 0.06 * outer, 0), 0.009)
    _bar(ankle, (behind, 0.06 * outer, 0), (behind, 0, 0), 0.009)
    _rod(foot, "", (-0.016, 0, 0), (0.004, 0, 0), 0.014, "exo_accent")
    _box(foot, "", (-0.005, 0, -0.045), (0.004, 0.018, 0.045), "exo_frame")
    for y in (-0.040, 0.040):
        _box(foot, "", (0.035, y, -0.083), (0.042, 0.003, 0.012), "exo_frame")
    _box(foot, "", (-0.005, 0, -0.083), (0.004, 0.040, 0.012), "exo_frame")
    for y in (-1, 1):  # the buckle's strap over the instep
        _bar(foot, (0.075, 0.041 * y, -0.080), (0.092, 0.031 * y, -0.030), 0.006, "exo_strap")
        _bar(foot, (0.092, 0.031 * y, -0.030), (0.092, 0.0, -0.008), 0.006, "exo_strap")


def _strap(body: mujoco.MjsBody, middle: ArrayLike, radii: tuple[float, float], half_width: float, parts: int) -> None:
    """Adds a band around a limb or the trunk, made of flat boxes on an ellipse about the vertical."""
    angle = 2 * math.pi * (np.arange(parts + 1) + 0.5) / parts
    ring = np.column_stack([radii[0] * np.cos(angle), radii[1] * np.sin(angle)]) / math.cos(math.pi / parts)
    for a, b in pairwise(ring):
        at, along = 0.5 * (a + b), b - a
        yaw = 0.5 * math.atan2(along[1], along[0])
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, pos=np.asarray(middle, dtype=float) + [*at, 0.0],
            size=[0.5 * float(np.hypot(*along)), 0.003, half_width], quat=[math.cos(yaw), 0, 0, math.sin(yaw)],
            material="exo_strap", **_VISUAL,
        )  # fmt: skip


def _box(body: mujoco.MjsBody, name: str, pos: ArrayLike, size: ArrayLike, material: str) -> None:
    body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=pos, size=size, material=material, **_VISUAL)


def _bar(body: mujoco.MjsBody, a: ArrayLike, b: ArrayLike, radius: float, material: str = "exo_frame") -> None:
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=_between(a, b), size=[radius, 0, 0], material=material, **_VISUAL
    )


def _rod(body: mujoco.MjsBody, name: str, a: ArrayLike, b: ArrayLike, radius: float, material: str) -> None:
    body.add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_CYLINDER, fromto=_between(a, b), size=[radius, 0, 0], material=material,
        **_VISUAL,
    )  # fmt: skip


def _between(a: ArrayLike, b: ArrayLike) -> Array:
    return np.concatenate([np.asarray(a, dtype=float), np.asarray(b, dtype=float)])


_VISUAL = {"mass": 0.0, "contype": 0, "conaffinity": 0}
