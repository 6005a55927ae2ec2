"""Generates one walk of a campaign: recorded under a hidden name, checked, then moved to its place atomically."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from dataclasses import asdict, dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from stridetwin.scenarios.campaign.campaign_file import Quality
from stridetwin.scenarios.campaign.own_scenario import FOLDER as SCENARIOS
from stridetwin.scenarios.campaign.own_scenario import scenario_text
from stridetwin.scenarios.campaign.people import told
from stridetwin.scenarios.campaign.plan import Walk
from stridetwin.scenarios.campaign.quality import measured, reasons
from stridetwin.scenarios.files import sha256
from stridetwin.scenarios.record import record
from stridetwin.scenarios.scenario_file import Scenario, read_scenario, scenario_of
from stridetwin.scenarios.versions import digest
from stridetwin.sim.config import TwinConfig
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.recording.mcap_contents import McapContents
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.recording.topic_reader import concatenated
from stridetwin.streams.samples import Block


class _ReadOnce(McapContents):
    """Holds the blocks of all topics without images in memory, read in one pass: the check needs all of them."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, lenient=True)
        self._blocks: dict[str, Block[Any]] = {}

    def block(self, topic: str) -> Block[Any]:
        """All samples of a topic without images."""
        if not self._blocks:
            parts: dict[str, list[Block[Any]]] = {}
            for chunk in self.chunks:
                small = [t for t in chunk.parts if not self.readers[t].is_image]
                for name, messages in self._messages(chunk, small).items() if small else ():
                    block = self._kept_block(self.readers[name], messages, chunk.parts[name])
                    parts.setdefault(name, []).append(block)
            self._blocks = {name: concatenated(blocks) for name, blocks in parts.items()}
        return self._blocks[topic]


def read_once(path: Path) -> Recording:
    """A recording, opened leniently."""
    return Recording(path, lenient=True, contents=_ReadOnce(path))


RECORDINGS, REJECTED, ROWS, HIDDEN = "recordings", "rejected", "rows", ".unfinished"
ACCEPTED, REJECTS, FAILED = "accepted", "rejected", "failed"
_LIBRARIES = ("mujoco", "numpy", "scipy")


@dataclass(frozen=True, kw_only=True)
class Job:
    """A walk to generate.

    Attributes:
        walk: Its plan.
        folder: The campaign's.
        quality: Its quality limits.
        key: Of its row: a digest of everything that determines the recording.
        versions: Of the code that must generate it.
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
    """Digest of everything that determines a walk's recording.

    Args:
        walk: The walk.
        own: Digest of each of the user's files.
        made_by: Versions of the code.
    """
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
    try:
        from stridetwin.sim.twin import Twin
    except ModuleNotFoundError as error:
        raise StrideTwinError(
            f"{error.name} is not installed; walks need the simulator: pip install 'stridetwin[twin]'"
        ) from None
    scenario: Scenario | None = None
    recorded = hidden / f"{job.walk.name}.mcap"
    try:
        scenario = read_scenario(path)
        twin = Twin(scenario.config, job.walk.seed)
        _ = twin.duration_s  # simulated here
    except StrideTwinError as error:
        return _refused(job, error, path, scenario)
    try:
        record(twin, recorded, lambda *_: None)
    except ConfigError as error:  # a fault after the walk's end
        return _refused(job, error, path, scenario)
    figures = measured(read_once(recorded), scenario.config.person, twin.fell_at)
    row = judged(
        {
            **_row(job, ACCEPTED, [], scenario),
            "bytes": recorded.stat().st_size,
            "sha256": sha256(recorded),
            **figures,
        },
        job.quality,
    )
    for place in (RECORDINGS, REJECTED):
        if job.folder / row["recording"] != (other := job.place(place, ".mcap")):
            other.unlink(missing_ok=True)  # of another version
    os.replace(recorded, job.folder / row["recording"])
    return row


def judged(row: dict[str, Any], quality: Quality) -> dict[str, Any]:
    """The row of a recorded walk with its verdict and the resulting path of its recording."""
    found = reasons(row, quality)
    status, place = (REJECTS, REJECTED) if found else (ACCEPTED, RECORDINGS)
    return {**row, "status": status, "reasons": found, "recording": f"{place}/{row['walk']}.mcap"}


def _refused(job: Job, error: StrideTwinError, path: Path, scenario: Scenario | None) -> dict[str, Any]:
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
    body = told(config.person)
    return {
        "person": f"person_{_short(json.dumps(body, sort_keys=True))}",
        "body": body,
        "terrain": f"terrain_{_short(repr(config.route.segments))}",
        "physics": config.physics,
    }


def _short(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:8]
