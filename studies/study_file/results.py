"""What a study's rows say: means with intervals, the comparison of the methods, and both as text and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from stridetwin.batch.jobs import Row
from stridetwin.gate.metric_policy import Scale, scale_of
from stridetwin.outputs.base import CLAIM, Scores
from stridetwin.streams.samples import Array
from stridetwin.studies.significance import Difference, differences, interval_text, intervals, why_untested
from stridetwin.studies.study_file.study import Study


def score_values(study: Study, rows: Sequence[Row]) -> Array:
    """(C, M, W, S) scores of C combinations, M methods and W walks; means over outputs, NaN where missing.

    Args:
        study: The study.
        rows: Those of the walks of the first combination, then of the next ones.
    """
    values = [
        [_mean_of_outputs(row["scores"].get(method.name, {}), score) for score in study.scores]
        for row in rows
        for method in study.methods
    ]
    shape = len(study.combinations), len(study.seeds), len(study.methods), len(study.scores)
    return np.reshape(values, shape).swapaxes(1, 2)


def _mean_of_outputs(outputs: dict[str, Scores], score: str) -> float:
    """The mean over outputs, such as both feet; a score whose sign has a meaning counts without it."""
    scale = scale_of(score)
    found = [scores[score] for scores in outputs.values() if score in scores]
    return float(np.mean(np.abs(found) if scale is not None and scale.signed else found)) if found else np.nan


def collect_result(study: Study, rows: Sequence[Row]) -> dict[str, Any]:
    """The result as JSON holds it: `study`, `factors`, `scores`, `seeds`, `table`, `comparisons`, `words`, `failed`."""
    values = score_values(study, rows)
    labels = [dict(combination.labels) for combination in study.combinations]
    table: list[dict[str, Any]] = [
        label | {"method": method.name, "scores": {}} for label in labels for method in study.methods
    ]
    for s, score in enumerate(study.scores):
        columns = intervals(values[..., s].reshape(len(table), -1).T)
        for line, column in zip(table, columns):
            if np.isfinite(column.mean):
                line["scores"][score] = asdict(column)
    comparisons = _compare(study, values)
    walks = [(label, seed) for label in labels for seed in study.seeds]
    return {
        "study": study.description,
        "factors": list(labels[0]),
        "methods": [method.name for method in study.methods],
        "scores": list(study.scores),
        "seeds": list(study.seeds),
        "table": table,
        "comparisons": comparisons,
        "words": _words(study, comparisons),
        "failed": [
            label | {"seed": seed, "method": method, "reason": reason}
            for (label, seed), row in zip(walks, rows)
            for method, reason in row["failed"].items()
        ],
    }


def _compare(study: Study, values: Array) -> list[dict[str, Any]]:
    """Each method against the first in each combination, walk by walk, on the scale of the score."""
    places, columns, scales = [], [], []
    for s, score in enumerate(study.scores):
        scale = scale_of(score)
        for m, method in enumerate(study.methods[1:], 1):
            for c, combination in enumerate(study.combinations):
                if scale is not None and np.isfinite(values[c, [0, m], :, s]).all():
                    losses = [[scale.loss(value) for value in values[c, i, :, s]] for i in (0, m)]
                    columns.append(np.subtract(losses[1], losses[0]))
                    scales.append(scale)
                    places.append({"score": score, "method": method.name, "levels": dict(combination.labels)})
    if len(study.seeds) < 2 or not columns:
        return []
    tested = differences(np.column_stack(columns))
    return [place | _change(scale, difference) for place, scale, difference in zip(places, scales, tested)]


def _change(scale: Scale, difference: Difference) -> dict[str, Any]:
    """A difference of losses as a change of the score, and what it means."""
    ends = [scale.change(end) for end in (difference.low, difference.high) if end is not None]
    low, high = sorted(ends) if ends else (None, None)
    directions = ("higher", "lower") if scale.kind == CLAIM else ("worse", "better")
    return {
        "change": scale.change(difference.mean), "unit": "points" if scale.in_points else "%", "low": low,
        "high": high, "p": difference.p, "verdict": directions[difference.mean < 0] if difference.significant else "",
    }  # fmt: skip


def _words(study: Study, comparisons: Sequence[dict[str, Any]]) -> list[str]:
    """For each score and method, in which combinations it differs significantly from the first method."""
    if len(study.methods) == 1:
        return []
    if why := why_untested(len(study.seeds)):
        return [why]
    texts = []
    for score in study.scores:
        for method in study.methods[1:]:
            own = [c for c in comparisons if (c["score"], c["method"]) == (score, method.name)]
            subject = f"{score}: {method.name}"
            if not own:
                texts.append(f"{subject} cannot be compared with {study.methods[0].name}.")
                continue
            verdicts = dict.fromkeys(c["verdict"] for c in own if c["verdict"])
            parts = [
                f"{verdict} than {study.methods[0].name} with "
                + "; ".join(_place(c) for c in own if c["verdict"] == verdict)
                for verdict in verdicts
            ]
            if unsure := sum(not c["verdict"] for c in own):
                count = f"in {unsure} of {len(own)} combinations" if len(own) > 1 else "here"
                parts.append(f"no significant difference from {study.methods[0].name} {count}")
            texts.append(f"{subject}: {'. '.join(parts)}.")
    return texts


def _place(comparison: dict[str, Any]) -> str:
    levels = ", ".join(comparison["levels"].values())
    change = f"{comparison['change']:+.3g} {comparison['unit']}"
    return f"{levels} ({change})" if levels else change


def table_head(result: dict[str, Any]) -> list[str]:
    """Titles of the columns of `table_rows`; the first ones, without the scores, are text."""
    return [*result["factors"], "method", *result["scores"]]


def table_rows(result: dict[str, Any]) -> list[list[str]]:
    """The table as text: the levels, the method, and each score with its interval."""
    return [
        [*(line[name] for name in [*result["factors"], "method"]),
         *(interval_text(line["scores"].get(score)) for score in result["scores"])]
        for line in result["table"]
    ]  # fmt: skip


def failure_lines(result: dict[str, Any]) -> list[str]:
    """How often each method failed, with the first reason."""
    by_method: dict[str, list[dict[str, Any]]] = {}
    for failure in result["failed"]:
        by_method.setdefault(failure["method"], []).append(failure)
    return [f"{name} failed on {len(failures)} walks: {failures[0]['reason']}" for name, failures in by_method.items()]


def csv_text(study: Study, rows: Sequence[Row]) -> str:
    """A row per walk, method and score."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    values = score_values(study, rows)
    labels = [combination.labels for combination in study.combinations]
    writer.writerow([*labels[0], "seed", "method", "score", "value"])
    for (c, w, m, s), _ in np.ndenumerate(values.swapaxes(1, 2)):
        value = values[c, m, w, s]
        number = f"{value:.9g}" if np.isfinite(value) else ""
        writer.writerow([*labels[c].values(), study.seeds[w], study.methods[m].name, study.scores[s], number])
    return out.getvalue()
