"""The experiments by name: their cases, how one is run, and what they come to together."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from stridetwin.scenarios.experiments import (
    dvio_bench,
    dvio_faults,
    jao_faults,
    jao_simulation,
    jao_walk,
    shim_faults,
    shim_figures,
    shim_table5,
    zhao_closed_loop,
    zhao_generality,
)
from stridetwin.scenarios.experiments.case import Case
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
        name: Experiment(
            seeds=zhao_generality.SEEDS,
            run_case=partial(zhao_generality.run_case, poses),
            collect=zhao_generality.collect,
            table=zhao_generality.table,
        )
        for name, poses in (("zhao_generality", "dvio"), ("zhao_generality_given_poses", "given"))
    },
    "dvio_bench": Experiment(
        seeds=dvio_bench.SEEDS, run_case=dvio_bench.run_case, collect=dvio_bench.collect, table=dvio_bench.table
    ),
    "dvio_faults": Experiment(
        seeds=dvio_faults.SEEDS, run_case=dvio_faults.run_case, collect=dvio_faults.collect, table=dvio_faults.table
    ),
}


@dataclass(frozen=True, kw_only=True)
class Asked:
    """How an experiment is to be run.

    Attributes:
        folder: Gets one JSON file a case, as soon as it is done.
        workers: Cases at a time.
        first: First seed; None takes the experiment's.
        subset: Number of cases; None takes all.
        physics: How the body moves, where a body walks.
        resume: Cases whose files are there are not run again, walks that are there are not walked again.
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


def run_experiment(name: str, asked: Asked, progress: Progress) -> dict[str, Any]:
    """Runs the cases of an experiment.

    Args:
        name: Of `EXPERIMENTS`.
        asked: How.
        progress: Told how far it is (0-1).

    Returns:
        `experiment`, `summary`, `paper` and `cases`, as JSON holds them.

    Raises:
        StrideTwinError: There is no such experiment (the message lists those there are), or the folder holds cases of
            another kind of walk.
    """
    experiment = named(name)
    cases = asked.cases(experiment.seeds)
    asked.folder.mkdir(parents=True, exist_ok=True)
    missing = [c for c in cases if not (asked.resume and c.file(".json").exists())]
    progress(name, 1.0 - len(missing) / len(cases))
    for done, (case, result) in enumerate(_results(experiment, missing, asked.workers), 1):
        with whole_file(case.file(".json")) as file:
            file.write_text(json.dumps(result), encoding="utf-8")
        progress(name, 1.0 - (len(missing) - done) / len(cases))
    results = [_read(case) for case in cases]
    result = {"experiment": name, **experiment.collect(results), "cases": results}
    if experiment.report is not None:
        with whole_file(asked.folder / "report.html") as file:
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


def _read(case: Case) -> dict[str, Any]:
    result: dict[str, Any] = json.loads(case.file(".json").read_text(encoding="utf-8"))
    if (physics := result.get("physics", case.physics)) != case.physics:
        raise StrideTwinError(
            f"{case.file('.json')}: physics: {physics} is not valid; valid: {case.physics}, as asked for; "
            "run it anew without --resume, or into another folder"
        )
    return result


def _results(experiment: Experiment, cases: list[Case], workers: int) -> Iterator[tuple[Case, dict[str, Any]]]:
    """Results as they come."""
    if workers == 1:
        yield from ((case, experiment.run_case(case)) for case in cases)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        running = {pool.submit(experiment.run_case, case): case for case in cases}
        for future in as_completed(running):
            yield running[future], future.result()
