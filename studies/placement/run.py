"""Runs a placement: search, comparison, figures and report."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from stridetwin.batch.executors import BatchOptions, open_executor
from stridetwin.batch.folder import hold_folder
from stridetwin.batch.rows import RowLines
from stridetwin.batch.run import ROWS, Progress
from stridetwin.scenarios.campaign.named_files import SCENARIOS, copy_files, scenario_text
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.files import json_text, whole_file
from stridetwin.streams.samples import Array
from stridetwin.studies.placement.body_map import body_map
from stridetwin.studies.placement.measure import Measure, Measured
from stridetwin.studies.placement.page import placement_page
from stridetwin.studies.placement.problem_file import Place, Problem, check_ends, format_value, plain_of
from stridetwin.studies.placement.request import check_request, keep_request
from stridetwin.studies.placement.search import grid, optimise
from stridetwin.studies.significance import compared, front, in_words, intervals

_USED = "another placement uses it: expected a folder of its own"
_SHOWN = 10
_LONG = 40  # characters: longer labels are replaced by the rank
_ALIKE = 0.05  # share of every range: closer places count as one in the table of a search


@dataclass(frozen=True, kw_only=True)
class Options(BatchOptions):
    """Options of a placement run.

    Attributes:
        seed: First seed of the walks, and that of the search; None takes the file's.
        walks: Number of walks per scenario; None takes the file's.
        resume: Reuses the rows of an earlier run.
    """

    seed: int | None = None
    walks: int | None = None
    resume: bool = False

    def of(self, problem: Problem) -> Problem:
        """The problem with these seeds."""
        seeds = problem.seeds if self.walks is None else tuple(range(self.walks))
        if self.seed is not None:
            seeds = tuple(self.seed + i for i in range(len(seeds)))
        return replace(problem, seeds=seeds)


def run_placement(problem: Problem, options: Options, progress: Progress) -> dict[str, Any]:
    """Searches places and compares them.

    Returns:
        As JSON holds it: `placement`, `scores`, `walks`, `tried`, `table` (places with `label`, `values`, `scores`,
        best first), `comparisons`, `words`, `pareto`, `files`. All places are in `places.csv`.

    Raises:
        StrideTwinError: Any usage error.
    """
    problem, folder = options.of(problem), options.folder
    with hold_folder(folder, (folder / ROWS).exists, _USED) as unfinished:
        check_request(folder, problem, options.resume)
        (folder / SCENARIOS).mkdir(exist_ok=True)
        copy_files(folder, problem.own)
        check_ends(problem, folder)
        keep_request(folder, problem)
        rows = RowLines(folder / ROWS, unfinished)
        with open_executor(options.workers, options.scheduler) as executor:
            measure = Measure(problem, folder, rows, executor, progress)
            searched = _searched(problem, measure)
            losses = _means(searched.losses(problem.scores))
            if not np.isfinite(losses).any():
                weighing = ", ".join(score.name for score in problem.scores if score.weight)
                why = next(filter(None, searched.failed.values()), "the walks do not feed an estimator of this name")
                raise StrideTwinError(f"{problem.path}: scores: no place has all that weigh, {weighing}: {why}")
            shown, final = _finalists(problem, searched, losses, measure)
        rows.sort(measure.keys)
        result = _result(problem, searched, losses, final)
        _write(problem, folder, searched, losses, shown, result)
    return result


def _searched(problem: Problem, measure: Measure) -> Measured:
    """The unchanged place, then all others."""
    if problem.search is None:
        return measure([Place(), *grid(problem.knobs)], problem.seeds, "places")

    def loss(places: list[Place]) -> list[float]:
        return _means(measure(places, problem.seeds, "search").losses(problem.scores)).tolist()

    found = optimise(problem.knobs, problem.search, problem.seeds[0], loss)
    return measure([Place(), *found], problem.seeds, "places")


def _finalists(problem: Problem, searched: Measured, losses: Array, measure: Measure) -> tuple[list[int], Measured]:
    """Numbers of the places of the table, and their scores, on new walks with `confirm`."""
    count = _SHOWN if problem.confirm is None else problem.confirm.places
    best = _apart(problem, searched.places, losses, count)
    shown = best if 0 in best else [*best, 0]
    places = [searched.places[i] for i in shown]
    if problem.confirm is None:
        values = searched.values[shown]
        failed = {k: searched.failed[i] for k, i in enumerate(shown) if i in searched.failed}
        final = Measured(places=places, walks=searched.walks, values=values, failed=failed)
    else:
        first = max(problem.seeds) + 1
        final = measure(places, range(first, first + problem.confirm.walks), "confirm")
    ranks = np.argsort(_means(final.losses(problem.scores)), kind="stable")
    final = Measured(
        places=[final.places[i] for i in ranks],
        walks=final.walks,
        values=final.values[ranks],
        failed={k: final.failed[i] for k, i in enumerate(ranks.tolist()) if i in final.failed},
    )
    return [shown[i] for i in ranks], final


def _apart(problem: Problem, places: Sequence[Place], losses: Array, count: int) -> list[int]:
    """Numbers of the best places; in a search without those close to a better one."""
    kept: list[int] = []
    for i in np.argsort(losses, kind="stable").tolist():
        if len(kept) == count or not np.isfinite(losses[i]):
            break
        if problem.search is None or not any(_alike(problem, places[i], places[k]) for k in kept):
            kept.append(i)
    return kept


def _alike(problem: Problem, a: Place, b: Place) -> bool:
    if not a.values or not b.values:
        return False
    for knob in problem.knobs:
        one, other = a.values[knob.name], b.values[knob.name]
        if (one != other) if knob.values else (abs(one - other) > _ALIKE * (knob.high - knob.low)):
            return False
    return True


def _means(losses: Array) -> Array:
    """(P,) means over walks, infinite where one is missing."""
    return np.where(np.isfinite(losses).all(axis=1), losses.mean(axis=1), np.inf)


def _result(problem: Problem, searched: Measured, losses: Array, final: Measured) -> dict[str, Any]:
    table = []
    columns = [intervals(final.values[:, :, s].T) for s in range(len(problem.scores))]
    for i, place in enumerate(final.places):
        scores = {
            score.name: asdict(columns[s][i])
            for s, score in enumerate(problem.scores)
            if np.isfinite(columns[s][i].mean)
        }
        row = {"rank": i + 1, "label": place.label, "values": dict(place.values), "scores": scores}
        table.append(row | ({"failed": final.failed[i]} if i in final.failed else {}))
    pairs = compared(final.losses(problem.scores))
    names = [
        f"{i + 1} ({place.label})" if len(place.label) < _LONG else f"place {i + 1}"
        for i, place in enumerate(final.places)
    ]
    score_losses = np.column_stack([_means(s.losses(searched.values[..., k])) for k, s in enumerate(problem.scores)])
    return {
        "placement": problem.description,
        "scores": [
            {"name": s.name, "weight": s.weight, "better": "more" if s.higher_is_better else "less"}
            for s in problem.scores
        ],
        "free": [knob.name for knob in problem.knobs],
        "walks": searched.walks,
        "walks_of_table": final.walks,
        "tried": len(searched.places) - 1,
        "failed": len(searched.failed),
        "best": {"label": final.places[0].label, "values": dict(final.places[0].values)},
        "table": table,
        "comparisons": [asdict(pair) | {"first": pair.first + 1, "second": pair.second + 1} for pair in pairs],
        "words": in_words(pairs, names, len(final.walks)),
        "pareto": [
            {
                "label": searched.places[i].label,
                "values": dict(searched.places[i].values),
                "scores": {s.name: float(searched.values[i, :, k].mean()) for k, s in enumerate(problem.scores)},
            }
            for i in (front(score_losses) if len(problem.scores) > 1 else [])
        ],
    }


def _write(
    problem: Problem, folder: Path, searched: Measured, losses: Array, shown: list[int], result: dict[str, Any]
) -> None:
    """Writes all files and adds their names to the result."""
    best = searched.places[shown[0]]
    for base in problem.bases:
        with whole_file(folder / SCENARIOS / f"best_{base.name}.yaml") as file:
            file.write_text(scenario_text(plain_of(problem, base, best)), encoding="utf-8")
    image = body_map(problem, folder, searched, losses, best)
    files = [
        "placement.json",
        "placement.html",
        "places.csv",
        *(f"{SCENARIOS}/best_{b.name}.yaml" for b in problem.bases),
    ]
    if image is not None:
        files.append("body.png")
        with whole_file(folder / "body.png") as file:
            file.write_bytes(image.png)
    else:
        (folder / "body.png").unlink(missing_ok=True)  # of another problem
    result["files"] = files
    texts = {
        "placement.json": json_text(result),
        "places.csv": _csv(problem, searched, losses),
        "placement.html": placement_page(problem, searched, losses, result, image),
    }
    for name, text in texts.items():
        with whole_file(folder / name) as file:
            file.write_text(text, encoding="utf-8")


def _csv(problem: Problem, searched: Measured, losses: Array) -> str:
    """Every place, best first: its values, and the mean of each score."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*(k.name for k in problem.knobs), *(s.name for s in problem.scores), "failed"])
    means = searched.values.mean(axis=1)
    for i in np.argsort(losses, kind="stable").tolist():
        values = searched.places[i].values
        row = [format_value(values[k.name]) if values else "" for k in problem.knobs]
        scores = [f"{x:.6g}" if np.isfinite(x) else "" for x in means[i]]
        writer.writerow([*row, *scores, searched.failed.get(i, "")])
    return out.getvalue()
