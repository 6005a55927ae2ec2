"""Sampling, seeds and splits: even, deterministic, and the first walks stay when more are asked for."""

from dataclasses import replace

import numpy as np
import pytest
from small_campaign import write

from stridetwin.scenarios.campaign.campaign_file import Splits, load_campaign, read_campaign
from stridetwin.scenarios.campaign.plan import Extra, people, plan
from stridetwin.scenarios.campaign.sampling import cube
from stridetwin.scenarios.campaign.splits import split


def test_sobol_keeps_its_first_points_and_a_latin_hypercube_has_one_in_each_layer():
    few, many = (cube("sobol", n, 5, 7, (0,)) for n in (20, 1000))
    assert np.array_equal(few, many[:20])
    layers = np.sort((cube("latin_hypercube", 50, 3, 7, (0,)) * 50).astype(int), axis=0)
    assert np.array_equal(layers, np.tile(np.arange(50)[:, None], 3))
    for sampling in ("sobol", "latin_hypercube"):
        points = cube(sampling, 300, 4, 7, (0,))
        assert np.array_equal(points, cube(sampling, 300, 4, 7, (0,)))
        assert not np.array_equal(points, cube(sampling, 300, 4, 8, (0,)))
        assert not np.array_equal(points, cube(sampling, 300, 4, 7, (1,)))
        assert points.mean(axis=0) == pytest.approx(0.5, abs=0.01)
        assert ((points >= 0) & (points < 1)).all()


def test_more_walks_keep_the_first_ones(tmp_path):
    campaign = read_campaign(write(tmp_path))
    few, many = (plan(replace(campaign, walks=n), Extra()) for n in (4, 33))
    assert few == many[:4]
    several = load_campaign("stairs_and_ramps")
    assert plan(replace(several, walks=40), Extra()) == plan(several, Extra())[:40]
    assert plan(replace(campaign, seed=4), Extra())[0] != few[0]
    assert [w.seed for w in few] == [3000000, 3000001, 3000002, 3000003]


def test_scenarios_people_and_values_come_as_often_as_asked():
    campaign = load_campaign("stairs_and_ramps")
    walks = plan(campaign, Extra())
    counts = {name: sum(w.base == name for w in walks) for name in ("stair_up_down", "ramp_up_down", "turns")}
    assert counts == pytest.approx({"stair_up_down": 375, "ramp_up_down": 375, "turns": 125}, abs=3)
    crowd = people(campaign)
    assert len(crowd) == 40
    each = [sum(w.scenario["person"] == person for w in walks) for person in crowd]
    assert min(each) >= 20
    assert max(each) <= 30
    women = [p["height_m"] for p in crowd if p["sex"] == "female"]
    assert np.mean(women) == pytest.approx(1.64, abs=0.015)
    for walk in walks:
        if walk.base == "stair_up_down":
            up, down = (walk.scenario["terrain"][i]["stairs"] for i in (1, 3))
            assert up["riser_mm"] == down["riser_mm"] == walk.values[
                "terrain[1].stairs.riser_mm, terrain[3].stairs.riser_mm"
            ]  # fmt: skip
            assert not any("ramp" in name for name in walk.values)


@pytest.mark.parametrize("sampling", ["sobol", "latin_hypercube"])
def test_the_few_walks_of_one_scenario_fill_its_own_ranges(sampling):
    campaign = replace(load_campaign("stairs_and_ramps"), walks=24, sampling=sampling)
    treads = [
        w.values["terrain[1].stairs.tread_mm, terrain[3].stairs.tread_mm"]
        for w in plan(campaign, Extra())
        if w.base == "stair_up_down"
    ]
    assert len(treads) == pytest.approx(9, abs=1)
    assert set(treads) == {260, 280, 300, 320, 340}
    assert np.mean(treads) == pytest.approx(300, abs=12)


def test_nobody_is_in_two_parts_and_shares_hold():
    rng = np.random.default_rng(0)
    rows = [
        {"person": f"p{rng.integers(40)}", "terrain": f"t{rng.integers(300)}", "scenario": f"s{i % 5}"}
        for i in range(1000)
    ]
    splits = Splits()
    dealt = split(rows, splits, 3)
    for by, count in (("person", 40), ("terrain", len({r["terrain"] for r in rows}))):
        assert len(dealt[by]) == count
        for part, share in splits.shares.items():
            assert sum(p == part for p in dealt[by].values()) == pytest.approx(share * count, abs=2)
    earlier = split(rows[:100], splits, 3)
    assert all(dealt[by][name] == part for by in earlier for name, part in earlier[by].items())
    assert split(rows, splits, 4) != dealt
    by_scenario = split(rows, replace(splits, terrain_by="scenario"), 3)
    assert set(by_scenario["terrain"]) == {f"s{i}" for i in range(5)}
    refused = {"scenario": "s9", "status": "rejected"}
    assert split([refused, *rows], splits, 3) == dealt
