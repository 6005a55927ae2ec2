"""The history of scores over versions: a JSON-lines file with one line per run, and a page that plots it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from stridetwin.gate.compare import Comparison
from stridetwin.gate.formatting import failures, sentence
from stridetwin.gate.metric_policy import scale_of
from stridetwin.gate.score_table import checked_scores, is_text
from stridetwin.outputs.base import Scores
from stridetwin.pages.html import multiples, page, section, table
from stridetwin.pages.plot import PALETTE, Plot, data_range
from stridetwin.streams.errors import FieldLocation, StrideTwinError

_VERDICTS = PASSED, WORSE, FAILED, ALONE = "passed", "worse", "failed", "no baseline"
_NAMES = 6  # version names below a plot
_WRITTEN = "lines that `stridetwin score --history` has written"
_MOST_WALKS = 1_000_000_000


def history_line(
    label: str, rows: Sequence[Mapping[str, Any]], means: Mapping[str, Scores], comparison: Comparison | None
) -> dict[str, Any]:
    """The history entry of a run: its version or commit, the walks' rows, and the mean scores by estimator."""
    if comparison is not None and comparison.regressions:
        verdict = WORSE
    elif failures(rows):
        verdict = FAILED
    else:
        verdict = ALONE if comparison is None else PASSED
    digests = "\n".join(sorted(str(row["sha256"]) for row in rows))
    return {
        "label": label,
        "verdict": verdict,
        "regressions": [] if comparison is None else [sentence(line) for line in comparison.regressions],
        "walks": len(rows),
        "walks_digest": sha256(digests.encode()).hexdigest()[:16],
        "failed": sum(bool(row.get("failed")) for row in rows),
        "estimators": dict(means),
    }


def append_history(file: Path, line: Mapping[str, Any]) -> None:
    """Appends a line to a file, which is created if missing.

    Raises:
        ConfigError: `read_history` does not accept the file, which stays unchanged.
    """
    _check(line, FieldLocation(source=f"{file}: new line"))
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a", encoding="utf-8") as out:
        out.write(json.dumps(line, sort_keys=True, allow_nan=False) + "\n")


def read_history(file: Path) -> list[dict[str, Any]]:
    """The lines of a file.

    Raises:
        StrideTwinError: There are none, or one does not have the form of `score --history`.
    """
    lines = []
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
    """Raises ConfigError at the first field that differs from the form of `history_line`."""
    if not isinstance(line, dict):
        raise where.error(line, _WRITTEN)

    def need(fits: bool, name: str, valid: str) -> None:
        if not fits:
            raise where.key(name).error(line.get(name), valid)

    for name in ("label", "walks_digest"):
        need(is_text(line.get(name)), name, "text in UTF-8")
    need(line.get("verdict") in _VERDICTS, "verdict", ", ".join(_VERDICTS))
    for name, count in (("walks", line.get("walks")), ("failed", line.get("failed", 0))):
        fits = isinstance(count, int) and not isinstance(count, bool) and 0 <= count <= _MOST_WALKS
        need(fits, name, f"a whole number, 0-{_MOST_WALKS}")
    worse = line.get("regressions")
    need(isinstance(worse, list) and all(map(is_text, worse)), "regressions", "a list of texts in UTF-8")
    checked_scores(line.get("estimators"), where.key("estimators"))


def history_page(lines: Sequence[Mapping[str, Any]], title: str) -> str:
    """The lines as a page: each estimator's scores from version to version, and the verdicts."""
    names = list(dict.fromkeys(name for line in lines for name in line["estimators"]))
    worse = sum(line["verdict"] == WORSE for line in lines)
    lead = "Means over the walks, from version to version; where the walks are others, the line is broken."
    sections = [section(name, lead, _plots(name, lines)) for name in names]
    chips = [f"{len(lines)} versions", f"{lines[-1]['walks']} walks", f"{worse} times worse than the baseline"]
    sections.insert(0, section("Verdicts", "The latest first.", _verdicts(lines)))
    return page(title, "Scores of the estimators, version by version.", chips, sections, "Drawn by stridetwin history.")


def _plots(name: str, lines: Sequence[Mapping[str, Any]]) -> str:
    metrics = dict.fromkeys(m for line in lines for m in line["estimators"].get(name, {}) if scale_of(m) is not None)
    return multiples(_plot(name, metric, lines) for metric in metrics)


def _plot(name: str, metric: str, lines: Sequence[Mapping[str, Any]]) -> str:
    values = np.array([line["estimators"].get(name, {}).get(metric, np.nan) for line in lines], float)
    places = np.arange(len(lines), dtype=float)
    plot = Plot(
        title=f"{name} {metric}", x=(-0.5, max(len(lines) - 0.5, 0.5)), y=data_range(values, include=(0.0,)),
        x_label="version", y_label=metric, x_names=_labels(lines), height=230,
    )  # fmt: skip
    walks = np.array([line["walks_digest"] for line in lines])
    same_walks = np.split(np.arange(len(lines)), np.flatnonzero(walks[1:] != walks[:-1]) + 1)
    plot.curves([np.column_stack([places, values])[part] for part in same_walks], PALETTE[0])
    marked = tuple(f"{own} {metric}:" for own in (name, name.removesuffix("_l").removesuffix("_r")))
    worse = np.array([any(words.startswith(marked) for words in line["regressions"]) for line in lines])
    there = np.isfinite(values)
    plot.dots(places[there & ~worse], values[there & ~worse], PALETTE[0])
    if worse.any():
        plot.dots(places[there & worse], values[there & worse], PALETTE[1], size=9, label="worse")
    return plot.html()


def _labels(lines: Sequence[Mapping[str, Any]]) -> list[str]:
    """Names of evenly spaced versions including the last one."""
    every = -(-len(lines) // _NAMES)
    return [str(x["label"])[:8] if (len(lines) - 1 - i) % every == 0 else "" for i, x in enumerate(lines)]


def _verdicts(lines: Sequence[Mapping[str, Any]]) -> str:
    head = ("version", "verdict", "walks", "what became worse, or failed")
    rows = [(x["label"], x["verdict"], x["walks"], Markup("<br>").join(_bad(x))) for x in reversed(lines)]
    return table(head, rows, (2,))


def _bad(line: Mapping[str, Any]) -> list[str]:
    failed = line.get("failed", 0)
    return [*line["regressions"], *([f"an estimator failed on {failed} of {line['walks']} walks"] if failed else [])]
