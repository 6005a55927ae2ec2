"""Input of the controller at each control instant: the reference, and which parts of the soles may bear force."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.config import SIDES
from stridetwin.sim.dynamics.footstep_replanning import Planned
from stridetwin.sim.dynamics.soles import HEEL_POINTS, PER_FOOT, toe_weights
from stridetwin.sim.gait.reference import Reference
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.streams.samples import Array

CONTROL_S = 0.002
_ON_GROUND_RAD = 5e-4  # pitch within which heel and ball both count as on the ground
_LANDS_RAD = 0.02  # the same while the foot comes down: soles sink in, and the landing end may arrive early


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """The reference at N control instants; feet in the order left, right.

    Attributes:
        t: (N,) s.
        q: (N, nq).
        v: (N, nv).
        a: (N, nv).
        share: (N, 2) share of the load.
        touching: (N, 2, points) whether a sole point is planned to bear force.
        force_weight: (N, 2, points) relative weight of force at a point: under a foot that stands on its toes alone, it
            is lower the closer the point is to the planned centre of pressure.
        R_sole: (N, 2, 3, 3) axes in the world of the ground's frame under each foot (of the flat foot); in the air, of
            the next footprint.
        p_sole: (N, 2, 3) m, the footprint.
        p_foot: (N, 2, 3) m; v_foot, a_foot its derivatives.
        com: (N, 2, 2) m and m/s, horizontal centre of mass and its rate.
        swinging: (N, 2) whether a foot is in the air.
        until_landing: (N, 2) s; 0 in stance.
        R_way: (N, 2, 2) columns forward and left of the way.
        near_edge: (N, 2) whether the next footprint lies just before or behind a riser.
        R_foot: (N, 2, 3, 3); w_foot (N, 2, 3) rad/s, world axes; dw_foot its derivative.
    """

    t: Array
    q: Array
    v: Array
    a: Array
    share: Array
    touching: NDArray[np.bool_]
    force_weight: Array
    R_sole: Array
    p_sole: Array
    com: Array
    swinging: NDArray[np.bool_]
    until_landing: Array
    R_way: Array
    near_edge: NDArray[np.bool_]
    p_foot: Array
    v_foot: Array
    a_foot: Array
    R_foot: Array
    w_foot: Array
    dw_foot: Array

    def feet(self, i: int) -> Planned:
        """State of the feet in row i."""
        return Planned(
            swinging=self.swinging[i], until_landing=self.until_landing[i], share=self.share[i], R_way=self.R_way[i],
            near_edge=self.near_edge[i], normal=self.R_sole[i, :, :, 2],
        )  # fmt: skip


def plan_control(reference: Reference, model: mujoco.MjModel, size: Wearer) -> Plan:
    """Samples a reference at the control rate.

    Args:
        reference: The planned motion.
        model: Model of the wearer; its kinematics give the pose of the feet.
        size: Wearer.
    """
    t = np.arange(0.0, reference.duration_s, CONTROL_S)
    q, v, a = reference.state(t)
    n = len(t)
    p, R = np.empty((n, 2, 3)), np.empty((n, 2, 3, 3))
    com = np.empty((n, 2, 2))
    dp, w = np.empty((n, 2, 3)), np.empty((n, 2, 3))
    feet = [model.body(f"foot_{side}").id for side in SIDES]
    data, read = mujoco.MjData(model), np.empty(6)
    for i in range(n):
        data.qpos, data.qvel = q[i], v[i]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_subtreeVel(model, data)
        com[i] = data.subtree_com[1, :2], data.subtree_linvel[1, :2]
        for k, body in enumerate(feet):
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, read, 0)
            p[i, k], R[i, k], w[i, k], dp[i, k] = data.xpos[body], data.xmat[body].reshape(3, 3), read[:3], read[3:]
    loads = reference.loads(t)
    heading = np.mean([np.interp(t, reference.grid, reference.paths[side].heading) for side in SIDES], axis=0)
    R_way = np.stack([np.cos(heading), -np.sin(heading), np.sin(heading), np.cos(heading)], -1).reshape(-1, 2, 2)
    touching, force_weight = np.zeros((n, 2, PER_FOOT), dtype=bool), np.ones((n, 2, PER_FOOT))
    R_sole, p_sole = np.empty((n, 2, 3, 3)), np.empty((n, 2, 3))
    swinging, near_edge = np.zeros((n, 2), dtype=bool), np.zeros((n, 2), dtype=bool)
    until_landing = np.zeros((n, 2))
    for k, side in enumerate(SIDES):
        for before, after in pairwise(reference.steps[side]):
            air = (t > before.t_off) & (t < after.t_touch)
            swinging[air, k] = True
            until_landing[air, k] = after.t_touch - t[air]
            near_edge[air, k] = after.mode in ("SA", "SD") or after.departure != "push"
        own = reference.steps[side]
        at = np.searchsorted([step.t_off for step in own], t)
        R_sole[:, k] = np.array([step.R_world_sole for step in own])[at]
        p_sole[:, k] = np.array([step.p_foot_in_world for step in own])[at]
        pitch = np.interp(t, reference.grid, reference.paths[side].pitch)
        for step in reference.steps[side]:
            on = (t >= step.t_touch) & (t <= step.t_off)
            flat = on & (np.abs(pitch) < _ON_GROUND_RAD)
            within = np.where(np.cumsum(flat) > 0, _ON_GROUND_RAD, _LANDS_RAD)[on, None]
            touching[on, k, :HEEL_POINTS] = pitch[on, None] < within
            touching[on, k, HEEL_POINTS:] = pitch[on, None] > -within
            toes = on & (pitch >= _ON_GROUND_RAD)
            x = (loads[toes, 4 * k + 1 : 4 * k + 4] - step.p_foot_in_world) @ step.R_world_sole[:, 0]
            force_weight[toes, k, HEEL_POINTS:] = toe_weights(size, x)
    return Plan(
        t=t, q=q, v=v, a=a, share=loads[:, [0, 4]], touching=touching, force_weight=force_weight, R_sole=R_sole,
        p_sole=p_sole, com=com, swinging=swinging, until_landing=until_landing, R_way=R_way, near_edge=near_edge,
        p_foot=p, v_foot=dp, a_foot=_rate(dp), R_foot=R, w_foot=w, dw_foot=_rate(w),
    )  # fmt: skip


def _rate(x: Array) -> Array:
    return np.asarray(np.gradient(x, CONTROL_S, axis=0), dtype=float)
