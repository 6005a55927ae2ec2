"""Scores of many walks in the form that `score --json` prints and a later run reads as its baseline."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NotRequired, TypedDict, TypeGuard

from stridetwin.gate.metric_policy import scale_of
from stridetwin.outputs.base import Scores
from stridetwin.outputs.path.evaluate import LARGEST_SCORE
from stridetwin.streams.errors import FieldLocation, StrideTwinError

EVERY_ESTIMATOR = "every estimator"
"""Name in the failures if the built-in estimators failed together."""
_MIN_SIZE = 1e-100  # smallest absolute value of a score other than 0: a value divided by it stays finite
_MAX_NAME_LENGTH = 400  # characters
_EXPECTED_FORM = "what `stridetwin score --json` prints"  # in messages


class ScoredWalk(TypedDict):
    """The scores of one recording.

    Attributes:
        name: Name in the table.
        sha256: Digest of the recording.
        metadata: Its scenario, seed and physics, as far as the recording has them.
        estimators: Scores by output.
        failed: Reasons by estimator, if one failed.
    """

    name: str
    sha256: str
    metadata: dict[str, str]
    estimators: dict[str, Scores]
    failed: NotRequired[dict[str, str]]


@dataclass(frozen=True, kw_only=True)
class ScoreTable:
    """Scores of walks, as `score --json` prints them.

    Attributes:
        walks: Scores of each estimator, by the digest of the recording (or a unique word, if that is unknown).
        failed: By the same key, the estimators that could not be scored, and the reasons.
        means: Estimator to mean scores.
    """

    walks: Mapping[str, Mapping[str, Scores]]
    failed: Mapping[str, Mapping[str, str]]
    means: Mapping[str, Scores]


def table_of(document: object, source: str) -> ScoreTable:
    """The table in the JSON of a file of scores; `source` is its name in messages.

    Raises:
        ConfigError: It does not have the form of `score --json`.
    """
    top = FieldLocation(source=source)
    if not isinstance(document, dict):
        raise top.error(document, _EXPECTED_FORM)
    means = check_scores(document.get("estimators"), top.key("estimators"))
    entries = document.get("recordings", [])
    if not isinstance(entries, list):
        raise top.key("recordings").error(entries, f"a list, {_EXPECTED_FORM}")
    walks: dict[str, dict[str, Scores]] = {}
    failed: dict[str, dict[str, str]] = {}
    for i, entry in enumerate(entries):
        where = top.key("recordings").item(i)
        if not isinstance(entry, dict):
            raise where.error(entry, f"a walk, {_EXPECTED_FORM}")
        if "estimators" not in entry:
            continue  # the file is from `run`, whose entry only describes its walk: all its scores are in the means
        digest = entry.get("sha256")
        if not (digest is None or is_text(digest)):
            raise where.key("sha256").error(digest, "text in UTF-8")
        key = digest or f"recording {i}"  # without a digest a word that occurs once in the table
        walks[key] = check_scores(entry["estimators"], where.key("estimators"))
        reasons = _check_names(entry.get("failed", {}), where.key("failed"), "estimators, each with a reason")
        failed[key] = {}
        for name, why in reasons.items():
            if not isinstance(why, str):
                raise where.key("failed").key(name).error(why, "text")
            failed[key][name] = why
    return ScoreTable(walks=walks, failed=failed, means=means)


def read_table(path: str | Path) -> ScoreTable:
    """Reads a baseline: a file of scores with at least one comparable score.

    Raises:
        StrideTwinError: It is not JSON, does not have the form of `score --json`, or holds no gated score.
        OSError: It cannot be read.
    """
    try:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
        table = table_of(document, str(path))
    except (ValueError, RecursionError) as error:
        raise StrideTwinError(f"{path}: is not JSON: {error}; expected {_EXPECTED_FORM}") from error
    # the means and the walks must each have a score that the gate compares
    walks = [entry["estimators"] for entry in document.get("recordings", []) if "estimators" in entry]
    for field, tables in (("estimators", [table.means]), ("recordings", walks)):
        names = [metric for estimators in tables for scores in estimators.values() for metric in scores]
        if tables and all(scale_of(name) is None for name in names):
            raise FieldLocation(source=str(path), path=field).error(document[field], "at least one comparable score")
    return table


def check_scores(node: object, where: FieldLocation) -> dict[str, Scores]:
    """Checks that a node of a file maps estimators to scores by name, and returns these.

    Args:
        node: The node.
        where: Its position in the file, for errors.

    Raises:
        ConfigError: It has another form, or a value is no number of a valid size; the message has the path of the
            field.
    """
    estimators: dict[str, Scores] = {}
    for name, scores in _check_names(node, where, f"estimators, each with its scores: {_EXPECTED_FORM}").items():
        estimators[name] = {}
        for metric, value in _check_names(scores, where.key(name), "scores by name").items():
            if not (_is_number(value) and (value == 0 or _MIN_SIZE <= abs(value) <= LARGEST_SCORE)):
                valid = f"a number, 0 or of {_MIN_SIZE:g} to {LARGEST_SCORE:g} in size"
                raise where.key(name).key(metric).error(value, valid)
            estimators[name][metric] = value
    return estimators


def _is_number(value: object) -> TypeGuard[float]:
    """Whether it is a number of a JSON file, and not true or false."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def is_text(value: object) -> TypeGuard[str]:
    """Whether it is text that can be encoded: without unpaired surrogates."""
    return isinstance(value, str) and value.encode("utf-8", "ignore").decode() == value


def document_of(entries: Sequence[ScoredWalk], means: Mapping[str, Scores]) -> dict[str, object]:
    """The scores of some walks as `score --json` prints them.

    Args:
        entries: Rows of the walks.
        means: Mean scores by estimator.
    """
    return {"recordings": list(entries), "estimators": dict(means)}


def _check_names(value: object, where: FieldLocation, valid: str) -> dict[str, object]:
    """Checks that a value is a mapping whose keys are names, and returns it.

    Args:
        value: Node of a file.
        where: Its position.
        valid: What is valid there, for the error.

    Raises:
        ConfigError: It is no mapping, or a key is too long or no text in UTF-8.
    """
    if not isinstance(value, dict):
        raise where.error(value, valid)
    for name in value:
        if not is_text(name) or len(name) > _MAX_NAME_LENGTH:
            raise where.error(name, f"names in UTF-8, of up to {_MAX_NAME_LENGTH} characters")
    return value


def mean_scores(all_scores: Iterable[dict[str, Scores]]) -> dict[str, Scores]:
    """Mean of each score over recordings, per estimator; of a score with `_max_` in its name the largest value.

    Args:
        all_scores: For each recording, estimator to its scores by name. A recording without a score does not count in
            the score's mean.
    """
    values: dict[str, dict[str, list[float]]] = {}  # by estimator and score, over the recordings that have it
    for recording in all_scores:
        for name, scores in recording.items():
            for metric, value in scores.items():
                values.setdefault(name, {}).setdefault(metric, []).append(value)
    return {
        name: {
            metric: max(of_recordings) if "_max_" in metric else sum(of_recordings) / len(of_recordings)
            for metric, of_recordings in metrics.items()
        }
        for name, metrics in values.items()
    }
