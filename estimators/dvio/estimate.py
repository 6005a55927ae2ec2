"""What the odometry tells."""

from __future__ import annotations

from dataclasses import dataclass

from stridetwin.estimators.base import deprecated
from stridetwin.estimators.dvio import kernel
from stridetwin.estimators.dvio.live import Live
from stridetwin.streams.pose import Pose
from stridetwin.streams.samples import Array

TRACKING, COASTING, LOST = "tracking", "coasting", "lost"


@dataclass(frozen=True, kw_only=True, eq=False)
class DvioEstimate:
    """What is believed of the camera's IMU after one sample.

    The world's z axis is up; its origin is where the IMU first was, its x axis points where the camera first looked.

    Attributes:
        t_ns: Time of the sample.
        pose: Of the IMU; valid unless the odometry is lost.
        v_imu_in_world: (3,) m/s.
        gyro_bias: (3,) rad/s.
        accel_bias: (3,) m/s².
        health: `tracking`; `coasting`, where the IMU alone tells the motion, for want of points or of pictures; or
            `lost`, from a failure on until all is found again: the pose then holds its place, and the covariance says
            how little that means.
    """

    t_ns: int
    pose: Pose
    v_imu_in_world: Array
    gyro_bias: Array
    accel_bias: Array
    health: str

    @classmethod
    def of(cls, live: Live, health: str, frame: str = "") -> DvioEstimate:
        """What a propagated state says, copied."""
        T_world_imu, covariance = kernel.told(live)
        t_ns = int(live.t_ns[0])
        return cls(
            t_ns=t_ns,
            pose=Pose(
                t_ns=t_ns,
                p_frame_in_world=T_world_imu[:3, 3],
                rotation=T_world_imu[:3, :3],
                frame=frame,
                covariance=covariance,
                valid=health != LOST,
            ),
            v_imu_in_world=live.v.copy(),
            gyro_bias=live.bias[:3].copy(),
            accel_bias=live.bias[3:].copy(),
            health=health,
        )

    @property
    def covariance(self) -> Array:
        """(6, 6) of the pose: position (m) and rotation about the world's axes (rad)."""
        assert self.pose.covariance is not None
        return self.pose.covariance

    @property
    def T_world_imu(self) -> Array:
        """(4, 4) IMU to world, m; deprecated, see `pose`."""
        deprecated("DvioEstimate.T_world_imu", "pose.T_world_frame")
        return self.pose.T_world_frame
