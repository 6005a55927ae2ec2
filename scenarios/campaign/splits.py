"""Splits of a campaign's walks: nobody, and no terrain, is in two parts of one split.

People (and terrains) are dealt to the parts in the order in which they first come, by the fractional parts of multiples
of the golden section (a Weyl sequence: as even as can be): the shares hold for any number of them, and walks that are
added move nobody from one part to another.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stridetwin.scenarios.campaign.campaign_file import Splits

_GOLDEN = (5**0.5 - 1) / 2
_KEYS = {"person": 2, "terrain": 3}


def split(rows: Sequence[Mapping[str, Any]], splits: Splits, seed: int) -> dict[str, dict[str, str]]:
    """Which part each person and each terrain is in.

    Args:
        rows: All walks, in order.
        splits: Parts and their shares.
        seed: Of the campaign.

    Returns:
        For `person` and `terrain`, name to part.
    """
    return {
        by: _dealt(list(dict.fromkeys(k for row in rows if (k := group(row, by, splits)))), splits.shares, seed, by)
        for by in _KEYS
    }


def group(row: Mapping[str, Any], by: str, splits: Splits) -> str | None:
    """The person or the terrain of a walk, as the splits take it; None of one whose scenario is not valid."""
    key = "scenario" if (by, splits.terrain_by) == ("terrain", "scenario") else by
    return row.get(key) if "person" in row else None


def _dealt(names: Sequence[str], shares: Mapping[str, float], seed: int, by: str) -> dict[str, str]:
    start = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_KEYS[by],))).random()
    parts, ends = list(shares), np.cumsum(list(shares.values()))
    start *= ends[0]  # whoever comes first is in the first part
    return {
        name: parts[min(int(np.searchsorted(ends, (start + i * _GOLDEN) % 1.0, side="right")), len(parts) - 1)]
        for i, name in enumerate(names)
    }
