"""What drives the actuation modules."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from stridetwin.sim.config import Exo, Gait, Level, Route, TwinConfig
from stridetwin.sim.dynamics.drive import DRIVER_S, PERIOD_S, Drive
from stridetwin.sim.dynamics.simulated_walk import SimulatedWalk
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.exoskeleton import HIP, KNEE
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Actuator, Block

WALK = TwinConfig(
    name="driven",
    route=Route(segments=(Level(length_m=4.0),)),
    gait=Gait(stand_s=0.5),
    sensors=("actuator",),
    physics="dynamic",
    exo=Exo(mode=1, drive="assist"),
)


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin(WALK, 3)


def hinge(model: mujoco.MjModel, name: str) -> tuple[int, int]:
    joint = model.joint(name)
    return int(joint.qposadr[0]), int(joint.dofadr[0])


def swinging(twin: Twin, drive: Drive, speed_share: float = 1.0) -> list[float]:
    """W given to hips that swing like a walker's, a stride a second."""
    data = mujoco.MjData(twin.model)
    at = {side: hinge(twin.model, f"exo_hip_flexion_{side}") for side in "lr"}
    given = []
    for k in range(4000):
        phase = 2.0 * math.pi * k * DRIVER_S
        for sign, side in ((1.0, "l"), (-1.0, "r")):
            data.qpos[at[side][0]] = sign * 0.35 * math.sin(phase)
            data.qvel[at[side][1]] = sign * 0.35 * 2.0 * math.pi * math.cos(phase) * speed_share
        torque = drive.torques(data)
        assert np.abs(torque[[dof for _, dof in at.values()]]).max() <= HIP.torque_max_nm
        assert np.count_nonzero(torque) <= 2
        given.append(sum(torque[dof] * data.qvel[dof] for _, dof in at.values()))
    return given


def test_idle_motors_and_none_give_no_torque(twin: Twin) -> None:
    for exo in (None, Exo(mode=1), Exo(mode=0)):
        assert not any(swinging(twin, Drive(twin.model, exo)))


def test_assist_gives_power_to_hips_that_swing_like_a_walkers(twin: Twin) -> None:
    assert np.mean(swinging(twin, Drive(twin.model, Exo(mode=1, drive="assist")))[1000:]) > 2.0  # W


def test_motors_beyond_their_speed_can_only_brake(twin: Twin) -> None:
    too_fast = 40.0 * HIP.speed_max_radps
    given = swinging(twin, Drive(twin.model, Exo(mode=1, drive="assist")), speed_share=too_fast)
    assert np.count_nonzero(np.array(given) > 0.0) < 0.05 * len(given)  # where the legs turn round they are slow


def test_drivers_compensate_most_of_their_rotors(twin: Twin) -> None:
    """A frame that follows the wearer's knee feels a fifth of the rotor, and a hundredth of a second of lag."""
    drive, data = Drive(twin.model, Exo(mode=1, drive="assist")), mujoco.MjData(twin.model)
    _, dof = hinge(twin.model, "exo_knee_flexion_l")
    t = np.arange(0.0, 2.0, DRIVER_S)
    speed = np.sin(10.0 * t)
    given = np.empty_like(t)
    for k, v in enumerate(speed):
        data.qvel[dof] = v
        given[k] = drive.torques(data)[dof]
    rotor = KNEE.reflected_inertia * np.gradient(speed, t)
    felt = (rotor - given)[200:]
    assert np.sqrt(np.mean(felt**2)) < 0.25 * np.sqrt(np.mean(rotor[200:] ** 2))
    assert np.mean((given * speed)[200:]) < 0.05  # W; carrying a rotor is no drive


def test_hips_without_modules_cannot_be_helped(twin: Twin) -> None:
    for exo in (Exo(mode=0, drive="assist"), Exo(mode=2, joints=("knee_l", "knee_r"), drive="assist")):
        with pytest.raises(ConfigError, match=r"drive.*assist.*both hips"):
            Drive(twin.model, exo)


def test_a_planned_walk_has_no_motors_to_drive() -> None:
    with pytest.raises(ConfigError, match=r"exo\.drive.*assist.*idle, or physics dynamic"):
        Twin(replace(WALK, physics="kinematic"), 3)


def test_actuators_measure_torque_and_speed_of_the_motors(twin: Twin) -> None:
    walk = twin.walk
    assert isinstance(walk, SimulatedWalk)
    assert walk.fell_at is None
    sampled = [
        b
        for group in twin.blocks()
        for b in group
        if isinstance(b, Block) and b.topic == "/exo/hip_l/actuator" and b.kind is Actuator
    ]
    command = np.concatenate([b.columns["torque_command"] for b in sampled])
    t = np.concatenate([b.t_ns for b in sampled]) * 1e-9
    names = walk.coordinates.names[6:]
    true = walk.efforts(t)[0][:, names.index("exo_hip_flexion_l")]
    assert np.abs(command).max() > 5.0
    assert np.corrcoef(command, true)[0, 1] > 0.97


def test_a_law_of_ones_own_is_followed_a_period_later(twin: Twin) -> None:
    asked = iter(np.arange(1.0, 9.0)[:, None] * np.ones(4))
    drive, data = Drive(twin.model, Exo(mode=1), lambda angle: next(asked)), mujoco.MjData(twin.model)
    given = np.array([drive.torques(data)[hinge(twin.model, "exo_knee_flexion_l")[1]] for _ in range(40)])
    assert given.reshape(4, -1).tolist() == [[k] * round(PERIOD_S / DRIVER_S) for k in (0.0, 1.0, 2.0, 3.0)]
