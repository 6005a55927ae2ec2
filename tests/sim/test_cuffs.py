"""Cuffs between exoskeleton and wearer: which way they push, and what the pairs of force cells measure of it."""

from __future__ import annotations

from itertools import pairwise

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stridetwin.sim.config import Exo, Level, Route, TwinConfig
from stridetwin.sim.dynamics.couplings import CouplingSet
from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.kinds import ForceCellPart
from stridetwin.sim.sensors.force_cells import InteractionModel
from stridetwin.sim.sensors.standard_rig import sensor_rig
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.exo_couplings import BodyState, exo_couplings, wrench
from stridetwin.sim.wearer.exoskeleton import EXO_LEG_JOINTS
from stridetwin.streams.rig import OtherSensor
from stridetwin.streams.samples import Array, Block

CONFIG = TwinConfig(
    name="cuffs", route=Route(segments=(Level(length_m=4.0),)), exo=Exo(), sensors=("interaction",), ideal=True
)
PLACES = tuple(f"{part}_{side}" for part in ("thigh", "shank") for side in "lr")


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin(CONFIG, 4)


def force_cells(place: str) -> InteractionModel:
    sensor = sensor_rig(CONFIG).sensors[f"/exo/{place}/interaction"]
    assert isinstance(sensor.calibration, OtherSensor)
    assert isinstance(sensor.part, ForceCellPart)
    return InteractionModel(sensor.calibration, sensor.part, Noise(None))


def settled(twin: Twin, place: str, push: float) -> float:
    """Force of a cuff on a standing wearer, N, forward positive, once a forward push on the frame there has settled."""
    model, dt = twin.model, 1e-3
    own = np.array([model.joint(f"{j}_{s}").dofadr[0] for s in "lr" for j in EXO_LEG_JOINTS])
    ties = [(c, model.body(c.exo_body).id, model.body(c.body).id) for c in exo_couplings(twin.size)]
    cuff = next(tie for tie in ties if tie[0].name == place)
    data, needed, full = mujoco.MjData(model), np.empty(model.nv), np.empty((model.nv, model.nv))
    data.qpos = twin.reference.state(np.zeros(1))[0][0]
    angle, speed = data.qpos[own + 1].copy(), np.zeros(len(own))

    def pose(body: int) -> BodyState:
        twist = np.empty(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, twist, 0)
        return BodyState(p=data.xpos[body], R=data.xmat[body].reshape(3, 3), v=twist[3:], w=twist[:3])

    for _ in range(600):
        data.qpos[own + 1], data.qvel[own] = angle, speed
        mujoco.mj_forward(model, data)
        mujoco.mj_rne(model, data, 0, needed)
        mujoco.mj_fullM(model, data, full)
        given_force = np.zeros(model.nv)
        for c, exo, body in ties:
            force, torque, point = wrench(c, pose(exo), pose(body))
            mujoco.mj_applyFT(model, data, force, torque, point, exo, given_force)
        at = data.xpos[cuff[1]] + data.xmat[cuff[1]].reshape(3, 3) @ cuff[0].p_in_exo
        mujoco.mj_applyFT(model, data, [push, 0.0, 0.0], np.zeros(3), at, cuff[1], given_force)
        speed = speed + dt * np.linalg.solve(full[np.ix_(own, own)], (given_force - needed)[own])
        angle = angle + dt * speed
    force, _, _ = wrench(cuff[0], pose(cuff[1]), pose(cuff[2]))
    return -float(force @ data.xmat[cuff[1]].reshape(3, 3)[:, 0])


@pytest.mark.parametrize("place", PLACES)
def test_pushing_the_frame_pushes_the_limb_the_same_way(twin: Twin, place: str) -> None:
    pair = force_cells(place)
    differences = []
    for push in (40.0, -40.0):
        on_limb = settled(twin, place, push)
        front, back = pair.read(np.array([0]), np.array([-on_limb])).columns["force"][0]
        assert front - back == pytest.approx(-on_limb)
        differences.append(back - front)  # a frame that pushes forward presses on the limb's back
    assert differences[0] > 2.0
    assert differences[1] < -2.0
    assert differences[0] - differences[1] > 15.0


def test_every_pair_changes_sign_in_every_stride_and_measures_the_cuffs_force(twin: Twin) -> None:
    read: dict[str, list[Array]] = {}
    for chunk in twin.blocks():
        for block in chunk:
            if isinstance(block, Block) and block.topic.endswith("/interaction"):
                force = block.columns["force"]
                assert force.min() >= 0.0
                read.setdefault(block.topic, []).append(np.column_stack([block.t_ns, force]))
    for place in PLACES:
        rows = np.concatenate(read[f"/exo/{place}/interaction"])
        t, push = rows[:, 0] * 1e-9, rows[:, 2] - rows[:, 1]
        truth = twin.player().motion(rows[:, 0].astype(np.int64)).cuff_force[place]
        np.testing.assert_allclose(push, truth, atol=1e-9)
        touch = [s.t_touch for s in twin.walk.steps[place[-1]] if np.isfinite(s.t_touch)]
        for begin, end in pairwise(touch):
            stride = push[(t > begin) & (t < end)]
            assert stride.min() < -1.0 < 1.0 < stride.max(), place


@given(push=st.floats(-300.0, 300.0))
def test_cells_only_press_and_their_difference_is_the_force(push: float) -> None:
    pair = force_cells("shank_r")
    front, back = pair.read(np.array([0]), np.array([push])).columns["force"][0]
    assert min(front, back) >= 0.0
    assert front - back == pytest.approx(push, abs=1e-9)
    assert (front > 5.0) == (push > 0.0) or push == 0.0 or abs(push) < 1e-9


def test_a_wearer_without_exoskeleton_has_no_couplings_to_simulate() -> None:
    bare = TwinConfig(name="bare", route=Route(segments=(Level(length_m=4.0),)), exo=None, sensors=())
    twin = Twin(bare, 4)
    none = CouplingSet.of(twin.model, exo_couplings(twin.size))
    assert none.bodies.shape == (0, 2)
    assert none.bodies.dtype == np.int64
    assert none.chain.dtype == np.bool_
