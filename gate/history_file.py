"""The history of scores over versions: a JSON-lines file with one line per run."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import NotRequired, TypedDict

from stridetwin.gate.compare import Comparison
from stridetwin.gate.formatting import collect_failures, to_sentence
from stridetwin.gate.score_table import ScoredWalk, check_scores, is_text
from stridetwin.outputs.base import Scores
from stridetwin.streams.errors import FieldLocation, StrideTwinError

_VERDICTS = PASSED, WORSE, FAILED, ALONE = "passed", "worse", "failed", "no baseline"
"""Verdicts on a run: nothing is worse, a score is worse than the baseline, an estimator failed, or no baseline."""
_WRITTEN = "lines that `stridetwin score --history` has written"  # what a file should hold, in messages
_MOST_WALKS = 1_000_000_000  # a larger number in a file is taken for damage


class HistoryLine(TypedDict):
    """The scores of one run in a history.

    Attributes:
        label: Version or commit.
        verdict: `passed`, `worse`, `failed` or `no baseline`.
        regressions: What became worse than the baseline, one sentence each.
        walks: Number of walks.
        walks_digest: Digest of the walks; scores of other walks cannot be compared.
        failed: Number of walks on which an estimator failed.
        estimators: Mean scores by estimator.
    """

    label: str
    verdict: str
    regressions: list[str]
    walks: int
    walks_digest: str
    failed: NotRequired[int]
    estimators: dict[str, Scores]


def history_line(
    label: str, rows: Sequence[ScoredWalk], means: Mapping[str, Scores], comparison: Comparison | None
) -> HistoryLine:
    """The entry of a run in the history.

    Args:
        label: Its version, such as a commit.
        rows: Results of `score_walk`.
        means: Mean scores by estimator.
        comparison: With the baseline; None without one.
    """
    # a regression takes precedence over a failure, and a failure over the lack of a baseline
    if comparison is not None and comparison.regressions:
        verdict = WORSE
    elif collect_failures(rows):
        verdict = FAILED
    else:
        verdict = ALONE if comparison is None else PASSED
    # the same walks give the same digest, in whatever order they were scored
    digests = "\n".join(sorted(row["sha256"] for row in rows))
    return {
        "label": label,
        "verdict": verdict,
        "regressions": [] if comparison is None else [to_sentence(line) for line in comparison.regressions],
        "walks": len(rows),
        "walks_digest": sha256(digests.encode()).hexdigest()[:16],
        "failed": sum(bool(row.get("failed")) for row in rows),
        "estimators": dict(means),
    }


def append_history(file: Path, line: HistoryLine) -> None:
    """Appends a line to a file, which is created if missing.

    Raises:
        ConfigError: `read_history` would not accept the line; the file stays unchanged.
    """
    _check(line, FieldLocation(source=f"{file}: new line"))
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a", encoding="utf-8") as out:
        out.write(json.dumps(line, sort_keys=True, allow_nan=False) + "\n")


def read_history(file: Path) -> list[HistoryLine]:
    """Reads the lines of a history, and checks that each has the form that `score --history` writes.

    Raises:
        StrideTwinError: There are none, or one has another form; names file, line and field.
    """
    lines: list[HistoryLine] = []
    try:
        texts = file.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError:
        raise StrideTwinError(f"{file}: is not text in UTF-8") from None
    for number, text in enumerate(texts, 1):
        try:
            lines.append(json.loads(text))
            _check(lines[-1], FieldLocation(source=f"{file}: line {number}"))
        except (ValueError, RecursionError) as error:
            raise StrideTwinError(f"{file}: line {number}: {error}; expected {_WRITTEN}") from None
    if not lines:
        raise StrideTwinError(f"{file}: no line in it; expected {_WRITTEN}")
    return lines


def _check(line: object, where: FieldLocation) -> None:
    """Checks that a line has the form of a `HistoryLine`.

    Args:
        line: Parsed JSON of the line.
        where: Its position, for errors.

    Raises:
        ConfigError: It is no mapping, or a field has another form; the first such field is named.
    """
    if not isinstance(line, dict):
        raise where.error(line, _WRITTEN)

    def need(fits: bool, name: str, valid: str) -> None:
        """Raises ConfigError for a field that does not fit; `valid` says what is expected."""
        if not fits:
            raise where.key(name).error(line.get(name), valid)

    for name in ("label", "walks_digest"):
        need(is_text(line.get(name)), name, "text in UTF-8")
    need(line.get("verdict") in _VERDICTS, "verdict", ", ".join(_VERDICTS))
    for name, count in (("walks", line.get("walks")), ("failed", line.get("failed", 0))):
        # true and false are integers for Python, too
        fits = isinstance(count, int) and not isinstance(count, bool) and 0 <= count <= _MOST_WALKS
        need(fits, name, f"a whole number, 0-{_MOST_WALKS}")
    worse = line.get("regressions")
    need(isinstance(worse, list) and all(map(is_text, worse)), "regressions", "a list of texts in UTF-8")
    check_scores(line.get("estimators"), where.key("estimators"))
