"""Sampling, seeds and splits: even, deterministic, and the first walks stay when more are asked for."""

from dataclasses import replace

import numpy as np
import pytest
from small_campaign import write

from stridetwin.scenarios.campaign.campaign_file import Splits, load_campaign, read_campaign
from stridetwin.scenarios.campaign.manifest import assign_splits, card_text, manifest, varying_values
from stridetwin.scenarios.campaign.plan import Extra, draw_people, plan_walks, quasi_random_points
from stridetwin.scenarios.scenario_file import CAMERAS


def test_sobol_keeps_its_first_points_and_a_latin_hypercube_has_one_in_each_layer():
    few, many = (quasi_random_points("sobol", n, 5, 7, (0,)) for n in (20, 1000))
    assert np.array_equal(few, many[:20])
    layers = np.sort((quasi_random_points("latin_hypercube", 50, 3, 7, (0,)) * 50).astype(int), axis=0)
    assert np.array_equal(layers, np.tile(np.arange(50)[:, None], 3))
    for sampling in ("sobol", "latin_hypercube"):
        points = quasi_random_points(sampling, 300, 4, 7, (0,))
        assert np.array_equal(points, quasi_random_points(sampling, 300, 4, 7, (0,)))
        assert not np.array_equal(points, quasi_random_points(sampling, 300, 4, 8, (0,)))
        assert not np.array_equal(points, quasi_random_points(sampling, 300, 4, 7, (1,)))
        assert points.mean(axis=0) == pytest.approx(0.5, abs=0.01)
        assert ((points >= 0) & (points < 1)).all()


def test_more_walks_keep_the_first_ones(tmp_path):
    campaign = read_campaign(write(tmp_path))
    few, many = (plan_walks(replace(campaign, walks=n), Extra()) for n in (4, 33))
    assert few == many[:4]
    several = load_campaign("stairs_and_ramps")
    assert plan_walks(replace(several, walks=40), Extra()) == plan_walks(several, Extra())[:40]
    assert plan_walks(replace(campaign, seed=4), Extra())[0] != few[0]
    assert [w.seed for w in few] == [3000000, 3000001, 3000002, 3000003]


def test_scenarios_people_and_values_come_as_often_as_asked():
    campaign = load_campaign("stairs_and_ramps")
    walks = plan_walks(campaign, Extra())
    counts = {name: sum(w.base == name for w in walks) for name in ("stair_up_down", "ramp_up_down", "turns")}
    assert counts == pytest.approx({"stair_up_down": 375, "ramp_up_down": 375, "turns": 125}, abs=3)
    crowd = draw_people(campaign)
    assert len(crowd) == 40
    each = [sum(w.scenario["person"] == person for w in walks) for person in crowd]
    assert min(each) >= 20
    assert max(each) <= 30
    women = [p["height_m"] for p in crowd if p["sex"] == "female"]
    assert np.mean(women) == pytest.approx(1.64, abs=0.015)
    for walk in walks:
        if walk.base == "stair_up_down":
            up, down = (walk.scenario["terrain"][i]["stairs"] for i in (1, 3))
            assert (
                up["riser_mm"]
                == down["riser_mm"]
                == walk.values["terrain[1].stairs.riser_mm, terrain[3].stairs.riser_mm"]
            )
            assert not any("ramp" in name for name in walk.values)


@pytest.mark.parametrize("sampling", ["sobol", "latin_hypercube"])
def test_the_few_walks_of_one_scenario_fill_its_own_ranges(sampling):
    campaign = replace(load_campaign("stairs_and_ramps"), walks=24, sampling=sampling)
    treads = [
        w.values["terrain[1].stairs.tread_mm, terrain[3].stairs.tread_mm"]
        for w in plan_walks(campaign, Extra())
        if w.base == "stair_up_down"
    ]
    assert len(treads) == pytest.approx(9, abs=1)
    assert set(treads) == {260, 280, 300, 320, 340}
    assert np.mean(treads) == pytest.approx(300, abs=12)


TWO = """
campaign: Two scenarios, each with values of its own
walks: 128
scenarios:
  - scenario: stair_up_down
    set:
      "terrain[1].stairs.riser_mm, terrain[3].stairs.riser_mm": {uniform: [130, 190]}
      "terrain[1].stairs.tread_mm, terrain[3].stairs.tread_mm": {uniform: [260, 340]}
  - level_20m
people:
  - count: 16
    height_m: {uniform: [1.55, 1.9]}
    bmi: {normal: [24, 3], within: [19, 30]}
set:
  gait.speed_mps: {uniform: [0.7, 1.3]}
  light: {uniform: [0.4, 1.3]}
"""


@pytest.mark.parametrize(("sampling", "most"), [("sobol", 0.12), ("latin_hypercube", 0.3)])
def test_height_and_all_that_varies_within_a_scenario_have_nothing_to_do_with_each_other(tmp_path, sampling, most):
    campaign = replace(read_campaign(write(tmp_path, TWO)), sampling=sampling)
    for seed in range(4):
        found = [w for w in plan_walks(replace(campaign, seed=seed), Extra()) if w.base == "stair_up_down"]
        values = np.array([[w.scenario["person"]["height_m"], *w.values.values()] for w in found])
        assert values.shape == (64, 5)
        assert np.abs(np.corrcoef(values.T) - np.eye(5)).max() < most
        if sampling == "sobol":  # every field of four by four over two of them has some walks
            fields = [np.searchsorted(np.quantile(x, [0.25, 0.5, 0.75]), x) for x in values.T]
            for a, b in ((0, 1), (0, 3), (3, 4), (2, 4)):
                counts = np.bincount(4 * fields[a] + fields[b], minlength=16)
                assert counts.min() >= 2
                assert counts.max() <= 7


def test_the_people_of_a_group_stand_by_the_first_of_their_values(tmp_path):
    heights = [p["height_m"] for p in draw_people(read_campaign(write(tmp_path, TWO)))]
    assert heights == sorted(heights)
    assert np.diff(heights).max() < 0.05


TWICE = """
campaign: One scenario twice
walks: 8
scenarios:
  - {scenario: short.yaml, set: {gait.speed_mps: {uniform: [0.5, 0.6]}}}
  - {scenario: short.yaml, set: {gait.speed_mps: {uniform: [1.1, 1.2]}}}
  - {scenario: more/short.yaml, set: {gait.speed_mps: 0.9}}
set:
  light: {uniform: [0.4, 1.3]}
  gait.speed_mps: {uniform: [0.7, 0.8]}
splits: {terrain_by: scenario}
"""


def test_a_scenario_that_is_listed_twice_counts_as_two(tmp_path):
    path = write(tmp_path, TWICE)
    write(tmp_path / "more")
    campaign = read_campaign(path)
    assert [base.name for base in campaign.bases] == ["short", "short_2", "short_3"]
    assert varying_values(campaign) == {
        "light": "uniform 0.4 to 1.3",
        "gait.speed_mps": "uniform 0.7 to 0.8",
        "short: gait.speed_mps": "uniform 0.5 to 0.6",
        "short_2: gait.speed_mps": "uniform 1.1 to 1.2",
    }
    rows = [{"person": "p", "terrain": "t", "scenario": w.base} for w in plan_walks(campaign, Extra())]
    assert set(assign_splits(rows, campaign.splits, 0)["terrain"]) == {"short", "short_2", "short_3"}


def test_listed_values_are_those_of_the_walk(tmp_path):
    path = write(tmp_path, TWICE)
    write(tmp_path / "more")
    campaign = read_campaign(path)
    walks = plan_walks(campaign, Extra())
    for walk in walks:
        assert walk.values.get("gait.speed_mps", 0.9) == walk.scenario["gait"]["speed_mps"]
        assert ("gait.speed_mps" in walk.values) == (walk.base != "short_3")
        assert walk.values["light"] == walk.scenario["light"]
    rows = [
        {
            "walk": w.name,
            "status": "accepted",
            "scenario": w.base,
            "values": w.values,
            "person": "p",
            "body": {},
            "terrain": "t",
            "duration_s": 1.0,
            "bytes": 1,
            "reasons": [],
        }
        for w in walks
    ]
    lines = card_text(manifest(campaign, rows, {}, {})).splitlines()
    (common,) = [line for line in lines if line.startswith("| gait.speed_mps |")]
    assert common == "| gait.speed_mps | uniform 0.7 to 0.8 |  |  |"


def test_a_replaced_variable_is_not_listed_and_a_partly_replaced_one_is(tmp_path):
    text = TWO.replace("  - level_20m", "  - {scenario: level_20m, set: {gait: {fixed: {speed_mps: 1}}}}")
    text += "  'texture, gait.gaze': {choice: [plain, rich]}\n  physics: {choice: [kinematic, dynamic]}\n"
    text += "  sensors.head_camera.part: {choice: [D455, L515]}\n"
    campaign = read_campaign(write(tmp_path, text))
    for walk in plan_walks(campaign, Extra()):
        assert ("gait.speed_mps" in walk.values) == (walk.base == "stair_up_down")
        assert {"texture, gait.gaze", "physics", "sensors.head_camera.part"} < walk.values.keys()
    asked = plan_walks(campaign, Extra(physics="kinematic", off=CAMERAS))
    for walk, one in zip(asked, plan_walks(campaign, Extra())):
        assert one.values.keys() - walk.values.keys() == {"physics", "sensors.head_camera.part"}
        assert walk.values.items() <= one.values.items()


def test_nobody_is_in_two_parts_and_shares_hold():
    rng = np.random.default_rng(0)
    rows = [
        {"person": f"p{rng.integers(40)}", "terrain": f"t{rng.integers(300)}", "scenario": f"s{i % 5}"}
        for i in range(1000)
    ]
    splits = Splits()
    dealt = assign_splits(rows, splits, 3)
    for by, count in (("person", 40), ("terrain", len({r["terrain"] for r in rows}))):
        assert len(dealt[by]) == count
        for part, share in splits.shares.items():
            assert sum(p == part for p in dealt[by].values()) == pytest.approx(share * count, abs=2)
    earlier = assign_splits(rows[:100], splits, 3)
    assert all(dealt[by][name] == part for by in earlier for name, part in earlier[by].items())
    assert assign_splits(rows, splits, 4) != dealt
    by_scenario = assign_splits(rows, replace(splits, terrain_by="scenario"), 3)
    assert set(by_scenario["terrain"]) == {f"s{i}" for i in range(5)}
    refused = {"scenario": "s9", "status": "rejected"}
    assert assign_splits([refused, *rows], splits, 3) == dealt
