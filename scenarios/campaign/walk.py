"""Generates one walk of a campaign: recorded under a hidden name, checked, then moved to its place atomically."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import NotRequired, TypedDict

import numpy as np

from stridetwin.batch.folder import UNFINISHED
from stridetwin.batch.jobs import Failure
from stridetwin.batch.versions import code_versions
from stridetwin.scenarios.campaign.campaign_file import Quality, plain_person
from stridetwin.scenarios.campaign.named_files import SCENARIOS, scenario_text
from stridetwin.scenarios.campaign.plan import PlannedWalk
from stridetwin.scenarios.check import check_recording
from stridetwin.scenarios.files import sha256
from stridetwin.scenarios.metadata import read_injected_faults
from stridetwin.scenarios.record import record, twin_class
from stridetwin.scenarios.scenario_file import Scenario, read_scenario, scenario_of
from stridetwin.sim.config import TwinConfig
from stridetwin.streams.errors import ConfigError, StrideTwinError, was_interrupted
from stridetwin.streams.recording.reader import Recording

RECORDINGS, REJECTED, ROWS = "recordings", "rejected", "rows"
"""Folders of the campaign: accepted recordings, rejected ones, and rows of the manifest."""
ACCEPTED, REJECTS, FAILED = "accepted", "rejected", "failed"
"""Statuses of a walk."""
_RESIDUAL = "/truth/root_residual"  # topic of the external force at the root besides the ground's


class QualityFigures(TypedDict):
    """Figures of the quality check of a recorded walk.

    Attributes:
        duration_s: Duration of the recording.
        fell_at_s: When the walker fell; None without a fall.
        help_mean_pct: Mean external force at the root besides the ground's, % of the body weight.
        findings: Errors that `check` finds.
        expected_findings: Errors about streams with an injected fault.
    """

    duration_s: float
    fell_at_s: float | None
    help_mean_pct: float
    findings: list[str]
    expected_findings: list[str]


class _WalkerAndTerrain(TypedDict):
    """Person, body, terrain and physics of a walk."""

    person: str
    body: dict[str, object]
    terrain: str
    physics: str


class WalkRow(TypedDict):
    """Entry of a walk in the manifest.

    Attributes:
        walk: Its name.
        seed: Its seed.
        scenario: The scenario that it comes from.
        scenario_file: Its own scenario file, relative to the campaign's folder.
        values: Drawn values by name.
        status: `accepted`, `rejected` or `failed`.
        reasons: Why it was not accepted.
        person: Name of the person; it is missing, like body, terrain and physics, where the scenario is invalid.
        body: Body measures of the person; the manifest has them by person instead.
        terrain: Name of the terrain; equal routes have equal names.
        physics: How the body moves.
        recording: The recording, relative to the campaign's folder; an infeasible walk has none, and none of the
            following keys.
        bytes: Size of the recording.
        sha256: Digest of the recording.
        duration_s: This key and the following ones up to `expected_findings`: see `QualityFigures`.
        split: Parts of the splits of an accepted walk, by `person` and `terrain`.
    """

    walk: str
    seed: int
    scenario: str
    scenario_file: str
    values: dict[str, object]
    status: str
    reasons: list[str]
    person: NotRequired[str]
    body: NotRequired[dict[str, object]]
    terrain: NotRequired[str]
    physics: NotRequired[str]
    recording: NotRequired[str]
    bytes: NotRequired[int]
    sha256: NotRequired[str]
    duration_s: NotRequired[float]
    fell_at_s: NotRequired[float | None]
    help_mean_pct: NotRequired[float]
    findings: NotRequired[list[str]]
    expected_findings: NotRequired[list[str]]
    split: NotRequired[dict[str, str]]


@dataclass(frozen=True, kw_only=True)
class WalkTask:
    """A walk to generate, in the campaign's folder and with its quality limits."""

    walk: PlannedWalk
    folder: Path
    quality: Quality

    def path(self, folder: str, suffix: str) -> Path:
        """The file of this walk in a folder of the campaign."""
        return self.folder / folder / f"{self.walk.name}{suffix}"


def walk_versions() -> dict[str, str]:
    """Versions that determine a walk: the project, a digest of its sources, and the numerical libraries."""
    return code_versions(__name__, estimators=False)


def generate_walk(task: WalkTask) -> WalkRow | Failure:
    """Simulates, records and checks one walk; returns its row, or a `Failure` after an unexpected error.

    An infeasible walk is rejected and has no recording.

    Raises:
        StrideTwinError: An error that affects all walks: no simulator, a full disk.
    """
    try:
        with tempfile.TemporaryDirectory(prefix=f"{task.walk.name}-", dir=task.folder / UNFINISHED) as name:
            return _simulate(task, Path(name))
    except OSError as error:
        raise StrideTwinError(f"{error.filename or task.folder}: {error.strerror or error}") from None
    except StrideTwinError:
        raise
    except Exception as error:
        if was_interrupted(error):  # a library has turned a Ctrl-C into an error of its own
            raise KeyboardInterrupt from error
        return Failure(f"{type(error).__name__}: {error}")


def row_of_failure(task: WalkTask, reason: str) -> WalkRow:
    """The row of a walk with an unexpected error; it is not stored, so that the next run tries the walk again.

    It holds person and terrain like any other row, so that the splits do not depend on which walks failed.

    Args:
        task: The walk.
        reason: The error as text.
    """
    try:
        scenario = scenario_of(task.walk.scenario, task.path(SCENARIOS, ".yaml"))
    except Exception:  # may be the cause of the failure
        scenario = None
    return _start_row(task, FAILED, [f"error: {_one_line(task, reason)}"], scenario)


def _simulate(task: WalkTask, unfinished: Path) -> WalkRow:
    """Simulates, records and checks a walk. Files are written to `unfinished` and then moved to their places.

    Recordings of the same walk by another version of the code are removed.

    Args:
        task: The walk.
        unfinished: Temporary folder of this walk.

    Returns:
        The walk's row: accepted, rejected by its quality figures, or rejected as infeasible, without a recording.
    """
    make_twin = twin_class()
    scenario: Scenario | None = None
    path, recorded = task.path(SCENARIOS, ".yaml"), unfinished / f"{task.walk.name}.mcap"
    unfinished_scenario = unfinished / path.name
    unfinished_scenario.write_text(scenario_text(task.walk.scenario), encoding="utf-8")
    os.replace(unfinished_scenario, path)
    try:
        scenario = read_scenario(path)
        twin = make_twin(scenario.config, task.walk.seed)
        _ = twin.duration_s  # asking for the duration simulates the walk, which may be infeasible
    except StrideTwinError as error:
        return _reject_infeasible(task, error, path, scenario)
    try:
        record(twin, recorded, lambda *_: None)
    except ConfigError as error:  # a fault after the walk's end
        return _reject_infeasible(task, error, path, scenario)
    body_weight_n = scenario.config.person.mass_kg * scenario.config.gravity_mps2
    figures = quality_figures(Recording(recorded, lenient=True), body_weight_n, twin.fell_at)
    row = with_verdict(
        {
            **_start_row(task, ACCEPTED, [], scenario),
            "bytes": recorded.stat().st_size,
            "sha256": sha256(recorded),
            **figures,
        },
        task.quality,
    )
    for place in (RECORDINGS, REJECTED):
        recording = task.path(place, ".mcap")
        if recording != task.folder / row["recording"]:  # in the folder of the other verdict: by another version
            recording.unlink(missing_ok=True)
    os.replace(recorded, task.folder / row["recording"])
    return row


def with_verdict(row: WalkRow, quality: Quality) -> WalkRow:
    """The row of a recorded walk with its verdict and the resulting path of its recording."""
    why = rejection_reasons(row, quality)
    status, place = (REJECTS, REJECTED) if why else (ACCEPTED, RECORDINGS)  # and the folder of the recording
    return {**row, "status": status, "reasons": why, "recording": f"{place}/{row['walk']}.mcap"}


def _reject_infeasible(task: WalkTask, error: StrideTwinError, path: Path, scenario: Scenario | None) -> WalkRow:
    """Removes recordings of other versions and returns the row of a walk that cannot be simulated.

    Args:
        task: The walk.
        error: Why it is infeasible.
        path: Its scenario file, whose path is shortened in the text.
        scenario: The scenario; None where it is invalid, so that the row has no person and terrain.
    """
    for place in (RECORDINGS, REJECTED):
        task.path(place, ".mcap").unlink(missing_ok=True)  # of another version
    text = _one_line(task, str(error).replace(str(path), path.stem))
    return _start_row(task, REJECTS, [f"refused: {text}"], scenario)


def _one_line(task: WalkTask, text: str) -> str:
    """The message on one line, without the campaign's path on this machine, so that rows are the same everywhere."""
    # scenario files name the user's files relative to their own folder (`../files/...`)
    for place in (f"{task.folder / SCENARIOS}/../", f"{task.folder}/"):
        text = text.replace(place, "")
    return " ".join(text.split())


def _start_row(task: WalkTask, status: str, why: list[str], scenario: Scenario | None = None) -> WalkRow:
    """Entry of a walk in the manifest, without figures of its recording.

    Args:
        task: The walk.
        status: `accepted`, `rejected` or `failed`.
        why: Reasons if it was not accepted.
        scenario: Gives person and terrain; None leaves them out.
    """
    row: WalkRow = {
        "walk": task.walk.name,
        "seed": task.walk.seed,
        "scenario": task.walk.base,
        "scenario_file": f"{SCENARIOS}/{task.walk.name}.yaml",
        "values": task.walk.values,
        "status": status,
        "reasons": why,
    }
    return row if scenario is None else {**row, **_person_and_terrain(scenario.config)}


def _person_and_terrain(config: TwinConfig) -> _WalkerAndTerrain:
    """Person, body, terrain and physics of a walk.

    The names of person and terrain are digests of the body and of the route, so that equal ones have equal names.
    """
    body = plain_person(config.person)
    return {
        "person": f"person_{_short_digest(json.dumps(body, sort_keys=True))}",
        "body": body,
        "terrain": f"terrain_{_short_digest(repr(config.route.segments))}",
        "physics": config.physics,
    }


def _short_digest(text: str) -> str:
    """Eight hexadecimal digits of the digest of a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def quality_figures(recording: Recording, body_weight_n: float, fell_at_s: float | None) -> QualityFigures:
    """Figures of the quality check, as in the manifest; the force at the root is given in % of the body weight.

    Args:
        recording: The recorded walk, opened leniently.
        body_weight_n: Weight of the walker at the site of the walk.
        fell_at_s: When the walker fell; None without a fall.

    Returns:
        `duration_s`, `fell_at_s`, `help_mean_pct`, and the errors that `check` finds: `findings`, and
        `expected_findings` about streams with an injected fault.
    """
    # topics with an injected fault, whose errors are expected
    broken = {i.topic for i in read_injected_faults(recording.metadata)}
    errors = [f for f in check_recording(recording).findings if f.is_error]
    return {
        "duration_s": _round(recording.duration),
        "fell_at_s": None if fell_at_s is None else _round(fell_at_s),
        "help_mean_pct": _root_help_pct(recording, body_weight_n),
        "findings": [f.text for f in errors if f.topic not in broken],
        "expected_findings": [f.text for f in errors if f.topic in broken],
    }


def rejection_reasons(figures: QualityFigures | WalkRow, quality: Quality) -> list[str]:
    """Reasons to reject a walk by the figures of `quality_figures`; empty if it is accepted."""
    why = []
    if figures["fell_at_s"] is not None and quality.falls == "reject":
        why.append(f"fell: at {figures['fell_at_s']:.2f} s")
    if (help_pct := figures["help_mean_pct"]) > quality.help_pct:
        why.append(f"help: {help_pct:g} % of the body weight at the root, more than {quality.help_pct:g} %")
    if quality.sensors == "reject":
        why += [f"sensors: {text}" for text in figures["findings"]]
    return why


def _root_help_pct(recording: Recording, body_weight_n: float) -> float:
    """Mean external force at the root besides the ground's, % of the body weight; 0 for a kinematic walk."""
    # (N,) N, size of this force at each sample
    force = np.linalg.norm(recording.block(_RESIDUAL).columns["force_in_world"], axis=1)
    return _round(100.0 * float(force.mean()) / body_weight_n)


def _round(value: float) -> float:
    """The number with three decimals; adding 0 turns -0 into 0."""
    return round(value, 3) + 0.0
