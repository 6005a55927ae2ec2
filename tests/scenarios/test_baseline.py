import pytest

from stridetwin.scenarios.baseline import regressions
from stridetwin.scenarios.evaluate import summary
from stridetwin.streams.errors import StrideTwinError

BASE = {"estimators": {"a": {"ape_rmse_m": 0.1, "nees_position_within_95_pct": 90.0, "distance_m": 20.0}}}


def found(now, tolerance=0.1):
    return [r.metric for r in regressions({"a": now}, BASE, "base.json", tolerance)]


def test_equal_scores_pass_and_worse_ones_are_named():
    same = dict(BASE["estimators"]["a"])
    assert found(same) == []
    assert found(same | {"ape_rmse_m": 0.111}) == []
    assert found(same | {"ape_rmse_m": 0.113}) == ["ape_rmse_m"]
    assert found(same | {"ape_rmse_m": 0.01}) == []


def test_for_shares_of_good_samples_higher_is_better():
    same = dict(BASE["estimators"]["a"])
    assert found(same | {"nees_position_within_95_pct": 99.0}) == []
    assert found(same | {"nees_position_within_95_pct": 70.0}) == ["nees_position_within_95_pct"]


def test_what_describes_the_walk_is_not_judged_but_a_missing_score_is_worse():
    assert found({"ape_rmse_m": 0.1, "nees_position_within_95_pct": 90.0, "distance_m": 99.0}) == []
    assert found({}) == ["ape_rmse_m", "nees_position_within_95_pct"]


@pytest.mark.parametrize("bad", [[], {}, {"estimators": 3}, {"estimators": {"a": {"ape_rmse_m": "x"}}}])
def test_other_files_are_no_baseline(bad):
    with pytest.raises(StrideTwinError, match=r"base\.json"):
        regressions({}, bad, "base.json", 0.1)


def test_a_summary_has_means_and_the_largest_maximum():
    both = summary([{"a": {"ape_rmse_m": 1.0, "ape_max_m": 2.0}}, {"a": {"ape_rmse_m": 3.0, "ape_max_m": 8.0}}])
    assert both == {"a": {"ape_rmse_m": 2.0, "ape_max_m": 8.0}}
