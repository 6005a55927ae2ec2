import numpy as np
import pytest
from scipy import stats

from stridetwin.gate import bootstrap
from stridetwin.gate.bootstrap import compare_groups, compare_pairs, holm_correct

RNG = np.random.default_rng(4)


def test_of_normal_values_it_says_what_student_says():
    x = RNG.normal(0.3, 1.0, (40, 3))
    y = RNG.normal(0.0, 1.0, (25, 3))
    one, two = compare_pairs(x), compare_groups(y, x)
    student = stats.ttest_1samp(x, 0.0, alternative="greater")
    welch = stats.ttest_ind(x, y, equal_var=False, alternative="greater")
    assert one.p_above == pytest.approx(student.pvalue, abs=0.02)
    assert two.p_above == pytest.approx(welch.pvalue, abs=0.02)
    interval = stats.ttest_1samp(x, 0.0).confidence_interval()
    assert one.low == pytest.approx(interval.low, abs=0.1)
    assert one.high == pytest.approx(interval.high, abs=0.1)
    assert one.p_above + one.p_below == pytest.approx(1.0, abs=1e-3)


def test_it_is_the_same_each_time_and_missing_values_are_left_out():
    x = RNG.normal(0.2, 1.0, (30, 2))
    holes = np.vstack([x, np.full((10, 2), np.nan)])
    assert np.array_equal(compare_pairs(x).p_above, compare_pairs(x).p_above)
    assert compare_pairs(holes).mean == pytest.approx(compare_pairs(x).mean)
    assert compare_pairs(holes).p_above == pytest.approx(compare_pairs(x).p_above, abs=0.03)
    assert list(compare_pairs(holes).count) == [30, 30]


def test_changes_that_are_all_the_same_are_sure_and_no_changes_are_none():
    tested = compare_pairs(np.column_stack([np.full(10, 0.1), np.zeros(10), np.full(10, -0.1)]))
    assert tested.p_above[0] < 1e-3 < tested.p_below[0]
    assert tested.p_above[1] == tested.p_below[1] == 1.0
    assert tested.p_below[2] < 1e-3
    assert tested.low[0] == pytest.approx(0.1)


def test_one_odd_walk_of_thirty_proves_nothing():
    assert compare_pairs(np.eye(30)[:, :1] * 9.0).p_above[0] > 0.05


def test_holm_corrects_step_by_step():
    assert holm_correct([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm_correct([0.6, 0.9]) == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize("kind", ["skewed", "heavy"])
def test_among_scores_that_have_not_changed_it_seldom_finds_one(monkeypatch, kind):
    """Level 10 %, forty comparisons: four expected, ten or more in one of two hundred such."""
    monkeypatch.setattr(bootstrap, "DRAWS", 2000)
    rng = np.random.default_rng(7)
    found = 0
    for _ in range(40):
        x = rng.standard_t(4, (12, 12)) if kind == "heavy" else rng.exponential(1.0, (12, 12)) - 1.0
        found += bool((holm_correct(compare_pairs(x).p_above) <= 0.1).any())
    assert found < 10


def test_more_resamples_than_memory_holds_are_drawn_by_columns_and_change_nothing(monkeypatch):
    x, y = RNG.normal(0.2, 1.0, (12, 7)), RNG.normal(0.0, 1.0, (9, 7))
    x[3, 2] = np.nan
    whole = compare_pairs(x, 9000), compare_groups(y, x, 9000)
    assert compare_pairs(np.full((10, 1), 0.1), 9000).p_above[0] == pytest.approx(1.0 / 9001)
    monkeypatch.setattr(bootstrap, "_MAX_RESAMPLED_MEANS", 30_000)
    for one, other in zip(whole, (compare_pairs(x, 9000), compare_groups(y, x, 9000))):
        for name in ("count", "mean", "low", "high", "p_above", "p_below"):
            assert np.allclose(getattr(one, name), getattr(other, name), rtol=1e-9, atol=0.0)


def test_an_interval_is_bounded_where_one_of_few_walks_is_an_outlier():
    changes = np.array([0.01, 0.012, 0.009, 0.011, 0.01, 0.008, 0.012, 1.2])[:, None]
    found = compare_pairs(changes)
    error = changes.std(ddof=1) / np.sqrt(len(changes))
    assert found.low[0] > found.mean[0] - 8 * error
    assert found.high[0] < found.mean[0] + 8 * error
