"""Values from quantiles: inside limits, with the moments of their distribution, and refused where there is none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stridetwin.scenarios.campaign.distributions import Choice, DistributionInFile, Fixed
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.validation import validate

MIDDLES = (np.arange(20000) + 0.5) / 20000


def read(node):
    return validate(DistributionInFile, node, "c.yaml", at="set.x")


def drawn(node) -> np.ndarray:
    found = read(node)
    return np.array([found.at(u) for u in MIDDLES.tolist()])


def test_moments_are_those_of_the_distribution():
    assert drawn({"uniform": [2, 5]}).mean() == pytest.approx(3.5, abs=1e-4)
    logs = np.log(drawn({"log_uniform": [0.1, 10]}))
    assert (logs.mean(), logs.std()) == pytest.approx((0, np.log(100) / 12**0.5), abs=1e-3)
    normal = drawn({"normal": [1, 0.2], "within": [0.8, 1.2]})
    assert normal.mean() == pytest.approx(1, abs=1e-4)
    assert normal.std() == pytest.approx(0.2 * 0.5396, rel=1e-3)  # of a normal distribution cut at one SD either way
    assert normal.min() >= 0.8
    assert normal.max() <= 1.2


def test_whole_numbers_steps_and_choices_come_as_often_as_asked():
    values, counts = np.unique(drawn({"integer": [2, 5]}), return_counts=True)
    assert values.tolist() == [2, 3, 4, 5]
    assert counts.tolist() == [5000] * 4
    values, counts = np.unique(drawn({"uniform": [0.1, 0.35], "step": 0.1}), return_counts=True)
    assert values.tolist() == [0.1, 0.2, 0.3]
    assert counts.max() - counts.min() <= 1
    values, counts = np.unique(drawn({"choice": ["a", "b"], "weights": [3, 1]}), return_counts=True)
    assert dict(zip(values, counts)) == {"a": 15000, "b": 5000}
    assert isinstance(read({"integer": [1, 2]}).at(0.7), int)


@given(st.floats(0, 1, exclude_max=True), st.floats(-1e6, 1e6), st.floats(1e-3, 1e6))
def test_no_value_leaves_its_limits(u, low, width):
    high = low + width
    for node in ({"uniform": [low, high]}, {"normal": [low, width], "within": [low, high]}):
        assert low <= read(node).at(u) <= high
    whole = [int(low), int(low) + 7]
    assert whole[0] <= read({"integer": whole}).at(u) <= whole[1]


def test_anything_that_is_no_distribution_is_a_value():
    assert read([1, 2]) == Fixed(fixed=[1, 2])
    assert read({"fixed": {"kind": "ahead"}}).at(0.5) == {"kind": "ahead"}
    assert read({"choice": [[1], {"a": 2}]}) == Choice(choice=([1], {"a": 2}))


@pytest.mark.parametrize(
    ("node", "message"),
    [
        ({"kind": "ahead"}, "set.x: invalid {'kind': 'ahead'}: expected a value, or keys uniform, "),
        ({"uniform": [2, 1]}, "set.x.uniform: invalid [2.0, 1.0]: expected two numbers, the lower first"),
        ({"uniform": [1, 2], "sep": 1}, "invalid 'sep': expected keys uniform, step (did you mean 'step'?)"),
        ({"log_uniform": [0, 1]}, "set.x.log_uniform[0]: invalid 0: expected 1e-09-1e+09"),
        ({"normal": [1, 0.1]}, "set.x.within: missing: expected "),
        ({"normal": [1, 0], "within": [0, 2]}, "set.x.normal: invalid [1.0, 0.0]: expected mean and standard"),
        ({"normal": [1, 0.01], "within": [2, 3]}, "set.x.within: invalid [2.0, 3.0]: expected limits no farther"),
        ({"integer": [1.5, 2]}, "set.x.integer[0]: invalid 1.5: expected a whole number"),
        ({"choice": []}, "set.x.choice: invalid []: expected a list with at least one item"),
        ({"choice": [1, 2], "weights": [1]}, "set.x.weights: invalid [1.0]: expected 2 numbers, one for each value"),
    ],
)
def test_errors_name_field_value_and_what_is_valid(node, message):
    with pytest.raises(ConfigError) as error:
        read(node)
    assert message in str(error.value)
