"""Generates a campaign: plan, missing walks, manifest and card.

A folder belongs to one request, so that walks of two requests never mix.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from stridetwin.batch.executors import BatchOptions
from stridetwin.batch.folder import differing_keys, hold_folder, read_request, write_request
from stridetwin.batch.jobs import Failure, Job, Work, content_key, one_by_one
from stridetwin.batch.rows import RowFiles
from stridetwin.batch.run import Batch, Progress
from stridetwin.scenarios.campaign import manifest as manifests
from stridetwin.scenarios.campaign.campaign_file import Campaign
from stridetwin.scenarios.campaign.extremes import check_extremes
from stridetwin.scenarios.campaign.named_files import SCENARIOS, Variable, copy_files
from stridetwin.scenarios.campaign.plan import Extra, PlannedWalk, plan_walks
from stridetwin.scenarios.campaign.walk import (
    ACCEPTED,
    RECORDINGS,
    REJECTED,
    ROWS,
    WalkRow,
    WalkTask,
    generate_walk,
    row_of_failure,
    walk_versions,
    with_verdict,
)
from stridetwin.scenarios.files import sha256
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.files import atomic_file, to_json

_USED = "another process generates walks there: expected another folder"
_RESUME = "the same command continues"
_ANOTHER = "expected the same request to resume, or another folder"
_LABELS = {"off": "sensors switched off:"}


@dataclass(frozen=True, kw_only=True)
class CampaignOptions(BatchOptions):
    """Options of a campaign run.

    Attributes:
        seed: Replaces the campaign's.
        subset: Number of walks, from the first; None takes all. Further walks that the folder has are kept.
        extra: Overrides for every walk.
    """

    seed: int | None = None
    subset: int | None = None
    extra: Extra = field(default_factory=Extra)


@dataclass(frozen=True, kw_only=True)
class CampaignResult:
    """Result of a campaign: its manifest, and the number of walks generated now; the others were reused."""

    manifest: manifests.Manifest
    generated: int

    @property
    def verdicts(self) -> Counter[str]:
        """Number of walks by status: accepted, rejected or failed."""
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
        """Number of walks that were not accepted by kind of reason, such as `fell`; a walk may have several kinds."""
        # the kind is the text before the colon; a walk counts once for each kind
        kinds_of_walks = [{reason.split(":")[0] for reason in walk["reasons"]} for walk in self.manifest["walks"]]
        return Counter(kind for kinds in kinds_of_walks for kind in kinds)


def generate(
    campaign: Campaign,
    options: CampaignOptions,
    progress: Progress,
    announce: Callable[[Sequence[PlannedWalk]], None] = lambda missing: None,
) -> CampaignResult:
    """Generates the walks that the folder lacks for this configuration and version of the code.

    Args:
        campaign: The campaign.
        options: Folder, workers and what differs from the campaign's file.
        progress: Receives the stage and its progress (0-1).
        announce: Receives the walks to generate, before the first.

    Raises:
        StrideTwinError: Any usage error; finished walks are kept.
        KeyboardInterrupt: After a Ctrl-C, with the number of walks that are kept.
    """
    progress("plan", 0.0)
    if options.seed is not None:
        campaign = replace(campaign, seed=options.seed)
    check_extremes(campaign, options.extra)
    # the key of a walk changes with its scenario, the user's files or the code, and then it is generated again
    folder, versions = options.folder, walk_versions()
    file_digests = {name: sha256(path) for name, path in sorted(campaign.user_files.items())}
    jobs = [
        Job(
            name=walk.name,
            key=content_key(asdict(walk), file_digests, versions),
            task=WalkTask(walk=walk, folder=folder.absolute(), quality=campaign.quality),
        )
        for walk in plan_walks(campaign, options.extra)
    ]
    # one process at a time; `unfinished` is a folder for files that are not complete yet
    with hold_folder(folder, lambda: any((folder / ROWS).glob("*.json")), _USED) as unfinished:
        for name in (RECORDINGS, REJECTED, ROWS, SCENARIOS):
            (folder / name).mkdir(exist_ok=True)
        bind_folder(folder, campaign_request(campaign, options.extra, file_digests), (job.name for job in jobs))
        store: RowFiles[WalkRow] = RowFiles(folder / ROWS, unfinished, is_sorted=True)
        # walks beyond a subset that are there already stay in the manifest
        requested_count = len(jobs) if options.subset is None else options.subset
        jobs = [job for i, job in enumerate(jobs) if i < requested_count or store.has_any(job)]
        batch = Batch(jobs, store, update_row=lambda job, row: _current_row(job, row, store))
        if batch.outdated:  # manifest and card describe recordings that will be replaced
            for name in (manifests.NAME, manifests.CARD_NAME):
                (folder / name).unlink(missing_ok=True)
        copy_files(folder, campaign.user_files)
        announce([job.task.walk for job in batch.missing])
        stage = f"walks, {batch.outdated} of another version again" if batch.outdated else "walks"
        generated = len(batch.missing)
        try:
            work = Work(run=one_by_one(generate_walk), versions=walk_versions)
            results = batch.run_with(options, work, stage, progress, _RESUME)
        except KeyboardInterrupt as stop:
            raise KeyboardInterrupt(f"{len(batch.results)} of {len(jobs)} walks are in {folder}; {_RESUME}") from stop
        # a walk with an unexpected error has a row in the manifest alone
        rows = [
            row_of_failure(job.task, result.reason) if isinstance(result, Failure) else result
            for job, result in zip(jobs, results)
        ]
        content = manifests.manifest(campaign, rows, versions, file_digests)
        for name, text in ((manifests.CARD_NAME, manifests.card_text(content)), (manifests.NAME, to_json(content))):
            with atomic_file(folder / name) as file:
                file.write_text(text, encoding="utf-8")
    return CampaignResult(manifest=content, generated=generated)


def _current_row(job: Job[WalkTask], row: WalkRow, store: RowFiles[WalkRow]) -> WalkRow | None:
    """A stored row with its verdict by the current quality limits.

    The limits may differ from those of the earlier run: then the recording is moved to the folder of the new verdict,
    and the changed row is stored.

    Args:
        job: The walk's job.
        row: Its stored row; one without a recording, of an infeasible walk, comes back as it is.
        store: The rows of the campaign.

    Returns:
        The row; None if the recording is missing or incomplete, so that the walk is generated again.
    """
    if "recording" not in row:
        return row
    candidates = [job.task.path(place, ".mcap") for place in (RECORDINGS, REJECTED)]
    recording = next((path for path in candidates if path.is_file() and path.stat().st_size == row["bytes"]), None)
    if recording is None:
        return None
    current = with_verdict(row, job.task.quality)
    current_place = job.task.folder / current["recording"]
    if recording != current_place:
        os.replace(recording, current_place)
    if current != row:
        store.write(job, current)
    return current


def campaign_request(campaign: Campaign, extra: Extra, file_digests: Mapping[str, str]) -> dict[str, object]:
    """What decides which walks a campaign has, apart from their number: its name, seed and options, and a digest.

    Limits of quality, splits and the description may change, as they do not change a walk. The number of walks counts
    only where it changes them all (Latin hypercube).

    Args:
        campaign: The campaign.
        extra: Overrides for every walk.
        file_digests: Digests of the user's files.
    """

    def plain(variables: Iterable[Variable]) -> list[tuple[str, str]]:
        """Name and distribution of each variable as text."""
        return [(v.name, repr(v.distribution)) for v in variables]

    content = [
        [(base.name, base.scenario, base.weight, plain(base.variables)) for base in campaign.bases],
        [(group.count, repr(group.body), group.names) for group in campaign.people],
        plain(campaign.variables),
        campaign.sampling,
        0 if campaign.sampling == "sobol" else campaign.walks,  # further Sobol points leave the earlier ones
        dict(file_digests),
    ]
    digest = hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()[:16]
    return {"campaign": campaign.path.stem, "digest": digest, "seed": campaign.seed, **asdict(extra)}


def bind_folder(folder: Path, request: Mapping[str, object], walk_names: Iterable[str]) -> None:
    """Binds a folder to a request, or confirms that it belongs to it.

    Args:
        folder: The campaign's folder, locked.
        request: The request.
        walk_names: Names of its walks.

    Raises:
        StrideTwinError: The folder has walks of another request, of none that is known, or more than are asked for.
    """
    existing = {row.stem for row in (folder / ROWS).glob("*.json")}  # names of the walks that the folder has
    previous = read_request(folder)
    if existing and not isinstance(previous, dict):
        raise StrideTwinError(f"{folder}: has walks without their request (earlier version): expected another folder")
    if existing and isinstance(previous, dict) and (differing := _differences(request, previous)):
        raise StrideTwinError(f"{folder}: has walks of another request ({differing}): {_ANOTHER}")
    if extra := existing - set(walk_names):  # of an equal request for more walks
        raise StrideTwinError(
            f"{folder}: has {len(extra)} walks beyond those asked for, from {min(extra)} on: {_ANOTHER}"
        )
    write_request(folder, request)


def _differences(request: Mapping[str, object], previous: Mapping[str, object]) -> str:
    """What differs between two requests, as text; "" for equal ones."""
    keys = differing_keys(request, previous)
    if keys == ["digest"]:
        return "its campaign file, or a file that it names, has changed since"
    return "; ".join(
        f"{_LABELS.get(key, key)} {_text(previous.get(key))}, not {_text(request[key])}"
        for key in keys
        if key != "digest"
    )


def _text(value: object) -> str:
    """A setting as text for a message."""
    if isinstance(value, (list, tuple)):
        return ", ".join(value) or "none"
    return "as in the scenario" if value is None else str(value)
