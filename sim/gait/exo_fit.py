"""Motion of the exoskeleton's legs with the wearer: first without weight on their couplings, then with it.

Each leg of the frame hangs on the pelvis by joints with stops and is coupled to the wearer at the thigh cuff, the
shank cuff and the heel (`exo_couplings`). `fit_leg` finds the angles of least elastic energy of a weightless leg.
`solve_leg_dynamics` adds the effect of its weight, inertia, rotors and friction: the motion relative to that fit,
linearised at every instant and integrated in time. So the couplings support the leg as they would in a forward
simulation.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from stridetwin.sim.config import SIDES
from stridetwin.sim.exo_description import OwnExo
from stridetwin.sim.gait import exo_fit_kernel
from stridetwin.sim.kinematics.coordinates import Coordinates
from stridetwin.sim.kinematics.rigid_tree import Tree, chain_loads
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.sim.wearer.exo_couplings import check_cuff_stiffness, exo_couplings, leg_frame
from stridetwin.sim.wearer.exoskeleton import FRICTION_SPEED_RADPS, RANGE_RAD, ExoLinks, outward
from stridetwin.streams.algebra.arrays import rot_z
from stridetwin.streams.samples import Array

STOP_STIFFNESS = 1500.0  # N m/rad, rubber on the mechanical stops
STOP_WIDTH_RAD = np.radians(0.5)  # over which a stop engages
_ITERATIONS = 12  # most Gauss-Newton iterations per instant, for weightless legs
_STOP_ITERATIONS = 12  # most Newton iterations per step in time, for legs with weight


@dataclass(frozen=True, kw_only=True, eq=False)
class LegPose:
    """Pose of one of the wearer's legs, to which the couplings attach, in the pelvis' frame at N instants.

    Attributes:
        p: (N, 3) m, origin by body: thigh, shank, foot.
        R: (N, 3, 3) rotation by body.
    """

    p: dict[str, Array]
    R: dict[str, Array]


def leg_pose(
    size: Wearer, side: str, R_pelvis_thigh: Array, R_pelvis_shank: Array, p_foot: Array, R_foot: Array
) -> LegPose:
    """Pose of one of the wearer's legs in the pelvis' frame at N instants.

    Args:
        size: Wearer, for the half width of the hips and the length of the thigh.
        side: `l` or `r`.
        R_pelvis_thigh: (N, 3, 3) rotation of the thigh.
        R_pelvis_shank: (N, 3, 3) rotation of the shank.
        p_foot: (N, 3) m, origin of the foot's frame.
        R_foot: (N, 3, 3) rotation of the foot.
    """
    p_hip = np.broadcast_to([0.0, outward(side) * size.body.hip_half_width_m, 0.0], p_foot.shape)
    p_knee = p_hip + R_pelvis_thigh @ np.array([0.0, 0.0, -size.body.thigh_m])
    return LegPose(
        p={"thigh": p_hip, "shank": p_knee, "foot": p_foot},
        R={"thigh": R_pelvis_thigh, "shank": R_pelvis_shank, "foot": R_foot},
    )


class ExoLeg:
    """Statics of one leg of the frame on a wearer.

    Args:
        size: Wearer with exoskeleton.
        side: `l` or `r`.

    Attributes:
        frame: Its joints and bodies.
        is_standard: Whether it is the leg of Shim et al.
        kernel: Input of the compiled loops.

    Raises:
        ValueError: The wearer has no exoskeleton.
    """

    def __init__(self, size: Wearer, side: str) -> None:
        """Collects joints, stops and couplings of the leg `side` (`l` or `r`) as arrays for the compiled loops."""
        self.frame = frame = leg_frame(size, side)
        self.is_standard = isinstance(size.exo, ExoLinks)
        cuffs = [c for c in exo_couplings(size) if c.name.endswith(f"_{side}")]  # the C couplings of this leg
        self._coupled_bodies = [c.body[:-2] for c in cuffs]  # of the wearer, without the side: thigh, shank, foot
        self.kernel = exo_fit_kernel.CoupledLeg(
            offsets=frame.offsets,
            axes=frame.axes,
            last=np.array([frame.bodies.index(c.exo_body) for c in cuffs]),
            p_in_exo=np.array([c.p_in_exo for c in cuffs]),
            p_in_body=np.array([c.p_in_body for c in cuffs]),
            # entries of a law: stiffness, damping, rotational stiffness, rotational damping
            stiffness=np.array([c.law[[0, 2]] for c in cuffs]),
            damping=np.array([c.law[[1, 3]] for c in cuffs]),
            stops=frame.stops,
            stop=np.array([STOP_STIFFNESS, STOP_WIDTH_RAD]),
        )

    def strains(self, q: Array, wearer: LegPose) -> tuple[Array, Array]:
        """Strains of the leg's C couplings at N instants, and their Jacobian by the joint angles.

        The six strains of a coupling are the displacement, m, and the rotation (sine of the angle) of the wearer's body
        in the axes of the exoskeleton's body.

        Args:
            q: (N, J) rad, angles of the exoskeleton's leg.
            wearer: Pose of the wearer's leg at these instants.

        Returns:
            (N, 6 C) strains; (N, 6 C, J) their Jacobian.
        """
        return exo_fit_kernel.strains(self.kernel, q, *self.attachment_poses(wearer))

    def attachment_poses(self, wearer: LegPose) -> tuple[Array, Array]:
        """Origins (N, C, 3) m and rotations (N, C, 3, 3) of the wearer's body at each coupling, pelvis' frame."""
        p = [wearer.p[body] for body in self._coupled_bodies]
        R = [wearer.R[body] for body in self._coupled_bodies]
        return np.stack(p, 1), np.stack(R, 1)


def check_legs(model: mujoco.MjModel, size: Wearer) -> None:
    """Rejects a custom exoskeleton whose cuffs do not hold it, or hold it too stiffly for its weight.

    The check is made with the wearer standing upright and all joints at zero; the built-in exoskeleton always passes.

    Raises:
        ConfigError: A leg that its cuffs do not hold, or whose natural frequency or damping is too high for a
            simulation in steps of 1 ms.
    """
    if not isinstance(size.exo, OwnExo):
        return
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    upright = np.eye(3)[None]  # (1, 3, 3) rotation of every body of a standing wearer
    for side in SIDES:
        leg = ExoLeg(size, side)
        ankle = np.array(  # m, in the pelvis' frame
            [0.0, size.body.hip_half_width_m * outward(side), -size.body.thigh_m - size.body.shank_m]
        )
        R_foot = rot_z(np.array([outward(side) * size.body.shank_twist_rad]))
        foot = ankle - R_foot @ np.array([size.ankle_x, 0.0, size.body.ankle_height_m])
        wearer = leg_pose(size, side, upright, upright, foot, R_foot)
        value, jacobian = leg.strains(np.zeros((1, len(leg.frame.joints))), wearer)
        dofs = np.array([model.joint(name).dofadr[0] for name in leg.frame.joints])
        # (J, J) stiffness and damping of the couplings as seen by the joints of the leg
        _, stiffness = exo_fit_kernel.project_on_joints(leg.kernel, leg.kernel.stiffness, jacobian, value)
        _, damping = exo_fit_kernel.project_on_joints(leg.kernel, leg.kernel.damping, jacobian, value)
        check_cuff_stiffness(size.exo, side, mass[np.ix_(dofs, dofs)], stiffness[0], damping[0])


def fit_leg(leg: ExoLeg, wearer: LegPose) -> Array:
    """(N, J) rad, joint angles at which a weightless leg of the exoskeleton has the least elastic energy.

    The energy is that of the couplings and of the joint stops. Each instant is solved by the Gauss-Newton method. Its
    first step is the whole change that the instant before needed.

    Args:
        leg: Statics of the leg.
        wearer: Pose of the wearer's leg at N consecutive instants.
    """
    q = _initial_angles(wearer) if leg.is_standard else np.zeros((len(wearer.p["foot"]), len(leg.frame.joints)))
    exo_fit_kernel.fit_angles(leg.kernel, q, *leg.attachment_poses(wearer), _ITERATIONS)
    return q


def _initial_angles(wearer: LegPose) -> Array:
    """(N, 6) rad, start values for the leg of Shim et al., clipped to its ranges.

    Hip flexion, knee flexion and ankle dorsiflexion follow from the wearer's segments; the other three angles are 0.
    """
    R_thigh, R_shank = wearer.R["thigh"], wearer.R["shank"]  # in the pelvis' frame
    R_ankle = np.swapaxes(R_shank, 1, 2) @ wearer.R["foot"]  # foot to shank
    q = np.zeros((len(R_thigh), 6))
    # columns 2 to 4 are hip flexion, knee flexion and ankle dorsiflexion. Rotations about y follow from the x and z
    # entries of the z axis; the knee angle is that between the z axes of thigh and shank
    q[:, 2] = np.arctan2(-R_thigh[:, 0, 2], R_thigh[:, 2, 2])
    q[:, 3] = np.arccos(np.clip(np.einsum("ni,ni->n", R_thigh[:, :, 2], R_shank[:, :, 2]), -1, 1))
    q[:, 4] = np.arctan2(-R_ankle[:, 0, 2], R_ankle[:, 2, 2])
    return np.clip(q, RANGE_RAD[:, 0], RANGE_RAD[:, 1])


def solve_leg_dynamics(
    legs: dict[str, ExoLeg],
    start: dict[str, Array],
    wearers: dict[str, LegPose],
    model: mujoco.MjModel,
    layout: Coordinates,
    splines: BSpline,
    t: Array,
    rounds: int,
) -> dict[str, Array]:
    """Angles of both legs with their weight, inertia, rotors and friction.

    Solves M δ'' + C δ' + K δ + stops(q + δ) = −(loads + gradient) for the difference δ from the angles q, initially at
    rest, by Newmark's method with constant average acceleration. Then it linearises again about the result. M, C and K
    are mass, damping and stiffness of the leg on its couplings. The gradient is that of the couplings' elastic energy.
    The loads are weight, inertia, damping, rotors and friction.

    Args:
        legs: Statics by side.
        start: (N, J) rad by side, initial angles at `t`: of weightless legs, or the result for a similar motion.
        wearers: The wearer's legs at `t`.
        model: Compiled model of the wearer.
        layout: Its coordinates.
        splines: All coordinates; those of the legs are not read.
        t: (N,) s, evenly spaced.
        rounds: Number of linearisations.

    Returns:
        (N, J) rad by side.
    """
    dt = float(t[1] - t[0])
    # `tree` is the part of the model that carries both legs of the exoskeleton, `chains` (2, J) are the legs' bodies in
    # it, and `hinges` (2, J) their joints in the model
    full_tree = Tree.of(model)
    names = [legs[side].frame.bodies for side in SIDES]
    tree = full_tree.subtree([full_tree.index_of(model.body(name).id) for bodies in names for name in bodies])
    chains = np.array([[tree.index_of(model.body(name).id) for name in bodies] for bodies in names])
    hinges = np.array([[model.joint(name).id for name in legs[side].frame.joints] for side in SIDES])
    diagonal = np.arange(hinges.shape[1])  # indices of the diagonal of a (J, J) matrix
    qpos, dofs = model.jnt_qposadr[hinges], model.jnt_dofadr[hinges]
    # (2, J) viscous friction, N m s/rad, and the slope of the smooth dry friction at rest, likewise
    viscous, friction = model.dof_damping[dofs], model.dof_frictionloss[dofs] / FRICTION_SPEED_RADPS
    q, v, a = layout.evaluate(splines, t)
    attachments = {side: legs[side].attachment_poses(wearers[side]) for side in SIDES}
    angles = np.stack([start[side] for side in SIDES], 1)  # (N, 2, J)
    for _ in range(rounds):
        # inertial loads and weight of the legs on their present motion
        angle_splines = make_interp_spline(t, angles, k=5)
        q[:, qpos], v[:, dofs], a[:, dofs] = angles, angle_splines(t, 1), angle_splines(t, 2)
        mass, load = chain_loads(tree, chains, q, v, a, model.opt.gravity)
        for k, side in enumerate(SIDES):
            leg, speed = legs[side].kernel, v[:, dofs[k]]
            # torques of the couplings at the present strains and their rates, with the matrices K and C
            value, jacobian = exo_fit_kernel.strains(leg, angles[:, k], *attachments[side])
            gradient, stiffness = exo_fit_kernel.project_on_joints(leg, leg.stiffness, jacobian, value)
            damping_torque, damping = exo_fit_kernel.project_on_joints(
                leg, leg.damping, jacobian, make_interp_spline(t, value, k=5)(t, 1)
            )
            # friction of the joints; `friction_share`, −1 to 1, is the share of the full dry friction that acts, and
            # its slope adds to C
            friction_share = np.tanh(speed / FRICTION_SPEED_RADPS)
            drag = viscous[k] * speed + FRICTION_SPEED_RADPS * friction[k] * friction_share
            damping[:, diagonal, diagonal] += viscous[k] + friction[k] * (1.0 - friction_share**2)
            # right side: what the present motion leaves unbalanced; the rotors add to M
            force = -(gradient + damping_torque + load[:, k] + model.dof_armature[dofs[k]] * a[:, dofs[k]] + drag)
            mass[:, k, diagonal, diagonal] += model.dof_armature[dofs[k]]
            angles[:, k] += exo_fit_kernel.integrate_motion(
                leg, mass[:, k], damping, stiffness, force, angles[:, k], dt, _STOP_ITERATIONS
            )
    return {side: angles[:, k] for k, side in enumerate(SIDES)}
