"""Compiles the kernels of estimators in a second process, while this one simulates or records a walk."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from multiprocessing.synchronize import Event
from pathlib import Path
from tempfile import TemporaryDirectory

from stridetwin.batch.processes import run_beside
from stridetwin.estimators import registry
from stridetwin.estimators.base import POSES, Options
from stridetwin.outputs.feeding import EstimatorClass, runnable_instances, runnable_on
from stridetwin.outputs.registry import kind_of
from stridetwin.run.live_chain import Chain, Request
from stridetwin.run.warm_up import synthetic_rig, synthetic_samples, write_synthetic_recording
from stridetwin.streams.compiled import is_uncompiled
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import Rig


@contextmanager
def compile_ahead(rig: Rig, metadata: Mapping[str, str], only: Collection[str] | None = None) -> Iterator[None]:
    """Compiles the estimators that a rig can feed, in a process that runs beside the body of the `with` statement.

    The kernels go to Numba's cache, where any later process finds them. At the end, an estimator whose compilation has
    not begun is left to whoever runs it first. Nothing is started where the cache has kernels of every estimator.

    Args:
        rig: Calibration of the sensors that will be recorded.
        metadata: Of the recording, with the geometry of the exoskeleton.
        only: Names of the estimators that will be run; None stands for all.
    """
    names = [name for name in registry.names() if only is None or name in only]
    uncompiled = [name for name in names if _is_uncompiled(registry.estimator(name), rig, metadata)]
    # Those that take poses run an odometry, too; they have the most to compile.
    uncompiled.sort(key=lambda name: not kind_of(registry.estimator(name).declaration).takes_poses)
    if not uncompiled:
        yield
        return
    with run_beside(_compile_estimators, uncompiled, dict(metadata)):
        yield


def _compile_estimators(stop: Event, names: Sequence[str], metadata: Mapping[str, str]) -> None:
    """Compiles one estimator after the other, until `stop` is set."""
    for name in names:
        if not stop.is_set():
            compile_estimator(name, metadata)


def _is_uncompiled(estimator_class: EstimatorClass, rig: Rig, metadata: Mapping[str, str]) -> bool:
    """Whether a rig feeds an estimator of whose package Numba's cache has no kernel yet."""
    package = ".".join(estimator_class.__module__.split(".")[:3])  # such as `stridetwin.estimators.foot_ins`
    if not is_uncompiled(package):
        return False
    options = Options(method=estimator_class.declaration.methods[0], metadata=metadata)
    return bool(runnable_on(estimator_class, options, rig, rig.topics))


def compile_estimator(name: str, metadata: Mapping[str, str]) -> None:
    """Runs an estimator on a synthetic walk, so that every kernel that it uses on a recording is compiled.

    An estimator that needs a sensor of which `synthetic_rig` has none is left alone.

    Args:
        name: Name of the estimator.
        metadata: Of the recordings that follow, with the geometry of the exoskeleton.
    """
    estimator_class = registry.estimator(name)
    kind, rig = kind_of(estimator_class.declaration), synthetic_rig()
    try:
        if kind.takes_poses:
            feed_synthetic_samples(Chain(Request(estimator=name), rig, metadata))
            return
        options = Options(method=estimator_class.declaration.methods[0], metadata=metadata)
        takes = {s.topic: s.kind for s in estimator_class.streams(rig, options) if s.live and s.topic != POSES}
    except StrideTwinError:  # the synthetic rig lacks a sensor
        return
    with TemporaryDirectory() as folder:
        recording = write_synthetic_recording(Path(folder) / "synthetic.mcap", takes, metadata)
        for instance in runnable_instances(estimator_class, recording):
            kind.run(instance, recording)


def feed_synthetic_samples(chain: Chain) -> None:
    """Feeds six seconds of synthetic samples to a chain, which compiles the kernels of live operation."""
    for sample in synthetic_samples(chain.takes):
        for _ in chain.update(sample):
            pass
