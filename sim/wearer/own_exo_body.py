"""The bodies of a custom exoskeleton."""

from __future__ import annotations

import mujoco
import numpy as np

from stridetwin.sim.exo_description import Link, OwnExo, hinge_of


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
