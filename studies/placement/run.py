"""Runs a placement: search, comparison, figures and report."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stridetwin.batch.executors import BatchOptions, open_executor
from stridetwin.batch.folder import REQUEST, differing_keys, hold_folder, read_request, write_request
from stridetwin.batch.rows import RowLines
from stridetwin.batch.run import ROWS, Progress
from stridetwin.scenarios.campaign.named_files import SCENARIOS, copy_files, scenario_text
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.files import atomic_file, to_json
from stridetwin.studies.placement.body_map import body_map
from stridetwin.studies.placement.free import to_number
from stridetwin.studies.placement.measure import Measure, MeasuredPlaces, mean_losses
from stridetwin.studies.placement.page import placement_page
from stridetwin.studies.placement.problem_file import Place, PlacementProblem, check_ends, format_value, plain_of
from stridetwin.studies.placement.result import PlaceInTable, PlacementResult
from stridetwin.studies.placement.scores import PlaceRow
from stridetwin.studies.placement.search import grid, optimise
from stridetwin.studies.significance import compare_places, comparison_text, intervals, pareto_front

_USED = "another placement uses it: expected a folder of its own"  # message about the output folder
_SHOWN = 10  # places in the table
_LONG = 40  # characters: longer labels are replaced by the rank
_ALIKE = 0.05  # share of every range: closer places count as one in the table of a search


@dataclass(frozen=True, kw_only=True)
class PlacementOptions(BatchOptions):
    """Options of a placement run.

    Attributes:
        seed: First seed of the walks, and that of the search; None takes the file's.
        walks: Number of walks per scenario; None takes the file's.
        resume: Reuses the rows of an earlier run.
    """

    seed: int | None = None
    walks: int | None = None
    resume: bool = False

    def of(self, problem: PlacementProblem) -> PlacementProblem:
        """The problem with the seeds that these options set."""
        seeds = problem.seeds if self.walks is None else tuple(range(self.walks))
        if self.seed is not None:
            seeds = tuple(range(self.seed, self.seed + len(seeds)))
        return replace(problem, seeds=seeds)


def run_placement(problem: PlacementProblem, options: PlacementOptions, progress: Progress) -> PlacementResult:
    """Searches places and compares them.

    Args:
        problem: The placement.
        options: Folder, workers and seeds.
        progress: Receives the stage and its progress (0-1).

    Returns:
        As JSON holds it (`PlacementResult`): above all `table` (places with `label`, `values` and `scores`, best first)
        and `comparisons`, their differences. All places are in `places.csv`.

    Raises:
        StrideTwinError: Any usage error.
    """
    problem = options.of(problem)  # with the seeds of the options
    folder = options.folder
    with hold_folder(folder, (folder / ROWS).exists, _USED) as unfinished:
        _check_folder(folder, problem, options.resume)
        (folder / SCENARIOS).mkdir(exist_ok=True)
        copy_files(folder, problem.user_files)
        check_ends(problem, folder)
        write_request(folder, _request(problem))
        rows: RowLines[PlaceRow] = RowLines(folder / ROWS, unfinished)
        with open_executor(options.workers, options.scheduler) as executor:
            measure = Measure(problem, folder, rows, executor, progress)
            searched = _search(problem, measure)
            if not np.isfinite(searched.losses).any():
                # names of the scores with a weight, and the first reason for a missing score
                weighing = ", ".join(score.name for score in problem.scores if score.weight)
                why = next(filter(None, searched.failed.values()), "the walks do not feed an estimator of this name")
                raise StrideTwinError(f"{problem.path}: scores: no place has all that weigh, {weighing}: {why}")
            final = _measure_finalists(problem, searched, measure)
        rows.sort(measure.keys)
        result = _make_result(problem, searched, final)
        _write(problem, folder, searched, final.places[0], result)
    return result


def _request(problem: PlacementProblem) -> dict[str, object]:
    """What must be equal for a folder's results to be continued, as JSON.

    Seeds, their number and the budget are not part of it, so that more walks or a larger budget continue the results.
    """
    return {
        "placement": problem.description,
        "scenarios": [plain_of(problem, base, Place()) for base in problem.bases],
        "free": [[k.name, k.low, k.high, k.step, list(k.values)] for k in problem.knobs],
        "surfaces": [[free.surface, dict(free.fixed)] for free in problem.free if free.surface is not None],
        "scores": [[score.name, score.weight] for score in problem.scores],
    }


def _check_folder(folder: Path, problem: PlacementProblem, resume: bool) -> None:
    """Refuses results of another command, a placement that is not to be continued, and another placement.

    Args:
        folder: The output folder.
        problem: The placement.
        resume: The user asked to continue.

    Raises:
        StrideTwinError: The folder cannot be used; the message says what to do.
    """
    previous = read_request(folder)  # what the folder was made for; None if it has no request
    if previous is not None and not (isinstance(previous, dict) and "placement" in previous):
        raise StrideTwinError(f"{folder}: holds results of another command: expected another folder")
    if not resume and any((folder / name).exists() for name in (ROWS, REQUEST)):
        raise StrideTwinError(f"{folder}: holds a placement: expected --resume to continue it, or another folder")
    if isinstance(previous, dict) and (keys := differing_keys(_request(problem), previous)):
        description = f"{previous['placement']!r} (other {', '.join(keys)})"
        raise StrideTwinError(f"{folder}: holds another placement, {description}: expected another folder")


def _search(problem: PlacementProblem, measure: Measure) -> MeasuredPlaces:
    """Measures the unchanged place, then all others of the sweep or all that the search tries."""

    def losses(places: list[Place]) -> list[float]:
        """Measures places on all walks and returns their losses, for the search."""
        losses_of_places: list[float] = measure(places, problem.seeds, "search").losses.tolist()
        return losses_of_places

    if problem.search is None:
        places = grid(problem.knobs)
    else:
        places = optimise(problem.knobs, problem.search, problem.seeds[0], losses)
    # what the search has measured is reused from the stored rows
    return measure([Place(), *places], problem.seeds, "places")


def _measure_finalists(problem: PlacementProblem, searched: MeasuredPlaces, measure: Measure) -> MeasuredPlaces:
    """The places of the table, the unchanged one among them, best first.

    Args:
        problem: The placement; with `confirm` the best places are measured again, on walks that the search has not
            used.
        searched: All measured places.
        measure: Measures places.
    """
    count = _SHOWN if problem.confirm is None else problem.confirm.places
    shown = _distinct_best(problem, searched, count)
    final = searched.part(shown if 0 in shown else [*shown, 0])  # place 0 is the unchanged one
    if problem.confirm is not None:
        first = max(problem.seeds) + 1  # seeds that the search has not used
        final = measure(final.places, range(first, first + problem.confirm.walks), "confirm")
    return final.part(final.best_first)  # on the walks of the table, the order may be another one


def _distinct_best(problem: PlacementProblem, searched: MeasuredPlaces, count: int) -> list[int]:
    """Numbers of the best places with a loss, best first; in a search without those close to a better one.

    Args:
        problem: The placement.
        searched: All measured places.
        count: Most places.
    """
    numbers: list[int] = []
    for i in searched.best_first:
        if len(numbers) == count or not np.isfinite(searched.losses[i]):  # places without a loss come last
            break
        place = searched.places[i]
        if problem.search is None or not any(_are_alike(problem, place, searched.places[k]) for k in numbers):
            numbers.append(i)
    return numbers


def _are_alike(problem: PlacementProblem, a: Place, b: Place) -> bool:
    """Whether two places have the same choices, and numbers that differ by at most `_ALIKE` of each range.

    The unchanged scenario, which has no values, is like no place.
    """
    if not a.values or not b.values:
        return False
    for knob in problem.knobs:
        first, second = a.values[knob.name], b.values[knob.name]
        if knob.values:
            is_alike = first == second
        else:
            is_alike = abs(to_number(first) - to_number(second)) <= _ALIKE * (knob.high - knob.low)
        if not is_alike:
            return False
    return True


def _make_result(problem: PlacementProblem, searched: MeasuredPlaces, final: MeasuredPlaces) -> PlacementResult:
    """The result of `run_placement` as JSON holds it, without the files.

    Args:
        problem: The placement.
        searched: All measured places, from which the Pareto front comes.
        final: Places of the table, best first.
    """
    names = [score.name for score in problem.scores]
    # for each score, the mean of each place over the walks with its interval
    columns = [intervals(values.T) for values in np.moveaxis(final.values, 2, 0)]
    table: list[PlaceInTable] = []
    for i, place in enumerate(final.places):
        scores = {name: column[i].row() for name, column in zip(names, columns) if np.isfinite(column[i].mean)}
        row: PlaceInTable = {"rank": i + 1, "label": place.label, "values": dict(place.values), "scores": scores}
        if i in final.failed:
            row["failed"] = final.failed[i]
        table.append(row)
    pairs = compare_places(final.losses_of_walks)
    labels = [place.label for place in final.places]
    # the place of each rank in the sentences: with its label, unless that is long
    place_names = [f"{i} ({name})" if len(name) < _LONG else f"place {i}" for i, name in enumerate(labels, 1)]
    # for each score, (P,) losses of all measured places, for the Pareto front
    losses = [mean_losses(score.losses(searched.values[..., s])) for s, score in enumerate(problem.scores)]
    best = pareto_front(np.column_stack(losses)) if len(names) > 1 else []
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
        "best": {"label": table[0]["label"], "values": table[0]["values"]},
        "table": table,
        "comparisons": [
            # places are named by their rank, from 1
            {
                "first": p.first + 1,
                "second": p.second + 1,
                "difference": p.mean,
                "low": p.low,
                "high": p.high,
                "p": p.p,
                "significant": p.significant,
            }
            for p in pairs
        ],
        "words": comparison_text(pairs, place_names, len(final.walks)),
        "pareto": [
            {
                "label": searched.places[i].label,
                "values": dict(searched.places[i].values),
                "scores": {name: float(values.mean()) for name, values in zip(names, searched.values[i].T)},
            }
            for i in best
        ],
    }


def _write(
    problem: PlacementProblem, folder: Path, searched: MeasuredPlaces, best: Place, result: PlacementResult
) -> None:
    """Writes all files of a placement and adds their names to its result, as `files`.

    Args:
        problem: The placement.
        folder: The output folder.
        searched: All measured places.
        best: The best place.
        result: The result, which is changed.
    """
    texts = {
        f"{SCENARIOS}/best_{base.name}.yaml": scenario_text(plain_of(problem, base, best)) for base in problem.bases
    }
    image = body_map(problem, folder, searched, best)
    files = ["placement.json", "placement.html", "places.csv", *texts]
    if image is not None:
        files.append("body.png")
        with atomic_file(folder / "body.png") as file:
            file.write_bytes(image.png)
    else:
        (folder / "body.png").unlink(missing_ok=True)  # the map of an earlier run, in which a sensor moved
    result["files"] = files
    texts["placement.json"] = to_json(result)
    texts["places.csv"] = _csv(problem, searched)
    texts["placement.html"] = placement_page(problem, searched, result, image)
    for name, text in texts.items():
        with atomic_file(folder / name) as file:
            file.write_text(text, encoding="utf-8")


def _csv(problem: PlacementProblem, searched: MeasuredPlaces) -> str:
    """All places as CSV, best first: values, mean of each score, and the reason for a missing one."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*(k.name for k in problem.knobs), *(s.name for s in problem.scores), "failed"])
    for i in searched.best_first:
        values = searched.places[i].values
        row = [format_value(values[k.name]) if values else "" for k in problem.knobs]  # the unchanged place has none
        scores = [f"{x:.6g}" if np.isfinite(x) else "" for x in searched.means[i]]
        writer.writerow([*row, *scores, searched.failed.get(i, "")])
    return out.getvalue()
