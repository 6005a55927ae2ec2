"""How the exoskeleton's legs follow the wearer: first where their couplings hold them, then what their weight does.

Each leg of the frame hangs on the pelvis by six joints with stops and is coupled to the wearer at the thigh cuff, the
shank cuff and the heel (`exoskeleton.couplings`). `fit_leg` finds the angles of least elastic energy, the leg taken as
weightless. `settle` adds what its weight, inertia, rotors and friction do: the motion about that fit, linearised at
every instant, integrated in time. So the couplings carry the leg as they would in a forward simulation.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from stridetwin.sim.actuation import FRICTION_SPEED_RADPS
from stridetwin.sim.body import Wearer
from stridetwin.sim.config import SIDES
from stridetwin.sim.coordinates import Coordinates
from stridetwin.sim.coupling import strain
from stridetwin.sim.exoskeleton import EXO_LEG_BODIES, EXO_LEG_JOINTS, RANGE_RAD, chain, couplings
from stridetwin.sim.rotation import rot_x, rot_y, rot_z
from stridetwin.streams.samples import Array

STOP_STIFFNESS = 1500.0  # N m/rad, rubber on the mechanical stops
STOP_WIDTH_RAD = np.radians(0.5)  # over which a stop comes in
_ITERATIONS = 6
_ROUNDS = 3
_STOP_ITERATIONS = 8
_JOINTS = np.arange(6)


@dataclass(frozen=True, kw_only=True, eq=False)
class Limbs:
    """Pose of one of the wearer's legs in the pelvis' frame at N instants: what the couplings hold on to.

    Attributes:
        p: (N, 3) m, origin by body: thigh, shank, foot.
        R: (N, 3, 3) rotation by body.
    """

    p: dict[str, Array]
    R: dict[str, Array]


def limbs(size: Wearer, side: str, R_pelvis_thigh: Array, R_pelvis_shank: Array, p_foot: Array, R_foot: Array) -> Limbs:
    """Pose of a leg from the rotations of its segments and the foot's pose, all in the pelvis' frame."""
    outward = 1.0 if side == "l" else -1.0
    p_hip = np.broadcast_to([0.0, outward * size.body.hip_half_width_m, 0.0], p_foot.shape)
    p_knee = p_hip + R_pelvis_thigh @ np.array([0.0, 0.0, -size.body.thigh_m])
    return Limbs(
        p={"thigh": p_hip, "shank": p_knee, "foot": p_foot},
        R={"thigh": R_pelvis_thigh, "shank": R_pelvis_shank, "foot": R_foot},
    )


class ExoLeg:
    """Statics of one leg of the frame on a wearer.

    Args:
        size: Wearer with exoskeleton.
        side: `l` or `r`.

    Raises:
        ValueError: The wearer has no exoskeleton.
    """

    def __init__(self, size: Wearer, side: str) -> None:
        if size.exo is None:
            raise ValueError("the wearer has no exoskeleton")
        self._offsets, self._axes = chain(size.exo, side)
        self._couplings = [c for c in couplings(size) if c.name.endswith(f"_{side}")]
        self.stiffness = _block([m for c in self._couplings for m in (c.stiffness, c.turn_stiffness)])
        self.damping = _block([m for c in self._couplings for m in (c.damping, c.turn_damping)])

    def strains(self, q: Array, wearer: Limbs) -> tuple[Array, Array]:
        """(N, 18) strains of the couplings (displacement, turn; see `coupling.strain`) and their (N, 18, 6) Jacobian.

        Args:
            q: (N, 6) rad, `EXO_LEG_JOINTS`.
            wearer: The leg of the wearer.
        """
        pivots, R = self._poses(q)
        axes = np.stack([R[i] @ self._axes[i] for i in range(6)], 1)
        values, jacobians = [], []
        for c in self._couplings:
            last, body = EXO_LEG_BODIES.index(c.exo_body[:-2]), c.body[:-2]
            to_body = np.swapaxes(R[last], 1, 2)
            displacement, turn, change, point = strain(c, pivots[last], R[last], wearer.p[body], wearer.R[body])
            moves = np.zeros((len(q), 6, 6))  # as the frame turns, the wearer's point moves the other way in its axes
            for j in range(last + 1):
                moves[:, :3, j] = -np.einsum("nij,nj->ni", to_body, np.cross(axes[:, j], point - pivots[j]))
                moves[:, 3:, j] = -np.einsum("nij,njk,nk->ni", change, to_body, axes[:, j])
            values += [displacement, turn]
            jacobians.append(moves)
        return np.concatenate(values, 1), np.concatenate(jacobians, 1)

    def _poses(self, q: Array) -> tuple[list[Array], list[Array]]:
        p, R = np.zeros((len(q), 3)), np.broadcast_to(np.eye(3), (len(q), 3, 3))
        pivots, rotations = [], []
        for i, axis in enumerate(self._axes):
            p = p + R @ self._offsets[i]
            about = int(np.abs(axis).argmax())
            R = R @ (rot_x, rot_y, rot_z)[about](axis[about] * q[:, i])
            pivots.append(p)
            rotations.append(R)
        return pivots, rotations


def stops(q: Array) -> tuple[Array, Array]:
    """(..., 6) torque that the stops ask for, N m, and its slope, N m/rad: the gradient of their energy, smooth."""
    over, under = (q - RANGE_RAD[:, 1]) / STOP_WIDTH_RAD, (RANGE_RAD[:, 0] - q) / STOP_WIDTH_RAD
    torque = STOP_STIFFNESS * STOP_WIDTH_RAD * (np.logaddexp(0.0, over) - np.logaddexp(0.0, under))
    return torque, STOP_STIFFNESS * (_logistic(over) + _logistic(under))


def fit_leg(leg: ExoLeg, wearer: Limbs) -> Array:
    """(N, 6) angles of a weightless leg: the least energy of couplings and stops, by Newton's method on all at once."""
    R_thigh, R_shank = wearer.R["thigh"], wearer.R["shank"]
    R_ankle = np.swapaxes(R_shank, 1, 2) @ wearer.R["foot"]
    q = np.zeros((len(R_thigh), 6))
    q[:, 2] = np.arctan2(-R_thigh[:, 0, 2], R_thigh[:, 2, 2])
    q[:, 3] = np.arccos(np.clip(np.einsum("ni,ni->n", R_thigh[:, :, 2], R_shank[:, :, 2]), -1, 1))
    q[:, 4] = np.arctan2(-R_ankle[:, 0, 2], R_ankle[:, 2, 2])
    q = np.clip(q, RANGE_RAD[:, 0], RANGE_RAD[:, 1])
    for _ in range(_ITERATIONS):
        gradient, hessian, _ = _elastic(leg, q, wearer)
        torque, slope = stops(q)
        hessian[:, _JOINTS, _JOINTS] += slope
        q = q - np.linalg.solve(hessian, (gradient + torque)[..., None])[..., 0]
    return q


def settle(
    legs: dict[str, ExoLeg], fitted: dict[str, Array], wearers: dict[str, Limbs], model: mujoco.MjModel,
    layout: Coordinates, splines: BSpline, t: Array,
) -> dict[str, Array]:  # fmt: skip
    """Angles of both legs with their weight, inertia, rotors and friction.

    Solves M δ'' + C δ' + K δ + stops(q + δ) = −(loads + gradient) for the deviation δ from the fit q, at rest at first
    (Newmark's method with constant average acceleration), and again about what that gives.

    Args:
        legs: Statics by side.
        fitted: (N, 6) rad by side, angles of the weightless legs at `t`.
        wearers: The wearer's legs at `t`.
        model: Compiled model of the wearer.
        layout: Its coordinates.
        splines: All coordinates; those of the legs are not read.
        t: (N,) s, evenly spaced.

    Returns:
        (N, 6) rad by side.
    """
    dt = float(t[1] - t[0])
    columns = np.array([[layout.names.index(f"{j}_{s}") for j in EXO_LEG_JOINTS] for s in SIDES])
    motion = [splines(t, order) for order in range(3)]
    angles = np.stack([fitted[side] for side in SIDES], 1)
    mass = np.empty((*angles.shape, 6))
    damp, stiff, force = np.empty_like(mass), np.empty_like(mass), np.empty_like(angles)
    for _ in range(_ROUNDS):
        legs_motion = make_interp_spline(t, angles, k=5)
        for order in range(3):
            motion[order][:, columns] = legs_motion(t, order)
        mass, load, drag = _loads(model, layout.dof[columns - 6], *layout.to_mujoco(*motion))
        for k, side in enumerate(SIDES):
            gradient, stiff[:, k], (value, jacobian) = _elastic(legs[side], angles[:, k], wearers[side])
            damped = np.swapaxes(jacobian, 1, 2) @ legs[side].damping
            rate = make_interp_spline(t, value, k=5)(t, 1)
            damp[:, k] = damped @ jacobian
            force[:, k] = -(gradient + np.einsum("nij,nj->ni", damped, rate) + load[:, k])
        damp[..., _JOINTS, _JOINTS] += drag
        angles = angles + _newmark(mass, damp, stiff, force, angles, dt)
    return {side: angles[:, k] for k, side in enumerate(SIDES)}


def _elastic(leg: ExoLeg, q: Array, wearer: Limbs) -> tuple[Array, Array, tuple[Array, Array]]:
    """Gradient (N, 6) and Gauss-Newton Hessian (N, 6, 6) of the couplings' energy; strains and their Jacobian."""
    value, jacobian = leg.strains(q, wearer)
    weighted = np.swapaxes(jacobian, 1, 2) @ leg.stiffness
    return np.einsum("nij,nj->ni", weighted, value), weighted @ jacobian, (value, jacobian)


def _loads(
    model: mujoco.MjModel, dofs: NDArray[np.int64], q: Array, v: Array, a: Array
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Mass matrices (N, 2, 6, 6) of the legs, the torque (N, 2, 6) their motion takes, and its slope with speed."""
    data = mujoco.MjData(model)
    needed, full = np.empty(model.nv), np.empty((model.nv, model.nv))
    mass, load = np.empty((len(q), *dofs.shape, dofs.shape[1])), np.empty((len(q), *dofs.shape))
    for i in range(len(q)):
        data.qpos, data.qvel, data.qacc = q[i], v[i], a[i]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_crb(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 1, needed)
        mujoco.mj_fullM(model, data, full)
        for k, own in enumerate(dofs):
            mass[i, k] = full[np.ix_(own, own)]
        load[i] = needed[dofs]
    speed, friction = v[:, dofs], model.dof_frictionloss[dofs]
    load += model.dof_armature[dofs] * a[:, dofs] + model.dof_damping[dofs] * speed
    load += friction * np.tanh(speed / FRICTION_SPEED_RADPS)
    slope = friction / FRICTION_SPEED_RADPS / np.cosh(speed / FRICTION_SPEED_RADPS) ** 2
    return mass, load, model.dof_damping[dofs] + slope


def _newmark(mass: Array, damp: Array, stiff: Array, force: Array, angles: Array, dt: float) -> Array:
    """(N, 2, 6) solution x of M x'' + C x' + K x + stops(angles + x) = f, from rest in balance."""
    matrix = stiff + 2 / dt * damp + 4 / dt**2 * mass
    x = _meet_stops(stiff[0], force[0], angles[0], np.zeros_like(force[0]))
    v, a = np.zeros_like(x), np.zeros_like(x)
    path = np.empty_like(force)
    path[0] = x
    for i in range(1, len(force)):
        from_mass, from_damp = 4 / dt**2 * x + 4 / dt * v + a, 2 / dt * x + v
        right = force[i] + (mass[i] @ from_mass[..., None] + damp[i] @ from_damp[..., None])[..., 0]
        new = _meet_stops(matrix[i], right, angles[i], x)
        a_new = 4 / dt**2 * (new - x) - 4 / dt * v - a
        v = v + 0.5 * dt * (a + a_new)
        x, a = new, a_new
        path[i] = x
    return path


def _meet_stops(matrix: Array, right: Array, angles: Array, x: Array) -> Array:
    """Solution x of A x + stops(angles + x) = b by Newton's method, one step where no stop is near."""
    for _ in range(_STOP_ITERATIONS):
        torque, slope = stops(angles + x)
        rest = right - torque - (matrix @ x[..., None])[..., 0]
        jacobian = matrix.copy()
        jacobian[..., _JOINTS, _JOINTS] += slope
        step = np.linalg.solve(jacobian, rest[..., None])[..., 0]
        x = x + step
        if np.abs(step).max() < STOP_WIDTH_RAD:
            break
    return x


def _block(parts: list[Array]) -> Array:
    whole = np.zeros((3 * len(parts), 3 * len(parts)))
    for i, part in enumerate(parts):
        whole[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = part
    return whole


def _logistic(x: Array) -> Array:
    return 0.5 * (1.0 + np.tanh(0.5 * x))
