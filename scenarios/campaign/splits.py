"""Splits of a campaign's walks: no person and no terrain is in two parts of one split.

People and terrains are assigned in order of their first walk, by the fractional parts of multiples of the golden ratio
(a Weyl sequence). The shares hold for any number of them, and additional walks move no one to another part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stridetwin.scenarios.campaign.campaign_file import Splits

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
