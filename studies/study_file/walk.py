"""One walk of a study: it is simulated, and all methods run on its recording."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TypedDict

from stridetwin.batch.folder import UNFINISHED
from stridetwin.outputs.base import Scores
from stridetwin.scenarios.record import make_twin, record
from stridetwin.scenarios.scenario_file import Scenario
from stridetwin.scenarios.score_needs import estimators_of, sensors_of, with_sensors_for
from stridetwin.streams.errors import StrideTwinError, was_interrupted
from stridetwin.streams.recording.reader import Recording
from stridetwin.studies.study_file.methods import Method, align_odometry, run_method

WALK = "walk"
"""Key of a row's `failed` if the walk itself failed."""


class StudyRow(TypedDict):
    """The row of a walk.

    Attributes:
        scores: By method and output, such as one per foot.
        failed: Reason by method that failed, or under `WALK` if the walk itself did.
    """

    scores: dict[str, dict[str, Scores]]
    failed: dict[str, str]


@dataclass(frozen=True, kw_only=True)
class StudyWalk:
    """A walk of a study, on which all methods run.

    Attributes:
        scenario: Its scenario; when it runs, with no other sensors than those that the methods need
            (`keep_needed_sensors`).
        seed: Its seed.
        methods: The methods.
    """

    scenario: Scenario
    seed: int
    methods: tuple[Method, ...]


def missing_sensors_reason(method: Method, scenario: Scenario) -> str:
    """Why the sensors of a scenario do not feed a method, or the estimators that it needs; "" if they do."""
    try:
        # without any sensor the method would have nothing to read
        return "" if sensors_of(estimators_of([method.estimator]), scenario.config) else "needs no sensors"
    except StrideTwinError as error:
        return str(error)


def keep_needed_sensors(scenario: Scenario, methods: Iterable[Method]) -> Scenario:
    """The scenario without the sensors that no method reads.

    Methods that the scenario cannot feed, because it lacks a sensor, do not count. If it can feed none of them, all
    sensors stay.
    """
    fed = [method.estimator for method in methods if not missing_sensors_reason(method, scenario)]
    return with_sensors_for(scenario, estimators_of(fed)) if fed else scenario


def run_walk(folder: Path, walk: StudyWalk) -> StudyRow:
    """The row of a walk: `scores` by method and output, and `failed` with a reason by method, or for the walk.

    Args:
        folder: The study's folder; the recording lies there until it is scored.
        walk: The walk.

    Raises:
        StrideTwinError: An error that is not specific to this walk, such as a full disk.
    """
    scores: dict[str, dict[str, Scores]] = {}
    failed: dict[str, str] = {}
    try:
        with tempfile.TemporaryDirectory(dir=folder / UNFINISHED) as name:
            path = Path(name) / "walk.mcap"
            record(make_twin(walk.scenario, walk.seed), path)
            # faults may leave a recording that is refused unless it is read leniently
            recording = Recording(path, lenient=bool(walk.scenario.config.faults))
            # the odometry runs once for all methods that take its poses, and only if there is one
            make_walk = cache(lambda: align_odometry(recording))
            for method in walk.methods:
                try:
                    scores[method.name] = run_method(method, recording, make_walk)
                except Exception as error:
                    if was_interrupted(error):  # Ctrl-C in compiled code arrives as another exception
                        raise KeyboardInterrupt from error
                    failed[method.name] = _one_line(error, path)
    except StrideTwinError as error:
        failed[WALK] = _one_line(error, folder)
    except OSError as error:
        raise StrideTwinError(f"{error.filename or folder}: {error.strerror or error}") from None
    return {"scores": scores, "failed": failed}


def _one_line(error: Exception, path: Path) -> str:
    """The message on one line, without the given path, which is only of this machine.

    The type of an error that is not this project's is put before its message.
    """
    text = str(error) if isinstance(error, StrideTwinError) else f"{type(error).__name__}: {error}"
    return " ".join(text.replace(f"{path}: ", "").replace(f"{path}/", "").split())
