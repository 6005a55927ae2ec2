"""The manifest of a campaign: configuration, checksum, verdict and part of each split of every walk.

It holds no time, machine or number of workers, so that these change no byte of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from stridetwin.scenarios.campaign.campaign_file import Campaign
from stridetwin.scenarios.campaign.splits import group, split
from stridetwin.scenarios.campaign.walk import ACCEPTED

FORMAT = "stridetwin-campaign-1"
NAME = "manifest.json"


def manifest(
    campaign: Campaign, rows: Sequence[Mapping[str, Any]], versions: Mapping[str, str], own: Mapping[str, str]
) -> dict[str, Any]:
    """The manifest as JSON holds it.

    Args:
        campaign: Its configuration.
        rows: All walks, in order.
        versions: Of the code that made them.
        own: Checksum of each of the user's files.
    """
    dealt = split(rows, campaign.splits, campaign.seed)
    walks, bodies = [], {}
    for row in rows:
        entry = {key: value for key, value in row.items() if key not in ("key", "body")}
        if "person" in row:
            bodies[row["person"]] = row["body"]
        if row["status"] == ACCEPTED:
            entry["split"] = {by: dealt[by][str(group(row, by, campaign.splits))] for by in dealt}
        walks.append(entry)
    return {
        "format": FORMAT,
        "campaign": campaign.path.stem,
        "description": campaign.description,
        "seed": campaign.seed,
        "sampling": campaign.sampling,
        "scenarios": sorted({base.name for base in campaign.bases}),
        "ranges": ranges(campaign),
        "quality": vars(campaign.quality),
        "shares": campaign.splits.shares,
        "terrain_by": campaign.splits.terrain_by,
        "versions": dict(versions),
        "files": dict(own),
        "people": bodies,
        "splits": dealt,
        "walks": walks,
    }


def ranges(campaign: Campaign) -> dict[str, str]:
    """Each value that varies, with its distribution in words; those of one scenario begin with its name."""
    found = {v.name: v.distribution.words for v in campaign.variables if v.varies}
    for base in campaign.bases:
        found |= {f"{base.name}: {v.name}": v.distribution.words for v in base.variables if v.varies}
    for i, people in enumerate(campaign.people):
        if people.names:
            found[f"people[{i}]"] = ", ".join(people.names)
        for key, distribution in people.body.items():
            found[f"people[{i}].{key}"] = distribution.words
    return found
