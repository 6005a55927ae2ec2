"""The walk that the checks run on: five seconds of the twin on level ground, or synthetic samples without MuJoCo."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from stridetwin.estimators.base import POSES, AnyEstimator, Options, Stream
from stridetwin.scenarios.record import nominal_sensors, record, twin_class
from stridetwin.sim.config import Gait, Level, Route, TwinConfig
from stridetwin.sim.parts.library import load_part
from stridetwin.sim.parts.sensor_config import STANDARD, SensorConfig
from stridetwin.streams.errors import StrideTwinError, install_hint
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Rig
from stridetwin.streams.samples import Footprint, Odometry, Sample
from stridetwin.streams.trajectory import Trajectory

_NAME, _SEED = "conformance", 1  # of the twin's walk
_LENGTH_M, _STAND_S = 2.0, 1.0  # way, and time of standing at its start and end
_SMALL_SENSORS = ("foot_imu", "sonar", "insole", "ahrs", "exo_imu", "encoder", "interaction", "actuator", "head_imu")
_CAMERAS = ((), ("head_camera",), ("foot_camera",), ("head_camera", "foot_camera"))
"""Cameras of the walk; the first set with most of the estimator's streams is rendered: images take most of the time."""
_CAMERA_RATES_HZ = {"head_camera": 10.0, "foot_camera": 5.0}
_IMAGE_SCALE = 0.5
"""Scale of the cameras' widths and heights in pixels; the field of view stays."""
_SYNTHETIC_EYES_M, _SYNTHETIC_POSE_HZ = 1.6, 100  # height and rate of the poses without MuJoCo


@dataclass(frozen=True, kw_only=True, eq=False)
class Walk:
    """A recording for one estimator, with what the checks compare it with.

    Attributes:
        recording: The recording.
        options: Options of the estimator, with the recording's metadata.
        streams: Its streams that the recording has, poses included.
        pose_topic: Truth that takes the place of the odometry's poses; "" for an estimator that takes none.
        is_twin: Whether it is the suite's own walk, on level ground from rest to rest.
    """

    recording: Recording
    options: Options
    streams: tuple[Stream, ...]
    pose_topic: str = ""
    is_twin: bool = False

    @property
    def rig(self) -> Rig:
        """Calibration of the recording; empty without one."""
        return rig_of(self.recording)

    @property
    def samples(self) -> tuple[Sample, ...]:
        """Samples of the streams that `update` takes, in time order, poses included; it must get copies of them."""
        topics = [s.topic for s in self.streams if s.live and s.topic != POSES]
        return _read_samples(self.recording.path, self.pose_topic, tuple(dict.fromkeys(topics)))

    @cached_property
    def footprints(self) -> int:
        """Number of true footprints; 0 if unknown."""
        topics = [topic for topic, info in self.recording.topics.items() if info.kind is Footprint]
        return sum(self.recording.topics[topic].count for topic in topics)

    def truth_of(self, frame: str) -> Trajectory | None:
        """True path of a frame, such as `foot_l/imu`; None if unknown."""
        topic = _truth_topic(frame)
        if not frame or topic not in self.recording.topics:
            return None
        block = self.recording.block(topic)
        return Trajectory(
            t_ns=block.t_ns,
            p_frame_in_world=block.columns["p_frame_in_world"],
            q_world_frame=block.columns["q_world_frame"],
        )


def find_walk(estimator_class: type[AnyEstimator], options: Options | None, recording: Path | None) -> Walk:
    """The walk for an estimator: a recording if one is given, else the twin's, else synthetic samples.

    Args:
        estimator_class: Its class.
        options: Its options; None takes the defaults with the first of its methods.
        recording: File of a recording to use in place of the twin's walk.

    Raises:
        StrideTwinError: No walk has the streams that the estimator requires; the message names what is missing.
    """
    options = options or Options(method=estimator_class.declaration.methods[0])
    if recording is not None:
        return _select_streams(estimator_class, options, Recording(recording))
    if find_spec("mujoco") is None:
        return _synthetic_walk(estimator_class, options)
    problem: Exception | None = None
    mounts = estimator_class.declaration.mounts or ("head",)
    mount = options.mount or mounts[0]
    counts: list[int] = []  # per set of cameras, how many of the estimator's live streams the walk then has
    for cameras in _CAMERAS:
        rig, metadata = _nominal_rig(cameras, mount)
        # an estimator may raise anything for a rig without its sensors; a check of its own reports that
        try:
            streams = estimator_class.streams(rig, replace(options, metadata=metadata, source=_NAME))
            _require_topics(streams, rig.topics)
            counts.append(len(rig.topics.intersection(stream.topic for stream in streams if stream.live)))
        except Exception as error:
            problem = error
            counts.append(0)
    if max(counts):  # the first set of cameras with most streams
        path = _record_twin(_CAMERAS[counts.index(max(counts))], mount)
        return replace(_select_streams(estimator_class, options, Recording(path)), is_twin=True)
    raise StrideTwinError(f"the walk lacks what the estimator needs: {_describe(problem)}") from problem


def missing_roles(streams: Iterable[Stream], topics: Iterable[str]) -> list[str]:
    """The roles that no available topic fills, each as the text of its topics joined by "or".

    One available topic is enough for a role. The topic of poses (`POSES`) is never missing: every walk has poses.

    Args:
        streams: Streams of an estimator; only those that are required count.
        topics: Available topics.
    """
    available = set(topics)
    topics_by_role: dict[str, list[str]] = {}
    for stream in streams:
        if stream.required and stream.topic != POSES:
            topics_by_role.setdefault(stream.role, []).append(stream.topic)
    return [" or ".join(role_topics) for role_topics in topics_by_role.values() if available.isdisjoint(role_topics)]


def rig_of(recording: Recording) -> Rig:
    """Calibration of a recording; empty without one."""
    return recording.rig if recording.has_rig else Rig()


def _select_streams(estimator_class: type[AnyEstimator], options: Options, recording: Recording) -> Walk:
    """The walk of a recording; of several possible mounts the first that it has.

    Args:
        estimator_class: The estimator.
        options: Its options; metadata and source are set here.
        recording: The recording.

    Raises:
        StrideTwinError: The recording lacks a stream that the estimator requires.
    """
    options = replace(options, metadata=recording.metadata, source=str(recording.path))
    mounts = estimator_class.declaration.mounts
    candidates = [replace(options, mount=mount) for mount in mounts] if mounts and not options.mount else [options]
    problem: StrideTwinError | None = None
    for candidate in candidates:
        try:
            streams = estimator_class.streams(rig_of(recording), candidate)
            _require_topics(streams, recording.topics)
        except StrideTwinError as error:
            problem = error
            continue
        pose_topic = ""  # where the estimator takes no poses
        if any(stream.topic == POSES for stream in streams):
            pose_topic, frame = _find_poses(recording, streams)
            candidate = replace(candidate, poses_of=frame)
        used = tuple(s for s in streams if s.topic == POSES or s.topic in recording.topics)
        return Walk(recording=recording, options=candidate, streams=used, pose_topic=pose_topic)
    raise StrideTwinError(f"{recording.path}: {problem}") from problem


def _require_topics(streams: Sequence[Stream], topics: Iterable[str]) -> None:
    """Raises StrideTwinError where a required role has none of its topics."""
    if lacking := missing_roles(streams, topics):
        raise StrideTwinError(f"no topic {', '.join(lacking)}")


def _describe(problem: Exception | None) -> str:
    """An exception in words."""
    return str(problem) if isinstance(problem, StrideTwinError) else repr(problem)


def _find_poses(recording: Recording, streams: Sequence[Stream]) -> tuple[str, str]:
    """Finds the true poses that take the place of an odometry's: of the depth camera or another sensor on its body.

    Args:
        recording: The recording.
        streams: Streams of the estimator, among them that of a depth camera.

    Returns:
        Topic of the poses, and the frame that they are of, such as `head/imu`.

    Raises:
        StrideTwinError: There are no such poses.
    """
    topics = {stream.topic for stream in streams}
    rig = rig_of(recording)
    bodies = {camera.mount.body for camera in rig.cameras.values() if camera.depth_topic in topics}
    sensors: list[CameraCalibration | ImuCalibration] = [*rig.cameras.values(), *rig.imus.values()]
    for sensor in sensors:
        frame = sensor.topic.removeprefix("/")
        if sensor.mount.body in bodies and _truth_topic(frame) in recording.topics:
            return _truth_topic(frame), frame
    raise StrideTwinError("no true poses of the depth camera's body, which take the place of an odometry's")


@lru_cache(maxsize=1)
def _read_samples(path: Path, pose_topic: str, topics: tuple[str, ...]) -> tuple[Sample, ...]:
    """Samples in time order; poses as an odometry gives them, without velocities, before the images of that instant.

    Args:
        path: The recording.
        pose_topic: Truth that takes the place of an odometry's poses, under the topic `POSES`; "" for none.
        topics: Topics of the samples.
    """
    wanted = [pose_topic, *topics] if pose_topic else list(topics)
    unknown = np.full(3, np.nan)
    return tuple(
        replace(sample, topic=POSES, v_frame_in_world=unknown, angular_rate=unknown)
        if isinstance(sample, Odometry) and sample.topic == pose_topic
        else sample
        for sample in Recording(path).samples(wanted)
    )


def _truth_topic(frame: str) -> str:
    """Topic of the true poses of a frame."""
    return f"/truth/{frame}/odometry"


@lru_cache(maxsize=1)
def _session_folder() -> Path:
    """A folder for recordings that is removed at the end of the process."""
    folder = tempfile.mkdtemp(prefix="stridetwin-conformance-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def _config(cameras: tuple[str, ...], mount: str) -> TwinConfig:
    """Configuration of the twin's walk on level ground, with some groups of cameras.

    Args:
        cameras: The groups, such as `head_camera`, whose images are fewer and smaller than those of the standard rig.
        mount: Where the RGB-D camera is: `head` or `chest`.
    """
    return TwinConfig(
        name=_NAME,
        route=Route(segments=(Level(length_m=_LENGTH_M),)),
        gait=Gait(stand_s=_STAND_S),
        sensors=(*_SMALL_SENSORS, *cameras),
        fittings={camera: _small_camera(camera) for camera in cameras},
        rig_mount=mount,
    )


def _small_camera(group: str) -> SensorConfig:
    """The standard camera of a group with fewer and smaller images."""
    standard: Any = load_part(STANDARD[group])
    imager = standard.imager
    small = {name: _IMAGE_SCALE * getattr(imager, name) for name in ("width", "height", "focal")}
    return SensorConfig(part=replace(standard, imager=replace(imager, **small)), rate_hz=_CAMERA_RATES_HZ[group])


@lru_cache(maxsize=8)
def _nominal_rig(cameras: tuple[str, ...], mount: str) -> tuple[Rig, Mapping[str, str]]:
    """Calibration and metadata of the twin's walk, without planning or recording it."""
    return nominal_sensors(_config(cameras, mount), _SEED)


def _record_twin(cameras: tuple[str, ...], mount: str) -> Path:
    """File of the twin's walk; recorded once per process."""
    path = _session_folder() / f"{'_'.join([mount, *cameras])}.mcap"
    if not path.exists():
        record(twin_class()(_config(cameras, mount), _SEED), path)
    return path


def _synthetic_walk(estimator_class: type[AnyEstimator], options: Options) -> Walk:
    """Six seconds of a person who stands, for a computer without MuJoCo.

    Raises:
        StrideTwinError: The synthetic samples lack a sensor that the estimator requires.
    """
    from stridetwin.run.warm_up import synthetic_rig, write_synthetic_recording

    rig = synthetic_rig()
    with _explain_missing_twin():
        streams = estimator_class.streams(rig, options)
    takes = {s.topic: s.kind for s in streams if s.topic != POSES and s.live}  # type of the samples by topic
    # a file of its own for each estimator, as they take other topics
    path = _session_folder() / f"synthetic_{len(list(_session_folder().iterdir()))}.mcap"
    poses = chain.from_iterable(_poses_at_rest(_truth_topic(topic.removeprefix("/"))) for topic in rig.imus)
    recording = write_synthetic_recording(path, takes, more=poses)
    with _explain_missing_twin():
        return _select_streams(estimator_class, options, recording)


@contextmanager
def _explain_missing_twin() -> Iterator[None]:
    """Context manager: adds to an error inside it that the simulator, which is not installed, has more sensors."""
    try:
        yield
    except StrideTwinError as error:
        raise StrideTwinError(f"{error}; without MuJoCo there are few sensors: {install_hint('twin')}") from error


def _poses_at_rest(topic: str) -> Iterator[Sample]:
    """Six seconds of poses, on a topic, of a sensor that stands at the height of the eyes."""
    for i in range(6 * _SYNTHETIC_POSE_HZ + 1):
        yield Odometry(
            topic=topic,
            t_ns=i * 10**9 // _SYNTHETIC_POSE_HZ,
            v_frame_in_world=np.zeros(3),
            angular_rate=np.zeros(3),
            p_frame_in_world=np.array([0.0, 0.0, _SYNTHETIC_EYES_M]),
            q_world_frame=np.array([1.0, 0.0, 0.0, 0.0]),
        )
