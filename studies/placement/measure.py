"""Scores of places on walks, by geometry or recordings; all places share the walks: differences are paired."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from stridetwin.evaluation.gate.walk_scores import Job, score_walk
from stridetwin.scenarios.campaign.named_files import SCENARIOS, Base
from stridetwin.scenarios.processes import mapped
from stridetwin.scenarios.record import make_twin, record
from stridetwin.scenarios.scenario_file import Scenario, scenario_of
from stridetwin.scenarios.versions import digest
from stridetwin.sim.sensors.standard_rig import SensorRig, sensor_rig
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.samples import Array
from stridetwin.studies.placement import geometric
from stridetwin.studies.placement.geometric import geometric_scores
from stridetwin.studies.placement.places import Place, plain_of
from stridetwin.studies.placement.posed_walk import PosedWalk, posed_walk
from stridetwin.studies.placement.problem_file import Problem
from stridetwin.studies.placement.rows import HIDDEN, Rows, key_of
from stridetwin.studies.placement.scores import GEOMETRIC, Score


@dataclass(frozen=True, kw_only=True)
class Walk:
    """A walk to be recorded.

    Attributes:
        name: Name of its scenario.
        scenario: Its plain data.
        seed: Seed of everything random in it.
        folder: The placement's folder.
    """

    name: str
    scenario: dict[str, Any]
    seed: int
    folder: Path


def recorded_scores(walk: Walk) -> dict[str, Any]:
    """`estimators`, and `failed` with a reason if the walk or an estimator failed. The recording is deleted.

    Raises:
        StrideTwinError: An error that is not specific to this walk, such as a full disk.
    """
    try:
        with tempfile.TemporaryDirectory(prefix=HIDDEN, dir=walk.folder) as name:
            scenario = scenario_of(walk.scenario, walk.folder / SCENARIOS / f"{walk.name}.yaml")
            path = Path(name) / "walk.mcap"
            record(make_twin(scenario, walk.seed), path, lambda *_: None)
            row = score_walk(Job(name=walk.name, path=path, lenient=bool(scenario.config.faults)))
    except StrideTwinError as error:
        return {"estimators": {}, "failed": {"walk": " ".join(str(error).split())}}
    except OSError as error:
        raise StrideTwinError(f"{error.filename or walk.folder}: {error.strerror or error}") from None
    return {"estimators": row["estimators"], **({"failed": row["failed"]} if "failed" in row else {})}


Progress = Callable[[str, float], None]
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

    def __call__(self, places: Sequence[Place], seeds: Sequence[int], stage: str) -> Measured:
        """Scores of places on the walks of all scenarios with these seeds."""
        problem = self._problem
        walks = [(base, seed) for base in problem.bases for seed in seeds]
        values = np.full((len(places), len(walks), len(problem.scores)), np.nan)
        failed: dict[int, str] = {}
        for first in range(0, len(places), _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            plain = [{base.name: plain_of(problem, base, place) for base in problem.bases} for place in places[part]]
            scenarios = [{name: self._scenario(name, data) for name, data in own.items()} for own in plain]
            said = (stage, first / len(places), len(plain) / len(places))
            rows: list[list[dict[str, Any]]] = [[{} for _ in walks] for _ in plain]
            if self._names:
                self._look(plain, scenarios, walks, rows, said)
            if len(self._names) < len(problem.scores):
                self._record(plain, scenarios, walks, rows, said)
            for i, own in enumerate(rows):
                for j, row in enumerate(own):
                    values[first + i, j] = [row.get("scores", {}).get(s.name, np.nan) if s.geometric
                                            else s.of(row.get("estimators", {})) for s in problem.scores]  # fmt: skip
                    if "failed" in row and np.isnan(values[first + i, j]).any():
                        failed.setdefault(first + i, "; ".join(f"{n}: {why}" for n, why in row["failed"].items()))
        names = [f"{base.name}, seed {seed}" for base, seed in walks]
        return Measured(places=list(places), walks=names, values=values, failed=failed)

    def _look(
        self,
        plain: list[dict[str, Any]],
        scenarios: list[dict[str, Scenario | str]],
        walks: list[tuple[Base, int]],
        rows: list[list[dict[str, Any]]],
        said: tuple[str, float, float],
    ) -> None:
        """Adds the geometric scores to the rows."""
        seeing, version = vars(self._problem.seeing), _version(geometric.__name__)
        keys = [[_key("geometric", own[base.name], seed, self._names, seeing, version) for base, seed in walks]
                for own in scenarios]  # fmt: skip
        new = {key: (i, j) for i, own in enumerate(keys) for j, key in enumerate(own) if self._rows.get(key) is None}
        missing = list(new.values())
        posed: Iterator[PosedWalk | str | None] = iter([None] * len(missing))
        if any(GEOMETRIC[name][0] for name in self._names):
            posed = self._plan([(plain[i], scenarios[i], *walks[j]) for i, j in missing])
        worn: tuple[tuple[int, str], SensorRig] | None = None
        for done, ((i, j), walk) in enumerate(zip(missing, posed), 1):
            name = walks[j][0].name
            scenario = scenarios[i][name]
            row: dict[str, Any] = {"walk": f"{name}, seed {walks[j][1]}", "scores": {}}
            try:
                if isinstance(scenario, str) or isinstance(walk, str):
                    raise StrideTwinError(scenario if isinstance(scenario, str) else str(walk))
                if worn is None or worn[0] != (i, name):
                    worn = (i, name), sensor_rig(scenario.config)
                row["scores"] = geometric_scores(worn[1], walk, self._names, self._problem.seeing)
            except StrideTwinError as error:
                row["failed"] = {"walk": str(error)}
            self._rows.add([(keys[i][j], row)])
            self._progress(said[0], said[1] + said[2] * done / len(missing))
        for i, own in enumerate(keys):
            for j, key in enumerate(own):
                rows[i][j] |= self._rows.get(key) or {}

    def _scenario(self, name: str, plain: dict[str, Any]) -> Scenario | str:
        """A place's scenario, or the error message."""
        try:
            return scenario_of(plain, self._folder / SCENARIOS / f"{name}.yaml")
        except StrideTwinError as error:
            return " ".join(str(error).replace(f"{self._folder}/", "").split())

    def _plan(
        self, walks: list[tuple[dict[str, Any], dict[str, Scenario | str], Base, int]]
    ) -> Iterator[PosedWalk | str]:
        """The walk of each, planned once for all places that differ only in their sensors."""
        keys, jobs = [], dict[str, tuple[Scenario, int]]()
        for plain, scenarios, base, seed in walks:
            body = {k: v for k, v in plain[base.name].items() if k not in _SENSORS_ALONE}
            scenario = scenarios[base.name]
            keys.append("" if isinstance(scenario, str) else json.dumps([body, seed], sort_keys=True))
            if not isinstance(scenario, str):
                jobs[keys[-1]] = scenario, seed
        if len(self._posed.keys() | jobs.keys()) > _MOST_WALKS:
            self._posed = {}
        jobs = {key: job for key, job in jobs.items() if key not in self._posed}
        for done, (key, walk) in enumerate(zip(jobs, mapped(_posed, list(jobs.values()), self._workers)), 1):
            self._posed[key] = walk
            self._progress("plan walks", done / len(jobs))
        return (self._posed.get(key, "") for key in keys)

    def _record(
        self,
        plain: list[dict[str, Any]],
        scenarios: list[dict[str, Scenario | str]],
        walks: list[tuple[Base, int]],
        rows: list[list[dict[str, Any]]],
        said: tuple[str, float, float],
    ) -> None:
        """Adds the estimators' scores to the rows."""
        version = _version(__name__)
        keys = [[_key("recorded", own[base.name], seed, version) for base, seed in walks] for own in scenarios]
        jobs: dict[str, Walk] = {}
        for own, found in zip(plain, keys):
            for (base, seed), key in zip(walks, found):
                if self._rows.get(key) is None:
                    jobs[key] = Walk(name=base.name, scenario=own[base.name], seed=seed, folder=self._folder)
        for done, (key, row) in enumerate(zip(jobs, mapped(recorded_scores, list(jobs.values()), self._workers)), 1):
            walk = jobs[key]
            self._rows.add([(key, {"walk": f"{walk.name}, seed {walk.seed}", **row})])
            if done == len(walks):
                self._check_scores([self._rows.get(k) or {} for k in list(jobs)[:done]])
            self._progress(said[0], said[1] + said[2] * done / len(jobs))
        for i, found in enumerate(keys):
            for j, key in enumerate(found):
                row = self._rows.get(key) or {}
                rows[i][j] |= row | {"failed": {**rows[i][j].get("failed", {}), **row.get("failed", {})}}

    def _check_scores(self, rows: Sequence[dict[str, Any]]) -> None:
        """Refuses a score that its estimator reports on no walk of the first place, before the others are measured."""
        for score in self._problem.scores:
            reported = [score.reported_instead(row.get("estimators", {})) for row in rows]
            if not score.geometric and all(reported):
                valid = f"of this estimator: {', '.join(sorted(set().union(*reported)))}"
                raise ConfigError(self._problem.path, "scores", score.name, valid)


def _key(kind: str, scenario: Scenario | str, *what: Any) -> str:
    """Key of a row: the whole configuration with its parts; equivalent places share it."""
    return key_of(kind, scenario if isinstance(scenario, str) else repr(scenario.config), *what)


def _posed(job: tuple[Scenario, int]) -> PosedWalk | str:
    """The walk, or the error message of an infeasible one."""
    try:
        return posed_walk(*job)
    except StrideTwinError as error:
        return " ".join(str(error).split())


@cache
def _version(module: str) -> str:
    return digest(module)
