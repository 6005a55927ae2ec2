"""The standard rig: every sensor of the wearer, where it sits and what its data sheet says.

Noise figures are those of the parts' data sheets; where a sheet is silent the comment says what stands in.
Random walks are not on data sheets: ours let a bias wander by its in-run instability in 100 s.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from stridetwin.sim.actuation import modules
from stridetwin.sim.config import SIDES, Exo, TwinConfig
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import Board, CameraCalibration, ImuCalibration, Mount, OtherSensor, Rig
from stridetwin.streams.samples import Array

GROUPS = (
    "foot_imu", "foot_camera", "sonar", "insole", "ahrs", "encoder", "interaction", "actuator", "head_imu",
    "head_camera",
)  # fmt: skip
EXO_GROUPS = ("ahrs", "encoder", "interaction", "actuator")
_G = 9.80665
_DEG = math.pi / 180
_WALK_S = 100.0

# RGB-D camera: 640 x 480 is cut to 4:3 from the 1280 x 800 picture of 90 deg and scaled by 0.6, so 0.6 * 640
# px.
RGBD_FOCAL_PX = 384.0
RGBD_PITCH_RAD = 25 * _DEG
_RGBD_MOUNT = {"head": ("head", (0.10, 0.0, 0.12)), "chest": ("torso", (0.14, 0.0, 0.30))}
# D455 data sheet: the IMU relative to the imagers, optical axes.
_P_IMU_IN_RGBD = (-0.0302, 0.0074, 0.0160)


def standard_rig(config: TwinConfig) -> Rig:
    """The rig that a walk carries.

    Args:
        config: Which groups of sensors are on, and where the RGB-D camera sits. Without exoskeleton the groups that sit
            on it are left out.

    Returns:
        Rig with the sensors of the chosen groups.

    Raises:
        ConfigError: An unknown group of sensors or an unknown place for the RGB-D camera.
    """
    for i, group in enumerate(config.sensors):
        if group not in GROUPS:
            raise ConfigError(config.name, f"sensors[{i}]", group, ", ".join(GROUPS))
    if config.rig_mount not in _RGBD_MOUNT:
        raise ConfigError(config.name, "rig_mount", config.rig_mount, " or ".join(_RGBD_MOUNT))
    on = set(config.sensors) - set(EXO_GROUPS if config.exo is None else ())
    imus: list[ImuCalibration] = []
    cameras: list[CameraCalibration] = []
    boards: list[Board] = []
    for side in SIDES:
        if "foot_imu" in on:
            imus.append(_foot_imu(side))
        if "foot_camera" in on:
            cameras.append(_foot_camera(side))
            boards.append(_board(side))
    if "head_camera" in on:
        cameras.append(_rgbd_camera(config.rig_mount))
    if "head_imu" in on:
        imus.append(_rgbd_imu(config.rig_mount))
    others = [s for group, sensors in _OTHERS.items() if group in on for s in sensors()]
    if config.exo is not None and "actuator" in on:
        others += _actuators(config.exo)
    return Rig(
        imus={s.topic: s for s in imus},
        cameras={s.topic: s for s in cameras},
        boards={b.name: b for b in boards},
        others={s.topic: s for s in others},
    )


def _foot_imu(side: str) -> ImuCalibration:
    # Analog Devices ADIS16485: 0.3 deg/sqrt(h), 6.25 deg/h in run, +-0.2 deg/s repeatability; 0.023
    # m/s/sqrt(h), 32 ug in run, +-3 mg repeatability.
    return ImuCalibration(
        topic=f"/foot_{side}/imu",
        part="Analog Devices ADIS16485",
        rate_hz=120.0,
        mount=Mount(body=f"foot_{side}", T_body_sensor=_pose(np.eye(3), (-0.030, 0.042 * _outward(side), 0.060))),
        gyroscope_noise_density=0.3 * _DEG / 60,
        gyroscope_random_walk=6.25 * _DEG / 3600 / math.sqrt(_WALK_S),
        accelerometer_noise_density=0.023 / 60,
        accelerometer_random_walk=32e-6 * _G / math.sqrt(_WALK_S),
        gyroscope_bias_sd=0.2 * _DEG,
        accelerometer_bias_sd=3e-3 * _G,
    )


def _foot_camera(side: str) -> CameraCalibration:
    inward = -_outward(side)
    forward = _direction(27 * _DEG * inward, 24 * _DEG)
    return CameraCalibration(
        topic=f"/foot_{side}/camera",
        part="Basler acA800-200gc",
        rate_hz=60.0,
        mount=Mount(
            body=f"foot_{side}",
            T_body_sensor=_pose(_looking(forward, roll=math.pi / 2 * inward), (-0.070, 0.045 * inward, 0.036)),
        ),
        width=800,
        height=600,
        intrinsics=_pinhole(800, 600, 400 / math.tan(36.5 * _DEG)),
        imu_topic=f"/foot_{side}/imu",
    )


def _board(side: str) -> Board:
    inward = -_outward(side)
    out = _direction(167 * _DEG * inward, 2 * _DEG)
    up = np.array([0.0, 0.0, 1.0]) - out[2] * out
    up /= np.linalg.norm(up)
    rotation = np.column_stack([np.cross(up, out), up, out])
    return Board(
        name=f"foot_{side}",
        mount=Mount(body=f"foot_{side}", T_body_sensor=_pose(rotation, (-0.074, -0.005 * inward, 0.066))),
        squares=(6, 9),
        square_m=0.005,
    )


def _rgbd_camera(where: str) -> CameraCalibration:
    return CameraCalibration(
        topic=f"/{where}/color",
        part="Intel RealSense D455",
        rate_hz=30.0,
        mount=_rgbd_mount(where),
        width=640,
        height=480,
        intrinsics=_pinhole(640, 480, RGBD_FOCAL_PX),
        depth_topic=f"/{where}/depth",
        imu_topic=f"/{where}/imu",
    )


def _rgbd_imu(where: str) -> ImuCalibration:
    # Bosch BMI055: 0.014 deg/s/sqrt(Hz), 150 ug/sqrt(Hz). Zero offsets are what the maker's calibration
    # leaves: about 0.2 deg/s and 10 mg; in-run instability about 10 deg/h and 40 ug (not on the sheet).
    camera = _rgbd_mount(where)
    return ImuCalibration(
        topic=f"/{where}/imu",
        part="Bosch BMI055 in Intel RealSense D455",
        rate_hz=200.0,
        mount=Mount(body=camera.body, T_body_sensor=camera.T_body_sensor @ _pose(np.eye(3), _P_IMU_IN_RGBD)),
        gyroscope_noise_density=0.014 * _DEG,
        gyroscope_random_walk=10 * _DEG / 3600 / math.sqrt(_WALK_S),
        accelerometer_noise_density=150e-6 * _G,
        accelerometer_random_walk=40e-6 * _G / math.sqrt(_WALK_S),
        gyroscope_bias_sd=0.2 * _DEG,
        accelerometer_bias_sd=10e-3 * _G,
    )


def _rgbd_mount(where: str) -> Mount:
    body, position = _RGBD_MOUNT[where]
    return Mount(body=body, T_body_sensor=_pose(_looking(_direction(0.0, -RGBD_PITCH_RAD)), position))


def _sonars() -> list[OtherSensor]:
    return [
        OtherSensor(
            topic=f"/foot_{side}/sonar",
            kind="range",
            part="Devantech SRF08",
            rate_hz=25.0,
            mount=Mount(
                body=f"foot_{side}",
                T_body_sensor=_pose(_x_along((0.0, -_outward(side), 0.0)), (-0.030, -0.040 * _outward(side), 0.050)),
            ),
            # The sheet gives no noise: 1 cm stands for a third of its 43 mm of range quantum.
            parameters={"beam_rad": 60 * _DEG, "range_max_m": 6.0, "range_sd_m": 0.01},
        )
        for side in SIDES
    ]


def _insoles() -> list[OtherSensor]:
    return [
        OtherSensor(
            topic=f"/foot_{side}/insole",
            kind="insole",
            part="Tekscan FlexiForce A401 x 4",
            rate_hz=100.0,
            mount=Mount(body=f"foot_{side}"),
            parameters={
                # heel, lateral ball, medial ball, toe: x and y in the foot frame
                "cells_m": [
                    [0.000, 0.0],
                    [0.125, 0.028 * _outward(side)],
                    [0.140, -0.024 * _outward(side)],
                    [0.200, -0.010 * _outward(side)],
                ],
                "force_sd_n": 3.0,  # linearity 3 % of a typical load of 100 N
            },
        )
        for side in SIDES
    ]


def _ahrs() -> list[OtherSensor]:
    # LORD 3DM-GX4-25 on the back: 0.5 deg dynamic pitch and roll, 2 deg heading. NTRexLAB MW-AHRS on the
    # limbs: 0.5 deg and 2 deg as well. Half of it is taken as constant over a walk.
    places = {"back": ("exo_back", "LORD 3DM-GX4-25")} | {
        f"{part}_{side}": (f"exo_{part}_{side}", "NTRexLAB MW-AHRS") for part in ("thigh", "foot") for side in SIDES
    }
    return [
        OtherSensor(
            topic=f"/exo/{place}/ahrs",
            kind="ahrs",
            part=part,
            rate_hz=100.0,
            mount=Mount(body=body),
            parameters={
                "tilt_sd_rad": 0.25 * _DEG,
                "tilt_bias_sd_rad": 0.25 * _DEG,
                "heading_bias_sd_rad": 1.0 * _DEG,
                "rate_sd_radps": 0.1 * _DEG,
            },
        )
        for place, (body, part) in places.items()
    ]


def _encoders() -> list[OtherSensor]:
    return [
        OtherSensor(
            topic=f"/exo/knee_{side}/encoder",
            kind="encoder",
            part="CUI AMT203",
            rate_hz=100.0,
            mount=Mount(body=f"exo_shank_{side}"),
            parameters={"counts": 4096.0, "angle_sd_rad": 0.1 * _DEG},  # 12 bit; accuracy 0.2 deg
        )
        for side in SIDES
    ]


def _interactions() -> list[OtherSensor]:
    return [
        OtherSensor(
            topic=f"/exo/{part}_{side}/interaction",
            kind="interaction",
            part="Tekscan FlexiForce A301 x 2",
            rate_hz=100.0,
            mount=Mount(body=f"exo_{part}_{side}"),
            parameters={"preload_n": 5.0, "force_sd_n": 0.6},  # strap tension; 2.5 % repeatability at 25 N
        )
        for part in ("thigh", "shank")
        for side in SIDES
    ]


def _actuators(exo: Exo) -> list[OtherSensor]:
    mounted = modules(exo)
    limits = {
        joint: {"torque_max_nm": float(m.torque_max_nm), "speed_max_radps": float(m.speed_max_radps)}
        for joint, m in mounted.items()
    }
    return [
        OtherSensor(
            topic=f"/exo/{joint}_{side}/actuator",
            kind="actuator",
            part="actuation module" if f"{joint}_{side}" in mounted else "no actuation module",
            rate_hz=100.0,
            mount=Mount(body=f"exo_{body}_{side}"),
            parameters={
                "torque_sd_nm": 0.2,
                "speed_sd_radps": 0.01,
            }  # current sensing; differentiated encoder
            | limits.get(f"{joint}_{side}", {}),
        )
        for joint, body in (("hip", "thigh"), ("knee", "shank"))
        for side in SIDES
    ]


_OTHERS = {
    "sonar": _sonars,
    "insole": _insoles,
    "ahrs": _ahrs,
    "encoder": _encoders,
    "interaction": _interactions,
}


def _outward(side: str) -> float:
    return 1.0 if side == "l" else -1.0


def _pinhole(width: int, height: int, focal: float) -> tuple[float, float, float, float]:
    return focal, focal, (width - 1) / 2, (height - 1) / 2


def _pose(rotation: ArrayLike, position: ArrayLike) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, position
    return T


def _direction(left: float, up: float) -> Array:
    """Unit vector turned from forward to the left and then up, rad."""
    return np.array([math.cos(up) * math.cos(left), math.cos(up) * math.sin(left), math.sin(up)])


def _looking(forward: Array, roll: float = 0.0) -> Array:
    """Rotation of an optical frame that looks along `forward`, upright and then rolled clockwise."""
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cos, sin = math.cos(roll), math.sin(roll)
    return np.column_stack([cos * right + sin * down, cos * down - sin * right, forward])


def _x_along(axis: ArrayLike) -> Array:
    """Rotation of a frame whose x axis is a horizontal `axis` and whose z axis points up."""
    x, z = np.asarray(axis, dtype=float), np.array([0.0, 0.0, 1.0])
    return np.column_stack([x, np.cross(z, x), z])
