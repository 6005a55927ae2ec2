"""Scores of places on walks, by geometry or recordings. All places share the walks: differences are paired."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from uuid import uuid4

import numpy as np

from stridetwin.batch.executors import Executor
from stridetwin.batch.folder import UNFINISHED
from stridetwin.batch.forecast import Forecast
from stridetwin.batch.jobs import Failure, Job, Work, content_key, one_by_one
from stridetwin.batch.rows import RowLines
from stridetwin.batch.run import Batch, Progress
from stridetwin.batch.versions import code_versions
from stridetwin.gate.walk_scores import ScoringJob, score_walk, scoring_versions
from stridetwin.scenarios.campaign.named_files import SCENARIOS
from stridetwin.scenarios.record import make_twin, record
from stridetwin.scenarios.scenario_file import Scenario, scenario_of
from stridetwin.scenarios.score_needs import estimators_of, sensors_of, with_sensors_for
from stridetwin.sim.sensors.standard_rig import sensor_rig
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.notices import warn
from stridetwin.streams.samples import Array
from stridetwin.streams.validation import suggest
from stridetwin.studies.placement import visibility
from stridetwin.studies.placement.free import grid_size
from stridetwin.studies.placement.problem_file import Place, PlacementProblem, plain_of
from stridetwin.studies.placement.scores import GEOMETRIC_SCORES, PlaceRow, PlaceScore, Seeing
from stridetwin.studies.placement.visibility import PosedWalk, geometric_scores, pose_walk

# keys of a scenario that change its sensors, not the walk
_SENSORS_ALONE = ("sensors", "camera_mount", "faults", "ideal_sensors")
_MAX_PLACES = 200  # that are measured before the next ones are read
_MAX_GROUP = 25  # places that one worker scores on a walk in one go
_MAX_POSED_WALKS = 64  # that a process holds in memory, some 20 MB each
# from how many walks on a warning comes first: recorded ones take some seconds each, posed ones some 15 ms
_MANY_RECORDED, _MANY_POSED = 500, 50_000


def placement_forecast(problem: PlacementProblem, measured: int) -> Forecast:
    """The forecast of the time that a placement still takes; warns of a long one.

    Args:
        problem: The placement.
        measured: Number of walks with a row.
    """
    # 1 for the unchanged place, and those of the sweep or the search
    places = 1 + (grid_size(problem.knobs) if problem.search is None else problem.search.budget)
    walks = len(problem.bases) * len(problem.seeds)
    missing = max(places * walks - measured, 0)
    size = f"{places} places on {walks} walk{'s' if walks > 1 else ''}"
    is_posed = all(score.geometric for score in problem.scores)
    if missing > (_MANY_POSED if is_posed else _MANY_RECORDED):
        warn(f"{size}: {missing} walks to measure; a coarser step, fewer seeds or a search take less")
    return Forecast(size, missing, "--resume continues")


@dataclass(frozen=True, kw_only=True, eq=False)
class Visit:
    """One place on one walk, which is simulated and scored together.

    Attributes:
        at: Number of the place, and number of the walk among those of the place.
        seed: Seed of the walk.
        scenario: The scenario with the place.
        needed: The same with no other sensors than those that the scored estimators read.
        walk: Digest of the walk, which visits share that differ in their sensors alone.
    """

    at: tuple[int, int]
    seed: int
    scenario: Scenario
    needed: Scenario
    walk: str

    @property
    def label(self) -> str:
        """Name of the walk: the scenario and the seed."""
        return f"{self.scenario.config.name}, seed {self.seed}"


def score_recording(folder: Path, estimators: frozenset[str], visit: Visit) -> PlaceRow:
    """Simulates a visit's walk with the needed sensors, and scores the recording, which is deleted then.

    Args:
        folder: The placement's folder, in which the recording lies meanwhile.
        estimators: Names of the estimators to run.
        visit: Place and walk.

    Returns:
        `walk`, `estimators` (scores by output), and `failed` with a reason if the walk or an estimator failed.

    Raises:
        StrideTwinError: An error that is not specific to this walk, such as a full disk.
    """
    row: PlaceRow = {"walk": visit.label, "estimators": {}}
    config = visit.needed.config
    try:
        with tempfile.TemporaryDirectory(dir=folder / UNFINISHED) as name:
            path = Path(name) / "walk.mcap"
            record(make_twin(visit.needed, visit.seed), path, lambda *_: None)
            scored = score_walk(ScoringJob(name=config.name, path=path, lenient=bool(config.faults), only=estimators))
    except StrideTwinError as error:
        row["failed"] = {"walk": _one_line(error, folder)}
        return row
    except OSError as error:
        raise StrideTwinError(f"{error.filename or folder}: {error.strerror or error}") from None
    row["estimators"] = scored["estimators"]
    if "failed" in scored:
        row["failed"] = scored["failed"]
    return row


def _one_line(error: StrideTwinError, folder: Path) -> str:
    """The message on one line, without the placement's path on this machine."""
    return " ".join(str(error).replace(f"{folder}/", "").split())


def score_posed(names: Sequence[str], seeing: Seeing, run: str, visit: Visit) -> PlaceRow:
    """Computes the geometric scores of a visit.

    Args:
        names: Scores of `GEOMETRIC_SCORES`.
        seeing: When a board counts as seen.
        run: Identifies the run of the placement, whose walks are kept in memory.
        visit: Place and walk.

    Returns:
        `walk`, `scores` by name, and `failed` with a reason if the place or the walk is infeasible.
    """
    row: PlaceRow = {"walk": visit.label, "scores": {}}
    try:
        # only scores that ask for a sensor need the walk; weights do not
        walk = _plan_walk_once(run, visit) if any(GEOMETRIC_SCORES[name][0] for name in names) else None
        row["scores"] = geometric_scores(sensor_rig(visit.scenario.config), walk, names, seeing)
    except StrideTwinError as error:
        row["failed"] = {"walk": str(error)}
    return row


_posed_walks: dict[tuple[str, str], PosedWalk | str] = {}
"""The walks of one run, or the messages of infeasible ones, by the run's name and the walk's digest."""


def _plan_walk_once(run: str, visit: Visit) -> PosedWalk:
    """The walk of a visit, planned once in each process for all places that share it.

    Raises:
        StrideTwinError: The walk is infeasible.
    """
    key = run, visit.walk
    if key not in _posed_walks:
        # the memory is full, or holds walks of another run, which may have been planned by other rules
        if len(_posed_walks) == _MAX_POSED_WALKS or any(cached_run != run for cached_run, _ in _posed_walks):
            _posed_walks.clear()
        try:
            _posed_walks[key] = pose_walk(visit.scenario, visit.seed)
        except StrideTwinError as error:
            _posed_walks[key] = " ".join(str(error).split())  # raised again for every place
    walk = _posed_walks[key]
    if isinstance(walk, str):
        raise StrideTwinError(walk)
    return walk


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredPlaces:
    """Scores of P places on W walks.

    Attributes:
        scores: The S scores.
        places: P of them.
        walks: Descriptions of the W walks.
        values: (P, W, S), NaN where a score is missing.
        failed: Reason for a missing score, by the place's number.
    """

    scores: tuple[PlaceScore, ...]
    places: list[Place]
    walks: list[str]
    values: Array
    failed: dict[int, str]

    @cached_property
    def losses_of_walks(self) -> Array:
        """(P, W) weighted sums of the scores, lower is better; NaN where one is missing."""
        parts = [s.weight * s.losses(self.values[..., i]) for i, s in enumerate(self.scores) if s.weight]
        return np.asarray(np.sum(parts, axis=0))

    @cached_property
    def losses(self) -> Array:
        """(P,) weighted sums of the scores, means over all walks; infinite where one is missing."""
        return mean_losses(self.losses_of_walks)

    @property
    def best_first(self) -> list[int]:
        """Numbers of the places by their loss, the best first."""
        numbers: list[int] = np.argsort(self.losses, kind="stable").tolist()
        return numbers

    @cached_property
    def means(self) -> Array:
        """(P, S) means over walks; NaN where one is missing."""
        return np.asarray(self.values.mean(axis=1))

    def part(self, numbers: Sequence[int]) -> MeasuredPlaces:
        """The places of some numbers, in this order; they are numbered anew, from 0."""
        failed = {new: self.failed[old] for new, old in enumerate(numbers) if old in self.failed}
        places = [self.places[i] for i in numbers]
        values = self.values[numbers]
        return MeasuredPlaces(scores=self.scores, places=places, walks=self.walks, values=values, failed=failed)


def mean_losses(losses: Array) -> Array:
    """(P,) means over walks of (P, W) losses, infinite where one is missing."""
    return np.where(np.isfinite(losses).all(axis=1), losses.mean(axis=1), np.inf)


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

    def __init__(
        self, problem: PlacementProblem, folder: Path, rows: RowLines[PlaceRow], executor: Executor, progress: Progress
    ) -> None:
        self._problem, self._folder, self._rows = problem, folder.absolute(), rows
        self._executor, self._progress = executor, progress
        self._geometric_names = tuple(s.name for s in problem.scores if s.geometric)
        names = [s.name for s in problem.scores if not s.geometric]
        self._estimators = estimators_of(names, f"{problem.path}: scores")  # that give the other scores
        self._forecast = placement_forecast(problem, len(rows))
        self._run_name = uuid4().hex  # names this run for the workers' memory of walks
        self._is_checked = False  # whether the first rows have shown that the estimators report all scores
        self.keys: list[str] = []

    def __call__(self, places: Sequence[Place], seeds: Sequence[int], stage: str) -> MeasuredPlaces:
        """Scores places on the walks of all scenarios with some seeds.

        Args:
            places: The places.
            seeds: Seeds of the walks of each scenario.
            stage: What is measured, for progress.

        Raises:
            ConfigError: On every walk of the first place, an estimator reports scores, but not one that is asked for.
            StrideTwinError: An error that affects all walks.
        """
        scores = self._problem.scores
        walks = [f"{base.name}, seed {seed}" for base in self._problem.bases for seed in seeds]
        values = np.full((len(places), len(walks), len(scores)), np.nan)
        failed: dict[int, str] = {}  # reason by number of the place
        for first in range(0, len(places), _MAX_PLACES):
            part = range(first, min(first + _MAX_PLACES, len(places)))

            def progress(share: float, part: range = part) -> None:
                """Reports the share of this part as the share of all places."""
                self._progress(stage, (part.start + share * len(part)) / len(places))

            visits = list(self._visits([(i, places[i]) for i in part], seeds, failed))
            for visit, row in zip(visits, self._rows_of(visits, len(walks), progress)):
                # a reason counts only where a score is missing
                values[visit.at] = [score.of(row) for score in scores]
                if row.get("failed") and np.isnan(values[visit.at]).any():
                    why = "; ".join(f"{name}: {reason}" for name, reason in row["failed"].items())
                    failed.setdefault(visit.at[0], why)
        return MeasuredPlaces(scores=scores, places=list(places), walks=walks, values=values, failed=failed)

    def _visits(
        self, places: Iterable[tuple[int, Place]], seeds: Sequence[int], failed: dict[int, str]
    ) -> Iterator[Visit]:
        """All visits of some places.

        Args:
            places: Places with their numbers.
            seeds: Seeds of the walks of each scenario.
            failed: Gets the reason, by the place's number, why a scenario cannot have a place.
        """
        # walks are numbered scenario by scenario, and within one seed by seed
        for (i, place), (b, base) in product(places, enumerate(self._problem.bases)):
            plain = plain_of(self._problem, base, place)
            try:
                scenario = scenario_of(plain, self._folder / SCENARIOS / f"{base.name}.yaml")
            except StrideTwinError as error:
                failed.setdefault(i, f"walk: {_one_line(error, self._folder)}")
                continue
            # an estimator that the place cannot feed has no score there
            feeding = [name for name in self._estimators if _feeds(scenario, name)]
            needed = with_sensors_for(scenario, feeding) if feeding else scenario
            # what determines the walk itself, for its digest
            body = {key: value for key, value in plain.items() if key not in _SENSORS_ALONE}
            for k, seed in enumerate(seeds, b * len(seeds)):
                yield Visit(at=(i, k), seed=seed, scenario=scenario, needed=needed, walk=content_key(body, seed))

    def _rows_of(self, visits: list[Visit], walks: int, progress: Callable[[float], None]) -> list[PlaceRow]:
        """The row of each visit, with the geometric scores and those of estimators.

        Args:
            visits: The visits.
            walks: Number of walks of each place.
            progress: Receives the share of the work that is done (0-1).
        """
        none: list[PlaceRow] = [{}] * len(visits)  # where scores of one of the two sorts are not asked for
        # rows with geometric scores, and rows with those of estimators
        posed = self._score_posed(visits, progress) if self._geometric_names else none
        recorded = self._score_recordings(visits, walks, progress) if self._estimators else none
        # one row for each visit, with the reasons of both
        return [{**a, **b, "failed": a.get("failed", {}) | b.get("failed", {})} for a, b in zip(posed, recorded)]

    def _score_posed(self, visits: list[Visit], progress: Callable[[float], None]) -> list[PlaceRow]:
        """Rows of visits with the geometric scores.

        Args:
            visits: The visits.
            progress: Receives the share of the work that is done (0-1).
        """
        versions = partial(code_versions, visibility.__name__)
        seeing, sources = self._problem.seeing, versions()["sources"]
        jobs = []
        counts: Counter[str] = Counter()  # number of visits of each walk so far
        for visit in visits:
            config = repr(visit.scenario.config)
            key = content_key("geometric", config, visit.seed, self._geometric_names, vars(seeing), sources)
            # visits of one walk run together, so that its plan is made once, at most `_MAX_GROUP` in a group
            group = f"{visit.walk} {counts[visit.walk] // _MAX_GROUP}"
            counts[visit.walk] += 1
            jobs.append(Job(name=visit.label, key=key, task=visit, group=group))
        score = partial(score_posed, self._geometric_names, seeing, self._run_name)
        return self._run(jobs, Work(run=one_by_one(score), versions=versions), progress)

    def _score_recordings(self, visits: list[Visit], walks: int, progress: Callable[[float], None]) -> list[PlaceRow]:
        """Rows with the estimators' scores; those of the first place are checked before the others are measured.

        Args:
            visits: The visits, place by place.
            walks: Number of walks of each place, so that the first ones are those of the first place.
            progress: Receives the share of the work that is done (0-1).
        """
        versions = partial(scoring_versions, __name__, tuple(sorted(self._estimators)))
        jobs = []
        for visit in visits:
            key = content_key("recorded", repr(visit.needed.config), visit.seed, versions())
            jobs.append(Job(name=visit.label, key=key, task=visit))
        work = Work(run=one_by_one(partial(score_recording, self._folder, self._estimators)), versions=versions)
        if jobs and not self._is_checked:
            share = walks / len(jobs)  # share of the work that the walks of the first place are
            self._check_scores(self._run(jobs[:walks], work, lambda done: progress(share * done)))
            self._is_checked = True
        return self._run(jobs, work, progress)  # the rows of the first place are stored by now, and reused

    def _run(
        self, jobs: Sequence[Job[Visit]], work: Work[Visit, PlaceRow], progress: Callable[[float], None]
    ) -> list[PlaceRow]:
        """Runs jobs, reusing stored rows; a walk that failed has a row with the reason.

        The keys of all jobs are added to `keys`, which later fixes the order of the rows in the file.

        Args:
            jobs: The jobs.
            work: How their rows are made.
            progress: Receives the share of the jobs that are done (0-1).
        """
        self.keys += [job.key for job in jobs]
        results = Batch(jobs, self._rows).run(work, self._executor, progress, self._forecast)
        return [{"failed": {"walk": row.reason}} if isinstance(row, Failure) else row for row in results]

    def _check_scores(self, rows: Sequence[PlaceRow]) -> None:
        """Raises ConfigError for a score that its estimator lacks on every walk, although it reports others on each.

        An estimator that reports nothing on a walk may just not be fed by it, so this tells nothing about its scores.
        """
        for score in self._problem.scores:
            # names of the scores that the estimator reports on each walk
            reported = [score.find_reported(row) for row in rows]
            if not score.geometric and all(names and score.metric not in names for names in reported):
                valid = f"a score of its estimator: {suggest(score.metric, sorted(set().union(*reported)))}"
                raise ConfigError(self._problem.path, "scores", score.name, valid)


def _feeds(scenario: Scenario, estimator: str) -> bool:
    """Whether a scenario has the sensors that an estimator reads."""
    try:
        return bool(sensors_of([estimator], scenario.config))
    except StrideTwinError:
        return False
