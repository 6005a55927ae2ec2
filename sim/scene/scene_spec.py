"""The model of a scene: a walk's model with what MuJoCo needs to show and step it alone.

The twin moves its model by a planned motion and a whole-body controller of its own. A scene has neither: servos hold
the wearer's joints, and constraints between sites tie the exoskeleton to the wearer, in the place of the twin's
couplings (`exo_couplings`). Bodies, joints and geoms stay as composed.

The rig is a site per sensor and board, a MuJoCo camera per camera, and MuJoCo's own sensors where it has them. Names
are topics with underscores: `/foot_l/imu` is `foot_l_imu`. A camera of MuJoCo has neither distortion nor noise.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

import mujoco
import numpy as np

from stridetwin.sim.composition import Composition, compose
from stridetwin.sim.config import TwinConfig
from stridetwin.sim.dynamics.drive import DRIVER_S
from stridetwin.sim.dynamics.soles import TOE_STIFFNESS
from stridetwin.sim.exo_description import hinge_of
from stridetwin.sim.rendering.renderer import FAR_M, NEAR_M, swap_camera_convention
from stridetwin.sim.wearer.body import compile_model
from stridetwin.sim.wearer.exo_couplings import exo_couplings
from stridetwin.sim.wearer.exoskeleton import modules
from stridetwin.sim.wearer.sensor_bodies import UPPERS
from stridetwin.sim.world.bystanders import plan_bystanders, pose_crowd
from stridetwin.streams.algebra.arrays import to_quaternion
from stridetwin.streams.rig import Mount, Rig

KEYFRAME = "stand"
_PERSON_M = 2.0  # extent of the view in which a viewer opens
_SENSOR, _SITE, _JOINT = mujoco.mjtSensor, mujoco.mjtObj.mjOBJ_SITE, mujoco.mjtObj.mjOBJ_JOINT
_SITE_M, _CUFF_SITE_M = 0.004, 0.005  # size of the sites


# Servos of the wearer's joints; chosen by hand.
_TRUNK_NM_RAD = 1500.0
"""Legs and lumbar spine: three times the weight's pull at the ankles of a tall person, who falls below 0.5 kN m/rad per
ankle."""
# neck and arms carry only themselves; the toes have the stiffness of the simulated walk
_SERVO_NM_RAD = {"neck": 80.0, "shoulder": 80.0, "elbow": 80.0, "toe": TOE_STIFFNESS}
_DAMPING_RATIO = 1.0  # share of critical damping
_SEED = 0  # of the bystanders' size and places


def scene_spec(config: TwinConfig, seed: int = 0) -> mujoco.MjSpec:
    """The composed model of a walk with everything that MuJoCo needs to show and step it alone.

    Args:
        config: Scenario.
        seed: Of the walk, which draws its floor.

    Raises:
        ConfigError: A value that cannot be built.
    """
    composition = compose(config, seed)
    spec = composition.spec
    spec.modelname = config.name
    _add_sensor_sites(spec, composition.sensor_rig.rig)
    _add_servos_and_keyframe(composition, config)
    route_m = float(compile_model(spec).stat.extent)  # of the whole scene
    spec.stat.extent, spec.stat.center = _PERSON_M, (0.0, 0.0, 0.9)  # a viewer opens on the middle of the person
    # distances of the near and the far plane, and the reach of shadows, over the whole route; all in extents
    scale = spec.visual.map
    scale.znear, scale.zfar, scale.shadowclip = NEAR_M / _PERSON_M, FAR_M / _PERSON_M, route_m / _PERSON_M
    view = getattr(spec.visual, "global")
    # from the side in front; between walls from the front
    view.azimuth, view.elevation = 180.0 if config.route.scenery == "corridor" else 140.0, -12.0
    view.offwidth, view.offheight = 1920, 1080  # largest image that can be rendered off screen, pixels
    return spec


def _add_sensor_sites(spec: mujoco.MjSpec, rig: Rig) -> None:
    """Adds sites, cameras and sensors of a rig to a model that has the wearer's and the sensors' bodies."""
    for name, mount in _site_mounts(rig):
        T = mount.T_body_sensor
        _mount_body(spec, mount).add_site(
            name=name, pos=T[:3, 3], quat=to_quaternion(T[:3, :3]), size=np.full(3, _SITE_M)
        )
    for camera in rig.cameras.values():
        T = swap_camera_convention(camera.mount.T_body_sensor)
        _mount_body(spec, camera.mount).add_camera(
            name=_scene_name(camera.topic),
            pos=T[:3, 3],
            quat=to_quaternion(T[:3, :3]),
            # vertical field of view, from the height and the vertical focal length in pixels
            fovy=math.degrees(2 * math.atan2(camera.height / 2, camera.intrinsics[1])),
            resolution=[camera.width, camera.height],
        )
    for topic in rig.imus:
        _add_sensor(spec, f"{_scene_name(topic)}_gyro", _SENSOR.mjSENS_GYRO, _SITE, _scene_name(topic))
        _add_sensor(
            spec, f"{_scene_name(topic)}_accelerometer", _SENSOR.mjSENS_ACCELEROMETER, _SITE, _scene_name(topic)
        )
    for topic, sensor in rig.others.items():
        name = _scene_name(topic)
        if sensor.kind == "ahrs":
            _add_sensor(spec, name, _SENSOR.mjSENS_FRAMEQUAT, _SITE, name)
        elif sensor.kind == "encoder":
            joint = topic.split("/")[2]  # such as `knee_l` of `/exo/knee_l/encoder`
            _add_sensor(spec, name, _SENSOR.mjSENS_JOINTPOS, _JOINT, hinge_of(joint))


def _scene_name(topic: str) -> str:
    """Name of a topic's site, camera or sensor in a scene."""
    return re.sub(r"\W", "_", topic.strip("/"))


def _site_mounts(rig: Rig) -> Iterator[tuple[str, Mount]]:
    """Name in the scene, and mount, of the site of every sensor and board of a rig."""
    for sensors in (rig.imus, rig.cameras, rig.others):
        yield from ((_scene_name(topic), sensor.mount) for topic, sensor in sensors.items())
    for name, board in rig.boards.items():
        yield f"{name}_board", board.mount


def _mount_body(spec: mujoco.MjSpec, mount: Mount) -> mujoco.MjsBody:
    """Body of the model that carries a mount; for a foot, the shoe's upper."""
    return spec.body(UPPERS.get(mount.body, mount.body))


def _add_sensor(spec: mujoco.MjSpec, name: str, kind: mujoco.mjtSensor, of: mujoco.mjtObj, target: str) -> None:
    """Adds one of MuJoCo's own sensors, of the type `kind`, to the site or joint `target`; `of` says which it is."""
    spec.add_sensor(name=name, type=kind, objtype=of, objname=target)


def _add_servos_and_keyframe(composition: Composition, config: TwinConfig) -> None:
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
    # the keyframe: the wearer stands, and bystanders stand around the start (a walk of 1 s that stays there)
    model = compile_model(spec)
    data = mujoco.MjData(model)
    crowd = plan_bystanders(
        config.route.bystanders,
        composition.terrain,
        np.array([0.0, 1.0]),
        np.zeros(2),
        np.zeros((2, 2)),
        np.random.default_rng(_SEED),
    )
    pose_crowd(model, data, crowd, 0.0)
    spec.add_key(
        name=KEYFRAME,
        qpos=model.qpos0,
        ctrl=np.zeros(model.nu),
        mpos=data.mocap_pos.ravel(),
        mquat=data.mocap_quat.ravel(),
    )


def _add_cuffs(composition: Composition) -> None:
    """Adds a pair of sites and an equality constraint for every cuff.

    A strap holds its point on the limb (`connect`), a holder the rotation, too (`weld`); both are soft constraints with
    MuJoCo's own defaults.
    """
    spec = composition.spec
    for cuff in exo_couplings(composition.size):
        # (name of the site, body, place on it, m) on the exoskeleton, then on the wearer
        ends = (f"cuff_{cuff.name}", cuff.exo_body, cuff.p_in_exo), (f"limb_{cuff.name}", cuff.body, cuff.p_in_body)
        for name, body, place in ends:
            spec.body(body).add_site(name=name, pos=place, size=np.full(3, _CUFF_SITE_M))
        spec.add_equality(
            name=f"cuff_{cuff.name}",
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1=ends[0][0],
            name2=ends[1][0],
            # a strap lets the limb slide along itself: its stiffness along z is 0
            type=mujoco.mjtEq.mjEQ_WELD if cuff.law[0, 2, 2] > 0.0 else mujoco.mjtEq.mjEQ_CONNECT,
        )


def _add_actuators(spec: mujoco.MjSpec, config: TwinConfig) -> None:
    """Adds a servo for each hinge of the wearer and a motor for each powered hinge, with the hinge's name."""
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE and not joint.name.startswith("exo_"):
            servo = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            # by the first part of the name, as in `neck_flexion`; legs and lumbar spine have the trunk's stiffness
            kp = _SERVO_NM_RAD.get(joint.name.partition("_")[0], _TRUNK_NM_RAD)
            servo.set_to_position(kp=kp, dampratio=_DAMPING_RATIO)
    if config.exo is None:
        return
    for name, module in modules(config.exo).items():
        hinge = hinge_of(name)
        motor = spec.add_actuator(
            name=hinge,
            target=hinge,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            ctrllimited=True,
            ctrlrange=[-module.torque_max_nm, module.torque_max_nm],
        )
        motor.set_to_motor()
