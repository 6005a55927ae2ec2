"""Scores of one recording, and of many recordings in parallel processes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from stridetwin.batch.executors import BatchOptions
from stridetwin.batch.jobs import Failure, Job, Work, content_key, one_by_one
from stridetwin.batch.run import Batch, run_batch
from stridetwin.batch.versions import class_version, code_versions
from stridetwin.estimators import registry
from stridetwin.estimators.base import PATH
from stridetwin.gate.own_estimators import OwnEstimator
from stridetwin.gate.score_table import EVERY_ESTIMATOR, ScoredWalk
from stridetwin.outputs.base import KindEvaluations, Scores, scores_by_output
from stridetwin.outputs.parameters import ParameterValues
from stridetwin.outputs.path.evaluate import Result, evaluate
from stridetwin.outputs.registry import estimators, kind_of, kinds
from stridetwin.run.recording import Selection, evaluate_recording
from stridetwin.scenarios.camera_report import report_cameras
from stridetwin.scenarios.campaign import manifest
from stridetwin.scenarios.campaign.walk import ACCEPTED, RECORDINGS
from stridetwin.scenarios.files import sha256
from stridetwin.scenarios.record import Progress
from stridetwin.streams.errors import StrideTwinError, was_interrupted
from stridetwin.streams.formats.opening import open_with_warnings
from stridetwin.streams.notices import warn
from stridetwin.streams.recording.reader import Recording

OnEvaluated = Callable[[Recording, Sequence[KindEvaluations]], None]
"""Receives a recording and the outputs of all estimators beside the truth."""


@dataclass(frozen=True, kw_only=True)
class ScoringJob:
    """One recording to be scored, with how it is scored.

    Attributes:
        name: Name in the table.
        path: Recording, or anything that can be imported.
        sha256: Digest of the recording, if known.
        lenient: Reads a damaged recording up to the damage.
        alignment: See `alignment.align`.
        user_estimators: Estimators that replace the built-in ones.
        only: Names of the built-in estimators to run, see `score_needs.estimators_of`; None runs all.
        parameters: Values in place of the estimators' own, see `outputs.parameters`.
        strict: A failing estimator aborts the job; else the others continue, and the table gives the reason.
    """

    name: str
    path: Path
    sha256: str | None = None
    lenient: bool = False
    alignment: str = "start"
    user_estimators: Sequence[OwnEstimator] = ()
    only: frozenset[str] | None = None
    parameters: ParameterValues = field(default_factory=dict)
    strict: bool = False


def jobs_of(sources: Sequence[Path], **settings: Any) -> list[ScoringJob]:
    """The jobs of some sources: recordings, and every accepted walk of campaigns.

    A single job is strict (`ScoringJob.strict`): a failing estimator is then an error at once.

    Args:
        sources: Recordings, or folders of campaigns that `generate` has written.
        **settings: Fields of all jobs, such as `alignment`; `lenient` is required for campaigns.

    Raises:
        StrideTwinError: A campaign's folder has no accepted walk, its recordings differ from its list, or a folder
            holds campaigns instead of being one.
    """
    jobs: list[ScoringJob] = []
    for source in sources:
        if (source / manifest.NAME).is_file():
            jobs += _jobs_of_campaign(source, settings)
        elif manifests := sorted(source.glob(f"*/{manifest.NAME}")):
            folder = manifests[0].parent  # the first of the campaigns that the source holds
            raise StrideTwinError(
                f"{source}: no campaign: expected a folder that generate has written, such as {folder}"
            )
        else:
            jobs.append(ScoringJob(name=source.stem, path=source, **settings))
    return [replace(jobs[0], strict=True)] if len(jobs) == 1 else jobs


def _jobs_of_campaign(folder: Path, settings: dict[str, Any]) -> list[ScoringJob]:
    """Jobs for the accepted walks of a campaign; warns of recordings that its manifest does not list.

    Args:
        folder: Folder of the campaign.
        settings: Fields of all jobs; a walk in whose recording the check has found errors (`findings`, or
            `expected_findings` about injected faults) is read leniently in any case.

    Raises:
        StrideTwinError: The manifest is invalid, lists no accepted walk, or a recording has another size than it says.
    """
    path = folder / manifest.NAME
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if document["format"] != manifest.FORMAT:
            raise ValueError(f"format {document['format']!r}")
        rows = [w for w in document["walks"] if w["status"] == ACCEPTED]
        jobs = []
        for row in rows:
            is_faulty = bool(row["findings"] or row["expected_findings"])
            job_settings = {**settings, "lenient": settings["lenient"] or is_faulty}
            jobs.append(
                ScoringJob(name=row["walk"], path=folder / row["recording"], sha256=row["sha256"], **job_settings)
            )
            size = jobs[-1].path.stat().st_size if jobs[-1].path.is_file() else 0
            if size != row["bytes"]:
                raise StrideTwinError(f"{jobs[-1].path}: {size} bytes, but {row['bytes']} in {path}; generate it again")
    except (KeyError, TypeError, ValueError) as error:
        raise StrideTwinError(
            f"{path}: invalid manifest of a campaign ({error}): expected one written by generate"
        ) from None
    if not jobs:
        raise StrideTwinError(f"{folder}: contains no accepted walk")
    unlisted = {file.name for file in (folder / RECORDINGS).glob("*.mcap")} - {job.path.name for job in jobs}
    if unlisted:
        text = f"{len(unlisted)} recordings, such as {min(unlisted)}, are not in {path}; they are not scored"
        warn(f"{folder / RECORDINGS}: {text}")
    return jobs


def score_walk(
    job: ScoringJob, progress: Progress | None = None, on_evaluated: OnEvaluated | None = None
) -> ScoredWalk:
    """Scores one recording and returns its row.

    Args:
        job: The recording, and how it is scored.
        progress: Receives the stage and its progress (0-1).
        on_evaluated: Receives the recording and the outputs beside the truth once all estimators have run.

    Returns:
        `name`, `sha256`, `metadata` (scenario, seed, physics), `estimators` (scores by output), and `failed` (reasons
        by estimator) if an estimator failed.

    Raises:
        StrideTwinError: The recording cannot be read; in a strict job, any error.
    """
    recording = open_with_warnings(job.path, job.lenient)
    scores: dict[str, Scores] = {}
    failed: dict[str, str] = {}
    evaluations: list[KindEvaluations] = []  # outputs of all estimators beside the truth, by kind of output
    row: ScoredWalk = {
        "name": job.name,
        "sha256": job.sha256 or _digest(job.path),
        "metadata": {k: recording.metadata[k] for k in ("scenario", "seed", "physics") if k in recording.metadata},
        "estimators": scores,
    }
    if job.user_estimators:  # they replace the built-in ones, and each gives a path
        results: list[Result] = []
        for estimator in job.user_estimators:  # each may fail alone
            try:
                results += evaluate(recording, [estimator.path(recording)], job.alignment)
            except StrideTwinError as error:
                _record_failure(job, failed, estimator.name, error)
        evaluations = [KindEvaluations(kind=kinds()[PATH], evaluations=results)] if results else []
        scores |= scores_by_output(evaluations)
    else:
        try:
            report_cameras(recording, _list_used(recording, job), lenient=job.lenient)
            for kind_results in _evaluate_installed(recording, job, progress):
                evaluations.append(kind_results)
                scores |= scores_by_output([kind_results])
        except Exception as error:
            if was_interrupted(error):  # Ctrl-C in compiled code arrives as another exception
                raise KeyboardInterrupt from error
            # they run together, so an error that gets here is not of a single one
            _record_failure(job, failed, EVERY_ESTIMATOR, error)
    if on_evaluated is not None:
        on_evaluated(recording, evaluations)
    if failed:
        row["failed"] = failed
    return row


def _list_used(recording: Recording, job: ScoringJob) -> set[str]:
    """Topics of the streams that the job's built-in estimators take from a recording."""
    selection = Selection(only=job.only, parameters=job.parameters)
    instances = [instance for kind in kinds() for instance in selection.instances(kind, recording)]
    return {stream.topic for instance in instances for stream in instance.streams}


def _evaluate_installed(recording: Recording, job: ScoringJob, progress: Progress | None) -> Iterator[KindEvaluations]:
    """Runs the estimators that the recording feeds, and yields their evaluated outputs kind by kind.

    Args:
        recording: The recording.
        job: Selects the estimators and their parameters.
        progress: Receives the stage and its progress (0-1).

    Raises:
        StrideTwinError: It feeds none; the message says what they need.
    """
    selection = Selection(only=job.only, parameters=job.parameters)
    has_any = False
    for kind_results in evaluate_recording(recording, selection, alignment=job.alignment, progress=progress):
        has_any = True
        yield kind_results
    if not has_any:
        declarations = [e.declaration for name, e in estimators().items() if job.only is None or name in job.only]
        needs = ", or ".join(declaration.needs for declaration in declarations if declaration.needs)
        contents = recording.describe_topics()
        raise StrideTwinError(f"{job.path}: no estimator can run: expected a recording with {needs}; {contents}")


def _record_failure(job: ScoringJob, failed: dict[str, str], name: str, error: Exception) -> None:
    """Adds an estimator's error on one line to `failed`; in a strict job raises it.

    Args:
        job: The job, whose path is left out of the text.
        failed: Reasons by estimator, which get one more.
        name: Name of the estimator.
        error: Its error; one that is no StrideTwinError is shown with its type.
    """
    if job.strict:
        raise error
    text = str(error) if isinstance(error, StrideTwinError) else f"{type(error).__name__}: {error}"
    failed[name] = " ".join(text.replace(f"{job.path}: ", "").split())


def _digest(path: Path) -> str:
    """Digest of a file, or of all files of a folder."""
    if path.is_file():
        return sha256(path)
    hashed = hashlib.sha256()
    for file in sorted(f for f in path.rglob("*") if f.is_file()):
        hashed.update(f"{file.relative_to(path).as_posix()} {sha256(file)}\n".encode())
    return hashed.hexdigest()


def score_walks(
    jobs: Sequence[ScoringJob],
    options: BatchOptions,
    progress: Progress,
    *,
    is_kept: bool = False,
    on_evaluated: OnEvaluated | None = None,
) -> list[ScoredWalk]:
    """Scores recordings in parallel and returns the row of each, as `score_walk` gives it, in the order of the jobs.

    Args:
        jobs: The recordings; the workers of a cluster must see them under the same paths.
        options: Processes or cluster that score the recordings; the folder is for `is_kept`.
        progress: Receives the stage and its progress (0-1).
        is_kept: Keeps the rows in the folder, and reuses those of equal recordings, options and versions of the code.
        on_evaluated: Receives the recording and the outputs beside the truth once all estimators have run; only for
            one job that is neither kept nor run on a cluster.

    Raises:
        StrideTwinError: A recording cannot be read; in a strict job, any error.
    """
    if len(jobs) == 1 and options.scheduler is None and not is_kept:  # in this process, with its progress
        progress("score", 0.0)
        return [score_walk(jobs[0], progress, on_evaluated)]
    if options.scheduler is not None:  # workers have other working folders
        jobs = [replace(job, path=job.path.absolute()) for job in jobs]
    # the built-in estimators whose code determines the rows; the code of users' estimators has no version
    estimators = () if jobs[0].user_estimators else tuple(sorted(jobs[0].only or registry.names()))
    versions = partial(scoring_versions, __name__, estimators)
    work = Work(run=one_by_one(score_walk), versions=versions)
    # rows that are not kept need no digest, only keys that differ
    keys = [_key(job, versions()) if is_kept else str(i) for i, job in enumerate(jobs)]
    keyed = [Job(name=job.name, key=key, task=job) for job, key in zip(jobs, keys)]
    if is_kept:
        results = run_batch(keyed, work, options, "score", progress)
    else:
        batch: Batch[ScoringJob, ScoredWalk] = Batch(keyed, None)  # None: it stores no rows
        results = batch.run_with(options, work, "score", progress, "")  # "": a stopped batch cannot be continued
    return [
        _row_of_failure(job, result.reason) if isinstance(result, Failure) else result
        for job, result in zip(jobs, results)
    ]


def scoring_versions(module: str, estimators: Sequence[str]) -> dict[str, str]:
    """Versions of the code behind the scores that a module makes of some estimators and their kinds of output.

    Args:
        module: Name of the module that runs and scores the estimators.
        estimators: Names of the estimators.

    Returns:
        Versions of the project and of libraries (`code_versions`), and digests of the sources of the kinds of output,
        by module, and of the estimators, by name.
    """
    classes = {name: registry.estimator(name) for name in estimators}
    kinds = [kind_of(c.declaration) for c in classes.values()]
    kind_versions = {type(kind).__module__: class_version(type(kind)) for kind in kinds}
    return code_versions(module) | kind_versions | {name: class_version(c) for name, c in classes.items()}


def _key(job: ScoringJob, versions: Mapping[str, str]) -> str:
    """Digest of everything that determines a row: recording, options, and versions of the code."""
    only = None if job.only is None else sorted(job.only)
    content = job.name, job.sha256 or _digest(job.path), job.lenient, job.alignment, only, dict(versions)
    changed_parameters = [job.parameters] if job.parameters else []
    return content_key(*content, *changed_parameters)


def _row_of_failure(job: ScoringJob, reason: str) -> ScoredWalk:
    """The row of a recording whose worker died."""
    digest = job.sha256 or _digest(job.path)
    return {"name": job.name, "sha256": digest, "metadata": {}, "estimators": {}, "failed": {EVERY_ESTIMATOR: reason}}
