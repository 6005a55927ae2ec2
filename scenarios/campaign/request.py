"""The request that a campaign's folder belongs to, so that walks of two requests never mix."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from stridetwin.batch.folder import differing_keys, read_request, write_request
from stridetwin.scenarios.campaign.campaign_file import Campaign
from stridetwin.scenarios.campaign.plan import Extra
from stridetwin.scenarios.campaign.walk import ROWS
from stridetwin.streams.errors import StrideTwinError

_ANOTHER = "expected the same request to resume, or another folder"
_LABELS = {"off": "sensors switched off:"}


def campaign_request(campaign: Campaign, extra: Extra, user_files: Mapping[str, str]) -> dict[str, Any]:
    """What decides which walks a campaign has, apart from their number: its name, seed and options, and a digest.

    Limits of quality, splits and the description may change, as they do not change a walk. The number of walks counts
    only where it changes them all (Latin hypercube).

    Args:
        campaign: The campaign.
        extra: Overrides for every walk.
        user_files: Digests of the user's files.
    """

    def plain(variables: Iterable[Any]) -> list[Any]:
        return [(v.name, repr(v.distribution)) for v in variables]

    content = [
        [(base.name, base.scenario, base.weight, plain(base.variables)) for base in campaign.bases],
        [(group.count, repr(group.body), group.names) for group in campaign.people],
        plain(campaign.variables),
        campaign.sampling,
        0 if campaign.sampling == "sobol" else campaign.walks,
        dict(user_files),
    ]
    digest = hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()[:16]
    return {"campaign": campaign.path.stem, "digest": digest, "seed": campaign.seed, **asdict(extra)}


def bind_folder(folder: Path, request: Mapping[str, Any], walk_names: Iterable[str]) -> None:
    """Binds a folder to a request, or confirms that it belongs to it.

    Args:
        folder: The campaign's folder, locked.
        request: The request.
        walk_names: Names of its walks.

    Raises:
        StrideTwinError: The folder has walks of another request.
    """
    existing = {row.stem for row in (folder / ROWS).glob("*.json")}
    previous = read_request(folder)
    if existing and previous is None:
        raise StrideTwinError(f"{folder}: has walks without their request (earlier version): expected another folder")
    if existing and (differing := _differences(request, previous)):
        raise StrideTwinError(f"{folder}: has walks of another request ({differing}): {_ANOTHER}")
    if extra := existing - set(walk_names):
        raise StrideTwinError(
            f"{folder}: has {len(extra)} walks beyond those asked for, from {min(extra)} on: {_ANOTHER}"
        )
    write_request(folder, request)


def _differences(request: Mapping[str, Any], previous: Mapping[str, Any]) -> str:
    """The values that differ, as text; "" for the same request."""
    keys = differing_keys(request, previous)
    if keys == ["digest"]:
        return "its campaign file, or a file that it names, has changed since"
    return "; ".join(
        f"{_LABELS.get(key, key)} {_text(previous.get(key))}, not {_text(request[key])}"
        for key in keys
        if key != "digest"
    )


def _text(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return ", ".join(value) or "none"
    return "as in the scenario" if value is None else str(value)
