"""The estimator under test: its class, its walk, and what it returns there."""

from __future__ import annotations

import traceback
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar, Protocol
from unittest import SkipTest

from stridetwin.estimators.base import PATH, AnyEstimator, Declaration, Options, Stream
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Depth, Image, Sample, copy_sample
from stridetwin.streams.trajectory import Pose
from stridetwin.testing.leaves import Leaf, difference, field_of, flatten
from stridetwin.testing.samples import find_changed_field, overwrite
from stridetwin.testing.walk import Walk, find_walk

_TESTING = Path(__file__).resolve().parent  # folder of this package, which has the checks


class ConformanceError(AssertionError):
    """A check failed; the message says what happened and what to change in the estimator."""


@dataclass(frozen=True, slots=True, eq=False)
class Returned:
    """An estimate that `update` returned.

    Attributes:
        index: Number of the sample that it followed, from 0.
        t_ns: Stamp of that sample.
        estimate: The returned object.
        leaves: Values of the object when it was returned.
    """

    index: int
    t_ns: int
    estimate: object
    leaves: list[Leaf]


@dataclass(frozen=True, eq=False)
class BufferRun:
    """Result of a run in which the arrays of each sample are overwritten after `update`.

    Attributes:
        returned: The estimates; their values were read after the sample was overwritten.
        changed: Topic and field of the first sample that `update` itself changed; "" if it changed none.
    """

    returned: list[Returned]
    changed: str


class PathUpdate(Protocol):
    """A class with `update` alone, as `score --estimator` takes."""

    def __init__(self, rig: Rig) -> None:
        """Takes the calibration."""

    def update(self, sample: Sample, /) -> object:
        """Takes one sample; returns a `Pose` or None."""


class Subject:
    """One estimator under test; what runs on its walk is kept, so that several checks share it.

    Args:
        estimator_class: An `Estimator`; or a class with `update` alone, as `score --estimator` takes.
        options: Its options; None for the defaults.
        recording: Recording to use in place of the twin's walk.

    Attributes:
        estimator_class: The class with the whole interface of an estimator.
    """

    def __init__(self, estimator_class: type, options: Options | None = None, recording: Path | None = None) -> None:
        self.estimator_class: type[AnyEstimator] = _with_interface(estimator_class)
        self._options, self._recording = options, recording

    @property
    def name(self) -> str:
        """Name of the class."""
        return self.estimator_class.__name__

    @cached_property
    def walk(self) -> Walk:
        """The walk of all checks.

        Raises:
            StrideTwinError: No walk has the streams that the estimator requires.
        """
        return find_walk(self.estimator_class, self._options, self._recording)

    @property
    def takes_images(self) -> bool:
        """Whether some of its samples are images."""
        return any(stream.kind in (Image, Depth) for stream in self.walk.streams)

    def create(self) -> AnyEstimator:
        """A new instance for the walk.

        Raises:
            ConformanceError: The constructor raised an exception.
        """
        try:
            return self.estimator_class(self.walk.rig, options=self.walk.options)
        except Exception as error:
            raise ConformanceError(f"the constructor raised {describe(error)}") from error

    @cached_property
    def reference(self) -> list[Returned]:
        """Estimates of one instance on the walk.

        Raises:
            ConformanceError: `update` raised an exception.
        """
        return feed(self.create(), self.walk.samples)

    @cached_property
    def fields_not_finite(self) -> frozenset[str]:
        """Paths of fields, without indices, that are not finite on the walk even without faults.

        The check of finite values reports them, so that the checks with faults leave them out.
        """
        leaves = (leaf for returned in self.reference for leaf in returned.leaves)
        return frozenset(field_of(leaf) for leaf in leaves if not leaf.is_finite)

    @cached_property
    def buffer_run(self) -> BufferRun:
        """Estimates of one instance while the caller reuses the buffers of the samples."""
        estimator = self.create()
        returned: list[Returned] = []
        changed = ""  # the first array that `update` itself has changed, in words
        for i, original in enumerate(self.walk.samples):
            sample = copy_sample(original)
            estimate = call_update(estimator, sample)
            if not changed and (field := find_changed_field(sample, original)):
                changed = f"{field} of the sample of {sample.topic} at {sample.t_ns * 1e-9:.3f} s"
            overwrite(sample)
            if estimate is not None:
                returned.append(Returned(i, sample.t_ns, estimate, flatten(estimate)))
        return BufferRun(returned, changed)


def feed(estimator: AnyEstimator, samples: Iterable[Sample]) -> list[Returned]:
    """All estimates for copies of some samples.

    Raises:
        ConformanceError: `update` raised an exception.
    """
    returned = list[Returned]()
    for i, sample in enumerate(map(copy_sample, samples)):
        if (estimate := call_update(estimator, sample)) is not None:
            returned.append(Returned(i, sample.t_ns, estimate, flatten(estimate)))
    return returned


def call_update(estimator: AnyEstimator, sample: Sample) -> object:
    """Calls `update` with a sample; returns its result.

    Raises:
        ConformanceError: It raised an exception.
    """
    try:
        return estimator.update(sample)
    except Exception as error:
        at = f"the sample of {sample.topic} stamped {sample.t_ns * 1e-9:.3f} s"
        raise ConformanceError(f"update raised {describe(error)}, on {at}") from error


def describe(error: BaseException) -> str:
    """An exception in one line: type, message, and where in the author's code it arose."""
    frames = traceback.extract_tb(error.__traceback__)
    # calls that are not of these checks; the innermost one is last
    outside = [f for f in frames if not Path(f.filename).resolve().is_relative_to(_TESTING)]
    place = ""
    if outside:
        innermost = outside[-1]
        place = f" ({Path(innermost.filename).name}:{innermost.lineno}, in {innermost.name})"
    return f"{type(error).__name__}: {' '.join(str(error).split())}{place}"


def require_equal(returned: list[Returned], expected: list[Returned], cause: str) -> None:
    """Compares estimates bit by bit.

    Args:
        returned: The estimates.
        expected: Those of the reference.
        cause: What to say before the first difference.

    Raises:
        ConformanceError: They differ in their number, in a value, or in the samples that they follow.
    """
    for one, other in zip(returned, expected):
        at = f"the estimate at {other.t_ns * 1e-9:.3f} s"
        if one.index != other.index:
            raise ConformanceError(f"{cause}: {at} follows sample {one.index} instead of {other.index}")
        if text := difference(one.leaves, other.leaves):
            raise ConformanceError(f"{cause}: of {at}, {text}")
    if len(returned) != len(expected):
        raise ConformanceError(f"{cause}: {len(returned)} estimates instead of {len(expected)}")


def pose_of(estimate: object) -> Pose | None:
    """The pose that an estimate is or has; None for estimates of another kind."""
    pose = estimate if isinstance(estimate, Pose) else getattr(estimate, "pose", None)
    return pose if isinstance(pose, Pose) else None


def skip(reason: str) -> SkipTest:
    """The exception of a check that does not apply; pytest reports it as a skipped test."""
    return SkipTest(reason)


def _with_interface(estimator_class: type) -> type[AnyEstimator]:
    """The class with the whole interface of an estimator, as the checks need it.

    A class with `declaration` or `streams` comes back as it is, and its faults are found by the checks. One with
    `update` alone is wrapped: it gets a declaration of kind path, and as streams the topics that its attribute
    `topics` names, or else all of the rig.
    """
    if hasattr(estimator_class, "declaration") or hasattr(estimator_class, "streams"):  # checked as it is
        return estimator_class
    inner_class: type[PathUpdate] = estimator_class

    class PathFromUpdate:
        """An estimator of a path that calls a class with `update` alone."""

        declaration: ClassVar[Declaration] = Declaration(name=inner_class.__name__, kind=PATH)

        def __init__(self, rig: Rig, *, options: Options | None = None, parameters: object = None) -> None:
            self._inner = inner_class(rig)

        @classmethod
        def streams(cls, rig: Rig, options: Options) -> tuple[Stream, ...]:
            """The topics that the class names, else all of the rig."""
            kinds = stream_kinds(rig)
            topics = getattr(inner_class, "topics", None) or list(kinds)
            return tuple(Stream(role=topic, topic=topic, kind=kinds.get(topic, Sample)) for topic in topics)

        def update(self, sample: Sample) -> object:
            """What the class returns; a pose without a frame gets the one that the class names in `frame`, if any."""
            estimate = self._inner.update(sample)
            frame = getattr(inner_class, "frame", "")
            if isinstance(estimate, Pose) and frame and not estimate.frame:
                return replace(estimate, frame=frame)
            return estimate

    PathFromUpdate.__name__ = inner_class.__name__
    return PathFromUpdate


def stream_kinds(rig: Rig) -> dict[str, type[Sample]]:
    """Type of the samples of each topic of a rig."""
    from stridetwin.streams.samples import Actuator, Ahrs, Encoder, Imu, Insole, Interaction, Range

    others: dict[str, type[Sample]] = {
        "range": Range,
        "insole": Insole,
        "ahrs": Ahrs,
        "encoder": Encoder,
        "interaction": Interaction,
        "actuator": Actuator,
    }
    kinds: dict[str, type[Sample]] = {topic: Imu for topic in rig.imus}
    kinds |= {topic: Image for topic in rig.cameras}
    kinds |= {camera.depth_topic: Depth for camera in rig.cameras.values() if camera.depth_topic}
    return kinds | {topic: others[sensor.kind] for topic, sensor in rig.others.items() if sensor.kind in others}
