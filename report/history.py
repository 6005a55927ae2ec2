"""The page that plots a history of scores over versions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from stridetwin.gate.history_file import WORSE, HistoryLine
from stridetwin.gate.metric_policy import scale_of
from stridetwin.pages.html import multiples, page, section, table
from stridetwin.pages.plot import PALETTE, Plot, data_range

_NAMES = 6  # version names below a plot


def history_page(lines: Sequence[HistoryLine], title: str) -> str:
    """Renders a history as an HTML page: the verdict of each version, and each estimator's scores over the versions."""
    names = list(dict.fromkeys(name for line in lines for name in line["estimators"]))
    worse_count = sum(line["verdict"] == WORSE for line in lines)
    lead = "Means over the walks, from version to version; where the walks are others, the line is broken."
    sections = [section(name, lead, _plots(name, lines)) for name in names]
    chips = [f"{len(lines)} versions", f"{lines[-1]['walks']} walks", f"{worse_count} times worse than the baseline"]
    # above the estimators
    sections.insert(0, section("Verdicts", "The latest first.", _verdicts(lines)))
    return page(title, "Scores of the estimators, version by version.", chips, sections, "Drawn by stridetwin history.")


def _plots(name: str, lines: Sequence[HistoryLine]) -> str:
    """One small plot for each score of an estimator that the gate compares."""
    # each score once; the gate compares those that have a scale
    metrics = dict.fromkeys(m for line in lines for m in line["estimators"].get(name, {}) if scale_of(m) is not None)
    return multiples(_plot(name, metric, lines) for metric in metrics)


def _plot(name: str, metric: str, lines: Sequence[HistoryLine]) -> str:
    """Plots a score over the versions; the line breaks where the walks change, and worse versions are marked.

    Args:
        name: Name of the estimator in the scores.
        metric: Name of the score; versions without it have no point.
        lines: The history, the oldest version first.
    """
    values = np.array([line["estimators"].get(name, {}).get(metric, np.nan) for line in lines], float)
    places = np.arange(len(lines), dtype=float)  # of the versions on the x axis
    plot = Plot(
        title=f"{name} {metric}",
        x=(-0.5, max(len(lines) - 0.5, 0.5)),
        y=data_range(values, include=(0.0,)),
        x_label="version",
        y_label=metric,
        x_names=_labels(lines),
        height=230,
    )
    walks = np.array([line["walks_digest"] for line in lines])
    # runs of versions that were scored on the same walks, as indices
    same_walks = np.split(np.arange(len(lines)), np.flatnonzero(walks[1:] != walks[:-1]) + 1)
    plot.curves([np.column_stack([places, values])[part] for part in same_walks], PALETTE[0])
    # beginnings of the sentences about this score; the gate names both feet of an estimator without `_l` or `_r`
    beginnings = tuple(f"{output} {metric}:" for output in (name, name.removesuffix("_l").removesuffix("_r")))
    # which versions have such a sentence
    worse = np.array([any(sentence.startswith(beginnings) for sentence in line["regressions"]) for line in lines])
    is_scored = np.isfinite(values)
    plot.dots(places[is_scored & ~worse], values[is_scored & ~worse], PALETTE[0])
    if worse.any():
        plot.dots(places[is_scored & worse], values[is_scored & worse], PALETTE[1], size=9, label="worse")
    return plot.html()


def _labels(lines: Sequence[HistoryLine]) -> list[str]:
    """Short names for the axis of a plot, one per version.

    Only evenly spaced versions have one, at most `_NAMES`, including the last one; the others have "".
    """
    every = -(-len(lines) // _NAMES)  # every n-th version has a name; rounded up
    from_last = reversed(range(len(lines)))  # how many versions come after each one
    return [str(line["label"])[:8] if later % every == 0 else "" for later, line in zip(from_last, lines)]


def _verdicts(lines: Sequence[HistoryLine]) -> str:
    """A table of the versions, the latest first, with what became worse or failed."""
    head = ("version", "verdict", "walks", "what became worse, or failed")
    rows = [
        (line["label"], line["verdict"], line["walks"], Markup("<br>").join(_describe_problems(line)))
        for line in reversed(lines)
    ]
    return table(head, rows, (2,))  # column 2 has numbers


def _describe_problems(line: HistoryLine) -> list[str]:
    """Sentences on what became worse or failed in one version."""
    failed = line.get("failed", 0)
    return [*line["regressions"], *([f"an estimator failed on {failed} of {line['walks']} walks"] if failed else [])]
