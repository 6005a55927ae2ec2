"""Board observations from shoe-camera images, searched for where the filter predicts them."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.checkerboard.detector import BoardDetector
from stridetwin.estimators.checkerboard.pose import BoardObservation
from stridetwin.estimators.foot_to_foot.events import RelativePosition
from stridetwin.estimators.foot_to_foot.shoe_rig import Shoes
from stridetwin.estimators.foot_to_foot.state import BOARD, CAMERA, FEET
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array, Image

_HELD = 8  # images that may wait for the IMUs to reach their time; the oldest is dropped first
# Half width of the search region: standard deviations of the prediction, and pixels in addition, because an
# overconfident prediction misidentifies the corners of a partly visible board.
_REGION_SD, _MIN_REGION_PX = 3.0, 12.0
# With a less certain prediction the whole image is searched, at most once in this time, because that takes longer.
_LOST_PX, _LOST_EVERY_NS = 60.0, 100_000_000
# After this time without a board at its prediction, which may then be wrong, whole images are searched, once in the
# second time. A stride is no integer multiple of it.
_MISSED_NS, _MISSED_EVERY_NS = 2_000_000_000, 300_000_000


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardPrediction:
    """Predicted pose of the other foot's board in a camera.

    Attributes:
        T_camera_board: (4, 4) pose of the board in the camera's optical frame at the image's instant.
        covariance: (6, 6) of position (m) and rotation vector (rad), camera axes.
        T_before: (4, 4) pose one exposure time earlier.
    """

    T_camera_board: Array
    covariance: Array
    T_before: Array

    def error_px(self, points_in_board: Array, focal_px: float) -> float:
        """Largest standard deviation of a predicted point's pixel.

        Args:
            points_in_board: (M, 3) m, points that are in front of the camera.
            focal_px: Focal length of the camera, pixels.
        """
        arms = points_in_board @ self.T_camera_board[:3, :3].T  # from the board's origin to the points, camera axes
        x, y, z = (arms + self.T_camera_board[:3, 3]).T  # points in the camera
        zero = np.zeros_like(z)
        # derivatives of the normalised image coordinates x / z and y / z: `by_point` (M, 2, 3) by the point, and
        # J (M, 2, 6) by the board's position and rotation
        by_point = np.stack([np.stack([1 / z, zero, -x / z**2], 1), np.stack([zero, 1 / z, -y / z**2], 1)], 1)
        J = np.concatenate([by_point, np.cross(arms[:, None, :], by_point)], axis=2)
        variance = np.einsum("mij,jk,mik->m", J, self.covariance, J)
        return focal_px * float(np.sqrt(variance.max()))


class BoardTracker:
    """The cameras of both shoes, each with a detector of the other shoe's board.

    An image waits until both IMUs have reached its time. A board that faces away or is out of view is not searched. If
    the filter has lost the other shoe, the whole image is searched, at most ten times per second; and less often if no
    predicted board has been found for long, because the calibration may be wrong.

    Args:
        shoes: Cameras and boards.
        exposure_s: Exposure time of the cameras, s.
    """

    def __init__(self, shoes: Shoes, exposure_s: float) -> None:
        """Prepares a detector for each shoe camera that can see a board on the other shoe."""
        # by topic of the camera: detector of the other shoe's board; index in `FEET` of the camera's foot, calibration
        self._detectors: dict[str, BoardDetector] = {}
        self._cameras: dict[str, tuple[int, CameraCalibration]] = {}
        for i, foot in enumerate(FEET):
            board = shoes.boards.get(FEET[1 - i])  # on the other shoe
            if foot in shoes.cameras and board is not None:
                camera = shoes.cameras[foot]
                self._cameras[camera.topic] = i, camera
                self._detectors[camera.topic] = BoardDetector(board, camera)
        self.exposure_ns = round(exposure_s * 1e9)
        self._waiting: deque[Image] = deque(maxlen=_HELD)  # until both IMUs have reached their time
        self._searched_ns = dict.fromkeys(self._cameras, -_LOST_EVERY_NS)  # when an image was last searched as a whole
        self._newest_ns = dict.fromkeys(self._cameras, -(2**62))  # time of each camera's newest image
        # when a board was last found at its prediction; at first, time of the first image
        self._found_ns: int | None = None

    def enqueue(self, image: Image) -> bool:
        """Queues an image until the IMUs have reached its time.

        Returns:
            Whether it was queued: not if its camera has no detector of a board, or if it is out of order.
        """
        if image.topic not in self._cameras or image.t_ns <= self._newest_ns[image.topic]:
            return False
        self._newest_ns[image.topic] = image.t_ns
        self._waiting.append(image)
        return True

    def pop_ready(self, reached_ns: int) -> list[tuple[Image, int, int]]:
        """Removes the images whose time both IMUs have reached from the queue.

        Args:
            reached_ns: Time that both IMUs have reached.

        Returns:
            These images in time order, each with the index in `FEET` of the camera's foot, and its time on the IMUs'
            clock, ns.
        """
        ready = []
        for _ in range(len(self._waiting)):
            image = self._waiting.popleft()
            foot, camera = self._cameras[image.topic]
            t_ns = image.t_ns + round(camera.timeshift_cam_imu_s * 1e9)  # on the IMUs' clock
            if t_ns <= reached_ns:
                ready.append((image, foot, t_ns))
            else:
                self._waiting.append(image)  # it stays, in the same order as before
        return sorted(ready, key=lambda item: item[2])

    def detect(self, image: Image, expected: BoardPrediction, doubted: bool = False) -> BoardObservation | None:
        """The board in an image; None if it is not detected or not searched.

        If predictions are `doubted`, the whole image is searched. If no board has been found at its prediction for
        `_MISSED_NS`, the whole image is searched first.
        """
        if doubted:
            return self._search_whole_image(image, self._detectors[image.topic], _LOST_EVERY_NS)
        if self._found_ns is None:  # the first image
            self._found_ns = image.t_ns
        if image.t_ns - self._found_ns > _MISSED_NS:
            observation = self._search_whole_image(image, self._detectors[image.topic], _MISSED_EVERY_NS)
            if observation is not None:
                return observation
        return self._search_prediction(image, expected)

    def _search_prediction(self, image: Image, expected: BoardPrediction) -> BoardObservation | None:
        """The board in an image at its prediction, or anywhere if the prediction is uncertain.

        Args:
            image: The image.
            expected: Predicted pose of the board.

        Returns:
            None if it is not detected, or not searched because it faces away or is out of view.
        """
        detector, (_, camera) = self._detectors[image.topic], self._cameras[image.topic]
        # (N, 2) px, where the corners are expected; None if the board faces away or is not in front of the camera
        guess = detector.predict(expected.T_camera_board)
        error_px = np.inf  # half width of the region in which each corner is searched
        if guess is not None:
            error_px = _REGION_SD * expected.error_px(detector.points_in_board, camera.intrinsics[0]) + _MIN_REGION_PX
        else:
            rotation_variance = np.linalg.eigvalsh(expected.covariance[3:, 3:])[-1]  # about the least certain axis
            # `_REGION_SD` standard deviations of the rotation are less than 1 rad
            if _REGION_SD**2 * rotation_variance < 1.0 and self._is_position_certain(expected):
                return None  # it certainly faces away, or is behind the camera
        if guess is None or not error_px < _LOST_PX:
            return self._search_whole_image(image, detector, _LOST_EVERY_NS)
        # a predicted corner may be in the image, given the size of the search region
        inside = np.all((guess > -error_px) & (guess < np.array([camera.width, camera.height]) + error_px), axis=1)
        if not inside.any():
            return None
        # mean motion of the corners during the exposure, which blurs them
        guess_before = detector.predict(expected.T_before)
        motion_px = None if guess_before is None else (guess - guess_before).mean(axis=0)
        observation = detector.detect(image, guess, error_px, motion_px)
        if observation is not None:
            self._found_ns = image.t_ns
        return observation

    def _search_whole_image(self, image: Image, detector: BoardDetector, every_ns: int) -> BoardObservation | None:
        """The board anywhere in an image; None if an image of this camera was searched less than `every_ns` ago."""
        if image.t_ns - self._searched_ns[image.topic] < every_ns:
            return None
        self._searched_ns[image.topic] = image.t_ns
        return detector.detect(image)

    def _is_position_certain(self, expected: BoardPrediction) -> bool:
        """Whether `_REGION_SD` standard deviations of the board's predicted position are less than its distance."""
        distance = float(np.linalg.norm(expected.T_camera_board[:3, 3]))
        # along the least certain direction, m
        position_sd = float(np.sqrt(np.linalg.eigvalsh(expected.covariance[:3, :3])[-1]))
        return _REGION_SD * position_sd < distance


def relative_position(
    observation: BoardObservation, foot: int, mounts: Array, expected: BoardPrediction
) -> RelativePosition | None:
    """Measurement of the published filter from an observed board; None if the corners are collinear.

    Args:
        observation: Board of the other foot in an image.
        foot: Index in `FEET` of the foot with the camera.
        mounts: (4, 7) position (m) and quaternion (w, x, y, z) of camera left, camera right, board left, board right,
            each in its foot's IMU.
        expected: Prediction by the feet's attitudes, which selects one of a plane's two poses.
    """
    rotation_sd = float(np.sqrt(np.linalg.eigvalsh(expected.covariance[3:, 3:])[-1]))  # about the least certain axis
    return RelativePosition.of_observation(
        observation,
        T_imu_camera=_to_transform(mounts[CAMERA + foot]),
        T_other_board=_to_transform(mounts[BOARD + 1 - foot]),
        R_camera_board=expected.T_camera_board[:3, :3],
        rotation_sd=rotation_sd,
    )


def _to_transform(mount: Array) -> Array:
    """(4, 4) transform of a mount (7,): position (entries 0-2, m) and quaternion (3-6; w, x, y, z)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_quat(mount[3:], scalar_first=True).as_matrix(), mount[:3]
    return T
