import numpy as np
import pytest

from stridetwin.studies.significance import compare_places, comparison_text, intervals, pareto_front


def test_common_walks_resolve_small_differences_and_find_none_between_equal_places():
    rng = np.random.default_rng(3)
    walks = rng.normal(10.0, 3.0, 8)  # they differ far more than the places do
    losses = np.array([walks, walks + 0.5 + rng.normal(0, 0.1, 8), walks + rng.normal(0.02, 0.3, 8)])
    pairs = {(p.first, p.second): p for p in compare_places(losses)}
    assert pairs[0, 1].significant
    assert not pairs[0, 2].significant
    assert pairs[0, 1].low < 0.5 < pairs[0, 1].high
    words = comparison_text(list(pairs.values()), ["A", "B", "C"], 8)
    assert "A: the difference from C is not significant." in words
    assert "A is better than B (significant)." in words


def test_few_walks_prove_nothing():
    losses = np.array([[1.0, 1.1, 1.0], [5.0, 5.1, 5.2]])
    assert not any(p.significant for p in compare_places(losses))
    assert "too few" in comparison_text(compare_places(losses), ["A", "B"], 3)[0]
    assert compare_places(losses[:, :1]) == []
    assert "One walk" in comparison_text([], ["A", "B"], 1)[0]


def test_intervals_hold_their_mean_and_there_is_none_of_one_walk_or_where_a_walk_failed():
    values = np.array([[1.0, 5.0], [2.0, np.nan], [3.0, 7.0], [2.0, 6.0]])
    whole, broken = intervals(values)
    assert whole.mean == pytest.approx(2.0)
    assert whole.low < 2.0 < whole.high
    assert np.isnan(broken.mean)
    assert intervals(values[:1])[0].low is None


@pytest.mark.parametrize("walks", [3, 4, 5, 6, 8, 12])
def test_few_walks_have_an_interval_even_if_one_alone_differs(walks):
    differing = np.zeros((walks, 1))
    differing[-1] = 0.3
    equal = np.full((walks, 1), 98.5)
    (found,) = intervals(differing)
    assert -0.5 < found.low < found.mean < found.high < 0.8
    assert intervals(equal)[0].low == pytest.approx(98.5) == intervals(equal)[0].high


def test_what_is_significant_has_an_interval_without_zero():
    rng = np.random.default_rng(5)
    walks = rng.normal(0.0, 1.0, 5)
    (pair,) = compare_places(np.array([walks, walks + 1.0 + rng.normal(0.0, 0.1, 5)]))
    assert pair.significant
    assert 0.0 < pair.low < 1.0 < pair.high


def test_no_place_of_the_front_is_beaten():
    losses = np.array([[1.0, 5.0], [2.0, 2.0], [3.0, 3.0], [5.0, 1.0], [np.inf, 0.0], [2.0, 2.0]])
    assert pareto_front(losses) == [0, 1, 3, 5]
