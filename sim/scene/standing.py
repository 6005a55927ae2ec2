"""What lets MuJoCo alone step a composed model: cuffs, servos in the joints, and a keyframe that stands.

The twin moves its model by a planned motion and a whole-body controller of its own. A scene has neither: servos hold
the wearer's joints, and constraints between sites tie the exoskeleton to the wearer, in the place of the twin's
couplings (`exo_couplings`). Bodies, joints and geoms stay as composed.
"""

from __future__ import annotations

import mujoco
import numpy as np

from stridetwin.sim.composition import Composition
from stridetwin.sim.config import TwinConfig
from stridetwin.sim.dynamics.drive import DRIVER_S
from stridetwin.sim.exo_description import hinge_of
from stridetwin.sim.wearer.body import compile_model
from stridetwin.sim.wearer.exo_couplings import couplings
from stridetwin.sim.wearer.exoskeleton import modules
from stridetwin.sim.world.bystanders import bystanders, pose
from stridetwin.streams.samples import Array

KEYFRAME = "stand"


# Servos of the wearer's joints; chosen by hand.
_TRUNK_NM_RAD = 1500.0
"""Legs and lumbar spine: three times the weight's pull at the ankles of a tall person, who falls below 0.5 kN m/rad per
ankle."""
_LIMB_NM_RAD = 80.0  # neck and arms, which carry only themselves
_TOE_NM_RAD = 40.0  # the same as the toes of the simulated walk (`soles.TOE_STIFFNESS`)
_DAMPING_RATIO = 1.0  # share of critical damping
_SEED = 0  # of the bystanders' size and places


def add_standing(composition: Composition, config: TwinConfig) -> None:
    """Adds cuffs, servos, motors and the keyframe `KEYFRAME`; contacts are on, with the forward simulation's step.

    Args:
        composition: The composed model, which is changed.
        config: What it was composed from.
    """
    spec = composition.spec
    spec.option.disableflags = 0
    spec.option.timestep = DRIVER_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    _add_cuffs(composition)
    _add_actuators(spec, config)
    model = compile_model(spec)
    data = mujoco.MjData(model)
    still = np.zeros(2)
    crowd = bystanders(
        config.route.bystanders, composition.terrain, np.array([0.0, 1.0]), still, np.zeros((2, 2)),
        np.random.default_rng(_SEED),
    )  # fmt: skip
    pose(model, data, crowd, 0.0)
    spec.add_key(
        name=KEYFRAME, qpos=model.qpos0, ctrl=np.zeros(model.nu), mpos=data.mocap_pos.ravel(),
        mquat=data.mocap_quat.ravel(),
    )  # fmt: skip


def _add_cuffs(composition: Composition) -> None:
    """A strap holds its point on the limb, a holder the rotation, too; soft constraints with MuJoCo's own defaults."""
    spec = composition.spec
    for cuff in couplings(composition.size):
        ends = (f"cuff_{cuff.name}", cuff.exo_body, cuff.p_in_exo), (f"limb_{cuff.name}", cuff.body, cuff.p_in_body)
        for name, body, place in ends:
            spec.body(body).add_site(name=name, pos=place, size=_site_size())
        holds = cuff.stiffness[2, 2] > 0.0
        spec.add_equality(
            name=f"cuff_{cuff.name}", objtype=mujoco.mjtObj.mjOBJ_SITE, name1=ends[0][0], name2=ends[1][0],
            type=mujoco.mjtEq.mjEQ_WELD if holds else mujoco.mjtEq.mjEQ_CONNECT,
        )  # fmt: skip


def _site_size() -> Array:
    return np.array([0.005, 0.005, 0.005])


def _servo_stiffness(joint: str) -> float:
    """Stiffness of the servo of one of the wearer's joints, N m/rad."""
    if joint.startswith("toe"):
        return _TOE_NM_RAD
    return _LIMB_NM_RAD if joint.startswith(("neck", "shoulder", "elbow")) else _TRUNK_NM_RAD


def _add_actuators(spec: mujoco.MjSpec, config: TwinConfig) -> None:
    """Servos named as the wearer's hinges, and motors named as those of the exoskeleton that modules drive."""
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE and not joint.name.startswith("exo_"):
            servo = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            servo.set_to_position(kp=_servo_stiffness(joint.name), dampratio=_DAMPING_RATIO)
    if config.exo is None:
        return
    for name, module in modules(config.exo).items():
        hinge = hinge_of(name)
        motor = spec.add_actuator(
            name=hinge, target=hinge, trntype=mujoco.mjtTrn.mjTRN_JOINT, ctrllimited=True,
            ctrlrange=[-module.torque_max_nm, module.torque_max_nm],
        )  # fmt: skip
        motor.set_to_motor()
