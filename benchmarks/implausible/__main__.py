"""Implausible recordings: whether what ruins an estimate is reported with its cause, without false alarms.

`python -m benchmarks.implausible [--count 200] [--clean 300] [--catalogue 60] [--seed 1000] [--only NAME ...]
[--workers 1] [--json]`.
Good recordings of generated walks are corrupted at random as recorders, drivers and users do (`corruptions`), in every
format of other tools (`files`), and opened and checked. A corruption is `right` if a report names its cause, `other` if
something else was reported, else silent. Where nothing right was reported, the estimates (`foot_ins`, `dvio`,
`terrain_map`) are compared with those of the good recording: the corruption matters if one changes by more than 5 % of
the way, or of the height of the eyes. Then clean recordings of all parts, and walks of the catalogue, are checked:
what names a cause is a false alarm. Cases are drawn by the seed; seeds below 1000 are for tuning.
"""

from __future__ import annotations

import sys
import tempfile
import time
from argparse import Namespace
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from itertools import repeat
from pathlib import Path
from typing import Any, TypeVar

from benchmarks.command import answer, command
from benchmarks.implausible.clean import CleanCase, CleanTrial, check_catalogue_walk, check_clean
from benchmarks.implausible.corruptions import CORRUPTIONS
from benchmarks.implausible.files import FORMATS
from benchmarks.implausible.trials import (
    LEAST_CHANGE,
    RIGHT,
    SILENT,
    Case,
    Trial,
    draw_cases,
    list_clean_reports,
    try_case,
)
from benchmarks.implausible.walks import build_walk
from stridetwin.batch.processes import open_pool

ResultT = TypeVar("ResultT")


def measure(arguments: Namespace) -> dict[str, Any]:
    """Trials of all cases, counts by corruption and format, and the clean recordings with false alarms."""
    with open_pool(arguments.workers) as pool, tempfile.TemporaryDirectory() as folder:
        cases = list(draw_cases(arguments.count, arguments.seed, Path(folder), arguments.only))
        trials = _try_cases(pool, cases, arguments.estimate_all)
        clean = [
            *_run(pool, check_clean, [CleanCase(number=i, seed=arguments.seed) for i in range(arguments.clean)]),
            *_run(
                pool,
                check_catalogue_walk,
                [CleanCase(number=i, seed=arguments.seed) for i in range(arguments.catalogue)],
            ),
        ]
    return {
        "benchmark": "implausible",
        "seed": arguments.seed,
        "summary": summarise(trials, clean),
        "corruptions": count_by_corruption(trials),
        "trials": [asdict(trial) for trial in trials],
        "clean": [asdict(trial) for trial in clean if trial.alarms],
    }


def _try_cases(pool: ProcessPoolExecutor, cases: Iterable[Case], always_estimate: bool) -> list[Trial]:
    """Generates the good walks that the cases need, checks these, and then tries the cases; trials by number."""
    # neighbours have the same walk and format, so that what a process keeps of these is used again
    cases = sorted(cases, key=lambda case: (case.walk, case.form, case.number))
    _run(pool, build_walk, sorted({case.walk for case in cases}), repeat(cases[0].seed if cases else 0))
    recordings = sorted({(case.form, case.walk) for case in cases}, key=lambda r: (r[1], r[0]))
    reports = _run(pool, list_clean_reports, *zip(*recordings)) if recordings else []
    of_recording = dict(zip(recordings, reports))
    clean_reports = [of_recording[case.form, case.walk] for case in cases]
    trials = _run(pool, try_case, cases, clean_reports, repeat(always_estimate))
    return sorted(trials, key=lambda trial: trial.number)


def _run(
    pool: ProcessPoolExecutor, function: Callable[..., ResultT], jobs: Sequence[object], *more: Iterable[object]
) -> list[ResultT]:
    """Results of a function for all jobs in their order; every half minute their number goes to stderr.

    Args:
        pool: Runs the jobs.
        function: Takes a job, and an item of each of `more`.
        jobs: First arguments.
        more: Further arguments, an item for each job.
    """
    results: list[ResultT] = []
    last = time.monotonic()
    for result in pool.map(function, jobs, *more):
        results.append(result)
        if time.monotonic() - last > 30:
            print(f"{function.__name__}: {len(results)} of {len(jobs)}", file=sys.stderr, flush=True)
            last = time.monotonic()
    return results


def summarise(trials: Sequence[Trial], clean: Sequence[CleanTrial]) -> dict[str, float]:
    """Figures of the acceptance: share of the corruptions that matter which are right, and of false alarms.

    Corruptions that were reported right count as such that matter, unless it was estimated that they do not.
    """
    right = [t for t in trials if t.outcome == RIGHT and (t.change is None or t.is_harmful)]
    missed = [t for t in trials if t.outcome != RIGHT and t.is_harmful]
    relevant = len(right) + len(missed)
    alarms = sum(bool(trial.alarms) for trial in clean)
    return {
        "corruptions": len(trials),
        "that matter": relevant,
        "reported with the right cause": len(right),
        "silent, no estimate to compare": sum(t.outcome == SILENT and t.change is None for t in trials),
        "right, %": 100.0 * len(right) / max(1, relevant),
        "clean recordings": len(clean),
        "false alarms": alarms,
        "false alarms, %": 100.0 * alarms / max(1, len(clean)),
    }


_COLUMNS = ("count", "right", "other", "other, harmful", "silent", "silent, harmful")
"""Columns of the table: cases, and their outcomes; harmful are those that change an estimate."""


def count_by_corruption(trials: Iterable[Trial]) -> dict[str, dict[str, int]]:
    """Counts of outcomes by `corruption, family of formats`, in the order of the corruptions."""
    counts: dict[str, dict[str, int]] = {}
    order = list(CORRUPTIONS)
    for trial in sorted(trials, key=lambda t: (order.index(t.corruption), FORMATS[t.form].family)):
        row = counts.setdefault(f"{trial.corruption}, {FORMATS[trial.form].family}", dict.fromkeys(_COLUMNS, 0))
        row["count"] += 1
        row[trial.outcome] += 1
        if trial.outcome != RIGHT and trial.is_harmful:
            row[f"{trial.outcome}, harmful"] += 1
    return counts


def show(result: dict[str, Any]) -> None:
    """Prints the table, the corruptions that matter and were not reported right, the false alarms and the summary."""
    print(f"{'corruption, format':32}" + "".join(f"{name:>16}" for name in _COLUMNS))
    for name, row in result["corruptions"].items():
        print(f"{name:32}" + "".join(f"{row[column] or '-':>16}" for column in _COLUMNS))
    for trial in result["trials"]:
        if trial["outcome"] != RIGHT and (trial["change"] or 0.0) > LEAST_CHANGE:
            reports = "; ".join(trial["reports"]) or "no report"
            print(
                f"missed {trial['number']}: {trial['corruption']} ({trial['what']}) in {trial['form']}, "
                f"changes an estimate by {trial['change']:.0%}: {reports}"[:600]
            )
    for trial in result["clean"]:
        print(f"false alarm, seed {trial['seed']}, {trial['part']}: {'; '.join(trial['alarms'])}"[:400])
    print(", ".join(f"{name} {value:.4g}" for name, value in result["summary"].items()))


if __name__ == "__main__":
    names = sorted({*CORRUPTIONS, *FORMATS, *(form.family for form in FORMATS.values())})
    parser = command(__doc__)
    parser.add_argument("--count", type=int, default=200, help="corruptions")
    parser.add_argument("--clean", type=int, default=300, help="clean recordings")
    parser.add_argument("--catalogue", type=int, default=60, help="clean walks of the catalogue")
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--only", nargs="+", choices=names, default=[], metavar="NAME", help=f"of {', '.join(names)}")
    parser.add_argument("--estimate-all", action="store_true", help="estimate from corruptions that are reported, too")
    parser.add_argument("--workers", type=int, default=1)
    raise SystemExit(answer(parser, measure, show))
