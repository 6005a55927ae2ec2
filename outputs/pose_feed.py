"""Estimators of terrain and modes fed with the poses of an odometry: on a whole recording, or sample by sample."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators import registry
from stridetwin.estimators.base import CAMERA_POSES, PATH, POSES, AnyEstimator, EstimatedPose, Options, Progress
from stridetwin.outputs.aligned_walk import AlignedWalk
from stridetwin.outputs.base import AnyKind, Collector, Output
from stridetwin.outputs.feeding import EstimatorClass, Instance, rig_of
from stridetwin.outputs.path.run import pose_of
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Odometry, Sample
from stridetwin.streams.trajectory import Pose, Trajectory

_PROGRESS_NS = 200_000_000  # time of the recording between two reports of the progress


def default_odometry() -> EstimatorClass:
    """The odometry whose poses estimators of terrain and modes use.

    Raises:
        StrideTwinError: None is installed.
    """
    odometry = next(
        (
            estimator_class
            for estimator_class in registry.estimators(PATH).values()
            if estimator_class.declaration.supplies_poses
        ),
        None,
    )
    if odometry is None:
        raise StrideTwinError("no installed estimator gives poses of a camera that could lead terrain map and modes")
    return odometry


def pose_sample(
    t_ns: int,
    p_frame_in_world: Array,
    q_world_frame: Array,
    topic: str = POSES,
    *,
    status: str = "",
    covariance: Array | None = None,
) -> Odometry:
    """A pose as a sample, an `EstimatedPose` if its status or covariance is known; its velocities are unknown (NaN).

    Args:
        t_ns: Time.
        p_frame_in_world: (3,) m.
        q_world_frame: (4,) quaternion, w first.
        topic: `POSES` or `CAMERA_POSES`.
        status: What holds the pose; "" if unknown.
        covariance: (6, 6), see `EstimatedPose`; None if unknown.
    """
    unknown = np.full(3, np.nan)
    if not status and covariance is None:
        return Odometry(
            topic=topic,
            t_ns=t_ns,
            p_frame_in_world=p_frame_in_world,
            q_world_frame=q_world_frame,
            v_frame_in_world=unknown,
            angular_rate=unknown,
        )
    return EstimatedPose(
        topic=topic,
        t_ns=t_ns,
        p_frame_in_world=p_frame_in_world,
        q_world_frame=q_world_frame,
        v_frame_in_world=unknown,
        angular_rate=unknown,
        status=status,
        covariance=covariance,
    )


def merge_poses(
    poses: Trajectory,
    recording: Recording,
    topics: Sequence[str],
    camera: Trajectory | None = None,
    statuses: NDArray[np.str_] | None = None,
) -> Iterator[Sample]:
    """Poses and samples of a recording in time order; each pose comes before the sample of the same instant.

    Args:
        poses: The poses, which become samples of the topic `POSES`.
        recording: Holds the samples.
        topics: Topics of the recording that are read.
        camera: Poses of the camera in the odometry's frame, which become samples of the topic `CAMERA_POSES`; None
            without any. See `PathEstimate.camera`.
        statuses: (N,) what holds each of the poses; None if unknown.
    """
    streams = [] if camera is None else [_pose_samples(camera, CAMERA_POSES)]
    # at equal stamps the samples come in the order of these arguments
    return heapq.merge(*streams, _pose_samples(poses, POSES, statuses), recording.samples(topics), key=lambda s: s.t_ns)


def _pose_samples(path: Trajectory, topic: str, statuses: NDArray[np.str_] | None = None) -> Iterator[Sample]:
    """The poses of a path as samples of a topic, in time order, with their (N,) statuses."""
    covariances = repeat(None) if path.covariance is None else path.covariance
    words = repeat("") if statuses is None else statuses.tolist()
    poses = zip(path.t_ns.tolist(), path.p_frame_in_world, path.q_world_frame, words, covariances)
    for t_ns, p, q, status, covariance in poses:
        yield pose_sample(t_ns, p, q, topic, status=status, covariance=covariance)


@dataclass(frozen=True, kw_only=True, eq=False)
class _RunningEstimator:
    """An estimator that runs in `replay`, with its collector.

    Attributes:
        kind: Of its outputs.
        estimator: At work.
        collector: Of its outputs.
        topics: The topics that it takes; empty for the inner estimator of another, which feeds it.
    """

    kind: AnyKind
    estimator: AnyEstimator
    collector: Collector[object]
    topics: tuple[str, ...]


def replay(
    instances: Iterable[tuple[AnyKind, Instance]],
    recording: Recording,
    poses: Trajectory,
    camera: Trajectory | None = None,
    walk: AlignedWalk | None = None,
    progress: Progress | None = None,
    *,
    statuses: NDArray[np.str_] | None = None,
) -> list[tuple[AnyKind, list[Output[object]]]]:
    """Runs estimators that take poses on a recording, all in one pass over its images.

    An estimator that runs another one itself (`inner_estimators`) gives that one's output, too; so where a predictor of
    modes contains a terrain map, the map is not built twice, unless the map's instance has parameters of its own.

    Args:
        instances: The estimators, each with its kind; `Options.poses_of` is the frame of the poses.
        recording: With depth and its calibration.
        poses: In the odometry's world.
        camera: See `PathEstimate.camera`.
        walk: The same poses beside the truth, for scores; None without a truth.
        progress: Receives the stage and its progress (0-1).
        statuses: (N,) what holds each of the poses; None if unknown.

    Returns:
        Kind and outputs of each instance, in the given order.

    Raises:
        StrideTwinError: The rig lacks a sensor or calibration.
    """
    numbered = list(instances)
    running: dict[int, _RunningEstimator] = {}  # by the number of the instance
    inner: dict[type, AnyEstimator] = {}  # by class, the estimators that others run themselves
    # from the last instance to the first: an outer estimator, such as a predictor of modes, comes after the inner one
    # that it runs, such as a map, in the order of the kinds, and must be built first
    for i, (kind, instance) in reversed(list(enumerate(numbered))):
        # an estimator that an outer one already runs, unless this instance has parameters of its own
        shared = inner.get(instance.estimator_class) if instance.parameters is None else None
        estimator = shared or instance.build(rig_of(recording))
        inner |= {type(e): e for e in getattr(estimator, "inner_estimators", ())}
        # its outer estimator feeds a shared one, so that it takes no topic by itself
        topics = () if shared else (POSES, CAMERA_POSES, *(s.topic for s in instance.streams))
        collector = kind.collector(estimator, instance, walk)
        running[i] = _RunningEstimator(kind=kind, estimator=estimator, collector=collector, topics=topics)
    outermost_first = list(running.values())
    topics_of_all = dict.fromkeys(t for r in outermost_first for t in r.topics if t in recording.topics)
    reported_ns = -1  # time of the recording at the last report of the progress
    for sample in merge_poses(poses, recording, list(topics_of_all), camera, statuses):
        for r in outermost_first:
            if not r.topics:  # an inner estimator: its outer one, earlier in the list, has just fed it
                r.collector.add(sample, None)
            elif sample.topic in r.topics:
                r.collector.add(sample, r.estimator.update(sample))
        if progress is not None and sample.t_ns - reported_ns > _PROGRESS_NS:
            reported_ns = sample.t_ns
            progress("terrain ahead", _progress_share(poses, sample.t_ns))
    return [(running[i].kind, running[i].collector.outputs()) for i in range(len(numbered))]


def _progress_share(poses: Trajectory, t_ns: int) -> float:
    """Share of the poses' time that has passed at a time, 0-1."""
    first_ns, last_ns = int(poses.t_ns[0]), int(poses.t_ns[-1])
    return min(1.0, max(0.0, (t_ns - first_ns) / max(1, last_ns - first_ns)))


class PoseFeed:
    """Turns what an odometry returned into the samples that estimators of terrain and modes take."""

    def __init__(self) -> None:
        self._camera: Pose | None = None  # the camera's pose that was passed on last

    def samples(self, estimate: object) -> Iterator[Odometry]:
        """The samples in an estimate of the odometry: the camera's pose if it is new, and the pose if it is valid."""
        pose, camera = pose_of(estimate), getattr(estimate, "camera_pose", None)
        if camera is not None and camera is not self._camera:  # another object than the last one passed on
            self._camera = camera
            yield pose_sample(camera.t_ns, camera.p_frame_in_world, camera.q_world_frame, CAMERA_POSES)
        if pose is not None and pose.valid:
            status = str(getattr(estimate, "health", ""))
            yield pose_sample(
                pose.t_ns, pose.p_frame_in_world, pose.q_world_frame, status=status, covariance=pose.covariance
            )


class OdometryDriven:
    """An estimator of terrain or modes on live samples, with the poses of the default odometry.

    Args:
        rig: Calibration.
        estimator_class: Its class.
        options: Of the estimator; the odometry gets its own defaults.

    Attributes:
        odometry: Name of the odometry.
        estimator: The running estimator.
        takes: The kind of sample that odometry and estimator take, by topic.

    Raises:
        StrideTwinError: The rig lacks a sensor; the message names it.
    """

    def __init__(self, rig: Rig, estimator_class: EstimatorClass, options: Options | None = None) -> None:
        options, odometry_class = options or Options(), default_odometry()
        # `poses_of` is for the estimator alone: the frame of the odometry's poses, that of its IMU
        odometry_options = replace(options, method=odometry_class.declaration.methods[0], poses_of="")
        streams = [s for s in odometry_class.streams(rig, odometry_options) if s.live]
        frame = next(s.topic for s in streams if s.role == "imu").removeprefix("/")  # such as `head/imu`
        options = replace(options, poses_of=frame)
        self._feed = PoseFeed()
        self.odometry = odometry_class.declaration.name
        self._odometry = odometry_class(rig, options=odometry_options)
        self.estimator: AnyEstimator = estimator_class(rig, options=options)
        # types of the samples that each of the two takes, by topic
        self._odometry_takes = {s.topic: s.kind for s in streams}
        self._estimator_takes = {s.topic: s.kind for s in estimator_class.streams(rig, options) if s.topic != POSES}
        self.takes = self._odometry_takes | self._estimator_takes

    def feeds_odometry(self, sample: Sample) -> bool:
        """Whether the odometry takes a sample."""
        return sample.topic in self._odometry_takes

    def update_odometry(self, sample: Sample) -> Pose | None:
        """Passes a sample to the odometry and its new pose to the estimator.

        Call it before `update` with the same sample.

        Returns:
            The odometry's pose; None without a new one.
        """
        estimate = self._odometry.update(sample) if self.feeds_odometry(sample) else None
        for pose in self._feed.samples(estimate):
            self.estimator.update(pose)
        return pose_of(estimate)

    def feeds_estimator(self, sample: Sample) -> bool:
        """Whether the estimator takes a sample."""
        return sample.topic in self._estimator_takes

    def update(self, sample: Sample) -> object:
        """Passes a sample to the estimator if it takes it.

        Returns:
            The estimate; None without a new one.
        """
        return self.estimator.update(sample) if self.feeds_estimator(sample) else None
