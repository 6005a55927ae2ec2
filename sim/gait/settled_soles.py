"""Footsteps on a floor that is not exactly level: each sole lies on the ground that is under it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stridetwin.sim.gait.footsteps import Footstep
from stridetwin.sim.wearer.dimensions import Shoe
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.samples import Array

_SAME_GROUND_M = 0.012  # points of a sole that are farther from the others are beyond an edge; risers have 20 mm
_TILT_WEIGHT = 1e-4  # m², of a tilt of 0 beside the points, for soles that hardly rest on the ground


def settle_soles(footsteps: Sequence[Footstep], shoe: Shoe, terrain: Terrain) -> list[Footstep]:
    """Footsteps whose soles lie on the plane that fits the ground under them best.

    Args:
        footsteps: Planned on the exact ground.
        shoe: Their sole.
        terrain: The ground.
    """
    x, y = np.meshgrid(
        np.linspace(shoe.heel_back_x, shoe.toe_hinge_x, 5), np.linspace(-shoe.half_width, shoe.half_width, 3)
    )
    sole = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return [_settle(step, sole, terrain) for step in footsteps]


def _settle(step: Footstep, sole: Array, terrain: Terrain) -> Footstep:
    """A footstep on the ground under the points (K, 3) m of its sole, which are given in the foot's frame."""
    points = step.p_foot_in_world + sole @ step.R_world_sole.T
    above = terrain.height(points[:, :2]) - points[:, 2]  # m, of the ground over the planned sole
    on_ground = abs(above - np.median(above)) < _SAME_GROUND_M
    # rise of the ground at the foot's origin, and its slopes along and across the foot, by ridge regression
    A = np.column_stack([np.ones(len(sole)), sole[:, :2]])[on_ground]
    rise, along, across = np.linalg.solve(A.T @ A + np.diag([0.0, _TILT_WEIGHT, _TILT_WEIGHT]), A.T @ above[on_ground])
    tilt = np.eye(3)  # of the settled foot in the planned one: x and y in the new plane, x ahead as before
    tilt[:, 0] = np.array([1.0, 0.0, along]) / np.hypot(1.0, along)
    tilt[:, 2] = np.array([-along, -across, 1.0]) / np.sqrt(1.0 + along**2 + across**2)
    tilt[:, 1] = np.cross(tilt[:, 2], tilt[:, 0])
    up = step.p_foot_in_world + np.array([0.0, 0.0, float(rise)])
    return replace(step, p_foot_in_world=up, R_world_sole=step.R_world_sole @ tilt)
