"""Whether the parts sit on the shoes that the rig says: left and right are easily exchanged.

A picture of the other shoe's board tells how the two shoes are turned to each other, given which shoe carries the
camera. So do the attitudes of the IMUs, given which shoe carries which. Of the four ways in which left and right can
have been told, the true one makes the two agree. Cameras that sit mirrored on the shoes show an exchange while the
wearer still stands; exchanged IMUs show when the feet swing.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.foot_ins.board_pose import admissible, board_poses
from stridetwin.estimators.foot_ins.board_sighting import BoardSighting
from stridetwin.estimators.foot_to_foot.memory import BOARD, CAMERA, NEVER
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Array

_SD = 0.3  # rad: a plane's orientation in a picture, and the feet's headings while nobody knows them
_MOST = 4.0  # standard deviations; a picture says no more than that against anything
_APART_NS = 50_000_000  # pictures closer together say the same
_DOUBT, _SURE, _CLEAR = 4.0, 20.0, 10.0  # differences of log-likelihoods: not used, decided, and between which two

_WAYS = tuple(product((0, 1), (0, 1)))  # IMUs exchanged, cameras exchanged; the first is as the rig says
_NAMES = {
    (0, 1): "the cameras sit on each other's shoe",
    (1, 0): "the IMUs sit on each other's shoe",
    (1, 1): "IMUs and cameras sit on each other's shoe",
}


class Worn:
    """Weighs what pictures say about left and right, until they have said enough.

    Args:
        mounts: (4, 7) of cameras and boards in their feet's IMUs, as in `memory.Pair`.
    """

    def __init__(self, mounts: Array) -> None:
        self._R_imu_part = Rotation.from_quat(mounts[:, 3:], scalar_first=True).as_matrix()
        self._against = np.zeros(len(_WAYS))
        self._newest_ns = NEVER
        self._settled = False

    def agrees(self, sighting: BoardSighting, camera: int, R_world_imu: Array) -> bool:
        """Whether a sighting may be used: False as long as it looks as if left and right were exchanged.

        Args:
            sighting: Of a foot's camera.
            camera: That foot, as the rig says.
            R_world_imu: (2, 3, 3) attitudes that the IMUs of the left and of the right foot give about that time.

        Raises:
            StrideTwinError: Left and right are exchanged; the message says of what.
        """
        if self._settled:
            return True
        if sighting.t_ns - self._newest_ns >= _APART_NS and (poses := admissible(board_poses(sighting))):
            self._newest_ns = sighting.t_ns
            seen = np.array([pose.T_camera_board[:3, :3] for pose in poses])
            self._against += [self._misfit(seen, camera, R_world_imu, *way) for way in _WAYS]
        behind = self._against[0] - self._against[1:].min()
        self._settled = behind < -_SURE
        if behind > _SURE and np.diff(np.sort(self._against))[0] > _CLEAR:
            what = _NAMES[_WAYS[int(np.argmin(self._against))]]
            raise StrideTwinError(
                f"left and right are exchanged at {sighting.t_ns * 1e-9:.2f} s: {what}; "
                "valid: every part on the shoe that the rig says"
            )
        return bool(behind < _DOUBT)

    def _misfit(self, R_camera_board: Array, camera: int, R_world_imu: Array, imus: int, cameras: int) -> float:
        """Log-likelihood against one way to wear the parts, of the (N, 3, 3) likeliest pose."""
        foot = camera ^ cameras  # that the camera really sits on
        by_picture = self._R_imu_part[CAMERA + foot] @ R_camera_board @ self._R_imu_part[BOARD + 1 - foot].T
        by_imus = R_world_imu[foot ^ imus].T @ R_world_imu[1 - foot ^ imus]
        cosine = (np.einsum("nij,ij->n", by_picture, by_imus).max() - 1.0) / 2.0
        return 0.5 * min(math.acos(max(-1.0, min(1.0, cosine))) / _SD, _MOST) ** 2
