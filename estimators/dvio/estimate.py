"""What the odometry tells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stridetwin.estimators.dvio.live import Live
from stridetwin.streams.samples import Array

TRACKING, COASTING, LOST = "tracking", "coasting", "lost"


@dataclass(frozen=True, kw_only=True, eq=False)
class DvioEstimate:
    """What is believed of the camera's IMU after one sample.

    The world's z axis is up; its origin is where the IMU first was, its x axis points where the camera first looked.

    Attributes:
        t_ns: Time of the sample.
        T_world_imu: (4, 4) IMU to world, m.
        v_imu_in_world: (3,) m/s.
        covariance: (6, 6) of position (m) and of rotation about the world's axes (rad).
        gyro_bias: (3,) rad/s.
        accel_bias: (3,) m/s².
        health: `tracking`; `coasting`, where the IMU alone tells the motion, for want of points; or `lost`, from a
            failure on until all is found again: the pose then holds its place, and the covariance says how little that
            means.
    """

    t_ns: int
    T_world_imu: Array
    v_imu_in_world: Array
    covariance: Array
    gyro_bias: Array
    accel_bias: Array
    health: str

    @classmethod
    def of(cls, live: Live, health: str) -> DvioEstimate:
        """What a propagated state says, copied."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = live.R, live.p
        to_world = np.eye(6)
        to_world[3:, 3:] = live.R
        return cls(
            t_ns=int(live.t_ns[0]),
            T_world_imu=T,
            v_imu_in_world=live.v.copy(),
            covariance=to_world @ live.covariance[:6, :6] @ to_world.T,
            gyro_bias=live.bias[:3].copy(),
            accel_bias=live.bias[3:].copy(),
            health=health,
        )
