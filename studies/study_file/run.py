"""Runs a study: its walks, the rows that are reused, and its files."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from stridetwin.batch.executors import BatchOptions
from stridetwin.batch.folder import hold_folder
from stridetwin.batch.jobs import Failure, Job, Row, Work, content_key, one_by_one
from stridetwin.batch.rows import RowLines
from stridetwin.batch.run import ROWS, Batch, Progress
from stridetwin.gate.walk_scores import scoring_versions
from stridetwin.scenarios.campaign.named_files import copy_files
from stridetwin.scenarios.scenario_file import Scenario
from stridetwin.scenarios.score_needs import estimators_of
from stridetwin.streams.errors import StrideTwinError, Where
from stridetwin.streams.files import json_text, whole_file
from stridetwin.studies.study_file import walk as walk_module
from stridetwin.studies.study_file.page import study_page
from stridetwin.studies.study_file.results import collect_result, csv_text
from stridetwin.studies.study_file.study import Study, make_scenario
from stridetwin.studies.study_file.walk import WALK, Walk, keep_needed_sensors, run_walk, why_unfed

FILES = REPORT, TABLE, VALUES = "study.html", "study.json", "study.csv"


@dataclass(frozen=True, kw_only=True)
class Options(BatchOptions):
    """Options of a study's run.

    Attributes:
        first: First seed; None takes the file's seeds.
        subset: Number of walks of each combination; None takes all.
        physics: How the body moves; None takes the scenarios'.
        resume: Reuses the rows of an earlier run.
    """

    first: int | None = None
    subset: int | None = None
    physics: str | None = None
    resume: bool = False

    def of(self, study: Study) -> Study:
        """The study with these seeds."""
        seeds = study.seeds[: self.subset]
        return replace(study, seeds=seeds if self.first is None else tuple(range(self.first, self.first + len(seeds))))

    def command(self, study: Study) -> str:
        """The command that gives the same result."""
        given = {"--seed": self.first, "--subset": self.subset, "--physics": self.physics}
        words = [str(word) for name, value in given.items() if value is not None for word in (name, value)]
        return shlex.join(["stridetwin", "experiment", study.path.name, *words])


def run_study(study: Study, options: Options, progress: Progress) -> dict[str, Any]:
    """Runs the walks of a study and writes `FILES` into the folder.

    Returns:
        As `results.collect_result`, with `files`.

    Raises:
        StrideTwinError: Any usage error; the folder is used by another process, or holds rows and is not to be resumed.
    """
    study, folder = options.of(study), options.folder
    with hold_folder(folder, (folder / ROWS).exists) as unfinished:
        if (folder / ROWS).exists() and not options.resume:
            raise StrideTwinError(f"{folder}: holds a study: expected --resume to continue it, or another folder")
        copy_files(folder, study.own)
        scenarios = [make_scenario(study, each, folder, options.physics) for each in study.combinations]
        _check_sensors(study, scenarios)
        versions = partial(_versions, tuple(sorted({method.estimator for method in study.methods})))
        jobs = _list_jobs(study, scenarios, versions())
        work = Work(run=one_by_one(partial(run_walk, folder.absolute())), versions=versions)
        store = RowLines(folder / ROWS, unfinished)
        results = Batch(jobs, store).run_with(options, work, study.path.stem, progress, "--resume continues")
        store.sort([job.key for job in jobs])
        rows = [{"scores": {}, "failed": {WALK: r.reason}} if isinstance(r, Failure) else r for r in results]
        result = {**collect_result(study, rows), "files": list(FILES)}
        _write(study, options, rows, result)
    return result


def _check_sensors(study: Study, scenarios: Sequence[Scenario]) -> None:
    """Refuses a method that no combination has the sensors for."""
    for method in study.methods:
        reasons = [why_unfed(method, scenario) for scenario in scenarios]
        if all(reasons):
            at = Where(source=str(study.path)).key("methods").key(method.name).key("estimator")
            raise at.error(method.estimator, f"an estimator that a combination feeds ({reasons[0]})")


def _versions(estimators: Sequence[str]) -> dict[str, str]:
    """Versions of the code that determine the scores, those of the estimators that feed these ones included."""
    return scoring_versions(walk_module.__name__, sorted(estimators_of(estimators)))


def _list_jobs(study: Study, scenarios: Sequence[Scenario], versions: dict[str, str]) -> list[Job[Walk]]:
    jobs = []
    for combination, scenario in zip(study.combinations, scenarios):
        needed = keep_needed_sensors(scenario, study.methods)
        name = ", ".join([combination.base.name, *(level.name for level in combination.levels)])
        for seed in study.seeds:
            key = content_key(repr(needed.config), seed, repr(study.methods), versions)
            task = Walk(scenario=needed, seed=seed, methods=study.methods)
            jobs.append(Job(name=f"{name}, seed {seed}", key=key, task=task))
    return jobs


def _write(study: Study, options: Options, rows: Sequence[Row], result: dict[str, Any]) -> None:
    text = Path(study.path).read_text(encoding="utf-8")
    texts = {
        REPORT: study_page(result, text, options.command(study)),
        TABLE: json_text(result),
        VALUES: csv_text(study, rows),
    }
    for name, content in texts.items():
        with whole_file(options.folder / name) as file:
            file.write_text(content, encoding="utf-8")
