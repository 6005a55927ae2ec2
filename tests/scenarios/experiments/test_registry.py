"""Experiments by name: cases that are kept, gone on with, and laid beside the paper's."""

from __future__ import annotations

import json

import pytest

from stridetwin.scenarios.experiments import registry
from stridetwin.scenarios.experiments.case import Case
from stridetwin.scenarios.experiments.names import EXPERIMENT_NAMES
from stridetwin.scenarios.experiments.registry import EXPERIMENTS, Asked, Experiment, run_experiment
from stridetwin.streams.errors import StrideTwinError


def collected(results: list[dict]) -> dict:
    return {"summary": {"sum": sum(r["seed"] for r in results)}, "paper": {}}


@pytest.fixture
def ran(monkeypatch) -> list[int]:
    """Seeds that an experiment named `small` has run."""
    seeds: list[int] = []

    def run_case(case: Case) -> dict:
        seeds.append(case.seed)
        return {"seed": case.seed, "physics": case.physics}

    small = Experiment(seeds=range(5, 9), run_case=run_case, collect=collected, table=lambda result: [])
    monkeypatch.setitem(registry.EXPERIMENTS, "small", small)
    return seeds


def run(folder, **options):
    shares = []
    result = run_experiment("small", Asked(folder=folder, **options), lambda _, share: shares.append(share))
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    return result


def test_cases_are_kept_and_a_stopped_run_goes_on(tmp_path, ran) -> None:
    assert [c["seed"] for c in run(tmp_path, subset=2)["cases"]] == [5, 6]
    result = run(tmp_path, resume=True)
    assert ran == [5, 6, 7, 8]
    assert result["summary"]["sum"] == 26
    assert json.loads((tmp_path / "seed_7.json").read_text()) == {"seed": 7, "physics": "dynamic"}
    run(tmp_path, subset=1)
    assert ran == [5, 6, 7, 8, 5]


def test_other_seeds_than_the_reported_ones_can_be_asked_for(tmp_path, ran) -> None:
    assert [c["seed"] for c in run(tmp_path, first=2, subset=2)["cases"]] == [2, 3]
    assert ran == [2, 3]


def test_walks_of_another_physics_are_not_mixed_in(tmp_path, ran) -> None:
    run(tmp_path, subset=1)
    with pytest.raises(StrideTwinError, match=r"seed_5\.json: physics: dynamic is not valid; valid: kinematic"):
        run(tmp_path, subset=1, physics="kinematic", resume=True)


def test_every_experiment_is_listed_and_others_are_refused(tmp_path) -> None:
    assert set(EXPERIMENTS) == set(EXPERIMENT_NAMES)
    with pytest.raises(StrideTwinError, match="jao_loop_126m"):
        run_experiment("magic", Asked(folder=tmp_path), lambda *_: None)
