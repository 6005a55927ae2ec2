"""Scores of many walks, as `score --json` prints them and a later run takes them for its baseline."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stridetwin.scenarios.scoring import Scores
from stridetwin.streams.errors import StrideTwinError

EVERY = "every estimator"
"""Stands among those that failed where the built-in ones fell together."""


@dataclass(frozen=True, kw_only=True)
class ScoreTable:
    """Scores of some walks.

    Attributes:
        walks: By the digest of its recording (or a word of its own, where that is not told) what each estimator got.
        failed: By the same key the estimators that gave nothing to score, and why.
        means: Estimator to mean scores.
    """

    walks: Mapping[str, Mapping[str, Scores]]
    failed: Mapping[str, Mapping[str, str]]
    means: Mapping[str, Scores]


def table_of(document: object, source: str) -> ScoreTable:
    """What a file of scores says.

    Args:
        document: Its JSON.
        source: Its name for messages.

    Raises:
        StrideTwinError: It has not the form of `score --json`.
    """
    means = document.get("estimators") if isinstance(document, dict) else None
    entries = document.get("recordings", []) if isinstance(document, dict) else None
    if not isinstance(means, dict) or not isinstance(entries, list):
        raise StrideTwinError(f'{source}: is no baseline; valid: what `stridetwin score --json` prints ("estimators")')
    _check(means, source, "estimators")
    walks, failed = {}, {}
    for i, entry in enumerate(entries):
        if not isinstance(entry, dict) or "estimators" not in entry:
            continue  # of `run`: what was walked, with all scores in the means
        _check(entry["estimators"], source, f"recordings[{i}].estimators")
        key = str(entry.get("sha256") or f"recording {i}")
        walks[key] = entry["estimators"]
        failed[key] = entry.get("failed", {})
        if not isinstance(failed[key], dict):
            raise StrideTwinError(f"{source}: recordings[{i}].failed: is no baseline; valid: estimators, each with why")
    return ScoreTable(walks=walks, failed=failed, means=means)


def read_table(path: Path) -> ScoreTable:
    """A file of scores.

    Raises:
        StrideTwinError: It is not JSON, or has not the form of `score --json`.
        OSError: It cannot be read.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise StrideTwinError(f"{path}: is not JSON: {error}") from error
    return table_of(document, str(path))


def document_of(entries: Sequence[Mapping[str, Any]], means: Mapping[str, Scores]) -> dict[str, Any]:
    """The JSON of some walks' scores."""
    return {"recordings": list(entries), "estimators": dict(means)}


def _check(estimators: object, source: str, place: str) -> None:
    if not isinstance(estimators, dict):
        raise StrideTwinError(f"{source}: {place}: is no baseline; valid: estimators, each with its scores")
    for name, scores in estimators.items():
        if not isinstance(scores, dict):
            raise StrideTwinError(f"{source}: {place}.{name}: is no baseline; valid: scores by name")
        for metric, value in scores.items():
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not number or not math.isfinite(value):
                raise StrideTwinError(f"{source}: {place}.{name}.{metric}: {value!r} is not valid; valid: a number")
