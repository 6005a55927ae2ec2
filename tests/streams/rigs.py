"""A small rig and one block of every small sample, for the tests."""

import numpy as np

from stridetwin.streams.rig import Board, CameraCalibration, ImuCalibration, Mount, OtherSensor, Rig
from stridetwin.streams.samples import (
    Accelerometer,
    Actuator,
    Ahrs,
    Block,
    Encoder,
    FootPhase,
    Footprint,
    Imu,
    Insole,
    Interaction,
    Joints,
    Odometry,
    Point,
    Range,
    Wrench,
)


def pose(x=0.1, y=0.0, z=0.2):
    T = np.eye(4)
    T[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    T[:3, 3] = x, y, z
    return T


def small_rig():
    imu = ImuCalibration(
        topic="/head/imu",
        part="BMI055",
        rate_hz=200.0,
        mount=Mount(body="head", T_body_sensor=pose(0.05)),
        gyroscope_noise_density=1e-3,
        gyroscope_random_walk=2e-5,
        accelerometer_noise_density=1e-2,
        accelerometer_random_walk=3e-4,
        gyroscope_bias_sd=0.01,
    )
    camera = CameraCalibration(
        topic="/head/color",
        part="D455",
        rate_hz=30.0,
        mount=Mount(body="head", T_body_sensor=pose()),
        width=32,
        height=24,
        intrinsics=(38.1, 38.2, 15.5, 11.5),
        distortion=(0.1, -0.05, 1e-5, 0.0),
        depth_topic="/head/depth",
        imu_topic="/head/imu",
        timeshift_cam_imu_s=0.002,
    )
    board = Board(name="foot_l", mount=Mount(body="foot_l"), squares=(6, 9), square_m=0.005)
    sonar = OtherSensor(
        topic="/foot_l/sonar",
        kind="range",
        part="SRF08",
        rate_hz=100.0,
        mount=Mount(body="foot_l"),
        parameters={"field_of_view_rad": 1.0, "min_range_m": 0.03, "cells": [[0.0, 1.0], [2.0, 3.0]]},
    )
    return Rig(
        imus={imu.topic: imu},
        cameras={camera.topic: camera},
        boards={board.name: board},
        others={sonar.topic: sonar},
    )


def unit(rng, n):
    q = rng.normal(size=(n, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def every_small_block(n=57, seed=3):
    """One block of every small sample, 200 Hz for the IMU and 100 Hz else."""
    rng = np.random.default_rng(seed)

    def v(*shape):
        return rng.normal(size=(n, *shape))

    content = {
        "/head/imu": (Imu, {"angular_rate": v(3), "specific_force": v(3)}),
        "/exo/back/ahrs": (Ahrs, {"q_world_sensor": unit(rng, n), "angular_rate": v(3)}),
        "/foot_l/sonar": (Range, {"distance": np.where(np.arange(n) % 5, np.float32(0.344), 0.0)}),
        "/exo/knee_l/encoder": (Encoder, {"angle": v()}),
        "/foot_l/insole": (Insole, {"force": v(4)}),
        "/exo/thigh_l/interaction": (Interaction, {"force": v(2)}),
        "/exo/hip_l/actuator": (Actuator, {"torque_command": v(), "torque": v(), "speed": v()}),
        "/chest/accelerometer": (Accelerometer, {"specific_force": v(3)}),
        "/truth/pelvis": (
            Odometry,
            {
                "p_frame_in_world": v(3),
                "q_world_frame": unit(rng, n),
                "v_frame_in_world": v(3),
                "angular_rate": v(3),
            },
        ),
        "/truth/joints": (Joints, {"position": v(3), "velocity": v(3), "torque": v(3)}),
        "/truth/foot_l/wrench": (Wrench, {"force_in_world": v(3), "torque_in_world": v(3)}),
        "/truth/foot_l/cop": (Point, {"p_in_world": v(3)}),
        "/truth/foot_l/phase": (FootPhase, {"phase": rng.integers(0, 4, n)}),
        "/truth/footprints": (
            Footprint,
            {
                "foot": np.array(["l", "r"])[np.arange(n) % 2],
                "p_foot_in_world": v(3),
                "q_world_foot": unit(rng, n),
                "terrain": np.array(["level", "stair", "ramp"])[np.arange(n) % 3],
                "mode": np.array(["LG", "SA", "SD", "RA", "RD"])[np.arange(n) % 5],
            },
        ),
    }
    blocks = []
    for topic, (kind, columns) in content.items():
        t = np.arange(n, dtype=np.int64) * (5_000_000 if kind is Imu else 10_000_000) + 1_234_567_890
        constants = {"names": ("hip", "knee", "ankle")} if kind is Joints else {}
        blocks.append(Block(topic=topic, kind=kind, t_ns=t, columns=columns, constants=constants))
    return blocks
