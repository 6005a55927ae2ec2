"""Feet that are turned outward against the knees: inverse kinematics, model and planned walks agree."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from stridetwin.sim.gait.leg_ik import solve_leg
from stridetwin.sim.motion.skeleton import Skeleton, lengths_of, with_twist
from stridetwin.sim.people import Person
from stridetwin.streams.algebra.arrays import from_euler


@pytest.mark.parametrize("side", ["l", "r"])
@pytest.mark.parametrize("twist_deg", [-20.0, 0.0, 15.0, 40.0])
def test_joint_angles_bring_the_foot_to_its_pose(side: str, twist_deg: float) -> None:
    skeleton = Skeleton.of(with_twist(lengths_of(Person()), np.radians(twist_deg)))
    rng, n = np.random.default_rng(3), 50
    out, body = (1.0 if side == "l" else -1.0), skeleton.size.body
    p_pelvis = np.tile([0.2, -0.1, body.thigh_m + body.shank_m], (n, 1))
    R_pelvis = from_euler(rng.uniform(-0.2, 0.2, (n, 3)))
    p_foot = np.array([0.2, -0.1 + out * body.hip_half_width_m, 0.0]) + rng.uniform(-0.2, 0.2, (n, 3))
    p_foot[:, 2] = np.abs(p_foot[:, 2])
    R_foot = from_euler(rng.uniform(-0.3, 0.3, (n, 3)))
    leg = solve_leg(skeleton.size, side, p_pelvis, R_pelvis, p_foot, R_foot, np.radians(3.0))
    assert (leg.stretch < 1e-12).mean() > 0.5
    x = np.zeros((n, len(skeleton.layout.names)))
    for name in ("hip_flexion", "hip_adduction", "hip_rotation", "knee_flexion", "ankle_dorsiflexion"):
        x[:, skeleton.column(f"{name}_{side}")] = getattr(leg, name)
    x[:, skeleton.column(f"ankle_inversion_{side}")] = leg.ankle_inversion
    poses = skeleton.poses(x)  # in the pelvis' frame, as the root of these coordinates is at the origin
    foot = skeleton.index(f"foot_{side}")
    R = R_pelvis @ poses.R[:, foot]
    p = p_pelvis + np.einsum("nij,nj->ni", R_pelvis, poses.p[:, foot])
    reached = leg.stretch < 1e-12
    assert_allclose(R[reached], R_foot[reached], atol=1e-9)
    assert_allclose(p[reached], p_foot[reached], atol=1e-9)
