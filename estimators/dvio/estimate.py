"""What the odometry estimates after a sample of the IMU."""

from __future__ import annotations

from dataclasses import dataclass

from stridetwin.estimators.base import LOST
from stridetwin.estimators.dvio import kernel
from stridetwin.estimators.dvio.nav_state import NavState
from stridetwin.streams.samples import Array
from stridetwin.streams.trajectory import Pose


@dataclass(frozen=True, kw_only=True, eq=False)
class DvioEstimate:
    """Estimated state of the camera's IMU after one sample.

    The world's z axis is up. Its origin is the IMU's first position; its x axis is the camera's first line of sight.

    Attributes:
        t_ns: Time of the sample.
        pose: Pose of the IMU; valid unless the odometry is lost.
        camera_pose: Estimated mount, the camera's pose in the IMU's frame; the same object until it changes.
        v_imu_in_world: (3,) m/s, velocity of the IMU.
        gyro_bias: (3,) rad/s, estimated bias of the gyroscope.
        accel_bias: (3,) m/s², estimated bias of the accelerometer.
        health: `tracking`; `depth_only`: images show too few points, but planes in the depth images hold the pose as
            far as they constrain it; `imu_only`: dead reckoning; or `lost`: from a failure until a new start. While
            lost, the pose is frozen and its covariance grows accordingly.
    """

    t_ns: int
    pose: Pose
    camera_pose: Pose
    v_imu_in_world: Array
    gyro_bias: Array
    accel_bias: Array
    health: str

    @classmethod
    def of(
        cls,
        nav: NavState,
        health: str,
        camera_pose: Pose,
        frame: str = "",
        unmodelled: Array | None = None,
    ) -> DvioEstimate:
        """The estimate of a propagated state, as copies; `frame` names the IMU, such as `head/imu`.

        Args:
            nav: The state; its time is that of the estimate.
            health: `tracking`, `depth_only`, `imu_only` or `lost`; the pose is valid unless lost.
            camera_pose: Estimated mount of the camera.
            frame: Frame of the pose.
            unmodelled: (3,) m², variance of the position beyond that of the state; None for none.
        """
        t_ns, covariance = int(nav.t_ns[0]), kernel.pose_covariance(nav)
        if unmodelled is not None:
            covariance[range(3), range(3)] += unmodelled
        return cls(
            t_ns=t_ns,
            pose=Pose(
                t_ns=t_ns,
                p_frame_in_world=nav.p.copy(),
                rotation=nav.R.copy(),
                frame=frame,
                covariance=covariance,
                valid=health != LOST,
            ),
            camera_pose=camera_pose,
            v_imu_in_world=nav.v.copy(),
            gyro_bias=nav.bias[:3].copy(),
            accel_bias=nav.bias[3:].copy(),
            health=health,
        )

    @property
    def covariance(self) -> Array:
        """(6, 6) of the pose: position (m) and rotation about the world's axes (rad)."""
        assert self.pose.covariance is not None
        return self.pose.covariance
