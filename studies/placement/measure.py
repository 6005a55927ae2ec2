"""Scores of places on walks, by geometry or recordings.

All places share the walks: differences are paired.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from stridetwin.gate.walk_scores import Job, score_walk
from stridetwin.scenarios.campaign.named_files import SCENARIOS
from stridetwin.scenarios.processes import mapped
from stridetwin.scenarios.record import make_twin, record
from stridetwin.scenarios.scenario_file import Scenario, scenario_of
from stridetwin.scenarios.score_needs import estimators_of, sensors_of, with_sensors_for
from stridetwin.scenarios.versions import digest
from stridetwin.sim.sensors.standard_rig import SensorRig, sensor_rig
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.samples import Array
from stridetwin.streams.validation import suggest
from stridetwin.studies.placement import visibility
from stridetwin.studies.placement.forecast import Forecast
from stridetwin.studies.placement.problem_file import Place, Problem, plain_of
from stridetwin.studies.placement.rows import HIDDEN, Rows, key_of
from stridetwin.studies.placement.scores import GEOMETRIC, Score
from stridetwin.studies.placement.visibility import PosedWalk, geometric_scores, posed_walk


@dataclass(frozen=True, kw_only=True)
class Walk:
    """A walk to be recorded.

    Attributes:
        name: Name of its scenario.
        scenario: Its plain data.
        seed: Seed of everything random in it.
        folder: The placement's folder.
        estimators: Those that are scored; the walk has no other sensors than those that they read.
    """

    name: str
    scenario: dict[str, Any]
    seed: int
    folder: Path
    estimators: frozenset[str]


def recorded_scores(walk: Walk) -> dict[str, Any]:
    """`estimators`, and `failed` with a reason if the walk or an estimator failed. The recording is deleted.

    Raises:
        StrideTwinError: An error that is not specific to this walk, such as a full disk.
    """
    try:
        with tempfile.TemporaryDirectory(prefix=HIDDEN, dir=walk.folder) as name:
            scenario = scenario_of(walk.scenario, walk.folder / SCENARIOS / f"{walk.name}.yaml")
            path = Path(name) / "walk.mcap"
            record(make_twin(_with_sensors_of(walk.estimators, scenario), walk.seed), path, lambda *_: None)
            lenient = bool(scenario.config.faults)
            row = score_walk(Job(name=walk.name, path=path, lenient=lenient, only=walk.estimators))
    except StrideTwinError as error:
        return {"estimators": {}, "failed": {"walk": " ".join(str(error).split())}}
    except OSError as error:
        raise StrideTwinError(f"{error.filename or walk.folder}: {error.strerror or error}") from None
    return {"estimators": row["estimators"], **({"failed": row["failed"]} if "failed" in row else {})}


def _with_sensors_of(estimators: frozenset[str], scenario: Scenario) -> Scenario:
    """The scenario with the sensors of those estimators that it feeds; all of its sensors if it feeds none."""
    feeding = [name for name in estimators if _feeds(scenario, name)]
    return with_sensors_for(scenario, feeding) if feeding else scenario


def _feeds(scenario: Scenario, estimator: str) -> bool:
    try:
        return bool(sensors_of([estimator], scenario.config))
    except StrideTwinError:
        return False


Progress = Callable[[str, float], None]
POSED, RECORDED = "geometric", "recorded"
"""Kinds of rows: scores of a posed walk, and of estimators on a recording."""
_SENSORS_ALONE = ("sensors", "camera_mount", "faults", "ideal_sensors")
_AT_ONCE = 200
_MOST_WALKS = 64  # held in memory, some 20 MB each


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


@dataclass(frozen=True, kw_only=True, eq=False)
class _Visit:
    """One place on one walk.

    Attributes:
        place: Number of the place.
        name: Name of the walk's scenario.
        seed: Seed of the walk.
        plain: Plain data of the scenario with the place.
        scenario: The scenario, or the error message.
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

    def key(self, kind: str, *what: Any) -> str:
        """Key of its row: the whole configuration with its parts; equivalent places share it."""
        scenario = self.needed if kind == RECORDED else self.scenario
        return key_of(kind, scenario if isinstance(scenario, str) else repr(scenario.config), self.seed, *what)


class Measure:
    """Measures places.

    Args:
        problem: Scores and scenarios.
        folder: The placement's; contains the user's parts.
        rows: Rows measured so far.
        workers: Number of walks at a time.
        progress: Receives the stage and its progress (0-1).
    """

    def __init__(self, problem: Problem, folder: Path, rows: Rows, workers: int, progress: Progress) -> None:
        self._problem, self._folder, self._rows = problem, folder, rows
        self._workers, self._progress = workers, progress
        self._posed: dict[str, PosedWalk | str] = {}
        self._names = [s.name for s in problem.scores if s.geometric]
        names = [s.name for s in problem.scores if not s.geometric]
        self._estimators = estimators_of(names, f"{problem.path}: scores")
        self._forecast = Forecast(problem, rows.found, workers)

    def __call__(self, places: Sequence[Place], seeds: Sequence[int], stage: str) -> Measured:
        """Scores of places on the walks of all scenarios with these seeds."""
        scores, walks = self._problem.scores, [(base, seed) for base in self._problem.bases for seed in seeds]
        values = np.full((len(places), len(walks), len(scores)), np.nan)
        failed: dict[int, str] = {}
        self._progress(stage, 0.0)
        for first in range(0, len(places), _AT_ONCE):
            part = places[first : first + _AT_ONCE]
            visits = [visit for i, place in enumerate(part, first) for visit in self._visits(i, place, seeds)]

            def progress(share: float, first: int = first, count: int = len(part)) -> None:
                self._progress(stage, (first + share * count) / len(places))

            seen = self._look(visits, progress) if self._names else [{}] * len(visits)
            recorded = self._record(visits, len(walks), progress) if len(self._names) < len(scores) else seen
            for k, (visit, geometric, row) in enumerate(zip(visits, seen, recorded)):
                at = visit.place, k % len(walks)
                values[at] = [geometric.get("scores", {}).get(s.name, np.nan) if s.geometric
                              else s.of(row.get("estimators", {})) for s in scores]  # fmt: skip
                why = {**geometric.get("failed", {}), **row.get("failed", {})}
                if why and np.isnan(values[at]).any():
                    failed.setdefault(visit.place, "; ".join(f"{name}: {reason}" for name, reason in why.items()))
        names = [f"{base.name}, seed {seed}" for base, seed in walks]
        return Measured(places=list(places), walks=names, values=values, failed=failed)

    def _visits(self, number: int, place: Place, seeds: Sequence[int]) -> Iterator[_Visit]:
        for base in self._problem.bases:
            plain = plain_of(self._problem, base, place)
            scenario: Scenario | str
            try:
                scenario = scenario_of(plain, self._folder / SCENARIOS / f"{base.name}.yaml")
            except StrideTwinError as error:
                scenario = " ".join(str(error).replace(f"{self._folder}/", "").split())
            needed = scenario if isinstance(scenario, str) else _with_sensors_of(self._estimators, scenario)
            for seed in seeds:
                yield _Visit(
                    place=number, name=base.name, seed=seed, plain=plain, scenario=scenario, needed=needed
                )  # fmt: skip

    def _look(self, visits: list[_Visit], progress: Callable[[float], None]) -> list[dict[str, Any]]:
        """Rows with the geometric scores of all visits."""
        seeing, version = vars(self._problem.seeing), _version(visibility.__name__)
        keys = [v.key(POSED, self._names, seeing, version) for v in visits]
        missing = {key: visit for key, visit in zip(keys, visits) if self._rows.get(key) is None}
        posed: Iterator[PosedWalk | str | None] = iter([None] * len(missing))
        if any(GEOMETRIC[name][0] for name in self._names):
            posed = self._plan(list(missing.values()))
        worn: tuple[tuple[int, str], SensorRig] | None = None
        for done, ((key, visit), walk) in enumerate(zip(missing.items(), posed), 1):
            row: dict[str, Any] = {"walk": visit.label, "scores": {}}
            try:
                if isinstance(visit.scenario, str) or isinstance(walk, str):
                    raise StrideTwinError(visit.scenario if isinstance(visit.scenario, str) else str(walk))
                if worn is None or worn[0] != (visit.place, visit.name):
                    worn = (visit.place, visit.name), sensor_rig(visit.scenario.config)
                row["scores"] = geometric_scores(worn[1], walk, self._names, self._problem.seeing)
            except StrideTwinError as error:
                row["failed"] = {"walk": str(error)}
            self._rows.add([(key, row)])
            self._forecast.measured()
            progress(done / len(missing))
        return [self._rows.get(key) or {} for key in keys]

    def _plan(self, visits: list[_Visit]) -> Iterator[PosedWalk | str]:
        """The walk of each visit, planned once for all places that differ only in their sensors."""
        keys, jobs = [], dict[str, tuple[Scenario, int]]()
        for visit in visits:
            body = {k: v for k, v in visit.plain.items() if k not in _SENSORS_ALONE}
            keys.append("" if isinstance(visit.scenario, str) else json.dumps([body, visit.seed], sort_keys=True))
            if not isinstance(visit.scenario, str):
                jobs[keys[-1]] = visit.scenario, visit.seed
        if len(self._posed.keys() | jobs.keys()) > _MOST_WALKS:
            self._posed = {}
        jobs = {key: job for key, job in jobs.items() if key not in self._posed}
        for done, (key, walk) in enumerate(zip(jobs, mapped(_posed, list(jobs.values()), self._workers)), 1):
            self._posed[key] = walk
            self._progress("plan walks", done / len(jobs))
        return (self._posed.get(key, "") for key in keys)

    def _record(self, visits: list[_Visit], walks: int, progress: Callable[[float], None]) -> list[dict[str, Any]]:
        """Rows with the estimators' scores of all visits; each place has so many walks."""
        version = _version(__name__)
        keys = [v.key(RECORDED, version, sorted(self._estimators)) for v in visits]
        jobs = {
            key: Walk(
                name=visit.name, scenario=visit.plain, seed=visit.seed, folder=self._folder, estimators=self._estimators
            )
            for key, visit in zip(keys, visits)
            if self._rows.get(key) is None
        }
        for done, (key, row) in enumerate(zip(jobs, mapped(recorded_scores, list(jobs.values()), self._workers)), 1):
            self._rows.add([(key, {"walk": f"{jobs[key].name}, seed {jobs[key].seed}", **row})])
            if done == walks:
                self._check_scores([self._rows.get(k) or {} for k in list(jobs)[:done]])
            self._forecast.measured()
            progress(done / len(jobs))
        return [self._rows.get(key) or {} for key in keys]

    def _check_scores(self, rows: Sequence[dict[str, Any]]) -> None:
        """Refuses a score that its estimator reports on no walk of the first place, before the others are measured."""
        for score in self._problem.scores:
            reported = [score.reported_instead(row.get("estimators", {})) for row in rows]
            if not score.geometric and all(reported):
                valid = f"a score of its estimator: {suggest(score.metric, sorted(set().union(*reported)))}"
                raise ConfigError(self._problem.path, "scores", score.name, valid)


def _posed(job: tuple[Scenario, int]) -> PosedWalk | str:
    """The walk, or the error message of an infeasible one."""
    try:
        return posed_walk(*job)
    except StrideTwinError as error:
        return " ".join(str(error).split())


@cache
def _version(module: str) -> str:
    return digest(module)
