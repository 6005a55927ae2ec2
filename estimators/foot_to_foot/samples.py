"""Where the other shoe is, as the published filter of two feet takes it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stridetwin.estimators.foot_ins.board_pose import admissible, board_poses
from stridetwin.estimators.foot_ins.board_sighting import BoardSighting
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RelativePosition:
    """Where the other foot is, as the published system takes it from a picture.

    Attributes:
        topic: Stream of the picture.
        t_ns: Middle of the exposure, on the clock of the IMUs.
        p_other_in_imu: (3,) position of the other foot's IMU in this foot's, m.
        sd: Standard deviation on each axis, m.
    """

    topic: str
    t_ns: int
    p_other_in_imu: Array
    sd: float

    def __post_init__(self) -> None:
        """Raises ConfigError where the position is not three finite numbers, or `sd` is not one above 0."""
        if np.shape(self.p_other_in_imu) != (3,) or not np.all(np.isfinite(self.p_other_in_imu)):
            raise ConfigError("RelativePosition", "p_other_in_imu", self.p_other_in_imu, "three finite numbers")
        if not 0.0 < self.sd < np.inf:
            raise ConfigError("RelativePosition", "sd", self.sd, "a finite number > 0")

    @classmethod
    def of_sighting(
        cls,
        sighting: BoardSighting,
        *,
        T_imu_camera: ArrayLike,
        T_other_board: ArrayLike,
        R_camera_board: ArrayLike | None = None,
        rotation_sd: float = np.inf,
    ) -> RelativePosition | None:
        """From the pose of the other foot's board in the camera (Jao, Wang, Shkel 2020, Sec. II-D).

        p_a^b = p_a^C + C(q_a^C) [p_C^f - C(q_C^f) C(q_b^f)ᵀ p_b^f]

        Of the two poses that a plane has, the likelier one counts.

        Args:
            sighting: By foot a of the board f on foot b.
            T_imu_camera: (4, 4) pose of the camera C in a's IMU.
            T_other_board: (4, 4) pose of the board in b's IMU.
            R_camera_board: (3, 3) what is known of the board's orientation in the camera.
            rotation_sd: How well, rad.

        Returns:
            None where the corners lie on a line.
        """
        poses = admissible(board_poses(sighting), R_camera_board, rotation_sd)
        if not poses:
            return None
        T_camera_other = poses[0].T_camera_board @ np.linalg.inv(np.asarray(T_other_board, dtype=float))
        x, y, z = T_camera_other[:3, 3] - poses[0].T_camera_board[:3, 3]
        J = np.hstack([np.eye(3), [[0, z, -y], [-z, 0, x], [y, -x, 0]]])
        sd = float(np.sqrt(np.trace(J @ poses[0].covariance @ J.T) / 3))
        p = (np.asarray(T_imu_camera) @ T_camera_other)[:3, 3]
        return cls(topic=sighting.topic, t_ns=sighting.t_ns, p_other_in_imu=p, sd=sd)
