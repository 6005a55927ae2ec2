"""The manifest of a campaign: configuration, checksum, verdict and split parts of every walk.

It holds no time, machine or number of workers, so it has the same bytes wherever it is made. No person and no terrain
is in two parts of one split. They are assigned in order of their first walk, by the fractional parts of multiples of
the golden ratio (a Weyl sequence): shares hold for any number of them, and more walks move no one to another part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stridetwin.scenarios.campaign.campaign_file import Campaign, Splits
from stridetwin.scenarios.campaign.walk import ACCEPTED

_GOLDEN = (5**0.5 - 1) / 2
_KEYS = {"person": 2, "terrain": 3}


def split(rows: Sequence[Mapping[str, Any]], splits: Splits, seed: int) -> dict[str, dict[str, str]]:
    """Assigns each person and each terrain to a part.

    Args:
        rows: All walks, in order.
        splits: Parts and their shares.
        seed: Of the campaign.

    Returns:
        For `person` and `terrain`, name to part.
    """
    return {
        by: _assigned(list(dict.fromkeys(k for row in rows if (k := group(row, by, splits)))), splits.shares, seed, by)
        for by in _KEYS
    }


def group(row: Mapping[str, Any], by: str, splits: Splits) -> str | None:
    """The person or the terrain of a walk; None where its scenario is invalid."""
    key = "scenario" if (by, splits.terrain_by) == ("terrain", "scenario") else by
    return row.get(key) if "person" in row else None


def _assigned(names: Sequence[str], shares: Mapping[str, float], seed: int, by: str) -> dict[str, str]:
    start = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_KEYS[by],))).random()
    parts, ends = list(shares), np.cumsum(list(shares.values()))
    start *= ends[0]  # the first one is in the first part
    return {
        name: parts[min(int(np.searchsorted(ends, (start + i * _GOLDEN) % 1.0, side="right")), len(parts) - 1)]
        for i, name in enumerate(names)
    }


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
    """Each varying value, with its distribution as text; values of one scenario begin with its name."""
    found = {v.name: v.distribution.words for v in campaign.variables if v.varies}
    for base in campaign.bases:
        found |= {f"{base.name}: {v.name}": v.distribution.words for v in base.variables if v.varies}
    for i, people in enumerate(campaign.people):
        if people.names:
            found[f"people[{i}]"] = ", ".join(people.names)
        for key, distribution in people.body.items():
            found[f"people[{i}].{key}"] = distribution.words
    return found
