"""The compiled rigid tree against MuJoCo, whose model it reads."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from stridetwin.sim.config import SIDES, Exo, Person
from stridetwin.sim.kinematics.rigid_tree import Tree, body_motion, chain_loads, hinge_torques, root_wrench
from stridetwin.sim.wearer.body import add_wearer, compile_model
from stridetwin.sim.wearer.exoskeleton import EXO_LEG_BODIES
from stridetwin.streams.samples import Array

N = 12


def model_of(person: Person, exo: Exo | None) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    add_wearer(spec, person, exo)
    return compile_model(spec)


@pytest.fixture(scope="module", params=[Exo(), Exo(mode=1), None], ids=["unpowered", "powered", "bare"])
def model(request: pytest.FixtureRequest) -> mujoco.MjModel:
    return model_of(Person(height_m=1.83, mass_kg=91), request.param)


def moves(model: mujoco.MjModel) -> tuple[Array, Array, Array]:
    """Random poses, velocities and accelerations, (N, nq), (N, nv), (N, nv)."""
    rng = np.random.default_rng(4)
    q = rng.uniform(-1.0, 1.0, (N, model.nq))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    return q, rng.normal(0.0, 2.0, (N, model.nv)), rng.normal(0.0, 20.0, (N, model.nv))


def test_poses_and_velocities_are_those_of_mujoco(model: mujoco.MjModel) -> None:
    tree, data, twist = Tree.of(model), mujoco.MjData(model), np.empty(6)
    q, v, _ = moves(model)
    p, quat, speed, w = body_motion(tree, q, v)
    for i in range(N):
        data.qpos, data.qvel = q[i], v[i]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        for k, body in enumerate(tree.ids):
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, twist, 0)
            np.testing.assert_allclose(p[i, k], data.xpos[body], atol=1e-12)
            np.testing.assert_allclose(quat[i, k], data.xquat[body], atol=1e-12)
            np.testing.assert_allclose(speed[i, k], twist[3:], atol=1e-11)
            np.testing.assert_allclose(data.xmat[body].reshape(3, 3) @ w[i, k], twist[:3], atol=1e-11)


def test_root_wrench_is_that_of_inverse_dynamics(model: mujoco.MjModel) -> None:
    data, needed = mujoco.MjData(model), np.empty(model.nv)
    q, v, a = moves(model)
    force, moment, com = root_wrench(Tree.of(model), q, v, a, model.opt.gravity)
    for i in range(N):
        rne(model, data, q[i], v[i], a[i], needed)
        np.testing.assert_allclose(force[i], needed[:3], rtol=1e-10, atol=1e-8)
        R = data.body("root").xmat.reshape(3, 3)
        np.testing.assert_allclose(R.T @ moment[i], needed[3:6], rtol=1e-10, atol=1e-8)
        np.testing.assert_allclose(com[i], data.subtree_com[0], atol=1e-12)


def test_hinge_torques_are_those_of_inverse_dynamics_less_what_pushes(model: mujoco.MjModel) -> None:
    data, needed, push = mujoco.MjData(model), np.empty(model.nv), np.empty(model.nv)
    (q, v, a), tree, rng = moves(model), Tree.of(model), np.random.default_rng(5)
    bodies = np.array([len(tree.ids) - 1, 0, 5, 5])
    forces, moments = rng.normal(0.0, 100.0, (2, len(bodies), N, 3))
    torque = hinge_torques(tree, q, v, a, model.opt.gravity, bodies, forces, moments)
    for i in range(N):
        rne(model, data, q[i], v[i], a[i], needed)
        push[:] = 0.0
        for k, body in enumerate(tree.ids[bodies]):
            mujoco.mj_applyFT(model, data, forces[k, i], moments[k, i], data.xpos[body], body, push)
        np.testing.assert_allclose(torque[i], (needed - push)[tree.dof], rtol=1e-9, atol=1e-8)


@pytest.mark.parametrize("alone", [False, True], ids=["whole", "only"])
@pytest.mark.parametrize("exo", [Exo(), Exo(mode=2, joints=("hip_l", "hip_r"))], ids=["unpowered", "hips"])
def test_mass_and_loads_of_the_exoskeletons_legs_are_those_of_mujoco(exo: Exo, alone: bool) -> None:
    model = model_of(Person(), exo)
    tree, data = Tree.of(model), mujoco.MjData(model)
    names = [[f"{body}_{side}" for body in EXO_LEG_BODIES] for side in SIDES]
    chains = legs(tree, model, names)
    if alone:
        tree = tree.subtree(chains.ravel().tolist())
        chains = legs(tree, model, names)
    q, v, a = moves(model)
    mass, load = chain_loads(tree, chains, q, v, a, model.opt.gravity)
    dofs = model.body_dofadr[[[model.body(name).id for name in own] for own in names]]
    needed, full = np.empty(model.nv), np.empty((model.nv, model.nv))
    for i in range(N):
        rne(model, data, q[i], v[i], a[i], needed)
        mujoco.mj_crb(model, data)
        mujoco.mj_fullM(model, data, full)
        for k, own in enumerate(dofs):
            np.testing.assert_allclose(load[i, k], needed[own], rtol=1e-10, atol=1e-9)
            block = full[np.ix_(own, own)] - np.diag(model.dof_armature[own])
            np.testing.assert_allclose(mass[i, k], block, rtol=1e-10, atol=1e-11)


def legs(tree: Tree, model: mujoco.MjModel, names: list[list[str]]) -> NDArray[np.int64]:
    return np.array([[tree.index_of(model.body(name).id) for name in own] for own in names])


def rne(model: mujoco.MjModel, data: mujoco.MjData, q: Array, v: Array, a: Array, needed: Array) -> None:
    data.qpos, data.qvel, data.qacc = q, v, a
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_comVel(model, data)
    mujoco.mj_rne(model, data, 1, needed)
