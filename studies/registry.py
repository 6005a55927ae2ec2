"""Runs an experiment: its cases, the rows that are reused, and the summary of all."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from stridetwin.batch.executors import BatchOptions
from stridetwin.batch.folder import hold_folder
from stridetwin.batch.jobs import Failure, Job, Row, Work, content_key, one_by_one
from stridetwin.batch.rows import RowFiles
from stridetwin.batch.run import Batch, Progress
from stridetwin.batch.versions import class_version, code_versions
from stridetwin.estimators import registry
from stridetwin.outputs.parameters import ParameterValues, check_used, use_parameters
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.files import atomic_file
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.experiment import Experiment, experiment
from stridetwin.studies.result import AnyResult

_USED = "another process runs an experiment there: expected another folder"


@dataclass(frozen=True, kw_only=True)
class ExperimentBatchOptions(BatchOptions):
    """Options of an experiment run. The folder has one JSON file per case, written when the case is done.

    Attributes:
        first: First seed; None takes the experiment's.
        subset: Number of cases; None takes all.
        physics: How the body moves, if a body walks.
        resume: Reuses the rows and recordings in the folder that this version of the code made with this
            configuration.
        keep: Recordings of walks are kept.
        estimators: Installed estimators that are run besides those of the study.
        parameters: Values in place of the estimators' own, see `outputs.parameters`; the result records them.
    """

    first: int | None = None
    subset: int | None = None
    physics: str = "dynamic"
    resume: bool = False
    keep: bool = False
    estimators: tuple[str, ...] = ()
    parameters: ParameterValues = field(default_factory=dict)

    def cases(self, study: Experiment) -> list[ExperimentCase]:
        """The cases of an experiment with these options: one per seed, with consecutive seeds from the first one."""
        first = study.seeds[0] if self.first is None else self.first
        count = self.subset or len(study.seeds)
        return [
            ExperimentCase(
                seed=seed,
                folder=self.folder.absolute(),
                setup=study.setup,
                physics=self.physics,
                resume=self.resume,
                keep=self.keep,
                estimators=self.estimators,
                parameters=self.parameters,
            )
            for seed in range(first, first + count)
        ]


def run_experiment(
    name: str,
    options: ExperimentBatchOptions,
    progress: Progress,
    announce: Callable[[str], None] = lambda text: None,
) -> AnyResult:
    """Runs the cases of an experiment.

    Args:
        name: In the catalogue.
        options: Which cases, and where.
        progress: Receives the stage and its progress (0-1).
        announce: Receives the size of what is missing, such as `60 cases: 60 walks (1500 s), 120 estimates, ...`.

    Returns:
        The result of `Experiment.result`.

    Raises:
        StrideTwinError: The name, or that of an estimator, is invalid (the message lists the valid ones); another
            process uses the folder; or the worker of a case died twice.
    """
    study = experiment(name)
    _check_estimators(study, options.estimators)
    check_used(options.parameters, [*study.adjustable, *options.estimators])
    jobs = [_make_job(study, case) for case in options.cases(study)]
    folder = options.folder
    with hold_folder(folder, lambda: any(folder.glob("seed_*")), _USED) as unfinished:
        store: RowFiles[Row] = RowFiles(folder, unfinished, is_sorted=False)
        batch = Batch(jobs, store, resume=options.resume)
        stage = f"{name}, {batch.outdated} rows of another version are run again" if batch.outdated else name
        if missing := [job.task.case for job in batch.missing]:
            announce(f"{name}: {study.size(missing).describe(len(missing), options.workers)}")
        versions = partial(_versions, study.module, options.estimators)
        work = Work(run=one_by_one(_run_case), versions=versions)
        results = batch.run_with(options, work, stage, progress, "--resume continues")
        # an experiment needs every row
        for job, row in zip(jobs, results):
            if isinstance(row, Failure):
                raise StrideTwinError(f"{name}: {job.name}: {row.reason}; --resume runs it again")
        # rows are read from the files even if they are new, so that they are equal to reused ones to the last bit
        rows = [read_row(store.path(job)) for job in jobs]
        result = study.result(rows)
        if options.parameters:
            result["parameters"] = {name: dict(values) for name, values in options.parameters.items()}
        if study.report is not None:
            with atomic_file(folder / "report.html") as file:
                file.write_text(study.report(result), encoding="utf-8")
    return result


def _check_estimators(study: Experiment, chosen: Sequence[str]) -> None:
    """Refuses installed estimators that the experiment cannot run: those of another kind than `Experiment.kind`.

    Raises:
        StrideTwinError: The message lists the valid ones.
    """
    # installed estimators are only looked up where some are chosen and the experiment can run any
    valid = list(registry.estimators(study.kind)) if chosen and study.kind else []
    for estimator in chosen:
        if estimator not in valid:
            expected = ", ".join(valid) or f"none, as {study.name} compares methods of its own"
            raise StrideTwinError(f"experiment {study.name}: invalid estimator {estimator!r}: expected {expected}")


@dataclass(frozen=True, kw_only=True)
class _CaseTask:
    """A case to run on a worker.

    Attributes:
        case: The case.
        run: Runs it.
        walks_key: Key of its recordings, which do not depend on the estimators. It is stored beside them, so that those
            of another version are not reused.
    """

    case: ExperimentCase
    run: Callable[[ExperimentCase], Row]
    walks_key: str


def _make_job(study: Experiment, case: ExperimentCase) -> Job[_CaseTask]:
    """The job of a case, with the keys of its row and recordings: digests of configuration and code."""
    content = study.name, study.content, case.seed, case.physics
    # the recordings do not depend on the code of the estimators
    walks_key = content_key(*content, _sources_digest(study.module, with_estimators=False))
    task = _CaseTask(case=case, run=study.run_case, walks_key=walks_key)
    changed_parameters = [case.parameters] if case.parameters else []
    sources = _sources_digest(study.module, with_estimators=True)
    key = content_key(*content, sources, _plugin_versions(case.estimators), *changed_parameters)
    return Job(name=case.name, key=key, task=task)


def _sources_digest(module: str, *, with_estimators: bool) -> str:
    """Digest of the sources behind a module's results, with or without the estimators."""
    return code_versions(module, estimators=with_estimators)["sources"]


def _versions(module: str, estimators: Sequence[str]) -> dict[str, str]:
    """Versions that determine the rows of a study's module with installed estimators beside its own."""
    return code_versions(module) | _plugin_versions(estimators)


def _plugin_versions(estimators: Sequence[str]) -> dict[str, str]:
    """Digests of the sources of installed estimators by name."""
    return {name: class_version(registry.estimator(name)) for name in estimators}


def key_of(name: str, case: ExperimentCase) -> str:
    """Key that this version of the code gives the row of a case."""
    return _make_job(experiment(name), case).key


def read_row(file: Path) -> Row:
    """Reads the row of a case from its file."""
    row: Row = json.loads(file.read_text(encoding="utf-8"))
    return row


def _run_case(task: _CaseTask) -> Row:
    """Runs a case and returns its row; recordings of another version are deleted first."""
    mark = task.case.file(".key")  # beside the recordings: the key of what made them
    if not mark.exists() or mark.read_text(encoding="utf-8") != task.walks_key:
        for recording in task.case.recordings:
            recording.unlink()
        with atomic_file(mark) as file:
            file.write_text(task.walks_key, encoding="utf-8")
    with use_parameters(task.case.parameters):
        row = task.run(task.case)
    if not task.case.keep:  # `run` has then deleted its recordings
        mark.unlink()
    return row
