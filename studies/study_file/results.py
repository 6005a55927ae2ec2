"""What a study's rows say: means with intervals, the comparison of the methods, and both as text and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from itertools import product
from typing import NotRequired, TypedDict

import numpy as np

from stridetwin.gate.metric_policy import Scale, scale_of
from stridetwin.outputs.base import CLAIM, Scores
from stridetwin.streams.samples import Array
from stridetwin.studies.significance import (
    Difference,
    IntervalRow,
    Sentences,
    differences,
    interval_text,
    intervals,
    missing_test_reason,
)
from stridetwin.studies.study_file.study import Study
from stridetwin.studies.study_file.walk import StudyRow

_MAX_PCT = 200.0
"""A larger increase is written as a factor."""


class TableLine(TypedDict):
    """A combination and a method.

    Attributes:
        levels: Names of the combination's levels, by factor.
        method: Name of the method.
        scores: By name, each score's mean over the walks with its 95 % interval; missing ones are left out.
    """

    levels: dict[str, str]
    method: str
    scores: dict[str, IntervalRow]


class ComparedMethod(TypedDict):
    """A method that is compared with the first one in a combination, by one score.

    Attributes:
        score: Name of the score.
        method: Name of the method.
        levels: Names of the combination's levels, by factor.
    """

    score: str
    method: str
    levels: dict[str, str]


class ScoreChange(TypedDict):
    """The change of a score from the first method to another one.

    Attributes:
        change: Mean change.
        unit: Its unit, `%` or `points`.
        low: Lower end of its 95 % interval; None with one or two walks.
        high: Upper end.
        p: p-value, corrected for the number of comparisons.
        verdict: `better`, `worse`, `higher` or `lower`; "" if the change is not significant.
    """

    change: float
    unit: str
    low: float | None
    high: float | None
    p: float
    verdict: str


class MethodComparison(ComparedMethod, ScoreChange):
    """A method against the first one in a combination, by one score."""


class MethodFailure(TypedDict):
    """A walk on which a method failed, and the reason.

    Attributes:
        levels: Names of the combination's levels, by factor.
        seed: Seed of the walk.
        method: Name of the method, or `walk` if the walk itself failed.
        reason: Why.
    """

    levels: dict[str, str]
    seed: int
    method: str
    reason: str


class StudyResult(Sentences):
    """The result of a study.

    Attributes:
        study: What is compared, in one line.
        factors: Names of the factors.
        methods: Names of the methods.
        scores: Names of the scores.
        seeds: Seeds of the walks of each combination.
        table: One line per combination and method.
        comparisons: Each method against the first one.
        words: Comparisons and failures as sentences.
        failed: The failures.
        files: Names of the written files.
        parameters: Values of `--set`, by estimator and name; only where there are any.
    """

    study: str
    factors: list[str]
    methods: list[str]
    scores: list[str]
    seeds: list[int]
    table: list[TableLine]
    comparisons: list[MethodComparison]
    failed: list[MethodFailure]
    files: NotRequired[list[str]]
    parameters: NotRequired[dict[str, dict[str, object]]]


def score_values(study: Study, rows: Sequence[StudyRow]) -> Array:
    """(C, M, W, S) scores of C combinations, M methods and W walks; means over outputs, NaN where missing.

    Args:
        study: The study.
        rows: Those of the walks of the first combination, then of the next ones.
    """
    # rows are ordered by combination, then by walk; so the list's order is combination, walk, method, score
    values = [
        [_mean_of_outputs(row["scores"].get(method.name, {}), score) for score in study.scores]
        for row in rows
        for method in study.methods
    ]
    shape = len(study.combinations), len(study.seeds), len(study.methods), len(study.scores)
    return np.reshape(values, shape).swapaxes(1, 2)


def _mean_of_outputs(outputs: dict[str, Scores], score: str) -> float:
    """The mean of a score over a method's outputs, such as both feet; NaN if none has it.

    Of a score whose sign has a meaning, absolute values are averaged, so that they do not cancel.

    Args:
        outputs: Scores of each output on one walk, by the output's name.
        score: Name of the score.
    """
    scale = scale_of(score)
    values = [scores[score] for scores in outputs.values() if score in scores]
    return float(np.mean(np.abs(values) if scale is not None and scale.signed else values)) if values else np.nan


def collect_result(study: Study, rows: Sequence[StudyRow]) -> StudyResult:
    """The result as JSON holds it, without the written files.

    Args:
        study: The study.
        rows: Those of the walks of the first combination, then of the next ones.
    """
    values = score_values(study, rows)  # (combinations, methods, walks, scores)
    labels = [dict(combination.labels) for combination in study.combinations]
    table: list[TableLine] = [
        {"levels": label, "method": method.name, "scores": {}} for label in labels for method in study.methods
    ]
    for s, score in enumerate(study.scores):
        # lines and columns are both in the order combination, method; rows of the transposed array are walks
        for line, column in zip(table, intervals(values[..., s].reshape(len(table), -1).T)):
            if np.isfinite(column.mean):
                line["scores"][score] = column.row()
    comparisons = _compare_with_first(study, values)
    # levels and seed of each row
    walks = [(label, seed) for label in labels for seed in study.seeds]
    failed: list[MethodFailure] = [
        {"levels": label, "seed": seed, "method": name, "reason": why}
        for (label, seed), row in zip(walks, rows)
        for name, why in row["failed"].items()
    ]
    return {
        "study": study.description,
        "factors": list(labels[0]),
        "methods": [method.name for method in study.methods],
        "scores": list(study.scores),
        "seeds": list(study.seeds),
        "table": table,
        "comparisons": comparisons,
        "words": [*_describe_comparisons(study, comparisons), *_describe_failures(failed)],
        "failed": failed,
    }


def _compare_with_first(study: Study, values: Array) -> list[MethodComparison]:
    """Tests each method against the first one in each combination, walk by walk, on the scale of the score.

    Args:
        study: The study.
        values: (C, M, W, S) scores of C combinations, M methods and W walks. A method is only compared where it and
            the first one have the score on every walk.

    Returns:
        Ordered by score, method and combination.
    """
    compared: list[ComparedMethod] = []
    columns: list[Array] = []  # of each comparison, the (W,) losses minus those of the first method
    scales: list[Scale] = []  # of each comparison, the scale of the score
    # s, m, c: numbers of score, method and combination
    for s, m, c in np.ndindex(len(study.scores), len(study.methods), len(study.combinations)):
        scale = scale_of(study.scores[s])
        # method 0 is what the others are compared with; both need every walk
        if m and scale is not None and len(study.seeds) > 1 and np.isfinite(values[c, [0, m], :, s]).all():
            losses_of_first, losses = ([scale.loss(value) for value in values[c, i, :, s]] for i in (0, m))
            columns.append(np.subtract(losses, losses_of_first))
            scales.append(scale)
            levels = dict(study.combinations[c].labels)
            compared.append({"score": study.scores[s], "method": study.methods[m].name, "levels": levels})
    tested = differences(np.column_stack(columns)) if columns else []
    return [
        {**method, **_to_score_change(scale, difference)} for method, scale, difference in zip(compared, scales, tested)
    ]


def _to_score_change(scale: Scale, difference: Difference) -> ScoreChange:
    """A difference of losses as a change of the score: in % or points, with interval, p-value and verdict.

    Args:
        scale: Scale of the score.
        difference: Mean loss of a method minus that of the first one; a larger loss is worse.
    """
    # where more is better, the change has the other sign than the loss, and the ends change places
    ends = [scale.change(end) for end in (difference.low, difference.high) if end is not None]
    low, high = sorted(ends) if ends else (None, None)
    directions = ("higher", "lower") if scale.kind == CLAIM else ("worse", "better")
    return {
        "change": scale.change(difference.mean),
        "unit": "points" if scale.in_points else "%",
        "low": low,
        "high": high,
        "p": difference.p,
        # a lower loss is better: False chooses the first word, True the second
        "verdict": directions[difference.mean < 0] if difference.significant else "",
    }


def _describe_comparisons(study: Study, comparisons: Sequence[MethodComparison]) -> list[str]:
    """For each score and method, in which combinations it differs significantly from the first method."""
    first = study.methods[0].name
    if why_untested := missing_test_reason(len(study.seeds)):
        return [why_untested]
    if len(study.methods) == 1:  # nothing to compare
        return []
    texts = []
    for score, method in product(study.scores, study.methods[1:]):
        by_verdict: dict[str, list[str]] = {}  # combinations with their changes, by verdict; "" is not significant
        for comparison in comparisons:
            if (comparison["score"], comparison["method"]) == (score, method.name):
                by_verdict.setdefault(comparison["verdict"], []).append(_describe_change(comparison))
        unsure = by_verdict.pop("", [])
        parts = [f"{verdict} than {first} with {'; '.join(places)}" for verdict, places in by_verdict.items()]
        parts += [f"no significant difference from {first} with {'; '.join(unsure)}"] if unsure else []
        texts.append(f"{score}: {method.name}: {'. '.join(parts) or f'cannot be compared with {first}'}.")
    return texts


def _describe_change(comparison: MethodComparison) -> str:
    """The combination of a comparison and its change, such as `low noise (+12 %)`; large increases as a factor."""
    change = f"{comparison['change']:+.3g} {comparison['unit']}"
    if comparison["unit"] == "%" and comparison["change"] > _MAX_PCT:
        change = f"{1.0 + comparison['change'] / 100.0:.3g}-fold"
    return f"{', '.join(comparison['levels'].values()) or 'all walks'} ({change})"


def _describe_failures(failed: Sequence[MethodFailure]) -> list[str]:
    """On how many walks each method failed, with the first reason."""
    reasons: dict[str, list[str]] = {}  # by method, one reason per walk
    for failure in failed:
        reasons.setdefault(failure["method"], []).append(failure["reason"])
    return [
        f"{name} failed on {len(method_reasons)} walks, first: {method_reasons[0]}"
        for name, method_reasons in reasons.items()
    ]


def table_head(result: StudyResult) -> list[str]:
    """Titles of the columns of `table_rows`; those before the scores are text."""
    return [*result["factors"], "method", *result["scores"]]


def table_rows(result: StudyResult) -> list[list[str]]:
    """The table as text: the levels, the method, and each score with its interval."""
    scores = result["scores"]
    return [
        [*line["levels"].values(), line["method"], *(interval_text(line["scores"].get(score)) for score in scores)]
        for line in result["table"]
    ]


def csv_text(study: Study, rows: Sequence[StudyRow]) -> str:
    """All scores as CSV: one row per walk, method and score."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    # levels of each combination, by seed and combination; those that take turns differ from seed to seed
    labels = [[walk.labels for walk in study.walks(seed)] for seed in study.seeds]
    writer.writerow([*labels[0][0], "seed", "method", "score", "value"])
    # c, w, m, s: numbers of combination, walk, method and score
    for (c, w, m, s), value in np.ndenumerate(score_values(study, rows).swapaxes(1, 2)):
        number = f"{value:.9g}" if np.isfinite(value) else ""
        writer.writerow([*labels[w][c].values(), study.seeds[w], study.methods[m].name, study.scores[s], number])
    return out.getvalue()
