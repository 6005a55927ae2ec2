from dataclasses import replace

import numpy as np
import pytest
from score_tables import SPREADS, of_rows, table, walk

from stridetwin.gate.compare import (
    BETTER,
    MISSING,
    NEW,
    PAIRED,
    SAME,
    TOLERANCE,
    UNPAIRED,
    WORSE,
    Rules,
    compare_scores,
)
from stridetwin.gate.metric_policy import OVERALL, scale_of
from stridetwin.gate.score_table import table_of
from stridetwin.streams.errors import StrideTwinError

RULES = Rules()


def lines(now, baseline, rules=RULES):
    return {(x.estimator, x.metric): x for x in compare_scores(now, baseline, rules).lines}


def changed(rows_of, change):
    """A table of which each walk's scores went through a function."""
    rows = [
        {"name": k, "sha256": k, "estimators": {n: change(i, n, dict(s)) for n, s in w.items()}}
        for i, (k, w) in enumerate(rows_of.walks.items())
    ]
    rows = [{**row, "estimators": {n: s for n, s in row["estimators"].items() if s}} for row in rows]
    return of_rows(rows)


def test_the_same_scores_are_the_same():
    found = lines(table(1, 20), table(1, 20))
    assert {x.verdict for x in found.values()} == {SAME}
    assert {x.method for x in found.values()} == {PAIRED}
    assert found["mine", "ape_rmse_m"].change == 0.0
    assert ("mine", "distance_m") not in found


def test_eight_percent_in_the_noise_are_found_on_the_same_walks():
    found = lines(table(1, 30, factor=1.08, jitter=0.05), table(1, 30))
    overall = found["mine", OVERALL]
    assert overall.verdict == WORSE
    assert overall.low < 8.0 < overall.high
    assert overall.high - overall.low < 4.0
    assert overall.p < 0.01
    assert found["mine", "nees_position_within_95_pct"].verdict == SAME


def test_the_composite_finds_what_no_single_score_shows():
    found = lines(table(3, 30, factor=1.05, jitter=0.1), table(3, 30), Rules(level=0.001))
    assert [m for (_, m), x in found.items() if x.verdict == WORSE] == [OVERALL]


def test_an_improvement_is_reported_and_passes():
    comparison = compare_scores(table(1, 30, factor=0.9, jitter=0.05), table(1, 30), RULES)
    assert any(x.verdict == BETTER for x in comparison.lines)
    assert comparison.regressions == []


def test_a_sure_change_below_the_least_is_none():
    assert lines(table(1, 30, factor=1.008), table(1, 30))["mine", OVERALL].verdict == SAME
    assert lines(table(1, 30, factor=1.012), table(1, 30))["mine", OVERALL].verdict == WORSE


def test_many_scores_and_a_low_level_get_the_resamples_that_they_need():
    names = tuple(f"e{i}" for i in range(20))
    found = lines(table(1, 12, 1.5, 0.02, names), table(1, 12, names=names))  # eighty have changed
    assert {x.verdict for (_, metric), x in found.items() if metric in SPREADS} == {WORSE}
    found = lines(table(1, 12, 1.5, 0.02), table(1, 12), Rules(level=1e-4))
    assert {x.verdict for (_, metric), x in found.items() if metric in SPREADS} == {WORSE}


def test_a_level_that_asks_for_too_many_resamples_is_refused_with_the_smallest_valid_one():
    names = tuple(f"e{i}" for i in range(20))
    baseline = table(1, 12, names=names)  # six scores each
    with pytest.raises(StrideTwinError, match=r"--false-alarms: invalid 0\.01: expected 0\.024 or more, with the 120"):
        compare_scores(baseline, baseline, Rules(level=1e-4))
    assert compare_scores(baseline, baseline, Rules(level=2.4e-4)).regressions == []
    few = table(1, 3, names=names)
    assert compare_scores(few, few, Rules(level=1e-4)).regressions == []  # by the tolerance


def test_two_feet_of_one_estimator_are_compared_together_and_a_single_one_alone():
    names = ("foot_l", "foot_r", "lone_l")
    found = lines(table(1, 12, 1.1, 0.02, names), table(1, 12, names=names))
    assert {name for name, _ in found} == {"foot", "lone_l"}
    assert found["foot", OVERALL].verdict == WORSE
    assert found["foot", OVERALL].low < 10.0 < found["foot", OVERALL].high


def test_other_walks_are_compared_as_groups_and_seldom_differ():
    alarms = 0
    for seed in range(20):
        comparison = compare_scores(table(seed, 20), table(100, 20), RULES)
        assert {x.method for x in comparison.lines} == {UNPAIRED}
        alarms += bool(comparison.regressions)
    assert alarms <= 1
    assert lines(table(5, 20, factor=3.0), table(100, 20))["mine", OVERALL].verdict == WORSE


def test_walks_in_only_one_table_are_left_out_and_counted():
    comparison = compare_scores(table(1, 20, first=5), table(1, 20), RULES)
    assert (
        comparison.description == "15 walks in both tables, compared in pairs; 10 walks in only one table are left out"
    )


def test_few_walks_are_compared_by_their_means():
    comparison = compare_scores(table(1, 3, factor=1.2), table(1, 3), RULES)
    assert "3 walks of the baseline, 3 now: fewer than 8, too few for statistics" in comparison.description
    found = {x.metric: x for x in comparison.lines}
    assert found["ape_rmse_m"].method == TOLERANCE
    assert found["ape_rmse_m"].verdict == WORSE
    assert lines(table(1, 3, factor=1.05), table(1, 3))["mine", "ape_rmse_m"].verdict == SAME


def test_an_estimator_without_scores_on_a_walk_fails_the_gate():
    baseline = table(1, 12, names=("mine", "yours"))
    now = changed(baseline, lambda i, name, s: None if (i, name) == (4, "yours") else s)
    comparison = compare_scores(now, baseline, RULES)
    assert [(x.estimator, x.metric, x.baseline, x.now) for x in comparison.regressions] == [("yours", "walks", 12, 11)]
    gone = changed(baseline, lambda i, name, s: None if name == "yours" else s)
    assert [x.verdict for x in compare_scores(gone, baseline, RULES).regressions] == [MISSING]
    assert any(x.verdict == NEW for x in compare_scores(baseline, gone, RULES).lines)


@pytest.mark.parametrize("who", ["mine", "every estimator"])
def test_on_other_walks_an_estimator_that_fails_as_it_did_not_before_closes_the_gate(who):
    baseline, now = table(100, 12), table(1, 12)
    broke = replace(now, failed={next(iter(now.walks)): {who: "no"}}, walks={**dict(list(now.walks.items())[1:])})
    found = compare_scores(broke, baseline, RULES).regressions
    assert [(x.estimator, x.metric, x.baseline, x.now) for x in found] == [("mine", "walks", 12, 11)]
    assert compare_scores(broke, replace(baseline, failed={"x": {who: "no"}}), RULES).regressions == []


def test_a_score_that_has_disappeared_closes_the_gate():
    baseline = table(1, 12)
    now = changed(baseline, lambda i, name, s: {m: v for m, v in s.items() if m != "rpe_1m_pct"})
    assert [(x.metric, x.verdict) for x in compare_scores(now, baseline, RULES).regressions] == [
        ("rpe_1m_pct", MISSING)
    ]


@pytest.mark.parametrize("metric", ["nis_standing", "nees_position_mean", "end_height_error_m"])
@pytest.mark.parametrize("walks", [3, 12])
def test_one_that_means_do_not_judge_does_so_too(metric, walks):
    baseline = changed(table(1, walks), lambda i, name, s: s | {metric: 1.0 + i})
    now = changed(baseline, lambda i, name, s: {m: v for m, v in s.items() if m != metric})
    assert [(x.metric, x.verdict) for x in compare_scores(now, baseline, RULES).regressions] == [(metric, MISSING)]
    assert compare_scores(baseline, baseline, RULES).regressions == []


def test_a_filter_that_errs_more_for_what_it_claims_is_worse_and_one_that_errs_less_is_not():
    baseline = table(1, 12)
    bold = changed(baseline, lambda i, name, s: s | {"nis_standing": 2.0 + 0.1 * (i % 3)})
    timid = changed(baseline, lambda i, name, s: s | {"nis_standing": 0.4})
    assert lines(bold, baseline)["mine", "nis_standing"].verdict == WORSE
    assert lines(timid, baseline)["mine", "nis_standing"].verdict == SAME


def test_shares_change_by_points():
    baseline = table(1, 12)
    now = changed(baseline, lambda i, name, s: s | {"nees_position_within_95_pct": 92.0 - 0.1 * (i % 3)})
    line = lines(now, baseline)["mine", "nees_position_within_95_pct"]
    assert (line.verdict, line.in_points) == (WORSE, True)
    assert line.change == pytest.approx(-3.1, abs=0.1)
    assert lines(baseline, now)["mine", "nees_position_within_95_pct"].verdict == BETTER


def test_errors_below_rounding_count_as_rounding():
    scale = scale_of("ape_rmse_m")
    assert scale.loss(1e-9) == scale.loss(0.0019) < scale.loss(0.0021)
    assert scale_of("end_height_error_m").loss(-0.5) == scale_of("end_height_error_m").loss(0.5)
    assert scale_of("lead_median_s").loss(1.0) < scale_of("lead_median_s").loss(0.5)
    assert scale_of("steps") is None


def test_a_walk_without_one_of_the_scores_leaves_the_others_theirs():
    rng = np.random.default_rng(0)
    rows = [{"name": str(i), "sha256": str(i), "estimators": {"a": walk(rng)}} for i in range(9)]
    rows[3]["estimators"]["a"].pop("rpe_5m_pct")
    found = lines(of_rows(rows), of_rows(rows))
    assert found["a", "rpe_5m_pct"].walks == 8
    assert found["a", OVERALL].walks == 9


@pytest.mark.parametrize(
    "bad",
    [
        [],
        {},
        {"estimators": 3},
        {"estimators": {"a": {"ape_rmse_m": "x"}}},
        {"estimators": {}, "recordings": 3},
        {"estimators": {}, "recordings": [{"estimators": {"a": {"b": None}}}]},
        {"estimators": {}, "recordings": [{"estimators": {}, "failed": ["a"]}]},
    ],
)
def test_other_files_are_no_baseline(bad):
    with pytest.raises(StrideTwinError, match=r"base\.json"):
        table_of(bad, "base.json")


def covered(pct):
    """Twenty walks that are covered as given, by the number of the walk."""
    return changed(table(1, 20), lambda i, name, scores: {**scores, "coverage_pct": pct(i)})


@pytest.mark.parametrize(
    ("pct", "verdict"),
    [
        (lambda i: 99.0, SAME),
        (lambda i: 99.0 - 0.1 * (i % 2), SAME),
        (lambda i: 97.0, WORSE),
        (lambda i: 90.0 if i == 3 else 99.0, WORSE),  # one partial result in twenty, no proof needed
        (lambda i: 100.5, BETTER),
    ],
)
def test_what_is_covered_of_the_same_walks_is_compared_without_a_test(pct, verdict):
    found = lines(covered(pct), covered(lambda i: 99.0))["mine", "coverage_pct"]
    assert (found.verdict, found.method, found.p) == (verdict, PAIRED, None)


def test_an_end_that_is_never_reached_is_missing_and_what_is_covered_is_worse():
    whole = covered(lambda i: 100.0)
    partial = changed(
        whole, lambda i, name, s: {k: v for k, v in s.items() if k != "end_error_m"} | {"coverage_pct": 3.0}
    )
    found = lines(partial, whole)
    assert found["mine", "end_error_m"].verdict == MISSING
    assert found["mine", "coverage_pct"].verdict == WORSE
