"""Whether the depth of a camera and its focal length agree with a motion that is measured otherwise.

The reference is an IMU on the camera's body, or poses that come with the images. Runs of about a second are compared
until the scale is certain.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypedDict

import numpy as np

from stridetwin.scenarios.camera_motion import CameraPath, Tracks, solve_path, track_features
from stridetwin.scenarios.inertial_path import InertialPath, integrate, measure_motion_m
from stridetwin.scenarios.motion_scale import (
    SHIFTS_S,
    LogRatio,
    MotionScale,
    Run,
    compare_with_imu,
    compare_with_poses,
    correlate,
    fit_motion_scale,
)
from stridetwin.streams.algebra.arrays import from_quaternion
from stridetwin.streams.depth_planes import find_implausible_planes, find_planes, measure_focal_ratio
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.plausible import (
    DEPTH_UNITS,
    Implausible,
    find_implausible_depth,
    force_at_rest,
    name_depth_option,
)
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array, Block, Depth, Image, Imu, Odometry, Sample

MARGIN_LOG = math.log(1.1)
"""Logarithm of the factor by which depth or focal length may be off: an odometry's path is then off by a tenth."""
_RUN_S, _SHORTEST_RUN_S = 1.2, 0.6
"""Longest run of images that is compared, two steps of a walk, and shortest one."""
_BATCH, _MOST_WINDOWS = 4, 16
"""Runs that are read at a time, and most runs of a recording."""
_MOST_CANDIDATES = 120
"""Most windows among which those with the most motion are chosen."""
_PLANE_VIEWS = 12
"""Depth images in which planes are looked for."""
_LARGEST_FOCAL_LOG = math.log(1.75)
"""A larger scale is no focal length: no lens is so far from a calibrated one."""
_FORCE_SHARE = (0.85, 1.15)
"""Typical force of a usable accelerometer, in multiples of gravity."""
_NEAREST_POSE_S = 0.005
"""Most time between an image and its pose."""
_INPUT_POSES = "7scenes"
"""Layout whose poses are an input: its scenes were made with them."""


class DepthScaleRow(TypedDict):
    """A `DepthScale` as plain values."""

    reference: str
    scale: float
    scale_half: float
    focal_ratio: float
    focal_half: float | None
    correlation: float
    runs: int


@dataclass(frozen=True, kw_only=True)
class DepthScale:
    """Depth and focal length of a camera against a reference.

    Attributes:
        reference: Topic of the IMU or of the poses.
        camera: The camera.
        motion: Scales as they were measured, with the calibrated focal length.
        depth: Recorded depth over the true one, if that is certainly wrong; else None.
        focal: Calibrated focal length over the true one, if that is certainly wrong; else None.
        may_be_focal: Whether a wrong focal length may also be the cause of a wrong scale of depth.
        per_metre: Units of the depth images per metre, as they were read; None if no option gives them.
    """

    reference: str
    camera: CameraCalibration
    motion: MotionScale
    depth: LogRatio | None
    focal: LogRatio | None
    may_be_focal: bool
    per_metre: float | None

    def row(self) -> DepthScaleRow:
        """The scale as a mapping of plain values, for JSON."""
        half = self.motion.focal.half
        return {
            "reference": self.reference,
            "scale": self.motion.path.ratio,
            "scale_half": self.motion.path.half * self.motion.path.ratio,
            "focal_ratio": self.motion.focal.ratio,
            "focal_half": None if math.isinf(half) else half * self.motion.focal.ratio,
            "correlation": self.motion.correlation,
            "runs": self.motion.runs,
        }

    def faults(self) -> Iterator[str]:
        """Yields a sentence for each error of the depth or of the intrinsics."""
        if self.focal is not None:
            f = self.camera.intrinsics[0]
            yield (
                f"intrinsics: invalid focal length {f:.4g} px: expected {_interval(f, self.focal)} px (95 %), as its "
                f"motion and that of {self.reference} agree only then; calibrate it, or give intrinsics for images of "
                f"{self.camera.width} x {self.camera.height} with --rig"
            )
        if self.depth is not None:
            factor = 1.0 / self.depth.ratio
            other = ""
            if self.may_be_focal:
                f = self.camera.intrinsics[0] * self.motion.sideways.ratio
                other = f", or the focal length {f:.3g} px in place of {self.camera.intrinsics[0]:.4g} px"
            yield (
                f"depth: invalid unit: it makes the camera's motion {_interval(1.0, self.depth, inverse=False)} times "
                f"(95 %) that of {self.reference}: expected 1; multiply the depth by {factor:.2g}, "
                f"{name_depth_option(factor, self.per_metre)}{other}"
            )


def _interval(value: float, ratio: LogRatio, *, inverse: bool = True) -> str:
    """A value divided (or multiplied) by a ratio, as text with the half width of its interval."""
    middle = value / ratio.ratio if inverse else value * ratio.ratio
    return f"{middle:.3g} ± {middle * ratio.half:.2g}"


def measure_depth_scales(recording: Recording, gyros: Mapping[str, Block[Imu]]) -> dict[str, DepthScale]:
    """Depth and focal length of every camera that can be compared with a reference, by the topic of its depth."""
    cameras = recording.rig.cameras.values() if recording.has_rig else ()
    scales = {camera.depth_topic: measure_depth_scale(recording, camera, gyros) for camera in cameras}
    return {topic: scale for topic, scale in scales.items() if scale is not None}


def find_implausible_views(recording: Recording, compared: Collection[str]) -> Iterator[tuple[str, Implausible]]:
    """Yields what distances and planes in some depth images show of the unit and the focal length.

    Args:
        recording: Recording with the images. An import has checked its depth itself.
        compared: Topics of depth whose scale is known better.

    Yields:
        Topic of the depth, and what is implausible.
    """
    cameras = recording.rig.cameras.values() if recording.has_rig and recording.is_mcap else ()
    for camera in cameras:
        if camera.depth_topic not in recording.topics or camera.depth_topic in compared:
            continue
        try:
            depths = _sample_depths(recording, camera)
        except StrideTwinError:  # a damaged image is a problem of its own
            continue
        implausible = list(find_implausible_depth(depths, _units_per_metre(recording)))
        if not implausible:
            views = [find_planes(depth, camera) for depth in depths]
            implausible = list(find_implausible_planes(views, camera, _units_per_metre(recording)))
        yield from ((camera.depth_topic, finding) for finding in implausible)


def measure_depth_scale(
    recording: Recording, camera: CameraCalibration, gyros: Mapping[str, Block[Imu]]
) -> DepthScale | None:
    """Compares the motion of a depth camera with that of the IMU on its body, else with poses that are an input.

    Args:
        recording: Recording with the images.
        camera: Calibration of a camera with depth.
        gyros: Samples of the IMUs by topic.

    Returns:
        None if neither is there, or they cannot be compared: too little motion or texture, or another clock or mount.
    """
    if not _has_images(recording, camera):
        return None
    if camera.imu_topic in gyros:
        imu = gyros[camera.imu_topic]
        force_mps2, _ = force_at_rest(imu.t_ns, imu.columns["specific_force"])
        if not _FORCE_SHARE[0] < force_mps2 / NOMINAL_GRAVITY_MPS2 < _FORCE_SHARE[1]:
            return None  # forces in another unit, which is an error of its own
        return _measure(recording, camera, camera.imu_topic, _ByImu(recording, camera, gyros[camera.imu_topic]))
    topic = _find_input_poses(recording, camera)
    if topic is not None:
        return _measure(recording, camera, topic, _ByPoses(recording, camera, recording.block(topic)))
    return None


def _has_images(recording: Recording, camera: CameraCalibration) -> bool:
    """Whether a camera has both images and depth."""
    topics = recording.topics
    return (
        camera.topic in topics
        and topics[camera.topic].kind is Image
        and camera.depth_topic in topics
        and topics[camera.depth_topic].kind is Depth
    )


def _find_input_poses(recording: Recording, camera: CameraCalibration) -> str | None:
    """Topic of poses of the camera that are an input, not the truth: of a device, or of the layout of 7-Scenes."""
    topics = [f"{camera.topic}/odometry"]
    if recording.metadata.get("imported_from") == _INPUT_POSES:
        topics.append(f"/truth{camera.topic}/odometry")
    return next((t for t in topics if t in recording.topics and recording.topics[t].kind is Odometry), None)


class _ByImu:
    """Compares the paths of runs with an IMU.

    Args:
        recording: Recording with the images.
        camera: The camera.
        imu: All samples of the IMU on its body.
    """

    def __init__(self, recording: Recording, camera: CameraCalibration, imu: Block[Imu]) -> None:
        self._imu, self._calibrated_s = imu, camera.timeshift_cam_imu_s
        T_body_imu = recording.rig.imu(camera.imu_topic).mount.T_body_sensor
        self._T_imu_camera = np.linalg.inv(T_body_imu) @ camera.mount.T_body_sensor
        self._times = recording.image_times(camera.topic)
        self._reach_ns = round((float(SHIFTS_S[-1]) + abs(self._calibrated_s)) * 1e9)

    def choose_windows(self, size: int) -> list[int]:
        """Numbers of the first images of windows, alternately with the most motion and the most rotation."""
        motions, turns, starts = list[float](), list[float](), list[int]()
        step = max(size, len(self._times) // _MOST_CANDIDATES)
        for start in range(0, len(self._times) - size + 1, step):
            inertial = self._integrate(int(self._times[start]), int(self._times[start + size - 1]))
            if inertial is not None:
                starts.append(start)
                motions.append(measure_motion_m(inertial))
                turns.append(float(np.linalg.norm(inertial.rotation_rad, axis=1).max()))
        by_motion, by_turn = (np.argsort(values)[::-1].tolist() for values in (motions, turns))
        order = dict.fromkeys(i for both in zip(by_motion, by_turn) for i in both)
        return [starts[i] for i in order]

    def compare(self, paths: Sequence[CameraPath]) -> list[Run]:
        """The runs at the shift of the clock at which they agree best; none if that is the largest one."""
        inertials = [self._integrate(int(path.t_ns[0]), int(path.t_ns[-1])) for path in paths]
        both = [(path, inertial) for path, inertial in zip(paths, inertials) if inertial is not None]
        best: list[Run] = []
        best_correlation, is_at_end = -math.inf, False
        for i, shift_s in enumerate(SHIFTS_S.tolist()):
            runs = [
                compare_with_imu(p, inertial, self._T_imu_camera, self._calibrated_s + shift_s) for p, inertial in both
            ]
            correlation = correlate(runs)
            if correlation > best_correlation:
                best, best_correlation, is_at_end = runs, correlation, i in (0, len(SHIFTS_S) - 1)
        return [] if is_at_end else best

    def _integrate(self, first_ns: int, last_ns: int) -> InertialPath | None:
        """The IMU's path between two times of the camera, and as far beyond as clocks may differ."""
        return integrate(self._imu, first_ns - self._reach_ns, last_ns + self._reach_ns)


class _ByPoses:
    """Compares the paths of runs with given poses.

    Args:
        recording: Recording with the images.
        camera: The camera.
        poses: Poses of the camera.
    """

    def __init__(self, recording: Recording, camera: CameraCalibration, poses: Block[Sample]) -> None:
        self._t_ns = poses.t_ns
        self._T = np.tile(np.eye(4), (len(poses), 1, 1))
        self._T[:, :3, :3] = from_quaternion(poses.columns["q_world_frame"])
        self._T[:, :3, 3] = poses.columns["p_frame_in_world"]
        self._times = recording.image_times(camera.topic)

    def choose_windows(self, size: int) -> list[int]:
        """Numbers of the first images of windows, those with the longest way first."""
        starts = list(range(0, len(self._times) - size + 1, size))
        at = (
            [self._nearest(int(self._times[s])) for s in starts],
            [self._nearest(int(self._times[s + size - 1])) for s in starts],
        )
        way = np.linalg.norm(self._T[at[1], :3, 3] - self._T[at[0], :3, 3], axis=1)
        return [starts[i] for i in np.argsort(way)[::-1].tolist()]

    def compare(self, paths: Sequence[CameraPath]) -> list[Run]:
        """The runs, over the images that have a pose."""
        runs: list[Run] = []
        for path in paths:
            at = np.array([self._nearest(int(t)) for t in path.t_ns])
            has_pose = np.abs(self._t_ns[at] - path.t_ns) <= _NEAREST_POSE_S * 1e9
            if has_pose.all():
                runs.append(compare_with_poses(path, self._T[at]))
        return runs

    def _nearest(self, t_ns: int) -> int:
        """Number of the pose that is nearest to a time."""
        return int(np.argmin(np.abs(self._t_ns - t_ns)))


def _measure(
    recording: Recording, camera: CameraCalibration, reference: str, comparison: _ByImu | _ByPoses
) -> DepthScale | None:
    """Reads runs of images until the scale is certainly right or wrong, and names what is wrong."""
    size = max(8, round(_RUN_S * recording.topics[camera.topic].rate_hz))
    windows = comparison.choose_windows(size)[:_MOST_WINDOWS]
    tracks: list[Tracks] = []

    def fit(focal_factor: float) -> MotionScale | None:
        paths = [path for run in tracks if (path := solve_path(run, focal_factor)) is not None]
        return fit_motion_scale(comparison.compare([path for path in paths if _duration_s(path) > _SHORTEST_RUN_S]))

    motion = None
    for start in range(0, len(windows), _BATCH):
        for first in windows[start : start + _BATCH]:
            tracks += track_features(recording, camera, first, size, _RUN_S)
        motion = fit(1.0)
        if motion is not None and _is_right(motion):
            break
    if motion is None:
        return None
    depth, focal, may_be_focal = _judge(motion, fit, lambda: _focal_by_planes(recording, camera))
    return DepthScale(
        reference=reference,
        camera=camera,
        motion=motion,
        depth=depth,
        focal=focal,
        may_be_focal=may_be_focal,
        per_metre=_units_per_metre(recording),
    )


def _units_per_metre(recording: Recording) -> float | None:
    """Units of the depth images per metre, as they were read; None if no option gives them."""
    text = recording.metadata.get(DEPTH_UNITS, "")
    return float(text) if re.fullmatch(r"[0-9.e+-]+", text) else None


def _duration_s(path: CameraPath) -> float:
    """Duration of a path."""
    return float(path.t_ns[-1] - path.t_ns[0]) * 1e-9


def _is_right(motion: MotionScale) -> bool:
    """Whether depth and focal length are certainly right."""
    sideways_or_focal = motion.sideways.is_within(MARGIN_LOG) or motion.focal.is_within(MARGIN_LOG)
    return motion.path.is_within(MARGIN_LOG) and sideways_or_focal


def _judge(
    motion: MotionScale, fit: Callable[[float], MotionScale | None], focal_by_planes: Callable[[], LogRatio | None]
) -> tuple[LogRatio | None, LogRatio | None, bool]:
    """What is certainly wrong: the depth, the focal length, and whether the latter may be wrong in place of the former.

    Args:
        motion: With the calibrated focal length.
        fit: Measures it with the focal length times a factor.
        focal_by_planes: Calibrated focal length over that with which floor and walls are perpendicular.
    """
    if _is_right(motion):
        return None, None, False
    # with the right depth, the ratio of focal lengths that explains the sideways motion
    needed = LogRatio(value=-motion.sideways.value, half=motion.sideways.half)
    focal = motion.focal
    is_explained = abs(needed.value) < _LARGEST_FOCAL_LOG and _agree(focal, needed)
    if motion.path.is_beyond(MARGIN_LOG) and is_explained and not focal.is_beyond(MARGIN_LOG):
        by_planes = focal_by_planes()
        if by_planes is not None and by_planes.is_beyond(MARGIN_LOG) and _agree(by_planes, needed):
            focal = by_planes
        else:
            may_be_focal = by_planes is None or not by_planes.is_within(MARGIN_LOG)
            return motion.path, None, may_be_focal and not focal.is_within(MARGIN_LOG)
    if focal.is_beyond(MARGIN_LOG) and abs(focal.value) < _LARGEST_FOCAL_LOG:
        corrected = fit(1.0 / focal.ratio)
        is_depth_off = corrected is not None and corrected.path.is_beyond(MARGIN_LOG)
        return corrected.path if corrected is not None and is_depth_off else None, focal, False
    return motion.path if motion.path.is_beyond(MARGIN_LOG) else None, None, False


def _agree(a: LogRatio, b: LogRatio) -> bool:
    """Whether the intervals of two logarithms allow the same value."""
    return abs(a.value - b.value) <= math.hypot(a.half, b.half)


def _focal_by_planes(recording: Recording, camera: CameraCalibration) -> LogRatio | None:
    """Calibrated focal length over that with which floor and walls are perpendicular; None without enough of them."""
    views = [find_planes(depth, camera) for depth in _sample_depths(recording, camera)]
    ratio = measure_focal_ratio(views)
    return None if ratio is None else LogRatio(value=math.log(ratio.ratio), half=ratio.half_log)


def _sample_depths(recording: Recording, camera: CameraCalibration) -> list[Array]:
    """Some depth images (H, W), m, spread over a recording."""
    count = len(recording.image_times(camera.depth_topic))
    numbers = np.unique(np.linspace(0, count - 1, _PLANE_VIEWS).round().astype(int)).tolist()
    images = recording.images(camera.depth_topic, numbers)
    depths = [np.asarray(image.depth, float) for image in images if isinstance(image, Depth)]
    return [depth for depth in depths if depth.shape == (camera.height, camera.width)]
