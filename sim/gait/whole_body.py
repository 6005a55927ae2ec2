"""The wearer's coordinates from pelvis, feet and posture, and the zero-moment point of the resulting motion."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stridetwin.sim.body import LEG_JOINTS, Wearer
from stridetwin.sim.config import SIDES
from stridetwin.sim.coordinates import Coordinates
from stridetwin.sim.exoskeleton import leg_frame
from stridetwin.sim.gait.foot_path import FootPath
from stridetwin.sim.gait.leg_ik import LegAngles, solve_leg
from stridetwin.sim.gait.pelvis import KNEE_HARD_MIN_RAD
from stridetwin.sim.gait.posture import Posture
from stridetwin.streams.samples import Array


def legs(size: Wearer, p_pelvis: Array, R_pelvis: Array, paths: Mapping[str, FootPath]) -> dict[str, LegAngles]:
    """Angles of both legs that bring the feet to their paths under a pelvis at (N, 3), (N, 3, 3)."""
    return {
        side: solve_leg(size, side, p_pelvis, R_pelvis, paths[side].p_foot_in_world, paths[side].R_world_foot,
                        KNEE_HARD_MIN_RAD)
        for side in SIDES
    }  # fmt: skip


def coordinates(
    size: Wearer, layout: Coordinates, p_pelvis: Array, pose: Posture, legs_: Mapping[str, LegAngles],
    exo: Mapping[str, Array], paths: Mapping[str, FootPath],
) -> Array:  # fmt: skip
    """(N, names) coordinates in the order of `layout.names`; `exo` holds (N, J) angles by side, or is empty."""
    columns = dict(zip(layout.ROOT, np.column_stack([p_pelvis, pose.pelvis]).T))
    columns |= pose.joints
    for side in SIDES:
        for joint in LEG_JOINTS[:-1]:
            columns[f"{joint}_{side}"] = getattr(legs_[side], joint)
        columns[f"toe_extension_{side}"] = paths[side].toe_extension
        if side in exo:
            columns |= dict(zip(leg_frame(size, side).joints, exo[side].T))
    return np.column_stack([columns[name] for name in layout.names])


def zero_moment_point(
    p_root: Array, force: Array, moment: Array, com_z: Array, z: Array, mass: float
) -> tuple[Array, Array]:  # fmt: skip
    """Zero-moment point of a motion.

    Args:
        p_root: (N, 3) m, root in the world.
        force: (N, 3) N, external force that the motion needs, world axes (`rigid_tree.root_wrench`).
        moment: (N, 3) N m, likewise, about the root.
        com_z: (N,) height of the centre of mass, m.
        z: (N,) height of the ground, m.
        mass: Of the whole body, kg.

    Returns:
        (N, 2) zero-moment point at height z, m, and (N,) kappa for its correction by `pelvis.cart_table`, s².
    """
    x = p_root[:, 0] + ((z - p_root[:, 2]) * force[:, 0] - moment[:, 1]) / force[:, 2]
    y = p_root[:, 1] + ((z - p_root[:, 2]) * force[:, 1] + moment[:, 0]) / force[:, 2]
    return np.stack([x, y], -1), mass * (com_z - z) / force[:, 2]
