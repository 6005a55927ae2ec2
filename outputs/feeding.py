"""Which estimators a recording or a rig can feed, and how one is started on a recording.

Everything specific to an estimator is in its declaration (`estimators.base`).
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator
from dataclasses import dataclass, replace

from stridetwin.estimators.base import FOOT_NAMES, POSES, AnyEstimator, Declaration, Options, Stream
from stridetwin.streams.errors import ConfigError, RecordingError, StrideTwinError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Sample

EstimatorClass = type[AnyEstimator]


@dataclass(frozen=True, kw_only=True, eq=False)
class Instance:
    """An estimator's class with the options for one instance, such as one foot.

    Attributes:
        estimator_class: Its class.
        options: Of the instance, with the recording's metadata.
        streams: The streams that it takes.
        parameters: Of the constructor, in place of the estimator's own; None leaves these.
    """

    estimator_class: EstimatorClass
    options: Options
    streams: tuple[Stream, ...]
    parameters: object = None

    @property
    def declaration(self) -> Declaration:
        """The declaration of the class."""
        return self.estimator_class.declaration

    def build(self, rig: Rig) -> AnyEstimator:
        """Builds the estimator.

        Raises:
            StrideTwinError: The rig lacks a sensor or its calibration.
        """
        if self.parameters is None:
            return self.estimator_class(rig, options=self.options)
        return self.estimator_class(rig, options=self.options, parameters=self.parameters)

    def with_poses_of(self, frame: str) -> Instance:
        """This instance for poses of a frame (`Options.poses_of`), such as `head/imu`."""
        return replace(self, options=replace(self.options, poses_of=frame))


def with_metadata(estimator_class: EstimatorClass, options: Options | None, recording: Recording) -> Options:
    """The options completed by the metadata of a recording; None stands for those of the estimator's first method."""
    options = options or Options(method=estimator_class.declaration.methods[0])
    return replace(options, metadata=recording.metadata, source=str(recording.path))


def rig_of(recording: Recording) -> Rig:
    """The rig of a recording; an empty one if it has none."""
    return recording.rig if recording.has_rig else Rig()


def instance_for(estimator_class: EstimatorClass, recording: Recording, options: Options | None = None) -> Instance:
    """The instance that the user's options select on a recording, whether that can feed it or not (`check_topics`).

    Raises:
        StrideTwinError: Rig or metadata do not say which streams it takes.
    """
    options = with_metadata(estimator_class, options, recording)
    streams = estimator_class.streams(rig_of(recording), options)
    return Instance(estimator_class=estimator_class, options=options, streams=streams)


def runnable_instances(estimator_class: EstimatorClass, recording: Recording) -> list[Instance]:
    """The instances that a recording can feed: one per foot or one of a camera; else at most one.

    Raises:
        ConfigError: The recording's metadata for the estimator is invalid.
    """
    defaults = with_metadata(estimator_class, None, recording)
    return runnable_on(estimator_class, defaults, rig_of(recording), recording.topics)


def runnable_on(estimator_class: EstimatorClass, defaults: Options, rig: Rig, topics: Container[str]) -> list[Instance]:
    """The instances of an estimator that some topics of a rig can feed.

    There is one per foot for an estimator of one foot; else at most one, with the first of its mounts that the topics
    feed.

    Args:
        estimator_class: The estimator.
        defaults: Options of all instances, with the metadata.
        rig: Calibration of the sensors.
        topics: Available topics.

    Raises:
        ConfigError: The metadata in the options is invalid.
    """
    declaration, variants = estimator_class.declaration, [defaults]
    if declaration.per_foot:
        variants = [replace(defaults, foot=foot) for foot in FOOT_NAMES]
    elif declaration.mounts:
        variants = [replace(defaults, mount=mount) for mount in declaration.mounts]
    instances = []
    for options in variants:  # one per foot or mount
        try:
            streams = estimator_class.streams(rig, options)
        except ConfigError:  # invalid metadata is the user's error, and not a lack of a sensor
            raise
        except StrideTwinError:  # the rig lacks what this foot or mount needs
            continue
        if not missing_topics(streams, topics):
            instances.append(Instance(estimator_class=estimator_class, options=options, streams=streams))
    return instances[:1] if declaration.mounts else instances  # the mounts are alternatives


def missing_topics(streams: Iterable[Stream], available_topics: Container[str]) -> list[str]:
    """The roles that no available topic fills, each as the text of its topics joined by "or".

    One available topic is enough for a role. The topic of poses (`POSES`) is never missing: poses come from elsewhere.

    Args:
        streams: Streams of an estimator; only those that are required count.
        available_topics: Topics that there are.
    """
    topics_by_role: dict[str, list[str]] = {}
    for stream in streams:
        if stream.required and stream.topic != POSES:
            topics_by_role.setdefault(stream.role, []).append(stream.topic)
    unfilled = [topics for topics in topics_by_role.values() if not any(t in available_topics for t in topics)]
    return [" or ".join(topics) for topics in unfilled]


def check_topics(instance: Instance, recording: Recording) -> None:
    """Raises RecordingError if a recording lacks a stream that an instance requires."""
    if missing := missing_topics(instance.streams, recording.topics):
        # advice to give another topic the missing name, for the first topic that has such advice
        hint = next(filter(None, map(recording.map_hint, missing)), "")
        name = instance.declaration.name
        contents = recording.describe_topics()
        raise RecordingError(f"{recording.path}: no topic {', '.join(missing)}: {name} needs it; {contents}{hint}")


def start(instance: Instance, recording: Recording) -> tuple[AnyEstimator, Iterator[Sample]]:
    """Builds an estimator for a recording.

    Returns:
        The estimator, and the samples of its live streams in time order, which its `update` takes.

    Raises:
        RecordingError: The recording lacks a required stream.
    """
    check_topics(instance, recording)
    # streams that are not live are for estimators that read a whole recording at once, by their method `follow`
    topics = [s.topic for s in instance.streams if s.live and s.topic in recording.topics]
    return instance.build(rig_of(recording)), iter(recording.samples(topics))
