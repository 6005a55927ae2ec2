"""The announced cost of walks: close to what recordings are, and in words."""

from dataclasses import replace

import pytest

from stridetwin.scenarios.cost import Cost, cost_of, scale_cost
from stridetwin.scenarios.scenario_file import load_scenario


def test_the_cost_of_a_walk_is_about_that_of_its_recording():
    config = load_scenario("demo").config  # seed 0: 46.3 s, 398 MB
    cost = cost_of([config])
    assert cost.walked_s == pytest.approx(46.3, rel=0.2)
    assert cost.size_mb == pytest.approx(398, rel=0.2)
    alone = cost_of([replace(config, sensors=("foot_imu",))])
    assert alone.size_mb < 0.1 * cost.size_mb
    assert alone.cpu_s < 0.25 * cost.cpu_s


def test_the_cost_of_many_walks_is_said_in_words():
    cost = Cost(walks=2, walked_s=40.0, size_mb=300.0, cpu_s=80.0)
    assert scale_cost(cost, 20).describe(2) == "20 walks: about 400 s of walking, 3.0 GB, 0:06:40 with 2 processes"
    assert cost.describe() == "2 walks: about 40 s of walking, 300 MB, 0:01:20 with 1 process"  # one start
    assert cost.is_long
    assert not scale_cost(cost, 1).is_long
