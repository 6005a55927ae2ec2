"""Input of the controller at each control instant: the reference, and which parts of the soles may bear force."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np

from stridetwin.sim.config import SIDES
from stridetwin.sim.dynamics.footstep_replanning import PlannedFeet
from stridetwin.sim.dynamics.soles import HEEL_POINTS, PER_FOOT, toe_weights
from stridetwin.sim.gait.reference import Reference
from stridetwin.sim.kinematics.smooth import ease
from stridetwin.streams.samples import Array

CONTROL_S = 0.002  # period of the controller
_ON_GROUND_RAD = 5e-4  # pitch within which heel and ball both count as on the ground
_LANDS_RAD = 0.02  # the same while the foot comes down: soles sink in, and the landing end may arrive early
_UNLOADS_S = 0.06  # before the heel rises, in which its load goes to the ball
_UNLOADED = 30.0  # weight of force at the heel when it rises, relative to that of a flat foot


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """The reference at N control instants.

    Attributes:
        t: (N,) s.
        q: (N, nq) positions in MuJoCo's layout.
        v: (N, nv) velocities.
        a: (N, nv) accelerations.
        com: (N, 2, 2) m and m/s, horizontal centre of mass and its rate.
        feet: Plan of the feet, each with a leading axis of N.
    """

    t: Array
    q: Array
    v: Array
    a: Array
    com: Array
    feet: PlannedFeet

    def feet_at(self, i: int) -> PlannedFeet:
        """The planned motion of both feet in row i, at time i times `CONTROL_S`."""
        return PlannedFeet(*(values[i] for values in self.feet))


def plan_control(reference: Reference, model: mujoco.MjModel) -> Plan:
    """The plan of a walk: its reference at the control rate, the feet, and the parts of the soles that bear force.

    Args:
        reference: The planned motion.
        model: Model of the wearer; its kinematics give the poses of the feet.
    """
    t = np.arange(0.0, reference.duration_s, CONTROL_S)
    q, v, a = reference.state(t)
    n = len(t)
    # position, rotation, velocity and angular velocity of both feet, world axes
    p, R = np.empty((n, 2, 3)), np.empty((n, 2, 3, 3))
    dp, w = np.empty((n, 2, 3)), np.empty((n, 2, 3))
    com = np.empty((n, 2, 2))
    bodies = [model.body(f"foot_{side}").id for side in SIDES]
    data, read = mujoco.MjData(model), np.empty(6)  # `read`: angular, then linear velocity of a body
    for i in range(n):
        data.qpos, data.qvel = q[i], v[i]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_subtreeVel(model, data)
        # body 1 is the root of the walker, whose subtree is the whole walker
        com[i] = data.subtree_com[1, :2], data.subtree_linvel[1, :2]
        for k, body in enumerate(bodies):
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, read, 0)
            p[i, k], R[i, k], w[i, k], dp[i, k] = data.xpos[body], data.xmat[body].reshape(3, 3), read[:3], read[3:]
    loads = reference.loads(t)  # (N, 8) of the left, then the right foot: share of the load (1), centre of pressure (3)
    heading = np.mean([np.interp(t, reference.grid, reference.paths[side].heading) for side in SIDES], axis=0)
    # (N, 2, 2) columns forward and left of the way
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
            # the next footprint lies behind a riser of a stair, or the foot leaves it over a riser
            near_edge[air, k] = after.mode in ("SA", "SD") or after.departure != "push"
        # the footprint on which the foot stands, or in the air the next one: the first with its toe-off still to come
        foot_steps = reference.steps[side]
        at = np.searchsorted([step.t_off for step in foot_steps], t)
        R_sole[:, k] = np.array([step.R_world_sole for step in foot_steps])[at]
        p_sole[:, k] = np.array([step.p_foot_in_world for step in foot_steps])[at]
        pitch = np.interp(t, reference.grid, reference.paths[side].pitch)
        # toes up: only the heel bears force; toes down: only ball and toes; flat: all points
        for step in reference.steps[side]:
            on = (t >= step.t_touch) & (t <= step.t_off)
            flat = on & (np.abs(pitch) < _ON_GROUND_RAD)
            # tolerance of the pitch: wider until the foot has been flat for the first time in this stance
            within = np.where(np.cumsum(flat) > 0, _ON_GROUND_RAD, _LANDS_RAD)[on, None]
            touching[on, k, :HEEL_POINTS] = pitch[on, None] < within
            touching[on, k, HEEL_POINTS:] = pitch[on, None] > -within
            toes = on & (pitch >= _ON_GROUND_RAD)
            # the load leaves the heel before the heel leaves the ground, not at that instant
            rise = np.append(np.flatnonzero(toes), n)  # rows in which the heel is up
            stands = np.flatnonzero(flat)
            # (stands,) s, until the heel rises
            left = np.asarray((rise[np.searchsorted(rise, stands)] - 1 - stands) * CONTROL_S, dtype=np.float64)
            force_weight[stands, k, :HEEL_POINTS] *= (_UNLOADED ** ease(1.0 - left / _UNLOADS_S))[:, None]
            # m, planned centre of pressure along the foot, from the origin of its frame
            pressed_at = loads[toes, 4 * k + 1 : 4 * k + 4]
            x = (pressed_at - step.p_foot_in_world) @ step.R_world_sole[:, 0]
            force_weight[toes, k, HEEL_POINTS:] = toe_weights(reference.size, x)
    feet = PlannedFeet(
        share=loads[:, [0, 4]],
        touching=touching,
        force_weight=force_weight,
        R_sole=R_sole,
        p_sole=p_sole,
        swinging=swinging,
        until_landing=until_landing,
        R_way=R_way,
        near_edge=near_edge,
        p_foot=p,
        v_foot=dp,
        a_foot=_time_derivative(dp),
        R_foot=R,
        w_foot=w,
        dw_foot=_time_derivative(w),
    )
    return Plan(t=t, q=q, v=v, a=a, com=com, feet=feet)


def _time_derivative(x: Array) -> Array:
    """(N, ...) time derivative of (N, ...) values every `CONTROL_S`, by central differences."""
    return np.asarray(np.gradient(x, CONTROL_S, axis=0), dtype=float)
