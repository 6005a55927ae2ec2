"""A wearer's bodies as a rigid tree: poses, velocities and inertial loads of many instants at once, compiled.

The same results as MuJoCo's `mj_kinematics`, `mj_comVel`, `mj_rne` and `mj_crb`, without an engine call for every
instant: the recursive Newton-Euler method and the composite-rigid-body method (Featherstone 2008, chapters 5 and 6), in
world axes. All functions take positions q (N, nq), velocities v (N, nv) and accelerations a (N, nv) at N instants in
MuJoCo's layout, and gravity (3,) in m/s².
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numba
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.algebra.tuples import (
    Vec3,
    cross,
    dot,
    mat3,
    matvec,
    minus,
    multiply,
    plus,
    store_vec3,
    times,
    to_matrix,
    transposed,
    vec3,
    vec3_at,
)
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Array

_entry_kernel = entry_kernel(__file__, llvm_level=1)

Indices = NDArray[np.int64]


class Tree(NamedTuple):
    """Bodies on a free root, parents first; `qpos` and `dof` address the model's own layout, the free root first.

    Attributes:
        ids: (B,) the bodies in the model.
        parent: (B,) index in the tree, -1 of the root.
        offset: (B, 3) m, origin in the parent's frame.
        rotation: (B, 4) unit quaternion (w, x, y, z), body to parent, with the hinges at zero.
        mass: (B,) kg.
        com: (B, 3) m, in the body's frame.
        inertia: (B, 3, 3) kg m² about the centre of mass, body axes.
        hinges: (B, 2) index of the body's first hinge, and one past its last.
        axis: (J, 3) of each hinge, in the frame after the hinge before it.
        anchor: (J, 3) m, a point on it, in the body's frame.
        qpos: (J,) address of each hinge in qpos.
        dof: (J,) address of each hinge in qvel.
    """

    ids: Indices
    parent: Indices
    offset: Array
    rotation: Array
    mass: Array
    com: Array
    inertia: Array
    hinges: Indices
    axis: Array
    anchor: Array
    qpos: Indices
    dof: Indices

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Tree:
        """Tree of a model's wearer: the body of its first joint, the free root, and all that it carries with mass."""
        root = int(model.jnt_bodyid[0])
        ids = np.flatnonzero((model.body_rootid == root) & (model.body_subtreemass > 0.0))
        index = {int(body): i for i, body in enumerate(ids)}
        # joints of the model by body, without the root and its free joint; then all of them in one array
        joints = [list(range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b])) for b in ids[1:]]
        # (B + 1,) number of hinges before each body, and of all hinges; the root has none
        ends = np.cumsum([0, 0, *map(len, joints)])
        flat = np.array([j for body_joints in joints for j in body_joints], dtype=np.int64)
        R = np.empty((len(ids), 9))  # rows: rotation matrix of the principal axes of inertia
        for row, quat in zip(R, model.body_iquat[ids]):
            mujoco.mju_quat2Mat(row, quat)
        axes = R.reshape(-1, 3, 3)  # principal axes of inertia, in the body's frame
        return cls(
            ids=ids,
            parent=np.array([index.get(int(model.body_parentid[b]), -1) for b in ids]),
            offset=model.body_pos[ids],
            rotation=model.body_quat[ids],
            mass=model.body_mass[ids],
            com=model.body_ipos[ids],
            inertia=(axes * model.body_inertia[ids][:, None]) @ np.swapaxes(axes, 1, 2),
            hinges=np.column_stack([ends[:-1], ends[1:]]),
            axis=model.jnt_axis[flat],
            anchor=model.jnt_pos[flat],
            qpos=model.jnt_qposadr[flat].astype(np.int64),
            dof=model.jnt_dofadr[flat].astype(np.int64),
        )

    def index_of(self, body: int) -> int:
        """Index in the tree of a body, which is given by its id in the model; the body must be in the tree."""
        return int(np.searchsorted(self.ids, body))

    def subtree(self, bodies: Sequence[int]) -> Tree:
        """The part of the tree that carries some bodies or is carried by them.

        The motion of its bodies is that in the whole tree.

        Args:
            bodies: The bodies, as indices in this tree.
        """
        kept = set(bodies)
        for body, up in enumerate(self.parent):  # parents come first, so one pass finds all that they carry
            if up in kept:
                kept.add(body)
        for body in sorted(kept, reverse=True):  # and all bodies from there up to the root, whose parent is -1
            while body >= 0:
                kept.add(body)
                body = int(self.parent[body])
        rows = np.array(sorted(kept))  # indices in this tree; `searchsorted` gives those in the new one
        hinges = np.concatenate([np.arange(*self.hinges[b]) for b in rows]).astype(np.int64)  # those of all kept bodies
        ends = np.cumsum([0, *np.diff(self.hinges[rows])[:, 0]])  # number of kept hinges before each kept body
        return Tree(
            ids=self.ids[rows],
            parent=np.where(self.parent[rows] < 0, -1, np.searchsorted(rows, self.parent[rows])),
            offset=self.offset[rows],
            rotation=self.rotation[rows],
            mass=self.mass[rows],
            com=self.com[rows],
            inertia=self.inertia[rows],
            hinges=np.column_stack([ends[:-1], ends[1:]]),
            axis=self.axis[hinges],
            anchor=self.anchor[hinges],
            qpos=self.qpos[hinges],
            dof=self.dof[hinges],
        )


class _Bodies(NamedTuple):
    """Motion of all bodies at one instant, world axes; compiled code fills it.

    Attributes:
        p: (B, 3) m, origins.
        quat: (B, 4) unit quaternions, body to world.
        R: (B, 3, 3) the same as matrices.
        speed: (B, 3) m/s of the origins.
        w: (B, 3) rad/s.
        dv: (B, 3) m/s² of the origins.
        dw: (B, 3) rad/s².
        axes: (J, 3) of the hinges.
    """

    p: Array
    quat: Array
    R: Array
    speed: Array
    w: Array
    dv: Array
    dw: Array
    axes: Array


@numba.njit(**INNER_KERNEL)
def _allocate_bodies(tree: Tree) -> _Bodies:
    """Uninitialised arrays for the motion of all bodies at one instant: p, quat, R, speed, w, dv, dw and axes."""
    n = len(tree.parent)
    return _Bodies(
        np.empty((n, 3)),  # p
        np.empty((n, 4)),  # quat
        np.empty((n, 3, 3)),  # R
        np.empty((n, 3)),  # speed
        np.empty((n, 3)),  # w
        np.empty((n, 3)),  # dv
        np.empty((n, 3)),  # dw
        np.empty((len(tree.axis), 3)),  # axes
    )


@_entry_kernel
def body_motion(tree: Tree, q: Array, v: Array) -> tuple[Array, Array, Array, Array]:
    """Poses and velocities of all bodies at N instants, as MuJoCo's `mj_kinematics` and `mj_comVel` compute them.

    Args:
        tree: The bodies.
        q: (N, nq) positions.
        v: (N, nv) velocities.

    Returns:
        (N, B, 3) m, origins in the world; (N, B, 4) unit quaternions (w, x, y, z), body to world; (N, B, 3) m/s of the
        origins, world axes; (N, B, 3) rad/s, the bodies' own axes.
    """
    # `bodies` holds the motion at one instant; the accelerations do not matter here and are set to 0
    n, count, bodies, no_acceleration = len(q), len(tree.parent), _allocate_bodies(tree), np.zeros(v.shape[1])
    p, quat = np.empty((n, count, 3)), np.empty((n, count, 4))
    speed, w = np.empty((n, count, 3)), np.empty((n, count, 3))
    for i in range(n):
        _forward_kinematics(tree, q[i], v[i], no_acceleration, bodies)
        for b in range(count):
            store_vec3(vec3(bodies.p[b]), p[i, b])
            store_vec3(vec3(bodies.speed[b]), speed[i, b])
            for k in range(4):
                quat[i, b, k] = bodies.quat[b, k]
            # angular velocity from the world's axes to the body's
            store_vec3(matvec(transposed(mat3(bodies.R[b])), vec3(bodies.w[b])), w[i, b])
    return p, quat, speed, w


@_entry_kernel
def root_wrench(tree: Tree, q: Array, v: Array, a: Array, gravity: Array) -> tuple[Array, Array, Array]:
    """External wrench that the motion of the whole tree needs: the rate of its momentum minus its weight.

    Args:
        tree: The bodies.
        q: (N, nq) positions.
        v: (N, nv) velocities.
        a: (N, nv) accelerations.
        gravity: (3,) m/s².

    Returns:
        (N, 3) force, N, and (N, 3) its moment about the root's origin, N m, world axes; (N, 3) centre of mass, m.
    """
    n, bodies, g, total_mass = len(q), _allocate_bodies(tree), vec3(gravity), 0.0
    for mass in tree.mass:
        total_mass += mass
    p, force, moment, com = bodies.p, np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    for i in range(n):
        _forward_kinematics(tree, q[i], v[i], a[i], bodies)
        # sums over all bodies; the first moment of mass, Σ m r, is about the world's origin
        sum_force, sum_moment, first_moment = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        for b in range(len(p)):
            body_force, body_moment, arm = _inertial_wrench(tree, b, bodies, g)
            away = minus(vec3(p[b]), vec3(p[0]))  # from the root's origin to the body's
            sum_force = plus(sum_force, body_force)
            sum_moment = plus(sum_moment, plus(body_moment, cross(away, body_force)))
            first_moment = plus(first_moment, times(tree.mass[b], plus(vec3(p[b]), arm)))
        store_vec3(sum_force, force[i])
        store_vec3(sum_moment, moment[i])
        store_vec3(times(1.0 / total_mass, first_moment), com[i])
    return force, moment, com


@_entry_kernel
def hinge_torques(
    tree: Tree, q: Array, v: Array, a: Array, gravity: Array, bodies: Indices, forces: Array, moments: Array
) -> Array:
    """(N, J) N m, torques of the hinges for a motion of the tree, by the recursive Newton-Euler method.

    Rotors and friction of the joints are not included. All hinges of one body rotate about one point.

    Args:
        tree: The bodies.
        q: (N, nq) positions.
        v: (N, nv) velocities.
        a: (N, nv) accelerations.
        gravity: (3,) m/s².
        bodies: (K,) bodies on which external wrenches act, as indices in the tree; repetitions are allowed.
        forces: (K, N, 3) N, world axes.
        moments: (K, N, 3) N m about the origins of these bodies, world axes.
    """
    n, count, motions, g = len(q), len(tree.parent), _allocate_bodies(tree), vec3(gravity)
    p, R, axes, torque = motions.p, motions.R, motions.axes, np.empty((n, len(tree.axis)))
    # wrench that each body needs from its carrier: force, and moment about the body's origin, world axes
    force, moment = np.empty((count, 3)), np.empty((count, 3))
    for i in range(n):
        _forward_kinematics(tree, q[i], v[i], a[i], motions)
        for b in range(count):
            body_force, body_moment, _ = _inertial_wrench(tree, b, motions, g)
            store_vec3(body_force, force[b])
            store_vec3(body_moment, moment[b])
        # an external wrench on a body reduces what its carrier has to provide
        for k, b in enumerate(bodies):
            store_vec3(minus(vec3(force[b]), vec3(forces[k, i])), force[b])
            store_vec3(minus(vec3(moment[b]), vec3(moments[k, i])), moment[b])
        # from the tips to the root: torques of the body's hinges, then its wrench is added to its carrier's
        for b in range(count - 1, 0, -1):
            up, body_force, body_moment = tree.parent[b], vec3(force[b]), vec3(moment[b])
            for j in range(tree.hinges[b, 0], tree.hinges[b, 1]):
                arm = matvec(mat3(R[b]), vec3(tree.anchor[j]))
                torque[i, j] = dot(vec3(axes[j]), minus(body_moment, cross(arm, body_force)))
            away = minus(vec3(p[b]), vec3(p[up]))
            store_vec3(plus(vec3(moment[up]), plus(body_moment, cross(away, body_force))), moment[up])
            store_vec3(plus(vec3(force[up]), body_force), force[up])
    return torque


@_entry_kernel
def chain_loads(tree: Tree, chains: Indices, q: Array, v: Array, a: Array, gravity: Array) -> tuple[Array, Array]:
    """Mass matrices of chains of bodies that hang on the tree, and the torques for their motion and weight.

    The torques are those of the whole motion, that of the carrying bodies included. The composite-rigid-body method
    gives the matrices. Rotors and friction of the joints are not included.

    Args:
        tree: The bodies.
        chains: (C, L) bodies of each chain from the first to the tip, each on one hinge through its own origin.
        q: (N, nq) positions.
        v: (N, nv) velocities.
        a: (N, nv) accelerations.
        gravity: (3,) m/s².

    Returns:
        (N, C, L, L) kg m², mass matrix of the hinges of each chain; (N, C, L) N m, their torques.
    """
    n, bodies, motions = len(q), len(tree.parent), _allocate_bodies(tree)
    count, length = chains.shape  # C, L
    p, axes = motions.p, motions.axes
    mass, load = np.empty((n, count, length, length)), np.empty((n, count, length))
    # of each body with all that it carries: force, moment, first moment of mass, mass and inertia, about its origin
    force, moment, first_moment = np.empty((bodies, 3)), np.empty((bodies, 3)), np.empty((bodies, 3))
    carried_mass, inertia, g = np.empty(bodies), np.empty((bodies, 3, 3)), vec3(gravity)
    for i in range(n):
        _forward_kinematics(tree, q[i], v[i], a[i], motions)
        for b in range(bodies):
            body_force, body_moment, arm = _inertial_wrench(tree, b, motions, g)
            store_vec3(body_force, force[b])
            store_vec3(body_moment, moment[b])
            store_vec3(times(tree.mass[b], arm), first_moment[b])
            carried_mass[b] = tree.mass[b]
            _world_inertia(tree, b, motions.R, arm, inertia[b])
        # composite bodies: add each body to its carrier, from the tips to the root
        for b in range(bodies - 1, 0, -1):
            up = tree.parent[b]
            d = minus(vec3(p[b]), vec3(p[up]))
            body_force = vec3(force[b])
            store_vec3(plus(vec3(moment[up]), plus(vec3(moment[b]), cross(d, body_force))), moment[up])
            store_vec3(plus(vec3(force[up]), body_force), force[up])
            _add_to_carrier(inertia[b], vec3(first_moment[b]), carried_mass[b], d, inertia[up], first_moment[up])
            carried_mass[up] += carried_mass[b]
        for k in range(count):
            for j in range(length):
                b = chains[k, j]
                axis = vec3(axes[tree.hinges[b, 0]])
                load[i, k, j] = dot(axis, vec3(moment[b]))
                # force and moment about its origin that the composite body needs for 1 rad/s² of its own hinge; the
                # moment about each hinge nearer to the root, along that hinge's axis, is the entry of the mass matrix
                unit_force, unit_moment = cross(axis, vec3(first_moment[b])), matvec(mat3(inertia[b]), axis)
                for o in range(j + 1):
                    d = minus(vec3(p[b]), vec3(p[chains[k, o]]))
                    other_axis = vec3(axes[tree.hinges[chains[k, o], 0]])
                    mass[i, k, o, j] = mass[i, k, j, o] = dot(other_axis, plus(unit_moment, cross(d, unit_force)))
    return mass, load


@numba.njit(**INNER_KERNEL)
def _forward_kinematics(tree: Tree, q: Array, v: Array, a: Array, bodies: _Bodies) -> None:
    """Writes poses, velocities and accelerations of all bodies at one instant, from the root outwards.

    A body starts with the motion of its carrier. Each of its hinges then adds its rotation, its rate, and its angular
    acceleration q'' axis + q' ω × axis, about the hinge's anchor.

    Args:
        tree: The bodies.
        q: (nq,) positions in MuJoCo's layout.
        v: (nv,) velocities; the root's angular velocity is in its own axes.
        a: (nv,) accelerations; the root's angular acceleration is in its own axes.
        bodies: Output.
    """
    p, quat, R, speed, w, dv, dw, axes = bodies
    for b in range(len(tree.parent)):
        up = tree.parent[b]
        # pose: unit quaternion, body to world, and M the same as a matrix; omega, alpha: angular velocity, acceleration
        if up < 0:  # the root: its motion stands in the first entries of q, v and a
            origin, velocity, acceleration = vec3(q), vec3(v), vec3(a)
            pose = (q[3], q[4], q[5], q[6])
            M = to_matrix(pose)
            omega, alpha = matvec(M, vec3_at(v, 3)), matvec(M, vec3_at(a, 3))
        else:
            omega, alpha = vec3(w[up]), vec3(dw[up])
            r = matvec(mat3(R[up]), vec3(tree.offset[b]))  # from the carrier's origin to this body's, world axes
            origin, velocity = plus(vec3(p[up]), r), plus(vec3(speed[up]), cross(omega, r))
            acceleration = _point_acceleration(r, omega, vec3(dv[up]), alpha)
            pose = multiply(
                (quat[up, 0], quat[up, 1], quat[up, 2], quat[up, 3]),
                (tree.rotation[b, 0], tree.rotation[b, 1], tree.rotation[b, 2], tree.rotation[b, 3]),
            )
            M = to_matrix(pose)
        for j in range(tree.hinges[b, 0], tree.hinges[b, 1]):
            # move to the anchor, rotate about the hinge, and move back to the body's origin
            r, local_axis = matvec(M, vec3(tree.anchor[j])), vec3(tree.axis[j])
            axis, rate, half = matvec(M, local_axis), v[tree.dof[j]], 0.5 * q[tree.qpos[j]]
            origin, velocity = plus(origin, r), plus(velocity, cross(omega, r))
            acceleration = _point_acceleration(r, omega, acceleration, alpha)
            alpha = plus(alpha, plus(times(a[tree.dof[j]], axis), times(rate, cross(omega, axis))))
            omega = plus(omega, times(rate, axis))
            sine = math.sin(half)
            pose = multiply(pose, (math.cos(half), sine * local_axis[0], sine * local_axis[1], sine * local_axis[2]))
            M = to_matrix(pose)
            r = times(-1.0, matvec(M, vec3(tree.anchor[j])))
            origin, velocity = plus(origin, r), plus(velocity, cross(omega, r))
            acceleration = _point_acceleration(r, omega, acceleration, alpha)
            store_vec3(axis, axes[j])
        store_vec3(origin, p[b])
        store_vec3(velocity, speed[b])
        store_vec3(acceleration, dv[b])
        store_vec3(omega, w[b])
        store_vec3(alpha, dw[b])
        quat[b, 0], quat[b, 1], quat[b, 2], quat[b, 3] = pose
        for k in range(3):
            store_vec3(M[k], R[b, k])


@numba.njit(**INNER_KERNEL)
def _point_acceleration(r: Vec3, w: Vec3, dv: Vec3, dw: Vec3) -> Vec3:
    """Acceleration dv + ω̇ × r + ω × (ω × r) of a point at r from an origin that accelerates with dv.

    `w` and `dw` are the angular velocity ω and acceleration ω̇ of the body; all vectors are in world axes.
    """
    return plus(dv, plus(cross(dw, r), cross(w, cross(w, r))))


@numba.njit(**INNER_KERNEL)
def _inertial_wrench(tree: Tree, b: int, bodies: _Bodies, gravity: Vec3) -> tuple[Vec3, Vec3, Vec3]:
    """Wrench that the motion of one body needs, without those that it carries.

    Args:
        tree: The bodies.
        b: Index of the body.
        bodies: Motion of all bodies.
        gravity: g in the world, m/s².

    Returns:
        Force m (a_com − g), N; moment about the body's origin, arm × force + R (I ω̇ + ω × I ω), N m; and the arm from
        the origin to the centre of mass, m. All are in world axes.
    """
    M, inertia, omega, alpha = mat3(bodies.R[b]), mat3(tree.inertia[b]), vec3(bodies.w[b]), vec3(bodies.dw[b])
    arm = matvec(M, vec3(tree.com[b]))
    force = times(tree.mass[b], minus(_point_acceleration(arm, omega, vec3(bodies.dv[b]), alpha), gravity))
    to_body = transposed(M)
    rate_in_body = matvec(to_body, omega)
    # rate of the angular momentum about the centre of mass, in the body's axes: I ω̇ + ω × I ω
    momentum_rate = plus(matvec(inertia, matvec(to_body, alpha)), cross(rate_in_body, matvec(inertia, rate_in_body)))
    return force, plus(cross(arm, force), matvec(M, momentum_rate)), arm


@numba.njit(**INNER_KERNEL)
def _world_inertia(tree: Tree, b: int, R: Array, arm: Vec3, out: Array) -> None:
    """Writes a body's inertia about its own origin in world axes: R I Rᵀ + m (|arm|² 1 − arm armᵀ), kg m².

    Args:
        tree: The bodies.
        b: Index of the body.
        R: (B, 3, 3) rotations of all bodies, body to world.
        arm: From the body's origin to its centre of mass, world axes, m.
        out: (3, 3) output.
    """
    M, inertia, mass = mat3(R[b]), mat3(tree.inertia[b]), tree.mass[b]
    for k in range(3):  # row k is column k, because the matrix is symmetric: R I times row k of R, minus m arm_k arm
        store_vec3(minus(matvec(M, matvec(inertia, vec3(R[b, k]))), times(mass * arm[k], arm)), out[k])
        out[k, k] += mass * dot(arm, arm)


@numba.njit(**INNER_KERNEL)
def _add_to_carrier(inertia: Array, first: Vec3, mass: float, d: Vec3, to_inertia: Array, to_first: Array) -> None:
    """Adds first moment and inertia of a composite body to those of its carrier, about the carrier's origin.

    Let h be the composite's first moment of mass about its own origin, m its mass, and d its place. The carrier gains
    the first moment h' = h + m d and the inertia I + (d·h' + d·h) 1 − d h'ᵀ − h dᵀ.

    Args:
        inertia: (3, 3) kg m² of the composite about its own origin.
        first: Its first moment of mass h, kg m.
        mass: Its mass, kg.
        d: From the carrier's origin to its own, m.
        to_inertia: (3, 3) inertia of the carrier, which is added to.
        to_first: (3,) first moment of the carrier, which is added to.
    """
    first_about_carrier = plus(first, times(mass, d))  # h'
    for k in range(3):
        # row k of d h'ᵀ + h dᵀ; the diagonal gets d·h' + d·h below
        outer_row = plus(times(d[k], first_about_carrier), times(first[k], d))
        store_vec3(plus(vec3(to_inertia[k]), minus(vec3(inertia[k]), outer_row)), to_inertia[k])
        to_inertia[k, k] += dot(d, first_about_carrier) + dot(d, first)
    store_vec3(plus(vec3(to_first), first_about_carrier), to_first)
