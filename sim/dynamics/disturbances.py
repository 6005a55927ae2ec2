"""Disturbances that the wearer's controller does not know: body mass, floor height, pushes, joint noise, missteps."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from stridetwin.sim.config import SIDES, Dynamics
from stridetwin.sim.dynamics.plan import Plan
from stridetwin.streams.samples import Array


def disturbed(model: mujoco.MjModel, dynamics: Dynamics) -> mujoco.MjModel:
    """Copy of the model with the true body mass and floor height."""
    model = copy.copy(model)
    model.body_mass *= 1.0 + dynamics.mass_error
    model.body_inertia *= 1.0 + dynamics.mass_error
    mujoco.mj_setConst(model, mujoco.MjData(model))
    for i in range(model.ngeom):
        name = model.geom(i).name
        if name == "ground" or name.startswith("terrain_"):
            model.geom_pos[i, 2] += dynamics.floor_offset_m
        elif name.startswith("sole_"):
            model.geom_friction[i, 0] = dynamics.friction
    return model


def pushing(dynamics: Dynamics, plan: Plan) -> Array:
    """(N, 2) horizontal force on the pelvis at each instant of a plan, N, world."""
    force = np.zeros((len(plan.t), 2))
    for push in dynamics.pushes:
        during = (plan.t >= push.at_s) & (plan.t < push.at_s + push.duration_s)
        force[during] += plan.R_way[during] @ [push.forward_n, push.left_n]
    return force


def misplaced(dynamics: Dynamics, plan: Plan) -> Array:
    """(N, 2, 2) m, world, offset of each foot's landing from its foothold, at each instant of a plan."""
    off = np.zeros((len(plan.t), len(SIDES), 2))
    for misstep in dynamics.missteps:
        landing = plan.t[:, None] + plan.until_landing
        landing[~plan.swinging | (landing < misstep.at_s)] = np.inf
        first = landing.min()
        if not np.isfinite(first):
            continue  # the last foot has already landed
        foot = int(landing.min(axis=0).argmin())
        during = np.isclose(landing[:, foot], first)
        off[during, foot] += plan.R_way[during] @ [misstep.forward_m, misstep.left_m]
    return off
