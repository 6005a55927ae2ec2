"""Mounts of the sensors on the two shoes, from the rig's calibration, and detection of swapped left and right.

An image of the other shoe's board gives the relative rotation of the shoes, given which shoe carries the camera. So do
the IMUs' attitudes, given which shoe carries which. Of the four assignments of left and right, only the true one makes
the two agree. Cameras mounted as mirror images show a swap while the wearer is stationary; swapped IMUs show when the
feet swing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product
from typing import Protocol, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.checkerboard.pose import BoardObservation, find_board_poses, select_poses
from stridetwin.estimators.foot_ins.estimate import StartPose
from stridetwin.estimators.foot_to_foot.state import BOARD, CAMERA, FEET, NEVER
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import Board, CameraCalibration, ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Array

_WAYS = tuple(product((0, 1), (0, 1)))  # IMUs swapped, cameras swapped; the first is as the rig says
_NAMES = {
    (0, 1): "the cameras sit on each other's shoe",
    (1, 0): "the IMUs sit on each other's shoe",
    (1, 1): "IMUs and cameras sit on each other's shoe",
}
_ROTATION_SD_RAD = 0.3  # a plane's orientation in an image, and the feet's headings while unknown
_MAX_EVIDENCE_SD = 4.0  # largest evidence of one image
_APART_S = 0.05  # closer images are not independent
# Evidence as log-likelihoods: with more than the first no observation is used; with the second an exchange, or that
# there is none, is certain, if the next assignment is less likely by the third.
_UNCERTAIN, _CERTAIN, _MARGIN = 4.0, 20.0, 10.0
# A start without given poses; hand-chosen on walks of seeds below 1000. Distance between the feet (doubled: the second
# foot starts 0.2 m farther away until the first image), and rotation of each outwards (doubled: its path starts turned
# by 0.2 rad until the first image); then the uncertainty of the second foot's position and heading (doubled: the first
# image moves it more).
_START_SEPARATION_M, _START_TOE_OUT_RAD = 0.2, 0.1
_START_POSITION_SD_M, _START_HEADING_SD_RAD = 0.15, 0.2


class LeftRightCheck:
    """Accumulates evidence from images about left and right, until it suffices.

    Args:
        mounts: (4, 7) of cameras and boards in their feet's IMUs, as in `state.Pair`.
    """

    def __init__(self, mounts: Array) -> None:
        """Begins without evidence; a row of `mounts` (4, 7) is position (m) and quaternion (w, x, y, z)."""
        # (4, 3, 3) IMU <- camera left, camera right, board left, board right
        self._R_imu_part = Rotation.from_quat(mounts[:, 3:], scalar_first=True).as_matrix()
        self._against = np.zeros(len(_WAYS))  # negative log-likelihood of each assignment
        self._newest_ns = NEVER  # time of the last image used
        self._settled = False  # that nothing is exchanged is certain

    @property
    def seems_exchanged(self) -> bool:
        """Whether another assignment than the rig's is the likeliest so far."""
        return bool(self._against[0] > self._against[1:].min())

    def agrees(self, observation: BoardObservation, camera: int, R_world_imu: Array) -> bool:
        """Whether an observation by a foot's camera may be used: False while left and right seem exchanged.

        The observation is added to the evidence, unless it is too close in time to the last one.

        Args:
            observation: Board of the other foot in an image.
            camera: Index in `FEET` of the foot that carries the camera according to the rig.
            R_world_imu: (2, 3, 3) attitudes of the left and right IMU about that time.

        Raises:
            StrideTwinError: Left and right are exchanged; the message says for which sensors.
        """
        if self._settled:
            return True
        # an image is evidence if it is `_APART_S` after the last one, and its corners determine a pose
        if observation.t_ns - self._newest_ns >= round(_APART_S * 1e9) and (
            poses := select_poses(find_board_poses(observation))
        ):
            self._newest_ns = observation.t_ns
            R_camera_board = np.array([pose.T_camera_board[:3, :3] for pose in poses])
            self._against += [
                self._misfit(R_camera_board, camera, R_world_imu, imus, cameras) for imus, cameras in _WAYS
            ]
        # by how much the rig's assignment, the first, is less likely than the best of the others
        behind = self._against[0] - self._against[1:].min()  # positive if another assignment is more likely
        self._settled = behind < -_CERTAIN
        # exchanged, and the best assignment is clearly better than the second best
        if behind > _CERTAIN and np.diff(np.sort(self._against))[0] > _MARGIN:
            what = _NAMES[_WAYS[int(np.argmin(self._against))]]
            raise StrideTwinError(
                f"left and right are exchanged at {observation.t_ns * 1e-9:.2f} s: {what}: "
                "expected every part on the shoe that the rig says"
            )
        return bool(behind < _UNCERTAIN)

    def _misfit(self, R_camera_board: Array, camera: int, R_world_imu: Array, imus: int, cameras: int) -> float:
        """Negative log-likelihood of one assignment of left and right, for the most likely pose of the board.

        Args:
            R_camera_board: (N, 3, 3) rotations of the poses that explain the image.
            camera: Index in `FEET` of the foot that carries the camera according to the rig.
            R_world_imu: (2, 3, 3) attitudes of the left and right IMU.
            imus: 1 if the IMUs are exchanged, else 0.
            cameras: 1 if the cameras are exchanged, else 0.
        """
        foot = camera ^ cameras  # the foot that actually carries the camera; `x ^ 1` is the other of 0 and 1
        # relative rotation of the shoes, by the image (N, 3, 3) and by the IMUs (3, 3); `off` is the angle between them
        by_image = self._R_imu_part[CAMERA + foot] @ R_camera_board @ self._R_imu_part[BOARD + 1 - foot].T
        by_imus = R_world_imu[foot ^ imus].T @ R_world_imu[1 - foot ^ imus]
        # trace of by_imageᵀ by_imus is 1 + 2 cos(angle); the largest is that of the pose that fits best
        cosine = (np.einsum("nij,ij->n", by_image, by_imus).max() - 1.0) / 2.0
        off = math.acos(max(-1.0, min(1.0, cosine))) / _ROTATION_SD_RAD  # in standard deviations
        return 0.5 * min(off, _MAX_EVIDENCE_SD) ** 2


class _Mounted(Protocol):
    """A part of a rig with a mount."""

    @property
    def mount(self) -> Mount:
        """Where the part is mounted."""


M = TypeVar("M", bound=_Mounted)


@dataclass(frozen=True, kw_only=True, eq=False)
class Shoes:
    """Both shoes; a missing part has no calibration, and its pose is the identity.

    Attributes:
        imus: Calibration of the IMU of each foot that has one, by `l` and `r`.
        cameras: Calibration of the camera of each foot that has one, by `l` and `r`.
        boards: Board of each foot that has one, by `l` and `r`.
        mounts: (4, 7) position (m) and quaternion (w, x, y, z) of camera left, camera right, board left, board right,
            each in its foot's IMU.
        sonars: (2, 3) each foot's sonar in its IMU, m.
        sonar_topics: Topic of each foot's sonar, left and right, "" where there is none.
    """

    imus: dict[str, ImuCalibration]
    cameras: dict[str, CameraCalibration]
    boards: dict[str, Board]
    mounts: Array
    sonars: Array
    sonar_topics: tuple[str, str]


def shoes_of(rig: Rig) -> Shoes:
    """The two shoes of a rig: whatever is mounted on the bodies `foot_l` and `foot_r`.

    Raises:
        StrideTwinError: No foot carries an IMU, or one carries two.
    """
    imus: dict[str, ImuCalibration] = {}
    cameras: dict[str, CameraCalibration] = {}
    boards: dict[str, Board] = {}
    sonars, topics = np.zeros((2, 3)), ["", ""]
    mounts = np.tile([0.0, 0, 0, 1, 0, 0, 0], (4, 1))  # position 0 and the identity quaternion, for missing parts
    for i, foot in enumerate(FEET):
        # IMUs of the body may be worn on the shoe, too
        shoe_imus = [imu for topic, imu in rig.imus.items() if topic == f"/foot_{foot}/imu"]
        imu = _find_on_foot(shoe_imus, foot, "IMU") or _find_on_foot(rig.imus.values(), foot, "IMU")
        if imu is None:  # without an IMU, nothing else on the foot is of use
            continue
        imus[foot] = imu
        # mounts in the rig are poses on the foot; here they are relative to the foot's IMU
        T_imu_foot = np.linalg.inv(imu.mount.T_body_sensor)
        if (camera := _find_on_foot(rig.cameras.values(), foot, "camera")) is not None:
            cameras[foot], mounts[CAMERA + i] = camera, _to_mount(T_imu_foot @ camera.mount.T_body_sensor)
        if (board := _find_on_foot(rig.boards.values(), foot, "board")) is not None:
            boards[foot], mounts[BOARD + i] = board, _to_mount(T_imu_foot @ board.mount.T_body_sensor)
        sonar = _find_on_foot((s for s in rig.others.values() if s.kind == "range"), foot, "sonar")
        if sonar is not None:
            sonars[i], topics[i] = (T_imu_foot @ sonar.mount.T_body_sensor)[:3, 3], sonar.topic
    if not imus:
        raise StrideTwinError("the rig has no IMU on foot_l or foot_r")
    return Shoes(
        imus=imus, cameras=cameras, boards=boards, mounts=mounts, sonars=sonars, sonar_topics=(topics[0], topics[1])
    )


def side_by_side_start(shoes: Shoes) -> dict[str, StartPose]:
    """Assumed stance at the start: both feet flat, side by side, the toes a little out.

    The world's origin is on the ground between the heels, its x axis points forward. The left foot's position and
    heading are this by definition; the right foot's are a guess.
    """
    start = {}
    for foot, imu in shoes.imus.items():
        side = 1.0 if foot == "l" else -1.0  # the y axis points to the left
        T_world_foot = np.eye(4)
        T_world_foot[:3, :3] = Rotation.from_euler("z", side * _START_TOE_OUT_RAD).as_matrix()
        T_world_foot[1, 3] = side * _START_SEPARATION_M / 2
        T = T_world_foot @ imu.mount.T_body_sensor  # world <- IMU
        q = Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
        # uncertainty beyond the default of a start, which is tiny
        guess = {} if foot == "l" else {"position_sd": _START_POSITION_SD_M, "heading_sd": _START_HEADING_SD_RAD}
        start[foot] = StartPose(p_imu_in_world=T[:3, 3], q_world_imu=q, **guess)
    return start


def _find_on_foot(parts: Iterable[M], foot: str, kind: str) -> M | None:
    """The part of one kind that is mounted on a foot; None if there is none.

    Raises:
        StrideTwinError: There are two or more.
    """
    mounted = [p for p in parts if p.mount.body == f"foot_{foot}"]
    if len(mounted) > 1:
        raise StrideTwinError(f"foot_{foot} carries {len(mounted)} {kind}s; one is what the filter of two feet takes")
    return mounted[0] if mounted else None


def _to_mount(T: Array) -> Array:
    """(7,) position (entries 0-2, m) and quaternion (3-6; w, x, y, z) of a (4, 4) pose."""
    return np.concatenate([T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)])
