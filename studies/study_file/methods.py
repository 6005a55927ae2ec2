"""The methods that a study compares: estimators with a method and parameters, and their scores on a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from stridetwin.estimators import registry
from stridetwin.estimators.base import Options
from stridetwin.outputs.aligned_walk import AlignedWalk, align_walk, odometry_of
from stridetwin.outputs.base import Scores
from stridetwin.outputs.feeding import rig_of, runnable_instances, runnable_on, with_metadata
from stridetwin.outputs.parameters import change_parameters
from stridetwin.outputs.path.run import run_paths
from stridetwin.outputs.pose_feed import default_odometry, replay
from stridetwin.outputs.registry import kind_of
from stridetwin.streams.errors import FieldLocation, StrideTwinError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.validation import suggest


@dataclass(frozen=True, kw_only=True)
class Method:
    """One of the methods that a study compares.

    Attributes:
        name: In the study.
        estimator: Name of the installed estimator.
        method: One of its methods.
        parameters: The `parameters` that its constructor gets; None leaves its own.
    """

    name: str
    estimator: str
    method: str
    parameters: object = None


def make_method(name: str, estimator: str, method: str, parameters: Mapping[str, object], at: FieldLocation) -> Method:
    """A method from what a file says.

    Args:
        name: Name of the method in the study.
        estimator: Name of an installed estimator.
        method: One of its methods; "" for the first one.
        parameters: Values in place of the estimator's own; empty leaves them all.
        at: Position in the file, for errors.

    Raises:
        ConfigError: No such estimator, method or parameter, or an invalid value; the message has the valid ones.
    """
    if estimator not in registry.names():
        raise at.key("estimator").error(estimator, suggest(estimator, registry.names()))
    estimator_class = registry.estimator(estimator)
    methods = estimator_class.declaration.methods
    if method and method not in methods:
        raise at.key("method").error(method, suggest(method, methods))
    chosen = method or methods[0]
    values = change_parameters(estimator_class, chosen, parameters, at.key("parameters")) if parameters else None
    return Method(name=name, estimator=estimator, method=chosen, parameters=values)


def run_method(method: Method, recording: Recording, make_walk: Callable[[], AlignedWalk | None]) -> dict[str, Scores]:
    """Scores of a method on a recording with truth, by output, such as the left and the right foot.

    Args:
        method: The method.
        recording: With what it needs.
        make_walk: Gives the walk with the poses of the default odometry (`align_odometry`), or None without valid
            poses; it is only called for estimators that take poses.

    Raises:
        StrideTwinError: The recording does not feed the estimator or lacks the truth, or an estimate is invalid.
    """
    estimator_class = registry.estimator(method.estimator)
    declaration = estimator_class.declaration
    kind = kind_of(declaration)
    options = with_metadata(estimator_class, Options(method=method.method), recording)
    # the estimator may run several times on a recording, such as once per foot
    instances = [
        replace(instance, parameters=method.parameters)
        for instance in runnable_on(estimator_class, options, rig_of(recording), recording.topics)
    ]
    if not instances:
        raise StrideTwinError(f"cannot run: expected a walk with {declaration.needs or 'other sensors'}")
    if not kind.has_truth(recording):
        raise StrideTwinError(f"cannot be scored: expected a walk with the truth of the kind {declaration.kind!r}")
    # the odometry's poses, only for estimators that take them
    walk = make_walk() if kind.takes_poses else None
    if kind.takes_poses and walk is None:
        raise StrideTwinError(f"cannot run: no poses of {default_odometry().declaration.name}")
    outputs = []
    for instance in instances:
        if walk is None:
            outputs += kind.run(instance, recording)
        else:
            fed_instance = kind, instance.with_poses_of(walk.frame)
            # `replay` gives kind and outputs of each instance; here there is one
            _, instance_outputs = replay(
                [fed_instance], recording, walk.poses, walk.camera, walk, statuses=walk.statuses
            )[0]
            outputs += instance_outputs
    return {evaluation.name: dict(evaluation.scores) for evaluation in kind.evaluate(outputs, recording)}


def align_odometry(recording: Recording) -> AlignedWalk | None:
    """The walk with the poses of the default odometry, beside the truth; None without depth, truth or valid poses."""
    instances = runnable_instances(default_odometry(), recording)
    paths = [output.estimates for instance in instances for output in run_paths(instance, recording)]
    odometry = odometry_of(recording, paths)
    return None if odometry is None else align_walk(recording, odometry)
