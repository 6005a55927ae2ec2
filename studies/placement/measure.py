"""Scores of places on walks, by geometry or recordings.

All places share the walks: differences are paired.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np

from stridetwin.batch.executors import Executor
from stridetwin.batch.folder import UNFINISHED
from stridetwin.batch.jobs import Failure, Job, Row, Work, content_key, one_by_one
from stridetwin.batch.rows import RowLines
from stridetwin.batch.run import Batch, Progress
from stridetwin.batch.versions import code_versions
from stridetwin.gate.walk_scores import Job as ScoreJob
from stridetwin.gate.walk_scores import score_walk, scoring_versions
from stridetwin.scenarios.campaign.named_files import SCENARIOS
from stridetwin.scenarios.record import make_twin, record
from stridetwin.scenarios.scenario_file import Scenario, scenario_of
from stridetwin.scenarios.score_needs import estimators_of, sensors_of, with_sensors_for
from stridetwin.sim.sensors.standard_rig import sensor_rig
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.samples import Array
from stridetwin.streams.validation import suggest
from stridetwin.studies.placement import visibility
from stridetwin.studies.placement.forecast import placement_forecast
from stridetwin.studies.placement.problem_file import Place, Problem, plain_of
from stridetwin.studies.placement.scores import GEOMETRIC, Score, Seeing
from stridetwin.studies.placement.visibility import PosedWalk, geometric_scores, posed_walk

POSED, RECORDED = "geometric", "recorded"
"""Kinds of rows: scores of a posed walk, and of estimators on a recording."""
_SENSORS_ALONE = ("sensors", "camera_mount", "faults", "ideal_sensors")
_MAX_PLACES = 200  # that are measured before the next ones are read
_MAX_GROUP = 25  # places that one worker scores on a walk in one go
_MAX_POSED_WALKS = 64  # that a process holds in memory, some 20 MB each


@dataclass(frozen=True, kw_only=True, eq=False)
class Visit:
    """One place on one walk.

    Attributes:
        place: Number of the place.
        name: Name of the walk's scenario.
        seed: Seed of the walk.
        plain: Plain data of the scenario with the place.
        scenario: The scenario, or the error message of an invalid one.
        needed: The same with no other sensors than those that the scored estimators read.
    """

    place: int
    name: str
    seed: int
    plain: dict[str, Any]
    scenario: Scenario | str
    needed: Scenario | str

    @property
    def label(self) -> str:
        """Its walk as text."""
        return f"{self.name}, seed {self.seed}"

    @property
    def walk(self) -> str:
        """Identifies the walk: visits that differ in their sensors alone share it; "" if the scenario is invalid."""
        if isinstance(self.scenario, str):
            return ""
        body = {k: v for k, v in self.plain.items() if k not in _SENSORS_ALONE}
        return content_key(body, self.seed)

    def key(self, kind: str, *what: Any) -> str:
        """Key of its row: the whole configuration with its parts; equivalent places share it."""
        scenario = self.needed if kind == RECORDED else self.scenario
        config = scenario if isinstance(scenario, str) else repr(scenario.config)
        return content_key(kind, config, self.seed, *what)


def score_recording(folder: Path, estimators: frozenset[str], visit: Visit) -> Row:
    """A row: `walk`, `estimators`, and `failed` with a reason if the walk or an estimator failed.

    Args:
        folder: The placement's folder; the recording lies there until it is scored.
        estimators: Those that are scored; the walk has no other sensors than those that they read.
        visit: The place and the walk.

    Raises:
        StrideTwinError: An error that is not specific to this walk, such as a full disk.
    """
    row: Row = {"walk": visit.label, "estimators": {}}
    try:
        with tempfile.TemporaryDirectory(dir=folder / UNFINISHED) as name:
            if isinstance(visit.needed, str):
                raise StrideTwinError(visit.needed)
            path = Path(name) / "walk.mcap"
            record(make_twin(visit.needed, visit.seed), path, lambda *_: None)
            lenient = bool(visit.needed.config.faults)
            scored = score_walk(ScoreJob(name=visit.name, path=path, lenient=lenient, only=estimators))
    except StrideTwinError as error:
        return row | {"failed": {"walk": _one_line(error, folder)}}
    except OSError as error:
        raise StrideTwinError(f"{error.filename or folder}: {error.strerror or error}") from None
    return row | {key: scored[key] for key in ("estimators", "failed") if key in scored}


def _one_line(error: StrideTwinError, folder: Path) -> str:
    """The message on one line, without the placement's path on this machine."""
    return " ".join(str(error).replace(f"{folder}/", "").split())


def _with_sensors_of(estimators: frozenset[str], scenario: Scenario) -> Scenario:
    """The scenario with the sensors of those estimators that it feeds; all of its sensors if it feeds none."""
    feeding = [name for name in estimators if _feeds(scenario, name)]
    return with_sensors_for(scenario, feeding) if feeding else scenario


def _feeds(scenario: Scenario, estimator: str) -> bool:
    try:
        return bool(sensors_of([estimator], scenario.config))
    except StrideTwinError:
        return False


def score_posed(names: Sequence[str], seeing: Seeing, run: str, visit: Visit) -> Row:
    """A row: `walk`, `scores`, and `failed` with a reason if the place or the walk is infeasible.

    Args:
        names: The scores.
        seeing: When a board counts as seen.
        run: Identifies the run of the placement, whose walks are kept in memory.
        visit: The place and the walk.
    """
    row: Row = {"walk": visit.label, "scores": {}}
    try:
        if isinstance(visit.scenario, str):
            raise StrideTwinError(visit.scenario)
        needs_walk = any(GEOMETRIC[name][0] for name in names)
        walk = _posed_walk(run, visit.walk, visit.scenario, visit.seed) if needs_walk else None
        row["scores"] = geometric_scores(sensor_rig(visit.scenario.config), walk, names, seeing)
    except StrideTwinError as error:
        row["failed"] = {"walk": str(error)}
    return row


_posed_walks: dict[tuple[str, str], PosedWalk | str] = {}
"""The walks of one run, or the messages of infeasible ones, by the run's and the walk's names."""


def _posed_walk(run: str, name: str, scenario: Scenario, seed: int) -> PosedWalk:
    """The walk, planned once in each process for all places that share it.

    Raises:
        StrideTwinError: It is infeasible.
    """
    key = run, name
    if key not in _posed_walks:
        if len(_posed_walks) == _MAX_POSED_WALKS or any(other != run for other, _ in _posed_walks):
            _posed_walks.clear()
        try:
            _posed_walks[key] = posed_walk(scenario, seed)
        except StrideTwinError as error:
            _posed_walks[key] = " ".join(str(error).split())
    walk = _posed_walks[key]
    if isinstance(walk, str):
        raise StrideTwinError(walk)
    return walk


@dataclass(frozen=True, kw_only=True, eq=False)
class Measured:
    """Scores of P places on W walks.

    Attributes:
        places: P of them.
        walks: Descriptions of the W walks.
        values: (P, W, S) scores in the problem's order; NaN where a score is missing.
        failed: Reason for a missing score, by the place's number.
    """

    places: list[Place]
    walks: list[str]
    values: Array
    failed: dict[int, str] = field(default_factory=dict)

    def losses(self, scores: Sequence[Score]) -> Array:
        """(P, W) weighted sum of the scores, lower is better; NaN where one is missing."""
        parts = [s.weight * s.losses(self.values[..., i]) for i, s in enumerate(scores) if s.weight]
        return np.asarray(np.sum(parts, axis=0))


class Measure:
    """Measures places.

    Args:
        problem: Scores and scenarios.
        folder: The placement's; contains the user's parts.
        rows: Rows measured so far.
        executor: Where walks are simulated and scored.
        progress: Receives the stage and its progress (0-1).

    Attributes:
        keys: Keys of the rows of all measured places, in order.
    """

    def __init__(self, problem: Problem, folder: Path, rows: RowLines, executor: Executor, progress: Progress) -> None:
        self._problem, self._folder, self._rows = problem, folder.absolute(), rows
        self._executor, self._progress = executor, progress
        self._names = tuple(s.name for s in problem.scores if s.geometric)
        names = [s.name for s in problem.scores if not s.geometric]
        self._estimators = estimators_of(names, f"{problem.path}: scores")
        self._forecast = placement_forecast(problem, len(rows))
        self._run_name, self._is_checked = uuid4().hex, False
        self.keys: list[str] = []

    def __call__(self, places: Sequence[Place], seeds: Sequence[int], stage: str) -> Measured:
        """Scores of places on the walks of all scenarios with these seeds."""
        scores, walks = self._problem.scores, [(base, seed) for base in self._problem.bases for seed in seeds]
        values = np.full((len(places), len(walks), len(scores)), np.nan)
        failed: dict[int, str] = {}
        for first in range(0, len(places), _MAX_PLACES):
            part = places[first : first + _MAX_PLACES]
            visits = [visit for i, place in enumerate(part, first) for visit in self._visits(i, place, seeds)]

            def progress(share: float, first: int = first, count: int = len(part)) -> None:
                self._progress(stage, (first + share * count) / len(places))

            posed = self._score_posed(visits, progress) if self._names else [{}] * len(visits)
            recorded = self._score_recordings(visits, len(walks), progress) if len(self._names) < len(scores) else posed
            for k, (visit, geometric, row) in enumerate(zip(visits, posed, recorded)):
                at = visit.place, k % len(walks)
                values[at] = [geometric.get("scores", {}).get(s.name, np.nan) if s.geometric
                              else s.of(row.get("estimators", {})) for s in scores]  # fmt: skip
                why = {**geometric.get("failed", {}), **row.get("failed", {})}
                if why and np.isnan(values[at]).any():
                    failed.setdefault(visit.place, "; ".join(f"{name}: {reason}" for name, reason in why.items()))
        names = [f"{base.name}, seed {seed}" for base, seed in walks]
        return Measured(places=list(places), walks=names, values=values, failed=failed)

    def _visits(self, number: int, place: Place, seeds: Sequence[int]) -> Iterator[Visit]:
        for base in self._problem.bases:
            plain = plain_of(self._problem, base, place)
            scenario: Scenario | str
            try:
                scenario = scenario_of(plain, self._folder / SCENARIOS / f"{base.name}.yaml")
            except StrideTwinError as error:
                scenario = _one_line(error, self._folder)
            needed = scenario if isinstance(scenario, str) else _with_sensors_of(self._estimators, scenario)
            for seed in seeds:
                yield Visit(
                    place=number, name=base.name, seed=seed, plain=plain, scenario=scenario, needed=needed
                )  # fmt: skip

    def _score_posed(self, visits: list[Visit], progress: Callable[[float], None]) -> list[Row]:
        """Rows with the geometric scores of all visits."""
        versions = partial(code_versions, visibility.__name__)
        seeing, sources = self._problem.seeing, versions()["sources"]
        jobs, walks = [], Counter[str]()
        for visit in visits:
            key = visit.key(POSED, self._names, vars(seeing), sources)
            group = f"{visit.walk} {walks[visit.walk] // _MAX_GROUP}"
            walks[visit.walk] += 1
            jobs.append(Job(name=visit.label, key=key, task=visit, group=group))
        score = partial(score_posed, self._names, seeing, self._run_name)
        return self._run(jobs, Work(run=one_by_one(score), versions=versions), progress)

    def _score_recordings(self, visits: list[Visit], walks: int, progress: Callable[[float], None]) -> list[Row]:
        """Rows with the estimators' scores of all visits; each place has so many walks."""
        versions = partial(scoring_versions, __name__, tuple(sorted(self._estimators)))
        jobs = [Job(name=visit.label, key=visit.key(RECORDED, versions()), task=visit) for visit in visits]
        work = Work(run=one_by_one(partial(score_recording, self._folder, self._estimators)), versions=versions)
        if not self._is_checked:
            share = walks / len(jobs)
            self._check_scores(self._run(jobs[:walks], work, lambda done: progress(share * done)))
            self._is_checked = True
        return self._run(jobs, work, progress)

    def _run(self, jobs: Sequence[Job[Any]], work: Work[Any, Row], progress: Callable[[float], None]) -> list[Row]:
        self.keys += [job.key for job in jobs]
        results = Batch(jobs, self._rows).run(work, self._executor, progress, self._forecast)
        return [{"failed": {"walk": row.reason}} if isinstance(row, Failure) else row for row in results]

    def _check_scores(self, rows: Sequence[Row]) -> None:
        """Refuses a score that its estimator reports on no walk of the first place, before the others are measured."""
        for score in self._problem.scores:
            reported = [score.reported_instead(row.get("estimators", {})) for row in rows]
            if not score.geometric and all(reported):
                valid = f"a score of its estimator: {suggest(score.metric, sorted(set().union(*reported)))}"
                raise ConfigError(self._problem.path, "scores", score.name, valid)
