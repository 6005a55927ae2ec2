"""The request that a campaign's folder belongs to, so that walks of two requests never mix."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from stridetwin.scenarios.campaign.campaign_file import Campaign
from stridetwin.scenarios.campaign.plan import Extra
from stridetwin.scenarios.campaign.walk import ROWS
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.files import json_text, whole_file

NAME = "request.json"
_ANOTHER = "expected the same request to resume, or another folder"
_WORDS = {"off": "sensors switched off:"}


def request(campaign: Campaign, extra: Extra, own: Mapping[str, str]) -> dict[str, Any]:
    """What decides which walks a campaign has, apart from their number: its name, seed and options, and a digest.

    Limits of quality, splits and the description may change, as they do not change a walk. The number of walks counts
    only where it changes them all (Latin hypercube).

    Args:
        campaign: The campaign.
        extra: Overrides for every walk.
        own: Digests of the user's files.
    """

    def plain(variables: Iterable[Any]) -> list[Any]:
        return [(v.name, repr(v.distribution)) for v in variables]

    what = [
        [(base.name, base.scenario, base.weight, plain(base.variables)) for base in campaign.bases],
        [(group.count, repr(group.body), group.names) for group in campaign.people],
        plain(campaign.variables),
        campaign.sampling,
        0 if campaign.sampling == "sobol" else campaign.walks,
        dict(own),
    ]
    digest = hashlib.sha256(json.dumps(what, sort_keys=True, default=str).encode()).hexdigest()[:16]
    return {"campaign": campaign.path.stem, "digest": digest, "seed": campaign.seed, **asdict(extra)}


def claim(folder: Path, asked: Mapping[str, Any], walks: Iterable[str]) -> None:
    """Takes a folder for a request, or confirms that it belongs to it.

    Args:
        folder: The campaign's folder, locked.
        asked: The request.
        walks: Names of its walks.

    Raises:
        StrideTwinError: The folder has walks of another request.
    """
    file, there = folder / NAME, {row.stem for row in (folder / ROWS).glob("*.json")}
    if there and not file.is_file():
        raise StrideTwinError(f"{folder}: has walks without their request (earlier version): expected another folder")
    if there and (differing := _differing(json.loads(file.read_text(encoding="utf-8")), asked)):
        raise StrideTwinError(f"{folder}: has walks of another request ({differing}): {_ANOTHER}")
    if more := there - set(walks):
        raise StrideTwinError(
            f"{folder}: has {len(more)} walks beyond those asked for, from {min(more)} on: {_ANOTHER}"
        )
    with whole_file(file) as new:
        new.write_text(json_text(dict(asked)), encoding="utf-8")


def _differing(had: Mapping[str, Any], asked: Mapping[str, Any]) -> str:
    """The values that differ, as text; "" for the same request."""
    now = json.loads(json_text(dict(asked)))
    parts = [
        f"{_WORDS.get(key, key)} {_text(had.get(key))}, not {_text(value)}"
        for key, value in now.items()
        if key != "digest" and had.get(key) != value
    ]
    if not parts and had.get("digest") != now["digest"]:
        parts = ["its campaign file, or a file that it names, has changed since"]
    return "; ".join(parts)


def _text(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(value) or "none"
    return "as in the scenario" if value is None else str(value)
