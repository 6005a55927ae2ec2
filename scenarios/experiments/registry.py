"""The experiments by name: their cases, how one is run, and what they come to together."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

from stridetwin.estimators.methods import with_current_names
from stridetwin.scenarios.experiments import (
    assistance,
    dvio_bench,
    dvio_faults,
    jao_faults,
    jao_simulation,
    jao_walk,
    mode_faults,
    mode_fusion,
    mode_not_fooled,
    mode_report,
    mode_tables,
    shim_faults,
    shim_figures,
    shim_table5,
    zhao_closed_loop,
    zhao_generality,
    zhao_trials,
)
from stridetwin.scenarios.experiments.case import Case
from stridetwin.scenarios.experiments.mode_walks import FORGETFUL, Telling
from stridetwin.scenarios.experiments.versions import digest
from stridetwin.scenarios.processes import as_done
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.files import whole_file

Progress = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One experiment of a paper.

    Attributes:
        seeds: One case each.
        run_case: From a case to a result that JSON can hold; runs in a process of its own.
        collect: From the results to `summary` and `paper`.
        table: From all of it to lines of text.
        report: From all of it to an HTML page with its figures; None where it has none.
    """

    seeds: range
    run_case: Callable[[Case], dict[str, Any]]
    collect: Callable[[list[dict[str, Any]]], dict[str, Any]]
    table: Callable[[dict[str, Any]], list[str]]
    report: Callable[[dict[str, Any]], str] | None = None

    @property
    def source(self) -> tuple[str, str]:
        """The module of `run_case`, and what else it is given there."""
        run: Any = self.run_case
        if isinstance(run, partial):
            return str(run.func.__module__), repr((run.args, run.keywords))
        return str(run.__module__), ""


def _told_modes(name: str, seeds: range, run_case: Callable[[Case], dict[str, Any]]) -> Experiment:
    """An experiment about the modes of coming steps."""
    return Experiment(
        seeds=seeds,
        run_case=run_case,
        collect=partial(mode_tables.collect, name),
        table=mode_tables.table,
        report=mode_report.report,
    )


EXPERIMENTS = {
    "jao_simulation": Experiment(
        seeds=range(1000, 1100),
        run_case=jao_simulation.run_case,
        collect=jao_simulation.collect,
        table=jao_simulation.table,
    ),
    **{
        name: Experiment(
            seeds=jao_walk.SEEDS,
            run_case=partial(jao_walk.run_walk, name),
            collect=partial(jao_walk.collect, name),
            table=jao_walk.table,
        )
        for name in ("jao_straight_53m", "jao_loop_126m", "stairs_16")
    },
    "jao_faults": Experiment(
        seeds=jao_faults.SEEDS, run_case=jao_faults.run_case, collect=jao_faults.collect, table=jao_faults.table
    ),
    "shim_table5": Experiment(
        seeds=shim_table5.SEEDS,
        run_case=shim_table5.run_case,
        collect=shim_table5.collect,
        table=shim_table5.table,
        report=shim_figures.report,
    ),
    "shim_faults": Experiment(
        seeds=shim_faults.SEEDS, run_case=shim_faults.run_case, collect=shim_faults.collect, table=shim_faults.table
    ),
    **{
        name: Experiment(
            seeds=zhao_closed_loop.SEEDS,
            run_case=partial(zhao_closed_loop.run_case, scenario),
            collect=zhao_closed_loop.collect,
            table=zhao_closed_loop.table,
        )
        for name, scenario in (("zhao_closed_loop", "zhao_loop"), ("zhao_closed_loop_stress", "zhao_loop_stress"))
    },
    **{
        name: _told_modes(name, seeds, partial(zhao_generality.run_case, telling))
        for name, seeds, telling in (
            ("zhao_generality", zhao_generality.SEEDS, Telling()),
            ("zhao_generality_given_poses", zhao_generality.SEEDS, Telling(poses="given")),
            ("zhao_generality_shallow", zhao_generality.SEEDS, Telling(pitch_down="shallow")),
            ("zhao_baselines", zhao_generality.SEEDS[:60], Telling(methods=("proposed", "published", FORGETFUL))),
        )
    },
    **{name: _told_modes(name, zhao_trials.SEEDS, partial(zhao_trials.run_case, name)) for name in zhao_trials.TRIALS},
    "mode_not_fooled": Experiment(
        seeds=mode_not_fooled.SEEDS,
        run_case=mode_not_fooled.run_case,
        collect=mode_not_fooled.collect,
        table=mode_not_fooled.table,
    ),
    "mode_fusion": Experiment(
        seeds=mode_fusion.SEEDS, run_case=mode_fusion.run_case, collect=mode_fusion.collect, table=mode_fusion.table
    ),
    "mode_faults": Experiment(
        seeds=mode_faults.SEEDS, run_case=mode_faults.run_case, collect=mode_faults.collect, table=mode_faults.table
    ),
    **{
        name: Experiment(
            seeds=seeds, run_case=partial(assistance.run_case, ways), collect=assistance.collect, table=assistance.table
        )
        for name, seeds, ways in (
            ("assistance", assistance.SEEDS, ("none", "carried", "late", "predicted", "known")),
            ("assistance_wrong", assistance.MANY, ("wrong",)),
        )
    },
    "dvio_bench": Experiment(
        seeds=dvio_bench.SEEDS, run_case=dvio_bench.run_case, collect=dvio_bench.collect, table=dvio_bench.table
    ),
    "dvio_faults": Experiment(
        seeds=dvio_faults.SEEDS, run_case=dvio_faults.run_case, collect=dvio_faults.collect, table=dvio_faults.table
    ),
}


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of an experiment run.

    Attributes:
        folder: Gets one JSON file a case, as soon as it is done.
        workers: Cases at a time.
        first: First seed; None takes the experiment's.
        subset: Number of cases; None takes all.
        physics: How the body moves, where a body walks.
        resume: Cases whose rows are there, of this configuration and version of the code, are not run again, walks
            that are there not walked again.
        keep: Recordings of walks stay.
    """

    folder: Path
    workers: int = 1
    first: int | None = None
    subset: int | None = None
    physics: str = "dynamic"
    resume: bool = False
    keep: bool = False

    def cases(self, seeds: range) -> list[Case]:
        """The cases of an experiment with these seeds."""
        first, count = seeds[0] if self.first is None else self.first, self.subset or len(seeds)
        return [
            Case(seed=seed, folder=self.folder, physics=self.physics, resume=self.resume, keep=self.keep)
            for seed in range(first, first + count)
        ]


def run_experiment(name: str, options: Options, progress: Progress) -> dict[str, Any]:
    """Runs the cases of an experiment.

    Args:
        name: Of `EXPERIMENTS`.
        options: How it is run.
        progress: Told how far it is (0-1).

    Returns:
        `experiment`, `summary`, `paper` and `cases`, as JSON holds them.

    Raises:
        StrideTwinError: There is no such experiment; the message lists those there are.
    """
    experiment = named(name)
    cases = options.cases(experiment.seeds)
    options.folder.mkdir(parents=True, exist_ok=True)
    keys = {case.seed: _keys(name, experiment, case) for case in cases}
    found = {case.seed: _row_key(case) for case in cases} if options.resume else {}
    missing = [c for c in cases if found.get(c.seed) != keys[c.seed].row]
    outdated = sum(found.get(c.seed) is not None for c in missing)
    stage = f"{name}, {outdated} of another version anew" if outdated else name
    progress(stage, 1.0 - len(missing) / len(cases))
    jobs = [_Job(case=c, run=experiment.run_case, walks=keys[c.seed].walks) for c in missing]
    for done, (job, result) in enumerate(as_done(_Job.result, jobs, options.workers), 1):
        with whole_file(job.case.file(".json")) as file:
            file.write_text(json.dumps({"key": keys[job.case.seed].row, **result}), encoding="utf-8")
        progress(stage, 1.0 - (len(missing) - done) / len(cases))
    results = [_read(case) for case in cases]
    result = {"experiment": name, **experiment.collect(results), "cases": results}
    if experiment.report is not None:
        with whole_file(options.folder / "report.html") as file:
            file.write_text(experiment.report(result), encoding="utf-8")
    return result


def named(name: str) -> Experiment:
    """An experiment.

    Raises:
        StrideTwinError: There is none of this name; the message lists those there are.
    """
    if name not in EXPERIMENTS:
        raise StrideTwinError(f"there is no experiment {name!r}; valid: {', '.join(EXPERIMENTS)}")
    return EXPERIMENTS[name]


@dataclass(frozen=True, kw_only=True)
class _Keys:
    """What a case's files are made of: configuration and version of the code.

    Attributes:
        row: Of its row.
        walks: Of its recordings, which no estimator has seen.
    """

    row: str
    walks: str


def _keys(name: str, experiment: Experiment, case: Case) -> _Keys:
    module, given = experiment.source
    what = json.dumps([name, given, case.seed, case.physics])
    row, walks = (
        hashlib.sha256((what + _version(module, estimators)).encode()).hexdigest()[:16] for estimators in (True, False)
    )
    return _Keys(row=row, walks=walks)


@cache
def _version(module: str, estimators: bool) -> str:
    return digest(module, estimators=estimators)


def key_of(name: str, case: Case) -> str:
    """The key that a case's row has when this version of the code makes it."""
    return _keys(name, named(name), case).row


def _row_key(case: Case) -> str | None:
    """Key of the row that there is, "" where it has none or is damaged; None where there is no row."""
    if not case.file(".json").exists():
        return None
    try:
        return str(_read(case).get("key", ""))
    except (ValueError, AttributeError):
        return ""


def _read(case: Case) -> dict[str, Any]:
    return read_row(case.file(".json"))


def read_row(file: Path) -> dict[str, Any]:
    """A case's row from its file, with the methods' names of today."""
    row: dict[str, Any] = with_current_names(json.loads(file.read_text(encoding="utf-8")))
    return row


@dataclass(frozen=True, kw_only=True)
class _Job:
    """A case to be run.

    Attributes:
        case: Which.
        run: Runs it.
        walks: Key of its recordings; it lies beside them, so that those of another version are not gone on with.
    """

    case: Case
    run: Callable[[Case], dict[str, Any]]
    walks: str

    def result(self) -> dict[str, Any]:
        """What running it gives."""
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
