"""From plan and state to joint torques: gains and weights of the whole-body problem."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import mujoco
import numba
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.config import SIDES
from stridetwin.sim.dynamics.footstep_replanning import PlannedFeet, StepReplan
from stridetwin.sim.dynamics.plan import Plan
from stridetwin.sim.dynamics.soles import TOE_DAMPING, TOE_STIFFNESS, sole_points
from stridetwin.sim.dynamics.spatial import State, axes_of, bias_acceleration, chain_of, jacobian, velocity
from stridetwin.sim.dynamics.whole_body_problem import ContactPoints, Tasks, eliminate, solve_control_step
from stridetwin.sim.kinematics.coordinates import Coordinates
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.streams.algebra.tuples import Vec3, cross, mat3, matvec, minus, plus, times, transposed, vec3
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Array

_entry_kernel = entry_kernel(Path(__file__).parent, llvm_level=1)


class FootGains(NamedTuple):
    """Gains and weights for feet and contacts; rates in rad/s, critically damped.

    Attributes:
        swing_rate: Tracking rate of a foot in swing.
        pivot_rate: Tracking rate of the attitude of a foot on the ground.
        contact_damping: Rate at which a contact point's velocity dies, 1/s.
        swing: Weight of a foot in swing.
        pivot: Weight of the attitude of a foot that rolls on its heel or ball.
        stance: Weight of the attitude of a foot that stands flat.
        contact: Weight of contact points at rest.
        pivot_rad: Angle between sole and ground at which a foot counts wholly as rolling.
        force: Weight of contact force.
        force_change: Weight of its change from one control step to the next.
        friction: Friction coefficient that the controller counts on.
        yielding: Weight of the body's vertical acceleration where the legs yield (`Gains.max_lift`).
    """

    swing_rate: float = 25.0
    pivot_rate: float = 40.0
    contact_damping: float = 60.0
    swing: float = 2.0
    pivot: float = 5.0
    stance: float = 0.05
    contact: float = 20.0
    pivot_rad: float = 0.05
    force: float = 2e-6
    force_change: float = 6e-5
    friction: float = 0.7
    yielding: float = 100.0


class _Body(NamedTuple):
    """Constants of the controlled body, and the contact forces of the control step before.

    Attributes:
        driven: (n,) coordinates that the controller moves, the root's six first.
        free: (b,) coordinates without a motor.
        weight: (n,) weights of the target accelerations.
        bodies: (2, points) body of each sole point.
        local: (points, 3) m, the points in their bodies.
        point_chain: (2, points, n) which coordinates move a point.
        feet: (2,) bodies of the feet.
        foot_chain: (2, n) which coordinates move a foot.
        force: (2, points, 4) N, forces of the control step before, along the four edges of each point's friction cone
            (`_set_friction_cone`); overwritten at each step.
        assist: (6,) standard deviation of the root's assist, N and N m; 0 for none.
        lift: (1,) N, vertical force of both feet together in the control step before; overwritten at each step.
    """

    driven: NDArray[np.int64]
    free: NDArray[np.int64]
    weight: Array
    bodies: NDArray[np.int64]
    local: Array
    point_chain: NDArray[np.bool_]
    feet: NDArray[np.int64]
    foot_chain: NDArray[np.bool_]
    force: Array
    assist: Array
    lift: Array


class _Forces(NamedTuple):
    """Generalised forces at one instant, each (nv,), in N for translations and N m for rotations.

    Attributes:
        bias: Coriolis, centrifugal and gravity forces, of the engine.
        passive: Springs and dampers of the model, of the engine.
        known: Couplings and motors of the exoskeleton.
    """

    bias: Array
    passive: Array
    known: Array


@dataclass(frozen=True, kw_only=True)
class Gains:
    """Tracking and weights; rates in rad/s, critically damped.

    Attributes:
        joint_rate: Of the joints.
        root_rate: Of the root.
        sway_rate: Of the root's horizontal position.
        root, tilt: Weights of the root's position and attitude.
        joint, lumbar, leg, toe, arm: Weights of neck and exoskeleton joints, lumbar, leg, toe and arm joints.
        foot: Feet and contacts.
        max_torque: Joint torque limit, N m.
        max_lift: Vertical force of both feet together, as a share of the body weight, from which on the legs yield:
            tracking then gives way, as a person's knees do.
        leg_stiffness: Of legs that have yielded, N/m: by it the limit grows with the way that the pelvis is below its
            plan, so that a body that sinks is caught. By hand: with 120 the last landing after a ramp presses with 1.8
            body weights, with 60 with 1.55; people's legs have 14 (Geyer, Seyfarth & Blickhan 2006, Proc. R. Soc. B
            273).
        slack_m: The pelvis may be lower than planned by this before that.
        assist_n, assist_nm: Standard deviations of the assist's force and torque, where there is assist.
        max_assist: Limit of its force, as a share of the body weight.
    """

    joint_rate: float = 20.0
    root_rate: float = 16.0
    sway_rate: float = 12.0
    root: float = 1.0
    tilt: float = 0.15
    joint: float = 0.05
    lumbar: float = 0.03
    leg: float = 0.002
    toe: float = 0.1
    arm: float = 0.004
    foot: FootGains = field(default_factory=FootGains)
    max_torque: float = 400.0
    max_lift: float = 1.45
    leg_stiffness: float = 60e3
    slack_m: float = 0.01
    assist_n: float = 20.0
    assist_nm: float = 1.6
    max_assist: float = 0.08


class Controller:
    """Whole-body controller of a person with a known plan.

    Args:
        model: Model with sole points.
        size: Wearer.
        layout: Coordinates of the model.
        gains: Tracking and weights.
        assist: Whether a soft wrench may help at the root.
        mass_ratio: Mass that the controller assumes, divided by the model's mass. One factor for all bodies; 1 if the
            controller knows the true masses.
    """

    def __init__(
        self, model: mujoco.MjModel, size: Wearer, layout: Coordinates, gains: Gains, assist: bool, mass_ratio: float
    ) -> None:
        """Prepares the arrays of the control step: weights, rates, and the constants of body and contact points.

        The arguments are explained at the class. `mass_ratio` is the assumed mass of every body over its mass in the
        model; `assist` says whether a soft wrench may help at the root.
        """
        self._model, self._gains, self._mass_ratio = model, gains, mass_ratio
        # weight of the walker as the controller assumes it, N; `weights` below are those of the optimisation
        weight = mass_ratio * float(model.body_subtreemass[0] * np.linalg.norm(model.opt.gravity))
        self._max_lift = gains.max_lift * weight  # N, from which on the legs yield
        self._max_help = gains.max_assist * weight  # N, largest force of the assist at the root
        names = layout.names[6:]  # hinges; the six coordinates of the root come before them
        # the controller moves the root and the wearer's joints; the exoskeleton's joints are free
        motor = np.array([not name.startswith("exo_") for name in names])
        driven, free = np.concatenate([np.arange(6), layout.dof[motor]]), layout.dof[~motor]
        # weight of the deviation from the target acceleration, by degree of freedom: position and attitude of the root,
        # then each joint by the first part of its name, as in `hip_flexion_l`
        weights = np.full(model.nv, gains.joint)
        weights[:3], weights[3:6] = gains.root, gains.tilt
        by_joint = {"lumbar": gains.lumbar, "toe": gains.toe} | dict.fromkeys(("shoulder", "elbow"), gains.arm)
        by_joint |= dict.fromkeys(("hip", "knee", "ankle"), gains.leg)
        for name, dof in zip(names, layout.dof):
            weights[dof] = by_joint.get(name.split("_")[0], gains.joint)
        self._rate = np.full(model.nv, gains.joint_rate)  # rad/s, tracking rate of each degree of freedom
        self._rate[:6] = gains.root_rate
        self._rate[:2] = gains.sway_rate
        points = sole_points(size)
        bodies = np.array([[model.body(f"{body}_{side}").id for body, _ in points] for side in SIDES])
        feet = np.array([model.body(f"foot_{side}").id for side in SIDES])
        self._body = _Body(
            driven=driven,
            free=free,
            weight=weights[driven],
            bodies=bodies,
            local=np.array([p for _, p in points]),
            point_chain=np.array([[chain_of(model, b)[driven] for b in row] for row in bodies]),
            feet=feet,
            foot_chain=np.array([chain_of(model, b)[driven] for b in feet]),
            # last axis: the four edges of a point's friction cone, n + μ x, n − μ x, n + μ y, n − μ y
            force=np.zeros((len(SIDES), len(points), 4)),
            # force (3) and torque (3); all 0 without assist
            assist=np.repeat([gains.assist_n, gains.assist_nm], 3) * float(assist),
            lift=np.zeros(1),
        )
        # (2,) degrees of freedom of the toe hinges
        self._toes = np.array([model.joint(f"toe_extension_{side}").dofadr[0] for side in SIDES])
        # overwritten at each control step: mass matrix, and plan minus state in the degrees of freedom
        self._M = np.empty((model.nv, model.nv))
        self._error = np.empty(model.nv)

    def torques(
        self,
        data: mujoco.MjData,
        state: State,
        plan: Plan,
        i: int,
        shift: StepReplan,
        touching: NDArray[np.bool_],
        known: Array,
        lift: float,
    ) -> Array:
        """Generalised forces (nv,) of the wearer at one control step: joint torques, and the assist at the root.

        It stores the contact forces of this step; the next step limits their change.

        Args:
            data: State after `mj_step1`.
            state: Views of that state.
            plan: The reference at the control rate.
            i: Row of the plan.
            shift: Shifts of feet and pelvis relative to the plan.
            touching: (2, points) which sole points may bear force.
            known: (nv,) generalised forces of couplings and motors, which the wearer knows.
            lift: N, vertical force of both feet together that the soles sensed last.
        """
        model, gains = self._model, self._gains
        # (nv, nv) mass matrix of the model; the controller multiplies it by the ratio of the masses that it assumes
        mujoco.mj_fullM(model, data, self._M)
        # (nv,) plan minus state; a rotation vector for the attitude of the root
        mujoco.mj_differentiatePos(model, self._error, 1.0, data.qpos, plan.q[i])
        # (nv,) bias minus passive and known forces, and (nv,) target accelerations
        h, target = _compute_targets(
            self._rate,
            self._error,
            data.qvel,
            plan.v[i],
            plan.a[i],
            shift.root,
            self._mass_ratio,
            _Forces(data.qfrc_bias, data.qfrc_passive, known),
            self._toes,
        )
        # N, by which the ground pressed harder than the forces of the last control step: where a sole slaps down
        unforeseen = max(lift - float(self._body.lift[0]), 0.0)
        # N, by which legs that have yielded far press harder
        caught = gains.leg_stiffness * max(float(self._error[2] + shift.root[0, 2]) - gains.slack_m, 0.0)
        torque = _solve_step(
            self._mass_ratio * self._M,
            h,
            target,
            self._body,
            state,
            plan.feet_at(i),
            touching,
            shift.foot,
            self._max_lift + caught - unforeseen,
            gains.foot,
        )
        return _limit_torques(
            torque, self._body.driven, self._toes, self._error, plan.v[i], self._max_help, gains.max_torque
        )


@_entry_kernel
def _compute_targets(
    rate: Array,
    error: Array,
    qvel: Array,
    v: Array,
    a: Array,
    root: Array,
    mass_ratio: float,
    forces: _Forces,
    toes: NDArray[np.int64],
) -> tuple[Array, Array]:
    """Right-hand side of the equations of motion and target accelerations of one control step.

    The target of a coordinate is a + k² e + 2 k (v − q'). It is critically damped with the rate k; e is the error. The
    targets of the root's position follow the shift of the pelvis in the same way. The toes are held by their own
    springs, so their passive force is not subtracted.

    Args:
        rate: (nv,) rad/s, tracking rate k of each degree of freedom.
        error: (nv,) planned minus present position.
        qvel: (nv,) present velocity q'.
        v: (nv,) planned velocity.
        a: (nv,) planned acceleration.
        root: (3, 3) shift of the pelvis, its rate and acceleration, world axes.
        mass_ratio: Mass that the controller assumes, divided by the model's.
        forces: Bias, passive and known forces.
        toes: (2,) degrees of freedom of the toe hinges.

    Returns:
        (nv,) bias minus passive and known forces; (nv,) target accelerations.
    """
    h, target = np.empty(len(a)), np.empty(len(a))
    for j in range(len(a)):
        target[j] = a[j] + rate[j] * (rate[j] * error[j] + 2.0 * (v[j] - qvel[j]))
        h[j] = mass_ratio * forces.bias[j] - forces.passive[j] - forces.known[j]
    for j in range(3):  # position of the root
        target[j] += rate[j] * (rate[j] * root[0, j] + 2.0 * root[1, j]) + root[2, j]
    for toe in toes:  # undo the subtraction
        h[toe] += forces.passive[toe]
    return h, target


@_entry_kernel
def _limit_torques(
    torque: Array,
    driven: NDArray[np.int64],
    toes: NDArray[np.int64],
    error: Array,
    v: Array,
    max_help: float,
    max_torque: float,
) -> Array:
    """(nv,) generalised forces within their limits, from the torques of the driven coordinates.

    The toes get the spring and damper that hold them to their plan. The root's wrench is scaled down until its force is
    at most `max_help`. Each joint torque is clipped to ±`max_torque`.

    Args:
        torque: (n,) generalised forces of the driven coordinates.
        driven: (n,) these degrees of freedom.
        toes: (2,) degrees of freedom of the toe hinges.
        error: (nv,) planned minus present position.
        v: (nv,) planned velocity. The damper's share of the present velocity acts in the model itself.
        max_help: Largest force at the root, N.
        max_torque: Largest joint torque, N m.
    """
    full = np.zeros(len(error))
    for i in range(len(driven)):
        full[driven[i]] = torque[i]
    for toe in toes:
        full[toe] += TOE_STIFFNESS * error[toe] + TOE_DAMPING * v[toe]
    # entries 0 to 2 are the root's force, 3 to 5 its torque: one factor for both
    factor = min(1.0, max_help / max(math.sqrt(full[0] ** 2 + full[1] ** 2 + full[2] ** 2), 1e-9))
    for j in range(len(full)):
        full[j] = factor * full[j] if j < 6 else min(max(full[j], -max_torque), max_torque)
    return full


@_entry_kernel
def _solve_step(
    M: Array,
    h: Array,
    target: Array,
    body: _Body,
    state: State,
    feet: PlannedFeet,
    touching: NDArray[np.bool_],
    foot_shift: Array,
    max_lift: float,
    gains: FootGains,
) -> Array:
    """Torques (n,) of the driven coordinates at one instant, from tasks and contacts.

    The tasks are rows J q'' = target with weights. A contact point of a stance foot decelerates: its target is
    −d v − J' q', with the damping d. The attitude of a foot follows its plan: its target is α + k² θ + 2 k Δω − J' q'
    with the planned angular acceleration α, the rate k, the rotation θ to the planned attitude, and the difference Δω
    of the angular velocities; its weight is lower where the sole lies flat. The position of a foot in the air follows
    its plan and its shift likewise. The contact forces of this step are stored in `body.force` for the next one.

    Args:
        M: (nv, nv) mass matrix.
        h: (nv,) bias minus the known forces.
        target: (nv,) target accelerations.
        body: Constants of the controlled body.
        state: Views of the engine's state.
        feet: Plan of the feet.
        touching: (2, points) which sole points may bear force.
        foot_shift: (2, 3, 3) shift of each foot, its rate and acceleration.
        max_lift: N, vertical force of both feet together from which on the legs yield.
        gains: Gains and weights of the feet.
    """
    n, per_foot = len(body.driven), body.bodies.shape[1]
    # (n, 6) motion axes of the driven coordinates and their rates, (n,) their velocities and target accelerations
    axes, axes_dot = state.cdof[body.driven], state.cdof_dot[body.driven]
    speed, target = state.qvel[body.driven], target[body.driven]
    # at most three rows per sole point, and six per foot for its attitude and position; m tasks and k contact points
    # are filled
    # tasks: Jacobian rows, target accelerations and weights
    most = 13 + 6 * per_foot  # one row more for the vertical acceleration of the body
    tasks, targets, weights = np.zeros((most, n)), np.zeros(most), np.zeros(most)
    # contact points: Jacobian rows, edges of the friction cones, and weights of the forces
    contacts, edges, cost = np.zeros((6 * per_foot, n)), np.zeros((2 * per_foot, 4, 3)), np.zeros(2 * per_foot)
    last = np.empty((2 * per_foot, 4))  # N, forces of the step before
    m, k = 0, 0
    for side in range(2):
        in_contact = False  # whether any point of this foot may bear force
        for i in range(per_foot):
            if not touching[side, i]:
                continue  # a point off the ground has neither task nor force
            # a contact point decelerates: J q'' = -d v - J' q'; its force has a cone of four edges
            b = body.bodies[side, i]
            p = plus(vec3(state.xpos[b]), matvec(axes_of(state, b), vec3(body.local[i])))
            arm = minus(p, vec3(state.centre))
            v, w = velocity(state, b, p)
            chain = body.point_chain[side, i]
            jacobian(axes, chain, arm, tasks, m, -1)
            jacobian(axes, chain, arm, contacts, 3 * k, -1)
            bias, _ = bias_acceleration(axes_dot, chain, speed, v, w, arm)
            _set_target(minus(times(-gains.contact_damping, v), bias), gains.contact, targets, weights, m)
            _set_friction_cone(feet.R_sole[side], gains.friction, edges[k])
            # the less load a foot is planned to bear, the more expensive its force; a share of at least 0.02 is assumed
            cost[k] = feet.force_weight[side, i] * gains.force / max(feet.share[side], 0.02) ** 2
            for e in range(4):
                last[k, e] = body.force[side, i, e]
            m += 3
            k += 1
            in_contact = True
        # attitude of the foot: dw + k² rotation + 2 k (w_plan - w)
        b = body.feet[side]
        # `R` holds the axes of the foot in the world, one per row
        p, R, chain = vec3(state.xpos[b]), transposed(axes_of(state, b)), body.foot_chain[side]
        arm = minus(p, vec3(state.centre))
        v, w = velocity(state, b, p)
        jacobian(axes, chain, arm, tasks, -1, m)
        bias, rotation_bias = bias_acceleration(axes_dot, chain, speed, v, w, arm)
        # small rotation from the present to the planned attitude: half the sum of the cross products of their axes
        R_planned, rotation = transposed(mat3(feet.R_foot[side])), (0.0, 0.0, 0.0)
        for axis in range(3):
            rotation = plus(rotation, times(0.5, cross(R[axis], R_planned[axis])))
        rate = gains.pivot_rate if in_contact else gains.swing_rate
        correction = plus(times(rate * rate, rotation), times(2 * rate, minus(vec3(feet.w_foot[side]), w)))
        alpha = minus(plus(vec3(feet.dw_foot[side]), correction), rotation_bias)
        weight = gains.swing
        if in_contact:
            # 0 where the sole lies flat, 1 where the foot rolls on its heel or ball
            rolling = min(_angle_between(feet.R_sole[side], feet.R_foot[side]) / gains.pivot_rad, 1.0)
            weight = gains.stance + rolling * (gains.pivot - gains.stance)
        _set_target(alpha, weight, targets, weights, m)
        m += 3
        if not in_contact:
            # position of a foot in the air: a + k² (p_plan - p) + 2 k (v_plan - v), plan and shift together
            position_error = minus(plus(vec3(feet.p_foot[side]), vec3(foot_shift[side, 0])), p)
            velocity_error = minus(plus(vec3(feet.v_foot[side]), vec3(foot_shift[side, 1])), v)
            correction = plus(times(rate * rate, position_error), times(2 * rate, velocity_error))
            planned = plus(vec3(feet.a_foot[side]), vec3(foot_shift[side, 2]))
            jacobian(axes, chain, arm, tasks, m, -1)
            _set_target(minus(plus(planned, correction), bias), gains.swing, targets, weights, m)
            m += 3
    # the free coordinates are eliminated; the forces are stored, because the next step limits their change
    A, bias_driven = eliminate(M, h, body.driven, body.free)
    points = ContactPoints(contacts[: 3 * k], edges[:k], cost[:k], gains.force_change, last[:k])
    _, torque, forces, _ = solve_control_step(
        A, bias_driven, target, body.weight, Tasks(tasks[:m], targets[:m], weights[:m]), points, body.assist
    )
    if _lift(forces, edges) > max_lift:
        # the legs yield: the root's vertical row M_z q'' + h_z is the lift, and one more task brings it to its limit
        mass = M[2, 2]  # kg, of the whole body
        tasks[m], targets[m], weights[m] = A[2] / mass, (max_lift - bias_driven[2]) / mass, gains.yielding
        m += 1
        _, torque, forces, _ = solve_control_step(
            A, bias_driven, target, body.weight, Tasks(tasks[:m], targets[:m], weights[:m]), points, body.assist
        )
    body.lift[0] = _lift(forces, edges)
    k = 0  # number of the contact point among those that bear force
    for side in range(2):
        for i in range(per_foot):
            for e in range(4):
                body.force[side, i, e] = forces[k, e] if touching[side, i] else 0.0
            k += touching[side, i]
    return torque


@numba.njit(**INNER_KERNEL)
def _lift(forces: Array, edges: Array) -> float:
    """Vertical force, N, of (k, 4) forces along the (k, 4, 3) edges of friction cones, world axes."""
    lift = 0.0
    for i in range(len(forces)):
        for e in range(4):
            lift += forces[i, e] * edges[i, e, 2]
    return lift


@numba.njit(**INNER_KERNEL)
def _set_target(acceleration: Vec3, weight: float, targets: Array, weights: Array, m: int) -> None:
    """Writes one acceleration (x, y, z) into rows m to m + 2 of `targets`, and its weight into those of `weights`."""
    targets[m], targets[m + 1], targets[m + 2] = acceleration
    weights[m] = weights[m + 1] = weights[m + 2] = weight


@numba.njit(**INNER_KERNEL)
def _set_friction_cone(R_sole: Array, friction: float, edges: Array) -> None:
    """Writes the four edges of a friction cone into `edges` (4, 3): n + μ x, n − μ x, n + μ y, n − μ y.

    x, y and the normal n are the columns of `R_sole`, the axes of the ground under the foot; μ is `friction`.
    """
    for e in range(4):
        sign = friction if e % 2 == 0 else -friction
        for axis in range(3):
            edges[e, axis] = R_sole[axis, 2] + sign * R_sole[axis, e // 2]


@numba.njit(**INNER_KERNEL)
def _angle_between(A: Array, B: Array) -> float:
    """Angle between the third columns of two rotations, rad, for small angles: the length of their difference."""
    return math.sqrt((A[0, 2] - B[0, 2]) ** 2 + (A[1, 2] - B[1, 2]) ** 2 + (A[2, 2] - B[2, 2]) ** 2)
