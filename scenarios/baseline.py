"""Scores against a baseline: where did an estimator become worse than its tolerance allows?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from stridetwin.scenarios.scoring import Scores
from stridetwin.streams.errors import StrideTwinError

# what rounding between machines may do, in the unit of the key
_SLACK = {"_m": 0.002, "_mm": 0.2, "_deg": 0.02, "_pct": 0.02, "_s": 0.05, "_error": 0.02}
_HIGHER_IS_BETTER = (
    "nees_position_within_95_pct", "coverage_pct", "classification_accuracy_pct", "slope_in_95_pct",
    "elevation_in_95_pct", "accuracy_pct", "strict_accuracy_pct", "transition_accuracy_pct", "changes_found_pct",
    "lead_median_s", "lead_p5_s", "transition_lead_median_s", "completeness_pct", "found_pct",
)  # fmt: skip
_NOT_JUDGED = ("distance_m", "duration_s", "nees_position_mean", "end_height_error_m", "nis_", "steps", "transitions",
               "straddling_pct", "edge_mean_mm")  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Regression:
    """One score that is worse than the baseline allows.

    Attributes:
        estimator: Whose.
        metric: Which score.
        baseline: Its value in the baseline.
        now: Its value now; None where it is missing.
        limit: The worst value that passes.
    """

    estimator: str
    metric: str
    baseline: float
    now: float | None
    limit: float


def regressions(now: Mapping[str, Scores], baseline: object, source: str, tolerance: float) -> list[Regression]:
    """Every score that is worse than the baseline by more than the tolerance.

    Args:
        now: Estimator to scores.
        baseline: What an earlier `stridetwin score --json` printed.
        source: Name of the baseline for messages.
        tolerance: Share by which an error may grow (or a share of good samples fall), 0.1 = 10 %.

    Raises:
        StrideTwinError: The baseline has not the form of `score --json`.
    """
    estimators = baseline.get("estimators") if isinstance(baseline, dict) else None
    if not isinstance(estimators, dict) or not all(isinstance(s, dict) for s in estimators.values()):
        raise StrideTwinError(f'{source}: is no baseline; valid: what `stridetwin score --json` prints ("estimators")')
    found = []
    for name, scores in sorted(estimators.items()):
        for metric, value in sorted(scores.items()):
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise StrideTwinError(f"{source}: estimators.{name}.{metric}: {value!r} is not valid; valid: a number")
            if metric.startswith(_NOT_JUDGED):
                continue
            slack = next((s for unit, s in _SLACK.items() if metric.endswith(unit)), 0.0)
            allowance = abs(value) * tolerance + slack
            higher = metric in _HIGHER_IS_BETTER
            limit = value - allowance if higher else value + allowance
            current = now.get(name, {}).get(metric)
            if current is None or (current < limit if higher else current > limit):
                found.append(Regression(estimator=name, metric=metric, baseline=value, now=current, limit=limit))
    return found
