"""Runs estimators of paths on a recording."""

from __future__ import annotations

from collections.abc import Container
from inspect import signature
from types import MappingProxyType

import numpy as np

from stridetwin.estimators import registry
from stridetwin.estimators.base import PATH, PathEstimate, Progress
from stridetwin.outputs.base import Collector, Output
from stridetwin.outputs.feeding import Instance, runnable_instances, start
from stridetwin.outputs.parameters import ParameterValues, with_parameters
from stridetwin.streams.errors import StrideTwinError, check_type
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Sample
from stridetwin.streams.trajectory import Pose, trajectory_of


def pose_of(estimate: object, source: str = "estimator") -> Pose | None:
    """The pose in what the `update` of an estimator of paths returned; None without a pose.

    Args:
        estimate: A `Pose`, an object whose `pose` is one, or None.
        source: Name of the estimator, for the error.

    Raises:
        StrideTwinError: It is neither a `Pose` nor has one.
    """
    pose = estimate
    if estimate is not None and not isinstance(estimate, Pose):
        pose = getattr(estimate, "pose", estimate)  # without such an attribute the check below fails
    if pose is None or isinstance(pose, Pose):
        return pose
    expected = "stridetwin.streams.trajectory.Pose"
    raise StrideTwinError(f"{source}.update: invalid {type(estimate).__name__}: expected {expected}")


class PathCollector(Collector[PathEstimate]):
    """Collects the poses of an estimator, one path per frame.

    Args:
        instance: The estimator's class and options.
        source: Recording, for errors.
    """

    def __init__(self, instance: Instance, source: str) -> None:
        self._instance, self._source = instance, source
        self._poses: dict[str, list[Pose]] = {}  # by frame, in time order

    def add(self, sample: Sample, estimate: object) -> None:
        """Keeps the pose of an estimate, if it has one."""
        if (pose := pose_of(estimate, self._instance.estimator_class.__name__)) is not None:
            self._poses.setdefault(pose.frame, []).append(pose)

    def outputs(self) -> list[Output[PathEstimate]]:
        """The path of each frame, ready from the first valid pose on.

        Raises:
            StrideTwinError: There is no pose.
        """
        declaration, options = self._instance.declaration, self._instance.options
        if not self._poses:
            raise StrideTwinError(f"{self._source}: {declaration.name} gives no pose")
        outputs = []
        for frame, poses in self._poses.items():
            # the suffix of the name: the frame's part, else the foot of an estimator of one foot
            part = declaration.parts.get(frame, options.foot if declaration.per_foot else "")
            # the path is ready from its first valid pose on, or from its first one if none is valid
            valid = np.array([pose.valid for pose in poses], bool)
            path = PathEstimate(
                name=f"{declaration.name}_{part}" if part else declaration.name,
                frame=frame,
                path=trajectory_of(poses),
                ready_ns=poses[int(valid.argmax())].t_ns,
                healthy=valid,
                # all parts of one estimator share a world
                world=declaration.name if declaration.parts else "",
                label=declaration.name if declaration.label is None else declaration.label,
                supplies_poses=declaration.supplies_poses,
            )
            outputs.append(path_output(path, instance=self._instance))
        return outputs


def path_output(path: PathEstimate, instance: Instance) -> Output[PathEstimate]:
    """A path as an output of an instance."""
    return Output(name=path.name, estimates=path, part=instance.declaration.parts.get(path.frame, ""))


def run_paths(instance: Instance, recording: Recording, progress: Progress | None = None) -> list[Output[PathEstimate]]:
    """Runs one estimator of paths on a whole recording.

    The estimator's `follow` is used where it has one and takes what the instance has, because it is faster; otherwise
    samples are fed one by one.

    Args:
        instance: The estimator with its options.
        recording: The recording.
        progress: Receives the stage and its progress (0-1), from `follow` alone.

    Raises:
        StrideTwinError: A topic or calibration is missing, or the estimator gives no pose.
    """
    # values in place of the estimator's own need a `follow` that has the argument `parameters`
    follow = getattr(instance.estimator_class, "follow", None)
    takes_parameters = follow is not None and "parameters" in signature(follow).parameters
    if follow is not None and (instance.parameters is None or takes_parameters):
        more = {} if instance.parameters is None else {"parameters": instance.parameters}
        paths: list[PathEstimate] = follow(recording, instance.options, progress, **more)
        return [path_output(path, instance) for path in paths]
    estimator, samples = start(instance, recording)
    collector = PathCollector(instance, str(recording.path))
    for sample in samples:
        collector.add(sample, estimator.update(sample))
    return collector.outputs()


def all_paths(
    recording: Recording,
    *,
    supplies_poses: bool | None = None,
    only: Container[str] | None = None,
    parameters: ParameterValues = MappingProxyType({}),
) -> list[PathEstimate]:
    """All paths that can be estimated from a recording, in the order of the estimators.

    Args:
        recording: The recording.
        supplies_poses: Selects estimators by `Declaration.supplies_poses`; None takes all.
        only: Names of the estimators to run; None runs all.
        parameters: Values in place of the estimators' own.

    Raises:
        StrideTwinError: An estimator fails, or a value is invalid.
    """
    check_type("all_paths", "recording", recording, Recording, "a Recording, such as open_any(PATH)")
    selected = [
        estimator_class
        for name, estimator_class in registry.estimators(PATH).items()
        if supplies_poses in (None, estimator_class.declaration.supplies_poses) and (only is None or name in only)
    ]
    paths = []
    for estimator_class in selected:
        for instance in runnable_instances(estimator_class, recording):
            outputs = run_paths(with_parameters(instance, parameters), recording)
            paths += [output.estimates for output in outputs]
    return paths
