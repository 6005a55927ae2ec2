"""The inputs of the map: the depth camera's rectified image without depth discontinuities, and the pose at its time."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Rig
from stridetwin.streams.samples import Array, Odometry, copy_sample

_HERE = Path(__file__).parent

_MIN_JUMP_M = 0.25
"""A smaller change of pose is not a jump, however fast."""


@entry_kernel(_HERE)
def clip_range(depth: NDArray[np.float32], least: np.float32, most: np.float32) -> tuple[NDArray[np.float32], int]:
    """Depth image with invalid pixels set to 0, and the number of valid ones.

    Args:
        depth: (H, W) m; not finite or outside the limits means invalid.
        least: Smallest valid depth, m.
        most: Largest valid depth, m.
    """
    valid = np.empty(depth.shape, np.float32)
    nothing, count = np.float32(0.0), 0
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            inside = (depth[v, u] >= least) & (depth[v, u] <= most)
            valid[v, u] = depth[v, u] if inside else nothing
            count += inside
    return valid, count


@entry_kernel(_HERE, error_model="numpy")
def remove_discontinuities(depth: NDArray[np.float32], share: float, reach: int) -> NDArray[np.float32]:
    """Depth image without the pixels beside a discontinuity, which may lie between two surfaces (flying pixels).

    A pixel becomes 0 if the nearest and farthest depths around it differ by more than `share`. The same width is
    removed on both sides, so the middle of the gap is at the discontinuity.

    Args:
        depth: (H, W) m, 0 = none.
        share: Depth difference, relative to the larger depth, that makes a discontinuity.
        reach: Width removed on each side, pixels.

    Returns:
        (H, W) m, a copy in which the pixels beside a discontinuity are 0.
    """
    height, width = depth.shape
    # smallest ratio of nearest to farthest of a pixel that is kept; `nothing` and `never` mark pixels without depth in
    # a search for the farthest and for the nearest
    keeps, nothing, never = np.float32(1.0 - share), np.float32(0.0), np.float32(math.inf)
    clean = np.empty(depth.shape, np.float32)
    # First per column over the neighbouring rows, then over the neighbouring columns; outside the image there is none.
    # `far` and `near` are the results of the first search, with `reach` empty columns on either side.
    far, near = np.zeros(width + 2 * reach, np.float32), np.full(width + 2 * reach, never)
    farthest, nearest = np.empty(width, np.float32), np.empty(width, np.float32)
    for v in range(height):
        column_far, column_near = far[reach : reach + width], near[reach : reach + width]  # views
        for u in range(width):
            column_far[u] = nothing
            column_near[u] = never
        for row in range(max(v - reach, 0), min(v + reach + 1, height)):
            line = depth[row]
            for u in range(width):
                d = line[u]
                column_far[u] = d if d > column_far[u] else column_far[u]
                d = d if d > nothing else never
                column_near[u] = d if d < column_near[u] else column_near[u]
        for u in range(width):
            farthest[u] = far[u]
            nearest[u] = near[u]
        for shift in range(1, 2 * reach + 1):
            beside_far, beside_near = far[shift : shift + width], near[shift : shift + width]
            for u in range(width):
                farthest[u] = beside_far[u] if beside_far[u] > farthest[u] else farthest[u]
                nearest[u] = beside_near[u] if beside_near[u] < nearest[u] else nearest[u]
        line, out = depth[v], clean[v]
        for u in range(width):
            out[u] = line[u] if nearest[u] >= keeps * farthest[u] else nothing
    return clean


_WIDTH = 640.0  # px, width of the image in which numbers of pixels are given, see `DepthCamera.pixels`


NOT_SEEN, GROUND, BEHIND, NO_DEPTH = range(4)
"""What an image shows where ground is expected, see `DepthCamera.look_at`."""
_SURE_RANGE_M = 3.0
"""Level ground nearer than this is in the depth of every camera; beyond, some show none at grazing angles."""
_SAME_M, _SAME_SHARE = 0.03, 0.03
"""Largest distance along the ray between expected and seen ground: a constant and a share of the depth."""


class DepthCamera:
    """A depth stream and its pinhole model.

    Args:
        calibration: Calibration of the camera that the depth is registered to.

    Attributes:
        topic: Depth stream.
        shape: (H, W) of an image.
        intrinsics: (4,) fu, fv, pu, pv.
    """

    def __init__(self, calibration: CameraCalibration) -> None:
        """Prepares the rectification of depth images that are registered to the camera of `calibration`."""
        self.topic = calibration.depth_topic
        self.shape = (calibration.height, calibration.width)
        self.intrinsics: Array = np.array(calibration.intrinsics)
        # places u and v in the original image of each pixel of the rectified one; None for a lens without distortion
        self._maps = None
        if any(calibration.distortion):
            fisheye = calibration.distortion_model == "equidistant"
            undistort = cv2.fisheye.initUndistortRectifyMap if fisheye else cv2.initUndistortRectifyMap
            K, distortion = calibration.K, np.array(calibration.distortion)
            self._maps = undistort(K, distortion, np.eye(3), K, self.shape[::-1], cv2.CV_32FC1)  # size as (W, H)

    def pixels(self, of_640: float) -> int:
        """Converts a number of pixels of a 640-pixel image to this image's width, at least one."""
        return max(1, round(of_640 * self.shape[1] / _WIDTH))

    def rectify(self, depth: NDArray[np.float32], p: TerrainMapParameters) -> tuple[NDArray[np.float32], int]:
        """Rectifies a depth image to the pinhole model.

        Args:
            depth: (H, W) m; 0, NaN, infinity and negative values are invalid.
            p: Range limits.

        Returns:
            (H, W) m, 0 = invalid or out of range; number of valid pixels.

        Raises:
            StrideTwinError: The image size differs from the rig's.
        """
        if depth.shape != self.shape:
            raise StrideTwinError(
                f"{self.topic}: invalid image size {depth.shape}: expected {self.shape}, as in the rig"
            )
        clean, count = clip_range(np.asarray(depth, np.float32), np.float32(p.min_range_m), np.float32(p.max_range_m))
        if self._maps is None:
            return clean, count
        # the nearest pixel: a mean of two depths may lie between two surfaces
        rectified = np.asarray(cv2.remap(clean, *self._maps, cv2.INTER_NEAREST, borderValue=0.0), np.float32)
        return rectified, int(np.count_nonzero(rectified))

    def look_at(self, depth: NDArray[np.float32], points: Array) -> NDArray[np.int64]:
        """(N,) what an image shows at (N, 3) points, m, in the optical frame, where ground is expected.

        `NOT_SEEN`: out of view, farther than `_SURE_RANGE_M`, or behind something. `GROUND`: a surface is there.
        `BEHIND`: the surface in this direction is farther away. `NO_DEPTH`: there is none.

        Args:
            depth: (H, W) m, rectified; 0 is invalid.
            points: The points.
        """
        result = np.full(len(points), NOT_SEEN)
        z = points[:, 2]
        in_front = np.flatnonzero((z > 0.3) & (z < _SURE_RANGE_M))
        fu, fv, pu, pv = self.intrinsics
        u = np.rint(points[in_front, 0] / z[in_front] * fu + pu).astype(np.int64)
        v = np.rint(points[in_front, 1] / z[in_front] * fv + pv).astype(np.int64)
        inside = (u >= 0) & (u < self.shape[1]) & (v >= 0) & (v < self.shape[0])
        seen, expected = depth[v[inside], u[inside]], z[in_front][inside]
        slack = _SAME_M + _SAME_SHARE * expected
        here = np.where(seen > expected + slack, BEHIND, np.where(seen < expected - slack, NOT_SEEN, GROUND))
        result[in_front[inside]] = np.where(seen <= 0.0, NO_DEPTH, here)
        return result


def depth_calibration(rig: Rig, topic: str | None = None) -> CameraCalibration:
    """Calibration of the camera with this depth stream; without a topic, of the first camera that has one.

    Raises:
        StrideTwinError: No such camera; the message lists the available ones.
    """
    cameras = {camera.depth_topic: camera for camera in rig.cameras.values() if camera.depth_topic}
    if not cameras or (topic is not None and topic not in cameras):
        raise StrideTwinError(
            f"the rig has no depth {topic or 'camera'}; it has {', '.join(sorted(cameras)) or 'none'}"
        )
    return cameras[topic] if topic is not None else next(iter(cameras.values()))  # the first one


def camera_in_frame(rig: Rig, camera: CameraCalibration, frame: str) -> Array:
    """(4, 4) transform, m, from the camera's optical frame to another sensor's frame on the same body.

    Args:
        rig: Holds both mounting poses.
        camera: Camera of the optical frame.
        frame: Frame of the other sensor, such as `head/imu`; "" is the camera's own.

    Raises:
        StrideTwinError: The rig has no such sensor, or it is on another body.
    """
    if not frame:
        return np.eye(4)
    sensors: dict[str, ImuCalibration | CameraCalibration] = {**rig.imus, **rig.cameras}
    topics = [topic for topic, sensor in sensors.items() if sensor.mount.body == camera.mount.body]
    if f"/{frame}" not in topics:
        valid = ", ".join(topic.removeprefix("/") for topic in topics)
        raise StrideTwinError(f"the rig has no frame {frame!r} on the body of {camera.topic}; it has {valid}")
    return np.asarray(np.linalg.inv(sensors[f"/{frame}"].mount.T_body_sensor) @ camera.mount.T_body_sensor, float)


def is_pose(sample: Odometry) -> bool:
    """Whether position and quaternion of a sample are finite, and the quaternion is not near zero."""
    p, q = sample.p_frame_in_world.tolist(), sample.q_world_frame.tolist()
    # a sum is finite only if all its terms are
    return math.isfinite(sum(p)) and 0.5 <= math.hypot(*q) < math.inf


def transform(pose: Odometry) -> Array:
    """(4, 4) transform frame to world, m, of a pose sample."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(pose.q_world_frame, scalar_first=True).as_matrix()
    T[:3, 3] = pose.p_frame_in_world
    return T


class Poses:
    """Keeps the last pose, and detects jumps and gaps.

    Args:
        parameters: Limits of a pose's age and speed.
    """

    def __init__(self, parameters: TerrainMapParameters) -> None:
        """Begins without a pose; `parameters` limits age and speed of a pose."""
        self._p = parameters
        self._last: Odometry | None = None  # the newest valid pose

    def add(self, pose: Odometry) -> bool:
        """Takes a pose; returns whether it jumped from the previous one, or came after a long gap.

        A pose that is not finite, or not newer than the previous one, is ignored.
        """
        if not is_pose(pose):
            return False
        pose = copy_sample(pose)  # the caller may reuse its arrays
        if self._last is None:
            self._last = pose
            return False
        if pose.t_ns <= self._last.t_ns:
            return False
        moved = math.dist(pose.p_frame_in_world.tolist(), self._last.p_frame_in_world.tolist())
        dt = (pose.t_ns - self._last.t_ns) * 1e-9
        self._last = pose
        return dt > self._p.max_gap_s or (moved > _MIN_JUMP_M and moved > self._p.max_speed_mps * dt)

    def at(self, t_ns: int) -> Array | None:
        """(4, 4) frame to world at a time: the last pose, propagated by its velocity where it has one.

        None without a pose, or if the last one is more than `max_pose_age_s` before or after that time.
        """
        pose = self._last
        if pose is None or abs(t_ns - pose.t_ns) > self._p.max_pose_age_s * 1e9:
            return None
        # The angular rate is in the frame's own axes, so its rotation is on the right.
        dt, T = (t_ns - pose.t_ns) * 1e-9, transform(pose)  # s; negative where the pose is newer
        if dt and np.isfinite(pose.v_frame_in_world).all() and np.isfinite(pose.angular_rate).all():
            T[:3, 3] += pose.v_frame_in_world * dt
            T[:3, :3] = T[:3, :3] @ Rotation.from_rotvec(pose.angular_rate * dt).as_matrix()
        return T
