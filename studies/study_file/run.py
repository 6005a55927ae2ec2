"""Runs a study: its walks, the rows that are reused, and its files."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from stridetwin.batch.executors import BatchOptions
from stridetwin.batch.folder import hold_folder
from stridetwin.batch.jobs import Failure, Job, Work, content_key, one_by_one
from stridetwin.batch.rows import RowLines
from stridetwin.batch.run import ROWS, Batch, Progress
from stridetwin.gate.walk_scores import scoring_versions
from stridetwin.outputs.parameters import ParameterValues, to_texts
from stridetwin.scenarios.campaign.named_files import SCENARIOS, copy_files
from stridetwin.scenarios.scenario_file import Scenario
from stridetwin.scenarios.score_needs import estimators_of
from stridetwin.streams.errors import FieldLocation, StrideTwinError
from stridetwin.streams.files import atomic_file, to_json
from stridetwin.studies.design import make_scenario
from stridetwin.studies.size import SAMPLED, Size, size_of
from stridetwin.studies.study_file import walk as walk_module
from stridetwin.studies.study_file.page import study_page
from stridetwin.studies.study_file.results import StudyResult, collect_result, csv_text
from stridetwin.studies.study_file.study import Study
from stridetwin.studies.study_file.walk import (
    WALK,
    StudyRow,
    StudyWalk,
    keep_needed_sensors,
    missing_sensors_reason,
    run_walk,
)

STUDY_FILES = REPORT, TABLE, VALUES = "study.html", "study.json", "study.csv"
"""Names of the files of a study: its report, its result, and all scores."""


@dataclass(frozen=True, kw_only=True)
class StudyOptions(BatchOptions):
    """Options of a study's run.

    Attributes:
        first: First seed; None takes the file's seeds.
        subset: Number of walks of each combination; None takes all.
        physics: How the body moves; None takes the scenarios'.
        resume: Reuses the rows of an earlier run.
        parameters: The values that the study was read with, see `outputs.parameters`; the result records them.
    """

    first: int | None = None
    subset: int | None = None
    physics: str | None = None
    resume: bool = False
    parameters: ParameterValues = field(default_factory=dict)

    def of(self, study: Study) -> Study:
        """The study with the seeds that these options set."""
        seeds = study.seeds[: self.subset]  # the first ones, or all of them
        if self.first is not None:
            seeds = tuple(range(self.first, self.first + len(seeds)))
        return replace(study, seeds=seeds)

    def command(self, study: Study) -> str:
        """The command line that gives this result again."""
        option_values = {"--seed": self.first, "--subset": self.subset, "--physics": self.physics}
        arguments: list[str] = []
        for name, value in option_values.items():
            if value is not None:
                arguments += [name, str(value)]
        for text in to_texts(self.parameters):
            arguments += ["--set", text]
        return shlex.join(["stridetwin", "experiment", study.path.name, *arguments])


def run_study(
    study: Study,
    options: StudyOptions,
    progress: Progress,
    announce: Callable[[str], None] = lambda text: None,
) -> StudyResult:
    """Runs the walks of a study and writes `STUDY_FILES` into the folder.

    Args:
        study: The study.
        options: Which walks, and where.
        progress: Receives the stage and its progress (0-1).
        announce: Receives the size of what is missing as text (`size.Size.describe`).

    Returns:
        The result of `results.collect_result`, with `files`.

    Raises:
        StrideTwinError: Any usage error; the folder is used by another process, or holds rows and is not to be resumed.
    """
    study = options.of(study)  # with the seeds of the options
    folder = options.folder
    with hold_folder(folder, (folder / ROWS).exists) as unfinished:
        if (folder / ROWS).exists() and not options.resume:
            raise StrideTwinError(f"{folder}: holds a study: expected --resume to continue it, or another folder")
        copy_files(folder, study.user_files)
        if study.user_files:  # scenarios name them as ../files/..., from a folder that has to exist
            (folder / SCENARIOS).mkdir(exist_ok=True)
        walks = _list_walks(study, folder, options.physics)
        _check_sensors(study, walks)
        versions = partial(_versions, tuple(sorted({method.estimator for method in study.methods})))
        jobs = [_make_job(name, walk, versions()) for name, walk in walks]
        work = Work(run=one_by_one(partial(run_walk, folder.absolute())), versions=versions)
        store: RowLines[StudyRow] = RowLines(folder / ROWS, unfinished)
        batch = Batch(jobs, store)
        if batch.missing:
            announce(f"{study.path.stem}: {_size(batch.missing, study).describe(len(batch.missing), options.workers)}")
        results = batch.run_with(options, work, study.path.stem, progress, "--resume continues")
        store.sort([job.key for job in jobs])
        rows = [_row_of_failure(r) if isinstance(r, Failure) else r for r in results]
        result = collect_result(study, rows)
        result["files"] = list(STUDY_FILES)
        if options.parameters:
            result["parameters"] = {name: dict(values) for name, values in options.parameters.items()}
        _write(study, options, rows, result)
    return result


def _size(jobs: Sequence[Job[StudyWalk]], study: Study) -> Size:
    """What some walks take, at least one, estimated from a sample of them: walks, estimates and time."""
    sampled_jobs = jobs[:: -(-len(jobs) // SAMPLED)]  # every n-th one, rounded up: at most `SAMPLED`
    return size_of([[job.task.scenario.config] for job in sampled_jobs], len(jobs), len(study.methods))


def _row_of_failure(failure: Failure) -> StudyRow:
    """The row of a walk that has no scores, because its worker died: the reason is that of the walk itself."""
    return {"scores": {}, "failed": {WALK: failure.reason}}


def _list_walks(study: Study, folder: Path, physics: str | None) -> list[tuple[str, StudyWalk]]:
    """All walks with their names: those of the first combination, then of the next ones.

    Args:
        study: The study.
        folder: The output folder, which contains the user's parts.
        physics: Replaces that of the scenarios; None leaves it.
    """
    walks = []
    scenarios: dict[str, Scenario] = {}  # by name: the base scenario, and the levels of the combination with a seed
    for combination in study.combinations:
        for seed in study.seeds:
            of_seed = combination.with_levels(study.levels(seed))  # with the levels whose turn it is
            name = ", ".join([combination.base.name, *(level.name for level in of_seed.levels)])
            if name not in scenarios:  # seeds with the same levels share a scenario
                scenarios[name] = make_scenario(study, of_seed, folder, physics)
            walks.append(
                (f"{name}, seed {seed}", StudyWalk(scenario=scenarios[name], seed=seed, methods=study.methods))
            )
    return walks


def _check_sensors(study: Study, walks: Sequence[tuple[str, StudyWalk]]) -> None:
    """Refuses a method that no combination has the sensors for.

    Args:
        study: The study.
        walks: All walks with their names, combination by combination.

    Raises:
        ConfigError: There is such a method; the message has what the first combination lacks.
    """
    first_walks = [walk for _, walk in walks[:: len(study.seeds)]]  # one of each combination
    for method in study.methods:
        reasons = [missing_sensors_reason(method, walk.scenario) for walk in first_walks]
        if all(reasons):
            at = FieldLocation(source=str(study.path)).key("methods").key(method.name).key("estimator")
            raise at.error(method.estimator, f"an estimator that a combination feeds ({reasons[0]})")


def _versions(estimators: Sequence[str]) -> dict[str, str]:
    """Versions of the code that determine the scores of some estimators and of those that feed them."""
    return scoring_versions(walk_module.__name__, sorted(estimators_of(estimators)))


def _make_job(name: str, walk: StudyWalk, versions: dict[str, str]) -> Job[StudyWalk]:
    """The job of a walk; the walk keeps only the sensors that its methods read.

    Args:
        name: Name of the walk.
        walk: The walk.
        versions: Versions of the code, which the key of its row contains.
    """
    task = replace(walk, scenario=keep_needed_sensors(walk.scenario, walk.methods))
    key = content_key(repr(task.scenario.config), walk.seed, repr(walk.methods), versions)
    return Job(name=name, key=key, task=task)


def _write(study: Study, options: StudyOptions, rows: Sequence[StudyRow], result: StudyResult) -> None:
    """Writes the report, the table and all values of a study."""
    text = Path(study.path).read_text(encoding="utf-8")
    texts = {
        REPORT: study_page(result, text, options.command(study)),
        TABLE: to_json(result),
        VALUES: csv_text(study, rows),
    }
    for name, content in texts.items():
        with atomic_file(options.folder / name) as file:
            file.write_text(content, encoding="utf-8")
