"""Generates a campaign: plan, missing walks, manifest and card."""

from __future__ import annotations

import json
import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from stridetwin.scenarios.campaign import executors
from stridetwin.scenarios.campaign import manifest as manifests
from stridetwin.scenarios.campaign.campaign_file import Campaign
from stridetwin.scenarios.campaign.extremes import check_extremes
from stridetwin.scenarios.campaign.named_files import SCENARIOS, copy_files
from stridetwin.scenarios.campaign.plan import Extra, Walk, plan
from stridetwin.scenarios.campaign.request import claim, request
from stridetwin.scenarios.campaign.walk import (
    ACCEPTED,
    HIDDEN,
    RECORDINGS,
    REJECTED,
    ROWS,
    Job,
    keep_row,
    key_of,
    versions,
    with_verdict,
)
from stridetwin.scenarios.files import locked, sha256
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.files import json_text, whole_file

Progress = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of a campaign run.

    Attributes:
        folder: Output folder.
        workers: Number of processes, one walk at a time each.
        scheduler: Address of a Dask scheduler, whose workers generate the walks instead.
        seed: Replaces the campaign's.
        subset: Number of walks, from the first; None takes all. Further walks that the folder has are kept.
        extra: Overrides for every walk.
    """

    folder: Path
    workers: int = 1
    scheduler: str | None = None
    seed: int | None = None
    subset: int | None = None
    extra: Extra = field(default_factory=Extra)


@dataclass(frozen=True, kw_only=True)
class Done:
    """Result of a campaign: its manifest, and the number of walks generated now; the others were reused."""

    manifest: dict[str, Any]
    made: int

    @property
    def verdicts(self) -> Counter[str]:
        """Number of walks by status."""
        return Counter(walk["status"] for walk in self.manifest["walks"])

    @property
    def empty_parts(self) -> list[str]:
        """Parts of the splits without an accepted walk, such as `test (by person)`."""
        accepted = [walk["split"] for walk in self.manifest["walks"] if walk["status"] == ACCEPTED]
        return [
            f"{part} (by {by})"
            for by in self.manifest["splits"]
            for part in self.manifest["shares"]
            if not any(split[by] == part for split in accepted)
        ]

    @property
    def reasons(self) -> Counter[str]:
        """Number of rejected walks by kind of reason."""
        return Counter(kind for w in self.manifest["walks"] for kind in {r.split(":")[0] for r in w["reasons"]})


def generate(
    campaign: Campaign,
    options: Options,
    progress: Progress,
    announce: Callable[[Sequence[Walk]], None] = lambda missing: None,
) -> Done:
    """Generates the walks that the folder lacks for this configuration and version of the code.

    Args:
        campaign: The campaign.
        options: Folder, workers and what differs from the campaign's file.
        progress: Receives the stage and its progress (0-1).
        announce: Receives the walks to generate, before the first.

    Raises:
        StrideTwinError: Any usage error; finished walks are kept.
        KeyboardInterrupt: As raised by a Ctrl-C, with the number of walks that are kept.
    """
    progress("plan", 0.0)
    if options.seed is not None:
        campaign = replace(campaign, seed=options.seed)
    check_extremes(campaign, options.extra)
    made_by = versions()
    own = {name: sha256(path) for name, path in sorted(campaign.own.items())}
    jobs = [
        Job(
            walk=walk,
            folder=options.folder.absolute(),
            quality=campaign.quality,
            key=key_of(walk, own, made_by),
            versions=made_by,
        )
        for walk in plan(campaign, options.extra)
    ]
    with _held(options.folder):
        claim(options.folder, request(campaign, options.extra, own), (job.walk.name for job in jobs))
        # walks beyond a subset that are there already stay in the manifest
        jobs = [job for i, job in enumerate(jobs) if _is_asked(i, options) or job.place(ROWS, ".json").exists()]
        found = {job.walk.name: _kept(job) for job in jobs}
        rows = {name: row for name, row in found.items() if row.get("status")}
        missing = [job for job in jobs if job.walk.name not in rows]
        outdated = sum(bool(found[job.walk.name]) for job in missing)
        if outdated:  # they describe recordings that will be replaced
            for name in (manifests.NAME, manifests.CARD_NAME):
                (options.folder / name).unlink(missing_ok=True)
        copy_files(options.folder, campaign.own)
        announce([job.walk for job in missing])
        stage = f"walks, {outdated} of another version again" if outdated else "walks"
        progress(stage, len(rows) / len(jobs))
        try:
            for row in executors.rows(missing, options.workers, options.scheduler):
                rows[row["walk"]] = row
                progress(stage, len(rows) / len(jobs))
        except KeyboardInterrupt as stop:
            kept = f"{len(rows)} of {len(jobs)} walks are in {options.folder}"
            raise KeyboardInterrupt(f"{kept}; the same command continues") from stop
        content = manifests.manifest(campaign, [rows[job.walk.name] for job in jobs], made_by, own)
        for name, text in ((manifests.CARD_NAME, manifests.card(content)), (manifests.NAME, json_text(content))):
            with whole_file(options.folder / name) as file:
                file.write_text(text, encoding="utf-8")
    return Done(manifest=content, made=len(missing))


def _is_asked(number: int, options: Options) -> bool:
    return options.subset is None or number < options.subset


def _kept(job: Job) -> dict[str, Any]:
    """The existing row of a walk with a complete recording; one without status where its version differs."""
    try:
        row: dict[str, Any] = json.loads(job.place(ROWS, ".json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except ValueError:
        return {"key": ""}
    if row.get("key") != job.key:
        return {"key": ""}
    del row["key"]
    if "recording" not in row:
        return row
    places = [job.place(place, ".mcap") for place in (RECORDINGS, REJECTED)]
    there = next((path for path in places if path.is_file() and path.stat().st_size == row["bytes"]), None)
    return {"key": ""} if there is None else _with_current_verdict(job, row, there)


def _with_current_verdict(job: Job, row: dict[str, Any], recording: Path) -> dict[str, Any]:
    """The row by the current quality limits, with the recording moved to the folder of its verdict."""
    now = with_verdict(row, job.quality)
    if recording != (place := job.folder / now["recording"]):
        os.replace(recording, place)
    if now != row:
        keep_row(job, now, job.folder / HIDDEN)
    return now


@contextmanager
def _held(folder: Path) -> Iterator[None]:
    """Locks and creates the folders of a campaign; removes the unfinished files of killed runs."""
    for name in (RECORDINGS, REJECTED, ROWS, SCENARIOS):
        (folder / name).mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        try:
            stack.enter_context(locked(folder))
        except BlockingIOError:
            raise StrideTwinError(f"{folder}: another process generates walks there: expected another folder") from None
        shutil.rmtree(folder / HIDDEN, ignore_errors=True)
        (folder / HIDDEN).mkdir(exist_ok=True)
        try:
            yield
        finally:
            shutil.rmtree(folder / HIDDEN, ignore_errors=True)
