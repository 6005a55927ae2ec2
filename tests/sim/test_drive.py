"""What drives the actuation modules."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from stridetwin.sim.actuation import HIP, KNEE
from stridetwin.sim.config import Exo, Level, Route, TwinConfig
from stridetwin.sim.dynamics.drive import PERIOD_S, Drive
from stridetwin.sim.dynamics.simulated_walk import SimulatedWalk
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Actuator, Block

WALK = TwinConfig(
    name="driven", route=Route(segments=(Level(length_m=4.0),)), sensors=("actuator",), physics="dynamic",
    exo=Exo(mode=1, drive="assist"),
)  # fmt: skip


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin(WALK, 3)


def hinge(model: mujoco.MjModel, name: str) -> tuple[int, int]:
    joint = model.joint(name)
    return int(joint.qposadr[0]), int(joint.dofadr[0])


def test_idle_motors_and_none_give_no_torque(twin: Twin) -> None:
    data = mujoco.MjData(twin.model)
    data.qvel[:] = 3.0
    for exo in (None, Exo(mode=1), Exo(mode=0, drive="transparent")):
        drive = Drive(twin.model, exo)
        for _ in range(3):
            assert not drive.torques(data).any()


def test_transparent_motors_push_along_the_motion_but_less_than_friction_holds(twin: Twin) -> None:
    data, drive = mujoco.MjData(twin.model), Drive(twin.model, Exo(mode=1, drive="transparent"))
    _, hip = hinge(twin.model, "exo_hip_flexion_l")
    _, knee = hinge(twin.model, "exo_knee_flexion_r")
    data.qvel[hip], data.qvel[knee] = 2.0, -3.0
    assert not drive.torques(data).any()  # a call late
    torque = drive.torques(data)
    assert 0.0 < torque[hip] < HIP.friction_nm + 2.0 * HIP.viscous_nms
    assert -(KNEE.friction_nm + 3.0 * KNEE.viscous_nms) < torque[knee] < 0.0
    assert np.count_nonzero(torque) == 2


def test_motors_beyond_their_speed_give_nothing(twin: Twin) -> None:
    data, drive = mujoco.MjData(twin.model), Drive(twin.model, Exo(mode=1, drive="transparent"))
    _, hip = hinge(twin.model, "exo_hip_flexion_l")
    data.qvel[hip] = HIP.speed_max_radps + 0.1
    drive.torques(data)
    assert not drive.torques(data).any()


def test_assist_gives_power_to_hips_that_swing_like_a_walkers(twin: Twin) -> None:
    data, drive = mujoco.MjData(twin.model), Drive(twin.model, Exo(mode=1, drive="assist"))
    plain = Drive(twin.model, Exo(mode=1, drive="transparent"))
    at = {side: hinge(twin.model, f"exo_hip_flexion_{side}") for side in "lr"}
    gained = []
    for k in range(400):
        phase = 2.0 * math.pi * k * PERIOD_S  # a stride a second
        for sign, side in ((1.0, "l"), (-1.0, "r")):
            data.qpos[at[side][0]] = sign * 0.35 * math.sin(phase)
            data.qvel[at[side][1]] = sign * 0.35 * 2.0 * math.pi * math.cos(phase)
        more = drive.torques(data) - plain.torques(data)
        gained.append(sum(more[dof] * data.qvel[dof] for _, dof in at.values()))
    assert np.mean(gained[100:]) > 2.0  # W


def test_a_planned_walk_has_no_motors_to_drive() -> None:
    with pytest.raises(ConfigError, match=r"exo\.drive.*assist.*idle, or physics dynamic"):
        Twin(replace(WALK, physics="kinematic"), 3)


def test_actuators_tell_what_the_motors_did(twin: Twin) -> None:
    walk = twin.walk
    assert isinstance(walk, SimulatedWalk)
    assert walk.fell_at is None
    told = [
        b for group in twin.blocks() for b in group
        if isinstance(b, Block) and b.topic == "/exo/hip_l/actuator" and b.kind is Actuator
    ]  # fmt: skip
    command = np.concatenate([b.columns["torque_command"] for b in told])
    t = np.concatenate([b.t_ns for b in told]) * 1e-9
    names = walk.coordinates.names[6:]
    true = walk.efforts(t)[0][:, names.index("exo_hip_flexion_l")]
    assert np.abs(command).max() > 5.0
    assert np.corrcoef(command, true)[0, 1] > 0.97
