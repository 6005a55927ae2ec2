"""The wearer: a person scaled to height and mass, shoes and exoskeleton, composed with MjSpec from leaf files.

Every body's frame is x forward, y left, z up when the wearer stands upright. The foot's frame has its origin on the
sole under the heel's centre.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from stridetwin.sim.config import SIDES, Exo, Person
from stridetwin.sim.exo_description import OwnExo
from stridetwin.sim.wearer.anthropometry import Anthropometry, anthropometry, compute_girth, leaf_scales
from stridetwin.sim.wearer.dimensions import Shoe, Wearer
from stridetwin.sim.wearer.exo_body import add_exoskeleton, add_own_exo
from stridetwin.sim.wearer.exoskeleton import ExoLinks, fit_links, modules
from stridetwin.sim.wearer.leaves import attach, read_leaf, silence_prefix_warnings
from stridetwin.streams.algebra.arrays import rot_z

# hinges of a leg from the hip to the toes; in the model, each name ends with the side
LEG_JOINTS = (
    "hip_flexion",
    "hip_adduction",
    "hip_rotation",
    "knee_flexion",
    "ankle_dorsiflexion",
    "ankle_inversion",
    "toe_extension",
)
# bodies whose motion the twin reports
_TRACKED = ("pelvis", "torso", "head", *(f"{b}_{s}" for s in SIDES for b in ("thigh", "shank", "foot", "toe")))
_TRACKED_EXO = ("exo_back", *(f"exo_{b}_{s}" for s in SIDES for b in ("thigh", "shank", "foot")))


def fit_wearer(person: Person, with_exo: bool = True) -> Wearer:
    """Dimensions of a person in shoes, and of the built-in exoskeleton fitted to them.

    Args:
        person: The person.
        with_exo: Whether they wear the exoskeleton.

    Raises:
        ConfigError: A person outside the range of the tables.
    """
    body = anthropometry(person)
    girth = compute_girth(person)
    k = leaf_scales(body)["shoe"]
    # the heel's back is 0.045 m behind the foot's origin in every shoe; the hinge moves with the length
    shoe = Shoe(
        heel_back_x=-0.045,
        toe_hinge_x=0.145 * k,
        toe_hinge_z=0.024,
        toe_tip_x=body.shoe_length_m - 0.045,
        half_width=0.037,
    )
    ankle_x = 0.020
    links = fit_links(body, girth, ankle_x, shoe.heel_back_x) if with_exo else None
    return Wearer(body=body, girth=girth, shoe=shoe, ankle_x=ankle_x, exo=links)


def bodies_to_track(size: Wearer) -> tuple[str, ...]:
    """Names of the bodies whose motion the twin reports: trunk, head, legs, and the links of the exoskeleton."""
    if size.exo is None:
        return _TRACKED
    return _TRACKED + (_TRACKED_EXO if isinstance(size.exo, ExoLinks) else size.exo.bodies)


def add_wearer(spec: mujoco.MjSpec, person: Person, exo: Exo | None) -> Wearer:
    """Attaches person, shoes and exoskeleton to the world of a model, with a free root.

    Args:
        spec: The model.
        person: The person.
        exo: The exoskeleton; None for a person without it.

    Returns:
        Dimensions of the wearer.

    Raises:
        ConfigError: A person outside the range of the tables, or an unknown mode of the exoskeleton.
    """
    spec.compiler.degree = False  # as in the leaf files
    size = fit_wearer(person, exo is not None)
    if exo is not None and exo.user_exo is not None:
        size = replace(size, exo=exo.user_exo)
    body, girth = size.body, size.girth
    root = spec.worldbody.add_body(name="root", pos=[0, 0, body.thigh_m + body.shank_m + body.ankle_height_m])
    scales = leaf_scales(body)
    trunk_scale = scales["trunk"]
    attach(
        root, _scale_leaf("trunk", {"pelvis": trunk_scale, "torso": trunk_scale, "head": trunk_scale}, girth), "pelvis"
    )
    spec.body("root").add_freejoint(name="root")
    pelvis, torso = spec.body("pelvis"), spec.body("torso")

    for side in SIDES:
        y = 1.0 if side == "l" else -1.0  # direction outwards
        leg = _scale_leaf("leg", {name: scales[name] for name in ("thigh", "shank")}, girth)
        ankle_in_foot = np.array([size.ankle_x, 0.0, body.ankle_height_m])
        twist = body.shank_twist_rad  # of the left leg, whose mirror image the right one is
        leg.body("foot").quat = [np.cos(twist / 2), 0, 0, np.sin(twist / 2)]
        leg.body("foot").pos = np.array([0.0, 0.0, -body.shank_m]) - rot_z(np.array(twist)) @ ankle_in_foot
        for joint in ("ankle_dorsiflexion", "ankle_inversion"):
            leg.joint(joint).pos = ankle_in_foot
        leg.body("toe").pos = [size.shoe.toe_hinge_x, 0, size.shoe.toe_hinge_z]
        attach(pelvis, leg, "thigh", [0, y * body.hip_half_width_m, 0], side)
        for part, carrier in (("shoe_rear", "foot"), ("shoe_toe", "toe")):
            shoe = _scale_leaf(part, {}, 1.0)
            _stretch_foot(shoe, scales["shoe"])
            attach(spec.body(f"{carrier}_{side}"), shoe, part, side=side)
        arm = _scale_leaf("arm", {name: scales[name] for name in ("upper_arm", "forearm")}, girth)
        shoulder = np.array([0.0, y * body.shoulder_half_width_m, 0.395 * trunk_scale])  # m, in the torso's frame
        attach(torso, arm, "upper_arm", shoulder, side)
    _set_inertials(spec, body)
    if exo is not None and isinstance(size.exo, ExoLinks):
        add_exoskeleton(pelvis, size.exo, girth, modules(exo))
    elif isinstance(size.exo, OwnExo):
        add_own_exo(spec, pelvis, size.exo)
    return size


def compile_model(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compiles a model, without MuJoCo's warnings about empty prefixes."""
    with silence_prefix_warnings():
        return spec.compile()


def _scale_leaf(name: str, length_scale: dict[str, float], girth: float) -> mujoco.MjSpec:
    """Leaf file scaled to a person.

    Args:
        name: Name of the leaf.
        length_scale: Factor on the length of each body; others keep theirs.
        girth: Factor on the thickness.
    """
    spec = read_leaf(name)
    for body in spec.bodies[1:]:  # without the world
        k = length_scale.get(body.name, 1.0)
        for child in body.bodies:
            child.pos = np.asarray(child.pos) * k
        for geom in body.geoms:
            geom.pos = np.asarray(geom.pos) * k
            if length_scale:  # the shoes keep their shapes: `_stretch_foot` fits them
                is_capsule = geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE
                # sizes: radius and half length of a capsule; otherwise thickness along x and y, and length along z
                geom.size = np.asarray(geom.size) * ([girth, k, 1.0] if is_capsule else [girth, girth, k])
    return spec


def _stretch_foot(shoe: mujoco.MjSpec, k: float) -> None:
    """Stretches a shoe by the factor `k` along the foot; the heel stays as it is, so heel mounts fit every shoe."""
    for geom in [g for b in shoe.bodies for g in b.geoms]:
        stretch = 1.0 if geom.name in ("sole_heel", "upper_heel", "ankle") else k
        geom.pos = np.asarray(geom.pos) * [stretch, 1.0, 1.0]
        geom.size = np.asarray(geom.size) * [stretch, 1.0, 1.0]


def _set_inertials(spec: mujoco.MjSpec, body: Anthropometry) -> None:
    """Sets masses and inertias of the wearer's bodies; their geoms get no mass and do not collide."""
    for target in spec.bodies[1:]:
        for geom in target.geoms:
            geom.mass = geom.contype = geom.conaffinity = 0
        part = body.inertials.get(target.name.removesuffix("_l").removesuffix("_r"))
        if part is not None:
            target.explicitinertial = True
            target.mass, target.ipos, target.inertia = part.mass, part.com, part.inertia
            target.iquat = [1, 0, 0, 0]  # the moments of inertia are about the body's axes
