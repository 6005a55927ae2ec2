"""Whether the class is an estimator at all: declaration, streams, constructor, estimates and their stamps."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import entry_points

from stridetwin.estimators.base import MODES, PATH, POSES, STEPS, TERRAIN, Declaration, Options, Stream
from stridetwin.estimators.contact_terrain import StepEstimate
from stridetwin.estimators.locomotion_mode import ModeEstimate
from stridetwin.estimators.registry import OUTPUT_GROUP
from stridetwin.estimators.terrain_map import TerrainEstimate
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import Rig
from stridetwin.testing.subject import ConformanceError, Subject, describe, pose_of
from stridetwin.testing.walk import missing_roles

_ESTIMATES: dict[str, type] = {STEPS: StepEstimate, TERRAIN: TerrainEstimate, MODES: ModeEstimate}
"""Type of the estimates by kind; those of paths are checked by `pose_of`."""
_MAP_METHODS = ("heights", "profile", "ground", "surface_points")
"""Methods that an estimator of terrain has besides `update`, as `TerrainMap` does."""


def check_declaration(subject: Subject) -> None:
    """Name, kind and methods are valid, and the declared streams are those of the walk."""
    estimator_class: object = subject.estimator_class
    declaration = getattr(estimator_class, "declaration", None)
    if not isinstance(declaration, Declaration):
        raise ConformanceError(
            f"declaration is {type(declaration).__name__}: add the class attribute "
            "`declaration = Declaration(name=..., kind=...)` of stridetwin.estimators.base"
        )
    if not re.fullmatch(r"[A-Za-z_]\w*", declaration.name):
        raise ConformanceError(
            f"declaration.name: invalid {declaration.name!r}: expected letters, digits and _, because files are named "
            "after it"
        )
    kinds = sorted({point.name for point in entry_points(group=OUTPUT_GROUP)})
    if declaration.kind not in kinds:
        raise ConformanceError(f"declaration.kind: invalid {declaration.kind!r}: expected one of {', '.join(kinds)}")
    if not declaration.methods:
        raise ConformanceError("declaration.methods is empty: expected at least one name, the default first")
    for method in ("streams", "update"):
        if not callable(getattr(estimator_class, method, None)):
            raise ConformanceError(f"{method} is missing: add the method that stridetwin.estimators.base describes")
    _check_streams(subject)


def check_missing_sensors(subject: Subject) -> None:
    """Without its sensors in the rig, the constructor raises a StrideTwinError that names what is missing."""
    walk, rig = subject.walk, subject.walk.rig
    sensor_names = _sensor_names_of(walk.streams)
    message = _rejection_message(subject, Rig(), Options(method=walk.options.method, foot=walk.options.foot))
    if message is None:
        raise ConformanceError(
            "the constructor accepts a rig without any sensor: raise a StrideTwinError that names the missing sensor, "
            "such as `rig.imu(topic)` does"
        )
    if not any(word in message.lower() for word in sensor_names):
        raise ConformanceError(f"for an empty rig the error is {message!r}: name the missing sensor in it")
    topics_by_role: dict[str, set[str]] = {}
    for stream in walk.streams:
        topics_by_role.setdefault(stream.role, set()).add(stream.topic)
    # an estimator may accept a rig without the sensors of one role, but raise nothing but a StrideTwinError
    for topics in topics_by_role.values():
        _rejection_message(subject, _without_topics(rig, topics), walk.options)


def check_estimates(subject: Subject) -> None:
    """On the walk, `update` returns estimates of the declared kind and raises no exception."""
    estimates = [returned.estimate for returned in subject.reference]
    kind = subject.estimator_class.declaration.kind
    if not estimates:
        raise ConformanceError("update returned None after every sample of the walk: return an estimate when it is new")
    if kind == PATH:  # valid: a pose, an object whose `pose` is one, or whose `pose` is None because nothing is new
        wrong = next((e for e in estimates if pose_of(e) is None and getattr(e, "pose", e) is not None), None)
        expected = "a stridetwin.streams.trajectory.Pose, or an object whose `pose` is one"
    elif kind in _ESTIMATES:
        wrong = next((e for e in estimates if not isinstance(e, _ESTIMATES[kind])), None)
        expected = f"a {_ESTIMATES[kind].__module__}.{_ESTIMATES[kind].__name__}"
    else:  # a kind of another package, whose estimates only it knows
        return
    if wrong is not None:
        raise ConformanceError(f"update returned {type(wrong).__name__}: for kind {kind!r}, return {expected}")
    if kind == TERRAIN:
        lacking = [name for name in _MAP_METHODS if not callable(getattr(subject.estimator_class, name, None))]
        if lacking:
            raise ConformanceError(
                f"no method {', '.join(lacking)}: an estimator of kind {kind!r} has those of TerrainMap"
            )


def check_stamps(subject: Subject) -> None:
    """The time of an estimate is the stamp, in ns, of a sample so far; the stamps of a path increase."""
    samples = subject.walk.samples
    stamps: set[int] = set()  # of the samples so far
    fed = 0  # number of the samples so far
    newest: dict[str, int] = {}  # stamp of the last pose, by its frame
    for returned in subject.reference:
        stamps.update(sample.t_ns for sample in samples[fed : returned.index + 1])
        fed = returned.index + 1
        pose = pose_of(returned.estimate)
        for source in (returned.estimate, pose):
            t_ns = getattr(source, "t_ns", None)
            if t_ns is not None and t_ns not in stamps:
                raise ConformanceError(
                    f"an estimate after the sample at {returned.t_ns} ns has t_ns = {t_ns!r}: set it to the stamp of "
                    "the newest sample that the estimate contains, in integer nanoseconds"
                )
        if pose is not None:
            if pose.t_ns <= newest.get(pose.frame, -1):
                raise ConformanceError(
                    f"two poses of {pose.frame or 'the path'} have the stamp {pose.t_ns} ns, or it went back: return "
                    "None where nothing is new"
                )
            newest[pose.frame] = pose.t_ns


def _check_streams(subject: Subject) -> None:
    """The declared streams are well-formed, without the truth, and the walk has the required ones.

    Raises:
        ConformanceError: They are not; the message says what to correct.
    """
    try:
        walk = subject.walk
        streams = subject.estimator_class.streams(walk.rig, walk.options)
    except StrideTwinError as error:
        raise ConformanceError(
            f"the walk cannot feed the estimator: {error}; correct `streams`, or check on a recording that has them"
        ) from error
    except Exception as error:
        raise ConformanceError(f"streams raised {describe(error)}") from error
    if not streams:
        raise ConformanceError("streams is empty: return a Stream for each topic that update takes")
    for stream in streams:
        if not isinstance(stream, Stream):
            raise ConformanceError(f"streams has a {type(stream).__name__}: expected stridetwin.estimators.base.Stream")
        if not stream.role or not stream.topic.startswith("/"):
            raise ConformanceError(f"invalid {stream}: expected a role, and a topic that begins with /")
        if stream.topic.startswith("/truth/"):
            raise ConformanceError(f"streams names {stream.topic}: an estimator never gets the truth")
        info = walk.recording.topics.get(stream.topic)
        if info is not None and not issubclass(info.kind, stream.kind):
            raise ConformanceError(
                f"streams names {stream.topic} as {stream.kind.__name__}: its samples are {info.kind.__name__}"
            )
    if lacking := missing_roles(streams, walk.recording.topics):
        raise ConformanceError(f"no topic {', '.join(lacking)} in the walk: correct the topics of `streams`")


def _rejection_message(subject: Subject, rig: Rig, options: Options) -> str | None:
    """Message of the constructor's StrideTwinError for a rig; None if it accepts the rig.

    `streams` is called first; it may refuse the rig, too, but only with a StrideTwinError.

    Raises:
        ConformanceError: One of the two raised another exception.
    """
    estimator_class = subject.estimator_class
    calls: dict[str, Callable[[], object]] = {
        "streams": lambda: estimator_class.streams(rig, options),
        "the constructor": lambda: estimator_class(rig, options=options),
    }
    message: str | None = None  # at the end that of the constructor, the last call
    for name, call in calls.items():
        try:
            call()
            message = None
        except StrideTwinError as error:
            message = str(error)
        except Exception as error:
            raise ConformanceError(
                f"for a rig without its sensors {name} raised {describe(error)}: raise a StrideTwinError that names "
                "the missing sensor"
            ) from error
    return message


def _sensor_names_of(streams: tuple[Stream, ...]) -> set[str]:
    """Words of which a message about missing sensors has to contain one: parts of topics, roles and kinds."""
    texts = [text for s in streams if s.topic != POSES for text in (s.topic, s.role, s.kind.__name__)]
    # words of at least three letters, so that the `l` of `foot_l` is none
    return {word for text in texts for word in re.split(r"[/_\W]+", text.lower()) if len(word) > 2}


def _without_topics(rig: Rig, topics: set[str]) -> Rig:
    """The rig without the sensors of some topics."""
    return replace(
        rig,
        imus={t: imu for t, imu in rig.imus.items() if t not in topics},
        cameras={t: c for t, c in rig.cameras.items() if t not in topics and c.depth_topic not in topics},
        others={t: sensor for t, sensor in rig.others.items() if t not in topics},
    )
