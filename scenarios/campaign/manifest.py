"""The manifest of a campaign: every walk, what it was made of, its checksum, its verdict and its part of each split.

It says nothing of when, where and by how many workers the walks were made, so that these change no byte of it.
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
    """The manifest as JSON has it.

    Args:
        campaign: What was asked.
        rows: All walks, in order.
        versions: Of the code that made them.
        own: Checksum of each file of the user's own.
    """
    dealt = split(rows, campaign.splits, campaign.seed)
    walks, bodies = [], {}
    for row in rows:
        told = {key: value for key, value in row.items() if key not in ("key", "body")}
        if "person" in row:
            bodies[row["person"]] = row["body"]
        if row["status"] == ACCEPTED:
            told["split"] = {by: dealt[by][str(group(row, by, campaign.splits))] for by in dealt}
        walks.append(told)
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
