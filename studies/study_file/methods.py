"""The methods that a study compares: estimators with a method and parameters, and their scores on a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, get_args, get_type_hints

from stridetwin.estimators import registry
from stridetwin.estimators.base import Options
from stridetwin.outputs.aligned_walk import AlignedWalk, align_walk, odometry_of
from stridetwin.outputs.base import Scores
from stridetwin.outputs.feeding import EstimatorClass, rig_of, runnable_instances, runnable_on, with_metadata
from stridetwin.outputs.path.run import run_paths
from stridetwin.outputs.pose_feed import default_odometry, replay
from stridetwin.outputs.registry import kind_of
from stridetwin.streams.errors import ConfigError, FieldLocation, StrideTwinError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.validation import suggest, validate


@dataclass(frozen=True, kw_only=True)
class Method:
    """One of the methods that a study compares.

    Attributes:
        name: In the study.
        estimator: Name of the installed estimator.
        method: One of its methods.
        parameters: Of its constructor; None leaves its own.
    """

    name: str
    estimator: str
    method: str
    parameters: object = None


def make_method(name: str, estimator: str, method: str, parameters: Mapping[str, object], at: FieldLocation) -> Method:
    """A method from what a file says; `at` is its position there, `method` may be "" for the estimator's first one.

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
    values = _set_parameters(estimator_class, chosen, parameters, at.key("parameters")) if parameters else None
    return Method(name=name, estimator=estimator, method=chosen, parameters=values)


def _set_parameters(
    estimator_class: EstimatorClass, method: str, values: Mapping[str, object], at: FieldLocation
) -> object:
    """The parameters that the estimator has with this method, with some values replaced."""
    hint = get_type_hints(estimator_class.__init__).get("parameters")
    kinds = [kind for kind in (hint, *get_args(hint)) if isinstance(kind, type) and _fields(kind)]
    if not kinds:
        name = estimator_class.declaration.name
        raise at.error(dict(values), f"no parameters, as the constructor of {name} declares no class of them")
    default = getattr(estimator_class, "default_parameters", None)
    group = kinds[0]() if default is None else default(method)
    for name, value in values.items():
        group = _replace_value(group, name.split("."), value, at.key(name))
    return group


def _fields(group: Any) -> list[str]:
    """Names of the fields of a dataclass or a named tuple, or of an object of it; none of anything else."""
    return [f.name for f in fields(group)] if is_dataclass(group) else list(getattr(group, "_fields", ()))


def _replace_value(group: Any, keys: list[str], value: Any, at: FieldLocation) -> Any:
    """A copy of a group of parameters with one value replaced; the keys lead to it through inner groups.

    Raises:
        ConfigError: No such parameter, or an invalid value.
    """
    name, *below = keys
    if name not in _fields(group):
        raise at.error(name, suggest(name, _fields(group)) or "no key below a value")
    try:
        if below:
            new = _replace_value(getattr(group, name), below, value, at)
        else:
            new = validate(get_type_hints(type(group))[name], value, at.source, at=at.path)
        return group._replace(**{name: new}) if hasattr(group, "_replace") else replace(group, **{name: new})
    except ConfigError as error:
        raise at.error(error.value, error.valid) from error
    except (StrideTwinError, ValueError, TypeError, RuntimeError) as error:
        raise at.error(value, f"what {type(group).__name__} accepts ({error})") from error


def run_method(method: Method, recording: Recording, make_walk: Callable[[], AlignedWalk | None]) -> dict[str, Scores]:
    """Scores of a method on a recording with truth, by output, such as the left and the right foot.

    Args:
        method: The method.
        recording: With what it needs.
        make_walk: Gives the poses of the default odometry, for estimators that take poses, see `align_odometry`.

    Raises:
        StrideTwinError: The recording does not feed the estimator, lacks the truth, or the estimator gives no output.
    """
    estimator_class = registry.estimator(method.estimator)
    declaration = estimator_class.declaration
    kind = kind_of(declaration)
    options = with_metadata(estimator_class, Options(method=method.method), recording)
    instances = [
        replace(instance, parameters=method.parameters)
        for instance in runnable_on(estimator_class, options, rig_of(recording), recording.topics)
    ]
    if not instances:
        raise StrideTwinError(f"cannot run: expected a walk with {declaration.needs or 'other sensors'}")
    if not kind.has_truth(recording):
        raise StrideTwinError(f"cannot be scored: expected a walk with the truth of the kind {declaration.kind!r}")
    walk = make_walk() if kind.takes_poses else None
    if kind.takes_poses and walk is None:
        raise StrideTwinError(f"cannot run: no poses of {default_odometry().declaration.name}")
    outputs = []
    for instance in instances:
        if walk is None:
            outputs += kind.run(instance, recording)
        else:
            posed = kind, instance.with_poses_of(walk.frame)
            outputs += replay([posed], recording, walk.poses, walk.camera, walk)[0][1]
    return {evaluation.name: dict(evaluation.scores) for evaluation in kind.evaluate(outputs, recording)}


def align_odometry(recording: Recording) -> AlignedWalk | None:
    """The walk with the poses of the default odometry, beside the truth; None without depth, truth or valid poses."""
    instances = runnable_instances(default_odometry(), recording)
    paths = [output.estimates for instance in instances for output in run_paths(instance, recording)]
    odometry = odometry_of(recording, paths)
    return None if odometry is None else align_walk(recording, odometry)
