"""Every estimator that a recording feeds, of every kind of output, beside the truth."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from stridetwin.batch.processes import open_pool
from stridetwin.estimators import registry as estimator_registry
from stridetwin.estimators.base import PATH, PathEstimate, Progress
from stridetwin.outputs.aligned_walk import align_walk, odometry_of
from stridetwin.outputs.base import AnyKind, KindEvaluations, Output
from stridetwin.outputs.feeding import Instance, runnable_instances
from stridetwin.outputs.parameters import ParameterValues, with_parameters
from stridetwin.outputs.path.run import all_paths
from stridetwin.outputs.pose_feed import replay
from stridetwin.outputs.registry import kinds
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Image

KindOutputs = tuple[AnyKind, list[Output[Any]]]
"""A kind, and its outputs of one recording before they are compared with the truth."""


@dataclass(frozen=True, kw_only=True)
class Selection:
    """Which estimators are run on a recording, and how.

    Attributes:
        only: Names of the estimators to run, see `scenarios.score_needs.estimators_of`; None runs all.
        backend: `Options.backend` of the estimators that have it; "" takes their first.
        frames: Frames whose paths are scored; None takes all.
        parameters: Values in place of the estimators' own, see `outputs.parameters`.
    """

    only: frozenset[str] | None = None
    backend: str = ""
    frames: frozenset[str] | None = None
    parameters: ParameterValues = field(default_factory=dict)

    def instances(self, kind: str, recording: Recording) -> list[Instance]:
        """The selected estimators of one kind of output that the recording feeds, each with its options."""
        selected = [
            estimator_class
            for name, estimator_class in estimator_registry.estimators(kind).items()
            if self.only is None or name in self.only
        ]
        runnable = [instance for chosen in selected for instance in runnable_instances(chosen, recording)]
        return [with_parameters(self._with_backend(instance), self.parameters) for instance in runnable]

    def _with_backend(self, instance: Instance) -> Instance:
        """The instance with the selected backend, or as it is if its estimator does not have that backend."""
        if self.backend not in instance.declaration.backends:
            return instance
        return replace(instance, options=replace(instance.options, backend=self.backend))


def evaluate_recording(
    recording: Recording,
    selection: Selection | None = None,
    *,
    alignment: str = "start",
    progress: Progress | None = None,
    in_two_processes: bool = False,
) -> Iterator[KindEvaluations]:
    """Runs every selected estimator that a recording feeds, and compares the outputs with the truth, kind by kind.

    Paths come first, because their odometry supplies the poses for terrain and modes, which are run in one pass over
    the images. A kind that takes no poses is left out if the recording lacks its truth (`OutputKind.has_truth`), and
    any kind without scores.

    Args:
        recording: The recording.
        selection: Which estimators are run; None runs all.
        alignment: Of paths with the truth, see `outputs.alignment.align`.
        progress: Receives the stage and its progress (0-1).
        in_two_processes: Estimates the paths of other estimators with cameras in a process of their own meanwhile.

    Raises:
        StrideTwinError: As the estimators, and as `OutputKind.evaluate`; the kinds before have been given.
    """
    for kind, outputs in run_recording(recording, selection, progress=progress, in_two_processes=in_two_processes):
        if evaluations := kind.evaluate(outputs, recording, alignment):
            yield KindEvaluations(kind=kind, evaluations=evaluations)


def run_recording(
    recording: Recording,
    selection: Selection | None = None,
    *,
    progress: Progress | None = None,
    in_two_processes: bool = False,
) -> Iterator[KindOutputs]:
    """Runs every selected estimator that a recording feeds, without comparing the outputs with the truth.

    Paths come first, because their odometry supplies the poses for terrain and modes, which are run in one pass over
    the images. A kind that takes no poses is left out if the recording lacks its truth (`OutputKind.has_truth`).

    Args:
        recording: The recording.
        selection: Which estimators are run; None runs all.
        progress: Receives the stage and its progress (0-1).
        in_two_processes: Estimates the paths of other estimators with cameras in a process of their own meanwhile.

    Yields:
        Each kind of output that has any, with its outputs.

    Raises:
        StrideTwinError: An estimator fails; earlier kinds have been given.
    """
    selection = selection or Selection()
    with ExitStack() as stack:
        # runs estimators of paths on the recording; further keywords of `all_paths` select some
        find_paths: Callable[..., list[PathEstimate]] = partial(
            all_paths, recording, only=selection.only, parameters=selection.parameters
        )
        driven: list[KindOutputs] | None = None  # of the kinds that take poses, if they have been run already
        if in_two_processes and recording.is_mcap and has_two_image_estimators(recording, selection.only):
            # the other process, which opens the MCAP file itself, estimates the paths of those that supply no poses;
            # this one odometry and what it drives
            pool = stack.enter_context(open_pool(1))
            future = pool.submit(_find_other_paths, recording.path, recording.lenient, selection)
            odometries = find_paths(supplies_poses=True)
            driven = _run_driven(recording, selection, odometries, progress)
            paths = future.result() + odometries
        else:
            paths = find_paths()
        for name, kind in kinds().items():
            if kind.takes_poses or not kind.has_truth(recording):  # those that take poses come last
                continue
            if name == PATH:
                frames = selection.frames
                outputs = [Output(name=p.name, estimates=p) for p in paths if frames is None or p.frame in frames]
            else:
                instances = selection.instances(name, recording)
                outputs = [output for instance in instances for output in kind.run(instance, recording)]
            if outputs:
                yield kind, outputs
        yield from _run_driven(recording, selection, paths, progress) if driven is None else driven


def _find_other_paths(path: Path, lenient: bool, selection: Selection) -> list[PathEstimate]:
    """Runs the estimators of paths that supply no poses, in a process that opens the recording itself."""
    recording = Recording(path, lenient)
    return all_paths(recording, supplies_poses=False, only=selection.only, parameters=selection.parameters)


def _run_driven(
    recording: Recording, selection: Selection, paths: Iterable[PathEstimate], progress: Progress | None
) -> list[KindOutputs]:
    """Runs the kinds that take poses, with those of the odometry among `paths`.

    Args:
        recording: The recording.
        selection: Which estimators are run.
        paths: Estimated paths, among them that of an odometry if one was run.
        progress: Receives the stage and its progress (0-1).

    Returns:
        Their outputs; empty if no odometry supplies poses, or no estimator of these kinds is selected.
    """
    takes_poses = [name for name, kind in kinds().items() if kind.takes_poses]
    names = {name for kind in takes_poses for name in estimator_registry.estimators(kind)}
    if selection.only is not None and not names & selection.only:
        return []
    odometry = odometry_of(recording, paths)
    return [] if odometry is None else run_driven(recording, odometry, selection, progress)


def run_driven(
    recording: Recording, odometry: PathEstimate, selection: Selection | None = None, progress: Progress | None = None
) -> list[KindOutputs]:
    """Runs every selected estimator that takes poses, with those of an odometry, in one pass over the images.

    Args:
        recording: The recording.
        odometry: The path of an odometry that supplies poses, as `odometry_of` gives it.
        selection: Which estimators are run; None runs all.
        progress: Receives the stage and its progress (0-1).

    Returns:
        Each kind with its outputs.
    """
    selection = selection or Selection()
    instances = []
    for name, kind in kinds().items():
        if kind.takes_poses:
            selected = selection.instances(name, recording)
            instances += [(kind, instance.with_poses_of(odometry.frame)) for instance in selected]
    walk = align_walk(recording, odometry)
    by_kind: dict[AnyKind, list[Output[Any]]] = {}
    for kind, outputs in replay(instances, recording, walk.poses, walk.camera, walk, progress, statuses=walk.statuses):
        by_kind.setdefault(kind, []).extend(outputs)
    return list(by_kind.items())


def has_two_image_estimators(recording: Recording, only: Container[str] | None = None) -> bool:
    """Whether the recording feeds images to the odometry and to another estimator of paths among those to run.

    Only then a second process saves time.

    Args:
        recording: The recording.
        only: Names of the estimators to run; None stands for all.
    """
    # whether the estimators with images supply poses: {True, False} if there is an odometry and another one
    supplies_poses = set[bool]()
    for name, estimator_class in estimator_registry.estimators(PATH).items():
        if only is not None and name not in only:
            continue
        for instance in runnable_instances(estimator_class, recording):
            if any(stream.kind is Image and stream.topic in recording.topics for stream in instance.streams):
                supplies_poses.add(estimator_class.declaration.supplies_poses)
    return len(supplies_poses) == 2
