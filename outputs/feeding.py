"""Runs estimators: selects those that a recording can feed, runs one on a recording, or one live behind an odometry.

The odometry's poses feed the terrain map and, through it, the prediction of modes. Everything specific to an
estimator is in its declaration (`estimators.base`).
"""

from __future__ import annotations

import heapq
from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import repeat
from typing import Any

import numpy as np

from stridetwin.estimators import registry
from stridetwin.estimators.base import (
    CAMERA_POSES,
    FEET,
    POSES,
    Estimator,
    Options,
    PathEstimate,
    Progress,
    Stream,
    deprecated,
)
from stridetwin.estimators.contact_terrain import StepEstimate
from stridetwin.estimators.locomotion_mode import ModeEstimate
from stridetwin.estimators.terrain_map.depth_camera import depth_calibration
from stridetwin.outputs.terrain.files import given_poses, pose_sample
from stridetwin.streams.errors import ConfigError, RecordingError, StrideTwinError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Odometry, Sample
from stridetwin.streams.trajectory import Pose, Trajectory, trajectory_of

Found = type[Estimator]


def with_metadata(found: Found, options: Options | None, recording: Recording) -> Options:
    """The options with the metadata of a recording; by default those of the estimator's first method."""
    options = options or Options(method=found.declaration.methods[0])
    return replace(options, metadata=recording.metadata, source=str(recording.path))


def fed(found: Found, recording: Recording) -> list[Options]:
    """Options of each estimator instance that a recording can feed: one per foot or one of a camera; else at most one.

    Raises:
        ConfigError: The recording's metadata for the estimator is invalid.
    """
    rig = recording.rig if recording.has_rig else Rig()
    return [options for options, _ in feeding(found, with_metadata(found, None, recording), rig, recording.topics)]


def feeding(
    found: Found, defaults: Options, rig: Rig, topics: Container[str]
) -> list[tuple[Options, tuple[Stream, ...]]]:
    """Options and streams of each estimator instance that some topics can feed, see `fed`.

    Raises:
        ConfigError: The metadata in the options is invalid.
    """
    declaration, variants = found.declaration, [defaults]
    if declaration.per_foot:
        variants = [replace(defaults, foot=foot) for foot in FEET]
    elif declaration.mounts:
        variants = [replace(defaults, mount=mount) for mount in declaration.mounts]
    instances = []
    for options in variants:
        try:
            streams = found.streams(rig, options)
        except ConfigError:
            raise
        except StrideTwinError:
            continue
        if not missing(streams, topics):
            instances.append((options, streams))
    return instances[:1] if declaration.mounts else instances


def missing(streams: Iterable[Stream], there: Container[str]) -> list[str]:
    """The topics of each required role that are all missing, joined by "or"; poses come from elsewhere."""
    roles: dict[str, list[str]] = {}
    for stream in streams:
        if stream.required and stream.topic != POSES:
            roles.setdefault(stream.role, []).append(stream.topic)
    return [" or ".join(topics) for topics in roles.values() if not any(topic in there for topic in topics)]


def paths(
    found: Found, recording: Recording, options: Options | None = None, progress: Progress | None = None
) -> list[PathEstimate]:
    """The paths that an estimator of kind `path` gives for a recording.

    Raises:
        StrideTwinError: A topic or calibration is missing, or the estimator gives no pose.
    """
    options = with_metadata(found, options, recording)
    if (follow := getattr(found, "follow", None)) is not None:
        estimates: list[PathEstimate] = follow(recording, options, progress)
        return estimates
    estimator, samples = _started(found, recording, options)
    by_frame: dict[str, list[Pose]] = {}
    for sample in samples:
        if (pose := pose_of(estimator.update(sample), found.__name__)) is not None:
            by_frame.setdefault(pose.frame, []).append(pose)
    declaration, made = found.declaration, []
    if not by_frame:
        raise RecordingError(f"{recording.path}: {declaration.name} gives no pose")
    for frame, poses in by_frame.items():
        part = declaration.parts.get(frame, options.foot if declaration.per_foot else "")
        valid = np.array([pose.valid for pose in poses], bool)
        ready_ns = poses[int(valid.argmax())].t_ns
        made.append(
            PathEstimate(
                name=f"{declaration.name}_{part}" if part else declaration.name, frame=frame, path=trajectory_of(poses),
                ready_ns=ready_ns, healthy=valid, world=declaration.name if declaration.parts else "",
                label=declaration.name if declaration.label is None else declaration.label, leads=declaration.leads,
            )
        )  # fmt: skip
    return made


def all_paths(
    recording: Recording, leads: bool | None = None, only: Container[str] | None = None
) -> list[PathEstimate]:
    """All paths that can be estimated from the recording.

    Args:
        recording: The recording.
        leads: Selects estimators by whether they feed others.
        only: Names of the estimators to run; None runs all.
    """
    return [
        estimate
        for name, found in registry.estimators("path").items()
        if leads in (None, found.declaration.leads) and (only is None or name in only)
        for options in fed(found, recording)
        for estimate in paths(found, recording, options)
    ]


def pose_of(estimate: Any, source: str = "estimator") -> Pose | None:
    """The pose in the return value of an estimator of kind `path`; None without a pose.

    Raises:
        StrideTwinError: It is neither a `Pose` nor has one.
    """
    if estimate is None or isinstance(estimate, Pose):
        return estimate
    if hasattr(estimate, "pose"):
        pose: Pose | None = estimate.pose
        return pose
    if not hasattr(estimate, "p_frame_in_world"):
        kind = type(estimate).__name__
        raise StrideTwinError(f"{source}.update: invalid {kind}: expected stridetwin.streams.trajectory.Pose")
    deprecated("an estimate with p_frame_in_world and q_world_frame", "stridetwin.streams.trajectory.Pose")
    p, q = np.asarray(estimate.p_frame_in_world, float), np.asarray(estimate.q_world_frame, float)
    return Pose(t_ns=int(estimate.t_ns), p_frame_in_world=p, rotation=q)


def steps(found: Found, recording: Recording, options: Options | None = None) -> list[StepEstimate]:
    """The last estimate of each step, in order, by an estimator of kind `steps`; step 0 is omitted.

    Raises:
        StrideTwinError: A topic or the geometry is missing.
    """
    estimator, samples = _started(found, recording, with_metadata(found, options, recording))
    last: dict[int, StepEstimate] = {}
    for sample in samples:
        estimate = estimator.update(sample)
        if estimate is not None and estimate.step > 0:
            last[estimate.step] = estimate
    return [last[step] for step in sorted(last)]


def _started(found: Found, recording: Recording, options: Options) -> tuple[Estimator, Iterator[Sample]]:
    """An estimator and its samples from a recording."""
    rig = recording.rig if recording.has_rig else Rig()
    streams = found.streams(rig, options)
    check_topics(found, streams, recording)
    topics = [s.topic for s in streams if s.live and s.topic in recording.topics]
    return found(rig, options=options), iter(recording.samples(topics))


def check_topics(found: Found, streams: Sequence[Stream], recording: Recording) -> None:
    """Raises RecordingError if a recording lacks a stream that an estimator requires."""
    if lacking := missing(streams, recording.topics):
        raise RecordingError(f"{recording.path}: no topic {', '.join(lacking)}: {found.declaration.name} needs it")


def posed(
    found: Found, recording: Recording, options: Options | None = None, path: Trajectory | None = None,
    camera_poses: Trajectory | None = None,
) -> tuple[Estimator, Iterator[Sample]]:  # fmt: skip
    """An estimator of kind `map` or `modes`, and the poses and samples from a recording that it takes.

    Args:
        found: Its class.
        recording: With depth and its calibration.
        options: See `Options`; `poses_of` is that of the poses.
        path: Poses of the frame `options.poses_of`; None uses those in the recording.
        camera_poses: `PathEstimate.camera` of an odometry that gave them.

    Returns:
        The estimator, and samples in time order; each pose comes before the image of the same instant.

    Raises:
        StrideTwinError: A topic or calibration is missing, or there are no poses of the camera or its body.
    """
    options, camera = with_metadata(found, options, recording), depth_calibration(recording.rig)
    streams = found.streams(recording.rig, options)
    check_topics(found, streams, recording)
    topics = [s.topic for s in streams if s.topic in recording.topics]
    if path is not None:
        return found(recording.rig, options=options), merged(path, recording, topics, camera_poses)
    topic, frame = given_poses(recording, camera)
    options = replace(options, poses_of=frame)
    return found(recording.rig, options=options), iter(recording.samples([topic, *topics]))


def mapped(
    found: Found, recording: Recording, options: Options | None = None, path: Trajectory | None = None,
    camera_poses: Trajectory | None = None,
) -> Any:  # fmt: skip
    """An estimator of kind `map` after a whole recording; see `posed`."""
    estimator, samples = posed(found, recording, options, path, camera_poses)
    for sample in samples:
        estimator.update(sample)
    return estimator


def predicted(
    found: Found, recording: Recording, options: Options | None = None, path: Trajectory | None = None,
    camera_poses: Trajectory | None = None,
) -> list[ModeEstimate]:  # fmt: skip
    """All predictions of an estimator of kind `modes` on a recording; see `posed`."""
    estimator, samples = posed(found, recording, options, path, camera_poses)
    return [estimate for sample in samples if (estimate := estimator.update(sample)) is not None]


def merged(
    path: Trajectory, recording: Recording, topics: Sequence[str], camera: Trajectory | None = None
) -> Iterator[Sample]:
    """Poses and samples of a recording in time order; each pose comes before the sample of the same instant.

    Args:
        path: The poses.
        recording: Holds the samples.
        topics: Its streams.
        camera: `PathEstimate.camera`.
    """
    posed = [_pose_samples(camera, CAMERA_POSES)] if camera is not None else []
    return heapq.merge(*posed, _pose_samples(path, POSES), recording.samples(topics), key=lambda s: s.t_ns)


def _pose_samples(path: Trajectory, topic: str) -> Iterator[Sample]:
    return map(pose_sample, path.t_ns.tolist(), path.p_frame_in_world, path.q_world_frame, repeat(topic))


def leader() -> Found:
    """The odometry whose poses feed the estimators of the ground ahead.

    Raises:
        StrideTwinError: None is installed.
    """
    for found in registry.estimators("path").values():
        if found.declaration.leads:
            return found
    raise StrideTwinError("no installed estimator gives poses of a camera that could lead terrain map and modes")


class Leading:
    """The poses of an odometry as the samples that estimators of maps and modes take."""

    def __init__(self) -> None:
        self._camera: Pose | None = None

    def samples(self, estimate: Any) -> Iterator[Odometry]:
        """The camera's pose, if it is estimated and new, then the pose, if it is valid."""
        pose, camera = pose_of(estimate), getattr(estimate, "camera_pose", None)
        if camera is not None and camera is not self._camera:
            self._camera = camera
            yield pose_sample(camera.t_ns, camera.p_frame_in_world, camera.q_world_frame, CAMERA_POSES)
        if pose is not None and pose.valid:
            yield pose_sample(pose.t_ns, pose.p_frame_in_world, pose.q_world_frame)


class Led:
    """An estimator of kind `map` or `modes` on live samples, with the poses of an odometry.

    Args:
        rig: Calibration.
        found: Its class.
        options: Of the estimator; the odometry gets its own defaults.

    Attributes:
        odometry: Name of the odometry.
        estimator: The running estimator.
        takes: The kind of sample that odometry and estimator take, by topic.

    Raises:
        StrideTwinError: The rig lacks a sensor; the message names it.
    """

    def __init__(self, rig: Rig, found: Found, options: Options | None = None) -> None:
        options, first = options or Options(), leader()
        own = replace(options, method=first.declaration.methods[0], poses_of="")
        streams = [s for s in first.streams(rig, own) if s.live]
        frame = next(s.topic for s in streams if s.role == "imu").removeprefix("/")
        options = replace(options, poses_of=frame)
        self._leading = Leading()
        self.odometry, self._odometry = first.declaration.name, first(rig, options=own)
        self.estimator: Any = found(rig, options=options)
        self._poses_from = {s.topic: s.kind for s in streams}
        self._own = {s.topic: s.kind for s in found.streams(rig, options) if s.topic != POSES}
        self.takes = self._poses_from | self._own

    def feeds_odometry(self, sample: Sample) -> bool:
        """Whether the odometry takes a sample."""
        return sample.topic in self._poses_from

    def lead(self, sample: Sample) -> Pose | None:
        """Passes the sample to the odometry and its pose to the estimator; call it before `update`."""
        estimate = self._odometry.update(sample) if self.feeds_odometry(sample) else None
        for given in self._leading.samples(estimate):
            self.estimator.update(given)
        return pose_of(estimate)

    def feeds_estimator(self, sample: Sample) -> bool:
        """Whether the estimator takes a sample."""
        return sample.topic in self._own

    def update(self, sample: Sample) -> Any:
        """Passes the sample to the estimator; returns its estimate, None without a new one."""
        return self.estimator.update(sample) if self.feeds_estimator(sample) else None
