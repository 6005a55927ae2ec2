"""Means of few walks, judged by a tolerance."""

import pytest

from stridetwin.gate.compare import Rules, compare_scores
from stridetwin.gate.score_table import mean_scores, table_of

SAME = {"ape_rmse_m": 0.1, "nees_position_within_95_pct": 90.0, "distance_m": 20.0}


def found(now, baseline=SAME):
    sides = (table_of({"estimators": {"a": s}}, "base.json") for s in (now, baseline))
    return [line.metric for line in compare_scores(*sides, Rules()).regressions]


def test_equal_scores_pass_and_worse_ones_are_named():
    assert found(SAME) == []
    assert found(SAME | {"ape_rmse_m": 0.111}) == []
    assert found(SAME | {"ape_rmse_m": 0.113}) == ["ape_rmse_m"]
    assert found(SAME | {"ape_rmse_m": 0.01}) == []


def test_for_shares_of_good_samples_higher_is_better():
    assert found(SAME | {"nees_position_within_95_pct": 99.0}) == []
    assert found(SAME | {"nees_position_within_95_pct": 70.0}) == ["nees_position_within_95_pct"]


def test_descriptions_of_the_walk_are_not_compared_but_a_missing_score_is_worse():
    assert found(SAME | {"distance_m": 99.0}) == []
    assert found({}) == ["ape_rmse_m", "nees_position_within_95_pct"]


def test_a_summary_has_means_and_the_largest_maximum():
    both = mean_scores([{"a": {"ape_rmse_m": 1.0, "ape_max_m": 2.0}}, {"a": {"ape_rmse_m": 3.0, "ape_max_m": 8.0}}])
    assert both == {"a": {"ape_rmse_m": 2.0, "ape_max_m": 8.0}}


@pytest.mark.parametrize("metric", ["nis_standing", "end_height_error_m", "straddling_pct"])
def test_scores_without_a_meaningful_mean_are_not_compared(metric):
    assert found({metric: 9.0}, {metric: 1.0}) == []


def test_what_is_covered_may_not_shrink_by_the_tolerance():
    covered = SAME | {"coverage_pct": 100.0}
    assert found(covered | {"coverage_pct": 99.5}, covered) == []
    assert found(covered | {"coverage_pct": 93.0}, covered) == ["coverage_pct"]
    assert found(SAME, covered) == ["coverage_pct"]
