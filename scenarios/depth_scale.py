"""Whether the depth of a camera and its focal length agree with its motion.

The focal length is the one with which points of known depth move as a body. The depth is compared with an IMU on the
camera's body, or with poses that are an input. Runs of about a second are read until both are certain.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypedDict

import numpy as np

from stridetwin.scenarios.depth_tracks import CameraPath, RunTracks, solve_path, track_features
from stridetwin.scenarios.focal_length import measure_focal_by_images
from stridetwin.scenarios.inertial_path import InertialPath, integrate_path, measure_motion_m
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
from stridetwin.streams.depth_planes import (
    FOCAL_FIELD,
    choose_views,
    find_implausible_views,
    find_planes,
    measure_focal_ratio,
)
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.plausible import DEPTH_UNITS, Implausible, force_at_rest, name_depth_option
from stridetwin.streams.recording.imported import IMPORTED_FROM
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array, Block, Depth, Image, Imu, Odometry, Sample

MARGIN_LOG = math.log(1.1)
"""Logarithm of the factor by which depth or focal length may be off: an odometry's path is then off by a tenth."""
WARNING_LOG = math.log(1.05)
"""Logarithm of the factor by which depth or focal length may be off without a warning."""
_RUN_S, _SHORTEST_RUN_S = 1.2, 0.6
"""Longest run of images that is compared, two steps of a walk, and shortest one."""
_RUN_IMAGES = (8, 80)
"""Fewest and most images of a run, at any rate."""
_BATCH, _MOST_WINDOWS = 4, 16
"""Runs that are read at a time, and most runs of a recording."""
_MOST_CANDIDATES = 120
"""Most windows among which those with the most motion are chosen."""
_KNOWN_FOCAL_LOG = 0.06
"""Half width of the interval of a focal length's logarithm up to which floor and walls are not asked."""
_LARGEST_FOCAL_LOG = math.log(1.75)
"""A larger scale is no focal length: no lens is so far from a calibrated one."""
_USUAL_FACTORS = (0.001, 0.1, 0.2, 0.25, 0.5, 2.0, 4.0, 5.0, 10.0, 1000.0)
"""Factors between usual units of depth: 1/1000, 1/2000, 1/4000, 1/5000 and 1/10000 m, mm and m."""
_FORCE_SHARE = (0.85, 1.15)
"""Typical force of a usable accelerometer, in multiples of gravity."""
_NEAREST_POSE_S = 0.005
"""Most time between an image and its pose."""
_UNIT_TOLERANCE = 0.01
"""Largest difference of a quaternion's norm from 1."""
_INPUT_POSES = "7scenes"
"""Layout whose poses are an input: its scenes were made with them."""


class DepthScaleRow(TypedDict):
    """A `DepthScale` as plain values; None for what is not known.

    Attributes:
        reference: Topic of the IMU or of the poses; "" without any.
        scale: Length of the camera's path over that of the reference.
        scale_half: Half width of its 95 % interval.
        correlation: Of both paths.
        focal_ratio: Calibrated focal length over the one that fits.
        focal_half: Half width of its 95 % interval.
        runs: Number of runs of images.
    """

    reference: str
    scale: float | None
    scale_half: float | None
    correlation: float | None
    focal_ratio: float | None
    focal_half: float | None
    runs: int


@dataclass(frozen=True, kw_only=True)
class DepthScale:
    """Depth and focal length of a camera against its motion.

    Attributes:
        reference: Topic of the IMU or of the poses; "" without any.
        camera: The camera.
        motion: Camera's motion over the reference's, with the focal length that fits where the calibrated one is wrong;
            None if there is no reference that it agrees with.
        focal: Calibrated focal length over the one with which points of known depth move as a rigid scene.
        by_planes: Calibrated focal length over the one with which floor and walls are perpendicular; None if it was not
            needed, or there are none.
        per_metre: Units of the depth images per metre, as they were read; None if no option gives them.
        runs: Number of runs of images that were compared.
    """

    reference: str
    camera: CameraCalibration
    motion: MotionScale | None
    focal: LogRatio
    by_planes: LogRatio | None
    per_metre: float | None
    runs: int

    def row(self) -> DepthScaleRow:
        """The scale as a mapping of plain values, for JSON."""
        motion, is_known = self.motion, math.isfinite(self.focal.half)
        return {
            "reference": self.reference,
            "scale": None if motion is None else motion.path.ratio,
            "scale_half": None if motion is None else motion.path.half * motion.path.ratio,
            "correlation": None if motion is None else motion.correlation,
            "focal_ratio": self.focal.ratio if is_known else None,
            "focal_half": self.focal.half * self.focal.ratio if is_known else None,
            "runs": self.runs,
        }

    def faults(self, asks_focal: bool = True) -> Iterator[tuple[str, bool]]:
        """Yields a sentence for each fault of the depth or of the intrinsics, and whether it is an error.

        Args:
            asks_focal: Whether the focal length is judged; false where the rotation has shown that it is right.
        """
        f = self.camera.intrinsics[0]
        if asks_focal and self.focal.is_beyond(WARNING_LOG):
            what = (
                f"intrinsics: invalid focal length {f:.4g} px: expected {_format_quotient(f, self.focal)} px (95 %), "
                f"with which points in the images move as a rigid scene; give the calibration of images of "
                f"{self.camera.width} x {self.camera.height} with --rig"
            )
            yield what, self.focal.is_beyond(MARGIN_LOG)
        if self.motion is None or not self.motion.is_beyond(WARNING_LOG):
            return
        path, sideways, cause = self.motion.path, self.motion.sideways, ""
        may_be_focal = self._may_be_focal(sideways)
        if not path.is_beyond(WARNING_LOG):
            if not may_be_focal:
                return
            path = sideways
        if may_be_focal:
            expected = _format_quotient(f, LogRatio(value=-sideways.value, half=sideways.half))
            if self.by_planes is not None and self.by_planes.is_beyond(WARNING_LOG):
                what = (
                    f"intrinsics: invalid focal length {f:.4g} px: expected {expected} px (95 %), with which its "
                    f"motion is that of {self.reference}, and floor and walls are perpendicular; give the calibration "
                    f"of images of {self.camera.width} x {self.camera.height} with --rig"
                )
                yield what, path.is_beyond(MARGIN_LOG)
                return
            cause = f"; or the focal length is {expected} px in place of {f:.4g} px"
        factor = _round_to_usual(-path.value, path.half)
        what = (
            f"depth: invalid unit: it makes the camera's motion {path.ratio:.3g} ± {path.ratio * path.half:.2g} times "
            f"(95 %) that of {self.reference}: expected 1; multiply the depth by {factor:.3g}, "
            f"{name_depth_option(factor, self.per_metre)}{cause}"
        )
        yield what, path.is_beyond(MARGIN_LOG)

    def _may_be_focal(self, sideways: LogRatio) -> bool:
        """Whether a wrong focal length may be the cause of a wrong sideways motion."""
        needed = LogRatio(value=-sideways.value, half=sideways.half)
        known = [self.focal] if self.by_planes is None else [self.focal, self.by_planes]
        is_possible = all(ratio.agrees(needed) for ratio in known)
        return is_possible and abs(needed.value) < _LARGEST_FOCAL_LOG and not self.focal.is_beyond(WARNING_LOG)


def _format_quotient(value: float, ratio: LogRatio) -> str:
    """A value over a ratio with the half width of its 95 % interval, as text: `600 ± 12`."""
    return f"{value / ratio.ratio:.3g} ± {value / ratio.ratio * ratio.half:.2g}"


def _round_to_usual(factor_log: float, half: float) -> float:
    """The factor between usual units of depth that is within an interval, else the factor in its middle.

    Args:
        factor_log: Logarithm of the factor in the middle.
        half: Half width of the interval of the logarithm.
    """
    usual = min(_USUAL_FACTORS, key=lambda factor: abs(math.log(factor) - factor_log))
    return usual if abs(math.log(usual) - factor_log) < half else math.exp(factor_log)


def measure_depth_scales(
    recording: Recording, gyros: Mapping[str, Block[Imu]], skipped: Collection[str] = ()
) -> dict[str, DepthScale]:
    """Depth and focal length of every camera that can be compared with a reference, by the topic of its depth.

    Args:
        recording: Recording with the images.
        gyros: Samples of the IMUs by topic.
        skipped: Topics of depth that are left out.

    Returns:
        Only cameras of which something is known.
    """
    known = recording.rig.cameras.values() if recording.has_rig else ()
    cameras = [camera for camera in known if camera.depth_topic not in skipped]
    scales = {camera.depth_topic: measure_depth_scale(recording, camera, gyros) for camera in cameras}
    return {topic: scale for topic, scale in scales.items() if scale is not None}


def judge_depth_images(
    recording: Recording, scales: Mapping[str, DepthScale], skipped: Collection[str] = ()
) -> Iterator[tuple[str, Implausible]]:
    """Yields what distances and planes in some depth images show of the unit and the focal length.

    Args:
        recording: Recording with the images. An import has checked its depth itself.
        scales: What is known better, by the topic of the depth.
        skipped: Topics of depth that are left out.

    Yields:
        Topic of the depth, and what is implausible.
    """
    cameras = recording.rig.cameras.values() if recording.has_rig and recording.is_mcap else ()
    for camera in cameras:
        scale = scales.get(camera.depth_topic)
        is_focal_known = scale is not None and scale.focal.half < _KNOWN_FOCAL_LOG
        is_depth_known = scale is not None and scale.motion is not None
        is_left_out = camera.depth_topic in skipped or camera.depth_topic not in recording.topics
        if is_left_out or (is_focal_known and is_depth_known):
            continue
        try:
            depths = _read_some_depths(recording, camera)
        except StrideTwinError:  # a damaged image is a problem of its own
            continue
        for finding in find_implausible_views(depths, camera, _units_per_metre(recording)):
            if not (is_focal_known if finding.field == FOCAL_FIELD else is_depth_known):
                yield camera.depth_topic, finding


def measure_depth_scale(
    recording: Recording, camera: CameraCalibration, gyros: Mapping[str, Block[Imu]]
) -> DepthScale | None:
    """Compares the motion of a depth camera with that of the IMU on its body, else with poses that are an input.

    Args:
        recording: Recording with the images.
        camera: Calibration of a camera with depth.
        gyros: Samples of the IMUs by topic.

    Returns:
        Scale and focal length, as far as they are known; None if neither is: too little motion or texture, or another
        clock or mount.
    """
    if not _has_images(recording, camera):
        return None
    reference = _find_reference(recording, camera, gyros)
    size = int(np.clip(round(_RUN_S * recording.topics[camera.topic].rate_hz), *_RUN_IMAGES))
    windows = reference.choose_windows(size)[:_MOST_WINDOWS]
    tracks: list[RunTracks] = []
    motion, focal = None, LogRatio(value=0.0, half=math.inf)
    for start in range(0, len(windows), _BATCH):
        for first in windows[start : start + _BATCH]:
            runs = track_features(recording, camera, first, size, _RUN_S)
            tracks += [run for run in runs if run.t_ns[-1] - run.t_ns[0] > _SHORTEST_RUN_S * 1e9]
        focal = measure_focal_by_images(tracks)
        motion = _fit_scale(reference, tracks, 1.0)
        focal = focal if motion is None else focal.combine(motion.focal)
        is_right = not reference.topic if motion is None else motion.path.is_within(MARGIN_LOG)
        if is_right and focal.is_within(MARGIN_LOG):
            break
    if focal.is_beyond(WARNING_LOG):
        motion = _fit_scale(reference, tracks, 1.0 / focal.ratio)
    if motion is None and math.isinf(focal.half):
        return None
    is_open = motion is not None and motion.is_beyond(WARNING_LOG) and not focal.is_beyond(WARNING_LOG)
    return DepthScale(
        reference=reference.topic,
        camera=camera,
        motion=motion,
        focal=focal,
        by_planes=_measure_focal_by_planes(recording, camera) if is_open else None,
        per_metre=_units_per_metre(recording),
        runs=len(tracks),
    )


def _fit_scale(reference: _Reference, tracks: Sequence[RunTracks], focal_factor: float) -> MotionScale | None:
    """Scale of the motion with the calibrated focal length times a factor; None if the paths do not agree with it.

    Args:
        reference: What the motion is compared with.
        tracks: Features of the runs.
        focal_factor: The factor.
    """
    paths = [path for run in tracks if (path := solve_path(run, focal_factor)) is not None]
    long = [path for path in paths if path.t_ns[-1] - path.t_ns[0] > _SHORTEST_RUN_S * 1e9]
    motion = fit_motion_scale(reference.compare(long))
    return motion if motion is not None and motion.is_usable else None


def _find_reference(recording: Recording, camera: CameraCalibration, gyros: Mapping[str, Block[Imu]]) -> _Reference:
    """The IMU on the camera's body if its forces are usable, else poses that are an input, else none."""
    if camera.imu_topic in gyros:
        imu = gyros[camera.imu_topic]
        force_mps2, _ = force_at_rest(imu.t_ns, imu.columns["specific_force"])
        if _FORCE_SHARE[0] < force_mps2 / NOMINAL_GRAVITY_MPS2 < _FORCE_SHARE[1]:
            return _ByImu(recording, camera, imu)
    topic = _find_input_poses(recording, camera)
    return _Reference(recording, camera) if topic is None else _ByPoses(recording, camera, recording.block(topic))


def _units_per_metre(recording: Recording) -> float | None:
    """Units of the depth images per metre, as they were read; None if no option gives them."""
    text = recording.metadata.get(DEPTH_UNITS, "")
    return float(text) if re.fullmatch(r"\d+(\.\d+)?(e[+-]?\d+)?", text) else None


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
    if recording.metadata.get(IMPORTED_FROM) == _INPUT_POSES:
        topics.append(f"/truth{camera.topic}/odometry")
    return next((t for t in topics if t in recording.topics and recording.topics[t].kind is Odometry), None)


class _Reference:
    """What a camera's motion is compared with; this class is for no reference, its subclasses are the others.

    Args:
        recording: Recording with the images.
        camera: The camera.

    Attributes:
        topic: Topic of the reference; "" for none.
    """

    topic = ""

    def __init__(self, recording: Recording, camera: CameraCalibration) -> None:
        self._times = recording.image_times(camera.topic)

    def choose_windows(self, size: int) -> list[int]:
        """Numbers of the first images of windows of `size` images, in the order in which they are to be read.

        Without a reference they are spread over the recording.
        """
        starts = np.arange(0, len(self._times) - size + 1, size)
        spread = np.linspace(0, len(starts) - 1, min(len(starts), _MOST_WINDOWS)).round().astype(int)
        chosen = starts[spread].tolist()
        # first some that are far from one another
        return [start for offset in range(_BATCH) for start in chosen[offset::_BATCH]]

    def compare(self, paths: Sequence[CameraPath]) -> list[Run]:
        """The paths of runs beside those of the reference; empty without one, or if it does not agree."""
        del paths
        return []


class _ByImu(_Reference):
    """Compares the paths of runs with an IMU.

    Args:
        recording: Recording with the images.
        camera: The camera.
        imu: All samples of the IMU on its body.
    """

    def __init__(self, recording: Recording, camera: CameraCalibration, imu: Block[Imu]) -> None:
        super().__init__(recording, camera)
        self.topic = imu.topic
        self._imu, self._calibrated_s = imu, camera.timeshift_cam_imu_s
        T_body_imu = recording.rig.imu(camera.imu_topic).mount.T_body_sensor
        self._T_imu_camera = np.linalg.inv(T_body_imu) @ camera.mount.T_body_sensor
        self._reach_ns = round((float(SHIFTS_S[-1]) + abs(self._calibrated_s)) * 1e9)

    def choose_windows(self, size: int) -> list[int]:
        """Numbers of the first images of windows of `size` images, alternately with the most motion and rotation."""
        motions, turns, starts = list[float](), list[float](), list[int]()
        step = max(size, len(self._times) // _MOST_CANDIDATES)
        for start in range(0, len(self._times) - size + 1, step):
            inertial = self._find_inertial_path(int(self._times[start]), int(self._times[start + size - 1]))
            if inertial is not None:
                starts.append(start)
                motions.append(measure_motion_m(inertial))
                turns.append(float(np.linalg.norm(inertial.rotation_rad, axis=1).max()))
        by_motion, by_turn = (np.argsort(values)[::-1].tolist() for values in (motions, turns))
        order = dict.fromkeys(i for both in zip(by_motion, by_turn) for i in both)
        return [starts[i] for i in order]

    def compare(self, paths: Sequence[CameraPath]) -> list[Run]:
        """The runs at the shift of the clock at which they agree best; empty if that is the first or last one tried."""
        inertials = [self._find_inertial_path(int(path.t_ns[0]), int(path.t_ns[-1])) for path in paths]
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

    def _find_inertial_path(self, first_ns: int, last_ns: int) -> InertialPath | None:
        """The IMU's path between two times by the camera's clock, and as far beyond as both clocks may differ.

        None where the IMU does not cover that, or has a gap.
        """
        return integrate_path(self._imu, first_ns - self._reach_ns, last_ns + self._reach_ns)


class _ByPoses(_Reference):
    """Compares the paths of runs with given poses.

    Args:
        recording: Recording with the images.
        camera: The camera.
        poses: Poses of the camera.
    """

    def __init__(self, recording: Recording, camera: CameraCalibration, poses: Block[Sample]) -> None:
        super().__init__(recording, camera)
        self.topic = poses.topic
        p, q = poses.columns["p_frame_in_world"], poses.columns["q_world_frame"]
        is_sound = np.isfinite(p).all(axis=1) & (np.abs(np.linalg.norm(q, axis=1) - 1.0) < _UNIT_TOLERANCE)
        self._t_ns = poses.t_ns[is_sound]
        self._T = np.tile(np.eye(4), (len(self._t_ns), 1, 1))
        self._T[:, :3, :3], self._T[:, :3, 3] = from_quaternion(q[is_sound]), p[is_sound]

    def choose_windows(self, size: int) -> list[int]:
        """Numbers of the first images of windows of `size` images, those with the longest way first."""
        starts = list(range(0, len(self._times) - size + 1, size))
        if not len(self._t_ns) or not starts:
            return []
        first = [self._nearest(int(self._times[start])) for start in starts]
        last = [self._nearest(int(self._times[start + size - 1])) for start in starts]
        way = np.linalg.norm(self._T[last, :3, 3] - self._T[first, :3, 3], axis=1)
        return [starts[i] for i in np.argsort(way)[::-1].tolist()]

    def compare(self, paths: Sequence[CameraPath]) -> list[Run]:
        """The runs of whose images each has a pose."""
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


def _measure_focal_by_planes(recording: Recording, camera: CameraCalibration) -> LogRatio | None:
    """Calibrated focal length over that with which floor and walls are perpendicular; None without enough of them."""
    views = [find_planes(depth, camera) for depth in _read_some_depths(recording, camera)]
    ratio = measure_focal_ratio(views)
    return None if ratio is None else LogRatio(value=math.log(ratio.ratio), half=ratio.half_log)


def _read_some_depths(recording: Recording, camera: CameraCalibration) -> list[Array]:
    """Some depth images (H, W), m, spread over a recording; those of another size than the calibrated one are left out.

    Raises:
        StrideTwinError: An image is damaged.
    """
    images = recording.images(camera.depth_topic, choose_views(len(recording.image_times(camera.depth_topic))))
    depths = [np.asarray(image.depth, float) for image in images if isinstance(image, Depth)]
    return [depth for depth in depths if depth.shape == (camera.height, camera.width)]
