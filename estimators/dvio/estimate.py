"""What the odometry tells."""

from __future__ import annotations

from dataclasses import dataclass

from stridetwin.estimators.dvio import kernel
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
        health: `tracking`; `coasting`, where the IMU alone tells the motion, for want of points or of pictures; or
            `lost`, from a failure on until all is found again: the pose then holds its place, and the covariance says
            how little that means.
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
        T_world_imu, covariance = kernel.told(live)
        return cls(
            t_ns=int(live.t_ns[0]),
            T_world_imu=T_world_imu,
            v_imu_in_world=live.v.copy(),
            covariance=covariance,
            gyro_bias=live.bias[:3].copy(),
            accel_bias=live.bias[3:].copy(),
            health=health,
        )
