"""The transfer benchmark's comparison: what equal, reversed and halved sides give, and what its walks are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import transfer
from stridetwin.scenarios.campaign.campaign_file import read_campaign
from stridetwin.scenarios.campaign.plan import Extra, plan_walks


def errors(walks: int, seed: int, noise: float) -> dict[str, list[float]]:
    """Errors that the variants have on walks, m: each variant has a level of its own."""
    rng = np.random.default_rng(seed)
    names = [*transfer.our_variants(), *transfer.published_variants()]
    return {name: (0.05 * 1.2**i * np.exp(noise * rng.standard_normal(walks))).tolist() for i, name in enumerate(names)}


def test_a_side_agrees_with_itself_and_not_with_its_reverse() -> None:
    people = errors(14, 0, 0.1)
    figures = transfer.compare_sides(people, people)
    assert all(ratio == pytest.approx(1.0) for levels in figures["level"].values() for ratio in levels.values())
    assert all(rho == pytest.approx(1.0) for rho in figures["rank"].values())
    assert all(same == changed for changed, same in figures["signs"].values())
    reverse = {name: [1.0 / e for e in values] for name, values in people.items()}
    assert transfer.compare_sides(people, reverse)["rank"]["all, medians"] == pytest.approx(-1.0)


def test_people_agree_with_other_people_the_less_the_more_they_differ() -> None:
    alike, different = (transfer.compare_halves(errors(14, 0, noise), rounds=20) for noise in (0.1, 4.0))
    assert alike["rank, all, means"] > 0.98
    assert alike["signs, ours, medians"] > 0.9
    assert different["rank, all, means"] < 0.9
    assert different["signs, all, means"] < alike["signs, all, means"]


def test_its_campaign_walks_runs_and_goes_slowly() -> None:
    campaign = replace(read_campaign(transfer.CAMPAIGN), seed=0)
    gaits = [planned.scenario["gait"] for planned in plan_walks(campaign, Extra())]
    runs = [gait for gait in gaits if gait.get("pattern") == "run"]
    assert 0.2 < len(runs) / len(gaits) < 0.5
    assert min(gait["speed_mps"] for gait in runs) >= 1.5
    assert min(gait["speed_mps"] for gait in gaits) < 0.6
