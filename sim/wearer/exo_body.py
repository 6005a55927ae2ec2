"""The bodies of an exoskeleton in the wearer's model: the built-in one from its MJCF template, or a custom one."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import pairwise

import mujoco
import numpy as np
from jinja2 import Environment, StrictUndefined

from stridetwin.assets import mjcf
from stridetwin.sim.config import SIDES
from stridetwin.sim.exo_description import Link, Module, OwnExo, hinge_of
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.sim.wearer.exo_couplings import leg_frame
from stridetwin.sim.wearer.exoskeleton import CUFF_SHARE
from stridetwin.streams.samples import Array


def exoskeleton(size: Wearer, modules: Mapping[str, Module]) -> mujoco.MjSpec:
    """The built-in exoskeleton, in the frame of the pelvis: back panel `exo_back`, and the bodies of both legs.

    Args:
        size: Wearer with its links.
        modules: Actuation modules by joint (`exoskeleton.modules`).
    """
    text = Environment(undefined=StrictUndefined).from_string(mjcf("exoskeleton")).render(
        links=size.exo, girth=size.girth, legs={side: leg_frame(size, side) for side in SIDES}, modules=modules,
        cuffs=CUFF_SHARE, band=_band, xyz=lambda values: " ".join(map(str, values)),
    )  # fmt: skip
    return mujoco.MjSpec.from_string(text)


def _band(
    middle: tuple[float, float, float], radii: tuple[float, float], half_width: float, parts: int
) -> Iterator[dict[str, Array | list[float]]]:
    """Flat boxes on an ellipse about the vertical: a strap around a limb or the trunk."""
    angle = 2 * math.pi * (np.arange(parts + 1) + 0.5) / parts
    ring = np.column_stack([radii[0] * np.cos(angle), radii[1] * np.sin(angle)]) / math.cos(math.pi / parts)
    for a, b in pairwise(ring):
        at, along = 0.5 * (a + b), b - a
        yaw = 0.5 * math.atan2(along[1], along[0])
        yield {
            "pos": np.asarray(middle, dtype=float) + [*at, 0.0],
            "size": [0.5 * float(np.hypot(*along)), 0.003, half_width],
            "quat": [math.cos(yaw), 0.0, 0.0, math.sin(yaw)],
        }


def add_own_exo(spec: mujoco.MjSpec, pelvis: mujoco.MjsBody, own: OwnExo) -> None:
    """Attaches the exoskeleton to the pelvis."""
    base = _add(spec, pelvis, own.base)
    for leg in own.legs.values():
        parent = base
        for link in leg:
            parent = _add(spec, parent, link)
            hinge = parent.add_joint(
                name=link.joint, type=mujoco.mjtJoint.mjJNT_HINGE, axis=link.axis, range=link.stops.tolist(),
                limited=mujoco.mjtLimited.mjLIMITED_TRUE, armature=link.armature, frictionloss=link.friction,
            )  # fmt: skip
            hinge.damping[0] = link.damping
    for name, module in own.modules.items():
        hinge = spec.joint(hinge_of(name))
        hinge.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
        hinge.actfrcrange = [-module.torque_max_nm, module.torque_max_nm]


def _add(spec: mujoco.MjSpec, parent: mujoco.MjsBody, link: Link) -> mujoco.MjsBody:
    body = parent.add_body(name=link.name, pos=link.offset)
    inertia, axes = np.linalg.eigh(link.inertia)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, axes.ravel())
    body.explicitinertial = True
    body.mass, body.ipos, body.inertia, body.iquat = link.mass, link.com, inertia, quat
    for i, shape in enumerate(link.shapes):
        geom = body.add_geom(
            type=shape.kind, pos=shape.pos, quat=shape.quat, rgba=shape.rgba, mass=0.0, contype=0, conaffinity=0
        )
        if len(shape.vertices):
            mesh = f"{link.name}_{i}"
            # it weighs nothing here, and a flat mesh has an inertia as a shell only
            spec.add_mesh(
                name=mesh, uservert=shape.vertices.ravel(), userface=shape.faces.ravel(),
                inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
            )  # fmt: skip
            geom.meshname = mesh
        else:
            geom.size = shape.size
    return body
