"""Generates one walk of a campaign: recorded under a hidden name, checked, then moved to its place atomically."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from stridetwin.scenarios.campaign.campaign_file import Quality
from stridetwin.scenarios.campaign.named_files import SCENARIOS, scenario_text
from stridetwin.scenarios.campaign.people import plain_person
from stridetwin.scenarios.campaign.plan import Walk
from stridetwin.scenarios.check import Finding, check_recording
from stridetwin.scenarios.files import sha256
from stridetwin.scenarios.metadata import injected_faults
from stridetwin.scenarios.record import record, twin_class
from stridetwin.scenarios.scenario_file import Scenario, read_scenario, scenario_of
from stridetwin.scenarios.versions import digest
from stridetwin.sim.config import Person, TwinConfig
from stridetwin.streams.errors import ConfigError, StrideTwinError, was_interrupted
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.recording.reader import Recording

RECORDINGS, REJECTED, ROWS, HIDDEN = "recordings", "rejected", "rows", ".unfinished"
ACCEPTED, REJECTS, FAILED = "accepted", "rejected", "failed"
_RESIDUAL = "/truth/root_residual"
_LIBRARIES = ("mujoco", "numpy", "scipy")


@dataclass(frozen=True, kw_only=True)
class Job:
    """A walk to generate, in the campaign's folder and with its quality limits.

    Attributes:
        key: Digest of everything that determines the recording.
        versions: Versions of the code that must generate it.
    """

    walk: Walk
    folder: Path
    quality: Quality
    key: str
    versions: dict[str, str]

    def place(self, folder: str, suffix: str) -> Path:
        """A file of this walk."""
        return self.folder / folder / f"{self.walk.name}{suffix}"


@cache
def versions() -> dict[str, str]:
    """Versions that determine a walk: the project, a digest of its sources, and the numerical libraries."""
    return {
        "stridetwin": metadata.version("stridetwin"),
        "sources": digest(__name__, estimators=False),
        **{name: metadata.version(name) for name in _LIBRARIES},
    }


def key_of(walk: Walk, own: dict[str, str], made_by: dict[str, str]) -> str:
    """Digest of everything that determines a recording: the walk, digests of the user's files, versions of the code."""
    what = json.dumps([asdict(walk), own, made_by], sort_keys=True)
    return hashlib.sha256(what.encode()).hexdigest()[:16]


def make(job: Job) -> dict[str, Any]:
    """Simulates, records and checks one walk; returns its row.

    An infeasible walk is rejected and has no recording. The row of an unexpected error is not kept, so that the next
    run tries again.

    Raises:
        StrideTwinError: An error that affects all walks: other versions here, no simulator, a full disk.
    """
    here = versions()
    if here != job.versions:
        other = ", ".join(f"{n} {here[n]}" for n in here if here[n] != job.versions.get(n))
        raise StrideTwinError(f"a worker has other versions: {other}; expected: the same on every worker")
    try:
        return _made(job)
    except OSError as error:
        raise StrideTwinError(f"{error.filename or job.folder}: {error.strerror or error}") from None
    except StrideTwinError:
        raise
    except Exception as error:
        if was_interrupted(error):
            raise KeyboardInterrupt from error
        return failed(job, f"{type(error).__name__}: {error}")


def failed(job: Job, why: str) -> dict[str, Any]:
    """The row of a walk with an unexpected error; it is not kept, so that the next run tries again.

    It holds person and terrain like any other row, so that the splits do not depend on which walks failed.
    """
    try:
        scenario = scenario_of(job.walk.scenario, job.place(SCENARIOS, ".yaml"))
    except Exception:  # may be the cause of the failure
        scenario = None
    return _row(job, FAILED, [f"error: {_one_line(job, why)}"], scenario)


def _made(job: Job) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(prefix=f"{job.walk.name}-", dir=job.folder / HIDDEN) as name:
        hidden, path = Path(name), job.place(SCENARIOS, ".yaml")
        _put(scenario_text(job.walk.scenario), hidden, path)
        row = _walked(job, path, hidden)
        keep_row(job, row, hidden)
    return row


def keep_row(job: Job, row: dict[str, Any], hidden: Path) -> None:
    """Writes a row for the next run."""
    _put(json.dumps({"key": job.key, **row}, sort_keys=True), hidden, job.place(ROWS, ".json"))


def _put(text: str, hidden: Path, path: Path) -> None:
    """Writes a file atomically; another worker may still write the same walk."""
    written = hidden / path.name
    written.write_text(text, encoding="utf-8")
    os.replace(written, path)


def _walked(job: Job, path: Path, hidden: Path) -> dict[str, Any]:
    make_twin = twin_class()
    scenario: Scenario | None = None
    recorded = hidden / f"{job.walk.name}.mcap"
    try:
        scenario = read_scenario(path)
        twin = make_twin(scenario.config, job.walk.seed)
        _ = twin.duration_s  # simulated here
    except StrideTwinError as error:
        return _infeasible(job, error, path, scenario)
    try:
        record(twin, recorded, lambda *_: None)
    except ConfigError as error:  # a fault after the walk's end
        return _infeasible(job, error, path, scenario)
    figures = measured(Recording(recorded, lenient=True), scenario.config.person, twin.fell_at)
    row = with_verdict(
        {**_row(job, ACCEPTED, [], scenario), "bytes": recorded.stat().st_size, "sha256": sha256(recorded), **figures},
        job.quality,
    )
    for place in (RECORDINGS, REJECTED):
        if job.folder / row["recording"] != (other := job.place(place, ".mcap")):
            other.unlink(missing_ok=True)  # of another version
    os.replace(recorded, job.folder / row["recording"])
    return row


def with_verdict(row: dict[str, Any], quality: Quality) -> dict[str, Any]:
    """The row of a recorded walk with its verdict and the resulting path of its recording."""
    found = reasons(row, quality)
    status, place = (REJECTS, REJECTED) if found else (ACCEPTED, RECORDINGS)
    return {**row, "status": status, "reasons": found, "recording": f"{place}/{row['walk']}.mcap"}


def _infeasible(job: Job, error: StrideTwinError, path: Path, scenario: Scenario | None) -> dict[str, Any]:
    """The row of an infeasible walk."""
    for place in (RECORDINGS, REJECTED):
        job.place(place, ".mcap").unlink(missing_ok=True)  # of another version
    words = _one_line(job, str(error).replace(str(path), path.stem))
    return _row(job, REJECTS, [f"refused: {words}"], scenario)


def _one_line(job: Job, text: str) -> str:
    """The message on one line, without the campaign's path on this machine."""
    for place in (f"{job.folder / SCENARIOS}/../", f"{job.folder}/"):
        text = text.replace(place, "")
    return " ".join(text.split())


def _row(job: Job, status: str, why: list[str], scenario: Scenario | None = None) -> dict[str, Any]:
    """A walk's entry of the manifest."""
    row: dict[str, Any] = {
        "walk": job.walk.name,
        "seed": job.walk.seed,
        "scenario": job.walk.base,
        "scenario_file": f"{SCENARIOS}/{job.walk.name}.yaml",
        "values": job.walk.values,
        "status": status,
        "reasons": why,
    }
    if scenario is not None:
        row |= _who_and_where(scenario.config)
    return row


def _who_and_where(config: TwinConfig) -> dict[str, Any]:
    """Person and terrain; equal bodies and equal routes have equal names."""
    body = plain_person(config.person)
    return {
        "person": f"person_{_short(json.dumps(body, sort_keys=True))}",
        "body": body,
        "terrain": f"terrain_{_short(repr(config.route.segments))}",
        "physics": config.physics,
    }


def _short(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def measured(recording: Recording, person: Person, fell_at_s: float | None) -> dict[str, Any]:
    """Figures of the quality check, as in the manifest; the force at the root is given in % of the body weight.

    Returns:
        `duration_s`, `fell_at_s`, `help_mean_pct`, and the errors that `check` finds: `findings`, and
        `expected_findings` about streams with an injected fault.
    """
    broken = {i.topic for i in injected_faults(recording.metadata)}
    errors = [f for f in check_recording(recording).findings if f.is_error]
    return {
        "duration_s": _rounded(recording.duration),
        "fell_at_s": None if fell_at_s is None else _rounded(fell_at_s),
        "help_mean_pct": _root_help_pct(recording, person),
        "findings": [_words(f) for f in errors if f.topic not in broken],
        "expected_findings": [_words(f) for f in errors if f.topic in broken],
    }


def reasons(figures: Mapping[str, Any], quality: Quality) -> list[str]:
    """Reasons to reject a walk by the figures of `measured`; empty if it is accepted."""
    found = []
    if figures["fell_at_s"] is not None and quality.falls == "reject":
        found.append(f"fell: at {figures['fell_at_s']:.2f} s")
    if (help_pct := figures["help_mean_pct"]) > quality.help_pct:
        found.append(f"help: {help_pct:g} % of the body weight at the root, more than {quality.help_pct:g} %")
    if quality.sensors == "reject":
        found += [f"sensors: {words}" for words in figures["findings"]]
    return found


def _root_help_pct(recording: Recording, person: Person) -> float:
    """Mean external force at the root besides the ground's, % of the body weight; 0 for a kinematic walk."""
    force = np.linalg.norm(recording.block(_RESIDUAL).columns["force_in_world"], axis=1)
    return _rounded(100.0 * float(force.mean()) / (person.mass_kg * NOMINAL_GRAVITY_MPS2))


def _words(finding: Finding) -> str:
    return finding.what if finding.what.startswith(finding.topic) else f"{finding.topic}: {finding.what}"


def _rounded(value: float) -> float:
    """Three decimals; -0 becomes 0."""
    return round(value, 3) + 0.0
