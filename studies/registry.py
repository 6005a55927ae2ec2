"""Runs an experiment: its cases, the rows that are reused, and the summary of all."""

from __future__ import annotations

import hashlib
import inspect
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from stridetwin.estimators import registry
from stridetwin.scenarios.processes import as_done
from stridetwin.scenarios.versions import digest
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.files import whole_file
from stridetwin.studies.case import Case
from stridetwin.studies.catalogue import STUDIES, Experiment, experiment

Progress = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of an experiment run.

    Attributes:
        folder: Output folder: one JSON file per case, written when the case is done.
        workers: Number of cases that run at a time.
        first: First seed; None takes the experiment's.
        subset: Number of cases; None takes all.
        physics: How the body moves, if a body walks.
        resume: Reuses the rows and recordings in the folder that this version of the code made with this
            configuration.
        keep: Recordings of walks are kept.
        estimators: Installed estimators that are run besides those of the study.
    """

    folder: Path
    workers: int = 1
    first: int | None = None
    subset: int | None = None
    physics: str = "dynamic"
    resume: bool = False
    keep: bool = False
    estimators: tuple[str, ...] = ()

    def cases(self, seeds: range) -> list[Case]:
        """The cases of an experiment with these seeds."""
        first, count = seeds[0] if self.first is None else self.first, self.subset or len(seeds)
        return [
            Case(
                seed=seed,
                folder=self.folder,
                physics=self.physics,
                resume=self.resume,
                keep=self.keep,
                estimators=self.estimators,
            )
            for seed in range(first, first + count)
        ]


def run_experiment(name: str, options: Options, progress: Progress) -> dict[str, Any]:
    """Runs the cases of an experiment.

    Returns:
        `experiment`, `summary`, `paper` and `cases`, as JSON holds them.

    Raises:
        StrideTwinError: The name, or that of an estimator, is invalid; the message lists the valid ones.
    """
    study = experiment(name)
    _check_estimators(name, options.estimators)
    cases = options.cases(study.seeds)
    options.folder.mkdir(parents=True, exist_ok=True)
    keys = {case.seed: _keys(name, study, case) for case in cases}
    found = {case.seed: _row_key(case) for case in cases} if options.resume else {}
    missing = [c for c in cases if found.get(c.seed) != keys[c.seed].row]
    outdated = sum(found.get(c.seed) is not None for c in missing)
    stage = f"{name}, {outdated} rows of another version are run again" if outdated else name
    progress(stage, 1.0 - len(missing) / len(cases))
    jobs = [_Job(case=c, run=study.run_case, walks=keys[c.seed].walks) for c in missing]
    for done, (job, result) in enumerate(as_done(_Job.result, jobs, options.workers), 1):
        with whole_file(job.case.file(".json")) as file:
            file.write_text(json.dumps({"key": keys[job.case.seed].row, **result}), encoding="utf-8")
        progress(stage, 1.0 - (len(missing) - done) / len(cases))
    results = [_read(case) for case in cases]
    result = {"experiment": name, **study.collect(results), "cases": results}
    if study.report is not None:
        with whole_file(options.folder / "report.html") as file:
            file.write_text(study.report(result), encoding="utf-8")
    return result


def _check_estimators(name: str, chosen: Sequence[str]) -> None:
    """Refuses estimators that the experiment cannot run.

    Raises:
        StrideTwinError: The message lists the valid ones.
    """
    kind = STUDIES[name].kind if name in STUDIES else ""
    valid = list(registry.estimators(kind)) if chosen and kind else []
    for estimator in chosen:
        if estimator not in valid:
            expected = ", ".join(valid) or f"none, as {name} compares methods of its own"
            raise StrideTwinError(f"experiment {name}: invalid estimator {estimator!r}: expected {expected}")


@dataclass(frozen=True, kw_only=True)
class _Keys:
    """Digests of configuration and code that made a case's files.

    Attributes:
        row: Of its row.
        walks: Of its recordings, which do not depend on the estimators.
    """

    row: str
    walks: str


def _keys(name: str, study: Experiment, case: Case) -> _Keys:
    module, given = study.source
    what = json.dumps([name, given, case.seed, case.physics])
    others = json.dumps([(e, _source(e)) for e in case.estimators]) if case.estimators else ""
    row, walks = (
        hashlib.sha256((what + _version(module, estimators) + others * estimators).encode()).hexdigest()[:16]
        for estimators in (True, False)
    )
    return _Keys(row=row, walks=walks)


@cache
def _version(module: str, estimators: bool) -> str:
    return digest(module, estimators=estimators)


@cache
def _source(estimator: str) -> str:
    """Digest of the file of an installed estimator's class."""
    return hashlib.sha256(Path(inspect.getfile(registry.estimator(estimator))).read_bytes()).hexdigest()


def key_of(name: str, case: Case) -> str:
    """Key of a case's row when this version of the code makes it."""
    return _keys(name, experiment(name), case).row


def _row_key(case: Case) -> str | None:
    """Key of the existing row; "" if it has none or is damaged, None if there is no row."""
    if not case.file(".json").exists():
        return None
    try:
        return str(_read(case).get("key", ""))
    except (ValueError, AttributeError):
        return ""


def _read(case: Case) -> dict[str, Any]:
    return read_row(case.file(".json"))


def read_row(file: Path) -> dict[str, Any]:
    """A case's row from its file."""
    row: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return row


@dataclass(frozen=True, kw_only=True)
class _Job:
    """A case to run.

    Attributes:
        case: The case.
        run: Runs it.
        walks: Key of its recordings; it is stored beside them, so that those of another version are not reused.
    """

    case: Case
    run: Callable[[Case], dict[str, Any]]
    walks: str

    def result(self) -> dict[str, Any]:
        """Runs the case and returns its row."""
        mark = self.case.file(".key")
        if not mark.exists() or mark.read_text(encoding="utf-8") != self.walks:
            for recording in self.case.recordings:
                recording.unlink()
            with whole_file(mark) as file:
                file.write_text(self.walks, encoding="utf-8")
        result = self.run(self.case)
        if not self.case.keep:
            mark.unlink()
        return result
