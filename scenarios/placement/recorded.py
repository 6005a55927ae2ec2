"""Scores of a place that need a recording: one walk, recorded, scored by every estimator that it feeds, thrown away."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stridetwin.scenarios.campaign.own_scenario import FOLDER
from stridetwin.scenarios.gate.walk_scores import Job, score_walk
from stridetwin.scenarios.placement.rows import HIDDEN
from stridetwin.scenarios.record import record
from stridetwin.scenarios.runner import make_twin
from stridetwin.scenarios.scenario_file import scenario_of
from stridetwin.streams.errors import StrideTwinError


@dataclass(frozen=True, kw_only=True)
class Walk:
    """A walk to be recorded.

    Attributes:
        name: Of its scenario.
        scenario: Its plain data.
        seed: Of everything random in it.
        folder: The placement's.
    """

    name: str
    scenario: dict[str, Any]
    seed: int
    folder: Path


def recorded_scores(walk: Walk) -> dict[str, Any]:
    """`estimators`, and `failed` with a reason where the walk or an estimator failed.

    Raises:
        StrideTwinError: What is wrong with more than this walk: a full disk.
    """
    try:
        with tempfile.TemporaryDirectory(prefix=HIDDEN, dir=walk.folder) as name:
            scenario = scenario_of(walk.scenario, walk.folder / FOLDER / f"{walk.name}.yaml")
            path = Path(name) / "walk.mcap"
            record(make_twin(scenario, walk.seed), path, lambda *_: None)
            row = score_walk(Job(name=walk.name, path=path, lenient=bool(scenario.config.faults)))
    except StrideTwinError as error:
        return {"estimators": {}, "failed": {"walk": " ".join(str(error).split())}}
    except OSError as error:
        raise StrideTwinError(f"{error.filename or walk.folder}: {error.strerror or error}") from None
    return {"estimators": row["estimators"], **({"failed": row["failed"]} if "failed" in row else {})}
